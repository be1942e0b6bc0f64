"""Runs statements on a connection, traced, until they end, Ctrl-C is pressed or their time is up.

DuckDB itself lets Python handle Ctrl-C, between the tasks of a query, of milliseconds each.
"""

from __future__ import annotations

import math
import os
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn, TypeVar

import duckdb

from ssduck.database.fetched_rows import is_duckdb_error
from ssduck.database.instances import damage_text, hint_of, is_damage, needed_extension
from ssduck.errors import (
    EvaluationError,
    LimitError,
    RecordError,
    SqlError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.limits import Limits, UsageMeter
from ssduck.recording.opened_record import OpenedRecord

T = TypeVar("T")

_REFUSAL_ERRORS = (duckdb.BinderException, duckdb.ParserException, duckdb.CatalogException)
# Errors that a file may cause.
_READING_ERRORS = (duckdb.IOException, duckdb.InvalidInputException, duckdb.SerializationException)
# Errors of functions that SQL calls, which stay as they are.
_OWN_ERRORS = (LimitError, UnknownNameError, UnsupportedError, EvaluationError, RecordError)
# The time between two interrupts of a statement whose time is up, s.
INTERRUPT_INTERVAL = 0.02


@contextmanager
def translated() -> Iterator[None]:
    """Raises KeyboardInterrupt where DuckDB makes another error of Ctrl-C.

    It hears it by itself, or Python does while DuckDB asks Arrow for the types of a table.
    """
    try:
        yield
    except (RuntimeError, duckdb.Error) as error:
        text = str(error)
        if text == "Query interrupted" or (
            isinstance(error, duckdb.Error) and "KeyboardInterrupt" in text
        ):
            raise KeyboardInterrupt from error
        raise


# -- limits of time ---------------------------------------------------------------------------


class Deadlines:
    """The statements that run, and the thread that interrupts them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._condition = threading.Condition(self._lock)
        self._entries: dict[Hashable, tuple[UsageMeter, Callable[[], None]]] = {}
        self._next_look = math.inf
        self._thread: threading.Thread | None = None

    def begin(self, key: Hashable, meter: UsageMeter, interrupt: Callable[[], None]) -> None:
        """Begins to watch a statement of a program whose time is limited.

        Args:
            key: an object for `end`.
            meter: tells when the time is up.
            interrupt: a quick function that is called when its time is up, again and again, because
                DuckDB ignores an interrupt before a statement begins.
        """
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._watch, daemon=True)
                self._thread.start()
            self._entries[key] = meter, interrupt
            if _deadline(meter) < self._next_look:
                self._condition.notify()

    def end(self, key: Hashable) -> None:
        """Ends to watch a statement; it is not interrupted after that. It may be called again."""
        with self._lock:
            self._entries.pop(key, None)

    def look_again(self) -> None:
        """Has the thread look at once, as programs were stopped."""
        with self._lock:
            self._condition.notify()

    def _watch(self) -> None:
        with self._condition:
            while True:
                wait = self._look()
                self._next_look = time.monotonic() + wait
                self._condition.wait(None if wait == math.inf else min(wait, threading.TIMEOUT_MAX))

    def _look(self) -> float:
        """Interrupts the statements that are late; returns the time until the next look, s."""
        # It holds on to no statement afterwards: that would keep its connection open.
        now = time.monotonic()
        late = [interrupt for meter, interrupt in self._entries.values() if _deadline(meter) <= now]
        for interrupt in late:
            interrupt()
        if late:
            return INTERRUPT_INTERVAL
        deadlines = (_deadline(meter) for meter, _ in self._entries.values())
        return min(deadlines, default=math.inf) - now


def _deadline(meter: UsageMeter) -> float:
    deadline = meter.deadline
    return math.inf if deadline is None else deadline


DEADLINES = Deadlines()

if hasattr(os, "register_at_fork"):  # a child has no such thread, and no statement that runs
    os.register_at_fork(after_in_child=DEADLINES.__init__)  # type: ignore[misc]


# -- statements -------------------------------------------------------------------------------


class StatementRunner(ABC):
    """Runs statements on a connection to DuckDB, traced, and interrupts them in time.

    Attributes:
        meter: the use of the running program's limits.
    """

    def __init__(
        self,
        connection: duckdb.DuckDBPyConnection,
        tracer: Callable[[str], None] | None,
        limits: Limits,
    ) -> None:
        self._connection = connection
        self._tracer = tracer
        self.meter = UsageMeter(limits)
        self._opened: OpenedRecord | None = None
        # The attached file with a record.
        self._attached: Path | None = None
        # What functions do before each statement.
        self._at_start: dict[str, Callable[[], None]] = {}
        # The exception of a function that SQL called: DuckDB keeps its text only.
        self._raised: list[BaseException] = []

    @property
    @abstractmethod
    def is_open(self) -> bool:
        """Whether the connection is open."""

    def _execute(self, sql: str, work: Callable[[], T], *, timed: bool = True) -> T:
        """Traces a statement, runs it, and interrupts it when its time is up."""
        if self._opened is not None:
            self._opened.check()
        if self._tracer is not None:
            self._tracer(sql)
        self._raised.clear()
        for begin in self._at_start.values():
            begin()
        key = object() if timed and self.meter.deadline is not None else None
        try:
            if key is not None:
                DEADLINES.begin(key, self.meter, self._interrupt)
            return work()
        except MemoryError as error:
            raise LimitError("the query needs more memory than available") from error
        except Exception as error:
            if not is_duckdb_error(error):
                raise
            self._raise_error(error)
        finally:
            if key is not None:
                DEADLINES.end(key)  # so that it does not interrupt what comes next

    def _interrupt(self) -> None:
        with suppress(duckdb.Error):  # it was closed meanwhile
            self._connection.interrupt()

    def _raise_error(self, error: Exception) -> NoReturn:
        cause = self._raised.pop() if self._raised else None
        if isinstance(cause, KeyboardInterrupt):
            raise cause from None
        if isinstance(cause, _OWN_ERRORS):
            raise cause from None
        if not self.is_open:
            raise SqlError("the interpreter is closed", is_final=True) from error
        self.meter.check_time()
        is_interrupt = isinstance(error, RuntimeError | duckdb.InterruptException)
        if is_interrupt or "KeyboardInterrupt" in str(error):
            raise KeyboardInterrupt from error
        if self._attached is not None and is_damage(error):
            raise RecordError(damage_text(self._attached, error)) from error
        if isinstance(error, duckdb.OutOfMemoryException):
            raise LimitError(f"the query needs more memory than available: {error}") from error
        if not self.meter.limits.files and (extension := needed_extension(error)) is not None:
            raise LimitError(
                f"the statement needs DuckDB's extension {extension!r}, which is not loaded, and "
                "files are switched off here (Limits: files)"
            ) from error
        if self._opened is not None and isinstance(error, _READING_ERRORS):
            unreadable = self._opened.reading_error(str(error))
            if unreadable is not None:
                raise unreadable from error
        text = str(error).strip()
        refused = isinstance(error, _REFUSAL_ERRORS)
        raise SqlError(text + hint_of(error), is_refused=refused) from error
