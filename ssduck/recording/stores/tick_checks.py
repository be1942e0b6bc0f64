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
    # Of each row that has not the tick and the time of the row before it.
    begins = np.flatnonzero((own[1:] != own[:-1]) | (own_times[1:] != own_times[:-1])) + 1
    own, own_times = (values[np.append(0, begins)] for values in (own, own_times))
    places = np.searchsorted(numbers, own)
    is_right = numbers.take(places, mode="clip") == own
    is_right &= times.take(places, mode="clip") == own_times
    if is_right.all():
        return None
    first = int(np.argmin(is_right))
    return (
        f"one is at the tick {own[first]} and the time {own_times[first]} s, which the record does "
        "not have"
    )
