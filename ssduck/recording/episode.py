"""Describes a recorded run of a world: `Episode`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from uuid import uuid4

from ssduck.recording.buffers import TickBuffer
from ssduck.recording.tags import Tag, Tags


def new_id() -> str:
    """Returns a random UUID for an episode."""
    return str(uuid4())


@dataclass(frozen=True)
class Episode:
    """A run of a world that is recorded in a folder or in a DuckDB file.

    Attributes:
        path: the folder or the file.
        world: the name of the world.
        number: the number of the episode of that world, from 0.
        started: the date and time of the start, in ISO 8601.
        tables: the names of the recorded tables.
        every: n where every n-th tick of the world is recorded.
        entities: the names of the recorded entities; None for all.
        ticks: the number of stored ticks.
        first_tick: the number of the first stored tick; None if there is none.
        last_tick: the number of the last stored tick; None if there is none.
        start: the simulated time of the first stored tick, s; None if there is none.
        end: the simulated time of the last stored tick, s; None if there is none.
        complete: whether the recording was closed, and not killed.
        id: a UUID of the run, which no other episode has.
        tags: what the user says of the run: texts, True, False or numbers, by name.
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
    complete: bool
    id: str
    tags: Tags = field(default_factory=dict[str, Tag], hash=False)


def extent_of(ticks: TickBuffer) -> dict[str, Any]:
    """Returns what an episode says of its ticks: their number, the first, and the last one."""
    if not len(ticks):
        none = dict.fromkeys(("first_tick", "last_tick", "start", "end"))
        return {"ticks": 0, **none}
    first, last = ticks.numbers[[0, -1]].tolist()
    start, end = ticks.times[[0, -1]].tolist()
    return {"ticks": len(ticks), "first_tick": first, "last_tick": last, "start": start, "end": end}
