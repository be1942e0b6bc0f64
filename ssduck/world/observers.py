"""Notifies observers of the ticks of a world.

A `TickObserver` is notified of each tick, and may request a tick at a simulated time: stepping
stops there, takes the tick and notifies all observers.
"""

from __future__ import annotations

import math
import threading
import weakref
from typing import Any, Protocol, TypeVar

T = TypeVar("T")
# The share of a step by which sums of steps may be off.
ROUNDING = 1e-6


class TickObserver(Protocol):
    """An observer of worlds; see `World.follow`."""

    def due(self, world: Any, /) -> float:
        """Returns the simulated time of the next requested tick of a world, s; inf for none.

        Stepping calls it between steps, so it must be quick. A past time means the next step.
        """

    def ticked(self, world: Any, /) -> None:
        """Handles a tick, which another observer may have requested; see `World.reached`."""


class EpisodeObserver(Protocol):
    """An observer of new episodes; see `Observers.follow_episodes`."""

    def episode_began(self, world: Any, /) -> None:
        """Handles the first tick of a new episode, before other observers get it."""


class Observers:
    """The observers of a world, to which there are weak references only.

    An argument `world` is always this world: its observers do not keep it alive.
    """

    def __init__(self, lock: threading.RLock) -> None:
        self._lock = lock
        self._of_ticks: tuple[weakref.ref[TickObserver], ...] = ()
        self._of_episodes: tuple[weakref.ref[EpisodeObserver], ...] = ()
        self._notifying = threading.Lock()

    def follow(self, observer: TickObserver) -> None:
        """Adds an observer of ticks; see `World.follow`."""
        with self._lock:
            self._of_ticks = _with(self._of_ticks, observer)

    def unfollow(self, observer: TickObserver) -> None:
        """Removes an observer of ticks."""
        with self._lock:
            self._of_ticks = tuple(ref for ref in self._of_ticks if ref() is not observer)

    def follow_episodes(self, observer: EpisodeObserver) -> None:
        """Adds an observer that is notified when the user has reset the simulation."""
        with self._lock:
            self._of_episodes = _with(self._of_episodes, observer)

    @property
    def are_there(self) -> bool:
        """Whether an observer is notified of the next tick."""
        is_alive = any(ref() is not None for ref in self._of_ticks)
        return is_alive and not self._notifying.locked()

    def steps_to_due(self, world: Any) -> float:
        """Returns the number of steps, 1 or more, to the next requested tick; inf for none."""
        if not self._of_ticks or self._notifying.locked():
            return math.inf
        observers = [ref() for ref in self._of_ticks]
        due = min((o.due(world) for o in observers if o is not None), default=math.inf)
        timestep = world.timestep
        if not timestep:
            return math.inf
        steps: float = max(1.0, (due - world.simulator.time) / timestep - ROUNDING)
        return steps if steps == math.inf else math.ceil(steps)

    def notify(self, world: Any) -> None:
        """Notifies the observers of the last tick; the caller must not hold a lock."""
        if not self._of_ticks or not self._notifying.acquire(blocking=False):
            return
        try:
            for ref in self._of_ticks:
                observer = ref()
                if observer is not None:
                    observer.ticked(world)
        finally:
            self._notifying.release()

    def notify_restart(self, world: Any) -> None:
        """Notifies the observers of a new episode; the caller must not hold a lock."""
        for ref in self._of_episodes:
            observer = ref()
            if observer is not None:
                observer.episode_began(world)


def _with(observers: tuple[weakref.ref[T], ...], observer: T) -> tuple[weakref.ref[T], ...]:
    """Returns the observers that are alive, with one that may be among them."""
    alive = [ref for ref in observers if ref() is not None]
    if not any(ref() is observer for ref in alive):
        alive.append(weakref.ref(observer))
    return tuple(alive)
