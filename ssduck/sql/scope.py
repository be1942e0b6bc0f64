"""The scope of a query's expressions in SQL: elements of sources, variables, ticks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Self

from sqlglot import exp

from ssduck.errors import UnknownNameError, nearest
from ssduck.formatting import short_repr
from ssduck.language.analysis import IMPURE, OVER_TIME, free_aliases, is_impure
from ssduck.language.builtins import BUILTINS
from ssduck.language.tree import (
    Assignment,
    Call,
    Name,
    Node,
    QualifiedName,
    Query,
    This,
    TimeIndex,
    UnresolvedName,
)
from ssduck.sql.operators import truth
from ssduck.sql.past_ticks import QueryTicks
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.sql_values import NotSqlError, SqlValue, StatementContext


class ExpressionScope(ABC):
    """The scope of the expressions of one query; `Expressions` translates them.

    Args:
        context: what all queries of the statement have in common.
        outer: the scope of the query around this one.

    Attributes:
        rows: the current element of each source, by alias.
        only_alias: the alias of the only source; None if there are several.
        locals: the state variables of a hierarchical query.
        ticks: the ticks of its entities.
    """

    def __init__(self, context: StatementContext, outer: ExpressionScope | None = None) -> None:
        self.context = context
        self.names = context.names
        self.outer = outer
        self.rows: dict[str, SqlValue] = {}
        self.only_alias: str | None = None
        self.locals: Mapping[str, SqlValue] = outer.locals if outer else {}
        self._are_constant: dict[Node, bool] = {}
        self.ticks: QueryTicks = QueryTicks(context, self.rows, outer.ticks if outer else None)

    def inside(self) -> Self:
        """Returns the expressions of a query nested in this one."""
        return type(self)(self.context, self)

    # -- constants --------------------------------------------------------------------------

    def element(self, alias: str | None) -> SqlValue | None:
        """Returns the current element of a source of this query or of one around it in SQL."""
        name = self.only_alias if alias is None else alias
        if name is not None and name in self.rows:
            return self.rows[name]
        # `this` alone is never that of a query further out.
        return self.outer.element(alias) if self.outer and alias is not None else None

    def is_constant(self, node: Node) -> bool:
        """Checks whether the node has the same value for all rows of the statement."""
        if node not in self._are_constant:  # all that contain a part ask for it
            self._are_constant[node] = self._is_constant(node)
        return self._are_constant[node]

    def _is_constant(self, node: Node) -> bool:
        match node:
            case This():
                return self._is_outside(node)
            case UnresolvedName() | Assignment():
                return False
            case QualifiedName():
                return not self._is_variable(node) and self._is_outside(node.this)
            case Name(name=name):
                deferred = self.context.list_in(name)
                if deferred is not None:
                    return self.is_constant(deferred)
                return name not in self.context.changing
            case TimeIndex(name=name) if name in self.context.changing:
                return False
            case Query():
                return not (
                    any(alias is None or self.element(alias) for alias in free_aliases(node))
                    or is_impure(node)
                    or any(self._is_changing(part) for part in node.walk())
                )
            case Call(name=name) if name in RELATIONS or name in IMPURE or name in OVER_TIME:
                return False
            case Call(name=name) if name not in BUILTINS and self.ticks.has_past:
                return False  # an entity that a user's function takes is that of the row's tick
        return all(self.is_constant(child) for child in node.children())

    def _is_variable(self, node: QualifiedName) -> bool:
        """Checks whether the alias is a variable; the plan is of use as long as that is so."""
        is_variable = self.context.plan.bare[node.alias] = self.names.has_variable(node.alias)
        return is_variable

    def _is_outside(self, node: This) -> bool:
        """Checks whether it is the element of a source further out than this SQL statement."""
        if node.alias is None or self.element(node.alias) is not None:
            return False
        if not self.names.has_source(node.alias):
            aliases = list(self.rows)
            raise UnknownNameError(
                f"there is no source {short_repr(node.alias)} here",
                span=node.span,
                suggestions=nearest(node.alias, aliases) or aliases[:3],
            )
        return True

    def _is_changing(self, node: Node) -> bool:
        if not isinstance(node, Name | TimeIndex):
            return False
        return node.name in self.context.changing or self.context.list_in(node.name) is not None

    # -- values -----------------------------------------------------------------------------

    @abstractmethod
    def value(self, node: Node) -> SqlValue:
        """Returns the node as SQL."""

    def condition(self, node: Node) -> exp.Expr:
        """Returns the node as a condition."""
        return truth(self.value(node))

    def number(self, node: Node) -> SqlValue:
        """Returns the node as SQL, if it is a number and never NULL; else NotSqlError."""
        value = self.value(node)
        if not value.sql_type.is_number or value.sql_type.nullable:
            raise NotSqlError
        return value
