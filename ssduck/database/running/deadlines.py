"""Interrupts statements whose time is up, from one thread for all connections.

The time of a statement is up as well when its program is stopped.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable, Hashable
from typing import TypeAlias

from ssduck.limits import UsageMeter

# The time between two interrupts of a statement whose time is up, s.
INTERRUPT_INTERVAL = 0.02
# The time after which the thread looks whether statements still come, s.
_LINGER = 1.0

Entry: TypeAlias = tuple[UsageMeter, Callable[[], None]]


class Deadlines:
    """The statements that run, and the thread that interrupts them.

    The thread keeps looking for a while after a statement has ended: waking it for each would take
    longer than many statements.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._condition = threading.Condition(self._lock)
        self._entries: dict[Hashable, Entry] = {}
        # When the thread looks next, and whether a statement has begun since it looked.
        self._next_look = math.inf
        self._is_used = False
        self._thread: threading.Thread | None = None

    def begin(self, key: Hashable, meter: UsageMeter, interrupt: Callable[[], None]) -> None:
        """Begins to watch a statement of a program whose time is limited.

        Args:
            key: an object for `end`.
            meter: tells when the time is up.
            interrupt: a quick function that is called when its time is up, again and again, because
                DuckDB ignores an interrupt before a statement begins.
        """
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._watch, daemon=True)
                self._thread.start()
            self._entries[key] = meter, interrupt
            self._is_used = True
            deadline = meter.deadline
            if deadline is not None and deadline < self._next_look:
                self._condition.notify()

    def end(self, key: Hashable) -> None:
        """Ends to watch a statement; it is not interrupted after that. It may be called again."""
        with self._lock:
            self._entries.pop(key, None)

    def look_again(self) -> None:
        """Has the thread look at once, as programs were stopped."""
        with self._lock:
            self._condition.notify()

    def _watch(self) -> None:
        with self._condition:
            while True:
                wait = self._look()
                self._next_look = time.monotonic() + wait
                self._condition.wait(None if wait == math.inf else min(wait, threading.TIMEOUT_MAX))

    def _look(self) -> float:
        """Interrupts the statements that are late; returns the time until the next look, s.

        It holds on to no statement afterwards: that would keep its connection open.
        """
        now = time.monotonic()
        is_used, self._is_used = self._is_used, False
        late = [interrupt for meter, interrupt in self._entries.values() if _deadline(meter) <= now]
        for interrupt in late:
            interrupt()
        if late:
            return INTERRUPT_INTERVAL
        if not self._entries:
            return _LINGER if is_used else math.inf
        return min(_deadline(meter) for meter, _ in self._entries.values()) - now


def _deadline(meter: UsageMeter) -> float:
    deadline = meter.deadline
    return math.inf if deadline is None else deadline


DEADLINES = Deadlines()

if hasattr(os, "register_at_fork"):  # a child has no such thread, and no statement that runs
    os.register_at_fork(after_in_child=DEADLINES.__init__)  # type: ignore[misc]
