"""Divides a program into tokens; finds its comments and texts, and reads quoted texts."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sqlglot.errors import TokenError
from sqlglot.tokenizer_core import Token, TokenType
from sqlglot.tokens import Tokenizer

from ssduck.errors import ParseError, SourceSpan


class SelectScriptTokenizer(Tokenizer):
    """sqlglot's tokenizer with SelectScript's quotes, comments and operators.

    Words stay plain words (`VAR`), so that no name is lost to an SQL keyword.
    """

    QUOTES: ClassVar[list[str | tuple[str, str]]] = ["'", '"']
    IDENTIFIERS: ClassVar[list[str | tuple[str, str]]] = []
    COMMENTS: ClassVar[list[str | tuple[str, str]]] = ["//", "#", ("/*", "*/")]
    STRING_ESCAPES: ClassVar[list[str]] = ["\\", "'", '"']  # a quote is doubled, too
    KEYWORDS: ClassVar[dict[str, TokenType]] = {
        "==": TokenType.EQ,
        "!=": TokenType.NEQ,
        ">=": TokenType.GTE,
        "<=": TokenType.LTE,
        "<>": TokenType.NEQ,
        "||": TokenType.DPIPE,
        "&&": TokenType.DAMP,
        "::": TokenType.DCOLON,
    }


def tokenize(text: str) -> list[Token]:
    """Returns the tokens of a program."""
    try:
        return SelectScriptTokenizer().tokenize(without_dashes(text))
    except TokenError as error:
        # The tokenizer's only error is a text or a comment without an end.
        message = "a text or a comment is opened here and never closed"
        span = SourceSpan(last_opening(text), len(text))
        raise ParseError(message, text=text, span=span) from error


_ENDS = {"'": "'", '"': '"', "/*": "*/", "//": "\n", "#": "\n", "--": "\n"}
_QUOTES = ("'", '"')
# What is before and behind the sign in an integer division.
_ENDS_OPERAND = re.compile(r"[\w)\]] *$")
_CONTINUES = re.compile(
    r" *(?:[\d.]+ *(?:$|[=<>!,;)+*/-]|(?:AS|FROM|AND|OR)\b)|[\w.]+(?:\([\w.]*\))? *;)",
    re.IGNORECASE | re.MULTILINE,
)


@dataclass(frozen=True)
class DelimitedText:
    """A text or a comment: its opening sign, its place, and whether it is closed."""

    opening: str
    start: int
    end: int
    is_closed: bool


def delimited(text: str) -> Iterator[DelimitedText]:
    """Yields the texts and comments of a program, in order."""
    index = 0
    while index < len(text):
        opening = next((o for o in _ENDS if text.startswith(o, index)), None)
        if opening is None or (opening == "--" and not _is_comment(text, index)):
            index += 1 if opening is None else len(opening)
            continue
        start, end = index, _ENDS[opening]
        index += len(opening)
        while index < len(text) and not (ends := text.startswith(end, index)):
            index += 2 if text[index] == "\\" and opening in _QUOTES else 1
            if opening in _QUOTES and text.startswith(end * 2, index):
                index += 2
        is_closed = end == "\n" or (index < len(text) and ends)
        index = min(len(text), index + (0 if end == "\n" else len(end)))
        yield DelimitedText(opening, start, index, is_closed)


def _is_comment(text: str, index: int) -> bool:
    """Checks whether two dashes begin a comment: before white space, or where the text ends."""
    return index + 2 >= len(text) or text[index + 2].isspace()


def without_dashes(text: str) -> str:
    """Returns the program with blanks in place of the comments that begin with two dashes.

    >>> without_dashes("SELECT z -- height")
    'SELECT z          '
    """
    if "--" not in text:
        return text
    parts, last = [], 0
    for part in delimited(text):
        if part.opening == "--":
            parts += [text[last : part.start], " " * (part.end - part.start)]
            last = part.end
    return "".join([*parts, text[last:]])


def divisions(text: str) -> list[SourceSpan]:
    """Returns the comments that are probably meant as divisions: `7 // 2`.

    >>> divisions("SELECT 7 // 2 AS n")
    [SourceSpan(start=9, end=11)]
    >>> divisions("SELECT z // 2 of them")
    []
    """
    if "//" not in text:
        return []
    return [
        SourceSpan(part.start, part.start + 2)
        for part in delimited(text)
        if part.opening == "//"
        and _ENDS_OPERAND.search(text, 0, part.start)
        and _CONTINUES.match(text, part.start + 2)
    ]


def last_opening(text: str) -> int:
    """Returns the start of the string literal or comment that is never closed."""
    return next((part.start for part in delimited(text) if not part.is_closed), 0)


def unquoted(quoted: str) -> str:
    r"""Returns the value of a quoted text.

    Two quotes of the text's own kind stand for one. Before such a quote and at the end of the text,
    two backslashes stand for one, and a single backslash makes the quote a part of the text. All
    other backslashes stand for themselves.

    >>> unquoted("'it''s'"), unquoted(r'"a\" b"')
    ("it's", 'a" b')
    """
    quote = quoted[0]
    escaped = rf"\\\\(?=\\*(?:{quote}|$))|\\{quote}|{quote}{quote}"
    return re.sub(escaped, lambda match: match.group()[-1], quoted[1:-1])


def escaped(text: str, quote: str) -> str:
    r"""Returns a text as it is written between quotes; `unquoted` reads it.

    >>> escaped("it's", "'"), escaped("it's", '"')
    ("it''s", "it's")
    """
    doubled = rf"\\+(?={quote}|\Z)|{quote}"
    return re.sub(doubled, lambda match: 2 * match.group(), text)
