"""Rows as tables: Arrow's, data frames, arrays, JSON, Parquet files."""

from __future__ import annotations

import json
from collections import namedtuple
from functools import lru_cache
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck import validation
from ssduck.adapters.base import Adapter, Selection
from ssduck.adapters.columns import distinct, plain_value, table_of
from ssduck.adapters.display import as_json
from ssduck.adapters.files import check_file, replace_file
from ssduck.adapters.optional import library
from ssduck.adapters.result import Result, values_of
from ssduck.sql.types import EXACT

# What numpy's integers of 64 bits hold.
_MOST = 2**63
# Letters that a level of JSON is indented by.
_MOST_INDENT = 80


def _result(selection: Selection) -> Result:
    return Result(table_of(selection))


def _df(selection: Selection) -> Any:
    """Integers and truths among which some are missing stay what they are."""
    pandas = library("pandas", "pandas")
    table = table_of(selection)
    nullable = {pa.int64(): pandas.Int64Dtype(), pa.bool_(): pandas.BooleanDtype()}
    frame = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_nested(column.type) or pa.types.is_decimal(column.type):
            frame[name] = pandas.Series(values_of(column), dtype=object)
        else:
            frame[name] = column.to_pandas(types_mapper=nullable.get if column.null_count else None)
    return pandas.DataFrame(frame)


def _polars(selection: Selection) -> Any:
    polars = library("polars", "polars")
    table = table_of(selection)
    # Decimals of a program's own may have digits behind the point.
    large = [
        field.name
        for field in table.schema
        if pa.types.is_decimal(field.type) and field.type.scale == 0
    ]
    return polars.from_arrow(table).with_columns(polars.col(large).cast(polars.Int128))


def _json(selection: Selection, indent: int | None = None) -> str:
    if indent is not None:
        validation.integer_between(indent, "indent", 0, _MOST_INDENT)
    names = distinct(selection.columns)
    rows = [dict(zip(names, as_json(row), strict=True)) for row in selection.rows]
    return json.dumps(rows, ensure_ascii=False, allow_nan=False, indent=indent)


def _records(selection: Selection) -> list[tuple[Any, ...]]:
    record = _record(tuple(map(str, selection.columns)))
    return [record._make(row) for row in selection.rows]


@lru_cache
def _record(names: tuple[str, ...]) -> Any:
    """The same class for the same columns, so that triggers can compare results."""
    return namedtuple("Row", names, rename=True)  # noqa: PYI024


def _parquet(selection: Selection, file: str) -> str:
    """It takes the place of a file of that name at once, when it is written."""
    import pyarrow.parquet as pq

    path = check_file(selection, file)
    table = table_of(selection)
    replace_file(path, lambda stream: pq.write_table(table, stream))
    return file


# -- numpy ------------------------------------------------------------------------------------


def _numpy(selection: Selection) -> npt.NDArray[Any]:
    rows = selection.rows
    if not rows:
        return np.zeros((0, len(selection.columns)))
    columns = [[plain_value(value) for value in column] for column in zip(*rows, strict=True)]
    arrays = [_array(column) for column in columns]
    kinds = {array.dtype.kind for array in arrays}
    exact = "f" not in kinds or all(_is_exact(array) for array in arrays)
    alike = (kinds <= {"i", "f"} and exact) or kinds == {"b"}
    if alike and all(array.ndim <= 2 for array in arrays):
        return np.column_stack(arrays)
    names = distinct(selection.columns)
    types = [(name, a.dtype, a.shape[1:]) for name, a in zip(names, arrays, strict=True)]
    table = np.zeros(len(rows), types)
    for name, array in zip(names, arrays, strict=True):
        table[name] = array
    return table


def _is_exact(array: npt.NDArray[Any]) -> bool:
    """Whether numbers stay what they are as floats."""
    return array.dtype.kind != "i" or bool(((array >= -EXACT) & (array <= EXACT)).all())


def _array(column: list[Any]) -> npt.NDArray[Any]:
    """Of numbers, truths or texts, or of lists of as many; of anything else of objects."""
    shape, flat = _flattened(column)
    present = [value for value in flat if value is not None]
    kinds, is_whole = set(map(type, present)), len(present) == len(flat)
    if kinds in ({bool}, {str}) and is_whole:
        return np.array(flat).reshape(shape)
    if kinds == {int} and is_whole and all(-_MOST <= n < _MOST for n in flat):
        return np.array(flat, np.int64).reshape(shape)
    exact = all(type(n) is float or abs(n) <= EXACT for n in present if type(n) in (int, float))
    if kinds and kinds <= {int, float} and exact:
        return np.array(flat, float).reshape(shape)  # None becomes NaN
    objects = np.full(len(column), None, object)
    for index, value in enumerate(column):
        objects[index] = value
    return objects


def _flattened(column: list[Any]) -> tuple[tuple[int, ...], list[Any]]:
    """The shape of values, as far as all are lists of as many, and what is in these."""
    shape: tuple[int, ...] = (len(column),)
    while column and all(type(value) is list for value in column):
        lengths = set(map(len, column))
        if len(lengths) > 1 or lengths == {0}:
            break
        shape = (*shape, *lengths)
        column = [part for value in column for part in value]
    return shape, column


TABULAR = (
    Adapter(
        ("table",),
        "A table with df(), pl(), arrow() and fetchall(), as Interpreter.sql gives; "
        "shows in notebooks.",
        _result,
        needs="columns",
    ),
    Adapter(("arrow",), "A pyarrow table.", table_of, needs="columns"),
    Adapter(("df", "pandas"), "A pandas data frame. Extra: pandas.", _df, needs="columns"),
    Adapter(("polars", "pl"), "A polars data frame. Extra: polars.", _polars, needs="columns"),
    Adapter(
        ("numpy",),
        "A 2-D array if all columns are numbers, or lists of as many numbers, side by side; "
        "else a structured array.",
        _numpy,
    ),
    Adapter(
        ("json",),
        "A text: a list of objects. Entities by name; null for what is no number.",
        _json,
        needs="columns",
    ),
    Adapter(("records",), "A list of named tuples, one a row.", _records),
    Adapter(
        ("parquet",),
        "Writes a Parquet file, in the place of one of that name, and gives its path.",
        cast("Any", _parquet),
        needs="columns",
        writes=True,
    ),
)
