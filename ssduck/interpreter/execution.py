"""Running programs: their statements in order, and the calls that are outside queries.

A program that fails leaves the variables as they were, and its error says where it failed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

from ssduck import validation
from ssduck.database.database import Database
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    LimitError,
    ProgramWarning,
    SelectScriptError,
    warn,
)
from ssduck.interpreter.linter import Linter
from ssduck.interpreter.namespace import Namespace
from ssduck.interpreter.planner import Planner
from ssduck.interpreter.temporal_functions import FORMS, TemporalEvaluator
from ssduck.language.clauses import formed
from ssduck.language.deferred import LazyList
from ssduck.language.evaluator import Frame
from ssduck.language.intervals import RELATIONS_OF_INTERVALS, are_intervals
from ssduck.language.overrides import meant
from ssduck.language.parser import parse
from ssduck.language.tree import Call, Node, Placeholder, Program, Query
from ssduck.limits import Limits, UsageMeter
from ssduck.recording.replay.past import together as entities_together
from ssduck.schema import MASSES
from ssduck.sql.dialects import in_dialect
from ssduck.sql.explain import told
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.translator import unknown_function
from ssduck.world.entities import Entity
from ssduck.world.world import World


class Execution(Namespace, ABC):
    """Programs that run, with what their expressions see (`EvaluationScope`).

    Args:
        database: where queries run.
        limits: what programs may use.
        row_by_row: whether every query runs row by row in Python.
        strict: whether what is probably a mistake is an error.

    Attributes:
        strict: as given; it may be set at any time.
    """

    def __init__(
        self, database: Database, limits: Limits, *, row_by_row: bool, strict: bool = False
    ) -> None:
        super().__init__(database)
        self.strict = strict
        self._doubts = Linter(
            self._value_or_none, self.is_function, lambda: self.worlds, self._recorded_names
        )
        self._limits = limits
        self._planner = Planner(database, self, limits, row_by_row=row_by_row)
        self._over_time = TemporalEvaluator()
        self._relations: WeakKeyDictionary[Call, Query] = WeakKeyDictionary()
        self._texts: list[str] = []
        self._meant: WeakKeyDictionary[Program, Program] = WeakKeyDictionary()

    @contextmanager
    def _running(self, program: Program) -> Iterator[None]:
        """Whatever fails in here leaves the variables as they were, and says where it failed."""
        with self._lock:
            self._forget()
            before = dict(self._variables)
            outermost = not self._texts
            if outermost:
                self._sweep()
                self._database.connection.meter = UsageMeter(self._limits)
            self._texts.append(program.text)
            try:
                yield
            except BaseException as error:
                self._variables = before
                if isinstance(error, SelectScriptError):
                    error.locate(program.text)
                if isinstance(error, RecursionError):
                    raise EvaluationError("the program is nested too deeply") from error
                raise
            finally:
                self._texts.pop()

    def _sweep(self) -> None:
        """Let go of worlds that programs made and nobody has any more; none is running."""
        if self._database.sweep():
            self._planner.forget()

    def _functions_changed(self) -> None:
        """What names of functions mean is looked up anew."""
        self._planner.forget()
        self._meant.clear()

    def _as_meant(self, program: Program) -> Program:
        """A program with users' functions where they replace something of the language."""
        if not self._replaced:
            return program
        found = self._meant.get(program)
        if found is None:
            found = self._meant[program] = meant(program, self._replaced)
        return found

    def _run(self, program: Program) -> Any:
        if program.explain:
            return self._explained(program)
        return self._valued(program, Frame(self))

    def _valued(self, program: Program, frame: Frame) -> Any:
        value = None
        for node in self._looked_at(program, frame):
            self.meter.step()
            value = frame.value(node)
        return value

    def _looked_at(self, program: Program, frame: Frame) -> Iterator[Node]:
        """The statements of a program, each with what is told of it before."""
        if program.doubts:
            self._tell(
                ArgumentError(d.message, text=program.text, span=d.span) for d in program.doubts
            )
        for node in self._as_meant(program).statements:
            self._tell(self._doubts.found(program.text, node, frame.local))
            yield node

    def _tell(self, doubts: Iterable[SelectScriptError]) -> None:
        """Warn of what is probably a mistake, once; in strict interpreters it is an error."""
        for doubt in doubts:
            if self.strict:
                raise doubt
            if self._doubts.is_new(doubt):
                warn(str(doubt), ProgramWarning)

    def _recorded_names(self, world: World) -> set[str]:
        """The names of all entities that are kept of a world."""
        try:
            members = self._database.record_of(world).members
        except SelectScriptError:  # nothing is kept of it
            return set()
        return {member.name for member in members.values()}

    # -- what a program becomes -------------------------------------------------------------

    def _explained(self, program: Program) -> str:
        with self._rehearsed(program) as frame:
            program = self._as_meant(program)
            plan_of = partial(self._planner.plan, frame=frame)
            stand_ins = {
                name: [m.name for m in world.snapshot.members if m.body and m.body.has_stand_ins]
                for name, world in self._database.worlds.items()
            }
            return "\n\n".join(
                told(program.text, statement, plan_of, stand_ins)
                for statement in program.statements[-1:]
            )

    def _sql_of(self, program: Program, dialect: str) -> str:
        with self._running(program), self._rehearsed(program) as frame:
            program = self._as_meant(program)
            query = program.statements[-1] if program.statements else None
            if not isinstance(query, Query):
                raise ArgumentError("the program does not end with a query")
            plan, values = self._planner.written(query, frame)
            return in_dialect(query, plan, values, dialect)

    @contextmanager
    def _rehearsed(self, program: Program) -> Iterator[Frame]:
        """Run all statements but the last, for the variables that it sees, and undo them."""
        before = dict(self._variables)
        frame = Frame(self)
        try:
            for number, statement in enumerate(self._looked_at(program, frame), 1):
                if number < len(program.statements):
                    frame.value(statement)
            with self._reading(*self._as_meant(program).statements[-1:]):
                yield frame
        finally:
            self._variables = before

    # -- calls outside queries ---------------------------------------------------------------

    def call(self, node: Call, arguments: list[Any], frame: Frame) -> Any:
        """The value of a function call outside SQL."""
        function = self.function(node.name)
        if function is None:
            if node.name in RELATIONS_OF_INTERVALS and are_intervals(arguments):
                return RELATIONS_OF_INTERVALS[node.name].function(arguments)
            if node.name in RELATIONS:
                return self._relation(node, arguments, frame)
            raise unknown_function(node, self._known_functions())
        if node.name == "eval":
            return self._run_text(arguments[0], frame)
        return function(arguments)

    def over_time(self, node: Call, frame: Frame) -> Any:
        """The value of a call whose argument is evaluated at each recorded tick."""
        age = frame.value(node.arguments[1]) if len(node.arguments) > 1 else None

        def rows(query: Query, given: dict[str, Any]) -> list[list[Any]]:
            found = self._planner.run(query, Frame(self, given=given), _unchecked)
            listed: list[list[Any]] = formed(found, lambda part: list(map(list, part.values)))
            return listed

        with self._reading(node):
            series = self._over_time.series(node, frame, self._database.record_of, rows)
            return FORMS[node.name].make(series, None if age is None else validation.seconds(age))

    def _run_text(self, text: Any, frame: Frame) -> Any:
        """The value of a text in the scope of a frame: it sees the rows that it stands in."""
        if not self._limits.eval:
            raise LimitError("eval is switched off here")
        validation.text(text, "eval takes a text")
        self._texts.append(text)
        try:
            program = parse(text)
            if program.explain:
                return self._explained(program)
            return self._valued(program, frame)
        except SelectScriptError as error:
            error.locate(text)
            raise
        finally:
            self._texts.pop()

    def _relation(self, node: Call, values: list[Any], frame: Frame) -> Any:
        """A relation outside a query: a query of one row, without sources."""
        query = self._relations.get(node)
        if query is None:
            names = [Placeholder(n.span, f"argument_{i}") for i, n in enumerate(node.arguments)]
            asked = Call(node.span, node.name, tuple(names), node.name_span)
            query = self._relations[node] = Query(node.span, (asked,), ())
        together = entities_together(values, frame.own_elements())
        if together is None:
            return None
        given = {f"argument_{index}": value for index, value in enumerate(together)}
        worlds = [value.world for value in values if isinstance(value, Entity)]
        with self._database.held(RELATIONS[node.name].inputs, worlds):
            for argument, value in zip(node.arguments, together, strict=True):
                if isinstance(value, Entity) and not value.is_there:
                    error = value.removed()
                    error.span = argument.span
                    raise error
                moment = value.moment if isinstance(value, Entity) else None
                if moment is not None and MASSES in RELATIONS[node.name].inputs:
                    moment.record.warn_of_masses()
            return self._planner.relation(query, Frame(self, given=given))

    # -- what else expressions see -----------------------------------------------------------

    @abstractmethod
    def query(self, node: Query, frame: Frame) -> Any:
        """The value of a query; `frame` knows the rows of the queries around it."""

    def deferred(self, node: Node) -> LazyList:
        """A list of the running program for the query that uses it."""
        return LazyList(node, self._texts[-1])

    @property
    def meter(self) -> UsageMeter:
        """How much of its limits the running program has used."""
        return self._database.connection.meter

    @contextmanager
    def _reading(self, *nodes: Node) -> Iterator[None]:
        """Hold all worlds at their tick, with the tables read that relations look things up in."""
        tables = frozenset().union(*map(self._tables_of, nodes))
        with self._database.held(tables, self._worlds_of(nodes) if tables else ()):
            yield


def _unchecked(_: object) -> None:
    """Columns of one name are no trouble."""
