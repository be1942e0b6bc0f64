"""Readers of model files that share no code with ssduck: what `tools.models` compares with.

yourdfpy parses URDF files, MuJoCo reads MJCF files, ElementTree SDF files, and trimesh meshes. Each
reader gives the frames, masses and boxes of links at positions of the joints.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
# A link of a file: the number of its model in the file and its name.
Key = tuple[int, str]


class UnreadableError(Exception):
    """The reader cannot read the file, or does not know a part of it."""


@dataclass
class Links:
    """What a file says of its links at some positions of the joints.

    Attributes:
        frames: the 4 x 4 matrix of each link's frame in the world frame.
        boxes: the corners of the box of its collision shapes, 2 x 3; NaN where that is not known.
    """

    frames: dict[Key, Array] = field(default_factory=dict)
    boxes: dict[Key, Array] = field(default_factory=dict)


class UrdfReader:
    """Reads a URDF file.

    Args:
        file: its path.

    Attributes:
        masses: the mass of each link, kg.
        joints: the limits of each joint that has one position, by its name, rad or m.
    """

    def __init__(self, file: Path) -> None:
        import yourdfpy

        robot = yourdfpy.URDF.load(str(file), build_scene_graph=False, load_meshes=False).robot
        self._file, self._robot = file, robot
        self._children: dict[str, list[Any]] = {link.name: [] for link in robot.links}
        for joint in robot.joints:
            self._children[joint.parent].append(joint)
        children = {joint.child for joint in robot.joints}
        (self._root,) = (link.name for link in robot.links if link.name not in children)
        self.masses: dict[Key, float | None] = {
            (0, link.name): None if link.inertial is None else link.inertial.mass
            for link in robot.links
        }
        self.joints = {
            joint.name: _limits(joint) for joint in robot.joints if joint.type in _MOVING
        }
        self._points = {link.name: list(self._shapes(link)) for link in robot.links}

    def at(self, positions: Mapping[str, float]) -> Links:
        """Returns the links at positions of the joints; those that are not given are at 0."""
        links, todo = Links(), [(self._root, np.eye(4))]
        while todo:
            name, frame = todo.pop()
            links.frames[0, name] = frame
            links.boxes[0, name] = box_of(shape.moved(frame) for shape in self._points[name])
            for joint in self._children[name]:
                origin = np.eye(4) if joint.origin is None else joint.origin
                motion = _motion(joint.type, joint.axis, positions.get(joint.name, 0.0))
                todo.append((joint.child, frame @ origin @ motion))
        return links

    def _shapes(self, link: Any) -> Iterator[Shape]:
        for collision in link.collisions:
            origin = np.eye(4) if collision.origin is None else collision.origin
            geometry = collision.geometry
            if geometry.box is not None:
                yield Shape(corners(np.array(geometry.box.size) / 2), 0.0, origin)
            elif geometry.sphere is not None:
                yield Shape(np.zeros((1, 3)), geometry.sphere.radius, origin)
            elif geometry.cylinder is not None:
                half = geometry.cylinder.length / 2
                yield Shape(_axis(half), 0.0, origin, geometry.cylinder.radius)
            elif geometry.mesh is not None:
                points = mesh_points(self._file, geometry.mesh.filename, geometry.mesh.scale)
                yield Shape(points, 0.0, origin)
            else:
                yield UNKNOWN


class SdfReader:
    """Reads an SDF file; its joints stay where the file has them. See `UrdfReader`."""

    joints: Mapping[str, tuple[float, float]] = {}

    def __init__(self, file: Path) -> None:
        root = ET.parse(file).getroot()
        models = [*root.iterfind("model"), *root.iterfind("world/model")]
        for part in ("include", "world/include", ".//frame", ".//model/model"):
            if root.find(part) is not None:
                raise UnreadableError(f"it has <{part.rpartition('/')[2]}>")
        self._file, self._links = file, Links()
        self.masses: dict[Key, float | None] = {}
        for number, model in enumerate(models):
            frame = _pose(model)
            for link in model.iterfind("link"):
                key = number, link.get("name", "")
                self._links.frames[key] = frame @ _pose(link)
                shapes = (self._shape(part) for part in link.iterfind("collision"))
                self._links.boxes[key] = box_of(
                    shape.moved(self._links.frames[key]) for shape in shapes
                )
                mass = link.findtext("inertial/mass")
                static = (model.findtext("static") or "").strip() in ("1", "true")
                self.masses[key] = 0.0 if static else None if mass is None else float(mass)

    def at(self, positions: Mapping[str, float]) -> Links:  # noqa: ARG002
        """Returns the links."""
        return self._links

    def _shape(self, collision: ET.Element) -> Shape:
        frame = _pose(collision)

        def numbers(path: str) -> Array:
            return np.array((collision.findtext(f"geometry/{path}") or "1").split(), float)

        if collision.find("geometry/box") is not None:
            return Shape(corners(numbers("box/size") / 2), 0.0, frame)
        if collision.find("geometry/sphere") is not None:
            return Shape(np.zeros((1, 3)), float(numbers("sphere/radius")[0]), frame)
        if collision.find("geometry/cylinder") is not None:
            half = float(numbers("cylinder/length")[0]) / 2
            return Shape(_axis(half), 0.0, frame, float(numbers("cylinder/radius")[0]))
        if (uri := collision.findtext("geometry/mesh/uri")) is not None:
            return Shape(mesh_points(self._file, uri.strip(), numbers("mesh/scale")), 0.0, frame)
        return UNKNOWN


class MjcfReader:
    """Reads an MJCF file by MuJoCo. See `UrdfReader`."""

    def __init__(self, file: Path) -> None:
        import mujoco

        self._mujoco, self._model = mujoco, mujoco.MjModel.from_xml_path(str(file))
        model = self._model
        self._names = [model.body(number).name for number in range(model.nbody)]
        self.masses: dict[Key, float | None] = {
            (0, name): mass for name, mass in zip(self._names, model.body_mass, strict=True) if name
        }
        self.joints = {
            model.joint(number).name: tuple(model.jnt_range[number])
            if model.jnt_limited[number]
            else (-1.0, 1.0)
            for number in range(model.njnt)
            if int(model.jnt_type[number])
            in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
            and model.joint(number).name
        }

    def at(self, positions: Mapping[str, float]) -> Links:
        """Returns the links at positions of the joints; those not given are where they begin."""
        model, links = self._model, Links()
        data = self._mujoco.MjData(model)
        for name, position in positions.items():
            data.joint(name).qpos[0] = position
        self._mujoco.mj_kinematics(model, data)
        shapes: list[list[Shape]] = [[] for _ in self._names]
        for geom in range(model.ngeom):
            if model.geom_contype[geom] or model.geom_conaffinity[geom]:
                frame = _frame(data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3))
                shapes[model.geom_bodyid[geom]].append(self._shape(geom).moved(frame))
        for number, name in enumerate(self._names):
            if name:
                turn = data.xmat[number].reshape(3, 3)
                links.frames[0, name] = _frame(data.xpos[number], turn)
                links.boxes[0, name] = box_of(shapes[number])
        return links

    def _shape(self, geom: int) -> Shape:
        model, type = self._model, self._mujoco.mjtGeom(self._model.geom_type[geom])
        size, nowhere = model.geom_size[geom], np.eye(4)
        match type.name.removeprefix("mjGEOM_"):
            case "BOX":
                return Shape(corners(size), 0.0, nowhere)
            case "SPHERE":
                return Shape(np.zeros((1, 3)), size[0], nowhere)
            case "CAPSULE":
                return Shape(_axis(size[1]), size[0], nowhere)
            case "CYLINDER":
                return Shape(_axis(size[1]), 0.0, nowhere, size[0])
            case "MESH":
                mesh = model.mesh(model.geom_dataid[geom])
                first, count = mesh.vertadr[0], mesh.vertnum[0]
                return Shape(model.mesh_vert[first : first + count].astype(float), 0.0, nowhere)
        return UNKNOWN


@dataclass(frozen=True)
class Shape:
    """A shape: points, and what is around each of them.

    Attributes:
        points: n x 3, m.
        radius: the radius of the ball around each point, m.
        frame: the 4 x 4 matrix of the shape's frame.
        disc: the radius of the disc around each point, across the z axis of the frame, m.
    """

    points: Array
    radius: float
    frame: Array
    disc: float = 0.0

    def moved(self, frame: Array) -> Shape:
        """Returns the shape in another frame."""
        return Shape(self.points, self.radius, frame @ self.frame, self.disc)

    def box(self) -> Array:
        """Returns the corners of its box, 2 x 3."""
        turn, position = self.frame[:3, :3], self.frame[:3, 3]
        points = self.points @ turn.T + position
        reach = self.radius + self.disc * np.sqrt(np.maximum(0.0, 1.0 - turn[:, 2] ** 2))
        return np.array([points.min(axis=0) - reach, points.max(axis=0) + reach])


UNKNOWN = Shape(np.full((1, 3), math.nan), 0.0, np.eye(4))
_MOVING = ("revolute", "continuous", "prismatic")


def box_of(shapes: Iterable[Shape]) -> Array:
    """Returns the corners of the box of shapes, 2 x 3; empty without shapes."""
    boxes = np.array([shape.box() for shape in shapes])
    return np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)]) if len(boxes) else boxes


def corners(half: Array) -> Array:
    """Returns the corners of a box of half-sizes, 8 x 3."""
    return np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T * half


def mesh_points(file: Path, name: str, scale: Sequence[float] | Array | float | None) -> Array:
    """Returns the vertices of a mesh that a file names, n x 3, m."""
    import trimesh

    path = name.partition("://")[2].lstrip("/") if "://" in name else name
    for folder in file.resolve().parents:
        for rest in (path, path.partition("/")[2]) if "://" in name else (path,):
            if rest and (folder / rest).is_file():
                mesh: Any = trimesh.load(folder / rest, force="mesh")
                return np.asarray(mesh.vertices) * (1.0 if scale is None else scale)
    raise UnreadableError(f"there is no mesh {name}")


def _axis(half: float) -> Array:
    return np.array([[0, 0, -half], [0, 0, half]])


def _frame(position: Array, turn: Array) -> Array:
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = turn, position
    return frame


def _limits(joint: Any) -> tuple[float, float]:
    limit = joint.limit
    if joint.type == "continuous" or limit is None or limit.lower is None or limit.upper is None:
        return -1.0, 1.0
    return (limit.lower, limit.upper) if limit.lower <= limit.upper else (-1.0, 1.0)


def _motion(type: str, axis: Array | None, position: float) -> Array:
    axis = np.array([1.0, 0, 0]) if axis is None else np.asarray(axis, float)
    if type not in _MOVING or not np.any(axis):
        return np.eye(4)
    axis = axis / np.linalg.norm(axis)
    if type == "prismatic":
        return _frame(axis * position, np.eye(3))
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.eye(3) + math.sin(position) * cross + (1 - math.cos(position)) * cross @ cross
    return _frame(np.zeros(3), turn)


def _pose(element: ET.Element) -> Array:
    """Returns the 4 x 4 matrix of an element's pose, roll, pitch and yaw about fixed axes."""
    pose = element.find("pose")
    if pose is None or not (pose.text or "").strip():
        return np.eye(4)
    if pose.get("relative_to") or pose.get("rotation_format", "euler_rpy") != "euler_rpy":
        raise UnreadableError("it has a pose with relative_to or rotation_format")
    x, y, z, *angles = map(float, (pose.text or "").split())
    scale = math.pi / 180 if pose.get("degrees") in ("1", "true") else 1.0
    turn = np.eye(3)
    for axis, angle in enumerate(angles):
        turn = _motion("revolute", np.eye(3)[axis], scale * angle)[:3, :3] @ turn
    return _frame(np.array([x, y, z]), turn)
