"""A world of which there is only what was recorded: it is replayed."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from ssduck import validation
from ssduck.errors import EvaluationError
from ssduck.recording.replay.past_world import PastWorld
from ssduck.recording.replay.record import Record, place_at
from ssduck.recording.stores.base import TickArchive
from ssduck.simulators.scenes import Camera
from ssduck.world.entities import Entity, RecordedTick
from ssduck.world.world import World


class ReplayedWorld(PastWorld):
    """A world of which there is only what was recorded: it is replayed, tick by tick.

    Its present is a recorded tick, at first the last one. `seek` goes to another one; `step` and
    `run` go on from there, a step a recorded time, and triggers are told as they were then. Where
    several ticks are of one time (a body was moved by hand), a step goes to the first of them.

    Args:
        name: what it is called.
        record: what is kept of it; it is told of this world.
        archive: where that is stored.
    """

    _record: Record

    def __init__(self, name: str, record: Record, archive: TickArchive) -> None:
        self.name, self.camera = name, Camera()
        record.world = self
        self.lock = threading.RLock()  # reading a record takes it
        posed, snapshot = record.taken(int(record.ticks.numbers[-1]))
        super().__init__(RecordedTick(record, snapshot.number), posed, snapshot)
        self.archive = archive
        self._tick = snapshot.number
        self._tell_wall_time()
        self._times, first = np.unique(record.ticks.times, return_index=True)
        self._firsts = record.ticks.numbers[first]
        steps = np.diff(self._times)
        self._timestep = float(np.median(steps)) if len(steps) else 0.0

    @property
    def own_record(self) -> Record:
        """What is kept of it."""
        return self._record

    @property
    def is_final(self) -> bool:
        """Whether its ticks need not be recorded: they are."""
        return True

    @property
    def timestep(self) -> float:
        """Simulated seconds between two recorded times, in the middle."""
        return self._timestep

    def seek(self, time: float) -> ReplayedWorld:
        """Go to the last tick until a time.

        Args:
            time: simulated seconds.

        Raises:
            EvaluationError: nothing of that time is recorded.
            ArgumentError: it is no finite number.
        """
        time = validation.seconds(time, "a time")
        with self.lock:
            self._check_not_pinned()
            times = self._record.ticks.times
            place = place_at(self.name, time, times, float(times[-1]))
            self._tick = int(self._record.ticks.numbers[place])
            self._take_tick()
        return self

    def advance(self, count: int, on_progress: Callable[[int], object] | None = None) -> None:
        """Go on by so many recorded times, telling no follower.

        Raises:
            EvaluationError: the record ends before that.
        """
        with self.lock:
            self._check_not_pinned()
            place = int(np.searchsorted(self._times, self.time, side="right")) - 1 + count
            if place >= len(self._times):
                raise EvaluationError(
                    f"what is recorded of {self.name!r} ends at {self._times[-1]:g} s"
                )
            if count:
                self._tick = int(self._firsts[place])
            if on_progress is not None:
                on_progress(count)
            self._take_tick()

    def _take(self) -> None:
        self._simulator = self._record.take(self.snapshot, self._tick)
        self._tell_wall_time()

    def _tell_wall_time(self) -> None:
        """What time of day it was at the tick."""
        told = self._record.rows("ticks", self._tick)["wall_time"]
        self.snapshot.tables["ticks"]["wall_time"][:] = told

    def entity(self, id: int) -> Entity:
        """The handle of an entity that is there, by its id."""
        return World.entity(self, id)

    def __repr__(self) -> str:
        numbers, times = self._record.ticks.numbers, self._record.ticks.times
        return (
            f"<RecordedWorld {self.name!r}: {len(self)} entities, ticks {numbers[0]} to "
            f"{numbers[-1]}, t={times[0]:g} s to {times[-1]:g} s>"
        )
