"""The environment of a stranger's task, which is in a process that can do no harm."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ssduck.errors import LimitError, SelectScriptError
from ssduck.gym.tasks import Task, spaces, targets, task_of
from ssduck.gym.wrapper import check_open
from ssduck.limits import LEAST_OPENING, Limits
from ssduck.sandbox.interpreter import SandboxedInterpreter
from ssduck.sandbox.references import RUN_SECONDS
from ssduck.sandbox.sources import Source

# What is told of a process that has been taken over.
_NO_ANSWER = "the process of the task sent no answer of one"


class SandboxedTaskEnv(gymnasium.Env[npt.NDArray[np.float64], npt.NDArray[np.float32]]):
    """The environment of a task, all of which is in a sandbox; see `TaskEnv`.

    What ends its process is a LimitError, and the next `reset` starts another one.

    Args:
        file: the file, absolute.
        limits: the limits of its terms, and the effects that the sandbox must have.

    Attributes:
        task: the task.
        interpreter: the interpreter that has the world, in the sandbox.
    """

    def __init__(self, file: Path, limits: Limits) -> None:
        self._is_closed = False
        self.interpreter = SandboxedInterpreter(Source.of_task(file), limits=limits)
        try:
            self.task = _task(file, self.interpreter.ask("task.task.values"))
        except BaseException:
            self.close()
            raise
        self.action_space, self.observation_space = spaces(self.task)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float64], dict[str, Any]]:
        """Loads the scene, and puts entities where they begin."""
        check_open(self._is_closed, "reset")
        super().reset(seed=seed, options=options)
        answer = self.interpreter.ask("task.reset", seed=seed, seconds=LEAST_OPENING)
        observation, info = self._checked(answer, ())
        return observation, info

    def step(
        self, action: npt.NDArray[np.float32]
    ) -> tuple[npt.NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        """Sets the targets of joints, runs the scene, and evaluates the terms."""
        check_open(self._is_closed, "step")
        numbers = targets(self.task, action)
        seconds = self.task.step_time * RUN_SECONDS
        answer = self.interpreter.ask("task.step", numbers, seconds=seconds)
        observation, reward, has_ended, is_over, info = self._checked(answer, (float, bool, bool))
        return observation, reward, has_ended, is_over, info

    def close(self) -> None:
        """Ends the process."""
        self._is_closed = True
        self.interpreter.close()

    def _checked(self, answer: Any, kinds: Sequence[type]) -> Any:
        """Returns an observation, values of some types, and the info."""
        try:
            observation, *values, info = answer
            numbers = np.array(observation, np.float64)
            is_right = list(map(type, values)) == list(kinds) and type(info) is dict
        except (TypeError, ValueError):
            is_right = False
        if not is_right or numbers.shape != self.observation_space.shape:
            raise LimitError(f"{self.task.path}: {_NO_ANSWER}")
        return numbers, *values, info


def _task(file: Path, values: Any) -> Task:
    """Returns the task of what a process says that a file holds."""
    try:
        return task_of(file, values)
    except SelectScriptError:
        raise
    except Exception as error:
        raise LimitError(f"{file}: {_NO_ANSWER}") from error
