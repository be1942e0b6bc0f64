"""Compares identifiers as DuckDB does."""

from __future__ import annotations

import string

_SMALL = str.maketrans(string.ascii_uppercase, string.ascii_lowercase)


def folded(name: str) -> str:
    """Returns an identifier in small letters, as DuckDB compares identifiers: only A to Z change.

    Python's `lower` makes more letters equal, such as the sign of the unit kelvin and a k. A name
    that is known after `lower` may be another one, which is not known, to DuckDB.

    >>> folded("Ticks"), folded("tic\N{KELVIN SIGN}s") == folded("ticks")
    ('ticks', False)
    """
    return name.translate(_SMALL)
