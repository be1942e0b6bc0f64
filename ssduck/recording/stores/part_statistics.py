"""Compares what the footers of parts say of their values with the values.

DuckDB leaves rows out by the statistics of a footer, and answers minima and maxima from them, and a
stranger may have written them. Bloom filters and page indexes are for the same, but take long to
compare: ssduck writes none, and refuses parts with them.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ssduck.errors import RecordError
from ssduck.recording.stores.base import StoreConnection
from ssduck.recording.stores.history_sql import file_list
from ssduck.recording.stores.object_store import ObjectPath, parquet_source
from ssduck.recording.stores.stored_columns import part_columns, unreadable

# The columns of which ssduck's parts have statistics: queries choose parts by them.
OWN_STATISTICS = ("tick", "time")
_NAMES = ("file_name", "row_group_id", "path_in_schema", "num_values", "stats_null_count")
_EXACT = ("min_is_exact", "max_is_exact")
_LEAST, _GREATEST = ("stats_min", "stats_min_value"), ("stats_max", "stats_max_value")
_SKIPS = ("bloom_filter_offset", "column_index_offset", "offset_index_offset")
# Between the names of a column and of what its lists have.
_NESTED = ", "
# The names of the path of an object by which it is known: its address may be written otherwise.
_NAMES_OF_OBJECT = 2
_SEPARATOR = re.compile(r"[/\\]")


@dataclass(frozen=True)
class _Stated:
    """What a footer says of a column in a row group."""

    file: tuple[str, ...]  # the names of its path; of an object, the last two
    group: int
    groups: int  # how many row groups the file has
    column: str
    count: int  # of its values, NULL counted
    nulls: int | None
    least: tuple[str, ...]
    greatest: tuple[str, ...]
    is_exact: bool  # whether these are values, not bounds of texts
    skips: bool  # whether there is a Bloom filter or a page index

    def is_true_of(self, values: Values) -> bool:
        """Checks whether the column has such values."""
        if self.nulls is not None and self.nulls != self.count - values.known:
            return False
        if not self.least and not self.greatest:
            return True
        if values.has_nan and self.column == "time":
            return False  # SQL reads NaN as NULL, but in times, where it is the greatest number
        return self._are(self.least, values.least, str.__le__) and self._are(
            self.greatest, values.greatest, str.__ge__
        )

    def _are(self, texts: Iterable[str], value: Any, bounds: Callable[[str, str], bool]) -> bool:
        if isinstance(value, str) and not self.is_exact:
            return all(bounds(text, value) for text in texts)
        return all(_is_text_of(text, value) for text in texts)


@dataclass(frozen=True)
class Values:
    """What values a column has.

    Attributes:
        known: the number of those that are not NULL.
        least: the least of these; None if there is none.
        greatest: the greatest, likewise.
        has_nan: whether NaN is among them, which is neither.
    """

    known: int
    least: Any
    greatest: Any
    has_nan: bool = False

    @classmethod
    def of(cls, column: pa.ChunkedArray) -> Values:
        """Returns what values a column of a part has; of lists, what is in them."""
        values = _flat(column)
        known, is_number = len(values) - values.null_count, pa.types.is_floating(values.type)
        if known == len(values) > 0 and (is_number or pa.types.is_integer(values.type)):
            numbers = values.to_numpy()
            least = numbers.min().item()
            if not math.isnan(least):
                return cls(known, least, numbers.max().item())
        has_nan = is_number and pc.any(pc.is_nan(values)).as_py() is True
        least, greatest = (bound.as_py() for bound in pc.min_max(values).values())
        return cls(known, least, greatest, has_nan)

    def __or__(self, other: Values) -> Values:
        """Returns what values both have together."""
        if not (self.known and other.known):
            return self if self.known else other
        least, greatest = min(self.least, other.least), max(self.greatest, other.greatest)
        return Values(self.known + other.known, least, greatest, self.has_nan or other.has_nan)


def add_values(found: dict[Path, dict[str, Values]], file: Path, rows: pa.Table) -> None:
    """Adds what values some rows of a part have, of the columns that ssduck has statistics of."""
    own = found.setdefault(file, {})
    for name in OWN_STATISTICS:
        values = Values.of(rows[name])
        own[name] = own[name] | values if name in own else values


def check_statistics(
    connection: StoreConnection,
    files: Sequence[Path],
    table: str,
    found: Mapping[Path, Mapping[str, Values]] = MappingProxyType({}),
) -> None:
    """Checks what the footers of parts say of the values of columns that are read.

    Args:
        connection: reads the footers, as queries do.
        files: the files, of episodes of one world.
        table: the table, or `models/<table>`.
        found: of files that were read, what values some columns have; others are read now.
    """
    expected, places = part_columns(table), _by_path(files)
    depth = _NAMES_OF_OBJECT if isinstance(files[0], ObjectPath) else 0
    rows = connection.fetchall(_select(files))
    groups = Counter(file for file, _ in {row[:2] for row in rows})
    stated = [_stated(row, depth, groups[row[0]]) for row in rows if _is_stated(row)]
    known = sorted((one for one in stated if one.column in expected), key=_row_group)
    for (name, _), columns in groupby(known, _row_group):
        own, file = list(columns), places[name]
        if any(one.skips for one in own):
            raise RecordError(
                f"{file} has a Bloom filter or a page index, which could hide rows: write it "
                "without"
            )
        values = _values(own, file, found.get(file, {}))
        for one in own:
            if not one.is_true_of(values[one.column]):
                raise RecordError(
                    f"{file} is damaged: the column {one.column!r} has other values than the "
                    "statistics in its footer say"
                )


def _values(
    stated: Sequence[_Stated], file: Path, found: Mapping[str, Values]
) -> dict[str, Values]:
    """Returns what values columns of a row group have: as found in all of the file, or read now."""
    values = dict(found) if stated[0].groups == 1 else {}
    missing = [one.column for one in stated if one.column not in values]
    if missing:
        rows = _read(file, stated[0].group, missing)
        values |= {name: Values.of(rows[name]) for name in missing}
    return values


def _select(files: Sequence[Path]) -> str:
    """Returns the SELECT of what footers say of columns."""
    names = ", ".join((*_NAMES, *_LEAST, *_GREATEST, *_SKIPS, *_EXACT))
    return f"SELECT {names} FROM parquet_metadata({file_list(files)})"  # noqa: S608


def _by_path(files: Sequence[Path]) -> dict[tuple[str, ...], Path]:
    """Returns files by the names of their paths without links, which DuckDB is given."""
    if isinstance(files[0], ObjectPath):
        return {(file.parent.name, file.name): file for file in files}
    folders = {file.parent: _names_of(str(file.parent.resolve())) for file in files}
    return {(*folders[file.parent], file.name): file for file in files}


def _names_of(path: str) -> tuple[str, ...]:
    return tuple(_SEPARATOR.split(path))


def _is_stated(row: Sequence[Any]) -> bool:
    """Checks whether a row of `_select` says anything by which rows can be left out."""
    return any(value is not None for value in row[len(_NAMES) - 1 : -len(_EXACT)])


def _stated(row: Sequence[Any], depth: int, groups: int) -> _Stated:
    """Returns a row of `_select`, with so many last names of the path of its file; 0 for all."""
    place, group, path, count, nulls, *others = row
    least, greatest = (
        tuple(text for text in texts if text is not None) for texts in (others[:2], others[2:4])
    )
    skips = any(offset is not None for offset in others[4:-2])
    is_exact = False not in others[-2:]
    file, column = _names_of(place)[-depth:], path.partition(_NESTED)[0]
    return _Stated(file, group, groups, column, count, nulls, least, greatest, is_exact, skips)


def _row_group(stated: _Stated) -> tuple[tuple[str, ...], int]:
    return stated.file, stated.group


def _read(file: Path, group: int, names: Sequence[str]) -> pa.Table:
    """Returns columns of a row group."""
    try:
        part = pq.ParquetFile(parquet_source(file))
        return part.read_row_group(group, columns=list(names), use_threads=False)
    except (pa.ArrowException, OSError) as error:
        raise unreadable(file, error) from error


def _flat(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Returns the values of a column, those of lists without the lists."""
    while not pa.types.is_primitive(column.type) and not pa.types.is_string(column.type):
        if pa.types.is_large_string(column.type):
            return column.cast(pa.string())
        column = pc.list_flatten(column)
    return column


def _is_text_of(text: str, value: Any) -> bool:
    """Checks whether DuckDB writes a value so."""
    if isinstance(value, bool):
        return text == str(value).lower()
    if value is None or isinstance(value, str):
        return text == value
    try:
        return bool(type(value)(text) == value)
    except ValueError:
        return False
