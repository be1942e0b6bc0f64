"""The types of values, as far as SQL knows them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, TypeAlias

from ssduck.udfs import ValueType
from ssduck.world import Entity, World

# Larger integers are not all numbers that a DOUBLE can be.
EXACT = 2**53
# More keys than this make no columns.
MOST_FIELDS = 200

SchemaOf: TypeAlias = Callable[[World], str]


@dataclass(frozen=True)
class Tag:
    """The type of a value: what a plan depends on.

    Attributes:
        type: what it is.
        element: of a list, what its elements are; None for a list without elements.
        length: of a list, 3 if it may be a point.
        schema: of an entity, the world that it is in.
        nullable: whether there may be none.
        fields: of a record, its keys and what they hold.
    """

    type: ValueType
    element: Tag | None = None
    length: int | None = None
    schema: str | None = None
    nullable: bool = False
    fields: tuple[tuple[str, Tag], ...] = ()

    @property
    def is_number(self) -> bool:
        """Whether it is a number."""
        return self.type in ("real", "integer", "number")

    @property
    def comes_back(self) -> bool:
        """Whether a value that went to SQL comes back as the same value."""
        match self.type:
            case "list":
                return self.element is None or self.element.comes_back
        return self.type in ("entity", "real", "integer", "text", "flag")

    @property
    def is_sql(self) -> bool:
        """Whether SQL has such values."""
        match self.type:
            case "list":
                return self.element is None or self.element.is_sql
            case "record":
                return all(tag.is_sql for _, tag in self.fields)
        return self.type in ("entity", "real", "integer", "number", "text", "flag")

    @property
    def sql_type(self) -> str:
        """DuckDB's type of such values."""
        if self.type == "list":
            return f"{self.element.sql_type if self.element else 'INTEGER'}[]"
        return _SQL_TYPES.get(self.type, "BIGINT")

    @property
    def words(self) -> str:
        """What it is, for people."""
        return _WORDS.get(self.type, "such a value")


_SQL_TYPES: dict[ValueType, str] = {
    "entity": "BIGINT",
    "integer": "BIGINT",
    "real": "DOUBLE",
    "number": "DOUBLE",
    "text": "VARCHAR",
    "flag": "BOOLEAN",
}
_WORDS: dict[ValueType, str] = {
    "entity": "an entity",
    "real": "a number",
    "integer": "a number",
    "number": "a number",
    "text": "a text",
    "flag": "True or False",
    "list": "a list",
    "record": "a dict",
    "nothing": "nothing",
}


@dataclass(frozen=True)
class Signature:
    """A user's function as SQL calls it: its name here and there, what it takes and yields."""

    function: str
    name: str
    parameters: tuple[Tag, ...]
    result: Tag


ANY = Tag("any")
REAL = Tag("real")
INTEGER = Tag("integer")
TEXT = Tag("text")
FLAG = Tag("flag")


def tag_of(value: Any, schema_of: SchemaOf) -> Tag:
    """The type of a value.

    Args:
        value: any value.
        schema_of: gives the schema of a world.
    """
    match value:
        case bool():
            return FLAG
        case int():
            return INTEGER if abs(value) < EXACT else ANY
        case float():
            return REAL if math.isfinite(value) else ANY
        case str():
            return ANY if "\0" in value or (not value.isprintable() and _is_torn(value)) else TEXT
        case None:
            return Tag("nothing")
        case Entity():
            return Tag("entity", schema=schema_of(value.world))
        case list():
            tag = merged(tag_of(element, schema_of) for element in value)
            if tag is not None and not tag.is_sql:
                return ANY
            return Tag("list", tag, 3 if len(value) == 3 else None)
        case dict():
            return _record(value, schema_of)
    return ANY


def _is_torn(text: str) -> bool:
    """Whether it has half of a surrogate pair, which UTF-8 has no letters for."""
    return any("\ud800" <= letter <= "\udfff" for letter in text)


def _record(value: Mapping[Any, Any], schema_of: SchemaOf) -> Tag:
    if not value or len(value) > MOST_FIELDS:
        return ANY
    folded = {key.casefold() for key in value if isinstance(key, str) and key}
    if len(folded) < len(value):  # SQL does not tell upper from lower case
        return ANY
    fields = tuple((key, tag_of(part, schema_of)) for key, part in value.items())
    return Tag("record", fields=fields)


def merged(tags: Iterable[Tag]) -> Tag | None:
    """The type of what is one of several types; None of none."""
    distinct = list(dict.fromkeys(tags))
    return reduce(_both, distinct) if distinct else None


def _both(a: Tag, b: Tag) -> Tag:
    if a == b:
        return a
    if a.is_number and b.is_number:
        return Tag("number", nullable=a.nullable or b.nullable)
    if a.type == b.type == "list":
        elements = [tag.element for tag in (a, b) if tag.element is not None]
        length = a.length if a.length == b.length else None
        element = merged(elements)
        return Tag("list", element, length) if element is None or element.is_sql else ANY
    if a.type == b.type == "record" and [k for k, _ in a.fields] == [k for k, _ in b.fields]:
        pairs = zip(a.fields, b.fields, strict=True)
        return Tag("record", fields=tuple((k, _both(t, u)) for (k, t), (_, u) in pairs))
    if a.type == b.type and a.schema == b.schema:
        return replace(a, nullable=a.nullable or b.nullable)
    return ANY


def to_sql(value: Any) -> Any:
    """A value as SQL takes it: entities by their ids."""
    if isinstance(value, Entity):
        return value.column("id")
    if isinstance(value, list):
        return [to_sql(element) for element in value]
    return value


Converter: TypeAlias = Callable[[Any], Any]


def converter(tag: Tag, worlds: Mapping[str, World]) -> Converter | None:
    """What makes values of those that SQL gives back: entities of ids; None if they are."""
    if tag.type == "entity" and tag.schema is not None:
        entity = worlds[tag.schema].entity
        return lambda value: None if value is None else entity(value)
    if tag.type == "list" and tag.element is not None:
        inner = converter(tag.element, worlds)
        return None if inner is None else lambda values: [inner(value) for value in values]
    return None
