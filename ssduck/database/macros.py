"""What DuckDB's catalog holds of ssduck: the relations as macros, and what tables mean.

It is for the SQL of users, and made when they first write some; what SelectScript becomes has the
relations' formulas in it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from sqlglot import exp

from ssduck.language.intervals import ABOUT_INTERVALS, INTERVALS, RELATIONS_OF_INTERVALS
from ssduck.schema import MODELS, TABLES
from ssduck.sql.from_clause import pair_table
from ssduck.sql.relations.geometry_query import COLLIDING, WITHIN, PairSearch
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.relations.relation import Relation


@dataclass(frozen=True)
class PairTableMacro:
    """A table of pairs of a world, for SQL over thousands of bodies: a join of rows takes longer.

    Attributes:
        name: in a world's schema; that of the only world goes without it.
        parameters: what it takes.
        search: finds the pairs.
        distance: the parameter that is its distance.
        about: what a row is.
    """

    name: str
    parameters: tuple[str, ...]
    search: PairSearch
    distance: str
    about: str

    def macro(self, place: Sequence[str], schema: str) -> str:
        """The statement that makes it."""
        pairs = pair_table(self.search, exp.column(self.distance), schema, "pairs").table
        rows = exp.select("pairs.a", "pairs.b").from_(pairs).sql("duckdb")
        temporary = "TEMP " if place[0] == "temp" else ""
        name = _dotted(place[1:] if temporary else place, self.name)
        parameters = ", ".join(self.parameters)
        return f"CREATE OR REPLACE {temporary}MACRO {name}({parameters}) AS TABLE {rows}"

    def comment(self, place: Sequence[str]) -> str:
        """The statement that lets DuckDB say what it is."""
        said = exp.Literal.string(self.about).sql("duckdb")
        where = ("temp", "main") if place[0] == "temp" else place
        return f"COMMENT ON MACRO TABLE {_dotted(where, self.name)} IS {said}"


TABLE_MACROS = (
    PairTableMacro(
        "colliding_pairs",
        ("depth := 1e-6",),
        COLLIDING,
        "depth",
        "A row is the ids a, b of two entities that are deeper in each other than depth, 1e-6 m "
        "if it is not given; each pair both ways.",
    ),
    PairTableMacro(
        "pairs_within",
        ("d",),
        WITHIN,
        "d",
        "A row is the ids a, b of two entities whose clearance is at most d metres; each pair "
        "both ways.",
    ),
)


def _dotted(place: Sequence[str], name: str) -> str:
    return ".".join(exp.to_identifier(part, quoted=True).sql("duckdb") for part in (*place, name))


def described(
    worlds: Sequence[str],
    only: str | None,
    known: Collection[str] | None,
    recorded: Collection[str] = (),
) -> Iterator[str]:
    """The statements that make the macros and comments.

    Relations look things up in the only world, as a row does not tell which it is of; each world
    has them under its own name, too.

    Args:
        worlds: the schemas of all worlds; one may have several.
        only: that of the only world.
        known: those that were described before; None if nothing was.
        recorded: those whose ticks are recorded.
    """
    for relation in RELATIONS.values() if known is None else looking_up():
        yield relation.macro(only)
        yield relation.comment()
    if known is None:
        yield from _of_intervals()
    for table in TABLE_MACROS:
        if only is not None:
            yield table.macro(("temp",), only)
            yield table.comment(("temp",))
        elif known:
            yield f"DROP MACRO TABLE IF EXISTS {_dotted(('temp', 'main'), table.name)}"
    for schema in worlds:
        if schema in (known or ()):
            continue
        for relation in looking_up():
            yield relation.macro(schema, inside=True)
            yield relation.comment(schema)
        for table in TABLE_MACROS:
            yield table.macro((schema,), schema)
            yield table.comment((schema,))
        yield from _comments(schema, recorded=schema in recorded)


def _of_intervals() -> Iterator[str]:
    """What makes intervals of rows, and the relations of these."""
    yield f"CREATE OR REPLACE TEMP MACRO intervals(source) AS TABLE {INTERVALS}"
    about = exp.Literal.string(ABOUT_INTERVALS).sql("duckdb")
    yield f"COMMENT ON MACRO TABLE temp.main.intervals IS {about}"
    for name, allen in RELATIONS_OF_INTERVALS.items():
        if name not in RELATIONS:  # else it is one more of that relation
            yield f"CREATE OR REPLACE TEMP MACRO {name}(a, b) AS ({allen.formula})"
            about = exp.Literal.string(allen.about).sql("duckdb")
            yield f"COMMENT ON MACRO temp.main.{name} IS {about}"


def looking_up() -> Iterator[Relation]:
    """The relations that look things up in their entities' world."""
    return (relation for relation in RELATIONS.values() if relation.tables)


def formulas(names: Iterable[str], schema: str) -> Iterator[str]:
    """The statements that make relations that look nothing up macros of a world's schema, too.

    Args:
        names: of the relations.
        schema: that of the world.
    """
    for name in names:
        yield RELATIONS[name].macro(schema, inside=True)
        yield RELATIONS[name].comment(schema)


def dropped(world: str, *, described: bool, formulas: Iterable[str] = ()) -> Iterator[str]:
    """The statements that take a world's views and macros out of its schema.

    Args:
        world: the schema.
        described: whether it has macros.
        formulas: the relations that it has besides those that look things up.
    """
    names = [("VIEW", table) for table in TABLES]
    names += [("MACRO", relation.name) for relation in looking_up() if described]
    names += [("MACRO", name) for name in formulas]
    for kind, name in names:
        place = exp.table_(name, db=world, quoted=True)
        yield exp.Drop(tables=[place], kind=kind, exists=True).sql("duckdb")
    for table in TABLE_MACROS if described else ():
        yield f"DROP MACRO TABLE {_dotted((world,), table.name)}"


def _comments(schema: str, *, recorded: bool) -> Iterator[str]:
    """What the tables of a world hold."""
    for name, table in TABLES.items():
        comments = {column.name: column.comment for column in table.columns}
        comments |= {
            column.second_name: column.comment for column in table.columns if column.second_name
        }
        yield from _comments_on(schema, name, f"A row is {table.row}.", comments)
        if table.has_history:
            about = f"A row is {table.row}, at each recorded tick."
            yield from _comments_on(schema, table.history_view, about, comments)
    for table in MODELS.values() if recorded else ():
        about = f"What is the same at each recorded tick. A row is {table.row}."
        comments = {column.name: column.comment for column in table.model}
        yield from _comments_on(schema, table.model_view, about, comments)


def _comments_on(schema: str, view: str, about: str, columns: Mapping[str, str]) -> Iterator[str]:
    yield _comment("VIEW", exp.table_(view, db=schema, quoted=True), about)
    for name, comment in columns.items():
        place = exp.column(name, table=view, db=schema, quoted=True)
        yield _comment("COLUMN", place, comment)


def _comment(kind: str, place: exp.Expr, text: str) -> str:
    said = exp.Literal.string(text)
    return exp.Comment(this=place, kind=kind, expression=said).sql("duckdb")
