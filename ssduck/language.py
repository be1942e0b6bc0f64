"""SelectScript text to a tree.

The tokenizer is sqlglot's with SelectScript's quotes and comments; the parser is a recursive
descent over its tokens, one method a precedence level (the grammar is in docs/language.md).
The tree is made of frozen nodes that know their place in the text. It knows no simulator,
no database and no variable: names are looked up when a program runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import ClassVar, NoReturn, TypeVar

from sqlglot.errors import TokenError
from sqlglot.tokenizer_core import Token, TokenType
from sqlglot.tokens import Tokenizer

from ssduck.chains import Row
from ssduck.errors import ParseError, Span, nearest
from ssduck.quotes import unquoted
from ssduck.tree import (
    Adapter,
    Aged,
    Assignment,
    Branch,
    Call,
    Endless,
    If,
    Index,
    Key,
    ListOf,
    Literal,
    Name,
    Node,
    Program,
    Query,
    Recursion,
    Source,
    This,
    Unary,
)

T = TypeVar("T")

# Parsing and evaluating recurse; deeper programs than this get an error, not a crash.
MAXIMUM_DEPTH = 60


class SelectScriptTokenizer(Tokenizer):
    """sqlglot's tokenizer with SelectScript's quotes, comments and operators.

    Words stay plain words (`VAR`), so that no name is lost to an SQL keyword.
    """

    QUOTES: ClassVar[list[str | tuple[str, str]]] = ["'", '"']
    IDENTIFIERS: ClassVar[list[str | tuple[str, str]]] = []
    COMMENTS: ClassVar[list[str | tuple[str, str]]] = ["//", "#", ("/*", "*/")]
    STRING_ESCAPES: ClassVar[list[str]] = ["\\"]
    KEYWORDS: ClassVar[dict[str, TokenType]] = {
        "==": TokenType.EQ,
        "!=": TokenType.NEQ,
        ">=": TokenType.GTE,
        "<=": TokenType.LTE,
    }


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

LEVEL_OF = {operator: level for level, operators in enumerate(LEVELS) for operator in operators}

CLAUSES = frozenset(
    (
        *("SELECT", "FROM", "WHERE", "START", "WITH", "CONNECT", "BY", "STOP"),
        *("NO", "CYCLE", "UNIQUE", "MEMORIZE", "MAXIMUM", "GROUP", "HAVING", "ORDER"),
        *("ASC", "ASCENDING", "DESC", "DESCENDING", "LIMIT", "AS"),
    )
)
OPERATOR_WORDS = ("OR", "XOR", "AND", "NOT", "IN")
# These never begin an expression, so a name spelled so would be unreachable.
RESERVED = frozenset((*OPERATOR_WORDS, "FROM", "WHERE", "SELECT", "AS"))


def is_reserved(name: str) -> bool:
    """Whether a program could not call a variable so."""
    return name.upper() in RESERVED or name.upper() in ("TRUE", "FALSE", "THIS")


@lru_cache(maxsize=512)
def parse(text: str) -> Program:
    """Parse a program.

    Args:
        text: statements, each ended by `;` (the last may go without).

    Returns:
        The program's tree; the same object for the same text.

    Raises:
        ParseError: with the place of the first thing that is wrong.
    """
    return _Parser(text).program()


def _tokenize(text: str) -> list[Token]:
    try:
        return SelectScriptTokenizer().tokenize(text)
    except TokenError as error:
        # The only thing that this tokenizer refuses is a text or a comment without an end.
        message = "a text or a comment is opened here and never closed"
        span = Span(_last_opening(text), len(text))
        raise ParseError(message, text=text, span=span) from error


class _Parser:
    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens = _tokenize(text)
        self.index = 0
        self.depth = 0

    # -- tokens ---------------------------------------------------------------------------

    @property
    def token(self) -> Token | None:
        return self.tokens[self.index] if self.index < len(self.tokens) else None

    def ahead(self, offset: int = 1) -> Token | None:
        index = self.index + offset
        return self.tokens[index] if index < len(self.tokens) else None

    def at(self, kind: TokenType) -> bool:
        return self.token is not None and self.token.token_type == kind

    def at_word(self, *words: str) -> bool:
        return _is_word(self.token, *words)

    def take(self, kind: TokenType) -> Token | None:
        if not self.at(kind):
            return None
        self.index += 1
        return self.tokens[self.index - 1]

    def take_words(self, *words: str) -> bool:
        """Take a run of keywords (`GROUP BY`), or nothing."""
        if all(_is_word(self.ahead(offset), word) for offset, word in enumerate(words)):
            self.index += len(words)
            return True
        return False

    def expect(self, kind: TokenType, what: str) -> Token:
        taken = self.take(kind)
        if taken is None:
            self.fail(f"expected {what}")
        return taken

    def expect_word(self, word: str) -> None:
        if not self.take_words(word):
            self.fail(f"expected {word}")

    def expect_name(self, what: str) -> Token:
        if self.token is not None and self.token.text.upper() in RESERVED:
            self.fail(f"expected {what}")
        return self.expect(TokenType.VAR, what)

    def here(self) -> Span:
        """The place of the current token; behind the text once that is used up."""
        if self.token is None:
            return Span(len(self.text.rstrip()), len(self.text.rstrip()) + 1)
        return _span(self.token)

    def since(self, start: Span) -> Span:
        return Span(start.start, self.end())

    def end(self) -> int:
        """Where the text of what was taken last ends."""
        return _span(self.tokens[self.index - 1]).end

    def fail(self, message: str) -> NoReturn:
        token = self.token
        found = "the end of the text" if token is None else repr(self.text[_slice(token)])
        names = () if token is None else nearest(token.text, CLAUSES, 1)
        known = token is not None and token.text.upper() in CLAUSES
        raise ParseError(
            f"{message}, found {found}",
            text=self.text,
            span=self.here(),
            suggestions=() if known else names,
        )

    # -- statements -----------------------------------------------------------------------

    def program(self) -> Program:
        explain = _is(self.ahead(), TokenType.VAR) and self.take_words("EXPLAIN")
        statements = []
        while self.token is not None:
            if self.take(TokenType.SEMICOLON):
                continue
            statements.append(self.statement())
            if self.token is not None:
                self.expect(TokenType.SEMICOLON, "';'")
        return Program(self.text, tuple(statements), explain)

    def statement(self) -> Node:
        self.descend()
        if self.at_word("SELECT"):
            node: Node = self.query()
        elif self.at_assignment():
            node = self.assignment()
        else:
            node = self.expression()
        self.depth -= 1
        return node

    def at_assignment(self) -> bool:
        """Whether `name =` or `name{…} =` comes next."""
        if not self.at(TokenType.VAR):
            return False
        offset = 1
        if _is(self.ahead(offset), TokenType.L_BRACE):
            depth = 0
            while token := self.ahead(offset):
                depth += _is(token, TokenType.L_BRACE) - _is(token, TokenType.R_BRACE)
                offset += 1
                if depth == 0:
                    break
        token = self.ahead(offset)
        return _is(token, TokenType.EQ) and token is not None and token.text == "="

    def assignment(self) -> Assignment:
        start = self.here()
        name = self.expect_name("a variable's name")
        horizon: Node | None = None
        opening = self.here()
        if self.take(TokenType.L_BRACE):
            endless = self.take(TokenType.R_BRACE)
            horizon = Endless(self.since(opening)) if endless else self.expression()
            if not endless:
                self.expect(TokenType.R_BRACE, "'}'")
        self.expect(TokenType.EQ, "'='")
        value = self.statement()
        return Assignment(self.since(start), name.text, horizon, value)

    def plain_assignment(self, what: str) -> Assignment:
        """An assignment to what has no history."""
        if _is(self.ahead(), TokenType.L_BRACE):
            self.index += 1
            self.fail(f"expected '=' ({what} has no history)")
        return self.assignment()

    def state(self) -> Node:
        """An assignment to a state variable, or what is evaluated beside those."""
        if self.at_assignment():
            return self.plain_assignment("a state variable")
        return self.expression()

    # -- queries --------------------------------------------------------------------------

    def query(self) -> Query:
        start = self.here()
        self.descend()
        self.expect_word("SELECT")
        star = self.at(TokenType.STAR)
        items = () if self.take(TokenType.STAR) else self.separated(self.part)
        if star and not self.at_word("FROM"):
            self.fail("expected FROM after *")
        self.expect_word("FROM")
        sources = self.separated(self.source)
        where = self.part() if self.take_words("WHERE") else None
        recursion = self.recursion()
        group = self.separated(self.expression) if self.take_words("GROUP", "BY") else ()
        having = self.expression() if self.take_words("HAVING") else None
        order = self.separated(self.key) if self.take_words("ORDER", "BY") else ()
        limit = self.expression() if self.take_words("LIMIT") else None
        adapter = self.adapter() if self.take_words("AS") else None
        self.depth -= 1
        return Query(
            self.since(start),
            items,
            sources,
            where,
            recursion,
            group,
            having,
            order,
            limit,
            adapter,
        )

    def part(self) -> Node:
        """What stands in SELECT or WHERE: an expression, or an assignment to a variable."""
        if not self.at_assignment():
            return self.expression()
        self.descend()
        node = replace(self.assignment(), is_bare=True)
        self.depth -= 1
        return node

    def separated(self, part: Callable[[], T]) -> tuple[T, ...]:
        parts = [part()]
        while self.take(TokenType.COMMA):
            parts.append(part())
        return tuple(parts)

    def source(self) -> Source:
        start = self.here()
        alias = None
        if self.at_assignment():
            alias = self.expect_name("a source's name").text
            if self.at(TokenType.L_BRACE):
                self.fail("expected '=' (a source has no history)")
            self.index += 1
        value = self.query() if self.at_word("SELECT") else self.expression()
        if alias is None and isinstance(value, Name | Aged):
            alias = value.name
        return Source(self.since(start), alias, value)

    def key(self) -> Key:
        start = self.here()
        value = self.expression()
        descending = self.take_words("DESC") or self.take_words("DESCENDING")
        if not descending:
            _ = self.take_words("ASC") or self.take_words("ASCENDING")
        return Key(self.since(start), value, descending)

    def recursion(self) -> Recursion | None:
        start = self.here()
        initial: tuple[Node, ...] = ()
        if self.take_words("START", "WITH"):
            initial = self.separated(self.state)
        elif not self.at_word("CONNECT"):
            return None
        if not self.take_words("CONNECT", "BY"):
            self.fail("expected CONNECT BY")
        no_cycle = self.take_words("NO", "CYCLE")
        unique = self.take_words("UNIQUE")
        memorizes = self.take_words("MEMORIZE")
        bounded = memorizes and not (self.at_assignment() or self.at_word("MAXIMUM"))
        memorize = self.primary() if bounded else None
        maximum = self.primary() if self.take_words("MAXIMUM") else None
        step = self.separated(self.state)
        if not self.take_words("STOP", "WITH"):
            self.fail("expected STOP WITH")
        stop = self.expression()
        return Recursion(
            self.since(start), initial, no_cycle, unique, memorizes, memorize, maximum, step, stop
        )

    def adapter(self) -> Adapter:
        start = self.here()
        name = self.expect_name("the name of a result form").text
        arguments: list[Node] = []
        named: list[Assignment] = []
        if self.take(TokenType.L_PAREN):
            while not self.at(TokenType.R_PAREN):
                if self.at_assignment():
                    named.append(self.plain_assignment("an argument"))
                else:
                    arguments.append(self.statement())
                if not self.take(TokenType.COMMA):
                    break
            self.expect(TokenType.R_PAREN, "')'")
        return Adapter(self.since(start), name, tuple(arguments), tuple(named))

    # -- expressions ----------------------------------------------------------------------

    def expression(self) -> Node:
        self.descend()
        node = self.operation(0)
        self.depth -= 1
        return node

    def descend(self) -> None:
        self.depth += 1
        if self.depth > MAXIMUM_DEPTH:
            raise ParseError(
                f"nested deeper than {MAXIMUM_DEPTH} levels", text=self.text, span=self.here()
            )

    def operation(self, loosest: int) -> Node:
        """Operators of the level `loosest` and tighter ones, by precedence climbing."""
        start = self.here()
        if self.take_words("NOT"):
            self.descend()
            operand = self.operation(LEVEL_OF["NOT"])
            self.depth -= 1
            left: Node = Unary(self.since(start), "NOT", operand)
        else:
            left = self.unary()
        while (level := self.operator_level()) >= loosest:
            row = Row(start.start, left, self.end())
            while self.operator_level() == level:
                operator = self.tokens[self.index].text.upper()
                self.index += 1
                row.add(operator, self.operation(level + 1), self.end())
            left = row.node()
        return left

    def operator_level(self) -> int:
        """The level of the operator that comes next, -1 if none does."""
        token = self.token
        if token is None or token.token_type == TokenType.STRING:
            return -1
        if token.token_type == TokenType.EQ and token.text == "=":
            self.fail("expected '==' to compare ('=' assigns)")
        operator = token.text.upper()
        return -1 if operator == "NOT" else LEVEL_OF.get(operator, -1)

    def unary(self) -> Node:
        start = self.here()
        signs = []
        while self.at(TokenType.DASH) or self.at(TokenType.PLUS):
            self.descend()
            signs.append(self.tokens[self.index].text)
            self.index += 1
        node = self.postfix()
        self.depth -= len(signs)
        for sign in reversed(signs):
            node = Unary(self.since(start), sign, node)
        return node

    def postfix(self) -> Node:
        start = self.here()
        node = self.primary()
        indices: list[Node] = []
        while self.at(TokenType.L_BRACKET) or self.at(TokenType.DOT):
            if self.take(TokenType.L_BRACKET):
                indices.extend(self.separated(self.expression))
                self.expect(TokenType.R_BRACKET, "']'")
            else:
                self.expect(TokenType.DOT, "'.'")
                key = self.expect_name("a key")
                indices.append(Literal(_span(key), key.text))
        return Index(self.since(start), node, tuple(indices)) if indices else node

    def primary(self) -> Node:
        token = self.token
        start = self.here()
        if token is None:
            self.fail("expected an expression")
        if self.take(TokenType.NUMBER):
            return Literal(start, self.number(token))
        if self.take(TokenType.STRING):
            return Literal(start, unquoted(self.text[_slice(token)]))
        if self.take(TokenType.L_PAREN):
            node = self.statement()
            self.expect(TokenType.R_PAREN, "')'")
            return node
        if self.take(TokenType.L_BRACKET):
            items = () if self.at(TokenType.R_BRACKET) else self.separated(self.statement)
            self.expect(TokenType.R_BRACKET, "']'")
            return ListOf(self.since(start), items)
        if self.take(TokenType.DOT) and (digits := self.take(TokenType.NUMBER)):
            return Literal(self.since(start), self.number(digits, "."))
        return self.word()

    def number(self, token: Token, prefix: str = "") -> int | float:
        text = prefix + token.text
        try:
            return int(text) if text.isdigit() else float(text)
        except ValueError:
            raise ParseError(f"{text!r} is no number", text=self.text, span=_span(token)) from None

    def word(self) -> Node:
        start = self.here()
        if self.at_word("SELECT"):
            return self.query()
        if self.take_words("TRUE"):
            return Literal(start, True)
        if self.take_words("FALSE"):
            return Literal(start, False)
        if self.take_words("THIS"):
            return This(start, None)
        if self.at_word("IF") and _is(self.ahead(), TokenType.L_PAREN):
            return self.choice()
        name = self.expect_name("an expression")
        if self.at(TokenType.DOT) and _is_word(self.ahead(), "THIS"):
            self.index += 2
            return This(self.since(start), name.text)
        if self.take(TokenType.L_PAREN):
            arguments = () if self.at(TokenType.R_PAREN) else self.separated(self.statement)
            self.expect(TokenType.R_PAREN, "')'")
            return Call(self.since(start), name.text, arguments, start)
        if self.take(TokenType.L_BRACE):
            age = None if self.at(TokenType.R_BRACE) else self.expression()
            self.expect(TokenType.R_BRACE, "'}'")
            return Aged(self.since(start), name.text, age)
        return Name(start, name.text)

    def choice(self) -> If:
        """`IF(condition; …; …)`; an `IF` that is a whole else branch is a branch of this one."""
        start = self.here()
        self.index += 2
        branches = [self.branch(start)]
        otherwise: tuple[Node, ...] = ()
        open_ones = 1
        while self.take(TokenType.SEMICOLON) and not self.at(TokenType.R_PAREN):
            if not self.at_last_choice():
                otherwise = self.separated(self.statement)
                break
            inner = self.here()
            self.index += 2
            open_ones += 1
            branches.append(self.branch(inner))
        for _ in range(open_ones):
            self.expect(TokenType.R_PAREN, "')'")
        first, *further = branches
        return If(self.since(start), first.condition, first.then, otherwise, tuple(further))

    def branch(self, start: Span) -> Branch:
        """`condition; then, …`; without a then it is True, as in the published grammar."""
        condition = self.statement()
        if self.at(TokenType.R_PAREN):
            return Branch(self.since(start), condition, (Literal(self.since(start), True),))
        self.expect(TokenType.SEMICOLON, "';' or ')' after the condition")
        return Branch(self.since(start), condition, self.separated(self.statement))

    def at_last_choice(self) -> bool:
        """Whether an `IF(…)` comes next, and then the end of the one that it is in."""
        if not self.at_word("IF") or not _is(self.ahead(), TokenType.L_PAREN):
            return False
        close = self.closings.get(self.index + 1)
        behind = None if close is None else self.ahead(close + 1 - self.index)
        return _is(behind, TokenType.R_PAREN)

    @cached_property
    def closings(self) -> dict[int, int]:
        """Where the token is that closes a parenthesis, by where that is."""
        found: dict[int, int] = {}
        open_ones: list[int] = []
        for index, token in enumerate(self.tokens):
            if token.token_type == TokenType.L_PAREN:
                open_ones.append(index)
            elif token.token_type == TokenType.R_PAREN and open_ones:
                found[open_ones.pop()] = index
        return found


def _last_opening(text: str) -> int:
    """Where the text or comment begins that is never closed."""
    index = 0
    while index < len(text):
        closing = next(
            (end for begin, end in _DELIMITERS.items() if text.startswith(begin, index)), None
        )
        if closing is None:
            index += 1
            continue
        begin, index = index, index + (2 if closing == "*/" else 1)
        while index < len(text) and not text.startswith(closing, index):
            index += 2 if text[index] == "\\" and closing in ("'", '"') else 1
        if index >= len(text) and closing != "\n":
            return begin
        index += len(closing)
    return 0


_DELIMITERS = {"'": "'", '"': '"', "/*": "*/", "//": "\n", "#": "\n"}


def _is(token: Token | None, kind: TokenType) -> bool:
    return token is not None and token.token_type == kind


def _is_word(token: Token | None, *words: str) -> bool:
    return token is not None and token.token_type == TokenType.VAR and token.text.upper() in words


def _slice(token: Token) -> slice:
    return slice(token.start, token.end + 1)


def _span(token: Token) -> Span:
    return Span(token.start, token.end + 1)
