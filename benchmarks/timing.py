"""Times alternative ways to do the same thing in one process, and prints tables.

The ways take turns, so that a slower machine slows all of them. The result is the median time of
each, or the minimum where a call is long; ratios are those of these results.
"""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass


def medians(
    ways: Mapping[str, Callable[[], object]],
    rounds: int = 300,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Returns the median time of a call of each way, seconds.

    Args:
        ways: the calls by name.
        rounds: the number of calls of each way, after a tenth as many to warm up.
        clock: the clock; `time.process_time` leaves out what other processes take.
    """
    times: dict[str, list[float]] = {name: [] for name in ways}
    with uncollected():
        for number in range(-(rounds // 10), rounds):
            for name, call in ways.items():
                elapsed = _timed(call, clock)
                if number >= 0:
                    times[name].append(elapsed)
    return {name: statistics.median(values) for name, values in times.items()}


@dataclass(frozen=True)
class Way:
    """A call to time, and a preparation before each call that is not timed."""

    call: Callable[[], object]
    before: Callable[[], object] = lambda: None


def minima(ways: Mapping[str, Way], rounds: int, max_seconds: float) -> dict[str, float]:
    """Returns the minimal time of a call of each way, seconds.

    Args:
        ways: the calls by name.
        rounds: the number of calls of each way.
        max_seconds: the time, s, after which a way is not called again.
    """
    times: dict[str, list[float]] = {name: [] for name in ways}
    with uncollected():
        for _ in range(rounds):
            for name, way in ways.items():
                if sum(times[name]) <= max_seconds:
                    way.before()
                    times[name].append(_timed(way.call))
    return {name: min(values) for name, values in times.items()}


@contextmanager
def uncollected() -> Iterator[None]:
    """Disables Python's garbage collector, which would run at random times."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def _timed(call: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    start = clock()
    call()
    return clock() - start


def text_of(seconds: float) -> str:
    """Returns a time with its unit."""
    if seconds >= 1:
        return f"{seconds:.1f} s"
    return f"{seconds * 1e3:.2f} ms" if seconds >= 1e-3 else f"{seconds * 1e6:.0f} µs"


def text_in_microseconds(seconds: float) -> str:
    """Returns a time in microseconds with a decimal."""
    return f"{seconds * 1e6:.1f} µs"


def print_table(header: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> None:
    """Prints a Markdown table, each row as soon as it is measured."""
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)
    print()
