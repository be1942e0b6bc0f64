"""Many simulations of one model as one world: `BatchWorld`.

Its programs are evaluated over all environments at once (`ssduck.interpreter.batches`). What only
a single simulation has, a tick in tables, is that of one environment at a time.
"""

from __future__ import annotations

import weakref
from collections import deque
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Never, Self

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError, ProgramWarning, UnsupportedError, warn
from ssduck.formatting import joined_names, short_repr
from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.simulators.backends import backend
from ssduck.simulators.environments import (
    NO_CONTACTS,
    BodyEnvironments,
    Environments,
    EnvironmentSimulator,
    States,
    like,
    to_numpy,
)
from ssduck.simulators.recognition import simulator_of_model
from ssduck.world.copies import copied_tick
from ssduck.world.ticking import UNNAMED, LiveTicker
from ssduck.world.world import World

_MAX_HISTORY = 10**9


@dataclass(frozen=True, eq=False)
class PastEpisode:
    """The ticks in the history of an episode of an environment.

    Attributes:
        environment: its number.
        states: the states of all environments at each of its ticks, the oldest first.
        is_whole: whether the first tick of the episode is among them.
    """

    environment: int
    states: tuple[Environments, ...]
    is_whole: bool


class BatchTicker(LiveTicker):
    """Takes the tick of one environment at a time, in which queries read it.

    Attributes:
        is_open: whether queries may read the tick.
    """

    simulator: EnvironmentSimulator
    is_open = False

    @property
    def is_final(self) -> bool:
        """True: the ticks of a batch come from `BatchWorld.tick`, and are not recorded."""
        return True

    @property
    def time(self) -> float:
        """The latest simulated time of an environment, s."""
        return float(self.simulator.environments.times.max())

    def choose(self, environment: int) -> None:
        """Takes the tick of an environment."""
        self.simulator.chosen = environment
        self.snapshot.unavailable = self.unavailable
        self.take()

    @property
    def unavailable(self) -> dict[str, str]:
        """The tables that no state has, with the reason."""
        return {} if self.simulator.environments.knows_contacts else {"contacts": NO_CONTACTS}

    def pin(
        self, tables: Collection[str] = (), *, is_read: bool = True, is_settled: bool = True
    ) -> None:
        """Keeps the world at its tick; raises an error if none is chosen, or lacks a table."""
        if is_read:
            self.check_open()
        for table, reason in self.unavailable.items():
            if table in tables:
                raise ArgumentError(reason)
        super().pin(tables, is_read=is_read, is_settled=is_settled)

    def check_open(self) -> None:
        """Checks that one of the environments is read."""
        if not self.is_open:
            count = self.simulator.environments.count
            raise UnsupportedError(
                f"{self.name!r} is a batch of {count} environments, and this is a question to "
                f"one world: ask {self.name}.environment(0), or write it as a program for eval"
            )

    def run(self, *_: Any) -> Never:
        """Raises `UnsupportedError`: the caller steps the simulations."""
        raise UnsupportedError(
            f"{self.name!r} is a batch of {self.simulator.environments.count} environments: step "
            "your simulations, then give tick their state"
        )

    def add_recorder(self, *_: Any) -> Never:
        """Raises `UnsupportedError`: a recording is of one world."""
        raise UnsupportedError(
            f"{self.name!r} is a batch: World.batch(…, history=1000) keeps its ticks, and "
            "export_batch writes them as episodes"
        )


class BatchWorld(World):
    """Many simulations of one model, the *environments*, numbered from 0; see `World.batch`.

    Args:
        simulator: the environments.
        name: the name until the world is bound to a variable.
        history: the largest number of ticks that are kept, for `Interpreter.export_batch`.

    Attributes:
        version: is incremented with each tick and reset.
        began: (n,), the version at which the episode of each environment began.
    """

    ticker: BatchTicker

    def __init__(
        self, simulator: EnvironmentSimulator, *, name: str = UNNAMED, history: int = 0
    ) -> None:
        super().__init__(BatchTicker.begun(name, simulator, ()))
        self._environments: Environments = simulator.environments
        self.version = 0
        self._is_told_of_resets = self._has_told_of_fall = False
        self.began: Indices = np.zeros(self._environments.count, np.intp)
        self._restarting = np.ones(self._environments.count, np.bool_)
        # The states at the last ticks, each with `began` at it.
        self._history: deque[tuple[Environments, Indices]] = deque(maxlen=history)
        # What reads the present states before the next ones.
        self._before_tick: list[weakref.WeakMethod[Callable[[], None]]] = []
        self.snapshot.read_margins(simulator)  # those of the model, which stay the same

    def __repr__(self) -> str:
        names = joined_names([info.name for info in self.snapshot.entities], 6)
        return f"<BatchWorld {self.name!r}: {self.count} environments of {names}>"

    # -- time -------------------------------------------------------------------------------

    @property
    def count(self) -> int:
        """The number of environments."""
        return self._environments.count

    @property
    def environments(self) -> Environments:
        """The states of the environments at the last tick."""
        return self._environments

    @property
    def times(self) -> Array:
        """The simulated time of each environment, s, (n,)."""
        return self._environments.times.copy()

    def tick(  # type: ignore[override]
        self, state: States = None, **arrays: Any
    ) -> Self:
        """Takes the states of all environments; each program is evaluated at these until the next.

        Where the time of an environment has fallen, you have reset it: a new episode begins there,
        as `reset` begins one.

        Args:
            state: a dict of the arrays, an object with the arrays as attributes, such as batched
                data of MJX, or a list of `MjData`.
            **arrays: the arrays by name, of NumPy, torch, JAX or another library, with the
                environments on the first axis. Of a model of MuJoCo they have the names and shapes
                of `MjData`: xpos (n, nbody, 3) and xquat (n, nbody, 4), or qpos (n, nq); time (n,)
                or one number, s; site_xpos, cvel and subtree_com, qvel, qfrc_actuator and contact,
                if anything reads them.

        Returns:
            The world itself.

        Raises:
            ArgumentError: an array is of another name, shape or type, or one is missing; the states
                of the last tick remain.
        """
        self._before_tick = [one for one in self._before_tick if one() is not None]
        for reference in self._before_tick if self.version else ():
            if (read := reference()) is not None:
                read()  # it locks its interpreter, and then this world
        with self.lock:
            self.ticker.check_not_pinned()
            before = self._environments.times
            self._environments.update(state, arrays)
            self.version += 1
            self._restarting |= self._fallen(before)
            self.began[self._restarting] = self.version
            self._restarting[:] = False
            if self._history.maxlen:
                _ = self._environments.contacts  # those of `MjData` can be read now only
                self._history.append((copy(self._environments), self.began.copy()))
        return self

    def _fallen(self, before: Array) -> Flags:
        """Returns where the time has fallen; warns, once, if `reset` tells of resets elsewhere."""
        are_fallen: Flags = self._environments.times < before
        if self._is_told_of_resets and not self._has_told_of_fall and are_fallen.any():
            self._has_told_of_fall = True
            numbers = joined_names([str(number) for number in np.flatnonzero(are_fallen)], 5)
            warn(
                f"{self.name}: the time has fallen in environment {numbers} without reset: an "
                "episode begins there; MuJoCo itself resets a simulation that has become unstable",
                ProgramWarning,
            )
        return are_fallen

    def before_tick(self, read: Callable[[], None]) -> None:
        """Has a method called before each tick after the first: it reads the states until then.

        Args:
            read: a method of an object, which is not kept alive.
        """
        self._before_tick.append(weakref.WeakMethod(read))

    def reset(self, environments: Any = None) -> Self:
        """Begins new episodes: functions of time forget what was before the next tick.

        Args:
            environments: the numbers of the environments, or a mask (n,) of True and False; None
                for all.

        Returns:
            The world itself.

        Raises:
            ArgumentError: there is no such environment.
        """
        with self.lock:
            self.ticker.check_not_pinned()
            chosen = self.numbers(environments, "reset")
            self._environments.reset(chosen)
            self._restarting[chosen] = True
            self._is_told_of_resets |= self.version > 0
        return self

    def numbers(self, environments: Any, what: str) -> Indices:
        """Returns the numbers of some environments.

        Args:
            environments: the numbers, or a mask (n,) of True and False; None for all.
            what: what takes them, for messages.

        Raises:
            ArgumentError: there is no such environment.
        """
        if environments is None:
            return np.arange(self.count)
        given = to_numpy(environments, f"{what}: environments")
        if given.dtype.kind == "b":
            if given.shape != (self.count,):
                raise ArgumentError(
                    f"{what}: a mask is of shape ({self.count},), not {given.shape}"
                )
            return np.flatnonzero(given)
        numbers = np.atleast_1d(given)
        if not numbers.size:
            return np.zeros(0, np.intp)
        is_mask = numbers.size == self.count > len(np.unique(numbers)) and (numbers <= 1).all()
        if is_mask and numbers.dtype.kind != "f":
            raise ArgumentError(
                f"{what}: {short_repr(environments)} names an environment more than once: a mask "
                "has True and False, as mask.astype(bool)"
            )
        if numbers.dtype.kind == "f" or ((numbers < 0) | (numbers >= self.count)).any():
            raise ArgumentError(
                f"{what}: environments are numbers from 0 to {self.count - 1}, or a mask"
            )
        return numbers.astype(np.intp)

    # -- the past ---------------------------------------------------------------------------

    def past_episodes(self, environment: int) -> list[PastEpisode]:
        """Returns the ticks in the history of an environment by episode, the oldest first.

        Raises:
            ArgumentError: no ticks are kept.
        """
        if not self._history.maxlen:
            raise ArgumentError(
                f"{self.name!r} keeps no ticks: make it with World.batch(…, history=1000), the "
                "number of ticks that are kept"
            )
        by_beginning: dict[int, list[Environments]] = {}
        for states, began in self._history:
            by_beginning.setdefault(int(began[environment]), []).append(states)
        oldest = self.version - len(self._history) + 1
        return [
            PastEpisode(environment, tuple(states), beginning >= oldest)
            for beginning, states in by_beginning.items()
        ]

    def replay(self, episode: PastEpisode) -> Iterator[World]:
        """Yields a world of its own at each tick of an episode."""
        first, *others = episode.states
        own = self.ticker.simulator.of(episode.environment, first)
        world = World(own, name=self.name)
        yield world
        for states in others:
            own.environments = states
            yield world.tick()

    def step(self, count: int = 1, *, every: int | None = 1, **others: Never) -> Never:
        """Raises `UnsupportedError`: the caller steps the simulations."""
        del count, every, others
        self.ticker.run()

    run = begin_episode = step  # type: ignore[assignment]

    def follow(self, *_: Any) -> Never:
        """Raises `UnsupportedError`: a trigger is of one world."""
        raise UnsupportedError(
            f"{self.name!r} is a batch: a trigger would follow {self.count} environments; evaluate "
            "the program after each tick"
        )

    # -- one environment ----------------------------------------------------------------------

    @contextmanager
    def at(self, environment: int) -> Iterator[None]:
        """Lets queries read one of the environments in a context."""
        with self.lock:
            self.ticker.check_not_pinned()
            before = self.ticker.is_open
            self.ticker.choose(environment)
            self.ticker.is_open = True
            try:
                yield
            finally:
                self.ticker.is_open = before

    def environment(self, number: int) -> World:
        """Returns the world of an environment at the last tick, which never changes.

        It is queried like any other world; see `what_if`.

        Raises:
            ArgumentError: there is no such environment.
        """
        number = validation.integer(number, "environment", minimum=0)
        if number >= self.count:
            raise ArgumentError(f"environment: there are those from 0 to {self.count - 1}")
        tables = [
            name for name in ("contacts", "links", "joints") if name not in self.ticker.unavailable
        ]
        with self.at(number), self.pinned(tables):
            simulator, snapshot = copied_tick(self.snapshot)
            snapshot.unavailable = self.ticker.unavailable
        return World(LiveTicker.of_tick(simulator, snapshot), camera=self.camera)

    @property
    def present(self) -> Self:
        """The world itself, while one of its environments is read."""
        self.ticker.check_open()
        return self

    def render(self, *_: Any, **__: Any) -> Never:
        """Raises `UnsupportedError`: the simulator of the states draws them."""
        raise UnsupportedError(f"{self.name!r} is a batch: its simulator draws its environments")

    segmentation = save = excerpt = what_if = render

    def given_back(self, values: Array) -> Any:
        """Returns values as an array of the library that the last states came in."""
        return like(values, self._environments.sample)


def batch_of(model: Any, count: int, name: str = UNNAMED, history: int = 0) -> BatchWorld:
    """Returns many simulations of one model; see `World.batch`."""
    count = validation.integer(count, "batch: count", minimum=1)
    history = validation.integer(
        history, "batch: history, a number of ticks,", minimum=0, maximum=_MAX_HISTORY
    )
    if isinstance(model, World):
        simulator = _copies_of(model, count)
    else:
        simulator = backend(simulator_of_model(model)).environments(model, count)
    return BatchWorld(simulator, name=name, history=history)


def _copies_of(world: World, count: int) -> EnvironmentSimulator:
    """Returns environments that have the bodies of a world, all as it is at its tick."""
    with world.pinned(("links", "joints")):
        snapshot = world.snapshot
        of_joints = snapshot.joints()
        # Their names are those of the world, which may have others than its model.
        named = {
            one.body: replace(one.body, name=one.name) for one in snapshot.entities if one.body
        }
        states = {}
        for group, poses in snapshot.body_groups:
            for body, run in group.runs.items():
                links = np.arange(run.start, run.stop)
                states[named[body]] = poses.states_at(poses.positions[links], links)
    joints = {copy: of_joints.get(body, np.zeros((0, 3))) for body, copy in named.items()}
    bodies = {copy.name: copy for copy in named.values()}
    environments = BodyEnvironments(bodies, states, joints, count)
    return EnvironmentSimulator(list(bodies.values()), environments, world.simulator)
