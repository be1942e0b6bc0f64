"""Defines the result forms of values and tables: dicts, lists, frames, arrays, JSON, files."""

from __future__ import annotations

import json
from collections import namedtuple
from functools import lru_cache
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck import validation
from ssduck.adapters.base import Selection, check_file, form, replace_file
from ssduck.adapters.columns import array_of, checked_names, plain_value, table_of
from ssduck.adapters.display import DisplayTable, as_json
from ssduck.adapters.formats import FORMATS, text_of
from ssduck.adapters.optional import library
from ssduck.adapters.result import Result, is_table, python_values, table_of_frame
from ssduck.errors import ArgumentError
from ssduck.sql.types import EXACT

# What a key of a dict takes, bytes.
_KEY_BYTES = 32


def tabulated(value: Any) -> Any:
    """Returns the rows of a data frame, an Arrow table or an array, to show or to write all.

    Those of a frame are a `Result`, with a named index as columns, and so are those of a structured
    array; those of another array are a list. Any other value is itself, and so is a frame that
    Arrow cannot have.
    """
    is_array = isinstance(value, np.ndarray)
    if is_array and not (value.ndim and value.dtype.names):
        return value.tolist()
    if isinstance(value, Result) or not (is_array or is_table(value)):
        return value
    try:
        frame = value
        if is_array:
            frame = {name: array_of(name, value[name].tolist()) for name in value.dtype.names}
        elif any(name is not None for name in getattr(getattr(value, "index", None), "names", ())):
            frame = value.reset_index()
        return Result(table_of_frame(frame))
    except (pa.ArrowException, ArgumentError, TypeError, ValueError, OverflowError):
        return value


@form("dict", "dictionary", needs="columns")
def _dicts(selection: Selection) -> list[dict[Any, Any]]:
    """A list of dicts, one for each row, with the names of the columns as keys. The default."""
    rows = selection.read()
    selection.charge(sum(map(len, rows.values[:1])) * len(rows.values) * _KEY_BYTES)
    if isinstance(rows.names, list):
        try:
            return [
                dict(zip(names, values, strict=True))
                for names, values in zip(rows.names, rows.values, strict=True)
            ]
        except TypeError as error:
            raise ArgumentError(f"this cannot be the name of a column: {error}") from error
    return [dict(zip(rows.names, values, strict=True)) for values in rows.values]


@form("list")
def _flat(selection: Selection) -> list[Any]:
    """One flat list of the values, row by row."""
    return list(chain.from_iterable(selection.rows))


_NO_DEFAULT: Any = ()


@form("value", "val")
def _single_value(selection: Selection, default: Any = _NO_DEFAULT) -> Any:
    """The value in the first column of the first row; default, or [], if there is no row."""
    rows = selection.rows
    if rows:
        return rows[0][0]
    return [] if default is _NO_DEFAULT else default


VALUES = (_dicts, _flat, _single_value)


# The upper bound of numpy's 64-bit integers.
_INT64_END = 2**63
# The largest indentation of a level of JSON, characters.
_MAX_INDENT = 80


@form(
    "table",
    help="A table with df(), pl(), arrow() and fetchall(), as Interpreter.sql returns; notebooks "
    "display it.",
    needs="columns",
    joins_groups=True,
)
def _result(selection: Selection) -> Result:
    return Result(table_of(selection))


@form(
    "df",
    "pandas",
    "dataframe",
    help="A pandas data frame. Extra: pandas.",
    needs="columns",
    joins_groups=True,
)
def _df(selection: Selection) -> Any:
    """Returns a data frame; integers and booleans keep their type if values are missing."""
    pandas = library("pandas", "pandas")
    table = table_of(selection)
    nullable = {pa.int64(): pandas.Int64Dtype(), pa.bool_(): pandas.BooleanDtype()}
    frame = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_nested(column.type) or pa.types.is_decimal(column.type):
            frame[name] = pandas.Series(python_values(column), dtype=object)
        else:
            frame[name] = column.to_pandas(types_mapper=nullable.get if column.null_count else None)
    return pandas.DataFrame(frame)


@form("polars", "pl", needs="columns", joins_groups=True)
def _polars(selection: Selection) -> Any:
    """A polars data frame. Extra: polars."""
    polars = library("polars", "polars")
    table = table_of(selection)
    # Only integral decimals become integers; a program may also return decimal fractions.
    large = [
        field.name
        for field in table.schema
        if pa.types.is_decimal(field.type) and field.type.scale == 0
    ]
    return polars.from_arrow(table).with_columns(polars.col(large).cast(polars.Int128))


@form("json", needs="columns")
def _json(selection: Selection, indent: int | None = None) -> str:
    """A JSON text, a list of objects. Entities appear by name, NaN and infinities as null."""
    if indent is not None:
        validation.integer_between(indent, "indent", 0, _MAX_INDENT)
    names = checked_names(selection.columns)
    selection.charge(len(selection.rows) * sum(map(len, names)))
    rows = (dict(zip(names, as_json(row), strict=True)) for row in selection.timed_rows)
    if indent is not None:
        return json.dumps(list(rows), ensure_ascii=False, allow_nan=False, indent=indent)
    texts = [json.dumps(row, ensure_ascii=False, allow_nan=False) for row in rows]
    return f"[{', '.join(texts)}]"


@form("csv", needs="columns")
def _csv(selection: Selection) -> str:
    """A CSV text with a line of the columns' names. Entities appear by name, lists as JSON."""
    return text_of(_named_rows(selection), FORMATS["csv"])


@form("markdown", needs="columns")
def _markdown(selection: Selection) -> str:
    """A table in Markdown, with numbers rounded to six digits."""
    return text_of(_named_rows(selection), FORMATS["markdown"])


def _named_rows(selection: Selection) -> DisplayTable:
    return DisplayTable(checked_names(selection.columns), selection.timed_rows)


@form("records")
def _records(selection: Selection) -> list[tuple[Any, ...]]:
    """A list of named tuples, one for each row."""
    row_class = class_of_rows(tuple(map(str, selection.columns)))
    return [row_class._make(row) for row in selection.timed_rows]


@lru_cache
def class_of_rows(names: tuple[str, ...]) -> Any:
    """Returns the tuple class of columns, always the same one, so that results compare equal."""
    return namedtuple("Row", names, rename=True)  # noqa: PYI024


@form(
    "parquet",
    help="Writes the rows to a Parquet file, replaces an existing one, and returns its path.",
    needs="columns",
    writes=True,
)
def _parquet(selection: Selection, file: str) -> str:
    """Writes a Parquet file and atomically replaces an existing file of that name."""
    import pyarrow.parquet as pq

    path = check_file(selection, file)
    table = table_of(selection)
    replace_file(path, lambda stream: pq.write_table(table, stream))
    return file


# -- numpy ------------------------------------------------------------------------------------


@form(
    "numpy",
    "tensor",
    help="A 2-D NumPy array if all columns are numbers, or lists of equally many numbers, side "
    "by side; else a structured array. Over a batch, an array of the library of its states.",
)
def _numpy(selection: Selection) -> npt.NDArray[Any]:
    rows = selection.copied_rows
    if not rows:
        return np.zeros((0, len(selection.columns)))
    columns = [[plain_value(value) for value in column] for column in zip(*rows, strict=True)]
    arrays = [_array(column) for column in columns]
    kinds = {array.dtype.kind for array in arrays}
    are_exact = "f" not in kinds or all(_are_exact(array) for array in arrays)
    is_plain_array = (kinds <= {"i", "f"} and are_exact) or kinds == {"b"}
    if is_plain_array and all(array.ndim <= 2 for array in arrays):
        return np.column_stack(arrays)
    names = checked_names(selection.columns)
    types = [(name, a.dtype, a.shape[1:]) for name, a in zip(names, arrays, strict=True)]
    table = np.zeros(len(rows), types)
    for name, array in zip(names, arrays, strict=True):
        table[name] = array
    return table


def _are_exact(array: npt.NDArray[Any]) -> bool:
    """Checks whether all numbers can be converted to floats without rounding."""
    return array.dtype.kind != "i" or bool(((array >= -EXACT) & (array <= EXACT)).all())


def _array(column: list[Any]) -> npt.NDArray[Any]:
    """Returns an array of numbers, booleans, strings or equal-length lists; else of objects."""
    shape, flat = _flattened(column)
    present = [value for value in flat if value is not None]
    kinds, is_complete = set(map(type, present)), len(present) == len(flat)
    if kinds in ({bool}, {str}) and is_complete:
        return np.array(flat).reshape(shape)
    if kinds == {int} and is_complete and all(-_INT64_END <= n < _INT64_END for n in flat):
        return np.array(flat, np.int64).reshape(shape)
    are_exact = all(type(n) is float or abs(n) <= EXACT for n in present if type(n) in (int, float))
    if kinds and kinds <= {int, float} and are_exact:
        return np.array(flat, float).reshape(shape)  # None becomes NaN
    objects = np.full(len(column), None, object)
    for index, value in enumerate(column):
        objects[index] = value
    return objects


def _flattened(column: list[Any]) -> tuple[tuple[int, ...], list[Any]]:
    """Returns the shape of values, as far as they are lists of equal length, and the elements."""
    shape: tuple[int, ...] = (len(column),)
    while column and all(type(value) is list for value in column):
        lengths = set(map(len, column))
        if len(lengths) > 1 or lengths == {0}:
            break
        shape = (*shape, *lengths)
        column = [part for value in column for part in value]
    return shape, column


_arrow = form("arrow", help="A pyarrow table.", needs="columns", joins_groups=True)(table_of)

TABULAR = (_result, _arrow, _df, _polars, _numpy, _json, _csv, _markdown, _records, _parquet)
