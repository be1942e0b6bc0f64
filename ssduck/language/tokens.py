"""Divides a program into tokens, and goes through them; reports what is wrong there."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar, NoReturn, TypeVar

from sqlglot.errors import TokenError
from sqlglot.tokenizer_core import Token, TokenType
from sqlglot.tokens import Tokenizer

from ssduck.errors import ParseError, SourceSpan, nearest
from ssduck.formatting import RESERVED_WORDS
from ssduck.language import ast
from ssduck.language.sql_suggestions import (
    NO_BOUNDS,
    NO_COMMA,
    NO_NUMBER,
    NO_PREFIX,
    NO_TUPLE,
    NUMPY,
    SIGNS,
    STATEMENTS,
    suggestion_for,
    suggestion_for_name,
)


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
        opening = next((part.start for part in delimited(text) if not part.is_closed), 0)
        span = SourceSpan(opening, len(text))
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


T = TypeVar("T")

# Parsing and evaluation recurse; a deeper program is an error instead of a crash.
MAXIMUM_DEPTH = 60


# What follows a dot and is no name as it stands, `room.a:b`, and how far before an error it begins.
_SIGNED_NAME = re.compile(r"\b([A-Za-z_]\w*)\.(\w+[/:][\w/:]*)")
_MAX_SIGNED = 80
# What is written at an error: signs, as in `=>`, or digits with a comma, as in `0,1`.
_WRITTEN = re.compile(r"[=<>*+:-]+|\d+,\d+")

CLAUSES = frozenset(
    (
        *("SELECT", "FROM", "WHERE", "START", "WITH", "CONNECT", "BY", "STOP"),
        *("NO", "CYCLE", "UNIQUE", "MEMORIZE", "MAXIMUM", "GROUP", "HAVING", "ORDER"),
        *("ASC", "ASCENDING", "DESC", "DESCENDING", "LIMIT", "OFFSET", "AS"),
    )
)
OPERATOR_WORDS = ("OR", "XOR", "AND", "NOT", "IN")


# Loosest first; each level is left-associative.
LEVELS: tuple[tuple[str, ...], ...] = (
    ("OR",),
    ("XOR",),
    ("AND",),
    ("NOT",),
    ("IN",),
    ("==",),
    ("!=",),
    (">=",),
    (">",),
    ("<=",),
    ("<",),
    ("+", "-"),
    ("*", "/", "%"),
    ("^",),
)

_OPENING = frozenset((TokenType.L_PAREN, TokenType.L_BRACKET, TokenType.L_BRACE))
_CLOSING = frozenset((TokenType.R_PAREN, TokenType.R_BRACKET, TokenType.R_BRACE))

LEVEL_OF = {operator: level for level, operators in enumerate(LEVELS) for operator in operators}


class Cursor:
    """A place among the tokens of a text.

    Attributes:
        index: the number of the current token.
        depth: the nesting depth of the current token.
        suspicions: the probable mistakes so far.
    """

    def __init__(self, text: str, tokens: list[Token]) -> None:
        self.text = text
        self.tokens = tokens
        self.index = 0
        self.depth = 0
        self.suspicions: list[ast.Suspicion] = []

    @property
    def token(self) -> Token | None:
        """The current token; None behind the last one."""
        return self.tokens[self.index] if self.index < len(self.tokens) else None

    def ahead(self, offset: int = 1) -> Token | None:
        """Returns the token so many places further on."""
        index = self.index + offset
        return self.tokens[index] if index < len(self.tokens) else None

    def at(self, kind: TokenType) -> bool:
        """Checks whether the current token is of that type."""
        return self.token is not None and self.token.token_type == kind

    def at_word(self, *words: str) -> bool:
        """Checks whether the current token is one of these words, given in upper case."""
        return is_word(self.token, *words)

    def take(self, kind: TokenType) -> Token | None:
        """Takes the current token if it is of that type."""
        if not self.at(kind):
            return None
        self.index += 1
        return self.tokens[self.index - 1]

    def take_words(self, *words: str) -> bool:
        """Takes a sequence of keywords (`GROUP BY`), or nothing."""
        if all(is_word(self.ahead(offset), word) for offset, word in enumerate(words)):
            self.index += len(words)
            return True
        return False

    def expect(self, kind: TokenType, expected: str) -> Token:
        """Takes a token of that type; `expected` describes it in the error."""
        token = self.take(kind)
        if token is None:
            self.fail(f"expected {expected}")
        return token

    def expect_word(self, word: str) -> None:
        """Takes a keyword."""
        if not self.take_words(word):
            self.fail(f"expected {word}")

    def expect_name(self, expected: str) -> Token:
        """Takes a name; `expected` describes it in the error."""
        if self.token is not None and self.token.text.upper() in RESERVED_WORDS:
            self.fail(f"expected {expected}")
        return self.expect(TokenType.VAR, expected)

    def expect_own_name(self, expected: str) -> Token:
        """Takes a name that a program may define."""
        if self.at_word("TRUE", "FALSE", "THIS"):
            self.fail(f"expected {expected} (True, False and this are words of the language)")
        return self.expect_name(expected)

    def here(self) -> SourceSpan:
        """Returns the place of the current token, or of the end of the text."""
        if self.token is None:
            return SourceSpan(len(self.text.rstrip()), len(self.text.rstrip()) + 1)
        return span_of(self.token)

    def since(self, start: SourceSpan) -> SourceSpan:
        """Returns the place from there to the token before the current one."""
        return SourceSpan(start.start, self.end())

    def end(self) -> int:
        """Returns the end of the previous token in the text."""
        return span_of(self.tokens[self.index - 1]).end

    def separated(self, part: Callable[[], T]) -> tuple[T, ...]:
        """Returns one or more parts with commas between them."""
        parts = [part()]
        while self.take(TokenType.COMMA):
            parts.append(part())
        return tuple(parts)

    def descend(self) -> None:
        """Goes one nesting level deeper."""
        self.depth += 1
        if self.depth > MAXIMUM_DEPTH:
            raise ParseError(
                f"nested deeper than {MAXIMUM_DEPTH} levels", text=self.text, span=self.here()
            )

    def key_wanted(self) -> str:
        """Returns what to say where there is no name behind a dot: a word or a text in brackets."""
        if self.token is None:
            return "a key"
        word = self.text[slice_of(self.token)]
        if word[:1] in ("'", '"'):
            return f"a key (write [{unquoted(word)!r}] for a name in quotes)"
        is_word = word.isidentifier()
        return "a key" + f" (write [{word!r}] for a word of the language)" * is_word

    def past_end(self, world: str) -> str:
        """Returns what to say where the braces of a past do not end: two times are no past."""
        if not self.at(TokenType.COMMA):
            return "'}'"
        return (
            f"'}}' (a past is of one time, {world}{{1.5}}, of the last seconds, {world}{{-2}}, or "
            f"whole, {world}{{}}; of a span write FROM {world}{{}} WHERE time >= 1 AND time <= 2)"
        )

    def _name_with_signs(self) -> str | None:
        """Returns how to write a name such as `room.a/` or `room.a:b` before the current token."""
        place = self.here().start
        for found in _SIGNED_NAME.finditer(self.text, max(0, place - _MAX_SIGNED)):
            if found.start() < place <= found.end():
                return f"{found.group(1)}[{found.group(2)!r}]"
        return None

    def _name_with_blanks(self) -> str:
        """Returns how to write a name such as `room.red box` at the current token; "" if none."""
        words, offset = [self.tokens[self.index - 1].text], 0
        while (token := self.ahead(offset)) is not None and token.token_type == TokenType.VAR:
            if is_word(token, *RESERVED_WORDS) or nearest(token.text, CLAUSES, 1):
                break
            words.append(token.text)
            offset += 1
        world = self.ahead(-3)
        is_name = len(words) > 1 and is_kind(world, TokenType.VAR)
        return f"{world.text}[{' '.join(words)!r}]" if is_name and world is not None else ""

    def is_followed(self) -> bool:
        """Checks whether a comma ends the part that comes next."""
        depth = offset = 0
        while (token := self.ahead(offset)) is not None and depth >= 0:
            if depth == 0 and token.token_type in (TokenType.COMMA, TokenType.SEMICOLON):
                return token.token_type == TokenType.COMMA
            depth += (token.token_type in _OPENING) - (token.token_type in _CLOSING)
            offset += 1
        return False

    def fail(self, message: str) -> NoReturn:
        """Raises the error for the current token."""
        token = self.token
        if (signed := self._name_with_signs()) is not None:
            message += f" (a name with other signs is written {signed})"
        names: tuple[str, ...] = ()
        if token is None:
            result, instead = "the end of the text", ""
        else:
            result = repr(self.text[slice_of(token)])
            instead = self._suggestion(token)
            is_known = token.text.upper() in CLAUSES or instead
            names = () if is_known else nearest(token.text, CLAUSES, 1)
            if message.endswith(")"):  # it says what to write, unless a word of it is misspelt
                names = tuple(name for name in names if name in message)
        text = f"{message}, found {result}" + (f"; {instead}" if instead else "")
        raise ParseError(text, text=self.text, span=self.here(), suggestions=names)

    def _suggestion(self, token: Token) -> str:
        """Returns the suggestion for a word of SQL that led to the current token."""
        before = self.tokens[self.index - 1] if self.index else None
        if before is not None and before.text.upper() in STATEMENTS:
            return suggestion_for(before.text)
        written = self._written_at(token.start)
        signs = [written, "" if before is None else self._written_at(before.start)]
        if instead := next((SIGNS[sign] for sign in signs if sign in SIGNS), ""):
            return instead
        if before is not None and (instead := self._between(before, token)):
            return instead
        suggestion = "" if token.token_type == TokenType.STRING else suggestion_for(token.text)
        if suggestion or before is None:
            return suggestion
        is_key = is_kind(self.ahead(-2), TokenType.DOT)  # the cube of room.cube
        if is_word(token, "AT") and not is_key and before.token_type == TokenType.VAR:
            numbers = (
                later for later in map(self.ahead, (1, 2)) if is_kind(later, TokenType.NUMBER)
            )
            time = next((number.text for number in numbers if number is not None), "0.5")
            return f"the world at a time is {before.text}{{{time}}}"
        if is_kind(token, TokenType.L_PAREN) and is_key:
            instead = suggestion_for_name(before.text)
            return instead or f"a function has no dot before it: write {before.text}(…)"
        if is_key and is_kind(token, TokenType.VAR) and is_kind(self.ahead(2), TokenType.DOT):
            return f"a relation stands before its entities: {token.text}(a, b)"
        if is_key and (name := self._name_with_blanks()):
            return f"a name with blanks is written {name}"
        neighbours = [None if is_key else before, self._called_name()]
        words = [t.text for t in neighbours if t is not None and t.token_type == TokenType.VAR]
        suggestion = next(filter(None, map(suggestion_for, words)), "")
        has_comma = "," in written and not is_kind(self.ahead(-2), TokenType.VAR)
        return suggestion or (SIGNS[","] if has_comma else "")

    def _written_at(self, place: int) -> str:
        """Returns the signs, or the number with a comma, at a place of the text."""
        first, last = max(0, place - _MAX_SIGNED), place + _MAX_SIGNED
        found = (match for match in _WRITTEN.finditer(self.text, first, last))
        return next((one.group() for one in found if one.start() <= place < one.end()), "")

    def _between(self, before: Token, token: Token) -> str:
        """Returns what to write for two tokens that follow each other in other languages only."""
        kinds = (before.token_type, token.token_type)
        opening, is_adjacent = self._opening(), before.end + 1 == token.start
        bracket = None if opening is None else self.tokens[opening].token_type
        if kinds[0] == TokenType.COMMA and (kinds[1] in _CLOSING or is_word(token, *CLAUSES)):
            return NO_COMMA
        if kinds == (TokenType.NUMBER,) * 2 and bracket == TokenType.L_BRACKET:
            return NUMPY
        if kinds == (TokenType.R_BRACKET, TokenType.L_PAREN):
            return NO_BOUNDS
        if kinds == (TokenType.NUMBER, TokenType.VAR) and is_adjacent:
            return NO_NUMBER
        if kinds[1] == TokenType.STRING and is_adjacent and is_word(before, "F", "R", "B", "U"):
            return NO_PREFIX
        if kinds[1] == TokenType.COMMA and bracket == TokenType.L_PAREN:
            called = self._called_name()
            is_call = is_kind(called, TokenType.VAR)
            is_call = is_call and not is_word(called, *CLAUSES, *OPERATOR_WORDS)
            is_query = opening is not None and is_word(self.tokens[opening + 1], "SELECT")
            return "" if is_call or is_query else NO_TUPLE
        return ""

    def _opening(self) -> int | None:
        """Returns the number of the bracket that is open at the current token."""
        depth = 0
        for place in range(self.index - 1, -1, -1):
            kind = self.tokens[place].token_type
            depth += (kind in _CLOSING) - (kind in _OPENING)
            if depth < 0:
                return place
        return None

    def _called_name(self) -> Token | None:
        """Returns the token before the bracket that is open at the current token."""
        opening = self._opening()
        return self.tokens[opening - 1] if opening else None


def is_kind(token: Token | None, kind: TokenType) -> bool:
    """Checks whether there is a token, and of that type."""
    return token is not None and token.token_type == kind


def is_word(token: Token | None, *words: str) -> bool:
    """Checks whether a token is one of these words, given in upper case."""
    return token is not None and token.token_type == TokenType.VAR and token.text.upper() in words


def slice_of(token: Token) -> slice:
    """Returns the place of a token in the text."""
    return slice(token.start, token.end + 1)


def span_of(token: Token) -> SourceSpan:
    """Returns the place of a token."""
    return SourceSpan(token.start, token.end + 1)
