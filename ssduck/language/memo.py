"""Remembers results of users' functions within a query; the functions are pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ssduck.errors import ArgumentError, SourceSpan
from ssduck.language.tree import Placeholder
from ssduck.language.value_keys import ValueKeys, exact_key

# The key of a query's memos in a frame's cache; no program contains this part.
MEMOS = Placeholder(SourceSpan(0, 0), "memos")
# The largest number of results of a function; when it is reached, all are dropped.
MAX_STORED = 10_000
# After TRIAL_CALLS calls, a function with fewer hits than one in _MIN_CALLS_PER_HIT is not cached.
TRIAL_CALLS = 2_000
_MIN_CALLS_PER_HIT = 8


class Memo:
    """A function that remembers its results.

    Arguments are compared exactly: 1, 1.0 and True differ, and so do 0.0 and -0.0. Calls whose
    arguments have no keys are not cached. Identical objects are not compared, because lists do not
    change while a query runs.

    Args:
        call: the function.
        by_identity: whether calls may repeat the same objects; SQL makes new ones for each call.
    """

    def __init__(self, call: Callable[[list[Any]], Any], *, by_identity: bool = True) -> None:
        self._call = call
        self._uses_identity = by_identity
        self._keys = ValueKeys()
        self._by_identity: dict[tuple[int, ...], tuple[Sequence[Any], Any]] = {}
        self._by_key: dict[tuple[Any, ...], Any] = {}
        self._call_count = self._hit_count = 0
        self._is_useful = True

    def __call__(self, arguments: list[Any]) -> Any:
        """Returns the result of the function for these values."""
        if not self._is_useful:
            return self._call(arguments)
        self._call_count += 1
        identity = tuple(map(id, arguments))
        entry = self._by_identity.get(identity)
        if entry is not None:
            self._hit_count += 1
            return entry[1]
        try:
            key = (
                self._keys.exact(arguments)
                if self._uses_identity
                else tuple(map(exact_key, arguments))
            )
        except (ArgumentError, RecursionError):
            return self._call(arguments)
        if key in self._by_key:
            self._hit_count += 1
            value = self._by_key[key]
        else:
            value = self._by_key[key] = self._call(arguments)
        if self._uses_identity:  # it keeps them alive, so that their ids stay theirs
            self._by_identity[identity] = (arguments, value)
        self._tidy()
        return value

    def _tidy(self) -> None:
        if len(self._by_identity) > MAX_STORED or len(self._by_key) > MAX_STORED:
            self._clear()
        if (
            self._call_count == TRIAL_CALLS
            and self._hit_count * _MIN_CALLS_PER_HIT < self._call_count
        ):
            self._is_useful = False
            self._clear()

    def forget(self) -> None:
        """Drops all results, for the next query."""
        self._clear()
        self._call_count = self._hit_count = 0
        self._is_useful = True

    def _clear(self) -> None:
        self._by_identity.clear()
        self._by_key.clear()
        self._keys = ValueKeys()
