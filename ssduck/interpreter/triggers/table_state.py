"""Compares the tables of two ticks: which numbers have changed by more than a threshold."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array
from ssduck.schema import TABLES
from ssduck.world.live_tables import LiveTable
from ssduck.world.snapshot import Snapshot

# The columns that differ from tick to tick though nothing moves.
TIME_COLUMNS = ("tick", "time")
# A component of a quaternion changes by at most half the angle of a rotation.
_QUATERNION = ("qw", "qx", "qy", "qz")
_INTEGERS = {
    name: [c.name for c in table.columns if c.type == "integer" and c.name not in TIME_COLUMNS]
    for name, table in TABLES.items()
}


@dataclass(frozen=True)
class _TableCopy:
    """The numbers of a table at a tick.

    Attributes:
        version: the version of the table, which changes with all that is no number.
        doubles: the block of its doubles.
        integers: its columns of integers.
    """

    version: int
    doubles: Array
    integers: list[npt.NDArray[Any]]

    def has_same(self, table: LiveTable, integers: Iterable[str], threshold: float) -> bool:
        """Checks whether no number has changed by more than a threshold."""
        if table.version != self.version:
            return False
        same = (np.array_equal(a, table[b]) for a, b in zip(self.integers, integers, strict=True))
        if not all(same):
            return False
        changing = [name not in TIME_COLUMNS for name in table.names_of_doubles]
        now, before = table.block[changing], self.doubles[changing]
        if not threshold:
            return np.array_equal(now.view(np.int64), before.view(np.int64))
        with np.errstate(invalid="ignore"):  # infinite boxes
            change = np.abs(now - before)
        change[now == before] = 0.0
        names = (name for name in table.names_of_doubles if name not in TIME_COLUMNS)
        change[[name in _QUATERNION for name in names]] *= 2.0
        return bool((change <= threshold).all())


class TableState:
    """The numbers of tables at a tick, to compare later ticks with."""

    def __init__(self, snapshot: Snapshot, tables: Iterable[str]) -> None:
        self._copies = {}
        for name in tables:
            table = snapshot.tables[name]
            integers = [table[column].copy() for column in _known_integers(name, table)]
            self._copies[name] = _TableCopy(table.version, table.block.copy(), integers)

    def is_same(self, snapshot: Snapshot, threshold: float) -> bool:
        """Checks whether no number in the tables has changed by more than a threshold."""
        return all(
            copy.has_same(
                snapshot.tables[name], _known_integers(name, snapshot.tables[name]), threshold
            )
            for name, copy in self._copies.items()
        )


def _known_integers(name: str, table: LiveTable) -> list[str]:
    """Returns the columns of integers that are numbers in each row."""
    return [column for column in _INTEGERS[name] if column in table.names_of_numbers]
