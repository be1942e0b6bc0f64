"""Records as folders of Parquet files: where what is, and reading it.

    run/
      ssduck.json                                             what this is, its version, the units
      episodes/kitchen-0.json                                 what is recorded of which world
      entities/world=kitchen/episode=0/part-000000.parquet    a table, in sealed parts
      links/… joints/… shapes/… contacts/… sensings/… ticks/…
      frames/…                                                where links are, without `links`
      models/entities/world=kitchen/episode=0/part-000000.parquet    what the entities are

A folder such as `run/entities` is read by DuckDB, polars and pandas as it is: its rows are those
of the table at each tick, and the world and the episode are columns by the folders' names.

A part is written under another name, which begins with a dot, and gets its own when it is
complete; its ticks come last, and of what entities are, the table of entities. So a part that
has these is whole, whatever happened, and one that has not is not counted.

Each file tells in its footer which part of which table of which episode it is, so that one that is
missing, swapped, or of another record is noticed.
"""

from __future__ import annotations

import json
import re
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
_PART = re.compile(r"part-(\d{6,})\.parquet")
_EPISODE = re.compile(r"(.+)-(\d+)\.json")
# What a Parquet file begins and ends with.
_MAGIC = b"PAR1"


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
    def about(self) -> Path:
        """The file that tells what is recorded."""
        return self.path / "episodes" / f"{self.world}-{self.number}.json"

    def place(self, table: str) -> Path:
        """Where the parts of a table are; `models/entities` and the like are tables, too."""
        return self.path / table / f"world={self.world}" / f"episode={self.number}"

    @cached_property
    def _told(self) -> dict[str, Any]:
        told = _json(self.about)
        if (told.get("world"), told.get("episode")) not in ((self.world, self.number), (None,) * 2):
            raise RecordError(
                f"{self.about} tells of episode {told.get('episode')} of {told.get('world')!r}: it "
                "was renamed, or copied; give it its name again"
            )
        tables, recording = told.get("tables"), told.get("recording")
        is_right = isinstance(told.get("started"), str) and isinstance(recording, dict)
        if not (is_right and isinstance(tables, list) and "entities" in tables):
            raise RecordError(f"{self.about} is damaged: it does not tell what is recorded")
        return told

    @property
    def tables(self) -> tuple[str, ...]:
        """The tables that have parts, `ticks` among them.

        Raises:
            RecordError: the file that tells of the episode is damaged.
        """
        return tuple(self._told["tables"])

    @property
    def recording(self) -> dict[str, Any]:
        """What was kept of the ticks: `every` which one, and of which `entities`."""
        told: dict[str, Any] = self._told["recording"]
        return told

    @cached_property
    def parts(self) -> list[int]:
        """The numbers of the parts that are whole."""
        return _numbers(self.place("ticks"))

    def _parts_of(self, table: str) -> list[int]:
        """The numbers of the parts of a table, 0 and all up to the last one.

        Raises:
            RecordError: one is missing before the last one.
        """
        is_model = table.startswith("models/")
        place = self.place("models/entities" if is_model else "ticks")
        found = _numbers(place) if is_model else self.parts
        missing = sorted(set(range(max(found, default=-1))) - set(found))
        if missing:
            rest = "" if is_model else ", or take those away: what is before can be opened then"
            raise RecordError(
                f"{place / part_name(missing[0])} is missing, and parts after it are there: what "
                f"was between is not known; put it back{rest}"
            )
        wanted = self._told.get("parts", {}).get("models" if is_model else "ticks", 0)
        if len(found) < wanted:
            if is_model:
                raise RecordError(f"{place / part_name(len(found))} is missing")
            if table == "ticks":
                warn(
                    f"{place / part_name(len(found))} is missing: the record of {self.world!r} was "
                    f"closed with {wanted} parts, and ends after {len(found)} of them",
                )
        return found

    @property
    def has_ticks(self) -> bool:
        """Whether anything was stored."""
        return bool(self.parts)

    def files(self, table: str) -> list[Path]:
        """The files of a table, of whole parts only.

        Raises:
            RecordError: one is missing, or was cut off.
        """
        is_model = table.startswith("models/")
        files = []
        for number in self._parts_of(table):
            file = self.place(table) / part_name(number)
            self._check(file, self.label(table, number), is_model=is_model)
            files.append(file)
        return files

    def label(self, table: str, number: int) -> bytes | None:
        """What the footer of a part's file has; None in records that are older than that."""
        key = self._told.get("key")
        return None if key is None else label_of(key, table, number)

    def _check(self, file: Path, label: bytes | None, *, is_model: bool) -> None:
        """Complain of a part that is not there, not whole, or another one."""
        if not file.is_file():
            wrong = "is missing: the record was damaged, or only copied in part"
        elif (footer := _footer(file)) is None:
            wrong = "is damaged: it is no whole Parquet file"
        elif label is not None and label not in footer:
            wrong = "is another part, or of another record: it was renamed, or copied there"
        else:
            return
        ticks = self.place("ticks") / file.name
        rest = "" if is_model else f"; without {ticks} as well, what is before can be opened"
        raise RecordError(f"{file} {wrong}{rest}")

    def read(self, table: str) -> pa.Table:
        """All rows of a table.

        Raises:
            RecordError: a file is missing or damaged, or there is none.
        """
        files = self.files(table)
        if not files:
            raise RecordError(f"{self.place(table)} holds no whole part: nothing was stored")
        return pa.concat_tables([_read(file) for file in files])

    def ticks(self) -> tuple[list[int], TickBuffer]:
        """The first tick of each part, and all of them.

        Raises:
            RecordError: a file is damaged, or nothing was stored.
        """
        parts = [_read(file) for file in self.files("ticks")]
        if not parts:
            raise RecordError(f"{self.place('ticks')} holds no whole part: nothing was stored")
        rows = pa.concat_tables(parts)
        numbers = rows["tick"].to_numpy()
        if (np.diff(numbers) <= 0).any():
            raise RecordError(f"{self.place('ticks')} is damaged: its ticks do not ascend")
        ticks = TickBuffer.of(numbers, rows["time"].to_numpy())
        return [part["tick"][0].as_py() for part in parts], ticks

    @property
    def episode(self) -> Episode:
        """What it holds.

        Raises:
            RecordError: a file is damaged.
        """
        ticks = (
            self.ticks()[1] if FolderRun(self.path, self.world, self.number).parts else TickBuffer()
        )
        entities = self.recording.get("entities")
        return Episode.of(
            self.path,
            self.world,
            self.number,
            started=self._told["started"],
            tables=[table for table in self.tables if table in RECORDABLE],
            every=self.recording.get("every", 1),
            entities=None if entities is None else tuple(entities),
            ticks=ticks,
        )


def _numbers(place: Path) -> list[int]:
    if not place.is_dir():
        return []
    found = [_PART.fullmatch(file.name) for file in place.iterdir()]
    return sorted(int(match.group(1)) for match in found if match)


def part_name(number: int) -> str:
    """What a part is called, from 0."""
    return f"part-{number:06d}.parquet"


def label_of(key: str, table: str, number: int) -> bytes:
    """What the footer of a file tells: which part of which table, of the episode of a key."""
    return json.dumps({"episode": key, "table": table, "part": number}).encode()


def _footer(file: Path) -> bytes | None:
    """What is at the end of a Parquet file; None of one that does not end as they do."""
    tail = 4 + len(_MAGIC)  # the length of the footer, and the magic
    with file.open("rb") as stream:
        size = stream.seek(0, 2)
        if size < tail + len(_MAGIC):
            return None
        stream.seek(-tail, 2)
        told = stream.read()
        length = int.from_bytes(told[:4], "little") + tail
        if told[4:] != _MAGIC or length > size:
            return None
        stream.seek(-length, 2)
        return stream.read()


def _read(file: Path) -> pa.Table:
    try:
        return pq.ParquetFile(file.absolute()).read().replace_schema_metadata()
    except (pa.ArrowException, OSError) as error:
        raise RecordError(f"{file} cannot be read: it is damaged: {error}") from error


def runs_in(path: Path) -> list[FolderRun]:
    """The runs that are recorded in a folder, by world and number.

    Raises:
        RecordError: it is no record, a damaged one, or one of a newer version.
    """
    check_about(path)
    found = []
    for file in (path / "episodes").glob("*.json"):
        match = _EPISODE.fullmatch(file.name)
        if match and file.stat().st_size:  # else it was about to begin
            found.append(FolderRun(path, match.group(1), int(match.group(2))))
    return sorted(found, key=lambda run: (run.world, run.number))


def check_about(folder: Path) -> None:
    """Complain of a folder that is no record, or of a newer version."""
    about = folder / ABOUT
    if not about.is_file():
        raise RecordError(f"{folder} is no record of ssduck: it has no {ABOUT}")
    told = _json(about)
    if told.get("format") != FORMAT:
        raise RecordError(f"{folder} is no record of ssduck: {about} is of another format")
    number = told.get("version")
    if type(number) is not int or number < 1:
        raise RecordError(f"{about} is damaged: it tells no version")
    if number > VERSION:
        raise RecordError(
            f"{folder} is a record of version {number}; this ssduck reads those up to {VERSION}: "
            "install a newer one"
        )


def _json(file: Path) -> dict[str, Any]:
    try:
        told = json.loads(file.read_text("utf-8"))
    except OSError as error:
        raise RecordError(f"{file} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise RecordError(f"{file} is damaged: {error}") from error
    if not isinstance(told, dict):
        raise RecordError(f"{file} is damaged: it holds no object")
    return told
