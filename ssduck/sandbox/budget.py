"""The size of an answer, counted before the host takes memory for it."""

from __future__ import annotations

from ssduck.errors import LimitError

# The size of an answer by default, bytes.
ANSWER_BYTES = 32 * 2**20
# The size of a number or a short text in a list, bytes.
ELEMENT = 40
# The size of what JSON makes of a sign of its own, at most, bytes.
_OF_SIGNS = {b",": 64, b"[": 136, b"{": 248}


class InvalidAnswerError(Exception):
    """What a worker sent is no answer: something else runs there."""


class Budget:
    """What an answer may take in the host, with the message that brings it.

    Args:
        size: bytes.
    """

    def __init__(self, size: int = ANSWER_BYTES) -> None:
        self._size = self._left = size

    def charge(self, size: int) -> None:
        """Counts something.

        Raises:
            LimitError: the answer takes more in all.
        """
        self._left -= size
        if self._left < 0:
            raise LimitError(
                f"the answer takes more than {self._size:,} bytes; select less, or allow more: "
                "answer_bytes"
            )

    def charge_json(self, text: bytes) -> None:
        """Counts what a text of JSON becomes, from its length and its signs."""
        self.charge(len(text) + sum(text.count(sign) * size for sign, size in _OF_SIGNS.items()))
