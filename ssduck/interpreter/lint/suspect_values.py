"""Finds comparisons and columns of a query that are valid, but mean something else in SQL.

A number that is compared with a text, a missing value for which `!=` holds, a column of the first
row of a group, a number as the age of `least` and `holds`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias
from typing import Literal as OneOf

from ssduck import validation
from ssduck.errors import ArgumentError, SelectScriptError, SourceSpan
from ssduck.formatting import argument_in_words
from ssduck.interpreter.lint.scope import Check, Scope, spelled, spelled_id
from ssduck.language import ast
from ssduck.language.aggregates import is_grouped, over_rows
from ssduck.language.analysis import free_aliases, states
from ssduck.language.builtins import EXTREMES
from ssduck.recording.replay.past import Past
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.handles import Links
from ssduck.world.world import World


@dataclass(frozen=True, eq=False)
class _Elements(ast.Node):
    """The elements of a list that a variable may be."""

    name: str


# The operators that compare two values.
COMPARISONS = frozenset(("<", "<=", ">", ">=", "==", "!=", "IN"))
Kind = OneOf["number", "text", "boolean", "entity", "list"]
# The largest number of rows of a variable that are looked at.
MAX_ROWS = 1000
_WORDS: dict[Kind, str] = {
    "number": "a number",
    "text": "a text",
    "boolean": "True or False",
    "entity": "an entity",
    "list": "a list",
}
_KIND_OF_TYPE: dict[type, Kind] = {int: "number", float: "number", str: "text", bool: "boolean"}
# The relations whose values are lists of numbers.
VECTORS = frozenset(
    name for name, one in RELATIONS.items() if one.result == "list" and one.element == "double"
)
_COORDINATES = 3
Sources: TypeAlias = Mapping[str | None, ast.Source]
# What to write for a second argument that is no age.
_INSTEAD_OF_AGE = {
    **{name: f"of two numbers write {list_one}([a, b])" for name, list_one in EXTREMES.items()},
    "holds": "the time for which a condition has held is heldFor(condition) >= 0.2",
    "changes": "the value at a time is at(0.2, expression)",
}

# Two names of one relation.
_SYNONYMS = {"name": "id", "kind": "type"}
# Keys that only one entity has.
_UNIQUE = frozenset(("id", "obj", "this"))


@dataclass(frozen=True)
class Comparison:
    """A column that is compared with values."""

    source: ast.Source  # the source of its row
    column: str  # its name
    is_bare: bool  # whether a variable of that name comes first
    values: tuple[
        ast.Node, ...
    ]  # the literals, and what may be an entity, that it is compared with
    holds_of_missing: bool  # whether the comparison holds of a missing value
    span: SourceSpan  # the place of the comparison
    other: Comparison | None = None  # the column that it is compared with


def suspect_values(statement: ast.Node) -> Iterator[Check]:
    """Yields the checks of a statement's comparisons, columns, aggregates and ages."""
    queries = [part for part in statement.walk() if isinstance(part, ast.Query)]
    names = {name for query in queries for name in states(query)}
    for query in queries:
        yield from (partial(_mistakes_at, site) for site in _comparisons(query))
    for part in statement.walk():
        for side, value in _compared_with_values(part, names):
            yield partial(_never_equal, side, value)
        match part:
            case ast.Call(name=name, arguments=(_, age)) if name in _INSTEAD_OF_AGE and not (
                isinstance(age, ast.Unary) and age.operator == "-"
            ):
                yield partial(_time_as_age, part)
            case ast.Binary(operator="+" | "*" | "<" | "<=" | ">" | ">=") if any(
                map(_vector_of, _sides(part))
            ):
                yield partial(_operator_of_vectors, part)
    for query in queries:
        if not is_grouped(query):
            for call in (call for item in query.items for call in over_rows(item)):
                if call.name != "count" and _vector_of(call.arguments[0]):
                    yield partial(_aggregate_of_vectors, call)
        for node in map(unnamed, query.items):
            match node:
                case ast.Query(items=(_,), adapter=None, recursion=None):
                    yield partial(_list_of_dicts, node)
        for name, span in first_rows(query):
            yield partial(_first_row, name, span)


def _sides(node: ast.Binary) -> tuple[ast.Node, ast.Node]:
    return node.left, node.right


def _vector_of(node: ast.Node) -> str:
    """Returns the relation whose value, a list of numbers, a part is; "" for another part."""
    match node:
        case ast.Call(name=name) | ast.Name(name=name) | ast.QualifiedName(key=name):
            return name if name in VECTORS else ""
        case ast.Binary(operator="-", left=left, right=right):
            return _vector_of(left) or _vector_of(right)
    return ""


# -- columns --------------------------------------------------------------------------------------


def is_comparison(node: ast.Node) -> bool:
    """Checks whether a part compares two values."""
    return isinstance(node, ast.Binary) and node.operator in COMPARISONS


def column_of(node: ast.Node) -> tuple[str | None, str, bool] | None:
    """Returns the alias and the name of a column, and whether a variable may hide it."""
    match node:
        case ast.Name(name=name):
            return None, name, True
        case ast.QualifiedName(alias=alias, key=name):
            return alias, name, False
        case ast.Call(name=name, arguments=(ast.This(alias=alias),)):
            return alias, name, False
        case ast.Index(base=ast.This(alias=alias), indices=(ast.Literal(value=str() as name),)):
            return alias, name, False
    return None


def unnamed(item: ast.Node) -> ast.Node:
    """Returns the value of a column that AS or `to` names."""
    is_named = isinstance(item, ast.Call) and item.name == "to" and item.arguments
    return item.arguments[0] if is_named else item  # type: ignore[attr-defined]


def first_rows(query: ast.Query) -> Iterator[tuple[str, SourceSpan]]:
    """Yields the columns beside an aggregate of a group that are of the group's first row."""
    if not query.group or query.recursion is not None or not any(map(over_rows, query.items)):
        return
    columns = [unnamed(item) for item in query.items]
    names = {name: value for name, value in map(_named, query.items) if name}
    keys = {_printed(key, query) for key in query.group}
    keys |= {_printed(value, query) for name, value in names.items() if name in keys}
    if keys & _UNIQUE:
        return
    for value in columns:
        is_of_row = isinstance(value, ast.Name) or bool(free_aliases(value))
        if is_of_row and not over_rows(value) and not _is_of_keys(value, keys, query):
            yield value.name if isinstance(value, ast.Name) else "", value.span


def _named(item: ast.Node) -> tuple[str, ast.Node]:
    match item:
        case ast.Call(name="to", arguments=(value, ast.Literal(value=str() as name))):
            return name, value
    return "", item


def _is_of_keys(node: ast.Node, keys: set[str], query: ast.Query) -> bool:
    """Checks whether a value follows from the keys of its group."""
    if _printed(node, query) in keys:
        return True
    column = column_of(node)
    if column is not None:
        return not keys.isdisjoint((f"{column[0]}.id", f"{column[0]}.this"))
    if isinstance(node, ast.Query | ast.This):
        return False
    return all(_is_of_keys(child, keys, query) for child in node.children())


def _printed(node: ast.Node, query: ast.Query) -> str:
    """Returns a column as one word, `a.z`; another value as its outline."""
    is_only = len(query.sources) == 1
    if isinstance(node, ast.This):
        return "this" if is_only or node.alias is None else f"{node.alias}.this"
    column = column_of(node)
    if column is None:
        return node.outline()
    alias, name, _ = column
    name = _SYNONYMS.get(name, name)
    return name if is_only or alias is None else f"{alias}.{name}"


# -- comparisons --------------------------------------------------------------------------------


def _comparisons(query: ast.Query) -> Iterator[Comparison]:
    present = {
        name
        for node in ast.conjuncts(query.where)
        if isinstance(node, ast.Unary) and node.operator == "NOT"
        for name in _columns_of_null_test(node.operand)
    }
    for part in (*query.items, query.where, query.having):
        if part is not None:
            yield from _in_condition(part, query, present, negated=False)


def _compared_with_values(node: ast.Node, names: set[str]) -> Iterator[tuple[ast.Node, ast.Node]]:
    """Yields what may be an entity or a relation, with each value that it is compared with."""
    match node:
        case ast.Binary(operator="==" | "!=" | "IN" as operator, left=left, right=right):
            sides = [(left, right)] if operator == "IN" else [(left, right), (right, left)]
            for side, other in sides:
                is_state = isinstance(side, ast.Name) and side.name in names
                if isinstance(side, ast.Name | ast.Index | ast.Call) and not is_state:
                    for value in _values(other, operator, names):
                        yield side, value


def _columns_of_null_test(node: ast.Node) -> Iterator[str]:
    if isinstance(node, ast.Unary) and node.operator == "IS NULL":
        column = column_of(node.operand)
        if column is not None:
            yield column[1]


def _in_condition(
    node: ast.Node, query: ast.Query, present: set[str], *, negated: bool
) -> Iterator[Comparison]:
    match node:
        case ast.Query():
            return
        case ast.Unary(operator="NOT", operand=operand):
            yield from _in_condition(operand, query, present, negated=not negated)
            return
        case ast.Binary(operator="==" | "!=" | "IN" as operator, left=left, right=right):
            holds = (negated != (operator == "!=")) and operator != "IN"
            holds = holds or (operator == "IN" and negated)
            sides = [(left, right)] if operator == "IN" else [(left, right), (right, left)]
            for side, other in sides:
                site = site_of(side, query, _values(other, operator, states(query)), node.span)
                if site is not None and (site.values or holds):
                    is_missing = holds and site.column not in present
                    yield replace(site, holds_of_missing=is_missing)
            if operator != "IN":
                first, second = (site_of(side, query, (), node.span) for side in (left, right))
                if first is not None and second is not None:
                    yield replace(first, other=second)
            return
        case ast.Binary(operator="AND" | "OR") | ast.OperatorChain(operators=("AND" | "OR", *_)):
            pass
        case _:
            negated = False
    for child in node.children():
        yield from _in_condition(child, query, present, negated=negated)


def site_of(
    node: ast.Node, query: ast.Query, values: tuple[ast.Node, ...], span: SourceSpan
) -> Comparison | None:
    """Returns the place of a column in a comparison; None for another value."""
    column = (node.alias, "this", False) if isinstance(node, ast.This) else column_of(node)
    if column is None:
        return None
    alias, name, is_bare = column
    source = sources_in(query, {}).get(alias)
    if source is None:
        return None
    return Comparison(source, name, is_bare, values, holds_of_missing=False, span=span)


def _values(node: ast.Node, operator: str, names: AbstractSet[str]) -> tuple[ast.Node, ...]:
    """Returns the literals, and what may be an entity, on a side of a comparison."""
    if operator == "IN" and isinstance(node, ast.Name) and node.name not in names:
        return (_Elements(node.span, node.name),)
    items = (node,) if operator != "IN" else node.items if isinstance(node, ast.ListLiteral) else ()
    return tuple(
        item
        for item in items
        if isinstance(item, ast.Literal | ast.Index)
        or (isinstance(item, ast.Name) and item.name not in names)
    )


def sources_in(query: ast.Query, around: Sources) -> Sources:
    """Returns the sources that a query's clauses see, by alias; the only one by None, too."""
    inside: dict[str | None, ast.Source] = {
        a: source for a, source in around.items() if a is not None
    }
    inside |= {source.alias: source for source in reversed(query.sources) if source.alias}
    if len(query.sources) == 1:
        inside[None] = query.sources[0]
    return inside


# -- what is a mistake ----------------------------------------------------------------------------


def _never_equal(node: ast.Node, value: ast.Node, scope: Scope) -> Iterator[SelectScriptError]:
    """Yields the mistake of an entity, or of the value of a relation, that is compared."""
    if scope.handle_of(node) is not None:
        yield from _unequal("this", {"entity"}, [value], scope)
    elif isinstance(node, ast.Call) and column_of(node) is None:
        kind = _KIND_OF_RESULT.get(scope.type_of_relation(node.name) or "")
        yield from _unequal(node.name, {kind} if kind else set(), [value], scope)


def _time_as_age(call: ast.Call, scope: Scope) -> Iterator[SelectScriptError]:
    """Yields the mistake of an age that is a number from 0 on, or computed by functions."""
    age = call.arguments[1]
    match age:
        case ast.Literal():
            is_time = True
        case ast.Name(name=name) if (value := scope.variable(name)) is not None:
            is_time = validation.is_number(value) and value >= 0
        case _:
            is_time = any(isinstance(part, ast.Call) for part in age.walk())
    if is_time:
        yield ArgumentError(
            f"the second argument of {call.name} is an age: {call.name} is over the recorded "
            f"ticks at that time, or of the last seconds if it is negative; "
            f"{_INSTEAD_OF_AGE[call.name]}",
            span=call.span,
        )


def _operator_of_vectors(node: ast.Binary, scope: Scope) -> Iterator[SelectScriptError]:
    if node.operator == "*":
        if any(_is_integer(side, scope) for side in _sides(node)):
            yield ArgumentError(
                "* of a whole number repeats a list; the multiple is [2 * x(a), 2 * y(a), "
                "2 * z(a)], or [2 * v[0], 2 * v[1], 2 * v[2]] of another list v",
                span=node.span,
            )
    elif all(_is_vector(side, scope) for side in _sides(node)):
        one = "+" if node.operator == "+" else "<"
        yield ArgumentError(_OFVECTORS[one].format(node.operator), span=node.span)


def _aggregate_of_vectors(call: ast.Call, scope: Scope) -> Iterator[SelectScriptError]:
    if _is_vector(call.arguments[0], scope):
        yield ArgumentError(
            f"{call.name} is over the numbers of the list of each row; over the rows write "
            f"SELECT {call.name}(x(this)) AS x, {call.name}(y(this)) AS y, …",
            span=call.span,
        )


def _list_of_dicts(query: ast.Query, _: Scope) -> Iterator[SelectScriptError]:
    yield ArgumentError(
        "the nested query is a list of dicts here; write AS value for its value, or AS list",
        span=query.span,
    )


def _first_row(name: str, span: SourceSpan, scope: Scope) -> Iterator[SelectScriptError]:
    """Yields the mistake of a column of a group's first row, whose name is a bare one or ""."""
    if not name or scope.variable(name) is None:
        message = "this is of the first row of each group; group by it, too, or aggregate it"
        yield ArgumentError(message, span=span)


# What is told of an operator of two lists of numbers, "<" for all that order them.
_OFVECTORS = {
    "+": "+ joins two lists to a longer one; the sum is [x(a) + x(b), y(a) + y(b), "
    "z(a) + z(b)], and - of two lists is their difference",
    "<": "{0} orders two lists by the first numbers that differ, as words by their letters; of "
    "each number write x(a) {0} x(b) AND y(a) {0} y(b) AND z(a) {0} z(b), or v[0] {0} w[0] AND …",
}


def _is_integer(node: ast.Node, scope: Scope) -> bool:
    """Checks whether a part is a whole number: a literal, or a variable."""
    match node:
        case ast.Unary(operator="-", operand=ast.Literal(value=value)) | ast.Literal(value=value):
            return type(value) is int
        case ast.Name(name=name):
            return type(scope.variable(name)) is int
    return False


def _is_vector(node: ast.Node, scope: Scope) -> bool:
    """Checks whether a part is a list of numbers, such as a position."""
    if isinstance(node, ast.ListLiteral):
        return len(node.items) == _COORDINATES
    value = scope.variable(node.name) if isinstance(node, ast.Name) else None
    if value is not None:
        is_list = type(value) is list and len(value) == _COORDINATES
        return is_list and all(isinstance(part, int | float) for part in value)
    return scope.type_of_relation(_vector_of(node)) is not None


def is_hidden(site: Comparison, scope: Scope) -> bool:
    """Checks whether a bare name is a variable, and not the column."""
    return site.is_bare and scope.variable(site.column) is not None


def _different_columns(
    site: Comparison, other: Comparison, scope: Scope
) -> Iterator[SelectScriptError]:
    """Yields the mistake that two columns of entities can never be equal."""
    first = kind_of_relation(site, scope)
    second = kind_of_relation(other, scope)
    if first is None or second is None or {first, second} == {"boolean", "number"}:
        return
    if first != second:
        yield ArgumentError(
            f"{site.column} is {_WORDS[first]} and {other.column} is {_WORDS[second]}; they are "
            f"never equal, and a text is written in quotes: '{other.column}'",
            span=site.span,
        )


def _mistakes_at(site: Comparison, scope: Scope) -> Iterator[SelectScriptError]:
    if is_hidden(site, scope):
        return
    if site.other is not None:
        if not is_hidden(site.other, scope):
            yield from _different_columns(site, site.other, scope)
        return
    cells = _cells(site, scope)
    if cells is None:
        kind = kind_of_relation(site, scope)
        kinds = set() if kind is None else {kind}
    else:
        types = set(map(type, cells))
        if site.holds_of_missing and type(None) in types:
            yield ArgumentError(
                f"{site.column} is nothing in some rows, and this holds of them; "
                f"write AND {site.column} IS NOT NULL to leave them out",
                span=site.span,
            )
        types.discard(type(None))
        kinds = {_KIND_OF_TYPE[kind] for kind in types} if types <= _KIND_OF_TYPE.keys() else set()
    this = _this_of(site.source) if cells is None else ""
    yield from _unequal(site.column, kinds, site.values, scope, this)


def _this_of(source: ast.Source) -> str:
    """Returns how the element of a source is written."""
    is_named = source.alias not in (None, getattr(source.value, "name", None))
    return f"{source.alias}.this" if is_named else "this"


def _unequal(
    what: str,
    kinds: AbstractSet[Kind],
    values: Iterable[ast.Node],
    scope: Scope,
    this: str = "",
) -> Iterator[SelectScriptError]:
    """Yields the mistakes that what has some kinds never equals values of others."""
    words = " or ".join(_WORDS[kind] for kind in sorted(kinds))
    for value in values if kinds else ():
        plain = _plain_values(value, scope)
        if plain:
            is_truth_value = kinds == {"boolean"} and any(one in (0, 1) for one in plain)
            is_equal = is_truth_value or any(_KIND_OF_TYPE[type(one)] in kinds for one in plain)
            told = argument_in_words(plain[0])
            advice = "; compare its id: id(…)" if isinstance(plain[0], str) else ""
            advice = advice if "entity" in kinds else ""
        else:
            is_equal = "entity" in kinds or scope.handle_of(value) is None
            told, advice = f"the entity {(name := spelled(value))}", ""
            if what in ("id", "name") and this:
                column = this.removesuffix("this") + what
                advice = f"; write {this} = {name}, or {column} = {spelled_id(value)}"
            elif what in ("id", "name"):
                advice = f"; its id is {spelled_id(value)}"
            elif this:
                advice = f"; that of the entity is {what}({name})"
        if not is_equal:
            yield ArgumentError(
                f"{what} is {words}, and never equals {told}{advice}", span=value.span
            )


def _plain_values(node: ast.Node, scope: Scope) -> list[Any]:
    """Returns the numbers and texts that a part of a comparison is; none if it is another."""
    values: list[Any] = []
    match node:
        case ast.Literal(value=value):
            values = [value]
        case ast.Name(name=name):
            values = [scope.variable(name)]
        case _Elements(name=name):
            found = scope.variable(name)
            values = found if type(found) is list else []
    return values if all(type(value) in _KIND_OF_TYPE for value in values) else []


def _cells(site: Comparison, scope: Scope) -> list[Any] | None:
    """Returns the values of a column of the dicts in a variable; None if it holds none."""
    value = site.source.value
    rows = scope.variable(value.name) if isinstance(value, ast.Name) else None
    if not isinstance(rows, list) or not rows:
        return None
    dicts = [row for row in rows[:MAX_ROWS] if isinstance(row, dict)]
    return [row[site.column] for row in dicts if site.column in row] if dicts else None


def kind_of_relation(site: Comparison, scope: Scope) -> Kind | None:
    """Returns what the values of a column of entities are; None if it is not known."""
    value = site.source.value
    if not isinstance(value, ast.Name | ast.TimeIndex | ast.Call):
        return None
    if isinstance(value, ast.Name) and not isinstance(
        scope.variable(value.name), World | Past | Links
    ):
        return None
    if site.column == "this":
        return "entity" if _has_handles(value, scope) else None
    return _KIND_OF_RESULT.get(scope.type_of_relation(site.column) or "")


def _has_handles(value: ast.Name | ast.TimeIndex | ast.Call, scope: Scope) -> bool:
    """Checks whether the elements of a source are entities, links or sites for sure."""
    if isinstance(value, ast.Call):
        return value.name in ("links", "sites")
    return isinstance(scope.variable(value.name), World | Past | Links)


_KIND_OF_RESULT: Mapping[str, Kind] = {
    "double": "number",
    "integer": "number",
    "string": "text",
    "boolean": "boolean",
    "entity": "entity",
    "list": "list",
}
