"""Caches the rows of recorded ticks, in blocks of ticks, and answers at them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.geometry.arrays import Array, Flags
from ssduck.geometry.pair_batch import PairQuestion
from ssduck.recording.buffers import TickBuffer

# The number of ticks of a block, and the number of cached blocks.
BLOCK = 64
MAX_BLOCKS = 8


class RowCache:
    """The rows of a record, with a cache of the least recently used blocks."""

    def __init__(
        self, fetch: Callable[[str, int, int], pa.Table], ticks: TickBuffer, source: str
    ) -> None:
        self.source = source
        self._fetch = fetch
        self._ticks = ticks
        self._blocks: OrderedDict[tuple[int, int], dict[str, dict[str, npt.NDArray[Any]]]] = (
            OrderedDict()
        )

    def clear(self) -> None:
        """Drops all rows."""
        self._blocks.clear()

    def rows(self, table: str, tick: int) -> dict[str, npt.NDArray[Any]]:
        """Returns the columns of a table at a tick; NaN for unknown numbers."""
        number = tick // BLOCK
        # The key of the last block changes when further ticks are recorded.
        last = min((number + 1) * BLOCK - 1, int(self._ticks.numbers[-1]))
        key = number, last
        if key not in self._blocks:
            while len(self._blocks) >= MAX_BLOCKS:
                self._blocks.popitem(last=False)
            self._blocks[key] = {}
        self._blocks.move_to_end(key)
        block = self._blocks[key]
        if table not in block:
            rows = self._fetch(table, number * BLOCK, last)
            order = np.argsort(rows["tick"].to_numpy(), kind="stable")
            block[table] = {name: rows[name].to_numpy()[order] for name in rows.column_names}
        columns = block[table]
        first, end = np.searchsorted(columns["tick"], [tick, tick + 1])
        return {name: column[first:end] for name, column in columns.items()}


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
        """Adds answers at ticks that are not cached."""
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
