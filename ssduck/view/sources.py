"""What a page shows: records as sources, and what all sources need.

A source gives frames (the poses of all links at a tick) and mirrors: worlds for the queries of the
page, which hold no lock of the simulation while they run. Only the thread of the queries calls
`mirror`, and only that of scans `recorded`; `watch` sets what is called at each new tick, in any
thread.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.opening import open_record
from ssduck.limits import Limits
from ssduck.recording.replay.replayed_world import ReplayedWorld
from ssduck.simulators.backends import drawn_shapes
from ssduck.view.frames import Frame, Track, scene_message, track_of
from ssduck.world.world import World


@dataclass(frozen=True, eq=False)
class Ticks:
    """The numbers of recorded ticks, (n,), ascending, and their simulated times, s, (n,)."""

    numbers: npt.NDArray[np.int64]
    times: Array


@dataclass(frozen=True, eq=False)
class Asked:
    """A world that answers queries, and the interpreter that has it under its name."""

    interpreter: Interpreter
    world: World


class RecordSource:
    """A record, whose ticks are all there; each viewer has a time of its own."""

    latest: Frame | None = None

    def __init__(self, path: str | Path, episode: int | None) -> None:
        self.firings: list[tuple[str, float]] = []
        self._open = partial(open_record, path, episode=episode, limits=page_limits())
        with contextlib.ExitStack() as stack:
            self._asked = self._opened(stack)
            # Poses are read by an interpreter of their own, so that no query delays them.
            shown = self._opened(stack)
            self._stack = stack.pop_all()
        self._frames = _replayed(shown.world)
        self._scanned: Asked | None = None
        self._lock = threading.Lock()
        self._scene: tuple[Frame, bytes] | None = None

    def _opened(self, stack: contextlib.ExitStack) -> Asked:
        ss = self._open()
        stack.callback(ss.close)
        ss.strict = True
        return Asked(ss, ss.worlds[0])

    @property
    def about(self) -> dict[str, Any]:
        """The name of the world, and that it is recorded."""
        return {"world": self._asked.world.name, "kind": "record"}

    def watch(self, changed: Callable[[], object] | None) -> None:
        """Does nothing: a record does not change."""

    def frame(self, time: float | None) -> Frame:
        """Returns the frame at a time; the first one for None."""
        with self._lock:
            self._frames.seek(_recorded_time(self._frames, time))
            frame = Frame.of(self._frames.snapshot)
            frame.poses  # noqa: B018  # computed here, as the next tick is restored in its place
            return frame

    def scene(self, frame: Frame) -> bytes:
        """Returns the scene of a frame; the same one until entities come or go."""
        with self._lock:
            if self._scene is None or not self._scene[0].has_same_scene(frame):
                visuals = partial(drawn_shapes, self._frames.simulator)
                self._scene = frame, scene_message(frame, visuals, camera_of(self._frames))
            return self._scene[1]

    def ticks(self) -> Ticks:
        """Returns the recorded ticks."""
        ticks = self._frames.source_record.ticks
        return Ticks(ticks.numbers, ticks.times)

    def track(self, frame: Frame, first: int, count: int) -> Track | None:
        """Returns the poses at recorded ticks."""
        with self._lock:
            return track_of(self._frames.source_record, frame, first, count)

    def mirror(self, time: float | None) -> Asked:
        """Returns the world at a time."""
        world = _replayed(self._asked.world)
        world.seek(_recorded_time(world, time))
        return self._asked

    def recorded(self) -> Asked:
        """Returns a world that goes through the recorded ticks."""
        if self._scanned is None:
            self._scanned = self._opened(self._stack)
        return self._scanned

    def close(self) -> None:
        """Closes the record."""
        self._stack.close()


def _replayed(world: World) -> ReplayedWorld:
    assert isinstance(world, ReplayedWorld)
    return world


def _recorded_time(world: ReplayedWorld, time: float | None) -> float:
    """Returns the recorded time that is nearest to a time, s; the first one for None."""
    times = world.source_record.ticks.times
    first, last = float(times[0]), float(times[-1])
    return first if time is None else min(max(time, first), last)


def page_limits() -> Limits:
    """Returns the limits of the programs of a page."""
    return Limits.strict(progress=False)


def camera_of(world: World) -> dict[str, Any]:
    """Returns the camera of a world for the page."""
    camera = world.camera
    return {"camera": {"eye": camera.eye, "target": camera.target, "fov": camera.fov}}
