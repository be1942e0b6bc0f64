"""Writes batches of rows to a store in a background thread while the simulation goes on.

A world that ticks stores its rows in time by itself. A thread of the process sees to the others: it
sleeps until the buffered rows of a recorder are due, and takes them if nothing uses the recorder.
"""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from time import monotonic
from typing import Protocol, TypeAlias

import pyarrow as pa

from ssduck.world import ctrl_c
from ssduck.world.live_tables import new_version

# Held by a store while added rows become readable.
CommitLock: TypeAlias = AbstractContextManager[None]
NO_LOCK: CommitLock = nullcontext()
# Stores a batch, the rows of each table.
StoreBatch: TypeAlias = Callable[[Mapping[str, pa.Table], CommitLock], None]


class BufferedRows:
    """The rows of a table in several parts."""

    def __init__(self, columns: pa.Schema) -> None:
        self.empty = columns.empty_table()  # a table without rows that has the columns
        self.parts: list[pa.Table] = []  # the parts, oldest first
        # A number that changes whenever `arrow` becomes another object.
        self.version = new_version()

    @property
    def arrow(self) -> pa.Table:
        """The rows of all parts."""
        return pa.concat_tables([self.empty, *self.parts])


class BackgroundWriter:
    """Writes batches of rows to a store, oldest first, in this thread or in the background.

    A batch is readable here until it is readable in the store. The writing thread holds `lock`
    during the transition, and a reader of both holds it while it reads.
    """

    def __init__(
        self,
        append: StoreBatch,
        tables: Mapping[str, pa.Schema],
    ) -> None:
        self._append = append
        # A condition: waiting for the thread releases the lock, however often it was acquired.
        self.lock = threading.Condition(threading.RLock())
        # The rows that are not stored yet, by table.
        self.batches = {table: BufferedRows(columns) for table, columns in tables.items()}
        self._count = 0
        self._thread: threading.Thread | None = None
        self._failure: BaseException | None = None

    def __len__(self) -> int:
        """Returns the number of batches that are not stored yet."""
        return self._count

    @property
    def is_writer_thread(self) -> bool:
        """Whether the calling thread is the background thread."""
        return self._thread is threading.current_thread()

    @property
    def is_busy(self) -> bool:
        """Whether the background thread is running."""
        return self._thread is not None

    def put(self, rows: Mapping[str, pa.Table]) -> None:
        """Adds a batch; the background thread must not be running."""
        with self.lock:
            for table, batch in self.batches.items():
                batch.parts.append(rows[table])
                batch.version = new_version()
            self._count += 1

    def start(self) -> None:
        """Stores all batches in the background; see `wait` and `pop_failure` for the outcome."""
        self._thread = threading.Thread(target=self._run, name="ssduck stores")
        try:
            self._thread.start()
        except RuntimeError:  # the interpreter is shutting down and starts no threads
            self._run()

    def _run(self) -> None:
        try:
            self.store(self._append)
        except BaseException as error:  # noqa: BLE001  # raised by the next tick or flush
            self._failure = error
        finally:
            with self.lock:
                self._thread = None
                self.lock.notify_all()

    def store(self, store_batch: StoreBatch) -> None:
        """Stores all batches in this thread; a batch that fails and those after it stay here."""
        while self._count:
            oldest = {table: batch.parts[0] for table, batch in self.batches.items()}
            store_batch(oldest, self._commit())

    @contextmanager
    def _commit(self) -> Iterator[None]:
        with self.lock:
            yield
            for batch in self.batches.values():
                del batch.parts[0]
                batch.version = new_version()
            self._count -= 1

    def wait(self, *, is_final: bool = False) -> None:
        """Waits until the background thread has ended.

        Ctrl-C that is deferred is delivered if there is something to wait for, and only then.
        """
        if not self.is_busy:
            return
        with nullcontext() if is_final else ctrl_c.allowed(), self.lock:
            self.lock.wait_for(lambda: self._thread is None)

    def pop_failure(self) -> BaseException | None:
        """Returns the error of the background thread since the last call; None if there is none."""
        failure, self._failure = self._failure, None
        return failure


# -- rows that are due ------------------------------------------------------------------------

# The time after which rows are taken that could not be taken when they were due, s.
RETRY_INTERVAL = 0.02
# The time after which the thread ends if nothing is buffered, s.
_IDLE_SECONDS = 5.0


class Flushable(Protocol):
    """A recorder."""

    # the time at which buffered rows are to be stored, s of `time.monotonic`; None if there are
    # none
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
