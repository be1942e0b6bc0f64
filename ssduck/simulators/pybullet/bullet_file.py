"""Collision shapes that PyBullet does not tell, read from what it saves of a client.

`saveBullet` writes all shapes of a client as they are in memory: capsules between two points,
triangles of concave meshes, shapes of rigid bodies. The file describes its own structures (names,
types and lengths of their fields), from which numpy's types are made here. Vectors are doubles;
what places a shape in its link, and the sizes of primitives, are single floats, of which the
shortest decimal is taken: 0.08 for what a model says is 0.08.
"""

from __future__ import annotations

import re
import struct
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import IDENTITY, compose, quaternion_from_matrix
from ssduck.geometry.shapes import Geometry
from ssduck.simulators.pybullet.console import pybullet

# A geometry with its position (3,) and orientation (4,) in a frame.
Placed: TypeAlias = tuple[Geometry, Array, Array]

# The file's own names of numbers.
_NUMBERS = {
    "char": "u1",
    "uchar": "u1",
    "short": "<i2",
    "ushort": "<u2",
    "int": "<i4",
    "long": "<i4",
    "ulong": "<u4",
    "float": "<f4",
    "double": "<f8",
    "void": "u1",
}
_POINTER = np.dtype("<u8")
# In front of each block: its code, length, address in memory, structure, how many of these.
_BLOCK = struct.Struct("<4siQii")
_HEAD = 12
# The first of the frictions by which links are told from each other: none has such a one.
_FIRST_TAG = 2**50
# What getDynamicsInfo tells of a link: where its friction is.
_FRICTION = 1


class _Kind(IntEnum):
    """Bullet's numbers of the types of shapes."""

    BOX = 0
    HULL = 4
    SPHERE = 8
    SPHERES = 9
    CAPSULE = 10
    CYLINDER = 13
    MESH = 21
    SCALED_MESH = 22
    EMPTY = 27
    PLANE = 28
    COMPOUND = 31


class SavedShapes:
    """The shapes of a client's bodies, saved when they are first asked for.

    Args:
        client: the client.
        handles: the bodies that may be asked for.
    """

    def __init__(self, client: int, handles: Sequence[int]) -> None:
        self._client = client
        self._handles = handles

    def of(self, handle: int, link: int) -> list[Placed] | None:
        """Returns the shapes of a link in the frame of its centre of mass; the base is link 0.

        Returns:
            None for what is not known: height fields, or if PyBullet cannot save.
        """
        if self._file is None:
            return None
        root = self._roots.get((handle, link))
        return [] if root is None else self._file.shapes(root)

    @cached_property
    def _file(self) -> _File | None:
        return self._saved[0] if self._saved is not None else None

    @cached_property
    def _roots(self) -> Mapping[tuple[int, int], int]:
        """The addresses of the shapes of links that have some."""
        assert self._saved is not None
        file, tags = self._saved
        found = {tags.get(friction): shape for friction, shape in file.colliders()}
        return {link: shape for link, shape in found.items() if link is not None}

    @cached_property
    def _saved(self) -> tuple[_File, Mapping[float, tuple[int, int]]] | None:
        """What was saved, and the friction by which links are told from each other there.

        The file has no numbers of bodies. Nothing moves while they have another friction.
        """
        links = [
            (handle, link)
            for handle in self._handles
            for link in range(-1, pybullet.getNumJoints(handle, self._client))
        ]
        frictions = [pybullet.getDynamicsInfo(*end, self._client)[_FRICTION] for end in links]
        try:
            for tag, end in enumerate(links, _FIRST_TAG):
                pybullet.changeDynamics(
                    *end, lateralFriction=float(tag), physicsClientId=self._client
                )
            data = _save(self._client)
        finally:
            for end, friction in zip(links, frictions, strict=True):
                pybullet.changeDynamics(
                    *end, lateralFriction=friction, physicsClientId=self._client
                )
        if data is None:
            return None
        tags = {
            float(tag): (handle, link + 1) for tag, (handle, link) in enumerate(links, _FIRST_TAG)
        }
        return _File(data), tags


def _save(client: int) -> bytes | None:
    """Returns the content of a file that PyBullet saves; None if that fails."""
    with tempfile.TemporaryDirectory(prefix="ssduck") as folder:
        path = Path(folder) / "saved.bullet"
        try:
            pybullet.saveBullet(str(path), client)
            data = path.read_bytes()
        except (pybullet.error, OSError):
            return None
    # Addresses of 8 bytes, the lowest byte of a number first.
    is_known = data[:6] == b"BULLET" and data[7:9] == b"-v"
    return data if is_known else None


@dataclass(frozen=True, eq=False)
class _Structure:
    """A structure of the file, and its fields: type and name, as in C."""

    name: str
    fields: Sequence[tuple[str, str]]


class _File:
    """A file that PyBullet saved."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._blocks: dict[int, tuple[int, int, int]] = {}  # by address: structure, count, place
        self._colliders: list[int] = []
        place = _HEAD
        while True:
            code, length, address, structure, count = _BLOCK.unpack_from(data, place)
            place += _BLOCK.size
            if code == b"DNA1":
                break
            self._blocks[address] = structure, count, place
            if code in (b"MBLC", b"RBDY", b"COBJ"):
                self._colliders.append(address)
            place += length
        self._structures = _structures(data[place : place + length])
        self._by_name = {structure.name: structure for structure in self._structures}
        self._types: dict[str, npt.DTypeLike] = {}

    def colliders(self) -> Iterator[tuple[float, int]]:
        """Yields the friction and the address of the shape of each collider."""
        for address in self._colliders:
            own = self._at(address)[0]
            while "m_friction" not in own.dtype.names:
                own = own[own.dtype.names[0]]
            yield float(own["m_friction"]), int(own["m_collisionShape"])

    def shapes(self, address: int) -> list[Placed] | None:
        """Returns a shape, or those that it is made of; None if one is not supported."""
        shape = self._at(address)[0]
        head = shape
        while "m_shapeType" not in head.dtype.names:
            head = head[head.dtype.names[0]]
        kind = int(head["m_shapeType"])
        match kind:
            case _Kind.COMPOUND:
                return self._compound(shape)
            case _Kind.SPHERES:
                return self._spheres(shape)
            case _Kind.HULL:
                return [_placed(Geometry.hull(self._hull(shape)))]
            case _Kind.MESH:
                return self._mesh(shape, np.ones(3))
            case _Kind.SCALED_MESH:
                return self._mesh(shape["m_trimeshShapeData"], _vector(shape["m_localScaling"]))
            case _Kind.EMPTY:
                return []
            case _Kind.PLANE:
                return _plane(shape)
        primitive = _primitive(kind, shape)
        return None if primitive is None else [primitive]

    def _compound(self, shape: Any) -> list[Placed] | None:
        if not shape["m_numChildShapes"]:
            return []
        found: list[Placed] = []
        for child in self._at(int(shape["m_childShapePtr"])):
            own = self.shapes(int(child["m_childShape"]))
            if own is None:
                return None
            frame = child["m_transform"]
            rows = frame["m_basis"]["m_el"]["m_floats"][:, :3].astype(np.float64)
            place, turn = _vector(frame["m_origin"])[None], quaternion_from_matrix(rows)[None]
            for geometry, position, orientation in own:
                at, as_ = compose(place, turn, position[None], orientation[None])
                found.append((geometry, at[0], as_[0]))
        return found

    def _spheres(self, shape: Any) -> list[Placed] | None:
        """Returns the hull of spheres: one of them, or two of a size, which are a capsule."""
        spheres = self._at(int(shape["m_localPositionArrayPtr"]))
        scale = _vector(shape["m_convexInternalShapeData"]["m_localScaling"])
        centres = np.array([_vector(sphere["m_pos"]) for sphere in spheres]) * scale
        radii = [_decimal(sphere["m_radius"]) * float(scale[0]) for sphere in spheres]
        if len(set(radii)) != 1 or len(centres) > 2:
            return None
        axis = centres[-1] - centres[0]
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            sphere = Geometry.primitive("sphere", (radii[0], 0.0, 0.0))
            return [(sphere, centres[0], IDENTITY.copy())]
        capsule = Geometry.primitive("capsule", (radii[0], length, 0.0))
        return [(capsule, centres.mean(axis=0), _turned_to(axis / length))]

    def _hull(self, shape: Any) -> Array:
        address = int(shape["m_unscaledPointsDoublePtr"]) or int(shape["m_unscaledPointsFloatPtr"])
        points = self._at(address)["m_floats"][:, :3].astype(np.float64)
        scaled: Array = points * _vector(shape["m_convexInternalShapeData"]["m_localScaling"])
        return scaled

    def _mesh(self, shape: Any, scale: Array) -> list[Placed] | None:
        vertices: list[Array] = []
        faces: list[npt.NDArray[np.int32]] = []
        mesh = shape["m_meshInterface"]
        parts = self._at(int(mesh["m_meshPartsPtr"])) if mesh["m_numMeshParts"] else ()
        for part in parts:
            address = int(part["m_vertices3d"]) or int(part["m_vertices3f"])
            corners = self._corners(part)
            if not address or corners is None:
                return None
            faces.append(corners + sum(map(len, vertices)))
            vertices.append(self._at(address)["m_floats"][:, :3].astype(np.float64))
        if not vertices:
            return []
        # Each triangle may have corners of its own: a closed mesh shares them.
        points, place = np.unique(np.concatenate(vertices), axis=0, return_inverse=True)
        triangles = place.reshape(-1)[np.concatenate(faces)].astype(np.int32)
        scaled = points * _vector(mesh["m_scaling"]) * scale
        return [_placed(Geometry("mesh", (0.0, 0.0, 0.0), scaled, triangles))]

    def _corners(self, part: Any) -> npt.NDArray[np.int32] | None:
        """Returns the corners of a part's triangles, (n, 3)."""
        for name, field in (
            ("m_indices32", "m_value"),
            ("m_3indices16", "m_values"),
            ("m_3indices8", "m_values"),
            ("m_indices16", "m_value"),
        ):
            address = int(part[name])
            if address in self._blocks and address:
                values = self._at(address)[field].astype(np.int32)
                return values[..., :3] if values.ndim == 2 else values.reshape(-1, 3)
        return None

    # -- structures -------------------------------------------------------------------------

    def _at(self, address: int) -> npt.NDArray[Any]:
        """Returns the block at an address, as an array of its structures."""
        structure, count, place = self._blocks[address]
        return np.frombuffer(self._data, self._type(self._structures[structure].name), count, place)

    def _type(self, name: str) -> Any:
        """Returns numpy's type of a structure or a number."""
        if name in _NUMBERS:
            return np.dtype(_NUMBERS[name])
        if name not in self._types:
            fields = []
            for kind, field in self._by_name[name].fields:
                own = _POINTER if field.startswith("*") else self._type(kind)
                counts = tuple(map(int, re.findall(r"\[(\d+)\]", field)))
                fields.append((field.lstrip("*").partition("[")[0], own, counts))
            self._types[name] = np.dtype(fields)
        return self._types[name]


def _structures(data: bytes) -> list[_Structure]:
    """Parses the description of the structures at the end of a file."""
    place = 4  # behind "SDNA"

    def words() -> list[str]:
        nonlocal place
        (count,) = struct.unpack_from("<i", data, place + 4)
        place += 8
        found = []
        for _ in range(count):
            end = data.index(b"\0", place)
            found.append(data[place:end].decode())
            place = end + 1
        place = -(-place // 4) * 4
        return found

    names, types = words(), words()
    place += 4 + 2 * len(types)  # their lengths, which follow from their fields
    place = -(-place // 4) * 4
    (count,) = struct.unpack_from("<i", data, place + 4)
    place += 8
    found = []
    for _ in range(count):
        kind, fields = struct.unpack_from("<hh", data, place)
        pairs = struct.iter_unpack("<hh", data[place + 4 : place + 4 + 4 * fields])
        found.append(_Structure(types[kind], [(types[t], names[n]) for t, n in pairs]))
        place += 4 + 4 * fields
    return found


# -- numbers and primitives -------------------------------------------------------------------


def _decimal(number: Any) -> float:
    """Returns the shortest decimal that is a single float."""
    return float(str(np.float32(number)))


def _vector(fields: Any) -> Array:
    """Returns a vector of the file, (3,)."""
    numbers = fields["m_floats"][:3]
    if numbers.dtype == np.float32:
        return np.array([_decimal(number) for number in numbers])
    vector: Array = numbers.astype(np.float64)
    return vector


def _placed(geometry: Geometry) -> Placed:
    return geometry, np.zeros(3), IDENTITY.copy()


def _plane(shape: Any) -> list[Placed]:
    normal = _vector(shape["m_planeNormal"])
    normal /= np.linalg.norm(normal)
    offset = _decimal(shape["m_planeConstant"])
    plane = Geometry.primitive("plane", normal.tolist())
    return [(plane, normal * offset, IDENTITY.copy())]


def _primitive(kind: int, shape: Any) -> Placed | None:
    """Returns a box, a sphere, a capsule or a cylinder; None for what is none of these."""
    own, axis = shape, 2
    if "m_upAxis" in shape.dtype.names:
        own, axis = shape["m_convexInternalShapeData"], int(shape["m_upAxis"])
    if "m_implicitShapeDimensions" not in own.dtype.names:
        return None
    # Bullet takes the margin off the sizes of boxes and cylinders, in single floats.
    sizes = own["m_implicitShapeDimensions"]["m_floats"][:3]
    margin = own["m_collisionMargin"]
    whole = [_decimal(np.float32(size) + np.float32(margin)) for size in sizes]
    across = (axis + 1) % 3
    turn = _turned_to(np.eye(3)[axis])
    if kind == _Kind.BOX:
        return _placed(Geometry.primitive("box", [2.0 * half for half in whole]))
    if kind == _Kind.SPHERE:
        return _placed(Geometry.primitive("sphere", (_decimal(sizes[0]), 0.0, 0.0)))
    if kind == _Kind.CAPSULE:
        size = _decimal(sizes[across]), 2.0 * _decimal(sizes[axis]), 0.0
        return Geometry.primitive("capsule", size), np.zeros(3), turn
    if kind == _Kind.CYLINDER:
        size = whole[across], 2.0 * whole[axis], 0.0
        return Geometry.primitive("cylinder", size), np.zeros(3), turn
    return None


def _turned_to(axis: Array) -> Array:
    """Returns a quaternion w, x, y, z that turns z to an axis of length 1."""
    x, y, z = axis
    if z < -1.0 + 1e-12:
        return np.array([0.0, 1.0, 0.0, 0.0])
    turn = np.array([1.0 + z, -y, x, 0.0])
    unit: Array = turn / np.linalg.norm(turn)
    return unit
