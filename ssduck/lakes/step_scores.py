"""The scores of the episodes of a record, step by step, for `ssduck.gym.score`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from ssduck.gym.scoring import EpisodeScore
from ssduck.gym.terms import Terms
from ssduck.lakes.questions import StepsQuestion, from_text
from ssduck.lakes.scan import entries_of_records
from ssduck.lakes.workers import answer_episodes
from ssduck.limits import Limits

# So many episodes are read at a time.
_PORTION = 64


def step_scores(
    folder: Path, world: str, numbers: Sequence[int], terms: Terms, limits: Limits | None
) -> Iterator[EpisodeScore | None]:
    """Yields the score of each episode; None of one that has to be opened by itself.

    Args:
        folder: the record.
        world: the name of the world.
        numbers: the numbers of the episodes.
        terms: the terms.
        limits: the limits of the terms.
    """
    entries = {one.episode: one for one in entries_of_records([folder], {}) if one.world == world}
    question, left = StepsQuestion(terms, limits), iter(numbers)
    while portion := list(islice(left, _PORTION)):
        known = [entries[number] for number in portion if number in entries]
        answers = zip(known, answer_episodes(question, known), strict=True)
        scores = {entry.episode: answer.text for entry, answer in answers}
        for number in portion:
            text = scores.get(number)
            yield None if text is None else _score_of(from_text(text))


def _score_of(told: dict[str, object]) -> EpisodeScore:
    """Returns the score that an answer has; series are tuples again."""
    parts = told.pop("parts")
    assert isinstance(parts, dict)
    series = {
        name: tuple(value) if isinstance(value, list) and name != "options" else value
        for name, value in told.items()
    }
    own = {name: tuple(values) for name, values in parts.items()}
    return EpisodeScore(parts=own, **series)  # type: ignore[arg-type]
