"""The rows of a tick: numpy buffers that an Arrow table looks into.

The numbers of a table are written in place, so that whoever holds the Arrow table (DuckDB does)
sees the next tick without being told.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from itertools import count
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.geometry.arrays import Array, Indices
from ssduck.schema import Column, ColumnType

# The types of Arrow by those of columns.
ARROW_TYPES: dict[ColumnType, pa.DataType] = {
    "double": pa.float64(),
    "integer": pa.int64(),
    "string": pa.string(),
    "boolean": pa.bool_(),
    "points": pa.list_(pa.list_(pa.float64(), 3)),
    "triples": pa.list_(pa.list_(pa.int32(), 3)),
}

_versions = count(1)


class LiveTable:
    """The columns of one table.

    Attributes:
        arrow: the table; its numbers change in place.
        version: another one whenever `arrow` became another object; no two tables have the same.
        whole: whether every number is known; an unknown one is NaN here and NULL in `arrow`.
    """

    def __init__(self, columns: tuple[Column, ...]) -> None:
        self.columns = columns
        self.fill(0, {})

    def fill(self, count: int, values: dict[str, Any]) -> None:
        """Make the table anew with that many rows; columns without values start at 0."""
        self.count = count
        kinds: dict[str, ColumnType] = {column.name: column.type for column in self.columns}
        self._numbers: dict[str, npt.NDArray[Any]] = {}
        # What is given with gaps stays as it is given; the rest are buffers to be written.
        live = [
            (name, kind)
            for name, kind in kinds.items()
            if kind in ("double", "integer") and not _has_none(values.get(name, ()))
        ]
        # One block for all doubles: neighbouring columns can be written in one go.
        doubles = [name for name, kind in live if kind == "double"]
        self.block = np.zeros((len(doubles), count))
        self._row = {name: row for row, name in enumerate(doubles)}
        for name, kind in live:
            if kind == "double":
                self._numbers[name] = self.block[self._row[name]]
            else:
                self._numbers[name] = np.zeros(count, dtype=np.int64)
        self._others = {
            name: pa.array(values[name] if name in values else [None] * count, ARROW_TYPES[kind])
            for name, kind in kinds.items()
            if name not in self._numbers
        }
        for name, column in self._numbers.items():
            if name in values:
                column[:] = values[name]
        self.publish()

    def put(self, values: dict[str, Any]) -> None:
        """Put other values in the place of columns that hold no numbers."""
        kinds = {column.name: column.type for column in self.columns}
        new = {name: pa.array(column, ARROW_TYPES[kinds[name]]) for name, column in values.items()}
        self._others = self._others | new
        self.publish()

    def clone(self) -> LiveTable:
        """The same rows in buffers of their own; what is never written in place is shared."""
        clone = copy.copy(self)
        clone.block = self.block.copy()
        clone._numbers = {  # noqa: SLF001  # one class
            name: clone.block[self._row[name]] if name in self._row else column.copy()
            for name, column in self._numbers.items()
        }
        clone.publish()
        return clone

    def publish(self) -> None:
        """Make the Arrow table anew: its numbers look into the buffers, but for unknown ones."""
        unknown = np.logical_or.reduce(np.isnan(self.block), axis=1)
        self.is_complete = not any(unknown)
        arrays = []
        for column in self.columns:
            name = column.name
            if name not in self._numbers:
                arrays.append(self._others[name])
            elif name in self._row and unknown[self._row[name]]:
                arrays.append(pa.array(self._numbers[name], from_pandas=True))
            else:
                buffer = pa.py_buffer(self._numbers[name])
                arrays.append(
                    pa.Array.from_buffers(ARROW_TYPES[column.type], self.count, [None, buffer])
                )
        self.arrow = pa.table(arrays, names=[column.name for column in self.columns])
        self.version = next(_versions)

    def booleans(self, name: str) -> npt.NDArray[np.uint8]:
        """A column of booleans, 0 or 1."""
        column: npt.NDArray[np.uint8] = (
            self._others[name].fill_null(False).to_numpy(zero_copy_only=False)
        )
        return column.astype(np.uint8)

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        """The buffer of a column of numbers."""
        return self._numbers[name]

    def doubles(self, first: str, last: str) -> Array:
        """The buffers of neighbouring columns of doubles, (columns, rows)."""
        return self.block[self._row[first] : self._row[last] + 1]

    def block_rows(self, names: Sequence[str]) -> slice | Indices:
        """The rows of `block` that are some columns of doubles; a slice if these are neighbours."""
        rows = [self._row[name] for name in names]
        if rows == list(range(rows[0], rows[0] + len(rows))):
            return slice(rows[0], rows[0] + len(rows))
        return np.array(rows, dtype=np.intp)

    def publish_unknown(self) -> None:
        """Tell that numbers were written: an unknown one (NaN) becomes NULL."""
        if not self.is_complete or np.isnan(self.block).any():
            self.publish()


def _has_none(values: Iterable[Any]) -> bool:
    return any(value is None for value in values)
