"""Converts values to SQL and back: their types, and the ids of entities."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from operator import itemgetter
from typing import Any, TypeAlias

import numpy as np

from ssduck.recording.replay.record import Record
from ssduck.sql.types import ANY, BOOLEAN, DOUBLE, EXACT, IDS, INTEGER, STRING, SqlType, merged
from ssduck.world.handles import Handle
from ssduck.world.world import World

# The largest number of keys of a dict that become columns.
MAX_FIELDS = 200

SchemaOf: TypeAlias = Callable[[World], str]


def sql_type_of(value: Any, schema_of: SchemaOf) -> SqlType:
    """Returns the SQL type of a value."""
    return _type_of_class(type(value), (value,), schema_of)


def common_sql_type(values: Sequence[Any], schema_of: SchemaOf) -> SqlType | None:
    """Returns the common SQL type of values; None for no values.

    Values of one class are examined together, as there may be millions.
    """
    kinds = dict.fromkeys(map(type, values))
    return merged(
        _type_of_class(
            kind, values if len(kinds) == 1 else [v for v in values if type(v) is kind], schema_of
        )
        for kind in kinds
    )


def _type_of_class(kind: type, values: Sequence[Any], schema_of: SchemaOf) -> SqlType:
    for plain, of_values in _PLAIN.items():
        if issubclass(kind, plain):
            return of_values(values)
    if issubclass(kind, list):
        return _list(values, schema_of)
    if issubclass(kind, dict):
        return _record(values, schema_of)
    return merged(_type_of_object(value, schema_of) for value in values) or ANY


def _type_of_object(value: Any, schema_of: SchemaOf) -> SqlType:
    match value:
        case None:
            return SqlType("nothing")
        case Handle() if value.is_there:  # SQL has no row of a removed entity
            past = value.moment is not None
            schema, table = schema_of(value.world), value.TABLE
            return SqlType("entity", schema=schema, past=past, table=table)
        case np.ndarray() if value.shape == (3,) and value.dtype.kind in "iuf":
            return SqlType("array") if np.isfinite(value).all() else ANY
    return ANY


def _integer(values: Sequence[int]) -> SqlType:
    return INTEGER if min(values) > -EXACT and max(values) < EXACT else ANY


def _double(values: Sequence[float]) -> SqlType:
    return DOUBLE if all(map(math.isfinite, values)) else ANY


def _text(values: Sequence[str]) -> SqlType:
    unprintable = [text for text in values if not text.isprintable()]
    return ANY if any("\0" in text or _has_lone_surrogate(text) for text in unprintable) else STRING


def _has_lone_surrogate(text: str) -> bool:
    """Checks whether a text has half of a surrogate pair, which UTF-8 cannot encode."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return True
    return False


_PLAIN: dict[type, Callable[[Sequence[Any]], SqlType]] = {
    bool: lambda _: BOOLEAN,  # before int, of which it is a kind
    int: _integer,
    float: _double,
    str: _text,
}


def _list(values: Sequence[list[Any]], schema_of: SchemaOf) -> SqlType:
    lists = list({id(value): value for value in values}.values())
    elements = lists[0] if len(lists) == 1 else list(chain.from_iterable(lists))
    sql_type = common_sql_type(elements, schema_of)
    list_type = SqlType("list", sql_type, 3 if set(map(len, lists)) == {3} else None)
    return list_type if list_type.is_sql else ANY


def _record(values: Sequence[Mapping[Any, Any]], schema_of: SchemaOf) -> SqlType:
    key_tuples = set(map(tuple, values))
    keys = key_tuples.pop()
    if key_tuples or not keys or len(keys) > MAX_FIELDS:
        return ANY
    folded = {key.casefold() for key in keys if isinstance(key, str) and key}
    if len(folded) < len(keys):  # SQL ignores case
        return ANY
    field_types = [
        (key, common_sql_type(list(map(itemgetter(key), values)), schema_of)) for key in keys
    ]
    return SqlType("record", fields=tuple((key, sql_type or ANY) for key, sql_type in field_types))


def is_exactly(value: Any, sql_type: SqlType) -> bool:
    """Checks whether a value has a type, and SQL preserves it: 3 is not a double, 3.0 is."""
    element = sql_type.element
    if sql_type.type == "list":
        is_list = type(value) is list
        return is_list and (element is None or all(is_exactly(part, element) for part in value))
    kind = type(value)
    return kind in _PLAIN and _PLAIN[kind]((value,)).type == sql_type.type


def to_sql(value: Any) -> Any:
    """Returns a value for SQL: an entity as its id, at a recorded tick as its key.

    >>> to_sql([1, "cup"])
    [1, 'cup']
    """
    if isinstance(value, Handle):
        if value.moment is not None:
            return value.moment.tick * IDS + value.id
        return value.column("id")
    if isinstance(value, list):
        return [to_sql(element) for element in value]
    return point_of(value) if isinstance(value, np.ndarray) else value


def point_of(value: Any) -> Any:
    """Returns a list or an array of three numbers as doubles, [x, y, z]; another value as it is.

    >>> point_of([1, 0.5, 0])
    [1.0, 0.5, 0.0]
    """
    numbers = value.tolist() if isinstance(value, np.ndarray) else value
    is_point = (
        type(numbers) is list and len(numbers) == 3 and set(map(type, numbers)) <= {int, float}
    )
    return list(map(float, numbers)) if is_point else value


Converter: TypeAlias = Callable[[Any], Any]


def converter(
    sql_type: SqlType, world: Callable[[str], World], record: Callable[[str], Record]
) -> Converter | None:
    """Returns the function from SQL's values to Python's; None if they are the same.

    The worlds and their records are found by their schemas.
    """
    schema = sql_type.schema
    if sql_type.type == "entity" and schema is not None:
        if sql_type.past:
            return lambda key: None if key is None else record(schema).handle(*divmod(key, IDS))
        return lambda value: None if value is None else world(schema).handle(value)
    if sql_type.type == "list" and sql_type.element is not None:
        convert = converter(sql_type.element, world, record)
        return None if convert is None else lambda values: list(map(convert, values))
    return None
