"""Defines the result forms of plain Python values: dicts, a flat list, a single value."""

from __future__ import annotations

from itertools import chain
from typing import Any

from ssduck.adapters.base import Adapter, Selection
from ssduck.errors import ArgumentError

# What a key of a dict takes, bytes.
_KEY_BYTES = 32


def _dicts(selection: Selection) -> list[dict[Any, Any]]:
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


def _flat(selection: Selection) -> list[Any]:
    return list(chain.from_iterable(selection.rows))


_NO_DEFAULT: Any = ()


def _single_value(selection: Selection, default: Any = _NO_DEFAULT) -> Any:
    rows = selection.rows
    if rows:
        return rows[0][0]
    return [] if default is _NO_DEFAULT else default


VALUES = (
    Adapter(
        ("dict", "dictionary"),
        "A list of dicts, one for each row, with the names of the columns as keys. The default.",
        _dicts,
        needs="columns",
    ),
    Adapter(("list",), "One flat list of the values, row by row.", _flat),
    Adapter(
        ("value", "val"),
        "The value in the first column of the first row; default, or [], if there is no row.",
        _single_value,
    ),
)
