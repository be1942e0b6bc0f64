"""Runs SelectScript programs and raw SQL: the class `Interpreter`.

The steps of one query, `ss.eval("SELECT id(this) FROM kitchen WHERE above(this, table) AS list;")`:

1. `Interpreter.eval` parses the text (`ssduck.language.parser`) and runs the program in a
   transaction (`Execution.transaction`): if it fails, the variables are restored.
2. `Execution.run` reads the spellings of SQL (`ssduck.language.sql_readings`), and takes the
   statements in order. Before each, the linter reports probable mistakes
   (`ssduck.interpreter.lint`). The evaluator (`ssduck.language.evaluator`) computes the value of
   the statement, and calls `Interpreter._value_of_query` for a query.
3. `Interpreter._value_of_query` finds the result form behind AS (`ssduck.interpreter.output`), and
   holds the worlds at their current tick while the query runs.
4. `Planner.run` (`ssduck.interpreter.planner`) evaluates the sources behind FROM, and finds the
   plan for their types: SQL (`ssduck.sql.translator`), or row by row in Python. Plans are cached.
5. `PlannedQuery.run` (`ssduck.interpreter.query_runner`) executes the SQL
   (`ssduck.database.connection`) and evaluates in Python the clauses that SQL cannot express;
   `RowByRowQuery.run` evaluates all of them in Python.
6. The result form makes the result from the rows (`AsClause.value`, `ssduck.adapters`).

`Execution` runs the program, and holds its variables and functions (`Namespace`). Other parts have
the rest of the methods that an `Interpreter` offers (`of_part`): its `Records`, its triggers
(`TriggerRegistry`), its `Batches`, and `Additions` of functions and tables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Never, Self, cast

from ssduck import validation
from ssduck.adapters.registry import find
from ssduck.adapters.result import MAX_ROWS, Result, TableView
from ssduck.database.database import Database
from ssduck.errors import SqlError, UnknownNameError
from ssduck.formatting import count_of, joined_names
from ssduck.geometry.distance import Statistics
from ssduck.interpreter.additions import Additions, ServedPage
from ssduck.interpreter.batches.methods import Batches, BatchTerms
from ssduck.interpreter.eval_as import (
    Condition,
    QueryPart,
    SelectedColumns,
    SourceElements,
    as_dict,
    as_list,
    as_value,
    takes_results,
)
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.namespace import check_name
from ssduck.interpreter.output import AsClause, ResultForms, as_clause_of
from ssduck.interpreter.parts import of_part
from ssduck.interpreter.program import (
    CompiledProgram,
    check_parameters,
    rows_to_show,
    tree_of,
)
from ssduck.interpreter.recording import Records
from ssduck.interpreter.sql_hints import add_hint
from ssduck.interpreter.triggers.registry import TriggerRegistry
from ssduck.interpreter.triggers.tick_batch import TriggerBatches
from ssduck.language import ast
from ssduck.language.analysis import aliases_of, sees_outside
from ssduck.language.evaluator import Frame
from ssduck.language.parser import parse
from ssduck.language.value_keys import python_value
from ssduck.lazy import service
from ssduck.limits import Limits
from ssduck.logic.why import Why
from ssduck.recording.spec import Recording
from ssduck.simulators.scenes import Camera
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.public_names import INSTEAD_IN_INTERPRETERS, PublicNames
from ssduck.world.stepping import run
from ssduck.world.world import World


class Interpreter(PublicNames):
    """Runs SelectScript programs and raw SQL on worlds.

    Args:
        database: the path of a DuckDB file, or `":memory:"`.
        tracer: a function that is called with each SQL statement before it runs, but for those that
            make views.
        limits: the limits of programs and SQL; with `Limits.strict()`, for programs from
            elsewhere, it is a `SandboxedInterpreter`.
        row_by_row: whether every query runs row by row in Python, for comparison.
        strict: whether a probable mistake in a program (a name that no entity has, a variable
            that hides a function) is an error instead of a `ProgramWarning`. The attribute
            `strict` may be set at any time.
        recording: the recording of each world; None for no recording. By default `Recording()`:
            entities, links and contacts at each tick, in memory as many ticks as take 512 MiB, in
            a file all of them. See `record`.

    Raises:
        ArgumentError: an argument has the wrong type.
        SqlError: the database file cannot be opened.

    >>> import ssduck
    >>> with ssduck.Interpreter() as ss:
    ...     ss.eval("SELECT this * this FROM [1, 2, 3] AS list;")
    [1, 4, 9]
    """

    INSTEAD_OF = INSTEAD_IN_INTERPRETERS

    def __new__(cls, *database: Any, limits: Limits | None = None, **options: Any) -> Any:
        """Returns an interpreter; one in a sandbox if the limits say so."""
        if isinstance(limits, Limits) and limits.is_sandboxed:
            return service("sandboxed interpreter")(*database, limits=limits, **options)
        return super().__new__(cls)

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
            recording = Recording()
        validation.instance(recording, Recording, "Interpreter: recording")
        limits = limits or Limits()
        self._database = Database(database, tracer, limits, recording)
        self._execution = Execution(
            self._database, limits, self._value_of_query, row_by_row=row_by_row, strict=strict
        )
        self._lock = self._execution.lock
        self._planner = self._execution.planner
        self._owned_worlds: list[World] = []
        self._forms = ResultForms(self._planner, self._execution.worlds_pinned)
        has_own_forms = type(self).evalAs is not Interpreter.evalAs
        batches = TriggerBatches(self._execution, None if has_own_forms else self._forms.query_of)
        self._triggers = TriggerRegistry(self.compile, self.eval, self._execution, batches)
        self._records = Records(self._execution, self.eval, self.sql, self._triggers)
        self._additions, self._batches = Additions(self._execution), Batches(self._execution)

    def close(self) -> None:
        """Removes the triggers, and closes the database and the world that `load` made.

        Worlds that you made stay open. One that a program made (`AS environment`) is closed when
        no variable of yours has it.
        """
        self._triggers.close()
        for world in self._owned_worlds:
            world.close()
        try:
            self._database.close()
        finally:
            self._execution.release_worlds()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def strict(self) -> bool:
        """Whether a probable mistake in a program is an error instead of a warning."""
        return self._execution.strict

    @strict.setter
    def strict(self, strict: bool) -> None:
        self._execution.strict = validation.boolean(strict, "Interpreter: strict")

    @property
    def worlds(self) -> list[World]:
        """The worlds that are bound to variables, the first one first."""
        return self._execution.worlds

    def __repr__(self) -> str:
        worlds = [
            f"{name} ({count_of(len(world), 'entity')}, t={world.time:g} s)"
            for name, world in self._database.worlds.items()
        ]
        parts = {
            "worlds": worlds,
            "variables": [name for name in self if name not in self._database.worlds],
            "functions": [
                name for name, known in self._execution.functions.items() if not known.builtin
            ],
            "triggers": [state.config.name for state in self.triggers()],
        }
        contents = [f"{kind} {joined_names(names, 8)}" for kind, names in parts.items() if names]
        return f"<Interpreter: {'; '.join(contents) or 'empty'}>"

    # -- programs -------------------------------------------------------------------------

    def compile(self, text: str) -> CompiledProgram:
        """Parses a program; running the compiled program parses nothing again.

        Args:
            text: the program.

        Raises:
            ParseError: the text is no program; the error has the place.

        >>> import ssduck
        >>> with ssduck.Interpreter() as ss:
        ...     program = ss.compile("1 + 1;")
        ...     ss.eval(program)
        2
        """
        return CompiledProgram(text, parse(text), self._execution.sql_of)

    def eval(
        self,
        program: str | CompiledProgram | QueryPart | SelectedColumns,
        elements: Sequence[Any] | Mapping[str, Any] = (),
        names: Sequence[str] = (),
        *,
        parameters: Mapping[str, Any] | None = None,
        **others: Any,
    ) -> Any:
        """Runs a program.

        Args:
            program: the text, or a compiled program; or a part of a query that `evalAs` received.
            elements: the row for such a part, one element for each source; for a program, its
                parameters.
            names: the names of the sources.
            parameters: values by name, which are variables of this run only.
            **others: an error, which says what to write.

        Returns:
            The value of the last statement; None if there is none.

        Raises:
            SelectScriptError: the program failed; the error has the place, and the variables are
                as they were before.
            ArgumentError: a parameter has no name of a variable, or is a world or of one's name.

        >>> import ssduck
        >>> with ssduck.Interpreter() as ss:
        ...     ss.eval("SELECT this FROM [1, 2, 3] WHERE this > high AS list;", {"high": 1})
        [2, 3]
        >>> with ssduck.Interpreter() as ss:
        ...     ss.eval("heights = [0.4, 1.2]; SELECT this FROM heights WHERE this > 1;")
        [{'this': 1.2}]
        """
        if isinstance(program, QueryPart | SelectedColumns):
            return program.value(cast("Sequence[Any]", elements), names)
        if parameters is None and not (isinstance(elements, tuple) and not elements):
            parameters = cast("Mapping[str, Any]", elements)
        if others or parameters is not None:
            check_parameters("eval", parameters, others)
        if parameters:
            with self._execution.with_parameters(parameters):
                return self.eval(program)
        compiled, execution = tree_of(program), self._execution
        batches = self._batches.programs
        if batches is not None and (batch := batches.batch_of(compiled)) is not None:
            return batches.value(compiled, batch)
        with execution.transaction(compiled):
            return execution.run(compiled)

    def show(self, program: str | CompiledProgram, rows: int = MAX_ROWS) -> TableView:
        """Returns the result of a program as a table for a terminal or a notebook.

        Args:
            program: the text, or a compiled program.
            rows: the largest number of rows to show.

        Raises:
            SelectScriptError: as `eval` does.
        """
        rows = validation.integer(rows, "show: rows", minimum=0)
        compiled = program if isinstance(program, CompiledProgram) else self.compile(program)
        return TableView(rows_to_show(compiled, self), rows)

    def explain(self, program: str | CompiledProgram) -> str:
        """Returns the SQL of the queries in a program's last statement, and what Python evaluates.

        The statements before it run, because the last one may use their variables. The variables
        are restored.

        Raises:
            SelectScriptError: as `eval` does.
        """
        compiled = tree_of(program)
        with self._execution.transaction(compiled):
            return self._execution.explanation(compiled)

    def why(self, program: str | CompiledProgram) -> Why:
        """Returns why the condition that ends a program holds, or does not.

        Its parts are a tree, which `print` shows: each has its value, its margin (`robustness`),
        and in an operator of time the tick that decides it. `WHY` in front of a program returns
        that text. The statements before it run, and the variables are restored.

        Raises:
            SelectScriptError: as `eval` does; or the program does not end with a condition.
        """
        compiled = tree_of(program)
        with self._execution.transaction(compiled):
            return self._execution.why(compiled)

    # -- queries of programs ------------------------------------------------------------------

    def _value_of_query(self, node: ast.Query, frame: Frame) -> Any:
        """Returns the value of a query; `frame` holds the rows of the queries around it."""
        if frame.elements and not sees_outside(node):
            frame = frame.independent()
        if type(self).evalAs is not Interpreter.evalAs:
            with self._execution.worlds_pinned(node):
                return self.evalAs(*self._eval_as_arguments(node, frame))
        return self._forms.result(node, frame, as_clause_of(node, frame))

    def _eval_as_arguments(self, node: ast.Query, frame: Frame) -> tuple[Any, ...]:
        resolved, values = self._planner.resolved_parts(node, frame)
        columns, names = SelectedColumns(node, resolved.columns, frame), aliases_of(node)
        condition, elements = resolved.query.where, SourceElements(values)
        where: Condition | list[Any] = [] if condition is None else Condition(condition, frame)
        if not takes_results(type(self).evalAs):
            return columns.form, columns, elements, names, where
        arguments = () if node.adapter is None else node.adapter.arguments
        rows = [e for e in elements if not isinstance(where, Condition) or where.value(e, names)]
        return columns.form, [frame.value(part) for part in arguments], columns, names, rows

    def evalAs(  # noqa: N802  # the tutorial's name
        self,
        form: str,
        select: SelectedColumns | list[Any],
        elements: SourceElements | SelectedColumns,
        names: list[str],  # noqa: ARG002
        where: Condition | list[Any],  # noqa: ARG002
    ) -> Any:
        """Returns the result of a query; a subclass may override it to make forms of its own.

        A subclass may instead have the parameters `(AS, PARAMS, SELECT, FROM_n, RESULTS)` of the
        published interpreters: the name of the form, the values of its arguments, the columns, the
        names of the sources, and a list of tuples of elements: the rows that satisfy WHERE.

        It is called for each query that Python evaluates, but not for one inside the SQL of
        another query. `ssduck.adapter` is the shorter way.

        Args:
            form: the name behind AS; `"dict"` if there is none.
            select: the columns. `eval(column, elements, names)` evaluates a column. A column is
                also a sequence of a kind, a name and the arguments, which are parts of the query as
                well.
            elements: an iterator over the combinations of elements, one of each source.
            names: the names of the sources.
            where: the condition, a part as well; `[]` if there is none.
        """
        columns = elements if isinstance(elements, SelectedColumns) else select
        assert isinstance(columns, SelectedColumns)
        query, frame = columns.query, columns.frame
        clause = as_clause_of(query, frame) if form == columns.form else AsClause(form, find(form))
        return self._forms.result(query, frame, clause)

    # -- variables and functions ----------------------------------------------------------

    def add_variable(self, name: str, value: Any) -> Any:
        """Binds a value to a name; the tables of a world become the schema of that name.

        NumPy's numbers become Python's, and tuples of numbers become lists; a list or a dict that
        contains some is copied. The relations take a 1-D array of numbers as a point.

        Args:
            name: the name of the variable.
            value: the value.

        Returns:
            The value.

        Raises:
            ArgumentError: the name cannot be the name of a variable, or of a schema.
        """
        check_name(name, "a variable")
        with self._lock:
            if isinstance(value, World):
                self._database.bind(name, value)
                self._planner.forget()
                self._execution.expire_histories()  # the time may be an earlier one now
            self._execution.bind(name, _plain(value))
            if isinstance(value, BatchWorld):
                self._batches.begin()
        if isinstance(value, World):
            self._triggers.rebound()
        return value

    def __getitem__(self, name: str) -> Any:
        """Returns the value of a variable, as `call_variable` does.

        Raises:
            UnknownNameError: no variable has that name; the error suggests the nearest names.

        >>> import ssduck
        >>> with ssduck.load("kitchen") as ss:
        ...     ss["high"] = 1.2
        ...     ss["kitchen"]["fridge"].name, ss["high"], "low" in ss
        ('fridge', 1.2, False)
        """
        return self._execution.variable(name)

    def __setitem__(self, name: str, value: Any) -> None:
        """Binds a value to a name, as `add_variable` does."""
        self.add_variable(name, value)

    def __contains__(self, name: object) -> bool:
        """Checks whether a variable has a name."""
        return name in self._execution.variables

    def __iter__(self) -> Iterator[str]:
        """Yields the names of the variables."""
        return iter(list(self._execution.variables))

    def call_variable(self, name: str) -> Any:
        """Returns the value of a variable.

        Raises:
            UnknownNameError: no variable has that name; the error suggests the nearest names.
        """
        return self._execution.variable(name)

    help = of_part("_execution", Execution.help)
    history = of_part("_execution", Execution.history)
    add_function = of_part("_additions", Additions.add_function)
    del_function = of_part("_additions", Additions.del_function)
    register = of_part("_additions", Additions.register)

    # -- records, triggers and batches ----------------------------------------------------

    record = of_part("_records", Records.record)
    past = of_part("_records", Records.past)
    record_to = of_part("_records", Records.record_to)
    export = of_part("_records", Records.export)
    flush = of_part("_records", Records.flush)
    add_trigger = of_part("_triggers", TriggerRegistry.add_trigger)
    del_trigger = of_part("_triggers", TriggerRegistry.del_trigger)
    pause_trigger = of_part("_triggers", TriggerRegistry.pause_trigger)
    resume_trigger = of_part("_triggers", TriggerRegistry.resume_trigger)
    triggers = of_part("_triggers", TriggerRegistry.triggers)
    export_batch = of_part("_batches", Batches.export_batch)
    over_batch = of_part("_batches", Batches.over_batch)

    # The tutorial's spellings.
    addVariable, callVariable = add_variable, call_variable  # noqa: N815
    addFunction, delFunction = add_function, del_function  # noqa: N815
    addTrigger, delTrigger = add_trigger, del_trigger  # noqa: N815
    evalAS_list, evalAS_dict, evalAS_value = as_list, as_dict, as_value  # noqa: N815

    def terms(
        self,
        success: str | None = None,
        failure: str | None = None,
        reward: str | Mapping[str, str] | None = None,
        stop_when: str | None = None,
        **options: Any,
    ) -> BatchTerms:
        """Returns the terms of a task over a batch: a call has their values in all environments.

        The arguments, `world` and `nan` among them, are those of `ssduck.gym.BatchTerms`.
        """
        made = service("terms")(self, success, failure, reward, stop_when, **options)
        return cast("BatchTerms", made)

    # -- simulated time -------------------------------------------------------------------

    def run(
        self,
        seconds: float,
        *,
        realtime: bool | float = False,
        progress: bool | Literal["always"] = False,
        every: int | None = 1,
        **others: Never,
    ) -> None:
        """Runs all worlds in lockstep for a duration, each in its own time step.

        A tick is taken after each step. All worlds run up to the time of a tick of one of them
        before any trigger is evaluated. What-if worlds do not run. The
        arguments and errors are those of `World.run`.

        Args:
            seconds: the simulated time, s.
            realtime: True to keep pace with the clock, or a factor of its speed.
            progress: whether a progress bar is shown.
            every: the number of steps between two ticks; None for requested ticks and the last.
            **others: none; an error says what to write for other names.

        Raises:
            UnknownNameError: there is no world.

        >>> import ssduck
        >>> with ssduck.load("kitchen") as ss:
        ...     ss.run(0.5)
        ...     ss.call_variable("kitchen").time
        0.5
        """
        worlds = [world for world in self.worlds if world.timestep]
        if not worlds:
            raise UnknownNameError(
                "there is no world to run; add one with add_variable, or use load"
            )
        run(worlds, seconds, realtime=realtime, progress=progress, every=every, **others)

    # -- raw SQL --------------------------------------------------------------------------

    def sql(
        self,
        text: str,
        parameters: Sequence[Any] | Mapping[str, Any] | None = None,
        **others: Any,
    ) -> Result:
        """Runs SQL on the worlds' tables.

        The tables of a world that is bound as `kitchen` are `kitchen.entities` and so on; the
        schema of the first world may be omitted. Relations are functions of rows:
        `FROM entities a, entities b WHERE above(a, b)`.

        Args:
            text: one SQL statement in DuckDB's dialect.
            parameters: a sequence for `?` and `$1`, a mapping for `$name`.
            **others: an error, which says what to write.

        Returns:
            All rows; steps of the world do not change them.

        Raises:
            SqlError: DuckDB refuses the statement.
            ArgumentError: the statement is no text, or the parameters are no list and no dict.
            UnknownNameError: the interpreter is strict, and no entity has a name that the statement
                compares.

        Warns:
            ProgramWarning: the same in an interpreter that is not strict.

        >>> import ssduck
        >>> with ssduck.Interpreter() as ss:
        ...     ss.sql("SELECT 6 * ? AS answer", [7]).fetchall()
        [(42,)]
        """
        validation.text(text, "sql: a statement is a text")
        check_parameters("sql", parameters, others)
        with self._lock:
            if not self._execution.is_running:
                self._execution.drop_unused_worlds()
                self._execution.begin_meter()
            self._execution.report(self._execution.linter.check_sql(text, parameters))
            try:
                return Result(self._database.user_rows(text, parameters))
            except SqlError as error:
                functions = self._execution.users_functions()
                add_hint(error, text, self._database.worlds, functions)
                raise

    def view(
        self,
        world: str | None = None,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        camera: Camera | None = None,
    ) -> ServedPage:
        """Serves a page that shows a world in 3-D as it is stepped, with a box for queries.

        It asks copies of ticks, without files. A notebook shows it; `close()` stops it.

        Args:
            world: the variable of the world; by default the first one.
            host: the address to listen at. Another one than 127.0.0.1 lets other computers ask.
            port: the port to listen at; 0 for a free one.
            camera: the camera with which the page begins; by default that of the world.

        Raises:
            UnsupportedError: websockets is not installed.
            UnknownNameError: there is no such world; with the nearest names.
            SimulatorError: the address cannot be listened at.
        """
        port = validation.integer(port, "view: port", minimum=0, maximum=65535)
        return cast("ServedPage", service("page")(self, world, camera, host=host, port=port))

    def statistics(self) -> dict[str, Statistics]:
        """Returns the numbers of shape comparisons so far, by the name of the world."""
        return {
            name: Statistics(world.snapshot.calls.pairs, world.snapshot.calls.calls)
            for name, world in self._database.worlds.items()
        }


def _plain(value: Any) -> Any:
    """Returns the value with Python's numbers and lists in place of NumPy's and tuples."""
    try:
        return python_value(value)
    except RecursionError:  # a list that contains itself; its use is the error
        return value
