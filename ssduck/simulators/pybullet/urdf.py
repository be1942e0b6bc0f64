"""Writes URDF models of bodies that have no model file, or no longer have one.

With `URDF_USE_INERTIA_FROM_FILE`, the loaded primitives behave exactly as those of
`createMultiBody`. Hulls get another margin, and come to rest up to 1e-5 m away.
"""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import compose, invert, rotation_matrices
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.geometry.solids import solid_of
from ssduck.simulators.interface import Body, LinkPoses
from ssduck.simulators.kinematics import moved_link_poses

Numbers = Sequence[float]

# Characters that no XML file can have: names of a world may have them.
_NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
# PyBullet's limit of effort or velocity of a joint without such a limit.
_UNLIMITED = 0.0


@dataclass(frozen=True, eq=False)
class Visual:
    """A visual shape of a link.

    Attributes:
        link: its index; the base is 0.
        geometry: the geometry; None for a mesh of a file.
        file: the file of a mesh.
        scale: the scale of a mesh, or 1s.
        position: in the link frame, metres.
        orientation: in the link frame, w, x, y, z.
        colour: red, green, blue, alpha, from 0 to 1.
    """

    link: int
    geometry: Geometry | None
    file: str
    scale: Numbers
    position: Array
    orientation: Array
    colour: Numbers


@dataclass(frozen=True, eq=False)
class BodyModel:
    """A body as a model file describes it.

    Attributes:
        body: its links, joints and shapes.
        zero_poses: for each joint, the pose of its link in the frame of the parent at position 0,
            (joints, 3) and (joints, 4).
        com: poses of the centres of mass in the link frames, (links, 3) and (links, 4).
        inertias: the moments about the axes of `com`, (links, 3), kg m²; None to compute them from
            the shapes.
        damping: the damping of the joints.
        contacts: contact parameters of the links, by PyBullet's elements.
        visuals: the visual shapes; None for the collision shapes.
    """

    body: Body
    zero_poses: tuple[Array, Array]
    com: tuple[Array, Array]
    inertias: Array | None
    damping: Numbers
    contacts: Sequence[Mapping[str, float]]
    visuals: Sequence[Visual] | None


def zero_poses(
    body: Body, link_poses: LinkPoses, positions: Mapping[int, float]
) -> tuple[Array, Array]:
    """Returns the poses of links in their parents' frames at joint positions of 0.

    Args:
        body: the body.
        link_poses: the present poses of its links.
        positions: the present positions of its joints, by link.
    """
    back = {link - 1: -position for link, position in positions.items()}
    zero = moved_link_poses(body, link_poses, None, back)
    parents = np.array([link.parent for link in body.links[1:]], dtype=np.intp)
    places, turns = zero.positions, zero.states[:, 3:7]
    inverse = invert(places[parents], turns[parents])
    return compose(*inverse, places[1:], turns[1:])


def write_model(model: BodyModel, folder: Path, stem: str) -> Path:
    """Writes a model and its meshes into a folder; the URDF file is `stem.urdf`."""
    robot = ET.Element("robot", name=unique_names([model.body.name])[0])
    meshes = _Meshes(folder, stem)
    names = unique_names(link.name for link in model.body.links)
    for index, name in enumerate(names):
        element = ET.SubElement(robot, "link", name=name)
        contact = ET.SubElement(element, "contact")
        for kind, value in model.contacts[index].items():
            ET.SubElement(contact, kind, value=_text_of(value))
        _add_inertial(element, model, index)
        shapes = [shape for shape in model.body.shapes if shape.frame == index]
        for shape in shapes:
            part = _add_geometry(element, "collision", shape, meshes)
            if shape.geometry.type == "mesh":
                part.set("concave", "yes")
        _add_visuals(element, index, shapes, model.visuals, meshes)
    for number in range(len(model.body.joints)):
        _add_joint(robot, model, number, names)
    path = folder / f"{stem}.urdf"
    ET.indent(robot)
    ET.ElementTree(robot).write(path, encoding="utf-8", xml_declaration=True)
    return path


def _add_inertial(element: ET.Element, model: BodyModel, index: int) -> None:
    inertial = ET.SubElement(element, "inertial")
    _add_origin(inertial, model.com[0][index], model.com[1][index])
    ET.SubElement(inertial, "mass", value=_text_of(model.body.links[index].mass))
    moments = np.zeros(3) if model.inertias is None else model.inertias[index]
    diagonal = dict(zip(("ixx", "iyy", "izz"), map(_text_of, moments), strict=True))
    ET.SubElement(inertial, "inertia", diagonal, ixy="0", ixz="0", iyz="0")


def _add_visuals(
    element: ET.Element,
    index: int,
    shapes: Sequence[PlacedGeometry],
    visuals: Sequence[Visual] | None,
    meshes: _Meshes,
) -> None:
    if visuals is None:
        for shape in shapes:
            _add_geometry(element, "visual", shape, meshes)
        return
    for number, visual in enumerate(visual for visual in visuals if visual.link == index):
        colour = f"{element.get('name')}_{number}"
        if visual.geometry is not None:
            placed = PlacedGeometry(index, visual.geometry, visual.position, visual.orientation)
            parts = [_add_geometry(element, "visual", placed, meshes)]
        elif Path(visual.file).is_file():
            part = ET.SubElement(element, "visual")
            _add_origin(part, visual.position, visual.orientation)
            scale = " ".join(map(_text_of, visual.scale))
            ET.SubElement(
                ET.SubElement(part, "geometry"),
                "mesh",
                filename=meshes.copy(Path(visual.file)),
                scale=scale,
            )
            parts = [part]
        else:  # the mesh is unknown; the collision shapes are the best substitute
            parts = [_add_geometry(element, "visual", shape, meshes) for shape in shapes]
        for part in parts:
            material = ET.SubElement(part, "material", name=colour)
            ET.SubElement(material, "color", rgba=" ".join(map(_text_of, visual.colour)))


def _add_geometry(
    element: ET.Element, kind: str, shape: PlacedGeometry, meshes: _Meshes
) -> ET.Element:
    part = ET.SubElement(element, kind)
    _add_origin(part, shape.position, shape.orientation)
    geometry = ET.SubElement(part, "geometry")
    a, b, c = map(_text_of, shape.geometry.size)
    match shape.geometry.type:
        case "box":
            ET.SubElement(geometry, "box", size=f"{a} {b} {c}")
        case "sphere":
            ET.SubElement(geometry, "sphere", radius=a)
        case "cylinder" | "capsule" as round:
            ET.SubElement(geometry, round, radius=a, length=b)
        case "plane":
            ET.SubElement(geometry, "plane", normal=f"{a} {b} {c}")
        case "hull" | "mesh":
            ET.SubElement(geometry, "mesh", filename=meshes.write(shape.geometry))
        case "ellipsoid":  # PyBullet has none
            stand_in = Geometry.hull(solid_of(shape.geometry).points)
            ET.SubElement(geometry, "mesh", filename=meshes.write(stand_in))
    return part


def unique_names(names: Iterable[str]) -> list[str]:
    r"""Makes names of a model distinct, not empty, and such that XML can have them.

    >>> unique_names(["leg", "leg", "", "a\0b"])
    ['leg', 'leg_2', '_', 'a_b']
    """
    unique: dict[str, None] = {}
    for name in names:
        stem = _NOT_IN_XML.sub("_", name) or "_"
        numbered = (f"{stem}_{number}" for number in count(2))
        unique[next(n for n in chain([stem], numbered) if n not in unique)] = None
    return list(unique)


def _add_joint(robot: ET.Element, model: BodyModel, number: int, names: Sequence[str]) -> None:
    joint = model.body.joints[number]
    limited = joint.lower is not None and joint.upper is not None
    kind = joint.type
    element = ET.SubElement(
        robot,
        "joint",
        name=unique_names(joint.name for joint in model.body.joints)[number],
        type="continuous" if kind == "revolute" and not limited else kind,
    )
    ET.SubElement(element, "parent", link=names[model.body.links[joint.link].parent])
    ET.SubElement(element, "child", link=names[joint.link])
    _add_origin(element, model.zero_poses[0][number], model.zero_poses[1][number])
    if kind in ("revolute", "prismatic"):
        ET.SubElement(element, "axis", xyz=" ".join(map(_text_of, joint.axis)))
    ET.SubElement(element, "dynamics", damping=_text_of(model.damping[number]))
    # PyBullet takes an empty range for no limit.
    low, high = (joint.lower, joint.upper) if limited else (0.0, -1.0)
    ET.SubElement(
        element,
        "limit",
        lower=_text_of(low or 0.0),
        upper=_text_of(high or 0.0),
        effort=_text_of(joint.max_effort or _UNLIMITED),
        velocity=_text_of(joint.max_velocity or _UNLIMITED),
    )


def _add_origin(element: ET.Element, position: Array, orientation: Array) -> None:
    ET.SubElement(
        element,
        "origin",
        xyz=" ".join(map(_text_of, position)),
        rpy=" ".join(map(_text_of, roll_pitch_yaw(orientation))),
    )


def roll_pitch_yaw(orientation: Array) -> tuple[float, float, float]:
    """Returns roll, pitch and yaw of a quaternion w, x, y, z: R = Rz(yaw) Ry(pitch) Rx(roll).

    The angles are radians. They are arctangents: the arcsine of PyBullet's function loses half of
    the digits near a pitch of 90°.
    """
    matrix = rotation_matrices(np.asarray(orientation, dtype=np.float64)[None])[0]
    level = math.hypot(matrix[0, 0], matrix[1, 0])
    pitch = math.atan2(-matrix[2, 0], level)
    if level < 1e-9:  # straight up or down: only the difference of roll and yaw matters
        return math.atan2(-matrix[1, 2], matrix[1, 1]), pitch, 0.0
    return (
        math.atan2(matrix[2, 1], matrix[2, 2]),
        pitch,
        math.atan2(matrix[1, 0], matrix[0, 0]),
    )


class _Meshes:
    """The mesh files of a model, each written once."""

    def __init__(self, folder: Path, stem: str) -> None:
        self._folder = folder
        self._stem = stem
        self._names: dict[str, str] = {}

    def write(self, geometry: Geometry) -> str:
        """Writes a hull or a mesh; returns the name of the file."""
        if geometry.key not in self._names:
            name = self._next(".obj")
            (self._folder / name).write_text(obj_text(geometry), encoding="utf-8")
            self._names[geometry.key] = name
        return self._names[geometry.key]

    def copy(self, file: Path) -> str:
        """Copies a mesh file; returns the name of the copy."""
        key = str(file.resolve())
        if key not in self._names:
            name = self._next(file.suffix)
            shutil.copyfile(file, self._folder / name)
            self._names[key] = name
        return self._names[key]

    def _next(self, suffix: str) -> str:
        return f"{self._stem}_{len(self._names) + 1}{suffix}"


def obj_text(geometry: Geometry) -> str:
    """Returns a hull or a mesh as an OBJ file."""
    corners = geometry.vertices
    faces: Iterable[Iterable[int]] = geometry.faces
    if not len(geometry.faces):
        # PyBullet makes a hull of the corners of all faces, whatever the faces are.
        faces = [(0, i, i + 1) for i in range(1, len(corners) - 1)]
    lines = ["v " + " ".join(map(_text_of, corner)) for corner in corners]
    lines += ["f " + " ".join(str(int(corner) + 1) for corner in face) for face in faces]
    return "\n".join(lines) + "\n"


def _text_of(number: float) -> str:
    return repr(float(number))
