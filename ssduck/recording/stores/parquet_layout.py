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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from ssduck.errors import RecordError, warn
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.episode import Episode
from ssduck.recording.stores.descriptions import (
    EPISODE,
    PARTS,
    RECORDING,
    check_description,
    read_description,
)
from ssduck.recording.stores.part_log import following_rows, is_log, read_log
from ssduck.recording.stores.stored_columns import check_parquet, part_columns
from ssduck.recording.stores.tick_index import INDEX, checked_ticks, indexed_ticks
from ssduck.schema import RECORDABLE
from ssduck.world.live_tables import ARROW_TYPES

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
# The largest number of digits of a part and of an episode keeps them below 10**9.
_PART = re.compile(r"part-([0-9]{6}|[1-9][0-9]{6,8})\.parquet")
_EPISODE = re.compile(r"(.+)-(0|[1-9][0-9]{0,8})\.json")
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
        check_inside(self.path, self.about_file)
        about = read_description(self.about_file)
        source = str(self.about_file)
        episode = about.get("world"), about.get("episode")
        if episode not in ((self.world, self.number), (None, None)):
            raise RecordError(
                f"{self.about_file} describes episode {episode[1]} of {episode[0]!r}: it was "
                "renamed or copied; give it its name again"
            )
        lack = "what is recorded"
        check_description(about, EPISODE, source, lack)
        check_description(about["recording"], RECORDING, f"{source}: 'recording'", lack)
        check_description(about.get("parts", {}), PARTS, f"{source}: 'parts'", lack)
        if not self.world.isidentifier():
            raise RecordError(f"{source} is damaged: {self.world!r} is no name of a world")
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
        check_inside(self.path, self.place(LOG))
        files = read_log(self.place(LOG), self.key or "")
        # In this order: the files of a log are removed when their part is complete.
        parts = _part_numbers(self.place("ticks"))
        log = following_rows(files, max(parts, default=-1) + 1)
        if log and set(log) != set(self.tables):
            raise RecordError(f"{self.place(LOG)} is damaged: its tables are not those recorded")
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
        missing = next((n for n, number in enumerate(numbers) if n != number), None)
        if missing is not None:
            hint = "" if is_model else ", or remove those: the parts before it can be opened then"
            raise RecordError(
                f"{place / part_name(missing)} is missing, and parts after it are there: put it "
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
        check_inside(self.path, self.about_file)
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
        check_inside(self.path, place)
        entries = list(os.scandir(place)) if has_files else []
        for entry in entries:
            if entry.is_symlink():
                check_inside(self.path, place / entry.name)
        present = {entry.name for entry in entries if entry.is_file()}
        for number in numbers:
            if part_name(number) not in present:
                raise self._error_of(table, number, _MISSING)
        return [place / part_name(number) for number in numbers]

    def label(self, table: str, number: int) -> bytes | None:
        """Returns the label in the footer of a part's file; None for an older record."""
        key = self._about.get("key")
        return None if key is None else label_of(key, table, number)

    def check(self, table: str, numbers: Iterable[int]) -> list[pq.FileMetaData]:
        """Checks that the files of parts are there and complete, with their labels and columns.

        Returns:
            The footers.

        Raises:
            RecordError: a file is missing or damaged.
        """
        checked = []
        for number in numbers:
            label = self.label(table, number)
            file = self.place(table) / part_name(number)
            try:
                footer = _footer(file)
            except FileNotFoundError:
                problem = _MISSING
            except OSError as error:
                problem = f"cannot be read: {error.strerror}"
            else:
                if footer is not None and (label is None or label in footer):
                    checked.append(check_parquet(str(file), footer, table))
                    continue
                problem = "is damaged: it is no complete Parquet file"
                if footer is not None:
                    problem = (
                        "is another part, or of another record: it was renamed, or copied there"
                    )
            raise self._error_of(table, number, problem)
        return checked

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
        files = self.listed_files(table)
        if not files:
            raise RecordError(f"{self.place(table)} has no complete part: nothing was stored")
        rows = self._rows(table, files, range(len(files)))
        return pa.concat_tables(rows, promote_options="default")  # older parts may lack columns

    def _rows(self, table: str, files: Sequence[Path], parts: Sequence[int]) -> list[pa.Table]:
        """Returns the rows of parts of a table, with the columns that it is to have."""
        footers = self.check(table, parts)
        return [
            _read(files[part], table, footer) for part, footer in zip(parts, footers, strict=True)
        ]

    def ticks(self) -> tuple[list[int], TickBuffer]:
        """Returns the first tick of each part, then of the log if it has rows, and all ticks.

        Raises:
            RecordError: a file is damaged, or nothing was stored.
        """
        files = self.listed_files("ticks")
        check_inside(self.path, self.place(INDEX))
        parts = indexed_ticks(self.place(INDEX), self.key or "", len(files))
        rest = self._rows("ticks", files, range(len(parts), len(files)))
        parts += [rows.select(["tick", "time"]) for rows in rest]
        if self.log:
            parts.append(self.log["ticks"].select(["tick", "time"]))
        if not parts:
            raise RecordError(f"{self.place('ticks')} has no complete part: nothing was stored")
        if not all(part.num_rows for part in parts):
            raise RecordError(f"{self.place('ticks')} is damaged: a part has no ticks")
        ticks = checked_ticks(pa.concat_tables(parts), str(self.place("ticks")))
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


def _read(file: Path, table: str, footer: pq.FileMetaData) -> pa.Table:
    """Returns the rows of a part, with the columns that it is to have."""
    types = {name: ARROW_TYPES[type] for name, type in part_columns(table).items()}
    try:
        # The threads of the library take longer to wake up than most of these files to read.
        part = pq.ParquetFile(file.absolute(), metadata=footer)
        present = set(part.schema_arrow.names)
        names = [name for name in types if name in present]
        rows = part.read(columns=names, use_threads=False).replace_schema_metadata()
        rows = rows.cast(pa.schema([(name, types[name]) for name in rows.column_names]))
        rows.validate(full=True)
    except (pa.ArrowException, OSError) as error:
        raise RecordError(f"{file} cannot be read: it is damaged: {error}") from error
    return rows


def check_inside(folder: Path, place: Path) -> None:
    """Checks that no symbolic link leads out of a record's folder.

    Raises:
        RecordError: one does, or leads back to itself.
    """
    names = place.parts[len(folder.parts) :]
    below = accumulate(names, os.path.join, initial=str(folder))
    next(below)  # the folder itself may be reached by a link
    if not any(map(os.path.islink, below)):
        return
    try:
        if place.resolve().is_relative_to(folder.resolve()):
            return
    except (OSError, RuntimeError):  # a link to itself
        pass
    raise RecordError(f"{place} is a symbolic link that leaves {folder}: put a copy in its place")


def runs_in(path: Path) -> list[FolderRun]:
    """Returns the runs in a folder, sorted by world and number; looks at none of their files.

    Raises:
        RecordError: the folder is no record, a damaged one, or one of a newer version.
    """
    check_about(path)
    place = path / "episodes"
    check_inside(path, place)
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
    check_inside(folder, about_file)
    about = read_description(about_file)
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
