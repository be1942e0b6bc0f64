"""Finds EXISTS whose subquery needs no more of the row around it than which entity it is.

`EXISTS (SELECT 1 FROM entities b WHERE collides(a, b))` is evaluated by DuckDB for all rows of `a`
that may differ. Once its relation is a join with the pairs of the tick, it may as well say whether
`a.id` is among the first entities of these pairs, which are found once.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from sqlglot import exp
from sqlglot.tokenizer_core import Token, TokenType

# The parts of a subquery that do nothing but choose rows.
_PARTS = frozenset(("expressions", "from_", "joins", "where"))


@dataclass(frozen=True)
class ExistsCondition:
    """An EXISTS in a statement.

    Attributes:
        start: the index of its first character.
        list_start: the index at which its subquery begins.
        list_end: the index of the subquery's FROM.
        end: the index after its closing bracket.
        reads_outer: whether the subquery reads columns of the entity around it.
    """

    start: int
    list_start: int
    list_end: int
    end: int
    reads_outer: bool


@dataclass(frozen=True)
class NamedColumns:
    """The names that a subquery sees, in small letters.

    Attributes:
        sources: the columns of its own sources, by name; None if they are unknown.
        outer: the name of the entity around it.
        outer_columns: the columns of that.
        is_outer_read: whether the relation itself reads columns of it.
    """

    sources: Mapping[str, Collection[str] | None]
    outer: str
    outer_columns: Collection[str]
    is_outer_read: bool


def exists_condition(
    select: exp.Select, call: exp.Expr, place: int, tokens: Sequence[Token], names: NamedColumns
) -> ExistsCondition | None:
    """Returns the EXISTS of a subquery; None if it is another, or needs more of what is around it.

    Args:
        select: the subquery.
        call: the relation of an entity of the subquery and the one around it.
        place: the index of the call.
        tokens: the tokens of the statement.
        names: what the names in the subquery are.
    """
    if not isinstance(select.parent, exp.Exists) or select.parent.find_ancestor(exp.Join):
        return None
    parts = {name for name, value in select.args.items() if value}
    is_plain = parts <= _PARTS and all(map(_is_plain, select.expressions))
    if not is_plain or sum(1 for _ in select.find_all(exp.Query)) > 1:
        return None
    reads_outer = _reads_outer(_columns_of_conditions(select, call), names)
    written = _written(tokens, place)
    return (
        None if reads_outer is None or written is None else ExistsCondition(*written, reads_outer)
    )


def _is_plain(selected: exp.Expr) -> bool:
    """Checks whether a selected value neither adds nor removes rows, as an aggregate does."""
    return isinstance(selected, exp.Literal | exp.Column | exp.Star)


def _columns_of_conditions(select: exp.Select, call: exp.Expr) -> Iterator[exp.Column]:
    """Yields the columns in a subquery, but for those that are selected or arguments of a call."""
    for column in select.find_all(exp.Column):
        around: exp.Expr | None = column
        while around is not None and around is not call and around.parent is not select:
            around = around.parent
        if around is not call and not any(around is selected for selected in select.expressions):
            yield column


def _reads_outer(columns: Iterator[exp.Column], names: NamedColumns) -> bool | None:
    """Checks whether columns are of the entity around a subquery; None if one may be of others.

    If some are, that entity becomes a source of the subquery, so that columns without a table would
    be ambiguous.
    """
    reads_outer, has_bare = names.is_outer_read, False
    for column in columns:
        table, name = column.table.lower(), column.name.lower()
        if column.args.get("db"):
            return None
        if table == names.outer and table not in names.sources and name in names.outer_columns:
            reads_outer = True
        elif not table and any(name in (known or ()) for known in names.sources.values()):
            has_bare = True
        elif (table or name) not in names.sources:
            return None
    return None if reads_outer and has_bare else reads_outer


def _written(tokens: Sequence[Token], place: int) -> tuple[int, int, int, int] | None:
    """Returns where the innermost EXISTS around a place is written; None if that is not known.

    These are its start, that of its subquery, the subquery's FROM, and its end.
    """
    found = None
    opened: list[tuple[bool, int]] = []
    for number, (before, token) in enumerate(pairwise(tokens)):
        if token.token_type == TokenType.L_PAREN:
            opened.append((before.token_type == TokenType.EXISTS, number))
        elif token.token_type == TokenType.R_PAREN and opened:
            is_exists, first = opened.pop()
            if is_exists and tokens[first].start < place < token.start:
                found = first, number + 1
                break
    if found is None:
        return None
    first, last = found
    inside = tokens[first + 2 : last]
    clauses = [t for t in inside if t.token_type in (TokenType.SELECT, TokenType.FROM)]
    kinds = [clause.token_type for clause in clauses]
    if kinds not in ([TokenType.FROM], [TokenType.SELECT, TokenType.FROM]):
        return None
    return tokens[first].start, inside[0].start, clauses[-1].start, tokens[last].end + 1
