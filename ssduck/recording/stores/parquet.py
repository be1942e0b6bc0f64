"""Writes records as folders of Parquet files, in complete parts (see `parquet_layout`)."""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ssduck.errors import RecordError
from ssduck.formatting import short_repr
from ssduck.geometry.shapes import Geometry
from ssduck.recording.background_writer import NO_LOCK, CommitLock
from ssduck.recording.episode import Episode
from ssduck.recording.recorder import Recorder
from ssduck.recording.spec import Recording
from ssduck.recording.static_tables import IdProvider, join_model, model_rows
from ssduck.recording.stores.base import TickStore
from ssduck.recording.stores.parquet_layout import (
    ABOUT,
    FORMAT,
    UNITS,
    VERSION,
    FolderRun,
    check_about,
    part_name,
)
from ssduck.schema import MODELS, TABLES, recorded_tables
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

    Raises:
        RecordError: there is a folder with something else in it, or it cannot be written.
    """

    def __init__(self, path: str | Path, world: str, recording: Recording) -> None:
        self.path = Path(path)
        self.recording = recording
        self.tables = recorded_tables(recording.tables)
        self.run = _begin_episode(self.path, world, self.tables, recording)
        self._models: dict[str, pa.Table] = {}
        self._geometries: set[int] = set()
        # The numbers of parts of the tables and of the models.
        self._part_count = self._model_count = 0
        self.last_tick: int | None = None

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

    def add(self, rows: Mapping[str, pa.Table], commit_lock: CommitLock = NO_LOCK) -> None:
        """Stores the rows of whole ticks as a part, all or nothing."""
        if not self._model_count:  # the world has no entities
            self.add_members((), _NoIds())
        for table, added in rows.items():
            if table != "ticks":
                complete = self._with_model(table, added, rows["entities"])
                self._write(table, self._part_count, complete)
        with commit_lock:
            self._write("ticks", self._part_count, rows["ticks"])
            self._part_count += 1
            self.last_tick = int(np.max(rows["ticks"]["tick"].to_numpy()))

    def finish(self) -> None:
        """Records the number of parts, so that missing ones are noticed.

        Raises:
            RecordError: the file cannot be written.
        """
        parts = {"ticks": self._part_count, "models": self._model_count}
        try:
            about = json.loads(self.run.about_file.read_text("utf-8")) | {"parts": parts}
            _write_atomically(self.run.about_file, lambda file: _write_json(about, file))
        except OSError as error:
            raise RecordError(f"{self.run.about_file} cannot be written: {error}") from error

    def discard(self) -> None:
        """Removes the files of the episode."""
        self.run.about_file.unlink(missing_ok=True)
        for table in (*self.tables, *(f"models/{table}" for table in MODELS)):
            shutil.rmtree(self.run.place(table), ignore_errors=True)

    def _with_model(self, table: str, rows: pa.Table, entities: pa.Table) -> pa.Table:
        """Returns rows with all columns of their table."""
        if table not in TABLES:  # the poses of links are internal
            return rows
        names = TABLES[table].names
        if not TABLES[table].model:
            return rows.select(names)
        if table == "links":
            rows = _sorted_links(
                pa.concat_tables([rows, self._links_of_single_link_bodies(rows, entities)])
            )
        for name in TABLES[table].tick_columns.booleans:
            place = rows.column_names.index(name)
            rows = rows.set_column(place, name, rows[name].cast(pa.bool_()))
        return join_model(table, rows, self._models[table], names)

    def _links_of_single_link_bodies(self, links: pa.Table, entities: pa.Table) -> pa.Table:
        """Returns the rows of the links of bodies with one link, which has the pose of the body."""
        model = self._models["entities"]
        single = model.filter(pa.array(model["links"].to_numpy() == 1))["id"].to_numpy()
        bodies = entities.filter(pa.array(np.isin(entities["id"].to_numpy(), single)))
        number = pa.array(np.zeros(bodies.num_rows, dtype=np.int64))
        renamed = bodies.rename_columns({"id": "entity"}).append_column("link", number)
        return renamed.select(links.column_names)

    def _write(self, table: str, number: int, rows: pa.Table) -> None:
        place = self.run.place(table)
        label = self.run.label(table, number)
        assert label is not None
        labelled = rows.replace_schema_metadata({FORMAT: label})
        try:
            place.mkdir(parents=True, exist_ok=True)
            _write_atomically(
                place / part_name(number), lambda file: _write_parquet(labelled, file)
            )
        except OSError as error:
            raise RecordError(
                f"{place} cannot be written: {error}; the rows that were stored before are intact, "
                "and the others are kept until there is room"
            ) from error

    def drop_before(self, tick: int) -> int:  # noqa: ARG002
        """Returns 0: a folder keeps all ticks."""
        return 0


def _sorted_links(links: pa.Table) -> pa.Table:
    """Returns rows of links sorted by tick, entity and link, so that sums are reproducible."""
    keys = [links[name].to_numpy() for name in ("link", "entity", "tick")]
    return links.take(np.lexsort(keys))


@dataclass(frozen=True)
class _NoIds:
    """The numbers of a world that has no entities."""

    run: int = 0

    def geometry_id(self, geometry: Geometry) -> int:
        """Fails: there are no geometries."""
        raise AssertionError(geometry)


class ParquetRecording:
    """A recording of a world to a folder, until it is closed.

    Args:
        world: the recorded world.
        recorder: records its ticks.
        folder: the store in the folder.
        recorders: the running recorders of the database, this one included.
    """

    def __init__(
        self, world: World, recorder: Recorder, folder: ParquetStore, recorders: list[Recorder]
    ) -> None:
        self._world = world
        self._recorder = recorder
        self._folder = folder
        self._recorders = recorders

    @property
    def episode(self) -> Episode:
        """The episode as it is on the disk so far."""
        return self._folder.run.episode

    def flush(self) -> int | None:
        """Writes the buffered ticks as a part; returns the last tick on the disk, or None.

        Raises:
            RecordError: they cannot be written, as the disk is full, say; they stay buffered.
        """
        with self._world.pinned():
            self._recorder.flush()
            return self._folder.last_tick

    def close(self) -> None:
        """Writes the buffered ticks, and ends the recording.

        Raises:
            RecordError: they cannot be written; the recording goes on, and can be closed again.
        """
        if self._recorder not in self._recorders:
            return
        self._recorder.mass_changes.warn(self._world)
        self.flush()
        self._folder.finish()
        self._world.remove_recorder(self._recorder)
        self._recorders.remove(self._recorder)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _begin_episode(
    path: Path, world: str, tables: Collection[str], recording: Recording
) -> FolderRun:
    """Begins a new episode in a folder; creates the folder if necessary."""
    if not world.isidentifier():
        raise RecordError(
            f"a world called {short_repr(world)} cannot be recorded: bind it to a name"
        )
    try:
        str(path.absolute()).encode()  # the Parquet library takes UTF-8 names only
        path.mkdir(parents=True, exist_ok=True)
        _check_name_length(path, world)
        if not (path / ABOUT).exists():
            if any(file.name != _temporary_path(path / ABOUT).name for file in path.iterdir()):
                raise RecordError(
                    f"{path} has something else in it, and is no record of ssduck: give a new "
                    "folder, or an empty one"
                )
            about = {"format": FORMAT, "version": VERSION, "units": UNITS}
            _write_atomically(path / ABOUT, lambda file: _write_json(about, file))
        check_about(path)
        (path / "episodes").mkdir(exist_ok=True)
        return _claim_episode(path, world, tables, recording)
    except RecordError:
        raise
    except (OSError, ValueError) as error:  # a null character is a ValueError
        raise RecordError(f"{path} cannot be written: {error}") from error


def _check_name_length(path: Path, world: str) -> None:
    """Checks that the name of a world is short enough for the names of files.

    Raises:
        RecordError: it is too long for the system.
    """
    maximum = _NAME_MAX
    if hasattr(os, "pathconf"):
        with suppress(OSError, ValueError):
            maximum = os.pathconf(path, "PC_NAME_MAX")
    # The longest file name of an episode, with as many digits as its number may have.
    room = maximum - len(os.fsencode(_temporary_path(FolderRun(path, "", 10**6).about_file).name))
    length = len(os.fsencode(world))
    if length > room:
        raise RecordError(
            f"a world called {short_repr(world)} cannot be recorded in {path}: files are named "
            f"after it, and its name has {length} bytes; at most {room} fit: bind it to a shorter "
            "one"
        )


def _claim_episode(
    path: Path, world: str, tables: Collection[str], recording: Recording
) -> FolderRun:
    """Creates the file of an episode under the first number that is free."""
    for number in count():
        run = FolderRun(path, world, number)
        try:
            with run.about_file.open("x", encoding="utf-8"):
                break
        except FileExistsError:
            continue
    about = {
        "world": world,
        "episode": number,
        "key": secrets.token_hex(8),
        "tables": list(tables),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "recording": {"every": recording.every, "entities": recording.entities},
    }
    _write_atomically(run.about_file, lambda file: _write_json(about, file))
    return run


def _temporary_path(place: Path) -> Path:
    """Returns the path of a file until it is complete."""
    return place.with_name(f".{place.name}.unfinished")


def _write_atomically(place: Path, write: Callable[[Path], None]) -> None:
    """Writes a file under a temporary name, and renames it when it is on the disk."""
    temporary = _temporary_path(place)
    try:
        write(temporary)
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(place)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    _sync_folder(place.parent)


def _sync_folder(folder: Path) -> None:
    """Writes the names in a folder to the disk, where the system supports it."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _write_json(content: Mapping[str, Any], file: Path) -> None:
    file.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def _write_parquet(rows: pa.Table, file: Path) -> None:
    texts = [f.name for f in rows.schema if pa.types.is_string(f.type)]
    keys = [f.name for f in rows.schema if pa.types.is_integer(f.type)]
    options = {"compression": "zstd", "use_dictionary": [*texts, *keys]}
    # An absolute path: the library takes md:x for a URI, and expands ~.
    pq.write_table(rows, file.absolute(), **options)
