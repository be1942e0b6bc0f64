"""`Interpreter`: variables, functions, running programs and raw SQL.

A program's statements run in order; its value is that of the last one. A program that fails
leaves the variables as they were. A query is translated once per text and types
(`ssduck.translate`), runs as one SQL statement on one tick of each world, and what is left of
it is evaluated in Python on the rows that come back (`ssduck.queries`).
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, Self
from weakref import WeakKeyDictionary

from ssduck.adapters import Adapter, find
from ssduck.database import Database
from ssduck.deferred import Deferred
from ssduck.dependencies import aliases_of, calls_of, sees_outside, tables_of, variables_of
from ssduck.dialects import in_dialect
from ssduck.entities import Entity
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    LimitError,
    SelectScriptError,
    UnknownNameError,
    nearest,
)
from ssduck.evaluate import Frame
from ssduck.explain import told
from ssduck.forms import Form, form_of, help_of_forms
from ssduck.functions import BUILTINS, Function
from ssduck.intervals import RELATIONS_OF_INTERVALS, are_intervals
from ssduck.keys import plain
from ssduck.language import is_reserved, parse
from ssduck.limits import Limits, Meter
from ssduck.messages import shown
from ssduck.opened import chosen_runs, runs, world_of
from ssduck.over_time import FORMS, OverTime
from ssduck.past import Past
from ssduck.past import together as entities_together
from ssduck.planner import Planner
from ssduck.recording import RECORDABLE, Recording
from ssduck.relations import Relation
from ssduck.result import Result
from ssduck.rows import formed
from ssduck.running import run
from ssduck.scenes import find_scene
from ssduck.sealed import FolderRecording
from ssduck.sources import within
from ssduck.spelled import Columns, Condition, Elements, Part
from ssduck.temporal import ValueHistory, aged, history_of, kept, seconds_of
from ssduck.translate import unknown_function
from ssduck.tree import Call, Given, Node, Program, Query
from ssduck.triggers import Triggers, TriggerVerbs
from ssduck.udfs import RELATIONS
from ssduck.world import World

# Seconds of simulated time whose ticks are kept in memory, if nothing else is asked for.
KEPT = 60.0


def load(
    scene: str | Path,
    database: str | Path = ":memory:",
    *,
    recording: Recording | Literal["default"] | None = "default",
) -> Interpreter:
    """An interpreter with a scene's world bound to the scene's name.

    Args:
        scene: the name of a shipped scene, or the path of a scene file, or of a model
            (URDF, SDF or MJCF).
        database: a DuckDB file, or `":memory:"`.
        recording: what is kept of the ticks; see `Interpreter`.

    Raises:
        UnknownNameError: there is no such scene, with the nearest names.
        SceneError: it cannot be loaded: file, key and reason.
    """
    description = find_scene(scene)
    interpreter = Interpreter(database, recording=recording)
    try:
        world = World.load(description)
        interpreter._own.append(world)  # noqa: SLF001  # it closes what is made here
        interpreter.add_variable(description.name, world)
    except BaseException:
        interpreter.close()
        raise
    return interpreter


def open_record(
    path: str | Path, world: str | None = None, episode: int | None = None
) -> Interpreter:
    """An interpreter on what was recorded, without a simulation: the same programs run.

    Each world is bound to its name, as it was at its last tick; `kitchen{12.5}` and the tables
    of its history tell of the others.

    A DuckDB file is only read, so that any number of processes can open it together, as long as
    none records into it.

    Args:
        path: a folder that `Interpreter.export` or `ssduck record` wrote, or a DuckDB file that
            was recorded into.
        world: the world that is opened; None for all.
        episode: the number of the run; None for the last one of each world that holds any tick.

    Raises:
        RecordError: there is no such record, it is damaged, of a newer version, or in use by
            another process.
    """
    interpreter = Interpreter(recording=None)
    return interpreter._opened(  # noqa: SLF001  # one room
        lambda database: [
            world_of(run, database)
            for run in chosen_runs(runs(Path(path), database), world, episode)
        ]
    )


@dataclass(frozen=True)
class Statistics:
    """What the relations of shapes have taken of one world, over all its ticks.

    Attributes:
        pairs: how many pairs of entities were compared; one that is asked for twice in a tick
            counts once. Where all pairs of a tick are compared at once, these are the pairs
            whose boxes meet, or are as near as was asked for.
        calls: how often FCL was called for that: once or twice for two shapes that are near each
            other, more often for meshes that are deep in something; never for those that
            formulas decide, as nearly all are where all of a tick is compared at once.
    """

    pairs: int
    calls: int


@dataclass(frozen=True, eq=False)
class Compiled:
    """A program that was parsed; running it again parses nothing.

    Attributes:
        text: how it was written.
        tree: what it means.
    """

    text: str
    tree: Program
    _interpreter: Interpreter

    def sql(self, dialect: str = "duckdb") -> str:
        """The SQL of the query that the program ends with, the values of variables put in.

        Args:
            dialect: one of sqlglot's: `"duckdb"`, `"postgres"`, `"sqlite"` …

        Raises:
            UnsupportedError: a part is left to Python, or is nothing that dialect has.
        """
        return self._interpreter._sql_of(self.tree, dialect)  # noqa: SLF001  # one room


class Interpreter(TriggerVerbs):
    """Runs SelectScript programs and raw SQL on worlds.

    Args:
        database: a DuckDB file, or `":memory:"`.
        tracer: is told each SQL statement before it runs.
        limits: what programs and SQL may use; for what comes from elsewhere,
            `Limits.strict()`.
        row_by_row: whether every query runs row by row in Python, to compare with.
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
        recording: Recording | Literal["default"] | None = "default",
    ) -> None:
        self._limits = limits or Limits()
        database = str(database)
        if recording == "default":
            recording = Recording(seconds=KEPT) if database == ":memory:" else Recording()
        self._database = Database(database, tracer, self._limits, recording)
        self._lock = threading.RLock()
        self._variables: dict[str, Any] = {}
        self._functions: dict[str, Function] = dict(BUILTINS)
        self._functions.update((command.name, command) for command in self._commands())
        self._functions.update((name, form.function) for name, form in FORMS.items())
        for name, allen in RELATIONS_OF_INTERVALS.items():
            if name not in RELATIONS:
                self._functions[name] = allen.function
        self._over_time = OverTime()
        self._own: list[World] = []
        self._planner = Planner(self._database, self, self._limits, row_by_row=row_by_row)
        self._relations: WeakKeyDictionary[Call, Query] = WeakKeyDictionary()
        self._selects: WeakKeyDictionary[Query, Query] = WeakKeyDictionary()
        self._texts: list[str] = []
        self._triggers = Triggers(self)

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

    def compile(self, text: str) -> Compiled:
        """Parse a program; running the result again parses nothing.

        Raises:
            ParseError: with the place of the first thing that is wrong.
        """
        return Compiled(text, parse(text), self)

    def eval(
        self,
        program: str | Compiled | Part | Columns,
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
        if isinstance(program, Part | Columns):
            return program.value(elements, names)
        compiled = _tree(program)
        with self._running(compiled):
            return self._run(compiled)

    def explain(self, program: str | Compiled) -> str:
        """The SQL of the queries in a program's last statement, and what is left to Python.

        The statements before it are run for their variables, which are then as before.

        Raises:
            SelectScriptError: as `eval` does.
        """
        compiled = _tree(program)
        with self._running(compiled):
            return self._explained(compiled)

    @contextmanager
    def _running(self, program: Program) -> Iterator[None]:
        """Whatever fails in here leaves the variables as they were, and says where it failed."""
        with self._lock:
            self._forget()
            before = dict(self._variables)
            outermost = not self._texts
            if outermost:
                self._database.meter = Meter(self._limits)
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

    def _run(self, program: Program) -> Any:
        if program.explain:
            return self._explained(program)
        return self._valued(program, Frame(self))

    def _valued(self, program: Program, frame: Frame) -> Any:
        value = None
        for node in program.statements:
            self.meter.step()
            value = frame.value(node)
        return value

    # -- what a program becomes -------------------------------------------------------------

    def _explained(self, program: Program) -> str:
        with self._rehearsed(program) as frame:
            plan_of = partial(self._planner.plan, frame=frame)
            return "\n\n".join(
                told(program.text, statement, plan_of) for statement in program.statements[-1:]
            )

    def _sql_of(self, program: Program, dialect: str) -> str:
        with self._running(program), self._rehearsed(program) as frame:
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
            for statement in program.statements[:-1]:
                frame.value(statement)
            with self._reading(*program.statements[-1:]):
                yield frame
        finally:
            self._variables = before

    # -- variables and functions ----------------------------------------------------------

    def add_variable(self, name: str, value: Any) -> Any:
        """Bind a value to a name; a world's tables become the schema of that name.

        numpy's numbers become Python's; a list or a dict with some in it is copied for that.

        Returns:
            The value.

        Raises:
            ArgumentError: the name cannot be a variable's, or a schema's.
        """
        _check_name(name, "a variable")
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

    def history(self, name: str) -> list[tuple[float, Any]]:
        """What `name{}` gives, with the simulated times.

        Args:
            name: of a variable that was assigned by `name{5.0} = …` or `name{} = …`.

        Returns:
            The time of each assignment, in seconds, and its value, the oldest first.

        Raises:
            UnknownNameError: there is no such variable, with the nearest names.
            ArgumentError: it has no history.
        """
        with self._lock:
            self.variable(name)
            return history_of(name, self._variables[name]).within(math.inf, self._now())

    def _now(self) -> float:
        """The simulated time in seconds, that of the first world."""
        worlds = self._database.worlds.values()
        for world in worlds:
            return world.time
        raise UnknownNameError("there is no world, so no simulated time; add one with add_variable")

    def _forget(self) -> None:
        """Drop what is out of its horizon, or later than now."""
        temporal = [(n, v) for n, v in self._variables.items() if isinstance(v, ValueHistory)]
        if temporal:
            now = self._now()
            for name, history in temporal:
                self._variables[name] = history.until(now).recent(now)

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
            ArgumentError: the name is that of a relation or of a function of the language.
        """
        _check_name(name, "a function")
        known = self._functions.get(name)
        if name in RELATIONS or (known is not None and known.builtin):
            raise ArgumentError(f"{name!r} is a function of the language; choose another name")
        if not callable(function):
            raise ArgumentError(f"{name}: {shown(function)} is no function")
        with self._lock:
            self._functions[name] = Function.of(name, function, help)
            self._planner.forget()

    def help(self, name: str | None = None) -> Any:
        """The names of all functions, or the help of one; that of `AS` lists the result forms.

        Raises:
            UnknownNameError: there is no such function, with the nearest names.
        """
        if name is None:
            return sorted(self._known_functions(), key=str.casefold)
        if name.upper() == "AS":
            return help_of_forms()
        described: dict[str, Function | Relation] = {**self._functions, **RELATIONS}
        if name not in described:
            raise UnknownNameError(
                f"there is no function {shown(name)}", suggestions=nearest(name, described)
            )
        return f"{name}\n{described[name].help}"

    def _known_functions(self) -> list[str]:
        return [*RELATIONS, *self._functions]

    # -- what is kept -----------------------------------------------------------------------

    def _opened(self, worlds: Callable[[Database], Iterable[World]]) -> Self:
        """With worlds that are only recorded."""
        try:
            for world in worlds(self._database):
                self.add_variable(world.name, world)
        except BaseException:
            self.close()
            raise
        return self

    def record(self, world: str | World, recording: Recording | None) -> None:
        """Keep the ticks of a world from now on: what of them, and for how long.

        It begins with the present tick. What was kept of the world before is dropped, but for
        that in a file.

        Args:
            world: the world, or the name of its variable.
            recording: what is kept; None for nothing.

        Raises:
            ArgumentError: it is no world of this interpreter, or has no entity of a name.
            UnsupportedError: it is a record itself.
        """
        if not isinstance(recording, Recording | None):
            raise ArgumentError(f"what is kept is told by a Recording, not {shown(recording)}")
        with self._lock:
            self._database.record(self._world(world), recording)
            self._planner.forget()

    def past(self, world: str | World, age: float | None = None) -> Past:
        """What `kitchen{age}` is: a source for queries.

        Args:
            world: the world, or the name of its variable.
            age: seconds: from 0 up a simulated time, below 0 the time until now, None for all
                that is kept.

        Raises:
            EvaluationError: nothing is kept of it, or nothing of that time.
            ArgumentError: it is no world of this interpreter, or that is no finite number.
        """
        with self._lock:
            return self._past(self._world(world), None if age is None else seconds_of(age))

    def record_to(
        self,
        path: str | Path,
        world: str | World | None = None,
        recording: Recording | None = None,
    ) -> FolderRecording:
        """Write the ticks of a world to a folder of Parquet files from now on, as a new episode.

        What is written is sealed in parts: whatever ends the recording, all but the last part is
        there, and it is whole.

        Args:
            path: the folder; it is made if it is not there, and may hold other episodes.
            world: the world, or the name of its variable; None for the first one.
            recording: what is written; None for all tables.

        Returns:
            What writes them, until it is closed: `with ss.record_to("run/"): …`.

        Raises:
            RecordError: the folder has something else in it, or cannot be written.
            ArgumentError: it is no world of this interpreter, or has no entity of a name.
        """
        recording = recording or Recording(tables=RECORDABLE)
        if recording.is_bounded:
            raise ArgumentError("a folder keeps all: seconds and ticks are for a history in memory")
        with self._lock:
            worlds = list(self._database.worlds.values())
            if world is None and not worlds:
                raise ArgumentError("there is no world to be recorded")
            chosen = worlds[0] if world is None else self._world(world)
            return self._database.record_to(chosen, recording, Path(path))

    def export(
        self,
        path: str | Path,
        world: str | World | None = None,
        *,
        entities: Iterable[str | Entity] | str | Compiled | None = None,
        start: float | None = None,
        end: float | None = None,
    ) -> dict[str, Path]:
        """Write what is kept of worlds to a folder of Parquet files, each as a new episode.

        Args:
            path: the folder; it is made if it is not there, and may hold other episodes.
            world: the world, or the name of its variable; None for all that are recorded.
            entities: those that are written, by name or as handles, or a program that yields
                them; None for all. A sensor brings the body that it sits on.
            start: simulated time from which on ticks are written, s.
            end: and until which.

        Returns:
            The folder of each episode's ticks, by the name of its world.

        Raises:
            RecordError: the folder has something else in it, or cannot be written.
            EvaluationError: nothing is kept of a world, or nothing of that time.
        """
        chosen = self.eval(entities) if isinstance(entities, str | Compiled) else entities
        names = None if chosen is None else _names(chosen)
        start, end = (None if time is None else seconds_of(time) for time in (start, end))
        with self._lock:
            worlds = (
                [w for w in self._database.worlds.values() if self._database.keeps(w)]
                if world is None
                else [self._world(world)]
            )
            if not worlds:
                raise EvaluationError("no world is recorded here")
            database = self._database
            return {
                database.schema_of(each): database.export(each, Path(path), names, (start, end))
                for each in worlds
            }

    def flush(self) -> dict[str, int]:
        """Store what is recorded; in a file it survives whatever happens then.

        Returns:
            The last tick of each world, by its name.

        Raises:
            SqlError: it cannot be stored, for the disk is full, say; nothing is lost by that.
        """
        with self._lock:
            return self._database.flush()

    def _past(self, world: World, age: float | None) -> Past:
        return self._database.record_of(world).past(age)

    def _world(self, world: str | World) -> World:
        found = self.variable(world) if isinstance(world, str) else world
        if not isinstance(found, World) or found not in self._database.worlds.values():
            raise ArgumentError(f"{shown(world)} is no world of this interpreter")
        return found

    # The tutorial's spellings.
    addVariable = add_variable  # noqa: N815
    callVariable = call_variable  # noqa: N815
    addFunction = add_function  # noqa: N815

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

    @property
    def worlds(self) -> list[World]:
        """The worlds that are bound to variables, the first one first."""
        return list(self._database.worlds.values())

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
        """
        with self._lock:
            if not self._texts:
                self._database.meter = Meter(self._limits)
            return Result(self._database.table(text, parameters))

    def statistics(self) -> dict[str, Statistics]:
        """What the relations of shapes have taken so far, by the world's name."""
        return {
            name: Statistics(world.snapshot.calls.pairs, world.snapshot.calls.calls)
            for name, world in self._database.worlds.items()
        }

    # -- functions that need the interpreter ------------------------------------------------

    def _commands(self) -> list[Function]:
        def clear(name: str | None = None) -> bool:
            if name is None:
                kept = {n: v for n, v in self._variables.items() if isinstance(v, World)}
            else:
                self.variable(name)
                kept = {n: v for n, v in self._variables.items() if n != name}
            self._variables = kept
            return True

        def show(*values: Any) -> Any:
            print(*values)  # noqa: T201  # it is what the language's print is for
            return values[-1]

        return [
            _command("help", self.help, "Lists all functions, or tells what one does.", "[name]"),
            _command("to", lambda value, name: value, "Names a selected column.", "value, name"),  # noqa: ARG005
            _command("var", self.variable, "Returns the variable of that name.", "name"),
            _command("clear", clear, "Forgets a variable, or all but the worlds.", "[name]"),
            _command("getTime", self._now, "Returns the simulated time in seconds.", ""),
            _command("print", show, "Prints its arguments and returns the last.", "value, ..."),
            _command("eval", lambda text: text, "Runs a program that is given as text.", "text"),
        ]

    def _run_text(self, text: Any, frame: Frame) -> Any:
        """The value of a text in the scope of a frame: it sees the rows that it stands in."""
        if not self._limits.eval:
            raise LimitError("eval is switched off here")
        if not isinstance(text, str):
            raise ArgumentError(f"eval takes a text, not {shown(text)}")
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

    # -- the scope of expressions (ssduck.evaluate.Scope) -----------------------------------

    def variable(self, name: str) -> Any:
        """The value of a variable, or an UnknownNameError with the nearest names."""
        if name in self._variables:
            value = self._variables[name]
            return value.last if isinstance(value, ValueHistory) else value
        if name in RELATIONS or name in self._functions:
            raise UnknownNameError(
                f"there is no variable {name!r}; {name} is a function: write {name}(this), say"
            )
        raise UnknownNameError(
            f"there is no variable {shown(name)}", suggestions=nearest(name, self.names())
        )

    def has_variable(self, name: str) -> bool:
        """Whether there is a variable of that name."""
        return name in self._variables

    def names(self) -> list[str]:
        """The names of all variables and functions."""
        return [*self._variables, *self._known_functions()]

    def assign(self, name: str, value: Any) -> None:
        """Set a variable."""
        self._variables[name] = value

    def keep(self, name: str, value: Any, horizon: float) -> None:
        """Set a variable that keeps its values of so many seconds."""
        before = self._variables.get(name)
        self._variables[name] = kept(before, value, horizon, self._now())

    def aged(self, name: str, *age: Any) -> Any:
        """What a variable was; all that it keeps if no age is given."""
        self.variable(name)
        return aged(name, self._variables[name], age, self._now, self._past)

    def deferred(self, node: Node) -> Deferred:
        """A list of the running program for the query that uses it."""
        return Deferred(node, self._texts[-1])

    @property
    def meter(self) -> Meter:
        """How much of its limits the running program has used."""
        return self._database.meter

    def function(self, name: str) -> Function | None:
        """A function that is no relation."""
        return self._functions.get(name)

    def is_users(self, name: str) -> bool:
        """Whether that is a user's function."""
        function = self._functions.get(name)
        return function is not None and not function.builtin

    def builtin(self, name: str) -> Function | None:
        """A function of plain values that comes with the language."""
        return BUILTINS.get(name)

    def call(self, node: Call, arguments: list[Any], frame: Frame) -> Any:
        """The value of a function call outside SQL."""
        function = self._functions.get(node.name)
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
            return FORMS[node.name].make(series, None if age is None else seconds_of(age))

    def check_call(self, node: Call) -> None:
        """Complain of an unknown function, or of a wrong number of arguments."""
        given = len(node.arguments)
        if node.name in RELATIONS:
            relation = RELATIONS[node.name]
            least, most = min(relation.expressions), max(relation.expressions)
            fits, usage = given in relation.expressions, relation.usage
        elif node.name in self._functions:
            function = self._functions[node.name]
            least, most = function.least, given if function.most is None else function.most
            fits, usage = least <= given <= most, f"see help('{node.name}')"
        else:
            raise unknown_function(node, self._known_functions())
        if not fits:
            wanted = f"{least}" if least == most else f"{least} to {most}"
            plural = "" if wanted == "1" else "s"
            raise ArgumentError(
                f"{node.name} takes {wanted} argument{plural}, not {given}: {usage}",
                span=node.span,
            )

    def query(self, node: Query, frame: Frame) -> Any:
        """The value of a query; `frame` knows the rows of the queries around it."""
        if frame.elements and not sees_outside(node):
            frame = frame.independent()
        if type(self).evalAs is not Interpreter.evalAs:
            with self._reading(node):
                return self.evalAs(*self._spelled(node, frame))
        return self._formed(node, frame, form_of(node, frame))

    def _formed(self, node: Query, frame: Frame, form: Form) -> Any:
        """What a form makes of what a query selects."""
        asked = self._asked(node, form.adapter)
        with self._reading(asked):  # the result is made of one tick, too
            return form.value(asked, frame, self._planner.run)

    def _asked(self, node: Query, adapter: Adapter) -> Query:
        """The query that is run for a form: the same one each time, as it is planned once."""
        if adapter.select is None:
            return node
        if node not in self._selects:
            self._selects[node] = adapter.select(node)
        return self._selects[node]

    def _spelled(self, node: Query, frame: Frame) -> tuple[Any, ...]:
        """The arguments of `evalAs`."""
        resolved, values = self._planner.spelled(node, frame)
        parts = Columns(node, resolved, frame)
        where: Condition | list[Any] = [] if node.where is None else Condition(node.where, frame)
        return parts.form, parts, Elements(values), aliases_of(node), where

    def evalAs(  # noqa: N802  # the tutorial's name
        self,
        form: str,
        select: Columns,
        elements: Elements,  # noqa: ARG002
        names: list[str],  # noqa: ARG002
        where: Condition | list[Any],  # noqa: ARG002
    ) -> Any:
        """What a query gives; a subclass that overrides it makes forms of its own.

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
        query, frame = select.query, select.frame
        asked = form_of(query, frame) if form == select.form else Form(form, find(form))
        return self._formed(query, frame, asked)

    @contextmanager
    def _reading(self, *nodes: Node) -> Iterator[None]:
        """Hold all worlds at their tick, with the tables read that relations look things up in."""
        tables = frozenset().union(*map(self._tables_of, nodes))
        with self._database.held(tables, self._worlds_of(nodes) if tables else ()):
            yield

    def _worlds_of(self, nodes: Iterable[Node]) -> list[World] | None:
        """The worlds that parts may be about; None if their values alone tell."""
        worlds: list[World] = []
        for node in nodes:
            called = calls_of(node)
            if not called.isdisjoint(("var", "eval")) or any(map(self.is_users, called)):
                return None
            values = [self._variables.get(name) for name in variables_of(node)]
            for value in values:
                if isinstance(value, Deferred):
                    inner = self._worlds_of([value.node])
                else:
                    inner = within(value.values if isinstance(value, ValueHistory) else value)
                if inner is None:
                    return None
                worlds += inner
        return worlds

    def _tables_of(self, node: Node) -> frozenset[str]:
        """The tables that relations in a part look things up in."""
        found = tables_of(node)
        for name in variables_of(node):
            value = self._variables.get(name)
            if isinstance(value, Deferred):
                found |= self._tables_of(value.node)
        return found

    def _relation(self, node: Call, values: list[Any], frame: Frame) -> Any:
        """A relation outside a query: a query of one row, without sources."""
        query = self._relations.get(node)
        if query is None:
            names = [Given(n.span, f"argument_{i}") for i, n in enumerate(node.arguments)]
            asked = Call(node.span, node.name, tuple(names), node.name_span)
            query = self._relations[node] = Query(node.span, (asked,), ())
        together = entities_together(values, frame.own_elements())
        if together is None:
            return None
        given = {f"argument_{index}": value for index, value in enumerate(together)}
        worlds = [value.world for value in values if isinstance(value, Entity)]
        with self._database.held(RELATIONS[node.name].tables, worlds):
            for argument, value in zip(node.arguments, together, strict=True):
                if isinstance(value, Entity) and not value.is_there:
                    error = value.removed()
                    error.span = argument.span
                    raise error
            return self._planner.relation(query, Frame(self, given=given))


def _tree(program: str | Compiled) -> Program:
    if isinstance(program, Compiled):
        return program.tree
    if not isinstance(program, str):
        raise ArgumentError(f"a program is a text or what compile gave, not {shown(program)}")
    return parse(program)


def _names(entities: Iterable[str | Entity]) -> tuple[str, ...]:
    """The names of entities that are given by name or as handles."""
    found = []
    for entity in entities:
        if not isinstance(entity, str | Entity):
            raise ArgumentError(f"entities are to be names or entities, not {shown(entity)}")
        found.append(entity if isinstance(entity, str) else entity.name)
    if not found:
        raise ArgumentError("there are no entities to be written")
    return tuple(dict.fromkeys(found))


def _plain(value: Any) -> Any:
    try:
        return plain(value)
    except RecursionError:  # a list that is in itself; where it is used tells
        return value


def _command(name: str, call: Callable[..., Any], about: str, usage: str) -> Function:
    function = Function.of(name, call, f"{about}\nUsage: {name}({usage})")
    least = 1 if usage.endswith("...") else function.least
    return replace(function, builtin=True, least=least)


def _check_name(name: str, what: str) -> None:
    if not isinstance(name, str) or not name.isidentifier():
        raise ArgumentError(f"{shown(name)} cannot be {what}'s name: letters, digits and _ only")
    if is_reserved(name):
        raise ArgumentError(f"{name!r} cannot be {what}'s name: it is a word of the language")


def _unchecked(_: object) -> None:
    """Columns of one name are no trouble."""
