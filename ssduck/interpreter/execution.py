"""Runs programs: their statements in order, and the calls outside queries.

If a program fails, its variables are restored, and the error has the place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ssduck import validation
from ssduck.database.database import Database
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    LimitError,
    ProgramWarning,
    SelectScriptError,
    SourceSpan,
    warn,
)
from ssduck.interpreter.lint.linter import Linter
from ssduck.interpreter.namespace import Namespace
from ssduck.interpreter.over_time.evaluator import TemporalEvaluator
from ssduck.interpreter.over_time.expansions import expanded
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS, is_fold, parts_of
from ssduck.interpreter.over_time.live import LiveFolds, copied
from ssduck.interpreter.over_time.nested import NestedExpressions, is_nested
from ssduck.interpreter.over_time.series import TickColumns, TickSeries
from ssduck.interpreter.over_time.why import Explainer
from ssduck.interpreter.planner import Planner
from ssduck.interpreter.sources import check_tick
from ssduck.language import ast
from ssduck.language.analysis import with_overrides
from ssduck.language.clauses import formed
from ssduck.language.evaluation_errors import unknown_function
from ssduck.language.evaluator import Frame
from ssduck.language.intervals import RELATIONS_OF_INTERVALS, are_intervals
from ssduck.language.parser import parse
from ssduck.language.sql_readings import SqlReader
from ssduck.language.value_history import LazyList
from ssduck.limits import Limits, UsageMeter
from ssduck.logic.margins import is_value
from ssduck.logic.why import Why
from ssduck.recording.replay.past import Past, common_moment, pin_to_common_tick
from ssduck.recording.replay.record import Record
from ssduck.sql.explain import explained, in_dialect
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.handles import Handle, Link
from ssduck.world.world import World

# The largest number of probable mistakes of a program that are shown.
MAX_WARNINGS = 20


class Execution(Namespace):
    """Runs programs, and is the scope of their expressions (`EvaluationScope`).

    Args:
        row_by_row: whether every query runs row by row in Python.
        strict: whether a probable mistake is an error.
    """

    def __init__(
        self,
        database: Database,
        limits: Limits,
        value_of_query: Callable[[ast.Query, Frame], Any],
        *,
        row_by_row: bool,
        strict: bool = False,
    ) -> None:
        super().__init__(database, limits)
        self.strict = strict  # whether a probable mistake is an error; it may be set at any time
        # Tells whether another thread has stopped what runs; None if none can.
        self.is_stopped: Callable[[], bool] | None = None
        # The probable mistakes that are collected in place of warnings; None to warn.
        self.doubts: dict[str, None] | None = None
        # The number of probable mistakes of the running program that were not reported before.
        self._new_doubts = 0
        self._value_of_query = value_of_query
        self.linter = Linter(
            self.variable_or_none,
            self.is_function,
            lambda: self.worlds,
            self._recorded_names,
            self.type_of_relation,
            self._finds,
            lambda node: Frame(self).value(node),
        )
        self.planner = Planner(database, self, limits, row_by_row=row_by_row)
        self.temporal = TemporalEvaluator(database.record_of, self._rows)
        self.nested = NestedExpressions(self.temporal.series, self.temporal.names_entities)
        self.folds = LiveFolds(
            self, self.planner, self.tables_read, database.is_recorded, database.record_of
        )
        # The queries of one relation, by its name and the number of its arguments.
        self._relation_queries: dict[tuple[str, int], ast.Query] = {}
        self._program_texts: list[str] = []
        self._stamp: tuple[object, ...] = ()
        self._override_cache: WeakKeyDictionary[ast.Program, ast.Program] = WeakKeyDictionary()
        # Statements as they are written, by what they stand for, if that is another one.
        self._written: WeakKeyDictionary[ast.Node, ast.Node] = WeakKeyDictionary()
        # The stamp of the names for which a statement has no probable mistake.
        self._sound: WeakKeyDictionary[ast.Node, object] = WeakKeyDictionary()
        self._reader = SqlReader(self)

    @contextmanager
    def transaction(self, program: ast.Program) -> Iterator[None]:
        """Restores the variables if anything inside fails, and adds the place to the error."""
        with self.lock:
            if self.is_running:
                self.expire_histories()
            else:
                self.begin_program()
            before = dict(self.variables)
            self._program_texts.append(program.text)
            try:
                yield
            except BaseException as error:
                self.variables = before
                if isinstance(error, SelectScriptError):
                    error.locate(program.text)
                if isinstance(error, RecursionError):
                    raise EvaluationError("the program is nested too deeply") from error
                raise
            finally:
                self._program_texts.pop()
                self._tell_of_more()

    def _tell_of_more(self) -> None:
        """Warns, at the end of a program, of the number of warnings that were not shown."""
        more = self._new_doubts - MAX_WARNINGS
        if more > 0 and not self.is_running:
            self._new_doubts = 0
            warn(f"and {more} more such warnings of this program", ProgramWarning)

    def begin_program(self) -> None:
        """Prepares for a program while none is running; the caller has the lock."""
        self.expire_histories()
        self.drop_unused_worlds()
        self.begin_meter()

    def begin_meter(self) -> None:
        """Measures a new program from now on."""
        self._new_doubts = 0
        self.database.connection.meter = UsageMeter(self.limits, self.is_stopped)

    @property
    def is_running(self) -> bool:
        """Whether a program is running."""
        return bool(self._program_texts)

    def drop_unused_worlds(self) -> None:
        """Drops worlds that programs made and that are no longer used; no program is running."""
        if self.database.sweep():
            self.planner.forget()

    @property
    def meaning(self) -> tuple[object, ...]:
        """Objects that are replaced when anything but variables gives programs another meaning."""
        return self.planner.generation, self.strict

    @property
    def stamp(self) -> tuple[object, ...]:
        """The same object as long as no variable is bound, and `meaning` is the same."""
        stamp = (self.variables.version, *self.meaning)
        if stamp != self._stamp:
            self._stamp = stamp
        return self._stamp

    def forget_plans(self) -> None:
        """Forgets what was derived from the names of functions."""
        self.planner.forget()
        self._override_cache.clear()

    def _with_overrides(self, program: ast.Program) -> ast.Program:
        """Returns the program with users' functions in the place of those they override.

        It has expressions in place of the functions that stand for these.
        """
        overridden = self._override_cache.get(program)
        if overridden is None:
            overridden = with_overrides(program, self.overrides) if self.overrides else program
            nodes = tuple(map(self.expanded, overridden.statements))
            pairs = zip(nodes, overridden.statements, strict=True)
            self._written.update(pair for pair in pairs if pair[0] is not pair[1])
            overridden = replace(overridden, statements=nodes)
            self._override_cache[program] = overridden
        return overridden

    def expanded(self, node: ast.Node) -> ast.Node:
        """Returns a part with expressions in place of the functions that stand for these."""
        return expanded(node, self.check_call)

    def read(self, program: ast.Program) -> ast.Program:
        """Returns a program as the present variables and functions give it its meaning."""
        return self._with_overrides(self._reader.read(program))

    def run(self, program: ast.Program) -> Any:
        """Returns the value of a program, or its explanation."""
        if program.explain:
            return self.explanation(program)
        return self._value_of(program, Frame(self))

    def _value_of(self, program: ast.Program, frame: Frame) -> Any:
        """Returns the value of the last statement."""
        value = None
        for node in self._linted_statements(program, frame):
            self.meter.step()
            value = frame.value(node)
        return value

    def _linted_statements(self, program: ast.Program, frame: Frame) -> Iterator[ast.Node]:
        """Yields the statements of a program, after reporting probable mistakes in each."""
        program = self._reader.read(program, frame.local)
        if program.suspicions:
            self.report(
                ArgumentError(d.message, text=program.text, span=d.span) for d in program.suspicions
            )
        for node in self._with_overrides(program).statements:
            stamp = self.stamp
            if self._sound.get(node) is not stamp:
                mistakes = self.mistakes(program.text, node, frame.local)
                self.report(mistakes)
                if not mistakes:
                    self._sound[node] = stamp
            yield node

    def mistakes(
        self, text: str, node: ast.Node, local: Mapping[str, Any] = MappingProxyType({})
    ) -> list[SelectScriptError]:
        """Returns the probable mistakes in a statement of a program, as errors."""
        return self.linter.check(text, self._written.get(node, node), local)

    def report(self, suspicions: Iterable[SelectScriptError]) -> None:
        """Warns of probable mistakes, once of each, or collects them in `doubts`: of the first."""
        for suspicion in suspicions:
            if self.strict:
                raise suspicion
            if self.doubts is not None:
                if len(self.doubts) < MAX_WARNINGS:
                    self.doubts.setdefault(str(suspicion))
            elif self.linter.is_new(suspicion):
                self._new_doubts += 1
                if self._new_doubts <= MAX_WARNINGS:
                    warn(str(suspicion), ProgramWarning)

    def _finds(self, query: ast.Query) -> bool | None:
        """Checks whether a query has a row; None if it fails."""
        try:
            return bool(self._value_of_query(query, Frame(self)))
        except LimitError:
            raise
        except SelectScriptError:
            return None

    def _recorded_names(self, world: World) -> set[str]:
        """Returns the names of all entities in the record of a world."""
        try:
            members = self.database.record_of(world).members
        except SelectScriptError:  # it is not recorded
            return set()
        return {member.name for member in members.values()}

    # -- explanations ------------------------------------------------------------------------

    def explanation(self, program: ast.Program) -> str:
        """Returns the SQL of the last statement's queries, and what Python evaluates.

        Of a program that begins with WHY, the reasons for its value.
        """
        if program.explain == "WHY":
            return str(self.why(program))
        program = self._reader.read(program)
        with self.rehearsal(program) as frame:
            program = self._with_overrides(program)
            plan_of = partial(self.planner.plan, frame=frame)
            stand_ins = {
                name: [m.name for m in world.snapshot.entities if m.body and m.body.has_stand_ins]
                for name, world in self.database.worlds.items()
            }
            return "\n\n".join(
                explained(program.text, statement, plan_of, stand_ins)
                for statement in program.statements[-1:]
            )

    def why(self, program: ast.Program) -> Why:
        """Returns why the condition that ends a program has its value, or its query its rows."""

        def record_of(call: ast.Call, frame: Frame) -> Record:
            return self.database.record_of(self.temporal.world_of(call, frame))

        with self.rehearsal(program) as frame:
            nodes = self.read(program).statements
            value = frame.value(nodes[-1]) if nodes and isinstance(nodes[-1], ast.Name) else None
            is_known = validation.is_number(value) or isinstance(value, str | list)
            if not nodes or is_value(nodes[-1]) or is_known:
                raise ArgumentError("WHY takes a condition, such as WHY on(table, cup);")
            resolved, written = self.planner.resolved_parts, self._written.get(nodes[-1], nodes[-1])
            explainer = Explainer(
                program.text, frame, self.nested, record_of, resolved, self.expanded
            )
            return explainer.why(written)

    def sql_of(self, program: ast.Program, dialect: str) -> str:
        """Returns the SQL of the query that ends a program, in a dialect."""
        with self.transaction(program), self.rehearsal(program) as frame:
            program = self.read(program)
            query = program.statements[-1] if program.statements else None
            if not isinstance(query, ast.Query):
                raise ArgumentError("the program does not end with a query")
            plan, values = self.planner.sql_plan(query, frame)
            return in_dialect(query, plan, values, dialect)

    @contextmanager
    def rehearsal(self, program: ast.Program) -> Iterator[Frame]:
        """Runs all statements but the last, yields their frame, and restores the variables."""
        before = dict(self.variables)
        frame = Frame(self)
        try:
            for number, statement in enumerate(self._linted_statements(program, frame), 1):
                if number < len(program.statements):
                    frame.value(statement)
            with self.worlds_pinned(*self.read(program).statements[-1:]):
                yield frame
        finally:
            self.variables = before

    # -- calls outside queries ---------------------------------------------------------------

    def call(self, node: ast.Call, arguments: list[Any], frame: Frame) -> Any:
        """Returns the value of a function call outside SQL."""
        function = self.function(node.name)
        if function is None:
            if node.name in RELATIONS_OF_INTERVALS and are_intervals(arguments):
                return RELATIONS_OF_INTERVALS[node.name].function(arguments)
            if node.name in RELATIONS:
                return self._relation(node, arguments, frame)
            raise unknown_function(node, self.known_functions())
        if node.name == "eval":
            return self._run_text(arguments[0], frame)
        values = arguments if function.builtin else self.at_tick_of_rows(arguments, frame)
        return None if values is None else function(values)

    def at_tick_of_rows(self, arguments: list[Any], frame: Frame) -> list[Any] | None:
        """Returns values, entities at the tick of the rows; None if one was not there then."""
        rows = frame.own_elements()
        if not any(isinstance(row, Handle) and row.moment is not None for row in rows):
            return arguments
        pinned = pin_to_common_tick(arguments, rows)
        if pinned is None:
            return None
        return [
            self.at_tick_of_rows(value, frame) if type(value) is list else value for value in pinned
        ]

    def over_time(self, node: ast.Call, frame: Frame) -> Any:
        """Returns the value of a call whose argument is evaluated at each recorded tick."""
        found = self.nested.at_row(node, frame, partial(self._record_of, node, frame))
        if found is not None:
            return copied(found[0])
        form = TEMPORAL_FUNCTIONS[node.name]
        other = None if form.operator else parts_of(node)[1]
        age = None if other is None else frame.value(other)
        age = None if age is None else validation.seconds(age)

        def of_record(series: TickSeries) -> Any:
            if form.make is None:
                return self.nested.verdict(node, series.record, frame)
            return form.make(series, age)

        series = partial(self.series, node, frame)
        is_kept = is_fold(node, at_first=True) and self.temporal.reader is None
        folds = is_kept and self.folds.takes(node, frame)
        with self.worlds_pinned(node, is_settled=not (folds and self.folds.need_no_tables(node))):
            if not folds:
                return of_record(series())
            fold = form.fold or self.nested.fold(node, frame, lambda: series().record)
            return self.folds.value(node, fold, series, of_record)

    def _record_of(self, node: ast.Call, frame: Frame) -> Record:
        """Returns the record of the entities in the expressions of a call of such a function."""
        return self.database.record_of(self.temporal.world_of(node, frame))

    def series(self, node: ast.Call, frame: Frame) -> TickSeries:
        """Returns the values of the expression in such a call; the caller pins the worlds.

        Of an operator, it is that of its first one.
        """
        expression, _ = parts_of(node)
        if TEMPORAL_FUNCTIONS[node.name].operator is None and not is_nested(expression):
            return self.temporal.series(node, frame)
        record = self._record_of(node, frame)
        moment = common_moment(record.world, (), frame.own_elements())

        def columns(past: Past) -> TickColumns:
            of_all = self.nested.columns(expression, record, frame)
            return of_all.between(past.first, past.last)

        now = None if moment is None else moment.tick
        return TickSeries(record, columns, expression, None, now)

    def _rows(self, query: ast.Query, placeholders: dict[str, Any]) -> Sequence[Sequence[Any]]:
        """Returns the rows of a query of the values of an expression at ticks."""
        frame = Frame(self, placeholders=placeholders)
        selected = self.planner.run(query, frame, lambda _: None)  # any columns
        fetched: Sequence[Sequence[Any]] = formed(selected, lambda part: part.values)
        return fetched

    def _run_text(self, text: Any, frame: Frame) -> Any:
        """Returns the value of a program in a text; it sees the rows around the call of `eval`."""
        if not self.limits.eval:
            raise LimitError("eval is switched off here")
        validation.text(text, "eval takes a text")
        self._program_texts.append(text)
        try:
            program = parse(text)
            if program.explain:
                return self.explanation(program)
            return self._value_of(program, frame)
        except SelectScriptError as error:
            error.locate(text)
            raise
        finally:
            self._program_texts.pop()

    def _relation(self, node: ast.Call, values: list[Any], frame: Frame) -> Any:
        """Returns the value of a relation outside a query, by a query of one row."""
        key = node.name, len(node.arguments)
        if key not in self._relation_queries:
            # It is in no text: its parts are told apart by their places, 0 of the call itself.
            whole, *places = (SourceSpan(place, place) for place in range(key[1] + 1))
            names = tuple(ast.Placeholder(span, f"argument_{i}") for i, span in enumerate(places))
            call = ast.Call(whole, node.name, names, whole)
            self._relation_queries[key] = ast.Query(whole, (call,), ())
        values = [value.tolist() if _is_vector(value) else value for value in values]
        pinned = pin_to_common_tick(values, frame.own_elements())
        if pinned is None:
            return None
        values_by_name = {f"argument_{index}": value for index, value in enumerate(pinned)}
        worlds = [value.world for value in values if isinstance(value, Handle)]
        check_tick(node, pinned)
        tables = RELATIONS[node.name].inputs
        if any(isinstance(value, Link) for value in values):
            tables |= {"links"}
        with self.database.pinned(tables, worlds):
            for argument, value in zip(node.arguments, pinned, strict=True):
                if isinstance(value, Handle) and not value.is_there:
                    error = value.removed()
                    error.span = argument.span
                    raise error
                moment = value.moment if isinstance(value, Handle) else None
                if moment is not None:
                    moment.record.warn_of_missing(tables)
            try:
                query = self._relation_queries[key]
                return self.planner.relation(query, Frame(self, placeholders=values_by_name))
            except SelectScriptError as error:
                spans = node.span, *(argument.span for argument in node.arguments)
                error.span = spans[0 if error.span is None else error.span.start]
                raise

    # -- the rest of the scope (`EvaluationScope`) -------------------------------------------

    def query(self, node: ast.Query, frame: Frame) -> Any:
        """Returns the value of a query; `frame` holds the rows of the queries around it."""
        return self._value_of_query(node, frame)

    def deferred(self, node: ast.Node) -> LazyList:
        """Returns a list of the running program, to be evaluated by the query that uses it."""
        return LazyList(node, self._program_texts[-1])

    @property
    def meter(self) -> UsageMeter:
        """The use of the running program's limits."""
        return self.database.connection.meter

    def worlds_pinned(
        self, *nodes: ast.Node, is_settled: bool = True
    ) -> AbstractContextManager[None]:
        """Pins all worlds at their tick, and reads the tables of relations."""
        tables: frozenset[str] = frozenset().union(*map(self.tables_read, nodes))
        # Which worlds are read matters for their tables, and for stale ticks of users' clients.
        is_relevant = tables or self.database.has_attached_world
        worlds = self.worlds_of(nodes) if is_relevant else ()
        return self.database.pinned(tables, worlds, is_settled=is_settled)


def _is_vector(value: Any) -> bool:
    """Checks whether a value is an array of numbers, which relations take as a list."""
    return isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "iuf"
