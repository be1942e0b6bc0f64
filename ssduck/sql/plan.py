"""The plan of a query, and the facts that it depends on."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, Protocol, TypeAlias

from sqlglot import exp

from ssduck.language.clauses import PythonClauses, SelectedValue
from ssduck.language.tree import Call, Node, Query
from ssduck.sql.types import Signature, SqlType

PastKind: TypeAlias = Literal["", "instant", "window", "now"]


@dataclass(frozen=True)
class SourceType:
    """The type of a source, and its alias.

    Attributes:
        alias: what it is called.
        schema: of a world, its schema.
        past_kind: of a world's past, whether it is one tick, or several, or the present one beside
            its past.
        is_one_entity: whether that is the past of one entity.
        sql_type: of values, what they are.
        has_values: whether its values are known before the query runs; else it is a part of it.
        dicts: whether some of its elements are dicts.
        known: whether it has elements, so that names can be looked up in them.
    """

    alias: str
    schema: str | None = None
    sql_type: SqlType | None = None
    has_values: bool = True
    dicts: bool = False
    known: bool = True
    past_kind: PastKind = ""
    is_one_entity: bool = False


class TypeEnvironment(Protocol):
    """The names of the interpreter, as the translator needs them."""

    @property
    def max_depth(self) -> int:
        """The most rows that a path of a hierarchical query may have."""

    def has_variable(self, name: str) -> bool:
        """Checks whether there is a variable of that name."""

    def has_source(self, alias: str) -> bool:
        """Checks whether a query around this one has a source of that name."""

    def sql_type(self, node: Node) -> SqlType:
        """Returns the type of the value of an expression that depends on no row of this query."""

    def world(self, node: Node) -> str | None:
        """Returns the schema of the world that such an expression is, None if it is none."""

    def deferred(self, name: str) -> Node | None:
        """Returns the list in a variable that the query evaluates; None for other values."""

    def resolved_name(self, name: str) -> str:
        """Returns the name that calls a function: marked if a user's function replaces it."""

    def check_call(self, node: Call) -> None:
        """Rejects an unknown function, or a wrong number of arguments."""

    def signature(self, name: str, arguments: tuple[SqlType, ...]) -> Signature | None:
        """Returns the signature of a user's function for arguments; None if SQL cannot call it."""


@dataclass(frozen=True)
class ParameterBinding:
    """A parameter of the SQL.

    Attributes:
        name: of the parameter.
        node: the expression that it is the value of,
        column: or the column of the entity that the expression is.
        source: instead, the source that it lists the elements of,
        end: or the past of a world that it is the first or the last tick of, or whose only entity.
        sql_type: of the value.
    """

    name: str
    node: Node | None = None
    column: str | None = None
    source: str | None = None
    end: Literal["", "first", "last", "id"] = ""
    sql_type: SqlType = field(default_factory=lambda: SqlType("list"))


@dataclass(frozen=True)
class OutputColumn:
    """A column of the SQL: its place, and the type of its values."""

    index: int
    sql_type: SqlType


@dataclass(frozen=True)
class PathSearch:
    """The search for paths over the edges that a statement yields: their length, their number."""

    max_length: int
    max_paths: int | None


@dataclass(eq=False)
class Plan:
    """The plan of a query.

    Attributes:
        query: what it is a plan of, bare names looked up.
        source_types: what the sources are.
        select: the SQL as sqlglot's tree.
        bindings: its parameters.
        tables: sources that SQL reads as tables of their own, by alias: the table's name.
        constants: what does not depend on rows, with the types that the plan relies on.
        worlds: of these, the schemas of those that are worlds.
        signatures: the users' functions that SQL calls.
        known: the columns by the part of the tree that they are the value of.
        elements: the column of each source's element, by alias.
        python_constants: constants that are evaluated in Python.
        python_clauses: what Python does with the rows.
        outputs: the selected columns, if nothing is left to Python.
        names: what the columns are called, if all of them are texts.
        paths: whether each row of the SQL is a path, or an edge of a graph of paths.
        graph: of a graph, which paths are wanted.
        bare: names that were looked up, and whether there was a variable of that name.
        deferred: lists that were put in for variables.
        cautious: whether nothing in the SQL can fail.
    """

    query: Query
    source_types: tuple[SourceType, ...]
    select: exp.Select = field(default_factory=exp.Select)
    bindings: list[ParameterBinding] = field(default_factory=list)
    tables: dict[str, str] = field(default_factory=dict)
    constants: dict[Node, SqlType] = field(default_factory=dict)
    worlds: dict[Node, str | None] = field(default_factory=dict)
    signatures: set[Signature] = field(default_factory=set)
    known: dict[Node, OutputColumn] = field(default_factory=dict)
    elements: dict[str, OutputColumn] = field(default_factory=dict)
    python_constants: list[Node] = field(default_factory=list)
    python_clauses: PythonClauses = field(default_factory=lambda: PythonClauses(()))
    outputs: list[OutputColumn] | None = None
    names: tuple[str, ...] = ()
    paths: bool = False
    graph: PathSearch | None = None
    bare: dict[str, bool] = field(default_factory=dict)
    deferred: dict[str, Node | None] = field(default_factory=dict)
    cautious: bool = False

    @cached_property
    def sql(self) -> str:
        """The text of the SQL; where values are written in, it is never asked for."""
        return self.select.sql(dialect="duckdb")

    @cached_property
    def numbers(self) -> dict[str, Literal["double", "integer"]]:
        """The types of those of its parameters that are numbers."""
        types: dict[str, Literal["double", "integer"]] = {}
        for binding in self.bindings:
            if binding.end:  # by what is written in a statement, DuckDB leaves out what is older
                continue
            match binding.sql_type.type:
                case "double" | "integer" as kind:
                    types[binding.name] = kind
        return types

    @property
    def python_parts(self) -> list[Node]:
        """The parts left to Python."""
        if self.paths:
            return []
        python_clauses = self.python_clauses
        columns = [c.node for c in python_clauses.columns if self.is_in_python(c.node)]
        names = [
            c.name
            for c in python_clauses.columns
            if isinstance(c.name, Node) and self.is_in_python(c.name)
        ]
        keys = [key.value for key in python_clauses.order]
        last = [node for node in (python_clauses.having, python_clauses.limit) if node is not None]
        groups = [node for node in python_clauses.group if self.is_in_python(node)]
        return [*python_clauses.conditions, *columns, *names, *keys, *groups, *last]

    def is_in_python(self, node: Node) -> bool:
        """Checks whether a part is evaluated in Python for each row."""
        return node not in self.known and node not in self.python_constants


__all__ = [
    "OutputColumn",
    "ParameterBinding",
    "Plan",
    "SelectedValue",
    "Signature",
    "SourceType",
    "TypeEnvironment",
]
