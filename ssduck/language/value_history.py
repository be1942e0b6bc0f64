"""Lists that are evaluated by the query that uses them."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

from ssduck import validation
from ssduck.errors import ArgumentError, EvaluationError
from ssduck.formatting import short_repr
from ssduck.language import ast


class LazyList:
    """A list that mentions elements of sources that do not exist yet.

    It is resolved in the query that uses it.
    """

    IN_WORDS = "a list for the query that uses it"

    def __init__(self, node: ast.Node, text: str) -> None:
        self.node = node
        self.text = text

    def __repr__(self) -> str:
        return f"<list for the query that uses it: {self.source}>"

    @property
    def source(self) -> str:
        """The text of the list as it was written."""
        return self.text[self.node.span.start : self.node.span.end]


# The largest difference of equal times, s: times are rounded multiples of a step, and 0.7 s
# is the 168th step of 1/240 s.
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

    Times and ages are simulated seconds; `now` is the current simulated time. Values that are later
    (after the first world was replaced by a younger one) are ignored.

    >>> history = ValueHistory.started("shut", horizon=5.0, now=0.0).added("open", 5.0, now=2.0)
    >>> history.at(1.0, now=2.0), history.within(math.inf, now=2.0)
    ('shut', [(0.0, 'shut'), (2.0, 'open')])

    Adding a value takes constant time on average. If the history is not the latest one of its log
    (after a program failed), its values are copied once.
    """

    last: Any  # the value of the variable itself
    horizon: float  # how long values are kept; infinite if without end
    log: ValueLog = field(repr=False)  # the log that contains its times and values
    first: int  # the index of its first value in the log
    end: int  # the index after its last value

    @classmethod
    def started(cls, value: Any, horizon: float, now: float) -> Self:
        """Returns the history of a variable that had none."""
        return cls(value, horizon, ValueLog([now], [value]), 0, 1)

    def added(self, value: Any, horizon: float, now: float) -> ValueHistory:
        """Returns the history with one more value, and another horizon from now on."""
        recent = self.until(now).recent(now)
        if horizon != self.horizon:
            recent = replace(recent, horizon=horizon).recent(now)
        log, first, end = recent.log, recent.first, recent.end
        if len(log.times) != end:  # another history has appended to the log
            log, first, end = log.part(first, end), 0, end - first
        log.times.append(now)
        log.values.append(value)
        return ValueHistory(value, horizon, log, first, end + 1)

    def recent(self, now: float) -> Self:
        """Returns the history without values that can no longer be read.

        The last value before the horizon stays: it is in force where the horizon begins.
        """
        begin, first, times = self._horizon_start(now), self.first, self.log.times
        while first + 1 < self.end and times[first + 1] < begin:
            first += 1
        if first == self.first:
            return self
        if first < len(times) - first:
            return replace(self, first=first)
        # The number of copied values is at most that of the dropped ones.
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
        """
        recent, times = self.until(now), self.log.times
        if recent.first == recent.end:
            raise EvaluationError(
                f"no value is kept: it is {_time_text(now)}, before all assignments"
            )
        begin = now - self.horizon
        oldest = max(times[recent.first], begin)
        if time < oldest - SAME_TIME:
            range_text = f"{_time_text(oldest)} to {_time_text(now)}"
            message = f"{_time_text(time)} is before the kept values, {range_text}"
            more = "; a longer horizon keeps more" if oldest == begin else ""
            raise EvaluationError(message + more)
        place = bisect_right(times, time + SAME_TIME, recent.first, recent.end)
        return self.log.values[place - 1]

    def within(self, seconds: float, now: float) -> list[tuple[float, Any]]:
        """Returns the times and values of the last seconds within the horizon, ends included."""
        recent = self.until(now)
        begin = max(self._horizon_start(now), now - seconds - SAME_TIME)
        first = bisect_left(self.log.times, begin, recent.first, recent.end)
        part = self.log.part(first, recent.end)
        return list(zip(part.times, part.values, strict=True))

    @property
    def values(self) -> Sequence[Any]:
        """All values that can be read."""
        return [self.last, *self.log.values[self.first : self.end]]

    def _horizon_start(self, now: float) -> float:
        return now - self.horizon - SAME_TIME


def with_assignment(before: Any, value: Any, horizon: float, now: float) -> ValueHistory:
    """Returns the value of a variable after `name{horizon} = value`.

    Args:
        before: its previous value; None if there was no such variable.
        value: the new value.
        horizon: the horizon, s, from `horizon_of`.
        now: the current simulated time, s.
    """
    if isinstance(value, LazyList):
        raise ArgumentError(
            "a list for the query that uses it has no history; assign it without {…}"
        )
    if isinstance(before, ValueHistory):
        return before.added(value, horizon, now)
    return ValueHistory.started(value, horizon, now)


def past_value(
    name: str, variable_value: Any, age: tuple[Any, ...], now: Callable[[], float]
) -> Any:
    """Returns the value of `name{…}`."""
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
    """Returns the history that a variable holds."""
    if not isinstance(variable_value, ValueHistory):
        raise ArgumentError(
            f"{name} has no history; {name}{{5.0}} = … keeps one of 5 s, {name}{{}} = … all of it"
        )
    return variable_value


def horizon_of(value: Any) -> float:
    """Returns the time for which `name{value} = …` keeps values, in seconds."""
    seconds = validation.seconds(value, "a horizon")
    if seconds < 0:
        raise ArgumentError(f"a horizon must be at least 0 s, not {short_repr(value)}")
    return seconds


def _time_text(time: float) -> str:
    return f"{round(time, 9):.12g} s"
