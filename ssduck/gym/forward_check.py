"""Tells of steps at which terms depend on which of MuJoCo's poses they see: `ForwardCheck`."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from ssduck.errors import ProgramWarning, warn
from ssduck.gym.judge import Judge
from ssduck.gym.terms import Judgement
from ssduck.interpreter.interpreter import Interpreter
from ssduck.limits import Limits
from ssduck.recording.spec import Recording
from ssduck.world.world import World

# The number of steps that are checked: each takes another forward pass and another statement.
_CHECKED = 1000


class ForwardCheck:
    """Judges steps by the poses of their joint positions, too, and warns where a term differs.

    Terms of poses alone are not compared: they always differ, by what moves within a step of the
    simulator. Those are compared for which this is much: flags, velocities and differences of time.

    After a step MuJoCo's poses are those at its beginning. Code that reads `qpos` is a step ahead
    of code that reads `xpos`; ssduck cannot know which of the two an environment reads.

    Args:
        environment: the unwrapped environment.
        judge: evaluates the terms by MuJoCo's poses.
        world: the name of the world.
        variables: the names of the variables.
        limits: the limits of terms.
    """

    def __init__(
        self,
        environment: Any,
        judge: Judge,
        world: str,
        variables: Sequence[str],
        limits: Limits | None,
    ) -> None:
        self._left, self._world = _CHECKED, world
        self._interpreter = Interpreter(
            recording=None, limits=limits and limits.in_process, strict=True
        )
        with warnings.catch_warnings():  # those of the world were given before
            warnings.simplefilter("ignore")
            attached = World.attach(environment, forward=True)
            self._interpreter.add_variable(world, attached)
            is_compared = dict(zip(judge.terms, judge.are_sensitive, strict=True))
            # The places of their values among those of all terms.
            self._places = [n for n, compared in enumerate(is_compared.values()) if compared]
            parts = {name: part for name, part in judge.terms.parts.items() if is_compared[part]}
            terms = replace(judge.terms, parts=parts, nan=0.0)  # whose errors the other judge has
            self._judge = Judge(terms, self._interpreter, world, variables, if_unknown="")
            if self._judge.needs_record:
                self._interpreter.record(world, Recording(tables=tuple(self._judge.past_tables)))

    def begin_episode(self, values: Mapping[str, Any]) -> None:
        """Takes the first tick after a reset."""
        if self._left:
            self._simulation.begin_episode()
            self._judge.begin_tick(values, is_first=True)
            self._judge.settle()

    def check(self, step: int, values: Mapping[str, Any], judgement: Judgement) -> None:
        """Takes a tick, and warns if a term differs, which ends the checks."""
        if not self._left:
            return
        self._left -= 1
        self._simulation.tick()
        self._judge.begin_tick(values)
        others = self._judge.judgement().computed
        for term, place, other in zip(self._judge.terms, self._places, others, strict=True):
            seen = judgement.computed[place]
            if _differ(seen, other):
                warn(
                    f"step {step}: {term.key} is {_shown(seen)} by MuJoCo's poses, which are those "
                    f"before the simulator's last step, and {_shown(other)} by the joint positions "
                    "after it: QueryWrapper(…, forward=True) if the environment's own code reads "
                    "qpos, forward=False if it reads xpos",
                    ProgramWarning,
                )
                self._left = 0
                break
        if not self._left:
            self.close()

    def close(self) -> None:
        """Ends the checks."""
        self._left = 0
        self._interpreter.close()

    @property
    def _simulation(self) -> World:
        world = self._interpreter[self._world]
        assert isinstance(world, World)
        return world


def _differ(a: bool | float | None, b: bool | float | None) -> bool:
    """Checks whether two values of a term differ by more than rounding; not if one is unknown."""
    return a is not None and b is not None and not math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-9)


def _shown(value: bool | float | None) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
