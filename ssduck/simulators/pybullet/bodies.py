"""Describes PyBullet bodies: their links, their joints, and their shapes in the link frames.

PyBullet returns the pose of a shape relative to the link's centre of mass. The pose of that in the
link frame is `com`. PyBullet does not return all shapes; see `_Reader.shapes`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ssduck.errors import ArgumentError
from ssduck.geometry.arrays import Array
from ssduck.geometry.mesh_files import load_hulls, load_mesh
from ssduck.geometry.poses import IDENTITY, compose, invert, rotation_matrices
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.simulators.interface import Body, Joint, Kind, Link
from ssduck.simulators.pybullet.bullet_file import SavedShapes
from ssduck.simulators.pybullet.collision_margins import (
    KnownMargins,
    known_margins,
    margin_of,
    with_margins,
)
from ssduck.simulators.pybullet.console import pybullet

Pose: TypeAlias = tuple[Array, Array]
# Shapes of a link; None for what PyBullet does not tell.
Shapes: TypeAlias = list[PlacedGeometry] | None
# Shapes that a caller knows, in link frames, by link (the base is 0) and number; None for all.
GivenShapes: TypeAlias = Mapping[tuple[int, int | None], Sequence[Geometry]]

# The joint types by PyBullet's numbers; a point-to-point joint cannot come from a model file.
_JOINT_TYPES = {
    pybullet.JOINT_REVOLUTE: "revolute",
    pybullet.JOINT_PRISMATIC: "prismatic",
    pybullet.JOINT_SPHERICAL: "spherical",
    pybullet.JOINT_PLANAR: "planar",
    pybullet.JOINT_FIXED: "fixed",
}
# What getDynamicsInfo says of a body of links, which is what model files make.
_MULTI_BODY = 2
_SOFT_BODY = 3
# So far apart are numbers that are the same in single floats.
_SINGLE = 1e-6
# PyBullet's box of a link without shapes is smaller; it has a diagonal of 2 mm times sqrt(3).
_BARE = 3.5e-3
# Directions in which no corner of a mesh shares its extreme with others.
_ASKEW = np.array([[0.62, 0.53, 0.58], [-0.71, 0.44, -0.55], [0.37, -0.82, 0.43]])


@dataclass(frozen=True, eq=False)
class BodyDescription:
    """A body as it was read.

    Attributes:
        body: its links, joints and shapes.
        com: poses of the links' centres of mass in the link frames, (links, 3) and (links, 4).
        exact: whether all its shapes are those that PyBullet uses; else boxes stand in for some.
        link_margins: the margin of each link; empty if PyBullet was not asked.
    """

    body: Body
    com: Pose
    exact: bool
    link_margins: tuple[KnownMargins, ...] = ()


def describe(
    client: int,
    handle: int,
    name: str | None,
    kind: Kind | None,
    saved: SavedShapes | None = None,
    given: GivenShapes | None = None,
) -> BodyDescription:
    """Reads a body.

    Args:
        client: the client that has it.
        handle: its number.
        name: replaces its own name.
        kind: replaces the kind that follows from its joints.
        saved: the shapes that PyBullet only saves, of this body and others.
        given: the shapes that the caller knows.

    Raises:
        ArgumentError: a shape is given that the body does not have.
    """
    saved = saved or SavedShapes(client, [handle])
    return _Reader(client, handle, saved, given or {}).described(name, kind)


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


def com_of(client: int, handle: int) -> Pose:
    """Returns the centres of mass as poses in the link frames, (links, 3) and (links, 4)."""
    links = range(-1, pybullet.getNumJoints(handle, client))
    return _com([pybullet.getDynamicsInfo(handle, link, client) for link in links])


def masses_of(client: int, body: Body) -> list[float]:
    """Returns the present masses of a body's links; of a soft body, the described ones."""
    links = range(-1, len(body.links) - 1)
    dynamics = [pybullet.getDynamicsInfo(body.handle, link, client) for link in links]
    # What PyBullet says of a soft body is no number of kilograms.
    return (
        body.masses
        if dynamics[0][10] == _SOFT_BODY
        else [float(link_margins[0]) for link_margins in dynamics]
    )


def _com(dynamics: Sequence[Any]) -> Pose:
    if dynamics[0][10] != _MULTI_BODY:
        # PyBullet answers with what happened to be in memory. The frame of the centre of
        # mass is the only one that it knows of these.
        return np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]])
    return (
        np.array([dynamic[3] for dynamic in dynamics], dtype=np.float64),
        wxyz(np.array([dynamic[4] for dynamic in dynamics], dtype=np.float64)),
    )


class _Reader:
    """One body of a client, while it is read."""

    def __init__(self, client: int, handle: int, saved: SavedShapes, given: GivenShapes) -> None:
        self.client = client
        self.handle = handle
        self.saved = saved
        self.given = given
        self.link_name, self.name = (
            text.decode(errors="replace") for text in pybullet.getBodyInfo(handle, client)
        )
        count = pybullet.getNumJoints(handle, client)
        self.infos = [pybullet.getJointInfo(handle, index, client) for index in range(count)]
        self.dynamics = [pybullet.getDynamicsInfo(handle, i, client) for i in range(-1, count)]
        self.type = self.dynamics[0][10]
        self.com = _com(self.dynamics)

    def described(self, name: str | None, kind: Kind | None) -> BodyDescription:
        joints = tuple(map(self._joint, self.infos))
        jointed = any(joint.type != "fixed" for joint in joints)
        parents = [-1] + [info[16] + 1 for info in self.infos]
        names = [self.link_name] + [info[12].decode(errors="replace") for info in self.infos]
        masses = [float(dynamic[0]) for dynamic in self.dynamics]
        if self.type == _SOFT_BODY:
            masses = [0.0]  # what PyBullet says is no number of kilograms
        link_margins = tuple(map(self._told, range(len(names))))
        body = Body(
            handle=self.handle,
            name=name or self.name or f"body_{self.handle}",
            kind=kind or ("robot" if jointed else "kinbody"),
            movable=jointed or masses[0] > 0.0 or self.type == _SOFT_BODY,
            links=tuple(map(Link, names, parents, masses)),
            joints=joints,
            shapes=tuple(
                shape
                for link, of in enumerate(link_margins)
                for shape in with_margins(self.own[link], of)
            ),
        )
        return BodyDescription(body, self.com, not body.has_stand_ins, link_margins)

    def _joint(self, info: tuple[Any, ...]) -> Joint:
        """Returns a joint, its axis in the frame of its link."""
        joint = joint_of(info)
        axis = rotation_matrices(self.com[1][[joint.link]])[0] @ joint.axis
        # PyBullet turns by as many radians however long the axis is, but does not shift so.
        length = float(np.linalg.norm(axis)) if joint.type == "revolute" else 1.0
        x, y, z = (axis / (length or 1.0)).tolist()
        return replace(joint, axis=(x, y, z))

    # -- shapes ---------------------------------------------------------------------------

    def _told(self, link: int) -> KnownMargins:
        """Returns what PyBullet tells of the margins of a link."""
        if all(
            margin_of(shape.geometry.type, KnownMargins(None)) == 0.0 for shape in self.own[link]
        ):
            return KnownMargins(None)
        entries = None
        # Of links that have capsules PyBullet may not be asked; of soft bodies, and of those in
        # maximal coordinates, it tells nothing.
        if link not in self._drawn_capsules and self.type == _MULTI_BODY:
            entries = pybullet.getCollisionShapeData(self.handle, link - 1, self.client)
        return known_margins(self.dynamics[link], entries)

    @cached_property
    def own(self) -> list[list[PlacedGeometry]]:
        """The collision shapes of each link."""
        return [list(self.shapes(link)) for link in range(len(self.dynamics))]

    def shapes(self, link: int) -> Iterator[PlacedGeometry]:
        """Yields the collision shapes of a link in its link frame (link 0 is the base).

        Shapes that the caller gave come first, then those that PyBullet returns, then those that it
        saves. If one shape is still unknown, the box of the link stands in for all of its shapes.

        Raises:
            ArgumentError: a shape is given that the link does not have.
        """
        if (link, None) in self.given:
            shapes: Shapes = self._placed(link, self.given[link, None])
        else:
            shapes = self._known(link)
        if shapes is None:
            yield self._stand_in(link)
        else:
            yield from shapes

    def _known(self, link: int) -> Shapes:
        """Returns the shapes of a link, given ones included; None if one is unknown."""
        entries = self._entries(link)
        numbers = {number for at, number in self.given if at == link and number is not None}
        if numbers:
            count = 0 if entries is None else len(entries)
            self._check_numbers(link, numbers, count)
            entries = [
                self._placed(link, self.given[link, number]) if number in numbers else entry
                for number, entry in enumerate(entries or ())
            ]
        if entries is None or None in entries:
            return None
        return [shape for entry in entries if entry is not None for shape in entry]

    def _check_numbers(self, link: int, numbers: set[int], count: int) -> None:
        for number in numbers:
            if not 0 <= number < count:
                has = f"{count} shapes, from 0" if count else "none that are told apart"
                raise ArgumentError(
                    f"shapes: body {self.handle}, link {link - 1} has no shape {number}: it has "
                    f"{has}; ({self.handle}, {link - 1}) stands for all shapes of the link"
                )

    def _placed(self, link: int, geometries: Iterable[Geometry]) -> list[PlacedGeometry]:
        """Geometries in the frame of a link."""
        return [PlacedGeometry(link, own, np.zeros(3), IDENTITY) for own in geometries]

    def _entries(self, link: int) -> list[Shapes] | None:
        """Returns the shapes of a link one by one, as far as they are known; None if nothing is.

        PyBullet gives back no triangles; of rigid and soft bodies no shapes at all; and asked
        for a capsule between two points of an MJCF file it crashes. A link that may have one is
        drawn as a capsule, too: of that and of what PyBullet does not tell, it is read what it
        saves. What is drawn has more digits, and is taken where both are the same.
        """
        entries: list[Shapes] | None = None
        if self.type == _MULTI_BODY and link not in self._drawn_capsules:
            link_margins = pybullet.getCollisionShapeData(self.handle, link - 1, self.client)
            entries = [self._shape(link, index, entry) for index, entry in enumerate(link_margins)]
            if None not in entries and (entries or self._is_bare(link)):
                return entries
        saved = self._saved(link)
        if saved is not None:
            drawn = self._drawn(link)
            return [[own] for own in (drawn if _are_alike(drawn, saved) else saved)]
        if entries is None:
            drawn = self._drawn(link)
            return [[own] for own in drawn] if self._agree(drawn, link) else None
        return entries or None

    def _saved(self, link: int) -> Shapes:
        """Returns the shapes of a link as PyBullet saves them; None if it does not."""
        saved = None if self.type == _SOFT_BODY else self.saved.of(self.handle, link)
        if saved is None:
            return None
        com = self._com_of(link)
        found = []
        for geometry, position, orientation in saved:
            place, turn = compose(*com, position[None], orientation[None])
            found.append(PlacedGeometry(link, geometry, place[0], turn[0]))
        return found

    def _shape(self, link: int, index: int, entry: tuple[Any, ...]) -> Shapes:
        """Returns the shapes of an entry, in general one; None if PyBullet lacks them."""
        com = self._com_of(link)
        local = np.array([entry[5]]), wxyz(np.array([entry[6]]))
        position, orientation = compose(*com, *local)
        primitive = primitive_of(entry[2], entry[3])
        if primitive is not None:
            return [PlacedGeometry(link, primitive, position[0], orientation[0])]
        if entry[2] != pybullet.GEOM_MESH:
            return None
        file = Path(entry[4].decode(errors="replace"))
        if file.is_file():
            pieces = self._from_file(link, file, tuple(map(float, entry[3])), local)
            if pieces is not None:
                return [
                    PlacedGeometry(link, piece, position[0], orientation[0]) for piece in pieces
                ]
        vertices = self._hull_vertices(link, index)
        if not len(vertices):
            return None
        return [PlacedGeometry(link, Geometry.hull(vertices), com[0][0], com[1][0])]

    def _from_file(
        self, link: int, file: Path, scale: tuple[float, ...], local: Pose
    ) -> Sequence[Geometry] | None:
        """Returns a mesh as its file has it: hulls, or the surface of a concave one.

        PyBullet makes one hull of each object in the file, and gives back the first only, and
        that rounded to about a 10,000th of its size. Of a concave mesh it gives nothing; so a
        mesh none of whose corners is among the link's is concave.
        """
        try:
            mesh = load_mesh(file, scale)
            hulls = load_hulls(file, scale)
        except ValueError:
            return None
        corners = mesh.vertices[np.argmax(mesh.vertices @ _ASKEW.T, axis=0)]
        corners = corners @ rotation_matrices(local[1])[0].T + local[0]
        known = self._hull_vertices(link)
        if len(known):
            gaps = np.linalg.norm(corners[:, None] - known[None], axis=2).min(axis=1)
            if gaps.max() < 2e-3 * float(np.ptp(mesh.vertices, axis=0).max()):
                return hulls
        return [mesh]

    def _hull_vertices(self, link: int, index: int = -1) -> Array:
        """Corners of a link's hulls in the frame of its centre of mass, all or of one shape.

        PyBullet applies the index again to the objects in that shape's file, so that it is good
        for meshes of one object, and for the first shape.
        """
        _, vertices = pybullet.getMeshData(
            self.handle, link - 1, collisionShapeIndex=index, physicsClientId=self.client
        )
        return np.array(vertices, dtype=np.float64).reshape(-1, 3)

    def _com_of(self, link: int) -> Pose:
        return self.com[0][[link]], self.com[1][[link]]

    # -- what PyBullet does not tell ---------------------------------------------------------

    @cached_property
    def _visuals(self) -> Sequence[tuple[Any, ...]]:
        data: Sequence[tuple[Any, ...]] = pybullet.getVisualShapeData(
            self.handle, physicsClientId=self.client
        )
        return data

    @cached_property
    def _drawn_capsules(self) -> set[int]:
        return {entry[1] + 1 for entry in self._visuals if entry[2] == pybullet.GEOM_CAPSULE}

    def _drawn(self, link: int) -> list[PlacedGeometry]:
        """Returns the visual shapes of a link; none if one is a mesh."""
        entries = [entry for entry in self._visuals if entry[1] == link - 1]
        found = [(entry, primitive_of(entry[2], entry[3])) for entry in entries]
        shapes = [
            PlacedGeometry(link, shape, np.array(entry[5]), wxyz(np.array([entry[6]]))[0])
            for entry, shape in found
            if shape is not None
        ]
        return shapes if len(shapes) == len(entries) else []

    def _agree(self, shapes: Sequence[PlacedGeometry], link: int) -> bool:
        """Checks whether PyBullet's box of a link is that of these shapes.

        Its box of several is that of their boxes in the frame of the centre of mass, widened
        there by at most 4 cm on each side and then turned.
        """
        if not shapes:
            return self._is_bare(link)
        if any(shape.geometry.type == "plane" for shape in shapes):
            return False  # drawn planes have no normal
        inverse = invert(*self._com_of(link))
        lows, highs = [], []
        for shape in shapes:
            centre, turn = compose(*inverse, shape.position[None], shape.orientation[None])
            half = np.abs(rotation_matrices(turn)[0]) @ _half_extents(shape.geometry)
            lows.append(centre[0] - half)
            highs.append(centre[0] + half)
        low, high = np.min(lows, axis=0), np.max(highs, axis=0)
        position, orientation = self._com_pose(link)
        matrix = rotation_matrices(orientation)[0]
        own_low, own_high = self._own_box(link)
        shift = (own_low + own_high) / 2 - (position[0] + matrix @ ((low + high) / 2))
        widened = (own_high - own_low) / 2 - np.abs(matrix) @ ((high - low) / 2)
        widened = widened / np.abs(matrix).sum(axis=1)
        return bool(
            np.abs(shift).max() < 1e-3
            and np.ptp(widened) < 1e-3
            and widened.min() > -1e-4
            and widened.max() < 0.041
        )

    def _stand_in(self, link: int) -> PlacedGeometry:
        """Returns a link's box as PyBullet has it now, for shapes that it does not give back."""
        low, high = self._own_box(link)
        position, orientation = self._com_pose(link)
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        world = low + corners * (high - low)
        # Row vectors times R are those turned by the inverse of R.
        local = (world - position) @ rotation_matrices(orientation)[0]
        com = self._com_of(link)
        return PlacedGeometry(link, Geometry.hull(local), com[0][0], com[1][0], exact=False)

    def _is_bare(self, link: int) -> bool:
        """Checks whether a link has no shapes: its box is but a margin of 1 mm around its mass."""
        low, high = self._own_box(link)
        shift = (low + high) / 2 - self._com_pose(link)[0][0]
        return bool((high - low).max() < _BARE and np.abs(shift).max() < 1e-6)

    def _own_box(self, link: int) -> tuple[Array, Array]:
        low, high = pybullet.getAABB(self.handle, link - 1, self.client)
        return np.array(low), np.array(high)

    def _com_pose(self, link: int) -> Pose:
        if link == 0:
            pose = pybullet.getBasePositionAndOrientation(self.handle, self.client)
        else:
            pose = pybullet.getLinkState(self.handle, link - 1, 0, 1, self.client)
        return np.array([pose[0]]), wxyz(np.array([pose[1]]))


def _are_alike(some: Sequence[PlacedGeometry], others: Sequence[PlacedGeometry]) -> bool:
    """Checks whether primitives are the same shapes in the same places, but for single floats."""
    if len(some) != len(others):
        return False
    for one, other in zip(some, others, strict=True):
        sizes = np.array([one.geometry.size, other.geometry.size])
        turns = rotation_matrices(np.array([one.orientation, other.orientation]))
        # Of what is round only the axis counts, either way; of a sphere nothing.
        axes = {"sphere": 0, "cylinder": 1, "capsule": 1}.get(one.geometry.type, 3)
        along = np.abs(np.einsum("ij,ij->j", *turns)[3 - axes :]).min(initial=1.0)
        off = np.sqrt(max(2.0 - 2.0 * along, 0.0))  # as an angle
        apart = max(np.abs(sizes[0] - sizes[1]).max(), np.abs(one.position - other.position).max())
        if one.geometry.type != other.geometry.type or max(apart, off) > _SINGLE:
            return False
    return True


def primitive_of(kind: int, size: Sequence[float]) -> Geometry | None:
    """Returns the geometry of a shape by PyBullet's numbers; None for what is no primitive."""
    a, b, c = size
    if kind == pybullet.GEOM_BOX:
        return Geometry.primitive("box", (a, b, c))
    if kind == pybullet.GEOM_SPHERE:
        return Geometry.primitive("sphere", (a, 0.0, 0.0))
    if kind == pybullet.GEOM_CYLINDER:  # PyBullet gives height, radius
        return Geometry.primitive("cylinder", (b, a, 0.0))
    if kind == pybullet.GEOM_CAPSULE:
        return Geometry.primitive("capsule", (b, a, 0.0))
    if kind == pybullet.GEOM_PLANE:
        return Geometry.primitive("plane", (a, b, c))
    return None


def _half_extents(shape: Geometry) -> Array:
    """Returns the half extents of a bounded primitive in its own frame."""
    a, b, c = shape.size
    match shape.type:
        case "box":
            return np.array([a, b, c]) / 2
        case "sphere":
            return np.array([a, a, a])
        case "cylinder":
            return np.array([a, a, b / 2])
        case "capsule":
            return np.array([a, a, a + b / 2])
    raise AssertionError(shape.type)
