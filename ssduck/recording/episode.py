"""What is recorded of a run of a world: `Episode`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ssduck.recording.buffers import TickBuffer


@dataclass(frozen=True)
class Episode:
    """A run of a world that is recorded in a folder or in a DuckDB file.

    Attributes:
        path: the folder, or the file.
        world: the name of the world.
        number: of the episode of that world, from 0.
        started: when, in ISO 8601.
        tables: those that are recorded, by name.
        every: which of the world's ticks are recorded: each n-th.
        entities: the names of those that are; None for all.
        ticks: how many are stored.
        first_tick: the number of the first one; None if there is none.
        last_tick: the number of the last one.
        start: its simulated time, s: that of the first tick.
        end: that of the last one, s.
    """

    path: Path
    world: str
    number: int
    started: str
    tables: tuple[str, ...]
    every: int
    entities: tuple[str, ...] | None
    ticks: int
    first_tick: int | None
    last_tick: int | None
    start: float | None
    end: float | None

    @classmethod
    def of(
        cls,
        path: Path,
        world: str,
        number: int,
        *,
        started: str,
        tables: Iterable[str],
        every: int,
        entities: tuple[str, ...] | None,
        ticks: TickBuffer,
    ) -> Episode:
        """An episode of these ticks; its tables in order."""
        told = started, tuple(sorted(tables)), every, entities, len(ticks)
        if not len(ticks):
            return cls(path, world, number, *told, None, None, None, None)
        first, last = ticks.numbers[[0, -1]].tolist()
        start, end = ticks.times[[0, -1]].tolist()
        return cls(path, world, number, *told, first, last, start, end)
