"""Loads the models of scene entries into a PyBullet client: model files and primitives."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ssduck.errors import SceneError
from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import compose
from ssduck.simulators.naming import body_name, name_by_file
from ssduck.simulators.pybullet.bodies import wxyz, xyzw
from ssduck.simulators.pybullet.clients import captured, pybullet
from ssduck.simulators.pybullet.mesh_checks import check_meshes
from ssduck.simulators.pybullet.model_files import ModelFile
from ssduck.simulators.scene_bodies import BodySpec, Material, Primitive

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


class LoadedModel(NamedTuple):
    """The bodies of a scene entry.

    Attributes:
        handles: PyBullet's numbers of the bodies.
        messages: what PyBullet leaves out or takes for 0, in words.
    """

    handles: Sequence[int]
    messages: tuple[str, ...] = ()


def load_model(spec: BodySpec, place: str, client: int) -> LoadedModel:
    """Loads the model of a scene entry."""
    if isinstance(spec.model, Primitive):
        with captured():  # PyBullet warns about the picture of a plane, and draws it
            return LoadedModel((_create_primitive(spec, spec.model, client),))
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
        return LoadedModel(handles, (*doubts, *said))
    reason = "; ".join(m for m in messages if not _CHATTER.search(m)) or str(failure)
    raise SceneError(f"{where}{spec.model} cannot be loaded: {reason}") from failure


def _load_file(spec: BodySpec, client: int, doubts: list[str]) -> Sequence[int]:
    """Loads a model file; adds what PyBullet leaves out or takes for 0 to a list."""
    model_file = ModelFile.read(spec)
    doubts += model_file.check()
    check_meshes(model_file.file, model_file.root)
    with tempfile.TemporaryDirectory(prefix="ssduck") as folder:
        file = str(model_file.for_pybullet(Path(folder)))
        if spec.source == "urdf":
            return (_load_urdf(spec, file, client),)
        load = pybullet.loadSDF if spec.source == "sdf" else pybullet.loadMJCF
        handles: Sequence[int] = load(file, physicsClientId=client)
    if not handles:
        ignored = "".join(f"; PyBullet {part}" for part in model_file.ignored(spec.fixed))
        raise SceneError(f"no body is in it{ignored}")
    static = model_file.static_models()
    for number, handle in enumerate(handles):
        if spec.fixed or number in static:
            pybullet.changeDynamics(handle, -1, mass=0.0, physicsClientId=client)
        _move(handle, spec, client)
    return handles


def names_in_file(spec: BodySpec, handles: Sequence[int], client: int) -> list[str]:
    """Returns the names that a model file gives to its bodies; not yet unique.

    The file's own name is used where that of a URDF model disagrees with it, see `name_by_file`.
    All bodies of an MJCF file have the name of its model. If there are several, each has its own
    name where the file gives it one. PyBullet puts a base without a name before a body with joints
    to the world.
    """
    own_names = ModelFile.read(spec).names() if len(handles) > 1 and spec.source == "mjcf" else ()
    names = []
    for handle in handles:
        model = pybullet.getBodyInfo(handle, client)[1].decode(errors="replace")
        own = (link for link in link_names(handle, client) if link in own_names)
        name = next(own, model)
        if spec.source == "urdf" and isinstance(spec.model, Path):
            name = name_by_file(name, spec.model)
        names.append(body_name(name) or f"body_{handle}")
    return names


def link_names(handle: int, client: int) -> list[str]:
    """Returns PyBullet's names of the links of a body, the base first."""
    infos = [
        pybullet.getJointInfo(handle, index, client)[12]
        for index in range(pybullet.getNumJoints(handle, client))
    ]
    base = pybullet.getBodyInfo(handle, client)[0]
    return [name.decode(errors="replace") for name in (base, *infos)]


def _move(handle: int, spec: BodySpec, client: int) -> None:
    """Moves a body from the frame of its file to the pose of the scene entry."""
    if spec.position == BodySpec.position and spec.orientation == BodySpec.orientation:
        return
    pose = pybullet.getBasePositionAndOrientation(handle, client)
    origin = np.array([spec.position]), np.array([spec.orientation])
    com = compose(*origin, np.array([pose[0]]), wxyz(np.array([pose[1]])))
    pybullet.resetBasePositionAndOrientation(
        handle, com[0][0].tolist(), xyzw(com[1])[0].tolist(), client
    )


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
    _set_velocity(handle, spec, position[0] - link[0][0], client)
    return handle


def _set_velocity(handle: int, spec: BodySpec, com: Array, client: int) -> None:
    """Sets the velocity of a base whose centre of mass is at a place from its link frame."""
    if any(spec.velocity):
        linear, spin = np.array(spec.velocity[:3]), np.array(spec.velocity[3:])
        linear = linear + np.cross(spin, com)
        pybullet.resetBaseVelocity(handle, linear.tolist(), spin.tolist(), client)


def _create_primitive(spec: BodySpec, primitive: Primitive, client: int) -> int:
    """Creates a body of one primitive shape."""
    shape, size, colour = _SHAPES[primitive.type], primitive.size, primitive.material.colour
    collision_size, visual_size = _sizes(primitive.type, size)
    handle = int(
        pybullet.createMultiBody(
            0.0 if spec.fixed else primitive.mass,
            pybullet.createCollisionShape(shape, physicsClientId=client, **collision_size),
            pybullet.createVisualShape(
                shape, rgbaColor=colour, physicsClientId=client, **visual_size
            ),
            spec.position,
            xyzw(np.array([spec.orientation]))[0].tolist(),
            physicsClientId=client,
        )
    )
    _set_material(handle, primitive.material, client)
    _set_velocity(handle, spec, np.zeros(3), client)
    return handle


def _sizes(type: str, size: Sequence[float]) -> tuple[dict[str, object], dict[str, object]]:
    """Returns PyBullet's arguments for the size of a collision shape and of a visual shape."""
    match type:
        case "box":
            half = [length / 2 for length in size]
            return {"halfExtents": half}, {"halfExtents": half}
        case "sphere":
            return {"radius": size[0]}, {"radius": size[0]}
        case "plane":
            return {"planeNormal": size}, {"planeNormal": size}
    radius, length = size
    return {"radius": radius, "height": length}, {"radius": radius, "length": length}


def _set_material(handle: int, material: Material, client: int) -> None:
    pybullet.changeDynamics(
        handle,
        -1,
        lateralFriction=material.friction,
        rollingFriction=material.rolling_friction,
        spinningFriction=material.spinning_friction,
        restitution=material.restitution,
        physicsClientId=client,
    )
