"""Describes tasks as their files do, and makes environments of them: `make_task`."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ssduck.errors import (
    ArgumentError,
    LimitError,
    ProgramWarning,
    SceneError,
    SelectScriptError,
    UnknownNameError,
    nearest,
    warn,
)
from ssduck.formatting import short_repr
from ssduck.gym.doubts import FirstTicks, warn_of_length
from ssduck.gym.judge import Judge
from ssduck.gym.terms import Judgement, Terms
from ssduck.gym.wrapper import INFO, check_open, described
from ssduck.interpreter.interpreter import Interpreter
from ssduck.limits import LEAST_OPENING, Limits
from ssduck.recording.episode_steps import plain
from ssduck.recording.paths import expand_path
from ssduck.recording.spec import Recording
from ssduck.sandbox.references import RUN_SECONDS
from ssduck.sandbox.sources import Source
from ssduck.simulators.scenes import Scene, find_scene
from ssduck.simulators.toml_reader import TomlTable, Vector
from ssduck.world.world import World

WORLD = "sim"
# The default step of a task, s, which is rounded to steps of the simulator.
STEP_TIME = 0.02
# The largest number of steps of the simulator, or of parts of these, in a step of a task.
MAX_STEPS = 100_000
# The largest size of a task file, bytes.
MAX_BYTES = 10_000_000
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


# -- the environment ---------------------------------------------------------------------------


class TaskEnv(gymnasium.Env[npt.NDArray[np.float64], npt.NDArray[np.float32]]):
    """The environment of a task; each reset loads its scene anew.

    Args:
        task: the task.
        limits: the limits of its terms.

    Attributes:
        task: the task.
        interpreter: the interpreter that has the world.
    """

    def __init__(self, task: Task, limits: Limits) -> None:
        self.task = task
        # The number of steps since the last reset; None before the first one.
        self._steps: int | None = None
        self._is_closed = False
        self._scene = _scene(task)
        self.interpreter = Interpreter(recording=None, limits=limits, strict=True)
        try:
            self._load()
            self._check_steps()
            for name, value in task.variables.items():
                self.interpreter.add_variable(name, value)
            self._judge, self._observer = (
                Judge(terms, self.interpreter, WORLD, (), if_unknown="set it in [variables]")
                for terms in (task.terms, task.observation)
            )
            self._record_past()
            self._judge.check()
            step = round(task.step_time / self._world.timestep) * self._world.timestep
            warn_of_length(self.interpreter, task.terms, task.steps * step)
            self._first_ticks = FirstTicks(task.terms)
            self._observer.check(may_be_constant=True)
            for number, action in enumerate(task.actions):
                self._check_joint(f"actions[{number}]", action)
            for number, start in enumerate(task.starts):
                self._entity(f"starts[{number}].entity", start.entity)
        except SelectScriptError as error:
            self.close()
            self._name_file(error)
            raise
        self.action_space, self.observation_space = spaces(task)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float64], dict[str, Any]]:
        """Loads the scene, and puts entities where they begin."""
        check_open(self._is_closed, "reset")
        super().reset(seed=seed, options=options)
        self._load()
        self._record_past()
        for number, start in enumerate(self.task.starts):
            position = self.np_random.uniform(start.low, start.high)
            try:
                self._world[start.entity].move(position.tolist())
            except SelectScriptError as error:
                error.message = f"starts[{number}]: {error.message}"
                self._name_file(error)
                raise
        self._steps = 0
        judgement, observation = self._judged(is_first=True)
        self._first_ticks.see(judgement)
        return observation, {INFO: described(judgement)}

    def step(
        self, action: npt.NDArray[np.float32]
    ) -> tuple[npt.NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        """Sets the targets of joints, runs the scene, and evaluates the terms."""
        check_open(self._is_closed, "step")
        numbers = targets(self.task, action)
        if self._steps is None:
            raise ArgumentError("step: call reset first")
        for one, number in zip(self.task.actions, numbers, strict=True):
            target = min(max(number, one.low), one.high)  # the space rounds the ends of the range
            _drive(self._world[one.entity], one, target)
        self._world.run(self.task.step_time, every=None)
        self._steps += 1
        judgement, observation = self._judged(is_first=False)
        reward = 0.0 if judgement.reward is None else judgement.reward
        is_over = self._steps >= self.task.steps
        info = {INFO: described(judgement)}
        return observation, reward, bool(judgement.stop), is_over, info

    def close(self) -> None:
        """Closes the simulation."""
        self._is_closed = True
        if WORLD in self.interpreter:
            self._world.close()
        self.interpreter.close()

    @property
    def _world(self) -> World:
        world = self.interpreter[WORLD]
        assert isinstance(world, World)
        return world

    def _load(self) -> None:
        """Loads the scene in place of the one before."""
        before = self._world if WORLD in self.interpreter else None
        self.interpreter.add_variable(WORLD, World.load(self._scene))
        if before is not None:
            before.close()

    def _check_steps(self) -> None:
        """Checks that a step of the task is some steps of the simulator, and not too many."""
        substeps = self._scene.engine.substeps or 1
        steps, timestep = self.task.step_time / self._world.timestep, self._world.timestep
        place = f"{self.task.path}: step_time: {self.task.step_time:g} s"
        if round(steps) < 1:
            raise SceneError(f"{place} is less than the simulator's time step, {timestep:g} s")
        is_given = self.task.step_time != STEP_TIME
        if is_given and abs(steps - round(steps)) > 1e-6 * steps:
            warn(
                f"{place} is no multiple of the simulator's time step, {timestep:g} s: a step "
                f"takes {round(steps) * timestep:g} s",
                ProgramWarning,
            )
        count = steps * substeps
        if count > MAX_STEPS:
            parts = f" ({substeps:,} substeps each)" if substeps > 1 else ""
            raise SceneError(
                f"{self.task.path}: step_time: {self.task.step_time:g} s are {count:.3g} steps of "
                f"the simulator{parts}, more than {MAX_STEPS:,}"
            )

    def _record_past(self) -> None:
        """Records the ticks in memory if a term reads them."""
        if tables := self._judge.past_tables | self._observer.past_tables:
            self.interpreter.record(WORLD, Recording(tables=tuple(tables)))

    def _judged(self, *, is_first: bool) -> tuple[Judgement, npt.NDArray[np.float64]]:
        """Returns the values of the terms and of the observation at the present tick."""
        try:
            for judge in (self._judge, self._observer):
                judge.begin_tick({}, is_first=is_first)
            observed = self._observer.judgement().parts
            return self._judge.judgement(), np.array(list(observed.values()))
        except SelectScriptError as error:
            self._name_file(error)
            raise

    def _name_file(self, error: SelectScriptError) -> None:
        """Lets the message of an error begin with the file, as those of scenes do."""
        if not isinstance(error, SceneError):
            error.message = f"{self.task.path}: {error.message}"

    def _entity(self, key: str, name: str) -> Any:
        try:
            return self._world[name]
        except SelectScriptError as error:
            message = f"{self.task.path}: {key}: {error.message}"
            raise SceneError(message, suggestions=error.suggestions) from error

    def _check_joint(self, key: str, action: Action) -> None:
        """Checks that a joint takes both ends of its range."""
        entity = self._entity(f"{key}.entity", action.entity)
        for end, target in (("low", action.low), ("high", action.high)):
            try:
                _drive(entity, action, target)
            except SelectScriptError as error:
                place = f"{key}.{'joint' if isinstance(error, UnknownNameError) else end}"
                message = f"{self.task.path}: {place}: {error.message}"
                raise SceneError(message, suggestions=error.suggestions) from error


def _drive(entity: Any, action: Action, target: float) -> None:
    kind = "positions" if action.control == "position" else "velocities"
    entity.drive(**{kind: {action.joint: target}})


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
        from ssduck.sandbox.interpreter import SandboxedInterpreter

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


def make_task(path: str | Path, *, limits: Limits | None = None) -> TaskEnv | SandboxedTaskEnv:
    """Returns the environment of a task that a TOML file describes.

    A task has no code. With `limits=Limits.strict()` it may come from a stranger: all of it is in
    a sandbox, a process that reads nothing but the libraries and the folder of the task, and can do
    no harm. What takes too long there, or ends the process, is a LimitError, and the next `reset`
    starts another one.

    Args:
        path: the file.
        limits: the limits of its terms. By default those of `Limits.strict()`, in this process:
            for tasks of your own, whose scene may be anywhere.

    Raises:
        SceneError: the file cannot be read, or the scene; the message has file and key.
        SelectScriptError: a term is wrong; the message has the file and the key.
        SandboxError: the system has no sandbox.
    """
    file = expand_path(path).absolute()
    if limits is not None and limits.is_sandboxed:
        return SandboxedTaskEnv(file, limits)
    return task_env(file, Limits.strict(require=()) if limits is None else limits)


def task_env(path: str | Path, limits: Limits) -> TaskEnv:
    """Returns the environment of a task, which is in this process."""
    file = Path(path)
    if not file.is_file():  # a pipe would be waited for, and a device read without end
        raise SceneError(f"{file}: there is no such file")
    try:
        if file.stat().st_size > MAX_BYTES:
            raise SceneError(f"{file}: it has more than {MAX_BYTES:,} bytes")
        values = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:  # a TOMLDecodeError is a ValueError
        reason = error.strerror if isinstance(error, OSError) else error
        raise SceneError(f"{file}: {reason}") from error
    except RecursionError:
        raise SceneError(f"{file}: it is nested too deeply") from None
    return TaskEnv(task_of(file, values), limits)


def _scene(task: Task) -> Scene:
    place, folder = task.scene.resolve(), task.path.parent
    if not place.exists():
        names: list[str] = []
        with suppress(OSError):  # a sandbox lists no folder
            names = [other.name for other in folder.iterdir()]
        told = f"there is no file {task.values['scene']!r} beside the task file"
        TomlTable(task.path, "", {}).fail("scene", told, nearest(task.scene.name, names))
    return find_scene(place)
