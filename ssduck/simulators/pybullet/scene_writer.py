"""Describes a PyBullet client that ssduck filled as a scene, and writes its models.

Bodies without a model file, or whose file is gone, get a URDF model. With
`URDF_USE_INERTIA_FROM_FILE`, the loaded primitives behave exactly as those of `createMultiBody`.
Hulls get another margin, and come to rest up to 1e-5 m away.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from ssduck.geometry.arrays import Array
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.geometry.solids import solid_of
from ssduck.simulators.backends import BodyToCopy, TickToCopy
from ssduck.simulators.interface import SCALAR_JOINTS, Body
from ssduck.simulators.model_xml import add_part, obj_text, roll_pitch_yaw, unique_names
from ssduck.simulators.naming import unique_name
from ssduck.simulators.pybullet.introspection import BodyModel, Visual, model_of
from ssduck.simulators.pybullet.scene_loader import constraints_of
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from ssduck.simulators.scene_bodies import BodySpec, Primitive
from ssduck.simulators.scenes import ConstraintSpec, Scene

# The folder of the models; each model has a folder of its own there.
MODELS = "models"
# References to other files in the lines of a mesh file or a material file.
_FILE_REFERENCE = re.compile(r"^\s*(?:mtllib|map_\w+)\s+(.+?)\s*$", re.MULTILINE)


def scene_of(
    simulator: PyBulletSimulator, originals: Sequence[BodyToCopy], tick: TickToCopy, folder: Path
) -> Scene:
    """Describes a simulation as a scene without sensors; writes its models into a folder."""
    models = _ModelWriter(simulator, folder)
    by_handle = {original.body.handle: original for original in originals}
    return replace(
        simulator.settings(),
        path=folder,
        time=tick.time,
        bodies=tuple(models.spec_of(original, tick) for original in originals),
        constraints=tuple(_constraints(simulator.client, by_handle)),
    )


def loadable_spec(simulator: PyBulletSimulator, body: Body) -> BodySpec | None:
    """Returns the scene entry of a body, if that is a primitive or a URDF file that is there."""
    spec = simulator.loaded.origins.get(body.handle)
    if spec is None or spec.source in ("sdf", "mjcf"):
        return None
    return spec if isinstance(spec.model, Primitive) or spec.model.is_file() else None


def placed(spec: BodySpec, original: BodyToCopy, tick: TickToCopy) -> BodySpec:
    """Returns a scene entry with the pose, the velocity and the flags of a body at a tick."""
    base = original.base_state.tolist()
    return replace(
        spec,
        position=tuple(base[:3]),
        orientation=tuple(base[3:7]),
        velocity=(0.0,) * 6 if spec.fixed else tuple(base[7:]),
        enabled=original.body not in tick.disabled,
        visible=original.body not in tick.hidden,
    )


def _constraints(client: int, originals: Mapping[int, BodyToCopy]) -> Iterator[ConstraintSpec]:
    for _, spec, (on, link), (to, to_link) in constraints_of(client):
        other = originals.get(to)
        yield replace(
            spec,
            on=originals[on].name,
            link=_link_name(originals[on].body, link),
            to=None if other is None else other.name,
            to_link=None if other is None else _link_name(other.body, to_link),
        )


def _link_name(body: Body, link: int) -> str | None:
    """Returns the name that a link has in a scene; None for the base."""
    return None if link < 0 else unique_names(part.name for part in body.links)[link + 1]


@dataclass(eq=False)
class _ModelWriter:
    """Writes the models of a saved scene."""

    simulator: PyBulletSimulator
    folder: Path
    copies: dict[Path, Path | None] = field(default_factory=dict)  # None for what cannot be copied

    def spec_of(self, original: BodyToCopy, tick: TickToCopy) -> BodySpec:
        body, states = original.body, original.joints
        spec = loadable_spec(self.simulator, body)
        copy = None if spec is None else spec.model
        if isinstance(copy, Path):
            if copy not in self.copies:
                self.copies[copy] = self._copy(copy)
            copy = self.copies[copy]
        if spec is None or copy is None:
            folder, stem = self._new_folder(original.name), _file_name(original.name)
            copy = write_model(model_of(self.simulator, body), folder, stem)
            spec = BodySpec(None, None, copy, own_inertia=True)
        names = unique_names(joint.name for joint in body.joints)
        settable = [n for n, joint in enumerate(body.joints) if joint.type in SCALAR_JOINTS]
        positions = {names[n]: float(states[n, 0]) for n in settable}
        motors = self.simulator.loaded.motor_positions.get(body.handle, {})
        targets = {names[link - 1]: target for link, target in motors.items()}
        return replace(
            placed(spec, original, tick),
            name=original.name,
            kind=body.kind,  # type: ignore[arg-type]  # no sensor has a body
            model=copy,
            joints=positions,
            joint_velocities={names[n]: float(states[n, 1]) for n in settable if states[n, 1]},
            hold=bool(motors) or not settable,
            held={name: target for name, target in targets.items() if target != positions[name]},
        )

    def _copy(self, file: Path) -> Path | None:
        """Returns a copy of a URDF file and its meshes; None if some are elsewhere."""
        references = _referenced_files(file)
        if references is None:
            return None
        folder = self._new_folder(file.stem)
        for name in (Path(file.name), *references):
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file.parent / name, target)
        return folder / file.name

    def _new_folder(self, name: str) -> Path:
        existing = {path.name for path in (self.folder / MODELS).glob("*")}
        folder = self.folder / MODELS / unique_name(_file_name(name), existing)
        folder.mkdir(parents=True)
        return folder


def _referenced_files(file: Path) -> list[Path] | None:
    """Returns the files that a URDF file refers to, in its folder; None if some are elsewhere."""
    try:
        root = ET.parse(file).getroot()  # noqa: S314  # PyBullet has read it
    except ET.ParseError:  # PyBullet may read it all the same
        return None
    queue = [Path(str(part.get("filename"))) for part in root.iter() if part.get("filename")]
    references: dict[Path, None] = {}
    while queue:
        name = queue.pop()
        if name in references:
            continue
        if name.is_absolute() or ".." in name.parts or not (file.parent / name).is_file():
            return None
        references[name] = None
        if name.suffix.lower() in (".obj", ".mtl"):
            text = (file.parent / name).read_text(encoding="utf-8", errors="replace")
            others = (name.parent / other for other in _FILE_REFERENCE.findall(text))
            # PyBullet draws a mesh without its material if the material is missing.
            queue += [other for other in others if (file.parent / other).is_file()]
    return list(references)


def _file_name(name: str) -> str:
    """Returns a name with only letters, digits, - and _."""
    return re.sub(r"[^\w-]+", "_", name) or "body"


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
        inertial = add_part(element, "inertial")
        _add_origin(inertial, model.com[0][index], model.com[1][index])
        add_part(inertial, "mass", value=model.body.links[index].mass)
        ixx, iyy, izz = model.inertias[index]
        add_part(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")
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


def _add_visual(
    element: ET.Element, visual: Visual, shapes: Sequence[PlacedGeometry], meshes: _Meshes
) -> list[ET.Element]:
    """Adds a visual shape; if its mesh is unknown, the collision shapes of the link."""
    if visual.geometry is not None:
        return [_add_shape(element, "visual", visual, meshes)]
    if not Path(visual.file).is_file():
        return [_add_shape(element, "visual", shape, meshes) for shape in shapes]
    part = add_part(element, "visual")
    _add_origin(part, visual.position, visual.orientation)
    name = meshes.copy(Path(visual.file))
    add_part(add_part(part, "geometry"), "mesh", filename=name, scale=visual.scale)
    return [part]


def _add_shape(
    element: ET.Element, kind: str, shape: PlacedGeometry | Visual, meshes: _Meshes
) -> ET.Element:
    part, geometry = add_part(element, kind), shape.geometry
    _add_origin(part, shape.position, shape.orientation)
    assert geometry is not None
    a, b, _ = geometry.size
    attributes: dict[str, Any] = {}
    tag: str = geometry.type
    match geometry.type:
        case "box":
            attributes = {"size": geometry.size}
        case "sphere":
            attributes = {"radius": a}
        case "cylinder" | "capsule":
            attributes = {"radius": a, "length": b}
        case "plane":
            attributes = {"normal": geometry.size}
        case _:
            is_ellipsoid = geometry.type == "ellipsoid"  # PyBullet has none
            mesh = Geometry.hull(solid_of(geometry).points) if is_ellipsoid else geometry
            tag, attributes = "mesh", {"filename": meshes.write(mesh)}
    add_part(add_part(part, "geometry"), tag, **attributes)
    return part


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
    # PyBullet takes an empty range for no limit, and an effort or a velocity of 0.
    low, high = (joint.lower, joint.upper) if limited else (0.0, -1.0)
    effort, velocity = joint.max_effort or 0.0, joint.max_velocity or 0.0
    add_part(element, "limit", lower=low, upper=high, effort=effort, velocity=velocity)


def _add_origin(element: ET.Element, position: Array, orientation: Array) -> None:
    add_part(element, "origin", xyz=position, rpy=roll_pitch_yaw(orientation))


@dataclass(frozen=True)
class _Meshes:
    """The mesh files of a model, each written once."""

    folder: Path
    stem: str  # of their names
    names: dict[str, str] = field(default_factory=dict)  # by what they are of

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
        if key not in self.names:
            name = f"{self.stem}_{len(self.names) + 1}{suffix}"
            make(self.folder / name)
            self.names[key] = name
        return self.names[key]
