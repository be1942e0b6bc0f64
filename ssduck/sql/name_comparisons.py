"""Finds the comparisons of entities' names with texts in raw SQL."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

from sqlglot import exp

from ssduck.errors import SourceSpan
from ssduck.sql.statement_trees import MAX_LENGTH, statement_trees

_ENTITIES = ("entities", "entities_history")
# A statement without a name and a text in quotes compares none; it need not be parsed.
_MAY_COMPARE = re.compile(r"\bname\b.*'|'.*\bname\b", re.IGNORECASE | re.DOTALL)


@dataclass(frozen=True)
class NameComparison:
    """A comparison of an entity's name with a text.

    Attributes:
        schema: the schema of the entity's table; None for that of the first world.
        text: the text.
        span: its place in the statement.
    """

    schema: str | None
    text: str
    span: SourceSpan


@lru_cache(maxsize=256)
def name_comparisons(sql: str) -> tuple[NameComparison, ...]:
    """Returns the comparisons of the column `entities.name` with texts by `=`, `<>` and IN.

    >>> [c.text for c in name_comparisons("SELECT z FROM entities e WHERE e.name = 'tabel'")]
    ['tabel']
    >>> name_comparisons("SELECT name FROM joints WHERE name = 'hinge'")
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
            if not isinstance(column, exp.Column) or column.name.lower() != "name":
                continue
            if column.table:
                table = tables.get(column.table.lower())
            else:
                table = next(iter(tables.values())) if len(tables) == 1 else None
            if table is None:
                continue
            for side in sides:
                if isinstance(side, exp.Literal) and side.is_string:
                    yield NameComparison(table.db or None, side.name, _span_of(side.name, sql))


def _tables_of(select: exp.Select) -> dict[str, exp.Table | None]:
    """Returns the tables of entities behind FROM by alias; None for other sources."""
    tables: dict[str, exp.Table | None] = {}
    clause = select.args.get("from_") or select.args.get("from")
    sources = [] if clause is None else [clause.this]
    sources += [join.this for join in select.args.get("joins") or []]
    for source in sources:
        is_entities = isinstance(source, exp.Table) and source.name.lower() in _ENTITIES
        tables[source.alias_or_name.lower()] = source if is_entities else None
    return tables


def _span_of(text: str, sql: str) -> SourceSpan:
    """Returns the place where a text first stands in a statement."""
    quoted = "'" + text.replace("'", "''") + "'"
    start = max(sql.find(quoted), 0)
    return SourceSpan(start, start + len(quoted))
