"""Looks up contacts and sensor readings of one or two entities at a recorded tick.

The macros of SQL cannot look things up by the tick of a row. Each function gets the columns of
tables at a tick (`ssduck.recording.replay.record.Record.rows`) and returns numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array
from ssduck.schema import LINK_FACTOR, entity_of, link_of

Columns: TypeAlias = Mapping[str, npt.NDArray[Any]]
# Returns the columns of a table at the tick.
RowReader: TypeAlias = Callable[[str], Columns]
NORMAL = ("nx", "ny", "nz")


def sensed(read_rows: RowReader, sensor: int, entity: int) -> list[float]:
    """Returns the share of a sensor's rays that end on an entity; [] if it perceives none."""
    sensings = read_rows("sensings")
    matches = np.flatnonzero((sensings["sensor"] == sensor) & (sensings["entity"] == entity))
    shares: list[float] = (sensings["hits"][matches] / sensings["rays"][matches]).tolist()
    return shares


def perceived(read_rows: RowReader, sensor: int, _: int) -> list[float]:
    """Returns the ids of the entities that a sensor perceives, ascending."""
    sensings = read_rows("sensings")
    ids: list[float] = (
        np.sort(sensings["entity"][sensings["sensor"] == sensor]).astype(float).tolist()
    )
    return ids


def contact_forces(read_rows: RowReader, a: int, b: int) -> list[float]:
    """Returns the normal forces of the contacts of two entities or links, N."""
    contacts = read_rows("contacts")
    forces: list[float] = contacts["force"][_are_of(contacts, a, b)].tolist()
    return forces


def opposition(read_rows: RowReader, a: int, b: int) -> list[float]:
    """Returns the cosines of the angles between the normals of two entities' pressing contacts.

    The entities may be links. There is a number for each contact, that of the normal most opposed
    to its own.
    """
    contacts = read_rows("contacts")
    normals = _vectors(contacts, _are_of(contacts, a, b) & (contacts["force"] > 0), *NORMAL)
    cosines: list[float] = (normals @ normals.T).min(axis=1, initial=1.0).tolist()
    return cosines


def _are_of(contacts: Columns, a: int, b: int) -> npt.NDArray[np.bool_]:
    """Checks which contacts are of two entities or links."""
    return (_touches(contacts, "a", a) & _touches(contacts, "b", b)) | (
        _touches(contacts, "a", b) & _touches(contacts, "b", a)
    )


def _touches(contacts: Columns, side: str, id: int) -> npt.NDArray[np.bool_]:
    """Checks which contacts have an entity or a link on a side."""
    is_entity: npt.NDArray[np.bool_] = contacts[side] == entity_of(id)
    return is_entity if id < LINK_FACTOR else is_entity & (contacts[f"link_{side}"] == link_of(id))


def wrench(read_rows: RowReader, entity: int, _: int) -> list[float]:
    """Returns the net contact force, N, on an entity or a link, and the moment, N m.

    The moment is that about its position.
    """
    contacts, position = read_rows("contacts"), _position(read_rows, entity)
    if position is None:
        return [0.0] * 6
    total = np.zeros(6)
    for side, sign in (("a", 1.0), ("b", -1.0)):
        is_in_contact = _touches(contacts, side, entity)
        forces = sign * _vectors(contacts, is_in_contact, "fx", "fy", "fz")
        arms = _vectors(contacts, is_in_contact, f"{side}x", f"{side}y", f"{side}z") - position
        total[:3] += forces.sum(axis=0)
        total[3:] += np.cross(arms, forces).sum(axis=0)
    components: list[float] = total.tolist()
    return components


def _position(read_rows: RowReader, id: int) -> Array | None:
    """Returns the position of an entity or a link, (3,), m; None if it is not there."""
    if id >= LINK_FACTOR:
        rows = read_rows("links")
        matches = (rows["entity"] == entity_of(id)) & (rows["link"] == link_of(id))
        if matches.any():
            return np.array([rows[axis][matches][0] for axis in "xyz"])
        # A body of one link has its pose, and no row of its own.
    rows = read_rows("entities")
    matches = rows["id"] == entity_of(id)
    return np.array([rows[axis][matches][0] for axis in "xyz"]) if matches.any() else None


def _vectors(columns: Columns, rows: npt.NDArray[np.bool_], *names: str) -> Array:
    return np.array([columns[name][rows] for name in names]).T.reshape(-1, 3)


LOOKUPS: dict[str, Callable[[RowReader, int, int], list[float]]] = {
    lookup.__name__: lookup for lookup in (sensed, perceived, contact_forces, opposition, wrench)
}
