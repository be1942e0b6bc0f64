"""Evaluates formulas of one shape at once, and finds those whose rows have changed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import compress
from typing import Any, TypeAlias

import numpy as np

from ssduck.columns.arrays import Array, ArrayValues
from ssduck.columns.expressions import Kind
from ssduck.columns.selects import ArraySelect
from ssduck.geometry.arrays import Flags, Indices
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.output import AsClause
from ssduck.interpreter.query_runner import PlannedQuery
from ssduck.interpreter.triggers.shapes import LiveShapes
from ssduck.interpreter.triggers.table_state import TIME_COLUMNS
from ssduck.language.clauses import Selected
from ssduck.language.evaluator import Frame
from ssduck.language.tree import Query
from ssduck.world.live_tables import LiveTable
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World

_TYPES = {"double": np.float64, "decimal": np.float64, "integer": np.int64, "string": np.object_}


Planned: TypeAlias = tuple[Query, PlannedQuery, AsClause, Frame]


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
        return self.kind, self.column, self.value.id if self.column else repr(self.value)


@dataclass(eq=False)
class Formula:
    """A query over the entities of one world, of which each row is decided by itself.

    Attributes:
        world: the world.
        select: its SELECT, with slots in place of constants.
        slots: the constants.
        tables: what is read from the simulator beside the entities.
        columns: the columns that it reads.
        version: a number that changes whenever the rows of the formula do.
        group: the formulas that were last evaluated with it; None before that.
        place: its place among them.
    """

    world: World
    select: ArraySelect
    slots: Sequence[Slot]
    tables: frozenset[str]
    columns: frozenset[str | None]
    _planned: Planned
    version: int = field(default=0, init=False)
    group: FormulaGroup | None = field(default=None, init=False)
    place: int = field(default=0, init=False)

    @cached_property
    def shape(self) -> tuple[Any, ...]:
        """What formulas that are evaluated at once have in common."""
        return self.select.text, *((slot.kind, slot.column) for slot in self.slots)

    def is_evaluated_at(self, tick: int) -> bool:
        """Checks whether its rows are those of the tick of a number."""
        return self.group is not None and self.group.number == tick

    @property
    def found(self) -> FoundRows | None:
        """The rows of its last evaluation."""
        return None if self.group is None else self.group.rows_of(self.place)

    def value(self) -> Any:
        """Returns the result of the program for the rows of its last evaluation."""
        rows = [] if self.found is None else self.found.values
        query, planned, form, frame = self._planned
        execution = frame.scope

        def run(_: Query, __: Frame, check: Callable[[Any], None]) -> Selected:
            check(planned.columns)
            return planned.output_rows(rows)

        assert isinstance(execution, Execution)
        with execution.lock:
            execution.begin_program()
            execution.meter.check_rows(len(rows))
            return form.value(query, Frame(execution), run)


@dataclass(frozen=True, eq=False)
class FoundRows:
    """The rows of k formulas at a tick, those of the first one first.

    Attributes:
        count: k.
        formulas: (rows,), the place of the formula of each row, ascending.
        columns: (rows,) or (rows, length) each.
    """

    count: int
    formulas: Indices
    columns: list[Array]

    @cached_property
    def _ends(self) -> list[int]:
        return list(np.searchsorted(self.formulas, np.arange(self.count + 1)).tolist())

    def of(self, place: int) -> FoundRows:
        """Returns the rows of a formula."""
        own = slice(*self._ends[place : place + 2])
        return FoundRows(1, self.formulas[own] - place, [column[own] for column in self.columns])

    @property
    def values(self) -> list[tuple[Any, ...]]:
        """The rows as Python's values."""
        if not self.columns:
            return [()] * len(self.formulas)
        return list(zip(*(column.tolist() for column in self.columns), strict=True))

    def differing(self, before: FoundRows) -> Flags:
        """Returns the formulas of which a bit of the rows differs from earlier ones, (k,)."""
        pairs = zip((self.formulas, *self.columns), (before.formulas, *before.columns), strict=True)
        if all(np.array_equal(_bits(ours), _bits(theirs)) for ours, theirs in pairs):
            return np.zeros(self.count, np.bool_)
        counts = [np.bincount(rows.formulas, minlength=self.count) for rows in (self, before)]
        differ: Flags = counts[0] != counts[1]
        now, then = (~differ[rows.formulas] for rows in (self, before))
        formulas = self.formulas[now]
        for ours, theirs in zip(self.columns, before.columns, strict=True):
            a, b = _bits(ours[now]), _bits(theirs[then])
            if a.shape != b.shape or a.dtype != b.dtype:
                differ[formulas] = True
                break
            unequal = a != b
            differ[formulas[unequal if unequal.ndim == 1 else unequal.any(axis=1)]] = True
        return differ


def _bits(values: Array) -> Array:
    """Returns a key of each value that tells 0.0 from -0.0."""
    is_double = values.dtype == np.float64
    return np.ascontiguousarray(values).view(np.int64) if is_double else values


class FormulaGroup:
    """Formulas of one shape that are evaluated at the same ticks.

    Args:
        formulas: k formulas.
        snapshot: a tick of their world with the same entities.
        shapes: the narrow phase of their world.

    Attributes:
        formulas: the formulas.
        number: the number of the tick of the last evaluation; 0 before the first.
    """

    def __init__(self, formulas: Sequence[Formula], snapshot: Snapshot, shapes: LiveShapes) -> None:
        self.formulas, self.number = tuple(formulas), 0
        self._select, self._shapes = formulas[0].select, shapes
        self._slots = [
            _SlotArray(s, snapshot) for s in zip(*(f.slots for f in formulas), strict=True)
        ]
        self._is_current = False
        self._reads_time = not formulas[0].columns.isdisjoint(TIME_COLUMNS)
        self._before = [formula.found for formula in formulas]
        self._found: FoundRows | None = None
        for place, formula in enumerate(formulas):
            formula.group, formula.place = self, place

    def rows_of(self, place: int) -> FoundRows | None:
        """Returns the last rows of a formula; None before the first evaluation."""
        return self._before[place] if self._found is None else self._found.of(place)

    def evaluate(self, snapshot: Snapshot, *, has_moved: bool) -> bool:
        """Evaluates the formulas at a tick, unless nothing that they read has changed.

        Args:
            snapshot: the tick.
            has_moved: whether a number that is read is another one than at the tick before.

        Returns:
            Whether any row has changed.

        Raises:
            LeftToDuckDBError: they have to be evaluated by themselves.
        """
        changed: Sequence[bool] = ()
        if has_moved or self._reads_time or not self._is_current:
            self._is_current = False
            found = self._evaluated(snapshot.table("entities"))
            if self._found is None:
                pairs = zip(map(found.of, range(found.count)), self._before, strict=True)
                changed = [last is None or bool(now.differing(last).any()) for now, last in pairs]
            else:
                changed = found.differing(self._found).tolist()
            for formula in compress(self.formulas, changed):
                formula.version += 1
            self._found = found
        self._is_current, self.number = True, snapshot.number
        return any(changed)

    def _evaluated(self, table: LiveTable) -> FoundRows:
        """Returns the rows of the formulas."""

        def read(key: int | str) -> Array:
            if isinstance(key, int):
                return self._slots[key].values(table)
            if key in table.names_of_numbers:
                return table[key]
            return np.array(table.values(key), np.object_ if key in ("name", "kind") else np.bool_)

        values = ArrayValues(read, table.count, self._shapes)
        mask = np.ones((1, table.count), np.bool_)
        for condition in self._select.conditions:
            mask = mask & condition(values)
        values.active = mask
        parts = [np.atleast_2d(part(values)) for part in self._select.columns]
        shape = len(self.formulas), table.count
        chosen = np.nonzero(np.broadcast_to(mask, shape))
        columns = [np.broadcast_to(part, shape + part.shape[2:])[chosen] for part in parts]
        formulas, *columns = self._select.arranged([chosen[0], *columns])
        return FoundRows(len(self.formulas), formulas, columns)


class _SlotArray:
    """A slot of k formulas as an array, (k, 1), or (1, 1) where all are equal."""

    def __init__(self, slots: Sequence[Slot], snapshot: Snapshot) -> None:
        if len({slot.key for slot in slots}) == 1:
            slots = slots[:1]
        self._column, values = slots[0].column, [[slot.value] for slot in slots]
        if self._column is None:
            self._values: Array = np.array(values, _TYPES[slots[0].kind])
        else:
            self._values = np.array([[snapshot.rows[value.id]] for (value,) in values], np.intp)

    def values(self, table: LiveTable) -> Array:
        """Returns the values at a tick."""
        return self._values if self._column is None else table[self._column][self._values]
