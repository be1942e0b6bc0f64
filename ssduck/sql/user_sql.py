"""Users' SQL: parsed, with parts of its text replaced, and with what its conditions compare."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, Literal, TypeAlias

import sqlglot
from sqlglot import exp
from sqlglot.dialects.dialect import Dialect
from sqlglot.errors import SqlglotError
from sqlglot.parsers.duckdb import DuckDBParser
from sqlglot.tokenizer_core import TokenType

from ssduck.errors import SourceSpan


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


# What a name is of: an entity, a link as in its model, a link with its entity, a joint; or a kind.
NameKind: TypeAlias = Literal["entity", "link", "full link", "joint", "kind", "kind of link"]
_COLUMNS: Mapping[str, Mapping[str, NameKind]] = {
    "entities": {"name": "entity", "kind": "kind"},
    "links": {"name": "link", "full_name": "full link", "kind": "kind of link"},
    "joints": {"name": "joint"},
}
# A statement without such a column and a text or a parameter compares none; it need not be parsed.
_NAME = r"\b(?:name|full_name|kind)\b"
_MAY_COMPARE = re.compile(rf"{_NAME}.*['?$]|['?$].*{_NAME}", re.IGNORECASE | re.DOTALL)


@dataclass(frozen=True)
class NameComparison:
    """A comparison of a name or a kind with a text."""

    schema: str | None  # the schema of the table; None for that of the first world
    kind: NameKind  # what the name is of
    # The text; or the parameter in its place, `name` of `$name` and 1 of `$1`.
    value: str | Parameter
    span: SourceSpan  # its place in the statement
    # The relations of other rows, and of the row that the name selects.
    relations: tuple[RelationOfRows, ...] = ()

    def text(self, parameters: Sequence[Any] | Mapping[str, Any] | None) -> str | None:
        """Returns the text that the name is compared with; None for no text."""
        found = bound_value(self.value, parameters)
        return found if isinstance(found, str) else None


@dataclass(frozen=True)
class Parameter:
    """A parameter of a statement, by its name or its number from 1."""

    name: str


def bound_value(value: Any, parameters: Sequence[Any] | Mapping[str, Any] | None) -> Any:
    """Returns a value, or that of a parameter; None if a parameter has none."""
    if not isinstance(value, Parameter):
        return value
    if isinstance(parameters, Mapping):
        return parameters.get(value.name)
    place = int(value.name) if value.name.isdecimal() else 0
    is_there = isinstance(parameters, Sequence) and 1 <= place <= len(parameters)
    return parameters[place - 1] if is_there else None  # type: ignore[index]


@dataclass(frozen=True)
class RelationOfRows:
    """A call of a relation of two rows."""

    name: str  # the relation, as it is written
    rows: tuple[str, str]  # the aliases of the rows
    is_past: bool  # whether they are of recorded ticks
    span: SourceSpan  # the place of its name


@lru_cache(maxsize=256)
def name_comparisons(sql: str) -> tuple[NameComparison, ...]:
    """Returns the comparisons of columns that are names or kinds with texts by `=`, `<>` and IN.

    >>> [c.value for c in name_comparisons("SELECT z FROM entities e WHERE e.name = 'tabel'")]
    ['tabel']
    >>> [c.kind for c in name_comparisons("SELECT position FROM joints WHERE name = 'hinge'")]
    ['joint']
    >>> name_comparisons("SELECT name FROM contacts WHERE name = 'hinge'")
    ()
    """
    if len(sql) > MAX_LENGTH or not _MAY_COMPARE.search(sql):
        return ()
    comparisons: list[NameComparison] = []
    for statement in statement_trees(sql):
        for select in statement.find_all(exp.Select):
            comparisons += _comparisons_in(select, sql)
    return tuple(comparisons)


def _comparisons_in(select: exp.Select, sql: str) -> Iterator[NameComparison]:
    """Yields the comparisons in the clauses of one SELECT, without those of nested ones."""
    tables = _tables_of(select)
    for node in select.find_all(exp.EQ, exp.NEQ, exp.In):
        if node.find_ancestor(exp.Select) is not select:
            continue
        sides = [node.this, *node.expressions, node.args.get("expression")]
        for column in sides:
            if not isinstance(column, exp.Column):
                continue
            if column.table:
                table = tables.get(column.table.lower())
            else:
                table = next(iter(tables.values())) if len(tables) == 1 else None
            kind = None if table is None else _columns_of(table).get(column.name.lower())
            if table is None or kind is None:
                continue
            for side in sides:
                value = _value_of(side, sql)
                if value is not None:
                    row = column.table if isinstance(node, exp.EQ) else ""
                    relations = tuple(_relations_of(row, node, select, sql)) if row else ()
                    yield NameComparison(table.db or None, kind, *value, relations)


def _relations_of(
    row: str, condition: exp.Expr, select: exp.Select, sql: str
) -> Iterator[RelationOfRows]:
    """Yields the calls in a SELECT of relations of other rows and of one that it selects."""
    if condition.find_ancestor(exp.Or, exp.Not) is not None:
        return
    tables = _tables_of(select)
    for call in select.find_all(exp.Anonymous, exp.Contains):
        is_text = isinstance(call, exp.Contains)
        sides = [call.this, call.expression] if is_text else call.expressions[:2]
        match [side.name for side in sides if isinstance(side, exp.Column) and not side.table]:
            case [first, second] if second.lower() == row.lower():
                found = tables.get(first.lower()), tables.get(second.lower())
                is_past = any(one and one.name.lower().endswith("_history") for one in found)
                name = "contains" if is_text else call.name
                if None not in found:
                    yield RelationOfRows(name, (first, second), is_past, span_of(name, sql))


def _value_of(side: exp.Expr | None, sql: str) -> tuple[str | Parameter, SourceSpan] | None:
    """Returns a text or a parameter, and its place; None for another side of a comparison."""
    if isinstance(side, exp.Literal) and side.is_string:
        return side.name, span_of("'" + side.name.replace("'", "''") + "'", sql)
    parameter = parameter_of(side, sql)
    if parameter is None:
        return None
    is_named = isinstance(side, exp.Placeholder) and side.this
    return parameter, span_of(f"${parameter.name}" if is_named else "?", sql)


def parameter_of(side: exp.Expr | None, sql: str) -> Parameter | None:
    """Returns the parameter that a part of a statement is; None for another part."""
    if not isinstance(side, exp.Placeholder | exp.Parameter):
        return None
    if side.this:
        return Parameter(side.name)
    # The tree does not tell which one of several `?` it is.
    return Parameter("1") if sql.count("?") == 1 else None


def _tables_of(select: exp.Select) -> dict[str, exp.Table | None]:
    """Returns the tables with names behind FROM by alias; None for other sources."""
    tables: dict[str, exp.Table | None] = {}
    clause = select.args.get("from_") or select.args.get("from")
    sources = [] if clause is None else [clause.this]
    sources += [join.this for join in select.args.get("joins") or []]
    for source in sources:
        has_names = isinstance(source, exp.Table) and bool(_columns_of(source))
        tables[source.alias_or_name.lower()] = source if has_names else None
    return tables


def _columns_of(table: exp.Table) -> Mapping[str, NameKind]:
    return _COLUMNS.get(table.name.lower().removesuffix("_history"), {})


def span_of(part: str, sql: str) -> SourceSpan:
    """Returns the place where a part first stands in a statement."""
    start = max(sql.find(part), 0)
    return SourceSpan(start, start + len(part))
