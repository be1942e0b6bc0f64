"""Reads and writes quoted texts."""

from __future__ import annotations

import re


def unquoted(quoted: str) -> str:
    r"""Returns the value of a quoted text.

    Two quotes of the text's own kind stand for one. Before such a quote and at the end of the text,
    two backslashes stand for one, and a single backslash makes the quote a part of the text. All
    other backslashes stand for themselves.

    >>> unquoted("'it''s'"), unquoted(r'"a\" b"')
    ("it's", 'a" b')

    Args:
        quoted: the text with its quotes.
    """
    quote = quoted[0]
    escaped = rf"\\\\(?=\\*(?:{quote}|$))|\\{quote}|{quote}{quote}"
    return re.sub(escaped, lambda match: match.group()[-1], quoted[1:-1])


def escaped(text: str, quote: str) -> str:
    r"""Returns a text as it is written between quotes; `unquoted` reads it.

    >>> escaped("it's", "'"), escaped("it's", '"')
    ("it''s", "it's")

    Args:
        text: the text.
        quote: the quote around it.
    """
    doubled = rf"\\+(?={quote}|\Z)|{quote}"
    return re.sub(doubled, lambda match: 2 * match.group(), text)
