"""The processes of this machine that answer questions, kept from one question to the next.

To start a process takes as long as to ask a hundred episodes. So the processes of the last question
are kept for some minutes, for one question at a time: a question that comes meanwhile has processes
of its own.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

# To start processes, some 2 s, takes as long as to ask so many episodes for each of them.
COLD = 140
# Each process that is there already has so many episodes at least.
WARM = 25
# How long processes are kept that answer nothing, s.
IDLE = 300.0


@dataclass(frozen=True)
class _Kept:
    """Processes that answer nothing now."""

    count: int
    setting: tuple[Any, ...]
    executor: ProcessPoolExecutor
    timer: threading.Timer

    def end(self) -> None:
        self.timer.cancel()
        self.executor.shutdown()


def end_at_once(executor: ProcessPoolExecutor) -> None:
    """Ends processes, whatever they are doing."""
    for process in list((executor._processes or {}).values()):  # noqa: SLF001
        process.terminate()
    executor.shutdown(cancel_futures=True)


class ProcessPools:
    """Gives questions processes, and keeps those of one question."""

    def __init__(self) -> None:
        self._kept: _Kept | None = None
        self._lock = threading.RLock()
        # Those of a process that forked: they are its own to end, and not those of its child.
        self._of_parent: list[_Kept] = []

    def default_count(self, episodes: int) -> int:
        """Returns the number of processes that answer for so many episodes soonest."""
        cores = os.cpu_count() or 1
        started = max(1, min(cores, episodes // COLD))
        with self._lock:
            kept = self._kept
        if kept is None or kept.setting != _setting() or kept.count > cores:
            return started
        return max(started, kept.count) if episodes >= WARM * kept.count else started

    def take(self, count: int) -> tuple[ProcessPoolExecutor, bool]:
        """Returns so many processes for one question, and whether they were there already.

        The caller gives them to `keep`, or shuts them down.
        """
        with self._lock:
            kept, self._kept = self._kept, None
        if kept is not None:
            if (kept.count, kept.setting) == (count, _setting()):
                kept.timer.cancel()
                return kept.executor, True
            kept.end()
        # A forked process would lack the threads of DuckDB.
        spawn = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(count, spawn, _end_with_parent), False

    def keep(self, executor: ProcessPoolExecutor, count: int) -> None:
        """Keeps processes that have answered for the next question, in place of others."""
        timer = threading.Timer(IDLE, self._end_idle, (executor,))
        timer.daemon = True
        with self._lock:
            before, self._kept = self._kept, _Kept(count, _setting(), executor, timer)
            timer.start()
        if before is not None:
            before.end()

    def close(self) -> None:
        """Ends the processes that are kept."""
        with self._lock:
            kept, self._kept = self._kept, None
        if kept is not None:
            kept.end()

    def _end_idle(self, executor: ProcessPoolExecutor) -> None:
        """Ends processes if they are still those that are kept."""
        with self._lock:
            kept = self._kept
            if kept is None or kept.executor is not executor:
                return
            self._kept = None
        kept.end()

    def leave_to_parent(self) -> None:
        """Keeps nothing in a process that was forked."""
        self._lock = threading.RLock()
        if self._kept is not None:
            self._of_parent.append(self._kept)
            self._kept = None


def _setting() -> tuple[Any, ...]:
    """Returns what processes have from their start."""
    try:
        folder = Path.cwd()
    except FileNotFoundError:
        folder = None
    return folder, dict(os.environ), tuple(sys.path)


def _end_with_parent() -> None:
    """Lets this process end when its parent is killed, which cannot tell it to."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def end() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=end, name="ssduck-parent", daemon=True).start()


pools = ProcessPools()
_register: Callable[..., None] | None = getattr(os, "register_at_fork", None)
if _register is not None:
    _register(after_in_child=pools.leave_to_parent)
