"""Evaluates formulas of one shape at once, and finds those whose rows have changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.columns.arrays import Array, ArrayValues, Calls
from ssduck.columns.expressions import Expression
from ssduck.geometry.arrays import Flags
from ssduck.interpreter.triggers.formulas import Formula
from ssduck.interpreter.triggers.rows import Slot, TickArrays, slot_values


class FormulaSelection:
    """Formulas of one shape that are evaluated at the same ticks.

    Args:
        tick: the columns of their world.
        calls: the narrow phase of their world.
        row_of: the row of each entity, by its id.
        formulas: k formulas.

    Attributes:
        formulas: the formulas.
        number: the number of the tick of the last evaluation; 0 before the first.
        state: the state of the table at that evaluation.
        reads_time: whether the rows may differ though nothing has moved.
    """

    def __init__(
        self,
        tick: TickArrays,
        calls: Calls,
        row_of: Mapping[int, int],
        formulas: Sequence[Formula],
    ) -> None:
        self.formulas = tuple(formulas)
        self.number = self.state = 0
        self._tick = tick
        self._calls = calls
        self._fetched: Mapping[str, Array] = {}
        self._leaves = ArrayValues(self._read, tick.table.count, calls, {})
        first = formulas[0]
        self._condition, self._columns, self._changing = (
            first.condition,
            first.columns,
            first.changing,
        )
        columns = zip(*(formula.slots for formula in formulas), strict=True)
        self._readers = [_slot_reader(slots, row_of) for slots in columns]
        self.reads_time = any(formula.reads_time for formula in formulas)
        self._version = -1
        self._mask: Flags = np.zeros((1, 0), dtype=np.bool_)
        self._values: list[Array] = []
        self._keys: list[Array] = []
        self._continue()

    def _continue(self) -> None:
        """Takes over the last rows of the formulas from their former selections."""
        before = [f.selection and f.selection.last(f.place) for f in self.formulas]
        if all(before) and len({last[0] for last in before if last}) == 1:
            known = [last for last in before if last]
            self._version = known[0][0]
            self._mask = np.stack([last[1] for last in known])
            self._values = [np.stack(c) for c in zip(*(last[2] for last in known), strict=True)]
            self._keys = [np.stack(c) for c in zip(*(last[3] for last in known), strict=True)]
        for place, formula in enumerate(self.formulas):
            formula.selection, formula.place = self, place

    def last(self, place: int) -> tuple[int, Flags, list[Array], list[Array]] | None:
        """Returns the last rows of a formula: the table's version, mask, values and their keys."""
        if self._version < 0:
            return None
        values = [_of_formula(part, place) for part in self._values]
        keys = [_of_formula(part, place) for part in self._keys]
        return self._version, _of_formula(self._mask, place), values, keys

    def _read(self, key: Any) -> Array:
        """Returns the values of a slot, a column, or an expression that DuckDB evaluated."""
        if isinstance(key, int):
            return self._readers[key](self._tick)
        return self._tick[key] if isinstance(key, str) else self._fetched[key[1]]

    def evaluate(self, number: int, fetched: Mapping[str, Array]) -> bool:
        """Evaluates the formulas at the tick of a number; returns whether rows have changed.

        Args:
            number: the number of the tick.
            fetched: the columns that DuckDB evaluated.

        Raises:
            LeftToDuckDBError: they have to be evaluated by themselves.
        """
        table = self._tick.table
        self._fetched = fetched
        is_replaced = self._version != table.version
        fixed = {} if is_replaced else self._leaves.fixed
        self._leaves = ArrayValues(self._read, table.count, self._calls, fixed)
        mask = np.ones((1, table.count), dtype=np.bool_)
        if self._condition is not None:
            mask = self._rows(self._condition).astype(np.bool_)  # NULL does not hold
        self._leaves.active = mask
        values = [self._rows(part).copy() for part in self._changing]
        keys = [_bits(part) for part in values]
        changed: Flags = np.ones(1, dtype=np.bool_)
        if not is_replaced:
            changed = self._differing(mask, keys)
        self._version, self.number = table.version, number
        self._mask, self._values, self._keys = mask, values, keys
        if not changed.any():
            return False
        is_changed = np.broadcast_to(changed, len(self.formulas)).tolist()
        for formula, is_new in zip(self.formulas, is_changed, strict=True):
            formula.version += is_new
        return True

    def _rows(self, part: Expression) -> Array:
        """Returns the values of a part for all rows, (k or 1, n) or (k or 1, n, length)."""
        values: Array = part.compute(self._leaves)
        if part.kind == "list":
            return values
        values = np.atleast_2d(values)
        return np.broadcast_to(values, (len(values), self._tick.table.count))

    def _differing(self, mask: Flags, keys: Sequence[Array]) -> Flags:
        """Returns whether the rows of each formula differ from the last ones, (k,) or (1,)."""
        changed: Flags = (mask != self._mask).any(axis=1)
        for now, before in zip(keys, self._keys, strict=True):
            differ = now != before
            if differ.ndim > mask.ndim:
                differ = differ.any(axis=2)
            changed = changed | (differ & mask).any(axis=1)
        return changed

    def rows(self, place: int) -> list[tuple[Any, ...]]:
        """Returns the rows of a formula at the last evaluation, before LIMIT and OFFSET."""
        mask = _of_formula(self._mask, place)
        if not self._columns:
            return [()] * int(mask.sum())
        changing = iter(self._values)
        columns = [
            _of_formula(self._rows(part) if part.is_fixed else next(changing), place)
            for part in self._columns
        ]
        return list(zip(*(column[mask].tolist() for column in columns), strict=True))


def _of_formula(values: Array, place: int) -> Array:
    """Returns the values of one of k formulas."""
    own: Array = values[place] if len(values) > 1 else values[0]
    return own


def _bits(values: Array) -> Array:
    """Returns a key of each value that tells 0.0 from -0.0."""
    if values.dtype == np.float64:
        return values.view(np.int64)
    if values.dtype == np.object_:
        return np.array([[repr(value) for value in row] for row in values.tolist()], dtype=object)
    return values


def _slot_reader(slots: Sequence[Slot], row_of: Mapping[int, int]) -> Callable[[TickArrays], Array]:
    """Returns a function that reads a slot of k formulas at a tick, (k, 1) or (1, 1)."""
    column = slots[0].column
    if column is None:
        constants = slot_values(slots)
        return lambda _: constants
    rows: npt.NDArray[np.intp] = np.array([row_of[slot.value.id] for slot in slots], np.intp)
    if (rows == rows[0]).all():
        rows = rows[:1]
    return lambda tick: tick[column][rows][:, None]
