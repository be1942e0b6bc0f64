"""Reads spellings of SQL whose meaning depends on the variables and functions that exist.

`WHERE z = 1` compares unless `z` is a variable, `above(a, b)` takes the elements of the sources `a`
and `b` unless these are variables, `MAX(z)` is `max(z)` and `EXISTS (SELECT …)` a condition unless
a function has that name. A nested query is a value, or a list, where a list of dicts would be an
error or never equal. The older meaning of a program always comes first, so a program that ran
before keeps its meaning.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol
from weakref import WeakKeyDictionary

from ssduck.errors import ParseError, SourceSpan
from ssduck.language import ast
from ssduck.language.aggregates import over_rows
from ssduck.language.builtins import AGGREGATES, BUILTINS, NUMBER_FUNCTIONS
from ssduck.language.sql_syntax import CHAIN_OF_EQUALS
from ssduck.language.tokens import LEVEL_OF

_COMPARISONS = ("==", "!=", "<", "<=", ">", ">=")
_ARITHMETIC = ("-", "*", "/", "%", "^")
_SUM = ("+",)
# The functions of lists that no list of dicts is an argument of.
_OF_NUMBERS = frozenset(("norm", *AGGREGATES)) - {"count", "uniq"}
# Stands among the visible names for a source of entities, whose functions are columns.
_ENTITIES = "."
# The clauses of a query that its own sources are visible in.
_OWN_CLAUSES = frozenset(("items", "where", "recursion", "group", "having", "order"))
# Those in which a bare name may be a key of the only source's element.
_CLAUSES_WITH_KEYS = frozenset(("items", "group", "having", "order"))


class Names(Protocol):
    """The names of a session, as far as they decide how a program is read."""

    def has_variable(self, name: str) -> bool:
        """Checks whether there is a variable of that name."""

    def is_function(self, name: str) -> bool:
        """Checks whether a function or a relation has that name."""

    def is_users(self, name: str) -> bool:
        """Checks whether that is a user's function."""

    def is_scalar(self, name: str) -> bool:
        """Checks whether that is a relation whose value is a number, a text, True or False."""

    def is_world(self, name: str) -> bool:
        """Checks whether a variable is a world, its past or its links."""

    def is_world_without(self, name: str, entity: str) -> bool:
        """Checks whether a variable is a world that has no entity of a name."""


class SqlReader:
    """Reads the programs of a session."""

    def __init__(self, names: Names) -> None:
        self._names = names
        self._doubtful: WeakKeyDictionary[ast.Program, _Doubts] = WeakKeyDictionary()
        self._read: WeakKeyDictionary[ast.Program, tuple[object, ast.Program]] = WeakKeyDictionary()

    def read(self, program: ast.Program, local: Collection[str] = ()) -> ast.Program:
        """Returns the program with its SQL spellings replaced; the same one if there are none."""
        doubtful = self._doubtful.get(program)
        if doubtful is None:
            doubtful = self._doubtful[program] = _doubts_of(program)
        if not doubtful.names:
            return program
        facts: dict[Any, Any] = {name: self._facts_of(name, local) for name in doubtful.names}
        for name, key in doubtful.keys:
            is_function = self._names.is_function(key)
            facts[name, key] = is_function and self._names.is_world_without(name, key)
        known = self._read.get(program)
        if known is None or known[0] != facts:
            known = self._read[program] = (facts, _Reading(self._names, program, local).program())
        return known[1]

    def _facts_of(self, name: str, local: Collection[str]) -> tuple[bool, ...]:
        names = self._names
        is_variable = name in local or names.has_variable(name)
        return is_variable, names.is_function(name), names.is_users(name), names.is_world(name)


@dataclass(frozen=True)
class _Doubts:
    """The names on which the reading of a program depends; none if it has one reading."""

    names: frozenset[str] = frozenset()  # the names
    # The sources that are called by their variables, with a key behind each: `room.z`.
    keys: frozenset[tuple[str, str]] = frozenset()


def _doubts_of(program: ast.Program) -> _Doubts:
    parts = [part for statement in program.statements for part in statement.walk()]
    is_doubtful = False
    names: set[str] = set()
    aliases: set[str] = set()
    bare: set[str] = set()
    own_names: set[str] = set()
    keys: set[tuple[str, str]] = set()
    for part in parts:
        match part:
            case ast.Assignment(name=name):
                is_doubtful |= part.value_start is not None
                names.add(name)
            case ast.Call(name=name):
                is_doubtful |= _lower_builtin(name) is not None or _is_exists(part)
                names.add(name)
            case ast.Query(adapter=None, items=(_,)) | ast.Query(adapter=None, group=(_, *_)):
                is_doubtful |= part not in program.statements
        match part:
            case ast.Source(alias=str() as alias, value=value):
                (own_names if _is_variable_itself(alias, value) else aliases).add(alias)
            case ast.Index(base=ast.Name(name=name), indices=(ast.Literal(value=str() as key),)):
                keys.add((name, key))
            case ast.Name(name=name) | ast.QualifiedName(key=name):
                bare.add(name)
    keys = {(name, key) for name, key in keys if name in own_names}
    is_doubtful |= not aliases.isdisjoint(bare) or bool(keys)
    return _Doubts(frozenset(names | aliases | bare), frozenset(keys)) if is_doubtful else _Doubts()


def _lower_builtin(name: str) -> str | None:
    """Returns the name of the language's own function that is spelled so in another case."""
    lower = name.lower()
    return lower if lower != name and lower in BUILTINS else None


def _is_variable_itself(alias: str, value: ast.Node) -> bool:
    """Checks whether a source is called by its variable's name."""
    return isinstance(value, ast.Name | ast.TimeIndex) and value.name == alias


class _Reading:
    def __init__(self, names: Names, program: ast.Program, local: Collection[str]) -> None:
        self._names = names
        self._program = program
        # The variables that the program itself sets, wherever it does.
        self._variables = {
            part.name
            for statement in program.statements
            for part in statement.walk()
            if isinstance(part, ast.Assignment) and part.value_start is None
        }.union(local)
        # The places of what is no mistake, as it is read.
        self._resolved_spans: set[SourceSpan] = set()

    def program(self) -> ast.Program:
        statements = tuple(self._node(node, frozenset()) for node in self._program.statements)
        suspicions = tuple(
            suspicion
            for suspicion in self._program.suspicions
            if suspicion.span not in self._resolved_spans
        )
        return replace(self._program, statements=statements, suspicions=suspicions)

    def _has_variable(self, name: str) -> bool:
        return name in self._variables or self._names.has_variable(name)

    def _node(self, node: ast.Node, aliases: frozenset[str]) -> ast.Node:
        return node.replaced(lambda part: self._change(part, aliases))

    def _change(self, part: ast.Node, aliases: frozenset[str]) -> ast.Node | None:
        match part:
            case ast.Query():
                return self._query(part, aliases)
            case ast.Name(name=name) if name in aliases and not self._names.is_function(name):
                return None if self._has_variable(name) else ast.This(part.span, name)
            case ast.Index(base=ast.Name(name=name), indices=(ast.Literal(value=str()),)):
                return self._qualified(part) if f"{name}." in aliases else None
            case ast.Unary(
                operator="NOT", operand=ast.Binary(operator="==", left=left, right=right)
            ):
                if isinstance(left, ast.Query) or isinstance(right, ast.Query):
                    return self._node(ast.Binary(part.span, "!=", left, right), aliases)
            case ast.Unary(
                operator="NOT", operand=ast.Binary(operator="IN", right=ast.Query() as right) as on
            ):
                if self._is_plain(on.left) and _has_one_column(right):
                    member = self._membership(on, right, is_required=True)
                    return self._node(replace(part, operand=member), aliases)
            case ast.Source(value=ast.Query() as query) if _has_aggregated_groups(query):
                return self._node(replace(part, value=_with_form(query, "dict")), aliases)
            case ast.Assignment() if self._compares(part, aliases):
                self._check_comparison(part)
                self._resolved_spans.add(part.span)
                return self._node(_comparison(part), aliases)
            case ast.Call(name=name) if not self._names.is_function(name):
                if _is_exists(part):
                    return self._node(_existence(part), aliases)
                builtin = _lower_builtin(name)
                if builtin is not None:
                    return self._node(replace(part, name=builtin), aliases)
            case ast.Binary(operator="IN", left=left, right=ast.Query() as right):
                if self._is_plain(left) and _has_one_column(right):
                    return self._node(self._membership(part, right), aliases)
        changed = part.replaced(lambda child: self._operand(part, child))
        return None if changed is part else self._node(changed, aliases)

    def _membership(
        self, node: ast.Binary, query: ast.Query, *, is_required: bool = False
    ) -> ast.Node:
        """Returns `x IN (SELECT …)` with the list of the nested query's values."""
        self._resolved_spans.add(query.span)
        return replace(node, right=_with_form(query, "list", is_required=is_required))

    def _operand(self, parent: ast.Node, child: ast.Node) -> ast.Node | None:
        """Returns an operand of a node: a nested query as its value; None for the node itself."""
        if child is parent:
            return None
        if not isinstance(child, ast.Query) or not _has_one_column(child):
            return child
        if not self._is_value(parent, child):
            is_list = isinstance(parent, ast.Call) and self._takes_numbers(parent.name)
            return _with_form(child, "list") if is_list else child
        is_unequal = isinstance(parent, ast.Binary) and parent.operator == "!="
        return _with_form(child, "value", is_required=is_unequal)

    def _is_value(self, parent: ast.Node, query: ast.Query) -> bool:
        """Checks whether a nested query of one column stands for its value."""
        match parent:
            case ast.OrderKey():
                return True
            case ast.Binary(operator=operator, left=left, right=right) if (
                operator in _COMPARISONS + _ARITHMETIC + _SUM
            ):
                other = right if query is left else left
                is_plain = operator not in _SUM and self._is_plain(other)
                return is_plain or self._has_one_row(query)
            case ast.Call(name="to", arguments=(value, _)):
                return query is value and self._has_one_row(query)
            case ast.Call(name=name) if name in NUMBER_FUNCTIONS:
                return not self._names.is_users(name)
            case ast.Call(name=name) if (_lower_builtin(name) or name) in AGGREGATES:
                return self._has_one_row(query)
            case ast.OperatorChain(operators=(operator, *_)):
                return operator in _COMPARISONS + _ARITHMETIC + _SUM and self._has_one_row(query)
            case ast.Unary(operator="-" | "+") | ast.If() | ast.Branch():
                return self._has_one_row(query)
            case ast.Query(items=items):
                return any(query is item for item in items) and self._has_one_row(query)
        return False

    def _takes_numbers(self, name: str) -> bool:
        """Checks whether a function takes a list of numbers, so that dicts would be an error."""
        name = _lower_builtin(name) or name
        return name in _OF_NUMBERS and not self._names.is_users(name)

    def _has_one_row(self, query: ast.Query) -> bool:
        """Checks whether a query certainly aggregates all of its rows to one."""
        if query.group or query.distinct or query.limit is not None or query.offset is not None:
            return False
        (item,) = query.items
        if isinstance(item, ast.Call) and item.name == "to" and len(item.arguments) == 2:
            item = item.arguments[0]
        return any(self._is_aggregate(part) for part in _outside_of_queries(item))

    def _is_aggregate(self, node: ast.Node) -> bool:
        """Checks whether a part is an aggregate of values that are no lists."""
        match node:
            case ast.Call(name=name, arguments=(argument,)):
                is_function = self._names.is_function(name)
                if is_function and self._names.is_users(name):
                    return False
                name = name if is_function else _lower_builtin(name) or name
                if name not in AGGREGATES:
                    return False
                if isinstance(argument, ast.Call) and argument.name == "uniq":
                    (argument,) = argument.arguments
                return self._is_scalar(argument)
        return False

    def _is_scalar(self, node: ast.Node) -> bool:
        """Checks whether a value is certainly a number, a text, True or False."""
        match node:
            case ast.Literal(value=value):
                return not isinstance(value, str)
            case ast.Unary():
                return True
            case ast.Binary(operator=operator, left=left, right=right):
                if operator not in _ARITHMETIC + _SUM:
                    return True
                return self._is_scalar(left) or self._is_scalar(right)
            case ast.Name(name=name) | ast.QualifiedName(key=name) | ast.Call(name=name):
                if isinstance(node, ast.Name) and self._has_variable(name):
                    return False
                is_own = not self._names.is_users(name)
                return is_own and (self._names.is_scalar(name) or name in NUMBER_FUNCTIONS)
            case ast.If(otherwise=(otherwise,)):
                return self._is_scalar(otherwise)
        return False

    def _query(self, query: ast.Query, aliases: frozenset[str]) -> ast.Query:
        changed = query.replaced(lambda child: self._operand(query, child))
        assert isinstance(changed, ast.Query)
        query = changed
        own = {
            source.alias
            for source in query.sources
            if source.alias is not None and not _is_variable_itself(source.alias, source.value)
        }
        visible = (aliases - {source.alias for source in query.sources}) | own
        visible -= {_ENTITIES}
        if any(map(self._has_columns, query.sources)):
            visible |= {_ENTITIES}
        # `room.z` where the source is called by its variable.
        visible |= {f"{s.alias}." for s in query.sources if s.alias not in own}
        parts: dict[str, Any] = {}
        for kind in fields(query):
            value = getattr(query, kind.name)
            inside = visible if kind.name in _OWN_CLAUSES else aliases
            if len(query.sources) == 1 and kind.name in _CLAUSES_WITH_KEYS:
                inside = frozenset(alias for alias in visible if alias.endswith("."))
            if isinstance(value, ast.Node):
                parts[kind.name] = self._node(value, inside)
            elif isinstance(value, tuple):
                parts[kind.name] = tuple(self._node(part, inside) for part in value)
        new = {
            name: value
            for name, value in parts.items()
            if not _is_same(value, getattr(query, name))
        }
        return replace(query, **new) if new else query

    def _qualified(self, node: ast.Index) -> ast.Node | None:
        """Returns `room.z` as a value of the source's element; None if it is an entity."""
        (index,) = node.indices
        assert isinstance(node.base, ast.Name)
        assert isinstance(index, ast.Literal)
        alias, key = node.base.name, str(index.value)
        is_text = self._program.text[index.span.start] in "'\""
        is_known = self._is_own_function(key) and self._names.is_world_without(alias, key)
        if is_text or not is_known or alias in self._variables:
            return None
        return ast.Call(node.span, key, (ast.This(node.base.span, alias),), index.span)

    def _check_comparison(self, node: ast.Assignment) -> None:
        """Checks that a value is compared with one other: `x = y = 0` is an error in SQL."""
        value = node.value
        is_equality = isinstance(value, ast.Assignment) or (
            isinstance(value, ast.Binary) and value.operator == "=="
        )
        if is_equality and value.span.start == node.value_start:
            raise ParseError(CHAIN_OF_EQUALS, text=self._program.text, span=node.span)

    def _compares(self, node: ast.Assignment, aliases: frozenset[str]) -> bool:
        """Checks whether `name = value` in a query is a comparison."""
        if node.value_start is None or self._has_variable(node.name):
            return False
        return _ENTITIES in aliases and self._names.is_function(node.name)

    def _has_columns(self, source: ast.Source) -> bool:
        """Checks whether functions of the elements of a source are its columns: of entities."""
        match source.value:
            case ast.Name(name=name) | ast.TimeIndex(name=name):
                return self._names.is_world(name)
            case ast.Query() | ast.Call():
                return True
        return False

    def _is_plain(self, node: ast.Node) -> bool:
        """Checks whether a value is certainly no list of dicts, and no dict."""
        match node:
            case ast.Literal():
                return True
            case ast.Index(base=ast.Name(name=name)):  # an entity
                return self._names.is_world(name)
            case ast.Unary(operand=operand):
                return self._is_plain(operand)
            case ast.Binary(left=left, right=right):
                return self._is_plain(left) and self._is_plain(right)
            case ast.Name(name=name):
                return not self._has_variable(name) and self._is_own(name)
            case ast.Call(name=name):
                return self._is_own_function(_lower_builtin(name) or name)
            case ast.QualifiedName(alias=alias, key=key):
                return not self._has_variable(alias) and self._is_own(key)
        return False

    def _is_own(self, name: str) -> bool:
        """Checks whether a name is a function of the language, or can only be a key."""
        return self._is_own_function(name) or not self._names.is_function(name)

    def _is_own_function(self, name: str) -> bool:
        is_known = self._names.is_function(name) and not self._names.is_users(name)
        return is_known and name not in ("to", "var", "eval", "print", "uniq", "min", "max")


def _is_same(value: Any, before: Any) -> bool:
    if isinstance(value, tuple):
        return all(new is old for new, old in zip(value, before, strict=True))
    return value is before


def _has_one_column(query: ast.Query) -> bool:
    """Checks whether a query yields one column and names no result form."""
    return len(query.items) == 1 and query.adapter is None and query.recursion is None


def _has_aggregated_groups(query: ast.Query) -> bool:
    """Checks whether a query has groups of one row each, and names no result form."""
    is_table = query.adapter is None and query.recursion is None and bool(query.group)
    return is_table and any(map(over_rows, query.items))


def _with_form(query: ast.Query, form: str, *, is_required: bool = False) -> ast.Query:
    clause = ast.AdapterClause(query.span, form, of_sql=True, is_required=is_required)
    return replace(query, adapter=clause)


def _is_exists(node: ast.Call) -> bool:
    return (
        node.name.upper() == "EXISTS"
        and len(node.arguments) == 1
        and (isinstance(node.arguments[0], ast.Query))
    )


def _existence(node: ast.Call) -> ast.Node:
    """Returns the condition that a query has rows."""
    (query,) = node.arguments
    assert isinstance(query, ast.Query)
    if query.adapter is None:
        query = _with_form(query, "list")
    return ast.Binary(node.span, "!=", ast.ListLiteral(node.span, ()), query)


def _outside_of_queries(node: ast.Node) -> Iterator[ast.Node]:
    """Yields a node and its parts, without nested queries and what is in them."""
    if not isinstance(node, ast.Query):
        yield node
        for child in node.children():
            yield from _outside_of_queries(child)


def _comparison(node: ast.Assignment) -> ast.Node:
    """Returns the comparison that `name = value AND …` is in SQL.

    The value of an assignment is the whole condition; `==` binds more tightly than `AND`.
    """
    assert node.value_start is not None
    name = ast.Name(SourceSpan(node.span.start, node.span.start + len(node.name)), node.name)
    return _with_first_operand(node.value, name, node.value_start, node.span.start)


def _with_first_operand(value: ast.Node, name: ast.Name, value_start: int, start: int) -> ast.Node:
    """Returns a value with `name ==` before the first operand that no brackets enclose."""
    span = SourceSpan(start, value.span.end)
    if value.span.start == value_start:
        match value:
            case ast.Binary(operator=operator, left=left) if _is_looser(operator):
                first = _with_first_operand(left, name, value_start, start)
                return replace(value, span=span, left=first)
            case ast.OperatorChain(operators=(operator, *_), operands=(left, *others)):
                if _is_looser(operator):
                    first = _with_first_operand(left, name, value_start, start)
                    return replace(value, span=span, operands=(first, *others))
            case ast.Unary(operator="NOT" | "IS NULL", operand=operand) if (
                operand.span.start == value_start
            ):  # `x IS NULL`, and `x NOT LIKE y`, which begin with their operand
                first = _with_first_operand(operand, name, value_start, start)
                return replace(value, span=span, operand=first)
    return ast.Binary(span, "==", name, value)


def _is_looser(operator: str) -> bool:
    return LEVEL_OF.get(operator, LEVEL_OF["IN"]) <= LEVEL_OF["=="]
