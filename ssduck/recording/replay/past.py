"""The past of a world as a source of queries.

A `Past` is what `kitchen{12.5}`, `kitchen{-2.0}` and `kitchen{}` are: some ticks of a
record, whose entities are handles that stay at their tick.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ssduck import validation
from ssduck.errors import EvaluationError
from ssduck.formatting import short_repr
from ssduck.recording.replay.past_world import PastWorld
from ssduck.recording.replay.record import ROUNDING, Record, place_at
from ssduck.world.entities import Entity, RecordedTick
from ssduck.world.world import World


def past_of(record: Record, age: float | None) -> Past:
    """Some ticks: the one at a time, those of the last seconds, or all.

    Args:
        record: what is kept of the world.
        age: seconds; from 0 up a simulated time, of which the last tick until then is taken;
            below 0 so long ago at most; None for all that are kept.

    Raises:
        EvaluationError: nothing is kept, or nothing of that time.
    """
    numbers, times = record.until_now()
    name = record.world.name
    if not len(numbers):
        raise EvaluationError(f"no tick of {name!r} is recorded")
    if age is None:
        return Past(record, int(numbers[0]), int(numbers[-1]), is_window=True)
    if age < 0:
        first = int(np.searchsorted(times, record.world.time + age - ROUNDING))
        if first == len(numbers):
            raise EvaluationError(
                f"of the last {-age:g} s of {name!r} no tick is recorded; the last one is of "
                f"{times[-1]:g} s, and it is {record.world.time:g} s"
            )
        return Past(record, int(numbers[first]), int(numbers[-1]), is_window=True)
    tick = int(numbers[place_at(name, age, times, record.world.time)])
    return Past(record, tick, tick, is_window=False)


@dataclass(frozen=True, eq=False)
class Past:
    """Some ticks of a world: a source of queries, whose elements are its entities at each.

    Attributes:
        record: what is kept of the world.
        first: the number of the first tick,
        last: and of the last one.
        is_window: whether there may be several; sources of one world that are so go through
            their ticks together.
        id: of the only entity that is meant; None for all.
        world: the world whose past it is.
    """

    record: Record
    first: int
    last: int
    is_window: bool
    id: int | None = None
    world: World = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "world", self.record.world)  # which is not to go meanwhile

    @property
    def ticks(self) -> list[int]:
        """The numbers of the ticks."""
        return self._chosen[0]

    @property
    def times(self) -> list[float]:
        """The simulated time of each tick, s."""
        return self._chosen[1]

    @property
    def _chosen(self) -> tuple[list[int], list[float]]:
        with self.record.world.lock:
            self.check()
            numbers = self.record.ticks.numbers
            ends = (
                np.searchsorted(numbers, self.first),
                np.searchsorted(numbers, self.last, "right"),
            )
            chosen = slice(*ends)
            return numbers[chosen].tolist(), self.record.ticks.times[chosen].tolist()

    def check(self) -> None:
        """Complain if some of the ticks are kept no longer.

        Raises:
            EvaluationError: they are not, or nothing of that record is.
        """
        self.record.check_open()
        numbers = self.record.ticks.numbers
        if not len(numbers) or self.first < numbers[0]:
            told = (
                f"the first that is kept is tick {numbers[0]}" if len(numbers) else "none is kept"
            )
            raise EvaluationError(
                f"tick {self.first} of {self.world.name!r} is kept no longer; {told}"
            )

    def __iter__(self) -> Iterator[Entity]:
        """The entities at each tick, tick by tick."""
        for tick in self.ticks:
            there = self.record.at(tick)
            if self.id is None:
                yield from there
            elif self.id in there.snapshot.rows:
                yield there.entity(self.id)

    def at(self, tick: int) -> PastWorld:
        """The entities at one of the ticks, by its number.

        Raises:
            EvaluationError: it is none of them.
        """
        if not validation.is_integer(tick) or not self.first <= tick <= self.last:
            raise EvaluationError(
                f"{short_repr(tick)} is none of the ticks {self.first} to {self.last}"
            )
        return self.record.at(tick)

    def __getitem__(self, name: str) -> Entity:
        """The entity of that name at the last of the ticks.

        Raises:
            UnknownNameError: there is none, with the nearest names.
        """
        return self.record.at(self.ticks[-1])[name]

    def __repr__(self) -> str:
        try:
            times = self.times
        except EvaluationError as error:
            return f"<Past of {self.world.name!r}: {error.message}>"
        told = f"t={times[0]:g} s" if not self.is_window else f"{len(times)} ticks"
        if self.is_window and times:
            told += f" from {times[0]:g} s to {times[-1]:g} s"
        return f"<Past of {self.world.name!r}: {told}>"


def at_moment(entity: Entity, moment: RecordedTick) -> Entity:
    """The handle of an entity as it is at a tick."""
    return type(entity)(entity.world, entity.id, entity.name, entity.kind, moment)


def together(values: Sequence[Any], elements: Iterable[Any]) -> Sequence[Any] | None:
    """Entities as they were at the tick of the first that stays at one; None if one was not there.

    A handle goes with its world; in a query of the past it goes with that.

    Args:
        values: the entities, and other values.
        elements: the current elements of the query that they are in.
    """
    worlds = {v.world for v in values if isinstance(v, Entity) and v.moment is None}
    if not worlds:
        return values
    first = next((v for v in values if isinstance(v, Entity) and v.moment is not None), None)
    if first is None:
        # Those of the query itself come last.
        past = [v for v in elements if isinstance(v, Entity) and v.moment is not None]
        first = next((v for v in reversed(past) if v.world in worlds), None)
    if first is None:
        return values
    moment = first.moment
    assert moment is not None
    found: list[Any] = []
    for value in values:
        if isinstance(value, Entity) and value.moment is None and value.world is first.world:
            there = at_moment(value, moment)
            if not there.is_there:
                return None
            found.append(there)
        else:
            found.append(value)
    return found


@dataclass(frozen=True, eq=False)
class PresentTick:
    """A world at its current tick, beside its past in one query: its entities stay at it."""

    record: Record
    tick: int

    @property
    def world(self) -> World:
        """The world."""
        return self.record.world

    def __iter__(self) -> Iterator[Entity]:
        """The entities."""
        for entity in self.world:
            yield at_moment(entity, RecordedTick(self.record, self.tick))
