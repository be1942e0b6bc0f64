"""The names of worlds alone: a `TypeEnvironment` for the examples in this package.

There are no variables and no users' functions; each source is a world with the name in FROM.
"""

from __future__ import annotations

from ssduck.language.parser import parse
from ssduck.language.tree import Call, Literal, Name, Node, Query
from ssduck.sql.name_resolution import resolve
from ssduck.sql.plan import SourceType
from ssduck.sql.sql_values import NotSqlError
from ssduck.sql.translator import translate
from ssduck.sql.types import BOOLEAN, DOUBLE, INTEGER, STRING, Signature, SqlType


class WorldNames:
    """The names of a program that has worlds and nothing else."""

    max_depth = 1000

    def has_variable(self, name: str) -> bool:  # noqa: ARG002
        """Checks whether there is a variable of that name."""
        return False

    has_source = has_variable

    def sql_type(self, node: Node) -> SqlType:
        """Returns the type of a constant: a number or a text."""
        match node:
            case Literal(value=bool()):
                return BOOLEAN
            case Literal(value=int()):
                return INTEGER
            case Literal(value=float()):
                return DOUBLE
            case Literal(value=str()):
                return STRING
        raise NotSqlError

    def world(self, node: Node) -> str | None:
        """Returns the schema of a world."""
        return node.name if isinstance(node, Name) else None

    def deferred(self, name: str) -> Node | None:  # noqa: ARG002
        """Returns the list that a variable holds; there is none."""
        return None

    def resolved_name(self, name: str) -> str:
        """Returns the name of a function."""
        return name

    def check_call(self, node: Call) -> None:
        """Accepts every call."""

    def signature(self, name: str, arguments: tuple[SqlType, ...]) -> Signature | None:  # noqa: ARG002
        """Returns the signature of a user's function; there is none."""
        return None


def query_of(text: str) -> Query:
    """Returns the query that a program consists of."""
    (query,) = parse(text).statements
    assert isinstance(query, Query)
    return query


def _worlds(query: Query) -> list[SourceType]:
    return [
        SourceType(str(source.alias), schema=WorldNames().world(source.value))
        for source in query.sources
    ]


def resolved_query(text: str) -> Query:
    """Returns the query with its bare names resolved.

    >>> resolved_query("SELECT id FROM kitchen WHERE isRobot;").where.outline()
    "Call('isRobot', [This(None)])"
    """
    query = query_of(text)
    return resolve(query, _worlds(query), WorldNames()).query


def sql_of(text: str) -> str:
    """Returns the SQL of a query of worlds.

    >>> sql_of("SELECT id FROM kitchen;")
    'SELECT kitchen.name FROM kitchen.entities AS kitchen'
    """
    query = query_of(text)
    return translate(query, _worlds(query), WorldNames()).select.sql("duckdb")
