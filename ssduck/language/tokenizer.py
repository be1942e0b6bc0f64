"""Divides the text of a program into tokens."""

from __future__ import annotations

from typing import ClassVar

from sqlglot.errors import TokenError
from sqlglot.tokenizer_core import Token, TokenType
from sqlglot.tokens import Tokenizer

from ssduck.errors import ParseError, SourceSpan
from ssduck.language.comments import last_opening, without_dashes

# Under a limit, a program may have this many letters for each word.
LETTERS_PER_WORD = 10


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
