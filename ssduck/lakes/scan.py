"""Finds the episodes below a path, and reads what a manifest has of each."""

from __future__ import annotations

import glob
import os
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import pyarrow as pa

from ssduck.errors import RecordError, SelectScriptError, warn
from ssduck.interpreter.archives import episodes
from ssduck.lakes.manifest import EpisodeEntry
from ssduck.recording.episode_steps import FOLDER as STEPS
from ssduck.recording.folder_episodes import ABOUT, VERSION, check_about, lost_runs, runs_named
from ssduck.recording.paths import expand_path
from ssduck.recording.stores.files import checksum_of, is_temporary
from ssduck.recording.stores.object_store import ObjectPath, file_system, reading
from ssduck.recording.stores.parquet_layout import INDEX, LOG, PAIRS, FolderRun
from ssduck.recording.stores.summaries import (
    EpisodeSummary,
    Listing,
    StoredFile,
    parts_in,
    read_summary,
    size_and_time,
    summary_of,
)
from ssduck.schema import MODELS, RECORDED

DUCKDB_SUFFIX = ".duckdb"
# The folders that a record has of its own.
OF_RECORD = frozenset((*RECORDED, "episodes", STEPS, INDEX, LOG, "models", PAIRS))
# The folders that have the files of an episode in them.
_FOLDERS = (*RECORDED, INDEX, LOG, PAIRS, *(f"models/{table}" for table in MODELS))
# The names of the objects of an episode.
_OF_EPISODE = re.compile(
    r"(?:.+/world=(?P<world>[^/]+)/episode=(?P<part_of>0|[1-9][0-9]{0,8})/[^/.][^/]*"
    r"|(?:episodes|gym)/(?P<described>[^/]+)-(?P<number>0|[1-9][0-9]{0,8})\.json)"
)
# What an entry says as an episode does, and as a summary does, of its ticks.
_EXTENT = ("ticks", "first_tick", "last_tick", "start", "end")
_OF_RUN = ("id", "started", "complete", *_EXTENT, "every", "tables", "entities")
MISSING = "is missing: its files were there when the manifest was made"


# An episode in a folder with its files, or the entry of one of which no more is to be read.
_Found: TypeAlias = EpisodeEntry | tuple[FolderRun, Listing]


def records_below(place: Path) -> Iterator[Path]:
    """Yields the records in a folder and its folders, or the path itself if it is a record.

    A record may have others in its folder, beside its own files. Warns of folders that cannot be
    listed.
    """

    def note(error: OSError) -> None:
        if error.filename == str(place):
            raise error
        warn(f"records in {error.filename} are left out: {error.strerror}")

    if place.is_file():
        yield place
        return
    for folder, folders, files in os.walk(place, onerror=note):
        if ABOUT in files or {"episodes", "ticks"} <= set(folders):
            yield Path(folder)
            folders[:] = set(folders) - OF_RECORD
        folders[:] = sorted(name for name in folders if not is_temporary(Path(name)))
        yield from (Path(folder, file) for file in sorted(files) if file.endswith(DUCKDB_SUFFIX))


def records_of(pattern: str) -> list[Path]:
    """Returns the records below a folder, or below whatever a pattern of paths matches."""
    place = expand_path(pattern)
    if isinstance(place, ObjectPath):
        return _records_in_store(place)
    is_pattern = glob.has_magic(pattern) and not os.path.exists(pattern)  # noqa: PTH110
    places = sorted(glob.glob(pattern, recursive=True)) if is_pattern else [pattern]  # noqa: PTH207
    if not places or not os.path.exists(places[0]):  # noqa: PTH110
        raise RecordError(f"there is no record {pattern}: neither a folder nor a DuckDB file")
    found = {path.absolute(): None for place in places for path in records_below(Path(place))}
    return sorted(found)


def _records_in_store(place: ObjectPath) -> list[Path]:
    names = objects_below(place)
    if not names:
        raise RecordError(f"there is no record {place}: there is no object below it")
    folders = {name.rpartition("/")[0] for name in names if name.rpartition("/")[2] == ABOUT}
    return sorted((place / folder if folder else place for folder in folders), key=str)


def objects_below(place: ObjectPath) -> dict[str, tuple[int, int]]:
    """Returns the sizes and times of all objects below an address, by their names there."""
    from pyarrow.fs import FileSelector, FileType

    selector = FileSelector(place.key, recursive=True, allow_not_found=True)
    start = len(place.key.rstrip("/")) + 1
    with reading(place):
        found = file_system().get_file_info(selector)
    return {
        info.path[start:]: (info.size, info.mtime_ns)
        for info in found
        if info.type == FileType.File
    }


def _found_in(record: Path) -> Iterator[_Found]:
    """Yields the episodes of a record; reads none of a folder."""
    if isinstance(record, ObjectPath):
        for (world, number), listing in sorted(_listings_in_store(record).items()):
            yield FolderRun(record, world, number), listing
    elif record.is_file():
        yield from _entries_of_file(record)
    else:
        try:
            runs = runs_named(record)
            runs += lost_runs(record, [(run.world, run.number) for run in runs])
        except OSError as error:  # a RecordError is one
            yield _unreadable(record, error)
            return
        yield from map(_found_run, runs)


def _found_run(run: FolderRun) -> _Found:
    try:
        return run, _listing(run)
    except OSError as error:  # a RecordError is one
        return _unreadable(run.path, error, run.world, run.number)


def _unreadable(record: Path, error: Exception, world: str = "", number: int = 0) -> EpisodeEntry:
    """Returns the entry of an episode, or of a record, that cannot be read."""
    message = str(error)
    if isinstance(error, SelectScriptError):
        message = error.message
    elif isinstance(error, OSError) and error.filename is not None:
        message = f"{error.filename}: {error.strerror}"
    return EpisodeEntry(str(record), world, number, error=message)


def _listings_in_store(record: ObjectPath) -> dict[tuple[str, int], dict[str, tuple[int, int]]]:
    """Returns the files of each episode of a record in an object store, of one listing."""
    objects = objects_below(record)
    others = {name[: -len(ABOUT)] for name in objects if name.endswith(f"/{ABOUT}")}
    listings: dict[tuple[str, int], dict[str, tuple[int, int]]] = {}
    for name, about in objects.items():
        match = _OF_EPISODE.fullmatch(name)
        if match is not None and not name.startswith(tuple(others)):
            world, number = (match["world"] or match["described"]), match["part_of"]
            key = world, int(number or match["number"])
            listings.setdefault(key, {ABOUT: objects.get(ABOUT, (0, 0))})[name] = about
    return listings


def _listing(run: FolderRun) -> dict[str, tuple[int, int]]:
    """Returns the files of an episode in a folder."""
    files: dict[str, tuple[int, int]] = {}
    described = run.about_file.name
    for name in (ABOUT, f"episodes/{described}", f"{STEPS}/{described}"):
        with suppress(FileNotFoundError):
            files[name] = size_and_time(run.path / name)
    for folder in map(run.folder, _FOLDERS):
        with suppress(FileNotFoundError), os.scandir(run.path / folder) as entries:
            for entry in entries:
                if not entry.name.startswith(".") and entry.is_file():
                    status = entry.stat()
                    files[f"{folder}/{entry.name}"] = (status.st_size, status.st_mtime_ns)
    return files


def _listing_of_file(file: Path) -> Listing:
    """Returns a DuckDB file, and its log if it has one."""
    log = file.with_name(f"{file.name}.wal")
    return {one.name: size_and_time(one) for one in (file, log) if one.is_file()}


def _entries_of_file(file: Path) -> list[EpisodeEntry]:
    try:
        files = tuple(
            StoredFile(name, size, modified, checksum_of(file.with_name(name)))
            for name, (size, modified) in sorted(_listing_of_file(file).items())
        )
        listed = episodes(file)
    except (SelectScriptError, OSError) as error:
        return [_unreadable(file, error)]
    return [
        EpisodeEntry(
            str(file),
            one.world,
            one.number,
            version=VERSION,
            tags=dict(one.tags),
            files=files,
            **{name: getattr(one, name) for name in _OF_RUN},
        )
        for one in listed
    ]


def entries_of_records(
    records: Iterable[Path], known: Mapping[tuple[str, str, int], EpisodeEntry]
) -> Iterator[EpisodeEntry]:
    """Yields an entry for each episode, those that are known and did not change as they are."""
    of_files: dict[str, list[EpisodeEntry]] = {}
    for one in known.values():
        of_files.setdefault(one.path, []).append(one)
    for record in records:
        before_of_file = of_files.get(str(record), [])
        if _is_unchanged_file(record, before_of_file):
            yield from before_of_file
            continue
        for found in _found_in(record):
            if isinstance(found, EpisodeEntry):
                yield found
                continue
            run, listing = found
            before = known.get((str(run.path), run.world, run.number))
            if before is not None and _is_unchanged(before, listing):
                yield before
            elif (entry := _described(run, listing)) is not None:
                yield entry


def _is_unchanged_file(record: Path, entries: Sequence[EpisodeEntry]) -> bool:
    """Checks whether a record is a DuckDB file that is as all its entries say."""
    if not entries or isinstance(record, ObjectPath) or not record.is_file():
        return False
    listing = _listing_of_file(record)
    return all(_is_unchanged(entry, listing) for entry in entries)


def _is_unchanged(entry: EpisodeEntry, listing: Listing) -> bool:
    if entry.error is not None:  # it may have been the system's
        return False
    return {file.name: (file.size, file.modified) for file in entry.files} == listing


def missing(entry: EpisodeEntry) -> EpisodeEntry:
    """Returns the entry of an episode whose files are gone."""
    message = f"episode {entry.episode} of {entry.world!r} in {entry.path} {MISSING}"
    return replace(entry, error=message, group=None, files=())


def _described(run: FolderRun, listing: Listing) -> EpisodeEntry | None:
    """Returns the entry of an episode in a folder; None if an export has not finished it."""
    entry = EpisodeEntry(str(run.path), run.world, run.number)
    try:
        if not run.about_file.is_file():
            raise RecordError(f"{run.about_file} is missing, and ticks of its episode are there")
        check_about(run.path)
        if not run.has_begun:
            return None
        if not run.has_ticks:
            raise RecordError(f"no tick of {run.world!r} was stored before the recording ended")
        return _entry_of(run, entry, listing)
    except RecordError as error:
        return replace(entry, error=error.message)
    except (OSError, pa.ArrowException) as error:
        return replace(entry, error=f"{run.about_file} cannot be read: {error}")


def _entry_of(run: FolderRun, entry: EpisodeEntry, listing: Listing) -> EpisodeEntry:
    """Returns the entry of an episode that can be read."""
    summary = read_summary(run, listing) or _computed(run, listing)
    files = []
    for name, (size, modified) in sorted(listing.items()):
        file = summary.files.get(name)
        checksum = zlib.crc32((run.path / name).read_bytes()) if file is None else file.checksum
        files.append(StoredFile(name, size, modified, checksum))
    return replace(
        entry,
        id=run.id,
        started=run.description["started"],
        complete=run.is_complete,
        version=VERSION,
        **{name: getattr(summary, name) for name in _EXTENT},
        every=run.recording.get("every", 1),
        tables=tuple(run.tables),
        entities=summary.entities,
        tags=dict(run.tags),
        group=summary.group,
        files=tuple(files),
    )


def _computed(run: FolderRun, listing: Listing) -> EpisodeSummary:
    """Returns the summary of an episode, for which each file is read."""
    files = {}
    for name, (size, modified) in parts_in(run, listing).items():
        content = (run.path / name).read_bytes()
        files[name] = StoredFile(name, size, modified, zlib.crc32(content))
    # The models are checked when they are read.
    numbers = run.parts
    are_whole = not any(run.problem(table, n) for table in run.tables for n in numbers)
    return summary_of(run, files, are_whole=are_whole)
