"""A page that is connected, and what it has."""

from __future__ import annotations

import asyncio
import json
import math
from typing import Any

import numpy as np
from websockets.asyncio.server import ServerConnection

from ssduck.view.answers import Answers
from ssduck.view.frames import Frame, Poses
from ssduck.view.sources import Ticks


class SentTicks:
    """The recorded ticks that a page has.

    Attributes:
        sent_at: the time of the last message, s of the server's clock.
        is_complete: whether the page has all of them.
    """

    def __init__(self) -> None:
        self.sent_at = -math.inf
        self.is_complete = False
        # The numbers of the first and the last tick that the page has; none if they are equal to 0.
        self._first = self._last = 0
        self._firings = 0

    def message(self, ticks: Ticks | None, firings: list[tuple[str, float]]) -> Any:
        """Returns the message of what is new; None if nothing is.

        Args:
            ticks: the recorded ticks; None for none.
            firings: the firings of triggers.
        """
        numbers = np.zeros(0, np.int64) if ticks is None else ticks.numbers
        is_new = not len(numbers) or not self._last or numbers[-1] < self._last
        if len(numbers) and not is_new and (numbers[0] > self._last or numbers[0] < self._first):
            is_new = True
        start = 0 if is_new else int(np.searchsorted(numbers, self._last, side="right"))
        dropped = 0
        if not is_new:
            dropped = int(numbers[0] - self._first)
        added = [] if ticks is None else ticks.times[start:].tolist()
        if (
            not added
            and not dropped
            and len(firings) == self._firings
            and bool(self._last) == (len(numbers) > 0)
        ):
            return None
        self._first = int(numbers[0]) if len(numbers) else 0
        self._last = int(numbers[-1]) if len(numbers) else 0
        self._firings = len(firings)
        return {
            "type": "ticks",
            "anew": is_new,
            "keep": len(numbers) - len(added),
            "times": added,
            "firings": firings,
        }


class Viewer:
    """A page that is connected.

    Args:
        connection: its connection.
        answers: answers its questions.

    Attributes:
        news: is set when there may be something to send.
        time: the time that it shows, s; None for the present.
        is_local: whether the page has the poses of that time.
        shown: the time of the last frame that it got, s; None for the present.
        frame: the last frame that it got.
        sent: the poses that it has; None if it needs all.
        ticks: the recorded ticks that it has.
        status: the state of the simulation that it knows.
        scan: the search for the changes of an answer that it waits for.
    """

    def __init__(self, connection: ServerConnection, answers: Answers) -> None:
        self.connection, self.answers = connection, answers
        self.news = asyncio.Event()
        self.time: float | None = None
        self.is_local = False
        self.shown: float | None = None
        self.frame: Frame | None = None
        self.sent: Poses | None = None
        self.ticks = SentTicks()
        self.status: dict[str, Any] | None = None
        self.scan: asyncio.Task[None] | None = None

    async def send(self, message: dict[str, Any]) -> None:
        """Sends a message as JSON."""
        await self.connection.send(json.dumps(message))

    def seek(self, question: dict[str, Any]) -> None:
        """Shows another time, as the page asks."""
        at = question.get("at")
        is_number = isinstance(at, int | float) and not isinstance(at, bool) and math.isfinite(at)
        self.time = float(at) if is_number else None  # type: ignore[arg-type]
        # A page that showed poses of its own needs all of them.
        if self.is_local:
            self.sent = None
        self.is_local = question.get("local") is True and self.time is not None
        self.shown = math.nan
        self.news.set()
