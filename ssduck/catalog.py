"""What DuckDB's catalog holds of ssduck: the relations as macros, and what tables mean.

It is for the SQL of users, and made when they first write some; what SelectScript becomes has the
relations' formulas in it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from sqlglot import exp

from ssduck.relations import Relation
from ssduck.tables import ROWS, TABLES
from ssduck.udfs import RELATIONS


def described(worlds: Sequence[str], known: Collection[str] | None) -> Iterator[str]:
    """The statements that make the macros and comments.

    Relations look things up in the only world, as a row does not tell which it is of; each world
    has them under its own name, too.

    Args:
        worlds: the schemas of all worlds.
        known: those that were described before; None if nothing was.
    """
    only = worlds[0] if len(worlds) == 1 else None
    for relation in RELATIONS.values() if known is None else looking_up():
        yield relation.macro(only)
        yield relation.comment()
    for schema in worlds:
        if schema in (known or ()):
            continue
        for relation in looking_up():
            yield relation.macro(schema, inside=True)
            yield relation.comment(schema)
        yield from _comments(schema)


def looking_up() -> Iterator[Relation]:
    """The relations that look things up in their entities' world."""
    return (relation for relation in RELATIONS.values() if relation.tables)


def dropped(world: str, *, described: bool) -> Iterator[str]:
    """The statements that take a world's views and macros out of its schema.

    Args:
        world: the schema.
        described: whether it has macros.
    """
    names = [("VIEW", table) for table in TABLES]
    names += [("MACRO", relation.name) for relation in looking_up() if described]
    for kind, name in names:
        place = exp.table_(name, db=world, quoted=True)
        yield exp.Drop(tables=[place], kind=kind, exists=True).sql("duckdb")


def _comments(schema: str) -> Iterator[str]:
    """What the tables of a world hold."""
    for table, columns in TABLES.items():
        view = exp.table_(table, db=schema, quoted=True)
        yield _comment("VIEW", view, f"A row is {ROWS[table]}.")
        for column in columns:
            place = exp.column(column.name, table=table, db=schema, quoted=True)
            yield _comment("COLUMN", place, column.comment)


def _comment(kind: str, place: exp.Expr, text: str) -> str:
    said = exp.Literal.string(text)
    return exp.Comment(this=place, kind=kind, expression=said).sql("duckdb")
