"""Handles Ctrl-C during work that does not check for it, and ends statements whose time is up.

Python's own handler waits until the interpreter regains control. DuckDB checks for a signal only
between the tasks of a query, and one task may take minutes. A signal is written to a socket at
once, though; a thread listens to it.
"""

from __future__ import annotations

import math
import os
import select
import selectors
import signal
import socket
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from signal import set_wakeup_fd
from threading import get_ident, main_thread
from typing import TypeAlias

import duckdb

from ssduck.limits import UsageMeter
from ssduck.world.ctrl_c import handler_of

Stop: TypeAlias = Callable[[], None]

_write_to = partial(set_wakeup_fd, warn_on_full_buffer=False)
# Plain values are faster than the attributes of modules: each statement uses them.
_SIGINT, _python_handler = int(signal.SIGINT), signal.default_int_handler


class _SignalSocket:
    """The socket that signals are written to, and the thread that listens to it.

    Signals are taken only under the lock: by the thread, or by the listener that leaves. So a
    signal reaches the listener of its time, never the next.
    """

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.current: InterruptListener | None = None
        self._receiver, self._sender = socket.socketpair()
        self._receiver.setblocking(False)
        self._sender.setblocking(False)
        self.number = self._sender.fileno()
        # Polling is cheaper than the error of an empty socket; Windows has no `poll`.
        self._poll = select.poll() if hasattr(select, "poll") else None
        if self._poll is not None:
            self._poll.register(self._receiver, select.POLLIN)
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
        """Passes on the signals that were written; the lock is held."""
        if self._poll is not None and not self._poll.poll(0):
            return
        try:
            signals = self._receiver.recv(4096)
        except BlockingIOError:
            return
        if self.current is not None:
            self.current.receive(signals, stops=stops)


class InterruptListener:
    """Work that Ctrl-C stops, from `enter` to `leave`.

    Python may raise KeyboardInterrupt inside `enter` and `leave`; `leave` undoes a part of
    `enter`, and may be called again.

    Args:
        stop: a function that is called at Ctrl-C, from another thread.

    Attributes:
        pressed: whether Ctrl-C was pressed; final after `leave`.
    """

    __slots__ = ("_before", "_line", "_outer", "_stop", "pressed")

    def __init__(self, stop: Stop) -> None:
        self.pressed = False
        self._stop = stop
        self._line: _SignalSocket | None = None
        self._outer: InterruptListener | None = None
        # The file descriptor of the previous signal handler, if there was one.
        self._before: list[int] = []

    def enter(self) -> None:
        """Starts to listen, in the main thread only, and not if the user has a handler."""
        if get_ident() != main_thread().ident or handler_of(_SIGINT) is not _python_handler:
            return
        self._line = line = _open_socket()
        if line.current is None:  # only this thread sets it
            line.current = self
        else:
            with line.lock:
                line.take()
                self._outer = line.current
                line.current = self
        # In one C call, so that no exception between the calls loses the result.
        self._before.extend(map(_write_to, (line.number,)))

    def leave(self) -> None:
        """Restores the state before `enter`."""
        line = self._line
        if line is None or line.current is not self:
            return
        for before in self._before:
            set_wakeup_fd(before, warn_on_full_buffer=before != line.number)
        with line.lock:
            line.take(stops=False)
            line.current = self._outer

    def receive(self, signals: bytes, *, stops: bool) -> None:
        """Receives signals, and passes them on."""
        if signal.SIGINT in signals:
            self.pressed = True
            if stops:
                self._stop()
        self.pass_on(signals)

    def pass_on(self, signals: bytes) -> None:
        """Passes signals on to the previous listener."""
        assert self._line is not None
        before = self._before[0] if self._before else self._line.number
        if before != self._line.number:
            with suppress(OSError):  # closed, or no longer read
                os.write(before, signals)
        elif self._outer is not None:
            self._outer.pass_on(signals)


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
    if _line is None:
        return
    line, _line = _line, None
    line.current = None
    before = signal.set_wakeup_fd(-1)
    if before not in {-1, line.number}:
        signal.set_wakeup_fd(before)
    line.close()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_close_in_child)


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


# The time between two interrupts of a statement whose time is up, s.
INTERRUPT_INTERVAL = 0.02
# The time after which the thread looks whether statements still come, s.
_LINGER = 1.0

Entry: TypeAlias = tuple[UsageMeter, Callable[[], None]]


class Deadlines:
    """The statements that run, and the thread that interrupts them.

    The thread keeps looking for a while after a statement has ended: waking it for each would take
    longer than many statements.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._condition = threading.Condition(self._lock)
        self._entries: dict[Hashable, Entry] = {}
        # When the thread looks next, and whether a statement has begun since it looked.
        self._next_look = math.inf
        self._is_used = False
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
            self._is_used = True
            deadline = meter.deadline
            if deadline is not None and deadline < self._next_look:
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
        is_used, self._is_used = self._is_used, False
        late = [interrupt for meter, interrupt in self._entries.values() if _deadline(meter) <= now]
        for interrupt in late:
            interrupt()
        if late:
            return INTERRUPT_INTERVAL
        if not self._entries:
            return _LINGER if is_used else math.inf
        return min(_deadline(meter) for meter, _ in self._entries.values()) - now


def _deadline(meter: UsageMeter) -> float:
    deadline = meter.deadline
    return math.inf if deadline is None else deadline


DEADLINES = Deadlines()

if hasattr(os, "register_at_fork"):  # a child has no such thread, and no statement that runs
    os.register_at_fork(after_in_child=DEADLINES.__init__)  # type: ignore[misc]
