"""The macros and comments in DuckDB's catalog: relations as macros, and the meaning of tables.

They serve users' SQL: a query gets the macros that it names, other statements get all macros and
comments. The SQL of SelectScript contains the relations' formulas instead.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from sqlglot import exp

from ssduck.language.intervals import ABOUT_INTERVALS, INTERVALS, RELATIONS_OF_INTERVALS
from ssduck.recording.stores.history_sql import quoted
from ssduck.schema import MODELS, TABLES
from ssduck.sql.from_clause import pair_table
from ssduck.sql.relations.geometry_query import COLLIDING, WITHIN, PairKind, PairSearch
from ssduck.sql.relations.registry import RELATIONS


@dataclass(frozen=True)
class PairTableMacro:
    """A table of pairs of entities or links, faster than a join of rows for thousands of them."""

    name: str  # its name in a world's schema; the schema of the only world may be omitted
    parameters: tuple[str, ...]  # its parameters
    search: PairSearch  # the search for pairs
    distance: str  # the parameter that is the distance or the depth, m
    about: str  # the meaning of a row
    kind: PairKind = "entities"  # what the two sides of a pair are

    def macro(self, schema: str, *, inside: bool) -> str:
        """Returns the statement that creates it, in the schema of its world or for all."""
        distance = exp.column(self.distance)
        pairs = pair_table(self.search, distance, schema, "pairs", self.kind).table
        rows = exp.select("pairs.a", "pairs.b").from_(pairs).sql("duckdb")
        place = f"MACRO {_dotted((schema,), self.name)}" if inside else f"TEMP MACRO {self.name}"
        return f"CREATE OR REPLACE {place}({', '.join(self.parameters)}) AS TABLE {rows}"


TABLE_MACROS = (
    PairTableMacro(
        "colliding_pairs",
        ("depth := 1e-6",),
        COLLIDING,
        "depth",
        "A row is the ids a, b of two entities that penetrate each other by more than depth, in "
        "metres, 1e-6 by default; each pair in both orders.",
    ),
    PairTableMacro(
        "pairs_within",
        ("d",),
        WITHIN,
        "d",
        "A row is the ids a, b of two entities whose clearance is at most d metres; each pair "
        "in both orders.",
    ),
    PairTableMacro(
        "colliding_link_pairs",
        ("depth := 1e-6",),
        COLLIDING,
        "depth",
        "A row is the ids a, b of two links, of one entity or two, that penetrate each other by "
        "more than depth, in metres, 1e-6 by default; each pair in both orders.",
        "links",
    ),
    PairTableMacro(
        "link_pairs_within",
        ("d",),
        WITHIN,
        "d",
        "A row is the ids a, b of two links, of one entity or two, whose clearance is at most d "
        "metres; each pair in both orders.",
        "links",
    ),
)


def _dotted(path: Sequence[str], name: str) -> str:
    return ".".join(map(quoted, (*path, name)))


_RELATIONS = {relation.name.lower(): relation for relation in RELATIONS.values()}
_PAIR_TABLES = {table.name: table for table in TABLE_MACROS}
_INTERVALS = "intervals"
# The macros that have a table; those of `TABLE_MACROS` depend on the worlds.
_WITH_TABLE = frozenset((_INTERVALS, *_PAIR_TABLES))
MACRO_NAMES = frozenset((*_RELATIONS, *RELATIONS_OF_INTERVALS)) | _WITH_TABLE
# Those that read tables of a world, and so are in its schema before a statement names them.
WORLD_MACROS = frozenset((*_PAIR_TABLES, *(n for n, one in _RELATIONS.items() if one.tables)))


@lru_cache(maxsize=16)
def description_script(
    worlds: Sequence[str], only: str | None, recorded: Collection[str] = ()
) -> str:
    """Returns the statements that create all macros and comments.

    Relations read the tables of the only world, as a row does not name its world; each world
    also has them in its own schema. All arguments must be hashable.
    """
    return ";\n".join(_description_statements(worlds, only, recorded))


def _description_statements(
    worlds: Sequence[str], only: str | None, recorded: Collection[str]
) -> Iterator[str]:
    for schema, names in ((None, MACRO_NAMES), *((world, WORLD_MACROS) for world in worlds)):
        for name in sorted(names):
            statement = macro_statement(name, schema, only)
            if statement is not None:
                yield statement
                yield _macro_comment(name, schema)
    for schema in worlds:
        yield from _comments(schema, recorded=schema in recorded)


def macro_statement(name: str, schema: str | None, only: str | None) -> str | None:
    """Returns the statement that creates a macro; None if there is no such macro in that place.

    Args:
        name: its name, in small letters.
        schema: the schema of a world; None for the macro that has no schema before its name.
        only: the schema of the only world; None if there are several worlds.
    """
    relation, pairs = _RELATIONS.get(name), _PAIR_TABLES.get(name)
    if relation is not None:
        return relation.macro(schema or only, inside=schema is not None)
    if pairs is not None:
        world = schema or only
        return None if world is None else pairs.macro(world, inside=schema is not None)
    if schema is not None:
        return None
    if name == _INTERVALS:
        return f"CREATE OR REPLACE TEMP MACRO {_INTERVALS}(source) AS TABLE {INTERVALS}"
    formula = RELATIONS_OF_INTERVALS[name].formula
    return f"CREATE OR REPLACE TEMP MACRO {name}(a, b) AS ({formula})"


def _macro_comment(name: str, schema: str | None) -> str:
    """Returns the statement that comments on a macro."""
    if name in _RELATIONS:
        return _RELATIONS[name].comment(schema)
    place = _dotted(("temp", "main") if schema is None else (schema,), name)
    if name in _PAIR_TABLES:
        kind, about = "MACRO TABLE", _PAIR_TABLES[name].about
    elif name == _INTERVALS:
        kind, about = "MACRO TABLE", ABOUT_INTERVALS
    else:
        kind, about = "MACRO", RELATIONS_OF_INTERVALS[name].about
    return f"COMMENT ON {kind} {place} IS {exp.Literal.string(about).sql('duckdb')}"


def drop_macro(name: str, schema: str | None = None) -> str:
    """Returns the statement that drops a macro, or one that has no schema before its name."""
    kind = "MACRO TABLE" if name in _WITH_TABLE else "MACRO"
    place = ("temp", "main") if schema is None else (schema,)
    return f"DROP {kind} IF EXISTS {_dotted(place, name)}"


def drop_statements(world: str, macros: Iterable[str]) -> Iterator[str]:
    """Yields the statements that drop the views of a world and its macros, by their names."""
    for table in TABLES:
        yield f"DROP VIEW IF EXISTS {_dotted((world,), table)}"
    for name in sorted(macros):
        yield drop_macro(name, world)


def _comments(schema: str, *, recorded: bool) -> Iterator[str]:
    """Yields the comments on the tables of a world."""
    for name, table in TABLES.items():
        columns = table.shown_columns
        comments = {column.name: column.comment for column in columns}
        comments |= {
            column.second_name: column.comment for column in table.columns if column.second_name
        }
        yield from _comments_on(schema, name, f"A row is {table.row}.", comments)
        if table.has_history:
            about = f"A row is {table.row}, at each recorded tick."
            yield from _comments_on(schema, table.history_view, about, comments)
    for table in MODELS.values() if recorded else ():
        about = f"Values that are the same at all recorded ticks. A row is {table.row}."
        comments = {column.name: column.comment for column in table.model}
        yield from _comments_on(schema, table.model_view, about, comments)


def _comments_on(schema: str, view: str, about: str, columns: Mapping[str, str]) -> Iterator[str]:
    yield _comment("VIEW", exp.table_(view, db=schema, quoted=True), about)
    for name, comment in columns.items():
        place = exp.column(name, table=view, db=schema, quoted=True)
        yield _comment("COLUMN", place, comment)


def _comment(kind: str, place: exp.Expr, text: str) -> str:
    literal = exp.Literal.string(text)
    return exp.Comment(this=place, kind=kind, expression=literal).sql("duckdb")
