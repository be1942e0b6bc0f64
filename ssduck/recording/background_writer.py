"""Writes batches of rows to a store in a background thread while the simulation goes on.

A world that ticks stores its rows in time by itself. A timer sees to the others: when the buffered
rows of a recorder are due, it takes them if nothing uses the recorder.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from time import monotonic, sleep
from typing import Any, TypeAlias

import pyarrow as pa

from ssduck.world import ctrl_c
from ssduck.world.live_tables import new_version

# Held by a store while added rows become readable.
CommitLock: TypeAlias = AbstractContextManager[None]
NO_LOCK: CommitLock = nullcontext()
# Stores a batch, the rows of each table.
StoreBatch: TypeAlias = Callable[[Mapping[str, pa.Table], CommitLock], None]
# The names of the threads that store rows, and of the timers.
_NAMES = ("ssduck stores", "ssduck flushes")


def is_background_thread() -> bool:
    """Checks whether the calling thread is one that stores rows in the background."""
    return threading.current_thread().name in _NAMES


class BufferedRows:
    """The rows of a table in several parts."""

    def __init__(self, columns: pa.Schema) -> None:
        self.empty = columns.empty_table()  # a table without rows that has the columns
        self.replace([])

    def replace(self, parts: list[pa.Table]) -> None:
        """Replaces the parts."""
        self.parts = parts  # the parts, oldest first
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
        self._thread: threading.Thread | None = None
        self._failure: BaseException | None = None

    def __len__(self) -> int:
        """Returns the number of batches that are not stored yet."""
        return len(self.batches["ticks"].parts)

    @property
    def is_busy(self) -> bool:
        """Whether the background thread is running."""
        return self._thread is not None

    def put(self, rows: Mapping[str, pa.Table]) -> None:
        """Adds a batch; the background thread must not be running."""
        with self.lock:
            for table, batch in self.batches.items():
                batch.replace([*batch.parts, rows[table]])

    def start(self) -> None:
        """Stores all batches in the background; see `wait` and `pop_failure` for the outcome."""
        self._thread = threading.Thread(target=self._run, name=_NAMES[0])
        try:
            self._thread.start()
        except RuntimeError:  # the interpreter is shutting down and starts no threads
            self._run()

    def _run(self) -> None:
        try:
            self.store()
        except BaseException as error:  # noqa: BLE001  # raised by the next tick or flush
            self._failure = error
        finally:
            with self.lock:
                self._thread = None
                self.lock.notify_all()

    def store(self) -> None:
        """Stores all batches in this thread; a batch that fails and those after it stay here."""
        while len(self):
            oldest = {table: batch.parts[0] for table, batch in self.batches.items()}
            self._append(oldest, self._commit())

    @contextmanager
    def _commit(self) -> Iterator[None]:
        with self.lock:
            yield
            for batch in self.batches.values():
                batch.replace(batch.parts[1:])

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


def start_watching(recorder: Any) -> None:
    """Stores the rows of a `Recorder` when they are due, though its world stands still."""
    seconds = max((recorder.flush_at or 0.0) - monotonic(), RETRY_INTERVAL)
    timer = threading.Timer(seconds, _flush, (weakref.ref(recorder),))
    timer.name, timer.daemon = _NAMES[1], True
    with suppress(RuntimeError):  # the interpreter is shutting down, and stores all rows
        timer.start()


def _flush(reference: weakref.ref[Any]) -> None:
    """Starts storing the rows that are due, unless a tick has done so meanwhile."""
    while (recorder := reference()) is not None and threading.main_thread().is_alive():
        due = recorder.flush_at
        if due is None or due > monotonic() or recorder.try_to_flush():
            return
        del recorder  # it is not kept alive
        sleep(RETRY_INTERVAL)
