"""Handles the signals that end a command: Ctrl-C, SIGTERM and SIGHUP."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NoReturn

import typer

# The signals that end a process; Windows lacks the last one.
ENDING = [
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
    return {number: signal.getsignal(number) for number in ENDING}


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
