"""Reads the contact points of the last step into arrays.

PyBullet returns each point as a tuple of numbers and triples, 31 Python objects. A loop over these
objects costs more than the tick itself. `marshal` writes them all in one call; since the bytes of
each point have the same layout, numpy reads them as records.
"""

from __future__ import annotations

import marshal
import struct
from collections.abc import Sequence
from itertools import repeat
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.simulators.interface import ContactPoints
from ssduck.simulators.pybullet.console import pybullet

# The groups of adjacent fields of a point in PyBullet's order, with the type and number of each:
# flags, bodies and links; points and normal; distance, normal force and first friction; ...
_GROUPS = (
    ("integers", "integer", 5),
    ("vectors", "triple", 3),
    ("scalars", "float", 3),
    ("direction_1", "triple", 1),
    ("friction_2", "float", 1),
    ("direction_2", "triple", 1),
)
# marshal's format 2, without references: a type code, then the value or the count of elements.
_FORMAT = 2
_HEADER = np.dtype([("code", "S1"), ("count", "<i4")])
_INTEGER = np.dtype([("code", "S1"), ("value", "<i4")])
_FLOAT = np.dtype([("code", "S1"), ("value", "<f8")])
_TRIPLE = np.dtype([("header", _HEADER), ("elements", _FLOAT, 3)])
_TYPES = {"integer": _INTEGER, "float": _FLOAT, "triple": _TRIPLE}
_RECORD = np.dtype(
    [("header", _HEADER), *((name, _TYPES[kind], count) for name, kind, count in _GROUPS)]
)
# A record as bytes: copying these is faster than copying its fields.
_BYTES = np.dtype((np.void, _RECORD.itemsize))

_Point: TypeAlias = tuple[Any, ...]
_Numbers: TypeAlias = npt.NDArray[Any]


def read_contacts(client: int) -> ContactPoints:
    """Returns the contact points of the last step, without those of separate shapes."""
    points = pybullet.getContactPoints(physicsClientId=client)
    return _meeting(points) if points else ContactPoints.none()


def _meeting(points: Sequence[_Point]) -> ContactPoints:
    """Returns the points at which shapes meet."""
    records = _records(points)
    if records is None:
        return _contacts(_values_by_field([point for point in points if point[8] <= 0.0]))
    is_meeting = records["scalars"]["value"][:, 0] <= 0.0
    if not is_meeting.all():
        records = records.view(_BYTES)[is_meeting].view(_RECORD)
    return _contacts(_values(records))


def _contacts(values: dict[str, _Numbers]) -> ContactPoints:
    """Returns contact points, from the values of each group of fields."""
    integers, vectors, scalars = values["integers"], values["vectors"], values["scalars"]
    friction = scalars[:, 2, None] * values["direction_1"][:, 0]
    friction += values["friction_2"] * values["direction_2"][:, 0]
    return ContactPoints(
        bodies=integers[:, 1:3].astype(np.intp),
        links=integers[:, 3:5].astype(np.intp) + 1,
        points=vectors[:, :2],
        normals=vectors[:, 2],
        depths=-scalars[:, 0],
        forces=scalars[:, 1],
        frictions=friction,
    )


def _values(records: _Numbers) -> dict[str, _Numbers]:
    """Returns the values of each group of fields, (points, fields) or (points, fields, 3).

    They are copied: arithmetic on numbers that are not aligned takes longer.
    """
    return {
        name: np.array((records[name]["elements"] if kind == "triple" else records[name])["value"])
        for name, kind, _ in _GROUPS
    }


def _records(points: Sequence[_Point]) -> _Numbers | None:
    """Returns points as records; None if the bytes of a point have another layout."""
    written = marshal.dumps(tuple(points), _FORMAT)
    if len(written) != _HEADER.itemsize + len(points) * _RECORD.itemsize:
        return None
    content = np.frombuffer(written, np.uint8, offset=_HEADER.itemsize)
    raw = content.reshape(len(points), _RECORD.itemsize)
    return content.view(_RECORD) if ((raw & _CODES) == _EXPECTED).all() else None


def _values_by_field(points: Sequence[_Point]) -> dict[str, _Numbers]:
    """Returns the values of each group of fields, converted one field at a time."""
    fields = iter(zip(*points, strict=True) if points else repeat(()))
    return {
        name: np.stack([_column(next(fields), kind) for _ in range(count)], axis=1)
        for name, kind, count in _GROUPS
    }


def _column(values: Sequence[Any], kind: str) -> _Numbers:
    """Returns the values of a field, (points,) or (points, 3)."""
    shape = (len(values), 3) if kind == "triple" else (len(values),)
    return np.array(values, dtype=np.int64 if kind == "integer" else np.float64).reshape(shape)


def _sample(byte: int) -> npt.NDArray[np.uint8]:
    """Returns a point as marshal writes it, with one byte throughout the values."""
    values = {"integer": struct.unpack("<i", bytes([byte] * 4))[0]}
    values["float"] = struct.unpack("<d", bytes([byte] * 8))[0]
    values["triple"] = (values["float"],) * 3
    point = tuple(values[kind] for _, kind, count in _GROUPS for _ in range(count))
    return np.frombuffer(marshal.dumps(point, _FORMAT), np.uint8)


# A mask of the bytes that are the same for all points, codes and counts, and these bytes.
_CODES = np.where(_sample(0) == _sample(1), 255, 0).astype(np.uint8)
_EXPECTED = _sample(0) & _CODES
