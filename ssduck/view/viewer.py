"""A page that is connected, and what it has."""

from __future__ import annotations

import asyncio
import json
import math
import sys
from bisect import bisect_right
from typing import Any

from websockets.asyncio.server import ServerConnection

from ssduck.interpreter.stopping import StopRequest
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
        # The numbers of the first and the last tick that the page has; 0 for none.
        self._first = self._last = 0
        self._firings = 0

    def message(self, ticks: Ticks | None, firings: list[tuple[str, float]]) -> Any:
        """Returns the message of what is new; None if nothing is.

        Args:
            ticks: the recorded ticks; None for none.
            firings: the firings of triggers.
        """
        numbers = [] if ticks is None else ticks.numbers.tolist()
        first, last = (numbers[0], numbers[-1]) if numbers else (0, 0)
        # The page goes on from what it has if that is a part of the ticks, or their beginning.
        goes_on = 0 < self._first <= first <= self._last <= last
        start = bisect_right(numbers, self._last) if goes_on else 0
        is_same = (first, last) == (self._first, self._last) and len(firings) == self._firings
        if is_same:
            return None
        self._first, self._last, self._firings = first, last, len(firings)
        return {
            "type": "ticks",
            "anew": not goes_on,
            "keep": start,
            "numbers": numbers[start:],
            "times": [] if ticks is None else ticks.times[start:].tolist(),
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
        questions: the questions that it waits for, with what ends their programs.
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
        self.questions: dict[asyncio.Task[None], StopRequest] = {}
        # The last query, and the last search for the changes of an answer.
        self._latest: dict[str, StopRequest] = {}

    def begin(self, question: dict[str, Any]) -> StopRequest:
        """Returns what ends the programs of a new question; ends the one that it supersedes."""
        stop, kind = StopRequest(), question.get("type")
        if kind in ("ask", "scan"):  # of these, a page waits for its last one only
            if kind in self._latest:
                self._latest[kind].make()
            self._latest[kind] = stop
        return stop

    def wait_for(self, task: asyncio.Task[None], stop: StopRequest) -> None:
        """Waits for the answer of a question.

        Args:
            task: sends the answer.
            stop: ends its programs.
        """
        self.questions[task] = stop
        task.add_done_callback(self.questions.pop)

    def leave(self) -> None:
        """Ends what the page waits for, as its connection is closed."""
        for task, stop in self.questions.items():
            task.cancel()
            stop.make()

    async def send(self, message: dict[str, Any]) -> None:
        """Sends a message as JSON."""
        await self.connection.send(json.dumps(message))

    def seek(self, question: dict[str, Any]) -> None:
        """Shows another time, as the page asks."""
        at = question.get("at")
        is_number = isinstance(at, int | float) and not isinstance(at, bool)
        # Neither infinite, nor NaN, nor an integer that no float can have.
        is_time = is_number and abs(at) <= sys.float_info.max  # type: ignore[arg-type]
        self.time = float(at) if is_time else None  # type: ignore[arg-type]
        # A page that showed poses of its own needs all of them.
        if self.is_local:
            self.sent = None
        self.is_local = question.get("local") is True and self.time is not None
        self.shown = math.nan
        self.news.set()
