"""Reads the contact points of the last step into arrays.

PyBullet returns each point as a tuple of numbers and triples, 31 Python objects. A loop over these
objects costs more than the tick itself. `marshal` writes them all in one call; since the bytes of
each point have the same layout, numpy reads each field of all points at once.
"""

from __future__ import annotations

import marshal
import struct
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, chain
from operator import itemgetter
from typing import Any, ClassVar, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.simulators.interface import ContactPoints, Contacts
from ssduck.simulators.pybullet.clients import pybullet

# marshal's format 2, without references: a type code, then the value or the count of elements.
_FORMAT = 2
_SIZES = {"integer": 5, "float": 9, "triple": 5 + 3 * 9}
_HEADER_SIZE = 5
# The fields of a point in PyBullet's order: flags, bodies and links; points and normal; distance,
# normal force and first friction; its direction; the second friction; its direction.
_FIELDS = (
    *("integer",) * 5,
    *("triple",) * 3,
    *("float",) * 3,
    *("triple", "float", "triple"),
)
# Where the value of each field is, or its first element; the last number is the size of a point.
_STARTS = list(accumulate(map(_SIZES.__getitem__, _FIELDS), initial=_HEADER_SIZE))
_SIZE = _STARTS[-1]
# The fields of bodies and links, and the runs of equal fields with floats.
_SIDES = range(1, 5)
_BODIES = slice(1, 3)
_BODY_A, _BODY_B = itemgetter(1), itemgetter(2)
_RUNS = (range(5, 8), range(8, 11), range(11, 12), range(12, 13), range(13, 14))
# Rows of floats: the points and the normal, the distance, the normal force, the frictions.
_DISTANCE, _FORCE, _FRICTION_1, _FRICTION_2 = 9, 10, 11, 15
_FLOATS = 19

_Point: TypeAlias = tuple[Any, ...]
# Bodies and links, (4, points), and the other numbers, (19, points).
_Columns: TypeAlias = tuple[Indices, Array]


@dataclass(frozen=True, eq=False)
class PyBulletContacts:
    """The contact points of the last step at which shapes press or meet.

    Bullet's list also has points of shapes that are about to meet, up to some millimetres apart. It
    presses some of these in the first step of an impact.

    Attributes:
        points: Bullet's list, which is looked into when something is asked.
    """

    points: Sequence[_Point]

    has_moments: ClassVar[bool] = False

    @classmethod
    def read(cls, client: int, known: AbstractSet[int]) -> tuple[Self, bool]:
        """Returns those between known bodies of a client, and whether there are others."""
        points = pybullet.getContactPoints(physicsClientId=client)
        lacks_bodies = not known >= {*map(_BODY_A, points), *map(_BODY_B, points)}
        if lacks_bodies:
            points = [point for point in points if known >= set(point[_BODIES])]
        return cls(points), lacks_bodies

    def all(self) -> ContactPoints:
        """Returns all of them."""
        return self._all

    def between(self, a: int, b: int, *, pressing: bool) -> tuple[Indices, Indices]:
        """Returns the bodies and links of those of two bodies; see `Contacts`."""
        return self.all().between(a, b, pressing=pressing)

    def joined(self, ticks: Sequence[Contacts]) -> tuple[ContactPoints, Indices]:
        """Returns all contacts of several ticks, and the number of each; see `Contacts`."""
        lists = [one.points for one in ticks if isinstance(one, PyBulletContacts)]
        if len(lists) < len(ticks):
            return ContactPoints.joined(ticks)
        found, is_found = _found([*chain.from_iterable(lists)])
        counts = np.append(0, np.cumsum(is_found))[np.cumsum([len(one) for one in lists])]
        return found, np.diff(counts, prepend=0)

    @cached_property
    def _all(self) -> ContactPoints:
        return _found(self.points)[0]


def _found(points: Sequence[_Point]) -> tuple[ContactPoints, Flags]:
    """Returns the points at which shapes press or meet, and which of the points these are."""
    if not points:
        return ContactPoints.none(), np.zeros(0, bool)
    sides, floats = _columns(points) or _columns_by_field(points)
    is_found = (floats[_DISTANCE] <= 0.0) | (floats[_FORCE] > 0.0)
    if not is_found.all():
        chosen = is_found.nonzero()[0]
        sides, floats = sides.take(chosen, axis=1), floats.take(chosen, axis=1)
    friction = floats[_FRICTION_1] * floats[_FRICTION_1 + 1 : _FRICTION_2]
    friction += floats[_FRICTION_2] * floats[_FRICTION_2 + 1 :]
    found = ContactPoints(
        bodies=sides[:2].T,
        links=sides[2:].T + 1,
        points=floats[:6].reshape(2, 3, -1).transpose(2, 0, 1),
        normals=floats[6:9].T,
        depths=-floats[_DISTANCE],
        forces=floats[_FORCE],
        frictions=friction.T,
    )
    return found, is_found


def _columns(points: Sequence[_Point]) -> _Columns | None:
    """Returns the numbers of points; None if the bytes of a point have another layout."""
    written, count = marshal.dumps(tuple(points), _FORMAT), len(points)
    if len(written) != _HEADER_SIZE + count * _SIZE:
        return None
    raw = np.frombuffer(written, np.uint8, offset=_HEADER_SIZE).reshape(count, _SIZE)
    if not ((raw & _CODES) == _EXPECTED).all():
        return None

    def values(fields: range, kind: str) -> npt.NDArray[Any]:
        """Returns the values of equal fields, (fields, points) or (fields, 3, points)."""
        field = _FIELDS[fields.start]
        is_triple = field == "triple"
        # Behind the header of the points and the codes of the field and of its first element.
        start = _HEADER_SIZE + _STARTS[fields.start] + 1 + is_triple * _HEADER_SIZE
        shape = (len(fields), 3, count) if is_triple else (len(fields), count)
        inner = (_SIZES["float"], _SIZE) if is_triple else (_SIZE,)
        return np.ndarray(shape, kind, written, start, (_SIZES[field], *inner))

    floats, row = np.zeros((_FLOATS, count)), 0
    for fields in _RUNS:
        run = values(fields, "<f8")
        rows = run.size // count
        floats[row : row + rows].reshape(run.shape)[...] = run
        row += rows
    return values(_SIDES, "<i4").astype(np.intp), floats


def _columns_by_field(points: Sequence[_Point]) -> _Columns:
    """Returns the numbers of points, converted one field at a time."""
    fields = list(zip(*points, strict=True))
    columns = [fields[place] for place in chain(*_RUNS)]
    floats = [np.array(column, dtype=np.float64).reshape(len(points), -1).T for column in columns]
    sides = [fields[place] for place in _SIDES]
    return np.array(sides, dtype=np.intp), np.concatenate(floats)


def _sample(byte: int) -> npt.NDArray[np.uint8]:
    """Returns a point as marshal writes it, with one byte throughout the values."""
    values = {"integer": struct.unpack("<i", bytes([byte] * 4))[0]}
    values["float"] = struct.unpack("<d", bytes([byte] * 8))[0]
    values["triple"] = (values["float"],) * 3
    return np.frombuffer(marshal.dumps(tuple(values[kind] for kind in _FIELDS), _FORMAT), np.uint8)


# A mask of the bytes that are the same for all points, codes and counts, and these bytes.
_CODES = np.where(_sample(0) == _sample(1), 255, 0).astype(np.uint8)
_EXPECTED = _sample(0) & _CODES
