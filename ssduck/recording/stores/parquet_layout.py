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
one, or one of another record is noticed.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ssduck.errors import RecordError, warn
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.episode import Episode
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
LOG = "log"
_PART = re.compile(r"part-(\d{6,})\.parquet")
_EPISODE = re.compile(r"(.+)-(\d+)\.json")
# The bytes that begin and end a Parquet file.
_MAGIC = b"PAR1"
_MISSING = "is missing: the record was damaged, or only copied in part"
# The size that most footers do not exceed, bytes.
_MOST_FOOTERS = 1 << 15


@dataclass(frozen=True)
class FolderRun:
    """A run of a world that is recorded in a folder.

    Attributes:
        path: the folder.
        world: the name of the world.
        number: of the episode, from 0.
    """

    path: Path
    world: str
    number: int

    @property
    def about_file(self) -> Path:
        """The file that describes the episode."""
        return self.path / "episodes" / f"{self.world}-{self.number}.json"

    def place(self, table: str) -> Path:
        """Returns the folder of the parts of a table, or of a model such as `models/entities`."""
        return self.path / table / f"world={self.world}" / f"episode={self.number}"

    @cached_property
    def _about(self) -> dict[str, Any]:
        about = _json(self.about_file)
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
        files = read_log(self.place(LOG), self.key or "")
        # In this order: the files of a log are removed when their part is complete.
        parts = _part_numbers(self.place("ticks"))
        log = following_rows(files, max(parts, default=-1) + 1)
        if log and set(log) != set(self.tables):
            raise RecordError(f"{self.place(LOG)} is damaged: it lacks tables")
        return parts, log

    @property
    def key(self) -> str | None:
        """The random text that identifies the episode in its files; None for an older record."""
        key: str | None = self._about.get("key")
        return key

    def _parts_of(self, table: str) -> list[int]:
        """Returns the numbers of the parts of a table, without gaps from 0 on.

        Raises:
            RecordError: a part before the last one is missing.
        """
        is_model = table.startswith("models/")
        place = self.place("models/entities" if is_model else "ticks")
        numbers = _part_numbers(place) if is_model else self.parts
        missing = sorted(set(range(max(numbers, default=-1))) - set(numbers))
        if missing:
            hint = "" if is_model else ", or remove those: the parts before it can be opened then"
            raise RecordError(
                f"{place / part_name(missing[0])} is missing, and parts after it are there: put it "
                f"back{hint}"
            )
        expected = self._about.get("parts", {}).get("models" if is_model else "ticks", 0)
        if len(numbers) < expected:
            if is_model:
                raise RecordError(f"{place / part_name(len(numbers))} is missing")
            if table == "ticks":
                warn(
                    f"{place / part_name(len(numbers))} is missing: the record of {self.world!r} "
                    f"was closed with {expected} parts, and ends after {len(numbers)} of them",
                )
        return numbers

    @property
    def has_begun(self) -> bool:
        """Whether it is said what is recorded: the file is empty at the very beginning."""
        return self.about_file.stat().st_size > 0

    @property
    def has_ticks(self) -> bool:
        """Whether anything was stored."""
        return bool(_part_numbers(self.place("ticks"))) or is_log(self.place(LOG))

    def files(self, table: str) -> list[Path]:
        """Returns the files of a table, of complete parts only.

        Raises:
            RecordError: a file is missing or damaged.
        """
        files = self.listed_files(table)
        self.check(table, range(len(files)))
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
                raise self._error_of(table, number, _MISSING)
        return [place / part_name(number) for number in numbers]

    def label(self, table: str, number: int) -> bytes | None:
        """Returns the label in the footer of a part's file; None for an older record."""
        key = self._about.get("key")
        return None if key is None else label_of(key, table, number)

    def check(self, table: str, numbers: Iterable[int]) -> None:
        """Checks that the files of parts exist, are complete, and have the right labels.

        Raises:
            RecordError: a file is missing or damaged.
        """
        for number in numbers:
            label = self.label(table, number)
            try:
                footer = _footer(self.place(table) / part_name(number))
            except FileNotFoundError:
                problem = _MISSING
            else:
                if footer is not None and (label is None or label in footer):
                    continue
                problem = "is damaged: it is no complete Parquet file"
                if footer is not None:
                    problem = (
                        "is another part, or of another record: it was renamed, or copied there"
                    )
            raise self._error_of(table, number, problem)

    def _error_of(self, table: str, number: int, problem: str) -> RecordError:
        """Returns the error that there is a problem with a part."""
        name = part_name(number)
        ticks = self.place("ticks") / name
        hint = (
            "" if table.startswith("models/") else f"; remove {ticks} to open the parts before it"
        )
        return RecordError(f"{self.place(table) / name} {problem}{hint}")

    def read(self, table: str) -> pa.Table:
        """Returns all rows of a table.

        Raises:
            RecordError: a file is missing or damaged, or there is none.
        """
        files = self.files(table)
        if not files:
            raise RecordError(f"{self.place(table)} has no complete part: nothing was stored")
        return pa.concat_tables([_read(file) for file in files])

    def ticks(self) -> tuple[list[int], TickBuffer]:
        """Returns the first tick of each part, then of the log if it has rows, and all ticks.

        Raises:
            RecordError: a file is damaged, or nothing was stored.
        """
        files = self.listed_files("ticks")
        parts = indexed_ticks(self.place(INDEX), self.key or "", len(files))
        self.check("ticks", range(len(parts), len(files)))
        parts += [_read(file).select(["tick", "time"]) for file in files[len(parts) :]]
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
        )


def _part_numbers(place: Path) -> list[int]:
    if not place.is_dir():
        return []
    matches = [_PART.fullmatch(file.name) for file in place.iterdir()]
    return sorted(int(match.group(1)) for match in matches if match)


def part_name(number: int) -> str:
    """Returns the file name of a part."""
    return f"part-{number:06d}.parquet"


def label_of(key: str, table: str, number: int | str) -> bytes:
    """Returns the label of a part of a table, of the episode with a key."""
    return json.dumps({"episode": key, "table": table, "part": number}).encode()


def _footer(file: Path) -> bytes | None:
    """Returns the footer of a Parquet file; None if the file does not end in one."""
    tail = 4 + len(_MAGIC)  # the length of the footer, and the magic
    with file.open("rb", buffering=0) as stream:
        size = stream.seek(0, 2)
        if size < tail + len(_MAGIC):
            return None
        stream.seek(-min(size, _MOST_FOOTERS), 2)
        end = stream.read()
        length = int.from_bytes(end[-tail:-4], "little") + tail
        if end[-4:] != _MAGIC or length > size:
            return None
        if length <= len(end):
            return end[-length:]
        stream.seek(-length, 2)
        return stream.read()


def _read(file: Path) -> pa.Table:
    try:
        # The threads of the library take longer to wake up than most of these files to read.
        rows = pq.ParquetFile(file.absolute()).read(use_threads=False)
        return rows.replace_schema_metadata()
    except (pa.ArrowException, OSError) as error:
        raise RecordError(f"{file} cannot be read: it is damaged: {error}") from error


def runs_in(path: Path) -> list[FolderRun]:
    """Returns the runs in a folder, sorted by world and number; looks at none of their files.

    Raises:
        RecordError: the folder is no record, a damaged one, or one of a newer version.
    """
    check_about(path)
    place = path / "episodes"
    names = [file.name for file in place.iterdir()] if place.is_dir() else []
    matches = map(_EPISODE.fullmatch, names)
    keys = sorted((match.group(1), int(match.group(2))) for match in matches if match)
    return [FolderRun(path, world, number) for world, number in keys]


def check_about(folder: Path) -> None:
    """Checks that a folder is a record of a known version.

    Raises:
        RecordError: it is not.
    """
    about_file = folder / ABOUT
    if not about_file.is_file():
        raise RecordError(f"{folder} is no record of ssduck: it has no {ABOUT}")
    about = _json(about_file)
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


def _json(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(file.read_text("utf-8"))
    except OSError as error:
        raise RecordError(f"{file} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise RecordError(f"{file} is damaged: {error}") from error
    if not isinstance(content, dict):
        raise RecordError(f"{file} is damaged: it has no JSON object")
    return content
