"""Answers questions inside the wall: seals its process first, then opens a scene or a record.

A question is a list of a request, its arguments and its options. The request says what is asked and
for what, as `"ss.sql"`; the object of `"it.step"` is the first argument. An answer is a list of the
value and the warnings, or of the error.
"""

from __future__ import annotations

import errno
import inspect
import os
import signal
import tempfile
import threading
from collections.abc import Callable
from contextlib import ExitStack
from functools import lru_cache, partial
from itertools import count
from typing import Any

from sqlglot import exp

from ssduck.errors import LimitError, SceneError, UnknownNameError, UnsupportedError, check_known
from ssduck.formatting import short_repr
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.mirrors import WorldCopy, WorldDescription, WorldNews, history_of
from ssduck.interpreter.opening import load, opened_record
from ssduck.interpreter.program import CompiledProgram, rows_to_show
from ssduck.lazy import service
from ssduck.limits import Limits
from ssduck.recording.spec import Recording
from ssduck.sandbox.budget import UNLIMITED, Budget
from ssduck.sandbox.messages import Message, receive, send
from ssduck.sandbox.probes import holes
from ssduck.sandbox.reports import Log, called_error, told_error
from ssduck.sandbox.seal import Walls, seal
from ssduck.sandbox.tables import own_table
from ssduck.sandbox.values import Decoder, Encoder
from ssduck.schema import TABLES
from ssduck.world.ctrl_c import deferred
from ssduck.world.entities import Entity  # noqa: F401  # a hint of a host's function may name it
from ssduck.world.handles import Link  # noqa: F401
from ssduck.world.world import World

# DuckDB gets this share of a worker's memory; the rest is Python's and the simulator's.
_DUCKDB_SHARE = 2


def serve(connection: int, walls: Walls, order: dict[str, Any]) -> None:
    """Seals this process, and answers questions until the host has no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    scratch = str(walls.scratch)
    os.chdir(scratch)
    names = ("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR")
    os.environ.update(dict.fromkeys(names, scratch))
    tempfile.tempdir = scratch
    lacking = seal(walls)
    worker = Worker(walls, {"holes": holes(walls), "lacking": lacking}, connection)
    budget = int(order["answer_bytes"])
    while True:
        try:
            question = receive(connection)
        except EOFError:
            return
        number, document, parts = worker.answer(question, Budget(budget))
        send(connection, number, document, parts)


class Worker:
    """Answers questions about what it has opened.

    Args:
        walls: what the process may use.
        effects: what the host is told of them.
        connection: the socket to the host.
    """

    def __init__(self, walls: Walls, effects: dict[str, Any], connection: int) -> None:
        self._walls, self._connection = walls, connection
        # What the process can do although an effect forbids it, and what it lacks.
        self.effects = effects
        self._log = Log()
        # What questions are about, by name: the interpreter, and what higher layers offer.
        self._opened: dict[str, Any] = {"worker": self}
        self._record: str | None = None
        self._copies: dict[str, WorldCopy] = {}
        self._compiled = lru_cache(256)(self._parsed)
        self._number, self._budget = 0, Budget()
        self._calling = threading.Lock()

    def _parsed(self, text: str) -> CompiledProgram:
        return self.ss.compile(text)

    @property
    def ss(self) -> Interpreter:
        """The interpreter."""
        if "ss" not in self._opened:
            raise LimitError("nothing is open in the sandbox")
        ss: Interpreter = self._opened["ss"]
        return ss

    def answer(
        self, question: Message, budget: Budget
    ) -> tuple[int, bytes, list[bytes | memoryview]]:
        """Returns the answer to a question: its number, its JSON and the parts of its body."""
        encoder = Encoder(budget, self._name_of)
        self._number, self._budget = question.number, budget
        try:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            request, arguments, options = self._decoded(question)
            what, *path = request.split(".")
            if what == "it":
                value, *arguments = arguments
            else:
                value = self._object(what)
            for name in path:
                value = getattr(value, name)
            if callable(value):
                value = value(*arguments, **options)
            text = encoder.text([value, self._log.taken()])
        except BaseException as error:  # noqa: BLE001  # the host raises it
            encoder = Encoder(Budget(), self._name_of)
            text = encoder.text([None, self._log.taken(), told_error(error)])
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        return question.number, text, encoder.parts

    def _object(self, what: str) -> Any:
        """Returns what a question is about; answers for agents and pages are made when asked."""
        if what not in self._opened and what != "ss":
            self._opened[what] = service(what)(self.ss, self._record)
        return self.ss if what == "ss" else self._opened[what]

    def _decoded(self, message: Message) -> Any:
        decoder = Decoder(
            message.body,
            Budget(UNLIMITED),
            entity=self._entity,
            world=self._world,
            table=own_table,
        )
        return decoder.value(message.document)

    def call(self, name: str, *arguments: Any) -> Any:
        """Asks the host for something while a question is answered; any thread may call it."""
        encoder = Encoder(self._budget, self._name_of)
        text = encoder.text([name, arguments])
        with self._calling, deferred():  # a reply that nobody takes is taken for a question
            send(self._connection, self._number, text, encoder.parts, is_call=True)
            value, *error = self._decoded(receive(self._connection))
        if error:
            raise called_error(error[0])
        return value

    def _world(self, name: str) -> World:
        value = self.ss[name]
        if not isinstance(value, World):
            raise UnknownNameError(f"{name!r} is no world of the sandbox")
        return value

    def _name_of(self, world: World) -> str:
        """Returns the variable that has a world; one that a program made gets a new variable."""
        for name in (world.name, *self.ss):
            if name in self.ss and self.ss[name] is world:
                return str(name)
        name = next(name for i in count(1) if (name := f"environment{i}") not in self.ss)
        self.ss.add_variable(name, world)
        return name

    def _entity(self, world: str, id: int, _: str, _kind: str, tick: int | None, *_own: str) -> Any:
        own = self._world(world)
        if tick is None:
            return own.handle(id)
        history = history_of(self.ss, own)
        if history is None or id not in history.record.members:
            raise UnsupportedError(f"the past of {world!r} is gone, and so is its entity")
        return history.record.handle(tick, id)

    # -- requests -------------------------------------------------------------------------

    def open(
        self, kind: str, location: str, options: dict[str, Any], limits: dict[str, Any]
    ) -> None:
        """Opens a scene, a record, a lake, a task, or nothing."""
        allowed = Limits(**limits, files=False, progress=False)
        recording = options.get("recording")
        if isinstance(recording, dict):
            options["recording"] = Recording(**recording)
        if kind == "lake":
            self._opened[kind] = service(kind)(location, allowed)
            return
        with ExitStack() as stack:
            if kind == "scene":
                ss = _loaded(location, allowed, options)
            elif kind == "record":
                ss = opened_record(location, limits=allowed, **options)
                self._record = location
            elif kind == "task":
                self._opened[kind] = service(kind)(location, limits=allowed)
                ss = self._opened[kind].interpreter
            else:
                ss = Interpreter(limits=allowed, **options)
            stack.callback(ss.close)
            # The wall holds without it, too.
            ss._database.raw_sql.seal(self._walls.memory // _DUCKDB_SHARE)  # noqa: SLF001  # the one door
            stack.pop_all()
        self._opened["ss"] = ss

    def eval(self, text: str, parameters: Any, is_compiled: bool) -> Any:
        """Runs a program."""
        program = self._compiled(text) if is_compiled else text
        return self.ss.eval(program, parameters=parameters)

    def show(self, text: str) -> Any:
        """Runs a program, and returns the columns of its query even if it has no rows."""
        return rows_to_show(self._compiled(text), self.ss)

    def sql_of(self, text: str, dialect: str) -> str:
        """Returns the SQL of a program."""
        program: CompiledProgram = self._compiled(text)
        return program.sql(dialect)

    def check(self, text: str) -> None:
        """Parses a program."""
        self._compiled(text)

    def set_variables(self, values: dict[str, Any]) -> None:
        """Sets variables."""
        for name, value in values.items():
            self.ss.add_variable(name, value)

    def names(self) -> list[str]:
        """Returns the names of the variables."""
        return list(self.ss)

    def worlds(self) -> list[str]:
        """Returns the names of the variables that are worlds, in the order of the worlds."""
        return [name for world in self.ss.worlds for name in self.ss if self.ss[name] is world]

    def table(self, name: str, table: str) -> Any:
        """Returns a table of a world's current tick."""
        check_known(table, TABLES, f"there is no table {short_repr(table)}")
        path = exp.table_(table, db=name, quoted=True).sql("duckdb")
        return self.ss.sql(f"FROM {path}").arrow()

    def entities(self, world: World) -> list[Any]:
        """Returns the entities of a world."""
        return list(world)

    def set_strict(self, strict: bool) -> None:
        """Makes probable mistakes errors, or warnings."""
        self.ss.strict = strict

    def copy_world(self, description: dict[str, Any]) -> None:
        """Begins a copy of a world of the host, in place of an earlier one of its name."""
        told = WorldDescription(**description)

        def sensed() -> WorldNews:
            return WorldNews(**self.call("sensed", told.name))

        self._copies[told.name] = WorldCopy(self.ss, told, sensed)

    def update_world(self, name: str, news: dict[str, Any]) -> None:
        """Takes over what is new in a world of the host; triggers see its tick."""
        copy = self._copies[name]
        copy.apply(WorldNews(**news))
        copy.world.notify_observers()

    def add_function(self, name: str, help: str, parameters: Any, hints: dict[str, str]) -> None:
        """Adds a function of the host."""
        self.ss.add_function(name, _stand_in(self.call, name, parameters, hints), help)

    def add_trigger(self, name: str, program: str, interval: float, options: Any) -> None:
        """Adds a trigger whose callback is in the host."""
        self.ss.add_trigger(name, program, interval, partial(self.call, "fired", name), **options)


def _stand_in(
    call: Callable[..., Any], name: str, parameters: Any, hints: dict[str, str]
) -> Callable[..., Any]:
    """Returns a function with the parameters of one of the host, which calls that one."""

    def stand_in(*arguments: Any) -> Any:
        return call("function", name, *arguments)

    if parameters is not None:
        defaults = {True: inspect.Parameter.empty, False: None}
        made = [
            inspect.Parameter(own, inspect._ParameterKind(kind), default=defaults[is_required])  # noqa: SLF001
            for own, kind, is_required in parameters
        ]
        stand_in.__signature__ = inspect.Signature(made)  # type: ignore[attr-defined]
    stand_in.__annotations__ = hints
    return stand_in


def _loaded(scene: str, limits: Limits, options: dict[str, Any]) -> Interpreter:
    try:
        return load(scene, limits=limits, **options)
    except (SceneError, PermissionError) as error:
        told = str(error)
        if os.strerror(errno.EACCES) not in told:
            raise
        name = "" if isinstance(error, SceneError) else f"{scene} cannot be loaded: "
        raise SceneError(f"{name}{told}; in a sandbox a scene reads its own folder only") from error
