"""Writes a world to a folder of Parquet files: until it is told to stop, or what is recorded."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
import pyarrow as pa

from ssduck.errors import EvaluationError
from ssduck.recording.episode import Episode, Tags, given_tags
from ssduck.recording.folder_episodes import missing_folders, remove_empty
from ssduck.recording.recorder import Recorder
from ssduck.recording.replay.record import Record
from ssduck.recording.spec import Recording, check_names, chosen_members
from ssduck.recording.stores.parquet import ParquetStore, write_tags
from ssduck.recording.stores.stored_columns import with_nulls
from ssduck.schema import RECORDABLE, RECORDED
from ssduck.world import ctrl_c

if TYPE_CHECKING:
    from ssduck.world.world import World


class ParquetRecording:
    """A recording of a world to a folder, until it is closed.

    If the user resets the simulation, the recording goes on in a new episode.

    Attributes:
        world: the recorded world.
    """

    def __init__(
        self,
        world: World,
        recording: Recording,
        path: Path,
        name: str,
        part_ticks: int,
        recorders: list[Recorder],
        tags: Tags | None = None,
        order: int = 0,
    ) -> None:
        self.world = world
        self._order = order
        self._tags = tags
        self._recording, self._path, self._name = recording, path, name
        self._part_ticks = part_ticks
        self._recorders = recorders
        self._start()

    def _start(self) -> None:
        recording, world = self._recording, self.world
        self._folder = ParquetStore(
            self._path,
            self._name,
            recording,
            tags=self._tags,
            camera=world.camera,
            order=self._order,
        )
        self._recorder = Recorder(recording, self._folder, self._part_ticks, recording.flush_every)
        self._recorders.append(self._recorder)
        try:
            world.ticker.add_recorder(self._recorder)
        except BaseException:
            self._recorder.stop_flushing()
            self._recorder.wait()
            world.ticker.remove_recorder(self._recorder)
            self._recorders.remove(self._recorder)
            self._folder.discard()
            raise

    @property
    def is_running(self) -> bool:
        """Whether it is not closed."""
        return self._recorder in self._recorders

    def begin_episode(self) -> None:
        """Completes the episode, and goes on in a new one."""
        self.close()
        self._start()

    @property
    def number(self) -> int:
        """The number of the present episode."""
        return self._folder.run.number

    @property
    def episode(self) -> Episode:
        """The episode as it is on the disk so far."""
        return self._folder.run.episode

    def tag(self, tags: Tags) -> None:
        """Adds tags to the present episode, at any time, and replaces those of the same names.

        Args:
            tags: texts, True, False or finite numbers, by name.

        Raises:
            ArgumentError: a tag is another value.
            RecordError: the file that describes the episode cannot be written.
        """
        write_tags(self._folder.run, given_tags(tags))

    def flush(self) -> int | None:
        """Writes the buffered ticks to the disk; returns the last tick there, or None.

        Other programs than ssduck see them when the part that they belong to is complete.

        Raises:
            RecordError: they cannot be written, as the disk is full, say; they stay buffered.
        """
        with self.world.pinned():
            self._recorder.flush()
            return self._folder.last_tick

    def close(self) -> None:
        """Writes the buffered ticks, and ends the recording.

        Raises:
            RecordError: they cannot be written; the recording goes on, and can be closed again.
        """
        if not self.is_running:
            return
        self._recorder.mass_changes.warn(self.world)
        with self.world.pinned():
            self._recorder.finish()
        self._recorder.stop_flushing()
        self.world.ticker.remove_recorder(self._recorder)
        self._recorders.remove(self._recorder)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def whole_record(path: Path) -> Iterator[list[ParquetStore]]:
    """Lets episodes be added to a folder, all or none."""
    made, begun = missing_folders(path), list[ParquetStore]()
    try:
        yield begun
    except BaseException:
        with ctrl_c.deferred():
            for episode in begun:
                episode.discard()
            if made is not None and path.exists():
                remove_empty(path, made)
        raise


# About so many rows of entities make a part: ten megabytes.
PART_ROWS = 1 << 18


def export(
    record: Record,
    recording: Recording,
    world: str,
    path: Path,
    names: tuple[str, ...] | None,
    between: tuple[float | None, float | None],
    begun: list[ParquetStore],
    tags: Tags | None = None,
    order: int = 0,
) -> Path:
    """Writes recorded ticks of a world as a new episode, and returns the folder of its ticks."""
    numbers = _ticks(record, between)
    record.warn_of_masses()
    chosen = Recording(
        tables=tuple(sorted(record.tables & set(RECORDABLE))),
        entities=recording.entities if names is None else names,
        every=recording.every,
    )
    members = list(record.members.values())
    check_names(Recording(entities=names), members)
    selected = members if names is None else chosen_members(members, names)
    ids = None if names is None else pa.array([member.id for member in selected])
    with ctrl_c.deferred():
        store = ParquetStore(
            path,
            world,
            chosen,
            is_export=True,
            tags={**record.tags, **(tags or {})},
            camera=record.world.camera,
            order=order,
        )
        begun.append(store)
    store.add_members(selected, record.world.snapshot)
    for first, last in _parts(numbers, max(len(selected), 1)):
        fetched = {
            table: with_nulls(in_order(record.fetch(table, first, last))) for table in store.tables
        }
        store.add({table: _rows_of(ids, table, rows) for table, rows in fetched.items()})
    store.finish()
    return store.run.place("ticks")


def in_order(rows: pa.Table) -> pa.Table:
    """Returns rows sorted by tick; the rows of a tick keep their order."""
    ticks = rows["tick"].to_numpy()
    if (ticks[1:] >= ticks[:-1]).all():
        return rows
    return rows.take(np.argsort(ticks, kind="stable"))


def _ticks(record: Record, between: tuple[float | None, float | None]) -> list[int]:
    numbers, times = record.ticks.numbers, record.ticks.times
    low = -np.inf if between[0] is None else between[0]
    high = np.inf if between[1] is None else between[1]
    selected: list[int] = numbers[(times >= low - 1e-9) & (times <= high + 1e-9)].tolist()
    if not selected:
        name = record.world.name
        recorded = f"from {times[0]:g} s to {times[-1]:g} s" if len(times) else "nothing"
        raise EvaluationError(f"no tick of {name!r} of that time is recorded, but {recorded}")
    return selected


def _parts(numbers: list[int], rows: int) -> list[tuple[int, int]]:
    """Returns the first and the last tick of each part."""
    step = max(PART_ROWS // rows, 1)
    parts = [numbers[start : start + step] for start in range(0, len(numbers), step)]
    return [(part[0], part[-1]) for part in parts]


def _rows_of(ids: pa.Array | None, table: str, rows: pa.Table) -> pa.Table:
    """Returns the rows of some entities; all rows if `ids` is None."""
    if ids is None:
        return rows
    is_selected = np.ones(rows.num_rows, dtype=bool)
    for column in RECORDED[table].entity_columns:
        is_selected &= np.isin(rows[column].to_numpy(), ids.to_numpy())
    return rows.filter(pa.array(is_selected))
