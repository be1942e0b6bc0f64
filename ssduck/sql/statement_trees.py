"""Parses users' SQL with sqlglot, without its warnings."""

from __future__ import annotations

from sqlglot import exp
from sqlglot.dialects.dialect import Dialect
from sqlglot.errors import SqlglotError
from sqlglot.parsers.duckdb import DuckDBParser
from sqlglot.tokenizer_core import TokenType

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
