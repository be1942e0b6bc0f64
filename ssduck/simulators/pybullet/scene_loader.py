"""Loads the models of a scene into a PyBullet client."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, cast

import numpy as np

from ssduck.errors import SceneError, nearest
from ssduck.geometry.poses import compose
from ssduck.simulators.interface import SCALAR_JOINTS, Joint, Kind, MotorTarget
from ssduck.simulators.kinematics import LIMIT_TOLERANCE
from ssduck.simulators.pybullet.bodies import BodyDescription, joint_of, wxyz, xyzw
from ssduck.simulators.pybullet.console import captured, pybullet
from ssduck.simulators.scenes import BodySpec, ConstraintSpec, Scene

CONSTRAINTS = {
    "fixed": pybullet.JOINT_FIXED,
    "point": pybullet.JOINT_POINT2POINT,
    "prismatic": pybullet.JOINT_PRISMATIC,
    "gear": pybullet.JOINT_GEAR,
}
# PyBullet's parameters by the attributes of `Engine`.
_ENGINE = {
    "substeps": "numSubSteps",
    "iterations": "numSolverIterations",
    "joint_iterations": "numNonContactInnerIterations",
}
# The beginning of each of Bullet's messages, which do not end in a new line.
_MESSAGE_START = re.compile(r"b3(?:Error|Warning)\[[^]]*\]:")


@dataclass(frozen=True, eq=False)
class SceneOrigin:
    """The scene entry that a body was loaded from, and the body's index in the entry's file."""

    spec: BodySpec
    number: int


@dataclass(eq=False)
class LoadedBodies:
    """Knowledge about the bodies that ssduck loaded into a client, by PyBullet body number.

    Attributes:
        names: the names in the scene.
        kinds: the kinds in the scene.
        origins: the scene entries of bodies that were loaded from a file.
        motor_positions: the positions that motors hold, by link.
        described: the descriptions of bodies, if known already.
        disabled: bodies that begin without collisions.
        hidden: bodies that begin hidden.
        time: the initial simulated time, s.
        elastic: whether nothing loses energy.
    """

    names: dict[int, str] = field(default_factory=dict)
    kinds: dict[int, Kind] = field(default_factory=dict)
    origins: dict[int, SceneOrigin] = field(default_factory=dict)
    motor_positions: dict[int, dict[int, float]] = field(default_factory=dict)
    described: dict[int, BodyDescription] = field(default_factory=dict)
    disabled: set[int] = field(default_factory=set)
    hidden: set[int] = field(default_factory=set)
    time: float = 0.0
    elastic: bool = False


def load_models(scene: Scene, client: int) -> LoadedBodies:
    """Fills a new client with a scene.

    Raises:
        SceneError: a model cannot be loaded, or a constraint cannot be made: file, key and reason.
    """
    pybullet.setTimeStep(scene.timestep, client)
    pybullet.setGravity(*scene.gravity, physicsClientId=client)
    engine = {name: value for name, value in asdict(scene.engine).items() if value is not None}
    set_solver_settings(engine, client)
    if scene.elastic:
        set_elastic(client)
    loaded = LoadedBodies(time=scene.time, elastic=scene.elastic)
    for index, spec in enumerate(scene.bodies):
        # A model that is loaded by itself has no entry in a scene's file.
        load_body(spec, f"{scene.path}: body[{index}]." if spec.name else "", loaded, client)
    _create_constraints(scene, loaded, client)
    # The contacts and rays of the first tick are those of the present poses.
    pybullet.performCollisionDetection(client)
    return loaded


def set_elastic(client: int) -> None:
    """Makes the collisions of a client elastic."""
    pybullet.setPhysicsEngineParameter(
        # Slow contacts bounce, too. No penetration is corrected: that would add energy.
        restitutionVelocityThreshold=0.0,
        contactERP=0.0,
        physicsClientId=client,
    )


def make_elastic(handle: int, client: int) -> None:
    """Makes a body elastic and frictionless, without damping."""
    for link in range(-1, pybullet.getNumJoints(handle, client)):
        pybullet.changeDynamics(
            handle,
            link,
            restitution=1.0,
            lateralFriction=0.0,
            spinningFriction=0.0,
            rollingFriction=0.0,
            linearDamping=0.0,
            angularDamping=0.0,
            # A contact that begins before shapes meet would brake them. The world's own threshold,
            # contactBreakingThreshold, applies to all clients of a process.
            contactProcessingThreshold=0.0,
            physicsClientId=client,
        )


def set_solver_settings(engine: Mapping[str, int], client: int) -> None:
    """Sets the solver, by the names of `Engine`; equal values are not set."""
    for name, value in engine.items():
        if solver_settings(client)[name] != value:
            pybullet.setPhysicsEngineParameter(physicsClientId=client, **{_ENGINE[name]: value})


def solver_settings(client: int) -> dict[str, int]:
    """Returns the settings of the solver, by the names of `Engine`."""
    parameters = pybullet.getPhysicsEngineParameters(client)
    return {name: int(parameters[key]) for name, key in _ENGINE.items()}


def load_body(spec: BodySpec, place: str, loaded: LoadedBodies, client: int) -> Sequence[int]:
    """Loads a scene entry and returns the numbers of its bodies; a file may hold several.

    Args:
        spec: the entry.
        place: its place in errors.
        loaded: the bodies loaded so far; receives these.
        client: the client.

    Raises:
        SceneError: the model cannot be loaded: file, key and reason.
    """
    handles = load_model(spec, place, client)
    for number, handle in enumerate(handles):
        loaded.origins[handle] = SceneOrigin(spec, number)
        if spec.name:
            loaded.names[handle] = spec.name
        if spec.kind:
            loaded.kinds[handle] = spec.kind
        if not spec.enabled:
            loaded.disabled.add(handle)
        if not spec.visible:
            loaded.hidden.add(handle)
        positions = _set_joints(handle, spec, place, client)
        if positions:
            loaded.motor_positions[handle] = positions
        if loaded.elastic:
            make_elastic(handle, client)
    return handles


def load_model(spec: BodySpec, place: str, client: int) -> Sequence[int]:
    """Loads a model file; an SDF or MJCF file may hold several bodies."""
    file = str(spec.model)
    suffix = spec.model.suffix.lower()
    with captured() as lines:
        try:
            if suffix == ".urdf":
                return (_load_urdf(spec, file, client),)
            load = pybullet.loadSDF if suffix == ".sdf" else pybullet.loadMJCF
            return cast("Sequence[int]", load(file, physicsClientId=client))
        except (pybullet.error, UnicodeEncodeError) as error:
            failure = error
    messages = [part.strip() for part in _MESSAGE_START.split(" ".join(lines)) if part.strip()]
    reason = "; ".join(messages) or str(failure)
    where = f"{place}urdf: " if place else ""
    raise SceneError(f"{where}{file} cannot be loaded: {reason}") from failure


def _load_urdf(spec: BodySpec, file: str, client: int) -> int:
    flags = pybullet.URDF_USE_IMPLICIT_CYLINDER  # PyBullet would make prisms of cylinders
    if spec.own_inertia:
        flags |= pybullet.URDF_USE_INERTIA_FROM_FILE
    handle = int(
        pybullet.loadURDF(file, useFixedBase=spec.fixed, flags=flags, physicsClientId=client)
    )
    # The flags of loadURDF decide whether its position is that of the root's centre of mass or of
    # its link frame; so the link frame is placed here.
    dynamics = pybullet.getDynamicsInfo(handle, -1, client)
    link = np.array([spec.position]), np.array([spec.orientation])
    com = np.array([dynamics[3]]), wxyz(np.array([dynamics[4]]))
    position, orientation = compose(*link, *com)
    pybullet.resetBasePositionAndOrientation(
        handle, position[0].tolist(), xyzw(orientation)[0].tolist(), client
    )
    if any(spec.velocity):
        linear, spin = np.array(spec.velocity[:3]), np.array(spec.velocity[3:])
        linear = linear + np.cross(spin, position[0] - link[0][0])
        pybullet.resetBaseVelocity(handle, linear.tolist(), spin.tolist(), client)
    return handle


def _set_joints(handle: int, spec: BodySpec, place: str, client: int) -> dict[int, float]:
    """Sets the initial joint states, and makes motors hold joints with limits.

    A joint that the scene does not set is at 0, or at its limit nearest to 0. Joints without limits
    are wheels and the like; their motors hold velocity 0.

    Returns:
        The positions that motors hold, by link; empty if PyBullet's own motors stay as they are.
    """
    count = pybullet.getNumJoints(handle, client)
    joints = [joint_of(pybullet.getJointInfo(handle, index, client)) for index in range(count)]
    for key in ("joints", "held"):
        for name, value in getattr(spec, key).items():
            _check_joint(name, value, joints, f"{place}{key}.{name}: {spec.model.name}")
    for name in spec.joint_velocities:
        _check_joint(name, None, joints, f"{place}joint_velocities.{name}: {spec.model.name}")
    motor_positions: dict[int, float] = {}
    for joint in joints:
        if joint.type not in SCALAR_JOINTS:
            continue
        value = spec.joints.get(joint.name, position_nearest_zero(joint))
        velocity = spec.joint_velocities.get(joint.name, 0.0)
        pybullet.resetJointState(handle, joint.link - 1, value, velocity, client)
        if spec.hold:
            motor_positions[joint.link] = spec.held.get(joint.name, value)
            hold_joint(handle, joint, motor_positions[joint.link], client)
    return motor_positions


def hold_joint(handle: int, joint: Joint, value: float, client: int) -> None:
    """Makes a joint's motor hold a position; velocity 0 for a joint without limits."""
    position = None if joint.lower is None else value
    set_motor(handle, joint.link, MotorTarget(position, 0.0, joint.max_effort or 0.0, None), client)


def set_motor(handle: int, link: int, motor: MotorTarget, client: int) -> None:
    """Sets the motor of a link's joint for the next steps."""
    bounds: dict[str, Any] = {} if motor.speed is None else {"maxVelocity": motor.speed}
    target: dict[str, Any] = (
        {"controlMode": pybullet.VELOCITY_CONTROL, "targetVelocity": motor.velocity}
        if motor.position is None
        else {"controlMode": pybullet.POSITION_CONTROL, "targetPosition": motor.position}
    )
    pybullet.setJointMotorControl2(
        handle, link - 1, force=motor.effort, physicsClientId=client, **target, **bounds
    )


def _check_joint(name: str, value: float | None, joints: Sequence[Joint], place: str) -> None:
    """Raises an error for a joint that does not exist or cannot be at a position."""
    by_name = {joint.name: joint for joint in joints}
    if name not in by_name:
        raise SceneError(f"{place} has no such joint", suggestions=nearest(name, by_name))
    joint = by_name[name]
    if joint.type not in SCALAR_JOINTS:
        raise SceneError(f"{place}: a {joint.type} joint has no position")
    low, high = _limits(joint)
    # Solvers leave a joint a little beyond its limits, and worlds are saved in that state.
    if value is not None and not low - LIMIT_TOLERANCE < value < high + LIMIT_TOLERANCE:
        raise SceneError(f"{place}: {value:g} is not from {low:g} to {high:g}, the joint's limits")


def _create_constraints(scene: Scene, loaded: LoadedBodies, client: int) -> None:
    handles = {name: handle for handle, name in loaded.names.items()}
    for index, spec in enumerate(scene.constraints):
        place = f"{scene.path}: constraint[{index}]."
        ends = []
        for key, body, link in (("on", spec.on, spec.link), ("to", spec.to, spec.to_link)):
            if body is None:
                ends.append((-1, -1))
                continue
            handle = handles[body]
            names = _link_names(handle, client)
            if link is not None and link not in names:
                raise SceneError(
                    f"{place}{key}_link: {body!r} has no link {link!r}",
                    suggestions=nearest(link, names),
                )
            ends.append((handle, -1 if link is None else names.index(link) - 1))
        create_constraint(spec, ends[0], ends[1], client)


def _link_names(handle: int, client: int) -> list[str]:
    infos = [
        pybullet.getJointInfo(handle, index, client)[12]
        for index in range(pybullet.getNumJoints(handle, client))
    ]
    base = pybullet.getBodyInfo(handle, client)[0]
    return [name.decode(errors="replace") for name in (base, *infos)]


def create_constraint(
    spec: ConstraintSpec, on: tuple[int, int], to: tuple[int, int], client: int
) -> None:
    """Creates a constraint between two links, each a body number and PyBullet's link index."""
    number = pybullet.createConstraint(
        *on,
        *to,
        CONSTRAINTS[spec.type],
        spec.axis,
        spec.position,
        spec.to_position,
        _to_xyzw(spec.orientation),
        _to_xyzw(spec.to_orientation),
        physicsClientId=client,
    )
    settings: dict[str, Any] = {}
    # PyBullet's default of 500 is an impulse of 500 N s; if set, it would be a force of 500 N.
    if spec.max_force != ConstraintSpec.max_force:
        settings["maxForce"] = spec.max_force
    if spec.type == "gear":
        settings |= {
            "gearRatio": spec.gear_ratio,
            "gearAuxLink": spec.gear_link,
            "relativePositionTarget": spec.gear_target,
        }
    if spec.erp:
        settings["erp"] = spec.erp
    if settings:
        pybullet.changeConstraint(number, physicsClientId=client, **settings)


def _to_xyzw(orientation: Sequence[float]) -> list[float]:
    w, *vector = orientation
    return [*vector, w]


def _limits(joint: Joint) -> tuple[float, float]:
    if joint.lower is None or joint.upper is None:
        return -math.inf, math.inf
    return joint.lower, joint.upper


def position_nearest_zero(joint: Joint) -> float:
    """Returns 0, or the limit of a joint nearest to 0."""
    low, high = _limits(joint)
    return min(max(0.0, low), high)
