"""Answers the questions of agents one after the other, and stops one that its agent cancels."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import anyio

from ssduck.errors import LimitError
from ssduck.mcp.answers import Answers

T = TypeVar("T")


@dataclass(eq=False)
class _Turn:
    """The turn of a question.

    Attributes:
        is_cancelled: whether its agent waits no longer.
    """

    is_cancelled: bool = False


class Turns:
    """The turns of questions, each in a thread of its own.

    Args:
        answers: answers one question at a time.
    """

    def __init__(self, answers: Answers) -> None:
        self._answers = answers
        self._one_at_a_time = threading.Lock()
        # Is held while a turn begins, ends or is cancelled.
        self._changing = threading.Lock()
        self._present: _Turn | None = None

    async def answer(self, question: Callable[[], T]) -> T:
        """Returns the answer to a question, which ends early if the request is cancelled.

        Args:
            question: asks `answers`.
        """
        turn = _Turn()
        try:
            return await anyio.to_thread.run_sync(
                self._answered, turn, question, abandon_on_cancel=True
            )
        except anyio.get_cancelled_exc_class():
            self._cancel(turn)
            raise

    def _answered(self, turn: _Turn, question: Callable[[], T]) -> T:
        with self._one_at_a_time:
            with self._changing:
                if turn.is_cancelled:
                    raise LimitError("the request was cancelled")
                self._present = turn
                self._answers.begin()
            try:
                return question()
            finally:
                with self._changing:
                    self._present = None

    def _cancel(self, turn: _Turn) -> None:
        with self._changing:
            turn.is_cancelled = True
            if self._present is turn:
                self._answers.stop()
