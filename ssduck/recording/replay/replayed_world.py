"""Replays a recorded world; a copy of a live one is the record of its last tick, with its past."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cached_property
from typing import NoReturn

import numpy as np
import numpy.typing as npt

from ssduck import validation
from ssduck.errors import EvaluationError, RecordError, UnsupportedError
from ssduck.geometry.arrays import Array
from ssduck.recording.replay.record import Record, index_at
from ssduck.recording.replay.restore import READ, recorded_elsewhere
from ssduck.recording.stores.base import TickArchive
from ssduck.simulators.interface import Simulator
from ssduck.simulators.scenes import Camera
from ssduck.world.entities import Sensor
from ssduck.world.entity_registry import EntityRegistry
from ssduck.world.snapshot import Snapshot
from ssduck.world.ticking import Ticker, TickSink
from ssduck.world.world import World


class ReplayTicker(Ticker):
    """Takes the ticks of a record, at first the last; it is restored when it is first read.

    Attributes:
        record: the record.
    """

    def __init__(self, name: str, record: Record) -> None:
        super().__init__(name)
        self.record = record
        self._restored: tuple[Simulator, Snapshot] | None = None
        # Whether the restored tables are those of another tick.
        self._is_elsewhere = False
        self._begin_at_end()

    def _begin_at_end(self) -> None:
        """Reads the times of the record, and goes to the last tick without restoring it."""
        self._tick = int(self.record.ticks.numbers[-1])
        self.__dict__.pop("_distinct_times", None)

    @cached_property
    def _distinct_times(self) -> tuple[Array, npt.NDArray[np.int64], float]:
        """The times of the ticks, s, ascending, the first tick of each, and their median step."""
        ticks = self.record.ticks
        times, first = np.unique(ticks.times, return_index=True)
        step = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        return times, ticks.numbers[first], step

    # -- the present tick -------------------------------------------------------------------

    @property
    def simulator(self) -> Simulator:  # type: ignore[override]  # restored when it is read
        """The static simulator of the present tick."""
        return self._present()[0]

    @property
    def snapshot(self) -> Snapshot:  # type: ignore[override]
        """The present tick."""
        return self._present()[1]

    @property
    def registry(self) -> EntityRegistry:  # type: ignore[override]
        """The entities at the present tick."""
        return EntityRegistry(self.snapshot.load_order)

    def _present(self) -> tuple[Simulator, Snapshot]:
        if self._restored is None:
            with self.lock:
                if self._restored is None:
                    simulator, snapshot = self.record.restore(self._tick)
                    self._restore_wall_time(snapshot)
                    self._restored = simulator, snapshot
        return self._restored

    def take(self, *, may_restart: bool = False) -> None:  # noqa: ARG002
        """Restores the present tick."""
        self._is_elsewhere = False
        if self._restored is None:
            self._present()
            return
        _, snapshot = self._restored
        self._restored = self.record.restore_into(snapshot, self._tick), snapshot
        self._restore_wall_time(snapshot)

    def _restore_wall_time(self, snapshot: Snapshot) -> None:
        wall_time = self.record.rows("ticks", self._tick)["wall_time"]
        if len(wall_time) != 1:
            raise RecordError(f"{self.record.source} is damaged: it has no tick {self._tick}")
        snapshot.tables["ticks"]["wall_time"][:] = wall_time

    @property
    def is_restored(self) -> bool:
        """Whether the present tick, or another one, is in memory."""
        return self._restored is not None

    @property
    def is_final(self) -> bool:
        """True: its ticks are recorded already."""
        return True

    @property
    def is_attached(self) -> bool:
        """False: nothing is simulated."""
        return False

    @property
    def number(self) -> int:
        """The number of the present tick."""
        return self._tick if self._restored is None or self._is_elsewhere else super().number

    @property
    def time(self) -> float:
        """The simulated time of the present tick, s."""
        if self._restored is not None and not self._is_elsewhere:
            return super().time
        ticks = self.record.ticks
        return float(ticks.times[np.searchsorted(ticks.numbers, self._tick)])

    @property
    def timestep(self) -> float:
        """The median of the steps between recorded times, s."""
        return self._distinct_times[2]

    def removal_of(self, name: str) -> str:
        """Returns that an entity of a name is recorded at other ticks; "" if none is."""
        return recorded_elsewhere(self.record, name)

    def request_tables(self, tables: Collection[str]) -> None:
        """Ensures that the tick includes tables; recorded ones are always there."""
        self.record.warn_of_missing(tables)
        if tables or self.is_restored:
            super().request_tables(READ.intersection(tables))

    def add_recorder(self, recorder: TickSink) -> NoReturn:
        """Raises `UnsupportedError`: there are no new ticks."""
        raise UnsupportedError(f"{self.name!r} is itself a record; {recorder} gets no ticks")

    # -- other ticks --------------------------------------------------------------------------

    def go_to(self, number: int) -> None:
        """Goes to the tick of a number, which is recorded."""
        with self.lock:
            self.check_not_pinned()
            self._tick = number
            self.take()

    def run(self, count: int, on_progress: Callable[[int], object] | None) -> None:
        """Goes on by a number of recorded times."""
        times, first_ticks, _ = self._distinct_times
        index = int(np.searchsorted(times, self.time, side="right")) - 1 + count
        if index >= len(times):
            raise EvaluationError(f"what is recorded of {self.name!r} ends at {times[-1]:g} s")
        if count:
            self._tick = int(first_ticks[index])
        if on_progress is not None:
            on_progress(count)

    def replace_ticks(
        self, numbers: npt.NDArray[np.int64], times: Array, *, is_read: bool = True
    ) -> None:
        """Replaces the ticks of the record by others of its entities; goes to the last of them.

        Args:
            numbers: the numbers of the ticks, (n,), ascending; none of them was there before.
            times: their simulated times, s, (n,).
            is_read: whether the tables of the present tick are read until the ticks are replaced
                again. Otherwise they may be those of another tick with the same entities.
        """
        with self.lock:
            self.check_not_pinned()
            self.record.ticks.replace(numbers, times)
            self._begin_at_end()
            if self.is_restored and is_read:
                self.take()
            else:
                self._is_elsewhere = self.is_restored


class ReplayedWorld(World):
    """A recorded world that is replayed tick by tick.

    Its current tick is a recorded one, at first the last. It is restored when it is first read:
    many programs ask of the past only. `seek` goes to another tick; `step` and
    `run` advance from there by one recorded time a step, and triggers fire as they did then. Where
    several ticks have the same time, as a body was moved by hand, a step goes to the first of them.

    Args:
        ticker: takes the ticks; the `world` of its record becomes this one.
        past: stores the ticks of the past, and reads them; None if there are none.
        camera: the camera of the world; None for that of any scene.
    """

    ticker: ReplayTicker

    def __init__(
        self,
        ticker: ReplayTicker,
        past: tuple[TickArchive, Record] | None,
        camera: Camera | None = None,
    ) -> None:
        super().__init__(ticker, camera=camera)
        self.past = past
        ticker.record.world = self
        if past is not None:
            past[1].world = self

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
            ticks = self.ticker.record.ticks
            index = index_at(self.name, time, ticks.times, float(ticks.times[-1]))
            self.ticker.go_to(int(ticks.numbers[index]))
        return self

    def seek_tick(self, number: int) -> ReplayedWorld:
        """Goes to the tick of a number."""
        with self.lock:
            if number not in self.ticker.record.ticks.numbers:
                raise RecordError(
                    f"{self.name!r} has no tick {number}: ticks of the episode are missing"
                )
            self.ticker.go_to(number)
        return self

    def __repr__(self) -> str:
        numbers, times = self.ticker.record.ticks.numbers, self.ticker.record.ticks.times
        return (
            f"<RecordedWorld {self.name!r}: {len(self)} entities, ticks {numbers[0]} to "
            f"{numbers[-1]}, t={times[0]:g} s to {times[-1]:g} s>"
        )


class CopyTicker(ReplayTicker):
    """Takes the last tick of a live world, of which what sensors perceive is copied on request.

    Args:
        name: the name of the copy.
        present: the record of the last tick alone.
        sense: copies the tick again, with what sensors perceive.
    """

    def __init__(self, name: str, present: Record, sense: Callable[[], None]) -> None:
        super().__init__(name, present)
        self._sense, self._is_sensed = sense, False

    def go_on_to(self, number: int, time: float) -> None:
        """Goes to the tick of which the rows are there now."""
        self.record.forget_rows()
        self._is_sensed = False
        self.replace_ticks(np.array([number]), np.array([time]))

    def request_tables(self, tables: Collection[str]) -> None:
        """Ensures that the tick includes tables; rays are cast in the live world."""
        if "sensings" in tables and not self._is_sensed:
            self._sense()
            self._is_sensed = True
        super().request_tables(tables)


class CopiedWorld(ReplayedWorld):
    """A copy of the last tick of a live world, which the simulation does not change."""

    ticker: CopyTicker

    def reading(self, sensor: Sensor, *, picture: bool = False) -> NoReturn:  # noqa: ARG002
        """Raises `UnsupportedError`: a copy has no rays and no pictures."""
        raise UnsupportedError(
            f"the reading of {sensor.name!r} is not in a copy of a tick: read it in the world "
            "itself, or ask for isSensing, sensingAmount or the table sensings"
        )

    def __repr__(self) -> str:
        return f"<CopiedWorld {self.name!r}: {len(self)} entities, t={self.time:g} s>"
