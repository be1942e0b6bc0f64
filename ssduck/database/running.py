"""Runs statements on a connection, traced, until they end, Ctrl-C is pressed or their time is up.

Python's own handler of Ctrl-C waits until the interpreter regains control. DuckDB checks for a
signal only between the tasks of a query, and one task may take minutes. A signal is written to a
socket at once, though; a thread listens to it.
"""

from __future__ import annotations

import math
import os
import selectors
import signal
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from signal import set_wakeup_fd
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
from ssduck.world.ctrl_c import handler_of

T = TypeVar("T")

_REFUSAL_ERRORS = (duckdb.BinderException, duckdb.ParserException, duckdb.CatalogException)
# Errors that a file may cause.
_READING_ERRORS = (duckdb.IOException, duckdb.InvalidInputException, duckdb.SerializationException)
# Errors of functions that SQL calls, which stay as they are.
_OWN_ERRORS = (LimitError, UnknownNameError, UnsupportedError, EvaluationError, RecordError)
# The time between two interrupts of a statement whose time is up, s.
INTERRUPT_INTERVAL = 0.02


# -- Ctrl-C -----------------------------------------------------------------------------------


class _SignalSocket:
    """The socket that signals are written to, and the thread that listens to it.

    Signals are taken only under the lock: by the thread, or by the listener that leaves. So a
    signal reaches the listener of its time, never the next.
    """

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.current: InterruptListener | None = None
        # Where signals were written before; they still are.
        self.before = -1
        self._receiver, self._sender = socket.socketpair()
        self._receiver.setblocking(False)
        self._sender.setblocking(False)
        self.number = self._sender.fileno()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._receiver, selectors.EVENT_READ)
            while True:
                selector.select()
                with self.lock:
                    self.take()

    def close(self) -> None:
        """Closes the socket, in a process where no thread listens."""
        self._receiver.close()
        self._sender.close()

    def take(self, *, stops: bool = True) -> None:
        """Tells the listener of the signals that were written; the lock is held."""
        with suppress(BlockingIOError):
            signals = self._receiver.recv(4096)
            if self.before != -1:
                with suppress(OSError):  # closed, or no longer read
                    os.write(self.before, signals)
            if self.current is not None and signal.SIGINT in signals:
                self.current.pressed = True
                if stops:
                    self.current.stop()


class InterruptListener:
    """Work that Ctrl-C stops, from `enter` to `leave`.

    Python may raise KeyboardInterrupt inside `enter` and `leave`; `leave` undoes a part of
    `enter`, and may be called again.

    Attributes:
        pressed: whether Ctrl-C was pressed; final after `leave`.
    """

    __slots__ = ("_line", "_outer", "pressed", "stop")

    def __init__(self, stop: Callable[[], None]) -> None:
        self.pressed = False
        self.stop = stop
        self._line: _SignalSocket | None = None
        self._outer: InterruptListener | None = None

    def enter(self) -> None:
        """Starts to listen in the main thread, unless the user has a handler."""
        is_main = threading.get_ident() == threading.main_thread().ident
        if not is_main or handler_of(signal.SIGINT) is not signal.default_int_handler:
            return
        self._line = line = _open_socket()
        with line.lock:
            line.take()
            self._outer = line.current
            line.current = self
        before = set_wakeup_fd(line.number, warn_on_full_buffer=False)
        if before != line.number:
            line.before = before

    def leave(self) -> None:
        """Restores the state before `enter`."""
        line = self._line
        if line is None or line.current is not self:
            return
        if self._outer is None:
            set_wakeup_fd(line.before)
        with line.lock:
            line.take(stops=False)
            line.current = self._outer
            if self._outer is None:
                line.before = -1


_line: _SignalSocket | None = None


def _open_socket() -> _SignalSocket:
    """Returns the line of this process."""
    global _line  # noqa: PLW0603
    if _line is None:
        _line = _SignalSocket()
    return _line


def _close_in_child() -> None:
    """Detaches a forked child from its parent's line, whose thread it does not have."""
    global _line
    if _line is not None:
        line, _line = _line, None
        line.current = None
        if (before := set_wakeup_fd(-1)) != line.number:
            set_wakeup_fd(before)
        line.close()


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
        """Interrupts the statements that are late; returns the time until the next look, s.

        It holds on to no statement afterwards: that would keep its connection open.
        """
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

if hasattr(os, "register_at_fork"):  # a child has no such threads, and no statement that runs
    os.register_at_fork(after_in_child=_close_in_child)
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
        # A record that is read.
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
        """Traces a statement, runs it, and interrupts it when the time is up.

        DuckDB's errors become ssduck's. At Ctrl-C, Python raises at the first call after
        DuckDB's error, or inside DuckDB, which makes another error of it, or none.
        """
        if self._opened is not None:
            self._opened.check()
        if self._tracer is not None:
            self._tracer(sql)
        self._raised.clear()
        for begin in self._at_start.values():
            begin()
        listener = InterruptListener(self._interrupt)
        try:
            result = self._run_in_time(work, listener, is_timed=timed)
        except Exception as error:
            if isinstance(error, MemoryError):
                raise LimitError("the query needs more memory than available") from error
            if not (listener.pressed or is_duckdb_error(error)):
                raise
            self._raise_error(error, interrupted=listener.pressed)
        if listener.pressed:
            raise KeyboardInterrupt
        return result

    def _run_in_time(
        self, work: Callable[[], T], listener: InterruptListener, *, is_timed: bool
    ) -> T:
        is_timed = is_timed and self.meter.deadline is not None
        try:
            listener.enter()
            if is_timed:
                DEADLINES.begin(listener, self.meter, self._interrupt)
            result = work()
        finally:
            try:
                _end(listener, is_timed=is_timed)
            except KeyboardInterrupt:  # it may have come before `_end` was done
                _end(listener, is_timed=is_timed)
                raise
        return result

    def _interrupt(self) -> None:
        with suppress(duckdb.Error):  # it was closed meanwhile
            self._connection.interrupt()

    def _raise_error(self, error: Exception, *, interrupted: bool) -> NoReturn:
        cause = self._raised.pop() if self._raised else None
        if isinstance(cause, KeyboardInterrupt):
            raise cause from None
        if interrupted:
            raise KeyboardInterrupt from error
        if isinstance(cause, _OWN_ERRORS):
            raise cause from None
        if not self.is_open:
            raise SqlError("the interpreter is closed", is_final=True) from error
        self.meter.check_time()
        if isinstance(error, RuntimeError | duckdb.InterruptException):
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


def _end(listener: InterruptListener, *, is_timed: bool) -> None:
    listener.leave()
    if is_timed:
        DEADLINES.end(listener)  # so that it does not interrupt what comes next
