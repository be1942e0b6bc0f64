"""Evaluates the formulas of many triggers at a tick: with numpy, and with one statement."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple, Protocol, TypeAlias
from weakref import WeakKeyDictionary, WeakSet

import numpy as np
import numpy.typing as npt
from sqlglot import exp

from ssduck.database.database import Database
from ssduck.database.statement import Statement
from ssduck.errors import SelectScriptError
from ssduck.interpreter.triggers.array_expressions import (
    ArrayExpression,
    NotArraysError,
    Number,
    TickArrays,
)
from ssduck.interpreter.triggers.formulas import ROWS, Formula, Part, SqlExpression
from ssduck.world.live_tables import LiveTable
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World

# A statement is made anew when a quarter of its formulas have been evaluated without it since.
_SHARE = 4
# For fewer formulas, one statement for all is no faster than one for each.
_FEW = 2

Values: TypeAlias = npt.NDArray[Any] | list[Any]


class Outcome(NamedTuple):
    """The rows of a formula at a tick.

    Attributes:
        tick: the number of the tick.
        mask: whether each entity fulfils the condition.
        arrays: the columns of the entities.
        changing: the columns that may differ at the next tick, for the entities that fulfil the
            condition.
        fingerprint: a key that is the same at two ticks only if all rows are, bit for bit.
    """

    tick: int
    mask: npt.NDArray[np.bool_]
    arrays: TickArrays
    changing: list[Values]
    fingerprint: tuple[Any, ...]

    def rows(self, formula: Formula) -> list[tuple[Any, ...]]:
        """Returns the rows that the formula's SQL would return."""
        if not formula.columns:
            return [()] * int(self.mask.sum())
        changing = iter(self.changing)
        columns = [
            part.values(self.arrays)[self.mask]
            if isinstance(part, ArrayExpression) and part.is_fixed
            else next(changing)
            for part in formula.columns
        ]
        lists = [column if isinstance(column, list) else column.tolist() for column in columns]
        return list(zip(*lists, strict=True))[formula.window]


def _selected(column: Values, mask: npt.NDArray[np.bool_]) -> Values:
    """Returns the values of the entities that fulfil a condition."""
    if isinstance(column, list):
        return [column[row] for row in np.flatnonzero(mask).tolist()]
    return column[mask]


def _bits(values: Values) -> Any:
    """Returns a key of values that tells 0.0 from -0.0."""
    if not isinstance(values, list):
        return values.tobytes()
    if all(type(value) is float for value in values):
        return array("d", values).tobytes()
    return repr(values)


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

    def outcomes(self, world: World, formulas: Sequence[Formula]) -> dict[Formula, Outcome]:
        """Returns the rows of formulas at the tick of their world.

        Formulas that are missing in the result have to be evaluated by themselves.

        Args:
            world: the world.
            formulas: formulas over this world.
        """
        batch = self._by_world.get(world)
        if batch is None:
            batch = self._by_world[world] = _FormulaBatch(self._session.database)
        self._session.begin_program()
        tables = frozenset().union(*(formula.tables for formula in formulas))
        with self._session.database.pinned(tables, [world]), np.errstate(all="ignore"):
            return batch.outcomes(world.snapshot, formulas)


class _FormulaBatch:
    """The formulas over the entities of one world."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._parameters: dict[str, float] = {}
        self._arrays: TickArrays | None = None
        # The formulas with parts that DuckDB evaluates, and the columns of their statement.
        self._in_sql: WeakSet[Formula] = WeakSet()
        self._statement: Statement | None = None
        self._types: dict[str, Number] = {}
        self._places: dict[str, int] = {}
        self._missed = 0
        self._failed: WeakSet[Formula] = WeakSet()

    def outcomes(self, snapshot: Snapshot, formulas: Sequence[Formula]) -> dict[Formula, Outcome]:
        """Returns the rows of formulas at a tick; see `FormulaBatches.outcomes`."""
        table = snapshot.tables["entities"]
        if not table.is_complete:
            return {}  # numpy would take an unknown number for NaN
        self._read_parameters(snapshot, table, formulas)
        if self._arrays is None or self._arrays.table is not table:
            self._arrays = TickArrays(table, self._parameters)
        self._arrays.update()
        in_sql = [f for f in formulas if f.sql_parts and f not in self._failed]
        fetched = self._fetched(table, in_sql) if len(in_sql) >= _FEW else None
        outcomes = {}
        for formula in formulas:
            if not formula.sql_parts or (fetched is not None and self._has(formula)):
                with suppress(NotArraysError):  # DuckDB evaluates it
                    outcomes[formula] = self._outcome(
                        snapshot.number, self._arrays, formula, fetched
                    )
        return outcomes

    def _read_parameters(
        self, snapshot: Snapshot, table: LiveTable, formulas: Sequence[Formula]
    ) -> None:
        """Reads the values of the formulas' parameters at the tick."""
        values = self._parameters
        values.clear()
        for formula in formulas:
            if not formula.types:
                continue
            values.update(formula.constants)
            for name, (entity, column) in formula.entity_columns.items():
                if name not in values:
                    values[name] = table[column][snapshot.rows[entity.id]].item()

    def _outcome(
        self,
        tick: int,
        arrays: TickArrays,
        formula: Formula,
        fetched: list[list[Any]] | None,
    ) -> Outcome:
        """Returns the rows of a formula at a tick, as copies."""
        if formula.condition is None:
            mask = np.ones(arrays.table.count, dtype=np.bool_)
        else:
            mask = self._values(formula.condition, arrays, fetched)
        changing = [
            _selected(self._values(part, arrays, fetched), mask) for part in formula.changing
        ]
        fingerprint = (arrays.table.version, mask.tobytes(), *map(_bits, changing))
        return Outcome(tick, mask, arrays, changing, fingerprint)

    def _values(self, part: Part, arrays: TickArrays, fetched: list[list[Any]] | None) -> Any:
        """Returns the values of an expression for all entities; of a condition, an array."""
        if isinstance(part, SqlExpression):
            assert fetched is not None
            values = fetched[self._places[part.text]]
            # A condition that is NULL does not hold.
            return np.array(values, dtype=np.bool_) if part.is_condition else values
        result = part.values(arrays)
        if isinstance(result, np.ndarray) and result.ndim:
            return result
        return np.broadcast_to(np.asarray(result), arrays.table.count)

    # -- the statement -----------------------------------------------------------------------

    def _has(self, formula: Formula) -> bool:
        """Checks whether the statement has all parts of a formula."""
        return all(part.text in self._places for part in formula.sql_parts)

    def _fetched(self, table: LiveTable, formulas: Sequence[Formula]) -> list[list[Any]] | None:
        """Returns the columns of the statement, in the order of the table's rows; None for none."""
        self._in_sql.update(formulas)
        self._missed += sum(not self._has(formula) for formula in formulas)
        if self._missed * _SHARE >= len(self._in_sql):
            self._prepare()
        if self._statement is None or sum(map(self._has, formulas)) < _FEW:
            return None
        values = {name: self._parameters.get(name, 0) for name in self._types}
        try:
            rows = self._statement.rows(values)
        except SelectScriptError:  # evaluated by itself, each gives its result or its error
            self._failed.update(formulas)
            return None
        places = {row[-1]: number for number, row in enumerate(rows)}
        ordered = [rows[places[id]] for id in table["id"].tolist()]
        return list(map(list, zip(*ordered, strict=True)))

    def _prepare(self) -> None:
        """Makes the statement for all formulas that exist."""
        self._missed = 0
        if self._statement is not None:
            self._statement.forget()
            self._statement = None
        self._places.clear()
        self._types.clear()
        select = exp.Select()
        for formula in self._in_sql:
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
