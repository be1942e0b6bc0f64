"""Copies of a live world in interpreters of their own: their queries do not delay the simulation.

A mirror has the last tick, or any recorded one, with the ticks before it. Recorded rows in memory
are shared, not copied. A record in a file is not mirrored: its own store has to read it, and a
program that asks the mirror for its past gets an error that says so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any, NoReturn

from ssduck.database.binding import WorldHistory
from ssduck.errors import UnsupportedError
from ssduck.interpreter.interpreter import Interpreter
from ssduck.limits import Limits
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.replay.record import Record
from ssduck.recording.replay.replayed_world import MirroredWorld, ReplayedWorld
from ssduck.recording.stores.base import TickArchive
from ssduck.recording.stores.memory import MemoryStore
from ssduck.world.entities import Sensor
from ssduck.world.layout import EntityInfo
from ssduck.world.world import World

# The schema of the models of the entities in a mirror.
_SCHEMA = "mirrored"
# The table of what sensors perceive.
_SENSINGS = "sensings"


def history_of(ss: Interpreter, world: World) -> WorldHistory | None:
    """Returns the recorded ticks of a world of an interpreter; None if it is not recorded."""
    return ss._database.history_of(world)  # noqa: SLF001  # one package


def listen_to_triggers(ss: Interpreter, listener: Callable[[str], object]) -> Callable[[], None]:
    """Calls a function with the name of each trigger that fires; returns what ends that."""
    listeners = ss._triggers.listeners  # noqa: SLF001  # one package
    listeners.append(listener)
    return partial(listeners.remove, listener)


class _LiveCopy(MirroredWorld):
    """A copy of the last tick of a live world that also has what its sensors perceive there.

    Rays are cast in the live world, and only for a program that asks for them.
    """

    _has_sensings = False

    def __init__(
        self, world: World, name: str, history: _HistoryCopy | _HistoryElsewhere | None
    ) -> None:
        self._original = world
        store, record = (None, None) if history is None else (history.store, history.record)
        super().__init__(world, name, store, record)

    @property
    def is_up_to_date(self) -> bool:
        """Whether the last tick of the world is this one, with the same sensors on."""
        original = self._original
        return self.tick_number == original.tick_number and _switches(self) == _switches(original)

    def update(self, world: World) -> None:
        """Copies the last tick of the world."""
        super().update(world)
        self._has_sensings = False

    def request_tables(self, tables: Iterable[str]) -> None:
        """Ensures that the tick includes tables; for sensors, the last tick is copied again."""
        requested = frozenset(tables)
        if _SENSINGS in requested and not self._has_sensings:
            with self._original.lock:
                self._original.request_tables((_SENSINGS,))
                self.update(self._original)
            self._has_sensings = True
        super().request_tables(requested - {_SENSINGS})

    def reading(self, sensor: Sensor, *, picture: bool = False) -> NoReturn:  # noqa: ARG002
        """Raises `UnsupportedError`: a copy has no rays and no pictures."""
        raise UnsupportedError(
            f"the reading of {sensor.name!r} is not in a copy of a tick: read it in the world "
            "itself, or ask for isSensing, sensingAmount or the table sensings"
        )


def _switches(world: World) -> dict[int, bool]:
    """Returns which sensors are switched on, by their ids."""
    snapshot = world.snapshot
    return {
        info.id: snapshot.sensing.is_on(info.id)
        for info in snapshot.entities
        if info.sensor is not None
    }


class Mirror:
    """An interpreter with a copy of a live world.

    Args:
        ss: the interpreter of the world.
        world: the world.
        name: the name of the copy.
        limits: the limits of programs that ask the copy.
        is_past: whether the copy goes to recorded ticks; else it is of the last tick.

    Attributes:
        original: the live world.
        interpreter: has the copy under its name.
        world: the copy.

    Raises:
        UnsupportedError: a copy of the past is requested, and no tick is recorded in memory.
    """

    def __init__(
        self, ss: Interpreter, world: World, name: str, limits: Limits, *, is_past: bool = False
    ) -> None:
        self.original = world
        self._history = history_of(ss, world)
        self._owner = ss
        self.interpreter = Interpreter(recording=None, limits=limits)
        self.interpreter.strict = True
        self._copy = _copy_of(self._history, self.interpreter, world, name)
        try:
            self._update_history()
            self.world = self._copied_world(name, is_past=is_past)
            self.interpreter.add_variable(name, self.world)
        except BaseException:
            self.interpreter.close()
            raise

    def _copied_world(self, name: str, *, is_past: bool) -> _LiveCopy | ReplayedWorld:
        copy = self._copy
        if not is_past:
            return _LiveCopy(
                self.original, name, copy or _elsewhere(self._history, self.original, name)
            )
        if copy is None and self._history is not None:
            raise UnsupportedError(_past_in_a_file(name))
        if copy is None or not len(copy.ticks):
            raise UnsupportedError(
                f"the past of {name!r} is not in memory: record it there, or open its record"
            )
        return ReplayedWorld(name, copy.record, copy.store, self.original.camera)

    @property
    def is_up_to_date(self) -> bool:
        """Whether the world is recorded in the same history, so that `update` can follow it."""
        return history_of(self._owner, self.original) is self._history

    def update(self) -> None:
        """Copies what is new."""
        original, world = self.original, self.world
        with original.lock:
            self._update_history()
            if isinstance(world, _LiveCopy) and not world.is_up_to_date:
                world.update(original)

    def _update_history(self) -> None:
        if self._copy is not None and self._history is not None:
            with self.original.lock:
                self._copy.update(self._history, self.original)

    def close(self) -> None:
        """Closes its interpreter; the world goes on."""
        self.interpreter.close()


@dataclass(frozen=True, eq=False)
class _HistoryCopy:
    """A copy of recorded ticks in memory."""

    store: MemoryStore
    record: Record
    ticks: TickBuffer
    members: dict[int, EntityInfo]

    def update(self, history: WorldHistory, world: World) -> None:
        """Copies what is new; the caller holds the world."""
        recorder, store = history.recorder, history.store
        assert recorder is not None
        assert isinstance(store, MemoryStore)
        with recorder.read_lock:
            new = [info for id, info in recorder.members.items() if id not in self.members]
            if new:
                self.store.add_members(new, world.snapshot)
                self.members.update({info.id: info for info in new})
            self.store.share(store, recorder.buffers)
            numbers, times = recorder.ticks.numbers, recorder.ticks.times
            last = int(self.ticks.numbers[-1]) if len(self.ticks) else 0
            for number, time in zip(numbers.tolist(), times.tolist(), strict=True):
                if number > last:
                    self.ticks.append(number, time)
            if len(numbers):
                self.ticks.drop_before(int(numbers[0]))


def _copy_of(
    history: WorldHistory | None, ss: Interpreter, world: World, name: str
) -> _HistoryCopy | None:
    """Returns an empty copy of recorded ticks; None if they are not in memory."""
    if history is None or history.recorder is None or not isinstance(history.store, MemoryStore):
        return None
    connection = ss._database.connection.writer()  # noqa: SLF001  # one package
    store = MemoryStore(_SCHEMA, connection, history.store.recording, name)
    ticks, members = TickBuffer(), dict[int, EntityInfo]()
    record = Record(
        None,
        ticks,
        members,
        store.tables,
        store.fetch,
        lambda request: store.near_pairs(request, None),
        geometries=world.snapshot.geometries,
        run=world.snapshot.run,
        source="the copy of its ticks",
        entities=history.store.recording.entities,
    )
    return _HistoryCopy(store, record, ticks, members)


def _past_in_a_file(world: str) -> str:
    """Returns the message that a mirror has no past, as the ticks are in a file."""
    return (
        f"the past of {world!r} is in a database file, which only its own interpreter reads: ask "
        "there, or open the file; a world of an interpreter without a file has its past here"
    )


class _FileArchive(TickArchive):
    """Recorded ticks that a mirror cannot read."""

    def __init__(self, archive: TickArchive, world: str) -> None:
        self.recording, self.tables, self._world = archive.recording, archive.tables, world

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise UnsupportedError(_past_in_a_file(self._world))

    select = models = fetch = near_pairs = _refuse

    def close(self, *, forget: bool) -> None:
        """Does nothing: the file stays open in its own interpreter."""


@dataclass(frozen=True, eq=False)
class _HistoryElsewhere:
    """Recorded ticks that a mirror cannot read: each access is an error that says why."""

    store: _FileArchive
    record: Record


def _elsewhere(history: WorldHistory | None, world: World, name: str) -> _HistoryElsewhere | None:
    """Returns the recorded ticks of a world that are not in memory; None if nothing is recorded."""
    if history is None:
        return None
    store, snapshot = _FileArchive(history.store, name), world.snapshot
    record = Record(
        None,
        history.record.ticks,
        history.record.members,
        store.tables,
        store.fetch,
        store.near_pairs,
        geometries=snapshot.geometries,
        run=snapshot.run,
        source="the record in a file",
    )
    return _HistoryElsewhere(store, record)
