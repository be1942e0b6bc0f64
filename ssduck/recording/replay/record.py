"""Provides the recorded ticks of a world, and the world as it was at each of them.

`Record.at` returns the world at a tick, restored from recorded rows without the simulator.
"""

from __future__ import annotations

import weakref
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from threading import Lock
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.errors import EvaluationError, ProgramWarning, warn
from ssduck.formatting import joined_names
from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.distance import CallCounter
from ssduck.geometry.pair_batch import PairQuestion
from ssduck.geometry.queries import ShapeQueries
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.episode import Tags
from ssduck.recording.recorder import MassChanges
from ssduck.recording.replay.batch_queries import EntityShapes
from ssduck.recording.replay.restore import PastWorld, RowCache, SnapshotRestorer, links_of
from ssduck.recording.spec import Recording, longer_recording_message, not_recorded_message
from ssduck.recording.stores.base import PairRequest
from ssduck.schema import (
    ALL_ENTITIES,
    LINK_FACTOR,
    MASSES,
    ON_DEMAND,
    POSE,
    RECORDABLE,
    TABLES,
    TWIST,
    VELOCITIES,
    entity_of,
    link_of,
)
from ssduck.simulators.clock import TIME_TOLERANCE
from ssduck.simulators.partial import StaticSimulator
from ssduck.world.entities import HANDLES, Entity
from ssduck.world.handles import Handle, RecordedTick, handle_of
from ssduck.world.layout import EntityInfo, margins_of
from ssduck.world.snapshot import RECORDED_DOUBLES, Snapshot
from ssduck.world.world import World

Ticks: TypeAlias = npt.NDArray[np.int64]
# A question about two entities, by their ids.
Key: TypeAlias = tuple[PairQuestion, int, int]

# The number of answers that are cached, of 16 bytes each.
MAX_ANSWERS = 1 << 20


class AnswerCache:
    """The answers to questions about pairs of entities of a record, by tick.

    It drops the questions that were not asked for the longest time.
    """

    def __init__(self) -> None:
        # The ticks, ascending, and the answer at each.
        self._answers: OrderedDict[Key, tuple[Ticks, Array]] = OrderedDict()
        self._count = 0
        self._lock = Lock()

    def clear(self) -> None:
        """Drops all answers."""
        with self._lock:
            self._answers.clear()
            self._count = 0

    def __len__(self) -> int:
        """Returns the number of cached answers."""
        return self._count

    def look_up(self, key: Key, ticks: Ticks) -> tuple[Array, Flags]:
        """Returns the answers at some ticks, and whether each is cached."""
        with self._lock:
            known, answers = self._answers.get(key, _NOTHING)
            if key in self._answers:
                self._answers.move_to_end(key)
        if not len(known):
            return np.zeros(len(ticks)), np.zeros(len(ticks), dtype=bool)
        places = np.minimum(np.searchsorted(known, ticks), len(known) - 1)
        is_cached: Flags = known[places] == ticks
        return answers[places], is_cached

    def add(self, key: Key, ticks: Ticks, answers: Array, first_kept: int) -> None:
        """Adds answers at ticks that are not cached."""
        with self._lock:
            known, before = self._answers.pop(key, _NOTHING)
            self._count -= len(known)
            all_ticks, places = np.unique(np.concatenate((known, ticks)), return_index=True)
            all_answers = np.concatenate((before, answers))[places]
            start = max(int(np.searchsorted(all_ticks, first_kept)), len(all_ticks) - MAX_ANSWERS)
            self._answers[key] = all_ticks[start:], all_answers[start:]
            self._count += len(all_ticks) - start
            while self._count > MAX_ANSWERS:
                _, (dropped, _) = self._answers.popitem(last=False)
                self._count -= len(dropped)


_NOTHING: tuple[Ticks, Array] = np.zeros(0, np.int64), np.zeros(0)


# The number of restored worlds that are cached.
MAX_WORLDS = 256

_NAN = float("nan")


class Record:
    """The recorded ticks of a world."""

    def __init__(
        self,
        world: World | None,
        ticks: TickBuffer,
        members: Mapping[int, EntityInfo],
        tables: Sequence[str],
        fetch: Callable[[str, int, int], pa.Table],
        near_pairs: Callable[[PairRequest], pa.Table],
        geometries: dict[str, int] | None = None,
        run: int | None = None,
        mass_changes: MassChanges | None = None,
        recording: Recording | None = None,
        source: str = "the record",
        tags: Tags | None = None,
        order: int | None = None,
        entities: Sequence[str] | None = None,
        *,
        is_copy: bool = False,
    ) -> None:
        self._entities = entities
        # Whether more ticks may come: not to a record that was opened.
        self.goes_on = is_copy or recording is not None
        self.order = order
        self.tags: Tags = tags or {}
        self.recording = recording
        self.source = source
        self._world: weakref.ref[World] | None = None
        if world is not None:
            self.world = world
        self.ticks = ticks
        self.tables = frozenset(tables)
        self._links_table = links_of(self.tables)
        self.members = members
        self.fetch = fetch
        self._mass_changes = mass_changes
        self.near_pairs = near_pairs
        self.entity_shapes = EntityShapes(members)  # the shapes of the members
        # The answers about pairs of entities at its ticks, as far as they are cached.
        self.answer_cache = AnswerCache()
        # The number of members that the value was computed for, and the value.
        self._cached_margins = -1, 0.0
        self._worlds: OrderedDict[int, PastWorld] = OrderedDict()
        if geometries is None:
            assert world is not None
            geometries, run = world.snapshot.geometries, world.snapshot.run
        self._row_cache = RowCache(fetch, ticks, source)
        self._restorer = SnapshotRestorer(
            members, self.tables, self._row_cache, Snapshot(geometries, run)
        )
        # Whether it was replaced by another record, or discarded.
        self.is_closed = False
        self._has_told_of_entities = self._has_told_of_dropped = False
        self._has_told_of_velocities = False
        # Calls of the narrow phase count for the world, at any tick.
        self.calls = CallCounter() if world is None else world.snapshot.calls

    @property
    def world(self) -> World:
        """The recorded world, which the record does not keep alive."""
        world = None if self._world is None else self._world()
        if world is None:
            raise EvaluationError("the world that was recorded is gone")
        return world

    @world.setter
    def world(self, world: World) -> None:
        self._world = weakref.ref(world)

    # -- which ticks ------------------------------------------------------------------------

    def ticks_until_now(self, now: int | None = None) -> tuple[npt.NDArray[np.int64], Array]:
        """Returns the numbers and times of the recorded ticks up to the world's current one."""
        with self.world.lock:
            self.check_open()
            numbers = self.ticks.numbers
            last = self.world.tick_number if now is None else now
            end = int(np.searchsorted(numbers, last, side="right"))
            return numbers[:end], self.ticks.times[:end]

    # -- a tick -----------------------------------------------------------------------------

    def entity(self, tick: int, id: int) -> Entity:
        """Returns the handle of an entity at a tick."""
        member, moment = self.members[id], RecordedTick(self, tick)
        return HANDLES[member.kind](self.world, id, member.name, member.kind, moment)

    def handle(self, tick: int, id: int) -> Handle:
        """Returns the handle of an entity or a link at a tick."""
        if id < LINK_FACTOR:
            return self.entity(tick, id)
        member = self.members[entity_of(id)]
        assert member.body is not None
        link = member.body.links[link_of(id)]
        return handle_of(link)(self.world, id, link.name, member.name, RecordedTick(self, tick))

    def at(self, tick: int) -> PastWorld:
        """Returns the world at a tick."""
        with self.world.lock:
            self._index_of(tick)
            if tick not in self._worlds:
                while len(self._worlds) >= MAX_WORLDS:
                    self._worlds.popitem(last=False)
                self._worlds[tick] = PastWorld(RecordedTick(self, tick), *self.restore(tick))
            self._worlds.move_to_end(tick)
            return self._worlds[tick]

    def restore(self, tick: int) -> tuple[StaticSimulator, Snapshot]:
        """Restores the static simulator and the snapshot of a tick."""
        with self.world.lock:
            self._index_of(tick)
            snapshot = self._restorer.snapshot(tick, _unavailable(self))
            snapshot.calls = self.calls
            return self.restore_into(snapshot, tick), snapshot

    def restore_into(self, snapshot: Snapshot, tick: int) -> StaticSimulator:
        """Restores a tick into a snapshot, and returns the static simulator of the tick."""
        with self.world.lock:
            time = float(self.ticks.times[self._index_of(tick)])
            return self._restorer.restore_into(snapshot, tick, time)

    def check_open(self) -> None:
        """Checks that the record was not discarded."""
        if self.is_closed:
            raise EvaluationError(
                f"what was recorded of {self.world.name!r} is kept no longer: it is recorded anew, "
                "or not at all"
            )

    def warn_of_masses(self) -> None:
        """Warns of bodies whose masses are no longer the recorded ones, of each once."""
        if self._mass_changes is not None:  # masses do not change in a replayed world
            self._mass_changes.warn(self.world)

    def warn_of_missing(self, inputs: Collection[str]) -> None:
        """Warns of what an evaluation reads and the record has not as the world had it."""
        if MASSES in inputs:
            self.warn_of_masses()
        if ALL_ENTITIES in inputs:
            self.warn_of_missing_entities()
        if VELOCITIES in inputs:
            self._warn_of_velocities()

    def _warn_of_velocities(self) -> None:
        """Warns, once, if no velocity was recorded, so that what depends on one is nothing."""
        if self._has_told_of_velocities or not len(self.ticks):
            return
        self._has_told_of_velocities = True
        last = int(self.ticks.numbers[-1])
        rows = self.fetch("entities", last, last)
        if rows.num_rows and all(rows[name].null_count == rows.num_rows for name in TWIST):
            warn(
                f"{self.world.name!r}: velocities were not recorded, and speed(e), settled(e) and "
                "their like are nothing: rate(position(e)) follows from the poses; "
                "write_record(velocities=…) stores them"
            )

    def warn_of_missing_entities(self) -> None:
        """Warns, once, if entities are missing on which the answer to a question may depend."""
        if self._entities is None or self._has_told_of_entities:
            return
        self._has_told_of_entities = True
        warn(
            f"{self.world.name!r}: only {joined_names(self._entities)} were recorded: answers that "
            "depend on other entities, or on contacts with these, may differ from those of the "
            "world, as force, torque, restsOn, supports, nextTo and NOT EXISTS do; record without "
            "entities=… to have all"
        )

    @property
    def dropped_ticks_message(self) -> str:
        """What to do to keep older ticks, after a semicolon; empty if none were dropped."""
        if self.recording is None or not self.ticks.has_dropped:
            return ""
        return f"; {longer_recording_message(self.world.name, self.recording)}"

    def warn_of_dropped_ticks(self, age: float | None = None) -> None:
        """Warns, once, if ticks were dropped that an answer is to be of."""
        advice = self.dropped_ticks_message
        if not advice or self._has_told_of_dropped or (age is not None and age >= 0.0):
            return
        name, first = self.world.name, float(self.ticks.times[0])
        if age is None or self.world.time + age < first - TIME_TOLERANCE:
            self._has_told_of_dropped = True
            warn(
                f"{name}: the past begins at {first:g} s, and so does what is asked of all ticks"
                f"{advice}",
                ProgramWarning,
            )

    def _index_of(self, tick: int) -> int:
        self.check_open()
        place = int(np.searchsorted(self.ticks.numbers, tick))
        if place == len(self.ticks) or self.ticks.numbers[place] != tick:
            raise EvaluationError(
                f"tick {tick} of {self.world.name!r} is not recorded, or is kept no longer"
                f"{self.dropped_ticks_message}"
            )
        return place

    def numbers(self, tick: int, id: int, first: str, last: str) -> list[float]:
        """Returns recorded doubles of the row of an entity or a link, from a column to a later one.

        They are those of the world at the tick, which is not restored for them; [] if there are
        none. Of a link they are those of its pose: the others follow from the shapes.
        """
        columns = RECORDED_DOUBLES if id < LINK_FACTOR else POSE
        if first not in columns:
            return []
        with self.world.lock:
            self._index_of(tick)
            names = columns[columns.index(first) : columns.index(last) + 1]
            return self._numbers(tick, entity_of(id), link_of(id), names)

    def _numbers(self, tick: int, id: int, link: int, names: Sequence[str]) -> list[float]:
        """Returns columns of an entity at a tick, of the entity itself for link -1."""
        body = self.members[id].body
        if link < 0 or body is None or len(body.links) == 1:  # its only link is where it is
            rows = self.rows("entities", tick)
            is_meant = rows["id"] == id
        else:
            rows = self.rows(self._links_table, tick)
            is_meant = (rows["entity"] == id) & (rows["link"] == link)
        places = np.flatnonzero(is_meant)[:1]
        return [float(rows[name][place]) for place in places for name in names]

    def link_poses(self, ticks: Ticks, rows: Indices, id: int, link: int) -> Array:
        """Returns the poses of a link of an entity at the ticks of some rows, (rows, 7)."""
        poses = np.full((len(rows), 7), _NAN)
        for tick in np.unique(ticks[rows]).tolist():
            poses[ticks[rows] == tick] = self._numbers(tick, id, link, POSE) or _NAN
        return poses

    def shapes(self, tick: int, *, with_sites: bool = False) -> ShapeQueries:
        """Returns queries of the shapes at a tick; on request, sites have their regions as such."""
        world = self.at(tick)
        return world.shapes_and_sites() if with_sites else world.shapes()

    @property
    def margins(self) -> float:
        """The largest distance of shapes that touch by their margins: twice the largest one, m."""
        if self._cached_margins[0] != len(self.members):
            self._cached_margins = len(self.members), margins_of(self.members.values())
        return self._cached_margins[1]

    def forget_rows(self) -> None:
        """Reads all rows anew from now on."""
        self._row_cache.clear()

    def rows(self, table: str, tick: int) -> dict[str, npt.NDArray[Any]]:
        """Returns the columns of a table at a tick; NaN for unknown numbers."""
        with self.world.lock:
            self.check_open()
            return self._row_cache.rows(table, tick)


def index_at(
    world: str, time: float, times: Array, now: float, advice: str = "", end: float = -np.inf
) -> int:
    """Returns the index of the last tick until a time; later ones are recorded until `end`."""
    place = int(np.searchsorted(times, time + TIME_TOLERANCE, side="right")) - 1
    if place < 0 or time > max(now, float(times[-1])) + TIME_TOLERANCE:
        is_later = place >= 0 and time <= end + TIME_TOLERANCE
        raise EvaluationError(
            f"{world!r} is recorded from {times[0]:g} s to {max(end, float(times[-1])):g} s; "
            f"{f'at {now:g} s ' if is_later else ''}there is no tick at {time:g} s"
            f"{' yet' if is_later else advice if place < 0 else ''}"
        )
    return place


def _unavailable(record: Record) -> dict[str, str]:
    """Returns the tables that are unavailable at a past tick, with the reasons."""
    world, recording = record.world.name, record.recording
    is_live = recording is not None
    recording = recording or Recording(tables=tuple(record.tables & set(RECORDABLE)))
    return {
        table: not_recorded_message(table, world, recording, is_live=is_live)
        for table in ON_DEMAND - record.tables
        if not TABLES[table].follows_from_poses
    }
