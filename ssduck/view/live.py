"""What a page shows: records and simulated worlds as sources, and the simulation that it controls.

A source gives frames (the poses of all links at a tick) and mirrors: worlds for the queries of the
page, which hold no lock of the simulation while they run. Only the thread of the queries calls
`mirror`, and only that of scans `recorded`; `watch` sets what is called at each new tick, in any
thread.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck import validation
from ssduck.errors import ArgumentError, SelectScriptError, UnsupportedError
from ssduck.geometry.arrays import Array
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.mirrors import Mirror, history_of, listen_to_triggers
from ssduck.interpreter.opening import open_record
from ssduck.limits import Limits
from ssduck.recording.replay.record import Record, index_at
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
        self.path, self.episode = path, episode
        self.firings: list[tuple[str, float]] = []
        self._open = partial(open_record, path, episode=episode, limits=page_limits())
        with contextlib.ExitStack() as stack:
            # Poses are read by an interpreter of their own, so that no query delays them.
            self._frames = _replayed(self._opened(stack).world)
            self._stack = stack.pop_all()
        self._lock = threading.Lock()
        self._scene: tuple[Frame, bytes] | None = None

    @cached_property
    def _asked(self) -> Asked:
        return self._opened(self._stack)

    @cached_property
    def _scanned(self) -> Asked:
        return self._opened(self._stack)

    def _opened(self, stack: contextlib.ExitStack) -> Asked:
        ss = self._open()
        stack.callback(ss.close)
        ss.strict = True
        return Asked(ss, ss.worlds[0])

    @property
    def about(self) -> dict[str, Any]:
        """The name of the world, and that it is recorded."""
        return {"world": self._frames.name, "kind": "record"}

    def watch(self, changed: Callable[[], object] | None) -> None:
        """Does nothing: a record does not change."""

    def frame(self, time: float | None) -> Frame:
        """Returns the frame at a time; the first one for None."""
        with self._lock:
            self._frames.seek(recorded_time(self._frames, time))
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
        ticks = self._frames.ticker.record.ticks
        return Ticks(ticks.numbers, ticks.times)

    def track(self, frame: Frame, first: int, count: int) -> Track | None:
        """Returns the poses at recorded ticks."""
        with self._lock:
            return track_of(self._frames.ticker.record, frame, first, count)

    def mirror(self, time: float | None) -> Asked:
        """Returns the world at a time."""
        world = _replayed(self._asked.world)
        world.seek(recorded_time(world, time))
        return self._asked

    def recorded(self) -> Asked:
        """Returns a world that goes through the recorded ticks."""
        return self._scanned

    def close(self) -> None:
        """Closes the record."""
        self._stack.close()


def _replayed(world: World) -> ReplayedWorld:
    assert isinstance(world, ReplayedWorld)
    return world


def recorded_time(world: ReplayedWorld, time: float | None) -> float:
    """Returns the recorded time that is nearest to a time, s; the first one for None."""
    times = world.ticker.record.ticks.times
    first, last = float(times[0]), float(times[-1])
    return first if time is None else min(max(time, first), last)


def page_limits() -> Limits:
    """Returns the limits of the programs of a page."""
    return Limits.strict(progress=False, require=())


def camera_of(world: World) -> dict[str, Any]:
    """Returns the camera of a world for the page."""
    camera = world.camera
    return {"camera": {"eye": camera.eye, "target": camera.target, "fov": camera.fov}}


# -- worlds that are simulated ----------------------------------------------------------------


# The last firings of triggers that a page gets.
MAX_FIRINGS = 5000


class LiveSource:
    """A world that is simulated.

    Attributes:
        interpreter: the interpreter that has the world.
        world: the world.
        name: the name of the world there.
        latest: the last frame; None if nobody looks.
        firings: the triggers that fired while somebody looked, with the simulated times, s.
    """

    def __init__(self, ss: Interpreter, world: World, name: str) -> None:
        self.interpreter = ss
        self.world, self.name = world, name
        self.latest: Frame | None = None
        self.firings: list[tuple[str, float]] = []
        # Is held while another world takes the place of this one.
        self.replacing = threading.Lock()
        self._changed: Callable[[], object] | None = None
        self._stop_listening: Callable[[], None] | None = None
        self._present: Mirror | None = None
        self._past: dict[str, Mirror] = {}
        self._scene: tuple[Frame, bytes] | None = None

    @property
    def about(self) -> dict[str, Any]:
        """The name of the world, and that it is live."""
        return {"world": self.name, "kind": "live"}

    # -- following ----------------------------------------------------------------------------

    def watch(self, changed: Callable[[], object] | None) -> None:
        """Follows the world while there is someone to tell: else a step costs nothing more."""
        if self._stop_listening is not None:
            self._stop_listening()
            self._stop_listening = None
        self._changed = changed
        if changed is None:
            self.world.unfollow(self)
            self.latest = None
        else:
            self.world.follow(self)
            self._stop_listening = listen_to_triggers(self.interpreter, self._fired)

    def _fired(self, trigger: str) -> None:
        self.firings.append((trigger, self.world.time))
        del self.firings[:-MAX_FIRINGS]

    def due(self, _world: Any, /) -> float:
        """Requests no ticks: the page shows those that are taken."""
        return float("inf")

    def ticked(self, world: Any, /) -> None:
        """Takes the frame of a tick, and tells of it."""
        with world.lock:
            self.latest = Frame.of(world.snapshot)
        changed = self._changed
        if changed is not None:
            changed()

    def replace_world(self, world: World) -> None:
        """Shows another world, of the same name, from now on."""
        changed = self._changed
        self.watch(None)
        self.world, self.latest = world, None
        self.firings.clear()
        self.watch(changed)
        if changed is not None:
            changed()

    # -- poses --------------------------------------------------------------------------------

    def frame(self, time: float | None) -> Frame:
        """Returns the last frame, or the one at a recorded time."""
        record = self._record
        if time is not None and record is not None and len(record.ticks):
            world = self.world
            with world.lock:
                numbers, times = record.ticks_until_now()
                clipped = min(max(time, float(times[0])), float(times[-1]))
                place = index_at(world.name, clipped, times, float(times[-1]))
                return Frame.of(record.at(int(numbers[place])).snapshot)
        latest = self.latest
        if self._changed is None or latest is None:
            with self.world.lock:
                self.latest = latest = Frame.of(self.world.snapshot)
        return latest

    def scene(self, frame: Frame) -> bytes:
        """Returns the scene of a frame; the same one until entities come or go."""
        if self._scene is None or not self._scene[0].has_same_scene(frame):
            simulator = self.world.simulator
            with self.world.lock:  # of a removed body, the simulator tells nothing or another's
                visuals = self.world.snapshot.drawn or partial(drawn_shapes, simulator)
                message = scene_message(frame, visuals, camera_of(self.world))
            self._scene = frame, message
        return self._scene[1]

    @property
    def _record(self) -> Record | None:
        history = history_of(self.interpreter, self.world)
        return None if history is None else history.record

    def ticks(self) -> Ticks | None:
        """Returns the recorded ticks; None if nothing is recorded."""
        record = self._record
        if record is None:
            return None
        with self.world.lock:
            return Ticks(record.ticks.numbers.copy(), record.ticks.times.copy())

    def track(self, frame: Frame, first: int, count: int) -> Track | None:
        """Returns the poses at recorded ticks."""
        record = self._record
        return None if record is None else track_of(record, frame, first, count)

    # -- queries ------------------------------------------------------------------------------

    def mirror(self, time: float | None) -> Asked:
        """Returns a copy of the last tick or of a recorded one."""
        if time is not None:
            return self._at("asked", time)
        self._present = mirror = self._up_to_date(self._present, is_past=False)
        return Asked(mirror.interpreter, mirror.world)

    def recorded(self) -> Asked:
        """Returns a copy that goes through the recorded ticks."""
        return self._at("scanned", None)

    def _at(self, use: str, time: float | None) -> Asked:
        """Returns the copy for a use at a recorded time, s; None for any."""
        self._past[use] = mirror = self._up_to_date(self._past.get(use), is_past=True)
        world = mirror.world
        assert isinstance(world, ReplayedWorld)
        if time is not None:
            times = world.ticker.record.ticks.times
            world.seek(min(max(time, float(times[0])), float(times[-1])))
        return Asked(mirror.interpreter, world)

    def _up_to_date(self, mirror: Mirror | None, *, is_past: bool) -> Mirror:
        world = self.world
        if mirror is not None and mirror.original is world and mirror.is_up_to_date:
            mirror.update()
            return mirror
        if mirror is not None:
            mirror.close()
        self.check_is_there()
        with world.lock:
            return Mirror(self.interpreter, world, self.name, page_limits(), is_past=is_past)

    def check_is_there(self) -> None:
        """Checks that the interpreter still has the world."""
        with self.replacing:
            if self.world not in self.interpreter.worlds:
                raise UnsupportedError(f"{self.name!r} is no longer in its interpreter")

    def close(self) -> None:
        """Closes the interpreters of the page; the world goes on."""
        self.watch(None)
        for mirror in (self._present, *self._past.values()):
            if mirror is not None:
                mirror.close()


Source: TypeAlias = LiveSource | RecordSource


# -- the simulation of a page -----------------------------------------------------------------


# The real time between two looks at what was asked, s: updates of the page come as often.
PERIOD = 1.0 / 30.0
MAX_SPEED = 100.0
# So many steps are taken between two looks at what was asked, at most.
MAX_STEPS = 100


class Simulation:
    """The simulation that a page controls, in a thread of its own; a reset loads the world anew."""

    def __init__(
        self, source: LiveSource, reload: Callable[[], World], changed: Callable[[], object]
    ) -> None:
        self._source, self._reload, self._changed = source, reload, changed
        self._condition = threading.Condition()
        self._is_playing, self._speed = False, 1.0
        self._steps, self._is_reset, self._is_over = 0, False, False
        self._error: str | None = None
        self._thread = threading.Thread(target=self._run, name="ssduck view", daemon=True)
        self._thread.start()

    @property
    def status(self) -> dict[str, Any]:
        """Whether it plays, its speed relative to real time, and what went wrong."""
        return {"playing": self._is_playing, "speed": self._speed, "error": self._error}

    def control(self, action: Any, value: Any = None) -> None:
        """Does what a page asks: `"play"`, `"pause"`, `"step"`, `"reset"`, or `"speed"`."""
        with self._condition:
            if action in ("play", "pause"):
                self._is_playing, self._steps = action == "play", 0
            elif action == "speed":
                speed = validation.number_above_0(value, "speed: a number above 0")
                self._speed = min(speed, MAX_SPEED)
            elif action == "step":
                self._is_playing = False
                self._steps += validation.integer(value or 1, "step: a number", minimum=1)
            elif action == "reset":
                self._is_reset, self._steps = True, 0
            else:
                raise ArgumentError(f"a page cannot ask for {str(action)[:40]!r}")
            self._condition.notify()
        self._changed()

    def close(self) -> None:
        """Ends the thread."""
        with self._condition:
            self._is_over = True
            self._condition.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._condition:
                while not (self._is_playing or self._steps or self._is_reset or self._is_over):
                    self._condition.wait()
                if self._is_over:
                    return
                steps = min(self._steps, MAX_STEPS)
                self._steps -= steps
                is_reset, self._is_reset = self._is_reset, False
                speed = self._speed if self._is_playing else 0.0
            try:
                self._advance(is_reset=is_reset, steps=steps, speed=speed)
            except SelectScriptError as error:
                self._is_playing, self._error = False, str(error)
                self._changed()

    def _advance(self, *, is_reset: bool, steps: int, speed: float) -> None:
        if is_reset:
            old = self._source.world
            with self._source.replacing:
                self._source.replace_world(self._reload())
            old.close()
        world = self._source.world
        if steps:
            world.step(steps)
        elif speed:
            started = time.monotonic()
            count = max(1, round(PERIOD * speed / world.timestep))
            world.step(count, every=None)
            # A simulation that is too slow for the speed runs as fast as it can.
            rest = count * world.timestep / speed - (time.monotonic() - started)
            if rest > 0:
                time.sleep(rest)
