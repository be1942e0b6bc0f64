"""Pins all worlds of a database at their tick while statements run."""

from __future__ import annotations

import threading
from collections.abc import Callable

from ssduck.database.referenced_tables import ReadData
from ssduck.database.worlds import WorldRegistry


class PinnedWorlds:
    """Pins worlds at their tick, with their rows registered, while statements run.

    A class is faster than a generator: each statement pins all worlds.

    Args:
        lock: the lock of the database.
        registry: the worlds of the database.
        reads: the tables to read, from the simulators if need be, and of which worlds.
        is_settled: whether all columns are written, as DuckDB needs them.
    """

    __slots__ = ("_is_settled", "_lock", "_reads", "_registry", "_undo")

    def __init__(
        self,
        lock: threading.RLock,
        registry: WorldRegistry,
        reads: ReadData,
        *,
        is_settled: bool = True,
    ) -> None:
        self._is_settled = is_settled
        self._lock = lock
        self._registry = registry
        self._reads = reads
        # The functions that undo what was done, in the order of doing.
        self._undo: list[Callable[[], object]] = []

    def __enter__(self) -> None:
        self._lock.acquire()
        self._undo.append(self._lock.release)
        try:
            self._pin()
        except BaseException:
            self.__exit__()
            raise

    def __exit__(self, *_: object) -> None:
        undo = self._undo
        while undo:
            undo.pop()()

    def _pin(self) -> None:
        undo, tables, worlds = self._undo, self._reads.tables, self._reads.worlds
        present = [
            (world, bound)
            for bound in self._registry.bound
            if (world := bound.reference()) is not None
        ]
        if len(present) > 1:  # in the same order in all databases, so that there is no deadlock
            present.sort(key=lambda item: item[0].serial)
        for world, _ in present:
            is_read = worlds is None or world.serial in worlds
            world.pin(tables if is_read else (), is_read=is_read, is_settled=self._is_settled)
            undo.append(world.unpin)
        for _, bound in present:
            history = bound.history
            if history is not None and history.recorder is not None:
                if self._is_settled:
                    bound.settle_history()
                lock = history.recorder.read_lock
                lock.acquire()
                undo.append(lock.release)
            self._registry.register(bound)
