"""Summaries of episodes in folders: what a lake has to know of an episode before it is asked.

    index/world=kitchen/episode=0/summary.json

A summary is written when a recording is closed, so that the manifest of a lake is made without
reading all files. It knows the sizes, the times and the checksums of the parts. If these are not
those that are there, or if there is no summary, as of a recording that was killed, the same is
computed from the files.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import asdict, astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from ssduck.errors import RecordError
from ssduck.recording.episode import extent_of
from ssduck.recording.stores.descriptions import (
    TEXT,
    Description,
    Value,
    check_description,
    is_names,
    is_whole,
    read_description,
)
from ssduck.recording.stores.files import write_json
from ssduck.recording.stores.object_store import ObjectPath, file_system, reading
from ssduck.recording.stores.parquet_layout import INDEX, LOG, FolderRun
from ssduck.schema import MODELS

# The size of each file, bytes, and the time of its last change, ns since 1970, by its name in the
# record.
Listing = Mapping[str, tuple[int, int]]


@dataclass(frozen=True)
class StoredFile:
    """A file of an episode."""

    name: str  # its path in the record, with slashes
    size: int  # its size, bytes
    modified: int  # when it was last changed, ns since 1970
    checksum: int  # the CRC-32 of its bytes


@dataclass(frozen=True)
class EpisodeSummary:
    """What a lake has to know of the ticks and models of an episode."""

    ticks: int  # the number of ticks
    first_tick: int  # the number of the first tick
    last_tick: int  # the number of the last tick
    start: float  # the simulated time of the first tick, s
    end: float  # the simulated time of the last tick, s
    entities: tuple[str, ...]  # the names of the entities, by id
    group: str | None  # the same text for episodes that can be asked together; None for no others
    files: Mapping[str, StoredFile]  # the files of its parts, by name


def summary_name(run: FolderRun) -> str:
    """Returns the name of the file of the summary of an episode, in its record."""
    return f"{run.folder(INDEX)}/summary.json"


def size_and_time(file: Path) -> tuple[int, int]:
    """Returns the size of a file, bytes, and the time of its last change, ns since 1970."""
    if isinstance(file, ObjectPath):
        with reading(file):
            (info,) = file_system().get_file_info([file.key])
        return info.size, info.mtime_ns
    status = file.stat()
    return status.st_size, status.st_mtime_ns


def parts_in(run: FolderRun, listing: Listing) -> Listing:
    """Returns the files of a listing that are in the folders of the parts of an episode."""
    tables = (*run.tables, *(f"models/{model}" for model in MODELS))
    folders = set(map(run.folder, tables))
    return {name: about for name, about in listing.items() if name.rpartition("/")[0] in folders}


def summary_of(
    run: FolderRun, files: Mapping[str, StoredFile], *, are_whole: bool
) -> EpisodeSummary:
    """Returns the summary of an episode, computed from its files."""
    models = {table: run.read(f"models/{table}") for table in MODELS}
    order = np.argsort(models["entities"]["id"].to_numpy(), kind="stable")
    names = models["entities"]["name"].take(pa.array(order)).to_pylist()
    group = _group_of(run, models) if are_whole else None
    extent = extent_of(run.ticks()[1])
    return EpisodeSummary(**extent, entities=tuple(names), group=group, files=files)


def _group_of(run: FolderRun, models: Mapping[str, pa.Table]) -> str | None:
    """Returns what is the same for episodes that can be asked together; None for no others."""
    if run.log or run.removed_parts or not run.has_checksums:
        return None
    parts = {table: run.listed_files(table) for table in run.tables}
    every, entities = run.recording.get("every", 1), run.recording["entities"]
    described = run.world, run.tables, every, entities, run.description.get("camera")
    sink = hashlib.sha256(repr(described).encode())
    for table, rows in sorted(models.items()):
        names = [name for name in rows.column_names if name != "run"]
        columns = {name: rows[name].to_pylist() for name in names}
        sink.update(repr((table, columns)).encode())
    content = pa.BufferReader(parts["entities"][-1].read_bytes())
    last = pq.ParquetFile(content).read(["tick", "id"], use_threads=False)
    sink.update(present_at_end(last).tobytes())
    return sink.hexdigest()


def present_at_end(rows: pa.Table) -> npt.NDArray[np.int64]:
    """Returns the ids of the entities at the last tick of some rows of theirs, ascending."""
    ticks = rows["tick"].to_numpy()
    present: npt.NDArray[np.int64] = np.sort(rows["id"].to_numpy()[ticks == ticks.max(initial=0)])
    return present


# -- files ------------------------------------------------------------------------------------


def write_summary(run: FolderRun, checksums: Mapping[str, int]) -> None:
    """Writes the summary of an episode that has been closed."""
    files = {
        name: StoredFile(name, *size_and_time(run.path / name), checksum)
        for name, checksum in checksums.items()
    }
    content = asdict(summary_of(run, files, are_whole=True))
    content |= {"key": run.key, "files": {name: astuple(file)[1:] for name, file in files.items()}}
    place = run.path / summary_name(run)
    place.parent.mkdir(parents=True, exist_ok=True)
    write_json(content, place)


def read_summary(run: FolderRun, listing: Listing) -> EpisodeSummary | None:
    """Returns the summary of an episode; None if it is missing, damaged or of other files."""
    file = run.path / summary_name(run)
    if summary_name(run) not in listing or run.removed_parts:
        return None
    if any(name.startswith(f"{LOG}/") for name in listing):
        return None
    try:
        content = read_description(file)
        check_description(content, _SUMMARY, str(file), "what is known of the episode")
    except (RecordError, OSError):  # the files have what it has
        return None
    files = {name: StoredFile(name, *values) for name, values in content["files"].items()}
    known = {name: (file.size, file.modified) for name, file in files.items()}
    if content["key"] != run.key or known != parts_in(run, listing):
        return None
    values = {key: content[key] for key in _SUMMARY if key not in ("key", "files", "entities")}
    return EpisodeSummary(**values, entities=tuple(content["entities"]), files=files)


def _is_number(value: Any) -> bool:
    return type(value) is float and math.isfinite(value)


def _is_file(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == len(_FILE_ENDS)
        and all(type(number) is int for number in value)
        and all(0 <= number < end for number, end in zip(value, _FILE_ENDS, strict=True))
    )


# No size, time or checksum reaches these.
_FILE_ENDS = (1 << 53, 1 << 63, 1 << 32)
_WHOLE = Value("a whole number", lambda value: is_whole(value, 0))
_NUMBER = Value("a number", _is_number)
_SUMMARY: Description = {
    "key": TEXT,
    "ticks": Value("a number of ticks", lambda value: is_whole(value, 1)),
    "first_tick": _WHOLE,
    "last_tick": _WHOLE,
    "start": _NUMBER,
    "end": _NUMBER,
    "entities": Value("a list of names", is_names),
    "group": Value("a text, or null", lambda value: value is None or isinstance(value, str)),
    "files": Value(
        "an object of files",
        lambda value: isinstance(value, dict) and all(map(_is_file, value.values())),
    ),
}
