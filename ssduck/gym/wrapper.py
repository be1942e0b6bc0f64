"""Computes success, failure and reward of an environment by queries: `QueryWrapper`."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsFloat, TypeAlias

import gymnasium

from ssduck import validation
from ssduck.errors import ArgumentError, ProgramWarning, SimulatorError, warn
from ssduck.formatting import short_repr
from ssduck.gym.doubts import FirstTicks, episode_seconds, time_limit, warn_of_length
from ssduck.gym.judge import Judge
from ssduck.gym.terms import Judgement, Reward, Terms, WhereNaN
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.namespace import check_name
from ssduck.limits import Limits
from ssduck.recording.episode_steps import EpisodeSteps, action_numbers, plain, recordable
from ssduck.recording.folder_recording import ParquetRecording
from ssduck.recording.paths import expand_path
from ssduck.recording.spec import Recording
from ssduck.simulators.recognition import client_of, parts_of
from ssduck.world.world import World

if TYPE_CHECKING:
    from ssduck.gym.batch_terms import BatchJudgement

# The key of a step's `info`.
INFO = "ssduck"
# What to do about a variable that there is not.
_IF_UNKNOWN = (
    "for a value of the environment, give variables={{'{name}': lambda env: env.{name}}}, say"
)
_STEP_AFTER_END = (
    "step: the environment has ended, and a step further belongs to the same episode: call reset; "
    "for one that resets itself, put gymnasium.wrappers.Autoreset around QueryWrapper"
)
# gymnasium's wrapper that resets at the step after the end; gymnasium 0.29 has none.
_AUTORESET: tuple[type[Any], ...] = tuple(
    filter(None, [getattr(gymnasium.wrappers, "Autoreset", None)])
)
# What `info` has where an environment resets itself at the end.
_REPLACED = ("final_observation", "final_obs")
# Returns what only Python knows: the value of a variable, from the environment.
VariableReader: TypeAlias = Callable[[gymnasium.Env[Any, Any]], Any]


class QueryWrapper(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """An environment whose success, failure and reward are queries on its simulation.

    A tick is taken at each reset and after each step, and at most one statement gives the values of
    all terms: `info["ssduck"]` has `success`, `failure`, `reward` and `parts`. Terms name entities
    as `sim.cup`. Their past begins at the last reset: by you, or by gymnasium's `Autoreset` within,
    whose step after an end is the first tick of an episode. Where MuJoCo resets an unstable state,
    the episode goes on.

    Args:
        env: the environment; its unwrapped one has a MuJoCo model with its data, or a PyBullet
            client.
        success: a condition: whether the task is done.
        failure: a condition: whether it has failed.
        reward: a number that replaces the reward of the environment, or numbers by name, which are
            added.
        stop_when: a condition that ends an episode (`terminated`), as the environment's own does.
            It may use `success` and `failure` by name, as a reward may.
        world: the name of the world in terms.
        variables: functions of the unwrapped environment, by the name of the variable that has
            their value. They are called after each reset and step. One that changes
            within an episode cannot be in a function of time, such as `previous`.
        record_to: a folder for the record of all episodes; it may have others.
        recording: the tables and entities that are recorded; all by default.
        forward: for MuJoCo, whether terms see the poses that belong to the joint positions of the
            step, `qpos`, in place of those before the simulator's last step, which `xpos` has:
            True if the environment's own code reads `qpos`, False if it reads `xpos`. None is
            False, with a warning at the first of 1,000 steps at which a flag depends on it, or a
            number that says how fast something moves or that reads the past, such as `rate`.
        step_time: for PyBullet, the simulated time of a step of the environment, s; None for one
            step of the client.
        nan: what a term is that cannot be computed, since a pose, a velocity or a variable is NaN,
            or a pose or a velocity was at an earlier step that a function of time reads:
            `"error"`; `"failure"`, where the episode has failed and ends, and the reward's part is
            0; or a number for the reward's part, where a condition is False and the episode goes
            on.
        limits: the limits of terms, which run in this process.
        why: whether `info["ssduck"]` has `why` at the end of an episode, the text of `WHY` success
            holds or not; a past that a term reads is then recorded.

    Raises:
        SimulatorError: the environment has no simulation that is known.
        UnknownNameError: a term has a name that nothing has; with the nearest names.
        ArgumentError: a term is of the wrong type, or can never change.
        SelectScriptError: a term is wrong otherwise.

    Warns:
        ProgramWarning: a term asks for more time than an episode has, which gymnasium's `TimeLimit`
            ends; or success, failure or the end held at the first tick of each of ten episodes.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        success: str | None = None,
        failure: str | None = None,
        reward: Reward | None = None,
        stop_when: str | None = None,
        *,
        world: str = "sim",
        variables: Mapping[str, VariableReader] | None = None,
        record_to: str | Path | None = None,
        recording: Recording | None = None,
        forward: bool | None = None,
        step_time: float | None = None,
        nan: WhereNaN = "error",
        limits: Limits | None = None,
        why: bool = False,
    ) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(
            self,
            success=success,
            failure=failure,
            reward=reward,
            stop_when=stop_when,
            world=world,
            variables=variables,
            record_to=record_to,
            recording=recording,
            forward=forward,
            step_time=step_time,
            nan=nan,
            limits=limits,
            why=why,
        )
        gymnasium.Wrapper.__init__(self, env)
        check_name(world, "a world")
        self._terms = Terms.of(success, failure, reward, stop_when, nan=nan)
        self._variables = _checked_variables(variables)
        self._step_time = None if step_time is None else validation.seconds(step_time, "step_time")
        self._folder = None if record_to is None else expand_path(record_to).absolute()
        self._recording, self._forward, self._world = recording, bool(forward), world
        self._tells_why = why and success is not None
        self._forward_check: ForwardCheck | None = None
        self._steps: EpisodeSteps | None = None
        self._record: ParquetRecording | None = None
        self._is_saved, self._is_closed = True, False
        # Whether the environment ended at the last step, and was not reset since.
        self._has_ended = False
        self._interpreter = interpreter_of_terms(limits)
        try:
            self._client = self._attach()
            self._judge = Judge(
                self._terms,
                self._interpreter,
                world,
                tuple(self._variables),
                if_unknown=_IF_UNKNOWN,
            )
            if forward is None and self._client is None and any(self._judge.are_sensitive):
                parts = self.env.unwrapped, self._judge, world, tuple(self._variables)
                self._forward_check = ForwardCheck(*parts, limits)
            # The number of steps of an episode at most, until its duration is known.
            self._limit = time_limit(env)
            self._first_ticks = FirstTicks(self._terms)
            seconds = episode_seconds(env, self._step_time)
            if seconds is not None:
                self._warn_of_length(seconds)
            # The first reset may build the simulation, or give variables their values.
            self._is_checked = False
            if len(self._judge.world):
                self._check_first()
        except BaseException:
            self._interpreter.close()
            raise

    @property
    def interpreter(self) -> Interpreter:
        """The interpreter that has the world: for queries, triggers and records of your own."""
        return self._interpreter

    # -- gymnasium's methods --------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Resets the environment, and begins an episode of the record."""
        check_open(self._is_closed, "reset")
        self._save()
        observation, info = self.env.reset(seed=seed, options=options)
        judgement = self._begin_episode(seed, recordable(options))
        return observation, info | {INFO: described(judgement)}

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Steps the environment, and evaluates the terms."""
        check_open(self._is_closed, "step")
        if self._steps is None:
            raise ArgumentError("step: call reset first")
        taken = action_numbers(action)  # before the environment may change it
        is_reset = _resets_next(self.env)
        if is_reset:
            self._save()
        elif self._has_ended:
            self._has_ended = False
            warn(_STEP_AFTER_END, ProgramWarning)
        observation, reward, terminated, truncated, info = self.env.step(action)
        _check_last_state(info)
        if is_reset:
            judgement = self._begin_episode(None, None)
            return observation, reward, terminated, truncated, info | {INFO: described(judgement)}
        simulation = self._judge.world
        self._judge.begin_step()
        try:
            self._take_tick(simulation, self._steps)
            values = self._set_variables(is_first=False)
            judgement = self._judge.judgement()
        except BaseException:
            self._judge.settle()
            raise
        if judgement.reward is not None:
            reward = judgement.reward
        if self._forward_check is not None:
            self._forward_check.check(len(self._steps.times), values, judgement)
        terminated = bool(terminated or judgement.stop)
        self._has_ended = bool(terminated or truncated)
        self._steps.add_tick(simulation.tick_number, simulation.time, values)
        self._steps.rewards.append(float(reward))
        self._steps.add_action(taken)
        self._steps.success = judgement.success
        self._is_saved = False
        told = described(judgement)
        if self._has_ended:
            if len(self._steps.times) - 1 == self._limit:
                self._warn_of_length(self._steps.times[-1] - self._steps.times[0])
            self._save()
            if self._tells_why:
                told["why"] = self._judge.why_success()
        return observation, reward, terminated, truncated, info | {INFO: told}

    def _take_tick(self, simulation: World, steps: EpisodeSteps) -> None:
        run = simulation.snapshot.run
        if self._client is None or self._step_time is None:
            simulation.tick()
        else:
            simulation.tick(time=len(steps.times) * self._step_time)
        if simulation.snapshot.run != run:
            self._steps = None
            raise SimulatorError(
                "step: the environment made its simulation anew within an episode, whose past is "
                "gone: call reset"
            )

    def close(self) -> None:
        """Completes the record, and closes the environment."""
        self._is_closed = True
        try:
            self._save()
            if self._record is not None:
                self._record.close()
        finally:
            if self._forward_check is not None:
                self._forward_check.close()
            self._interpreter.close()
            super().close()

    # -- the world --------------------------------------------------------------------------------

    def _attach(self) -> int | None:
        """Attaches the simulation; returns the number of its client if it is PyBullet's."""
        simulation = self.env.unwrapped
        client = None if parts_of(simulation) is not None else client_of(simulation)
        if client is None and parts_of(simulation) is None:
            raise SimulatorError(
                f"QueryWrapper: {short_repr(simulation)} has no simulation that ssduck knows: no "
                "MuJoCo model with its data, neither itself nor as physics or sim, and no PyBullet "
                "client (_client, physics_client)"
            )
        attached = World.attach(simulation if client is None else client, forward=self._forward)
        self._interpreter.add_variable(self._world, attached)
        return client

    def _begin_episode(self, seed: int | None, options: Any) -> Judgement:
        """Takes the first tick after a reset; returns what the terms say of it."""
        self._has_ended = False
        if self._client is not None and client_of(self.env.unwrapped) != self._client:
            if self._record is not None:
                self._record.close()
                self._record = None
            self._client = self._attach()
            self._record_past()
        else:
            self._judge.world.begin_episode()
        self._steps = EpisodeSteps(self._terms.texts, seed, options)
        values = self._set_variables(is_first=True)
        if self._forward_check is not None:
            self._forward_check.begin_episode(values)
        if not self._is_checked:
            self._record_past()
            self._judge.check()
            self._is_checked = True
        if self._folder is not None and self._record is None:
            self._record = self._interpreter.record_to(self._folder, self._world, self._recording)
        judgement = self._judge.judgement()
        self._first_ticks.see(judgement)
        simulation = self._judge.world
        self._steps.add_tick(simulation.tick_number, simulation.time, values)
        return judgement

    def _warn_of_length(self, seconds: float) -> None:
        """Warns of terms that ask for more time than an episode has."""
        self._limit = None
        warn_of_length(self._interpreter, self._terms, seconds)

    def _check_first(self) -> None:
        """Checks the terms before the first reset, which may be what sets variables."""
        self._record_past()
        try:
            has_values = [] not in self._set_variables(is_first=True).values()
        except Exception:  # noqa: BLE001  # whatever it is, the first reset raises it
            has_values = False
        self._judge.check(with_variables=has_values)
        self._is_checked = has_values

    def _record_past(self) -> None:
        """Records the ticks of the world in memory if a term reads them."""
        if self._judge.needs_record or (self._tells_why and self._judge.past_tables):
            self._interpreter.record(self._world, Recording(tables=tuple(self._judge.past_tables)))

    def _set_variables(self, *, is_first: bool) -> dict[str, Any]:
        """Sets the variables to their values now, and returns these."""
        environment = self.env.unwrapped
        values = {}
        for name, read in self._variables.items():
            values[name] = plain(read(environment), f"variables[{name!r}]")
        self._judge.begin_tick(values, is_first=is_first)
        return values

    def _save(self) -> None:
        """Writes the steps of the present episode."""
        if self._is_saved or self._steps is None:
            return
        if self._record is not None and self._folder is not None:
            self._record.flush()
            self._steps.write(self._folder, self._world, self._record.number)
            self._record.tag(self._steps.tags)
        self._is_saved = True


def _resets_next(env: gymnasium.Env[Any, Any]) -> bool:
    """Checks whether the next step of an environment resets it, by a wrapper of gymnasium's."""
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, _AUTORESET) and env.autoreset:
            return True
        env = env.env
    return False


def _check_last_state(info: Mapping[str, Any]) -> None:
    """Checks that the last state of an episode is there for the terms."""
    if key := next((key for key in _REPLACED if key in info), None):
        raise SimulatorError(
            f"step: the environment resets itself in the step that ends an episode (its info has "
            f"{key!r}), so that terms do not see the last state: wrap the environment by "
            "QueryWrapper first, and by what resets it outside"
        )


def interpreter_of_terms(limits: Limits | None) -> Interpreter:
    """Returns an interpreter for terms, which run in this process."""
    own = limits and replace(limits, require=())
    return Interpreter(recording=None, limits=own, strict=True)


def check_open(is_closed: bool, method: str) -> None:
    """Checks that an environment is open.

    Raises:
        gymnasium.error.ClosedEnvironmentError: it is closed.
    """
    if is_closed:
        raise gymnasium.error.ClosedEnvironmentError(
            f"{method}: the environment is closed: make it anew"
        )


def described(judgement: Judgement | BatchJudgement) -> dict[str, Any]:
    """Returns the values of the terms that there are, by name."""
    values = {
        "success": judgement.success,
        "failure": judgement.failure,
        "reward": judgement.reward,
    }
    described: dict[str, Any] = {name: one for name, one in values.items() if one is not None}
    if judgement.parts:
        described["parts"] = dict(judgement.parts)
    return described


def _checked_variables(variables: Mapping[str, VariableReader] | None) -> dict[str, VariableReader]:
    checked = validation.mapping(variables, "variables: give a dict of functions by name")
    for name, read in checked.items():
        check_name(name, "a variable")
        if not callable(read):
            raise ArgumentError(
                f"variables[{name!r}] is {short_repr(read)}: give a function of the environment, "
                f"such as lambda env: env.{name}"
            )
    return dict(checked)


# -- MuJoCo's two sets of poses ---------------------------------------------------------------


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
        self._left = _CHECKED
        self._interpreter = interpreter_of_terms(limits)
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
            self._judge.world.begin_episode()
            self._judge.begin_tick(values, is_first=True)
            self._judge.settle()

    def check(self, step: int, values: Mapping[str, Any], judgement: Judgement) -> None:
        """Takes a tick, and warns if a term differs, which ends the checks."""
        if not self._left:
            return
        self._left -= 1
        self._judge.world.tick()
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


def _differ(a: bool | float | None, b: bool | float | None) -> bool:
    """Checks whether two values of a term differ by more than rounding; not if one is unknown."""
    return a is not None and b is not None and not math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-9)


def _shown(value: bool | float | None) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
