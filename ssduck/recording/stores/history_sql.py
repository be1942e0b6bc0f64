"""Writes the SQL of recorded ticks: views of histories and models, and pairs that are near."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from functools import lru_cache

import pyarrow as pa
from sqlglot import exp

from ssduck.recording.stores.base import PairRequest, StoreConnection
from ssduck.schema import BOX, POSE, RECORDED, Table

# Boxes are taken to be a little nearer, m, so that one exactly as far as requested is found.
BOX_TOLERANCE = 1e-9
_WAITING = "entities that wait"


@lru_cache(maxsize=1024)
def quoted(name: str) -> str:
    """A name in SQL."""
    return exp.to_identifier(name, quoted=True).sql("duckdb")


def column_list(names: Iterable[str], source: Callable[[str], str] | None = None) -> str:
    """Columns in SQL, each with the table that it is of."""
    return ", ".join(
        quoted(name) if source is None else f"{source(name)}.{quoted(name)}" for name in names
    )


def create_table(place: str, columns: Mapping[str, str], *, replace: bool = False) -> str:
    """The statement that makes a table of columns and their types."""
    listed = ", ".join(f"{quoted(name)} {type}" for name, type in columns.items())
    return f"CREATE {'OR REPLACE ' if replace else ''}TABLE {place} ({listed})"


def all_columns(
    rows: str, columns: Mapping[str, str], present: Collection[str], missing: Mapping[str, str]
) -> str:
    """A SELECT of all columns of a table from rows of an older record, which may lack some.

    Args:
        rows: what follows FROM.
        columns: the names and the types.
        present: the names of the columns that the rows have.
        missing: the values of others, in SQL; a column that is neither is NULL.
    """
    listed = ", ".join(
        quoted(name)
        if name in present
        else f"({missing.get(name, 'NULL')})::{type} AS {quoted(name)}"
        for name, type in columns.items()
    )
    return f"SELECT {listed} FROM {rows}"  # noqa: S608


def waiting_rows(table: str, view: str) -> str:
    """A SELECT of the rows of a table that wait in a buffer, which DuckDB sees as a view."""
    columns = RECORDED[table].tick_columns
    listed = column_list((*columns.integers, *columns.doubles))
    listed += "".join(f", {quoted(name)}::BOOLEAN AS {quoted(name)}" for name in columns.booleans)
    return f"SELECT {listed} FROM {quoted(view)} WHERE tick >= 0"  # noqa: S608


def history(table: Table, rows: str, entities: str, model: Callable[[str], str]) -> str:
    """The SELECT of a table's history: its columns as at a tick, in their order.

    Args:
        table: a table of a world.
        rows: a SELECT of the columns that are stored with each tick.
        entities: the same of the table of entities.
        model: gives the place of the model of a table.
    """
    if not table.model:
        return f"SELECT {column_list(table.names)} FROM ({rows}) AS rows"  # noqa: S608
    stored = table.tick_columns
    listed = column_list(table.names, lambda name: "rows" if name in stored.names else "model")
    if table.name == "links":  # that of a body of one link is as the body
        doubles = column_list(stored.doubles)
        rows += (
            f" UNION ALL SELECT tick, id, 0, {doubles} FROM ({entities}) AS entities "  # noqa: S608
            f"WHERE id IN (SELECT id FROM {model('entities')} WHERE links = 1)"
        )
    keys = column_list(table.key)
    return f"SELECT {listed} FROM ({rows}) AS rows JOIN {model(table.name)} AS model USING ({keys})"  # noqa: S608


def near_rows(
    connection: StoreConnection,
    stored: str | None,
    request: PairRequest,
    waiting: pa.Table | None,
) -> pa.Table:
    """Pairs of entities whose boxes are near at a tick, or are not known, with both poses.

    Args:
        connection: reads the rows.
        stored: a SELECT of the stored rows of entities; None if there are none.
        request: which pairs.
        waiting: rows of entities that are not stored; None if there are none.

    Returns:
        `ssduck.recording.stores.base.PAIR_COLUMNS`, by tick.
    """
    columns = ("tick", "id", *POSE, *BOX)
    sources = [] if stored is None else [f"({stored}) AS stored"]
    if waiting is not None:
        sources.append(f'"{_WAITING}"')
    rows = " UNION ALL ".join(
        f"SELECT {column_list(columns)} FROM {source} WHERE tick BETWEEN ? AND ?"  # noqa: S608
        for source in sources
    )
    values = [request.first, request.last] * len(sources)
    poses = ", ".join(f'{side}."{name}" AS {side}_{name}' for side in "ab" for name in POSE)
    sides = (("a", "b"), ("b", "a"))
    far = [f"{s}.{axis}min > {t}.{axis}max + far" for axis in "xyz" for s, t in sides]
    only = [f"{side}.id = {id}" for side, id in (("a", request.a), ("b", request.b)) if id]
    sql = (
        f"WITH seen AS ({rows}), "  # noqa: S608
        f"asked AS (SELECT {request.apart!r}::DOUBLE + {BOX_TOLERANCE!r}::DOUBLE AS far) "
        f"SELECT a.tick AS tick, a.id AS a, b.id AS b, {poses} "
        "FROM seen AS a JOIN seen AS b ON a.tick = b.tick CROSS JOIN asked "
        f"WHERE {' AND '.join(['a.id <> b.id', *only])} "
        f"AND ({' OR '.join(far)}) IS NOT TRUE ORDER BY tick"
    )
    tables = {} if waiting is None else {_WAITING: waiting}
    return connection.rows(sql, values, tables)
