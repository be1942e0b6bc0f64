"""Describes bodies of PyBullet or of a recording, for writers of model files."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ssduck.errors import UnsupportedError
from ssduck.geometry.arrays import Array
from ssduck.geometry.bounds import BoundingBoxes
from ssduck.geometry.mesh_files import load_mesh
from ssduck.geometry.poses import IDENTITY, compose, invert, multiply
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.simulators.backends import stored_visuals
from ssduck.simulators.interface import SCALAR_JOINTS, Body, LinkPoses
from ssduck.simulators.kinematics import moved_link_poses, position_nearest_zero
from ssduck.simulators.pybullet.bodies import Pose, primitive_of, wxyz
from ssduck.simulators.pybullet.clients import pybullet
from ssduck.simulators.pybullet.simulator import PyBulletSimulator

_SOFT_BODY = 3
# The elements of a model's contact parameters that are not written if they have PyBullet's
# defaults, 0 and -1: their indices in the result of getDynamicsInfo.
_CONTACT_ELEMENTS = {
    "rolling_friction": 6,
    "spinning_friction": 7,
    "restitution": 5,
    "damping": 8,
    "stiffness": 9,
}


@dataclass(frozen=True, eq=False)
class Visual:
    """A visual shape of a link."""

    link: int  # its index; the base is 0
    geometry: Geometry | None  # the geometry; None for a mesh of a file
    file: str  # the file of a mesh
    scale: Sequence[float]  # the scale of a mesh, or 1s
    position: Array  # in the link frame, metres
    orientation: Array  # in the link frame, w, x, y, z
    colour: Sequence[float] | None  # red, green, blue, alpha, from 0 to 1; None if it is unknown


@dataclass(frozen=True, eq=False)
class BodyModel:
    """A body as a model file describes it."""

    body: Body  # its links, joints and shapes
    # For each joint, the pose of its link in the frame of the parent at position 0, (joints, 3) and
    # (joints, 4).
    zero_poses: Pose
    com: Pose  # poses of the centres of mass in the link frames, (links, 3) and (links, 4)
    inertias: Array  # the moments about the axes of `com`, (links, 3), kg m²; 0 if they are unknown
    damping: Sequence[float]  # the damping of the joints
    # Contact parameters of the links, by PyBullet's elements.
    contacts: Sequence[Mapping[str, float]]
    visuals: Sequence[Visual]  # the visual shapes


def model_of(simulator: PyBulletSimulator, body: Body) -> BodyModel:
    """Returns the model of a body."""
    client, handle = simulator.client, body.handle
    dynamics = [pybullet.getDynamicsInfo(handle, i, client) for i in range(-1, len(body.joints))]
    if dynamics[0][10] == _SOFT_BODY:
        raise UnsupportedError(f"{body.name!r} is soft: PyBullet does not tell what it is made of")
    description = simulator.description_of(body)
    assert description is not None
    infos = [pybullet.getJointInfo(handle, index, client) for index in range(len(body.joints))]
    link_poses = simulator.read_link_poses((body,))
    zero = zero_poses(body, link_poses, simulator.read_joints([body] if body.joints else []))
    for number, joint in enumerate(body.joints):
        if joint.type == "spherical":
            x, y, z, w = pybullet.getJointStateMultiDof(handle, number, client)[0]
            zero[1][number] = multiply(zero[1][number], np.array([w, -x, -y, -z]))
    return BodyModel(
        body,
        zero,
        description.com,
        np.array([dynamic[2] for dynamic in dynamics]),
        [info[6] for info in infos],
        [
            {name: dynamic[n] for name, n in _CONTACT_ELEMENTS.items() if dynamic[n] not in (0, -1)}
            | {"lateral_friction": dynamic[1]}
            for dynamic in dynamics
        ],
        list(_visuals(simulator, body)),
    )


def estimated_model(body: Body, link_poses: LinkPoses, joints: Array) -> BodyModel:
    """Returns the model of a recorded body; its centres of mass are those of its shapes."""
    com = np.array([_centre_of_shapes(body, link) for link in range(len(body.links))])
    return BodyModel(
        body,
        zero_poses(body, link_poses, joints),
        (com, np.tile(IDENTITY, (len(com), 1))),
        np.zeros((len(com), 3)),
        [0.0] * len(body.joints),
        [{}] * len(body.links),
        [
            Visual(v.frame, v.geometry, "", (1.0, 1.0, 1.0), v.position, v.orientation, v.colour)
            for v in stored_visuals(body)
        ],
    )


def zero_poses(body: Body, link_poses: LinkPoses, joints: Array) -> Pose:
    """Returns the poses of links in their parents' frames at joint positions of 0.

    A joint whose position is NaN is at 0, or at its limit nearest to 0.
    """
    back = {}
    for joint, (position, *_) in zip(body.joints, joints.tolist(), strict=True):
        if joint.type in SCALAR_JOINTS:
            known = position_nearest_zero(joint) if math.isnan(position) else position
            back[joint.link - 1] = -known
    return poses_in_parents(body, moved_link_poses(body, link_poses, None, back))


def poses_in_parents(body: Body, link_poses: LinkPoses) -> Pose:
    """Returns the poses of all links but the base in the frames of their parents."""
    parents = np.array([link.parent for link in body.links[1:]], dtype=np.intp)
    places, turns = link_poses.positions, link_poses.states[:, 3:7]
    return compose(*invert(places[parents], turns[parents]), places[1:], turns[1:])


def _centre_of_shapes(body: Body, link: int) -> Array:
    """Returns the centre of a link's shapes, in its frame, weighted by box volume."""
    shapes = [replace(shape, frame=0) for shape in body.shapes if shape.frame == link]
    if not shapes or any(shape.geometry.type == "plane" for shape in shapes):
        return np.zeros(3)
    boxer = BoundingBoxes(shapes, range(len(shapes)), len(shapes))
    boxes = boxer.boxes(np.zeros((1, 3)), np.eye(3)[None])
    low, high = boxes[:3].T, boxes[3:].T
    volumes = np.prod(high - low, axis=1)
    centre: Array = np.average((low + high) / 2, axis=0, weights=volumes + 1e-12)
    return centre


def _visuals(simulator: PyBulletSimulator, body: Body) -> Iterator[Visual]:
    entries = pybullet.getVisualShapeData(body.handle, physicsClientId=simulator.client)
    colours = simulator.colours_when_shown(body)
    for entry, (link, _, colour) in zip(entries, colours, strict=True):
        geometry = primitive_of(entry[2], entry[3])
        yield Visual(
            link + 1,
            geometry,
            entry[4].decode(errors="replace"),
            entry[3],
            np.array(entry[5]),
            wxyz(np.array([entry[6]]))[0],
            colour,
        )


def visual_shapes(simulator: PyBulletSimulator, body: Body) -> list[PlacedGeometry]:
    """Returns the visual shapes of a body; a link with a plane or an unreadable mesh collides so.

    PyBullet's visual planes have no normal, and soft bodies have a mesh without a file.
    """
    shapes: list[PlacedGeometry] = []
    lacking = set()
    for v in _visuals(simulator, body):
        geometry = v.geometry
        if geometry is None:
            with suppress(ValueError):
                geometry = load_mesh(Path(v.file), tuple(map(float, v.scale)))
        if geometry is None or geometry.type == "plane":
            lacking.add(v.link)
        else:
            colour: Any = v.colour and tuple(v.colour)
            pose = v.position, v.orientation
            shapes.append(PlacedGeometry(v.link, geometry, *pose, colour=colour))
    if not (shapes or lacking):
        return list(body.shapes)
    stand_ins = [shape for shape in body.shapes if shape.frame in lacking]
    return [shape for shape in shapes if shape.frame not in lacking] + stand_ins
