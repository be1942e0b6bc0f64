"""Loads the models of a scene, files and primitives, into a PyBullet client."""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ssduck.errors import SceneError, nearest, warn
from ssduck.formatting import joined_names
from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import compose
from ssduck.simulators.interface import SCALAR_JOINTS, Joint, MotorTarget
from ssduck.simulators.kinematics import check_joints, position_nearest_zero
from ssduck.simulators.naming import body_name, name_by_file, unique_name
from ssduck.simulators.pybullet.bodies import BodyDescription, joint_of, wxyz, xyzw
from ssduck.simulators.pybullet.clients import captured, pybullet
from ssduck.simulators.pybullet.model_files import ModelFile
from ssduck.simulators.pybullet.model_repairs import check_meshes, write_for_pybullet
from ssduck.simulators.scene_bodies import BodySpec, Primitive
from ssduck.simulators.scenes import ConstraintSpec, Engine, Scene, check_body

# The beginning of each of Bullet's messages, which do not end in a new line.
_MESSAGE_START = re.compile(r"b3(?:Error|Warning)\[[^]]*\]:")
# What PyBullet prints of what it goes on without: no part of a failure.
_CHATTER = re.compile(r"continuing without|using mass=", re.IGNORECASE)
# Messages about parts of files that are not loaded, and the beginning of some of them.
_SKIPPED = re.compile(
    r"cannot find|cannot extract|parse vector3 '|unhandled geom type|geom requires"
    r"|multiple root links"
)
_FILE_AND_LINE = re.compile(r"^(?:.*:\d+|\S*/): ")
_SHAPES = {
    "box": pybullet.GEOM_BOX,
    "sphere": pybullet.GEOM_SPHERE,
    "cylinder": pybullet.GEOM_CYLINDER,
    "capsule": pybullet.GEOM_CAPSULE,
    "plane": pybullet.GEOM_PLANE,
}


def _load_model(spec: BodySpec, place: str, client: int) -> tuple[Sequence[int], tuple[str, ...]]:
    """Returns PyBullet's numbers of bodies, and what it reads otherwise than meant, in words."""
    if isinstance(spec.model, Primitive):
        with captured():  # PyBullet warns about the picture of a plane, and draws it
            return (_create_primitive(spec, spec.model, client),), ()
    where = f"{place}{spec.source}: " if place else ""
    failure: Exception | None = None
    handles: Sequence[int] = ()
    doubts: list[str] = []
    with captured() as lines:
        try:
            handles = _load_file(spec, client, doubts)
        except (pybullet.error, UnicodeEncodeError, SceneError) as error:
            failure = error
    messages = [part.strip() for part in _MESSAGE_START.split(" ".join(lines)) if part.strip()]
    if failure is None:
        skipped = (message for message in messages if _SKIPPED.search(message))
        said = dict.fromkeys(_FILE_AND_LINE.sub("", message) for message in skipped)
        return handles, (*doubts, *said)
    faults = (_FILE_AND_LINE.sub("", m) for m in messages if not _CHATTER.search(m))
    reason = "; ".join(faults) or str(failure)
    raise SceneError(f"{where}{spec.model} cannot be loaded: {reason}") from failure


def _load_file(spec: BodySpec, client: int, doubts: list[str]) -> Sequence[int]:
    """Loads a model file; adds what PyBullet reads otherwise than meant to a list."""
    model = ModelFile.read(spec)
    doubts += (f"PyBullet {part}" for part in model.ignored(spec.fixed))
    ignored = "".join(f"; {doubt}" for doubt in doubts)
    doubts += model.check()
    check_meshes(model.file, model.root)
    with tempfile.TemporaryDirectory(prefix="ssduck") as folder:
        file = str(write_for_pybullet(model.file, model.format, model.root, Path(folder)))
        if spec.source == "urdf":
            return (_load_urdf(spec, file, client),)
        load = pybullet.loadSDF if spec.source == "sdf" else pybullet.loadMJCF
        handles: Sequence[int] = load(file, physicsClientId=client)
    if not handles:
        raise SceneError(f"no body is in it{ignored}")
    static = model.static_models()
    for number, handle in enumerate(handles):
        if spec.fixed or number in static:
            pybullet.changeDynamics(handle, -1, mass=0.0, physicsClientId=client)
        if (spec.position, spec.orientation) != (BodySpec.position, BodySpec.orientation):
            _put(handle, spec, pybullet.getBasePositionAndOrientation(handle, client), client)
    return handles


def link_names(handle: int, client: int) -> list[str]:
    """Returns PyBullet's names of the links of a body, the base first."""
    links = range(pybullet.getNumJoints(handle, client))
    names = (pybullet.getJointInfo(handle, index, client)[12] for index in links)
    base = pybullet.getBodyInfo(handle, client)[0]
    return [name.decode(errors="replace") for name in (base, *names)]


def _put(handle: int, spec: BodySpec, com: Sequence[Any], client: int) -> Array:
    """Puts a body at the pose of its entry, by that of its centre of mass in the frame there.

    Returns the position of the centre of mass, (3,).
    """
    origin = np.array([spec.position]), np.array([spec.orientation])
    places, turns = compose(*origin, np.array([com[0]]), wxyz(np.array([com[1]])))
    place: Array = places[0]
    pybullet.resetBasePositionAndOrientation(
        handle, place.tolist(), xyzw(turns)[0].tolist(), client
    )
    return place


def _load_urdf(spec: BodySpec, file: str, client: int) -> int:
    flags = pybullet.URDF_USE_IMPLICIT_CYLINDER  # PyBullet would make prisms of cylinders
    if spec.own_inertia:
        flags |= pybullet.URDF_USE_INERTIA_FROM_FILE
    handle = int(
        pybullet.loadURDF(file, useFixedBase=spec.fixed, flags=flags, physicsClientId=client)
    )
    # The flags of loadURDF decide whether its position is that of the root's centre of mass or of
    # its link frame; so the link frame is placed here.
    position = _put(handle, spec, pybullet.getDynamicsInfo(handle, -1, client)[3:5], client)
    _set_velocity(handle, spec, position - spec.position, client)
    return handle


def _set_velocity(handle: int, spec: BodySpec, com: Array, client: int) -> None:
    """Sets the velocity of a base whose centre of mass is at a place from its link frame."""
    if any(spec.velocity):
        linear, spin = np.array(spec.velocity[:3]), np.array(spec.velocity[3:])
        linear = linear + np.cross(spin, com)
        pybullet.resetBaseVelocity(handle, linear.tolist(), spin.tolist(), client)


def _create_primitive(spec: BodySpec, primitive: Primitive, client: int) -> int:
    shape, size, material = _SHAPES[primitive.type], primitive.size, primitive.material
    sizes: dict[str, Any] = {"radius": size[0]}
    if primitive.type == "box":
        sizes = {"halfExtents": [length / 2 for length in size]}
    elif primitive.type == "plane":
        sizes = {"planeNormal": size}
    is_long = primitive.type in ("cylinder", "capsule")
    collides = {"height": size[1], **sizes} if is_long else sizes
    drawn = {"length": size[1], **sizes} if is_long else sizes
    handle = int(
        pybullet.createMultiBody(
            0.0 if spec.fixed else primitive.mass,
            pybullet.createCollisionShape(shape, physicsClientId=client, **collides),
            pybullet.createVisualShape(
                shape, rgbaColor=material.colour, physicsClientId=client, **drawn
            ),
            spec.position,
            xyzw(np.array([spec.orientation]))[0].tolist(),
            physicsClientId=client,
        )
    )
    pybullet.changeDynamics(
        handle,
        -1,
        lateralFriction=material.friction,
        rollingFriction=material.rolling_friction,
        spinningFriction=material.spinning_friction,
        restitution=material.restitution,
        physicsClientId=client,
    )
    _set_velocity(handle, spec, np.zeros(3), client)
    return handle


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


@dataclass(eq=False)
class LoadedBodies:
    """Knowledge about the bodies that ssduck loaded into a client, by PyBullet body number."""

    names: dict[int, str] = field(default_factory=dict)  # the names in the scene
    origins: dict[int, BodySpec] = field(default_factory=dict)  # the entries in the scene
    # The positions that motors hold, by link.
    motor_positions: dict[int, dict[int, float]] = field(default_factory=dict)
    # The descriptions of bodies, if known already.
    described: dict[int, BodyDescription] = field(default_factory=dict)
    # What PyBullet ignores, skips or reads otherwise in model files, in words.
    doubts: dict[Path, tuple[str, ...]] = field(default_factory=dict)
    time: float = 0.0  # the initial simulated time, s
    elastic: bool = False  # whether nothing loses energy


def load_models(scene: Scene, client: int) -> LoadedBodies:
    """Fills a new client with a scene."""
    set_up(scene, client)
    loaded = LoadedBodies(time=scene.time, elastic=scene.elastic)
    entries = [(spec, load_body(spec, place, loaded, client)) for spec, place in scene.entries]
    loaded.names = _names(scene, entries, client)
    for file, doubts in loaded.doubts.items():
        names = [
            loaded.names[n] for spec, handles in entries if spec.model == file for n in handles
        ]
        warn(f"{file} ({joined_names(names)}): {'; '.join(doubts)}")
    _create_constraints(scene, loaded, client)
    # The contacts and rays of the first tick are those of the present poses.
    pybullet.performCollisionDetection(client)
    for handle, name in loaded.names.items():
        _check_poses(handle, f"{scene.path}: {name!r}", client)
    return loaded


def set_up(scene: Scene, client: int) -> None:
    """Gives a client the gravity, the time step and the solver of a scene."""
    pybullet.setTimeStep(scene.timestep, client)
    pybullet.setGravity(*scene.gravity, physicsClientId=client)
    present = pybullet.getPhysicsEngineParameters(client)
    engine = {_ENGINE[name]: value for name, value in asdict(scene.engine).items()}
    changes = {key: n for key, n in engine.items() if n is not None and n != present[key]}
    if scene.elastic:
        # Slow contacts bounce, too. No penetration is corrected: that would add energy.
        changes |= {"restitutionVelocityThreshold": 0.0, "contactERP": 0.0}
    if changes:
        pybullet.setPhysicsEngineParameter(physicsClientId=client, **changes)


def settings_of(client: int, loaded: LoadedBodies) -> Scene:
    """Returns a scene without bodies: the gravity, the time step and the solver of a client."""
    parameters = pybullet.getPhysicsEngineParameters(client)
    x, y, z = (parameters[f"gravityAcceleration{axis}"] for axis in "XYZ")
    return Scene(
        name="world",
        path=Path(),
        gravity=(x, y, z),
        timestep=parameters["fixedTimeStep"],
        elastic=loaded.elastic,
        engine=Engine(**{name: int(parameters[key]) for name, key in _ENGINE.items()}),
    )


def _check_poses(handle: int, place: str, client: int) -> None:
    """Checks that the links of a body have poses: a joint about an axis of length 0 gives none."""
    joints = _joints_of(handle, client)
    links = pybullet.getLinkStates(handle, range(len(joints)), physicsClientId=client) or ()
    poses = [pybullet.getBasePositionAndOrientation(handle, client), *(s[4:6] for s in links)]
    names = ["its base", *(f"the joint {joint.name!r}" for joint in joints)]
    for name, pose in zip(names, poses, strict=True):
        if not all(math.isfinite(number) for part in pose for number in part):
            raise SceneError(f"{place} has no pose at {name}: is an axis or an origin no vector?")


def _names(
    scene: Scene, entries: Sequence[tuple[BodySpec, Sequence[int]]], client: int
) -> dict[int, str]:
    """Returns the unique names of the bodies of a scene by body number; those of files give way.

    The file's own name is used where that of a URDF model disagrees with it, see `name_by_file`.
    All bodies of an MJCF file have the name of its model. If there are several, each has its own
    name where the file gives it one. PyBullet puts a base without a name before a body with joints
    to the world.
    """
    taken = {str(spec.name) for spec, _ in entries} | {sensor.name for sensor in scene.sensors}
    names = {}
    for spec, handles in entries:
        if spec.name is not None and len(handles) == 1:
            names[handles[0]] = spec.name
            continue
        is_mjcf = len(handles) > 1 and spec.source == "mjcf"
        in_file = ModelFile.read(spec).names() if is_mjcf else ()
        for handle in handles:
            model = pybullet.getBodyInfo(handle, client)[1].decode(errors="replace")
            own = next((link for link in link_names(handle, client) if link in in_file), model)
            if spec.source == "urdf" and isinstance(spec.model, Path):
                own = name_by_file(own, spec.model)
            name = body_name(own) or f"body_{handle}"
            names[handle] = unique_name(f"{spec.name}_{name}" if spec.name else name, taken)
            taken.add(names[handle])
    return names


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


def load_body(spec: BodySpec, place: str, loaded: LoadedBodies, client: int) -> Sequence[int]:
    """Loads a scene entry and returns the numbers of its bodies; a file may hold several."""
    handles, doubts = _load_model(spec, place, client)
    if doubts and isinstance(spec.model, Path):
        loaded.doubts.setdefault(spec.model, doubts)
    joints = [_joints_of(handle, client) for handle in handles]
    check_joints(spec, [joint for of_body in joints for joint in of_body], place)
    for handle, own_joints in zip(handles, joints, strict=True):
        loaded.origins[handle] = spec
        motors: dict[int, float] = {}
        for joint in own_joints:
            if joint.type in SCALAR_JOINTS:
                # A joint that the scene does not set is at 0, or at its limit nearest to 0.
                value = spec.joints.get(joint.name, position_nearest_zero(joint))
                velocity = spec.joint_velocities.get(joint.name, 0.0)
                pybullet.resetJointState(handle, joint.link - 1, value, velocity, client)
                if spec.hold:
                    motors[joint.link] = spec.held.get(joint.name, value)
                    hold_joint(handle, joint, motors[joint.link], client)
        if motors:
            loaded.motor_positions[handle] = motors
        if loaded.elastic:
            make_elastic(handle, client)
    return handles


def _joints_of(handle: int, client: int) -> list[Joint]:
    count = pybullet.getNumJoints(handle, client)
    return [joint_of(pybullet.getJointInfo(handle, index, client)) for index in range(count)]


def hold_joint(handle: int, joint: Joint, value: float, client: int) -> None:
    """Makes a motor hold a position; velocity 0 for a joint without limits, as of a wheel."""
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
            names = link_names(handles[body], client)
            if link is not None and link not in names:
                told = f"{place}{key}_link: {body!r} has no link {link!r}"
                raise SceneError(told, suggestions=nearest(link, names))
            ends.append((handles[body], -1 if link is None else names.index(link) - 1))
        create_constraint(spec, ends[0], ends[1], client)


def create_constraint(
    spec: ConstraintSpec, on: tuple[int, int], to: tuple[int, int], client: int
) -> None:
    """Creates a constraint between two links, each a body number and PyBullet's link index."""
    turns = xyzw(np.array([spec.orientation, spec.to_orientation])).tolist()
    places = spec.axis, spec.position, spec.to_position
    kind = CONSTRAINTS[spec.type]
    number = pybullet.createConstraint(*on, *to, kind, *places, *turns, physicsClientId=client)
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
    return [
        number
        for number, spec, (body, _), end in constraints_of(client)
        if (spec.type, body, end) == ("fixed", on, (to, -1))
    ]


def constraints_of(client: int) -> Iterator[tuple[int, ConstraintSpec, Any, Any]]:
    """Yields the constraints of a client: their numbers, what they are, and their two ends.

    An end is a body and a link, by PyBullet's numbers; -1, -1 is the world.
    """
    names = {number: name for name, number in CONSTRAINTS.items()}
    for index in range(pybullet.getNumConstraints(client)):
        number = pybullet.getConstraintUniqueId(index, physicsClientId=client)
        info = pybullet.getConstraintInfo(number, client)
        if info[4] not in names:
            continue  # an anchor of a soft body
        orientation, to_orientation = map(tuple, wxyz(np.array(info[8:10])).tolist())
        spec = ConstraintSpec(
            type=names[info[4]],
            on="",
            axis=info[5],
            position=info[6],
            orientation=orientation,
            to_position=info[7],
            to_orientation=to_orientation,
            max_force=info[10],
            gear_ratio=info[11],
            gear_link=info[12],
            gear_target=info[13],
            erp=info[14],
        )
        yield number, spec, info[:2], info[2:4]
