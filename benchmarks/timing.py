"""Timing two or more ways of doing the same thing, in turn, in one process.

The ways take turns, so that a machine that slows down slows all of them; what is told of each
is the median, and ratios are those of medians.
"""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Mapping


def medians(ways: Mapping[str, Callable[[], object]], rounds: int = 300) -> dict[str, float]:
    """The median time of a call of each way, seconds.

    Args:
        ways: what is called, by name.
        rounds: how often each is called, after a tenth as many calls that do not count.
    """
    times: dict[str, list[float]] = {name: [] for name in ways}
    gc.collect()
    gc.disable()
    try:
        for number in range(-(rounds // 10), rounds):
            for name, call in ways.items():
                start = time.perf_counter()
                call()
                elapsed = time.perf_counter() - start
                if number >= 0:
                    times[name].append(elapsed)
    finally:
        gc.enable()
    return {name: statistics.median(values) for name, values in times.items()}


def shown(seconds: float) -> str:
    """A time with its unit."""
    if seconds >= 1:
        return f"{seconds:.1f} s"
    return f"{seconds * 1e3:.2f} ms" if seconds >= 1e-3 else f"{seconds * 1e6:.0f} µs"
