"""The manifest of a lake: a Parquet file with what there is to know of each episode.

It has a row for each episode, with its files, their sizes and checksums, so that an episode is
asked without being listed, parsed and checked anew. Whatever it lacks, or has of files that were
changed since, is read anew from the records (`ssduck.lakes.scan`).
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from ssduck.recording.episode import Tag
from ssduck.recording.paths import expand_path
from ssduck.recording.stores.files import verified_parquet, write_parquet
from ssduck.recording.stores.object_store import ObjectPath
from ssduck.recording.stores.summaries import StoredFile

VERSION = 1
_LABEL = b"ssduck manifest"
_FILES = pa.list_(
    pa.struct(
        [
            ("name", pa.string()),
            ("size", pa.int64()),
            ("modified", pa.int64()),
            ("checksum", pa.int64()),
        ]
    )
)
SCHEMA = pa.schema(
    [
        ("path", pa.string()),
        ("world", pa.string()),
        ("episode", pa.int64()),
        ("id", pa.string()),
        ("started", pa.string()),
        ("complete", pa.bool_()),
        ("version", pa.int64()),
        ("ticks", pa.int64()),
        ("first_tick", pa.int64()),
        ("last_tick", pa.int64()),
        ("start", pa.float64()),
        ("end", pa.float64()),
        ("every", pa.int64()),
        ("tables", pa.list_(pa.string())),
        ("entities", pa.list_(pa.string())),
        ("tags", pa.string()),
        ("group", pa.string()),
        ("error", pa.string()),
        ("files", _FILES),
    ],
    metadata={_LABEL: str(VERSION).encode()},
)


@dataclass(frozen=True)
class EpisodeEntry:
    """What a manifest has of an episode.

    Attributes:
        path: the folder or the DuckDB file of the record, absolute.
        world: the name of the world.
        episode: the number of the episode of that world.
        id: the UUID of the run; None if that is unknown.
        started: the date and time of the start, in ISO 8601.
        complete: whether the recording was closed; None if that is unknown.
        version: the version of the format of the record.
        ticks: the number of ticks.
        first_tick: the number of the first tick.
        last_tick: the number of the last tick.
        start: the simulated time of the first tick, s.
        end: the simulated time of the last tick, s.
        every: n where every n-th tick was recorded.
        tables: the recorded tables.
        entities: the names of the entities, by id.
        tags: what was said of the run, by name.
        group: the same text for episodes with the same models, tables and entities at the last
            tick, which are asked together; None for an episode that is asked by itself.
        error: why the episode cannot be opened; None if nothing was wrong with it.
        files: the files.
    """

    path: str
    world: str
    episode: int
    id: str | None = None
    started: str | None = None
    complete: bool | None = None
    version: int | None = None
    ticks: int | None = None
    first_tick: int | None = None
    last_tick: int | None = None
    start: float | None = None
    end: float | None = None
    every: int | None = None
    tables: tuple[str, ...] | None = None
    entities: tuple[str, ...] | None = None
    tags: dict[str, Tag] = field(default_factory=dict)
    group: str | None = None
    error: str | None = None
    files: tuple[StoredFile, ...] = ()

    @property
    def key(self) -> tuple[str, str, int]:
        """What tells the episode from others, and their order."""
        return self.path, self.world, self.episode


def named_errors(entries: Sequence[EpisodeEntry]) -> str:
    """Returns how many episodes have errors, and what that of the first one is."""
    number = "1 has an error" if len(entries) == 1 else f"{len(entries)} have errors, the first"
    return f"{number}, in {entries[0].path}: {entries[0].error}"


def table_of(entries: Iterable[EpisodeEntry]) -> pa.Table:
    """Returns entries as the rows of a manifest."""
    rows = [_row(entry) for entry in entries]
    arrays = [pa.array([row[f.name] for row in rows], f.type) for f in SCHEMA]
    return pa.table(arrays, schema=SCHEMA)


def _row(entry: EpisodeEntry) -> dict[str, Any]:
    row = {f.name: getattr(entry, f.name) for f in fields(entry)}
    return row | {
        "tags": json.dumps(entry.tags, sort_keys=True),
        "files": [asdict(file) for file in entry.files],
    }


def entries_of(table: pa.Table) -> list[EpisodeEntry]:
    """Returns the rows of a manifest as entries."""
    return [_entry(row) for row in table.to_pylist()]


def _entry(row: dict[str, Any]) -> EpisodeEntry:
    return EpisodeEntry(
        **{
            **row,
            "tables": None if row["tables"] is None else tuple(row["tables"]),
            "entities": None if row["entities"] is None else tuple(row["entities"]),
            "tags": json.loads(row["tags"]),
            "files": tuple(StoredFile(**file) for file in row["files"]),
        }
    )


def write_manifest(entries: Iterable[EpisodeEntry], file: Path) -> bool:
    """Writes a manifest, all or nothing; returns whether the folder can be written.

    Its paths begin in its folder, so that a lake can be moved.
    """
    base = file.parent
    relative = [replace(e, path=_below(e.path, base)) for e in entries]
    with suppress(OSError):
        write_parquet(table_of(relative), file, compression="zstd")
        return True
    return False


def _below(path: str, base: Path) -> str:
    """Returns the path of a record from a folder on, which it is in."""
    place = expand_path(path)
    if isinstance(place, ObjectPath):
        return str(place).removeprefix(str(base)).lstrip("/") or "."
    return place.relative_to(base).as_posix()


def read_manifest(file: Path) -> list[EpisodeEntry]:
    """Returns the entries of a manifest; none if it is missing, damaged or of another version."""
    try:
        content = verified_parquet(file, has_checksums=True)
        metadata = content.schema_arrow.metadata or {}
        if metadata.get(_LABEL) != str(VERSION).encode():
            return []
        if content.schema_arrow.remove_metadata() != SCHEMA.remove_metadata():
            return []
        return [
            replace(entry, path=str(file.parent / entry.path))
            for entry in entries_of(content.read())
        ]
    # A RecordError is an OSError.
    except (OSError, pa.ArrowException, ValueError, TypeError):
        return []


def tag_column(values: Sequence[Tag | None]) -> pa.Array:
    """Returns a column of a tag; texts if it has values of several types."""
    types = {type(value) for value in values if value is not None}
    if types <= {bool}:
        return pa.array(values, pa.bool_())
    if types <= {int}:
        return pa.array(values, pa.int64())
    if types <= {int, float}:
        return pa.array(values, pa.float64())
    return pa.array([None if value is None else str(value) for value in values], pa.string())
