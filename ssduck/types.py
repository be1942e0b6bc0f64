"""The types of values, as far as SQL knows them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import chain
from operator import itemgetter
from typing import Any, TypeAlias

from ssduck.entities import Entity
from ssduck.record import Record
from ssduck.relations import ValueType
from ssduck.world import World

# Larger integers are not all numbers that a DOUBLE can be.
EXACT = 2**53
# The key of an entity at a recorded tick is tick * IDS + id: ids are fewer than this.
IDS = 2**25
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
        past: of an entity, whether it is one at a recorded tick.
        nullable: whether there may be none.
        fields: of a record, its keys and what they hold.
    """

    type: ValueType
    element: Tag | None = None
    length: int | None = None
    schema: str | None = None
    past: bool = False
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
                element = self.element
                return element is None or (element.is_sql and element.type != "record")
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
            return _integer((value,))
        case float():
            return _real((value,))
        case str():
            return _text((value,))
        case None:
            return Tag("nothing")
        case Entity() if not value.is_there:  # of one that is gone SQL knows nothing
            return ANY
        case Entity():
            past = value.moment is not None
            return Tag("entity", schema=schema_of(value.world), past=past)
        case list():
            return _list((value,), schema_of)
        case dict():
            return _record((value,), schema_of)
    return ANY


def tag_of_any(values: Sequence[Any], schema_of: SchemaOf) -> Tag | None:
    """The type of what is one of many values; None of none.

    Values of one kind are looked at together: there may be millions.

    Args:
        values: any values.
        schema_of: gives the schema of a world.
    """
    kinds = dict.fromkeys(map(type, values))
    return merged(
        _of_kind(kind, values if len(kinds) == 1 else _of(kind, values), schema_of)
        for kind in kinds
    )


def _of(kind: type, values: Sequence[Any]) -> list[Any]:
    return [value for value in values if type(value) is kind]


def _of_kind(kind: type, values: Sequence[Any], schema_of: SchemaOf) -> Tag:
    if kind in _PLAIN:
        return _PLAIN[kind](values)
    if kind is list:
        return _list(values, schema_of)
    if kind is dict:
        return _record(values, schema_of)
    return merged(tag_of(value, schema_of) for value in values) or ANY


def _integer(values: Sequence[int]) -> Tag:
    return INTEGER if min(values) > -EXACT and max(values) < EXACT else ANY


def _real(values: Sequence[float]) -> Tag:
    return REAL if all(map(math.isfinite, values)) else ANY


def _text(values: Sequence[str]) -> Tag:
    odd = [text for text in values if not text.isprintable()]
    return ANY if any("\0" in text or _is_torn(text) for text in odd) else TEXT


def _is_torn(text: str) -> bool:
    """Whether it has half of a surrogate pair, which UTF-8 has no letters for."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return True
    return False


_PLAIN: dict[type, Callable[[Sequence[Any]], Tag]] = {
    bool: lambda _: FLAG,
    int: _integer,
    float: _real,
    str: _text,
}


def _list(values: Sequence[list[Any]], schema_of: SchemaOf) -> Tag:
    lists = list({id(value): value for value in values}.values())
    parts = lists[0] if len(lists) == 1 else list(chain.from_iterable(lists))
    tag = tag_of_any(parts, schema_of)
    whole = Tag("list", tag, 3 if set(map(len, lists)) == {3} else None)
    return whole if whole.is_sql else ANY


def _record(values: Sequence[Mapping[Any, Any]], schema_of: SchemaOf) -> Tag:
    different = set(map(tuple, values))
    keys = different.pop()
    if different or not keys or len(keys) > MOST_FIELDS:
        return ANY
    folded = {key.casefold() for key in keys if isinstance(key, str) and key}
    if len(folded) < len(keys):  # SQL does not tell upper from lower case
        return ANY
    parts = [(key, tag_of_any(list(map(itemgetter(key), values)), schema_of)) for key in keys]
    return Tag("record", fields=tuple((key, tag or ANY) for key, tag in parts))


def is_exactly(value: Any, tag: Tag) -> bool:
    """Whether a value is of a type, and SQL gives it back as it is: 3 is no real, 3.0 is.

    Args:
        value: any value.
        tag: True or False, a number, a text, or lists of these.
    """
    element = tag.element
    if tag.type == "list":
        of_lists = type(value) is list
        return of_lists and (element is None or all(is_exactly(part, element) for part in value))
    kind = type(value)
    return kind in _PLAIN and _PLAIN[kind]((value,)).type == tag.type


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
    if a.type == b.type != "record" and (a.schema, a.past) == (b.schema, b.past):
        return replace(a, nullable=a.nullable or b.nullable)
    return ANY


def to_sql(value: Any) -> Any:
    """A value as SQL takes it: entities by their ids, at a recorded tick by their keys."""
    if isinstance(value, Entity):
        if value.moment is not None:
            return value.moment.tick * IDS + value.id
        return value.column("id")
    if isinstance(value, list):
        return [to_sql(element) for element in value]
    return value


Converter: TypeAlias = Callable[[Any], Any]


def converter(
    tag: Tag, worlds: Mapping[str, World], records: Mapping[str, Record]
) -> Converter | None:
    """What makes values of those that SQL gives back: entities of ids; None if they are.

    Args:
        tag: the type of the values.
        worlds: by schema.
        records: what is kept of those that are recorded.
    """
    schema = tag.schema
    if tag.type == "entity" and schema is not None:
        if tag.past:
            return lambda key: None if key is None else records[schema].entity(*divmod(key, IDS))
        return lambda value: None if value is None else worlds[schema].entity(value)
    if tag.type == "list" and tag.element is not None:
        inner = converter(tag.element, worlds, records)
        return None if inner is None else lambda values: [inner(value) for value in values]
    return None
