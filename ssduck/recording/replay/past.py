"""Provides past ticks of a world as a source of queries.

`kitchen{12.5}`, `kitchen{-2.0}` and `kitchen{}` are each a `Past`: some ticks of a record, whose
entities are handles that stay at their tick.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck import validation
from ssduck.errors import ArgumentError, EvaluationError, UnknownNameError
from ssduck.formatting import name_path, short_repr
from ssduck.geometry.arrays import Array
from ssduck.recording.replay.record import Record, index_at
from ssduck.recording.replay.restore import PastWorld
from ssduck.schema import EntityTable, entity_of
from ssduck.simulators.clock import TIME_TOLERANCE
from ssduck.world.entities import Entity
from ssduck.world.handles import Handle, Links, RecordedTick
from ssduck.world.world import World

# The number of a world's first tick.
_FIRST_TICK = 1


def past_of(record: Record, age: float | None, now: int | None = None) -> Past:
    """Returns the tick at a time, the ticks of the last seconds, or all ticks.

    Args:
        record: the record of the world.
        age: if not negative, a simulated time, s, to select the last tick until then; if negative,
            to select the ticks of so many last seconds; None for all ticks.
        now: the number of a recorded tick that takes the place of the current one.
    """
    numbers, times = record.ticks_until_now(now)
    name = record.world.name
    if not len(numbers):
        raise EvaluationError(f"no tick of {name!r} is recorded")
    time = record.world.time if now is None else float(times[-1])
    if age is None:
        return Past(record, int(numbers[0]), int(numbers[-1]), is_window=True)
    if age < 0:
        first = int(np.searchsorted(times, time + age - TIME_TOLERANCE))
        if first == len(numbers):
            raise EvaluationError(
                f"of the last {-age:g} s of {name!r} no tick is recorded; the last one is of "
                f"{times[-1]:g} s, and it is {time:g} s"
            )
        return Past(record, int(numbers[first]), int(numbers[-1]), is_window=True)
    advice = record.dropped_ticks_message or _binding_message(record, int(numbers[0]))
    end = float(record.ticks.times[-1])
    tick = int(numbers[index_at(name, age, times, time, advice, end)])
    return Past(record, tick, tick, is_window=False)


def _binding_message(record: Record, first: int) -> str:
    """Returns why a live world has no ticks before a tick, after a semicolon; empty if it has."""
    if record.recording is None or first == _FIRST_TICK:
        return ""
    return "; ticks are kept from when the world is bound to a variable, or a recording begins"


@dataclass(frozen=True, eq=False)
class Past:
    """Some ticks of a world: a source of queries, whose elements are its entities at each tick.

    Attributes:
        record: the record of the world.
        first: the number of the first tick.
        last: the number of the last tick.
        is_window: whether there may be several ticks; such sources of one world advance through
            their ticks together.
        id: the id of the only entity or link; None for all.
        table: the table of the elements: entities, or the links or sites of entities.
        world: the recorded world.
    """

    record: Record
    first: int
    last: int
    is_window: bool
    id: int | None = None
    table: EntityTable = "entities"
    world: World = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "world", self.record.world)  # keeps the world alive

    @property
    def ticks(self) -> list[int]:
        """The numbers of the ticks."""
        ticks: list[int] = self.ticks_and_times[0].tolist()
        return ticks

    @property
    def times(self) -> list[float]:
        """The simulated time of each tick, s."""
        times: list[float] = self.ticks_and_times[1].tolist()
        return times

    @property
    def ticks_and_times(self) -> tuple[npt.NDArray[np.int64], Array]:
        """The numbers of the n ticks, (n,), and the simulated time of each, s, (n,)."""
        with self.record.world.lock:
            self.check()
            numbers = self.record.ticks.numbers
            ends = (
                np.searchsorted(numbers, self.first),
                np.searchsorted(numbers, self.last, "right"),
            )
            chosen = slice(*ends)
            return numbers[chosen].copy(), self.record.ticks.times[chosen].copy()

    def check(self) -> None:
        """Checks that none of the ticks was dropped.

        Raises:
            EvaluationError: some were dropped, or the record was discarded.
        """
        self.record.check_open()
        numbers = self.record.ticks.numbers
        if not len(numbers) or self.first < numbers[0]:
            kept = (
                f"the first that is kept is tick {numbers[0]}" if len(numbers) else "none is kept"
            )
            raise EvaluationError(
                f"tick {self.first} of {self.world.name!r} is kept no longer; {kept}"
                f"{self.record.dropped_ticks_message}"
            )

    def __iter__(self) -> Iterator[Handle]:
        """Yields the entities or links at each tick, tick by tick."""
        for tick in self.ticks:
            world = self.record.at(tick)
            if self.id is None:
                yield from world if self.table == "entities" else Links(world, self.table)
            elif entity_of(self.id) in world.snapshot.rows:
                yield world.handle(self.id)

    def at(self, tick: int) -> PastWorld:
        """Returns the world at one of the ticks, by its number.

        Raises:
            EvaluationError: the tick is none of them.
        """
        if not validation.is_integer(tick) or not self.first <= tick <= self.last:
            raise EvaluationError(
                f"{short_repr(tick)} is none of the ticks {self.first} to {self.last}"
            )
        return self.record.at(tick)

    def __getitem__(self, name: str) -> Entity:
        """Returns the entity of a name at the tick.

        Raises:
            UnknownNameError: there is none; suggests the nearest names.
            ArgumentError: these may be several ticks.
        """
        if self.is_window:
            world = self.world.name
            raise ArgumentError(
                f"{name!r} of a window of ticks is of no single tick: for one of them write "
                f"{world}{{t}} with a time t from 0 s on, or previous(…) for the tick before; "
                f"for all of them query FROM {world}{{…}}, or write changes(…)"
            )
        past = self.record.at(self.ticks[-1])
        if name not in past and name in self.world:
            now = name_path(self.world.name, name)
            raise UnknownNameError(
                f"{name!r} was not there at {past.time:g} s: changes(z({now})) has the time at "
                "which it came"
            )
        return past[name]

    def __repr__(self) -> str:
        try:
            times = self.times
        except EvaluationError as error:
            return f"<Past of {self.world.name!r}: {error.message}>"
        description = f"t={times[0]:g} s" if not self.is_window else f"{len(times)} ticks"
        if self.is_window and times:
            description += f" from {times[0]:g} s to {times[-1]:g} s"
        return f"<Past of {self.world.name!r}: {description}>"


def pin_to_common_tick(values: Sequence[Any], elements: Iterable[Any]) -> Sequence[Any] | None:
    """Pins entities that follow their world; returns None if one did not exist at the tick.

    In a query of the past an entity follows the tick of the query. Beside an entity that is fixed
    to a tick, as `sim{0.0}.cup` is, it stays at the current tick of its world.

    Args:
        values: entities and other values.
        elements: the current elements of the query around them.
    """
    worlds = {v.world for v in values if isinstance(v, Handle) and v.moment is None}
    moments = {world: common_moment(world, values, elements) for world in worlds}
    present = worlds - {v.world for v in elements if isinstance(v, Handle) and v.moment is not None}
    pinned: list[Any] = []
    for value in values:
        is_free = isinstance(value, Handle) and value.moment is None
        moment = moments[value.world] if is_free else None
        handle = value if moment is None else value.pinned(moment)
        if moment is not None and not handle.is_there and value.world not in present:
            return None
        pinned.append(handle)
    return pinned


def common_moment(
    world: World, values: Iterable[Any], elements: Iterable[Any]
) -> RecordedTick | None:
    """Returns the tick of the entities of a world that follow it; None for its current one."""
    fixed, rows = (
        [v.moment for v in some if isinstance(v, Handle) and v.world is world and v.moment]
        for some in (values, elements)
    )
    ticks = {moment.tick for moment in rows}
    # The elements of the innermost query come last.
    of_row = next((moment for moment in fixed if moment.tick in ticks), rows[-1] if rows else None)
    if of_row is not None or not fixed:
        return of_row
    return RecordedTick(fixed[0].record, world.tick_number)


@dataclass(frozen=True, eq=False)
class PresentTick:
    """A world at its current tick, beside its past in one query: its entities stay at the tick."""

    record: Record
    tick: int
    table: EntityTable = "entities"

    @property
    def world(self) -> World:
        """The recorded world."""
        return self.record.world

    def __iter__(self) -> Iterator[Handle]:
        """Yields the entities or links, pinned to the tick."""
        for handle in self.world if self.table == "entities" else Links(self.world, self.table):
            yield handle.pinned(RecordedTick(self.record, self.tick))
