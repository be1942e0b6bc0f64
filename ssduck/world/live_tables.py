"""Holds the rows of a tick in numpy buffers that an Arrow table shares.

The numbers of a table are overwritten in place, so that readers of the Arrow table, such as
DuckDB, see the next tick without further calls.
"""

from __future__ import annotations

import copy
from collections.abc import Collection
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
# A table that becomes larger than its buffers gets such a part of its size more.
_SPARE_FRACTION = 4
# The version that was given out last; each is unique in the process, whatever thread asks.
_last_version = 0


def new_version() -> int:
    """Returns a new version of a table that DuckDB reads in place."""
    global _last_version  # noqa: PLW0603  # of all tables
    _last_version = version = next(_versions)
    return version


def last_version() -> int:
    """Returns a number that changes whenever any table gets a new version."""
    return _last_version


class LiveTable:
    """A table of the current tick.

    Attributes:
        columns: the declared columns.
        count: the number of rows.
        version: a number that changes whenever `arrow` is replaced; see `new_version`.
        is_complete: whether every number is known; an unknown one is NaN in the buffers and NULL
            in `arrow`.
    """

    def __init__(self, columns: tuple[Column, ...]) -> None:
        self.columns = columns
        self.fill(0, {})

    def fill(self, count: int, values: dict[str, Any]) -> None:
        """Resets the table to a number of rows; columns of numbers without values start at 0."""
        self.count = count
        kinds: dict[str, ColumnType] = {column.name: column.type for column in self.columns}
        self._numbers: dict[str, npt.NDArray[Any]] = {}
        # Columns of numbers without missing values get buffers; the others stay Arrow arrays.
        buffered = [
            (name, kind)
            for name, kind in kinds.items()
            if kind in ("double", "integer") and all(v is not None for v in values.get(name, ()))
        ]
        # One block for all doubles: adjacent columns can be written in one operation.
        doubles = [name for name, kind in buffered if kind == "double"]
        self._block = np.zeros((len(doubles), count))
        self._row = {name: row for row, name in enumerate(doubles)}
        self._block_rows: dict[tuple[str, ...], slice | Indices] = {}
        for name, kind in buffered:
            if kind == "double":
                self._numbers[name] = self._block[self._row[name]]
            else:
                self._numbers[name] = np.zeros(count, dtype=np.int64)
        self._buffers = self._block, dict(self._numbers)
        self._arrays = {
            name: pa.array(values[name] if name in values else [None] * count, ARROW_TYPES[kind])
            for name, kind in kinds.items()
            if name not in self._numbers
        }
        for name, column in self._numbers.items():
            if name in values:
                column[:] = values[name]
        self.publish()

    def resize(self, count: int) -> None:
        """Sets the number of rows, which the caller fills; the buffers stay if the rows fit."""
        if count == self.count:
            return
        if count > self._buffers[0].shape[1]:
            self.fill(count + count // _SPARE_FRACTION, {})
        block, numbers = self._buffers
        self.count = count
        self._block = block[:, :count]
        self._numbers = {name: column[:count] for name, column in numbers.items()}
        self._numbers |= {name: self._block[row] for name, row in self._row.items()}
        self.publish()

    def set_columns(self, values: dict[str, Any]) -> None:
        """Replaces columns that are not columns of numbers."""
        kinds = {column.name: column.type for column in self.columns}
        new = {name: pa.array(column, ARROW_TYPES[kinds[name]]) for name, column in values.items()}
        self._arrays = self._arrays | new
        self.publish()

    def clone(self) -> LiveTable:
        """Returns a table of the same rows with its own buffers; constant columns are shared."""
        clone = copy.copy(self)
        block = clone._block = self._block.copy()  # noqa: SLF001  # one class
        clone._numbers = {  # noqa: SLF001
            name: block[self._row[name]] if name in self._row else column.copy()
            for name, column in self._numbers.items()
        }
        clone._buffers = block, dict(clone._numbers)  # noqa: SLF001
        clone.publish()
        return clone

    def publish(self) -> None:
        """Replaces the Arrow table; columns with unknown numbers are copied, others shared."""
        self.is_complete = not _has_nan(self._block)
        self.version = new_version()
        self._arrow: pa.Table | None = None
        # The values of columns without buffers, as far as they were asked for.
        self._python_values: dict[str, list[Any]] = {}

    @property
    def arrow(self) -> pa.Table:
        """The Arrow table, made when it is asked for; its numbers change in place."""
        if self._arrow is None:
            unknown = np.logical_or.reduce(np.isnan(self._block), axis=1)
            self._arrow = pa.table(
                [self._arrow_column(column, unknown) for column in self.columns],
                names=[column.name for column in self.columns],
            )
        return self._arrow

    def _arrow_column(self, column: Column, unknown: npt.NDArray[np.bool_]) -> pa.Array:
        """Returns a column of the Arrow table; `unknown` are flags of the columns of doubles."""
        name = column.name
        if name not in self._numbers:
            return self._arrays[name]
        if name in self._row and unknown[self._row[name]]:
            return pa.array(self._numbers[name], from_pandas=True)
        buffer = pa.py_buffer(self._numbers[name])
        return pa.Array.from_buffers(ARROW_TYPES[column.type], self.count, [None, buffer])

    def booleans(self, name: str) -> npt.NDArray[np.uint8]:
        """Returns a column of booleans as 0 and 1, (rows,)."""
        column: npt.NDArray[np.uint8] = (
            self._arrays[name].fill_null(False).to_numpy(zero_copy_only=False)
        )
        return column.astype(np.uint8)

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        """Returns the buffer of a column of numbers, (rows,)."""
        return self._numbers[name]

    def values(self, name: str, rows: Indices | None = None) -> list[Any]:
        """Returns the values of a column, in some or all rows, as Python's; None if unknown."""
        if name not in self._numbers:
            if name not in self._python_values:
                self._python_values[name] = self._arrays[name].to_pylist()
            values = self._python_values[name]
            if rows is None:
                return values
            objects: list[Any] = np.fromiter(values, object, len(values)).take(rows).tolist()
            return objects
        column = self._numbers[name]
        selected = column if rows is None else column.take(rows)
        numbers: list[Any] = selected.tolist()
        if not self.is_complete:
            return [None if number != number else number for number in numbers]  # noqa: PLR0124
        return numbers

    def value(self, name: str, row: int) -> Any:
        """Returns the value of a column in a row as Python's; None if it is unknown."""
        column = self._numbers.get(name)
        if column is None:
            return self.values(name)[row]
        number = column[row].item()
        return None if number != number else number  # noqa: PLR0124  # NaN is unknown

    def doubles_in(self, row: int, names: tuple[str, ...]) -> list[float | None]:
        """Returns the values of columns of doubles in a row, None for unknown ones."""
        numbers = self._block[self.block_rows(names), row].tolist()
        return [None if number != number else number for number in numbers]  # noqa: PLR0124

    def doubles(self, first: str, last: str) -> Array:
        """Returns the buffer of adjacent columns of doubles, (columns, rows)."""
        return self._block[self._row[first] : self._row[last] + 1]

    @property
    def block(self) -> Array:
        """The columns of doubles, (columns, rows)."""
        return self._block

    @property
    def names_of_doubles(self) -> list[str]:
        """The columns in the rows of `block`, in order."""
        return list(self._row)

    @property
    def names_of_numbers(self) -> Collection[str]:
        """The columns of numbers that have a buffer."""
        return self._numbers.keys()

    def block_rows(self, names: tuple[str, ...]) -> slice | Indices:
        """Returns the rows of `block` that hold columns; a slice if they are adjacent."""
        if names not in self._block_rows:
            rows = [self._row[name] for name in names]
            is_run = rows == list(range(rows[0], rows[0] + len(rows)))
            run = slice(rows[0], rows[0] + len(rows))
            self._block_rows[names] = run if is_run else np.array(rows, dtype=np.intp)
        return self._block_rows[names]

    def publish_unknown(self) -> None:
        """Turns unknown numbers (NaN) into NULL, after numbers were written."""
        if not self.is_complete or _has_nan(self._block):
            self.publish()


def _has_nan(block: Array) -> bool:
    """Checks whether a number is unknown; the least of numbers with a NaN is NaN."""
    return bool(block.size) and bool(np.isnan(block.min()))
