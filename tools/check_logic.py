"""Compares margins of generated formulas of temporal logic with those of rtamt.

`python -m tools.check_logic [COUNT] [--seed N]` needs `pip install rtamt`; it is no dependency. The
ticks are one second apart and the bounds whole seconds, where rtamt's discrete time and ours mean
the same: of an episode that has ended, windows are cut at its end. 10,000 formulas take ten
minutes. It ends with the exit status 1 at the first margin that differs by more than 1e-12.
"""

from __future__ import annotations

import argparse
import random
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ssduck.logic import traces
from ssduck.logic.traces import Trace, Window

# The operators of one condition and of two: ours, and their names in rtamt.
_ONE: dict[str, Callable[..., Trace]] = {
    "always": traces.always,
    "eventually": traces.eventually,
    "historically": traces.historically,
    "once": traces.once,
}
_TWO: dict[str, Callable[..., Trace]] = {"until": traces.until, "since": traces.held_since}
_SIGNALS = ("a", "b", "c")
TOLERANCE = 1e-12


@dataclass(frozen=True)
class Formula:
    """A formula in rtamt's language, and a function that makes its margins of those of signals."""

    text: str
    margins: Callable[[dict[str, Trace]], Trace]


def formula(draw: random.Random, depth: int) -> Formula:
    """Returns a generated formula, with so many operators in one another."""
    if depth == 0:
        name, level = draw.choice(_SIGNALS), round(draw.uniform(-1.0, 1.0), 2)
        return Formula(f"({name} >= {level})", lambda signals: _above(signals[name], level))
    kind = draw.choice(["not", "and", "or", "implies", *_ONE, *_TWO])
    first = formula(draw, depth - 1)
    if kind == "not":
        return Formula(f"(not {first.text})", lambda signals: ~first.margins(signals))
    window, bounds = _window(draw)
    if kind in _ONE:
        text = f"({kind}{bounds} {first.text})"
        return Formula(text, lambda signals: _ONE[kind](first.margins(signals), window))
    second = formula(draw, depth - 1)
    if kind in _TWO:
        text = f"({first.text} {kind}{bounds} {second.text})"

        def joined(signals: dict[str, Trace]) -> Trace:
            return _TWO[kind](first.margins(signals), second.margins(signals), window)

        return Formula(text, joined)
    logic: dict[str, Callable[[Trace, Trace], Trace]] = {
        "and": lambda a, b: a & b,
        "or": lambda a, b: a | b,
        "implies": lambda a, b: ~a | b,
    }
    return Formula(
        f"({first.text} {kind} {second.text})",
        lambda signals: logic[kind](first.margins(signals), second.margins(signals)),
    )


def _above(signal: Trace, level: float) -> Trace:
    return Trace.of(signal.times, signal.low - level)


def _window(draw: random.Random) -> tuple[Window, str]:
    """Returns a window, and its bounds in rtamt's language; none for an endless one."""
    if draw.random() < 0.3:
        return Window(), ""
    start = draw.randint(0, 4)
    end = start + draw.randint(0, 6)
    return Window(start, end), f"[{start}:{end}]"


def margins_of_rtamt(text: str, signals: dict[str, Any]) -> list[float]:
    """Returns rtamt's margins of a formula at each tick."""
    import rtamt

    specification = rtamt.StlDiscreteTimeOfflineSpecification()
    for name in signals:
        specification.declare_var(name, "float")
    specification.spec = text
    specification.parse()
    times = list(range(len(signals["a"])))
    found = specification.evaluate({"time": times, **signals})
    return [margin for _, margin in found]


def main() -> None:
    """Compares generated formulas."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", nargs="?", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    draw = random.Random(options.seed)  # noqa: S311  # for generated formulas
    for number in range(options.count):
        one = formula(draw, draw.randint(1, 3))
        count = draw.randint(2, 30)
        signals = {name: [draw.uniform(-2, 2) for _ in range(count)] for name in _SIGNALS}
        times = np.arange(count, dtype=np.float64)
        ours = one.margins({name: Trace.of(times, np.array(v)) for name, v in signals.items()})
        theirs = np.array(margins_of_rtamt(one.text, signals))
        with np.errstate(invalid="ignore"):
            differ = (ours.low != theirs) & ~(np.abs(ours.low - theirs) <= TOLERANCE)
        if differ.any():
            print(f"{number}: {one.text}\n{signals}\nours:   {ours.low}\nrtamt: {theirs}")
            sys.exit(1)
    print(f"{options.count} formulas: all margins are those of rtamt within {TOLERANCE:g}")


if __name__ == "__main__":
    main()
