"""Decides when a trigger fires: its configuration, and which results count as new.

A result that differs from the last one delivered counts when it has held for the debounce
time: then it has *settled*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args
from weakref import WeakKeyDictionary

from ssduck import validation
from ssduck.errors import ArgumentError, nearest
from ssduck.formatting import short_repr
from ssduck.interpreter.triggers.diff import (
    canonical_key,
    copy_of,
    difference,
    is_true,
    multiset,
    rows_of,
)
from ssduck.world.world import World

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

    Attributes:
        is_steady: whether the last result equals the one that was last delivered, so that the
            same result again changes nothing.
    """

    def __init__(self, config: TriggerConfig) -> None:
        self._config = config
        self._delivered_rows: list[Any] = []
        self._settled = _before_the_first(config)
        self._candidate: Any = None
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
