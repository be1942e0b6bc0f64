"""Caches answers about pairs of entities at recorded ticks, which never change."""

from __future__ import annotations

from collections import OrderedDict
from threading import Lock
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Flags
from ssduck.geometry.pair_batch import PairQuestion

Ticks: TypeAlias = npt.NDArray[np.int64]
# A question about two entities, by their ids.
Key: TypeAlias = tuple[PairQuestion, int, int]

# The number of answers that are cached, of 16 bytes each.
MAX_ANSWERS = 1 << 20


class AnswerCache:
    """The answers to questions about pairs of entities of a record, by tick.

    It drops the questions that were not asked for the longest time.
    """

    def __init__(self) -> None:
        # The ticks, ascending, and the answer at each.
        self._answers: OrderedDict[Key, tuple[Ticks, Array]] = OrderedDict()
        self._count = 0
        self._lock = Lock()

    def clear(self) -> None:
        """Drops all answers."""
        with self._lock:
            self._answers.clear()
            self._count = 0

    def __len__(self) -> int:
        """Returns the number of cached answers."""
        return self._count

    def look_up(self, key: Key, ticks: Ticks) -> tuple[Array, Flags]:
        """Returns the answers at some ticks, and whether each is cached."""
        with self._lock:
            known, answers = self._answers.get(key, _NOTHING)
            if key in self._answers:
                self._answers.move_to_end(key)
        if not len(known):
            return np.zeros(len(ticks)), np.zeros(len(ticks), dtype=bool)
        places = np.minimum(np.searchsorted(known, ticks), len(known) - 1)
        is_cached: Flags = known[places] == ticks
        return answers[places], is_cached

    def add(self, key: Key, ticks: Ticks, answers: Array, first_kept: int) -> None:
        """Adds answers at ticks that are not cached.

        Args:
            key: the question and the entities.
            ticks: the ticks.
            answers: the answer at each.
            first_kept: the first tick of the record; earlier ones are dropped.
        """
        with self._lock:
            known, before = self._answers.pop(key, _NOTHING)
            self._count -= len(known)
            all_ticks, places = np.unique(np.concatenate((known, ticks)), return_index=True)
            all_answers = np.concatenate((before, answers))[places]
            start = max(int(np.searchsorted(all_ticks, first_kept)), len(all_ticks) - MAX_ANSWERS)
            self._answers[key] = all_ticks[start:], all_answers[start:]
            self._count += len(all_ticks) - start
            while self._count > MAX_ANSWERS:
                _, (dropped, _) = self._answers.popitem(last=False)
                self._count -= len(dropped)


_NOTHING: tuple[Ticks, Array] = np.zeros(0, np.int64), np.zeros(0)
