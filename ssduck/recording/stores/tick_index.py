"""The index of ticks of a recorded folder: a copy of the numbers and times of all its ticks.

    index/world=kitchen/episode=0/ticks.parquet

The ticks of a part are in a file of their own, and opening thousands of files takes seconds. So the
recorder also writes the ticks of all parts so far to one file, now and then and at the end. A
record without it, or with more parts than it knows, is complete nevertheless.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from ssduck.errors import RecordError
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.stores.files import verified_parquet, write_parquet
from ssduck.recording.stores.stored_columns import arrow_columns, check_columns
from ssduck.schema import ColumnType

INDEX = "index"
# The index is written after so many parts, and at the end if there are as many as a quarter.
INDEXED_PARTS = 64
MIN_PARTS = INDEXED_PARTS // 4
_COLUMNS = ("tick", "time")
_TYPES: dict[str, ColumnType] = {"part": "integer", "tick": "integer", "time": "double"}
# Numbers of ticks are less, so that each of them is also a double.
_MAX_TICK = 1 << 53
_LABEL = b"ssduck index"


class TickIndex:
    """The index of an episode that is being recorded."""

    def __init__(self, place: Path, key: str) -> None:
        self._file = index_file(place)
        self._key = key
        self._parts: list[pa.Table] = []

    def add(self, ticks: pa.Table) -> None:
        """Adds the ticks of a part; writes the index if it is time."""
        part = pa.array(np.full(ticks.num_rows, len(self._parts)))
        rows = pa.table([part, *(ticks[name] for name in _COLUMNS)], names=["part", *_COLUMNS])
        self._parts.append(rows)
        if len(self._parts) % INDEXED_PARTS == 0:
            self.write()

    def write(self) -> None:
        """Writes the ticks so far, unless they are few."""
        if len(self._parts) < MIN_PARTS:
            return
        self._file.parent.mkdir(parents=True, exist_ok=True)
        rows = pa.concat_tables(self._parts).replace_schema_metadata({_LABEL: _label(self._key)})
        write_parquet(rows, self._file, compression="zstd")


def indexed_ticks(place: Path, key: str, parts: int, *, has_checksums: bool) -> list[pa.Table]:
    """Returns the numbers and times of the ticks of each part that an index knows, in order."""
    file = index_file(place)
    if not file.is_file():
        return []
    try:
        index = verified_parquet(file, has_checksums=has_checksums)
        if (index.schema_arrow.metadata or {}).get(_LABEL) != _label(key):
            return []
        check_columns(str(file), arrow_columns(index.schema_arrow), _TYPES)
        rows = index.read(columns=list(_TYPES))
    except (pa.ArrowException, OSError):  # the parts have what it has; a RecordError is an OSError
        return []
    if any(rows[name].null_count for name in _TYPES):
        return []
    return _by_part(rows, range(parts))


def _by_part(rows: pa.Table, parts: Sequence[int]) -> list[pa.Table]:
    numbers = rows["part"].to_numpy()
    if (np.diff(numbers) < 0).any():
        return []
    starts = np.searchsorted(numbers, parts).tolist()
    ends = np.searchsorted(numbers, parts, side="right").tolist()
    ticks = rows.select(_COLUMNS).replace_schema_metadata()
    return [
        ticks.slice(start, end - start)
        for start, end in zip(starts, ends, strict=True)
        if end > start
    ]


def checked_ticks(rows: pa.Table, source: str) -> TickBuffer:
    """Returns the ticks of a record in order."""
    if rows["tick"].null_count or rows["time"].null_count:
        raise RecordError(f"{source} is damaged: a tick lacks its number or its time")
    numbers, times = rows["tick"].to_numpy(), rows["time"].to_numpy()
    if len(numbers) and not (numbers.min() >= 0 and numbers.max() < _MAX_TICK):
        raise RecordError(f"{source} is damaged: the number of a tick is out of bounds")
    if (np.diff(numbers) <= 0).any():
        raise RecordError(f"{source} is damaged: its ticks do not ascend")
    if not np.isfinite(times).all() or (np.diff(times) < 0).any():
        raise RecordError(f"{source} is damaged: the times of its ticks do not ascend")
    return TickBuffer.from_arrays(numbers, times)


def index_file(place: Path) -> Path:
    """Returns the file of the index in a folder."""
    return place / "ticks.parquet"


def _label(key: str) -> bytes:
    return json.dumps({"episode": key}).encode()
