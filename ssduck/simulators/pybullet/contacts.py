"""Reads the contact points of the last step into arrays.

PyBullet returns each point as a tuple of numbers and triples, 31 Python objects. A loop over these
objects costs more than the tick itself. `marshal` writes them all in one call; since the bytes of
each point have the same layout, numpy reads them as records.
"""

from __future__ import annotations

import marshal
import struct
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.simulators.interface import ContactPoints
from ssduck.simulators.pybullet.console import pybullet

# The fields of a point in PyBullet's order: integers, triples of floats, and floats.
_FIELDS = (
    *((name, "integer") for name in ("flags", "body_a", "body_b", "link_a", "link_b")),
    *((name, "triple") for name in ("point_a", "point_b", "normal")),
    *((name, "float") for name in ("distance", "force", "friction_1")),
    ("direction_1", "triple"),
    ("friction_2", "float"),
    ("direction_2", "triple"),
)
# marshal's format 2, without references: a type code, then the value or the count of elements.
_FORMAT = 2
_HEADER = np.dtype([("code", "S1"), ("count", "<i4")])
_INTEGER = np.dtype([("code", "S1"), ("value", "<i4")])
_FLOAT = np.dtype([("code", "S1"), ("value", "<f8")])
_TRIPLE = np.dtype([("header", _HEADER), ("elements", _FLOAT, 3)])
_TYPES = {"integer": _INTEGER, "float": _FLOAT, "triple": _TRIPLE}
_RECORD = np.dtype([("header", _HEADER), *((name, _TYPES[kind]) for name, kind in _FIELDS)])

_Point: TypeAlias = tuple[Any, ...]


def read_contacts(client: int) -> ContactPoints:
    """Returns the contact points of the last step, without those of separate shapes."""
    points = pybullet.getContactPoints(physicsClientId=client)
    return _meeting(_columns(points)) if points else ContactPoints.none()


def _meeting(columns: dict[str, npt.NDArray[Any]]) -> ContactPoints:
    """Returns the points at which shapes meet."""
    meeting = np.flatnonzero(columns["distance"] <= 0.0)
    column = {name: values.take(meeting, axis=0) for name, values in columns.items()}
    friction = (
        column["friction_1"][:, None] * column["direction_1"]
        + column["friction_2"][:, None] * column["direction_2"]
    )
    return ContactPoints(
        bodies=np.column_stack((column["body_a"], column["body_b"])).astype(np.intp),
        links=np.column_stack((column["link_a"], column["link_b"])).astype(np.intp) + 1,
        points=np.stack((column["point_a"], column["point_b"]), axis=1),
        normals=column["normal"],
        depths=-column["distance"],
        forces=column["force"],
        frictions=friction,
    )


def _columns(points: Sequence[_Point]) -> dict[str, npt.NDArray[Any]]:
    """Returns the values of each field of points, one row for each point."""
    records = _records(points)
    if records is None:
        return _columns_by_field(points)
    return {
        name: records[name]["elements"]["value"] if kind == "triple" else records[name]["value"]
        for name, kind in _FIELDS
    }


def _records(points: Sequence[_Point]) -> npt.NDArray[Any] | None:
    """Returns points as records; None if the bytes of a point have another layout."""
    written = marshal.dumps(tuple(points), _FORMAT)
    if len(written) != _HEADER.itemsize + len(points) * _RECORD.itemsize:
        return None
    records = np.frombuffer(written, _RECORD, offset=_HEADER.itemsize)
    raw = records.view(np.uint8).reshape(len(points), _RECORD.itemsize)
    return records if (raw.take(_CODES, axis=1) == _EXPECTED).all() else None


def _columns_by_field(points: Sequence[_Point]) -> dict[str, npt.NDArray[Any]]:
    """Returns the values of each field, converted one field at a time."""
    types = {"integer": np.int64, "float": np.float64, "triple": np.float64}
    return {
        name: np.array(values, dtype=types[kind])
        for (name, kind), values in zip(_FIELDS, zip(*points, strict=True), strict=True)
    }


def _sample(byte: int) -> npt.NDArray[np.uint8]:
    """Returns a point as marshal writes it, with one byte throughout the values."""
    values = {"integer": struct.unpack("<i", bytes([byte] * 4))[0]}
    values["float"] = struct.unpack("<d", bytes([byte] * 8))[0]
    values["triple"] = (values["float"],) * 3
    point = tuple(values[kind] for _, kind in _FIELDS)
    return np.frombuffer(marshal.dumps(point, _FORMAT), np.uint8)


# The places and the values of the bytes that are the same for all points: codes and counts.
_CODES = np.flatnonzero(_sample(0) == _sample(1))
_EXPECTED = _sample(0)[_CODES]
