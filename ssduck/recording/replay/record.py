"""What is kept of a world's ticks, and the world as it was at each of them.

`Record.at` gives the world at one tick, as what was recorded tells; the simulator is never asked.
"""

from __future__ import annotations

import weakref
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.errors import EvaluationError
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.batch import PairPredicate
from ssduck.geometry.distance import CallCounter
from ssduck.geometry.queries import ShapeQueries
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.mass_changes import MassChanges
from ssduck.recording.replay.batch_queries import EntityShapes, Ids, PairSide
from ssduck.recording.replay.batch_queries import LinkPosesOverTicks as LinkFrames
from ssduck.recording.replay.past_world import PastWorld
from ssduck.recording.replay.restore import SnapshotRestorer, links_of
from ssduck.recording.replay.row_cache import RowCache
from ssduck.recording.spec import not_recorded_message
from ssduck.recording.stores.base import PairRequest
from ssduck.schema import ON_DEMAND, POSE, TABLES
from ssduck.simulators.static import StaticSimulator
from ssduck.world.entities import HANDLES, Entity, RecordedTick
from ssduck.world.layout import EntityInfo, margins_of
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World

# So many ticks are kept as worlds.
MAX_WORLDS = 256
# After so many questions about a tick all shapes of it are placed.
FEW = 8
MAX_REQUESTED = 100_000

# What is told of two entities at a tick: the tick, their ids, and 1, or 0 where it is not known.
PAIR = ("tick", "a", "b", "known")
# Times are the same that differ by no more, s.
ROUNDING = 1e-9
_NAN = float("nan")


class Record:
    """What is kept of a world's ticks.

    Args:
        world: whose ticks they are; None if it is made of them, and told later.
        ticks: their numbers and times.
        members: the entities that they tell of, by id.
        tables: which tables are recorded.
        fetch: gives the rows of a table at the ticks from one to another.
        near: gives the pairs of entities whose boxes are near at some ticks, with their poses.
        geometries: the numbers of geometries by their keys; None for those of the world.
        run: the number of the run that they are of; None for that of the world.
        reweighed: the bodies whose masses changed after they were kept; None for none.
    """

    def __init__(
        self,
        world: World | None,
        ticks: TickBuffer,
        members: Mapping[int, EntityInfo],
        tables: Sequence[str],
        fetch: Callable[[str, int, int], pa.Table],
        near: Callable[[PairRequest], pa.Table],
        geometries: dict[str, int] | None = None,
        run: int | None = None,
        mass_changes: MassChanges | None = None,
    ) -> None:
        self._world: weakref.ref[World] | None = None
        if world is not None:
            self.world = world
        self.ticks = ticks
        self.tables = frozenset(tables)
        self._links = links_of(self.tables)
        self.members = members
        self.fetch = fetch
        self._near = near
        self._reweighed = mass_changes
        self._models = EntityShapes(members)
        # Of how many members it was found.
        self._margins = -1, 0.0
        # How often shapes at a tick were asked for.
        self._asked: dict[int, int] = {}
        self._worlds: OrderedDict[int, PastWorld] = OrderedDict()
        if geometries is None:
            assert world is not None
            geometries, run = world.snapshot.geometries, world.snapshot.run
        self._blocks = RowCache(fetch, ticks)
        self._placings = SnapshotRestorer(
            members, self.tables, self._blocks, Snapshot(geometries, run)
        )
        # Whether another record has taken its place, or none.
        self.is_closed = False
        # How often the narrow phase is called counts for the world, at whatever tick.
        self.calls = CallCounter() if world is None else world.snapshot.calls

    @property
    def world(self) -> World:
        """Whose ticks they are; it is not kept by them.

        Raises:
            EvaluationError: nobody has it any more.
        """
        world = None if self._world is None else self._world()
        if world is None:
            raise EvaluationError("the world that was recorded is gone")
        return world

    @world.setter
    def world(self, world: World) -> None:
        self._world = weakref.ref(world)

    # -- which ticks ------------------------------------------------------------------------

    def until_now(self) -> tuple[npt.NDArray[np.int64], Array]:
        """The numbers and times of the ticks that are kept, up to the world's present one."""
        with self.world.lock:
            self.check_open()
            numbers = self.ticks.numbers
            end = int(np.searchsorted(numbers, self.world.snapshot.number, side="right"))
            return numbers[:end], self.ticks.times[:end]

    # -- a tick -----------------------------------------------------------------------------

    def entity(self, tick: int, id: int) -> Entity:
        """The handle of an entity at a tick."""
        member = self.members[id]
        kind = HANDLES[member.kind]
        return kind(self.world, id, member.name, member.kind, RecordedTick(self, tick))

    def at(self, tick: int) -> PastWorld:
        """The world at a tick.

        Raises:
            EvaluationError: the tick is not kept, or not any more.
        """
        with self.world.lock:
            self._place_of(tick)
            if tick not in self._worlds:
                while len(self._worlds) >= MAX_WORLDS:
                    self._worlds.popitem(last=False)
                self._worlds[tick] = PastWorld(RecordedTick(self, tick), *self.taken(tick))
            self._worlds.move_to_end(tick)
            return self._worlds[tick]

    def taken(self, tick: int) -> tuple[StaticSimulator, Snapshot]:
        """What stands for a simulator at a tick, and the snapshot of it.

        Raises:
            EvaluationError: the tick is not kept, or not any more.
        """
        with self.world.lock:
            self._place_of(tick)
            snapshot = self._placings.snapshot(tick, _unavailable(self))
            snapshot.calls = self.calls
            return self.take(snapshot, tick), snapshot

    def take(self, snapshot: Snapshot, tick: int) -> StaticSimulator:
        """Make a snapshot that of a tick; gives what stands for a simulator there.

        Raises:
            EvaluationError: the tick is not kept, or not any more.
        """
        with self.world.lock:
            time = float(self.ticks.times[self._place_of(tick)])
            return self._placings.take(snapshot, tick, time)

    def check_open(self) -> None:
        """Complain if it is kept no longer.

        Raises:
            EvaluationError: something else is recorded of the world since, or nothing.
        """
        if self.is_closed:
            raise EvaluationError(
                f"what was recorded of {self.world.name!r} is kept no longer: it is recorded anew, "
                "or not at all"
            )

    def warn_of_masses(self) -> None:
        """Warn of bodies whose masses are no longer those that are kept; of each once."""
        if self._reweighed is not None:  # nothing changes in a world that was opened
            self._reweighed.warn(self.world)

    def _place_of(self, tick: int) -> int:
        self.check_open()
        place = int(np.searchsorted(self.ticks.numbers, tick))
        if place == len(self.ticks) or self.ticks.numbers[place] != tick:
            raise EvaluationError(
                f"tick {tick} of {self.world.name!r} is not recorded, or is kept no longer"
            )
        return place

    def pairs(self, asked: PairRequest, question: PairPredicate) -> list[Ids]:
        """The pairs of entities of which something holds, at some ticks.

        Args:
            asked: which ones; boxes are looked at as far out as margins make it.
            question: what is to hold.

        Returns:
            The columns `PAIR` of those of which it holds, or is not known.
        """
        far = self.margins if question.of == "touching" else 0.0
        rows = self._near(replace(asked, max_gap=asked.max_gap + far))
        ticks = rows["tick"].to_numpy()
        sides = [
            PairSide(
                rows[side].to_numpy(),
                LinkFrames(_columns(rows, side, POSE[:3]), _columns(rows, side, POSE[3:])),
                partial(self._link_frames, ticks),
            )
            for side in "ab"
        ]
        holds, known = self._models.together(sides[0], sides[1], question, self.calls)
        found = np.flatnonzero(holds | ~known)
        columns = (ticks, sides[0].ids, sides[1].ids, known.astype(np.int64))
        return [column[found] for column in columns]

    def _link_frames(
        self, ticks: npt.NDArray[np.int64], rows: Indices, id: int, link: int
    ) -> LinkFrames:
        """Where a link of an entity is at the ticks of some rows."""
        found = np.full((len(rows), 7), _NAN)
        for tick in np.unique(ticks[rows]).tolist():
            found[ticks[rows] == tick] = self._pose(self._links, tick, id, link)
        return LinkFrames(found[:, :3], found[:, 3:])

    def _pose(self, table: str, tick: int, id: int, link: int) -> Array:
        """Position and orientation of a link of an entity at a tick, (7,); NaN if it is not there.

        Args:
            table: of entities, where `link` is 0, or of links.
            tick: the tick.
            id: of the entity.
            link: its number.
        """
        own = self.rows(table, tick)
        is_it = own["id"] == id if table == "entities" else own["entity"] == id
        if table != "entities":
            is_it &= own["link"] == link
        place = np.flatnonzero(is_it)
        return np.array([own[name][place[0]] if len(place) else _NAN for name in POSE])

    def shapes(self, tick: int, ids: Sequence[int] | None) -> ShapeQueries:
        """The shapes at a tick, to be compared.

        Where few are asked for at a tick, only these are placed.

        Args:
            tick: which one.
            ids: of the entities that are asked for; None for all.
        """
        if ids is None:
            return self.at(tick).shapes()
        self._asked[tick] = self._asked.get(tick, 0) + 1
        if tick in self._worlds or self._asked[tick] > FEW or len(set(ids)) < len(ids):
            return self.at(tick).shapes()
        if len(self._asked) > MAX_REQUESTED:
            self._asked.clear()
        ordered = sorted(ids)
        poses = [
            [self._pose("entities", tick, id, 0)]
            + [self._pose(self._links, tick, id, link) for link in self._models.moving_links(id)]
            for id in ordered
        ]
        return self._models.shapes(ordered, [np.array(found) for found in poses], self.calls)

    @property
    def margins(self) -> float:
        """How much farther apart shapes may be than what touches, metres: twice the most."""
        if self._margins[0] != len(self.members):
            self._margins = len(self.members), margins_of(self.members.values())
        return self._margins[1]

    def rows(self, table: str, tick: int) -> dict[str, npt.NDArray[Any]]:
        """The columns of a table at a tick; NaN for what is not known."""
        with self.world.lock:
            self.check_open()
            return self._blocks.rows(table, tick)


def place_at(world: str, time: float, times: Array, now: float) -> int:
    """The place of the last tick until a time.

    Raises:
        EvaluationError: that is before the first, or later than it is now.
    """
    place = int(np.searchsorted(times, time + ROUNDING, side="right")) - 1
    if place < 0 or time > max(now, float(times[-1])) + ROUNDING:
        raise EvaluationError(
            f"{world!r} is recorded from {times[0]:g} s to {times[-1]:g} s; there is no tick at "
            f"{time:g} s"
        )
    return place


def _columns(rows: pa.Table, side: str, names: Sequence[str]) -> Array:
    """Columns of one of two entities, (rows, names)."""
    columns = [_numbers(rows[f"{side}_{name}"]) for name in names]
    return np.array(columns).reshape(len(names), rows.num_rows).T


def _unavailable(record: Record) -> dict[str, str]:
    """Tables whose rows nobody knows at a past tick, and why."""
    world = record.world.name
    return {
        table: not_recorded_message(table, world)
        for table in ON_DEMAND - record.tables
        if not TABLES[table].follows_from_poses
    }


def _numbers(column: pa.ChunkedArray) -> Array:
    """A column of numbers; NaN for what is not known."""
    return np.asarray(column.to_numpy(), dtype=np.float64)
