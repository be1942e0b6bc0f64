"""Handles the signals that end a command, and runs strict programs in a child process.

The interpreter keeps most limits itself. A call in C that takes long, and memory that libraries
take, end with the process.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from typing import Any, NoReturn

import typer

from ssduck.errors import LimitError
from ssduck.limits import GRACE, Limits, ending_text, limit_process_memory

# The signals that end a process; Windows lacks the last one.
_ENDING = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]
Handler = Callable[[int, Any], object]


@contextmanager
def deferred() -> Iterator[list[int]]:
    """Yields a list to which the first signal to end is added; the second one acts as usual."""
    received: list[int] = []
    before = _handlers()

    def on_first_signal(number: int, _: object) -> None:
        received.append(number)
        signal.signal(number, before[number])

    # In the background of a shell, Ctrl-C is ignored, but `kill -INT` ends a recording.
    heard = (n for n, old in before.items() if n == signal.SIGINT or old != signal.SIG_IGN)
    with _handled_by(on_first_signal, heard, before):
        yield received


@contextmanager
def raised() -> Iterator[None]:
    """Raises KeyboardInterrupt at the first signal to end, so that what was begun is removed.

    The command then ends with the exit status of the signal; a second one ends it at once.
    """
    received: list[int] = []

    def on_signal(number: int, _: object) -> NoReturn:
        if received:
            os._exit(128 + number)
        received.append(number)
        raise KeyboardInterrupt

    try:
        before = _handlers()
        heard = (n for n, old in before.items() if old != signal.SIG_IGN)
        with _handled_by(on_signal, heard, before):
            yield
    except BaseException:
        if received:  # a library may make another exception of it
            raise typer.Exit(128 + received[0]) from None
        raise


def _handlers() -> dict[int, Any]:
    """Returns the handlers of the signals that end a process; none in other threads."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    return {number: signal.getsignal(number) for number in _ENDING}


@contextmanager
def _handled_by(
    handler: Handler, numbers: Iterable[int], before: Mapping[int, Any]
) -> Iterator[None]:
    """Has a handler handle some signals, and puts the handlers before back."""
    try:
        for number in numbers:
            signal.signal(number, handler)
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


# -- strict programs in a child process -------------------------------------------------------


_BEGINS, _ENDS = b"b", b"e"


def supervised(limits: Limits) -> AbstractContextManager[None]:
    """Forks, and returns in the child; the parent waits for it, and ends as the child does."""
    if not hasattr(os, "fork"):  # Windows: the interpreter alone keeps the limits
        return contextlib.nullcontext()
    sys.stdout.flush()
    sys.stderr.flush()
    reading, writing = os.pipe()
    # A signal that comes before the parent can handle it would leave the child alone.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
    child = os.fork()
    if child:
        os.close(writing)
        _wait(child, reading, limits, mask)
    signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    os.close(reading)
    return _program_time(writing, limits)


@contextlib.contextmanager
def _program_time(pipe: int, limits: Limits) -> Iterator[None]:
    """Tells the parent when the program begins and ends, and limits memory meanwhile."""
    limit_process_memory(limits)
    os.write(pipe, _BEGINS)
    try:
        yield
    except MemoryError as error:
        raise LimitError("the program needs too much memory") from error
    finally:
        os.write(pipe, _ENDS)


def _wait(child: int, pipe: int, limits: Limits, mask: set[int | signal.Signals]) -> NoReturn:
    """Waits for the child, and ends this process as the child ends."""

    def interrupted(number: int, _: object) -> NoReturn:
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        os._exit(128 + number)

    for number in _ENDING:
        signal.signal(number, interrupted)
    signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    timeout = None
    while True:
        ready, _, _ = select.select([pipe], [], [], timeout)
        if not ready:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            raise LimitError(late_text(limits))
        message = os.read(pipe, 1)
        if not message:
            break
        is_running = message == _BEGINS
        timeout = limits.seconds + GRACE if is_running and limits.seconds is not None else None
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code < 0:
        raise LimitError(f"the process of the program ended by {signal_text(-code)}")
    sys.stdout.flush()
    os._exit(code)


def late_text(limits: Limits) -> str:
    """Returns the message that a process was ended as its program took too long."""
    return f"the program took more than {limits.seconds:g} s, and its process was ended"


def signal_text(number: int) -> str:
    """Returns the name of the signal that ended a process, with its likely reason."""
    return f"{ending_text(-number)}; it may have needed more memory than available"
