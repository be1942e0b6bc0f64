"""The size of an answer, counted before the host takes memory for it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from ssduck.errors import LimitError
from ssduck.limits import ANSWER_BYTES
from ssduck.sandbox.references import EntityReference

# What the host sends is limited by its own memory only, bytes.
UNLIMITED = 1 << 60
# The size of a number or a short text in a list, bytes.
ELEMENT = 40
# One wide character makes all of a text so wide, bytes.
WIDEST = 4
# The size of what JSON makes of a comma, and of a bracket and a brace with what follows, bytes.
_OF_COMMA, _OF_LIST, _OF_DICT = 64, 136, 248
# What a class of named tuples takes, and each of its names, bytes.
_CLASS, _NAME = 10_000, 1000
INT64 = 2**63
# Python needs a time for an integer that grows with the square of its digits.
_MAX_DIGITS = 5000


class InvalidAnswerError(Exception):
    """What a worker sent is no answer: something else runs there."""


class Budget:
    """What an answer may take in the host, with the message that brings it.

    Args:
        size: bytes.
    """

    def __init__(self, size: int = ANSWER_BYTES) -> None:
        self._size = self._left = size
        self._classes: set[tuple[str, ...]] = {()}

    def charge(self, size: int) -> None:
        """Counts something."""
        if not size >= 0:  # which NaN is not, either
            raise InvalidAnswerError("something has a size below 0")
        self._left -= size
        if self._left < 0:
            raise LimitError(
                f"the answer takes more than {self._size:,} bytes; select less, or allow more: "
                "answer_bytes"
            )

    def charge_json(self, text: bytes) -> None:
        """Counts what a text of JSON becomes, from its length and its signs."""
        width = WIDEST if b"\\u" in text else 1
        size = width * len(text) + _OF_COMMA * text.count(b",")
        self.charge(size + _OF_LIST * text.count(b"[") + _OF_DICT * text.count(b"{"))

    def parsed(self, text: bytes) -> Any:
        """Counts a text of JSON, and returns its value."""
        self.charge_json(text)
        return json.loads(str(text, "ascii"), parse_int=_integer)

    def charge_class(self, names: tuple[str, ...]) -> None:
        """Counts the class of named tuples with some names, if it is new."""
        if names not in self._classes:
            self._classes.add(names)
            self.charge(_CLASS + _NAME * len(names))

    def charge_keys(self, keys: Iterable[Any], count: int = 1) -> None:
        """Counts how often the keys of dicts may be compared.

        A worker can choose any number of keys that all have the same hash, but no such texts,
        entities and integers of 64 bits.
        """
        alike = sum(
            not isinstance(key, str | EntityReference) and not is_short(key) for key in keys
        )
        self.charge(count * alike * alike // 2)

    def charge_text(self, data: bytes) -> None:
        """Counts a text that is in the body, beside its bytes."""
        self.charge(len(data) * (1 if data.isascii() else WIDEST))


def is_short(value: Any) -> bool:
    """Checks whether a value is an integer of 64 bits."""
    return type(value) is int and -INT64 <= value < INT64


def _integer(digits: str) -> int:
    if len(digits) > _MAX_DIGITS:
        raise InvalidAnswerError("an integer has too many digits")
    return int(digits)
