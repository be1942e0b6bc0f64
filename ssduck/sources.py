"""What may stand in FROM: worlds, lists, tables, any value."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from ssduck.plan import Shape
from ssduck.result import Result
from ssduck.subqueries import aliases_of
from ssduck.tree import Query
from ssduck.types import ANY, INTEGER, SchemaOf, Tag, merged, tag_of
from ssduck.world import World


def elements_of(value: Any) -> Sequence[Any]:
    """The elements of a source.

    Args:
        value: a world (its entities), a list or a tuple, an array (its rows), a table of
            pandas, polars, Arrow or of `Interpreter.sql` (its rows as dicts); anything else is
            an element itself.
    """
    if isinstance(value, list | tuple):
        return value
    if isinstance(value, World):
        return list(value)
    if isinstance(value, np.ndarray) and value.ndim:
        rows: list[Any] = value.tolist()
        return rows
    table = table_of(value)
    return [value] if table is None else table.to_pylist()


def table_of(value: Any) -> pa.Table | None:
    """A data frame as an Arrow table; None if it is none."""
    if isinstance(value, pa.Table):
        return value
    if isinstance(value, Result):
        return value.arrow()
    if isinstance(value, pa.RecordBatch):
        return pa.Table.from_batches([value])
    # Without importing what may not be installed.
    match type(value).__module__.partition(".")[0], type(value).__name__:
        case "pandas", "DataFrame":
            return pa.Table.from_pandas(value, preserve_index=False)
        case "polars", "DataFrame":
            return value.to_arrow()
    return None


def shapes_of(query: Query, values: Sequence[Any], schema_of: SchemaOf) -> tuple[Shape, ...]:
    """What the sources of a query are.

    Args:
        query: the query.
        values: those of its sources; `INLINE` for a query that is to be a part of this one.
        schema_of: gives the schema of a world.

    Raises:
        ArgumentError: two sources have the same name.
    """
    aliases = aliases_of(query)
    return tuple(
        _shape(alias, value, schema_of) for alias, value in zip(aliases, values, strict=True)
    )


class _Inline:
    """Stands for the value of a source that is a part of the statement."""


INLINE = _Inline()


def _shape(alias: str, value: Any, schema_of: SchemaOf) -> Shape:
    if value is INLINE:
        return Shape(alias, given=False)
    if isinstance(value, World):
        return Shape(alias, schema_of(value))
    elements = elements_of(value)
    tag = _common(elements, schema_of)
    dicts = any(isinstance(element, dict) for element in elements)
    return Shape(alias, tag=tag, dicts=dicts, known=bool(elements))


def _common(elements: Iterable[Any], schema_of: SchemaOf) -> Tag:
    tags = {tag_of(element, schema_of) for element in elements}
    tag = merged(tags)
    if tag is None or tag.type == "nothing":
        return ANY
    if tag.type == "record":
        return tag
    return tag if (tag.comes_back and tag.element is not None) or _is_scalar(tag) else ANY


def _is_scalar(tag: Tag) -> bool:
    return tag.type in ("entity", "real", "integer", "text", "flag")


def arrow_of(elements: Sequence[Any], tag: Tag) -> pa.Table:
    """Records as a table: `n` from 1, and a column a key."""
    columns: dict[str, Any] = {"n": pa.array(range(1, len(elements) + 1), pa.int64())}
    for index, (key, part) in enumerate(tag.fields):
        if part.is_sql and part.type not in ("record", "entity"):
            values = [element[key] for element in elements]
            columns[f"f{index}"] = pa.array(values, _arrow_type(part))
    return pa.table(columns)


def _arrow_type(tag: Tag) -> pa.DataType:
    if tag.type == "list":
        return pa.list_(_arrow_type(tag.element or INTEGER))
    return _ARROW_TYPES[tag.type]


_ARROW_TYPES = {
    "integer": pa.int64(),
    "real": pa.float64(),
    "number": pa.float64(),
    "text": pa.string(),
    "flag": pa.bool_(),
}
