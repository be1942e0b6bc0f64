"""Answers questions inside the wall: seals its process first, then opens a scene or a record.

A question is a list of a request and its arguments, an answer a list of the value and the warnings,
or of the error.
"""

from __future__ import annotations

import errno
import os
import signal
import tempfile
from collections.abc import Callable, Collection
from contextlib import ExitStack
from functools import lru_cache
from typing import Any

from sqlglot import exp

from ssduck.errors import LimitError, SceneError, UnknownNameError, UnsupportedError, check_known
from ssduck.formatting import short_repr
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.opening import load, opened_record
from ssduck.interpreter.program import CompiledProgram, rows_to_show
from ssduck.lazy import service
from ssduck.limits import Limits
from ssduck.recording.spec import Recording
from ssduck.sandbox.budget import Budget
from ssduck.sandbox.messages import Message, receive, send
from ssduck.sandbox.probes import holes
from ssduck.sandbox.references import PROPERTIES
from ssduck.sandbox.reports import Log, told_error
from ssduck.sandbox.seal import Walls, seal
from ssduck.sandbox.values import Decoder, Encoder
from ssduck.schema import TABLES
from ssduck.world.running import run
from ssduck.world.world import World

# What the host sends is limited by its own memory only.
_UNLIMITED = 1 << 60
# DuckDB gets this share of a worker's memory; the rest is Python's and the simulator's.
_DUCKDB_SHARE = 2


def serve(
    connection: int, walls: Walls, order: dict[str, Any], without: Collection[str] = ()
) -> None:
    """Seals this process, and answers questions until the host has no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    scratch = str(walls.scratch)
    os.chdir(scratch)
    names = ("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR")
    os.environ.update(dict.fromkeys(names, scratch))
    tempfile.tempdir = scratch
    lacking = seal(walls, without)
    worker = Worker(walls, {"holes": holes(walls), "lacking": lacking})
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
    """

    def __init__(self, walls: Walls, effects: dict[str, Any]) -> None:
        self._walls = walls
        self._effects = effects
        self._log = Log()
        self._ss: Interpreter | None = None
        self._answers: Any = None
        # A lake, and the limits of what it is asked.
        self._lake: Any = None
        self._limits: Limits | None = None
        self._record: str | None = None
        self._task: Any = None
        self._compiled = lru_cache(256)(self._parsed)

    def _parsed(self, text: str) -> CompiledProgram:
        return self.ss.compile(text)

    @property
    def ss(self) -> Interpreter:
        """The interpreter."""
        if self._ss is None:
            raise LimitError("nothing is open in the sandbox")
        return self._ss

    def answer(
        self, question: Message, budget: Budget
    ) -> tuple[int, bytes, list[bytes | memoryview]]:
        """Returns the answer to a question: its number, its JSON and the parts of its body."""
        encoder = Encoder(budget, self._name_of)
        try:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            decoder = Decoder(
                question.body, Budget(_UNLIMITED), entity=self._entity, world=self._world
            )
            request, *arguments = decoder.value(question.document)
            value = _REQUESTS[request](self, *arguments)
            text = encoder.text([value, self._log.taken()])
        except BaseException as error:  # noqa: BLE001  # the host raises it
            encoder = Encoder(Budget(), self._name_of)
            text = encoder.text([None, self._log.taken(), told_error(error)])
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        return question.number, text, encoder.parts

    def _world(self, name: str) -> World:
        value = self.ss[name]
        if not isinstance(value, World):
            raise UnknownNameError(f"{name!r} is no world of the sandbox")
        return value

    def _name_of(self, world: World) -> str:
        """Returns the variable that has a world."""
        for name in (world.name, *self.ss):
            if name in self.ss and self.ss[name] is world:
                return str(name)
        raise UnsupportedError(
            "a world that no variable has cannot cross the wall of the sandbox; bind it, as in "
            "part = SELECT … AS environment;"
        )

    def _entity(self, world: str, id: int, _: str, _kind: str, tick: int | None, *_own: str) -> Any:
        if tick is not None:
            raise UnsupportedError("an entity of a past tick cannot go back into the sandbox")
        return self._world(world).handle(id)

    # -- requests -------------------------------------------------------------------------

    def effects(self) -> dict[str, Any]:
        """Returns what the process can do although an effect forbids it, and what it lacks."""
        return self._effects

    def open(
        self, kind: str, location: str, options: dict[str, Any], limits: dict[str, Any]
    ) -> None:
        """Opens a scene, a record, a lake, a task, or nothing."""
        allowed = Limits(**limits, files=False, progress=False)
        recording = options.get("recording")
        if isinstance(recording, dict):
            options["recording"] = Recording(**recording)
        if kind == "lake":
            self._lake, self._limits = service("lake")(location), allowed
            return
        with ExitStack() as stack:
            if kind == "scene":
                ss = _loaded(location, allowed, options)
            elif kind == "record":
                ss = opened_record(location, limits=allowed, **options)
                self._record = location
            elif kind == "task":
                self._task = service("task")(location, limits=allowed)
                ss = self._task.interpreter
            else:
                ss = Interpreter(limits=allowed, **options)
            stack.callback(ss.close)
            # The wall holds without it, too.
            ss._database.confine(self._walls.memory // _DUCKDB_SHARE)  # noqa: SLF001  # the one door
            stack.pop_all()
        self._ss = ss

    def eval(self, text: str, parameters: Any, is_compiled: bool) -> Any:
        """Runs a program."""
        program = self._compiled(text) if is_compiled else text
        return self.ss.eval(program, parameters=parameters)

    def show(self, text: str) -> Any:
        """Runs a program, and returns the columns of its query even if it has no rows."""
        return rows_to_show(self._compiled(text), self.ss.eval)

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

    def worlds(self) -> list[str]:
        """Returns the names of the variables that are worlds, in the order of the worlds."""
        return [name for world in self.ss.worlds for name in self.ss if self.ss[name] is world]

    def state(self, name: str) -> dict[str, Any]:
        """Returns what a handle of a world tells."""
        world = self._world(name)
        return {
            "time": world.time,
            "tick": world.tick_number,
            "timestep": world.timestep,
            "entities": len(world),
        }

    def table(self, name: str, table: str) -> Any:
        """Returns a table of a world's current tick."""
        self._world(name)
        check_known(table, TABLES, f"there is no table {short_repr(table)}")
        path = exp.table_(table, db=name, quoted=True).sql("duckdb")
        return self.ss.sql(f"FROM {path}").arrow()

    def entities(self, name: str) -> list[Any]:
        """Returns the entities of a world."""
        return list(self._world(name))

    def entity(self, name: str, entity: str) -> Any:
        """Returns the entity of a name."""
        return self._world(name)[entity]

    def property_of(self, entity: Any, name: str) -> Any:
        """Returns a property of an entity."""
        if name not in PROPERTIES:
            raise UnknownNameError(f"there is no property {name!r}")
        return getattr(entity, name)

    def step(self, name: str, count: int, every: int | None) -> None:
        """Steps a world."""
        self._world(name).step(count, every=every)

    def run(self, names: list[str] | None, seconds: float, every: int | None) -> None:
        """Runs worlds, or all of them."""
        if names is None:
            self.ss.run(seconds, every=every)
        else:
            run([self._world(name) for name in names], seconds, every=every)

    def tick(self, name: str) -> None:
        """Takes a tick of a world."""
        self._world(name).tick()

    def of_lake(self, method: str, arguments: list[Any], options: dict[str, Any]) -> Any:
        """Returns what a lake answers."""
        value = getattr(self._lake, method)
        if method in ("ask", "score"):
            options |= {"limits": self._limits, "processes": 1, "progress": False}
        return value(*arguments, **options) if callable(value) else value

    def told(self, method: str, arguments: list[Any]) -> Any:
        """Returns an answer to an agent."""
        if self._answers is None:
            self._answers = service("agent answers")(self.ss, self._record)
        return getattr(self._answers, method)(*arguments)

    def set_strict(self, strict: bool) -> None:
        """Makes probable mistakes errors, or warnings."""
        self.ss.strict = strict


def _loaded(scene: str, limits: Limits, options: dict[str, Any]) -> Interpreter:
    try:
        return load(scene, limits=limits, **options)
    except (SceneError, PermissionError) as error:
        told = str(error)
        if os.strerror(errno.EACCES) not in told:
            raise
        name = "" if isinstance(error, SceneError) else f"{scene} cannot be loaded: "
        raise SceneError(f"{name}{told}; in a sandbox a scene reads its own folder only") from error


_REQUESTS: dict[str, Callable[..., Any]] = {
    **{
        name: getattr(Worker, name)
        for name in (
            *("effects", "open", "eval", "show", "sql_of", "check", "set_variables", "worlds"),
            *("state", "table", "entities", "entity", "property_of"),
            *("step", "run", "tick", "set_strict"),
        )
    },
    "sql": lambda worker, text, parameters: worker.ss.sql(text, parameters),
    "explain": lambda worker, text: worker.ss.explain(text),
    "answer": Worker.told,
    "of_lake": Worker.of_lake,
    "task": lambda worker: worker._task.task.values,  # noqa: SLF001
    "reset": lambda worker, seed: worker._task.reset(seed=seed),  # noqa: SLF001
    "act": lambda worker, action: worker._task.step(action),  # noqa: SLF001
    "help": lambda worker, name: worker.ss.help(name),
    "history": lambda worker, name: worker.ss.history(name),
    "variable": lambda worker, name: worker.ss[name],
    "names": lambda worker: list(worker.ss),
    "has": lambda worker, name: name in worker.ss,
}
