"""Writes URDF models of bodies that have no model file, or no longer have one.

With `URDF_USE_INERTIA_FROM_FILE`, the loaded primitives behave exactly as those of
`createMultiBody`. Hulls get another margin, and come to rest up to 1e-5 m away.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from ssduck.geometry.arrays import Array
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.geometry.solids import solid_of
from ssduck.simulators.interface import SCALAR_JOINTS
from ssduck.simulators.model_xml import add_part, obj_text, roll_pitch_yaw, unique_names
from ssduck.simulators.pybullet.introspection import BodyModel, Visual

# PyBullet's limit of effort or velocity of a joint without such a limit.
_UNLIMITED = 0.0


def write_model(model: BodyModel, folder: Path, stem: str) -> Path:
    """Writes a model and its meshes into a folder; the URDF file is `stem.urdf`."""
    robot = ET.Element("robot", name=unique_names([model.body.name])[0])
    meshes = _Meshes(folder, stem)
    names = unique_names(link.name for link in model.body.links)
    for index, name in enumerate(names):
        element = add_part(robot, "link", name=name)
        contact = add_part(element, "contact")
        for kind, value in model.contacts[index].items():
            add_part(contact, kind, value=value)
        _add_inertial(element, model, index)
        shapes = [shape for shape in model.body.shapes if shape.frame == index]
        for shape in shapes:
            part = _add_shape(element, "collision", shape, meshes)
            if shape.geometry.type == "mesh":
                part.set("concave", "yes")
        visuals = [visual for visual in model.visuals if visual.link == index]
        for number, visual in enumerate(visuals):
            for part in _add_visual(element, visual, shapes, meshes):
                if visual.colour is not None:
                    material = add_part(part, "material", name=f"{name}_{number}")
                    add_part(material, "color", rgba=visual.colour)
    joint_names = unique_names(joint.name for joint in model.body.joints)
    for number, name in enumerate(joint_names):
        _add_joint(robot, model, number, name, names)
    path = folder / f"{stem}.urdf"
    ET.indent(robot)
    ET.ElementTree(robot).write(path, encoding="utf-8", xml_declaration=True)
    return path


def _add_inertial(element: ET.Element, model: BodyModel, index: int) -> None:
    inertial = add_part(element, "inertial")
    _add_origin(inertial, model.com[0][index], model.com[1][index])
    add_part(inertial, "mass", value=model.body.links[index].mass)
    ixx, iyy, izz = model.inertias[index]
    add_part(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")


def _add_visual(
    element: ET.Element, visual: Visual, shapes: Sequence[PlacedGeometry], meshes: _Meshes
) -> list[ET.Element]:
    """Adds a visual shape; if its mesh is unknown, the collision shapes of the link."""
    if visual.geometry is None and Path(visual.file).is_file():
        part = add_part(element, "visual")
        _add_origin(part, visual.position, visual.orientation)
        name = meshes.copy(Path(visual.file))
        add_part(add_part(part, "geometry"), "mesh", filename=name, scale=visual.scale)
        return [part]
    if visual.geometry is not None:
        pose = visual.position, visual.orientation
        shapes = [PlacedGeometry(visual.link, visual.geometry, *pose)]
    return [_add_shape(element, "visual", shape, meshes) for shape in shapes]


def _add_shape(
    element: ET.Element, kind: str, shape: PlacedGeometry, meshes: _Meshes
) -> ET.Element:
    part = add_part(element, kind)
    _add_origin(part, shape.position, shape.orientation)
    tag, attributes = _geometry(shape.geometry, meshes)
    add_part(add_part(part, "geometry"), tag, **attributes)
    return part


def _geometry(geometry: Geometry, meshes: _Meshes) -> tuple[str, dict[str, Any]]:
    """Returns the element of a geometry, and its attributes."""
    match geometry.type:
        case "box":
            return "box", {"size": geometry.size}
        case "sphere":
            return "sphere", {"radius": geometry.size[0]}
        case "cylinder" | "capsule" as round:
            return round, {"radius": geometry.size[0], "length": geometry.size[1]}
        case "plane":
            return "plane", {"normal": geometry.size}
        case "ellipsoid":  # PyBullet has none
            geometry = Geometry.hull(solid_of(geometry).points)
    return "mesh", {"filename": meshes.write(geometry)}


def _add_joint(
    robot: ET.Element, model: BodyModel, number: int, name: str, links: Sequence[str]
) -> None:
    joint = model.body.joints[number]
    limited = joint.lower is not None and joint.upper is not None
    kind = "continuous" if joint.type == "revolute" and not limited else joint.type
    element = add_part(robot, "joint", name=name, type=kind)
    add_part(element, "parent", link=links[model.body.links[joint.link].parent])
    add_part(element, "child", link=links[joint.link])
    _add_origin(element, model.zero_poses[0][number], model.zero_poses[1][number])
    if joint.type in SCALAR_JOINTS:
        add_part(element, "axis", xyz=joint.axis)
    add_part(element, "dynamics", damping=model.damping[number])
    # PyBullet takes an empty range for no limit.
    low, high = (joint.lower, joint.upper) if limited else (0.0, -1.0)
    effort, velocity = joint.max_effort or _UNLIMITED, joint.max_velocity or _UNLIMITED
    add_part(element, "limit", lower=low, upper=high, effort=effort, velocity=velocity)


def _add_origin(element: ET.Element, position: Array, orientation: Array) -> None:
    add_part(element, "origin", xyz=position, rpy=roll_pitch_yaw(orientation))


class _Meshes:
    """The mesh files of a model, each written once."""

    def __init__(self, folder: Path, stem: str) -> None:
        self._folder, self._stem = folder, stem
        self._names: dict[str, str] = {}

    def write(self, geometry: Geometry) -> str:
        """Writes a hull or a mesh; returns the name of the file."""
        corners, faces = geometry.vertices, geometry.faces.tolist()
        if not faces:
            # PyBullet makes a hull of the corners of all faces, whatever the faces are.
            faces = [(0, i, i + 1) for i in range(1, len(corners) - 1)]
        text = obj_text(corners, faces)
        return self._file(geometry.key, ".obj", lambda path: path.write_text(text, "utf-8"))

    def copy(self, file: Path) -> str:
        """Copies a mesh file; returns the name of the copy."""
        key = str(file.resolve())
        return self._file(key, file.suffix, lambda path: shutil.copyfile(file, path))

    def _file(self, key: str, suffix: str, make: Callable[[Path], Any]) -> str:
        if key not in self._names:
            name = f"{self._stem}_{len(self._names) + 1}{suffix}"
            make(self._folder / name)
            self._names[key] = name
        return self._names[key]
