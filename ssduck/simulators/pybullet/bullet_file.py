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
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import IDENTITY, compose, quaternion_from_matrix, turn_to
from ssduck.geometry.shapes import Geometry, GeometryType
from ssduck.simulators.pybullet.clients import pybullet

# A geometry with its position (3,) and orientation (4,) in a frame.
PosedGeometry: TypeAlias = tuple[Geometry, Array, Array]

# Numpy's types of the file's types.
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
# The header of a block: code, length, address in memory, structure, number of structures.
_BLOCK_HEADER = struct.Struct("<4siQii")
_FILE_HEADER_SIZE = 12
# The first of the frictions that identify links: no link has such a friction.
_FIRST_TAG = 2**50
# The index of the friction in the result of getDynamicsInfo.
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
    """The shapes of a client's bodies, read from a file that PyBullet saves on first use."""

    def __init__(self, client: int, handles: Sequence[int]) -> None:
        self._client = client
        self._handles = handles

    def shapes_of(self, handle: int, link: int) -> list[PosedGeometry] | None:
        """Returns the shapes of a link in the frame of its centre of mass; the base is link 0.

        None if they are unknown: they are height fields, or PyBullet cannot save.
        """
        if self._saved is None:
            return None
        file, addresses = self._saved
        address = addresses.get((handle, link))
        return [] if address is None else file.shapes(address)

    @cached_property
    def _saved(self) -> tuple[_BulletFile, Mapping[tuple[int, int], int]] | None:
        """The saved file, and the addresses of the links' shapes in it, by body and link.

        The file has no numbers of bodies: each link has a friction of its own while it is saved.
        """
        client = self._client
        counts = [(handle, pybullet.getNumJoints(handle, client)) for handle in self._handles]
        ends = [(handle, link) for handle, count in counts for link in range(-1, count)]
        frictions = [pybullet.getDynamicsInfo(*end, client)[_FRICTION] for end in ends]
        try:
            for tag, end in enumerate(ends, _FIRST_TAG):
                pybullet.changeDynamics(*end, lateralFriction=float(tag), physicsClientId=client)
            with tempfile.TemporaryDirectory(prefix="ssduck") as folder:
                path = Path(folder) / "saved.bullet"
                pybullet.saveBullet(str(path), client)
                data = path.read_bytes()
        except (pybullet.error, OSError):
            return None
        finally:
            for end, friction in zip(ends, frictions, strict=True):
                pybullet.changeDynamics(*end, lateralFriction=friction, physicsClientId=client)
        # "-": addresses of 8 bytes; "v": little-endian.
        if data[:6] != b"BULLET" or data[7:9] != b"-v":
            return None
        file = _BulletFile(data)
        by_tag = dict(file.colliders())
        links = (
            (float(tag), handle, link + 1) for tag, (handle, link) in enumerate(ends, _FIRST_TAG)
        )
        return file, {(handle, link): by_tag[tag] for tag, handle, link in links if tag in by_tag}


# A C structure of the file: its name, and the types and names of its fields.
_Structure: TypeAlias = tuple[str, Sequence[tuple[str, str]]]


class _BulletFile:
    """A file that PyBullet saved, parsed."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._blocks: dict[int, tuple[int, int, int]] = {}  # by address: structure, count, offset
        self._colliders: list[int] = []
        offset = _FILE_HEADER_SIZE
        while True:
            code, length, address, structure, count = _BLOCK_HEADER.unpack_from(data, offset)
            offset += _BLOCK_HEADER.size
            if code == b"DNA1":
                break
            self._blocks[address] = structure, count, offset
            if code in (b"MBLC", b"RBDY", b"COBJ"):
                self._colliders.append(address)
            offset += length
        self._structures = _parse_structures(data[offset : offset + length])
        self._fields = dict(self._structures)
        self._types: dict[str, npt.DTypeLike] = {}

    def colliders(self) -> Iterator[tuple[float, int]]:
        """Yields the friction and the address of the shape of each collider."""
        for address in self._colliders:
            collider = self._block(address)[0]
            while "m_friction" not in collider.dtype.names:
                collider = collider[collider.dtype.names[0]]
            yield float(collider["m_friction"]), int(collider["m_collisionShape"])

    def shapes(self, address: int) -> list[PosedGeometry] | None:
        """Returns a shape, or those that it is made of; None if one is not supported."""
        shape = self._block(address)[0]
        base = shape
        while "m_shapeType" not in base.dtype.names:
            base = base[base.dtype.names[0]]
        kind = int(base["m_shapeType"])
        match kind:
            case _Kind.COMPOUND:
                return self._compound(shape)
            case _Kind.SPHERES:
                return self._spheres(shape)
            case _Kind.HULL:
                scale = _vector(shape["m_convexInternalShapeData"]["m_localScaling"])
                names = "m_unscaledPointsDoublePtr", "m_unscaledPointsFloatPtr"
                return [_at_origin(Geometry.hull(self._points(shape, *names) * scale))]
            case _Kind.MESH:
                return self._mesh(shape, np.ones(3))
            case _Kind.SCALED_MESH:
                return self._mesh(shape["m_trimeshShapeData"], _vector(shape["m_localScaling"]))
            case _Kind.EMPTY:
                return []
            case _Kind.PLANE:
                normal = _vector(shape["m_planeNormal"])
                normal /= np.linalg.norm(normal)
                place = normal * _shortest_decimal(shape["m_planeConstant"])
                return [(Geometry.primitive("plane", normal.tolist()), place, IDENTITY.copy())]
        return _primitive(kind, shape)

    def _compound(self, shape: Any) -> list[PosedGeometry] | None:
        if not shape["m_numChildShapes"]:
            return []
        shapes: list[PosedGeometry] = []
        for child in self._block(int(shape["m_childShapePtr"])):
            parts = self.shapes(int(child["m_childShape"]))
            if parts is None:
                return None
            frame = child["m_transform"]
            matrix = frame["m_basis"]["m_el"]["m_floats"][:, :3].astype(np.float64)
            child_pose = _vector(frame["m_origin"])[None], quaternion_from_matrix(matrix)[None]
            for geometry, *pose in parts:
                position, orientation = compose(*child_pose, *(part[None] for part in pose))
                shapes.append((geometry, position[0], orientation[0]))
        return shapes

    def _spheres(self, shape: Any) -> list[PosedGeometry] | None:
        """Returns a sphere, or the capsule around two spheres of a radius; None for others."""
        spheres = self._block(int(shape["m_localPositionArrayPtr"]))
        scale = _vector(shape["m_convexInternalShapeData"]["m_localScaling"])
        centres = np.array([_vector(sphere["m_pos"]) for sphere in spheres]) * scale
        radii = [_shortest_decimal(sphere["m_radius"]) * float(scale[0]) for sphere in spheres]
        if len(set(radii)) != 1 or len(centres) > 2:
            return None
        axis = centres[-1] - centres[0]
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            sphere = Geometry.primitive("sphere", (radii[0], 0.0, 0.0))
            return [(sphere, centres[0], IDENTITY.copy())]
        capsule = Geometry.primitive("capsule", (radii[0], length, 0.0))
        return [(capsule, centres.mean(axis=0), turn_to(axis / length))]

    def _points(self, part: Any, in_doubles: str, in_floats: str) -> Array:
        """Returns the points (n, 3) that a part has under one of two names."""
        block = self._block(int(part[in_doubles]) or int(part[in_floats]))
        points: Array = block["m_floats"][:, :3].astype(np.float64)
        return points

    def _mesh(self, shape: Any, scale: Array) -> list[PosedGeometry] | None:
        vertices: list[Array] = []
        faces: list[npt.NDArray[np.int32]] = []
        mesh = shape["m_meshInterface"]
        parts = self._block(int(mesh["m_meshPartsPtr"])) if mesh["m_numMeshParts"] else ()
        for part in parts:
            triangles = self._triangles(part)
            if triangles is None or not (int(part["m_vertices3d"]) or int(part["m_vertices3f"])):
                return None
            faces.append(triangles + sum(map(len, vertices)))
            vertices.append(self._points(part, "m_vertices3d", "m_vertices3f"))
        if not vertices:
            return []
        # Triangles may have vertices of their own in the file; in a closed mesh they share them.
        points, inverse = np.unique(np.concatenate(vertices), axis=0, return_inverse=True)
        merged = inverse.reshape(-1)[np.concatenate(faces)].astype(np.int32)
        scaled = points * _vector(mesh["m_scaling"]) * scale
        return [_at_origin(Geometry("mesh", (0.0, 0.0, 0.0), scaled, merged))]

    def _triangles(self, part: Any) -> npt.NDArray[np.int32] | None:
        """Returns the vertex numbers of a part's triangles, (n, 3)."""
        for name, field in (
            ("m_indices32", "m_value"),
            ("m_3indices16", "m_values"),
            ("m_3indices8", "m_values"),
            ("m_indices16", "m_value"),
        ):
            address = int(part[name])
            if address in self._blocks and address:
                values = self._block(address)[field].astype(np.int32)
                return values[..., :3] if values.ndim == 2 else values.reshape(-1, 3)
        return None

    # -- structures -------------------------------------------------------------------------

    def _block(self, address: int) -> npt.NDArray[Any]:
        """Returns the block at an address, as an array of its structures."""
        structure, count, offset = self._blocks[address]
        dtype = self._dtype(self._structures[structure][0])
        return np.frombuffer(self._data, dtype, count, offset)

    def _dtype(self, name: str) -> Any:
        """Returns numpy's type of a structure or a number."""
        if name in _NUMBERS:
            return np.dtype(_NUMBERS[name])
        if name not in self._types:
            fields = []
            for kind, field in self._fields[name]:
                dtype = _POINTER if field.startswith("*") else self._dtype(kind)
                counts = tuple(map(int, re.findall(r"\[(\d+)\]", field)))
                fields.append((field.lstrip("*").partition("[")[0], dtype, counts))
            self._types[name] = np.dtype(fields)
        return self._types[name]


def _parse_structures(data: bytes) -> list[_Structure]:
    """Parses the description of the structures at the end of a file."""
    names: list[list[str]] = []
    offset = 4  # behind "SDNA"
    for _ in ("fields", "types"):
        (count,) = struct.unpack_from("<i", data, offset + 4)
        *texts, _rest = data[offset + 8 :].split(b"\0", count)
        names.append([text.decode() for text in texts])
        offset = _aligned(offset + 8 + sum(len(text) + 1 for text in texts))
    field_names, types = names
    # Behind the lengths of the types, which follow from their fields.
    offset = _aligned(offset + 4 + 2 * len(types))
    (count,) = struct.unpack_from("<i", data, offset + 4)
    offset += 8
    structures: list[_Structure] = []
    for _ in range(count):
        kind, fields = struct.unpack_from("<hh", data, offset)
        pairs = struct.iter_unpack("<hh", data[offset + 4 : offset + 4 + 4 * fields])
        structures.append((types[kind], [(types[t], field_names[n]) for t, n in pairs]))
        offset += 4 + 4 * fields
    return structures


def _aligned(offset: int) -> int:
    """Returns the next multiple of 4."""
    return -(-offset // 4) * 4


# -- numbers and primitives -------------------------------------------------------------------


def _shortest_decimal(number: Any) -> float:
    """Returns the shortest decimal that is a single float."""
    return float(str(np.float32(number)))


def _vector(fields: Any) -> Array:
    """Returns a vector of the file, (3,)."""
    numbers = fields["m_floats"][:3]
    if numbers.dtype == np.float32:
        return np.array([_shortest_decimal(number) for number in numbers])
    vector: Array = numbers.astype(np.float64)
    return vector


def _at_origin(geometry: Geometry) -> PosedGeometry:
    return geometry, np.zeros(3), IDENTITY.copy()


def _primitive(kind: int, shape: Any) -> list[PosedGeometry] | None:
    """Returns a box, a sphere, a capsule or a cylinder; None for other types."""
    convex, axis = shape, 2
    if "m_upAxis" in shape.dtype.names:
        convex, axis = shape["m_convexInternalShapeData"], int(shape["m_upAxis"])
    if "m_implicitShapeDimensions" not in convex.dtype.names:
        return None
    # Bullet subtracts the margin from the sizes of boxes and cylinders, in single floats.
    sizes = convex["m_implicitShapeDimensions"]["m_floats"][:3]
    margin = convex["m_collisionMargin"]
    halves = [_shortest_decimal(np.float32(size) + np.float32(margin)) for size in sizes]
    inner, across = list(map(_shortest_decimal, sizes)), (axis + 1) % 3
    forms: Mapping[int, tuple[GeometryType, Sequence[float]]] = {
        _Kind.BOX: ("box", [2.0 * half for half in halves]),
        _Kind.SPHERE: ("sphere", (inner[0], 0.0, 0.0)),
        _Kind.CAPSULE: ("capsule", (inner[across], 2.0 * inner[axis], 0.0)),
        _Kind.CYLINDER: ("cylinder", (halves[across], 2.0 * halves[axis], 0.0)),
    }
    if kind not in forms:
        return None
    turn = IDENTITY.copy() if axis == 2 else turn_to(np.eye(3)[axis])
    return [(Geometry.primitive(*forms[kind]), np.zeros(3), turn)]
