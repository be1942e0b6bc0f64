"""Handles the signals that end a command: Ctrl-C and SIGTERM."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import typer


@contextmanager
def deferred() -> Iterator[list[int]]:
    """Yields a list to which the first signal to end is added; the second one acts as usual."""
    received: list[int] = []

    def on_first_signal(number: int, _: object) -> None:
        received.append(number)
        signal.signal(number, before[number])

    with _handled_by(on_first_signal) as before:
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
        with _handled_by(on_signal):
            yield
    except BaseException:
        if received:  # a library may make another exception of it
            raise typer.Exit(128 + received[0]) from None
        raise


@contextmanager
def _handled_by(handler: Callable[[int, Any], object]) -> Iterator[dict[int, Any]]:
    """Has a handler handle the signals that are not ignored; yields the handlers before."""
    is_main = threading.current_thread() is threading.main_thread()  # others get no signal
    numbers = (signal.SIGINT, signal.SIGTERM) if is_main else ()
    before: dict[int, Any] = {number: signal.getsignal(number) for number in numbers}
    heard = [number for number, old in before.items() if old != signal.SIG_IGN]
    try:
        for number in heard:
            signal.signal(number, handler)
        yield before
    finally:
        for number in heard:
            signal.signal(number, before[number])
