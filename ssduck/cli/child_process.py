"""Runs a strict program in a child process, which its parent ends when it exceeds its limits.

The interpreter keeps most limits itself. A call in C that takes long, and memory that libraries
take, end with the process.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import NoReturn

from ssduck.cli.signals import ENDING
from ssduck.errors import LimitError
from ssduck.limits import GRACE, Limits, ending_text, limit_process_memory

_BEGINS, _ENDS = b"b", b"e"


def supervised(limits: Limits) -> AbstractContextManager[None]:
    """Forks, and returns in the child; the parent waits for it, and ends as the child does."""
    if not hasattr(os, "fork"):  # Windows: the interpreter alone keeps the limits
        return contextlib.nullcontext()
    sys.stdout.flush()
    sys.stderr.flush()
    reading, writing = os.pipe()
    # A signal that comes before the parent can handle it would leave the child alone.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
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

    for number in ENDING:
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
