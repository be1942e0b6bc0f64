"""Finds rows with the number or the time of a tick that their record does not have."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from ssduck.geometry.arrays import Array, Indices


def stray_row(rows: pa.Table, numbers: Indices, times: Array) -> str | None:
    """Returns what is wrong with the first row that is of no tick; None if there is none.

    Args:
        rows: rows with `tick` and `time`, s, which lack no value.
        numbers: the numbers of the ticks, ascending.
        times: their times, s.
    """
    own, own_times = rows["tick"].to_numpy(), rows["time"].to_numpy()
    if not len(own):
        return None
    places = np.searchsorted(numbers, own)
    is_right = numbers.take(places, mode="clip") == own
    is_right &= times.take(places, mode="clip") == own_times
    if is_right.all():
        return None
    first = int(np.argmin(is_right))
    return stray_message(own[first], own_times[first])


def stray_message(number: int, time: float | None) -> str:
    """Returns what is wrong with a row of no tick, which has this number and this time, s."""
    return f"one is at the tick {number} and the time {time} s, which the record does not have"
