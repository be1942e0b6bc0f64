"""Makes values into JSON for a page, as much of them as it can show."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.adapters.display import as_json, json_key

# The numbers of values in all rows of an answer, and of the letters of a text; downloads have all.
MAX_VALUES = 100_000
MAX_LETTERS = 100_000


def shown_rows(rows: Iterable[Sequence[Any]], most: int = MAX_VALUES) -> list[list[Any]]:
    """Returns the first rows as JSON; lists that are cut off end in a text that says so.

    Args:
        rows: the rows.
        most: the number of values that are shown, those in lists among them.
    """
    values = _ShownValues(most)
    shown = []
    for row in rows:
        if values.left <= 0:
            break
        shown.append(values.list_of(row))
    return shown


class _ShownValues:
    """Makes values into JSON until there are too many.

    Args:
        most: the number of values.

    Attributes:
        left: the number of further values.
    """

    def __init__(self, most: int) -> None:
        self.left = most

    def of(self, value: Any) -> Any:
        """Returns a value as JSON, or its beginning."""
        self.left -= 1
        match value:
            case str() | bytes() if len(value) > MAX_LETTERS:
                start = as_json(value[:MAX_LETTERS])
                return f"{start}… ({len(value) - MAX_LETTERS:,} more)"
            case list() | tuple():
                return self.list_of(value)
            case np.ndarray() if value.ndim:
                return self.list_of(value)
            case dict():
                return self._dict_of(value)
        return as_json(value)

    def list_of(self, values: Sequence[Any] | npt.NDArray[Any]) -> list[Any]:
        """Returns the first of some values."""
        shown: list[Any] = []
        for value in values:
            if self.left <= 0:
                return [*shown, _more(len(values) - len(shown))]
            shown.append(self.of(value))
        return shown

    def _dict_of(self, values: dict[Any, Any]) -> dict[str, Any]:
        shown: dict[str, Any] = {}
        for key, value in values.items():
            if self.left <= 0:
                return shown | {"…": _more(len(values) - len(shown))}
            shown[json_key(key)] = self.of(value)
        return shown


def _more(count: int) -> str:
    return f"… ({count:,} more)"
