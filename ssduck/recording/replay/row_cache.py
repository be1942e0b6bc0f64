"""The rows of recorded ticks, fetched in blocks."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ssduck.recording.buffers import TickBuffer

# So many ticks are fetched at once, and so many blocks of them kept.
BLOCK = 64
MAX_BLOCKS = 8


class RowCache:
    """The rows of a record, of which those that were asked for last are kept.

    Args:
        fetch: gives the rows of a table at the ticks from one to another.
        ticks: that are recorded.
    """

    def __init__(self, fetch: Callable[[str, int, int], pa.Table], ticks: TickBuffer) -> None:
        self._fetch = fetch
        self._ticks = ticks
        self._blocks: OrderedDict[tuple[int, int], dict[str, dict[str, npt.NDArray[Any]]]] = (
            OrderedDict()
        )

    def rows(self, table: str, tick: int) -> dict[str, npt.NDArray[Any]]:
        """The columns of a table at a tick; NaN for what is not known."""
        number = tick // BLOCK
        # What is recorded meanwhile makes a block another one.
        last = min((number + 1) * BLOCK - 1, int(self._ticks.numbers[-1]))
        key = number, last
        if key not in self._blocks:
            while len(self._blocks) >= MAX_BLOCKS:
                self._blocks.popitem(last=False)
            self._blocks[key] = {}
        self._blocks.move_to_end(key)
        block = self._blocks[key]
        if table not in block:
            found = self._fetch(table, number * BLOCK, last)
            order = np.argsort(found["tick"].to_numpy(), kind="stable")
            block[table] = {name: found[name].to_numpy()[order] for name in found.column_names}
        columns = block[table]
        first, end = np.searchsorted(columns["tick"], [tick, tick + 1])
        return {name: column[first:end] for name, column in columns.items()}
