"""Defers signals that end the program while a tick is taken, so that it is recorded whole.

A user's handler may raise at any place, as that of SIGTERM that ends the program.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]
import inspect
import signal
import threading
from typing import Any

# Without the wrappers of `signal`, which take ten times longer.
handler_of = _signal.getsignal
_set_handler = _signal.signal
# The signals that end the program; Windows has no SIGHUP.
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
_NUMBERS = tuple(int(getattr(signal, name)) for name in _NAMES if hasattr(signal, name))
# The handlers that are replaced, by signal, of each context, the outermost first.
_replaced: list[dict[int, Any]] = []
# The signals that came meanwhile.
_noted: list[int] = []


def _note(number: int, _: object) -> None:
    _noted.append(number)


class deferred:  # noqa: N801  # used as a function
    """Defers signals to the end of the context; other threads than the main one never get them.

    A class is faster than a generator, and a plain number than an enumeration: each tick uses it.
    """

    __slots__ = ("_handlers",)

    def __enter__(self) -> None:
        handlers = {}
        if threading.current_thread() is threading.main_thread():
            for number in _NUMBERS:
                handler = handler_of(number)
                if handler is not _note and callable(handler):
                    handlers[number] = handler
        self._handlers = handlers
        if handlers:
            _defer(handlers)
            _replaced.append(handlers)

    def __exit__(self, *_: object) -> None:
        handlers = self._handlers
        if handlers:
            _replaced.pop()
            _restore(handlers)
            _deliver(handlers)


class allowed:  # noqa: N801  # used as a function
    """Delivers signals in the context, which may wait for long, within `deferred`.

    A generator that Ctrl-C keeps from being entered would end later, and take the handler then.
    """

    __slots__ = ("_handlers",)

    def __enter__(self) -> None:
        self._handlers: dict[int, Any] = {}
        if not _replaced or threading.current_thread() is not threading.main_thread():
            return
        handlers = _replaced[-1]
        if all(handler_of(number) is not _note for number in handlers):
            return
        try:
            _restore(handlers)
            _deliver(handlers)
        except BaseException:
            _defer(handlers)
            raise
        self._handlers = handlers

    def __exit__(self, *_: object) -> None:
        handlers = self._handlers
        for number in handlers:  # a handler may have set another one
            if callable(handler := handler_of(number)) and handler is not _note:
                handlers[number] = handler
        _defer(handlers)


def _defer(handlers: dict[int, Any]) -> None:
    """Replaces handlers, all or none; one of them may be called, and raise, before it is."""
    try:
        for number, handler in handlers.items():
            if handler_of(number) is handler:
                _set_handler(number, _note)
    except BaseException:
        _restore(handlers)
        raise


def _restore(handlers: dict[int, Any]) -> None:
    """Puts all handlers back, though one that is back may be called, and raise, meanwhile."""
    raised: BaseException | None = None
    while True:
        try:
            for number, handler in handlers.items():
                if handler_of(number) is _note:
                    _set_handler(number, handler)
            break
        except BaseException as error:  # noqa: BLE001  # it is raised below
            raised = error
    if raised is not None:
        raise raised


def _deliver(handlers: dict[int, Any]) -> None:
    """Calls the handlers of the signals that came, as often as they came."""
    raised: BaseException | None = None
    while own := [number for number in _noted if number in handlers]:
        number = own[0]
        _noted.remove(number)
        handler = handler_of(number)
        try:
            if callable(handler):
                handler(number, inspect.currentframe())
            elif handler == signal.SIG_DFL:  # the first one has switched to it
                signal.raise_signal(number)
        except BaseException as error:  # noqa: BLE001  # it is raised below
            raised = raised or error
    if raised is not None:
        raise raised
