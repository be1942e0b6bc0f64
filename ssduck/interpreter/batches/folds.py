"""Functions of time over environments: a state for each, to which each tick adds the next value.

They are those of `ssduck.interpreter.over_time.functions` without an age, from the first tick of an
episode at which they were asked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ssduck.columns.arrays import Array
from ssduck.errors import UnsupportedError
from ssduck.geometry.arrays import Flags
from ssduck.interpreter.batches.expressions import Answers


@dataclass(eq=False)
class ArrayFold:
    """A function of an expression at all ticks until now, in each of n environments."""

    # Adds a tick: from the times (n,), s, the values of the expression and whether the tick is the
    # first one of an episode, (n,).
    step: Callable[[Array, Answers, Flags], None]
    answers: Callable[[], Answers]  # returns the values of the function


def fold_of(name: str) -> ArrayFold:
    """Returns a function of time without a state."""
    match name:
        case "since" | "heldFor":
            held = _Since()
            return ArrayFold(held.step, held.since if name == "since" else held.duration)
        case "initially":
            first = _First()
            return ArrayFold(first.step, lambda: first.value)
        case "previous" | "rate":
            last = _LastTwo()
            return ArrayFold(last.step, last.previous if name == "previous" else last.rate)
        case "least" | "greatest":
            extreme = _Extreme(np.less if name == "least" else np.greater)
            return ArrayFold(extreme.step, extreme.answers)
    raise UnsupportedError(
        f"{name} needs all past ticks, and a batch keeps none of them: heldFor, since, initially, "
        "lifted, previous, rate, least and greatest keep what they need"
    )


@dataclass(eq=False)
class _Since:
    """Since when a condition has held: NaN where it does not hold now."""

    start: Array = field(default_factory=lambda: np.zeros(0))
    time: Array = field(default_factory=lambda: np.zeros(0))

    def step(self, times: Array, answers: Answers, are_first: Flags) -> None:
        holds = answers.values.astype(np.bool_) & ~answers.unknown
        before = self.start if len(self.start) else np.full(len(times), np.nan)
        begins = are_first | np.isnan(before)
        self.start = np.where(holds, np.where(begins, times, before), np.nan)
        self.time = times

    def since(self) -> Answers:
        return Answers(self.start, np.isnan(self.start))

    def duration(self) -> Answers:
        held = np.where(np.isnan(self.start), 0.0, self.time - self.start)
        return Answers(held, np.zeros(len(held), np.bool_))


@dataclass(eq=False)
class _First:
    """The value at the first tick of the episode."""

    value: Answers = field(default_factory=lambda: Answers(np.zeros(0), np.zeros(0, np.bool_)))

    def step(self, times: Array, answers: Answers, are_first: Flags) -> None:
        del times
        self.value = _chosen(are_first, answers, self.value)


@dataclass(eq=False)
class _LastTwo:
    """The values at the last tick and at the one before, which has an earlier time."""

    before: Answers = field(default_factory=lambda: Answers(np.zeros(0), np.zeros(0, np.bool_)))
    now: Answers = field(default_factory=lambda: Answers(np.zeros(0), np.zeros(0, np.bool_)))
    seconds: Array = field(default_factory=lambda: np.zeros(0))
    time: Array = field(default_factory=lambda: np.zeros(0))

    def step(self, times: Array, answers: Answers, are_first: Flags) -> None:
        if not len(self.time):
            self.time, self.seconds = times, np.zeros(len(times))
        is_later = ~are_first & (times > self.time)
        self.before = _chosen(are_first, answers, _chosen(is_later, self.now, self.before))
        passed = np.where(is_later, times - self.time, self.seconds)
        self.seconds = np.where(are_first, 0.0, passed)
        self.now, self.time = answers, times

    def previous(self) -> Answers:
        return self.before

    def rate(self) -> Answers:
        change = self.now.values - self.before.values
        seconds = np.where(self.seconds > 0.0, self.seconds, 1.0)
        rates = change / (seconds if change.ndim == 1 else seconds[:, None])
        return Answers(rates, self.before.unknown | self.now.unknown)


@dataclass(eq=False)
class _Extreme:
    """The time and the value of the first of the extreme values, (n, 2)."""

    is_further: Callable[[Array, Array], Flags]
    found: Array = field(default_factory=lambda: np.zeros((0, 2)))

    def step(self, times: Array, answers: Answers, are_first: Flags) -> None:
        if not len(self.found):
            self.found = np.full((len(times), 2), np.nan)
        self.found = np.where(are_first[:, None], np.nan, self.found)
        is_number = ~(answers.unknown | np.isnan(answers.values))
        with np.errstate(invalid="ignore"):
            is_next = self.is_further(answers.values, self.found[:, 1])
        is_next = is_number & (is_next | np.isnan(self.found[:, 1]))
        entries = np.stack((times, answers.values.astype(np.float64)), axis=1)
        self.found = np.where(is_next[:, None], entries, self.found)

    def answers(self) -> Answers:
        return Answers(self.found, np.isnan(self.found[:, 1]))


def _chosen(are_chosen: Flags, new: Answers, old: Answers) -> Answers:
    """Returns new values where they are chosen, and old ones elsewhere."""
    if not len(old.unknown):
        return new
    if not len(new.unknown):
        return old
    condition = are_chosen if new.values.ndim == 1 else are_chosen[:, None]
    return Answers(
        np.where(condition, new.values, old.values), np.where(are_chosen, new.unknown, old.unknown)
    )
