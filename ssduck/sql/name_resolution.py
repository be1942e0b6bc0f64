"""Resolves the bare names in a query once its sources are known.

>>> from ssduck.sql.examples import resolved_query
>>> print(resolved_query("SELECT id FROM kitchen WHERE isRobot ORDER BY z;").outline())
Query([Name('id')], [Source('kitchen', Name('kitchen'))], Call('isRobot', [This(None)]),
      [OrderKey(Call('z', [This(None)]), False)])
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace

from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.language.aggregates import is_grouped, over_rows
from ssduck.language.analysis import states
from ssduck.language.clauses import SelectedValue
from ssduck.language.overrides import written_name
from ssduck.language.tree import (
    Assignment,
    Binary,
    Call,
    Index,
    Literal,
    Name,
    Node,
    OrderKey,
    QualifiedName,
    Query,
    This,
    TimeIndex,
    Unary,
    UnresolvedName,
)
from ssduck.sql.plan import SourceType, TypeEnvironment
from ssduck.sql.relations.registry import RELATIONS

# The types of values that are no lists, so that an aggregate of one is over the rows.
_SCALARS = frozenset(("double", "integer", "number", "string", "boolean"))


@dataclass
class ResolvedQuery:
    """A query whose bare names have been looked up.

    Attributes:
        query: the query; its remaining names are variables.
        columns: the selected columns.
        bare: the resolved names, and whether there was a variable of that name.
    """

    query: Query
    columns: tuple[SelectedValue, ...] = ()
    bare: dict[str, bool] = field(default_factory=dict)


def resolve(
    query: Query,
    source_types: Sequence[SourceType],
    names: TypeEnvironment,
    outer: Collection[str] = (),
) -> ResolvedQuery:
    """Resolves the bare names in SELECT, GROUP BY, HAVING and ORDER BY, and in WHERE functions.

    Such a name is a key of the current element if that is a dict, else a variable, else the
    function of that name applied to `this`.

    Args:
        query: the query.
        source_types: what its sources are.
        names: the variables and functions.
        outer: the state variables of outer hierarchical queries.

    Raises:
        UnknownNameError: it is none of these.
    """
    return _Resolver(query, source_types, names, outer).resolved()


class _Resolver:
    def __init__(
        self,
        query: Query,
        source_types: Sequence[SourceType],
        names: TypeEnvironment,
        outer: Collection[str],
    ) -> None:
        self._query = query
        self._source_types = source_types
        self._names = names
        self._states = states(query).union(outer)
        self._bare: dict[str, bool] = {}
        self._named_columns = dict(_named_columns(query))

    def resolved(self) -> ResolvedQuery:
        query = self._query
        changed = replace(
            query,
            where=None if query.where is None else query.where.replaced(self._in_where),
            group=tuple(map(self._key, query.group)),
            having=None if query.having is None else self._key(query.having),
            order=tuple(OrderKey(k.span, self._key(k.value), k.descending) for k in query.order),
        )
        columns = tuple(self._columns())
        if self._aggregates_all_rows(columns):
            changed = replace(changed, having=Literal(query.span, True))
        return ResolvedQuery(changed, columns, self._bare)

    def _aggregates_all_rows(self, columns: Sequence[SelectedValue]) -> bool:
        """Checks whether SELECT has aggregates that can only be over all rows: `avg(z)`.

        An aggregate of a number or a text of one row would be an error.
        """
        if self._query.recursion is not None or is_grouped(self._query):
            return False
        calls = (call for column in columns for call in over_rows(column.node))
        return any(self._is_scalar_of_row(call.arguments[0]) for call in calls)

    def _is_scalar_of_row(self, node: Node) -> bool:
        """Checks whether a value is certainly a number, a text or a truth value of a row."""
        match node:
            case Call(name=name, arguments=arguments) if name in RELATIONS:
                is_of_row = any(isinstance(argument, This) for argument in arguments)
                return is_of_row and RELATIONS[name].result in _SCALARS
            case QualifiedName(alias=alias, key=key):
                is_entity = any(t.alias == alias and _has_entities(t) for t in self._source_types)
                if not is_entity or self._names.has_variable(alias):
                    return False
                name = self._names.resolved_name(key)
                return name in RELATIONS and RELATIONS[name].result in _SCALARS
            case Unary(operand=operand):
                return self._is_scalar_of_row(operand)
            case Binary(operator="+" | "-" | "*" | "/" | "%" | "^", left=left, right=right):
                sides = (left, right)
                is_known = all(
                    isinstance(side, Literal) or self._is_scalar_of_row(side) for side in sides
                )
                return is_known and not all(isinstance(side, Literal) for side in sides)
        return False

    def _columns(self) -> Iterator[SelectedValue]:
        if not self._query.items:
            for source_type in self._source_types:
                yield SelectedValue(This(self._query.span, source_type.alias), source_type.alias)
        for node in self._query.items:
            match node:
                case Call(name="to", arguments=(value, Literal(value=str() as name))):
                    yield SelectedValue(self._resolved(value), name)
                case Call(name="to", arguments=(value, name_node)):
                    yield SelectedValue(self._resolved(value), self._resolved(name_node))
                case Call(name="to"):
                    raise ArgumentError("to takes 2 arguments: to(value, name)", span=node.span)
                case Call(name=name) | Name(name=name) | TimeIndex(name=name):
                    yield SelectedValue(self._resolved(node), written_name(name))
                case Assignment(name=name, is_bare=True):
                    yield SelectedValue(self._resolved(node), name)
                case QualifiedName(key=key):
                    yield SelectedValue(node, key)
                case This(alias=alias):
                    yield SelectedValue(node, alias or "this")
                case Index(indices=(*_, Literal(value=str() as key))):
                    yield SelectedValue(self._resolved(node), key)
                case _:
                    yield SelectedValue(self._resolved(node), "value")

    def _resolved(self, node: Node) -> Node:
        return node.replaced(self._looked_up)

    def _key(self, node: Node) -> Node:
        """Returns a part of GROUP BY, HAVING or ORDER BY, where columns have their names, too."""
        return node.replaced(lambda part: self._column_named(part) or self._looked_up(part))

    def _column_named(self, part: Node) -> Node | None:
        if not isinstance(part, Name) or part.name not in self._named_columns:
            return None
        if part.name in self._states or self._names.has_variable(part.name):
            return None
        only = self._source_types[0] if len(self._source_types) == 1 else None
        if only is not None and (only.sql_type is not None and only.sql_type.type == "record"):
            if any(key == part.name for key, _ in only.sql_type.fields):
                return None
        elif only is not None and (only.dicts or not only.known):
            return None
        name = self._names.resolved_name(part.name)
        call = Call(part.span, name, (This(part.span, None),), part.span)
        try:
            self._names.check_call(call)
        except SelectScriptError:
            self._bare[part.name] = False
            return self._resolved(self._named_columns[part.name])
        return None

    def _in_where(self, part: Node) -> Node | None:
        """Returns a bare name in WHERE: a function of the only element if there is no variable."""
        if isinstance(part, Query | QualifiedName):
            return part
        if not isinstance(part, Name) or part.name in self._states:
            return None
        only = self._source_types[0] if len(self._source_types) == 1 else None
        known = self._bare[part.name] = self._names.has_variable(part.name)
        is_record = (
            only is not None and only.sql_type is not None and only.sql_type.type == "record"
        )
        if known or only is None:
            return part
        if is_record or only.dicts or not only.known:
            return self._looked_up(part)
        name = self._names.resolved_name(part.name)
        call = Call(part.span, name, (This(part.span, None),), part.span)
        try:
            self._names.check_call(call)
        except SelectScriptError:  # the error at its evaluation is more precise
            return part
        return call

    def _looked_up(self, part: Node) -> Node | None:
        if isinstance(part, Query | QualifiedName):
            return part
        if not isinstance(part, Name) or part.name in self._states:
            return part if isinstance(part, Name) else None
        only = self._source_types[0] if len(self._source_types) == 1 else None
        if only is not None and only.sql_type is not None and only.sql_type.type == "record":
            if any(key == part.name for key, _ in only.sql_type.fields):
                key = Literal(part.span, part.name)
                return Index(part.span, This(part.span, None), (key,))
        elif only is not None and (only.dicts or not only.known):
            return UnresolvedName(part.span, part.name)
        known = self._bare[part.name] = self._names.has_variable(part.name)
        if known:
            return part
        name = self._names.resolved_name(part.name)
        call = Call(part.span, name, (This(part.span, None),), part.span)
        self._names.check_call(call)
        return call


def _has_entities(source_type: SourceType) -> bool:
    """Checks whether the elements of a source are entities."""
    element = source_type.sql_type
    return source_type.schema is not None or (element is not None and element.type == "entity")


def _named_columns(query: Query) -> Iterator[tuple[str, Node]]:
    """Yields the columns that have names of their own: what `to` and AS name."""
    for node in query.items:
        match node:
            case Call(name="to", arguments=(value, Literal(value=str() as name))):
                yield name, value
