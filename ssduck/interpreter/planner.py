"""Which plan a query runs by: made once for its types, kept, and made anew when these change."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from ssduck.database.database import Database
from ssduck.database.values import tag_of
from ssduck.errors import ArgumentError, EvaluationError, FunctionError
from ssduck.formatting import short_repr, type_in_words
from ssduck.interpreter.query_runner import PlannedQuery, RowByRowQuery, SqlFailedError, is_small
from ssduck.interpreter.signatures import TypeHints
from ssduck.interpreter.sources import INLINE, all_elements, beside_past, shapes_of
from ssduck.language.analysis import (
    aliases_of,
    is_impure,
    mentions,
    sees_outside,
    states,
)
from ssduck.language.builtins import Function
from ssduck.language.clauses import Selected
from ssduck.language.deferred import LazyList
from ssduck.language.evaluator import EvaluationScope, Frame
from ssduck.language.tree import Call, Name, Node, Placeholder, Query, TimeIndex
from ssduck.limits import Limits
from ssduck.recording.replay.past import PastTicks
from ssduck.schema import MASSES
from ssduck.sql.name_resolution import ResolvedQuery, resolve
from ssduck.sql.plan import Plan, SourceType
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.sql_values import NotSqlError
from ssduck.sql.subqueries import is_inline
from ssduck.sql.table_use import tables_of
from ssduck.sql.translator import NotInlineError, translate
from ssduck.sql.types import Signature, SqlType
from ssduck.world.entities import Entity
from ssduck.world.world import World

# So many queries keep their plans; then all are forgotten and made anew as they are needed.
MOST_PLANS = 500
_UNKNOWN = SqlType("any")


class _SmallError(NotSqlError):
    """A query is quicker row by row.

    Attributes:
        values: those of its sources.
        shapes: what they are.
    """

    def __init__(self, values: list[Any], shapes: tuple[SourceType, ...]) -> None:
        super().__init__()
        self.values = values
        self.shapes = shapes


class FunctionScope(EvaluationScope, Protocol):
    """What a planner needs of the interpreter: a scope that tells of users' functions."""

    def function(self, name: str) -> Function | None:
        """A function by its name."""


class Planner:
    """Runs queries, and keeps their plans.

    Args:
        database: where their SQL runs.
        scope: variables and functions.
        limits: what a query may use.
        row_by_row: whether every query runs row by row in Python.
    """

    def __init__(
        self, database: Database, scope: FunctionScope, limits: Limits, *, row_by_row: bool
    ) -> None:
        self._database = database
        self._scope = scope
        self._limits = limits
        self._row_by_row = row_by_row
        self._plans: dict[Query, list[PlannedQuery]] = {}
        self._rows: dict[Query, list[tuple[tuple[SourceType, ...], RowByRowQuery]]] = {}
        # Nested queries in FROM that must be evaluated before, by the query around them.
        self._evaluated: dict[Query, set[str]] = {}

    def forget(self) -> None:
        """Forget all plans: a function, or what a world is called, has changed."""
        for plans in self._plans.values():
            for planned in plans:
                planned.forget()
        self._plans.clear()
        self._rows.clear()
        self._evaluated.clear()

    def run(self, query: Query, frame: Frame, check: Callable[[Any], None]) -> Selected:
        """What a query selects; the caller holds the worlds.

        Args:
            query: the query.
            frame: what is around it.
            check: is told the columns before the query runs.
        """
        if not self._row_by_row:
            for cautious in (False, True):
                try:
                    return self._run_planned(query, frame, check, cautious=cautious)
                except SqlFailedError:
                    continue
                except _SmallError as error:
                    return self._rows_of(query, error.shapes, frame, check).run(frame, error.values)
                except NotSqlError:
                    break
        return self._run_row_by_row(query, frame, check)

    def spelled(self, query: Query, frame: Frame) -> tuple[ResolvedQuery, list[Sequence[Any]]]:
        """A query, bare names looked up, and the elements of its sources."""
        values = [frame.value(source.value) for source in query.sources]
        values = beside_past(values, frame.own_elements())
        shapes = shapes_of(query, values, self._database.schema_of)
        return resolve(query, shapes, self._typed(frame)), all_elements(values)

    def plan(self, query: Query, frame: Frame) -> Plan | None:
        """The plan that a query would run by; None if it runs row by row."""
        if self._row_by_row:
            return None
        try:
            return self._found(query, frame, self._typed(frame), cautious=False)[0].plan
        except NotSqlError:
            return None

    def written(self, query: Query, frame: Frame) -> tuple[Plan | None, dict[str, Any]]:
        """A query's plan as SQL, and the values of its parameters."""
        typed = self._typed(frame)
        try:
            planned, values = self._found(query, frame, typed, cautious=False, quickest=False)
        except NotSqlError:
            return None, {}
        return planned.plan, planned.parameters(typed.frame(), values)

    def relation(self, query: Query, frame: Frame) -> Any:
        """A relation outside a query: a query of one row, without sources."""
        typed = self._typed(frame)
        planned, _ = self._found(query, frame, typed, cautious=True)
        if planned.plan.left:
            (call,) = query.items
            assert isinstance(call, Call)
            given = [
                frame.given[part.name] for part in call.arguments if isinstance(part, Placeholder)
            ]
            told = ", ".join(
                short_repr(v) if isinstance(v, float) else type_in_words(v) for v in given
            )
            raise ArgumentError(
                f"{call.name} does not take ({told}): {RELATIONS[call.name].usage}", span=query.span
            )
        (row,) = planned.run(typed.frame(), ()).values  # type: ignore[union-attr]
        return row[0]

    # -- as SQL -----------------------------------------------------------------------------

    def _run_planned(
        self, query: Query, frame: Frame, check: Callable[[Any], None], *, cautious: bool
    ) -> Selected:
        typed = self._typed(frame)
        planned, values = self._found(query, frame, typed, cautious=cautious)
        if planned.is_hopeless():
            raise SqlFailedError
        check(planned.columns)
        return planned.run(typed.frame(), values)

    def _typed(self, frame: Frame) -> InterpreterTypes:
        return InterpreterTypes(self._scope, frame, self._database)

    def _found(
        self,
        query: Query,
        frame: Frame,
        typed: InterpreterTypes,
        *,
        cautious: bool,
        quickest: bool = True,
    ) -> tuple[PlannedQuery, list[Any]]:
        """The plan for sources and variables of these types, and the sources' values.

        Raises:
            NotSqlError: the query runs row by row.
        """
        if any(mentions(source.value, states(query)) for source in query.sources):
            raise NotSqlError
        while True:
            elements = frame.own_elements()
            values = beside_past(self._values(query, frame), elements)
            self._check_records(query, values)
            if any(isinstance(value, Entity) and value.moment is not None for value in elements):
                raise NotSqlError  # handles in it go with a row of a query around it
            shapes = shapes_of(query, values, self._database.schema_of)
            if quickest and query.sources and is_small(query, shapes, values):
                raise _SmallError(values, shapes)
            found = self._kept(query, shapes, typed, cautious=cautious)
            if found is not None:
                return found, values
            try:
                plan = translate(query, shapes, typed, cautious=cautious)
            except NotInlineError as error:
                self._evaluated.setdefault(query, set()).add(str(error))
                continue
            return self._keep(query, plan), values

    def _values(self, query: Query, frame: Frame) -> list[Any]:
        evaluated = self._evaluated.get(query, set())
        return [
            INLINE
            if is_inline(source.value)
            and alias not in evaluated
            and not is_impure(source.value)
            and not _sees_rows(source.value)
            else frame.value(source.value)
            for alias, source in zip(aliases_of(query), query.sources, strict=True)
        ]

    def _kept(
        self,
        query: Query,
        shapes: tuple[SourceType, ...],
        typed: InterpreterTypes,
        *,
        cautious: bool,
    ) -> PlannedQuery | None:
        for planned in self._plans.get(query, ()):
            if planned.plan.cautious == cautious and typed.fit(planned.plan, shapes):
                return planned
        return None

    def _keep(self, query: Query, plan: Plan) -> PlannedQuery:
        if sum(map(len, self._plans.values())) >= MOST_PLANS:
            self.forget()
        for signature in plan.signatures:
            function = self._scope.function(signature.function)
            assert function is not None
            self._database.add_function(signature, function)
        planned = PlannedQuery(plan, self._database, self._scope)
        self._plans.setdefault(query, []).append(planned)
        return planned

    def _check_records(self, query: Query, values: Sequence[Any]) -> None:
        """Complain of the past of a world that is recorded for another interpreter, too.

        It is warned of masses that records do not tell.
        """
        weighs = MASSES in tables_of(query)
        for value in values:
            if weighs and isinstance(value, PastTicks):
                value.record.warn_of_masses()
            known = isinstance(value, PastTicks) and value.world in self._database.worlds.values()
            if known and self._database.record_of(value.world) is not value.record:
                raise EvaluationError(
                    f"this past of {value.world.name!r} is of another interpreter's record"
                )

    # -- row by row -------------------------------------------------------------------------

    def _run_row_by_row(self, query: Query, frame: Frame, check: Callable[[Any], None]) -> Selected:
        changed = states(query)
        values = [
            [] if mentions(source.value, changed) else frame.value(source.value)
            for source in query.sources
        ]
        values = beside_past(values, frame.own_elements())
        self._check_records(query, values)
        shapes = shapes_of(query, values, self._database.schema_of)
        return self._rows_of(query, shapes, frame, check).run(frame, values)

    def _rows_of(
        self,
        query: Query,
        shapes: tuple[SourceType, ...],
        frame: Frame,
        check: Callable[[Any], None],
    ) -> RowByRowQuery:
        rows = self._known_rows(query, shapes, frame)
        check(rows.columns)
        return rows

    def _known_rows(
        self, query: Query, shapes: tuple[SourceType, ...], frame: Frame
    ) -> RowByRowQuery:
        typed = self._typed(frame)
        for known, rows in self._rows.get(query, ()):
            if known == shapes and typed.knows(rows.resolved.bare) and typed.defers(rows.deferred):
                return rows
        if sum(map(len, self._rows.values())) >= MOST_PLANS:
            self.forget()
        resolved = resolve(query, shapes, typed)
        names = {part.name for part in query.walk() if isinstance(part, Name)}
        deferred = {name: typed.deferred(name) for name in names}
        of_past = any(shape.moments for shape in shapes)
        rows = RowByRowQuery(
            query, resolved, self._scope, self._limits.depth, deferred, of_past=of_past
        )
        self._rows.setdefault(query, []).append((shapes, rows))
        return rows


def _sees_rows(node: Node) -> bool:
    """Whether a nested query sees rows that are in Python."""
    return isinstance(node, Query) and sees_outside(node)


class InterpreterTypes:
    """What the translator asks: names from the interpreter, types from the values.

    Args:
        scope: variables and functions.
        frame: what is around the query.
        database: knows the schemas of worlds.
    """

    def __init__(self, scope: FunctionScope, frame: Frame, database: Database) -> None:
        self.deepest = database.connection.meter.limits.depth
        self._scope = scope
        self._frame = frame
        self._database = database
        self._values: dict[Node, Any] = dict(frame.kept)
        self._failed: set[Node] = set()
        self.check_call = scope.check_call
        self.meant = scope.meant

    def frame(self) -> Frame:
        """The frame with what was evaluated already, so that it is evaluated once a run."""
        frame = self._frame
        return Frame(
            frame.scope, frame.elements, frame.local, frame.given, frame.columns, self._values
        )

    def has_variable(self, name: str) -> bool:
        """Whether there is a variable of that name."""
        return name in self._frame.local or self._scope.has_variable(name)

    def has_source(self, alias: str) -> bool:
        """Whether a query around this one has a source of that name."""
        return alias in self._frame.elements

    def tag(self, node: Node) -> SqlType:
        """The type of a constant part."""
        if node in self._failed:
            return _UNKNOWN
        if node not in self._values:
            try:
                self._values[node] = self._frame.value(node)
            except (ArgumentError, EvaluationError, FunctionError):
                self._failed.add(node)
                return _UNKNOWN  # it is an error only if a row comes to it
        return tag_of(self._values[node], self._database.schema_of)

    def world(self, node: Node) -> str | None:
        """The schema of the world that a constant part is."""
        if not isinstance(node, Name | TimeIndex):
            return None
        self.tag(node)
        value = self._values.get(node)
        return self._database.schema_of(value) if isinstance(value, World) else None

    def deferred(self, name: str) -> Node | None:
        """The list that a variable holds for the query that uses it."""
        if name in self._frame.local or not self._scope.has_variable(name):
            return None
        value = self._scope.variable(name)
        return value.node if isinstance(value, LazyList) else None

    def signature(self, name: str, arguments: tuple[SqlType, ...]) -> Signature | None:
        """How SQL calls a user's function with such arguments."""
        function = self._scope.function(name)
        if function is None or function.builtin or not isinstance(function.hints, TypeHints):
            return None
        return function.hints.signature(name, arguments)

    def knows(self, bare: dict[str, bool]) -> bool:
        """Whether these names are variables, or not, as they were."""
        return all(self.has_variable(name) == known for name, known in bare.items())

    def defers(self, deferred: Mapping[str, Node | None]) -> bool:
        """Whether these variables hold the lists that they held."""
        return all(self.deferred(name) is node for name, node in deferred.items())

    def fit(self, plan: Plan, shapes: Sequence[SourceType]) -> bool:
        """Whether a plan runs as it is for these sources and the present variables."""
        return (
            plan.shapes == shapes
            and self.knows(plan.bare)
            and self.defers(plan.deferred)
            and all(self.tag(node) == tag for node, tag in plan.constants.items())
            and all(self.world(node) == schema for node, schema in plan.worlds.items())
        )
