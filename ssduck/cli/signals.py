"""Handles the signals that end a command: Ctrl-C, SIGTERM and SIGHUP."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NoReturn

import typer

Handler = Callable[[int, Any], object]


@contextmanager
def deferred() -> Iterator[list[int]]:
    """Yields a list to which the first signal to end is added; the second one acts as usual."""
    received: list[int] = []
    before = _handlers()

    def on_first_signal(number: int, _: object) -> None:
        received.append(number)
        signal.signal(number, before[number])

    with _handled_by(on_first_signal, before):
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
        with _handled_by(on_signal, _handlers()):
            yield
    except BaseException:
        if received:  # a library may make another exception of it
            raise typer.Exit(128 + received[0]) from None
        raise


def _handlers() -> dict[int, Any]:
    """Returns the handlers of the signals that end a process; none in other threads."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    names = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    return {number: signal.getsignal(number) for number in numbers}


@contextmanager
def _handled_by(handler: Handler, before: Mapping[int, Any]) -> Iterator[None]:
    """Replaces handlers."""
    try:
        for number, old in before.items():
            if number == signal.SIGINT or old != signal.SIG_IGN:  # nohup lets SIGHUP be ignored
                signal.signal(number, handler)
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)
