"""Rows as plain Python values: dicts, a flat list, one value."""

from __future__ import annotations

from itertools import chain
from typing import Any

from ssduck.adapters.base import Adapter, Rows
from ssduck.errors import ArgumentError


def _dicts(rows: Rows) -> list[dict[Any, Any]]:
    if isinstance(rows.names, list):
        try:
            return [
                dict(zip(names, values, strict=True))
                for names, values in zip(rows.names, rows.values, strict=True)
            ]
        except TypeError as error:
            raise ArgumentError(f"a column cannot be called by that: {error}") from error
    return [dict(zip(rows.names, values, strict=True)) for values in rows.values]


def _flat(rows: Rows) -> list[Any]:
    return list(chain.from_iterable(rows.values))


def _first(rows: Rows, default: Any = ()) -> Any:
    if rows.values:
        return rows.values[0][0]
    return [] if default == () else default


VALUES = (
    Adapter(
        ("dict", "dictionary"),
        "A list of dicts, one a row, by the columns' names. The default.",
        _dicts,
        keyed=True,
    ),
    Adapter(("list",), "One flat list: row after row, column after column.", _flat),
    Adapter(
        ("value", "val"),
        "The first column of the first row; default, or [], if there is none.",
        _first,
    ),
)
