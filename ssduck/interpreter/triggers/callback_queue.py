"""Runs callbacks in a thread of their own, fed by a bounded queue."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any


class CallbackQueue:
    """A queue of values and a thread that calls back with each of them in turn.

    A full queue drops its oldest value. The thread refers to nothing but this object and the
    callback. It starts with the first value, and ends with `close`.

    Attributes:
        dropped: the number of values that were dropped.
    """

    def __init__(self, call: Callable[[Any], object], size: int, name: str) -> None:
        self.dropped = 0
        self._call = call
        self._size = size
        self._waiting: deque[Any] = deque()
        self._changed = threading.Condition()
        self._is_open = True
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)

    @property
    def pending(self) -> int:
        """The number of waiting values."""
        return len(self._waiting)

    def put(self, value: Any) -> None:
        """Adds a value, and drops the oldest one if the queue is full."""
        with self._changed:
            if not self._is_open:
                return
            if not self._thread.ident:
                self._thread.start()
            if len(self._waiting) == self._size:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append(value)
            self._changed.notify()

    def close(self) -> None:
        """Drops the waiting values and ends the thread."""
        with self._changed:
            self._is_open = False
            self.dropped += len(self._waiting)
            self._waiting.clear()
            self._changed.notify()

    def join(self, seconds: float) -> bool:
        """Waits for the end of the thread, or for a time, s; tells whether it has ended."""
        if not self._thread.ident or self._thread is threading.current_thread():
            return True
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or not self._is_open)
                if not self._is_open:
                    return
                value = self._waiting.popleft()
            self._call(value)
            del value
