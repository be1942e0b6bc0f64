"""Loads the models of a scene into a PyBullet client."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ssduck.errors import SceneError, nearest, warn
from ssduck.formatting import joined_names
from ssduck.simulators.interface import SCALAR_JOINTS, Joint, Kind, MotorTarget
from ssduck.simulators.joints import check_joints, position_nearest_zero
from ssduck.simulators.naming import unique_name
from ssduck.simulators.pybullet.bodies import BodyDescription, joint_of
from ssduck.simulators.pybullet.clients import pybullet
from ssduck.simulators.pybullet.model_files import ModelFile
from ssduck.simulators.pybullet.model_loader import link_names, load_model, names_in_file
from ssduck.simulators.scene_bodies import MODEL_SUFFIXES, BodySpec
from ssduck.simulators.scenes import ConstraintSpec, Scene, check_body
from ssduck.simulators.toml_reader import Vector

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
        skipped: what PyBullet says of parts of model files that it skips.
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
    skipped: dict[Path, tuple[str, ...]] = field(default_factory=dict)
    time: float = 0.0
    elastic: bool = False


def load_models(scene: Scene, client: int) -> LoadedBodies:
    """Fills a new client with a scene."""
    pybullet.setTimeStep(scene.timestep, client)
    pybullet.setGravity(*scene.gravity, physicsClientId=client)
    engine = {name: value for name, value in asdict(scene.engine).items() if value is not None}
    set_solver_settings(engine, client)
    if scene.elastic:
        set_elastic(client)
    loaded = LoadedBodies(time=scene.time, elastic=scene.elastic)
    entries = [(scene.floor, load_body(scene.floor, "", loaded, client))] if scene.floor else []
    # A model by itself has no entry in a scene's file.
    is_model = scene.path.suffix.lower() in MODEL_SUFFIXES
    for index, spec in enumerate(scene.bodies):
        place = "" if is_model else f"{scene.path}: body[{index}]."
        entries.append((spec, load_body(spec, place, loaded, client)))
    loaded.names = _names(scene, entries, client)
    _warn_of_ignored_parts(entries, loaded)
    _create_constraints(scene, loaded, client)
    # The contacts and rays of the first tick are those of the present poses.
    pybullet.performCollisionDetection(client)
    for handle, name in loaded.names.items():
        _check_poses(handle, f"{scene.path}: {name!r}", client)
    return loaded


def _check_poses(handle: int, place: str, client: int) -> None:
    """Checks that the links of a body have poses: a joint about an axis of length 0 gives none."""
    count = pybullet.getNumJoints(handle, client)
    links = pybullet.getLinkStates(handle, range(count), physicsClientId=client) if count else ()
    names = ["its base"] + [f"the joint {joint.name!r}" for joint in _joints_of(handle, client)]
    poses = [pybullet.getBasePositionAndOrientation(handle, client)]
    poses += [(link[4], link[5]) for link in links]
    for name, pose in zip(names, poses, strict=True):
        if not all(math.isfinite(number) for part in pose for number in part):
            raise SceneError(f"{place} has no pose at {name}: is an axis or an origin no vector?")


def _names(
    scene: Scene, entries: Sequence[tuple[BodySpec, Sequence[int]]], client: int
) -> dict[int, str]:
    """Returns the unique names of the bodies of a scene by body number; those of files give way."""
    taken = {str(spec.name) for spec, _ in entries} | {sensor.name for sensor in scene.sensors}
    names = {}
    for spec, handles in entries:
        if spec.name is not None and len(handles) == 1:
            names[handles[0]] = spec.name
            continue
        for handle, own_name in zip(handles, names_in_file(spec, handles, client), strict=True):
            name = own_name if spec.name is None else f"{spec.name}_{own_name}"
            names[handle] = unique_name(name, taken)
            taken.add(names[handle])
    return names


def _warn_of_ignored_parts(
    entries: Sequence[tuple[BodySpec, Sequence[int]]], loaded: LoadedBodies
) -> None:
    """Warns of each model file with parts that PyBullet ignores."""
    names: dict[Path, list[str]] = {}
    parts: dict[Path, list[str]] = {}
    for spec, handles in entries:
        if isinstance(spec.model, Path):
            names.setdefault(spec.model, []).extend(loaded.names[handle] for handle in handles)
            if spec.model not in parts:
                parts[spec.model] = ModelFile.read(spec).ignored(spec.fixed)
    for file, found in parts.items():
        said = [f"PyBullet {part}" for part in found] + list(loaded.skipped.get(file, ()))
        if said:
            warn(f"{file} ({joined_names(names[file])}): {'; '.join(said)}")


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


def gravity_of(parameters: Mapping[str, float]) -> Vector:
    """Returns gravity, m/s², among PyBullet's parameters."""
    x, y, z = (parameters[f"gravityAcceleration{axis}"] for axis in "XYZ")
    return x, y, z


def load_body(spec: BodySpec, place: str, loaded: LoadedBodies, client: int) -> Sequence[int]:
    """Loads a scene entry and returns the numbers of its bodies; a file may hold several."""
    handles, messages = load_model(spec, place, client)
    if messages and isinstance(spec.model, Path):
        loaded.skipped[spec.model] = messages
    joints = [_joints_of(handle, client) for handle in handles]
    check_joints(spec, [joint for of_body in joints for joint in of_body], place)
    for number, handle in enumerate(handles):
        loaded.origins[handle] = SceneOrigin(spec, number)
        if spec.kind:
            loaded.kinds[handle] = spec.kind
        if not spec.enabled:
            loaded.disabled.add(handle)
        if not spec.visible:
            loaded.hidden.add(handle)
        positions = _set_joints(handle, spec, joints[number], client)
        if positions:
            loaded.motor_positions[handle] = positions
        if loaded.elastic:
            make_elastic(handle, client)
    return handles


def _joints_of(handle: int, client: int) -> list[Joint]:
    count = pybullet.getNumJoints(handle, client)
    return [joint_of(pybullet.getJointInfo(handle, index, client)) for index in range(count)]


def _set_joints(
    handle: int, spec: BodySpec, joints: Sequence[Joint], client: int
) -> dict[int, float]:
    """Sets the initial joint states; returns the positions that motors hold, by link.

    A joint that the scene does not set is at 0, or at its limit nearest to 0. Joints without limits
    are wheels and the like; their motors hold velocity 0.
    """
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


def _create_constraints(scene: Scene, loaded: LoadedBodies, client: int) -> None:
    handles = {name: handle for handle, name in loaded.names.items()}
    for index, spec in enumerate(scene.constraints):
        place = f"{scene.path}: constraint[{index}]."
        ends = []
        for key, body, link in (("on", spec.on, spec.link), ("to", spec.to, spec.to_link)):
            if body is None:
                ends.append((-1, -1))
                continue
            check_body(body, handles, f"{place}{key}")
            handle = handles[body]
            names = link_names(handle, client)
            if link is not None and link not in names:
                raise SceneError(
                    f"{place}{key}_link: {body!r} has no link {link!r}",
                    suggestions=nearest(link, names),
                )
            ends.append((handle, -1 if link is None else names.index(link) - 1))
        create_constraint(spec, ends[0], ends[1], client)


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


def add_fixed_constraint(client: int, on: tuple[int, int], to: int) -> None:
    """Connects a link (body number, PyBullet's index) to the base of a body, as they are."""
    # A constraint connects the frames of two centres of mass.
    handle, link = on
    com_pose = (
        pybullet.getBasePositionAndOrientation(handle, client)
        if link < 0
        else pybullet.getLinkState(handle, link, 0, 1, client)[:2]
    )
    other = pybullet.getBasePositionAndOrientation(to, client)
    position, (x, y, z, w) = pybullet.multiplyTransforms(
        *pybullet.invertTransform(*com_pose), *other
    )
    spec = ConstraintSpec("fixed", on="", position=position, orientation=(w, x, y, z))
    create_constraint(spec, on, (to, -1), client)


def fixed_constraints(client: int, on: int, to: int) -> list[int]:
    """Returns the numbers of the fixed constraints between a body and the base of another."""
    numbers = [
        pybullet.getConstraintUniqueId(index, physicsClientId=client)
        for index in range(pybullet.getNumConstraints(client))
    ]
    return [
        number
        for number in numbers
        for info in [pybullet.getConstraintInfo(number, client)]
        if (info[0], info[2], info[3], info[4]) == (on, to, -1, pybullet.JOINT_FIXED)
    ]
