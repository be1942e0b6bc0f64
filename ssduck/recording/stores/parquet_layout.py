"""Defines the layout of records in folders of Parquet files, and reads them.

    run/
      ssduck.json                                             the format, its version, the units
      episodes/kitchen-0.json                                 what is recorded of which world
      entities/world=kitchen/episode=0/part-000000.parquet    a table, in complete parts
      links/… joints/… shapes/… contacts/… sensings/… ticks/…
      frames/…                                                the poses of links, without `links`
      models/entities/world=kitchen/episode=0/part-000000.parquet    the models of the entities
      index/world=kitchen/episode=0/summary.json    for lakes, of a closed episode (`summaries`)
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

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count, islice
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from ssduck.errors import RecordError, record_errors
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.episode import Episode, Tags, extent_of
from ssduck.recording.opened_record import FileStatus, file_status
from ssduck.recording.paths import (
    label_of,
    names_in,
    part_name,
    part_number,
    part_numbers,
)
from ssduck.recording.stores.descriptions import (
    EPISODE,
    PARTS,
    RECORDING,
    check_description,
    read_description,
)
from ssduck.recording.stores.files import (
    footer_in,
    footer_of,
    footer_problem,
    parquet_problem,
)
from ssduck.recording.stores.object_store import ObjectPath
from ssduck.recording.stores.part_log import following_rows, is_log, read_log
from ssduck.recording.stores.stored_columns import (
    MISSING,
    checked_parquet,
    rows_of_part,
    unreadable_because,
    with_nulls,
)
from ssduck.schema import RECORDABLE

LOG = "log"
# The folder of what is known of an episode for lakes.
INDEX = "index"
# The table of near pairs, which only other tools read.
PAIRS = "pairs"
# The largest number of missing parts that a check lists.
_MOST_MISSING = 1000
OTHER_PART = "is another part, or of another record: it was renamed, or copied there"
RESCUE = (
    "`ssduck check --repair` drops what is damaged, and ssduck.open(…, partial=True) leaves it out"
)


@dataclass(frozen=True)
class FolderRun:
    """A run of a world that is recorded in a folder.

    Whatever reads a file that is missing or damaged raises a RecordError.
    """

    path: Path  # the folder
    world: str  # the name of the world
    number: int  # of the episode, from 0
    left_out: frozenset[int] = frozenset()  # the numbers of parts that are taken for removed
    log_end: int | None = None  # the number of files of the log that are read; None for all
    # whether it had no folder of ticks or of a log when the record was listed
    is_empty: bool = field(default=False, compare=False)

    @property
    def about_file(self) -> Path:
        """The file that describes the episode."""
        return self.path / "episodes" / f"{self.world}-{self.number}.json"

    def folder(self, table: str) -> str:
        """Returns the name of the folder of the parts of a table in the record, with slashes."""
        return f"{table}/world={self.world}/episode={self.number}"

    def place(self, table: str) -> Path:
        """Returns the folder of the parts of a table, or of a model such as `models/entities`."""
        return self.path / self.folder(table)

    @cached_property
    def about_status(self) -> FileStatus:
        """The status of the file that describes the episode, from before it was read."""
        return None if isinstance(self.path, ObjectPath) else file_status(self.about_file)

    @cached_property
    def description(self) -> dict[str, Any]:
        """The description of the episode, which was checked."""
        _ = self.about_status  # first: what is written meanwhile is another status
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
        """The tables that have parts, `ticks` among them."""
        return tuple(self.description["tables"])

    @property
    def recording(self) -> dict[str, Any]:
        """What was recorded: n of `every` n-th tick, and the names of the `entities`."""
        recording: dict[str, Any] = self.description["recording"]
        return recording

    @property
    def has_checksums(self) -> bool:
        """Whether the files have checksums."""
        return "checksums" in self.description

    @property
    def is_complete(self) -> bool:
        """Whether the recording was closed."""
        return "parts" in self.description

    @property
    def removed_parts(self) -> frozenset[int]:
        """The numbers of parts that were removed as they were damaged, or are left out."""
        return self.left_out | set(self.description.get("removed", ()))

    @property
    def parts(self) -> list[int]:
        """The numbers of the complete parts."""
        return self._parts_and_log[0]

    @property
    def log(self) -> dict[str, pa.Table]:
        """The rows of the part that is not complete, by table; nothing if there are none.

        They have the columns that differ from tick to tick.
        """
        return self._parts_and_log[1]

    @cached_property
    def _parts_and_log(self) -> tuple[list[int], dict[str, pa.Table]]:
        files = read_log(
            self.place(LOG), self.key, has_checksums=self.has_checksums, end=self.log_end
        )
        # In this order: the files of a log are removed when their part is complete.
        parts = part_numbers(self.place("ticks"))
        log = following_rows(files, max({*parts, *self.removed_parts}, default=-1) + 1)
        if log and set(log) != set(self.tables):
            raise RecordError(f"{self.place(LOG)} is damaged: its tables are not those recorded")
        return [part for part in parts if part not in self.removed_parts], log

    @property
    def id(self) -> str:
        """The UUID of the run."""
        id: str = self.description["id"]
        return id

    @property
    def tags(self) -> Tags:
        """What the user says of the run, by name."""
        tags: Tags = self.description.get("tags", {})
        return tags

    @property
    def key(self) -> str:
        """The random text that identifies the episode in its files."""
        key: str = self.description["key"]
        return key

    @cached_property
    def _model_parts(self) -> list[int]:
        """The numbers of the complete parts of each model; one that records now may add others."""
        return part_numbers(self.place("models/entities"))

    def _parts_of(self, table: str) -> list[int]:
        """Returns the numbers of the parts of a table, ascending."""
        is_model = table.startswith("models/")
        place = self.place("models/entities" if is_model else "ticks")
        numbers = self._model_parts if is_model else self.parts
        missing = self._missing(numbers, is_model=is_model)
        if missing is not None:
            file, hint = place / part_name(missing), "" if is_model else f"; {RESCUE}"
            if missing < max(numbers, default=-1):
                raise RecordError(
                    f"{file} is missing, and parts after it are there: put it back{hint}"
                )
            raise RecordError(
                f"{file} is missing: the record of {self.world!r} was closed with "
                f"{self._expected(is_model=is_model)} parts: put it back{hint}"
            )
        return numbers

    def _missing(self, numbers: Iterable[int], *, is_model: bool) -> int | None:
        """Returns the number of the first missing part; None if all are present or removed."""
        present = {*numbers} if is_model else {*numbers, *self.removed_parts}
        first = next(number for number in count() if number not in present)
        last = max(max(present, default=-1), self._expected(is_model=is_model) - 1)
        return first if first <= last else None

    def _expected(self, *, is_model: bool) -> int:
        """Returns the number of parts that there were when the recording was closed, or 0."""
        expected: int = self.description.get("parts", {}).get("models" if is_model else "ticks", 0)
        return expected

    def numbers_to_check(self, *, is_model: bool) -> list[int]:
        """Returns the numbers of parts that are there or missing; of missing ones, the first."""
        present = set(part_numbers(self.place("models/entities" if is_model else "ticks")))
        end = max(max(present, default=-1) + 1, self._expected(is_model=is_model))
        missing = (number for number in range(end) if number not in present)
        return sorted({*present, *islice(missing, _MOST_MISSING)})

    @property
    def has_begun(self) -> bool:
        """Whether there is an episode: its file may be empty at the very beginning."""
        if self.about_file.stat().st_size == 0 and not self._has_rows:
            return False
        return not self.is_unfinished_export

    @property
    def is_unfinished_export(self) -> bool:
        """Whether an export wrote it that did not end."""
        return "exporting" in self.description

    @property
    def has_ticks(self) -> bool:
        """Whether anything was stored, and all of it if an export wrote it."""
        return not self.is_empty and self._has_rows and not self.is_unfinished_export

    @property
    def _has_rows(self) -> bool:
        return bool(part_numbers(self.place("ticks"))) or is_log(self.place(LOG))

    @record_errors()
    def listed_files(self, table: str) -> list[Path]:
        """Returns the files of a table, of complete parts only; looks into none of them."""
        place, numbers = self.place(table), self._parts_of(table)
        present = set(names_in(place))
        for number in numbers:
            if part_name(number) not in present:
                raise self._error_of(table, number, MISSING)
        return [place / part_name(number) for number in numbers]

    def label(self, table: str, number: int) -> bytes:
        """Returns the label in the footer of a part's file."""
        return label_of(self.key, table, number)

    def check_footers(self, table: str, numbers: Iterable[int]) -> None:
        """Checks that the files of parts are there and complete, with right footers."""
        for number in numbers:
            file = self.place(table) / part_name(number)
            try:
                footer = footer_of(file)
                problem = footer_problem(footer, has_checksums=self.has_checksums)
                problem = problem or self._problem_of_label(table, number, footer)
            except OSError as error:
                footer, problem = None, unreadable_because(file, error)
            if footer is None or problem is not None:
                raise self._error_of(table, number, problem or MISSING)
            checked_parquet(str(file), footer, table)

    def check_data(self, table: str, numbers: Iterable[int]) -> None:
        """Checks all bytes of the files of parts."""
        for number in numbers:
            self._part(table, number)

    def problem(self, table: str, number: int) -> str | None:
        """Returns what is wrong with the file of a part, all of which is read; None for nothing."""
        part = self._read(table, number)
        return part if isinstance(part, str) else None

    def _part(self, table: str, number: int) -> pq.ParquetFile:
        """Returns a part, all of which is checked."""
        part = self._read(table, number)
        if isinstance(part, str):
            raise self._error_of(table, number, part)
        return part

    def _read(self, table: str, number: int) -> pq.ParquetFile | str:
        """Returns a part, or what is wrong with its file."""
        file = self.place(table) / part_name(number)
        try:
            content = file.read_bytes()
            problem = parquet_problem(content, has_checksums=self.has_checksums)
            problem = problem or self._problem_of_label(table, number, footer_in(content))
            return problem or checked_parquet(str(file), content, table)
        except OSError as error:  # a RecordError is one
            return unreadable_because(file, error)

    def _problem_of_label(self, table: str, number: int, footer: bytes | None) -> str | None:
        """Returns that the footer of a part has the label of another; None if it has not."""
        return None if self.label(table, number) in (footer or b"") else OTHER_PART

    def _error_of(self, table: str, number: int, problem: str) -> RecordError:
        hint = "" if table.startswith("models/") else f"; {RESCUE}"
        return RecordError(f"{self.place(table) / part_name(number)} {problem}{hint}")

    def read(self, table: str) -> pa.Table:
        """Returns all rows of a table, with NULL for NaN."""
        parts = list(self.parts_of(table))
        if not parts:
            raise RecordError(f"{self.place(table)} has no complete part: nothing was stored")
        return with_nulls(pa.concat_tables(parts))

    def parts_of(self, table: str) -> Iterator[pa.Table]:
        """Yields the rows of each complete part of a table, checked."""
        for file in self.listed_files(table):
            yield rows_of_part(file, table, self._part(table, part_number(file)))

    def ticks(self) -> tuple[list[int], TickBuffer]:
        """Returns the first tick of each part, then of the log if it has rows, and all ticks."""
        parts = [rows.select(["tick", "time"]) for rows in self.parts_of("ticks")]
        if self.log:
            parts.append(self.log["ticks"].select(["tick", "time"]))
        if not parts:
            raise RecordError(f"{self.place('ticks')} has no complete part: nothing was stored")
        if not all(part.num_rows for part in parts):
            raise RecordError(f"{self.place('ticks')} is damaged: a part has no ticks")
        ticks = TickBuffer.checked(pa.concat_tables(parts), str(self.place("ticks")))
        return [part["tick"][0].as_py() for part in parts], ticks

    @property
    def episode(self) -> Episode:
        """The description of the episode."""
        run = FolderRun(self.path, self.world, self.number)  # as it is now
        ticks = run.ticks()[1] if run.has_ticks else TickBuffer()
        entities = self.recording.get("entities")
        return Episode(
            self.path,
            self.world,
            self.number,
            started=self.description["started"],
            tables=tuple(sorted(table for table in self.tables if table in RECORDABLE)),
            every=self.recording.get("every", 1),
            entities=None if entities is None else tuple(entities),
            complete=run.is_complete,
            id=run.id,
            tags=dict(run.tags),
            **extent_of(ticks),
        )
