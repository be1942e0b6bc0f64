"""What the hints of a Python function tell SQL of it."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from zlib import crc32

from ssduck.sql.types import BOOLEAN, DOUBLE, INTEGER, STRING, Signature, SqlType
from ssduck.world.entities import Entity

_TYPES: dict[object, SqlType] = {bool: BOOLEAN, int: INTEGER, float: DOUBLE, str: STRING}


@dataclass(frozen=True)
class TypeHints:
    """The types of a function's parameters, all of them positional, and of its result."""

    parameters: tuple[SqlType, ...]
    required: int
    result: SqlType

    def signature(self, name: str, arguments: tuple[SqlType, ...]) -> Signature | None:
        """How SQL calls the function with such arguments; None if they do not fit."""
        if not self.required <= len(arguments) <= len(self.parameters):
            return None
        taken = [
            _taken(parameter, argument)
            for parameter, argument in zip(self.parameters, arguments, strict=False)
        ]
        parameters = tuple(tag for tag in taken if tag is not None)
        if len(parameters) < len(arguments):
            return None
        # SQL does not tell upper from lower case, and one name has one signature.
        told = crc32(repr((name, parameters, self.result)).encode())
        return Signature(name, f"{name} {told:08x}", parameters, self.result)


def _taken(parameter: SqlType, argument: SqlType) -> SqlType | None:
    """An argument's type as the function takes it; None if it does not."""
    if parameter.type == "entity":
        return argument if argument.type == "entity" and argument.schema else None
    if parameter.type == "real" and argument.is_number:
        # The function may tell 3 from 3.0.
        return DOUBLE if argument.type == "real" else None
    if parameter.type == "list":
        fits = argument.type == "list" and (
            argument.element is None or parameter.element == argument.element
        )
        return replace(parameter, length=None) if fits else None
    return parameter if parameter.type == argument.type else None


def hints_of(call: Callable[..., Any]) -> TypeHints | None:
    """The types that a function's hints tell of; None if some are missing or are not SQL's."""
    try:
        parameters = inspect.signature(call).parameters.values()
        hints = typing.get_type_hints(call)
    except (TypeError, ValueError, NameError, AttributeError):
        return None
    if any(p.kind not in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) for p in parameters):
        return None
    taken = [_tag(hints.get(parameter.name)) for parameter in parameters]
    result = _tag(hints.get("return"))
    tags = tuple(tag for tag in taken if tag is not None)
    if result is None or result.type == "entity" or len(tags) < len(taken):
        return None
    return TypeHints(tags, sum(p.default is p.empty for p in parameters), result)


def _tag(hint: object) -> SqlType | None:
    if hint is Entity:
        return SqlType("entity")
    if typing.get_origin(hint) is list:
        (inner,) = typing.get_args(hint)
        element = _tag(inner)
        return None if element is None or element.type == "entity" else SqlType("list", element)
    return _TYPES.get(hint) if isinstance(hint, type) else None
