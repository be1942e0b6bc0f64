"""The plan of a query, and the facts that it depends on."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, Protocol, TypeAlias

from sqlglot import exp

from ssduck.language import ast
from ssduck.language.clauses import PythonClauses
from ssduck.schema import EntityTable
from ssduck.sql.pair_lookup import PairLookup
from ssduck.sql.types import Signature, SqlType

PastKind: TypeAlias = Literal["", "instant", "window", "now"]
# To run; to run where nothing in SQL may fail; to be read, or sent to another engine, so that it
# calls Python for shapes only; to have the rows of a query without its groups.
Purpose: TypeAlias = Literal["run", "cautious", "portable", "rows"]


@dataclass(frozen=True)
class SourceType:
    """The type of a source, and its alias."""

    alias: str  # its alias
    schema: str | None = None  # the schema of a world
    sql_type: SqlType | None = None  # the type of its values
    # Whether its values are known before the query runs; if not, it is a part of it.
    has_values: bool = True
    dicts: bool = False  # whether some of its elements are dicts
    known: bool = True  # whether it has elements, so that names can be looked up in them
    # The ticks of a world's past: one, several, or the current one beside its past.
    past_kind: PastKind = ""
    is_one_entity: bool = False  # whether it is the past of one entity
    table: EntityTable = "entities"  # the table of the world that has its elements


class TypeEnvironment(Protocol):
    """The names of the interpreter, as the translator needs them."""

    @property
    def max_depth(self) -> int:
        """The largest number of rows of a path of a hierarchical query."""

    def has_variable(self, name: str) -> bool:
        """Checks whether there is a variable of that name."""

    def has_source(self, alias: str) -> bool:
        """Checks whether a query around this one has a source of that name."""

    def sql_type(self, node: ast.Node) -> SqlType:
        """Returns the type of the value of an expression that depends on no row of this query."""

    def world(self, node: ast.Node) -> SourceType | None:
        """Returns the type of the world, or of its past, that is the value of such an expression.

        None if it is neither.
        """

    def deferred(self, name: str) -> ast.Node | None:
        """Returns the list in a variable that the query evaluates; None for other values."""

    def resolved_name(self, name: str) -> str:
        """Returns the name that calls a function: marked if a user's function replaces it."""

    def check_call(self, node: ast.Call) -> None:
        """Checks that a function is known, and the number of its arguments."""

    def signature(self, name: str, arguments: tuple[SqlType, ...]) -> Signature | None:
        """Returns the signature of a user's function for arguments; None if SQL cannot call it."""


@dataclass(frozen=True)
class ParameterBinding:
    """A parameter of the SQL."""

    name: str  # the name of the parameter
    node: ast.Node | None = None  # the expression whose value it is of; None for a source
    column: str | None = None  # the column of the entity that is the value of the expression
    source: str | None = None  # the source whose elements it lists
    # The number of a past: its first or its last tick, or the id of its entity.
    end: Literal["", "first", "last", "id"] = ""
    sql_type: SqlType = field(default_factory=lambda: SqlType("list"))  # the type of the value


@dataclass(frozen=True)
class OutputColumn:
    """A column of the SQL: its place, and the type of its values."""

    index: int
    sql_type: SqlType


@dataclass(frozen=True)
class PathSearch:
    """The search for paths over the edges from SQL: their largest length and number."""

    max_length: int
    max_paths: int | None


@dataclass(eq=False)
class Plan:
    """The plan of a query."""

    query: ast.Query  # the query, its bare names resolved
    source_types: tuple[SourceType, ...]  # the types of the sources
    select: exp.Select = field(default_factory=exp.Select)  # the SQL as sqlglot's tree
    bindings: list[ParameterBinding] = field(default_factory=list)  # the parameters of the SQL
    # The names of tables for sources that are lists of dicts, by alias.
    tables: dict[str, str] = field(default_factory=dict)
    # The parts that do not depend on rows, with the types that the plan relies on.
    constants: dict[ast.Node, SqlType] = field(default_factory=dict)
    # The types of the constants that are sources of nested queries, if they are worlds.
    worlds: dict[ast.Node, SourceType | None] = field(default_factory=dict)
    signatures: set[Signature] = field(default_factory=set)  # the users' functions that SQL calls
    # The SQL column of each part of the tree that has one.
    known: dict[ast.Node, OutputColumn] = field(default_factory=dict)
    # The column of each source's element, by alias.
    elements: dict[str, OutputColumn] = field(default_factory=dict)
    # The constants that Python evaluates.
    python_constants: list[ast.Node] = field(default_factory=list)
    # The clauses that Python applies to the rows.
    python_clauses: PythonClauses = field(default_factory=lambda: PythonClauses(()))
    outputs: list[OutputColumn] | None = None  # the selected columns, if nothing is left to Python
    # The keys of GROUP BY, by which the rows are sorted into groups, if nothing else is left to
    # Python.
    keys: list[OutputColumn] = field(default_factory=list)
    left_for: ast.Node | None = None  # the part for whose sake groups are left to Python
    names: tuple[str, ...] = ()  # the names of the columns, if all of them are texts
    paths: bool = False  # whether each row of the SQL is a path, or an edge of a graph of paths
    graph: PathSearch | None = None  # the search for paths over the edges
    # The resolved names, and whether there was a variable of that name.
    bare: dict[str, bool] = field(default_factory=dict)
    # The lists in variables that the query evaluates.
    deferred: dict[str, ast.Node | None] = field(default_factory=dict)
    purpose: Purpose = "run"  # what the SQL is for
    may_fail: bool = False  # whether something in the SQL may fail, so that Python decides
    lookup: PairLookup | None = None  # the look-up that has the rows of the SQL, if there is one

    @cached_property
    def sql(self) -> str:
        """The text of the SQL."""
        return self.select.sql(dialect="duckdb")

    @cached_property
    def numbers(self) -> dict[str, Literal["double", "integer"]]:
        """The types of those of its parameters that are numbers."""
        types: dict[str, Literal["double", "integer"]] = {}
        for binding in self.bindings:
            if binding.end:  # as literals, they let DuckDB skip older rows
                continue
            match binding.sql_type.type:
                case "double" | "integer" as kind:
                    types[binding.name] = kind
        return types

    @property
    def python_parts(self) -> list[ast.Node]:
        """The parts left to Python."""
        if self.paths:
            return []
        python_clauses = self.python_clauses
        columns = [c.node for c in python_clauses.columns if self.is_in_python(c.node)]
        names = [
            c.name
            for c in python_clauses.columns
            if isinstance(c.name, ast.Node) and self.is_in_python(c.name)
        ]
        keys = [key.value for key in python_clauses.order]
        ends = (python_clauses.having, python_clauses.limit, python_clauses.offset)
        last = [node for node in ends if node is not None]
        groups = [node for node in python_clauses.group if self.is_in_python(node)]
        return [*python_clauses.conditions, *columns, *names, *keys, *groups, *last]

    def is_in_python(self, node: ast.Node) -> bool:
        """Checks whether a part is evaluated in Python for each row."""
        return node not in self.known and node not in self.python_constants
