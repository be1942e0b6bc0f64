"""Writes episodes as folders of Parquet files, in complete parts (see `parquet_layout`)."""

from __future__ import annotations

import secrets
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from ssduck.errors import RecordError
from ssduck.recording.background_writer import NO_LOCK, CommitLock
from ssduck.recording.buffers import MAX_BUFFERED_ROWS
from ssduck.recording.episode import Tags, checked_tags, new_id
from ssduck.recording.folder_episodes import (
    begin_episode,
    folders_of,
    missing_folders,
    remove_empty,
    remove_episode,
)
from ssduck.recording.paths import FORMAT, expand_path, part_name
from ssduck.recording.spec import Recording
from ssduck.recording.static_tables import complete_rows, model_rows
from ssduck.recording.stores.base import TickStore
from ssduck.recording.stores.descriptions import (
    EPISODE,
    camera_text,
    change_description,
    check_description,
)
from ssduck.recording.stores.files import sync_folder, write_parquet
from ssduck.recording.stores.object_store import ObjectPath, remove_tree
from ssduck.recording.stores.parquet_layout import LOG, FolderRun
from ssduck.recording.stores.part_log import PartLog
from ssduck.recording.stores.summaries import write_summary
from ssduck.schema import recorded_tables
from ssduck.simulators.scenes import Camera
from ssduck.world.layout import EntityInfo
from ssduck.world.snapshot import Snapshot

# The columns of which parts have statistics: queries choose parts by them.
_WITH_STATISTICS = ("tick", "time")
# A part has so many ticks, unless a flush completes it before.
PART_TICKS = 2400


class ParquetStore(TickStore):
    """An episode of a world that is written into a folder of Parquet files.

    Its rows are read when the folder is opened (`ssduck.recording.stores.parquet_archive`).
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
        order: int = 0,
    ) -> None:
        self.path = expand_path(path)
        self.recording = recording
        self.tables = recorded_tables(recording.tables)
        about = {
            "world": world,
            "id": new_id(),
            "key": secrets.token_hex(8),
            "checksums": "crc32",
            "tables": list(self.tables),
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "recording": {"every": recording.every, "entities": recording.entities},
            "tags": dict(tags or {}),
            "order": order,
        }
        about |= {} if camera is None else {"camera": camera_text(camera)}
        about |= {"exporting": True} if is_export else {}
        self._made = missing_folders(self.path)
        try:
            self.run = begin_episode(self.path, world, about)
        except BaseException:
            if self._made:
                remove_empty(self.path, self._made)
            raise
        self._models: dict[str, pa.Table] = {}
        self._geometries: set[int] = set()
        self._part_count = self._model_count = 0
        # Where the files are: those of an export get their places when all of them are there.
        self._staged = self.run
        if is_export and not isinstance(self.path, ObjectPath):
            self._staged = replace(self.run, path=self.path / f".export-{self.run.key}")
        self._log = PartLog(self._staged.place(LOG), self.run.key)
        self.last_tick: int | None = None
        # The CRC-32 of the files of the parts, by their names in the record.
        self._checksums: dict[str, int] = {}

    def add_members(self, members: Collection[EntityInfo], snapshot: Snapshot) -> None:
        """Stores the models of entities as a part, all or nothing."""
        models = model_rows(members, snapshot, self._geometries)
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
            self.add_members((), Snapshot())

    def _set_last_tick(self, rows: Mapping[str, pa.Table]) -> None:
        self.last_tick = int(np.max(rows["ticks"]["tick"].to_numpy()))

    def finish(self) -> None:
        """Marks the episode as complete, with the number of its parts."""
        parts = {"ticks": self._part_count, "models": self._model_count}

        def finished(about: dict[str, Any]) -> dict[str, Any]:
            return {key: about[key] for key in about if key != "exporting"} | {"parts": parts}

        try:
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
            remove_empty(self.path, self._made)

    def _move_staged(self) -> None:
        """Moves the files of an export to their places."""
        if self._staged is self.run:
            return
        for name in folders_of(self.tables):
            staged, place = self._staged.place(name), self.run.place(name)
            if staged.is_dir():
                place.parent.mkdir(parents=True, exist_ok=True)
                staged.rename(place)
                sync_folder(place.parent)
        remove_tree(self._staged.path)
        self._staged = self.run

    def _write(self, table: str, number: int, rows: pa.Table) -> None:
        place = self._staged.place(table)
        labelled = rows.replace_schema_metadata({FORMAT: self.run.label(table, number)})
        with _writing(place):
            place.mkdir(parents=True, exist_ok=True)
            file = part_name(number)
            checksum = write_parquet(labelled, place / file, **_options(labelled))
        self._checksums[f"{self.run.folder(table)}/{file}"] = checksum


def write_tags(run: FolderRun, tags: Tags) -> None:
    """Adds tags to the description of an episode, and replaces those of the same names."""
    added = checked_tags(tags)

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


def _options(rows: pa.Table) -> dict[str, Any]:
    """Returns options that take little time: a busy world has a new part every second or two."""
    # LZ4 is faster than Zstandard; to split the bytes of doubles makes up for most of the size.
    doubles = [f.name for f in rows.schema if pa.types.is_floating(f.type)]
    texts = [f.name for f in rows.schema if pa.types.is_string(f.type)]
    keys = [f.name for f in rows.schema if pa.types.is_integer(f.type)]
    return {
        "compression": "lz4",
        "use_dictionary": [*texts, *keys],
        "use_byte_stream_split": doubles,
        "write_statistics": [name for name in _WITH_STATISTICS if name in rows.column_names],
    }
