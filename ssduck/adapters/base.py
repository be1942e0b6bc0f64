"""What an adapter is and what it is given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Rows:
    """What a query selected.

    Attributes:
        values: a tuple a row, in order: one value a selected item.
        names: the columns' names; where `to` names a column differently from row to row, a
            tuple a row.
    """

    values: list[tuple[Any, ...]]
    names: tuple[str, ...] | list[tuple[Any, ...]]


@dataclass(frozen=True)
class Adapter:
    """A form of the result.

    Attributes:
        names: what programs call it.
        help: what it makes of the rows.
        make: rows and the arguments behind AS to value.
        keyed: whether it takes the columns by name, so that these must differ.
    """

    names: tuple[str, ...]
    help: str
    make: Callable[..., Any]
    keyed: bool = False
