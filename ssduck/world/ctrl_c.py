"""Defers Ctrl-C while a tick is taken, so that it is taken and recorded as a whole."""

from __future__ import annotations

import inspect
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# Without their wrappers, which look up enumerations.
_handler_of = inspect.unwrap(signal.getsignal)
_set_handler = inspect.unwrap(signal.signal)
# The handlers that are replaced, outermost first, and whether Ctrl-C was pressed meanwhile.
_replaced: list[Any] = []
_is_pressed = False


def _note(*_: Any) -> None:
    global _is_pressed  # noqa: PLW0603  # signals are global
    _is_pressed = True


@contextmanager
def deferred() -> Iterator[None]:
    """Defers Ctrl-C to the end of the context; other threads than the main one never get it."""
    handler = None
    if threading.current_thread() is threading.main_thread():
        handler = _handler_of(signal.SIGINT)
    if not callable(handler) or handler is _note:
        yield
        return
    _replaced.append(handler)
    _set_handler(signal.SIGINT, _note)
    try:
        yield
    finally:
        _replaced.pop()
        _set_handler(signal.SIGINT, handler)
        _deliver(handler)


@contextmanager
def allowed() -> Iterator[None]:
    """Delivers Ctrl-C in the context, which may wait for long, within `deferred`."""
    is_deferred = threading.current_thread() is threading.main_thread() and bool(_replaced)
    if not is_deferred or _handler_of(signal.SIGINT) is not _note:
        yield
        return
    handler = _replaced[-1]
    _set_handler(signal.SIGINT, handler)
    try:
        _deliver(handler)
        yield
    finally:
        _set_handler(signal.SIGINT, _note)


def _deliver(handler: Any) -> None:
    """Calls a handler if Ctrl-C was pressed."""
    global _is_pressed  # noqa: PLW0603  # signals are global
    if _is_pressed:
        _is_pressed = False
        handler(signal.SIGINT, inspect.currentframe())
