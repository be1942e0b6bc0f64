"""Parses users' SQL, and replaces parts of its text: the rest stays as the user wrote it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise

import sqlglot
from sqlglot import exp
from sqlglot.dialects.dialect import Dialect
from sqlglot.errors import SqlglotError
from sqlglot.parsers.duckdb import DuckDBParser
from sqlglot.tokenizer_core import TokenType


@dataclass(frozen=True)
class Edit:
    """A replacement of a part of a statement; the parts that are inserted are empty."""

    start: int
    end: int
    text: str


def edited(sql: str, edits: Iterable[Edit]) -> str:
    """Returns a statement with parts of it replaced."""
    parts, position = [], 0
    for edit in sorted(set(edits), key=lambda edit: (edit.start, edit.end, edit.text)):
        parts += [sql[position : edit.start], edit.text]
        position = edit.end
    return "".join((*parts, sql[position:]))


def numbered(sql: str) -> str:
    """Returns a statement with numbers in place of the question marks of its parameters.

    >>> numbered("SELECT * FROM entities WHERE z > ? AND name <> ?")
    'SELECT * FROM entities WHERE z > $1 AND name <> $2'
    """
    marks = (t for t in sqlglot.tokenize(sql, dialect="duckdb") if t.text == "?")
    edits = []
    for number, mark in enumerate(marks, 1):
        if mark.token_type != TokenType.PLACEHOLDER or sql[mark.end + 1 : mark.end + 2].isalnum():
            return sql  # `?1` is the first parameter
        edits.append(Edit(mark.start, mark.end + 1, f"${number}"))
    return edited(sql, edits)


def with_parameters(sql: str, value: Callable[[str], str]) -> str:
    """Returns a statement with expressions in place of its parameters, which have names.

    >>> with_parameters("SELECT * FROM entities WHERE z > $low", lambda name: f"(SELECT {name})")
    'SELECT * FROM entities WHERE z > (SELECT low)'
    """
    tokens = sqlglot.tokenize(sql, dialect="duckdb")
    edits = [
        Edit(sign.start, name.end + 1, value(name.text))
        for sign, name in pairwise(tokens)
        if sign.token_type == TokenType.PARAMETER and name.start == sign.end + 1
    ]
    return edited(sql, edits)


# Longer texts are not parsed: sqlglot's time grows with them.
MAX_LENGTH = 20_000
_DIALECT = Dialect.get_or_raise("duckdb")


class _Parser(DuckDBParser):
    """A parser that does not warn of statements that it does not know, such as EXPLAIN.

    The column `force` of contacts is no word of DuckDB's, but one of sqlglot's.
    """

    ID_VAR_TOKENS = DuckDBParser.ID_VAR_TOKENS | {TokenType.FORCE}

    def _warn_unsupported(self) -> None:
        pass


def statement_trees(sql: str) -> list[exp.Expr]:
    """Returns the trees of the statements of a text; none if sqlglot cannot parse it.

    >>> [type(tree).__name__ for tree in statement_trees("SELECT 1; EXPLAIN SELECT 2")]
    ['Select', 'Command']
    >>> statement_trees("SELECT (")
    []
    """
    if len(sql) > MAX_LENGTH:
        return []
    try:
        trees = _Parser(dialect=_DIALECT).parse(_DIALECT.tokenize(sql), sql)
    except (SqlglotError, RecursionError):
        return []
    return [tree for tree in trees if tree is not None]
