"""`Interpreter`: variables, functions, running programs and raw SQL.

A program's statements run in order; its value is that of the last one. A program that fails
leaves the variables as they were. A query is translated once per text and types
(`ssduck.sql.translator`), runs as one SQL statement on one tick of each world, and what is left of
it is evaluated in Python on the rows that come back (`ssduck.interpreter.query_runner`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self
from weakref import WeakKeyDictionary

from ssduck import validation
from ssduck.adapters.registry import Adapter, find
from ssduck.adapters.result import Result
from ssduck.adapters.table_view import MOST_ROWS, TableView
from ssduck.database.database import Database
from ssduck.errors import UnknownNameError
from ssduck.geometry.queries import Statistics
from ssduck.interpreter.eval_as import (
    Condition,
    EvalAsMethods,
    QueryPart,
    SelectedColumns,
    SourceElements,
    takes_results,
)
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.namespace import check_name
from ssduck.interpreter.output import AsClause, form_of
from ssduck.interpreter.program import CompiledProgram, tree_of
from ssduck.interpreter.recording import RecordingMethods
from ssduck.interpreter.signatures import hints_of
from ssduck.interpreter.triggers.registry import TriggerMethods, TriggerRegistry
from ssduck.language.analysis import aliases_of, sees_outside
from ssduck.language.builtins import Function
from ssduck.language.evaluator import Frame
from ssduck.language.overrides import NAMED
from ssduck.language.parser import parse
from ssduck.language.tree import Query
from ssduck.language.value_keys import plain
from ssduck.limits import Limits, UsageMeter
from ssduck.recording.spec import Recording
from ssduck.world.running import run
from ssduck.world.world import World

# Seconds of simulated time whose ticks are kept in memory, if nothing else is asked for.
KEPT = 60.0


class Interpreter(Execution, RecordingMethods, TriggerMethods, EvalAsMethods):
    """Runs SelectScript programs and raw SQL on worlds.

    Args:
        database: a DuckDB file, or `":memory:"`.
        tracer: is told each SQL statement before it runs.
        limits: what programs and SQL may use; for what comes from elsewhere,
            `Limits.strict()`.
        row_by_row: whether every query runs row by row in Python, to compare with.
        strict: whether what is probably a mistake in a program (a name that no entity bears, a
            variable that hides a function) is an error, and no `ProgramWarning`. The attribute
            of that name may be set at any time.
        recording: what is kept of the ticks of each world, None for nothing; by default the
            entities at each tick, in memory those of the last 60 s, in a file all of them. See
            `record`.
    """

    def __init__(
        self,
        database: str | Path = ":memory:",
        *,
        tracer: Callable[[str], None] | None = None,
        limits: Limits | None = None,
        row_by_row: bool = False,
        strict: bool = False,
        recording: Recording | Literal["default"] | None = "default",
    ) -> None:
        row_by_row = validation.boolean(row_by_row, "Interpreter: row_by_row")
        strict = validation.boolean(strict, "Interpreter: strict")
        validation.instance(limits, Limits, "Interpreter: limits")
        database = validation.path(database, "Interpreter: database")
        if recording == "default":
            recording = Recording(seconds=KEPT) if database == ":memory:" else Recording()
        validation.instance(recording, Recording, "Interpreter: recording")
        limits = limits or Limits()
        super().__init__(
            Database(database, tracer, limits, recording),
            limits,
            row_by_row=row_by_row,
            strict=strict,
        )
        self._own: list[World] = []
        self._selects: WeakKeyDictionary[Query, dict[Adapter, Query]] = WeakKeyDictionary()
        self._triggers = TriggerRegistry(self)

    def close(self) -> None:
        """End the triggers, close the database and the world that `load` made; yours stay open."""
        self._triggers.close()
        for world in self._own:
            world.close()
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- programs -------------------------------------------------------------------------

    def compile(self, text: str) -> CompiledProgram:
        """Parse a program; running the result again parses nothing.

        Raises:
            ParseError: with the place of the first thing that is wrong.
        """
        return CompiledProgram(text, parse(text), self._sql_of)

    def eval(
        self,
        program: str | CompiledProgram | QueryPart | SelectedColumns,
        elements: Sequence[Any] = (),
        names: Sequence[str] = (),
    ) -> Any:
        """Run a program.

        Args:
            program: its text, or what `compile` gave; or a part of a query that `evalAs` was given.
            elements: of such a part's row, one a source,
            names: and what the sources are called.

        Returns:
            The value of the last statement, None if there is none.

        Raises:
            SelectScriptError: with the place; the variables are as they were before.
        """
        if isinstance(program, QueryPart | SelectedColumns):
            return program.value(elements, names)
        compiled = tree_of(program)
        with self._running(compiled):
            return self._run(compiled)

    def show(self, program: str | CompiledProgram, rows: int = MOST_ROWS) -> TableView:
        """What a program gives, as a table to be looked at: in a terminal, in a notebook.

        Args:
            program: its text, or what `compile` gave.
            rows: how many are shown at most.

        Raises:
            SelectScriptError: as `eval` does.
        """
        rows = validation.integer(rows, "show: rows", minimum=0)
        return TableView(self.eval(program), rows)

    def explain(self, program: str | CompiledProgram) -> str:
        """The SQL of the queries in a program's last statement, and what is left to Python.

        The statements before it are run for their variables, which are then as before.

        Raises:
            SelectScriptError: as `eval` does.
        """
        compiled = tree_of(program)
        with self._running(compiled):
            return self._explained(compiled)

    # -- variables and functions ----------------------------------------------------------

    def add_variable(self, name: str, value: Any) -> Any:
        """Bind a value to a name; a world's tables become the schema of that name.

        numpy's numbers become Python's; a list or a dict with some in it is copied for that.

        Returns:
            The value.

        Raises:
            ArgumentError: the name cannot be a variable's, or a schema's.
        """
        check_name(name, "a variable")
        with self._lock:
            if isinstance(value, World):
                self._database.bind(name, value)
                self._planner.forget()
                self._forget()  # the time may be an earlier one now
            self._variables[name] = _plain(value)
        if isinstance(value, World):
            self._triggers.rebound()
        return value

    def call_variable(self, name: str) -> Any:
        """The value of a variable.

        Raises:
            UnknownNameError: there is none, with the nearest names.
        """
        return self.variable(name)

    def add_function(
        self, name: str, function: Callable[..., Any], help: str | None = None
    ) -> None:
        """Make a Python function part of the language.

        Args:
            name: what programs call it.
            function: gets entities as handles, and plain values as Python's. It is taken to be
                pure: the same arguments on the same tick, the same result.
            help: what `help('name')` tells; by default its docstring.

        Raises:
            ArgumentError: the name is none, or that of what no function can replace.

        Warns:
            UserWarning: the function replaces a relation, a function or an operator of the
                language (`on`, `count`, `add` for `+`) in this interpreter's programs.
        """
        if not isinstance(name, str) or name not in NAMED:
            check_name(name, "a function")
        validation.function(function, name)
        with self._lock:
            self._adopt(Function.of(name, function, help, hints_of(function)))
            self._functions_changed()

    def del_function(self, name: str) -> None:
        """Remove a function that was added; what it replaced is there again.

        Raises:
            UnknownNameError: there is none, with the nearest names.
        """
        with self._lock:
            self._drop(name)
            self._functions_changed()

    # The tutorial's spellings.
    addVariable = add_variable  # noqa: N815
    callVariable = call_variable  # noqa: N815
    addFunction = add_function  # noqa: N815
    delFunction = del_function  # noqa: N815

    # -- simulated time -------------------------------------------------------------------

    def run(
        self,
        seconds: float,
        *,
        realtime: bool | float = False,
        progress: bool | Literal["always"] = False,
        every: int | None = None,
    ) -> None:
        """Run all worlds in lockstep for so much simulated time, each in its own time step.

        Wherever a trigger is due in one of them, or the clock or `every` asks for a tick, all run
        up to that moment before any trigger is evaluated. What-if worlds stay as they are. The
        arguments and errors are those of `World.run`.

        Raises:
            UnknownNameError: there is no world.
        """
        worlds = [world for world in self.worlds if world.timestep]
        if not worlds:
            raise UnknownNameError("there is no world that could run: add_variable one, or load")
        run(worlds, seconds, realtime=realtime, progress=progress, every=every)

    # -- raw SQL --------------------------------------------------------------------------

    def sql(self, text: str, parameters: Sequence[Any] | Mapping[str, Any] | None = None) -> Result:
        """Run SQL on the worlds' tables.

        The tables of a world bound as `kitchen` are `kitchen.entities` and so on; those of the
        first world go without the schema. Relations are functions of rows:
        `FROM entities a, entities b WHERE above(a, b)`.

        Args:
            text: one SQL statement in DuckDB's dialect.
            parameters: for `?` and `$1` a sequence, for `$name` a mapping.

        Returns:
            All its rows; stepping the world does not change them.

        Raises:
            SqlError: DuckDB refuses it.
            ArgumentError: the statement is no text.
        """
        validation.text(text, "sql: a statement is a text")
        with self._lock:
            if not self._texts:
                self._sweep()
                self._database.connection.meter = UsageMeter(self._limits)
            return Result(self._database.table(text, parameters))

    def statistics(self) -> dict[str, Statistics]:
        """What the relations of shapes have taken so far, by the world's name."""
        return {
            name: Statistics(world.snapshot.calls.pairs, world.snapshot.calls.calls)
            for name, world in self._database.worlds.items()
        }

    # -- queries of programs ------------------------------------------------------------------

    def query(self, node: Query, frame: Frame) -> Any:
        """The value of a query; `frame` knows the rows of the queries around it."""
        if frame.elements and not sees_outside(node):
            frame = frame.independent()
        if type(self).evalAs is not Interpreter.evalAs:
            with self._reading(node):
                return self.evalAs(*self._spelled(node, frame))
        return self._formed(node, frame, form_of(node, frame))

    def _formed(self, node: Query, frame: Frame, form: AsClause) -> Any:
        """What a form makes of what a query selects."""
        asked = self._asked(node, form.adapter)
        with self._reading(asked):  # the result is made of one tick, too
            return form.value(asked, frame, self._planner.run)

    def _asked(self, node: Query, adapter: Adapter) -> Query:
        """The query that is run for a form: the same one each time, as it is planned once."""
        if adapter.select is None:
            return node
        asked = self._selects.setdefault(node, {})
        if adapter not in asked:
            asked[adapter] = adapter.select(node)
        return asked[adapter]

    def _spelled(self, node: Query, frame: Frame) -> tuple[Any, ...]:
        """The arguments of `evalAs`."""
        resolved, values = self._planner.spelled(node, frame)
        parts, names = SelectedColumns(node, resolved.columns, frame), aliases_of(node)
        holds, elements = resolved.query.where, SourceElements(values)
        where: Condition | list[Any] = [] if holds is None else Condition(holds, frame)
        if not takes_results(type(self).evalAs):
            return parts.form, parts, elements, names, where
        given = () if node.adapter is None else node.adapter.arguments
        left = [e for e in elements if not isinstance(where, Condition) or where.value(e, names)]
        return parts.form, [frame.value(part) for part in given], parts, names, left

    def evalAs(  # noqa: N802  # the tutorial's name
        self,
        form: str,
        select: SelectedColumns | list[Any],
        elements: SourceElements | SelectedColumns,
        names: list[str],  # noqa: ARG002
        where: Condition | list[Any],  # noqa: ARG002
    ) -> Any:
        """What a query gives; a subclass that overrides it makes forms of its own.

        A subclass may also have the parameters `(AS, PARAMS, SELECT, FROM_n, RESULTS)` of the
        published interpreters: the form, the values of its arguments, the columns, the names of
        the sources, and a list of tuples of elements: the rows that WHERE leaves.

        Of such a subclass it is called for each query that Python evaluates; one that is a part
        of another's SQL is not seen. `ssduck.adapter` is the shorter way.

        Args:
            form: the name behind AS; `"dict"` if there is none.
            select: the columns. Each is a part that `eval(part, elements, names)` evaluates, and a
                sequence of a kind, a name and the arguments, which are such parts, too.
            elements: a tuple for each combination: an element of each source.
            names: of the sources.
            where: a part, too; `[]` if there is none.
        """
        parts = elements if isinstance(elements, SelectedColumns) else select
        assert isinstance(parts, SelectedColumns)
        query, frame = parts.query, parts.frame
        asked = form_of(query, frame) if form == parts.form else AsClause(form, find(form))
        return self._formed(query, frame, asked)


def _plain(value: Any) -> Any:
    try:
        return plain(value)
    except RecursionError:  # a list that is in itself; where it is used tells
        return value
