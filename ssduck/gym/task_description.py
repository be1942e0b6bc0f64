"""Describes a task as its file does, what an action is, and what is observed; it reads no file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError, SceneError
from ssduck.formatting import short_repr
from ssduck.gym.terms import Terms
from ssduck.recording.episode_steps import plain
from ssduck.simulators.toml_reader import TomlTable, Vector

WORLD = "sim"
# The default step of a task, s, which is rounded to steps of the simulator.
STEP_TIME = 0.02
# The keys of a task file.
_KEYS = (
    *("scene", "success", "failure", "stop_when", "reward", "nan", "observation", "variables"),
    *("actions", "starts", "seeds", "steps", "step_time"),
)


@dataclass(frozen=True)
class Action:
    """A joint that the action drives.

    Attributes:
        entity: the entity.
        joint: the joint.
        control: `position` or `velocity`.
        low: the least target, rad or m, or per second.
        high: the greatest.
    """

    entity: str
    joint: str
    control: str
    low: float
    high: float


@dataclass(frozen=True)
class Start:
    """A box in which an entity begins, drawn evenly at each reset.

    Attributes:
        entity: the entity.
        low: the least position x y z, m.
        high: the greatest.
    """

    entity: str
    low: Vector
    high: Vector


@dataclass(frozen=True)
class Task:
    """A task as a file describes it.

    Attributes:
        path: the file.
        values: what it holds.
        scene: the path of the scene.
        terms: success, failure, reward and end.
        observation: the numbers of an observation, by name.
        variables: constants of the terms.
        actions: the joints that an action drives, in its order.
        starts: where entities begin.
        seeds: the seeds with which the task is to be evaluated.
        steps: the number of steps after which an episode is over.
        step_time: the simulated time of a step, s.
    """

    path: Path
    values: Mapping[str, Any]
    scene: Path
    terms: Terms
    observation: Terms
    variables: Mapping[str, Any]
    actions: tuple[Action, ...]
    starts: tuple[Start, ...]
    seeds: tuple[int, ...]
    steps: int
    step_time: float


def task_of(file: Path, values: dict[str, Any]) -> Task:
    """Returns the task of what a file holds; it reads nothing more."""
    table = TomlTable(file, "", values)
    name = table.text("scene")
    if "\0" in name:
        table.fail("scene", f"{name!r} is no path")
    text = partial(table.text, default=None)  # type: ignore[arg-type]
    reward = values.get("reward")
    nan = values.get("nan", "error")
    table.read_keys.update(_KEYS)
    table.end()  # a misspelt term is no term
    try:
        terms = Terms.of(text("success"), text("failure"), reward, text("stop_when"), nan=nan)
        texts = _texts(table, "observation")
        observation = Terms.of(None, None, texts, None, table="observation", nan=nan)
        variables = {
            name: plain(value, f"variables.{name}")
            for name, value in table.table("variables").values.items()
        }
    except ArgumentError as error:
        raise SceneError(f"{file}: {error.message}") from error
    if WORLD in variables:
        raise SceneError(f"{file}: variables.{WORLD} is the world; give it another name")
    seeds = values.get("seeds", [0])
    if not isinstance(seeds, list) or not all(type(one) is int and one >= 0 for one in seeds):
        table.fail("seeds", f"expected a list of whole numbers from 0, found {seeds!r}")
    return Task(
        file,
        values,
        file.parent / name,
        terms,
        observation,
        variables,
        tuple(map(_action, table.tables("actions"))),
        tuple(map(_start, table.tables("starts"))),
        tuple(seeds),
        table.whole("steps", at_least=1) or 1000,
        table.number("step_time", STEP_TIME, above=0.0, at_most=60.0),
    )


def spaces(
    task: Task,
) -> tuple[gymnasium.Space[npt.NDArray[np.float32]], gymnasium.Space[npt.NDArray[np.float64]]]:
    """Returns the spaces of the actions and of the observations of a task."""
    low = np.array([action.low for action in task.actions], np.float32)
    high = np.array([action.high for action in task.actions], np.float32)
    shape = (len(task.observation.parts),)
    return (
        gymnasium.spaces.Box(low, high, dtype=np.float32),
        gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float64),
    )


def targets(task: Task, action: Any) -> list[float]:
    """Returns the targets of an action, one for each joint."""
    numbers = np.asarray(action, float)
    if numbers.shape != (len(task.actions),):
        raise ArgumentError(
            f"step: an action of this task has {len(task.actions)} numbers, and "
            f"{short_repr(action)} has the shape {numbers.shape}"
        )
    listed: list[float] = numbers.tolist()
    return listed


def _texts(table: TomlTable, key: str) -> Mapping[str, str]:
    """Returns terms by name."""
    value = table.values.get(key)
    if not isinstance(value, dict) or not value:
        table.fail(key, f"expected a table of terms, the numbers of an observation, not {value!r}")
    return value


def _action(table: TomlTable) -> Action:
    low, high = table.number("low"), table.number("high")
    if low >= high:
        table.fail("high", f"{high:g} is not above low, {low:g}")
    control = table.text("control", "position")
    if control not in ("position", "velocity"):
        table.fail("control", f"expected 'position' or 'velocity', found {control!r}")
    action = Action(table.text("entity"), table.text("joint"), control, low, high)
    table.end()
    return action


def _start(table: TomlTable) -> Start:
    start = Start(table.text("entity"), table.vector("low"), table.vector("high"))
    if any(low > high for low, high in zip(start.low, start.high, strict=True)):
        table.fail("high", "a number is less than that of low")
    table.end()
    return start
