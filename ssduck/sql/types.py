"""The types of values in SQL."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import reduce

from ssduck.schema import MAX_IDS, EntityTable
from ssduck.sql.relations.relation import ValueType

# From this integer on, not every integer is a DOUBLE.
EXACT = 2**53
# The key of an entity or a link at a recorded tick is tick * IDS + id: ids are fewer than this.
IDS = MAX_IDS


@dataclass(frozen=True)
class SqlType:
    """The type of a value, as plans depend on it.

    >>> SqlType("list", SqlType("double")).duckdb_type
    'DOUBLE[]'
    """

    type: ValueType  # the name of the type
    # The type of a list's elements; None for a list without elements.
    element: SqlType | None = None
    length: int | None = None  # 3 for a list that may be a point
    schema: str | None = None  # the schema of an entity's world
    past: bool = False  # whether it is an entity at a recorded tick
    table: EntityTable = "entities"  # the table of an entity's row; that of links if it is a link
    nullable: bool = False  # whether the value may be missing
    # The keys of a record and the types of their values.
    fields: tuple[tuple[str, SqlType], ...] = ()

    @property
    def is_number(self) -> bool:
        """Whether values are numbers."""
        return self.type in ("double", "integer", "number")

    @property
    def comes_back(self) -> bool:
        """Whether SQL returns a value unchanged."""
        match self.type:
            case "list":
                return self.element is None or self.element.comes_back
        return self.type in ("entity", "double", "integer", "string", "boolean")

    @property
    def is_sql(self) -> bool:
        """Whether SQL has such values."""
        match self.type:
            case "list":
                element = self.element
                return element is None or (element.is_sql and element.type != "record")
            case "record":
                return all(sql_type.is_sql for _, sql_type in self.fields)
        return self.type in ("entity", "double", "integer", "number", "string", "boolean")

    @property
    def is_plain(self) -> bool:
        """Whether values are numbers, texts, booleans or lists of them, which refer to no world."""
        if self.type == "list":
            return self.element is None or self.element.is_plain
        return self.is_number or self.type in ("string", "boolean")

    @property
    def duckdb_type(self) -> str:
        """DuckDB's type of such values."""
        if self.type == "list":
            return f"{self.element.duckdb_type if self.element else 'INTEGER'}[]"
        return _SQL_TYPES.get(self.type, "BIGINT")

    @property
    def words(self) -> str:
        """The type in words, for messages."""
        return _WORDS.get(self.type, "such a value")


_SQL_TYPES: dict[ValueType, str] = {
    "entity": "BIGINT",
    "integer": "BIGINT",
    "double": "DOUBLE",
    "number": "DOUBLE",
    "string": "VARCHAR",
    "boolean": "BOOLEAN",
}
_WORDS: dict[ValueType, str] = {
    "entity": "an entity",
    "double": "a number",
    "integer": "a number",
    "number": "a number",
    "string": "a text",
    "boolean": "True or False",
    "list": "a list",
    "array": "an array",
    "record": "a dict",
    "nothing": "nothing",
}


@dataclass(frozen=True)
class Signature:
    """A user's function as SQL calls it: both of its names, its parameters, its result."""

    function: str
    name: str
    parameters: tuple[SqlType, ...]
    result: SqlType


ANY = SqlType("any")
DOUBLE = SqlType("double")
POINT = SqlType("list", DOUBLE, 3)
INTEGER = SqlType("integer")
STRING = SqlType("string")
BOOLEAN = SqlType("boolean")


def merged(sql_types: Iterable[SqlType]) -> SqlType | None:
    """Returns the common type of several types; None if there are none.

    >>> merged([INTEGER, DOUBLE]).type, merged([STRING, INTEGER]).type
    ('number', 'any')
    """
    distinct = list(dict.fromkeys(sql_types))
    return reduce(_both, distinct) if distinct else None


def _both(a: SqlType, b: SqlType) -> SqlType:
    if a == b:
        return a
    if a.is_number and b.is_number:
        return SqlType("number", nullable=a.nullable or b.nullable)
    if a.type == b.type == "list":
        elements = [sql_type.element for sql_type in (a, b) if sql_type.element is not None]
        length = a.length if a.length == b.length else None
        element = merged(elements)
        return SqlType("list", element, length) if element is None or element.is_sql else ANY
    if a.type == b.type == "record" and [k for k, _ in a.fields] == [k for k, _ in b.fields]:
        pairs = zip(a.fields, b.fields, strict=True)
        return SqlType("record", fields=tuple((k, _both(t, u)) for (k, t), (_, u) in pairs))
    if a.type == b.type != "record" and (a.schema, a.past, a.table) == (b.schema, b.past, b.table):
        return replace(a, nullable=a.nullable or b.nullable)
    return ANY
