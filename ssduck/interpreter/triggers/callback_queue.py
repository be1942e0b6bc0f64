"""Callbacks in a thread of their own, fed by a bounded queue."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any


class CallbackQueue:
    """What waits for a callback, which a thread calls with it, one after another.

    When it is full, the oldest is dropped. The thread knows nothing but this object and the
    callback; it begins with the first that is put, and ends with `close`.

    Args:
        call: what is called; it raises nothing.
        size: how many may wait, besides the one that the callback is at.
        name: what the thread is called.

    Attributes:
        dropped: how many were never handed over.
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
        """How many wait."""
        return len(self._waiting)

    def put(self, value: Any) -> None:
        """Hand something over; the oldest that waits goes if there is no room."""
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
        """Hand over no more; what waits is dropped, and the thread ends."""
        with self._changed:
            self._is_open = False
            self.dropped += len(self._waiting)
            self._waiting.clear()
            self._changed.notify()

    def join(self, seconds: float) -> bool:
        """Wait until the thread has ended; tells whether it has."""
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
