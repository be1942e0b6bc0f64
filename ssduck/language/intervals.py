"""Intervals of simulated time during which something holds, and their relations.

A condition that holds at a tick is assumed to hold until the next one. So an interval [start, end]
begins at the first tick at which the condition holds, and ends at the first one at which it does
not, or at the last tick. Two intervals meet if one ends at the tick at which the other begins.

The relations are those of Allen, "Maintaining knowledge about temporal intervals", 1983.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr
from ssduck.language.builtins import Function

Interval: TypeAlias = list[float]


def intervals_of(times: npt.ArrayLike, holding: npt.ArrayLike) -> list[Interval]:
    """Returns the maximal intervals during which something held, in order.

    >>> intervals_of([0.0, 0.5, 1.0, 1.5], [True, True, False, True])
    [[0.0, 1.0], [1.5, 1.5]]

    Args:
        times: the times of the n recorded ticks, s, (n,).
        holding: whether the condition held at each tick, (n,).
    """
    ends = np.flatnonzero(np.diff(np.asarray(holding, np.bool_), prepend=False, append=False))
    # At the last tick it still holds.
    points = np.asarray(times)
    result: list[Interval] = points[np.minimum(ends, len(points) - 1)].reshape(-1, 2).tolist()
    return result


def column_of(values: Iterable[Any]) -> npt.NDArray[Any]:
    """Returns values as an array of objects, in which lists are values, too."""
    return np.fromiter(values, dtype=object)


def changes_of(times: npt.NDArray[Any], values: npt.NDArray[Any]) -> list[list[Any]]:
    """Returns the list [time, value] at the first tick, and at each tick where the value changes.

    >>> changes_of(np.array([0.0, 0.5, 1.0]), column_of(["on", "on", "off"]))
    [[0.0, 'on'], [1.0, 'off']]

    Args:
        times: the times of the n recorded ticks, s, (n,).
        values: the values at these, (n,); masked, or None of objects, where there is none.
    """
    data, unknown = np.ma.getdata(values), np.ma.getmaskarray(values)
    if data.dtype == np.object_:
        pairs = pairwise(values.tolist())
        changed = np.fromiter((not _same(*pair) for pair in pairs), np.bool_)
    else:
        is_other = (data[1:] != data[:-1]) & ((data[1:] == data[1:]) | (data[:-1] == data[:-1]))
        changed = np.where(unknown[1:] | unknown[:-1], unknown[1:] != unknown[:-1], is_other)
    places = np.flatnonzero(np.concatenate((np.ones(len(data[:1]), np.bool_), changed)))
    return list(map(list, zip(times[places].tolist(), values[places].tolist(), strict=True)))


def _same(a: Any, b: Any) -> bool:
    is_nan = a != a and b != b  # noqa: PLR0124  # NaN has not changed
    return type(a) is type(b) and (is_nan or bool(a == b))


def _ends(value: Any) -> tuple[float, float]:
    match value:
        case [int() | float() as start, int() | float() as end] if start <= end:
            return start, end
    raise ArgumentError(f"an interval is [start, end] in seconds, not {short_repr(value)}")


@dataclass(frozen=True)
class Allen:
    """A relation of two intervals."""

    name: str  # its name in the language and in SQL
    # A function that checks whether it holds of [a, b] and [c, d].
    holds: Callable[[float, float, float, float], bool]
    formula: str  # the same in DuckDB's SQL, for the lists a and b
    about: str  # its meaning

    @property
    def function(self) -> Function:
        """The relation as a function of the language."""
        help_text = f"{self.about}\nUsage: {self.name}(a, b) -> bool"
        return Function(
            self.name, lambda a, b: self.holds(*_ends(a), *_ends(b)), help_text, 2, 2, builtin=True
        )


_LISTED = (
    Allen(
        "before",
        lambda _a, b, c, _d: b < c,
        "a[2] < b[1]",
        "Checks if an interval a = [start, end], in seconds, ends before b begins.",
    ),
    Allen(
        "meets",
        lambda _a, b, c, _d: b == c,
        "a[2] = b[1]",
        "Checks if an interval a = [start, end], in seconds, ends when b begins.",
    ),
    Allen(
        "overlaps",
        lambda a, b, c, d: a < c < b < d,
        "a[1] < b[1] AND b[1] < a[2] AND a[2] < b[2]",
        "Checks if an interval a = [start, end], in seconds, begins before b and ends inside b.",
    ),
    Allen(
        "during",
        lambda a, b, c, d: c < a and b < d,
        "b[1] < a[1] AND a[2] < b[2]",
        "Checks if an interval a = [start, end], in seconds, begins after b begins and ends "
        "before b ends.",
    ),
)

# `overlaps` is also a relation of entities; the arguments decide which is meant.
RELATIONS_OF_INTERVALS: dict[str, Allen] = {allen.name: allen for allen in _LISTED}

# The maximal intervals of a table or view with columns `time` and `holds` and a row for each tick.
INTERVALS = """
    WITH ticks AS (
        SELECT time, coalesce(holds, FALSE) AS held, lead(time) OVER (ORDER BY time) AS following,
            max(time) OVER () AS latest
        FROM query_table(source)
    ), islands AS (
        SELECT *, sum((NOT held)::INTEGER) OVER (ORDER BY time) AS island FROM ticks
    )
    SELECT min(time) AS "start", max(coalesce(following, latest)) AS "end",
        bool_or(following IS NULL) AS still
    FROM islands WHERE held GROUP BY island ORDER BY 1
"""
ABOUT_INTERVALS = (
    "A row is a maximal interval, in seconds, during which a condition held, from a table or view "
    "with the columns time and holds and a row for each tick."
)


def are_intervals(values: Sequence[Any]) -> bool:
    """Checks whether two values are intervals: lists of two numbers, not entities."""
    return len(values) == 2 and all(isinstance(v, list) and len(v) == 2 for v in values)
