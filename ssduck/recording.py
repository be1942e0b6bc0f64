"""What of a world's ticks is kept, and the rows that wait to be stored.

A `Recorder` is told of each tick and copies its rows into rings: numpy buffers that an Arrow
table looks into, so that whoever holds that sees them at once. When a ring is full, all of them
are given to a store together, so that what is stored ends with a whole tick. A store that takes
its time gets them in a thread (`ssduck.storing`), while the rings are filled anew.
"""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Callable, Collection, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.errors import ArgumentError, SelectScriptError, nearest
from ssduck.geometry import Array, Geometry, Indices
from ssduck.layout import Layout, Member
from ssduck.messages import shown
from ssduck.snapshot import Snapshot
from ssduck.storing import WHENEVER, Cut, Kept, Storing
from ssduck.tables import TABLES, LiveTable

# What may be chosen; `ticks` are kept always, and geometries once.
RECORDABLE = ("entities", "links", "joints", "shapes", "contacts", "sensings")
# So many ticks wait at most to be stored, and so many rows of a table.
RING_TICKS = 240
MEMORY_TICKS = 960
RING_ROWS = 1 << 17
_LEAST_ROWS = 1024
# Of what is kept, a quarter at a time is stored together, and dropped together.
QUARTERS = 4


@dataclass(frozen=True)
class Recording:
    """What is kept of a world's ticks.

    Where each link of a body is, is kept with the entities in any case: relations of shapes need
    it.

    Args:
        tables: which tables, `entities` always among them. The others are read from the simulator
            with every tick.
        entities: the names of those that are kept; None for all. A sensor brings the body that it
            sits on.
        every: only every n-th tick is kept, the first one among them.
        changed: whether a row that is as in the tick before is not stored again. The tables of
            history are the same; they take less memory and more time.
        seconds: of simulated time that are kept at least, and at most half as much more; None
            for all.
        ticks: that are kept at least, and at most half as many more; None for all. Where both are
            given, what is older than either may be dropped.

    Raises:
        ArgumentError: a table is none of these, a number is no number above 0, or nothing is
            to be kept.
    """

    tables: tuple[str, ...] = ("entities",)
    entities: tuple[str, ...] | None = None
    every: int = 1
    changed: bool = False
    seconds: float | None = None
    ticks: int | None = None

    def __post_init__(self) -> None:
        for name in ("tables", "entities"):
            value = getattr(self, name)
            is_list = isinstance(value, list | tuple | set | frozenset)
            if value is not None and not (is_list and all(isinstance(v, str) for v in value)):
                raise ArgumentError(f"{name} is to be a list of names, not {shown(value)}")
            if value is not None:
                object.__setattr__(self, name, tuple(value))
        for table in self.tables:
            if table not in RECORDABLE:
                raise ArgumentError(
                    f"there is no table {shown(table)} to be recorded",
                    suggestions=nearest(table, RECORDABLE),
                )
        if "entities" not in self.tables:
            object.__setattr__(self, "tables", ("entities", *self.tables))
        for name in ("every", "ticks"):
            value = getattr(self, name)
            if value is not None and (type(value) is not int or value < 1):
                raise ArgumentError(f"{name} is to be a whole number above 0, not {shown(value)}")
        is_number = isinstance(self.seconds, int | float) and not isinstance(self.seconds, bool)
        if self.seconds is not None and not (is_number and 0.0 < self.seconds < math.inf):
            raise ArgumentError(f"seconds is to be a number above 0, not {shown(self.seconds)}")

    @property
    def is_bounded(self) -> bool:
        """Whether older ticks are dropped."""
        return self.seconds is not None or self.ticks is not None


@dataclass(frozen=True)
class Stored:
    """The columns of a table that differ from tick to tick; what does not is stored once.

    Attributes:
        integers: their names, `tick` first.
        reals: the first and the last of neighbouring columns of reals, `time` first.
        flags: their names.
    """

    integers: tuple[str, ...]
    reals: tuple[str, str]
    flags: tuple[str, ...] = ()

    def names_of_reals(self, table: str) -> tuple[str, ...]:
        """The columns of reals of a table, in order."""
        names = [column.name for column in TABLES[table] if column.type == "real"]
        return tuple(names[names.index(self.reals[0]) : names.index(self.reals[1]) + 1])


STORED: dict[str, Stored] = {
    "entities": Stored(("tick", "id"), ("time", "zmax"), ("enabled", "visible")),
    "links": Stored(("tick", "entity", "link"), ("time", "zmax")),
    "joints": Stored(("tick", "entity", "link"), ("time", "effort")),
    "shapes": Stored(("tick", "entity", "shape"), ("time", "zmax")),
    "contacts": Stored(("tick", "a", "link_a", "b", "link_b"), ("time", "fz")),
    "sensings": Stored(("tick", "sensor", "entity", "hits", "rays"), ("time", "measured")),
    "ticks": Stored(("tick",), ("time", "wall_time")),
}
# Where the links of bodies of several links are, if the table of links is not recorded.
FRAMES = "frames"
FRAME_REALS = ("time", "x", "y", "z", "qw", "qx", "qy", "qz")


class Ring:
    """Rows of one table that wait to be stored.

    Attributes:
        arrow: the table; its unused rows are of tick -1.
        version: counts up whenever `arrow` became another object.
        count: how many rows wait.
        capacity: how many can.
        ticks: the numbers of their ticks.
        reals: (columns, capacity).
    """

    def __init__(
        self, integers: tuple[str, ...], reals: tuple[str, ...], flags: tuple[str, ...] = ()
    ) -> None:
        self._names = integers, reals, flags
        self.version = 0
        self.count = 0
        self._lent: list[list[npt.NDArray[Any]]] = []
        self._make(_LEAST_ROWS)

    def _make(self, capacity: int) -> None:
        integers, reals, flags = self._names
        self.capacity = capacity
        # Who laid out the rows, of how many a tick, and whether from the first one on.
        self._laid: tuple[object, int] | None = None
        self._is_laid_whole = False
        numbers = self._numbers_of(capacity)
        self.integers = dict(zip(integers, numbers[: len(integers)], strict=True))
        self.ticks = self.integers["tick"]
        self.ticks.fill(-1)
        self.reals = numbers[len(integers)]
        self.flags = dict(zip(flags, numbers[len(integers) + 1 :], strict=True))
        columns: list[npt.NDArray[Any]] = [
            *self.integers.values(),
            *self.reals,
            *self.flags.values(),
        ]
        arrays = [
            pa.Array.from_buffers(pa.from_numpy_dtype(c.dtype), capacity, [None, pa.py_buffer(c)])
            for c in columns
        ]
        self.arrow = pa.table(arrays, names=[*integers, *reals, *flags])
        self.version += 1

    def _numbers_of(self, capacity: int) -> list[npt.NDArray[Any]]:
        """Buffers of integers, reals and flags: old ones that nobody looks into any more, or new.

        Memory that a process has already is had five times faster than other.
        """
        integers, reals, flags = self._names
        free = [own for own in self._lent if _is_free(own)]
        self._lent = [own for own in self._lent if not any(own is other for other in free)]
        for own in free:
            if len(own[0]) == capacity:
                return own
        return [
            *(np.zeros(capacity, dtype=np.int64) for _ in integers),
            np.zeros((len(reals), capacity)),
            *(np.zeros(capacity, dtype=np.uint8) for _ in flags),
        ]

    def takes(self, count: int) -> bool:
        """Whether it has room for so many rows more."""
        return self.count + count <= self.capacity

    def reserve(self, count: int, ticks: int) -> None:
        """Make room for some ticks of so many rows, beside what waits if it cannot be stored."""
        wanted = max(min(count * ticks, RING_ROWS), count, _LEAST_ROWS)
        if self.takes(count) and wanted <= self.capacity:
            return
        waiting, before = slice(0, self.count), (self.integers, self.reals, self.flags)
        self._make(max(wanted, self.count + count, 2 * self.count))
        self.reals[:, waiting] = before[1][:, waiting]
        for now, then in ((self.integers, before[0]), (self.flags, before[2])):
            for name, column in then.items():
                now[name][waiting] = column[waiting]

    def run(self, count: int) -> slice:
        """The place of so many new rows."""
        first, self.count = self.count, self.count + count
        return slice(first, self.count)

    def lay(self, owner: object, count: int, columns: Callable[[], Mapping[str, Any]]) -> None:
        """See to it that the rows to come have what is the same in each tick.

        Args:
            owner: what makes them; asked again, it has nothing else to tell.
            count: of rows a tick.
            columns: gives integers and flags of them.
        """
        if not count or self._laid == (owner, count):
            return
        times = -(-(self.capacity - self.count) // count)
        for name, values in columns().items():
            column = self.flags[name] if name in self.flags else self.integers[name]
            column[self.count :] = np.tile(values, times)[: self.capacity - self.count]
        self._laid = owner, count
        self._is_laid_whole = self.count == 0

    def rows(self) -> pa.Table:
        """What waits; what is no number is NULL."""
        waiting = self.arrow.slice(0, self.count)
        with np.errstate(invalid="ignore"):  # a sum takes a third of the time of looking at each
            sums = self.reals[:, : self.count].sum(axis=1)
        for row in np.flatnonzero(np.isnan(sums)).tolist():
            place = len(self.integers) + row
            column = pa.array(self.reals[row, : self.count], from_pandas=True)
            waiting = waiting.set_column(place, waiting.column_names[place], column)
        return waiting

    def taken(self) -> pa.Table:
        """What waits; the ring has nothing to do with it any more."""
        rows = self.rows()
        if 2 * self.count < self.capacity:
            rows = rows.take(pa.array(np.arange(self.count)))
            self.clear()
        else:
            self._lent.append([*self.integers.values(), self.reals, *self.flags.values()])
            self._make(self.capacity)
            self.count = 0
        return rows

    def clear(self) -> None:
        """Forget what waited."""
        self.ticks[: self.count] = -1
        self.count = 0
        if not self._is_laid_whole:
            self._laid = None


def _is_free(numbers: list[npt.NDArray[Any]]) -> bool:
    """Whether nobody but its list, and who asks, knows these buffers."""
    return all(sys.getrefcount(numbers[place]) == 2 for place in range(len(numbers)))


class Ticks:
    """The numbers and times of the ticks that are kept, ascending."""

    def __init__(self) -> None:
        self._numbers = np.zeros(256, dtype=np.int64)
        self._times = np.zeros(256)
        self._first = self._end = 0

    def __len__(self) -> int:
        return self._end - self._first

    @classmethod
    def of(cls, numbers: npt.ArrayLike, times: npt.ArrayLike) -> Ticks:
        """Such ticks, ascending; times in seconds."""
        ticks = cls()
        ticks._numbers = np.array(numbers, dtype=np.int64)
        ticks._times = np.array(times, dtype=np.float64)
        ticks._end = len(ticks._numbers)
        return ticks

    def append(self, number: int, time: float) -> None:
        """Note one more."""
        if self._end == len(self._numbers):
            self._make_room()
        self._numbers[self._end], self._times[self._end] = number, time
        self._end += 1

    def _make_room(self) -> None:
        kept = slice(self._first, self._end)
        count = len(self)
        numbers = np.zeros(max(256, 2 * count), dtype=np.int64)
        times = np.zeros(len(numbers))
        numbers[:count], times[:count] = self._numbers[kept], self._times[kept]
        self._numbers, self._times = numbers, times
        self._first, self._end = 0, count

    def forget_before(self, number: int) -> None:
        """Forget those of lower numbers."""
        self._first += int(np.searchsorted(self.numbers, number))

    @property
    def numbers(self) -> npt.NDArray[np.int64]:
        """(n,), ascending."""
        return self._numbers[self._first : self._end]

    @property
    def times(self) -> Array:
        """(n,), seconds, never falling."""
        return self._times[self._first : self._end]


class Store(Protocol):
    """What keeps the rows of ticks.

    Attributes:
        keeps: whether it keeps them where they are, which takes no time.
    """

    keeps: bool

    def add_members(
        self, members: Collection[Member], geometry_id: Callable[[Geometry], int]
    ) -> None:
        """Keep what entities are, all or none of it; geometries by their numbers."""

    def add(self, rows: Mapping[str, pa.Table], cut: Cut = WHENEVER) -> None:
        """Keep the rows of whole ticks, all or none of them; enters the cut to make them good."""

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """The rows of a table at ticks from first to last."""

    def near(self, asked: Any, waiting: pa.Table | None) -> pa.Table:
        """The pairs of entities whose boxes are near at some ticks."""

    def drop_before(self, tick: int) -> int:
        """Drop old ticks; tells which one is the first that is still there."""


class Recorder:
    """Keeps the ticks of a world.

    Args:
        recording: what of them.
        store: where.
        waits: so many ticks wait at most to be stored.

    Attributes:
        rings: what waits to be stored, by table.
        ticks: those that are kept.
        members: the entities that they tell of, by id; of those that are gone, too.
    """

    def __init__(self, recording: Recording, store: Store, waits: int = RING_TICKS) -> None:
        self.recording = recording
        self._waits = waits
        self._store = store
        self.rings = {table: _ring(table) for table in ("ticks", *recording.tables)}
        if "links" not in recording.tables:
            self.rings[FRAMES] = _frames_ring()
        columns = {table: ring.arrow.schema for table, ring in self.rings.items()}
        self._storing = Storing(store.add, columns)
        self._lock = threading.RLock()
        self.ticks = Ticks()
        self.members: dict[int, Member] = {}
        self._told = 0
        self._is_looked_after = True
        self._rows: _Rows | None = None
        # Entities of which the store has not been told, and what numbers their geometries.
        self._new: list[Member] = []
        self._geometry_id: Callable[[Geometry], int] | None = None

    @property
    def shown(self) -> tuple[Mapping[str, Ring | Kept], ...]:
        """What is not stored, by table; to be read with what is, and under `reading`."""
        return (self.rings,) if self._store.keeps else (self._storing.batches, self.rings)

    @property
    def reading(self) -> AbstractContextManager[Any]:
        """Nothing goes from what is not stored to what is while this lasts.

        Who enters it holds the world.
        """
        return self._storing.lock

    @property
    def is_stored_here(self) -> bool:
        """Whether the thread that asks is the one that stores."""
        return self._storing.is_here

    def note(self, snapshot: Snapshot) -> None:
        """Keep a tick, if it is one to be kept; the caller holds its world.

        Raises:
            RecordError: what waits cannot be stored in a folder; this tick waits with it.
            SqlError: the same of a database.
        """
        self._told += 1
        if (self._told - 1) % self.recording.every:
            return
        with self._lock:
            self._keep(snapshot, self._rows_of(snapshot))

    def _keep(self, snapshot: Snapshot, rows: _Rows) -> None:
        counts = {table: rows.count(snapshot, table) for table in self.rings}
        failed = self._tried(self._tell_new)
        is_due = self._is_due(snapshot.time) or not all(
            self.rings[table].takes(count) for table, count in counts.items()
        )
        if is_due:
            failed = self._tried(self._hand_over) or failed
        elif not self._storing.is_busy:
            failed = failed or self._tried(self._look_after)
        failed = failed or self._storing.failure()
        if is_due or not self.rings["ticks"].count:
            for table, count in counts.items():
                self.rings[table].reserve(count, self._waits)
        for table, count in counts.items():
            rows.copy(snapshot, table, self.rings[table], count)
        self.ticks.append(snapshot.number, snapshot.time)
        if not snapshot.is_whole:  # where the ring has what is no number, the store has NULL
            failed = failed or self._tried(self.flush)
        if failed is not None:
            raise failed

    @staticmethod
    def _tried(store: Callable[[], None]) -> BaseException | None:
        """Why something could not be stored, or waited for; None if it was."""
        try:
            store()
        except (SelectScriptError, KeyboardInterrupt) as error:
            return error
        return None

    def _hand_over(self) -> None:
        """Let what waits be stored, when all before it is."""
        self.wait()
        self._put()
        self._look_after()
        if self._new or not len(self._storing):  # rows go after what their entities are
            return
        self._is_looked_after = False
        if self._store.keeps:
            self._storing.store()
            self._look_after()
        else:
            self._storing.start()

    def _put(self) -> None:
        """Empty the rings; what was in them waits in a batch."""
        if self.rings["ticks"].count:
            self._storing.put({table: ring.taken() for table, ring in self.rings.items()})

    def wait(self) -> None:
        """Wait until nothing is being stored in a thread."""
        self._storing.wait()

    def flush(self) -> None:
        """Store what waits, and drop what is too old.

        Raises:
            RecordError: it cannot be stored in a folder; it waits on.
            SqlError: the same of a database.
        """
        with self._lock:
            self.wait()
            failed = self._storing.failure()
            if len(self._storing):  # whether it can be stored now is seen here
                failed = None
            self._tell_new()
            self._put()
            self._is_looked_after = False
            self._storing.store()
            self._look_after()
            if failed is not None:
                raise failed

    def _look_after(self) -> None:
        """Drop what is too old, once after something was stored; nothing is being stored."""
        if self._is_looked_after:
            return
        self._is_looked_after = True
        oldest = self._oldest()
        if oldest is not None:
            self.ticks.forget_before(self._store.drop_before(oldest))

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """The rows of a table at ticks from first to last, those that wait among them.

        The caller holds the world.
        """
        with self.reading:
            stored = self._store.fetch(table, first, last)
            waiting = self._waiting(table)
            ticks = waiting["tick"].to_numpy()
            inside = waiting.filter(pa.array((ticks >= first) & (ticks <= last)))
            copied = inside.select(stored.column_names).cast(stored.schema)
            return pa.concat_tables([stored, copied])

    def near(self, asked: Any) -> pa.Table:
        """The pairs of entities whose boxes are near at some ticks, with their poses.

        The caller holds the world.
        """
        with self.reading:
            return self._store.near(asked, self._waiting("entities"))

    def _waiting(self, table: str) -> pa.Table:
        """The rows of a table that are not stored."""
        return pa.concat_tables([self._storing.batches[table].arrow, self.rings[table].rows()])

    def _is_due(self, time: float) -> bool:
        """Whether what waits is to be stored: so many ticks, or a quarter of what is kept."""
        waiting = self.rings["ticks"].count
        if not waiting:
            return False
        recording = self.recording
        if recording.seconds is not None:
            since = self.ticks.times[-waiting]
            if time - since >= recording.seconds / QUARTERS:
                return True
        most = self._waits if recording.ticks is None else recording.ticks // QUARTERS
        return waiting >= min(self._waits, max(most, 1))

    def _oldest(self) -> int | None:
        """The first tick that is to be kept; None if all are."""
        recording, numbers = self.recording, self.ticks.numbers
        if not len(numbers) or not recording.is_bounded:
            return None
        first = 0
        if recording.ticks is not None:
            first = max(first, len(numbers) - recording.ticks)
        if recording.seconds is not None:
            times = self.ticks.times
            first = max(first, int(np.searchsorted(times, times[-1] - recording.seconds)))
        return int(numbers[first])

    def _rows_of(self, snapshot: Snapshot) -> _Rows:
        if self._rows is None or not self._rows.fit(snapshot):
            self._rows = _Rows(snapshot, self.recording.entities)
            new = [m for m in self._rows.members if m.id not in self.members]
            self._new += new
            self._geometry_id = snapshot.geometry_id
            self.members |= {member.id: member for member in new}
        return self._rows

    def _tell_new(self) -> None:
        """Store what entities are, before rows of theirs."""
        if self._new:
            assert self._geometry_id is not None
            self.wait()
            self._store.add_members(self._new, self._geometry_id)
            self._new = []


def in_parts(table: str) -> pa.Schema:
    """What the columns of a ring of a table are called, and of which types they are."""
    ring = _frames_ring() if table == FRAMES else _ring(table)
    return ring.arrow.schema


def _frames_ring() -> Ring:
    return Ring(("tick", "entity", "link"), FRAME_REALS)


def _ring(table: str) -> Ring:
    stored = STORED[table]
    return Ring(stored.integers, stored.names_of_reals(table), stored.flags)


class _Rows:
    """Which rows of a world's tables are kept, while its entities are the same.

    Args:
        snapshot: of a tick.
        names: of the entities that are kept; None for all.
    """

    def __init__(self, snapshot: Snapshot, names: Collection[str] | None) -> None:
        self._layout = snapshot.layout
        self._of = snapshot.disabled, snapshot.hidden
        members = self._layout.members
        self.members = members if names is None else chosen_members(members, names)
        self._ids = np.array([member.id for member in self.members], dtype=np.int64)
        kept = {member.id for member in self.members}
        absent = snapshot.disabled, snapshot.hidden
        bodies = [member.body for member in self.members]
        self._flags = {
            name: np.array([body is not None and body not in gone for body in bodies], np.uint8)
            for name, gone in zip(("enabled", "visible"), absent, strict=True)
        }
        self._frames = [
            _frames_of(part, self._layout, kept)
            for part in (self._layout.still, self._layout.moving)
        ]
        self._frames_count = sum(len(frames.places) for frames in self._frames)
        self._picked: dict[str, Indices | None] = {
            table: None if names is None else self._pick(snapshot, table)
            for table in ("entities", "joints", "shapes")
        }
        self._picked["links"] = self._links(kept)

    def fit(self, snapshot: Snapshot) -> bool:
        """Whether the entities are still the same, and their flags."""
        return snapshot.layout is self._layout and (
            (snapshot.disabled, snapshot.hidden) == self._of
        )

    def _pick(self, snapshot: Snapshot, table: str) -> Indices:
        owner = snapshot.tables[table]["id" if table == "entities" else "entity"]
        return np.flatnonzero(np.isin(owner, self._ids))

    def _links(self, kept: Collection[int]) -> Indices:
        """The rows of links of bodies that have several."""
        owners = [(id, len(body.links)) for id, body in self._layout.bodies for _ in body.links]
        rows = [row for row, (id, links) in enumerate(owners) if links > 1 and id in kept]
        return np.array(rows, dtype=np.intp)

    def count(self, snapshot: Snapshot, table: str) -> int:
        """How many rows of a table there are to be kept."""
        if table == FRAMES:
            return self._frames_count
        picked = self._selected(snapshot, table)
        return snapshot.tables[table].count if picked is None else len(picked)

    def _selected(self, snapshot: Snapshot, table: str) -> Indices | None:
        """The rows that are kept; None for all."""
        if table in self._picked:
            return self._picked[table]
        if table == "ticks" or self._picked["entities"] is None:
            return None
        sides = ("a", "b") if table == "contacts" else ("sensor", "entity")
        live = snapshot.tables[table]
        return np.flatnonzero(np.logical_and(*(np.isin(live[side], self._ids) for side in sides)))

    def copy(self, snapshot: Snapshot, table: str, ring: Ring, count: int) -> None:
        """Copy the rows of a table, of which there are so many, into a ring."""
        if table in self._picked or table == FRAMES:
            ring.lay(self, count, lambda: self._fixed(snapshot, table))
        run = ring.run(count)
        ring.ticks[run] = snapshot.number
        if table == FRAMES:
            self._copy_frames(snapshot, ring, run)
            return
        live: LiveTable = snapshot.tables[table]
        stored, picked = STORED[table], self._selected(snapshot, table)
        reals = live.reals(*stored.reals)
        ring.reals[:, run] = reals if picked is None else reals[:, picked]
        if table not in self._picked:
            for name in stored.integers[1:]:
                column = live[name]
                ring.integers[name][run] = column if picked is None else column[picked]

    def _fixed(self, snapshot: Snapshot, table: str) -> dict[str, npt.NDArray[Any]]:
        """The columns of integers and flags, but for the ticks."""
        if table == FRAMES:
            owners = {"entity": [f.entities for f in self._frames]}
            links = {"link": [f.links for f in self._frames]}
            return {name: np.concatenate(parts) for name, parts in (owners | links).items()}
        stored, picked = STORED[table], self._picked[table]
        live = snapshot.tables[table]
        own = {n: live[n] if picked is None else live[n][picked] for n in stored.integers[1:]}
        return own | {name: self._flags[name] for name in stored.flags}

    def _copy_frames(self, snapshot: Snapshot, ring: Ring, run: slice) -> None:
        ring.reals[0, run] = snapshot.time
        first = run.start
        for own, (_, frames) in zip(self._frames, snapshot.parts, strict=True):
            if not len(own.places):
                continue
            to = slice(first, first + len(own.places))
            first = to.stop
            ring.reals[1:4, to] = frames.positions.take(own.places, axis=0).T
            ring.reals[4:, to] = frames.states[:, 3:7].take(own.places, axis=0).T


@dataclass(frozen=True, eq=False)
class _Frames:
    """Of the bodies of several links that are read together: which frames, and whose."""

    places: Indices
    entities: Indices
    links: Indices


def _frames_of(part: Any, layout: Layout, kept: Collection[int]) -> _Frames:
    ids = {body: id for id, body in layout.bodies}
    runs = [
        (ids[body], run)
        for body, run in part.runs.items()
        if len(body.links) > 1 and ids[body] in kept
    ]
    counts = [run.stop - run.start for _, run in runs]
    empty = np.zeros(0, dtype=np.intp)
    return _Frames(
        np.concatenate([empty, *(np.arange(run.start, run.stop) for _, run in runs)]),
        np.repeat(np.array([id for id, _ in runs], dtype=np.int64), counts),
        np.concatenate([empty, *map(np.arange, counts)]),
    )


def chosen_members(members: Collection[Member], names: Collection[str]) -> list[Member]:
    """The entities of these names, and the bodies that sensors among them sit on."""
    hosts = {member.mount[0] for member in members if member.sensor and member.name in names}
    return [member for member in members if member.name in names or member.id in hosts]


def check_names(recording: Recording, members: Collection[Member]) -> None:
    """Complain of names that no entity has.

    Raises:
        ArgumentError: with the nearest right names.
    """
    known = [member.name for member in members]
    for name in recording.entities or ():
        if name not in known:
            raise ArgumentError(
                f"there is no entity {shown(name)} to be recorded", suggestions=nearest(name, known)
            )
