"""Tells of steps at which terms depend on which of MuJoCo's poses they see: `ForwardCheck`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from ssduck.errors import ProgramWarning, warn
from ssduck.gym.judge import Judge
from ssduck.gym.terms import Judgement, Terms
from ssduck.interpreter.interpreter import Interpreter
from ssduck.limits import Limits
from ssduck.recording.spec import Recording
from ssduck.world.world import World

# The number of steps that are checked: each takes another forward pass and another statement.
_CHECKED = 1000


class ForwardCheck:
    """Judges steps by the poses of their joint positions, too, and warns where a flag differs.

    After a step MuJoCo's poses are those at its beginning. Code that reads `qpos` is a step ahead
    of code that reads `xpos`; ssduck cannot know which of the two an environment reads.

    Args:
        environment: the unwrapped environment.
        terms: the terms.
        world: the name of the world.
        variables: the names of the variables.
        limits: the limits of terms.
    """

    def __init__(
        self,
        environment: Any,
        terms: Terms,
        world: str,
        variables: Sequence[str],
        limits: Limits | None,
    ) -> None:
        self._left, self._world = _CHECKED, world
        self._interpreter = Interpreter(recording=None, limits=limits, strict=True)
        with warnings.catch_warnings():  # those of the world were given before
            warnings.simplefilter("ignore")
            attached = World.attach(environment, forward=True)
            self._interpreter.add_variable(world, attached)
            flags = replace(terms, parts={})  # rewards are not compared
            self._judge = Judge(flags, self._interpreter, world, variables, if_unknown="")
            if tables := self._judge.past_tables:
                self._interpreter.record(world, Recording(tables=tuple(tables)))

    def begin_episode(self, values: Mapping[str, Any]) -> None:
        """Takes the first tick after a reset."""
        if self._left:
            self._simulation.begin_episode()
            self._judge.begin_tick(values, is_first=True)

    def check(self, step: int, values: Mapping[str, Any], judgement: Judgement) -> None:
        """Takes a tick, and warns if a flag differs, which ends the checks."""
        if not self._left:
            return
        self._left -= 1
        self._simulation.tick()
        self._judge.begin_tick(values)
        other = self._judge.judgement()
        flags = {"success": other.success, "failure": other.failure, "stop_when": other.stop}
        seen = {"success": judgement.success, "failure": judgement.failure}
        seen["stop_when"] = judgement.stop
        differing = next((name for name, flag in flags.items() if flag != seen[name]), None)
        if differing is not None:
            warn(
                f"step {step}: {differing} is {seen[differing]} by MuJoCo's poses, which are those "
                f"before the simulator's last step, and {flags[differing]} by the joint positions "
                "after it: QueryWrapper(…, forward=True) if the environment's own code reads "
                "qpos, forward=False if it reads xpos",
                ProgramWarning,
            )
            self._left = 0
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
