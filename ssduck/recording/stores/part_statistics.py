"""Compares what the footers of parts say of their values with the values.

DuckDB leaves rows out by the statistics of a footer, and answers minima and maxima from them, and a
stranger may have written them. Bloom filters and page indexes are for the same, but take long to
compare: ssduck writes none, and refuses parts with them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ssduck.errors import RecordError
from ssduck.recording.stores.base import StoreConnection
from ssduck.recording.stores.file_lists import file_list
from ssduck.recording.stores.object_store import ObjectPath, parquet_source
from ssduck.recording.stores.row_checks import repeated_columns
from ssduck.recording.stores.stored_columns import part_columns, unreadable

# The columns of which ssduck's parts have statistics: queries choose parts by them.
OWN_STATISTICS = ("tick", "time")
_NAMES = ("file_name", "row_group_id", "path_in_schema", "num_values", "stats_null_count")
_LEAST, _GREATEST = ("stats_min", "stats_min_value"), ("stats_max", "stats_max_value")
_SKIPS = ("bloom_filter_offset", "column_index_offset", "offset_index_offset")
# Between the names of a column and of what its lists have.
_NESTED = ", "
# The names of the path of an object by which it is known: its address may be written otherwise.
_NAMES_OF_OBJECT = 2
_SEPARATOR = re.compile(r"[/\\]")


@dataclass(frozen=True)
class _Stated:
    """What a footer says of a column in a row group.

    Attributes:
        file: the path of the file, by its names; of an object, the last two.
        group: the number of the row group.
        column: the name of the column.
        count: the number of its values, NULL counted.
        nulls: the number of NULL; None if it does not say.
        least: what it says is the least value, as texts.
        greatest: the same of the greatest.
        is_exact: whether these are values; if not, they are bounds of texts.
        skips: whether there is a Bloom filter or a page index.
    """

    file: tuple[str, ...]
    group: int
    column: str
    count: int
    nulls: int | None
    least: tuple[str, ...]
    greatest: tuple[str, ...]
    is_exact: bool
    skips: bool

    def is_true_of(self, column: pa.ChunkedArray, *, may_have_nan: bool) -> bool:
        """Checks whether the column has such values.

        Args:
            column: the column.
            may_have_nan: whether it may have NaN, which statistics leave out; what is measured is
                stored as NULL instead, and what a model says, as a joint's greatest effort, is not.
        """
        values = _flat(column)
        if self.nulls is not None and self.nulls != self.count - len(values) + values.null_count:
            return False
        if not self.least and not self.greatest:
            return True
        is_number = pa.types.is_floating(values.type) and not may_have_nan
        if is_number and pc.any(pc.is_nan(values)).as_py():
            return False  # the greatest number to SQL
        least, greatest = (bound.as_py() for bound in pc.min_max(values).values())
        return self._are(self.least, least, str.__le__) and self._are(
            self.greatest, greatest, str.__ge__
        )

    def _are(self, texts: Iterable[str], value: Any, bounds: Callable[[str, str], bool]) -> bool:
        if isinstance(value, str) and not self.is_exact:
            return all(bounds(text, value) for text in texts)
        return all(_is_text_of(text, value) for text in texts)


def check_statistics(connection: StoreConnection, files: Sequence[Path], table: str) -> None:
    """Checks what the footers of parts say of the values of columns that are read.

    Args:
        connection: reads the footers, as queries do.
        files: the files, of episodes of one world.
        table: the table, or `models/<table>`.

    Raises:
        RecordError: a footer says what is not so, or a part has a Bloom filter or a page index.
    """
    expected, places = part_columns(table), _by_path(files)
    of_models = expected if "/" in table else repeated_columns(table)
    depth = _NAMES_OF_OBJECT if isinstance(files[0], ObjectPath) else 0
    found = (_stated(row, depth) for row in connection.fetchall(_select(files)))
    known = sorted((stated for stated in found if stated.column in expected), key=_row_group)
    for (name, group), columns in groupby(known, _row_group):
        own, file = list(columns), places[name]
        if any(stated.skips for stated in own):
            raise RecordError(
                f"{file} has a Bloom filter or a page index, which could hide rows: write it "
                "without"
            )
        rows = _read(file, group, [stated.column for stated in own])
        for stated in own:
            if not stated.is_true_of(rows[stated.column], may_have_nan=stated.column in of_models):
                raise RecordError(
                    f"{file} is damaged: the column {stated.column!r} has other values than the "
                    "statistics in its footer say"
                )


def _select(files: Sequence[Path]) -> str:
    """Returns the SELECT of what footers say of columns."""
    names = ", ".join((*_NAMES, *_LEAST, *_GREATEST, *_SKIPS))
    bounds, counts = ", ".join((*_LEAST, *_GREATEST)), ", ".join(("stats_null_count", *_SKIPS))
    return (
        f"SELECT {names}, coalesce(min_is_exact AND max_is_exact, true) "  # noqa: S608
        f"FROM parquet_metadata({file_list(files)}) "
        f"WHERE coalesce({bounds}) IS NOT NULL OR coalesce({counts}) IS NOT NULL"
    )


def _by_path(files: Sequence[Path]) -> dict[tuple[str, ...], Path]:
    """Returns files by the names of their paths without links, which DuckDB is given."""
    if isinstance(files[0], ObjectPath):
        return {(file.parent.name, file.name): file for file in files}
    folders = {file.parent: _names_of(str(file.parent.resolve())) for file in files}
    return {(*folders[file.parent], file.name): file for file in files}


def _names_of(path: str) -> tuple[str, ...]:
    return tuple(_SEPARATOR.split(path))


def _stated(row: Sequence[Any], depth: int) -> _Stated:
    """Returns a row of `_select`, with so many last names of the path of its file; 0 for all."""
    place, group, path, count, nulls, *others, is_exact = row
    least, greatest = (
        tuple(text for text in texts if text is not None) for texts in (others[:2], others[2:4])
    )
    skips = any(offset is not None for offset in others[4:])
    file, column = _names_of(place)[-depth:], path.partition(_NESTED)[0]
    return _Stated(file, group, column, count, nulls, least, greatest, is_exact, skips)


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
