"""Replays a recorded world; a copy of a live one is the record of its last tick, with its past."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
import numpy.typing as npt

from ssduck import validation
from ssduck.errors import EvaluationError, RecordError, UnsupportedError
from ssduck.geometry.arrays import Array
from ssduck.recording.replay.record import Record, index_at
from ssduck.recording.replay.restore import PastWorld
from ssduck.recording.stores.base import TickArchive
from ssduck.simulators.scenes import Camera
from ssduck.world.entities import Entity, Sensor
from ssduck.world.snapshot import Snapshot
from ssduck.world.world import World

# The attributes of the current tick.
_STATE = frozenset(("snapshot", "_simulator", "_registry", "_recorded"))


class ReplayedWorld(PastWorld):
    """A recorded world that is replayed tick by tick.

    Its current tick is a recorded one, at first the last. It is restored when it is first read:
    many programs ask of the past only. `seek` goes to another tick; `step` and
    `run` advance from there by one recorded time a step, and triggers fire as they did then. Where
    several ticks have the same time, as a body was moved by hand, a step goes to the first of them.

    Args:
        name: the name of the world.
        record: the record of the world; its `world` becomes this one.
        archive: stores the recorded ticks.
        camera: the camera of the world; None for that of any scene.

    Attributes:
        past: stores the ticks of the past, and reads them; None if there are none.
    """

    _record: Record
    # Whether the tables of the current tick are those of another one.
    _is_elsewhere: bool = False

    def __init__(
        self, name: str, record: Record, archive: TickArchive, camera: Camera | None = None
    ) -> None:
        self._begin(name, camera or Camera())
        record.world = self
        self._record = record
        self.past: tuple[TickArchive, Record] | None = (archive, record)
        self._begin_at_end()

    def _begin_at_end(self) -> None:
        """Reads the times of the record, and goes to the last tick without restoring it."""
        self._tick = int(self._record.ticks.numbers[-1])
        for name in ("_distinct_times", "_median_step"):
            self.__dict__.pop(name, None)

    @cached_property
    def _distinct_times(self) -> tuple[Array, npt.NDArray[np.int64]]:
        """The times of the ticks, s, ascending, and the number of the first tick of each."""
        ticks = self._record.ticks
        times, first = np.unique(ticks.times, return_index=True)
        return times, ticks.numbers[first]

    @cached_property
    def _median_step(self) -> float:
        steps = np.diff(self._distinct_times[0])
        return float(np.median(steps)) if len(steps) else 0.0

    def replace_ticks(
        self, numbers: npt.NDArray[np.int64], times: Array, *, is_read: bool = True
    ) -> None:
        """Replaces the ticks of the record by others of its entities; goes to the last of them.

        Args:
            numbers: the numbers of the ticks, (n,), ascending; none of them was there before.
            times: their simulated times, s, (n,).
            is_read: whether the tables of the current tick are read until the ticks are replaced
                again. Otherwise they may be those of another tick with the same entities.
        """
        with self.lock:
            self._check_not_pinned()
            self._record.ticks.replace(numbers, times)
            self._begin_at_end()
            if self.is_restored and is_read:
                self._take_tick()
            else:
                self._is_elsewhere = self.is_restored

    if not TYPE_CHECKING:  # the base classes declare the attributes

        def __getattr__(self, name: str) -> Any:
            """Restores the current tick when an attribute of it is read for the first time."""
            if name not in _STATE:
                return super().__getattr__(name)
            with self.lock:
                if not self.is_restored:
                    simulator, snapshot = self._record.restore(self._tick)
                    self._restore_wall_time(snapshot)
                    self._set_state(simulator, snapshot)
                return self.__dict__[name]

    @property
    def is_restored(self) -> bool:
        """Whether the current tick is in memory."""
        return self.__dict__.keys() >= _STATE

    @property
    def _is_at_its_tick(self) -> bool:
        return self.is_restored and not self._is_elsewhere

    @property
    def tick_number(self) -> int:
        """The number of the current tick."""
        return self.snapshot.number if self._is_at_its_tick else self._tick

    @property
    def time(self) -> float:
        """The simulated time of the current tick, s."""
        ticks = self._record.ticks
        if self._is_at_its_tick:
            return self.snapshot.time
        return float(ticks.times[np.searchsorted(ticks.numbers, self._tick)])

    def request_tables(self, tables: Iterable[str]) -> None:
        """Ensures that the tick includes tables; recorded ones are always there."""
        requested = tuple(tables)
        self._record.warn_of_missing(requested)
        if requested or self.is_restored:
            super().request_tables(requested)

    @property
    def source_record(self) -> Record:
        """The record that is replayed."""
        return self._record

    @property
    def is_final(self) -> bool:
        """Whether its ticks need not be recorded, as they are recorded already."""
        return True

    @property
    def is_attached(self) -> bool:
        """Whether the simulation is a client of the user's."""
        return False

    @property
    def timestep(self) -> float:
        """The median of the steps between recorded times, s."""
        return self._median_step

    def seek(self, time: float) -> ReplayedWorld:
        """Goes to the last tick until a time.

        Args:
            time: the simulated time, s.

        Raises:
            EvaluationError: no tick of that time is recorded.
            ArgumentError: the time is no finite number.
        """
        time = validation.seconds(time, "a time")
        with self.lock:
            self._check_not_pinned()
            times = self._record.ticks.times
            index = index_at(self.name, time, times, float(times[-1]))
            self._tick = int(self._record.ticks.numbers[index])
            self._take_tick()
        return self

    def seek_tick(self, number: int) -> ReplayedWorld:
        """Goes to the tick of a number."""
        with self.lock:
            self._check_not_pinned()
            if number not in self._record.ticks.numbers:
                raise RecordError(
                    f"{self.name!r} has no tick {number}: ticks of the episode are missing"
                )
            self._tick = number
            self._take_tick()
        return self

    def advance(self, count: int, on_progress: Callable[[int], object] | None = None) -> None:
        """Advances by a number of recorded times, without notifying observers."""
        with self.lock:
            self._check_not_pinned()
            times, first_ticks = self._distinct_times
            index = int(np.searchsorted(times, self.time, side="right")) - 1 + count
            if index >= len(times):
                raise EvaluationError(f"what is recorded of {self.name!r} ends at {times[-1]:g} s")
            if count:
                self._tick = int(first_ticks[index])
            if on_progress is not None:
                on_progress(count)
            self._take_tick()

    def _take(self) -> None:
        self._is_elsewhere = False
        self._simulator = self._record.restore_into(self.snapshot, self._tick)
        self._restore_wall_time(self.snapshot)

    def _restore_wall_time(self, snapshot: Snapshot) -> None:
        """Restores the recorded wall time of the tick into its snapshot."""
        wall_time = self._record.rows("ticks", self._tick)["wall_time"]
        if len(wall_time) != 1:
            raise RecordError(f"{self._record.source} is damaged: it has no tick {self._tick}")
        snapshot.tables["ticks"]["wall_time"][:] = wall_time

    def entity(self, id: int) -> Entity:
        """Returns the handle of an entity at the current tick, by its id."""
        return World.entity(self, id)

    def __repr__(self) -> str:
        numbers, times = self._record.ticks.numbers, self._record.ticks.times
        return (
            f"<RecordedWorld {self.name!r}: {len(self)} entities, ticks {numbers[0]} to "
            f"{numbers[-1]}, t={times[0]:g} s to {times[-1]:g} s>"
        )


class CopiedWorld(ReplayedWorld):
    """A copy of the last tick of a live world, which the simulation does not change.

    Args:
        name: the name of the copy.
        present: the record of the last tick alone.
        camera: the camera of the world.
        past: stores the recorded ticks, and reads them: the `world` of the record becomes this one;
            None if there are none.
        sense: copies the tick again, with what sensors perceive.
    """

    def __init__(
        self,
        name: str,
        present: Record,
        camera: Camera,
        past: tuple[TickArchive, Record] | None,
        sense: Callable[[], None],
    ) -> None:
        self._begin(name, camera)
        self._record, self.past = present, past
        present.world = self
        if past is not None:
            past[1].world = self
        self._sense, self._is_sensed = sense, False
        self._begin_at_end()

    def go_to(self, number: int, time: float) -> None:
        """Goes to the tick of which the rows are there now."""
        self._record.forget_rows()
        self._is_sensed = False
        self.replace_ticks(np.array([number]), np.array([time]))

    def request_tables(self, tables: Iterable[str]) -> None:
        """Ensures that the tick includes tables; rays are cast in the live world."""
        requested = frozenset(tables)
        if "sensings" in requested and not self._is_sensed:
            self._sense()
            self._is_sensed = True
        super().request_tables(requested)

    def reading(self, sensor: Sensor, *, picture: bool = False) -> NoReturn:  # noqa: ARG002
        """Raises `UnsupportedError`: a copy has no rays and no pictures."""
        raise UnsupportedError(
            f"the reading of {sensor.name!r} is not in a copy of a tick: read it in the world "
            "itself, or ask for isSensing, sensingAmount or the table sensings"
        )

    def __repr__(self) -> str:
        return f"<CopiedWorld {self.name!r}: {len(self)} entities, t={self.time:g} s>"
