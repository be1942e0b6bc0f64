"""The rows of a tick as arrays, and the constants of formulas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from ssduck.columns.arrays import Array
from ssduck.columns.expressions import Kind
from ssduck.schema import TABLES
from ssduck.world.live_tables import LiveTable

Number: TypeAlias = Literal["double", "integer"]

COLUMN_KINDS: dict[str, Kind] = {
    **{column.name: "double" for column in TABLES["entities"].columns if column.type == "double"},
    **{column.name: "integer" for column in TABLES["entities"].columns if column.type == "integer"},
    **dict.fromkeys(("name", "kind"), "string"),
    **dict.fromkeys(("enabled", "visible"), "boolean"),
}
NUMERIC_COLUMNS = [name for name, kind in COLUMN_KINDS.items() if kind in ("double", "integer")]
# Those that stay the same until the table is replaced.
FIXED_COLUMNS = frozenset(("id", "name", "kind", "enabled", "visible"))
_TYPES = {"double": np.float64, "decimal": np.float64, "integer": np.int64, "string": np.object_}
_LARGEST = 1 << 63


@dataclass(frozen=True)
class Slot:
    """A constant of a shape, or a number of an entity that is the value of a variable.

    Attributes:
        kind: the type of its values.
        value: the constant, or the entity.
        column: the column of the entity; None for a constant.
    """

    kind: Kind
    value: Any
    column: str | None = None

    @property
    def key(self) -> tuple[Any, ...]:
        """A key that slots of equal values share; 0.0 and -0.0 differ."""
        value = self.value.id if self.column else repr(self.value)
        return self.kind, self.column, value

    @property
    def signature(self) -> tuple[Kind, str | None]:
        """What expressions of one shape have in common."""
        return self.kind, self.column

    @property
    def is_in_range(self) -> bool:
        """Whether arrays hold it."""
        is_integer = self.kind == "integer" and self.column is None
        return not is_integer or -_LARGEST < self.value < _LARGEST


def slot_values(slots: Sequence[Slot]) -> Array:
    """Returns the constants in a slot of k formulas, (k, 1), or (1, 1) where all are equal."""
    if len({slot.key for slot in slots}) == 1:
        slots = slots[:1]
    return np.array([[slot.value] for slot in slots], dtype=_TYPES[slots[0].kind])


class TickArrays:
    """The columns of the entities of a tick as arrays.

    Args:
        table: the table of entities.
    """

    def __init__(self, table: LiveTable) -> None:
        self.table = table
        self._columns: dict[str, Array] = {}
        self._version = -1

    def update(self) -> None:
        """Reads the columns of the table anew if it was replaced."""
        if self._version != self.table.version:
            self._version = self.table.version
            self._columns = {name: self.table[name] for name in NUMERIC_COLUMNS}

    def __getitem__(self, name: str) -> Array:
        """Returns a column."""
        if name not in self._columns:
            if COLUMN_KINDS[name] == "boolean":
                column = self.table.booleans(name).astype(np.bool_)
            else:
                column = np.array(self.table.arrow[name].to_pylist(), dtype=object)
            self._columns[name] = column
        return self._columns[name]
