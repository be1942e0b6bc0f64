"""Whether a result is another one than before: what stands for results, and which rows differ.

Results are alike where they are equal, lists and dicts part by part, arrays and data frames
number by number; and a NaN is like a NaN.
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
from ssduck.world.entities import Entity
from ssduck.world.world import World


@dataclass(frozen=True)
class Changed:
    """The rows by which two results differ; a row that is there twice counts twice.

    Attributes:
        added: the rows that came, in the order of the new result.
        removed: the rows that went, in the order of the old one.
    """

    added: list[Any]
    removed: list[Any]

    def __bool__(self) -> bool:
        return bool(self.added or self.removed)


def changed(before: Sequence[Any], now: Sequence[Any]) -> Changed:
    """What has to be added to some rows and removed of them to get others; order aside."""
    return Changed(added=_beyond(now, before), removed=_beyond(before, now))


def _beyond(rows: Sequence[Any], others: Sequence[Any]) -> list[Any]:
    """The rows that are there more often than among others."""
    known = Counter(map(likeness, others))
    found = []
    for row in rows:
        like = likeness(row)
        if known[like]:
            known[like] -= 1
        else:
            found.append(row)
    return found


def rows_of(result: Any) -> list[Any]:
    """The rows of a result: the elements of a list or an array, the rows of a data frame.

    None has no rows; anything else is one row.
    """
    return [] if result is None else list(elements_of(result))


def bag(rows: Sequence[Any]) -> frozenset[tuple[Any, int]]:
    """What stands for some rows, their order aside."""
    return frozenset(Counter(map(likeness, rows)).items())


def is_true(result: Any) -> bool:
    """Whether a result holds: what has rows does if it has any, and a NaN does not."""
    if isinstance(result, np.ndarray | pa.Table | pa.RecordBatch | Result) or _is_frame(result):
        return bool(rows_of(result))
    if isinstance(result, float | np.floating) and np.isnan(result):
        return False
    return bool(result)


def likeness(value: Any) -> Any:
    """What stands for a value among keys: the same for values that are alike."""
    kind = type(value)
    if kind is float:
        return _NAN if value != value else value  # noqa: PLR0124  # which only NaN is not
    if kind in ATOMS or isinstance(value, Entity | World):
        return value
    if kind is list or isinstance(value, tuple):
        return (kind, *map(likeness, value))
    if kind is dict:
        return (dict, frozenset((likeness(key), likeness(part)) for key, part in value.items()))
    if kind is set or kind is frozenset:
        return (frozenset, frozenset(map(likeness, value)))
    if isinstance(value, np.generic):
        return likeness(value.item()) if type(value.item()) in ATOMS else (kind, str(value))
    if isinstance(value, np.ndarray):
        return (np.ndarray, value.shape, _numbers(value))
    if isinstance(value, pa.Table | pa.RecordBatch | Result) or _is_frame(value):
        return (kind, *map(likeness, rows_of(value)))
    if _is_graph(value):
        nodes, edges = dict(value.nodes(data=True)), list(value.edges(data=True))
        return (kind, likeness(nodes), bag(edges))
    return _Other(value)


# Equal to itself, as a NaN is not.
_NAN = ("not a number",)


def _numbers(array: np.ndarray[Any, Any]) -> Any:
    """The numbers of an array; there may be many of them."""
    if array.dtype.kind not in "biufc":
        return likeness(array.tolist())
    if array.dtype.kind in "fc":
        array = array + 0.0  # there is no -0.0, then
        array[np.isnan(array)] = np.nan
    return (array.dtype.str, array.tobytes())


def _is_frame(value: Any) -> bool:
    """Whether it is a data frame, told without importing what may not be installed."""
    kind = type(value)
    is_known = kind.__module__.partition(".")[0] in {"pandas", "polars"}
    return is_known and kind.__name__ == "DataFrame"


def _is_graph(value: Any) -> bool:
    """Whether it is a graph of networkx, in the same way."""
    kind = type(value)
    is_known = kind.__module__.partition(".")[0] == "networkx"
    return is_known and kind.__name__ in {"DiGraph", "MultiDiGraph"}


class _Other:
    """A value of another type: alike if equal to a copy that was made when it was seen."""

    def __init__(self, value: Any) -> None:
        self._value = copied(value)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Other) or type(self._value) is not type(other._value):
            return False
        return self._value is other._value or bool(self._value == other._value)

    def __hash__(self) -> int:
        return hash(type(self._value))


def copied(value: Any) -> Any:
    """A copy that goes on as it is when the value is changed; itself if it cannot be copied."""
    kind = type(value)
    if kind in ATOMS or isinstance(value, Entity | World):
        return value
    if kind is list or kind is tuple or kind is set:
        return kind(map(copied, value))
    if kind is dict:
        return {key: copied(part) for key, part in value.items()}
    try:
        return copy.deepcopy(value)
    except Exception:  # noqa: BLE001  # a user's class may do anything
        return value
