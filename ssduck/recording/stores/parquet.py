"""Writes records as folders of Parquet files, in complete parts (see `parquet_layout`)."""

from __future__ import annotations

import os
import secrets
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pyarrow as pa

from ssduck.errors import RecordError
from ssduck.formatting import short_repr
from ssduck.geometry.shapes import Geometry
from ssduck.recording.background_writer import NO_LOCK, CommitLock
from ssduck.recording.buffers import MAX_BUFFERED_ROWS
from ssduck.recording.episode import Episode, new_id
from ssduck.recording.episode_steps import FOLDER as STEPS
from ssduck.recording.paths import expand_path
from ssduck.recording.recorded_visuals import camera_text
from ssduck.recording.recorder import Recorder
from ssduck.recording.spec import Recording
from ssduck.recording.static_tables import IdProvider, model_rows
from ssduck.recording.stores.atomic_files import (
    create_file,
    is_temporary,
    sync_folder,
)
from ssduck.recording.stores.base import TickStore
from ssduck.recording.stores.checksums import json_text, write_parquet
from ssduck.recording.stores.complete_rows import complete_rows
from ssduck.recording.stores.descriptions import EPISODE, change_description, check_description
from ssduck.recording.stores.links import check_inside
from ssduck.recording.stores.object_store import ObjectPath, remove_tree
from ssduck.recording.stores.parquet_layout import (
    ABOUT,
    DESCRIPTION,
    FORMAT,
    LOG,
    PAIRS,
    FolderRun,
    check_about,
    part_name,
)
from ssduck.recording.stores.part_log import PartLog
from ssduck.recording.stores.part_statistics import OWN_STATISTICS
from ssduck.recording.stores.summaries import write_summary
from ssduck.recording.stores.tick_index import INDEX, TickIndex
from ssduck.recording.tags import Tags, checked_tags
from ssduck.schema import MODELS, recorded_tables
from ssduck.simulators.scenes import Camera
from ssduck.world.layout import EntityInfo

if TYPE_CHECKING:
    from ssduck.world.world import World

# A part has so many ticks, unless a flush completes it before.
PART_TICKS = 2400
# The maximum length of a file name in bytes, where the system does not report it.
_NAME_MAX = 255


class ParquetStore(TickStore):
    """An episode of a world that is written into a folder of Parquet files.

    Its rows are read when the folder is opened (`ssduck.recording.stores.parquet_archive`).

    Args:
        path: the folder; it is created if it does not exist.
        world: the name of the world.
        recording: what is recorded of each tick.
        is_export: whether the episode exists only when it is finished.
        tags: what the user says of the run.
        camera: the camera of the world; None if it is not stored.
        about: the id of the episode and the time of its start; None for new ones.

    Raises:
        RecordError: the path is that of a file, or of a folder with something else in it, or it
            cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        world: str,
        recording: Recording,
        *,
        is_export: bool = False,
        tags: Tags | None = None,
        camera: Camera | None = None,
        about: Mapping[str, str] | None = None,
    ) -> None:
        self.path = expand_path(path)
        self.recording = recording
        self.tables = recorded_tables(recording.tables)
        described = _description(world, self.tables, recording, tags or {}, is_export=is_export)
        if camera is not None:
            described["camera"] = camera_text(camera)
        self._made = _missing_folders(self.path)
        try:
            self.run = _begin_episode(self.path, world, described | dict(about or {}))
        except BaseException:
            if self._made:
                _remove_empty(self.path, self._made)
            raise
        self._models: dict[str, pa.Table] = {}
        self._geometries: set[int] = set()
        # The numbers of parts of the tables and of the models.
        self._part_count = self._model_count = 0
        assert self.run.key is not None
        # Where the files are: those of an export get their places when all of them are there.
        self._staged = self.run
        if is_export and not isinstance(self.path, ObjectPath):
            self._staged = replace(self.run, path=self.path / f".export-{self.run.key}")
        self._log = PartLog(self._staged.place(LOG), self.run.key)
        self._index = TickIndex(self._staged.place(INDEX), self.run.key)
        self.last_tick: int | None = None
        # The CRC-32 of the files of the parts, by their names in the record.
        self._checksums: dict[str, int] = {}

    def add_members(self, members: Collection[EntityInfo], id_provider: IdProvider) -> None:
        """Stores the models of entities as a part, all or nothing."""
        models = model_rows(members, id_provider, self._geometries)
        for table in sorted(models, key=lambda table: table == "entities"):
            self._write(f"models/{table}", self._model_count, models[table])
        for table, rows in models.items():
            before = self._models.get(table)
            self._models[table] = rows if before is None else pa.concat_tables([before, rows])
        self._geometries |= set(models["geometries"]["id"].to_pylist())
        self._model_count += 1

    def append(self, rows: Mapping[str, pa.Table], commit_lock: CommitLock = NO_LOCK) -> None:
        """Stores the rows of whole ticks in the log, or as a part if they complete one."""
        if self._fill_a_part(rows):
            self.add(rows, commit_lock)
            return
        self._store_empty_models()
        with _writing(self._log.place), commit_lock:
            self._log.append(self._part_count, rows)
            self._set_last_tick(rows)

    def add(self, rows: Mapping[str, pa.Table], commit_lock: CommitLock = NO_LOCK) -> None:
        """Stores the rows of the log and those of further whole ticks as a part, all or nothing."""
        self._store_empty_models()
        rows = self._log.with_rows(rows)
        for table, added in rows.items():
            if table != "ticks":
                complete = complete_rows(table, added, rows["entities"], self._models)
                self._write(table, self._part_count, complete)
        with commit_lock:
            self._write("ticks", self._part_count, rows["ticks"])
            self._part_count += 1
            self._set_last_tick(rows)
        with _writing(self._log.place):
            self._log.clear()
            self._index.add(rows["ticks"])

    def complete(self) -> None:
        """Stores the rows of the log as a part."""
        if self._log:
            self.add({})

    def _fill_a_part(self, rows: Mapping[str, pa.Table]) -> bool:
        """Checks whether the log has as many rows as a part with these, or would with one tick."""
        counts = {table: self._log.count(table) + added.num_rows for table, added in rows.items()}
        ticks: int = counts["ticks"]
        most: int = max(counts.values())
        return ticks >= PART_TICKS or most + most / ticks > MAX_BUFFERED_ROWS

    def _store_empty_models(self) -> None:
        if not self._model_count:  # the world has no entities
            self.add_members((), _NoIds())

    def _set_last_tick(self, rows: Mapping[str, pa.Table]) -> None:
        self.last_tick = int(np.max(rows["ticks"]["tick"].to_numpy()))

    def finish(self) -> None:
        """Marks the episode as complete, with the number of its parts.

        Raises:
            RecordError: the file cannot be written.
        """
        parts = {"ticks": self._part_count, "models": self._model_count}

        def finished(about: dict[str, Any]) -> dict[str, Any]:
            return {key: about[key] for key in about if key != "exporting"} | {"parts": parts}

        try:
            self._index.write()
            self._move_staged()
            change_description(self.run.about_file, finished)
        except OSError as error:
            raise RecordError(f"{self.run.about_file} cannot be written: {error}") from error
        self._summarize()

    def _summarize(self) -> None:
        """Writes the summary of the episode, which is complete without it."""
        if self._part_count:
            run = FolderRun(self.path, self.run.world, self.run.number)  # as it is now
            with suppress(OSError):  # a lake reads the files instead; a RecordError is an OSError
                write_summary(run, self._checksums)

    def discard(self) -> None:
        """Removes the files of the episode, and the folder if it was made for them."""
        if self._staged is not self.run:
            remove_tree(self._staged.path)
        remove_episode(self.run)
        if self._made is not None:
            _remove_empty(self.path, self._made)

    @property
    def _places(self) -> tuple[str, ...]:
        """The names of the folders of the episode."""
        return _folders_of(self.tables)

    def _move_staged(self) -> None:
        """Moves the files of an export to their places."""
        if self._staged is self.run:
            return
        for name in self._places:
            staged, place = self._staged.place(name), self.run.place(name)
            if staged.is_dir():
                place.parent.mkdir(parents=True, exist_ok=True)
                staged.rename(place)
                sync_folder(place.parent)
        remove_tree(self._staged.path)
        self._staged = self.run

    def _write(self, table: str, number: int, rows: pa.Table) -> None:
        place = self._staged.place(table)
        label = self.run.label(table, number)
        assert label is not None
        labelled = rows.replace_schema_metadata({FORMAT: label})
        with _writing(place):
            place.mkdir(parents=True, exist_ok=True)
            file = part_name(number)
            checksum = write_parquet(labelled, place / file, **_options(labelled))
        self._checksums[f"{self.run.folder(table)}/{file}"] = checksum

    def drop_before(self, tick: int) -> int:  # noqa: ARG002
        """Returns 0: a folder keeps all ticks."""
        return 0


def write_tags(run: FolderRun, tags: Tags) -> None:
    """Adds tags to the description of an episode, and replaces those of the same names.

    Raises:
        ArgumentError: a tag is no text, boolean or finite number.
        RecordError: the file that describes the episode is damaged, or cannot be written.
    """
    added = checked_tags(tags)
    check_inside(run.path, run.about_file)

    def with_tags(about: dict[str, Any]) -> dict[str, Any]:
        check_description(about, EPISODE, str(run.about_file), "what is recorded")
        return about | {"tags": checked_tags({**about.get("tags", {}), **added})}

    with _writing(run.about_file):
        change_description(run.about_file, with_tags)


@contextmanager
def _writing(place: Path) -> Iterator[None]:
    """Turns errors of the system into ssduck's while a folder is written."""
    try:
        yield
    except RecordError:
        raise
    except OSError as error:
        raise RecordError(
            f"{place} cannot be written: {error}; the rows that were stored before are intact, "
            "and the others are kept until there is room"
        ) from error


@dataclass(frozen=True)
class _NoIds:
    """The numbers of a world that has no entities."""

    run: int = 0
    drawn: None = None

    def geometry_id(self, geometry: Geometry) -> int:
        """Fails: there are no geometries."""
        raise AssertionError(geometry)


class ParquetRecording:
    """A recording of a world to a folder, until it is closed.

    If the user resets the simulation, the recording goes on in a new episode.

    Args:
        world: the recorded world.
        recording: what is recorded.
        path: the folder.
        name: the name of the world there.
        part_ticks: the largest number of ticks of a part.
        recorders: the running recorders of the database, to which it adds its own.
        tags: what the user says of the run, of each of its episodes.

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
    ) -> None:
        self.world = world
        self._tags = tags
        self._recording, self._path, self._name = recording, path, name
        self._part_ticks = part_ticks
        self._recorders = recorders
        self._start()

    def _start(self) -> None:
        """Starts a new episode."""
        recording, world = self._recording, self.world
        self._folder = ParquetStore(
            self._path, self._name, recording, tags=self._tags, camera=world.camera
        )
        self._recorder = Recorder(recording, self._folder, self._part_ticks, recording.flush_every)
        self._recorders.append(self._recorder)
        try:
            world.add_recorder(self._recorder)
        except BaseException:
            self._recorder.stop_flushing()
            self._recorder.wait()
            world.remove_recorder(self._recorder)
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
        write_tags(self._folder.run, tags)

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
        self.world.remove_recorder(self._recorder)
        self._recorders.remove(self._recorder)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _description(
    world: str, tables: Collection[str], recording: Recording, tags: Tags, *, is_export: bool
) -> dict[str, Any]:
    """Returns what a new episode says of itself, but for its number."""
    about = {
        "world": world,
        "id": new_id(),
        "key": secrets.token_hex(8),
        "checksums": "crc32",
        "tables": list(tables),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "recording": {"every": recording.every, "entities": recording.entities},
        "tags": dict(tags),
    }
    return about | {"exporting": True} if is_export else about


def _folders_of(tables: Sequence[str]) -> tuple[str, ...]:
    """Returns the names of the folders of an episode with some tables."""
    return (*tables, LOG, INDEX, *(f"models/{table}" for table in MODELS))


def remove_episode(run: FolderRun) -> None:
    """Removes the files of an episode that is not wanted."""
    for name in (*_folders_of(run.tables), PAIRS):
        remove_tree(run.place(name))
    (run.path / STEPS / f"{run.world}-{run.number}.json").unlink(missing_ok=True)
    run.about_file.unlink(missing_ok=True)


@contextmanager
def whole_record(path: Path) -> Iterator[list[FolderRun]]:
    """Lets episodes be added to a folder, all or none.

    Args:
        path: the folder; one that is made in the context goes, too, if the context fails.

    Yields:
        The episodes, which are appended when they are complete.
    """
    made, runs = _missing_folders(path), list[FolderRun]()
    try:
        yield runs
    except BaseException:
        for run in runs:
            remove_episode(run)
        if made is not None and path.exists():
            _remove_empty(path, made)
        raise


def _missing_folders(path: Path) -> list[Path] | None:
    """Returns the folders that are made for a new record; None if there is one already."""
    if isinstance(path, ObjectPath) or (path / ABOUT).exists():
        return None
    return [folder for folder in (path, *path.parents) if not folder.exists()]


def _remove_empty(path: Path, made: Sequence[Path]) -> None:
    """Removes a new record without episodes, and the folders that were made for it.

    Another recorder may have begun an episode in it; then it stays.
    """
    with suppress(OSError, ValueError):
        with suppress(FileNotFoundError):  # the disk was full before
            (path / "episodes").rmdir()
        (path / ABOUT).unlink(missing_ok=True)
        for name, _, _ in os.walk(path, topdown=False):
            if Path(name) != path:
                Path(name).rmdir()
    for folder in made:
        with suppress(OSError, ValueError):  # it has files, or was not made
            folder.rmdir()
    with suppress(OSError, ValueError):
        if (path / "episodes").exists() and not (path / ABOUT).exists():
            create_file(path / ABOUT, json_text(DESCRIPTION))


def _begin_episode(path: Path, world: str, about: Mapping[str, Any]) -> FolderRun:
    """Begins a new episode in a folder; creates the folder if necessary."""
    if not world.isidentifier():
        raise RecordError(
            f"a world called {short_repr(world)} cannot be recorded: bind it to a name"
        )
    try:
        str(path.absolute()).encode()  # the Parquet library takes UTF-8 names only
        if path.exists() and not path.is_dir():
            raise RecordError(
                f"{path} is a file, and a record of Parquet files is a folder: give the path of a "
                "new folder, or of a record"
            )
        path.mkdir(parents=True, exist_ok=True)
        _check_name_length(path, world)
        about_file = path / ABOUT
        for place in (about_file, path / "episodes"):
            check_inside(path, place)
        if not about_file.exists():
            others = [file for file in path.iterdir() if not is_temporary(file)]
            # Another recorder may have begun in the meantime.
            if others and not about_file.exists():
                raise RecordError(
                    f"{path} has something else in it, and is no record of ssduck: give a new "
                    "folder, or an empty one"
                )
            create_file(about_file, json_text(DESCRIPTION))
        check_about(path)
        (path / "episodes").mkdir(exist_ok=True)
        return _claim_episode(path, world, about)
    except RecordError:
        raise
    except (OSError, ValueError) as error:  # a null character is a ValueError
        reason = error.strerror if isinstance(error, OSError) else error
        raise RecordError(f"{path} cannot be written: {reason}") from error


def _check_name_length(path: Path, world: str) -> None:
    """Checks that the name of a world is short enough for the names of files.

    Raises:
        RecordError: it is too long for the system.
    """
    maximum = _NAME_MAX
    if hasattr(os, "pathconf"):
        with suppress(OSError, ValueError):
            maximum = os.pathconf(path, "PC_NAME_MAX")
    # The longest file name of an episode, with as many digits as its number may have: that of a
    # damaged description, which a repair has set aside.
    longest = f"{FolderRun(path, '', 10**6).about_file.name}.damaged-10"
    room = maximum - len(longest)
    length = len(os.fsencode(world))
    if length > room:
        raise RecordError(
            f"a world called {short_repr(world)} cannot be recorded in {path}: files are named "
            f"after it, and its name has {length} bytes; at most {room} fit: bind it to a shorter "
            "one"
        )


def _claim_episode(path: Path, world: str, about: Mapping[str, Any]) -> FolderRun:
    """Creates the file of an episode under a number that is free, after those that are not.

    Raises:
        RecordError: a link leads a folder of the episode out of the record.
    """
    numbers = count(_free_number(path, world))
    while True:
        run = FolderRun(path, world, next(numbers))
        for place in (run.about_file, *map(run.place, _folders_of(about["tables"]))):
            check_inside(path, place)
        if create_file(run.about_file, json_text({**about, "episode": run.number})):
            return run


def _free_number(path: Path, world: str) -> int:
    """Returns the number of an episode that is not there, after one that is.

    It looks at few of them, so that beginning an episode does not take longer with each.
    """
    step = 1
    while FolderRun(path, world, step - 1).about_file.exists():
        step *= 2
    # The number step // 2 - 1 is taken, if it is no less than 0, and step - 1 is free.
    taken, free = step // 2 - 1, step - 1
    while free - taken > 1:
        middle = (taken + free) // 2
        if FolderRun(path, world, middle).about_file.exists():
            taken = middle
        else:
            free = middle
    return free


def _options(rows: pa.Table) -> dict[str, Any]:
    """Returns options that take little time: a busy world has a new part every second or two.

    LZ4 takes less time than Zstandard. To split the bytes of doubles makes up for most of the size.
    Statistics of other columns choose no parts, and would be compared with them at each opening.
    """
    doubles = [f.name for f in rows.schema if pa.types.is_floating(f.type)]
    texts = [f.name for f in rows.schema if pa.types.is_string(f.type)]
    keys = [f.name for f in rows.schema if pa.types.is_integer(f.type)]
    return {
        "compression": "lz4",
        "use_dictionary": [*texts, *keys],
        "use_byte_stream_split": doubles,
        "write_statistics": [name for name in OWN_STATISTICS if name in rows.column_names],
    }
