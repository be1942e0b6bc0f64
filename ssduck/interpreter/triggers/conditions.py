"""Decides when a trigger fires: its configuration, and which results count as new.

A result that differs from the last one delivered counts when it has held for the debounce time:
then it has *settled*. Lists and dicts are compared part by part, arrays and data frames number by
number; NaN equals NaN.
"""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args
from weakref import WeakKeyDictionary

import numpy as np

from ssduck import validation
from ssduck.adapters.result import is_table
from ssduck.errors import ArgumentError, nearest
from ssduck.formatting import short_repr
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
    if isinstance(result, np.ndarray) or is_table(result):
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
    if is_table(value):
        return (kind, *map(canonical_key, rows_of(value)))
    if _is_graph(value):
        nodes, edges = dict(value.nodes(data=True)), list(value.edges(data=True))
        return (kind, canonical_key(nodes), multiset(edges))
    return _CopiedValue(value)


def _item_key(item: tuple[Any, Any]) -> tuple[Any, Any]:
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


When: TypeAlias = Literal["change", "rising", "falling"]


@dataclass(frozen=True)
class TriggerConfig:
    """When a trigger fires, and what its callback gets; see `Interpreter.add_trigger`.

    Raises:
        ArgumentError: a value is wrong.
    """

    name: str
    interval: float
    when: When = "change"
    debounce: float = 0.0
    rows: bool = False
    queue: int | None = None
    threshold: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ArgumentError(
                f"add_trigger: name: {short_repr(self.name)} is not a non-empty text"
            )
        for name in ("interval", "debounce"):
            seconds = validation.duration(getattr(self, name), f"add_trigger: {name}")
            object.__setattr__(self, name, seconds)
        threshold = validation.finite_number(self.threshold, "add_trigger: threshold", "metres")
        if threshold < 0:
            raise ArgumentError(f"add_trigger: threshold: {threshold:g} is less than 0")
        object.__setattr__(self, "threshold", threshold)
        if self.when not in get_args(When):
            raise ArgumentError(
                f"add_trigger: when: {short_repr(self.when)} is none of 'change', 'rising', "
                "'falling'",
                suggestions=nearest(self.when, get_args(When)),
            )
        if not isinstance(self.rows, bool):
            raise ArgumentError(f"add_trigger: rows: {short_repr(self.rows)} is not True or False")
        if self.queue is not None:
            expected = "size; 1 or more, or None for none"
            queue = validation.integer(
                self.queue, "add_trigger: queue", minimum=1, expected=expected
            )
            object.__setattr__(self, "queue", queue)


class Debouncer:
    """Holds the result that was last delivered, and the one that is about to settle.

    Before the first result there are no rows, the result is false, and any result is a change.
    """

    def __init__(self, config: TriggerConfig) -> None:
        self._config = config
        self._delivered_rows: list[Any] = []
        self._settled = _before_the_first(config)
        self._candidate: Any = None
        # Whether the last result equals the one that was last delivered, so that the same result
        # again changes nothing.
        self.is_steady = False
        self._candidate_since: WeakKeyDictionary[World, float] | None = None

    def fires(self, result: Any, worlds: Sequence[World]) -> tuple[Any] | None:
        """Returns the value to deliver for a result, in a tuple; None if it does not fire."""
        if not self._settles(self._compared(result), worlds):
            return None
        if self._config.when != "change" and self._settled[0] is not (
            self._config.when == "rising"
        ):
            return None
        if not self._config.rows:
            return (copy_of(result),)
        rows = copy_of(rows_of(result))
        before, self._delivered_rows = self._delivered_rows, rows
        return (difference(before, copy_of(rows)),)

    def _compared(self, result: Any) -> Any:
        """Returns the key that is compared, in a tuple, as None stands for no result."""
        if self._config.when != "change":
            return (is_true(result),)
        return multiset(rows_of(result)) if self._config.rows else (canonical_key(result),)

    def _settles(self, value: Any, worlds: Sequence[World]) -> bool:
        """Checks whether a key is new and has held for the debounce time."""
        if value == self._settled:
            self.reset()
            self.is_steady = True
            return False
        self.is_steady = False
        if self._config.debounce and not self._has_held(value, worlds):
            return False
        self._settled = value
        self.reset()
        self.is_steady = True
        return True

    def _has_held(self, value: Any, worlds: Sequence[World]) -> bool:
        """Checks whether a new key has held for the debounce time."""
        if self._candidate_since is None or value != self._candidate:
            self._candidate = value
            self._candidate_since = WeakKeyDictionary({world: world.time for world in worlds})
        since = self._candidate_since
        return any(w.reached(since.get(w, w.time) + self._config.debounce) for w in worlds)

    def begin_episode(self) -> None:
        """Takes the next result for the first one; rows still differ from those delivered last."""
        self.reset()
        if self._config.when != "change" or not self._config.rows:
            self._settled = _before_the_first(self._config)

    def reset(self) -> None:
        """Forgets the result that was about to settle."""
        self._candidate = self._candidate_since = None
        self.is_steady = False


def _before_the_first(config: TriggerConfig) -> Any:
    """Returns the key that stands for the state before the first result."""
    if config.when != "change":
        return (False,)
    return multiset([]) if config.rows else None
