"""Texts in quotes, as programs write them."""

from __future__ import annotations

import re


def unquoted(written: str) -> str:
    r"""What a text in quotes says.

    Backslashes before a quote of its own kind, and at its end, count by twos: two are a backslash,
    and one that is left makes the quote a part of the text. All other backslashes are themselves.

    Args:
        written: the text with its quotes.
    """
    quote = written[0]

    def read(found: re.Match[str]) -> str:
        backslashes, following = found.groups()
        return "\\" * (len(backslashes) // 2) + following

    return re.sub(rf"(\\+)({quote}|$)", read, written[1:-1])
