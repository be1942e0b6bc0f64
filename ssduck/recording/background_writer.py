"""Rows on their way to a store: full buffers, and the thread that stores them while ticks go on."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TypeAlias

import pyarrow as pa

# Entered while what was added is made good, by a store that others read.
Cut: TypeAlias = AbstractContextManager[None]
WHENEVER: Cut = nullcontext()


class BufferedRows:
    """The rows of a table, in parts.

    Attributes:
        empty: no rows, with the columns.
        parts: the oldest first.
        version: counts up whenever `arrow` becomes another object.
    """

    def __init__(self, columns: pa.Schema) -> None:
        self.empty = columns.empty_table()
        self.parts: list[pa.Table] = []
        self.version = 0

    @property
    def arrow(self) -> pa.Table:
        """All rows."""
        return pa.concat_tables([self.empty, *self.parts])


class BackgroundWriter:
    """Gives batches of rows to a store, the oldest first; in a thread, if that is wanted.

    A batch can be read here until it can be read in the store: the thread holds `lock` from the
    one to the other, and so does who reads both.

    Args:
        add: stores a batch, all or nothing of it, and enters the cut to make it good.
        tables: the columns of each table of a batch.

    Attributes:
        lock: is held while both are read.
        batches: the rows that are not stored, by table.
    """

    def __init__(
        self,
        add: Callable[[Mapping[str, pa.Table], Cut], None],
        tables: Mapping[str, pa.Schema],
    ) -> None:
        self._add = add
        # Who waits for the thread lets go of it, even under a query of its own.
        self.lock = threading.Condition(threading.RLock())
        self.batches = {table: BufferedRows(columns) for table, columns in tables.items()}
        self._count = 0
        self._thread: threading.Thread | None = None
        self._failure: BaseException | None = None

    def __len__(self) -> int:
        """How many batches are not stored."""
        return self._count

    @property
    def is_here(self) -> bool:
        """Whether the thread that asks is the one that stores."""
        return self._thread is threading.current_thread()

    @property
    def is_busy(self) -> bool:
        """Whether something is being stored in a thread."""
        return self._thread is not None

    def put(self, rows: Mapping[str, pa.Table]) -> None:
        """Take a batch; nothing is being stored."""
        with self.lock:
            for table, kept in self.batches.items():
                kept.parts.append(rows[table])
                kept.version += 1
            self._count += 1

    def start(self) -> None:
        """Store all batches in a thread; `wait` and `failure` tell how it went."""
        self._thread = threading.Thread(target=self._run, name="ssduck stores")
        try:
            self._thread.start()
        except RuntimeError:  # Python is about to end, and lets no thread begin
            self._run()

    def _run(self) -> None:
        try:
            self.store()
        except BaseException as error:  # noqa: BLE001  # who ticks or flushes next is told
            self._failure = error
        finally:
            with self.lock:
                self._thread = None
                self.lock.notify_all()

    def store(self) -> None:
        """Store all batches, here and now; what fails stays with those after it."""
        while self._count:
            first = {table: kept.parts[0] for table, kept in self.batches.items()}
            self._add(first, self._cut())

    @contextmanager
    def _cut(self) -> Iterator[None]:
        with self.lock:
            yield
            for kept in self.batches.values():
                del kept.parts[0]
                kept.version += 1
            self._count -= 1

    def wait(self) -> None:
        """Wait until nothing is being stored."""
        with self.lock:
            self.lock.wait_for(lambda: self._thread is None)

    def failure(self) -> BaseException | None:
        """What the thread has met since this was asked for."""
        failure, self._failure = self._failure, None
        return failure
