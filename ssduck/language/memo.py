"""Remembers results of users' functions within a query; the functions are pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ssduck.errors import ArgumentError, SourceSpan
from ssduck.language.tree import Placeholder
from ssduck.language.value_keys import ValueKeys, exactly

# A frame keeps the memos of a query under this part, which no program has.
MEMOS = Placeholder(SourceSpan(0, 0), "memos")
# So many values are kept of a function; then all are forgotten.
MAX_STORED = 10_000
# After so many calls a function that is hardly ever asked twice alike is not remembered.
TRIED = 2_000
_WORTH = 8


class Memo:
    """A function that remembers its results.

    Values are told apart as exactly as a function could: 1, 1.0 and True differ, and so do 0.0
    and -0.0. Those that cannot be told apart are not remembered. What is the very same object
    as before is not looked into, since lists do not change while a query runs.

    Args:
        call: the function.
        keeps_same: whether the same objects may be given again; SQL makes new ones each time.
    """

    def __init__(self, call: Callable[[list[Any]], Any], *, keeps_same: bool = True) -> None:
        self._call = call
        self._keeps_same = keeps_same
        self._keys = ValueKeys()
        self._same: dict[tuple[int, ...], tuple[Sequence[Any], Any]] = {}
        self._alike: dict[tuple[Any, ...], Any] = {}
        self._asked = self._found = 0
        self._is_worth_it = True

    def __call__(self, arguments: list[Any]) -> Any:
        """Returns the result of the function for these values."""
        if not self._is_worth_it:
            return self._call(arguments)
        self._asked += 1
        same = tuple(map(id, arguments))
        known = self._same.get(same)
        if known is not None:
            self._found += 1
            return known[1]
        try:
            alike = (
                self._keys.exact(arguments) if self._keeps_same else tuple(map(exactly, arguments))
            )
        except (ArgumentError, RecursionError):
            return self._call(arguments)
        if alike in self._alike:
            self._found += 1
            value = self._alike[alike]
        else:
            value = self._alike[alike] = self._call(arguments)
        if self._keeps_same:  # which keeps them, so that no other has their ids
            self._same[same] = (arguments, value)
        self._tidy()
        return value

    def _tidy(self) -> None:
        if len(self._same) > MAX_STORED or len(self._alike) > MAX_STORED:
            self._clear()
        if self._asked == TRIED and self._found * _WORTH < self._asked:
            self._is_worth_it = False
            self._clear()

    def forget(self) -> None:
        """Forgets all results, for the next query."""
        self._clear()
        self._asked = self._found = 0
        self._is_worth_it = True

    def _clear(self) -> None:
        self._same.clear()
        self._alike.clear()
        self._keys = ValueKeys()
