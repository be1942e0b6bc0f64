"""Formulas of temporal logic, and their values by the definitions, tick by tick.

What is unknown is None: AND and OR are those of Kleene.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

# Times of ticks are sums of time steps.
_SLACK = 1e-9


@dataclass(frozen=True)
class Formula:
    """A condition: a comparison, which is `name`, or an operator of others."""

    name: str
    parts: tuple[Formula, ...] = ()
    window: tuple[float, ...] = ()

    @property
    def text(self) -> str:
        """The formula in SelectScript."""
        texts = [part.text for part in self.parts]
        match self.name:
            case "NOT":
                return f"(NOT {texts[0]})"
            case "AND" | "OR" | "IMPLIES":
                return f"({texts[0]} {self.name} {texts[1]})"
        if not self.parts:
            return self.name
        return f"{self.name}({', '.join((*texts, *map(str, self.window)))})"


def value(
    formula: Formula, tick: int, times: list[float], signals: dict[str, list[Any]], *, is_open: bool
) -> bool | None:
    """Returns whether a formula holds at a tick.

    Args:
        formula: the formula.
        tick: the place of the tick.
        times: the times of the ticks, s.
        signals: the values of the comparisons at each tick, by their texts.
        is_open: whether more ticks may follow.
    """

    def at(part: Formula, place: int) -> bool | None:
        if place == len(times):
            return None
        return value(part, place, times, signals, is_open=is_open)

    parts = formula.parts
    match formula.name:
        case "NOT":
            return _not(at(parts[0], tick))
        case "AND":
            return _all([at(parts[0], tick), at(parts[1], tick)])
        case "OR":
            return _any([at(parts[0], tick), at(parts[1], tick)])
        case "IMPLIES":
            return _any([_not(at(parts[0], tick)), at(parts[1], tick)])
        case "eventually":
            return _any([at(parts[0], i) for i in _ahead(formula, tick, times, is_open=is_open)])
        case "always":
            return _all([at(parts[0], i) for i in _ahead(formula, tick, times, is_open=is_open)])
        case "until":
            condition, goal = parts
            held = [
                _all([at(goal, i), *(at(condition, j) for j in range(tick, i))])
                for i in _ahead(formula, tick, times, is_open=is_open)
            ]
            last = len(times) - 1
            if is_open and times[tick] + _bounds(formula)[0] > times[last] + _SLACK:
                # Perhaps the next tick comes after the window has begun, and then it has this one.
                before = (at(condition, j) for j in range(tick, last))
                held.append(_all([None, at(goal, last), *before]))
            return _any(held)
        case "once":
            return _any([at(parts[0], i) for i in _back(formula, tick, times)])
        case "historically":
            return _all([at(parts[0], i) for i in _back(formula, tick, times)])
        case "heldSince":
            condition, start = parts
            return _any(
                [
                    _all([at(start, i), *(at(condition, j) for j in range(i + 1, tick + 1))])
                    for i in _back(formula, tick, times)
                ]
            )
    result: bool | None = signals[formula.name][tick]
    return result


def _bounds(formula: Formula) -> tuple[float, float]:
    start, end = (*formula.window, *(0.0, math.inf)[len(formula.window) :])
    return start, end


def _ahead(formula: Formula, tick: int, times: list[float], *, is_open: bool) -> list[int]:
    """Returns the ticks of a window ahead; the number of ticks stands for one to come."""
    start, end = (times[tick] + bound for bound in _bounds(formula))
    places = _between(start, end, times) if start <= times[-1] + _SLACK else []
    return [*places, len(times)] if is_open and end > times[-1] + _SLACK else places


def _back(formula: Formula, tick: int, times: list[float]) -> list[int]:
    end, start = (times[tick] - bound for bound in _bounds(formula))
    return _between(start, end, times)


def _between(start: float, end: float, times: list[float]) -> list[int]:
    """Returns the ticks at which a condition has its value at some time from start to end."""
    following = [*times[1:], math.inf]
    return [
        place
        for place, (time, after) in enumerate(zip(times, following, strict=True))
        if time <= end + _SLACK and after > start + _SLACK
    ]


def _not(value: bool | None) -> bool | None:
    return None if value is None else not value


def _any(values: list[bool | None]) -> bool | None:
    return True if True in values else None if None in values else False


def _all(values: list[bool | None]) -> bool | None:
    return False if False in values else None if None in values else True
