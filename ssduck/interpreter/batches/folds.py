"""Functions of time over environments: a state for each, to which each tick adds the next value.

They are those of `ssduck.interpreter.over_time.functions` without an age, from the first tick of an
episode at which they were asked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ssduck.columns.arrays import Array
from ssduck.errors import UnsupportedError
from ssduck.geometry.arrays import Flags
from ssduck.interpreter.batches.expressions import Answers
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS, TemporalFunction
from ssduck.interpreter.over_time.nested import window_of
from ssduck.language.evaluator import Frame
from ssduck.language.tree import Call
from ssduck.logic.traces import Window
from ssduck.simulators.clock import TIME_TOLERANCE


@dataclass(eq=False)
class ArrayFold:
    """A function of an expression at all ticks until now, in each of n environments."""

    # Adds a tick: from the times (n,), s, the values of the expressions and whether the tick is the
    # first one of an episode, (n,).
    step: Callable[[Array, Sequence[Answers], Flags], None]
    answers: Callable[[], Answers]  # returns the values of the function


def fold_of(call: Call, frame: Frame) -> ArrayFold:
    """Returns a function of time without a state."""
    name, form = call.name, TEMPORAL_FUNCTIONS[call.name]
    if form.operator is not None:
        kind = FromFirst if form.looks_ahead else LookingBack
        held = kind(window_of(call, frame), form)
        return ArrayFold(held.step, held.answers)
    match name:
        case "since" | "heldFor":
            since = _Since()
            return ArrayFold(since.step, since.since if name == "since" else since.duration)
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
        "lifted, previous, rate, least, greatest and the operators of temporal logic keep what "
        "they need",
        span=call.span,
    )


@dataclass(eq=False)
class _Since:
    """Since when a condition has held: NaN where it does not hold now."""

    start: Array = field(default_factory=lambda: np.zeros(0))
    time: Array = field(default_factory=lambda: np.zeros(0))

    def step(self, times: Array, values: Sequence[Answers], are_first: Flags) -> None:
        (answers,) = values
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

    def step(self, times: Array, values: Sequence[Answers], are_first: Flags) -> None:
        (answers,) = values
        del times
        self.value = _chosen(are_first, answers, self.value)


@dataclass(eq=False)
class _LastTwo:
    """The values at the last tick and at the one before, which has an earlier time."""

    before: Answers = field(default_factory=lambda: Answers(np.zeros(0), np.zeros(0, np.bool_)))
    now: Answers = field(default_factory=lambda: Answers(np.zeros(0), np.zeros(0, np.bool_)))
    seconds: Array = field(default_factory=lambda: np.zeros(0))
    time: Array = field(default_factory=lambda: np.zeros(0))

    def step(self, times: Array, values: Sequence[Answers], are_first: Flags) -> None:
        (answers,) = values
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

    def step(self, times: Array, values: Sequence[Answers], are_first: Flags) -> None:
        (answers,) = values
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


@dataclass(eq=False)
class _Tick:
    """A tick that an operator may still look at."""

    times: Array  # (n,), s
    held: Array  # the bounds of the margin of the condition that is to hold, (2, n)
    starts: Array  # the bounds of that of its start, (2, n)
    x: Array  # the margin without a window, (2, n)
    x_before: Array  # that of the tick before, (2, n)
    # Where it is a tick of the present episode, and no later one has its time, (n,).
    is_there: Flags


class _Operator:
    """An operator of temporal logic in each of n environments."""

    def __init__(self, window: Window, form: TemporalFunction) -> None:
        self._window, self._form = window, form
        self._sign = -1.0 if form.takes_least else 1.0

    def _bounds(self, answers: Answers) -> Array:
        """Returns the bounds of the margins of a condition, (2, n)."""
        values = answers.values
        margins = values if self._form.of_margins else np.where(values.astype(np.bool_), 1.0, -1.0)
        margins = self._sign * margins.astype(np.float64)
        low, high = (np.where(answers.unknown, end, margins) for end in (-np.inf, np.inf))
        return np.stack((low, high))

    def _answers(self, margins: Array) -> Answers:
        bounds = self._sign * margins
        low, high = bounds if self._form.of_margins else bounds > 0.0
        return Answers(low, low != high)


class FromFirst(_Operator):
    """An operator that looks ahead from the first tick; see `UntilFromFirst` of `ssduck.logic`."""

    # The times of the first and of the last tick, and the bounds of `held`, `at_begin` and `later`.
    _BLANK = np.array([[np.nan], [np.nan], [np.inf], [np.inf], *[[-np.inf]] * 4])
    _before = _state = _BLANK  # at the tick before, which has an earlier time, and at the last one

    def step(self, times: Array, values: Sequence[Answers], are_first: Flags) -> None:
        """Adds a tick; see `ArrayFold`."""
        bounds = [self._bounds(answers) for answers in values]
        values_now = bounds[0] if len(bounds) == 2 else np.inf
        before = np.where(times == self._state[1], self._before, self._state)
        before = self._before = np.where(are_first, self._BLANK, before)
        first = np.where(np.isnan(before[0]), times, before[0])
        x = np.minimum(bounds[-1], before[2:4])
        begin, end = self._ends(first)
        later = np.maximum(before[4:6], np.where(times <= end, x, -np.inf))
        at_begin = np.where(times <= begin, x, -np.inf)
        later = np.where(times <= begin, before[6:], np.maximum(before[6:], later))
        self._state = np.stack(
            [first, times, *np.minimum(before[2:4], values_now), *at_begin, *later]
        )

    def _ends(self, first: Array) -> tuple[Array, Array]:
        """Returns the times at which the windows begin and end."""
        window, start = self._window, first + TIME_TOLERANCE
        return start + window.start, start + window.end

    def answers(self) -> Answers:
        """Returns the values of the operator."""
        first, now, *bounds = self._state
        held, at_begin, later = np.array(bounds).reshape(3, 2, -1)
        window = self._window
        found = np.where(first + window.start <= now + TIME_TOLERANCE, at_begin, -np.inf)
        found = np.maximum(found, later)
        may_come = first + window.end > now + TIME_TOLERANCE
        found[1] = np.where(may_come, np.maximum(found[1], held[1]), found[1])
        return self._answers(found)


class LookingBack(_Operator):
    """An operator of temporal logic at earlier ticks, in each of n environments.

    It is computed as in `ssduck.logic.stepwise`.
    """

    def __init__(self, window: Window, form: TemporalFunction) -> None:
        super().__init__(window, form)
        self._ticks: list[_Tick] = []
        self._largest: Array | None = None  # of starts that have left `_ticks`, (2, n)

    def step(self, times: Array, values: Sequence[Answers], are_first: Flags) -> None:
        """Adds a tick; see `ArrayFold`."""
        bounds = [self._bounds(answers) for answers in values]
        starts = bounds[-1]
        held = bounds[0] if len(bounds) == 2 else np.full_like(starts, np.inf)
        never = np.full_like(starts, -np.inf)
        before = never
        if self._ticks:
            last = self._ticks[-1]
            is_again = last.is_there & (times == last.times)
            before = np.where(are_first, never, np.where(is_again, last.x_before, last.x))
            last.is_there = last.is_there & ~is_again
        for tick in self._ticks:
            tick.is_there = tick.is_there & ~are_first
        x = np.maximum(starts, np.minimum(held, before))
        here = np.ones(len(times), np.bool_)
        self._ticks.append(_Tick(times, held, starts, x, before, here))
        largest = never if self._largest is None else self._largest
        self._largest = np.where(are_first, never, largest)
        self._drop(times)

    def _drop(self, times: Array) -> None:
        """Drops the ticks at which no window looks any more, but for the largest start."""
        end = times - self._window.start + TIME_TOLERANCE
        begin = times - self._window.end + TIME_TOLERANCE
        while len(self._ticks) > 1:
            first, second = self._ticks[:2]
            is_behind = second.times <= (end if np.isinf(self._window.end) else begin)
            if not (is_behind | ~first.is_there).all():
                break
            assert self._largest is not None
            starts = np.where(first.is_there, first.starts, -np.inf)
            if np.isinf(self._window.end):
                self._largest = np.maximum(self._largest, starts)
            del self._ticks[0]

    def answers(self) -> Answers:
        """Returns the values of the operator."""
        assert self._largest is not None
        now = self._ticks[-1].times
        end = now - self._window.start + TIME_TOLERANCE
        begin = now - self._window.end + TIME_TOLERANCE
        result, x = self._largest, np.full_like(self._largest, -np.inf)
        held = np.full_like(self._largest, np.inf)
        following, has_end = np.full(len(now), np.inf), np.zeros(len(now), np.bool_)
        for tick in reversed(self._ticks):
            is_later = tick.is_there & (tick.times > end)
            held = np.where(is_later, np.minimum(held, tick.held), held)
            is_in = tick.is_there & ~is_later
            x = np.where(is_in & ~has_end, tick.x, x)
            has_end |= is_in
            looks = is_in & (following > begin)
            result = np.where(looks, np.maximum(result, tick.starts), result)
            following = np.where(tick.is_there, tick.times, following)
        return self._answers(np.minimum(np.minimum(result, held), x))
