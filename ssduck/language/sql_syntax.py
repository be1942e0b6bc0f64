"""Parses forms that come from SQL: CASE, IN (…), LIKE, BETWEEN, IS NULL, count(*).

LIKE and IS NULL become operators of their own; all others become existing nodes.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

from sqlglot.tokenizer_core import Token, TokenType

from ssduck.errors import SourceSpan
from ssduck.language import ast
from ssduck.language.builtins import AGGREGATES
from ssduck.language.sql_suggestions import HABITS, NUMPY
from ssduck.language.tokens import (
    CLAUSES,
    LEVEL_OF,
    OPERATOR_WORDS,
    Cursor,
    is_kind,
    is_word,
    span_of,
)

# The result forms whose names are words of the grammar, so in any case.
FORMS = frozenset(("dict", "dictionary", "list", "val", "value"))
_CONDITIONS = ("LIKE", "BETWEEN", "IS")
RELATIONAL = ("<", "<=", ">", ">=")
# The words that may follow a source's alias.
_BEHIND_SOURCE = (
    *("WHERE", "START", "CONNECT", "GROUP", "HAVING", "ORDER", "LIMIT", "OFFSET", "AS"),
    *("JOIN", "INNER", "CROSS", "ON"),
)
CHAIN_OF_EQUALS = "this compares True or False; write x = y AND y = z"
# A list of numbers of which all but the first have signs, as NumPy prints an array.
_PRINTED_ARRAY = re.compile(r"\[\s*[-+]?[\d.]+(?:e[-+]?\d+)?(?:\s+[-+][\d.]+(?:e[-+]?\d+)?)+\s*\]")
_EQUALITIES = ("==", "!=")
_BEGINS = (TokenType.VAR, TokenType.NUMBER, TokenType.STRING)
_SIGNS = (TokenType.DASH, TokenType.PLUS)
# Messages quote shorter powers.
MAX_SPELLED = 60


def numbered_column(key: ast.Node, items: Sequence[ast.Node]) -> ast.Node:
    """Returns the second column for the 2 in `ORDER BY 2`; other keys unchanged."""
    number = key.value if isinstance(key, ast.Literal) else None
    if type(number) is not int or not 1 <= number <= len(items):
        return key
    match items[number - 1]:
        case ast.Assignment():
            return key
        case ast.Call(name="to", arguments=(value, _)):
            return value
        case column:
            return column


def _is_written_out(value: ast.Node) -> bool:
    """Checks whether a value depends on nothing."""
    kinds = (ast.Literal, ast.ListLiteral, ast.Unary, ast.Binary, ast.OperatorChain, ast.Assignment)
    return all(isinstance(part, kinds) for part in value.walk())


def _is_truth_value(node: ast.Node) -> bool:
    return isinstance(node, ast.Literal) and isinstance(node.value, bool)


class SqlForms(Cursor):
    """The part of the parser for forms that come from SQL."""

    # Where in a query `=` compares: "in a condition", "in a value" as SELECT has; "" elsewhere.
    equals = ""
    # Whether a comma may follow a query's result form.
    is_listed = False

    def __init__(self, text: str, tokens: list[Token]) -> None:
        super().__init__(text, tokens)
        # The comparisons that a part consists of: `a < b < c` of two.
        self.comparisons: dict[ast.Node, list[Any]] = {}

    @abstractmethod
    def statement(self) -> ast.Node:
        """Returns a statement."""

    @abstractmethod
    def expression(self) -> ast.Node:
        """Returns an expression."""

    @abstractmethod
    def operation(self, loosest: int) -> ast.Node:
        """Operators of the level `loosest` and tighter ones."""

    def condition(self) -> ast.Node:
        """Returns an expression in which `=` compares."""
        before, self.equals = self.equals, "in a condition"
        node = self.expression()
        self.equals = before
        return node

    def group_key(self) -> ast.Node:
        """Returns a key of GROUP BY or ORDER BY, in which `=` compares."""
        before, self.equals = self.equals, "in a value"
        node = self.expression()
        self.equals = before
        return node

    # -- operators ------------------------------------------------------------------------

    def condition_level(self) -> int:
        """Returns the level of `LIKE`, `BETWEEN`, `IS` and `NOT IN`; -1 if none is next."""
        negated = is_word(self.ahead(), "IN", *_CONDITIONS[:2])
        is_next = self.at_word(*_CONDITIONS) or (self.at_word("NOT") and negated)
        return LEVEL_OF["IN"] if is_next else -1

    def condition_operator(self, start: SourceSpan, left: ast.Node) -> ast.Node:
        """Returns the condition that `LIKE`, `BETWEEN`, `IS` or `NOT IN` makes of its left side."""
        is_not = self.take_words("NOT")
        if self.take_words("IS"):
            is_not = self.take_words("NOT")
            if not self.take_words("NULL"):
                self.fail("expected NULL (write == to compare)")
            node: ast.Node = ast.Unary(self.since(start), "IS NULL", left)
        elif self.take_words("BETWEEN"):
            low = self.operation(LEVEL_OF["+"])
            self.expect_word("AND")
            high = self.operation(LEVEL_OF["+"])
            place = self.since(start)
            above, below = ast.Binary(place, ">=", left, low), ast.Binary(place, "<=", left, high)
            node = ast.Binary(place, "AND", above, below)
        elif self.take_words("IN"):
            right = self.members()
            node = ast.Binary(self.since(start), "IN", left, right)
        else:
            self.expect_word("LIKE")
            right = self.operation(LEVEL_OF["IN"] + 1)
            self.check_pattern(right)
            node = ast.Binary(self.since(start), "LIKE", left, right)
        return ast.Unary(self.since(start), "NOT", node) if is_not else node

    def members(self) -> ast.Node:
        """Returns the right side of IN: `(1, 2)` is a list."""
        start = self.here()
        if not self.at(TokenType.L_PAREN):
            right = self.operation(LEVEL_OF["IN"] + 1)
        elif self._is_list():
            self.index += 1
            is_empty = self.at(TokenType.R_PAREN)
            items = () if is_empty else self.separated(self.statement)
            self.expect(TokenType.R_PAREN, "')'")
            return ast.ListLiteral(self.since(start), items)
        else:
            right = self.operation(LEVEL_OF["IN"] + 1)
            if isinstance(right.operand if isinstance(right, ast.Unary) else right, ast.Literal):
                return ast.ListLiteral(self.since(start), (right,))
        if isinstance(right, ast.Query) and right.adapter is None and right.items:
            message = "the query behind IN yields dicts; for their values write AS list"
            self.add_suspicion(right.span, message)
        return right

    def _is_list(self) -> bool:
        """Checks whether the parentheses that come next have commas in them, or nothing."""
        if is_word(self.ahead(), "SELECT"):
            return False
        depth = offset = 0
        while (token := self.ahead(offset)) is not None:
            if token.token_type in (TokenType.L_PAREN, TokenType.L_BRACKET, TokenType.L_BRACE):
                depth += 1
            elif token.token_type in (TokenType.R_PAREN, TokenType.R_BRACKET, TokenType.R_BRACE):
                depth -= 1
                if depth == 0:
                    return offset == 1
            elif depth == 1 and token.token_type == TokenType.COMMA:
                return True
            offset += 1
        return False

    def comparison(self, row: ast.OperandRow, places: Sequence[SourceSpan]) -> ast.Node:
        """Returns a comparison; `a < b <= c` is `a < b AND b <= c`."""
        parts: list[Any] = []
        # A comparison in parentheses begins behind its first token; it is a value like others.
        first, *others = (
            (
                self.comparisons.get(operand, []) if operand.span.start == place.start else [],
                operand,
            )
            for operand, place in zip(row.operands, places, strict=True)
        )
        parts += first[0]
        left = parts[-1].right if parts else first[1]
        for sign, (inner, operand) in zip(row.operators, others, strict=True):
            right = inner[0].left if inner else operand
            parts += [
                ast.Binary(SourceSpan(left.span.start, right.span.end), sign, left, right),
                *inner,
            ]
            left = inner[-1].right if inner else operand
        if len(parts) == 1:
            parts = [node := row.node()]
        else:
            joined = ast.OperandRow(places[0].start, parts[0], parts[0].span.end)
            for part in parts[1:]:
                joined.add("AND", part, part.span.end)
            node = joined.node()
        self.comparisons[node] = parts
        return node

    def check_equality(self, row: ast.OperandRow, places: Sequence[SourceSpan]) -> None:
        """Reports `a == b == c`, which compares whether a equals b with c."""
        if row.operators[0] not in _EQUALITIES or any(map(_is_truth_value, row.operands)):
            return
        is_chain = len(row.operators) > 1 or any(
            isinstance(operand, ast.Binary)
            and operand.operator in _EQUALITIES
            and operand.span.start == place.start  # not in brackets
            and not any(map(_is_truth_value, operand.children()))
            for operand, place in zip(row.operands, places, strict=True)
        )
        if is_chain:
            message = "this compares True or False; write a == b AND b == c, or (a == b) == c"
            span = SourceSpan(row.start, self.end())
            self.add_suspicion(span, message, is_grave=True)

    def check_sign(self, row: ast.OperandRow, start: SourceSpan, exponent: SourceSpan) -> None:
        """Reports `-x ^ 2`, which is `(-x) ^ 2`, and `x ^ 3 ^ 2`, which is `(x ^ 3) ^ 2`."""
        base, negated = row.operands[-1], self.text[start.start : row.ends[-1]]
        unsigned, is_negative = negated, False
        while isinstance(base, ast.Unary) and unsigned.startswith(("-", "+")):
            is_negative ^= base.operator == "-"
            base, unsigned = base.operand, unsigned[1:].lstrip()
        if not is_negative and len(row.operators) != 1:
            return  # a power of a power of a power is told of where it begins
        before, power = self.text[row.start : start.start], self.text[exponent.start : self.end()]
        if len(before) + len(negated) + len(power) > MAX_SPELLED:
            before, negated, unsigned, power = "", "-x", "x", "n"
            if not is_negative:
                before, negated = "x^", "m"
        is_this = f"({before}{negated})^{power}"
        other = f"-({unsigned}^{power})" if is_negative else f"({negated}^{power})"
        span = self.since(start) if is_negative else SourceSpan(row.start, self.end())
        message = f"this is {is_this}; write it so, or {before}{other}"
        self.add_suspicion(span, message, is_grave=True)

    def check_list(self, span: SourceSpan) -> None:
        """Reports `[1 -2 -3]`, a list of one number: NumPy prints arrays without commas."""
        if _PRINTED_ARRAY.fullmatch(self.text, span.start, span.end):
            self.add_suspicion(span, f"this is a list of one number; {NUMPY}", is_grave=True)

    # -- CASE -----------------------------------------------------------------------------

    def begins_case(self) -> bool:
        """Checks whether CASE comes next, and not a variable of that name."""
        if not self.at_word("CASE"):
            return False
        token = self.ahead()
        if token is None or token.token_type not in _BEGINS:
            return False
        words = (*CLAUSES, *OPERATOR_WORDS, *_CONDITIONS)
        return token.token_type != TokenType.VAR or token.text.upper() not in words

    def case(self) -> ast.Node:
        """Parses `CASE WHEN … THEN … ELSE … END` or `CASE x WHEN value THEN …` as an IF."""
        start = self.here()
        self.expect_word("CASE")
        compared = None if self.at_word("WHEN") else self.expression()
        if not self.at_word("WHEN"):
            self.fail("expected WHEN")
        branches: list[tuple[ast.Node, ast.Node]] = []
        while self.take_words("WHEN"):
            condition = self.condition() if compared is None else self.expression()
            if compared is not None:
                condition = ast.Binary(condition.span, "==", compared, condition)
            self.expect_word("THEN")
            branches.append((condition, self.expression()))
        if not self.take_words("ELSE"):
            self.fail("expected ELSE (a CASE without it would have no value)")
        otherwise = self.expression()
        self.expect_word("END")
        place = self.since(start)
        first, *further = (ast.Branch(place, condition, (then,)) for condition, then in branches)
        return ast.If(place, first.condition, first.then, (otherwise,), tuple(further))

    # -- calls ----------------------------------------------------------------------------

    def aggregate_argument(self, name: str) -> ast.Node | None:
        """Returns the argument of `count(*)` or `count(DISTINCT x)`; None if it is neither."""
        if self.at(TokenType.STAR) and is_kind(self.ahead(), TokenType.R_PAREN):
            if name.lower() != "count":
                self.fail("expected an expression (only count takes *)")
            star = self.here()
            self.index += 1
            return ast.Literal(star, 1)
        following = self.ahead()
        begins = following is not None and following.token_type in _BEGINS
        begins = begins or self._is_sign_ahead()
        if name.lower() in AGGREGATES and self.at_word("DISTINCT") and begins:
            start = self.here()
            self.index += 1
            argument = self.statement()
            return ast.Call(self.since(start), "uniq", (argument,), start)
        return None

    def _is_sign_ahead(self) -> bool:
        """Checks whether a sign of the next value follows: `x -1`, but not `x - 1` or `x-1`."""
        word, sign, value = self.token, self.ahead(), self.ahead(2)
        if word is None or sign is None or value is None or sign.token_type not in _SIGNS:
            return False
        return sign.start > word.end + 1 and value.start == sign.end + 1

    # -- clauses --------------------------------------------------------------------------

    def take_distinct(self) -> bool:
        """Takes DISTINCT after SELECT, unless it is a name or a call."""
        word, token = self.token, self.ahead()
        if word is None or token is None or not self.at_word("DISTINCT"):
            return False
        if is_word(token, "FROM", "AS", *OPERATOR_WORDS[:3], "IN"):
            return False
        has_space = token.start > word.end + 1
        opens = token.token_type in (TokenType.L_PAREN, TokenType.L_BRACKET) and has_space
        opens = opens or self._is_sign_ahead()
        is_star = token.token_type == TokenType.STAR and is_word(self.ahead(2), "FROM")
        if token.token_type not in _BEGINS and not opens and not is_star:
            return False
        self.index += 1
        return True

    def item(self) -> ast.Node:
        """Returns a selected value; `z AS height` is `to(z, 'height')`."""
        start = self.here()
        if is_kind(self.ahead(), TokenType.DOT) and is_kind(self.ahead(2), TokenType.STAR):
            name = self.expect_name("a source's name")  # `k.*` is its element, as `*` is
            self.index += 2
            return ast.This(self.since(start), name.text)
        return self.named(start, self.expression())

    def named(self, start: SourceSpan, node: ast.Node) -> ast.Node:
        """Returns a selected value with the name behind AS, if there is one."""
        if not self.take_words("AS"):
            return node
        if self.at(TokenType.STRING):
            self.fail("expected a column's name (without quotes)")
        name = self.expect_name("a column's name")
        place = self.since(start)
        return ast.Call(place, "to", (node, ast.Literal(span_of(name), name.text)), place)

    def source_alias(self, *, is_listed: bool) -> str | None:
        """Returns the alias in `FROM kitchen k` and `FROM kitchen AS k`; None if there is none."""
        second = self.ahead(2)
        if self.at_word("AS"):
            is_followed = is_word(second, *_BEHIND_SOURCE) or (
                is_kind(second, TokenType.COMMA) and not is_listed
            )
            if not is_followed:
                return None
            self.index += 1
            if self.token is not None and self.token.text.lower() in FORMS:
                self.fail("expected a source's name (the result form stands behind all clauses)")
            return self.expect_own_name("a source's name").text
        token = self.token
        if not is_kind(token, TokenType.VAR) or token is None:
            return None
        word = token.text.upper()
        if word in CLAUSES or word in OPERATOR_WORDS or word in HABITS:
            return None
        following = self.ahead()
        ends = following is None or following.token_type in (
            TokenType.COMMA,
            TokenType.SEMICOLON,
            TokenType.R_PAREN,
            TokenType.R_BRACKET,
        )
        if not (ends or is_word(following, *_BEHIND_SOURCE, *HABITS)):
            return None
        return self.expect_own_name("a source's name").text

    def limits(self, *, may_be_followed: bool) -> tuple[ast.Node | None, ast.Node | None]:
        """Returns the parts of LIMIT and OFFSET, in either order; None for one that is missing."""
        limit = offset = None
        while self.at_word("LIMIT", "OFFSET"):
            if limit is None and self.take_words("LIMIT"):
                limit = self.expression()
            elif offset is None and self.take_words("OFFSET"):
                offset = self.expression()
                if self.at_word("ROW", "ROWS"):
                    self.fail("expected no ROWS (write OFFSET n)")
            else:
                self.fail("expected LIMIT or OFFSET only once")
        if limit is not None and not may_be_followed and self.at(TokenType.COMMA):
            self.fail("expected OFFSET (write LIMIT n OFFSET m to skip the first m rows)")
        return limit, offset

    def form_name(self) -> str:
        """Returns the name of a result form; that of a basic one in any case."""
        if self.at(TokenType.STRING):
            self.fail("expected the name of a result form (without quotes)")
        name = self.expect_name("the name of a result form").text
        return name.lower() if name.lower() in FORMS else name

    def with_qualified_names(self, query: ast.Query) -> ast.Query:
        """Returns a query in which `a.id` is a `QualifiedName` wherever `a` is an alias."""
        aliases = {s.alias for s in query.sources if s.alias is not None}
        aliases -= {
            s.value.name for s in query.sources if isinstance(s.value, ast.Name | ast.TimeIndex)
        }

        def change(node: ast.Node) -> ast.Node | None:
            if isinstance(node, ast.Source):
                return node
            match node:
                case ast.Index(
                    base=ast.Name(name=name), indices=(ast.Literal(value=str() as key) as index,)
                ):
                    if name in aliases and self.text[index.span.start] not in "'\"":
                        return ast.QualifiedName(node.span, name, key, node)
            return None

        changed = query.replaced(change) if aliases else query
        assert isinstance(changed, ast.Query)
        return changed

    # -- suspicions -----------------------------------------------------------------------

    def add_suspicion(self, span: SourceSpan, message: str, *, is_grave: bool = False) -> None:
        """Records a probable mistake."""
        self.suspicions.append(ast.Suspicion(span, message, is_grave))

    def check_condition(self, node: ast.Node | None) -> None:
        """Reports a condition that assigns a constant, and so is the same for all rows."""
        match node:
            case (
                ast.Binary(operator="AND" | "OR" | "XOR")
                | ast.OperatorChain(operators=("AND" | "OR" | "XOR", *_))
            ):
                for side in node.children():
                    self.check_condition(side)
                self._check_constants(list(node.children()))
            case ast.Assignment(
                value=ast.Binary(operator="AND" | "OR") as value, value_start=int()
            ):
                self._check_constants(list(value.children())[1:])  # the first is compared
            case ast.Unary(operator="NOT", operand=operand):
                self.check_condition(operand)
            case ast.Assignment(name=name, value=value) if _is_written_out(value):
                self.add_suspicion(node.span, f"this sets the variable {name}; write == to compare")

    def _check_constants(self, conditions: Sequence[ast.Node]) -> None:
        """Reports conditions that are texts or numbers: `id = 'can' OR 'cup'`."""
        for node in conditions:
            if isinstance(node, ast.Literal) and not isinstance(node.value, bool):
                message = "this condition is the same for all rows; write x IN (a, b)"
                self.add_suspicion(node.span, message)

    def check_pattern(self, node: ast.Node) -> None:
        """Reports the pattern `'cup*'` of LIKE, which is of shells."""
        pattern = node.value if isinstance(node, ast.Literal) else None
        if isinstance(pattern, str) and "*" in pattern and not {"%", "_"} & set(pattern):
            message = "in a pattern of LIKE, % stands for any letters, and * for itself"
            self.add_suspicion(node.span, message)

    def check_texts(self, node: ast.Node | None) -> None:
        """Reports a condition on two texts, one in double quotes: it is the same for all rows."""
        if node is None or isinstance(node, ast.Query):
            return
        match node:
            case ast.Binary(left=ast.Literal(value=str()) as left, right=right):
                is_text = isinstance(right, ast.Literal) and isinstance(right.value, str)
                is_list = isinstance(right, ast.ListLiteral) and _is_written_out(right)
                for side in (left, right) if is_text or is_list else ():
                    if self.text[side.span.start] == '"':
                        name = self.text[side.span.start + 1 : side.span.end - 1]
                        self.add_suspicion(
                            side.span,
                            f'"{name}" is a text; a name is written without quotes: {name}',
                        )
                        return
        for child in node.children():
            self.check_texts(child)

    def check_keys(self, query: ast.Query) -> None:
        """Reports keys that are numbers and refer to no column, and those that are texts."""
        keys = [("ORDER BY", key.value) for key in query.order]
        keys += [("GROUP BY", node) for node in query.group]
        for clause, node in keys:
            is_text = self.text.startswith("'", node.span.start)  # of "z", the linter tells
            if isinstance(node, ast.Literal) and (type(node.value) is int or is_text):
                what = "a text" if is_text else "a number"
                self.add_suspicion(
                    node.span, f"{clause} {what} is the same for all rows; write the column"
                )
