"""What a page shows: a world that is simulated, or a record.

A source gives frames (the poses of all links at a tick) and mirrors: worlds for the queries of the
page, which hold no lock of the simulation while they run.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.opening import open_record
from ssduck.limits import Limits
from ssduck.recording.replay.replayed_world import ReplayedWorld
from ssduck.simulators.backends import drawn_shapes
from ssduck.simulators.visuals import collision_visuals
from ssduck.view.frames import Frame
from ssduck.view.messages import scene_message
from ssduck.world.world import World


class Source(Protocol):
    """A world that is shown."""

    @property
    def interpreter(self) -> Interpreter:
        """The strict interpreter of the page's queries."""

    @property
    def about(self) -> dict[str, Any]:
        """What a page has to know at the beginning."""

    def frame(self, time: float | None) -> Frame:
        """Returns the frame at a simulated time, s; the present or last one for None."""

    def scene(self, frame: Frame) -> bytes:
        """Returns the message of the scene of a frame."""

    def mirror(self, time: float | None) -> World:
        """Returns the world at a time, bound to its name in the interpreter."""

    def watch(self, changed: Callable[[], object] | None) -> None:
        """Sets what is called at each new tick, in any thread; None to stop that."""

    def close(self) -> None:
        """Releases what belongs to the source itself."""


class LiveSource:
    """A world that is simulated.

    Args:
        world: the world.
        name: the variable of the world in queries.
    """

    def __init__(self, world: World, name: str) -> None:
        self.world, self._name = world, name
        self.interpreter = Interpreter(recording=None, limits=page_limits())
        self.interpreter.strict = True
        self._latest: Frame | None = None
        self._changed: Callable[[], object] | None = None
        self._mirrored: tuple[World, int, int] | None = None
        self._scene: tuple[Frame, bytes] | None = None

    @property
    def about(self) -> dict[str, Any]:
        """The name of the world, and that it is live."""
        return {"world": self._name, "kind": "live"}

    def watch(self, changed: Callable[[], object] | None) -> None:
        """Follows the world while there is someone to tell: else a step costs nothing more."""
        self._changed = changed
        if changed is None:
            self.world.unfollow(self)
        else:
            self.world.follow(self)

    def due(self, _world: Any, /) -> float:
        """Requests no ticks: the page shows those that are taken."""
        return float("inf")

    def ticked(self, world: Any, /) -> None:
        """Takes the frame of a tick, and tells of it."""
        with world.lock:
            self._latest = Frame.of(world.snapshot)
        changed = self._changed
        if changed is not None:
            changed()

    def replace_world(self, world: World) -> None:
        """Shows another world, of the same name, from now on."""
        changed = self._changed
        self.watch(None)
        self.world, self._latest, self._mirrored = world, None, None
        self.watch(changed)
        if changed is not None:
            changed()

    def frame(self, time: float | None) -> Frame:  # noqa: ARG002
        """Returns the last frame."""
        latest = self._latest
        if self._changed is None or latest is None:
            with self.world.lock:
                self._latest = latest = Frame.of(self.world.snapshot)
        return latest

    def scene(self, frame: Frame) -> bytes:
        """Returns the scene of a frame; the same one until entities come or go."""
        if self._scene is None or not self._scene[0].has_same_scene(frame):
            simulator = self.world.simulator
            with self.world.lock:
                visuals = partial(drawn_shapes, simulator)
                message = scene_message(frame, visuals, camera_of(self.world))
            self._scene = frame, message
        return self._scene[1]

    def mirror(self, time: float | None) -> World:  # noqa: ARG002
        """Returns a copy of the present tick, which the simulation does not change."""
        world = self.world
        with world.lock:
            run, number = world.snapshot.run, world.snapshot.number
            if self._mirrored is not None and self._mirrored[1:] == (run, number):
                return self._mirrored[0]
            copy = world.what_if()
        self.interpreter.add_variable(self._name, copy)
        self._mirrored = copy, run, number
        return copy

    def close(self) -> None:
        """Closes the interpreter of the page; the world goes on."""
        self.watch(None)
        self.interpreter.close()


class RecordSource:
    """A record, whose ticks are all there.

    Args:
        path: the path of the record.
        episode: the number of the episode; None for the last one.
    """

    def __init__(self, path: str | Path, episode: int | None) -> None:
        with contextlib.ExitStack() as stack:
            self.interpreter = open_record(path, episode=episode, limits=page_limits())
            stack.callback(self.interpreter.close)
            self.interpreter.strict = True
            self._world = self._first_world(self.interpreter)
            # Poses are read by an interpreter of their own, so that no query delays them.
            self._shown = open_record(path, self._world.name, episode=episode)
            stack.pop_all()
        self._frames = self._first_world(self._shown)
        self._lock = threading.Lock()
        self._scene: tuple[Frame, bytes] | None = None

    @staticmethod
    def _first_world(ss: Interpreter) -> ReplayedWorld:
        world = ss.worlds[0]
        assert isinstance(world, ReplayedWorld)
        return world

    @property
    def about(self) -> dict[str, Any]:
        """The name of the world, and the times of its ticks, s."""
        times = self._frames.source_record.ticks.times
        return {"world": self._world.name, "kind": "record", "times": times.tolist()}

    def watch(self, changed: Callable[[], object] | None) -> None:
        """Does nothing: a record does not change."""

    def frame(self, time: float | None) -> Frame:
        """Returns the frame at a time; the first one for None."""
        with self._lock:
            times = self._frames.source_record.ticks.times
            first, last = float(times[0]), float(times[-1])
            self._frames.seek(first if time is None else min(max(time, first), last))
            frame = Frame.of(self._frames.snapshot)
            frame.poses  # noqa: B018  # computed here, as the next tick is restored in its place
            return frame

    def scene(self, frame: Frame) -> bytes:
        """Returns the scene of a frame; the same one until entities come or go."""
        if self._scene is None or not self._scene[0].has_same_scene(frame):
            self._scene = frame, scene_message(frame, collision_visuals, camera_of(self._frames))
        return self._scene[1]

    def mirror(self, time: float | None) -> World:
        """Returns the world at a time."""
        times = self._world.source_record.ticks.times
        first, last = float(times[0]), float(times[-1])
        self._world.seek(first if time is None else min(max(time, first), last))
        return self._world

    def close(self) -> None:
        """Closes the record."""
        self._shown.close()
        self.interpreter.close()


def page_limits() -> Limits:
    """Returns the limits of the programs of a page."""
    return Limits.strict(progress=False)


def camera_of(world: World) -> dict[str, Any]:
    """Returns the camera of a world for the page."""
    camera = world.camera
    return {"camera": {"eye": camera.eye, "target": camera.target, "fov": camera.fov}}
