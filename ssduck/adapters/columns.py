"""Converts columns of Python values to Arrow arrays, and chooses their types."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain
from typing import Any

import numpy as np
import pyarrow as pa

from ssduck import validation
from ssduck.adapters.base import Selection
from ssduck.errors import ArgumentError
from ssduck.formatting import error_text, short_repr, type_in_words
from ssduck.sql.types import EXACT
from ssduck.world.handles import Handle
from ssduck.world.world import World

# The bounds of 64-bit integers and of 38-digit decimals, which also carry DuckDB's HUGEINT.
_INT64_END = 2**63
_DECIMAL_END = 10**38


def table_of(selection: Selection) -> pa.Table:
    """Returns the rows as an Arrow table."""
    names = checked_names(selection.columns)
    rows = selection.copied_rows
    columns = zip(*rows, strict=True) if rows else [()] * len(names)
    arrays = [array_of(name, list(column)) for name, column in zip(names, columns, strict=True)]
    return pa.table(arrays, names=list(names))


def checked_names(names: Sequence[Any]) -> Sequence[str]:
    """Returns the names of columns after checking them."""
    for index, name in enumerate(names):
        validation.text(name, "the name of a column must be a text")
        if name in names[:index]:
            raise ArgumentError(f"two columns have the name {name!r}; name them with to(…, 'name')")
    return names


def array_of(name: str, values: Iterable[Any]) -> pa.Array:
    """Returns a column as an Arrow array: entities become names, and None null.

    >>> array_of("height", [1, None, 2.5]).type
    DataType(double)
    """
    plain = [plain_value(value) for value in values]
    return pa.array(plain, _type_of(plain, name))


def plain_value(value: Any) -> Any:
    """Returns a value without types of ssduck and numpy: entities and worlds become names.

    >>> plain_value((np.float64(0.5), np.arange(2)))
    [0.5, [0, 1]]
    """
    match value:
        case Handle():
            return value.full_name
        case World():
            return value.name
        case np.ndarray() | np.generic():
            return value.tolist()
        case list() | tuple():
            return [plain_value(part) for part in value]
        case dict():
            return {key: plain_value(part) for key, part in value.items()}
    return value


def _type_of(values: list[Any], name: str) -> pa.DataType:
    present = [value for value in values if value is not None]
    kinds = dict.fromkeys(map(type, present)).keys()  # in order
    if not kinds:
        return pa.null()
    if kinds == {int}:
        return _integers(present, name)
    if kinds == {int, float}:
        return _mixed_numbers(present, name)
    if len(kinds) > 1:
        a, b = (next(v for v in present if type(v) is kind) for kind in list(kinds)[:2])
        raise ArgumentError(
            f"the column {name!r} holds {type_in_words(a)} ({short_repr(a)}) and "
            f"{type_in_words(b)} ({short_repr(b)}); "
            "a column is of one type, such as str(…) gives"
        )
    (kind,) = kinds
    if kind is list:
        return pa.list_(_type_of(list(chain.from_iterable(present)), name))
    if kind is dict:
        return _struct(present, name)
    if kind in _PLAIN:
        return _PLAIN[kind]
    try:
        return pa.infer_type(present)
    except pa.ArrowException as error:
        raise ArgumentError(
            f"the column {name!r} holds values that no table can hold: {type_in_words(present[0])} "
            f"({error_text(error)})"
        ) from error


_PLAIN = {bool: pa.bool_(), float: pa.float64(), str: pa.string(), bytes: pa.binary()}


def _integers(values: list[int], name: str) -> pa.DataType:
    smallest, largest = min(values), max(values)
    if smallest >= -_INT64_END and largest < _INT64_END:
        return pa.int64()
    if smallest > -_DECIMAL_END and largest < _DECIMAL_END:
        return pa.decimal128(38, 0)
    raise ArgumentError(f"the column {name!r} holds an integer of more than 38 digits")


def _mixed_numbers(values: list[float], name: str) -> pa.DataType:
    """Returns the type of integers mixed with floats, which must all be exact as floats."""
    for value in values:
        if type(value) is int and abs(value) > EXACT:
            raise ArgumentError(
                f"the column {name!r} holds fractions and {short_repr(value)}, which is no float "
                "exactly; "
                "float(…) rounds it"
            )
    return pa.float64()


def _struct(values: list[dict[Any, Any]], name: str) -> pa.DataType:
    keys = checked_names(list(dict.fromkeys(chain.from_iterable(values))))
    return pa.struct([(k, _type_of([v.get(k) for v in values], f"{name}.{k}")) for k in keys])
