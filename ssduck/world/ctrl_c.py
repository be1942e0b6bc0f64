"""Defers Ctrl-C while a tick is taken, so that it is taken and recorded as a whole."""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]
import inspect
import signal
import threading
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
        _set_handler(_SIGINT, _note)  # Ctrl-C may come here; it is noted after that
        _replaced.append(handler)

    def __exit__(self, *_: object) -> None:
        handler = self._handler
        if handler is not None:
            _replaced.pop()
            _set_handler(_SIGINT, handler)
            _deliver(handler)


class allowed:  # noqa: N801  # used as a function
    """Delivers Ctrl-C in the context, which may wait for long, within `deferred`.

    A generator that Ctrl-C keeps from being entered would end later, and take the handler then.
    """

    __slots__ = ("_is_deferred",)

    def __enter__(self) -> None:
        self._is_deferred = False
        is_main = threading.current_thread() is threading.main_thread()
        if not (is_main and _replaced and handler_of(_SIGINT) is _note):
            return
        handler = _replaced[-1]
        try:
            _set_handler(_SIGINT, handler)
            _deliver(handler)
        except BaseException:
            _set_handler(_SIGINT, _note)
            raise
        self._is_deferred = True

    def __exit__(self, *_: object) -> None:
        if self._is_deferred:
            _set_handler(_SIGINT, _note)


def _deliver(handler: Any) -> None:
    """Calls a handler if Ctrl-C was pressed."""
    global _is_pressed  # noqa: PLW0603  # signals are global
    if _is_pressed:
        _is_pressed = False
        handler(_SIGINT, inspect.currentframe())
