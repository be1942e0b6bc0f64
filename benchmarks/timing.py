"""Timing two or more ways of doing the same thing, in turn, in one process; printing tables.

The ways take turns, so that a machine that slows down slows all of them; what is told of each
is the median, or the least where a call is long, and ratios are those of the same.
"""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass


def medians(ways: Mapping[str, Callable[[], object]], rounds: int = 300) -> dict[str, float]:
    """The median time of a call of each way, seconds.

    Args:
        ways: what is called, by name.
        rounds: how often each is called, after a tenth as many calls that do not count.
    """
    times: dict[str, list[float]] = {name: [] for name in ways}
    with _uncollected():
        for number in range(-(rounds // 10), rounds):
            for name, call in ways.items():
                elapsed = _timed(call)
                if number >= 0:
                    times[name].append(elapsed)
    return {name: statistics.median(values) for name, values in times.items()}


@dataclass(frozen=True)
class Way:
    """What is timed, and what is done before each call, which does not count."""

    call: Callable[[], object]
    before: Callable[[], object] = lambda: None


def minima(ways: Mapping[str, Way], rounds: int, most: float) -> dict[str, float]:
    """The least time of a call of each way, seconds.

    Args:
        ways: what is called, by name.
        rounds: how often each is called.
        most: seconds; a way whose calls have taken more is not called again.
    """
    times: dict[str, list[float]] = {name: [] for name in ways}
    with _uncollected():
        for _ in range(rounds):
            for name, way in ways.items():
                if sum(times[name]) <= most:
                    way.before()
                    times[name].append(_timed(way.call))
    return {name: min(values) for name, values in times.items()}


@contextmanager
def _uncollected() -> Iterator[None]:
    """Without Python's collector of garbage, which comes when it likes."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def _timed(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def shown(seconds: float) -> str:
    """A time with its unit."""
    if seconds >= 1:
        return f"{seconds:.1f} s"
    return f"{seconds * 1e3:.2f} ms" if seconds >= 1e-3 else f"{seconds * 1e6:.0f} µs"


def shown_finely(seconds: float) -> str:
    """A time of some microseconds."""
    return f"{seconds * 1e6:.1f} µs"


def printed(header: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> None:
    """Print a Markdown table, a row as soon as it is measured."""
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)
    print()
