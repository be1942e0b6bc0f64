"""Writes records of poses from anywhere: another simulator, motion capture, a real robot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyarrow as pa

from ssduck import validation
from ssduck.errors import ArgumentError, record_errors
from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.poses import rotation_matrices
from ssduck.interchange.entities import Entities, entities_of
from ssduck.interchange.pose_batches import Frames, PoseBatch, batch_of
from ssduck.recording.buffers import MAX_BUFFERED_ROWS
from ssduck.recording.episode import Episode
from ssduck.recording.paths import expand_path
from ssduck.recording.spec import Recording
from ssduck.recording.stores.parquet import PART_TICKS, ParquetStore
from ssduck.recording.tags import Tags, given_tags
from ssduck.schema import FRAMES, RECORDED
from ssduck.simulators.interface import LinkPoses
from ssduck.world import ctrl_c
from ssduck.world.layout import BodyGroup, EntityInfo, TableLayout
from ssduck.world.snapshot import Snapshot

# The boxes of about so many frames are computed together.
_FRAMES_AT_ONCE = 2048


def write_record(
    folder: str | Path,
    entities: Entities,
    poses: Any,
    times: Any = None,
    *,
    velocities: Any = None,
    world: str = "world",
    tags: Tags | None = None,
) -> Episode:
    """Writes poses from anywhere as an episode of a record, which `ssduck.open` answers as any.

    Relations of positions work, and those of shapes for the entities whose shapes are given. There
    are no contacts, readings of sensors and positions of joints: a query for them is an error that
    says so. If anything is wrong, nothing is written.

    Metres, seconds, kilograms; world frame, z up; poses are those of link frames, and quaternions
    w, x, y, z.

    Args:
        folder: the folder; it is made if it does not exist, and may hold other episodes.
        entities: the names of the entities; or a dict of their descriptions by name. A description
            may have: one shape, `box` (lengths along x, y, z), `sphere` (radius), `cylinder` or
            `capsule` (radius, length along z), `ellipsoid` (half its lengths along x, y, z),
            `plane` (normal), `mesh` (a file: all triangles) or `hull` (a file, or points (n, 3)),
            with `position` and `orientation` in the frame of the entity, and `scale` for a file; or
            any number of them, `shapes`; `kind` (`robot`, or `kinbody` by default); `mass`;
            `movable` (`True` by default); `links`, a dict of further links by name, each with
            shapes, mass and `parent` (a link before it; by default the entity itself).
        poses: an array of the poses of all frames, (ticks, frames, 7): x, y, z, qw, qx, qy, qz, or
            (ticks, frames, 3) of positions; or such an array for each frame by its name, (ticks,
            7) or (ticks, 3), or (7,) or (3,) of what stands still; or a table (Arrow, pandas,
            polars) with a row for each frame at each tick: time, name, x, y, z, and qw, qx, qy, qz
            unless nothing is turned, and vx, vy, vz, wx, wy, wz if they are known. With a column
            tick, of ascending numbers, several ticks may be at one time. Frames are the
            entities in their order, each followed by its links, whose names are `entity.link`. In
            a table, an entity may be missing at a tick: it is not there then. A quaternion of
            another length than 1 is scaled.
        times: the time of each tick, s, ascending; None for a table, which has them.
        velocities: of each frame, as `poses`, (…, 6): vx, vy, vz, m/s, and wx, wy, wz, rad/s, world
            frame; None if they are unknown. Unknown ones are NULL.
        world: the name of the world.
        tags: what you say of the run: texts, True, False or finite numbers, by name.

    Returns:
        The episode.

    Raises:
        ArgumentError: a name, a shape of an array or a number is wrong; times do not ascend; a
            value is NaN or infinite.
        RecordError: the folder holds other files, or cannot be written.

    >>> import numpy as np, ssduck, tempfile
    >>> times = np.arange(3) / 10
    >>> falling = np.stack([0 * times, 0 * times, 1 - times], axis=1)
    >>> entities = {"table": {"box": [1, 1, 0.1]}, "cup": {"sphere": 0.05}}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = ssduck.write_record(folder, entities, {"table": [0, 0, 0], "cup": falling}, times)
    ...     with ssduck.open(folder) as ss:
    ...         ss.eval("SELECT round(clearance(world.cup, this), 3) FROM world{} "
    ...                 "WHERE id == 'table' AS list;")
    [0.9, 0.8, 0.7]
    """
    writer = RecordWriter(folder, entities, world=world, tags=tags)
    return writer.write_whole([batch_of(writer.frames, poses, times, velocities, None)])


def write_tables(
    folder: str | Path,
    entities: Entities,
    tables: Iterable[pa.Table],
    *,
    world: str,
    tags: Tags | None,
) -> Episode:
    """Writes tables of poses as an episode, one after the other; see `write_record`.

    Frames come and go by themselves: an entity is there when all of its links are.
    """
    writer = RecordWriter(folder, entities, world=world, tags=tags)
    return writer.write_whole(
        batch_of(writer.frames, table, None, None, writer.last, are_whole=False) for table in tables
    )


class RecordWriter:
    """Writes an episode in batches of ticks: a context manager for long runs.

    A batch is checked before any of it is written. The episode begins with the first one. What was
    written stays, whatever happens to the process, in complete parts and a log, as with
    `Interpreter.record_to`.

    Args:
        folder: the folder; see `write_record`, also for the others.
        entities: the entities.
        world: the name of the world.
        tags: what you say of the run.

    Raises:
        ArgumentError: a name, a key or a value is wrong.

    >>> import numpy as np, ssduck, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with ssduck.RecordWriter(folder, ["marker"], world="lab") as writer:
    ...         for start in (0.0, 1.0):
    ...             writer.add(np.zeros((2, 1, 3)), times=[start, start + 0.5])
    ...     ssduck.episodes(folder)[0].ticks
    4
    """

    def __init__(
        self,
        folder: str | Path,
        entities: Entities,
        *,
        world: str = "world",
        tags: Tags | None = None,
    ) -> None:
        self._path = expand_path(folder).absolute()
        self._world = validation.world_name(world)
        self._tags = given_tags(tags)
        self._entities = entities_of(entities)
        self.frames = Frames.of(self._entities)
        has_links = len(self.frames) > len(self._entities)
        self._recording = Recording(tables=("entities", "links") if has_links else ("entities",))
        self._rows = _RowMaker(self._entities, self.frames, has_links=has_links)
        self._store: ParquetStore | None = None
        self._ticks = 0
        self.last: float | None = None
        self._is_closed = False

    def add(self, poses: Any, times: Any = None, *, velocities: Any = None) -> None:
        """Writes the poses of further ticks; see `write_record`.

        Raises:
            ArgumentError: a shape of an array or a number is wrong, or a time is not after the
                last one; nothing of the batch is written.
            RecordError: the folder holds other files, or cannot be written.
        """
        if self._is_closed:
            raise ArgumentError("add: the record is closed; write another one")
        batch = batch_of(self.frames, poses, times, velocities, self.last)
        if len(batch.times):
            if self._store is None:
                self.begin(is_export=False)
            self.write(batch)

    def write_whole(self, batches: Iterable[PoseBatch]) -> Episode:
        """Writes all batches of the episode, or nothing.

        Raises:
            ArgumentError: there is no tick.
        """
        try:
            for batch in batches:
                if len(batch.times):
                    if self._store is None:
                        self.begin(is_export=True)
                    self.write(batch)
            if self._store is None:
                raise ArgumentError("poses: there is no tick")
            return self.close()
        except BaseException:
            self.discard()
            raise

    @record_errors()
    def begin(self, *, is_export: bool) -> None:
        """Begins the episode; if it is an export, it exists only when it is closed."""
        with ctrl_c.deferred():  # so that `discard` has what was begun
            self._store = ParquetStore(
                self._path, self._world, self._recording, is_export=is_export, tags=self._tags
            )
        self._store.add_members(self._entities, Snapshot())

    def write(self, batch: PoseBatch) -> None:
        """Writes a batch, part by part."""
        assert self._store is not None
        most = max(min(PART_TICKS, MAX_BUFFERED_ROWS // max(len(self.frames), 1)), 1)
        for start in range(0, len(batch.times), most):
            part = _slice_of(batch, start, start + most)
            self._store.append(self._rows.tables(part, self._ticks + 1))
            self._ticks += len(part.times)
            self.last = float(part.times[-1])

    def close(self) -> Episode:
        """Completes the episode, and returns it.

        Raises:
            ArgumentError: nothing was written.
            RecordError: the folder cannot be written.
        """
        if self._store is None:
            raise ArgumentError("close: nothing was written: add poses before")
        if not self._is_closed:
            self._store.complete()
            self._store.finish()
            self._is_closed = True
        return self._store.run.episode

    def discard(self) -> None:
        """Removes what was written of the episode."""
        with ctrl_c.deferred():
            if self._store is not None:
                self._store.discard()
            self._is_closed = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None
    ) -> None:
        if kind is None or self._store is not None:
            self.close()


def _slice_of(batch: PoseBatch, start: int, stop: int) -> PoseBatch:
    part = slice(start, stop)
    return PoseBatch(batch.times[part], batch.poses[part], batch.twists[part], batch.present[part])


# -- rows -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _RowMaker:
    """Makes the rows of the tables of a record from poses, with the boxes of the shapes."""

    entities: Sequence[EntityInfo]
    frames: Frames
    has_links: bool

    def tables(self, batch: PoseBatch, first: int) -> dict[str, pa.Table]:
        """Returns the rows of a batch by table; its first tick gets the number `first`."""
        ticks = np.arange(first, first + len(batch.times))
        counts = len(self.entities), len(self.frames)
        of_entities, of_links = (np.zeros((19, count, len(ticks))) for count in counts)
        for portion, poses in _in_portions(batch, max(_FRAMES_AT_ONCE // max(counts[1], 1), 1)):
            self._bodies.write_entities(poses, of_entities[..., portion])
            if self.has_links:
                self._bodies.write_links(poses, of_links[..., portion])
        flags = np.ones(counts[0], dtype=np.uint8)
        ids = np.arange(1, counts[0] + 1)
        rows = {
            "ticks": _rows("ticks", ticks, batch.times, {"wall_time": None}),
            "entities": _numbered(
                "entities",
                batch,
                ticks,
                of_entities,
                batch.present,
                {"id": ids, "enabled": flags, "visible": flags},
            ),
        }
        if not self.has_links:
            return rows | {FRAMES: _rows(FRAMES, ticks[:0], batch.times[:0], {})}
        return rows | {"links": self._link_rows(batch, ticks, of_links)}

    @cached_property
    def _bodies(self) -> BodyGroup:
        """The bodies."""
        return TableLayout(self.entities, is_external=True).moving_bodies

    def _link_rows(self, batch: PoseBatch, ticks: Indices, block: Array) -> pa.Table:
        """Returns the rows of the links of entities that have several."""
        owners, starts = self.frames.owners, self.frames.starts
        several = np.flatnonzero(np.bincount(owners, minlength=len(starts))[owners] > 1)
        numbers = {"entity": owners[several] + 1, "link": several - starts[owners[several]]}
        present = batch.present[:, owners[several]]
        return _numbered("links", batch, ticks, block[:, several], present, numbers)


def _numbered(
    table: str,
    batch: PoseBatch,
    ticks: Indices,
    block: Array,
    present: Flags,
    fixed: Mapping[str, Any],
) -> pa.Table:
    """Returns the rows of a table of poses: of what is present, tick by tick."""
    tick, column = np.nonzero(present)
    names = [name for name in RECORDED[table].tick_columns.doubles if name != "time"]
    values = {name: block[place][column, tick] for place, name in enumerate(names)}
    return _rows(
        table, ticks[tick], batch.times[tick], values | {n: v[column] for n, v in fixed.items()}
    )


def _rows(table: str, ticks: Indices, times: Array, values: Mapping[str, Any]) -> pa.Table:
    """Returns rows with the columns of a table that differ from tick to tick; NULL for NaN."""
    columns = RECORDED[table].tick_columns
    types = {
        **dict.fromkeys(columns.integers, pa.int64()),
        **dict.fromkeys(columns.doubles, pa.float64()),
        **dict.fromkeys(columns.booleans, pa.uint8()),
    }
    given: dict[str, Any] = {"tick": ticks, "time": times, **values}
    arrays = [
        pa.nulls(len(ticks), type)
        if given.get(name) is None
        else pa.array(np.ascontiguousarray(given[name]), type, from_pandas=type == pa.float64())
        for name, type in types.items()
    ]
    return pa.table(arrays, names=list(types))


def _in_portions(batch: PoseBatch, count: int) -> Iterator[tuple[slice, LinkPoses]]:
    """Yields the ticks, so many at a time at most, each time with their poses."""
    for start in range(0, len(batch.times), count):
        portion = slice(start, min(start + count, len(batch.times)))
        poses = batch.poses[portion].reshape(-1, 7)
        states = np.concatenate((poses, batch.twists[portion].reshape(-1, 6)), axis=1)
        positions, orientations = poses[:, :3].copy(), poses[:, 3:].copy()
        yield portion, LinkPoses(positions, rotation_matrices(orientations), states)
