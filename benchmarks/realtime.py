"""Measures the processor time of recording the kitchen at 240 Hz, as a share of a core."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import ssduck
from ssduck import Recording
from ssduck.schema import RECORDABLE

HEADER = ("recording the kitchen at 240 Hz", "a tick", "cores", "budget")
BUDGET_CORES = 0.5
WARM_UP = 60
PERIOD = 1 / 240
TABLES: dict[str, tuple[str, ...] | None] = {
    "nothing": None,
    "entities, links, joints, contacts": ("entities", "links", "joints", "contacts"),
    "all tables": RECORDABLE,
}


def rows(ticks: int) -> Iterator[tuple[str, ...]]:
    """Yields the mean processor time of a tick, of all threads.

    A part is written every few hundred ticks: a shorter run may have none of them.
    """
    for name, tables in TABLES.items():
        seconds = _tick_seconds(tables, ticks)
        budget = f"{BUDGET_CORES:g}" if tables is not None and tables != RECORDABLE else ""
        yield name, f"{1e3 * seconds:.2f} ms", f"{seconds / PERIOD:.2f}", budget


def _tick_seconds(tables: tuple[str, ...] | None, ticks: int) -> float:
    with tempfile.TemporaryDirectory() as folder, ssduck.load("kitchen", recording=None) as ss:
        world = ss.call_variable("kitchen")
        if tables is not None:
            ss.record_to(Path(folder) / "run", recording=Recording(tables=tables))
        world.step(WARM_UP, every=1)
        start = time.process_time()
        world.step(ticks, every=1)
        return (time.process_time() - start) / ticks
