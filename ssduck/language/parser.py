"""Parses SelectScript text into a tree.

The tokenizer is sqlglot's with SelectScript's quotes and comments; the parser is a recursive
descent over its tokens, with precedence climbing. docs/reference/language.md has the grammar. The
tree consists of frozen nodes with their places in the text. Names are looked up when a program
runs.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache
from typing import NoReturn

from sqlglot.tokenizer_core import Token, TokenType

from ssduck.errors import ParseError, SourceSpan, nearest
from ssduck.formatting import RESERVED_WORDS
from ssduck.language import ast
from ssduck.language.sql_suggestions import STATEMENTS
from ssduck.language.sql_syntax import CHAIN_OF_EQUALS, RELATIONAL, SqlForms, numbered_column
from ssduck.language.tokens import (
    LEVEL_OF,
    divisions,
    is_kind,
    is_word,
    slice_of,
    span_of,
    tokenize,
    unquoted,
)


def is_reserved(name: str) -> bool:
    """Checks whether a name cannot be that of a variable."""
    return name.upper() in RESERVED_WORDS or name.upper() in ("TRUE", "FALSE", "THIS")


def parse(text: str) -> ast.Program:
    """Parses a program.

    >>> parse("1 + 2 * 3;").statements[0].outline()
    "Binary('+', Literal(1), Binary('*', Literal(2), Literal(3)))"
    >>> parse("v{5.0} = z(cup);").statements[0].outline()
    "Assignment('v', Literal(5.0), Call('z', [Name('cup')]))"
    >>> (query,) = parse("SELECT id FROM kitchen WHERE above(table, this) AS list;").statements
    >>> print(query.outline())
    Query([Name('id')], [Source('kitchen', Name('kitchen'))],
          Call('above', [Name('table'), This(None)]), AdapterClause('list'))
    >>> parse("SELECT id FORM kitchen;")
    Traceback (most recent call last):
        ...
    ssduck.errors.ParseError: ...

    Args:
        text: statements, each ended by `;` (the last may go without).

    Returns:
        The program's tree; the same object for the same text, unless it is long.

    Raises:
        ParseError: the text is not a program; the error has the place.
    """
    if len(text) <= _SHORT:
        return _short_program(text)
    return (_long_program if len(text) <= _LONG else _program)(text)


def _program(text: str) -> ast.Program:
    return _Parser(text, tokenize(text)).program()


# The trees of long programs take much memory.
_short_program, _long_program = lru_cache(maxsize=512)(_program), lru_cache(maxsize=8)(_program)
_SHORT, _LONG = 2_000, 50_000


# What follows a word at the beginning of a statement only if it is a keyword.
_OPERANDS = frozenset((TokenType.VAR, TokenType.NUMBER, TokenType.STRING))
_OPENING = (TokenType.L_PAREN, TokenType.L_BRACKET)
# What a program may begin with that asks about its last statement.
PREFIXES = ("EXPLAIN", "WHY")


class _Parser(SqlForms):
    # The place of the first word of the current statement.
    _first = 0

    # -- statements -----------------------------------------------------------------------

    def program(self) -> ast.Program:
        explain = ""
        if self._is_prefix():
            explain = next((word for word in PREFIXES if self.take_words(word)), "")
        statements = []
        while self.token is not None:
            if self.take(TokenType.SEMICOLON):
                continue
            self._first = self.index
            statements.append(self.statement())
            if self.token is not None:
                self.expect(TokenType.SEMICOLON, "';'")
        for span in divisions(self.text):
            self.add_suspicion(span, "this begins a comment; an integer quotient is floor(x / y)")
        return ast.Program(self.text, tuple(statements), explain, tuple(self.suspicions))

    def _is_prefix(self) -> bool:
        """Checks whether a word is no name, because of what follows it, as in WHY (a OR b)."""
        word, after = self.token, self.ahead()
        if word is None or after is None or after.token_type in _OPERANDS:
            return after is not None
        is_sign = is_kind(after, TokenType.DASH) and self.text[after.end + 1 :][:1] not in (" ", "")
        return word.end + 1 < after.start and (is_sign or after.token_type in _OPENING)

    def fail(self, message: str) -> NoReturn:
        """Raises the error for the current token, or for a statement whose first word is wrong."""
        word, token = self.tokens[self._first], self.token
        is_cause = is_word(token, "FROM") or (
            self.index == self._first + 1 and token is not None and token.token_type in _OPERANDS
        )
        if is_cause and self._first and is_word(word, *PREFIXES):
            text = f"{word.text} begins a program: write it before the first statement"
            raise ParseError(text, text=self.text, span=span_of(word))
        if is_cause and is_kind(word, TokenType.VAR) and not is_word(word, *STATEMENTS):
            names = nearest(word.text, ("SELECT", "EXPLAIN")[: 1 + (self._first == 0)], 1)
            if names and word.text.upper() not in names:
                raise ParseError(
                    f"{word.text!r} begins no statement",
                    text=self.text,
                    span=span_of(word),
                    suggestions=names,
                )
        super().fail(message)

    def statement(self) -> ast.Node:
        self.descend()
        if self.at_word("SELECT"):
            node: ast.Node = self.query()
        elif self.equals != "in a condition" and self.at_assignment():
            node = self.ambiguous_assignment() if self.equals else self.assignment()
        else:
            node = self.expression()
        self.depth -= 1
        return node

    def at_assignment(self) -> bool:
        """Checks whether `name =` or `name{…} =` comes next."""
        if not self.at(TokenType.VAR) or (self.equals and self.at_word("TRUE", "FALSE", "THIS")):
            return False
        offset = 1
        if is_kind(self.ahead(offset), TokenType.L_BRACE):
            depth = 0
            while token := self.ahead(offset):
                depth += is_kind(token, TokenType.L_BRACE) - is_kind(token, TokenType.R_BRACE)
                offset += 1
                if depth == 0:
                    break
        token = self.ahead(offset)
        return is_kind(token, TokenType.EQ) and token is not None and token.text == "="

    def assignment(self) -> ast.Assignment:
        start = self.here()
        name = self.expect_own_name("a variable's name")
        horizon: ast.Node | None = None
        opening = self.here()
        if self.take(TokenType.L_BRACE):
            endless = self.take(TokenType.R_BRACE)
            horizon = ast.UnboundedHorizon(self.since(opening)) if endless else self.expression()
            if not endless:
                self.expect(TokenType.R_BRACE, "'}'")
        self.expect(TokenType.EQ, "'='")
        value = self.statement()
        return ast.Assignment(self.since(start), name.text, horizon, value)

    def plain_assignment(self, target: str) -> ast.Assignment:
        """Parses an assignment to a name without history."""
        if is_kind(self.ahead(), TokenType.L_BRACE):
            self.index += 1
            self.fail(f"expected '=' ({target} has no history)")
        return self.assignment()

    def state(self) -> ast.Node:
        """Returns an assignment to a state variable, or another expression."""
        if self.at_assignment():
            return self.plain_assignment("a state variable")
        return self.expression()

    # -- queries --------------------------------------------------------------------------

    def query(self) -> ast.Query:
        start = self.here()
        self.descend()
        equals, self.equals = self.equals, "in a value"
        is_listed, self.is_listed = self.is_listed, True
        self.expect_word("SELECT")
        distinct = self.take_distinct()
        star = self.at(TokenType.STAR)
        items = () if self.take(TokenType.STAR) else self.separated(self.select_item)
        self.equals = ""
        if star and not self.at_word("FROM"):
            self.fail("expected FROM after *")
        if not self.take_words("FROM"):
            if self.token is None or self.at(TokenType.SEMICOLON):
                self.fail("expected FROM (without it write the value alone: 1 + 1)")
            self.fail("expected FROM (a column is named by AS)")
        self.is_listed = is_listed
        sources, joined = self.sources()
        self.is_listed = True
        where = self.condition() if self.take_words("WHERE") else None
        where = self.conjunction([*joined, *([] if where is None else [where])])
        if distinct and self.at_word("START", "CONNECT"):
            self.fail("expected no CONNECT BY (DISTINCT is of rows; write UNIQUE or NO CYCLE)")
        recursion = self.recursion()
        group = self.separated(self.group_key) if self.take_words("GROUP", "BY") else ()
        group = tuple(numbered_column(key, items) for key in group)
        having = self.condition() if self.take_words("HAVING") else None
        order = self.separated(self.key) if self.take_words("ORDER", "BY") else ()
        order = tuple(replace(key, value=numbered_column(key.value, items)) for key in order)
        limit, offset = self.limits(may_be_followed=is_listed)
        if offset is not None and recursion is not None:
            self.fail("expected no OFFSET of paths (it skips rows)")
        adapter = self.adapter() if self.take_words("AS") else None
        self.depth -= 1
        self.equals, self.is_listed = equals, is_listed
        query = ast.Query(
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
            distinct,
            offset,
        )
        self.check_condition(where)
        self.check_condition(having)
        self.check_texts(where)
        self.check_texts(having)
        self.check_keys(query)
        return self.with_qualified_names(query)

    def select_item(self) -> ast.Node:
        """Returns an item of SELECT: a value, named or not, or an assignment to a variable."""
        if not self.at_assignment():
            return self.item()
        start = self.here()
        node = replace(self.ambiguous_assignment(), is_bare=True)
        return self.named(start, node)

    def ambiguous_assignment(self) -> ast.Assignment:
        """Returns `name = value` in a query: an assignment that may be a comparison."""
        self.descend()
        value = self.ahead(2) if is_kind(self.ahead(), TokenType.EQ) else None
        node = self.assignment()
        self.depth -= 1
        return node if value is None else replace(node, value_start=value.start)

    def source(self) -> ast.Source:
        start = self.here()
        alias = None
        if self.at_assignment():
            alias = self.expect_own_name("a source's name").text
            if self.at(TokenType.L_BRACE):
                self.fail("expected '=' (a source has no history)")
            self.index += 1
        is_listed, self.is_listed = self.is_listed, True
        value = self.query() if self.at_word("SELECT") else self.expression()
        self.is_listed = is_listed
        if alias is None:
            alias = self.source_alias(is_listed=is_listed)
        if alias is None and isinstance(value, ast.Name | ast.TimeIndex):
            alias = value.name
        return ast.Source(self.since(start), alias, value)

    def sources(self) -> tuple[tuple[ast.Source, ...], list[ast.Node]]:
        """Returns the sources of FROM, and the conditions behind the ON of its joins."""
        sources, conditions = [self.source()], []
        while True:
            if self.take(TokenType.COMMA) or self.take_words("CROSS", "JOIN"):
                sources.append(self.source())
            elif self.take_words("JOIN") or self.take_words("INNER", "JOIN"):
                sources.append(self.source())
                if not self.take_words("ON"):
                    self.fail("expected ON (write FROM x a JOIN y b ON condition)")
                conditions.append(self.condition())
            else:
                return tuple(sources), conditions

    def conjunction(self, conditions: list[ast.Node]) -> ast.Node | None:
        """Returns conditions joined by AND; None if there are none."""
        result: ast.Node | None = None
        for node in conditions:
            span = node.span if result is None else SourceSpan(result.span.start, node.span.end)
            result = node if result is None else ast.Binary(span, "AND", result, node)
        return result

    def key(self) -> ast.OrderKey:
        start = self.here()
        value = self.group_key()
        descending = self.take_words("DESC") or self.take_words("DESCENDING")
        if not descending:
            _ = self.take_words("ASC") or self.take_words("ASCENDING")
        return ast.OrderKey(self.since(start), value, descending)

    def recursion(self) -> ast.Recursion | None:
        start = self.here()
        initial: tuple[ast.Node, ...] = ()
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
        stop = self.condition()
        self.check_condition(stop)
        return ast.Recursion(
            self.since(start), initial, no_cycle, unique, memorizes, memorize, maximum, step, stop
        )

    def adapter(self) -> ast.AdapterClause:
        start = self.here()
        name = self.form_name()
        arguments: list[ast.Node] = []
        named: list[ast.Assignment] = []
        if self.take(TokenType.L_PAREN):
            while not self.at(TokenType.R_PAREN):
                if self.at_assignment():
                    named.append(self.plain_assignment("an argument"))
                else:
                    arguments.append(self.statement())
                if not self.take(TokenType.COMMA):
                    break
            self.expect(TokenType.R_PAREN, "')'")
        return ast.AdapterClause(self.since(start), name, tuple(arguments), tuple(named))

    # -- expressions ----------------------------------------------------------------------

    def expression(self) -> ast.Node:
        self.descend()
        start = self.here()
        node = self.operation(0)
        if self.take_words("IMPLIES"):  # looser than OR, and right-associative
            denied, then = ast.Unary(node.span, "NOT", node), self.expression()
            node = ast.Binary(self.since(start), "OR", denied, then)
        self.depth -= 1
        return node

    def operation(self, loosest: int) -> ast.Node:
        """Operators of the level `loosest` and tighter ones, by precedence climbing."""
        start = self.here()
        if self.take_words("NOT"):
            self.descend()
            operand = self.operation(LEVEL_OF["NOT"])
            self.depth -= 1
            left: ast.Node = ast.Unary(self.since(start), "NOT", operand)
        else:
            left = self.unary()
        while (level := self.operator_level()) >= loosest:
            if self.condition_level() >= 0:
                left = self.condition_operator(start, left)
                continue
            row, places = ast.OperandRow(start.start, left, self.end()), [start]
            is_compared = False
            while self.operator_level() == level and self.condition_level() < 0:
                word = self.tokens[self.index].text.upper()
                operator = {"<>": "!=", "=": "=="}.get(word, word)
                is_chain, is_compared = word == "=" and is_compared, word == "="
                self.index += 1
                places.append(self.here())
                right = self.members() if operator == "IN" else self.operation(level + 1)
                if is_chain:
                    raise ParseError(CHAIN_OF_EQUALS, text=self.text, span=self.since(start))
                if operator == "^":
                    self.check_sign(row, *places[-2:])
                row.add(operator, right, self.end())
            self.check_equality(row, places)
            left = self.comparison(row, places) if operator in RELATIONAL else row.node()
        return left

    def operator_level(self) -> int:
        """Returns the level of the operator that comes next, -1 if none does."""
        token = self.token
        if token is None or token.token_type == TokenType.STRING:
            return -1
        if token.token_type == TokenType.EQ and token.text == "=":
            if self.equals:
                return LEVEL_OF["=="]
            self.fail("expected '==' to compare ('=' assigns)")
        operator = token.text.upper()
        if (level := self.condition_level()) >= 0:
            return level
        if operator == "<>":
            return LEVEL_OF["!="]
        return -1 if operator == "NOT" else LEVEL_OF.get(operator, -1)

    def unary(self) -> ast.Node:
        start = self.here()
        signs = []
        while self.at(TokenType.DASH) or self.at(TokenType.PLUS):
            self.descend()
            signs.append(self.tokens[self.index].text)
            self.index += 1
        node = self.postfix()
        self.depth -= len(signs)
        for sign in reversed(signs):
            node = ast.Unary(self.since(start), sign, node)
        return node

    def postfix(self) -> ast.Node:
        start = self.here()
        node = self.primary()
        indices: list[ast.Node] = []
        while self.at(TokenType.L_BRACKET) or self.at(TokenType.DOT):
            if self.take(TokenType.L_BRACKET):
                indices.extend(self.separated(self.expression))
                self.expect(TokenType.R_BRACKET, "']'")
            else:
                self.expect(TokenType.DOT, "'.'")
                key = self.expect_name(self.key_wanted())
                indices.append(ast.Literal(span_of(key), key.text))
        return ast.Index(self.since(start), node, tuple(indices)) if indices else node

    def primary(self) -> ast.Node:
        token = self.token
        start = self.here()
        if token is None:
            self.fail("expected an expression")
        if self.take(TokenType.NUMBER):
            return ast.Literal(start, self.number(token))
        if self.take(TokenType.STRING):
            return ast.Literal(start, unquoted(self.text[slice_of(token)]))
        if self.take(TokenType.L_PAREN):
            is_listed, self.is_listed = self.is_listed, False
            node = self.statement()
            self.is_listed = is_listed
            self.expect(TokenType.R_PAREN, "')'")
            return node
        if self.take(TokenType.L_BRACKET):
            items = () if self.at(TokenType.R_BRACKET) else self.parts()
            self.expect(TokenType.R_BRACKET, "']'")
            self.check_list(self.since(start))
            return ast.ListLiteral(self.since(start), items)
        if self.take(TokenType.DOT) and (digits := self.take(TokenType.NUMBER)):
            return ast.Literal(self.since(start), self.number(digits, "."))
        return self.word()

    def number(self, token: Token, prefix: str = "") -> int | float:
        text = prefix + token.text
        try:
            return int(text) if text.isdigit() else float(text)
        except ValueError:
            raise ParseError(
                f"{text!r} is not a number", text=self.text, span=span_of(token)
            ) from None

    def word(self) -> ast.Node:
        start = self.here()
        if self.at_word("SELECT"):
            return self.query()
        if self.take_words("TRUE"):
            return ast.Literal(start, True)
        if self.take_words("FALSE"):
            return ast.Literal(start, False)
        if self.take_words("THIS"):
            return ast.This(start, None)
        if self.begins_case():
            return self.case()
        if self.at_word("IF") and is_kind(self.ahead(), TokenType.L_PAREN):
            return self.if_expression()
        name = self.expect_name("an expression")
        if self.at(TokenType.DOT) and is_word(self.ahead(), "THIS"):
            self.index += 2
            return ast.This(self.since(start), name.text)
        if self.take(TokenType.L_PAREN):
            aggregate_argument = self.aggregate_argument(name.text)
            called = name.text
            if aggregate_argument is not None:
                arguments: tuple[ast.Node, ...] = (aggregate_argument,)
                called = called.lower()
            else:
                parts = self.branch_parts if called == "print" else self.parts
                arguments = () if self.at(TokenType.R_PAREN) else parts()
            self.expect(TokenType.R_PAREN, "')'")
            return ast.Call(self.since(start), called, arguments, start)
        if self.take(TokenType.L_BRACE):
            age = None if self.at(TokenType.R_BRACE) else self.expression()
            self.expect(TokenType.R_BRACE, self.past_end(name.text))
            return ast.TimeIndex(self.since(start), name.text, age)
        return ast.Name(start, name.text)

    def parts(self) -> tuple[ast.Node, ...]:
        """Statements with commas between them, in brackets."""
        is_listed, self.is_listed = self.is_listed, True
        result = self.separated(self.statement)
        self.is_listed = is_listed
        return result

    def branch_parts(self) -> tuple[ast.Node, ...]:
        """The parts of a branch of IF, or of `print`, whose last one is the value.

        In a condition, `=` assigns in those before the last.
        """
        is_listed, self.is_listed = self.is_listed, True
        result = self.separated(self.branch_part)
        self.is_listed = is_listed
        return result

    def branch_part(self) -> ast.Node:
        if self.equals != "in a condition" or not (self.at_assignment() and self.is_followed()):
            return self.statement()
        self.equals = ""
        node = self.statement()
        self.equals = "in a condition"
        return node

    def if_expression(self) -> ast.If:
        """Parses `IF(condition; …; …)`; an `IF` that is the whole else branch becomes a branch."""
        start = self.here()
        self.index += 2
        branches = [self.branch(start)]
        otherwise: tuple[ast.Node, ...] = ()
        depth = 1
        while self.take(TokenType.SEMICOLON) and not self.at(TokenType.R_PAREN):
            if not self.at_last_choice():
                otherwise = self.branch_parts()
                break
            inner = self.here()
            self.index += 2
            depth += 1
            branches.append(self.branch(inner))
        for _ in range(depth):
            self.expect(TokenType.R_PAREN, "')'")
        first, *further = branches
        return ast.If(self.since(start), first.condition, first.then, otherwise, tuple(further))

    def branch(self, start: SourceSpan) -> ast.Branch:
        """Parses `condition; then, …`; without values it is True, as in the published grammar."""
        condition = self.statement()
        self.check_condition(condition)
        if self.at(TokenType.R_PAREN):
            return ast.Branch(self.since(start), condition, (ast.Literal(self.since(start), True),))
        self.expect(TokenType.SEMICOLON, "';' or ')' after the condition")
        return ast.Branch(self.since(start), condition, self.branch_parts())

    def at_last_choice(self) -> bool:
        """Checks whether an `IF(…)` comes next, and then the end of the one that it is in."""
        if not self.at_word("IF") or not is_kind(self.ahead(), TokenType.L_PAREN):
            return False
        close = self.closings.get(self.index + 1)
        following = None if close is None else self.ahead(close + 1 - self.index)
        return is_kind(following, TokenType.R_PAREN)

    @cached_property
    def closings(self) -> dict[int, int]:
        """The place of each closing parenthesis, by the place of the opening one."""
        result: dict[int, int] = {}
        stack: list[int] = []
        for index, token in enumerate(self.tokens):
            if token.token_type == TokenType.L_PAREN:
                stack.append(index)
            elif token.token_type == TokenType.R_PAREN and stack:
                result[stack.pop()] = index
        return result
