"""Warns of terms that cannot be meant, by what is known of the episodes of an environment."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import gymnasium

from ssduck.errors import ProgramWarning, warn
from ssduck.gym.terms import Term, Terms, compiled
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.lint.foregone import beyond

# The number of episodes after which it is told what held at the first tick of all of them.
EPISODES = 10


def time_limit(env: Any) -> int | None:
    """Returns the number of steps after which gymnasium's `TimeLimit` ends an episode."""
    limits = [
        wrapper._max_episode_steps  # noqa: SLF001  # its `spec` may be missing
        for wrapper in _wrappers(env)
        if isinstance(wrapper, gymnasium.wrappers.TimeLimit)
    ]
    return min(limits, default=None)


def episode_seconds(env: Any, step: float | None = None) -> float | None:
    """Returns the simulated time of an episode at most, s; None if that is not known.

    Args:
        env: the environment.
        step: the simulated time of a step, s; None if an environment on MuJoCo has to say it.
    """
    limit, inner = time_limit(env), env.unwrapped
    # Another wrapper may take several steps in one.
    is_plain = all(type(one).__module__.startswith("gymnasium.") for one in _wrappers(env))
    if step is None and is_plain and hasattr(inner, "dt") and hasattr(inner, "model"):
        steps = getattr(inner, "frame_skip", getattr(inner, "n_substeps", 0))
        seconds = inner.model.opt.timestep * steps
        step = seconds if seconds == inner.dt else None
    return None if limit is None or step is None else limit * step


def _wrappers(env: Any) -> Iterator[Any]:
    while isinstance(env, gymnasium.Wrapper):
        yield env
        env = env.env


def warn_of_length(interpreter: Interpreter, terms: Terms, longest: float) -> None:
    """Warns of terms that ask for more time than an episode has, which is so many seconds."""
    for term in terms:
        tree = compiled(interpreter, term.key, term.text).tree
        for told in beyond(tree.statements[0], tree.text, longest):
            warn(f"{term.key}: {told}", ProgramWarning)


class FirstTicks:
    """Warns, once, of a condition that holds at the first tick of each episode."""

    def __init__(self, terms: Terms) -> None:
        conditions = {"success": terms.success, "failure": terms.failure, "stop": terms.stop_when}
        # The conditions that have held at all first ticks, by the names of their judgements.
        self._left: dict[str, Term] = {n: t for n, t in conditions.items() if t is not None}
        self._count = 0

    def see(
        self, judgement: Any, flags: Callable[[Any], Iterable[bool]] = lambda one: [one]
    ) -> None:
        """Takes what the terms say of a first tick, or of several ones.

        Args:
            judgement: the values of the terms.
            flags: returns the truth values at first ticks among those of a term.
        """
        held = {name: list(flags(getattr(judgement, name))) for name in self._left}
        self._left = {name: term for name, term in self._left.items() if all(held[name])}
        self._count += max(map(len, held.values()), default=0)
        if self._left and self._count >= EPISODES:
            term = next(iter(self._left.values()))
            self._left = {}
            warn(
                f"{term.key}: {term.text!r} held at the first tick of each of {self._count} "
                "episodes, before any action: add what is not so at the beginning, such as "
                "lifted(sim.cup, 0.1), or for how long it is to hold, heldFor(…) >= 0.5",
                ProgramWarning,
            )
