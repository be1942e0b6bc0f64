"""Ctrl-C while something is at work that does not look for it.

Python's own handler waits until its interpreter is given control back. DuckDB looks for a signal
between the tasks of a query only, and one task may take minutes. A signal is written to a socket
at once, though; a thread listens to it.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

Stop: TypeAlias = Callable[[], None]


@dataclass(frozen=True)
class Listening:
    """What listening put aside: whom Ctrl-C stopped, and where signals were written."""

    stop: Stop | None
    wakeup: int


class _Listener:
    def __init__(self) -> None:
        self.stop: Stop | None = None
        self._sender: socket.socket | None = None
        self._process = 0

    def listened(self) -> int:
        """The socket that a thread of this process listens to."""
        if self._sender is None or self._process != os.getpid():
            receiver, self._sender = socket.socketpair()
            self._sender.setblocking(False)
            self._process = os.getpid()
            threading.Thread(target=self._listen, args=(receiver,), daemon=True).start()
        return self._sender.fileno()

    def _listen(self, receiver: socket.socket) -> None:
        while signals := receiver.recv(64):
            if signal.SIGINT in signals:
                self._interrupt()

    def _interrupt(self) -> None:
        stop = self.stop  # not in `_listen`, which would keep it
        if stop is not None:
            stop()


_LISTENER = _Listener()


def listen(stop: Stop) -> Listening | None:
    """Call `stop` at Ctrl-C, from another thread, until `leave` is called.

    Returns:
        What `leave` is to be given; None where nothing was done: in another thread than the
        main one, or where a handler of the user's is in charge.
    """
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return None
    before = signal.set_wakeup_fd(_LISTENER.listened(), warn_on_full_buffer=False)
    listening = Listening(_LISTENER.stop, before)
    _LISTENER.stop = stop
    return listening


def leave(listening: Listening | None) -> None:
    """Be again as it was before `listen`."""
    if listening is not None:
        _LISTENER.stop = listening.stop
        signal.set_wakeup_fd(listening.wakeup)
