"""The count of simulated time."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Clock:
    """Simulated time: a number of steps of one length since a start.

    The time is a product, so that the rounding errors of many steps do not add up.

    >>> Clock(0.1).after(3, 0.1).time == 3 * 0.1
    True

    Attributes:
        timestep: the length of a step, s.
        since: the simulated time from which the steps are counted, s.
        steps: the number of steps since then.
    """

    timestep: float
    since: float = 0.0
    steps: int = 0

    @property
    def time(self) -> float:
        """Simulated seconds."""
        return self.since + self.steps * self.timestep

    def after(self, steps: int, timestep: float) -> Clock:
        """Returns the clock after more steps of a length, s; the length may be a new one."""
        if timestep != self.timestep:
            return Clock(timestep, self.time, steps)
        return Clock(timestep, self.since, self.steps + steps)

    def at(self, time: float, timestep: float) -> Clock:
        """Returns a clock that counts steps of a length, s, from a simulated time, s."""
        return Clock(timestep, time)
