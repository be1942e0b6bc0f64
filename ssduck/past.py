"""The past of a world: its recorded ticks, and the world as it was at each of them.

A `Record` is what is kept of one world. `Record.at` gives the world at one tick, as what was
recorded tells; the simulator is never asked. A `Past` is what `kitchen{12.5}`, `kitchen{-2.0}`
and `kitchen{}` are: some ticks of a record, whose entities are handles that stay at their tick.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.entities import HANDLES, Entity, Moment
from ssduck.errors import EvaluationError
from ssduck.geometry import Array, Indices, rotation_matrices
from ssduck.history import POSE, Archive, Near, not_recorded
from ssduck.layout import Layout, Member, Part
from ssduck.many_ticks import Frames as LinkFrames
from ssduck.many_ticks import Ids, Models, Side
from ssduck.rings import FRAMES, STORED, Ticks
from ssduck.scenes import Camera
from ssduck.separation import Counter
from ssduck.shapes import Shapes
from ssduck.simulators import Body, Frames
from ssduck.simulators.posed import Posed
from ssduck.snapshot import Snapshot
from ssduck.temporal import seconds_of
from ssduck.world import World

# So many ticks are fetched at once, and kept as worlds.
BLOCK = 64
MOST_BLOCKS = 8
MOST_WORLDS = 256
# After so many questions about a tick all shapes of it are placed.
FEW = 8
MOST_ASKED = 100_000

# What is told of two entities at a tick: the tick, their ids, and 1, or 0 where it is not known.
PAIR = ("tick", "a", "b", "known")
_NAN = float("nan")
# Tables that are worked out of poses, and those that nobody but a simulator knows.
_AS_READ = frozenset(("links", "joints", "shapes"))
_AS_RECORDED = frozenset(("contacts", "sensings"))


@dataclass(frozen=True, eq=False)
class _Placing:
    """The entities of a tick, and where the frames of their bodies are found.

    Attributes:
        template: a snapshot of such entities.
        sources: of each part, the rows of its frames: those of entities, then those of links.
        bases: of bodies of several links, the row of the base, and that of the entity, which
            knows how fast it is, (n, 2).
    """

    template: Snapshot
    sources: tuple[tuple[Part, Indices], ...]
    bases: Indices


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
    """

    world: World

    def __init__(
        self,
        world: World | None,
        ticks: Ticks,
        members: Mapping[int, Member],
        tables: Sequence[str],
        fetch: Callable[[str, int, int], pa.Table],
        near: Callable[[Near], pa.Table],
        geometries: dict[str, int] | None = None,
    ) -> None:
        if world is not None:
            self.world = world
        self._geometries = geometries
        self.ticks = ticks
        self.tables = frozenset(tables)
        # Which of them tells where the links of bodies of several links are.
        self._links = "links" if "links" in self.tables else FRAMES
        self.members = members
        self.fetch = fetch
        self._near = near
        self._models = Models(members)
        # How often shapes at a tick were asked for.
        self._asked: dict[int, int] = {}
        self._worlds: OrderedDict[int, PastWorld] = OrderedDict()
        self._blocks: OrderedDict[tuple[int, int], dict[str, dict[str, npt.NDArray[Any]]]] = (
            OrderedDict()
        )
        self._placings: dict[tuple[int, ...], _Placing] = {}
        # Whether another record has taken its place, or none.
        self.is_closed = False
        # How often the narrow phase is called counts for the world, at whatever tick.
        self.calls = Counter() if world is None else world.snapshot.calls

    # -- which ticks ------------------------------------------------------------------------

    def until_now(self) -> tuple[npt.NDArray[np.int64], Array]:
        """The numbers and times of the ticks that are kept, up to the world's present one."""
        with self.world.lock:
            self.check_open()
            numbers = self.ticks.numbers
            end = int(np.searchsorted(numbers, self.world.snapshot.number, side="right"))
            return numbers[:end], self.ticks.times[:end]

    def past(self, age: float | None) -> Past:
        """Some ticks: the one at a time, those of the last seconds, or all.

        Args:
            age: seconds; from 0 up a simulated time, of which the last tick until then is taken;
                below 0 so long ago at most; None for all that are kept.

        Raises:
            EvaluationError: nothing is kept, or nothing of that time.
        """
        numbers, times = self.until_now()
        name = self.world.name
        if not len(numbers):
            raise EvaluationError(f"no tick of {name!r} is recorded")
        if age is None:
            return Past(self, int(numbers[0]), int(numbers[-1]), is_window=True)
        if age < 0:
            first = int(np.searchsorted(times, self.world.time + age - _ROUNDING))
            if first == len(numbers):
                raise EvaluationError(
                    f"of the last {-age:g} s of {name!r} no tick is recorded; the last one is of "
                    f"{times[-1]:g} s, and it is {self.world.time:g} s"
                )
            return Past(self, int(numbers[first]), int(numbers[-1]), is_window=True)
        tick = int(numbers[_place_at(name, age, times, self.world.time)])
        return Past(self, tick, tick, is_window=False)

    # -- a tick -----------------------------------------------------------------------------

    def entity(self, tick: int, id: int) -> Entity:
        """The handle of an entity at a tick."""
        member = self.members[id]
        kind = HANDLES[member.kind]
        return kind(self.world, id, member.name, member.kind, Moment(self, tick))

    def at(self, tick: int) -> PastWorld:
        """The world at a tick.

        Raises:
            EvaluationError: the tick is not kept, or not any more.
        """
        with self.world.lock:
            self._place_of(tick)
            if tick not in self._worlds:
                while len(self._worlds) >= MOST_WORLDS:
                    self._worlds.popitem(last=False)
                self._worlds[tick] = PastWorld(self, *self.taken(tick))
            self._worlds.move_to_end(tick)
            return self._worlds[tick]

    def taken(self, tick: int) -> tuple[Posed, Snapshot]:
        """What stands for a simulator at a tick, and the snapshot of it.

        Raises:
            EvaluationError: the tick is not kept, or not any more.
        """
        placing = self._placing_at(tick)
        snapshot = placing.template.past(tick, _untold(self))
        snapshot.calls = self.calls
        return self.take(snapshot, tick), snapshot

    def take(self, snapshot: Snapshot, tick: int) -> Posed:
        """Make a snapshot that of a tick; gives what stands for a simulator there.

        Raises:
            EvaluationError: the tick is not kept, or not any more.
        """
        placing = self._placing_at(tick)
        members = placing.template.listed
        rows = self.rows("entities", tick)
        by_id = np.argsort(rows["id"])
        listed = [member.id for member in placing.template.members]
        order = by_id[np.searchsorted(rows["id"][by_id], listed)]
        reals = np.array([rows[name] for name in _REALS])[:, order]
        states = np.concatenate((reals[1:14].T, self._states_of_links(tick)))
        states[placing.bases[:, 0], 7:] = states[placing.bases[:, 1], 7:]
        absent = {
            name: frozenset(
                member.body
                for member, is_so in zip(
                    placing.template.members, rows[name][order].tolist(), strict=True
                )
                if member.body is not None and not is_so
            )
            for name in ("enabled", "visible")
        }
        posed = Posed(
            time=float(self.ticks.times[self._place_of(tick)]),
            frames={part.bodies: _frames(states[source]) for part, source in placing.sources},
            joints=self._joints(tick, placing.template.layout),
            disabled=absent["enabled"],
            hidden=absent["visible"],
            called="a recorded tick",
        )
        snapshot.go_to(tick)
        snapshot.take(posed, members)
        # To the last digit as it was.
        snapshot.tables["entities"].reals("time", "zmax")[:] = reals
        snapshot.tables["entities"].written()
        for table in _AS_RECORDED & self.tables:
            told = self.rows(table, tick)
            snapshot.tables[table].fill(len(told["tick"]), told)
        return posed

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

    def _place_of(self, tick: int) -> int:
        self.check_open()
        place = int(np.searchsorted(self.ticks.numbers, tick))
        if place == len(self.ticks) or self.ticks.numbers[place] != tick:
            raise EvaluationError(
                f"tick {tick} of {self.world.name!r} is not recorded, or is kept no longer"
            )
        return place

    def _placing_at(self, tick: int) -> _Placing:
        self._place_of(tick)
        return self._placing(tuple(np.sort(self.rows("entities", tick)["id"]).tolist()))

    def pairs(self, asked: Near, *, collide: bool) -> list[Ids]:
        """The pairs of entities that collide, or are as near, at some ticks.

        Args:
            asked: which ones.
            collide: whether they are to collide.

        Returns:
            The columns `PAIR` of those of which it holds, or is not known.
        """
        rows = self._near(asked)
        ticks = rows["tick"].to_numpy()
        sides = [
            Side(
                rows[side].to_numpy(),
                LinkFrames(_columns(rows, side, POSE[:3]), _columns(rows, side, POSE[3:])),
                partial(self._link_frames, ticks),
            )
            for side in "ab"
        ]
        apart = None if collide else asked.apart
        holds, known = self._models.together(sides[0], sides[1], apart, self.calls)
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

    def shapes(self, tick: int, ids: Sequence[int]) -> Shapes:
        """The shapes at a tick, to be compared.

        Where few are asked for at a tick, only these are placed.

        Args:
            tick: which one.
            ids: of the entities that are asked for.
        """
        self._asked[tick] = self._asked.get(tick, 0) + 1
        if tick in self._worlds or self._asked[tick] > FEW or len(set(ids)) < len(ids):
            return self.at(tick).shapes()
        if len(self._asked) > MOST_ASKED:
            self._asked.clear()
        poses = [
            [self._pose("entities", tick, id, 0)]
            + [self._pose(self._links, tick, id, link) for link in self._models.moving_links(id)]
            for id in ids
        ]
        return self._models.shapes(ids, [np.array(found) for found in poses], self.calls)

    def rows(self, table: str, tick: int) -> dict[str, npt.NDArray[Any]]:
        """The columns of a table at a tick; NaN for what is not known."""
        with self.world.lock:
            return self._rows(table, tick)

    def _rows(self, table: str, tick: int) -> dict[str, npt.NDArray[Any]]:
        self.check_open()
        number = tick // BLOCK
        # What is recorded meanwhile makes a block another one.
        last = min((number + 1) * BLOCK - 1, int(self.ticks.numbers[-1]))
        key = number, last
        if key not in self._blocks:
            while len(self._blocks) >= MOST_BLOCKS:
                self._blocks.popitem(last=False)
            self._blocks[key] = {}
        self._blocks.move_to_end(key)
        block = self._blocks[key]
        if table not in block:
            found = self.fetch(table, number * BLOCK, last)
            order = np.argsort(found["tick"].to_numpy(), kind="stable")
            block[table] = {name: found[name].to_numpy()[order] for name in found.column_names}
        columns = block[table]
        first, end = np.searchsorted(columns["tick"], [tick, tick + 1])
        return {name: column[first:end] for name, column in columns.items()}

    def _placing(self, ids: tuple[int, ...]) -> _Placing:
        if ids not in self._placings:
            members = [self.members[id] for id in ids]
            numbers = self._geometries
            template = Snapshot(self.world.snapshot.geometries if numbers is None else numbers)
            layout = Layout(members, watched=False)
            posed = Posed(
                0.0,
                {part.bodies: _nowhere(part) for part in (layout.still, layout.moving)},
                {body: np.zeros((len(body.joints), 3)) for _, body in layout.bodies},
                frozenset(),
                frozenset(),
            )
            template.take(posed, members)
            laid = template.layout
            starts = _starts(laid)
            sources = tuple(_sources(part, laid, starts) for part in (laid.still, laid.moving))
            bases = [(start, laid.rows[id]) for id, start in starts.items()]
            self._placings[ids] = _Placing(
                template, sources, np.array(bases, dtype=np.intp).reshape(-1, 2)
            )
        return self._placings[ids]

    def _states_of_links(self, tick: int) -> Array:
        """Of the links of bodies that have several: pose and velocities, (n, 13)."""
        rows = self.rows(self._links, tick)
        keys = np.array([rows[name] for name in ("entity", "link")])
        names = (*POSE, "vx", "vy", "vz", "wx", "wy", "wz")
        unknown = np.full(len(rows["tick"]), _NAN)
        reals = [rows.get(name, unknown) for name in names]
        return np.array(reals)[:, np.lexsort(keys[::-1])].T

    def _joints(self, tick: int, layout: Layout) -> dict[Body, Array]:
        if "joints" not in self.tables:
            return {b: np.full((len(b.joints), 3), _NAN) for _, b in layout.bodies}
        rows = self.rows("joints", tick)
        owners = rows["entity"]
        states = np.array([rows[name] for name in ("position", "velocity", "effort")])
        links = rows["link"]
        found = {}
        for id, body in layout.bodies:
            own = np.flatnonzero(owners == id)
            found[body] = states[:, own[np.argsort(links[own])]].T.copy()
        return found


def _place_at(world: str, time: float, times: Array, now: float) -> int:
    """The place of the last tick until a time.

    Raises:
        EvaluationError: that is before the first, or later than it is now.
    """
    place = int(np.searchsorted(times, time + _ROUNDING, side="right")) - 1
    if place < 0 or time > max(now, float(times[-1])) + _ROUNDING:
        raise EvaluationError(
            f"{world!r} is recorded from {times[0]:g} s to {times[-1]:g} s; there is no tick at "
            f"{time:g} s"
        )
    return place


def _columns(rows: pa.Table, side: str, names: Sequence[str]) -> Array:
    """Columns of one of two entities, (rows, names)."""
    columns = [_numbers(rows[f"{side}_{name}"]) for name in names]
    return np.array(columns).reshape(len(names), rows.num_rows).T


_ROUNDING = 1e-9
_REALS = STORED["entities"].names_of_reals("entities")


def _untold(record: Record) -> dict[str, str]:
    """Tables whose rows nobody knows at a past tick, and why."""
    tables = ("joints", "contacts", "sensings")
    world = record.world.name
    return {table: not_recorded(table, world) for table in tables if table not in record.tables}


def _numbers(column: pa.ChunkedArray) -> Array:
    """A column of numbers; NaN for what is not known."""
    return np.asarray(column.to_numpy(), dtype=np.float64)


def _frames(states: Array) -> Frames:
    positions = np.ascontiguousarray(states[:, :3])
    with np.errstate(invalid="ignore"):
        matrices = rotation_matrices(states[:, 3:7])
    return Frames(positions, matrices, states)


def _nowhere(part: Part) -> Frames:
    count = sum(run.stop - run.start for run in part.runs.values())
    states = np.zeros((count, 13))
    states[:, 3] = 1.0
    return _frames(states)


def _starts(layout: Layout) -> dict[int, int]:
    """The row of the base of each body of several links, behind the rows of all entities."""
    first = len(layout.members)
    found: dict[int, int] = {}
    for id, body in sorted(layout.bodies, key=lambda entry: entry[0]):
        if len(body.links) > 1:
            found[id] = first
            first += len(body.links)
    return found


def _sources(part: Part, layout: Layout, starts: Mapping[int, int]) -> tuple[Part, Indices]:
    """Where the frames of a part are: among the entities' rows, and behind them."""
    ids = {body: id for id, body in layout.bodies}
    places: list[int] = []
    for body in part.bodies:
        id = ids[body]
        start = starts.get(id, layout.rows[id])
        places += range(start, start + len(body.links))
    return part, np.array(places, dtype=np.intp)


class PastWorld(World):
    """A world as it was at a recorded tick: it never changes, and knows what was recorded.

    Args:
        record: what is kept of the world.
        posed: where its bodies were.
        snapshot: of that tick.
    """

    def __init__(self, record: Record, posed: Posed, snapshot: Snapshot) -> None:
        self._begin(posed, snapshot, record.world.name, record.world.camera)
        self._record = record
        self._recorded = snapshot.tables["entities"].reals("time", "zmax").copy()

    @property
    def origin(self) -> World:
        """The world whose past it is."""
        return self._record.world

    def _take(self) -> None:
        super()._take()
        # Other tables are worked out of poses; this one is to the last digit as it was.
        entities = self.snapshot.tables["entities"]
        entities.reals("time", "zmax")[:] = self._recorded
        entities.written()

    def ask(self, tables: Iterable[str]) -> None:
        """See to it that there are these tables; what was recorded is there."""
        super().ask(_AS_READ.intersection(tables))

    def shapes(self) -> Shapes:
        """The shapes of this tick, to be compared."""
        self.ask(("shapes",))
        return self.snapshot.shapes()

    def entity(self, id: int) -> Entity:
        """The handle of an entity at this tick, by its id."""
        return self._record.entity(self.snapshot.number, id)

    def __contains__(self, thing: object) -> bool:
        """Whether it has an entity of that name, or that entity."""
        if isinstance(thing, Entity):
            return thing.world is self._record.world and thing.id in self.snapshot.rows
        return super().__contains__(thing)


class RecordedWorld(PastWorld):
    """A world of which there is only what was recorded: it is replayed, tick by tick.

    Its present is a recorded tick, at first the last one. `seek` goes to another one; `step` and
    `run` go on from there, a step a recorded time, and triggers are told as they were then. Where
    several ticks are of one time (a body was moved by hand), a step goes to the first of them.

    Args:
        name: what it is called.
        record: what is kept of it; it is told of this world.
        archive: where that is stored.
    """

    def __init__(self, name: str, record: Record, archive: Archive) -> None:
        self.name, self.camera = name, Camera()
        record.world = self
        self.lock = threading.RLock()  # reading a record takes it
        posed, snapshot = record.taken(int(record.ticks.numbers[-1]))
        super().__init__(record, posed, snapshot)
        self.archive = archive
        self._tick = snapshot.number
        self._tell_wall_time()
        self._times, first = np.unique(record.ticks.times, return_index=True)
        self._firsts = record.ticks.numbers[first]
        steps = np.diff(self._times)
        self._timestep = float(np.median(steps)) if len(steps) else 0.0

    @property
    def own_record(self) -> Record:
        """What is kept of it."""
        return self._record

    @property
    def is_final(self) -> bool:
        """Whether its ticks need not be recorded: they are."""
        return True

    @property
    def timestep(self) -> float:
        """Simulated seconds between two recorded times, in the middle."""
        return self._timestep

    def seek(self, time: float) -> RecordedWorld:
        """Go to the last tick until a time.

        Args:
            time: simulated seconds.

        Raises:
            EvaluationError: nothing of that time is recorded.
            ArgumentError: it is no finite number.
        """
        time = seconds_of(time, "a time")
        with self.lock:
            self._check_not_held()
            times = self._record.ticks.times
            place = _place_at(self.name, time, times, float(times[-1]))
            self._tick = int(self._record.ticks.numbers[place])
            self._take_tick()
        return self

    def advance(self, count: int, watch: Callable[[int], object] | None = None) -> None:
        """Go on by so many recorded times, telling no follower.

        Raises:
            EvaluationError: the record ends before that.
        """
        with self.lock:
            self._check_not_held()
            place = int(np.searchsorted(self._times, self.time, side="right")) - 1 + count
            if place >= len(self._times):
                raise EvaluationError(
                    f"what is recorded of {self.name!r} ends at {self._times[-1]:g} s"
                )
            if count:
                self._tick = int(self._firsts[place])
            if watch is not None:
                watch(count)
            self._take_tick()

    def _take(self) -> None:
        self._simulator = self._record.take(self.snapshot, self._tick)
        self._tell_wall_time()

    def _tell_wall_time(self) -> None:
        """What time of day it was at the tick."""
        told = self._record.rows("ticks", self._tick)["wall_time"]
        self.snapshot.tables["ticks"]["wall_time"][:] = told

    def entity(self, id: int) -> Entity:
        """The handle of an entity that is there, by its id."""
        return World.entity(self, id)

    def __repr__(self) -> str:
        numbers, times = self._record.ticks.numbers, self._record.ticks.times
        return (
            f"<RecordedWorld {self.name!r}: {len(self)} entities, ticks {numbers[0]} to "
            f"{numbers[-1]}, t={times[0]:g} s to {times[-1]:g} s>"
        )


@dataclass(frozen=True, eq=False)
class Past:
    """Some ticks of a world: a source of queries, whose elements are its entities at each.

    Attributes:
        record: what is kept of the world.
        first: the number of the first tick,
        last: and of the last one.
        is_window: whether there may be several; sources of one world that are so go through
            their ticks together.
        id: of the only entity that is meant; None for all.
    """

    record: Record
    first: int
    last: int
    is_window: bool
    id: int | None = None

    @property
    def world(self) -> World:
        """The world whose past it is."""
        return self.record.world

    @property
    def ticks(self) -> list[int]:
        """The numbers of the ticks."""
        return self._chosen[0]

    @property
    def times(self) -> list[float]:
        """The simulated time of each tick, s."""
        return self._chosen[1]

    @property
    def _chosen(self) -> tuple[list[int], list[float]]:
        with self.record.world.lock:
            self.check()
            numbers = self.record.ticks.numbers
            ends = (
                np.searchsorted(numbers, self.first),
                np.searchsorted(numbers, self.last, "right"),
            )
            chosen = slice(*ends)
            return numbers[chosen].tolist(), self.record.ticks.times[chosen].tolist()

    def check(self) -> None:
        """Complain if some of the ticks are kept no longer.

        Raises:
            EvaluationError: they are not, or nothing of that record is.
        """
        self.record.check_open()
        numbers = self.record.ticks.numbers
        if not len(numbers) or self.first < numbers[0]:
            told = (
                f"the first that is kept is tick {numbers[0]}" if len(numbers) else "none is kept"
            )
            raise EvaluationError(
                f"tick {self.first} of {self.world.name!r} is kept no longer; {told}"
            )

    def __iter__(self) -> Iterator[Entity]:
        """The entities at each tick, tick by tick."""
        for tick in self.ticks:
            there = self.record.at(tick)
            if self.id is None:
                yield from there
            elif self.id in there.snapshot.rows:
                yield there.entity(self.id)

    def at(self, tick: int) -> PastWorld:
        """The entities at one of the ticks."""
        return self.record.at(tick)

    def __getitem__(self, name: str) -> Entity:
        """The entity of that name at the last of the ticks.

        Raises:
            UnknownNameError: there is none, with the nearest names.
        """
        return self.record.at(self.ticks[-1])[name]

    def __repr__(self) -> str:
        try:
            times = self.times
        except EvaluationError as error:
            return f"<Past of {self.world.name!r}: {error.message}>"
        told = f"t={times[0]:g} s" if not self.is_window else f"{len(times)} ticks"
        if self.is_window and times:
            told += f" from {times[0]:g} s to {times[-1]:g} s"
        return f"<Past of {self.world.name!r}: {told}>"


def at_moment(entity: Entity, moment: Moment) -> Entity:
    """The handle of an entity as it is at a tick."""
    return type(entity)(entity.world, entity.id, entity.name, entity.kind, moment)


def together(values: Sequence[Any], elements: Iterable[Any]) -> Sequence[Any] | None:
    """Entities as they were at the tick of the first that stays at one; None if one was not there.

    A handle goes with its world; in a query of the past it goes with that.

    Args:
        values: the entities, and other values.
        elements: the current elements of the query that they are in.
    """
    worlds = {v.world for v in values if isinstance(v, Entity) and v.moment is None}
    if not worlds:
        return values
    first = next((v for v in values if isinstance(v, Entity) and v.moment is not None), None)
    if first is None:
        # Those of the query itself come last.
        past = [v for v in elements if isinstance(v, Entity) and v.moment is not None]
        first = next((v for v in reversed(past) if v.world in worlds), None)
    if first is None:
        return values
    moment = first.moment
    assert moment is not None
    found: list[Any] = []
    for value in values:
        if isinstance(value, Entity) and value.moment is None and value.world is first.world:
            there = at_moment(value, moment)
            if not there.is_there:
                return None
            found.append(there)
        else:
            found.append(value)
    return found


@dataclass(frozen=True, eq=False)
class Now:
    """A world at its present tick, beside its past in one query: its entities stay at it."""

    record: Record
    tick: int

    @property
    def world(self) -> World:
        """The world."""
        return self.record.world

    def __iter__(self) -> Iterator[Entity]:
        """The entities."""
        for entity in self.world:
            yield at_moment(entity, Moment(self.record, self.tick))
