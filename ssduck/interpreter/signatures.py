"""Reads the type hints of Python functions, so that SQL can call them."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from zlib import crc32

from ssduck.sql.types import BOOLEAN, DOUBLE, INTEGER, STRING, Signature, SqlType
from ssduck.world.entities import Entity
from ssduck.world.handles import Link

_TYPES: dict[object, SqlType] = {bool: BOOLEAN, int: INTEGER, float: DOUBLE, str: STRING}


@dataclass(frozen=True)
class TypeHints:
    """The types of a function's parameters, all of them positional, and of its result."""

    parameters: tuple[SqlType, ...]  # the types of the parameters
    required: int  # the number of parameters without a default
    result: SqlType  # the type of the result

    def signature(self, name: str, arguments: tuple[SqlType, ...]) -> Signature | None:
        """Returns the SQL signature of the function for such arguments; None if they do not fit."""
        if not self.required <= len(arguments) <= len(self.parameters):
            return None
        accepted = [
            _accepted_type(parameter, argument)
            for parameter, argument in zip(self.parameters, arguments, strict=False)
        ]
        parameters = tuple(sql_type for sql_type in accepted if sql_type is not None)
        if len(parameters) < len(arguments):
            return None
        # SQL does not tell upper from lower case, and one name has one signature.
        types = [(t.duckdb_type, t.schema, t.past, t.table) for t in (*parameters, self.result)]
        checksum = crc32(repr((name, types)).encode())
        return Signature(name, f"{name} {checksum:08x}", parameters, self.result)


def _accepted_type(parameter: SqlType, argument: SqlType) -> SqlType | None:
    """Returns the type of an argument as the function takes it; None if it does not fit."""
    if parameter.type == "entity":
        fits = argument.type == "entity" and parameter.table in ("entities", argument.table)
        return argument if fits and argument.schema else None
    if parameter.type == "double" and argument.is_number:
        # The function may tell 3 from 3.0.
        return DOUBLE if argument.type == "double" else None
    if parameter.type == "list":
        fits = argument.type == "list" and (
            argument.element is None or parameter.element == argument.element
        )
        return replace(parameter, length=None) if fits else None
    return parameter if parameter.type == argument.type else None


def type_hints_of(call: Callable[..., Any]) -> TypeHints | None:
    """Returns the types in a function's hints; None if one is missing or has no SQL type.

    >>> def double(x: float) -> float:
    ...     return 2 * x
    >>> type_hints_of(double).result.type
    'double'
    """
    try:
        parameters = inspect.signature(call).parameters.values()
        hints = typing.get_type_hints(call)
    except (TypeError, ValueError, NameError, AttributeError):
        return None
    if any(p.kind not in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) for p in parameters):
        return None
    accepted = [_sql_type(hints.get(parameter.name)) for parameter in parameters]
    result = _sql_type(hints.get("return"))
    sql_types = tuple(sql_type for sql_type in accepted if sql_type is not None)
    if result is None or result.type == "entity" or len(sql_types) < len(accepted):
        return None
    return TypeHints(sql_types, sum(p.default is p.empty for p in parameters), result)


def _sql_type(hint: object) -> SqlType | None:
    if hint is Entity:
        return SqlType("entity")
    if hint is Link:
        return SqlType("entity", table="links")
    if typing.get_origin(hint) is list:
        (inner,) = typing.get_args(hint)
        element = _sql_type(inner)
        return None if element is None or element.type == "entity" else SqlType("list", element)
    return _TYPES.get(hint) if isinstance(hint, type) else None
