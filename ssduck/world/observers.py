"""Notifies observers of the ticks of a world.

A `TickObserver` is notified of each tick, and may request a tick at a simulated time: stepping
stops there, takes the tick and notifies all observers.
"""

from __future__ import annotations

import math
import threading
import weakref
from abc import ABC, abstractmethod
from typing import Any, Protocol

from ssduck.simulators.interface import Simulator

# The share of a step by which sums of steps may be off.
_ROUNDING = 1e-6


class TickObserver(Protocol):
    """An observer of worlds; see `Observable.follow`."""

    def due(self, world: Any, /) -> float:
        """Returns the simulated time of the next requested tick of a world, s; inf for none.

        Stepping calls it between steps, so it must be quick. A past time means the next step.
        """

    def ticked(self, world: Any, /) -> None:
        """Handles a tick, which another observer may have requested; see `Observable.reached`."""


class EpisodeObserver(Protocol):
    """An observer of new episodes; see `Observable.follow_episodes`."""

    def episode_began(self, world: Any, /) -> None:
        """Handles the first tick of a new episode, before other observers get it."""


class Observable(ABC):
    """A world as its observers see it."""

    lock: threading.RLock
    _simulator: Simulator

    @property
    @abstractmethod
    def time(self) -> float:
        """The simulated time of the last tick, s."""

    @property
    @abstractmethod
    def timestep(self) -> float:
        """The simulated time of the next step, s; 0 for a world that cannot be stepped."""

    def _init_observers(self) -> None:
        self._observers: tuple[weakref.ref[TickObserver], ...] = ()
        self._episode_observers: tuple[weakref.ref[EpisodeObserver], ...] = ()
        self._notifying = threading.Lock()

    def follow(self, follower: TickObserver) -> None:
        """Adds an observer, which may request ticks and is notified of all ticks.

        The observer is notified of the ticks of `step`, `run` and `tick`, in the thread that
        takes them. That thread then holds no lock of ssduck, so the observer may query any world.
        (An interpreter's lock is acquired before those of worlds; a thread that holds a world's
        `lock` must not step it.)

        If an observer or another thread steps the world during notification, these steps notify
        no one; the next tick notifies observers that became due meanwhile. So notifications do
        not recurse.

        The world has only a weak reference to the observer.

        Args:
            follower: the observer.
        """
        with self.lock:
            alive = [ref for ref in self._observers if ref() is not None]
            if not any(ref() is follower for ref in alive):
                alive.append(weakref.ref(follower))
            self._observers = tuple(alive)

    def unfollow(self, follower: TickObserver) -> None:
        """Removes an observer."""
        with self.lock:
            self._observers = tuple(ref for ref in self._observers if ref() is not follower)

    def follow_episodes(self, follower: EpisodeObserver) -> None:
        """Adds an observer that is notified when the user has reset the simulation.

        The world has only a weak reference to it.
        """
        with self.lock:
            alive = [ref for ref in self._episode_observers if ref() is not None]
            if not any(ref() is follower for ref in alive):
                alive.append(weakref.ref(follower))
            self._episode_observers = tuple(alive)

    def notify_restart(self) -> None:
        """Notifies the observers of a new episode; the caller must not hold a lock."""
        for ref in self._episode_observers:
            observer = ref()
            if observer is not None:
                observer.episode_began(self)

    def reached(self, due: float) -> bool:
        """Checks whether the last tick is at a simulated time or later, up to rounding."""
        return self.time >= due - self.slack

    @property
    def slack(self) -> float:
        """The rounding error allowed in a sum of steps, s: a millionth of a step."""
        return _ROUNDING * self.timestep

    @property
    def is_observed(self) -> bool:
        """Whether an observer is notified of the next tick."""
        is_alive = any(ref() is not None for ref in self._observers)
        return is_alive and not self._notifying.locked()

    def steps_to_due(self) -> float:
        """Returns the number of steps, 1 or more, to the next requested tick; inf for none."""
        if not self._observers or self._notifying.locked():
            return math.inf
        observers = [ref() for ref in self._observers]
        due = min((o.due(self) for o in observers if o is not None), default=math.inf)
        if not self.timestep:
            return math.inf
        steps = max(1.0, (due - self._simulator.time) / self.timestep - _ROUNDING)
        return steps if steps == math.inf else math.ceil(steps)

    def notify_observers(self) -> None:
        """Notifies the observers of the last tick; the caller must not hold a lock."""
        if not self._observers or not self._notifying.acquire(blocking=False):
            return
        try:
            for ref in self._observers:
                observer = ref()
                if observer is not None:
                    observer.ticked(self)
        finally:
            self._notifying.release()
