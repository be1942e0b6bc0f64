"""Evaluates formulas of one shape at once, and tells which rows and tables have changed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.columns.arrays import Array, ArrayValues
from ssduck.columns.compiler import Kind
from ssduck.columns.selects import ArraySelect
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.output import AsClause
from ssduck.interpreter.query_runner import PlannedQuery
from ssduck.interpreter.triggers.shapes import LiveShapes
from ssduck.language.clauses import Selected
from ssduck.language.evaluator import Frame
from ssduck.language.tree import Query
from ssduck.schema import TABLES
from ssduck.world.live_tables import LiveTable
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World

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
    """The numbers of a table at a tick."""

    version: int  # the version of the table, which changes with all that is no number
    doubles: Array  # the block of its doubles
    integers: list[npt.NDArray[Any]]  # its columns of integers

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


_TYPES = {"double": np.float64, "decimal": np.float64, "integer": np.int64, "string": np.object_}


Planned: TypeAlias = tuple[Query, PlannedQuery, AsClause, Frame]


@dataclass(frozen=True)
class Slot:
    """A constant of a shape, or a number of an entity that is the value of a variable."""

    kind: Kind  # the type of its values
    value: Any  # the constant, or the entity
    column: str | None = None  # the column of the entity; None for a constant

    @property
    def key(self) -> tuple[Any, ...]:
        """A key that slots of equal values share; 0.0 and -0.0 differ."""
        return self.kind, self.column, self.value.id if self.column else repr(self.value)


@dataclass(eq=False)
class Formula:
    """A query over the entities of one world, of which each row is decided by itself."""

    world: World
    select: ArraySelect  # its SELECT, with slots in place of constants
    slots: Sequence[Slot]  # the constants
    tables: frozenset[str]  # what is read from the simulator beside the entities
    columns: frozenset[str | None]  # the columns that it reads
    _planned: Planned
    # The formulas that were last evaluated with it; None before that.
    group: FormulaGroup | None = field(default=None, init=False)
    place: int = field(default=0, init=False)  # its place among them

    @cached_property
    def shape(self) -> tuple[Any, ...]:
        """What formulas that are evaluated at once have in common."""
        return self.select.text, *((slot.kind, slot.column) for slot in self.slots)

    def is_evaluated_at(self, tick: int) -> bool:
        """Checks whether its rows are those of the tick of a number."""
        return self.group is not None and self.group.number == tick

    @property
    def key(self) -> Any:
        """What differs if a bit of its rows does."""
        return None if self.group is None else self.group.key_of(self.place)

    def value(self) -> Any:
        """Returns the result of the program for the rows of its last evaluation."""
        rows = [] if self.group is None else self.group.rows_of(self.place)
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


def _bits(values: Array) -> tuple[Any, ...]:
    """Returns a key of an array that tells 0.0 from -0.0."""
    of_objects = values.dtype == np.object_
    return values.dtype, values.shape, values.tolist() if of_objects else values.tobytes()


class FormulaGroup:
    """Formulas of one shape that are evaluated at the same ticks.

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
        self._reads_time = not formulas[0].columns.isdisjoint(TIME_COLUMNS)
        # The columns of the rows of all formulas, those of the first one first; where the rows of
        # each begin; and the keys of the columns, and of the rows of each.
        self._columns: list[Array] = []
        self._ends: list[int] = [0] * (len(formulas) + 1)
        self._bits: list[Any] = []
        self._keys: dict[int, Any] = {}
        for place, formula in enumerate(formulas):
            formula.group, formula.place = self, place

    def rows_of(self, place: int) -> list[tuple[Any, ...]]:
        """Returns the last rows of a formula as Python's values."""
        columns = [column.tolist() for column in self._own(place)]
        start, end = self._ends[place : place + 2]
        return list(zip(*columns, strict=True)) if columns else [()] * (end - start)

    def key_of(self, place: int) -> Any:
        """Returns what differs if a bit of the last rows of a formula does."""
        if place not in self._keys:
            start, end = self._ends[place : place + 2]
            self._keys[place] = end - start, *map(_bits, self._own(place))
        return self._keys[place]

    def _own(self, place: int) -> list[Array]:
        return [column[slice(*self._ends[place : place + 2])] for column in self._columns]

    def evaluate(self, snapshot: Snapshot, *, has_moved: bool) -> bool:
        """Evaluates the formulas at a tick; returns whether their rows may have changed.

        They are as they were if nothing that the formulas read has moved.
        """
        bits = self._bits
        if has_moved or self._reads_time or not self.number:
            self.number = 0
            formulas, *columns = self._evaluated(snapshot.table("entities"))
            bits = [*map(_bits, (formulas, *columns))]
        has_changed = bits != self._bits
        if has_changed:
            ends = np.searchsorted(formulas, np.arange(len(self.formulas) + 1))
            self._columns, self._ends, self._keys = columns, ends.tolist(), {}
            self._bits = bits
        self.number = snapshot.number
        return has_changed

    def _evaluated(self, table: LiveTable) -> list[Array]:
        """Returns the place of the formula of each row, ascending, and the columns of the rows."""

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
        return self._select.arranged([chosen[0], *columns])


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
