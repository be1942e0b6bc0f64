"""Defers Ctrl-C while a tick is taken, so that it is taken and recorded as a whole."""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]
import inspect
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# Without the wrappers of `signal`, which take ten times longer.
handler_of = _signal.getsignal
_set_handler = _signal.signal
_SIGINT = int(signal.SIGINT)
# The handlers that are replaced, outermost first, and whether Ctrl-C was pressed meanwhile.
_replaced: list[Any] = []
_is_pressed = False


def _note(*_: Any) -> None:
    global _is_pressed  # noqa: PLW0603  # signals are global
    _is_pressed = True


class deferred:  # noqa: N801  # used as a function
    """Defers Ctrl-C to the end of the context; other threads than the main one never get it.

    A class is faster than a generator, and a plain number than an enumeration: each tick uses it.
    """

    __slots__ = ("_handler",)

    def __enter__(self) -> None:
        handler = None
        if threading.current_thread() is threading.main_thread():
            handler = handler_of(_SIGINT)
        if not callable(handler) or handler is _note:
            self._handler = None
            return
        self._handler = handler
        _replaced.append(handler)
        _set_handler(_SIGINT, _note)

    def __exit__(self, *_: object) -> None:
        handler = self._handler
        if handler is not None:
            _replaced.pop()
            _set_handler(_SIGINT, handler)
            _deliver(handler)


@contextmanager
def allowed() -> Iterator[None]:
    """Delivers Ctrl-C in the context, which may wait for long, within `deferred`."""
    is_deferred = threading.current_thread() is threading.main_thread() and bool(_replaced)
    if not is_deferred or handler_of(_SIGINT) is not _note:
        yield
        return
    handler = _replaced[-1]
    _set_handler(_SIGINT, handler)
    try:
        _deliver(handler)
        yield
    finally:
        _set_handler(_SIGINT, _note)


def _deliver(handler: Any) -> None:
    """Calls a handler if Ctrl-C was pressed."""
    global _is_pressed  # noqa: PLW0603  # signals are global
    if _is_pressed:
        _is_pressed = False
        handler(_SIGINT, inspect.currentframe())
