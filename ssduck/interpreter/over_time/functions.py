"""Functions of an expression at each recorded tick: `since`, `holds`, `changes` and others."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import gt, lt
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr
from ssduck.interpreter.over_time.series import TickSeries
from ssduck.language import ast
from ssduck.language.analysis import OF_MARGINS, TEMPORAL_OPERATORS
from ssduck.language.builtins import Function
from ssduck.language.intervals import changes_of, intervals_of
from ssduck.language.operators import apply
from ssduck.logic import traces
from ssduck.logic.stepwise import HeldSince, UntilFromFirst
from ssduck.logic.traces import Trace, Window

# Parts of a program that are computed from values alone, if their own parts are.
OF_VALUES = (
    ast.Literal,
    ast.ListLiteral,
    ast.Unary,
    ast.Binary,
    ast.OperatorChain,
    ast.Branch,
    ast.If,
)


@dataclass(frozen=True)
class Fold:
    """A function of all ticks until now, of its state at the tick before and the next value."""

    # Returns the state for a first tick: from its time, s, and the value.
    first: Callable[[float, Any], Any]
    begin: Callable[[TickSeries], Any]  # returns the state for all ticks of a series
    # Returns the state with one more tick: from the state, the time, s, and the value.
    step: Callable[[Any, float, Any], Any]
    # Returns the value of the function: from the state, and the time of its last tick, s.
    value: Callable[[Any, float], Any] = lambda state, _: state
    is_of_condition: bool = False  # whether its expression is a condition
    # The number of the last ticks on which the value depends; 0 for the first tick alone, None for
    # all ticks.
    reach: int | None = None


@dataclass(frozen=True)
class TemporalFunction:
    """A function whose first argument is evaluated at each tick."""

    name: str
    # The function that computes its value from a series of ticks and an age; None of an operator.
    make: Callable[[TickSeries, Any], Any] | None
    about: str  # its description for help
    usage: str  # its signature for help
    arguments: tuple[int, int] = (1, 2)  # the least and the largest number of arguments
    expression: int = 0  # the place of the expression among the arguments
    fold: Fold | None = None  # the fold over all ticks that it is without an age, if it is one
    is_in_lakes: bool = True  # whether it is evaluated over the episodes of a lake by one statement
    # The operator of temporal logic that it is: it takes the traces of its conditions, and a
    # window. None for another function.
    operator: Callable[..., Trace] | None = None
    looks_ahead: bool = False  # whether the operator depends on later ticks
    takes_least: bool = False  # whether it is the least of the margins of its condition
    of_margins: bool = False  # whether it takes and returns the margins of its conditions
    conditions: int = 1  # the number of its expressions

    @property
    def function(self) -> Function:
        """The entry for help; it is never called."""
        return never_called(self.name, self.about, self.usage, *self.arguments)


def never_called(name: str, about: str, usage: str, least: int, most: int) -> Function:
    """Returns the entry for help of a function that is not called with values."""
    help_text = f"{about}\nUsage: {usage}"
    return Function(name, lambda *_: None, help_text, least, most, builtin=True)


def expressions_of(call: ast.Call) -> tuple[ast.Node, ...]:
    """Returns the expressions of a call that are evaluated at ticks."""
    form = TEMPORAL_FUNCTIONS.get(call.name)
    if form is None:
        return call.arguments[:1]
    return call.arguments[form.expression : form.expression + form.conditions]


def operator_of(node: ast.Node) -> TemporalFunction | None:
    """Returns the operator of temporal logic that a part is; None for another part."""
    form = TEMPORAL_FUNCTIONS.get(node.name) if isinstance(node, ast.Call) else None
    return form if form is not None and form.operator is not None else None


def is_fold(call: ast.Call, *, at_first: bool = False) -> bool:
    """Checks whether the value of a call at a tick follows from that at the tick before.

    That is so of a function of all ticks without an age, and of an operator that looks back; and of
    one that looks ahead, if it is at the first tick.
    """
    form = TEMPORAL_FUNCTIONS[call.name]
    if form.operator is not None:
        return at_first or not form.looks_ahead
    return form.fold is not None and len(call.arguments) == 1


def parts_of(call: ast.Call) -> tuple[ast.Node, ast.Node | None]:
    """Returns the expression of a call that is evaluated at ticks, and the other argument."""
    expression = expressions_of(call)[0]
    others = [part for part in call.arguments if part is not expression]
    return expression, others[0] if others and operator_of(call) is None else None


def _since(series: TickSeries, _: Any) -> float | None:
    start: float | None = None
    for past in series.backwards():
        times, holding = series.holding(past)
        before = np.flatnonzero(~holding)
        if len(before):
            following = times[before[-1] + 1 :]
            return float(following[0]) if len(following) else start
        start = float(times[0])
    series.record.warn_of_dropped_ticks()
    return start


def _since_first(time: float, holds: bool) -> float | None:
    return time if holds else None


def _since_step(start: float | None, time: float, holds: bool) -> float | None:
    return start if holds and start is not None else _since_first(time, holds)


def _held_for(series: TickSeries, age: Any) -> float:
    return _duration(_since(series, age), float(series.ticks()[1][-1]))


def _duration(start: float | None, time: float) -> float:
    return 0.0 if start is None else time - start


def _holds(series: TickSeries, age: Any) -> list[list[float]]:
    return intervals_of(*series.holding(series.whole(age)))


def _changes(series: TickSeries, age: Any) -> list[list[Any]]:
    return changes_of(*series.at(series.whole(age)))


def _initially(series: TickSeries, _: Any) -> Any:
    series.record.warn_of_dropped_ticks()
    start = series.ticks()[1][0]
    return _values_in(series, start, start)[1][0]


def _values_in(series: TickSeries, first: float, last: float) -> tuple[list[float], list[Any]]:
    """Returns the times of few ticks, and the values at these; None where there is none."""
    times, values = series.at(series.window(first, last))
    return times.tolist(), values.tolist()


def _previous(series: TickSeries, _: Any) -> Any:
    times = series.ticks()[1]
    before = times[: np.searchsorted(times, series.time)]
    time = before[-1] if len(before) else times[0]
    return _values_in(series, time, time)[1][0]


def _rate(series: TickSeries, _: Any) -> Any:
    return _rate_of(_last_two(series))


# The times and the values at the tick before and at the last one, which is both if it is the first.
_LastTwo: TypeAlias = tuple[tuple[float, Any], tuple[float, Any]]


def _last_two(series: TickSeries) -> _LastTwo:
    times = series.ticks()[1]
    before = times[: np.searchsorted(times, times[-1])]
    ends = _values_in(series, before[-1] if len(before) else times[-1], times[-1])
    first, *others = zip(*ends, strict=True)
    return first, others[-1] if others else first


def _first_two(time: float, value: Any) -> _LastTwo:
    return (time, value), (time, value)


def _next_two(state: _LastTwo, time: float, value: Any) -> _LastTwo:
    return state[1], (time, value)


def _rate_of(state: _LastTwo, _: float = 0.0) -> Any:
    (start, before), (end, now) = state
    if before is None or now is None:
        return None
    is_list = type(before) is list
    first, last = (value if is_list else [value] for value in (before, now))
    if not {int, float}.issuperset(map(type, (*first, *last))):
        raise ArgumentError(f"rate takes an expression of numbers, not {short_repr(now)}")
    seconds = end - start if end > start else 1.0
    rates = [change / seconds for change in apply("-", last, first)]
    return rates if is_list else rates[0]


def _at(series: TickSeries, time: Any) -> Any:
    if time is None or time < 0:
        raise ArgumentError(
            "at takes a time from 0 s on, then an expression: at(0.5, x(cup)); for half a second "
            "ago, or the beginning until then, write at(max([0, getTime() - 0.5]), x(cup))"
        )
    return series.at(series.past(time))[1].tolist()[-1]


def _least(series: TickSeries, age: Any) -> list[Any] | None:
    if series.least_clearance is not None:
        past = series.whole(age)
        ticks, times = past.ticks_and_times
        found = None if (times[1:] == times[:-1]).any() else series.least_clearance(past)
        if found is not None:
            return [float(times[np.searchsorted(ticks, found[0])]), found[1]]
    return _extreme(series, age, "least", np.argmin)


def _greatest(series: TickSeries, age: Any) -> list[Any] | None:
    return _extreme(series, age, "greatest", np.argmax)


def _extreme(
    series: TickSeries, age: Any, name: str, choose: Callable[[npt.NDArray[Any]], np.intp]
) -> list[Any] | None:
    """Returns [time, value] of the first of the extreme values; None without numbers."""
    times, values = series.at(series.whole(age))
    data, are_numbers = np.ma.getdata(values), ~np.ma.getmaskarray(values)
    if data.dtype == np.object_:
        for value in values.tolist():
            _check_is_number(name, value)
        are_numbers = np.array(list(map(_is_number, values.tolist())), np.bool_)
    elif data.dtype == np.float64:
        are_numbers &= ~np.isnan(data)
    places = np.flatnonzero(are_numbers)
    if not len(places):
        return None
    place = places[choose(data[places])]
    return [float(times[place]), *data[place : place + 1].tolist()]


def _check_is_number(name: str, value: Any) -> None:
    if not (value is None or isinstance(value, int | float)):
        raise ArgumentError(f"{name} takes an expression of numbers, not {short_repr(value)}")


def _extreme_fold(
    name: str,
    make: Callable[[TickSeries, Any], Any],
    is_further: Callable[[Any, Any], bool],
) -> Fold:
    def step(state: list[Any] | None, time: float, value: Any) -> list[Any] | None:
        _check_is_number(name, value)
        if not _is_number(value) or not (state is None or is_further(value, state[1])):
            return state
        return [time, value]

    return Fold(
        lambda time, value: step(None, time, value), lambda series: make(series, None), step
    )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not math.isnan(value)


def fold_of_operator(name: str, window: Window, traces_of: Callable[[], Sequence[Trace]]) -> Fold:
    """Returns the fold that an operator is which looks back, or ahead from the first tick.

    A state has two bounds of the margin, which differ if something is unknown, or undecided. The
    margin of a truth value is 1 or -1.

    Args:
        name: the name of the operator.
        window: its window.
        traces_of: returns the traces of its conditions at all recorded ticks.
    """
    form = TEMPORAL_FUNCTIONS[name]
    sign = -1.0 if form.takes_least else 1.0
    blank: list[Any] = [HeldSince(window)] * 2
    if form.looks_ahead:
        blank = [UntilFromFirst(window, is_upper=is_upper) for is_upper in (False, True)]

    def bounds(value: Any) -> list[tuple[float, float]]:
        values = value if form.conditions == 2 and value is not None else (value,) * form.conditions
        margins = [_bounds_of(one, sign, of_margins=form.of_margins) for one in values]
        return list(zip(*(margins if form.conditions == 2 else [_HOLDS, *margins]), strict=True))

    def begin(_: TickSeries) -> list[Any]:
        traces = traces_of()
        columns = zip(*_arrays_of(traces, sign), strict=True)
        return [one.after(traces[0].times, *both) for one, both in zip(blank, columns, strict=True)]

    def first(time: float, value: Any) -> list[Any]:
        return step(blank, time, value)

    def step(state: Sequence[Any], time: float, value: Any) -> list[Any]:
        return [one.step(time, *bound) for one, bound in zip(state, bounds(value), strict=True)]

    def value(state: Sequence[Any], _: float) -> Any:
        bounds = [sign * one.margin for one in state]
        low, high = bounds if form.of_margins else [margin > 0.0 for margin in bounds]
        return low if low == high else None

    return Fold(first, begin, step, value)


_HOLDS = (math.inf, math.inf)


def _bounds_of(value: Any, sign: float, *, of_margins: bool) -> tuple[float, float]:
    """Returns the bounds of the margin of a value."""
    if value is None:
        return -math.inf, math.inf
    margin = sign * (value if of_margins else 1.0 if value else -1.0)
    return margin, margin


def _arrays_of(traces: Sequence[Trace], sign: float) -> list[list[npt.NDArray[Any]]]:
    """Returns the bounds of the margins of a condition that is to hold, and of its start."""
    margins = [trace.margins if sign > 0.0 else (~trace).margins for trace in traces]
    both = [[one.low, one.high] for one in margins]
    endless = np.full(len(traces[0].times), np.inf)
    return both if len(both) == 2 else [[endless, endless], *both]


def _operator(
    name: str,
    operator: Callable[..., Trace],
    about: str,
    *,
    looks_ahead: bool = False,
    other: str = "",
) -> TemporalFunction:
    """Returns an operator of temporal logic, of one condition or of two."""
    conditions = TEMPORAL_OPERATORS[name]
    arguments = f"condition, {other}" if other else "condition"
    return TemporalFunction(
        name,
        None,
        about,
        f"{name}({arguments}[, from, to]) -> bool",
        arguments=(conditions, conditions + 2),
        is_in_lakes=False,
        operator=operator,
        looks_ahead=looks_ahead,
        takes_least=name in ("always", "historically"),
        conditions=conditions,
    )


_SINCE = Fold(_since_first, lambda series: _since(series, None), _since_step, is_of_condition=True)
_LAST_TWO = Fold(_first_two, _last_two, _next_two, _rate_of, reach=2)
TEMPORAL_FUNCTIONS: dict[str, TemporalFunction] = {
    form.name: form
    for form in (
        TemporalFunction(
            "since",
            _since,
            "Returns the simulated time, in seconds, since which a condition has held at every "
            "recorded tick; nothing if it does not hold now.",
            "since(condition) -> float",
            arguments=(1, 1),
            fold=_SINCE,
        ),
        TemporalFunction(
            "heldFor",
            _held_for,
            "Returns the simulated time, in seconds, for which a condition has held until now; "
            "0 if it does not hold now.",
            "heldFor(condition) -> float",
            arguments=(1, 1),
            fold=replace(_SINCE, value=_duration),
        ),
        TemporalFunction(
            "holds",
            _holds,
            "Returns the maximal intervals [start, end] of simulated time, in seconds, during "
            "which a condition held. An interval ends at the first tick at which the condition "
            "does not hold, or at the last tick.",
            "holds(condition[, age]) -> list",
        ),
        TemporalFunction(
            "changes",
            _changes,
            "Returns [time, value] of an expression at the first recorded tick and at each tick "
            "where the value changes; times in seconds.",
            "changes(expression[, age]) -> list",
        ),
        TemporalFunction(
            "initially",
            _initially,
            "Returns the value of an expression at the first recorded tick, nothing if an entity "
            "was not there: z(cup) - initially(z(cup)) >= 0.1 is true of a cup that is lifted by "
            "10 cm.",
            "initially(expression) -> value",
            arguments=(1, 1),
            fold=Fold(
                lambda _, value: value,
                lambda series: _initially(series, None),
                lambda state, *_: state,
                reach=0,
            ),
        ),
        TemporalFunction(
            "previous",
            _previous,
            "Returns the value of an expression at the last recorded tick before the current time: "
            "that of the tick itself at the first one, nothing if an entity was not there.",
            "previous(expression) -> value",
            arguments=(1, 1),
            is_in_lakes=False,
            fold=replace(_LAST_TWO, value=lambda state, _: state[0][1]),
        ),
        TemporalFunction(
            "rate",
            _rate,
            "Returns the change of an expression from the recorded tick before to the last one, in "
            "its unit a second; 0 at the first tick, nothing if an entity was not there at one of "
            "them. Of a list of numbers it is a list.",
            "rate(expression) -> number",
            arguments=(1, 1),
            is_in_lakes=False,
            fold=_LAST_TWO,
        ),
        TemporalFunction(
            "at",
            _at,
            "Returns the value of an expression at a simulated time in seconds: at the last "
            "recorded tick until then; nothing if an entity was not there.",
            "at(time, expression) -> value",
            arguments=(2, 2),
            expression=1,
            is_in_lakes=False,
        ),
        TemporalFunction(
            "least",
            _least,
            "Returns [time, value] of the least value of an expression over the recorded ticks, "
            "at its first tick, the time in seconds: least(clearance(a, b)) is the closest "
            "approach.",
            "least(expression[, age]) -> list",
            fold=_extreme_fold("least", _least, lt),
        ),
        TemporalFunction(
            "greatest",
            _greatest,
            "Returns [time, value] of the greatest value of an expression over the recorded ticks, "
            "at its first tick, the time in seconds: greatest(contactForce(a, b)) is the hardest "
            "push.",
            "greatest(expression[, age]) -> list",
            fold=_extreme_fold("greatest", _greatest, gt),
        ),
        _operator(
            "always",
            traces.always,
            "Checks if a condition holds at all recorded ticks from `from` to `to` seconds after "
            "the tick; without them, at all ticks from there on. At an expression's outermost "
            "level the tick is the first one of the episode; nothing while that is not decided.",
            looks_ahead=True,
        ),
        _operator(
            "eventually",
            traces.eventually,
            "Checks if a condition holds at some recorded tick from `from` to `to` seconds after "
            "the tick; without them, at some tick from there on. At an expression's outermost "
            "level the tick is the first one of the episode; nothing while that is not decided.",
            looks_ahead=True,
        ),
        _operator(
            "until",
            traces.until,
            "Checks if a goal holds at some recorded tick from `from` to `to` seconds after the "
            "tick, and a condition at all ticks before that. At an expression's outermost level "
            "the tick is the first one of the episode; nothing while that is not decided.",
            looks_ahead=True,
            other="goal",
        ),
        _operator(
            "historically",
            traces.historically,
            "Checks if a condition held at all recorded ticks of the time from `to` to `from` "
            "seconds ago; without them, at all ticks until now.",
        ),
        _operator(
            "once",
            traces.once,
            "Checks if a condition held at some recorded tick of the time from `to` to `from` "
            "seconds ago, as in once(touching(cup, hand), 0, 5); without them, at some tick until "
            "now.",
        ),
        _operator(
            "heldSince",
            traces.held_since,
            "Checks if a condition has held at all recorded ticks after one at which another held, "
            "from `to` to `from` seconds ago; without them, at any tick until now.",
            other="start",
        ),
    )
}
TEMPORAL_FUNCTIONS |= {
    OF_MARGINS + name: replace(form, name=OF_MARGINS + name, of_margins=True)
    for name, form in TEMPORAL_FUNCTIONS.items()
    if form.operator is not None
}
