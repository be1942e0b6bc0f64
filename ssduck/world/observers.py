"""Who wants ticks of a world at certain simulated times: `TickObserver`, and a world's side of it.

A follower says when it wants the next tick; stepping stops there, takes it, and tells all
followers. Steps at whose end nobody wants a tick take none.
"""

from __future__ import annotations

import math
import threading
import weakref
from abc import ABC, abstractmethod
from typing import Any, Protocol

from ssduck.simulators.interface import Simulator

# The part of a step by which sums of steps may be off.
_ROUNDING = 1e-6


class TickObserver(Protocol):
    """Who follows worlds; see `Observable.follow`."""

    def due(self, world: Any, /) -> float:
        """The simulated time, s, at which it next wants a tick of a world; inf for none.

        It is asked between steps and must be quick. A time that is past: after the next step.
        """

    def ticked(self, world: Any, /) -> None:
        """Be told of a tick, which need not be one that it wanted: `reached` tells."""


class Observable(ABC):
    """What of a world its followers use."""

    lock: threading.RLock
    _simulator: Simulator

    @property
    @abstractmethod
    def time(self) -> float:
        """Simulated seconds at the last tick."""

    @property
    @abstractmethod
    def timestep(self) -> float:
        """Simulated seconds that the next step takes; 0 where there are no steps."""

    def _begin_following(self) -> None:
        self._followers: tuple[weakref.ref[TickObserver], ...] = ()
        self._telling = threading.Lock()

    def follow(self, follower: TickObserver) -> None:
        """Let a follower say when it wants ticks, and tell it of those that are taken.

        It is told of the ticks of `step`, `run` and `tick`, in the thread that takes them, with
        no lock of ssduck's held, so that it may query any world: an interpreter's lock comes
        before those of worlds, and who holds a world's `lock` must not step it.

        While followers are told, a step that one of them makes, or another thread, runs through
        and tells nobody; what became due meanwhile is told of with the next tick. So nothing
        recurses.

        The world does not keep it alive: it follows until it is gone, or `unfollow`.
        """
        with self.lock:
            kept = [ref for ref in self._followers if ref() is not None]
            if not any(ref() is follower for ref in kept):
                kept.append(weakref.ref(follower))
            self._followers = tuple(kept)

    def unfollow(self, follower: TickObserver) -> None:
        """Tell a follower nothing any more."""
        with self.lock:
            self._followers = tuple(ref for ref in self._followers if ref() is not follower)

    def reached(self, due: float) -> bool:
        """Whether the last tick is of that simulated time or a later one, rounding aside."""
        return self.time >= due - self.slack

    @property
    def slack(self) -> float:
        """Seconds that a sum of steps may be off by rounding: a millionth of a step."""
        return _ROUNDING * self.timestep

    def steps_to_due(self) -> float:
        """After how many steps, at least 1, a follower wants a tick; inf if none does."""
        if not self._followers or self._telling.locked():
            return math.inf
        followers = [ref() for ref in self._followers]
        due = min((f.due(self) for f in followers if f is not None), default=math.inf)
        if not self.timestep:
            return math.inf
        steps = max(1.0, (due - self._simulator.time) / self.timestep - _ROUNDING)
        return steps if steps == math.inf else math.ceil(steps)

    def notify_observers(self) -> None:
        """Tell the followers of the last tick; the caller holds no lock."""
        if not self._followers or not self._telling.acquire(blocking=False):
            return
        try:
            for ref in self._followers:
                follower = ref()
                if follower is not None:
                    follower.ticked(self)
        finally:
            self._telling.release()
