"""Builds the SQL of recorded ticks: views of histories and models, and pairs of near entities."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import starmap
from pathlib import Path

import pyarrow as pa
from sqlglot import exp

from ssduck.errors import RecordError
from ssduck.recording.stores.base import PairRequest, StoreConnection
from ssduck.recording.stores.object_store import ObjectPath, is_address
from ssduck.schema import BOX, POSE, RECORDED, Column, Table

# Is added to the largest gap of boxes, m, so that a gap of exactly that size is included.
BOX_TOLERANCE = 1e-9
_BUFFERED = "buffered entities"


@lru_cache(maxsize=1024)
def quoted(name: str) -> str:
    """Returns a quoted identifier."""
    return exp.to_identifier(name, quoted=True).sql("duckdb")


def column_list(names: Iterable[str], source: Callable[[str], str] | None = None) -> str:
    """Returns a list of columns in SQL, each qualified by its table if `source` is given."""
    return ", ".join(
        quoted(name) if source is None else f"{source(name)}.{quoted(name)}" for name in names
    )


def create_table(place: str, columns: Mapping[str, str], *, replace: bool = False) -> str:
    """Returns the statement that creates a table, from the types of its columns by name."""
    listed = ", ".join(f"{quoted(name)} {type}" for name, type in columns.items())
    return f"CREATE {'OR REPLACE ' if replace else ''}TABLE {place} ({listed})"


_NUMBER = "DOUBLE"


def known(name: str, type: str) -> str:
    """Returns a column with NULL for NaN, which others may have stored: SQL takes it as large.

    DuckDB computes this in a few nanoseconds a value, a third faster than `nullif`. Of a column
    whose statistics have bounds, it takes `isnan`, and comparisons with NaN, for false.
    """
    if type != _NUMBER or name == "time":
        return quoted(name)
    column = quoted(name)
    cases = f"WHEN isfinite({column}) THEN {column} WHEN isinf({column}) THEN {column}"
    return f"CASE {cases} END AS {column}"


def all_columns(rows: str, columns: Mapping[str, str]) -> str:
    """Returns a SELECT of all columns of a stored table."""
    return f"SELECT {', '.join(starmap(known, columns.items()))} FROM {rows}"  # noqa: S608


def buffered_rows(table: str, view: str) -> str:
    """Returns a SELECT of the buffered rows of a table, which DuckDB has as a view.

    An unknown number is NaN in the buffer, and NULL in the rows.
    """
    columns = RECORDED[table].tick_columns
    listed = column_list(columns.integers)
    for name in map(quoted, columns.doubles):
        has_unknown = RECORDED[table].has_unknown_numbers
        listed += f", nullif({name}, 'nan'::DOUBLE) AS {name}" if has_unknown else f", {name}"
    listed += "".join(f", {quoted(name)}::BOOLEAN AS {quoted(name)}" for name in columns.booleans)
    return f"SELECT {listed} FROM {quoted(view)} WHERE tick >= 0"  # noqa: S608


def history(table: Table, rows: str, entities: str, model: Callable[[str], str]) -> str:
    """Returns the SELECT of a table's history, with the columns of the table in order."""
    if not table.model:
        return f"SELECT {column_list(table.names)} FROM ({rows}) AS rows"  # noqa: S608
    stored = table.tick_columns
    listed = column_list(table.names, lambda name: "rows" if name in stored.names else "model")
    if table.name == "links":  # a body of one link has its pose, and no row of its own
        doubles = column_list(stored.doubles)
        rows += (
            f" UNION ALL SELECT tick, id, 0, {doubles} FROM ({entities}) AS entities "  # noqa: S608
            f"WHERE id IN (SELECT id FROM {model('entities')} WHERE links = 1)"
        )
    keys = column_list(table.key)
    return f"SELECT {listed} FROM ({rows}) AS rows JOIN {model(table.name)} AS model USING ({keys})"  # noqa: S608


def near_pair_rows(
    connection: StoreConnection,
    stored: str | None,
    request: PairRequest,
    buffered: pa.Table | None,
) -> pa.Table:
    """Returns the pairs of entities whose boxes are near at a tick, or unknown, with both poses."""
    columns = ("tick", "id", *POSE, *BOX)
    sources = [] if stored is None else [f"({stored}) AS stored"]
    if buffered is not None:
        sources.append(f'"{_BUFFERED}"')
    rows = " UNION ALL ".join(
        f"SELECT {column_list(columns)} FROM {source} WHERE tick BETWEEN ? AND ?"  # noqa: S608
        for source in sources
    )
    values = [request.first, request.last] * len(sources)
    poses = ", ".join(f'{side}."{name}" AS {side}_{name}' for side in "ab" for name in POSE)
    sides = (("a", "b"), ("b", "a"))
    apart = [f"{s}.{axis}min > {t}.{axis}max + max_gap" for axis in "xyz" for s, t in sides]
    ids = [f"{side}.id = {id}" for side, id in (("a", request.a), ("b", request.b)) if id]
    sql = (
        f"WITH entities AS ({rows}), "  # noqa: S608
        f"request AS (SELECT '{request.max_gap!r}'::DOUBLE + {BOX_TOLERANCE!r}::DOUBLE AS max_gap) "
        f"SELECT a.tick AS tick, a.id AS a, b.id AS b, {poses} "
        "FROM entities AS a JOIN entities AS b ON a.tick = b.tick CROSS JOIN request "
        f"WHERE {' AND '.join(['a.id <> b.id', *ids])} "
        f"AND ({' OR '.join(apart)}) IS NOT TRUE ORDER BY tick"
    )
    tables = {} if buffered is None else {_BUFFERED: buffered}
    return connection.rows(sql, values, tables)


# -- files ------------------------------------------------------------------------------------

_PATTERN = re.compile(r"[*?[]")


def file_list(files: Sequence[Path]) -> str:
    """Returns a list of files of parts, in SQL."""
    separator = "/" if isinstance(files[0], ObjectPath) else os.sep
    folders = {
        folder: exp.Literal.string(exact_path(folder) + separator).sql("duckdb")[:-1]
        for folder in {file.parent for file in files}
    }
    names = ", ".join(f"{folders[file.parent]}{file.name}'" for file in files)  # by `part_name`
    return f"[{names}]"


def rows_of_files(files: Sequence[Path], columns: Sequence[Column]) -> str:
    """Returns a SELECT of all columns of a table from its files."""
    rows = f"read_parquet({file_list(files)}, hive_partitioning = false)"
    return all_columns(rows, {column.name: column.sql for column in columns})


def exact_path(place: Path) -> str:
    """Returns a path with `*`, `?` and `[` escaped, which DuckDB reads as patterns.

    It lists the folders around a pattern: a link without such letters stays.
    """
    real = str(place.resolve())
    is_pattern = _PATTERN.search(real) and not _PATTERN.search(str(place))
    return str(place) if is_pattern else pattern_of(real)


def pattern_of(path: str) -> str:
    """Returns the same for an absolute path without links, or an address."""
    if not _PATTERN.search(path):
        return path
    if not is_address(path) and "\\" in path and os.sep != "\\":
        raise RecordError(
            f"{path} cannot be read: DuckDB takes a backslash in such a name for a slash; rename "
            "the folder"
        )
    return _PATTERN.sub(r"[\g<0>]", path)
