"""Scores recorded episodes as `QueryWrapper` would have scored them live."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from ssduck.errors import RecordError
from ssduck.gym.judge import Judge
from ssduck.gym.terms import Judgement, Reward, Terms, WhereNaN
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.opening import open_record
from ssduck.lazy import service
from ssduck.limits import Limits
from ssduck.recording.episode_steps import EpisodeSteps, recorded_steps
from ssduck.recording.paths import expand_path
from ssduck.recording.replay.replayed_world import ReplayedWorld


@dataclass(frozen=True)
class EpisodeScore:
    """The score of an episode, until `stop_when` ends it.

    Attributes:
        episode: the number of the episode.
        seed: the seed of its reset; None for none.
        options: the options of its reset.
        rewards: the reward of each step; that of the environment if no reward is given.
        success: whether the task was done, after each step; None without such a term.
        failure: whether it had failed, likewise.
        stop: whether `stop_when` held, likewise.
        parts: the parts of the reward by name, of each step.
    """

    episode: int
    seed: int | None
    options: Any
    rewards: tuple[float, ...]
    success: tuple[bool, ...] | None
    failure: tuple[bool, ...] | None
    stop: tuple[bool, ...] | None
    parts: Mapping[str, tuple[float, ...]]

    @property
    def total(self) -> float:
        """The return: the sum of the rewards, in the order of the steps."""
        return float(sum(self.rewards))

    @property
    def succeeded(self) -> bool | None:
        """Whether the task was done after the last step; None without such a term."""
        return None if self.success is None else bool(self.success and self.success[-1])


def score(
    record: str | Path,
    success: str | None = None,
    failure: str | None = None,
    reward: Reward | None = None,
    stop_when: str | None = None,
    *,
    world: str = "sim",
    nan: WhereNaN = "error",
    limits: Limits | None = None,
) -> Iterator[EpisodeScore]:
    """Yields the scores of recorded episodes, the same to the last digit as live.

    The simulator is not needed. Terms may use the variables that were recorded.

    Args:
        record: a folder that `QueryWrapper(…, record_to=…)` wrote.
        success: a condition: whether the task is done.
        failure: a condition: whether it has failed.
        reward: a number, or numbers by name, which are added.
        stop_when: a condition that ends an episode: later steps have no score.
        world: the name of the world in the record.
        nan: what a term is that cannot be computed, since numbers are NaN; as in `QueryWrapper`.
        limits: the limits of terms and of the record, in this process; for strangers' records,
            `ssduck.lake(record, limits=Limits.strict()).score(…)` is in a sandbox.

    Raises:
        RecordError: there is no such record, it is damaged, or it has no steps of environments.
        SelectScriptError: a term is wrong.
    """
    terms = Terms.of(success, failure, reward, stop_when, nan=nan)
    limits = limits and replace(limits, require=())
    folder = expand_path(record).absolute()
    numbers = [number for name, number in recorded_steps(folder) if name == world]
    if not numbers:
        raise RecordError(
            f"{folder} has no episode of an environment with the world {world!r}: record it by "
            "QueryWrapper(…, record_to=…)"
        )
    scores = service("step scores")(folder, world, numbers, terms, limits)
    return (
        _score(folder, world, number, terms, limits) if known is None else known
        for number, known in zip(numbers, scores, strict=True)
    )


def _score(
    folder: Path, world: str, number: int, terms: Terms, limits: Limits | None
) -> EpisodeScore:
    steps = EpisodeSteps.read(folder, world, number)
    with open_record(folder, world, number, limits=limits) as interpreter:
        interpreter.strict = True
        return score_with(interpreter, world, number, steps, terms)


def score_with(
    interpreter: Interpreter,
    world: str,
    number: int,
    steps: EpisodeSteps,
    terms: Terms,
    judges: dict[Any, Judge] | None = None,
) -> EpisodeScore:
    """Returns the score of an episode that an interpreter has open.

    Args:
        interpreter: the interpreter, strict.
        world: the name of the world.
        number: the number of the episode.
        steps: the steps of the episode.
        terms: the terms.
        judges: has what judged earlier episodes of these terms with this interpreter, whose worlds
            have the same entities, and gets what judges this one.

    Raises:
        SelectScriptError: a term is wrong, or ticks are missing.
    """
    recorded = tuple(steps.variables)
    judges = {} if judges is None else judges
    judge = judges.get((world, recorded))
    is_known = judge is not None
    if judge is None:
        if_unknown = "the record has no variables"
        if recorded:
            if_unknown = f"the record has the variables {', '.join(recorded)}"
        judge = Judge(terms, interpreter, world, recorded, if_unknown=if_unknown)
    judge.begin_episode()
    judgements = list(_judgements(interpreter, world, judge, steps, is_checked=is_known))
    judges[world, recorded] = judge

    # Without such a term, a step at which nothing is NaN is no failure.
    is_failed = any(one.failure is True for one in judgements)

    def series(name: str) -> tuple[Any, ...]:
        values = (getattr(one, name) for one in judgements)
        return tuple(False if value is None else value for value in values)

    return EpisodeScore(
        number,
        steps.seed,
        steps.options,
        series("reward") if terms.parts else tuple(steps.rewards[: len(judgements)]),
        series("success") if terms.success else None,
        series("failure") if terms.failure or is_failed else None,
        series("stop") if terms.stop_when or is_failed else None,
        {name: tuple(one.parts[name] for one in judgements) for name in terms.parts},
    )


def _judgements(
    interpreter: Interpreter, world: str, judge: Judge, steps: EpisodeSteps, *, is_checked: bool
) -> Iterator[Judgement]:
    """Yields what the terms say after each step, until one says that the episode ends."""
    replayed = interpreter[world]
    assert isinstance(replayed, ReplayedWorld)
    variables = [
        {name: series[index] for name, series in steps.variables.items()}
        for index in range(len(steps.times))
    ]
    is_by_time = all(a < b for a, b in pairwise(steps.times))
    seek = partial(_seek, replayed, steps, is_by_time=is_by_time)
    if not is_checked:
        seek(0)
        judge.begin_tick(variables[0], is_first=True)
        judge.check()
        seek(len(steps.times) - 1)
    if is_by_time:  # the world is at the last tick
        judgements = judge.judgements(steps.times, variables)
        if judgements is not None:
            yield from _until_stop(judgements[1:])
            return
    yield from _until_stop(_one_by_one(seek, judge, variables))


def _one_by_one(
    seek: Callable[[int], None], judge: Judge, variables: Sequence[Mapping[str, Any]]
) -> Iterator[Judgement]:
    """Yields what the terms say after each step, computed at its tick."""
    for index, values in enumerate(variables):
        seek(index)
        judge.begin_tick(values, is_first=index == 0)
        if index:
            yield judge.judgement()


def _until_stop(judgements: Iterable[Judgement]) -> Iterator[Judgement]:
    for judgement in judgements:
        yield judgement
        if judgement.stop:
            return


def _seek(replayed: ReplayedWorld, steps: EpisodeSteps, index: int, *, is_by_time: bool) -> None:
    time = steps.times[index]
    if is_by_time:
        replayed.seek(time)
    else:  # a simulation whose time stands still has several ticks of one time
        replayed.seek_tick(steps.ticks[index])
    if replayed.time != time:
        raise RecordError(
            f"{replayed.name!r} has no tick at {time:g} s: ticks of the episode are missing"
        )
