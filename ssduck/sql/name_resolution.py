"""Resolves the bare names in a query once its sources are known."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace

from ssduck.errors import ArgumentError, SelectScriptError, SourceSpan
from ssduck.language import ast
from ssduck.language.aggregates import is_grouped, is_one_group, over_rows
from ssduck.language.analysis import free_aliases, states, written_name
from ssduck.language.builtins import AGGREGATES, NUMBER_FUNCTIONS
from ssduck.language.clauses import SelectedValue
from ssduck.sql.plan import SourceType, TypeEnvironment
from ssduck.sql.relations.registry import RELATIONS

# The types of values that are no lists, so that an aggregate of one is over the rows.
SCALARS = frozenset(("double", "integer", "number", "string", "boolean"))


@dataclass
class ResolvedQuery:
    """A query whose bare names have been looked up."""

    query: ast.Query  # the query; its remaining names are variables
    columns: tuple[SelectedValue, ...] = ()  # the selected columns
    # The resolved names, and whether there was a variable of that name.
    bare: dict[str, bool] = field(default_factory=dict)


def resolve(
    query: ast.Query,
    source_types: Sequence[SourceType],
    names: TypeEnvironment,
    outer: Collection[str] = (),
) -> ResolvedQuery:
    """Resolves the bare names in SELECT, GROUP BY, HAVING and ORDER BY, and in WHERE functions.

    Such a name is a key of the current element if that is a dict, else a variable, else the
    function of that name applied to `this`.
    """
    return _Resolver(query, source_types, names, outer).resolved()


class _Resolver:
    def __init__(
        self,
        query: ast.Query,
        source_types: Sequence[SourceType],
        names: TypeEnvironment,
        outer: Collection[str],
    ) -> None:
        self._query = query
        self._source_types = source_types
        self._names = names
        self._only = source_types[0] if len(source_types) == 1 else None
        # The keys of the only source's elements if these are records; None if they are others.
        self._keys: frozenset[str] | None = None
        only_type = None if self._only is None else self._only.sql_type
        if only_type is not None and only_type.type == "record":
            self._keys = frozenset(key for key, _ in only_type.fields)
        self._states = states(query).union(outer)
        self._bare: dict[str, bool] = {}
        self._named_columns: dict[str, ast.Node] = {}  # the columns that `to` and AS name
        self._as_names: set[str] = set()  # those that AS names, as in SQL
        for node in query.items:
            match node:
                case ast.Call(name="to", arguments=(value, ast.Literal(value=str() as name))):
                    self._named_columns[name] = value
                    if node.name_span == node.span:  # `to` is called by its name
                        self._as_names.add(name)

    def resolved(self) -> ResolvedQuery:
        query = self._query
        changed = replace(
            query,
            where=None if query.where is None else query.where.replaced(self._in_where),
            group=tuple(map(self._key, query.group)),
            having=None if query.having is None else self._column_key(query.having),
            order=tuple(
                ast.OrderKey(k.span, self._order(k.value), k.descending) for k in query.order
            ),
        )
        columns = tuple(self._columns())
        if self._aggregates_all_rows(columns):
            changed = replace(changed, having=ast.Literal(query.span, True))
        if is_one_group(changed):  # an unknown aggregate would be taken for a value of one row
            for column in columns:
                self._check_calls(column.node)
        return ResolvedQuery(changed, columns, self._bare)

    def _check_calls(self, node: ast.Node) -> None:
        if isinstance(node, ast.Query):
            return
        if isinstance(node, ast.Call):
            self._names.check_call(node)
        for child in node.children():
            self._check_calls(child)

    def _aggregates_all_rows(self, columns: Sequence[SelectedValue]) -> bool:
        """Checks whether SELECT has aggregates that can only be over all rows: `avg(z)`."""
        if self._query.recursion is not None or is_grouped(self._query):
            return False
        aliases = {None, *(source_type.alias for source_type in self._source_types)}
        calls = (call for column in columns for call in over_rows(column.node))
        arguments = (call.arguments[0] for call in calls)
        return any(free_aliases(node) & aliases and self._is_scalar(node) for node in arguments)

    def _is_scalar(self, node: ast.Node) -> bool:
        """Checks whether a value is certainly a number, a text or a truth value."""
        match node:
            case ast.Literal():
                return True
            case ast.Call(name=name):
                if name in RELATIONS:
                    return RELATIONS[name].result in SCALARS
                return name in NUMBER_FUNCTIONS or (
                    name == "uniq" and self._is_scalar(node.arguments[0])
                )
            case ast.QualifiedName(alias=alias, key=key) if not self._names.has_variable(alias):
                return self._is_scalar_key(alias, key)
            case ast.Index(base=ast.This(alias=alias), indices=(ast.Literal(value=str() as key),)):
                return self._is_scalar_key(alias, key)
            case ast.UnresolvedName():
                # A key, unless a nested query without rows had keys.
                return self._query.sources[0].is_table
            case ast.Unary(operand=operand):
                return node.operator in ("NOT", "IS NULL") or self._is_scalar(operand)
            case ast.Binary(operator="+" | "-" | "*" | "/" | "%" | "^", left=left, right=right):
                return self._is_scalar(left) and self._is_scalar(right)
            case ast.Binary() | ast.OperatorChain(operators=("AND" | "OR" | "XOR", *_)):
                return True
            case ast.If(otherwise=(otherwise,)):
                values = [value for branch in node.branches for value in branch.then[-1:]]
                return all(map(self._is_scalar, (*values, otherwise)))
        return False

    def _is_scalar_key(self, alias: str | None, key: str) -> bool:
        """Checks whether a key of a source's elements, or a function of them, is such a value."""
        for source_type in self._source_types:
            if alias not in (None, source_type.alias):
                continue
            if _has_entities(source_type):
                name = self._names.resolved_name(key)
                return name in RELATIONS and RELATIONS[name].result in SCALARS
            if source_type.sql_type is not None and source_type.sql_type.type == "record":
                return any(
                    name == key and kind.type in SCALARS
                    for name, kind in source_type.sql_type.fields
                )
        return False

    def _columns(self) -> Iterator[SelectedValue]:
        if not self._query.items:
            for source_type in self._source_types:
                yield SelectedValue(
                    ast.This(self._query.span, source_type.alias), source_type.alias
                )
        for node in self._query.items:
            match node:
                case ast.Call(name="to", arguments=(value, ast.Literal(value=str() as name))):
                    yield SelectedValue(self._resolved(value), name)
                case ast.Call(name="to", arguments=(value, name_node)):
                    yield SelectedValue(self._resolved(value), self._resolved(name_node))
                case ast.Call(name="to"):
                    raise ArgumentError("to takes 2 arguments: to(value, name)", span=node.span)
                case ast.Call(name=name) | ast.Name(name=name) | ast.TimeIndex(name=name):
                    yield SelectedValue(self._resolved(node), written_name(name))
                case ast.Assignment(name=name, is_bare=True):
                    yield SelectedValue(self._resolved(node), name)
                case ast.QualifiedName(key=key):
                    yield SelectedValue(node, key)
                case ast.This(alias=alias):
                    yield SelectedValue(node, alias or "this")
                case ast.Index(indices=(*_, ast.Literal(value=str() as key))):
                    yield SelectedValue(self._resolved(node), key)
                case _:
                    yield SelectedValue(self._resolved(node), "value")

    def _resolved(self, node: ast.Node) -> ast.Node:
        return node.replaced(self._looked_up)

    def _key(self, node: ast.Node) -> ast.Node:
        """Returns a part of GROUP BY, HAVING or ORDER BY, where columns have their names, too."""
        return node.replaced(self._key_part)

    def _key_part(self, part: ast.Node) -> ast.Node | None:
        return self._column_named(part) or self._looked_up(part)

    def _order(self, node: ast.Node) -> ast.Node:
        """Returns a key of ORDER BY; within a computed one, functions of the row come first."""
        is_column = isinstance(node, ast.Name) or bool(self._query.group)
        return self._column_key(node) if is_column else self._key(node)

    def _column_key(self, node: ast.Node) -> ast.Node:
        """Returns a part of HAVING or ORDER BY, where the columns that AS names come first."""
        return node.replaced(lambda part: self._as_column(part) or self._key_part(part))

    def _as_column(self, part: ast.Node) -> ast.Node | None:
        match part:
            case ast.Call(name=name) if name in AGGREGATES:
                return self._key(part)  # of the rows, which have no columns yet
            case ast.Name(name=name) if name in self._as_names and not self._is_hidden(name):
                self._bare[name] = False
                return self._resolved(self._named_columns[name])
        return None

    def _is_hidden(self, name: str) -> bool:
        return name in self._states or self._names.has_variable(name)

    def _column_named(self, part: ast.Node) -> ast.Node | None:
        if not isinstance(part, ast.Name) or part.name not in self._named_columns:
            return None
        if self._is_hidden(part.name):
            return None
        if part.name in self._keys if self._keys is not None else self._may_be_key():
            return None
        if self._function_of_only(part.name, part.span) is not None:
            return None
        self._bare[part.name] = False
        return self._resolved(self._named_columns[part.name])

    def _in_where(self, part: ast.Node) -> ast.Node | None:
        """Returns a bare name in WHERE: a function of the only element if there is no variable."""
        if isinstance(part, ast.Query | ast.QualifiedName):
            return part
        if not isinstance(part, ast.Name) or part.name in self._states:
            return None
        known = self._bare[part.name] = self._names.has_variable(part.name)
        if known:
            return part
        if self._keys is not None and not self._is_known(part.name):
            return self._column_or(part, self._looked_up)
        if self._keys is not None or self._may_be_key():
            return self._looked_up(part)
        call = self._function_of_only(part.name, part.span)
        if call is None:  # the error at its evaluation is more precise
            return self._column_or(part, lambda name: name)
        return part if self._only is None else call

    def _function_of_only(self, name: str, span: SourceSpan) -> ast.Call | None:
        """Returns the call of a function of the only element; None if there is no such function."""
        call = ast.Call(span, self._names.resolved_name(name), (ast.This(span, None),), span)
        try:
            self._names.check_call(call)
        except SelectScriptError:
            return None
        return call

    def _may_be_key(self) -> bool:
        """Checks whether a name may be a key of the only source's elements, which differ."""
        return self._only is not None and (self._only.dicts or not self._only.known)

    def _is_known(self, name: str) -> bool:
        """Checks whether a name is a key of the records, or a function."""
        is_key = self._keys is not None and name in self._keys
        return is_key or self._function_of_only(name, self._query.span) is not None

    def _column_or(
        self, part: ast.Name, other: Callable[[ast.Node], ast.Node | None]
    ) -> ast.Node | None:
        """Returns the column that AS names; of a name that SELECT does not have, another part."""
        if part.name in self._as_names:
            return self._resolved(self._named_columns[part.name])
        return other(part)

    def _looked_up(self, part: ast.Node) -> ast.Node | None:
        if isinstance(part, ast.Query | ast.QualifiedName):
            return part
        if not isinstance(part, ast.Name) or part.name in self._states:
            return part if isinstance(part, ast.Name) else None
        if self._keys is not None and part.name in self._keys:
            key = ast.Literal(part.span, part.name)
            return ast.Index(part.span, ast.This(part.span, None), (key,))
        if self._keys is None and self._may_be_key():
            return ast.UnresolvedName(part.span, part.name)
        known = self._bare[part.name] = self._names.has_variable(part.name)
        if known:
            return part
        name = self._names.resolved_name(part.name)
        call = ast.Call(part.span, name, (ast.This(part.span, None),), part.span)
        self._names.check_call(call)
        return call


def _has_entities(source_type: SourceType) -> bool:
    element = source_type.sql_type
    return source_type.schema is not None or (element is not None and element.type == "entity")
