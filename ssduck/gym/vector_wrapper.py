"""Computes success, failure and reward of a vector of environments: `VectorQueryWrapper`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias

import gymnasium
import numpy as np
from gymnasium.vector import (
    AsyncVectorEnv,
    AutoresetMode,
    SyncVectorEnv,
    VectorEnv,
    VectorWrapper,
)

from ssduck import validation
from ssduck.errors import ArgumentError, ProgramWarning, SimulatorError, warn
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Flags
from ssduck.gym.batch_terms import BatchJudgement, BatchTerms
from ssduck.gym.doubts import FirstTicks, episode_seconds, warn_of_length
from ssduck.gym.terms import Reward, WhereNaN
from ssduck.gym.wrapper import INFO, check_open, described, interpreter_of_terms
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.namespace import check_name
from ssduck.limits import Limits
from ssduck.simulators.environments import to_numpy
from ssduck.simulators.recognition import parts_of
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.world import World

# Returns an array with a value for each environment, from the vector of environments.
ArrayReader: TypeAlias = Callable[[Any], Any]


# What terms read of a model, which is that of environment 0 for all.
_OF_MODEL = (
    *("body_mass", "body_pos", "body_quat", "body_ipos", "geom_size", "geom_pos", "geom_quat"),
    *("geom_dataid", "geom_margin", "jnt_range", "site_size", "mesh_vert"),
)


class VectorQueryWrapper(VectorWrapper[Any, Any, Any, Any, Any]):
    """A vector of environments whose success, failure and reward are queries on all simulations.

    The terms are evaluated once a step, over all environments: `infos["ssduck"]` has arrays
    `success`, `failure`, `reward` and `parts`. Their past begins at the resets of each environment.
    Environments end, and are reset, as gymnasium's autoreset mode says, also if a term ends them.

    Args:
        env: a `SyncVectorEnv` of environments that have a MuJoCo model with its data; an
            `AsyncVectorEnv` of such, whose data are copied from their processes at each step; or
            another vector with `state` and `model`.
        success: a condition: whether the task is done.
        failure: a condition: whether it has failed.
        reward: a number that replaces the reward of the environments, or numbers by name, which
            are added.
        stop_when: a condition that ends an episode (`terminated`), as the environments' own does.
            It may use `success` and `failure` by name, as a reward may.
        world: the name of the batch in terms.
        variables: functions of the vector of environments, by the name of the variable that has
            their value: an array with a value for each environment, or one value for all.
        state: a function of the vector of environments that returns their states, as
            `BatchWorld.tick` takes them: a dict of arrays, or an object that has these.
        model: the `mujoco.MjModel` of these states.
        forward: without `state`, whether terms see the poses that belong to `qpos`; see
            `QueryWrapper`.
        nan: what a term is in an environment in which it cannot be computed; see `QueryWrapper`.
        limits: the limits of terms, which run in this process.

    Raises:
        SimulatorError: an environment has no model with its data, or another model.
        ArgumentError: a term is of the wrong type; or this vector cannot end episodes, or does not
            show their last states, in its autoreset mode.
        SelectScriptError: a term is wrong otherwise.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        success: str | None = None,
        failure: str | None = None,
        reward: Reward | None = None,
        stop_when: str | None = None,
        *,
        world: str = "sim",
        variables: Mapping[str, ArrayReader] | None = None,
        state: ArrayReader | None = None,
        model: Any = None,
        forward: bool = False,
        nan: WhereNaN = "error",
        limits: Limits | None = None,
    ) -> None:
        super().__init__(env)
        check_name(world, "a world")
        self._mode = env.metadata.get("autoreset_mode", AutoresetMode.DISABLED)
        self._variables = validation.mapping(variables, "variables: give a dict of functions")
        self._parts: list[_Prepared] = []
        if state is None and isinstance(env.unwrapped, AsyncVectorEnv):
            model = _model_in_process(env.unwrapped)
            read: Callable[[], Sequence[Any]] = partial(env.unwrapped.get_attr, "data")
        elif state is None:
            self._parts = _prepared(env)
            model = self._parts[0].find()[0]
            read = partial(_data_of, self._parts)
        elif model is None:
            raise ArgumentError("VectorQueryWrapper: give the model of the states: model=…")
        if state is None:
            state = partial(_states, read, forward=forward)
        if not self._parts:
            self._check_mode(stops=stop_when is not None or nan == "failure")
        self._state = state
        self._ended: Flags = np.zeros(env.num_envs, np.bool_)
        self._is_closed = self._has_told_of_models = False
        self._interpreter = interpreter_of_terms(limits)
        try:
            self._batch: BatchWorld = World.batch(model, env.num_envs)
            self._interpreter.add_variable(world, self._batch)
            self._terms_of: Callable[[], BatchTerms] = partial(
                BatchTerms,
                self._interpreter,
                success,
                failure,
                reward,
                stop_when,
                world=world,
                nan=nan,
            )
            # Variables may have their values from the first reset on.
            self._terms = None if self._variables else self._made_terms()
        except BaseException:
            self._interpreter.close()
            raise

    def _check_mode(self, *, stops: bool) -> None:
        """Checks that states in arrays have what terms need."""
        if self._mode == AutoresetMode.SAME_STEP:
            raise ArgumentError(
                "VectorQueryWrapper: in the mode SAME_STEP, the state after a step is that of the "
                "next episode, and terms would not see the last one: make it with NEXT_STEP or "
                "DISABLED"
            )
        if stops and self._mode == AutoresetMode.NEXT_STEP:
            raise ArgumentError(
                "VectorQueryWrapper: this vector resets its environments at its own ends only, and "
                "stop_when ends others: make it with the mode DISABLED, and reset by reset_mask"
            )

    @property
    def interpreter(self) -> Interpreter:
        """The interpreter that has the batch: for queries of your own."""
        return self._interpreter

    # -- gymnasium's methods ------------------------------------------------------------------

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Resets all environments, or those of the option `reset_mask`."""
        check_open(self._is_closed, "reset")
        mask = None if options is None else options.get("reset_mask")
        observations, infos = self.env.reset(seed=seed, options=options)
        are_reset = np.ones(self.num_envs, np.bool_) if mask is None else np.array(mask)
        self._ended &= ~are_reset
        judgement = self._judged(are_reset)
        return observations, infos | {INFO: described(judgement)}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Steps all environments, and evaluates the terms."""
        check_open(self._is_closed, "step")
        are_reset = (
            self._ended if self._mode == AutoresetMode.NEXT_STEP else np.zeros_like(self._ended)
        )
        if not self._parts:
            observations, rewards, terminated, truncated, infos = self.env.step(actions)
            judgement = self._judged(are_reset)
            if judgement.reward is not None:
                rewards = np.where(are_reset, 0.0, to_numpy(judgement.reward, "reward"))
            if judgement.stop is not None:
                terminated = terminated | (to_numpy(judgement.stop, "stop_when") & ~are_reset)
        else:
            self._step_each(actions, are_reset)
            judgement = self._judged(are_reset)
            self._decide(judgement, are_reset)
            observations, rewards, terminated, truncated, infos = self.env.step(actions)
        self._ended = np.asarray(terminated) | np.asarray(truncated)
        if self._mode == AutoresetMode.SAME_STEP and self._ended.any():
            self._judged(self._ended)  # the first ticks of the next episodes
        return observations, rewards, terminated, truncated, infos | {INFO: described(judgement)}

    def close(self, **kwargs: Any) -> None:
        """Closes the environments."""
        self._is_closed = True
        self._interpreter.close()
        super().close(**kwargs)

    # -- steps --------------------------------------------------------------------------------

    def _step_each(self, actions: Any, are_reset: Flags) -> None:
        """Steps the environments, or resets them, for the vector to take what they returned."""
        each = gymnasium.vector.utils.iterate(self.env.action_space, actions)
        for part, action, is_reset in zip(self._parts, each, are_reset.tolist(), strict=True):
            part.prepare(action, is_reset=is_reset)

    def _decide(self, judgement: BatchJudgement, are_reset: Flags) -> None:
        """Changes what the environments returned to what the terms say."""
        rewards = None if judgement.reward is None else judgement.reward.tolist()
        stops = None if judgement.stop is None else judgement.stop.tolist()
        is_shown = self._mode == AutoresetMode.SAME_STEP
        for number in np.flatnonzero(~are_reset).tolist():
            part = self._parts[number]
            assert part.stepped is not None
            observation, reward, terminated, truncated, info = part.stepped
            reward = reward if rewards is None else rewards[number]
            terminated = bool(terminated or (stops is not None and stops[number]))
            if is_shown and (terminated or truncated):
                info = info | {INFO: _of_one(judgement, number)}
            part.stepped = observation, reward, terminated, truncated, info

    def _judged(self, are_reset: Flags) -> BatchJudgement:
        """Takes a tick of all environments, some of which were reset; returns the terms' values."""
        if are_reset.any():
            self._batch.reset(are_reset)
            self._warn_of_models(np.flatnonzero(are_reset).tolist())
        state = self._state(self.env)
        if isinstance(state, Mapping):
            self._batch.tick(**state)
        else:
            self._batch.tick(state)
        for name, read in self._variables.items():
            self._interpreter.add_variable(name, read(self.env))
        if self._terms is None:
            self._terms = self._made_terms()
        judgement = self._terms()
        if are_reset.any():
            self._first_ticks.see(judgement, lambda one: to_numpy(one, "a term")[are_reset])
        return judgement

    def _made_terms(self) -> BatchTerms:
        """Returns the terms; warns of those that ask for more time than an episode has."""
        made = self._terms_of()
        self._first_ticks = FirstTicks(made.terms)
        durations = [episode_seconds(part.env) for part in self._parts]
        known = [seconds for seconds in durations if seconds is not None]
        if known and len(known) == len(durations):
            warn_of_length(self._interpreter, made.terms, max(known))
        return made

    def _warn_of_models(self, numbers: Sequence[int]) -> None:
        """Warns, once, if the models of environments that were reset differ from others."""
        for number in numbers if self._parts and not self._has_told_of_models else ():
            other = (number + 1) % self.num_envs
            name = _difference(*(self._parts[place].find()[0] for place in (number, other)))
            if name is not None:
                self._has_told_of_models = True
                warn(
                    f"VectorQueryWrapper: the models of environments {number} and {other} differ "
                    f"in {name}: terms take shapes, masses and joints of environment 0 for all; "
                    "QueryWrapper around each environment takes its own",
                    ProgramWarning,
                )
                return


class _Prepared(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment that is stepped ahead of its vector, which gets what it returned then."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        self.stepped: tuple[Any, Any, bool, bool, dict[str, Any]] | None = None
        self._reset: tuple[Any, dict[str, Any]] | None = None

    def find(self) -> tuple[Any, Any]:
        """Returns the model and the data."""
        found = parts_of(self.env.unwrapped)
        if found is None:
            raise SimulatorError(
                f"VectorQueryWrapper: {short_repr(self.env.unwrapped)} has no MuJoCo model with "
                "its data: wrap each environment by QueryWrapper, or give state and model"
            )
        return found

    def prepare(self, action: Any, *, is_reset: bool) -> None:
        """Steps, or resets, the environment."""
        if is_reset:
            self._reset = self.env.reset()
        else:
            observation, reward, terminated, truncated, info = self.env.step(action)
            self.stepped = observation, reward, terminated, truncated, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Returns what the prepared step returned."""
        if self.stepped is None:
            return self.env.step(action)
        stepped, self.stepped = self.stepped, None
        return stepped

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Returns what the prepared reset returned; resets the environment if there was none."""
        prepared, self._reset = self._reset, None
        return self.env.reset(**options) if prepared is None else prepared


def _prepared(env: VectorEnv[Any, Any, Any]) -> list[_Prepared]:
    """Puts wrappers around the environments of a vector; returns them."""
    vector = env.unwrapped
    if not isinstance(vector, SyncVectorEnv):
        raise ArgumentError(
            f"VectorQueryWrapper: the simulations of {type(vector).__name__} are not at hand: give "
            "state=… and model=…, or wrap each of its environments by QueryWrapper"
        )
    parts = [_Prepared(one) for one in vector.envs]
    models = [part.find()[0] for part in parts]
    sizes = {(model.nbody, model.nsite, model.nq, model.nv, model.ngeom) for model in models}
    if len(sizes) > 1:
        raise SimulatorError("VectorQueryWrapper: the environments have different models")
    vector.envs = list(parts)
    return parts


def _difference(a: Any, b: Any) -> str | None:
    """Returns an array that differs between two models; None if none does that terms read."""
    names = () if a is b else _OF_MODEL
    return next((n for n in names if not np.array_equal(getattr(a, n), getattr(b, n))), None)


def _data_of(parts: Sequence[_Prepared]) -> list[Any]:
    return [part.find()[1] for part in parts]


def _model_in_process(vector: AsyncVectorEnv) -> Any:
    """Returns the model of the environments of a vector that steps them in other processes."""
    # To ask for what is not there ends the processes.
    if not all(all(vector.call("has_wrapper_attr", name)) for name in ("model", "data")):
        raise SimulatorError(
            "VectorQueryWrapper: the environments of this AsyncVectorEnv have no MuJoCo model with "
            "its data: wrap each of them by QueryWrapper, or give state=… and model=…"
        )
    return vector.get_attr("model")[0]


def _states(read: Callable[[], Sequence[Any]], _: object, *, forward: bool) -> Any:
    """Returns the states of all environments; their joint positions, from which poses follow."""
    data = list(read())
    if not forward:
        return data
    return {
        "qpos": np.stack([one.qpos for one in data]),
        "qvel": np.stack([one.qvel for one in data]),
        "time": np.array([one.time for one in data]),
    }


def _of_one(judgement: BatchJudgement, number: int) -> dict[str, Any]:
    """Returns the values of the terms in an environment, by name."""

    def one(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: one(part) for name, part in value.items()}
        return value[number].item()

    told: dict[str, Any] = one(described(judgement))
    return told
