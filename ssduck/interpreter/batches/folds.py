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
from ssduck.language import ast
from ssduck.language.evaluator import Frame
from ssduck.logic.traces import Window
from ssduck.simulators.clock import TIME_TOLERANCE


@dataclass(eq=False)
class ArrayFold:
    """A function of an expression at all ticks until now, in each of n environments."""

    # Adds a tick: from the times (n,), s, the values of the expressions and whether the tick is the
    # first one of an episode, (n,).
    step: Callable[[Array, Sequence[Answers], Flags], None]
    answers: Callable[[], Answers]  # returns the values of the function


def fold_of(call: ast.Call, frame: Frame) -> ArrayFold:
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


class _Ticks:
    """The ticks that an operator may still look at, the first one first, of n environments."""

    def __init__(self, count: int) -> None:
        bounds = (np.float64, (2, count))
        kind = [
            ("times", np.float64, (count,)),  # s
            ("held", *bounds),  # the bounds of the margin of the condition that is to hold
            ("starts", *bounds),  # the bounds of that of its start
            ("x", *bounds),  # the margin without a window
            # Where it is a tick of the present episode, and no later one has its time.
            ("is_there", np.bool_, (count,)),
        ]
        self._names = [name for name, *_ in kind]
        self._room = np.zeros(16, kind)
        self._first = self._end = 0

    def __len__(self) -> int:
        return self._end - self._first

    def __getitem__(self, name: str) -> Array:
        """Returns a column of the k ticks, (k, n) or (k, 2, n)."""
        return self._room[name][self._first : self._end]

    def add(self, *values: Array | bool) -> None:
        """Adds a tick, with a value of each column."""
        if self._end == len(self._room):
            kept = self._room[self._first :]
            self._room = np.concatenate((kept, np.zeros_like(kept), np.zeros(1, kept.dtype)))
            self._first, self._end = 0, len(kept)
        for name, value in zip(self._names, values, strict=True):
            self._room[name][self._end] = value
        self._end += 1

    def drop_first(self) -> None:
        self._first += 1


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
        has_begun = first + window.start <= now + TIME_TOLERANCE
        # If it has not, it may begin with this tick, if the next one comes after that.
        found = np.stack((np.where(has_begun, at_begin[0], -np.inf), at_begin[1]))
        found = np.maximum(found, later)
        may_come = first + window.end > now + TIME_TOLERANCE
        found[1] = np.where(may_come, np.maximum(found[1], held[1]), found[1])
        return self._answers(found)


class LookingBack(_Operator):
    """An operator of temporal logic at earlier ticks, in each of n environments.

    It is computed as in `ssduck.logic.stepwise`.
    """

    _x_before: Array  # the margin without a window at the tick before the last one, (2, n)

    def __init__(self, window: Window, form: TemporalFunction) -> None:
        super().__init__(window, form)
        self._ticks = _Ticks(0)
        self._largest = np.zeros((2, 0))  # of starts that have left the ticks

    def step(self, times: Array, values: Sequence[Answers], are_first: Flags) -> None:
        """Adds a tick; see `ArrayFold`."""
        bounds = [self._bounds(answers) for answers in values]
        starts = bounds[-1]
        held = bounds[0] if len(bounds) == 2 else np.full_like(starts, np.inf)
        never = np.full_like(starts, -np.inf)
        before, ticks = never, self._ticks
        if len(ticks):
            is_there = ticks["is_there"]
            is_again = is_there[-1] & (times == ticks["times"][-1])
            before = np.where(are_first, never, np.where(is_again, self._x_before, ticks["x"][-1]))
            is_there[-1] &= ~is_again
            if are_first.any():
                is_there &= ~are_first
        else:
            ticks = self._ticks = _Ticks(len(times))
            self._largest = never
        ticks.add(times, held, starts, np.maximum(starts, np.minimum(held, before)), True)
        self._x_before = before
        self._largest = np.where(are_first, never, self._largest)
        self._drop(times)

    def _drop(self, times: Array) -> None:
        """Drops the ticks at which no window looks any more, but for the largest start."""
        begin, end = self._ends(times)
        is_endless, ticks = np.isinf(self._window.end), self._ticks
        while len(ticks) > 1:
            is_behind = ticks["times"][1] <= (end if is_endless else begin)
            is_there = ticks["is_there"][0]
            if not (is_behind | ~is_there).all():
                break
            if is_endless:
                starts = np.where(is_there, ticks["starts"][0], -np.inf)
                self._largest = np.maximum(self._largest, starts)
            ticks.drop_first()

    def _ends(self, now: Array) -> tuple[Array, Array]:
        window, time = self._window, now + TIME_TOLERANCE
        return time - window.end, time - window.start

    def answers(self) -> Answers:
        """Returns the values of the operator."""
        ticks = self._ticks
        times, is_there = ticks["times"], ticks["is_there"]
        begin, end = self._ends(times[-1])
        is_later = is_there & (times > end)
        is_in = is_there & ~is_later
        held = np.full_like(self._largest, np.inf)
        if is_later.any():
            held = np.min(ticks["held"], axis=0, where=is_later[:, None], initial=np.inf)
        # That of the last tick in the window.
        last = len(times) - 1 - np.argmax(is_in[::-1], axis=0)
        x = np.take_along_axis(ticks["x"], last[None, None], axis=0)[0]
        x = np.where(is_in.any(axis=0), x, -np.inf)
        # A tick counts until the next one comes.
        ends = np.full_like(times, np.inf)
        known = np.where(is_there, times, np.inf)
        ends[:-1] = np.minimum.accumulate(known[::-1])[::-1][1:]
        looks = is_in & (ends > begin)
        starts = np.max(ticks["starts"], axis=0, where=looks[:, None], initial=-np.inf)
        largest = np.maximum(self._largest, starts)
        return self._answers(np.minimum(np.minimum(largest, held), x))
