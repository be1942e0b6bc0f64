"""Runs a world in real time, as the page of `ssduck view` asks: play, pause, step, speed, reset."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from ssduck import validation
from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.view.live import LiveSource
from ssduck.world.world import World

# The real time between two looks at what was asked, s: updates of the page come as often.
PERIOD = 1.0 / 30.0
MAX_SPEED = 100.0
# So many steps are taken between two looks at what was asked, at most.
MAX_STEPS = 100


class Simulation:
    """The simulation that the page controls, in a thread of its own.

    Args:
        source: shows the world.
        reload: returns the world anew, as at the beginning.
        changed: is called when the state has changed.
    """

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
        """Does what a page asks.

        Args:
            action: `"play"`, `"pause"`, `"step"`, `"reset"` or `"speed"`.
            value: of `"speed"`, the speed relative to real time; of `"step"`, the number of steps.

        Raises:
            ArgumentError: there is no such action, or the value is wrong.
        """
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
