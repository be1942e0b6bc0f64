"""Queries of all pairs that a search finds: their rows are looked up without a statement.

`SELECT id(a.this), id(b.this) FROM a = kitchen, b = kitchen WHERE collides(a.this, b.this)` asks
for the pairs that the narrow phase finds at once, and for columns of their entities. The joins
of DuckDB would take several times as long in a small scene. The SQL of such a plan remains the
definition of its rows, and runs where the search refuses its distance.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlglot import exp

from ssduck.schema import TABLES
from ssduck.sql.relations.geometry_query import PairSearch

_COLUMNS = frozenset(column.name for column in TABLES["entities"].columns)
_COMPARED = ("name", "id")
_COMPARE: Mapping[type[exp.Expr], Callable[[Any, Any], Any]] = {
    exp.LT: operator.lt,
    exp.LTE: operator.le,
    exp.GT: operator.gt,
    exp.GTE: operator.ge,
    exp.EQ: operator.eq,
    exp.NEQ: operator.ne,
}


@dataclass(frozen=True)
class PairColumn:
    """A column of one of the two entities of a pair."""

    side: int  # 0 for the entity of the first source, 1 for that of the second
    name: str  # the column of the table of entities


@dataclass(frozen=True)
class NameComparison:
    """A condition on the names or the ids of the two entities of a pair: `a.name < b.name`."""

    compare: Callable[[Any, Any], Any]  # the operator, of arrays
    sides: tuple[int, int]  # the sides of the two names
    column: str = "name"  # `name` or `id`


@dataclass(frozen=True)
class PairLookup:
    """The rows of a query of all pairs that a search finds, in ascending order of both ids."""

    schema: str  # the world
    search: PairSearch  # the search; its pairs are exact
    distance: float | str  # the distance of the search, m, or the name of the parameter that has it
    comparisons: tuple[NameComparison, ...]  # the conditions on names
    columns: tuple[PairColumn, ...]  # the columns of a row


@dataclass(frozen=True)
class JoinedPairs:
    """A search whose pairs are joined with two sources."""

    schema: str  # the world
    search: PairSearch  # the search
    distance: exp.Expr  # the distance of the search, m, in SQL
    condition: exp.Expr  # the condition on a row of the sources and of the pairs


def pair_lookup(
    pairs: JoinedPairs,
    tables: Sequence[str],
    conditions: Sequence[exp.Expr],
    columns: Sequence[exp.Expr],
) -> PairLookup | None:
    """Returns the look-up that replaces a SELECT; None if it does more than look up."""
    distance = _constant(pairs.distance)
    comparisons = [_comparison(c, tables) for c in conditions if c is not pairs.condition]
    selected = [_column(column, tables) for column in columns]
    if not pairs.search.is_exact or distance is None or None in comparisons or None in selected:
        return None
    return PairLookup(
        pairs.schema,
        pairs.search,
        distance,
        tuple(filter(None, comparisons)),
        tuple(filter(None, selected)),
    )


def _constant(distance: exp.Expr) -> float | str | None:
    """Returns a distance in SQL as a number, or the name of its parameter."""
    while isinstance(distance, exp.Cast | exp.Paren):
        if isinstance(distance, exp.Cast) and not distance.is_type("double"):
            return None
        distance = distance.this
    match distance:
        case exp.Parameter() | exp.Placeholder(this=str()):
            return distance.name
        case exp.Literal(is_string=False):
            return float(distance.this)
    return None


def _comparison(condition: exp.Expr, tables: Sequence[str]) -> NameComparison | None:
    """Returns a condition in SQL as a comparison of the two names or ids."""
    compare = _COMPARE.get(type(condition))
    if compare is None:
        return None
    left, right = (_column(side, tables) for side in (condition.this, condition.expression))
    if left is None or right is None or left.name != right.name or left.name not in _COMPARED:
        return None
    return NameComparison(compare, (left.side, right.side), left.name)


def _column(column: exp.Expr, tables: Sequence[str]) -> PairColumn | None:
    """Returns a column in SQL as that of one of the two entities."""
    if isinstance(column, exp.Column) and column.table in tables and column.name in _COLUMNS:
        return PairColumn(list(tables).index(column.table), column.name)
    return None
