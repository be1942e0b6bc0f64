"""Conditions on episodes: expressions of SQL over the columns of the manifest, and nothing else."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import pyarrow as pa
import sqlglot
from sqlglot import exp

from ssduck.errors import ArgumentError, nearest
from ssduck.formatting import short_repr

_TEXTS = "a text is in single quotes: task = 'pick'"


def condition(text: str, columns: Collection[str]) -> exp.Expr:
    """Returns a condition on rows with some columns.

    >>> condition("ticks > 100 AND NOT success", ["ticks", "success"]).sql("duckdb")
    '"ticks" > 100 AND NOT "success"'
    """
    if not isinstance(text, str) or not text.strip():
        raise ArgumentError("where: give a condition, such as \"task = 'pick' AND NOT success\"")
    try:
        tree = sqlglot.parse_one(text, into=exp.Condition, dialect="duckdb")
    except sqlglot.ParseError as error:
        detail = error.errors[0]["description"] if error.errors else str(error)
        if "<class" in detail:  # of sqlglot: no value stands behind a sign
            detail = f"a value is missing, or is a word of SQL; {_TEXTS}"
        raise ArgumentError(f"where: {text!r} is no condition: {detail}") from error
    except sqlglot.TokenError as error:
        raise ArgumentError(f"where: {text!r} is no condition: {error}") from error
    if tree.find(exp.Query) is not None:
        raise ArgumentError(f"where: {text!r} has a query; a condition is of one row of episodes")
    for part in tree.find_all(exp.Column):
        part.set("this", exp.to_identifier(_column(part, columns), quoted=True))
    return tree


def _column(part: exp.Column, columns: Collection[str]) -> str:
    """Returns the column that a condition names, in letters of any case if only one has them."""
    if part.name in columns and not part.table:
        return part.name
    found = [name for name in columns if name.casefold() == part.name.casefold()]
    if part.table or not found:
        raise ArgumentError(
            f"where: episodes have no column or tag {part.sql('duckdb')}; {_TEXTS}",
            suggestions=nearest(part.name, list(columns)),
        )
    if len(found) > 1:
        names = " and ".join(map(repr, found))
        raise ArgumentError(f"where: {part.name} may be {names}: write one of them in quotes")
    return found[0]


def no_episode(where: str, episodes: pa.Table) -> str:
    """Returns what to say of a condition that holds for none of the episodes."""
    unknown = list(_unknown_values(condition(where, episodes.column_names), episodes))
    message = f"where: of {episodes.num_rows} episodes, {where!r} holds for none"
    return "; ".join((message, *unknown))


def _unknown_values(test: exp.Expr, episodes: pa.Table) -> Iterator[str]:
    """Yields the texts and whole numbers of a condition that no episode has, with near ones."""
    for node in test.find_all(exp.EQ, exp.In):
        sides = [node.this, *node.expressions, node.args.get("expression")]
        for column in (side for side in sides if isinstance(side, exp.Column)):
            known = set(episodes[column.name].drop_null().to_pylist())
            for value in map(_value_of, sides):
                if value is None or value in known or type(value) not in set(map(type, known)):
                    continue
                near = nearest(value, (one for one in known if isinstance(one, str)), 1)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                yield f"none has the {column.name} {short_repr(value)}{hint}"


def _value_of(side: exp.Expr | None) -> str | int | None:
    if not isinstance(side, exp.Literal):
        return None
    return side.name if side.is_string else int(side.name) if side.is_int else None
