"""Defines the layout of records in folders of Parquet files, and reads them.

    run/
      ssduck.json                                             the format, its version, the units
      episodes/kitchen-0.json                                 what is recorded of which world
      entities/world=kitchen/episode=0/part-000000.parquet    a table, in complete parts
      links/… joints/… shapes/… contacts/… sensings/… ticks/…
      frames/…                                                the poses of links, without `links`
      models/entities/world=kitchen/episode=0/part-000000.parquet    the models of the entities
      index/world=kitchen/episode=0/ticks.parquet    the ticks of many parts (`tick_index`)
      log/world=kitchen/episode=0/part-000001-0000.arrow    rows of a part to come (`part_log`)

DuckDB, polars and pandas read a folder such as `run/entities` as it is: its rows are those of the
table at each tick, and the names of the folders make the columns of the world and the episode.

A file is written under a temporary name, which begins with a dot, and renamed when it is complete.
The `ticks` of a part are written last, and the `entities` of a part of models. So a part that has
these is complete, whatever happened; a part without them does not count.

The footer of each file identifies its episode, table and part, so that a missing file, a swapped
one, or one of another record is noticed. Checksums (`checksums`) find damaged bytes: those of the
footers when a record is opened, those of the data when a file is first read.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from ssduck.errors import RecordError
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.episode import Episode
from ssduck.recording.stores.checksums import (
    footer_of,
    footer_problem,
    parquet_problem,
    read_json,
    read_parquet,
)
from ssduck.recording.stores.part_log import following_rows, is_log, read_log
from ssduck.recording.stores.tick_index import INDEX, indexed_ticks
from ssduck.schema import RECORDABLE

FORMAT = "ssduck record"
VERSION = 1
UNITS = {
    "position": "m",
    "angle": "rad",
    "time": "s",
    "mass": "kg",
    "force": "N",
    "frame": "world, z up as the scene has it",
    "quaternion": "w, x, y, z",
}
ABOUT = "ssduck.json"
# The contents of that file.
DESCRIPTION = {"format": FORMAT, "version": VERSION, "units": UNITS}
LOG = "log"
_PART = re.compile(r"part-(\d{6,})\.parquet")
_EPISODE = re.compile(r"(.+)-(\d+)\.json")
MISSING = "is missing: the record was damaged, or only copied in part"
RESCUE = (
    "`ssduck check --repair` drops what is damaged, and ssduck.open(…, partial=True) leaves it out"
)


@dataclass(frozen=True)
class FolderRun:
    """A run of a world that is recorded in a folder.

    Attributes:
        path: the folder.
        world: the name of the world.
        number: of the episode, from 0.
        left_out: the numbers of parts that are taken for removed.
        log_end: the number of files of the log that are read; None for all.
    """

    path: Path
    world: str
    number: int
    left_out: frozenset[int] = frozenset()
    log_end: int | None = None

    @property
    def about_file(self) -> Path:
        """The file that describes the episode."""
        return self.path / "episodes" / f"{self.world}-{self.number}.json"

    def place(self, table: str) -> Path:
        """Returns the folder of the parts of a table, or of a model such as `models/entities`."""
        return self.path / table / f"world={self.world}" / f"episode={self.number}"

    @cached_property
    def _about(self) -> dict[str, Any]:
        about = read_json(self.about_file)
        episode = about.get("world"), about.get("episode")
        if episode not in ((self.world, self.number), (None, None)):
            raise RecordError(
                f"{self.about_file} describes episode {episode[1]} of {episode[0]!r}: it was "
                "renamed or copied; give it its name again"
            )
        tables, recording = about.get("tables"), about.get("recording")
        is_valid = isinstance(about.get("started"), str) and isinstance(recording, dict)
        if not (is_valid and isinstance(tables, list) and "entities" in tables):
            raise RecordError(f"{self.about_file} is damaged: it lacks what is recorded")
        return about

    @property
    def tables(self) -> tuple[str, ...]:
        """The tables that have parts, `ticks` among them.

        Raises:
            RecordError: the file that describes the episode is damaged.
        """
        return tuple(self._about["tables"])

    @property
    def recording(self) -> dict[str, Any]:
        """What was recorded: n of `every` n-th tick, and the names of the `entities`."""
        recording: dict[str, Any] = self._about["recording"]
        return recording

    @property
    def has_checksums(self) -> bool:
        """Whether the files have checksums, which those of older records lack."""
        return "checksums" in self._about

    @property
    def is_complete(self) -> bool | None:
        """Whether the recording was closed; None for an older record, which does not say so."""
        return None if self.key is None else "parts" in self._about

    @property
    def removed_parts(self) -> frozenset[int]:
        """The numbers of parts that were removed as they were damaged, or are left out."""
        return self.left_out | set(self._about.get("removed", ()))

    @property
    def parts(self) -> list[int]:
        """The numbers of the complete parts."""
        return self._parts_and_log[0]

    @property
    def log(self) -> dict[str, pa.Table]:
        """The rows of the part that is not complete, by table; nothing if there are none.

        They have the columns that differ from tick to tick.

        Raises:
            RecordError: a file of the log is missing or damaged.
        """
        return self._parts_and_log[1]

    @cached_property
    def _parts_and_log(self) -> tuple[list[int], dict[str, pa.Table]]:
        files = read_log(
            self.place(LOG), self.key or "", has_checksums=self.has_checksums, end=self.log_end
        )
        # In this order: the files of a log are removed when their part is complete.
        parts = part_numbers(self.place("ticks"))
        log = following_rows(files, max({*parts, *self.removed_parts}, default=-1) + 1)
        if log and set(log) != set(self.tables):
            raise RecordError(f"{self.place(LOG)} is damaged: it lacks tables")
        return [part for part in parts if part not in self.removed_parts], log

    @property
    def key(self) -> str | None:
        """The random text that identifies the episode in its files; None for an older record."""
        key: str | None = self._about.get("key")
        return key

    def _parts_of(self, table: str) -> list[int]:
        """Returns the numbers of the parts of a table, ascending.

        Raises:
            RecordError: a part is missing.
        """
        is_model = table.startswith("models/")
        place = self.place("models/entities" if is_model else "ticks")
        numbers = part_numbers(place) if is_model else self.parts
        missing = self._missing(numbers, is_model=is_model)
        if missing:
            file, hint = place / part_name(missing[0]), "" if is_model else f"; {RESCUE}"
            if missing[0] < max(numbers, default=-1):
                raise RecordError(
                    f"{file} is missing, and parts after it are there: put it back{hint}"
                )
            raise RecordError(
                f"{file} is missing: the record of {self.world!r} was closed with "
                f"{self._expected(is_model=is_model)} parts: put it back{hint}"
            )
        return numbers

    def _missing(self, numbers: Iterable[int], *, is_model: bool) -> list[int]:
        """Returns the numbers of missing parts, ascending, from those of the present ones."""
        count = max(max(numbers, default=-1) + 1, self._expected(is_model=is_model))
        removed = frozenset[int]() if is_model else self.removed_parts
        return sorted(set(range(count)) - set(numbers) - removed)

    def _expected(self, *, is_model: bool) -> int:
        """Returns the number of parts that there were when the recording was closed, or 0."""
        expected: int = self._about.get("parts", {}).get("models" if is_model else "ticks", 0)
        return expected

    @property
    def part_count(self) -> int:
        """The number of parts that there must be: complete, missing and removed ones."""
        present = part_numbers(self.place("ticks"))
        return max(max(present, default=-1) + 1, self._expected(is_model=False))

    @property
    def model_part_count(self) -> int:
        """The number of parts that the models must have."""
        present = part_numbers(self.place("models/entities"))
        return max(max(present, default=-1) + 1, self._expected(is_model=True))

    @property
    def has_begun(self) -> bool:
        """Whether there is an episode: its file may be empty at the very beginning."""
        if self.about_file.stat().st_size == 0 and not self._has_rows:
            return False
        return not self.is_unfinished_export

    @property
    def is_unfinished_export(self) -> bool:
        """Whether an export wrote it that did not end."""
        return "exporting" in self._about

    @property
    def has_ticks(self) -> bool:
        """Whether anything was stored, and all of it if an export wrote it.

        Raises:
            RecordError: the file that describes the episode is damaged.
        """
        return self._has_rows and not self.is_unfinished_export

    @property
    def _has_rows(self) -> bool:
        return bool(part_numbers(self.place("ticks"))) or is_log(self.place(LOG))

    def files(self, table: str) -> list[Path]:
        """Returns the files of a table, of complete parts only.

        Raises:
            RecordError: a file is missing or damaged.
        """
        files = self.listed_files(table)
        self.check(table, map(part_number, files))
        return files

    def listed_files(self, table: str) -> list[Path]:
        """Returns the files of a table, of complete parts only; looks into none of them.

        Raises:
            RecordError: a file is missing.
        """
        place, numbers = self.place(table), self._parts_of(table)
        has_files = bool(numbers) and place.is_dir()
        present = {entry.name for entry in os.scandir(place)} if has_files else set()
        for number in numbers:
            if part_name(number) not in present:
                raise self._error_of(table, number, MISSING)
        return [place / part_name(number) for number in numbers]

    def label(self, table: str, number: int) -> bytes | None:
        """Returns the label in the footer of a part's file; None for an older record."""
        key = self._about.get("key")
        return None if key is None else label_of(key, table, number)

    def check(self, table: str, numbers: Iterable[int]) -> None:
        """Checks that the files of parts exist, are complete, and have the right footers.

        Raises:
            RecordError: a file is missing or damaged.
        """
        for number in numbers:
            problem = self.problem(table, number, with_data=False)
            if problem is not None:
                raise self._error_of(table, number, problem)

    def check_data(self, table: str, numbers: Iterable[int]) -> None:
        """Checks all bytes of the files of parts.

        Raises:
            RecordError: a file is missing or damaged.
        """
        for number in numbers:
            problem = self.problem(table, number, with_data=True)
            if problem is not None:
                raise self._error_of(table, number, problem)

    def problem(self, table: str, number: int, *, with_data: bool) -> str | None:
        """Returns what is wrong with the file of a part; None for nothing.

        Args:
            table: the table, or the model such as `models/entities`.
            number: the number of the part.
            with_data: whether all bytes are read, and not only the footer.
        """
        file, label = self.place(table) / part_name(number), self.label(table, number)
        try:
            footer = footer_of(file)
            problem = footer_problem(footer, has_checksums=self.has_checksums)
            if problem is None and label is not None and label not in (footer or b""):
                problem = "is another part, or of another record: it was renamed, or copied there"
            if problem is None and with_data:
                problem = parquet_problem(file, has_checksums=self.has_checksums)
        except FileNotFoundError:
            return MISSING
        except OSError as error:
            return f"cannot be read: {error.strerror}"
        return problem

    def _error_of(self, table: str, number: int, problem: str) -> RecordError:
        """Returns the error that there is a problem with a part."""
        hint = "" if table.startswith("models/") else f"; {RESCUE}"
        return RecordError(f"{self.place(table) / part_name(number)} {problem}{hint}")

    def read(self, table: str) -> pa.Table:
        """Returns all rows of a table.

        Raises:
            RecordError: a file is missing or damaged, or there is none.
        """
        files = self.files(table)
        if not files:
            raise RecordError(f"{self.place(table)} has no complete part: nothing was stored")
        return pa.concat_tables([self._read(file) for file in files])

    def _read(self, file: Path) -> pa.Table:
        """Returns the rows of a file of a part."""
        return read_parquet(file, has_checksums=self.has_checksums).replace_schema_metadata()

    def ticks(self) -> tuple[list[int], TickBuffer]:
        """Returns the first tick of each part, then of the log if it has rows, and all ticks.

        Raises:
            RecordError: a file is damaged, or nothing was stored.
        """
        files = self.listed_files("ticks")
        parts = []
        if not self.removed_parts:
            parts = indexed_ticks(
                self.place(INDEX), self.key or "", len(files), has_checksums=self.has_checksums
            )
        self.check("ticks", map(part_number, files[len(parts) :]))
        parts += [self._read(file).select(["tick", "time"]) for file in files[len(parts) :]]
        if self.log:
            parts.append(self.log["ticks"].select(["tick", "time"]))
        if not parts:
            raise RecordError(f"{self.place('ticks')} has no complete part: nothing was stored")
        rows = pa.concat_tables(parts)
        numbers = rows["tick"].to_numpy()
        if (np.diff(numbers) <= 0).any():
            raise RecordError(f"{self.place('ticks')} is damaged: its ticks do not ascend")
        ticks = TickBuffer.from_arrays(numbers, rows["time"].to_numpy())
        return [part["tick"][0].as_py() for part in parts], ticks

    @property
    def episode(self) -> Episode:
        """The description of the episode.

        Raises:
            RecordError: a file is damaged.
        """
        run = FolderRun(self.path, self.world, self.number)  # as it is now
        ticks = run.ticks()[1] if run.has_ticks else TickBuffer()
        entities = self.recording.get("entities")
        return Episode.of(
            self.path,
            self.world,
            self.number,
            started=self._about["started"],
            tables=[table for table in self.tables if table in RECORDABLE],
            every=self.recording.get("every", 1),
            entities=None if entities is None else tuple(entities),
            ticks=ticks,
            complete=self.is_complete,
        )


def part_numbers(place: Path) -> list[int]:
    """Returns the numbers of the files of parts in a folder, ascending."""
    if not place.is_dir():
        return []
    matches = [_PART.fullmatch(file.name) for file in place.iterdir()]
    return sorted(int(match.group(1)) for match in matches if match)


def part_name(number: int) -> str:
    """Returns the file name of a part."""
    return f"part-{number:06d}.parquet"


def part_number(file: Path) -> int:
    """Returns the number of a part from its file."""
    match = _PART.fullmatch(file.name)
    assert match is not None
    return int(match.group(1))


def label_of(key: str, table: str, number: int | str) -> bytes:
    """Returns the label of a part of a table, of the episode with a key."""
    return json.dumps({"episode": key, "table": table, "part": number}).encode()


def runs_in(path: Path) -> list[FolderRun]:
    """Returns the runs in a folder, sorted by world and number; looks at none of their files.

    Raises:
        RecordError: the folder is no record, a damaged one, or one of a newer version; or it has
            ticks of an episode, and not the file that describes it.
    """
    check_about(path)
    runs = runs_named(path)
    for lost in lost_runs(path, [(run.world, run.number) for run in runs]):
        raise RecordError(
            f"{lost.about_file} is missing, and ticks of its episode are there: put it back, or "
            f"move {lost.place('ticks')} elsewhere"
        )
    return runs


def runs_named(path: Path) -> list[FolderRun]:
    """Returns the episodes of a folder that have a file, sorted by world and number."""
    place = path / "episodes"
    names = [file.name for file in place.iterdir()] if place.is_dir() else []
    matches = map(_EPISODE.fullmatch, names)
    keys = sorted((match.group(1), int(match.group(2))) for match in matches if match)
    return [FolderRun(path, world, number) for world, number in keys]


def lost_runs(path: Path, keys: Iterable[tuple[str, int]]) -> Iterator[FolderRun]:
    """Yields episodes that have ticks, and no file that describes them.

    Args:
        path: the folder.
        keys: the worlds and numbers of the files that are there.
    """
    numbers: dict[str, set[int]] = {}
    for world, number in keys:
        numbers.setdefault(world, set()).add(number)
    places = [path / table for table in ("ticks", LOG)]
    folders = {folder.name for place in places if place.is_dir() for folder in place.iterdir()}
    for folder in sorted(folders):
        world = folder.removeprefix("world=")
        present = numbers.get(world, set())
        for number in sorted(set(range(max(present, default=-1) + 2)) - present):
            run = FolderRun(path, world, number)
            if run.place("ticks").is_dir() or run.place(LOG).is_dir():
                yield run


def check_about(folder: Path) -> None:
    """Checks that a folder is a record of a known version.

    Raises:
        RecordError: it is not.
    """
    about_file = folder / ABOUT
    if not about_file.is_file():
        raise RecordError(f"{folder} is no record of ssduck: it has no {ABOUT}")
    about = read_json(about_file)
    if about.get("format") != FORMAT:
        raise RecordError(f"{folder} is no record of ssduck: {about_file} is of another format")
    version = about.get("version")
    if type(version) is not int or version < 1:
        raise RecordError(f"{about_file} is damaged: it has no version")
    if version > VERSION:
        raise RecordError(
            f"{folder} is a record of version {version}; this ssduck reads those up to {VERSION}: "
            "install a newer one"
        )
