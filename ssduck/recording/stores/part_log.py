"""The log of a recorded folder: the rows that are not enough for a part yet.

    log/world=kitchen/episode=0/part-000003-0000.arrow    the first rows of part 3, of all tables

Each file has the rows of some ticks, in a stream of Arrow's format for each table. It is not
compressed: a busy world has a new file every half second, which is gone a second later. It is
written under a temporary name and renamed when it is on the disk. When the part is complete, the
files of its rows are removed. So files of a part that exists do not count.

A reader takes the rows into memory: the files may be gone at the next moment.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from ssduck.errors import RecordError
from ssduck.recording.stores.files import UNSEALED, log_problem, write_atomically, write_sealed
from ssduck.recording.stores.stored_columns import check_stream, with_nulls
from ssduck.schema import RECORDED

_FILE = re.compile(r"part-([0-9]{6,9})-([0-9]{4,9})\.arrow")
# The keys of metadata: the label of a file, and the name of a table.
_LABEL, _TABLE = b"ssduck log", b"table"
# A reader that finds a file gone looks again, so many times.
_ATTEMPTS = 100


class PartLog:
    """The log of an episode that is being recorded."""

    def __init__(self, place: Path, key: str) -> None:
        self.place = place
        self._key = key
        self._batches: list[Mapping[str, pa.Table]] = []
        self._counts: Counter[str] = Counter()
        self._files: list[Path] = []

    def __len__(self) -> int:
        return len(self._batches)

    def with_rows(self, rows: Mapping[str, pa.Table]) -> Mapping[str, pa.Table]:
        """Returns the rows of the log and further ones, by table."""
        if not self._batches:
            return rows
        batches = [*self._batches, rows] if rows else self._batches
        return {
            table: pa.concat_tables([batch[table] for batch in batches])
            for table in self._batches[0]
        }

    def count(self, table: str) -> int:
        """Returns the number of rows of a table."""
        return self._counts[table]

    def append(self, part: int, rows: Mapping[str, pa.Table]) -> None:
        """Stores rows of a part, all or nothing."""
        self.place.mkdir(parents=True, exist_ok=True)
        file = self.place / _file_name(part, len(self._batches))
        label = _label(self._key, file.name)
        write_atomically(file, lambda path: _write(path, rows, label))
        self._batches.append(rows)
        self._counts.update({table: added.num_rows for table, added in rows.items()})
        self._files.append(file)

    def clear(self) -> None:
        """Removes the rows, which a part has now."""
        self._batches = []
        self._counts.clear()
        while self._files:
            self._files[-1].unlink(missing_ok=True)
            self._files.pop()


@dataclass(frozen=True)
class LogFile:
    """A file of a log, which was read."""

    path: Path
    part: int
    rows: dict[str, pa.Table]


def read_log(
    place: Path, key: str, *, has_checksums: bool, end: int | None = None
) -> list[LogFile]:
    """Returns the files of a log, in order."""
    before: list[Path] = []
    for _ in range(_ATTEMPTS):
        listed = log_files(place)[:end]
        try:
            return [
                LogFile(file, _numbers(file)[0], _read(file, key, has_checksums=has_checksums))
                for file in listed
            ]
        except FileNotFoundError as error:  # its part was completed meanwhile
            if isinstance(error, RecordError) and listed == before:
                raise
            before = listed
    raise RecordError(f"{place} changes faster than it can be read")


def is_log(place: Path) -> bool:
    """Checks whether a folder has files of a log."""
    return bool(log_files(place))


def following_rows(files: Sequence[LogFile], part: int) -> dict[str, pa.Table]:
    """Returns the rows of a part that is incomplete, by table; nothing if there are none."""
    chosen = [file for file in files if file.part == part]
    for number, file in enumerate(chosen):
        if _numbers(file.path)[1] != number:
            missing = file.path.with_name(_file_name(part, number))
            raise RecordError(
                f"{missing} is missing, and files after it are there: put it back, or remove those"
            )
    tables = chosen[0].rows if chosen else {}
    return {table: pa.concat_tables([file.rows[table] for file in chosen]) for table in tables}


def _file_name(part: int, number: int) -> str:
    return f"part-{part:06d}-{number:04d}.arrow"


def _numbers(file: Path) -> tuple[int, int]:
    """Returns the number of the part of a file, and its own."""
    match = _FILE.fullmatch(file.name)
    assert match is not None
    return int(match.group(1)), int(match.group(2))


def log_files(place: Path) -> list[Path]:
    """Returns the files of a log, in order."""
    if not place.is_dir():
        return []
    return sorted((file for file in place.iterdir() if _FILE.fullmatch(file.name)), key=_numbers)


def _label(key: str, name: str) -> bytes:
    return json.dumps({"episode": key, "file": name}).encode()


def _write(path: Path, rows: Mapping[str, pa.Table], label: bytes) -> None:
    sink = pa.BufferOutputStream()
    for number, (table, added) in enumerate(rows.items()):
        metadata = {_LABEL: label, _TABLE: table} | ({} if number else UNSEALED)
        labelled = added.replace_schema_metadata(metadata)
        with pa.ipc.new_stream(sink, labelled.schema) as writer:
            writer.write_table(labelled)
    write_sealed(memoryview(sink.getvalue()), path)


def log_file_problem(file: Path, key: str, *, has_checksums: bool) -> str | None:
    """Returns what is wrong with a file of a log; None for nothing."""
    try:
        _read(file, key, has_checksums=has_checksums)
    except RecordError as error:
        return error.message.removeprefix(f"{file} ").partition(";")[0]
    return None


def _read(file: Path, key: str, *, has_checksums: bool) -> dict[str, pa.Table]:
    stored = file.read_bytes()
    content = pa.BufferReader(stored)
    tables: dict[str, pa.Table] = {}
    try:
        if log_problem(stored, has_checksums=has_checksums) is not None:
            raise pa.ArrowInvalid("its checksum is wrong")
        while content.tell() < content.size():
            stream = pa.ipc.open_stream(content)
            metadata = stream.schema.metadata or {}
            if metadata[_LABEL] != _label(key, file.name):
                raise RecordError(
                    f"{file} is another file of a log, or of another record: it was renamed, or "
                    "copied there; remove it"
                )
            table = metadata[_TABLE].decode()
            if table in tables or table not in RECORDED:
                raise RecordError(f"{file} is damaged: {table!r} is no table, or there twice")
            check_stream(f"{file}, {table}", stream.schema, table)
            tables[table] = with_nulls(stream.read_all().replace_schema_metadata())
    except (pa.ArrowException, OSError, KeyError, UnicodeDecodeError) as error:
        if isinstance(error, RecordError):
            raise
        raise RecordError(
            f"{file} cannot be read: it is damaged: {error}; `ssduck check --repair` drops it and "
            "those after it, and ssduck.open(…, partial=True) leaves them out"
        ) from error
    return tables
