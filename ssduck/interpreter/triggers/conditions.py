"""When a trigger fires: the terms that it was added on, and which results are told of.

A result that is another one than what was last told of is told of once it has held for long
enough: it has *settled*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args
from weakref import WeakKeyDictionary

from ssduck import validation
from ssduck.errors import ArgumentError, nearest
from ssduck.formatting import short_repr
from ssduck.interpreter.triggers.diff import bag, changed, copied, is_true, likeness, rows_of
from ssduck.world.world import World

When: TypeAlias = Literal["change", "rising", "falling"]


@dataclass(frozen=True)
class TriggerConfig:
    """When a trigger fires, and what it hands over; see `Interpreter.add_trigger`.

    Raises:
        ArgumentError: one of them is none that a trigger can have.
    """

    name: str
    interval: float
    when: When = "change"
    debounce: float = 0.0
    rows: bool = False
    queue: int | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ArgumentError(
                f"add_trigger: name: {short_repr(self.name)} is no name; give a text"
            )
        for name in ("interval", "debounce"):
            seconds = validation.duration(getattr(self, name), f"add_trigger: {name}")
            object.__setattr__(self, name, seconds)  # for good from here on
        if self.when not in get_args(When):
            raise ArgumentError(
                f"add_trigger: when: {short_repr(self.when)} is none of 'change', 'rising', "
                "'falling'",
                suggestions=nearest(self.when, get_args(When)),
            )
        if not isinstance(self.rows, bool):
            raise ArgumentError(f"add_trigger: rows: {short_repr(self.rows)} is not True or False")
        if self.queue is not None:
            kind = "size; 1 or more, or None for none"
            queue = validation.integer(self.queue, "add_trigger: queue", minimum=1, expected=kind)
            object.__setattr__(self, "queue", queue)


class Debouncer:
    """What a callback was last told of, and what it is to be told of once that has held.

    Before the first result there are no rows, nothing is true, and any result is a change.
    """

    def __init__(self, terms: TriggerConfig) -> None:
        self._terms = terms
        self._told_rows: list[Any] = []
        self._settled: Any = None
        if terms.when != "change":
            self._settled = (False,)
        elif terms.rows:
            self._settled = bag([])
        self._next: Any = None
        self._since: WeakKeyDictionary[World, float] | None = None

    def fires(self, result: Any, worlds: Sequence[World]) -> tuple[Any] | None:
        """What is handed over for a result, in a tuple; None if it does not fire.

        Args:
            result: that of the evaluation.
            worlds: those whose time passes.
        """
        if not self._settles(self._compared(result), worlds):
            return None
        if self._terms.when != "change" and self._settled[0] is not (self._terms.when == "rising"):
            return None
        if not self._terms.rows:
            return (copied(result),)
        rows = copied(rows_of(result))
        before, self._told_rows = self._told_rows, rows
        return (changed(before, copied(rows)),)

    def _compared(self, result: Any) -> Any:
        """What is compared with what was told: in a tuple, for None stands for nothing yet."""
        if self._terms.when != "change":
            return (is_true(result),)
        return bag(rows_of(result)) if self._terms.rows else (likeness(result),)

    def _settles(self, value: Any, worlds: Sequence[World]) -> bool:
        """Whether it is another value, and has been so for long enough."""
        if value == self._settled:
            self.unsettle()
            return False
        if self._since is None or value != self._next:
            self._next = value
            self._since = WeakKeyDictionary({world: world.time for world in worlds})
        since = self._since
        held = any(w.reached(since.get(w, w.time) + self._terms.debounce) for w in worlds)
        if held or not self._terms.debounce:
            self._settled = value
            self.unsettle()
            return True
        return False

    def unsettle(self) -> None:
        """Forget what was to be told: it does not hold any more."""
        self._next = self._since = None
