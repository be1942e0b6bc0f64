"""Finds where the episodes of a MuJoCo simulation begin: `EpisodeClock`."""

from __future__ import annotations

from typing import Any

from ssduck.errors import ProgramWarning, warn
from ssduck.simulators.mujoco.library import mujoco

# MuJoCo's warnings of a state that it resets: `mj_resetData`, then a count of 1.
_UNSTABLE = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
]


class EpisodeClock:
    """Tells a reset, which begins an episode, from a time that falls within one.

    An episode begins with another model, and with a time that has fallen. It does not where MuJoCo
    itself reset an unstable state, nor if the user calls `begin_episode` at each reset, as
    `QueryWrapper` does. There time goes on, as that of a simulator without such a reset does.

    Args:
        data: the data of the simulation.

    Attributes:
        last: MuJoCo's time at the last tick, s.
        offset: what is added to MuJoCo's time, s.
    """

    def __init__(self, data: Any) -> None:
        self.last, self.offset = float(data.time), 0.0
        self._unstable = _unstable_states(data)
        # The simulated time between the last two ticks.
        self._interval = 0.0
        self._is_told = self._is_reset = False

    def begin(self) -> None:
        """Lets the next tick begin an episode; from now on, the user says where episodes begin."""
        self._is_told = self._is_reset = True

    def begins(self, data: Any, timestep: float, *, is_new: bool) -> bool:
        """Notes a tick; returns whether it begins an episode."""
        before, self.last = self.last, float(data.time)
        known, self._unstable = self._unstable, _unstable_states(data)
        is_reset, self._is_reset = self._is_reset, False
        has_fallen, is_same_time = self.last < before, self.last == before
        is_unstable = self._unstable > 0 and (
            has_fallen or (is_same_time and self._unstable != known)
        )
        if is_new or is_reset or (has_fallen and not is_unstable and not self._is_told):
            self.offset = 0.0
            return True
        if has_fallen or is_unstable:
            self._go_on(before, timestep, is_unstable=is_unstable)
        elif not is_same_time:
            self._interval = self.last - before
        return False

    def _go_on(self, before: float, timestep: float, *, is_unstable: bool) -> None:
        """Adds to MuJoCo's time what makes it go on from that of the last tick."""
        time = before + self.offset
        self.offset = time + (self._interval or max(self.last, timestep)) - self.last
        if is_unstable:
            reason = "MuJoCo reset a state that was unstable (a smaller timestep may help)"
        else:
            reason = "the simulation was reset without begin_episode()"
        warn(
            f"MuJoCo's time fell to {self.last:g} s within an episode, after {time:g} s: {reason}. "
            "The episode goes on, and its time too",
            ProgramWarning,
        )


def _unstable_states(data: Any) -> int:
    """Returns how many unstable states MuJoCo has counted since its last reset."""
    counts = data.warning.number
    return sum(int(counts[kind]) for kind in _UNSTABLE)
