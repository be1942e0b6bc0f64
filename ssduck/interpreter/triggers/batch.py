"""Evaluates the formulas of many triggers at a tick: with numpy, and with one statement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol
from weakref import WeakKeyDictionary, WeakSet

import numpy as np
from sqlglot import exp

from ssduck.columns.arrays import Array
from ssduck.columns.expressions import LeftToDuckDBError
from ssduck.database.database import Database
from ssduck.database.statement import Statement
from ssduck.errors import SelectScriptError
from ssduck.interpreter.triggers.formulas import ROWS, Formula
from ssduck.interpreter.triggers.geometric_calls import GeometricCalls
from ssduck.interpreter.triggers.rows import Number, TickArrays
from ssduck.interpreter.triggers.selection import FormulaSelection
from ssduck.interpreter.triggers.table_state import TIME_COLUMNS
from ssduck.world.layout import TableLayout
from ssduck.world.live_tables import LiveTable
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World

# A statement is made anew when a quarter of its formulas have been evaluated without it since.
_SHARE = 4
# For fewer formulas, one statement for all is no faster than one for each.
_FEW = 2


class Session(Protocol):
    """The interface of the interpreter's execution to batches."""

    database: Database

    def begin_program(self) -> None:
        """Prepares for a program while none is running."""


class FormulaBatches:
    """Evaluates formulas, those of each world together.

    Args:
        session: the variables and the database.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._by_world: WeakKeyDictionary[World, _FormulaBatch] = WeakKeyDictionary()

    def release_worlds(self) -> None:
        """Drops what refers to worlds."""
        for batch in self._by_world.values():
            batch.close()
        self._by_world.clear()

    def evaluate(
        self, world: World, layout: TableLayout, formulas: tuple[Formula, ...]
    ) -> int | None:
        """Evaluates formulas at the tick of their world, as far as they can be together.

        Args:
            world: the world.
            layout: the entities for which the formulas were made.
            formulas: formulas over this world; the same object as long as they are the same.

        Returns:
            A number that changes whenever the rows of a formula do; None if some of the formulas
            have to be evaluated by themselves (see `Formula.is_evaluated_at`).
        """
        batch = self._by_world.get(world)
        if batch is None:
            batch = self._by_world[world] = _FormulaBatch(self._session.database)
        batch.prepare(formulas)
        pinned: AbstractContextManager[None] = world.pinned(batch.tables)
        if batch.needs_sql:
            self._session.begin_program()
            pinned = self._session.database.pinned(batch.tables, [world])
        with pinned, np.errstate(all="ignore"):
            # A tick that was taken just now may have other entities.
            is_same = world.snapshot.layout is layout
            return batch.evaluate(world.snapshot) if is_same else None


class _FormulaBatch:
    """The formulas over the entities of one world.

    Attributes:
        tables: what they read beside the entities.
        needs_sql: whether DuckDB evaluates parts of them.
    """

    def __init__(self, database: Database) -> None:
        self.tables: frozenset[str] = frozenset()
        self.needs_sql = False
        self._statement = _FormulaStatement(database)
        self._calls = GeometricCalls()
        self._rows: _Rows | None = None
        self._formulas: tuple[Formula, ...] = ()
        self._selections: list[FormulaSelection] = []
        self._changes = 0
        # The formulas that numpy could not evaluate at some tick, and those that DuckDB could not.
        self._alone: WeakSet[Formula] = WeakSet()
        self._failed: WeakSet[Formula] = WeakSet()

    def close(self) -> None:
        """Drops the prepared statement."""
        self._statement.close()

    def prepare(self, formulas: tuple[Formula, ...]) -> None:
        """Sets the formulas to evaluate."""
        if formulas is not self._formulas:
            self._formulas, self._selections = formulas, []
            self.tables = frozenset().union(*(formula.tables for formula in formulas))
            self.needs_sql = any(formula.sql_parts for formula in formulas)

    def evaluate(self, snapshot: Snapshot) -> int | None:
        """Evaluates the formulas at a tick; see `FormulaBatches.evaluate`."""
        table = snapshot.tables["entities"]
        if not table.is_complete:
            return None  # numpy would take an unknown number for NaN
        if self._rows is None or self._rows.tick.table is not table:
            self._rows, self._selections = _Rows(table), []
        self._rows.update(self._calls.begin(snapshot) if "shapes" in self.tables else 0)
        if not self._selections:
            self._selections = self._selected(self._rows.tick, snapshot)
        stale = []
        for selection in self._selections:
            if selection.state != self._rows.state or selection.reads_time:
                stale.append(selection)
            else:
                selection.number = snapshot.number
        if stale:
            self._evaluate(snapshot, self._rows, stale)
        is_whole = all(selection.number == snapshot.number for selection in self._selections)
        return self._changes if is_whole else None

    def _evaluate(
        self, snapshot: Snapshot, rows: _Rows, selections: Sequence[FormulaSelection]
    ) -> None:
        """Evaluates selections of formulas, as far as numpy and DuckDB can."""
        fetched: Mapping[str, Array] = {}
        in_sql = [f for s in selections for f in s.formulas if f.sql_parts]
        in_sql = [formula for formula in in_sql if formula not in self._failed]
        if len(in_sql) >= _FEW:
            try:
                fetched = self._statement.columns(snapshot, rows.tick.table, in_sql)
            except SelectScriptError:  # evaluated by itself, each gives its result or its error
                self._failed.update(in_sql)
        for selection in selections:
            if any(part.text not in fetched for part in selection.formulas[0].sql_parts):
                continue
            try:
                self._changes += selection.evaluate(snapshot.number, fetched)
            except LeftToDuckDBError:
                self._evaluate_singly(snapshot, rows, selection, fetched)
            else:
                selection.state = rows.state

    def _evaluate_singly(
        self,
        snapshot: Snapshot,
        rows: _Rows,
        selection: FormulaSelection,
        fetched: Mapping[str, Array],
    ) -> None:
        """Evaluates each formula of a selection; the next one has none that cannot be."""
        if len(selection.formulas) == 1:
            return
        for formula in selection.formulas:
            single = FormulaSelection(rows.tick, self._calls, snapshot.rows, [formula])
            try:
                single.evaluate(snapshot.number, fetched)
            except LeftToDuckDBError:
                self._alone.add(formula)
        self._formulas = ()

    def _selected(self, tick: TickArrays, snapshot: Snapshot) -> list[FormulaSelection]:
        """Returns the formulas as selections of one shape each."""
        by_shape: dict[Any, list[Formula]] = {}
        for formula in self._formulas:
            key = formula if formula in self._alone else formula.shape
            by_shape.setdefault(key, []).append(formula)
        return [
            FormulaSelection(tick, self._calls, snapshot.rows, members)
            for members in by_shape.values()
        ]


class _Rows:
    """The rows of the entities, and whether they have changed.

    Args:
        table: the table of entities.

    Attributes:
        tick: its columns.
        state: a number that changes whenever a value does, other than the time, or a shape moves.
    """

    def __init__(self, table: LiveTable) -> None:
        self.tick = TickArrays(table)
        self.state = 0
        self._version = 0
        self._before: Array = np.zeros((0, 0), np.int64)
        self._columns: list[int] = []
        self._shapes = 0

    def update(self, shapes: int) -> None:
        """Takes note of the rows of the tick.

        Args:
            shapes: a number that changes whenever shapes move.
        """
        table = self.tick.table
        self.tick.update()
        if table.version != self._version:
            self._version = table.version
            names = table.names_of_doubles
            self._columns = [place for place, n in enumerate(names) if n not in TIME_COLUMNS]
            self.state += 1
        now = table.block[self._columns].view(np.int64)
        if shapes != self._shapes or not np.array_equal(now, self._before):
            self.state += 1
        self._before, self._shapes = now, shapes


class _FormulaStatement:
    """The statement that evaluates what numpy cannot, for all formulas of a world."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._formulas: WeakSet[Formula] = WeakSet()
        self._statement: Statement | None = None
        self._types: dict[str, Number] = {}
        self._places: dict[str, int] = {}
        self._missed = 0

    def columns(
        self, snapshot: Snapshot, table: LiveTable, formulas: Sequence[Formula]
    ) -> dict[str, Array]:
        """Returns the columns of the statement by their text, in the order of the table's rows.

        There are none if the statement has too few of the formulas.

        Raises:
            SelectScriptError: the statement fails.
        """
        self._formulas.update(formulas)
        self._missed += sum(not self._has(formula) for formula in formulas)
        if self._missed * _SHARE >= len(self._formulas):
            self._prepare()
        if self._statement is None or sum(map(self._has, formulas)) < _FEW:
            return {}
        values: dict[str, float] = dict.fromkeys(self._types, 0)
        for formula in formulas:
            for name in formula.types.keys() & values:
                if name in formula.constants:
                    values[name] = formula.constants[name]
                else:
                    entity, column = formula.entity_columns[name]
                    values[name] = table[column][snapshot.rows[entity.id]].item()
        rows = self._statement.rows(values)
        places = {row[-1]: number for number, row in enumerate(rows)}
        ordered = [rows[places[id]] for id in table["id"].tolist()]
        return {
            text: np.fromiter((row[place] for row in ordered), np.object_, len(ordered))
            for text, place in self._places.items()
        }

    def _has(self, formula: Formula) -> bool:
        """Checks whether the statement has all parts of a formula."""
        return all(part.text in self._places for part in formula.sql_parts)

    def close(self) -> None:
        """Drops the prepared statement."""
        if self._statement is not None:
            self._statement.forget()
            self._statement = None

    def _prepare(self) -> None:
        """Makes the statement for all formulas that exist."""
        self._missed = 0
        self.close()
        self._places.clear()
        self._types.clear()
        select = exp.Select()
        for formula in self._formulas:
            for part in formula.sql_parts:
                if part.text not in self._places:
                    self._places[part.text] = len(self._places)
                    select.append("expressions", part.sql.copy())
                    names = {parameter.name for parameter in part.sql.find_all(exp.Parameter)}
                    self._types |= {name: formula.types[name] for name in names}
            schema = formula.schema
        select.append("expressions", exp.column("id", table=ROWS))
        select.from_(exp.table_("entities", db=schema, alias=ROWS), copy=False)
        self._statement = Statement(self._database.plans, select, self._types)
