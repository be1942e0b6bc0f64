"""How simulated time is counted: `Clock`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Clock:
    """Simulated time: steps of one length since some moment.

    Times are products, so that the rounding of many steps does not add up.

    Attributes:
        timestep: the length of a step, s.
        since: the simulated time from which the steps are counted, s.
        steps: how many steps have passed since then.
    """

    timestep: float
    since: float = 0.0
    steps: int = 0

    @property
    def time(self) -> float:
        """Simulated seconds."""
        return self.since + self.steps * self.timestep

    def after(self, steps: int, timestep: float) -> Clock:
        """The clock after that many more steps of a length, s, which may be another one."""
        if timestep != self.timestep:
            return Clock(timestep, self.time, steps)
        return Clock(timestep, self.since, self.steps + steps)

    def at(self, time: float, timestep: float) -> Clock:
        """The clock at a simulated time, s, from which steps of a length, s, are counted."""
        return Clock(timestep, time)
