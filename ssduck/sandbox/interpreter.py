"""An interpreter whose programs, record and scene are in a process that can do no harm."""

from __future__ import annotations

import inspect
import threading
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Never, Self

from ssduck import validation
from ssduck.adapters.result import MAX_ROWS, Result, TableView
from ssduck.errors import LimitError, SelectScriptError, UnsupportedError, warn
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.namespace import check_name
from ssduck.interpreter.program import check_parameters
from ssduck.limits import GRACE, LEAST_OPENING, Limits
from ssduck.logic.why import Why
from ssduck.sandbox.budget import InvalidAnswerError
from ssduck.sandbox.live_worlds import LiveWorlds
from ssduck.sandbox.probes import check_present
from ssduck.sandbox.processes import WorkerEndedError, WorkerProcess, Zygote, shared_zygote
from ssduck.sandbox.references import RUN_SECONDS, NotInSandboxError, SandboxedWorld
from ssduck.sandbox.seal import Walls
from ssduck.sandbox.sources import Source, absolute
from ssduck.world.world import World

_GONE = "variables that programs have set are gone, and its worlds begin anew"
_IS_CALLED = "a function that a program in the sandbox calls cannot ask it: give it what it needs"
# A worker's address space beside the memory of its programs, bytes.
_SPARE = 10**9
_MOST = 2**47  # more than any machine has


@dataclass(frozen=True, eq=False)
class SandboxedProgram:
    """A program that the sandbox has parsed, and parses not again.

    Attributes:
        text: the text of the program.
    """

    text: str
    _owner: SandboxedInterpreter

    def shown(self) -> Any:
        """Returns the value of the program; the empty table of its columns if there are no rows."""
        return self._owner.ask("worker.show", self.text)

    def sql(self, dialect: str = "duckdb") -> str:
        """Returns the SQL of the query that ends the program, as `CompiledProgram.sql` does."""
        return str(self._owner.ask("worker.sql_of", self.text, dialect))


class SandboxedInterpreter:
    """Runs SelectScript programs and SQL in a process that can do no harm.

    It has the methods of `Interpreter`. Entities in results are `EntityReference`s, worlds are
    `SandboxedWorld`s. A program that takes too long, or ends its process, is a LimitError; the next
    question starts another process, with the variables that the host has set.

    Args:
        source: what the process opens.
        limits: the limits of programs, and the effects that the sandbox must have.
        strict: whether probable mistakes are errors.
        zygote: the process from which it is forked; by default that of this process.

    Attributes:
        is_stopped: tells whether another thread has stopped its programs; None if none can.

    Raises:
        SandboxError: the system lacks an effect, or the process does not start.
        SelectScriptError: the scene or record cannot be opened.
    """

    def __init__(
        self,
        source: Source | None = None,
        *,
        limits: Limits | None = None,
        strict: bool = False,
        zygote: Zygote | None = None,
    ) -> None:
        self._limits = Limits.strict() if limits is None else limits
        validation.instance(self._limits, Limits, "sandbox: limits")
        self._source = source or Source()
        self._strict = validation.boolean(strict, "sandbox: strict")
        self._zygote = zygote
        self._lock = threading.RLock()
        self.is_stopped: Callable[[], bool] | None = None
        # What the process gets again after it was ended.
        self._variables: dict[str, Any] = {}
        self._functions: dict[str, tuple[Callable[..., Any], str]] = {}
        self._triggers: dict[str, tuple[Callable[[Any], object], list[Any]]] = {}
        self._live = LiveWorlds()
        self._is_called = False
        self._worker: WorkerProcess | None = None
        self._is_closed = False
        try:
            self._start()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Ends the process."""
        with self._lock:
            self._is_closed = True
            self._live.close()
            self._end()
            self._source.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- the process ----------------------------------------------------------------------

    def ask(
        self,
        request: str,
        *arguments: Any,
        seconds: float = 0.0,
        updates_copies: bool = True,
        **options: Any,
    ) -> Any:
        """Asks the process, which is started again after it has ended.

        Args:
            request: what is asked, and for what, as `"ss.sql"`.
            arguments: its arguments.
            seconds: the time beside that of a program, s.
            updates_copies: whether copies of worlds become as the worlds are now.
            options: its named arguments.

        Raises:
            LimitError: there is no answer, because it took too long or the process ended.
        """
        with self._lock:
            if self._is_closed:
                raise LimitError("the interpreter is closed")
            if self._is_called:
                raise UnsupportedError(_IS_CALLED)
            if self._worker is not None and not self._worker.is_alive:
                self._worker = None
                warn(f"the process of the sandbox has ended; {_GONE}")
            if self._worker is None:
                self._start()
            try:
                limit = self._limits.seconds
                time = None if limit is None else limit + seconds + GRACE / 4
                if updates_copies:
                    self._live.update(partial(self._ask, time))
                return self._ask(time, request, *arguments, **options)
            except WorkerEndedError as error:
                self._worker, told = None, str(error)
                if error.is_late and not seconds:
                    told = f"the program took more than {limit:g} s, and its process was ended"
                raise LimitError(f"{told}; {_GONE}") from None

    def _ask(self, time: float | None, request: str, *arguments: Any, **options: Any) -> Any:
        assert self._worker is not None
        return self._worker.ask(
            request,
            arguments,
            options,
            seconds=time,
            world=self._world,
            name_of=self._live.name_of,
            call=self._called,
            is_stopped=self.is_stopped,
        )

    def _called(self, what: Any, *arguments: Any) -> Any:
        """Answers what the process asks before it answers."""
        self._is_called = True
        try:
            match what, *arguments:
                case "sensed", str(name):
                    return self._live.sensed(name)
                case "function", str(name), *given if name in self._functions:
                    return self._functions[name][0](*given)
                case "fired", str(name), value if name in self._triggers:
                    self._triggers[name][0](value)
                    return None
        finally:
            self._is_called = False
        raise InvalidAnswerError("it asks for something that is not here")

    def _world(self, name: str) -> SandboxedWorld:
        return SandboxedWorld(name, self.ask)

    def _start(self) -> None:
        """Starts a process, shows its effects, and has it open the source."""
        zygote = self._zygote or shared_zygote()
        memory = self._limits.memory or 10**9
        readable = (*self._source.readable, *absolute(self._limits.readable))
        walls = Walls("", readable, min(2 * memory + _SPARE, _MOST))
        self._worker = zygote.worker(walls, {"answer_bytes": self._limits.answer_bytes})
        own = self._limits
        limits = {name: getattr(own, name) for name in ("seconds", "rows", "depth", "eval")}
        # What a sandbox must not keep out may change nothing.
        limits["select_only"] = own.select_only and not own.require
        source, opening = self._source, max(self._limits.seconds or 0.0, LEAST_OPENING)
        ask = partial(self._ask, opening)
        try:
            effects = ask("worker.effects")
            check_present(self._limits.require, effects["holes"], effects["lacking"])
            ask("worker.open", source.kind, source.location, dict(source.options), limits)
            if self._strict:
                ask("worker.set_strict", True)
            self._live.begin_anew()
            self._live.update(ask)
            for name, (function, help) in self._functions.items():
                ask("worker.add_function", name, help, *_signature(function))
            for name, value in self._variables.items():
                try:
                    ask("worker.set_variables", {name: value})
                except SelectScriptError as error:  # an entity that is not there yet
                    warn(f"the variable {name!r} cannot be set again: {error.message}")
            for name, (_, settings) in self._triggers.items():
                ask("worker.add_trigger", name, *settings)
        except WorkerEndedError as error:
            self._end()
            raise LimitError(f"{source.location or 'the sandbox'}: {error}") from None
        except BaseException:
            self._end()
            raise

    def _end(self) -> None:
        if self._worker is not None:
            self._worker.end()
            self._worker = None

    @property
    def effects(self) -> dict[str, list[str]]:
        """What the process can do although an effect forbids it, by the effect: nothing, mostly."""
        return dict(self.ask("worker.effects")["holes"])

    # -- programs and SQL -----------------------------------------------------------------

    @property
    def strict(self) -> bool:
        """Whether a probable mistake in a program is an error instead of a warning."""
        return self._strict

    @strict.setter
    def strict(self, strict: bool) -> None:
        self._strict = validation.boolean(strict, "Interpreter: strict")
        self.ask("worker.set_strict", self._strict)

    def compile(self, text: str) -> SandboxedProgram:
        """Parses a program, as `Interpreter.compile` does."""
        text = validation.text(text, "a program is a text or a compiled program")
        self.ask("worker.check", text)
        return SandboxedProgram(text, self)

    def eval(
        self,
        program: str | SandboxedProgram,
        elements: Mapping[str, Any] | None = None,
        *,
        parameters: Mapping[str, Any] | None = None,
        **others: Any,
    ) -> Any:
        """Runs a program, as `Interpreter.eval` does."""
        given = elements if parameters is None else parameters
        if others or given is not None:
            check_parameters("eval", given, others)
        text, is_compiled = _text_of(program)
        return self.ask("worker.eval", text, None if given is None else dict(given), is_compiled)

    def show(self, program: str | SandboxedProgram, rows: int = MAX_ROWS) -> TableView:
        """Returns the result of a program as a table, as `Interpreter.show` does."""
        rows = validation.integer(rows, "show: rows", minimum=0)
        return TableView(self.ask("worker.show", _text_of(program)[0]), rows)

    def explain(self, program: str | SandboxedProgram) -> str:
        """Returns the SQL of a program and what Python evaluates, as `Interpreter.explain` does."""
        return str(self.ask("ss.explain", _text_of(program)[0]))

    def why(self, program: str | SandboxedProgram) -> Why:
        """Returns why the condition that ends a program holds, as `Interpreter.why` does."""
        why: Why = self.ask("ss.why", _text_of(program)[0])
        return why

    def sql(
        self,
        text: str,
        parameters: Sequence[Any] | Mapping[str, Any] | None = None,
        **others: Any,
    ) -> Result:
        """Runs SQL on the worlds' tables, as `Interpreter.sql` does."""
        validation.text(text, "sql: a statement is a text")
        check_parameters("sql", parameters, others)
        if parameters is not None:
            parameters = dict(parameters) if isinstance(parameters, Mapping) else list(parameters)
        result: Result = self.ask("ss.sql", text, parameters)
        return result

    def help(self, name: str | None = None) -> Any:
        """Returns the names of all functions, or the help of one, as `Interpreter.help` does."""
        return self.ask("ss.help", name)

    def history(self, name: str) -> list[tuple[float, Any]]:
        """Returns the values of a variable with a history, as `Interpreter.history` does."""
        return list(self.ask("ss.history", name))

    # -- variables and worlds -------------------------------------------------------------

    def add_variable(self, name: str, value: Any) -> Any:
        """Binds a plain value, an array, a table, an entity or a world to a name.

        A world of this process is copied into the sandbox: programs see its last tick, and those
        that were recorded since it was added. It stays bound when the process of a program has to
        be ended, as any value does.

        Raises:
            UnsupportedError: the value cannot go into the sandbox.
        """
        check_name(name, "a variable")
        with self._lock:
            if isinstance(value, World):
                self._live.add(name, value)
                try:
                    self.ask("ss.__contains__", name)
                except BaseException:
                    self._live.remove(name)
                    raise
                self._variables.pop(name, None)
            else:
                self.ask("worker.set_variables", {name: value})
                self._variables[name] = value
        return value

    def follow(self, name: str, world: World, owner: Interpreter, *, is_past: bool) -> None:
        """Copies a world of an interpreter of this process, unless that is being done.

        Args:
            name: the name of the copy.
            world: the world.
            owner: the interpreter, which records it or not.
            is_past: whether the copy goes to recorded ticks; else it is of the last tick.
        """
        with self._lock:
            self._live.add(name, world, owner, is_past=is_past)

    def __setitem__(self, name: str, value: Any) -> None:
        """Binds a value to a name, as `add_variable` does."""
        self.add_variable(name, value)

    def __getitem__(self, name: str) -> Any:
        """Returns the value of a variable; a world of the sandbox is a handle of it."""
        is_live = name in self._live and name not in self._variables
        return self._live[name] if is_live else self.ask("ss.__getitem__", name)

    call_variable = __getitem__
    addVariable, callVariable = add_variable, __getitem__  # noqa: N815  # the tutorial's names

    def __contains__(self, name: object) -> bool:
        """Checks whether a variable has a name."""
        return isinstance(name, str) and bool(self.ask("ss.__contains__", name))

    def __iter__(self) -> Iterator[str]:
        """Yields the names of the variables."""
        return iter(self.ask("worker.names"))

    @property
    def worlds(self) -> list[SandboxedWorld]:
        """The worlds, the first one first."""
        return [self._world(name) for name in self.ask("worker.worlds")]

    def run(self, seconds: float, *, every: int | None = 1) -> None:
        """Runs all worlds for a simulated time, s, as `Interpreter.run` does."""
        seconds = validation.duration(seconds, "run: seconds")
        self.ask("ss.run", seconds, every=every, seconds=seconds * RUN_SECONDS)

    # -- functions and triggers ------------------------------------------------------------

    def add_function(
        self, name: str, function: Callable[..., Any], help: str | None = None
    ) -> None:
        """Adds a function of this process, as `Interpreter.add_function` does.

        Programs in the sandbox choose its arguments: plain values, and references to entities. It
        cannot ask the sandbox.
        """
        validation.function(function, name)
        text = help if help is not None else inspect.getdoc(function) or f"Usage: {name}(...)"
        with self._lock:
            self.ask("worker.add_function", name, text, *_signature(function))
            self._functions[name] = function, text

    def del_function(self, name: str) -> None:
        """Removes a function that was added, as `Interpreter.del_function` does."""
        with self._lock:
            self.ask("ss.del_function", name)
            self._functions.pop(name, None)

    def add_trigger(
        self,
        name: str,
        program: str | SandboxedProgram,
        interval: float,
        callback: Callable[[Any], object],
        **options: Any,
    ) -> None:
        """Calls a function of this process, as `Interpreter.add_trigger` does.

        The program runs in the sandbox, as its worlds are stepped; of a world of this process, at
        each question. The callback cannot ask the sandbox.

        Raises:
            UnsupportedError: a queue is requested.
        """
        validation.function(callback, name)
        if options.pop("queue", None) is not None:
            raise UnsupportedError("add_trigger: queue: not in a sandbox; leave it out")
        with self._lock:
            settings = [_text_of(program)[0], interval, options]
            self._triggers[name] = callback, settings
            try:
                self.ask("worker.add_trigger", name, *settings)
            except BaseException:
                del self._triggers[name]
                raise

    def del_trigger(self, name: str) -> None:
        """Removes a trigger, as `Interpreter.del_trigger` does."""
        with self._lock:
            self.ask("ss.del_trigger", name)
            self._triggers.pop(name, None)

    addFunction, addTrigger, delTrigger = add_function, add_trigger, del_trigger  # noqa: N815

    def __repr__(self) -> str:
        return f"<SandboxedInterpreter: {self._source.location or 'empty'}>"

    def __getattr__(self, name: str) -> Never:
        if name in _NOT_HERE:
            raise NotInSandboxError(f"{name}: {_NOT_HERE[name]}")
        if not name.startswith("_") and hasattr(Interpreter, name):
            raise NotInSandboxError(
                f"{name}: not in a sandbox; an interpreter without Limits.strict() has it"
            )
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")


# What an interpreter has besides, and why a sandbox has it not.
_NOT_HERE = {
    **dict.fromkeys(("record", "record_to", "export"), "a program in the sandbox writes no record"),
    "view": "the page shows worlds of this process",
}


def _signature(function: Callable[..., Any]) -> tuple[list[list[Any]] | None, dict[str, str]]:
    """Returns the parameters of a function, and the names of the types in its hints."""
    try:
        parameters = inspect.signature(function).parameters.values()
        hints = typing.get_type_hints(function)
    except (TypeError, ValueError, NameError, AttributeError):
        return None, {}
    names = {
        name: str(hint) if typing.get_origin(hint) is not None else getattr(hint, "__name__", "")
        for name, hint in hints.items()
    }
    return [[p.name, p.kind.value, p.default is p.empty] for p in parameters], names


def _text_of(program: Any) -> tuple[str, bool]:
    if isinstance(program, SandboxedProgram):
        return program.text, True
    return validation.text(program, "a program is a text or a compiled program"), False
