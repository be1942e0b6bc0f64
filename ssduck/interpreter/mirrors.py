"""Copies of live worlds: a feed tells what is new there, as tables, and a copy takes it over.

A copy is in an interpreter of its own, so that its queries do not delay the simulation: in this
process (`Mirror`), or in that of a sandbox. It has the last tick, or goes to any recorded one, with
the ticks before it. Recorded rows in memory are shared in one process. A record in a file is not
copied: its own interpreter has to read it, and a program that asks the copy for its past gets an
error that says so.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import count, islice
from typing import Any, NoReturn, TypeAlias

import numpy as np
import pyarrow as pa

from ssduck.database.binding import WorldHistory
from ssduck.errors import UnsupportedError
from ssduck.geometry.margins import Margins
from ssduck.interpreter.interpreter import Interpreter
from ssduck.limits import Limits
from ssduck.recording.buffers import TickBuffer, buffer_schema
from ssduck.recording.replay.record import Record
from ssduck.recording.replay.replayed_world import (
    CopiedWorld,
    CopyTicker,
    ReplayedWorld,
    ReplayTicker,
)
from ssduck.recording.row_selection import RecordedRows
from ssduck.recording.spec import Recording, description_of
from ssduck.recording.static_tables import geometries_of, members_of, model_rows
from ssduck.recording.stores.base import TickArchive
from ssduck.recording.stores.descriptions import camera_of, camera_text
from ssduck.recording.stores.memory import MemoryStore
from ssduck.recording.stores.stored_columns import conformed
from ssduck.schema import MARGINS, MASSES, RECORDABLE, recorded_tables
from ssduck.simulators.partial import StaticSimulator
from ssduck.world.ctrl_c import deferred
from ssduck.world.layout import EntityInfo
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World

# Number the schemas of the models of the entities in copies.
_numbers = count()
# The table of what sensors perceive: rays are cast for a program that asks for it only.
_SENSINGS = "sensings"
_Tables: TypeAlias = dict[str, pa.Table]
_Pairs: TypeAlias = tuple[Mapping[int, list[int]], list[list[float]]]
_PRESENT = tuple(name for name in RECORDABLE if name != _SENSINGS)


def history_of(ss: Interpreter, world: World) -> WorldHistory | None:
    """Returns the recorded ticks of a world of an interpreter; None if it is not recorded."""
    return ss._database.history_of(world)  # noqa: SLF001  # one package


def listen_to_triggers(ss: Interpreter, listener: Callable[[str], object]) -> Callable[[], None]:
    """Calls a function with the name of each trigger that fires; returns what ends that."""
    listeners = ss._triggers.listeners  # noqa: SLF001  # one package
    listeners.append(listener)
    return partial(listeners.remove, listener)


# -- what is new in a world -------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class WorldNews:
    """What a copy of a world lacks: tables, texts and numbers, which any process understands."""

    tick: int  # the number of the last tick
    time: float  # its simulated time, s
    models: Mapping[str, pa.Table]  # the models of entities that are new there, by table
    rows: Mapping[str, pa.Table]  # the rows of the last tick, by table
    past_models: Mapping[str, pa.Table]  # the models of entities that were recorded first
    past: Mapping[str, pa.Table]  # the rows of recorded ticks that are new; empty if there are none
    first: int  # the number of the first recorded tick that is there
    # The classes of shapes by body, and the margins of two, (k, k), m; None for the sums.
    pairs: _Pairs | None


@dataclass(frozen=True, eq=False)
class WorldDescription:
    """What a copy is made with."""

    name: str  # the name of the copy
    run: int  # the number of the run of the world
    camera: Mapping[str, Any]  # the camera of the world
    # What is recorded of it in memory, as arguments of `Recording`; None for nothing.
    recording: Mapping[str, Any] | None
    is_elsewhere: bool  # whether its past is in a file, which the copy cannot read
    is_past: bool  # whether the copy goes to recorded ticks


class WorldFeed:
    """Tells one copy of a live world what is new.

    Args:
        ss: the interpreter of the world.
        world: the world.
        name: the name of the copy.
        is_past: whether the copy goes to recorded ticks; else it is of the last tick.

    Attributes:
        world: the world.
        description: what the copy is made with.

    Raises:
        UnsupportedError: a copy of the past is requested, and no tick is recorded in memory.
    """

    def __init__(self, ss: Interpreter, world: World, name: str, *, is_past: bool = False) -> None:
        self.world, self._owner = world, ss
        history = self._history = history_of(ss, world)
        is_elsewhere = history is not None and (
            history.recorder is None or ss._database.connection.is_file  # noqa: SLF001
        )
        if is_past and is_elsewhere:
            raise UnsupportedError(_past_in_a_file(name))
        if is_past and (history is None or not len(history.record.ticks)):
            raise UnsupportedError(
                f"the past of {name!r} is not in memory: record it there, or open its record"
            )
        self._recorder = None if history is None or is_elsewhere else history.recorder
        recording = None
        if self._recorder is not None:
            recording = description_of(replace(self._recorder.recording, changed=False))
        self.description = WorldDescription(
            name,
            world.snapshot.run,
            camera_text(world.camera),
            recording,
            is_elsewhere=is_elsewhere,
            is_past=is_past,
        )
        self._rows: tuple[tuple[str, ...], RecordedRows] | None = None
        # What the copy has: masses and margins of entities by id, recorded entities, geometries,
        # ticks.
        self._dynamics: dict[int, tuple[list[float], list[float]]] = {}
        self._recorded = set[int]()
        self._geometries = set[int]()
        self._last_recorded = 0
        self._told: tuple[Any, ...] | None = None

    @property
    def is_up_to_date(self) -> bool:
        """Whether the copy can follow the world: its past, masses and margins are the same."""
        if history_of(self._owner, self.world) is not self._history:
            return False
        with self.world.lock:
            self.world.request_tables((MASSES, MARGINS))
            present, told = self._present_dynamics, self._told
            if told is not None and told[1] is not None and self._pairs is None:
                return False
            return all(present.get(id, own) == own for id, own in self._dynamics.items())

    def news(self, *, is_sensed: bool = False) -> WorldNews | None:
        """Returns what is new since the last call; None if nothing is.

        Args:
            is_sensed: whether the last tick is to include what sensors perceive, which is read on
                request only.
        """
        world = self.world
        with world.lock:
            if self._present == self._told and not is_sensed:
                return None
            past = self._news_of_past()
            more = (_SENSINGS,) if is_sensed else ()
            models, rows = ({}, {}) if self.description.is_past else self._news_of_tick(more)
            self._told = self._present
            return WorldNews(world.tick_number, world.time, models, rows, *past, self._pairs)

    @property
    def _present(self) -> tuple[Any, ...]:
        """What tells states of the world apart: tick, margins of pairs, sensors that are on."""
        snapshot = self.world.snapshot
        sensors = (info.id for info in snapshot.entities if info.sensor is not None)
        are_on = [(id, snapshot.sensing.is_on(id)) for id in sensors]
        return snapshot.number, snapshot.margins_of_pairs, are_on

    def _news_of_tick(self, more: Collection[str]) -> tuple[_Tables, _Tables]:
        """Returns the models of new entities, and the rows of the last tick."""
        tables = recorded_tables((*_PRESENT, *more))
        with self.world.pinned((MASSES, MARGINS, *tables)):
            snapshot = self.world.snapshot
            if self._rows is None or self._rows[0] != tables or not self._rows[1].matches(snapshot):
                self._rows = tables, RecordedRows(snapshot, tables, None)
            selected = self._rows[1]
            assert snapshot.state is not None
            of_tick = selected.of_ticks([snapshot.state])
            rows = {table: of_table.arrow(table) for table, of_table in of_tick.items()}
            present, new = self._present_dynamics, []
            for member in selected.members:
                if member.id not in self._dynamics:
                    masses, margins = self._dynamics[member.id] = present.get(member.id, ([], []))
                    new.append(member.with_masses(masses).with_margins(margins))
            return self._models(new, with_visuals=True), rows

    @property
    def _present_dynamics(self) -> dict[int, tuple[list[float], list[float]]]:
        """The masses of the links and the margins of the shapes of each body, kg and m, by id."""
        snapshot = self.world.snapshot
        margins = iter(snapshot.tables["shapes"]["margin"].tolist())
        return {
            id: (
                snapshot.masses.get(id, [link.mass for link in body.links]),
                list(islice(margins, len(body.shapes))),
            )
            for id, body in snapshot.layout.bodies
        }

    @property
    def _pairs(self) -> _Pairs | None:
        pairs, bodies = self.world.snapshot.margins_of_pairs, self.world.snapshot.layout.bodies
        if pairs is None or pairs.classes is None or pairs.of_classes is None:
            return None
        classes = iter(pairs.classes.tolist())
        of_bodies = {id: list(islice(classes, len(body.shapes))) for id, body in bodies}
        return of_bodies, pairs.of_classes.tolist()

    def _news_of_past(self) -> tuple[_Tables, _Tables, int]:
        """Returns the models and rows that are new in the past, and its first tick."""
        recorder = self._recorder
        if recorder is None or not len(recorder.ticks):
            return {}, {}, 0
        new = [member for id, member in recorder.members.items() if id not in self._recorded]
        self._recorded |= {member.id for member in new}
        first, last = (int(number) for number in recorder.ticks.numbers[[0, -1]])
        begin, self._last_recorded = self._last_recorded + 1, last
        rows = {}
        if begin <= last:
            rows = {table: recorder.fetch(table, begin, last) for table in recorder.buffers}
        return self._models(new, with_visuals=False), rows, first

    def _models(self, members: Collection[EntityInfo], *, with_visuals: bool) -> _Tables:
        if not members:
            return {}
        snapshot = self.world.snapshot
        models = model_rows(members, snapshot, self._geometries, with_visuals=with_visuals)
        self._geometries |= set(models["geometries"]["id"].to_pylist())
        return models


# -- copies -----------------------------------------------------------------------------------


class WorldCopy:
    """A copy of a live world in an interpreter of its own.

    Args:
        ss: the interpreter, which gets the copy as a variable with the first news.
        description: what the copy is made with.
        sensed: returns the last tick with what sensors perceive.
    """

    def __init__(
        self,
        ss: Interpreter,
        description: WorldDescription,
        sensed: Callable[[], WorldNews | None],
    ) -> None:
        self._ss, self._description, self._sensed = ss, description, sensed
        self._geometries: list[pa.Table] = []
        self._numbers: dict[str, int] = {}  # of geometries, by their keys
        # The entities of any tick, and the rows of the last one.
        self._members: dict[int, EntityInfo] = {}
        self._rows: Mapping[str, pa.Table] = {}
        self._past = _past_copy(ss, description, self._numbers)
        self._world: ReplayedWorld | None = None

    @property
    def world(self) -> ReplayedWorld:
        """The copy."""
        assert self._world is not None
        return self._world

    def apply(self, news: WorldNews) -> None:
        """Takes over what is new, whole: Ctrl-C waits."""
        with deferred():
            if self._past is not None:
                self._past.apply(news, self._new(news.past_models))
            if not self._description.is_past:
                self._members |= self._new(news.models)
                self._rows = news.rows
            if self._world is None:
                self._world = self._first(news)
                self._ss.add_variable(self._description.name, self._world)
            elif isinstance(self._world, CopiedWorld):
                self._world.ticker.go_on_to(news.tick, news.time)
            if news.pairs is not None and not self._description.is_past:
                _set_pairs(self._world, news.pairs)

    def _new(self, models: Mapping[str, pa.Table]) -> dict[int, EntityInfo]:
        """Returns the entities of models, whose geometries may be those of earlier ones."""
        if not models:
            return {}
        self._geometries.append(models["geometries"])
        known = {**models, "geometries": pa.concat_tables(self._geometries)}
        self._numbers |= geometries_of(models)
        return members_of(known)

    def _first(self, news: WorldNews) -> ReplayedWorld:
        description, past = self._description, self._past
        camera = camera_of({"camera": description.camera})
        if description.is_past:
            assert past is not None
            ticker = ReplayTicker(description.name, past.record)
            return ReplayedWorld(ticker, (past.store, past.record), camera)
        present = Record(
            None,
            TickBuffer.from_arrays([news.tick], [news.time]),
            self._members,
            recorded_tables(RECORDABLE),
            self._rows_of,
            _no_pairs,
            self._numbers,
            description.run,
            source="the copy of its last tick",
            is_copy=True,
        )
        told = None if past is None else (past.store, past.record)
        return CopiedWorld(CopyTicker(description.name, present, self._with_sensings), told, camera)

    def _rows_of(self, table: str, *_: int) -> pa.Table:
        return self._rows.get(table, buffer_schema(table).empty_table())

    def _with_sensings(self) -> None:
        """Copies the last tick with what sensors perceive, for which rays are cast."""
        with deferred():
            news = self._sensed()
            assert news is not None
            self.apply(news)


def _set_pairs(world: ReplayedWorld, pairs: _Pairs) -> None:
    classes, of_classes = pairs
    listed = [one for id, _ in world.snapshot.layout.bodies for one in classes[id]]
    numbers = world.snapshot.tables["shapes"]["margin"].copy()
    margins = Margins(numbers, np.array(listed), np.array(of_classes))
    assert isinstance(world.simulator, StaticSimulator)
    world.snapshot.read_margins(replace(world.simulator, margins=margins))


def _no_pairs(_: Any) -> NoReturn:
    raise AssertionError("no function of time asks for the last tick alone")


@dataclass(frozen=True, eq=False)
class _PastCopy:
    """A copy of recorded ticks in memory."""

    store: Any  # a MemoryStore, or a _NoArchive
    record: Record
    ticks: TickBuffer
    members: dict[int, EntityInfo]
    ids: Snapshot

    def apply(self, news: WorldNews, members: Mapping[int, EntityInfo]) -> None:
        if members:
            self.store.add_members(members.values(), self.ids)
            self.members.update(members)
        if news.past:
            rows = {
                table: conformed(of_table, buffer_schema(table))
                for table, of_table in news.past.items()
            }
            self.store.add(rows)
            numbers, times = (rows["ticks"][name].to_pylist() for name in ("tick", "time"))
            for number, time in zip(numbers, times, strict=True):
                self.ticks.append(number, time)
        if len(self.ticks) and news.first > self.ticks.numbers[0]:
            self.store.begin_at(news.first)
            self.ticks.drop_before(news.first)


def _past_copy(
    ss: Interpreter, description: WorldDescription, numbers: dict[str, int]
) -> _PastCopy | None:
    """Returns an empty copy of recorded ticks; None if none are recorded."""
    ticks, members, ids = TickBuffer(), dict[int, EntityInfo](), Snapshot(numbers, description.run)
    archive: _NoArchive | MemoryStore
    if description.is_elsewhere:
        ticks = TickBuffer.from_arrays([0], [0.0])
        archive = _NoArchive(description.name)
    elif description.recording is not None:
        recording = Recording(**description.recording)
        connection = ss._database.connection.writer()  # noqa: SLF001  # one package
        archive = MemoryStore(f"copied{next(_numbers)}", connection, recording, description.name)
    else:
        return None
    record = Record(
        None,
        ticks,
        members,
        archive.tables,
        archive.fetch,
        lambda request: archive.near_pairs(request, None),
        numbers,
        description.run,
        source="the copy of its ticks",
        is_copy=True,
        entities=archive.recording.entities,
    )
    return _PastCopy(archive, record, ticks, members, ids)


def _past_in_a_file(world: str) -> str:
    """Returns the message that a copy has no past, as the ticks are in a file."""
    return (
        f"the past of {world!r} is in a database file, which only its own interpreter reads: ask "
        "there, or open the file; a world of an interpreter without a file has its past here"
    )


class _NoArchive(TickArchive):
    """Recorded ticks that a copy cannot read."""

    recording, tables = Recording(), recorded_tables(RECORDABLE)

    def __init__(self, world: str) -> None:
        self._world = world

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise UnsupportedError(_past_in_a_file(self._world))

    select = models = fetch = near_pairs = _refuse

    def close(self, *, forget: bool) -> None:
        """Does nothing: the file stays open in its own interpreter."""


class Mirror:
    """An interpreter of this process with a copy of a live world.

    Args:
        ss: the interpreter of the world.
        world: the world.
        name: the name of the copy.
        limits: the limits of programs that ask the copy.
        is_past: whether the copy goes to recorded ticks; else it is of the last tick.

    Attributes:
        original: the live world.
        interpreter: has the copy under its name.

    Raises:
        UnsupportedError: a copy of the past is requested, and no tick is recorded in memory.
    """

    def __init__(
        self, ss: Interpreter, world: World, name: str, limits: Limits, *, is_past: bool = False
    ) -> None:
        self.original, self._feed = world, WorldFeed(ss, world, name, is_past=is_past)
        self.interpreter = Interpreter(recording=None, limits=limits)
        self.interpreter.strict = True
        try:
            self._copy = WorldCopy(
                self.interpreter, self._feed.description, partial(self._feed.news, is_sensed=True)
            )
            self.update()
        except BaseException:
            self.interpreter.close()
            raise

    @property
    def world(self) -> ReplayedWorld:
        """The copy."""
        return self._copy.world

    @property
    def is_up_to_date(self) -> bool:
        """Whether `update` can follow the world."""
        return self._feed.is_up_to_date

    def update(self) -> None:
        """Copies what is new."""
        if (news := self._feed.news()) is not None:
            self._copy.apply(news)

    def close(self) -> None:
        """Closes its interpreter; the world goes on."""
        self.interpreter.close()
