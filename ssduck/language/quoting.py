"""Reads quoted texts."""

from __future__ import annotations

import re


def unquoted(written: str) -> str:
    r"""Returns the value of a quoted text.

    Two quotes of its own kind are one. Backslashes before such a quote, and at its end, count by
    twos: two are a backslash, and one that is left makes the quote a part of the text. All other
    backslashes are themselves.

    >>> unquoted("'it''s'"), unquoted(r'"a\" b"')
    ("it's", 'a" b')

    Args:
        written: the text with its quotes.
    """
    quote = written[0]
    escaped = rf"\\\\(?=\\*(?:{quote}|$))|\\{quote}|{quote}{quote}"
    return re.sub(escaped, lambda found: found.group()[-1], written[1:-1])
