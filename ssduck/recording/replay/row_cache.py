"""Caches the rows of recorded ticks, in blocks of ticks."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.recording.buffers import TickBuffer

# The number of ticks of a block, and the number of cached blocks.
BLOCK = 64
MAX_BLOCKS = 8


class RowCache:
    """The rows of a record, with a cache of the least recently used blocks.

    Args:
        fetch: returns the rows of a table at the ticks from a first to a last one.
        ticks: the recorded ticks.
        source: the folder or the file that has them, for messages.
    """

    def __init__(
        self, fetch: Callable[[str, int, int], pa.Table], ticks: TickBuffer, source: str
    ) -> None:
        self.source = source
        self._fetch = fetch
        self._ticks = ticks
        self._blocks: OrderedDict[tuple[int, int], dict[str, dict[str, npt.NDArray[Any]]]] = (
            OrderedDict()
        )

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
