"""Stores the last ticks of recorded worlds that stand still, in time.

A world that ticks stores its rows in time by itself. A thread of the process sees to the others: it
sleeps until the buffered rows of a recorder are due, and takes them if nothing uses the recorder.
"""

from __future__ import annotations

import os
import threading
import weakref
from time import monotonic
from typing import Protocol

# The time after which rows are taken that could not be taken when they were due, s.
RETRY_INTERVAL = 0.02
# The time after which the thread ends if nothing is buffered, s.
_IDLE_SECONDS = 5.0


class Flushable(Protocol):
    """A recorder.

    Attributes:
        flush_at: the time at which buffered rows are to be stored, s of `time.monotonic`; None if
            there are none.
    """

    flush_at: float | None

    def try_to_flush(self) -> bool:
        """Starts storing rows that are due; returns False if that is not possible now."""


class _FlushTimer:
    """The thread that stores rows of worlds that stand still, and the recorders of these."""

    def __init__(self) -> None:
        self._wakes = threading.Condition()
        self._recorders: weakref.WeakSet[Flushable] = weakref.WeakSet()
        self.thread: threading.Thread | None = None

    def watch(self, recorder: Flushable) -> None:
        """Stores the buffered rows of a recorder when they are due."""
        with self._wakes:
            self._recorders.add(recorder)
            if self.thread is None:
                self.thread = threading.Thread(target=self._run, name="ssduck flushes", daemon=True)
                try:
                    self.thread.start()
                except RuntimeError:  # the interpreter is shutting down, and stores all rows
                    self.thread = None
            else:
                self._wakes.notify()

    def _run(self) -> None:
        while (seconds := self._wait_time()) is not None:
            with self._wakes:
                self._wakes.wait(seconds)
            if not threading.main_thread().is_alive():
                return
            self._flush()

    def _flush(self) -> None:
        """Starts storing the rows that are due; keeps no recorder alive afterwards."""
        with self._wakes:
            recorders = list(self._recorders)
        for recorder in recorders:
            recorder.try_to_flush()

    def _wait_time(self) -> float | None:
        """Returns the time until rows are due, s; None if the thread is to end."""
        with self._wakes:
            due = [r.flush_at for r in self._recorders if r.flush_at is not None]
            if due:
                return max(min(due) - monotonic(), RETRY_INTERVAL)
            if not self._recorders:
                self.thread = None
                return None
            return _IDLE_SECONDS


_timer = _FlushTimer()


def start_watching(recorder: Flushable) -> None:
    """Stores the buffered rows of a recorder from now on whenever they are due."""
    _timer.watch(recorder)


def is_timer_thread() -> bool:
    """Checks whether the calling thread is the one that stores rows when they are due."""
    return _timer.thread is threading.current_thread()


def _renew_in_child() -> None:
    """Gives a forked process, which lacks the thread, a timer of its own."""
    global _timer  # noqa: PLW0603
    _timer = _FlushTimer()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_in_child)
