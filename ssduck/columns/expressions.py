"""What an expression is compiled to: the type of its value, and the function that computes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

# `decimal` is a literal with a point, which SQL compares exactly with other literals; `object` is
# any value that only passes through.
Kind: TypeAlias = Literal["double", "integer", "decimal", "boolean", "string", "list", "object"]
NUMBERS: tuple[Kind, ...] = ("double", "integer", "decimal")
# The values of leaves, which are parameters and columns, and of parts that were computed, by key.
Values: TypeAlias = Mapping[Any, Any]
# Returns the value of an expression.
Compute: TypeAlias = Callable[[Any], Any]


class LeftToDuckDBError(Exception):
    """An expression, or a value, that DuckDB evaluates."""


@dataclass(frozen=True)
class Expression:
    """An expression as a function.

    Attributes:
        kind: the type of its value.
        compute: a function of the values of leaves that returns its value.
        has_calls: whether it asks for shapes or contacts, which costs more than all else.
    """

    kind: Kind
    compute: Compute
    has_calls: bool = False
