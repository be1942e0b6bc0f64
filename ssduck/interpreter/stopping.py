"""Stops the programs of an interpreter from another thread."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Protocol

from ssduck.database.running import DEADLINES
from ssduck.interpreter.interpreter import Interpreter


class Stoppable(Protocol):
    """Runs programs, and stops them."""

    # Tells whether its programs have to end; None if nobody can stop them.
    is_stopped: Callable[[], bool] | None


class StopRequest:
    """Another thread's request that programs end, whether they run already or begin later."""

    def __init__(self) -> None:
        self._event = threading.Event()

    @property
    def is_made(self) -> bool:
        """Whether the programs have to end."""
        return self._event.is_set()

    def make(self) -> None:
        """Ends the programs, as if their time were up; any thread may call it, again too."""
        self._event.set()
        DEADLINES.look_again()

    @contextlib.contextmanager
    def applies_to(self, ss: Interpreter | Stoppable) -> Iterator[None]:
        """Applies to the programs that this thread runs inside; they raise a LimitError.

        Args:
            ss: their interpreter, here or in a sandbox, which no other thread uses meanwhile.
        """
        runs: Stoppable = ss._execution if isinstance(ss, Interpreter) else ss  # noqa: SLF001  # one package
        runs.is_stopped = self._event.is_set
        try:
            yield
        finally:
            runs.is_stopped = None
