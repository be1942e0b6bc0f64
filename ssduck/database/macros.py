"""The macros and comments in DuckDB's catalog: relations as macros, and the meaning of tables.

They serve users' SQL: a query gets the macros that it names, other statements get all macros and
comments. The SQL of SelectScript contains the relations' formulas instead.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from functools import lru_cache

from sqlglot import exp

from ssduck.language.intervals import ABOUT_INTERVALS, INTERVALS, RELATIONS_OF_INTERVALS
from ssduck.recording.stores.history_sql import quoted
from ssduck.schema import MODELS, TABLES
from ssduck.sql.from_clause import pair_table
from ssduck.sql.relations.geometry_query import COLLIDING, WITHIN, PairKind, PairSearch
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.relations.relation import Relation


@dataclass(frozen=True)
class PairTableMacro:
    """A table of pairs of entities or links, faster than a join of rows for thousands of them.

    Attributes:
        name: its name in a world's schema; the schema of the only world may be omitted.
        parameters: its parameters.
        search: the search for pairs.
        distance: the parameter that is the distance or the depth, m.
        about: the meaning of a row.
        kind: what the two sides of a pair are.
    """

    name: str
    parameters: tuple[str, ...]
    search: PairSearch
    distance: str
    about: str
    kind: PairKind = "entities"

    def macro(self, path: Sequence[str], schema: str) -> str:
        """Returns the statement that creates it."""
        distance = exp.column(self.distance)
        pairs = pair_table(self.search, distance, schema, "pairs", self.kind).table
        rows = exp.select("pairs.a", "pairs.b").from_(pairs).sql("duckdb")
        temporary = "TEMP " if path[0] == "temp" else ""
        name = _dotted(path[1:] if temporary else path, self.name)
        parameters = ", ".join(self.parameters)
        return f"CREATE OR REPLACE {temporary}MACRO {name}({parameters}) AS TABLE {rows}"

    def comment(self, path: Sequence[str]) -> str:
        """Returns the statement that comments on it."""
        text = exp.Literal.string(self.about).sql("duckdb")
        full_path = ("temp", "main") if path[0] == "temp" else path
        return f"COMMENT ON MACRO TABLE {_dotted(full_path, self.name)} IS {text}"


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


@lru_cache(maxsize=16)
def description_script(
    worlds: Sequence[str],
    only: str | None,
    described: Collection[str] | None,
    recorded: Collection[str] = (),
) -> str:
    """Returns the statements that create the macros and comments.

    Relations read the tables of the only world, as a row does not name its world; each world
    also has them in its own schema. All arguments must be hashable.

    Args:
        worlds: the schemas of all worlds; a world may have several.
        only: the schema of the only world; None if there are several worlds.
        described: the schemas that are described already; None if nothing is.
        recorded: the schemas of recorded worlds.
    """
    return ";\n".join(_description_statements(worlds, only, described, recorded))


def _description_statements(
    worlds: Sequence[str],
    only: str | None,
    described: Collection[str] | None,
    recorded: Collection[str],
) -> Iterator[str]:
    for relation in RELATIONS.values() if described is None else relations_with_tables():
        yield relation.macro(only)
        yield relation.comment()
    if described is None:
        yield from _interval_statements()
    for table in TABLE_MACROS:
        if only is not None:
            yield table.macro(("temp",), only)
            yield table.comment(("temp",))
        elif described:
            yield drop_macro(table.name)
    for schema in worlds:
        if schema in (described or ()):
            continue
        for relation in relations_with_tables():
            yield relation.macro(schema, inside=True)
            yield relation.comment(schema)
        for table in TABLE_MACROS:
            yield table.macro((schema,), schema)
            yield table.comment((schema,))
        yield from _comments(schema, recorded=schema in recorded)


_RELATIONS = {relation.name.lower(): relation for relation in RELATIONS.values()}
_PAIR_TABLES = {table.name: table for table in TABLE_MACROS}
_INTERVALS = "intervals"
# The macros that have a table; those of `TABLE_MACROS` depend on the worlds.
TABLE_MACRO_NAMES = frozenset((_INTERVALS, *_PAIR_TABLES))
_MACRO_NAMES = frozenset((*_RELATIONS, *RELATIONS_OF_INTERVALS)) | TABLE_MACRO_NAMES


def macros_among(words: AbstractSet[str]) -> AbstractSet[str]:
    """Returns the words in small letters that are names of macros."""
    return _MACRO_NAMES & words


def macro_statement(name: str, schema: str | None, only: str | None) -> str | None:
    """Returns the statement that creates a macro; None if there is no such macro in that place.

    Args:
        name: its name, in small letters.
        schema: the schema of a world; None for the macro that has no schema before its name.
        only: the schema of the only world; None if there are several worlds.
    """
    relation, pairs = _RELATIONS.get(name), _PAIR_TABLES.get(name)
    if relation is not None:
        if schema is None:
            return relation.macro(only)
        return relation.macro(schema, inside=True) if relation.tables else None
    if pairs is not None:
        if schema is None:
            return None if only is None else pairs.macro(("temp",), only)
        return pairs.macro((schema,), schema)
    if schema is not None:
        return None
    return _intervals_macro() if name == _INTERVALS else _interval_macro(name)


def drop_macro(name: str) -> str:
    """Returns the statement that drops a macro that has no schema before its name."""
    kind = "MACRO TABLE" if name in TABLE_MACRO_NAMES else "MACRO"
    return f"DROP {kind} IF EXISTS {_dotted(('temp', 'main'), name)}"


def _intervals_macro() -> str:
    return f"CREATE OR REPLACE TEMP MACRO {_INTERVALS}(source) AS TABLE {INTERVALS}"


def _interval_macro(name: str) -> str:
    return f"CREATE OR REPLACE TEMP MACRO {name}(a, b) AS ({RELATIONS_OF_INTERVALS[name].formula})"


def _interval_statements() -> Iterator[str]:
    """Yields the statements for intervals of rows, and for the relations of intervals."""
    yield _intervals_macro()
    about = exp.Literal.string(ABOUT_INTERVALS).sql("duckdb")
    yield f"COMMENT ON MACRO TABLE temp.main.intervals IS {about}"
    for name, allen in RELATIONS_OF_INTERVALS.items():
        if name not in RELATIONS:  # otherwise the relation's macro has it
            yield _interval_macro(name)
            about = exp.Literal.string(allen.about).sql("duckdb")
            yield f"COMMENT ON MACRO temp.main.{name} IS {about}"


def relations_with_tables() -> Iterator[Relation]:
    """Yields the relations that read tables of their entities' world."""
    return (relation for relation in RELATIONS.values() if relation.tables)


def formula_statements(names: Iterable[str], schema: str) -> Iterator[str]:
    """Yields the statements that add relations without tables to a world's schema."""
    for name in names:
        yield RELATIONS[name].macro(schema, inside=True)
        yield RELATIONS[name].comment(schema)


def drop_statements(world: str, *, described: bool, formulas: Iterable[str] = ()) -> Iterator[str]:
    """Yields the statements that drop a world's views and macros.

    Args:
        world: the schema of the world.
        described: whether it has macros.
        formulas: the relations without tables that it has.
    """
    names = [("VIEW", table) for table in TABLES]
    names += [("MACRO", relation.name) for relation in relations_with_tables() if described]
    names += [("MACRO", name) for name in formulas]
    for kind, name in names:
        place = exp.table_(name, db=world, quoted=True)
        yield exp.Drop(tables=[place], kind=kind, exists=True).sql("duckdb")
    for table in TABLE_MACROS if described else ():
        yield f"DROP MACRO TABLE {_dotted((world,), table.name)}"


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
