"""Variables with a history: `name{5.0} = …` keeps values, `name{…}` reads them.

A history is the values of a variable with the simulated times at which they were assigned,
oldest first. It is never changed: a program that fails leaves the one that was there before.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

from ssduck import validation
from ssduck.errors import ArgumentError, EvaluationError
from ssduck.formatting import short_repr
from ssduck.language.deferred import LazyList

# Simulated times are products of a step and rounded: so near to each other, in seconds, two are
# one. 0.7 s is the 168th step of 1/240 s.
SAME_TIME = 1e-9


@dataclass(frozen=True, eq=False)
class ValueLog:
    """Times and values, oldest first; histories that grew from one another share one.

    It is only ever appended to.
    """

    times: list[float]
    values: list[Any]

    def part(self, first: int, end: int) -> ValueLog:
        """Returns a copy of a range of the log."""
        return ValueLog(self.times[first:end], self.values[first:end])


@dataclass(frozen=True, eq=False)
class ValueHistory:
    """The value of a variable with a history.

    Times and ages are simulated seconds; `now` is the present simulated time. What is later
    than that (the first world was replaced by a younger one) is not there.

    >>> history = ValueHistory.begun("shut", horizon=5.0, now=0.0).added("open", 5.0, now=2.0)
    >>> history.at(1.0, now=2.0), history.within(math.inf, now=2.0)
    ('shut', [(0.0, 'shut'), (2.0, 'open')])

    Adding a value costs the same however many there are, on average; where it is not the
    latest history of its log that grows (a program failed), they are copied once.

    Attributes:
        last: the value of the variable itself.
        horizon: how long values are kept; infinite if without end.
        log: where its times and values are, maybe among others:
        first: from this place on,
        end: to before this one.
    """

    last: Any
    horizon: float
    log: ValueLog = field(repr=False)
    first: int
    end: int

    @classmethod
    def begun(cls, value: Any, horizon: float, now: float) -> Self:
        """Returns the history of a variable that had none."""
        return cls(value, horizon, ValueLog([now], [value]), 0, 1)

    def added(self, value: Any, horizon: float, now: float) -> ValueHistory:
        """Returns the history with one more value, and another horizon from now on."""
        known = self.until(now).recent(now)
        if horizon != self.horizon:
            known = replace(known, horizon=horizon).recent(now)
        log, first, end = known.log, known.first, known.end
        if len(log.times) != end:  # another one has grown from here
            log, first, end = log.part(first, end), 0, end - first
        log.times.append(now)
        log.values.append(value)
        return ValueHistory(value, horizon, log, first, end + 1)

    def recent(self, now: float) -> Self:
        """Returns the history without values that can no longer be read.

        The last value before the horizon stays: it is in force where the horizon begins.
        """
        begin, first, times = self._begin(now), self.first, self.log.times
        while first + 1 < self.end and times[first + 1] < begin:
            first += 1
        if first == self.first:
            return self
        if first < len(times) - first:
            return replace(self, first=first)
        # No more is copied than was forgotten.
        log = self.log.part(first, self.end)
        return replace(self, log=log, first=0, end=self.end - first)

    def until(self, now: float) -> Self:
        """Returns the history without later values; the variable itself keeps its value."""
        if self.end == self.first or self.log.times[self.end - 1] <= now:
            return self
        return replace(self, end=bisect_right(self.log.times, now, self.first, self.end))

    def at(self, time: float, now: float) -> Any:
        """Returns the value in force at a time: the last one that was assigned then or before.

        In the future that is the last one.

        Raises:
            EvaluationError: the time is before what is kept.
        """
        known, times = self.until(now), self.log.times
        if known.first == known.end:
            raise EvaluationError(
                f"nothing is kept: it is {_time_text(now)}, before all assignments"
            )
        begin = now - self.horizon
        oldest = max(times[known.first], begin)
        if time < oldest - SAME_TIME:
            kept = f"{_time_text(oldest)} to {_time_text(now)}"
            message = f"{_time_text(time)} is before what is kept, {kept}"
            more = "; a longer horizon keeps more" if oldest == begin else ""
            raise EvaluationError(message + more)
        place = bisect_right(times, time + SAME_TIME, known.first, known.end)
        return self.log.values[place - 1]

    def within(self, seconds: float, now: float) -> list[tuple[float, Any]]:
        """Returns the times and values of the last seconds within the horizon, ends included."""
        known = self.until(now)
        begin = max(self._begin(now), now - seconds - SAME_TIME)
        first = bisect_left(self.log.times, begin, known.first, known.end)
        part = self.log.part(first, known.end)
        return list(zip(part.times, part.values, strict=True))

    @property
    def values(self) -> Sequence[Any]:
        """All values that can be read."""
        return [self.last, *self.log.values[self.first : self.end]]

    def _begin(self, now: float) -> float:
        return now - self.horizon - SAME_TIME


def with_assignment(before: Any, value: Any, horizon: float, now: float) -> ValueHistory:
    """Returns the value of a variable after `name{horizon} = value`.

    Args:
        before: what it held; None if there was no such variable.
        value: the value.
        horizon: as `horizon_of` gave it.
        now: the present simulated time in seconds.

    Raises:
        ArgumentError: such values have no history.
    """
    if isinstance(value, LazyList):
        raise ArgumentError(
            "a list for the query that uses it has no history; assign it without {…}"
        )
    if isinstance(before, ValueHistory):
        return before.added(value, horizon, now)
    return ValueHistory.begun(value, horizon, now)


def past_value(
    name: str, variable_value: Any, age: tuple[Any, ...], now: Callable[[], float]
) -> Any:
    """Returns the value of `name{…}`.

    Args:
        name: of the variable.
        variable_value: what the variable holds: a history, or a value without one.
        age: what is in the braces; nothing if they are empty.
        now: gives the present simulated time in seconds.

    Raises:
        ArgumentError: the variable has no history, or the age is no finite number.
        EvaluationError: it is a time before what is kept.
    """
    history = history_of(name, variable_value)
    present = now()
    if not age:
        return [value for _, value in history.within(math.inf, present)]
    seconds = validation.seconds(age[0], "what is in {…}")
    if seconds < 0:
        return [value for _, value in history.within(-seconds, present)]
    try:
        return history.at(seconds, present)
    except EvaluationError as error:
        raise EvaluationError(f"{name}: {error.message}") from None


def history_of(name: str, variable_value: Any) -> ValueHistory:
    """Returns the history that a variable holds.

    Raises:
        ArgumentError: it has none.
    """
    if not isinstance(variable_value, ValueHistory):
        raise ArgumentError(
            f"{name} has no history; {name}{{5.0}} = … keeps one of 5 s, {name}{{}} = … all of it"
        )
    return variable_value


def horizon_of(value: Any) -> float:
    """Returns the time for which `name{value} = …` keeps values, in seconds.

    Raises:
        ArgumentError: it is no finite number, or less than 0.
    """
    seconds = validation.seconds(value, "a horizon")
    if seconds < 0:
        raise ArgumentError(f"a horizon is not less than 0 s, as {short_repr(value)} is")
    return seconds


def _time_text(time: float) -> str:
    return f"{round(time, 9):.12g} s"
