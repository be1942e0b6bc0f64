"""Describes PyBullet bodies: their links, their joints, and their shapes in the link frames.

PyBullet returns the pose of a shape relative to the link's centre of mass. The pose of that in the
link frame is `com`. PyBullet does not return all shapes; see `BodyReader._read_shapes`.

The *margin* of a shape is the distance at which it already touches. Bullet grows hulls and the
triangles of concave meshes by it. Boxes and cylinders shrink by it first, spheres and capsules
consist of margin, half-spaces have none: for these, contact begins at the surface. PyBullet returns
one number for each link. If the link is a compound (it has several shapes, or one that is not in
the frame of its centre of mass), the number is the compound's own margin, which has no effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ssduck.errors import ArgumentError, SimulatorError
from ssduck.geometry.arrays import Array
from ssduck.geometry.mesh_files import load_hulls, load_mesh
from ssduck.geometry.poses import IDENTITY, compose, rotation_matrices
from ssduck.geometry.shapes import Geometry, GeometryType, PlacedGeometry
from ssduck.simulators.interface import Body, Joint, Kind, Link
from ssduck.simulators.pybullet.bullet_file import SavedShapes
from ssduck.simulators.pybullet.clients import pybullet

# PyBullet's default for hulls, compounds, and concave meshes that are made by a call, metres.
DEFAULT = 1e-3
_PADDED = ("hull", "mesh")
# The tolerance for a shape in the frame of its link's centre of mass.
_POSE_TOLERANCE = 1e-9


@dataclass(frozen=True)
class LinkMargin:
    """The margin of a link as PyBullet returns it."""

    margin: float | None  # metres; None if PyBullet returns none
    is_compound: bool = False  # whether it is the margin of a compound of the shapes
    # Whether a shape comes from a mesh file; such a hull is a compound of its own.
    is_of_file: bool = False


def margin_of(type: str, link_margin: LinkMargin) -> float:
    """Returns the margin of a shape, metres.

    `changeDynamics` does not reach the hulls of a mesh file in a compound. A margin of 0 of
    a compound may have been set or not; it counts as not set.
    """
    if type not in _PADDED:
        return 0.0
    default = 0.0 if type == "mesh" and link_margin.is_of_file else DEFAULT
    if link_margin.margin is None:
        return default
    if not link_margin.is_compound:
        return link_margin.margin
    if link_margin.margin in (0.0, DEFAULT) or (type == "hull" and link_margin.is_of_file):
        return default
    return link_margin.margin


def margins_now(client: int, body: Body, known: Sequence[LinkMargin]) -> list[float]:
    """Returns the present margins of a body's shapes, whose links had some when described."""
    handle, get = body.handle, pybullet.getDynamicsInfo
    links = {shape.frame for shape in body.shapes if shape.geometry.type in _PADDED}
    now = {
        link: replace(known[link], margin=float(get(handle, link - 1, client)[11]))
        for link in links
        if known and known[link].margin is not None
    }
    return [
        margin_of(shape.geometry.type, now[shape.frame]) if shape.frame in now else shape.margin
        for shape in body.shapes
    ]


Pose: TypeAlias = tuple[Array, Array]
# The shapes of a link; None if PyBullet does not return them.
Shapes: TypeAlias = list[PlacedGeometry] | None
# The user's own shapes in link frames, by link (the base is 0) and number; None for all.
UserShapes: TypeAlias = Mapping[tuple[int, int | None], Sequence[Geometry]]

# The joint types by PyBullet's numbers; a point-to-point joint cannot come from a model file.
_JOINT_TYPES = {
    pybullet.JOINT_REVOLUTE: "revolute",
    pybullet.JOINT_PRISMATIC: "prismatic",
    pybullet.JOINT_SPHERICAL: "spherical",
    pybullet.JOINT_PLANAR: "planar",
    pybullet.JOINT_FIXED: "fixed",
}
# The body types of getDynamicsInfo; model files make multi-bodies.
_MULTI_BODY = 2
_SOFT_BODY = 3
_ORIGIN = np.zeros(3)
# Numbers that differ by less are equal as single floats.
_FLOAT32_TOLERANCE = 1e-6
# PyBullet's box of a link without shapes is smaller: its diagonal is 2 mm times sqrt(3).
_MAX_EMPTY_BOX = 3.5e-3
# The greatest number of joints of a body whose links PyBullet tells of.
MAX_JOINTS = 127
# Directions in which, in general, a single corner of a mesh is the farthest.
_GENERIC_DIRECTIONS = np.array([[0.62, 0.53, 0.58], [-0.71, 0.44, -0.55], [0.37, -0.82, 0.43]])


@dataclass(frozen=True, eq=False)
class BodyDescription:
    """A body of a client, as described once."""

    body: Body  # its links, joints and shapes
    com: Pose  # poses of the links' centres of mass in the link frames, (links, 3) and (links, 4)
    # The margin of each link; empty for a body that was not read.
    link_margins: tuple[LinkMargin, ...] = ()


def joint_of(info: tuple[Any, ...]) -> Joint:
    """Returns a joint from the result of `getJointInfo`; PyBullet's empty range means no limits.

    Its axis is still in the frame of the link's centre of mass.
    """
    lower, upper = float(info[8]), float(info[9])
    limited = lower <= upper
    return Joint(
        name=info[1].decode(errors="replace"),
        type=_JOINT_TYPES.get(info[2], "fixed"),  # type: ignore[arg-type]
        link=int(info[0]) + 1,
        lower=lower if limited else None,
        upper=upper if limited else None,
        max_effort=float(info[10]) or None,
        max_velocity=float(info[11]) or None,
        axis=info[13],
    )


def wxyz(orientations: Array) -> Array:
    """Converts PyBullet's quaternions (n, 4) into those of ssduck."""
    return orientations[:, [3, 0, 1, 2]]


def xyzw(orientations: Array) -> Array:
    """Converts ssduck's quaternions (n, 4) into those of PyBullet."""
    return orientations[:, [1, 2, 3, 0]]


def is_soft(body: Body) -> bool:
    """Checks whether a described body is soft: it moves without joints, and has no known mass."""
    return body.movable and len(body.links) == 1 and body.masses == [0.0]


def com_poses_of(client: int, handle: int) -> Pose:
    """Returns the centres of mass as poses in the link frames, (links, 3) and (links, 4)."""
    links = range(-1, pybullet.getNumJoints(handle, client))
    return _com_poses([pybullet.getDynamicsInfo(handle, link, client) for link in links])


def masses_of(client: int, body: Body) -> list[float]:
    """Returns the present masses of a body's links; of a soft body, the described ones."""
    links = range(-1, len(body.links) - 1)
    dynamics = [pybullet.getDynamicsInfo(body.handle, link, client) for link in links]
    # PyBullet's mass of a soft body is no number of kilograms.
    is_soft = dynamics[0][10] == _SOFT_BODY
    return body.masses if is_soft else [float(dynamic[0]) for dynamic in dynamics]


def _com_poses(dynamics: Sequence[Any]) -> Pose:
    if dynamics[0][10] != _MULTI_BODY:
        # PyBullet returns uninitialized memory. The frame of the centre of mass is the only one
        # that these bodies have.
        return np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]])
    places, turns = (np.array([dynamic[n] for dynamic in dynamics], np.float64) for n in (3, 4))
    return places, wxyz(turns)


class BodyReader:
    """Reads one body of a client."""

    def __init__(
        self, client: int, handle: int, name: str, saved: SavedShapes, user_shapes: UserShapes
    ) -> None:
        self.client, self.handle, self.name = client, handle, name
        self._saved_file, self._user_shapes = saved, user_shapes
        self.link_name = pybullet.getBodyInfo(handle, client)[0].decode(errors="replace")
        count = pybullet.getNumJoints(handle, client)
        if count > MAX_JOINTS:
            raise SimulatorError(
                f"the body {self.name!r} has {count} joints, and PyBullet tells the poses of "
                f"bodies of at most {MAX_JOINTS}, fixed ones included"
            )
        self._joint_infos = [pybullet.getJointInfo(handle, index, client) for index in range(count)]
        self._dynamics = [pybullet.getDynamicsInfo(handle, i, client) for i in range(-1, count)]
        self.type = self._dynamics[0][10]
        self.com = _com_poses(self._dynamics)
        self._visuals: Sequence[tuple[Any, ...]] = pybullet.getVisualShapeData(
            handle, physicsClientId=client
        )
        self._capsule_links = {v[1] + 1 for v in self._visuals if v[2] == pybullet.GEOM_CAPSULE}

    def read(self, kind: Kind | None) -> BodyDescription:
        """Returns the body; its joints tell the kind if that is None."""
        joints = tuple(map(self._joint, self._joint_infos))
        jointed = any(joint.type != "fixed" for joint in joints)
        parents = [-1] + [info[16] + 1 for info in self._joint_infos]
        names = [self.link_name] + [info[12].decode(errors="replace") for info in self._joint_infos]
        masses = [float(dynamic[0]) for dynamic in self._dynamics]
        if self.type == _SOFT_BODY:
            masses = [0.0]  # PyBullet's mass is no number of kilograms
        link_margins = tuple(map(self._read_margin, range(len(names))))
        body = Body(
            handle=self.handle,
            name=self.name,
            kind=kind or ("robot" if jointed else "kinbody"),
            movable=jointed or masses[0] > 0.0 or self.type == _SOFT_BODY,
            links=tuple(map(Link, names, parents, masses)),
            joints=joints,
            shapes=tuple(
                replace(shape, margin=margin_of(shape.geometry.type, margin))
                for link, margin in enumerate(link_margins)
                for shape in self._shapes[link]
            ),
        )
        return BodyDescription(body, self.com, link_margins)

    def _joint(self, info: tuple[Any, ...]) -> Joint:
        """Returns a joint, its axis in the frame of its link."""
        joint = joint_of(info)
        axis = rotation_matrices(self.com[1][[joint.link]])[0] @ joint.axis
        # The length of the axis scales the motion of a prismatic joint, not of a revolute one.
        length = float(np.linalg.norm(axis)) if joint.type == "revolute" else 1.0
        x, y, z = (axis / (length or 1.0)).tolist()
        return replace(joint, axis=(x, y, z))

    # -- shapes ---------------------------------------------------------------------------

    def _read_margin(self, link: int) -> LinkMargin:
        """Returns the margin of a link as far as PyBullet knows it."""
        is_padded = any(shape.geometry.type in _PADDED for shape in self._shapes[link])
        # PyBullet crashes on some links with capsules; it has no shapes of soft bodies, nor of
        # bodies in maximal coordinates.
        if not is_padded or link in self._capsule_links or self.type != _MULTI_BODY:
            return LinkMargin(None)
        entries = pybullet.getCollisionShapeData(self.handle, link - 1, self.client)
        shifts = [np.abs((*entry[5], *entry[6][:3])).max() for entry in entries]
        is_compound = len(entries) > 1 or max(shifts, default=0.0) > _POSE_TOLERANCE
        files = [entry[4] for entry in entries if entry[2] == pybullet.GEOM_MESH]
        is_of_file = not {b"", b"unknown_file"}.issuperset(files)
        return LinkMargin(float(self._dynamics[link][11]), is_compound, is_of_file)

    @cached_property
    def _shapes(self) -> list[list[PlacedGeometry]]:
        """The collision shapes of each link."""
        return list(map(self._read_shapes, range(len(self._dynamics))))

    def _read_shapes(self, link: int) -> list[PlacedGeometry]:
        """Returns the collision shapes of a link in its link frame (link 0 is the base).

        The user's own shapes take precedence over those that PyBullet returns, and these over those
        that it saves. If a shape is still unknown, the box of the link stands in for all shapes.
        """
        given = {
            number: [PlacedGeometry(link, one, np.zeros(3), IDENTITY) for one in geometries]
            for (owner, number), geometries in self._user_shapes.items()
            if owner == link
        }
        if None in given:
            return given[None]
        entries = self._entries(link)
        shapes: dict[int | None, Shapes] = dict(enumerate(entries or ()))
        for number in given.keys() - shapes:
            has = f"{len(shapes)} shapes, from 0" if shapes else "none that can be told apart"
            raise ArgumentError(
                f"shapes: body {self.handle}, link {link - 1} has no shape {number}: it has "
                f"{has}; ({self.handle}, {link - 1}) stands for all shapes of the link"
            )
        found = (shapes | given).values()
        if entries is None or None in found:
            return [self._stand_in(link)]
        return [shape for own in found for shape in own or ()]

    def _entries(self, link: int) -> list[Shapes] | None:
        """Returns the known shapes of a link one by one; None if none is known.

        PyBullet returns no triangles, and no shapes of rigid and soft bodies. It crashes on a
        capsule between two points of an MJCF file. The shapes of links that are drawn with a
        capsule, and those that PyBullet does not return, are read from a file that it saves.
        Visual shapes have more digits; they are used if they equal the saved shapes.
        """
        entries: list[Shapes] | None = None
        if self.type == _MULTI_BODY and link not in self._capsule_links:
            data = pybullet.getCollisionShapeData(self.handle, link - 1, self.client)
            entries = [self._entry_shapes(link, index, entry) for index, entry in enumerate(data)]
            if None not in entries and (entries or self._is_bare(link)):
                return entries
        saved = self._saved_shapes(link)
        if saved is not None:
            visuals = self._visual_shapes(link)
            return [[shape] for shape in (visuals if _are_equal(visuals, saved) else saved)]
        if entries is None:
            return [] if self._is_bare(link) else None
        return entries or None

    def _saved_shapes(self, link: int) -> Shapes:
        """Returns the shapes of a link as PyBullet saves them; None if it does not."""
        saved = None if self.type == _SOFT_BODY else self._saved_file.shapes_of(self.handle, link)
        return None if saved is None else [self._placed(link, *shape) for shape in saved]

    def _placed(
        self, link: int, geometry: Geometry, position: Array = _ORIGIN, turn: Array = IDENTITY
    ) -> PlacedGeometry:
        """Places a geometry that is at a pose in the frame of the centre of mass of a link."""
        com = self.com[0][[link]], self.com[1][[link]]
        (place,), (orientation,) = compose(*com, position[None], turn[None])
        return PlacedGeometry(link, geometry, place, orientation)

    def _entry_shapes(self, link: int, index: int, entry: tuple[Any, ...]) -> Shapes:
        """Returns the shapes of an entry, in general one; None if PyBullet lacks them."""
        pose = np.array(entry[5]), wxyz(np.array([entry[6]]))[0]
        primitive = primitive_of(entry[2], entry[3])
        pieces: tuple[Geometry, ...] = ()
        if primitive is not None:
            pieces = (primitive,)
        elif entry[2] != pybullet.GEOM_MESH:
            return None
        elif (file := Path(entry[4].decode(errors="replace"))).is_file():
            pieces = self._read_mesh(link, file, tuple(map(float, entry[3])), pose)
        if pieces:
            return [self._placed(link, piece, *pose) for piece in pieces]
        vertices = self._hull_vertices(link, index)
        return [self._placed(link, Geometry.hull(vertices))] if len(vertices) else None

    def _read_mesh(
        self, link: int, file: Path, scale: tuple[float, ...], pose: Pose
    ) -> tuple[Geometry, ...]:
        """Returns a mesh as its file has it: hulls, or the surface of a concave one; else nothing.

        PyBullet makes one hull of each object in the file. It returns only the first hull, rounded
        to about a 10,000th of its size, and nothing of a concave mesh. So a mesh is concave if none
        of its corners is among those of the link.
        """
        try:
            mesh = load_mesh(file, scale)
            hulls = load_hulls(file, scale)
        except ValueError:
            return ()
        corners = mesh.vertices[np.argmax(mesh.vertices @ _GENERIC_DIRECTIONS.T, axis=0)]
        corners = corners @ rotation_matrices(pose[1][None])[0].T + pose[0]
        vertices = self._hull_vertices(link)
        if len(vertices):
            gaps = np.linalg.norm(corners[:, None] - vertices[None], axis=2).min(axis=1)
            if gaps.max() < 2e-3 * float(np.ptp(mesh.vertices, axis=0).max()):
                return hulls
        return (mesh,)

    def _hull_vertices(self, link: int, index: int = -1) -> Array:
        """Returns the corners of a link's hulls, or of one shape, from the centre of mass."""
        _, vertices = pybullet.getMeshData(
            self.handle, link - 1, collisionShapeIndex=index, physicsClientId=self.client
        )
        return np.array(vertices, dtype=np.float64).reshape(-1, 3)

    # -- shapes that PyBullet does not return ------------------------------------------------

    def _visual_shapes(self, link: int) -> list[PlacedGeometry]:
        """Returns the visual shapes of a link; none if one is a mesh."""
        shapes = []
        for entry in self._visuals:
            if entry[1] == link - 1:
                primitive = primitive_of(entry[2], entry[3])
                if primitive is None:
                    return []
                turn = wxyz(np.array([entry[6]]))[0]
                shapes.append(PlacedGeometry(link, primitive, np.array(entry[5]), turn))
        return shapes

    def _stand_in(self, link: int) -> PlacedGeometry:
        """Returns the present bounding box of a link, for shapes that PyBullet does not return."""
        low, high = self._aabb(link)
        position, orientation = self._com_in_world(link)
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        world = low + corners * (high - low)
        # Row vectors times R are rotated by the inverse of R.
        local = (world - position) @ rotation_matrices(orientation)[0]
        return replace(self._placed(link, Geometry.hull(local)), exact=False)

    def _is_bare(self, link: int) -> bool:
        """Checks whether a link has no shapes: its box is a margin around a point."""
        low, high = self._aabb(link)
        shift = (low + high) / 2 - self._com_in_world(link)[0][0]
        return bool((high - low).max() < _MAX_EMPTY_BOX and np.abs(shift).max() < 1e-6)

    def _aabb(self, link: int) -> tuple[Array, Array]:
        low, high = pybullet.getAABB(self.handle, link - 1, self.client)
        return np.array(low), np.array(high)

    def _com_in_world(self, link: int) -> Pose:
        if link == 0:
            pose = pybullet.getBasePositionAndOrientation(self.handle, self.client)
        else:
            pose = pybullet.getLinkState(self.handle, link - 1, 0, 1, self.client)
        return np.array([pose[0]]), wxyz(np.array([pose[1]]))


def _are_equal(some: Sequence[PlacedGeometry], others: Sequence[PlacedGeometry]) -> bool:
    """Checks whether primitives are equal, up to the rounding errors of single floats."""
    if len(some) != len(others):
        return False
    for one, other in zip(some, others, strict=True):
        sizes = np.array([one.geometry.size, other.geometry.size])
        turns = rotation_matrices(np.array([one.orientation, other.orientation]))
        # Of a round shape only the axis matters, in either direction; of a sphere nothing.
        axes = {"sphere": 0, "cylinder": 1, "capsule": 1}.get(one.geometry.type, 3)
        along = np.abs(np.einsum("ij,ij->j", *turns)[3 - axes :]).min(initial=1.0)
        angle = np.sqrt(max(2.0 - 2.0 * along, 0.0))
        deviation = max(
            np.abs(sizes[0] - sizes[1]).max(), np.abs(one.position - other.position).max()
        )
        if one.geometry.type != other.geometry.type or max(deviation, angle) > _FLOAT32_TOLERANCE:
            return False
    return True


def primitive_of(kind: int, size: Sequence[float]) -> Geometry | None:
    """Returns the geometry of a shape by PyBullet's numbers; None for what is no primitive."""
    a, b, _ = size
    forms: Mapping[int, tuple[GeometryType, Sequence[float]]] = {
        pybullet.GEOM_BOX: ("box", size),
        pybullet.GEOM_SPHERE: ("sphere", (a, 0.0, 0.0)),
        pybullet.GEOM_CYLINDER: ("cylinder", (b, a, 0.0)),  # PyBullet gives height, radius
        pybullet.GEOM_CAPSULE: ("capsule", (b, a, 0.0)),
        pybullet.GEOM_PLANE: ("plane", size),
    }
    return Geometry.primitive(*forms[kind]) if kind in forms else None
