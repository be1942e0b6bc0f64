"""Compares results: keys that are equal for equal results, and the rows in which results differ.

Lists and dicts are compared part by part, arrays and data frames number by number; NaN equals NaN.
"""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from ssduck.adapters.result import Result
from ssduck.interpreter.sources import elements_of
from ssduck.language.value_keys import ATOMS
from ssduck.world.handles import Handle
from ssduck.world.world import World


@dataclass(frozen=True)
class Changed:
    """The rows in which two results differ; a row that occurs twice counts twice.

    Attributes:
        added: the new rows, in the order of the new result.
        removed: the rows that are gone, in the order of the old result.
    """

    added: list[Any]
    removed: list[Any]

    def __bool__(self) -> bool:
        return bool(self.added or self.removed)


def difference(before: Sequence[Any], now: Sequence[Any]) -> Changed:
    """Returns the rows to add and to remove to get from one result to another.

    >>> difference([1, 2, 2], [2, 3])
    Changed(added=[3], removed=[1, 2])
    """
    return Changed(added=_surplus(now, before), removed=_surplus(before, now))


def _surplus(rows: Sequence[Any], others: Sequence[Any]) -> list[Any]:
    """Returns the rows that occur more often than among others."""
    counts = Counter(map(canonical_key, others))
    surplus = []
    for row in rows:
        key = canonical_key(row)
        if counts[key]:
            counts[key] -= 1
        else:
            surplus.append(row)
    return surplus


def rows_of(result: Any) -> list[Any]:
    """Returns the rows of a result: the elements of a list or an array, the rows of a data frame.

    None has no rows; any other value is one row.
    """
    return [] if result is None else list(elements_of(result))


def multiset(rows: Sequence[Any]) -> frozenset[tuple[Any, int]]:
    """Returns a key of rows in which their order does not matter."""
    return frozenset(Counter(map(canonical_key, rows)).items())


def is_true(result: Any) -> bool:
    """Checks whether a result is true; rows are if there are any, NaN is not."""
    if isinstance(result, np.ndarray | pa.Table | pa.RecordBatch | Result) or _is_data_frame(
        result
    ):
        return bool(rows_of(result))
    if isinstance(result, float | np.floating) and np.isnan(result):
        return False
    return bool(result)


def canonical_key(value: Any) -> Any:
    """Returns a hashable key of a value, the same for equal values.

    >>> canonical_key([float("nan")]) == canonical_key([float("nan")])
    True
    """
    kind = type(value)
    if kind is float:
        return _NAN if value != value else value  # noqa: PLR0124  # only NaN differs from itself
    if kind in ATOMS or isinstance(value, Handle | World):
        return value
    if kind is list or isinstance(value, tuple):
        return (kind, *map(canonical_key, value))
    if kind is dict:
        return (dict, frozenset(map(_item_key, value.items())))
    if kind is set or kind is frozenset:
        return (frozenset, frozenset(map(canonical_key, value)))
    if isinstance(value, np.generic):
        return canonical_key(value.item()) if type(value.item()) in ATOMS else (kind, str(value))
    if isinstance(value, np.ndarray):
        return (np.ndarray, value.shape, _array_key(value))
    if isinstance(value, pa.Table | pa.RecordBatch | Result) or _is_data_frame(value):
        return (kind, *map(canonical_key, rows_of(value)))
    if _is_graph(value):
        nodes, edges = dict(value.nodes(data=True)), list(value.edges(data=True))
        return (kind, canonical_key(nodes), multiset(edges))
    return _CopiedValue(value)


def _item_key(item: tuple[Any, Any]) -> tuple[Any, Any]:
    """Returns the key of an item of a dict."""
    key, part = item
    if type(key) is str and type(part) is float and part == part:  # noqa: PLR0124  # not NaN
        return item  # the most frequent one
    return canonical_key(key), canonical_key(part)


# The key of NaN, which does not equal itself.
_NAN = ("not a number",)


def _array_key(array: np.ndarray[Any, Any]) -> Any:
    """Returns the key of an array's numbers; there may be many."""
    if array.dtype.kind not in "biufc":
        return canonical_key(array.tolist())
    if array.dtype.kind in "fc":
        array = array + 0.0  # -0.0 becomes 0.0
        array[np.isnan(array)] = np.nan
    return (array.dtype.str, array.tobytes())


def _is_data_frame(value: Any) -> bool:
    """Checks whether a value is a data frame, without importing its library."""
    kind = type(value)
    is_library = kind.__module__.partition(".")[0] in {"pandas", "polars"}
    return is_library and kind.__name__ == "DataFrame"


def _is_graph(value: Any) -> bool:
    """Checks whether a value is a graph of networkx, without importing it."""
    names = {(base.__module__.partition(".")[0], base.__name__) for base in type(value).__mro__}
    return bool(names & {("networkx", "DiGraph"), ("networkx", "MultiDiGraph")})


class _CopiedValue:
    """The key of any other value: a copy of it, compared by `==`."""

    def __init__(self, value: Any) -> None:
        self._value = copy_of(value)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _CopiedValue) or type(self._value) is not type(other._value):
            return False
        return self._value is other._value or bool(self._value == other._value)

    def __hash__(self) -> int:
        return hash(type(self._value))


def copy_of(value: Any) -> Any:
    """Returns a copy that is independent of the value; the value if it cannot be copied."""
    kind = type(value)
    if kind in ATOMS or isinstance(value, Handle | World):
        return value
    # Most parts are atoms, and a call for each of them would take most of the time.
    if kind is list:
        return [part if type(part) in ATOMS else copy_of(part) for part in value]
    if kind is dict:
        return {k: part if type(part) in ATOMS else copy_of(part) for k, part in value.items()}
    if kind is tuple or kind is set:
        return kind(map(copy_of, value))
    try:
        return copy.deepcopy(value)
    except Exception:  # noqa: BLE001  # a user's class may do anything
        return value
