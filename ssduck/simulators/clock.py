"""The count of simulated time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache

# Times that differ by less are equal, s.
TIME_TOLERANCE = 1e-9
# Lengths of steps and times that a user writes are fractions with denominators below this.
_MAX_DENOMINATOR = 1_000_000


@dataclass(frozen=True)
class Clock:
    """Simulated time: a number of steps of one length since a start.

    The time is rounded once: it is the number that a user writes for it. The step 0.1 stands for
    1/10, and 3 steps for 3/10; the product 3 * 0.1 is 0.30000000000000004.

    >>> Clock(0.1).after(3, 0.1).time
    0.3
    """

    timestep: float  # the length of a step, s
    since: float = 0.0  # the simulated time from which the steps are counted, s
    steps: int = 0  # the number of steps since then

    @cached_property
    def time(self) -> float:
        """Simulated seconds."""
        rough = self.since + self.steps * self.timestep
        if not math.isfinite(rough):
            return rough
        return float(_exact(self.since) + self.steps * _exact(self.timestep))

    def after(self, steps: int, timestep: float) -> Clock:
        """Returns the clock after more steps of a length, s; the length may be a new one."""
        if timestep != self.timestep:
            return Clock(timestep, self.time, steps)
        return Clock(timestep, self.since, self.steps + steps)


@lru_cache(maxsize=64)
def _exact(number: float) -> Fraction:
    """Returns the short fraction that a number stands for; where there is none, the number."""
    exact = Fraction(number)
    short = exact.limit_denominator(_MAX_DENOMINATOR)
    return short if float(short) == number else exact
