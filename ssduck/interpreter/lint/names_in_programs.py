"""Finds names that are valid where they stand, but name something else, or nothing.

A variable that hides a function, a text in the place of a name, a name that no entity has.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any

from ssduck.errors import ArgumentError, SelectScriptError, SourceSpan
from ssduck.formatting import short_repr
from ssduck.interpreter.lint.foregone import leaves
from ssduck.interpreter.lint.scope import Check, Scope, worlds_of
from ssduck.interpreter.lint.suspect_values import Sources, is_comparison, sources_in, unnamed
from ssduck.interpreter.over_time.expansions import EXPANSIONS
from ssduck.language import ast
from ssduck.language.analysis import OVER_TIME, calls_of, states
from ssduck.recording.replay.past import Past
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.user_sql import NameKind
from ssduck.world.handles import Handle, Link, Links
from ssduck.world.world import World

# The largest number of unknown names that are reported in a statement.
MAX_UNKNOWN = 20
# The functions that return the name or the kind of an entity.
_KIND_FUNCTIONS = ("kind", "type")
_NAME_FUNCTIONS = ("id", "name", *_KIND_FUNCTIONS)
# The functions of which a bare name stands for no call.
_NEVER_BARE = OVER_TIME | EXPANSIONS.keys()
# With those that SQL's users know as columns; so common as variables that they may hide them.
_MAY_HIDE = _NEVER_BARE | {"name", "kind"}
_NAMED = (ast.Name, ast.TimeIndex)


# -- names of variables, functions and columns ----------------------------------------------------


def hidden_names(statement: ast.Node) -> Iterator[Check]:
    """Yields the checks of names that may be those of something else, and of texts like names."""
    for node in statement.walk():
        match node:
            case ast.Assignment(name=name, span=span, is_bare=False) if len(name) > 1:
                # Shorter names are checked where they are used.
                place = SourceSpan(span.start, span.start + len(name))
                yield partial(_hides_function, name, place, (), _MAY_HIDE)
            case ast.Query():
                yield from _hidden_in(node)


def _hidden_in(query: ast.Query) -> Iterator[Check]:
    own = states(query)
    orders = [key.value for key in query.order]
    columns = {
        part.arguments[-1].value
        for part in query.items
        if isinstance(part, ast.Call)
        and part.name == "to"
        and isinstance(part.arguments[-1], ast.Literal)
    } - own
    having = () if query.having is None else (query.having,)
    for node in _bare_names([*query.group, *orders, *having]):
        if node.name in columns:
            yield partial(_hides_column, node)
    for key in (*query.items, *query.group, *orders):
        match key:
            case ast.Name(name=name) if name not in own:
                yield partial(_hides_function, name, key.span, (name,), _MAY_HIDE)
            case ast.Literal(value=str() as name):
                yield partial(_quoted_function, name, key.span)
    conditions = [part for part in (query.where, query.having) if part is not None]
    conditions += [item for item in map(unnamed, query.items) if is_comparison(item)]
    for node, others in _condition_names(conditions):
        if own.isdisjoint((node.name, *others)):
            names = node.name, *others
            yield partial(_hides_function, node.name, node.span, names, _NEVER_BARE)
    aliases = {s.alias for s in query.sources if not isinstance(s.value, _NAMED)}
    for source in query.sources:
        match source.value:
            case ast.Name(name=name) if name != source.alias:
                aliases.add(source.alias)
    for node in _bare_names(
        child for child in query.children() if not isinstance(child, ast.Source)
    ):
        if node.name in aliases - own:
            yield partial(_hides_element, node)
    for source in query.sources:
        match source.value:
            case ast.Literal(value=str() as name):
                yield partial(_quoted_source, name, source.value.span)


def _hides_function(
    name: str, span: SourceSpan, variables: Iterable[str], may_hide: frozenset[str], scope: Scope
) -> Iterator[SelectScriptError]:
    """Yields the mistake of a variable that hides a function, where some variables are set."""
    is_hidden = scope.is_function(name) and name not in may_hide
    if is_hidden and all(scope.variable(one) is not None for one in variables):
        yield ArgumentError(
            f"the variable {name} hides the function {name}: a bare {name} is the variable; "
            f"{name}(…) still calls the function",
            span=span,
        )


def _hides_column(node: ast.Name, scope: Scope) -> Iterator[SelectScriptError]:
    if scope.variable(node.name) is not None:
        message = f"{node.name} is the variable here, and not the column of that name"
        yield ArgumentError(message, span=node.span)


def _hides_element(node: ast.Name, scope: Scope) -> Iterator[SelectScriptError]:
    is_variable = scope.variable(node.name) is not None
    if is_variable or scope.is_function(node.name):
        what = "variable" if is_variable else "function"
        message = f"{node.name} is the {what} here; the element of the source is {node.name}.this"
        yield ArgumentError(message, span=node.span)


def _quoted_function(name: str, span: SourceSpan, scope: Scope) -> Iterator[SelectScriptError]:
    if scope.text[span.start : span.start + 1] == '"' and scope.is_function(name):
        message = f'"{name}" is a text; the function is written without quotes: {name}'
        yield ArgumentError(message, span=span)


def _quoted_source(name: str, span: SourceSpan, scope: Scope) -> Iterator[SelectScriptError]:
    if isinstance(scope.variable(name), World | Past | list):
        message = f"{short_repr(name)} is a text, and the only element; the variable is {name}"
        yield ArgumentError(message, span=span)


def _condition_names(nodes: Iterable[ast.Node]) -> Iterator[tuple[ast.Name, tuple[str, ...]]]:
    """Yields bare names that are conditions, or are compared with constants and other names.

    Each has the names that it is compared with: where all are variables, no row has a part in it.
    """
    for node in (leaf for whole in nodes for leaf in leaves(whole)):
        match node:
            case ast.Name():
                yield node, ()
            case ast.Binary(left=left, right=right):
                for side, other in ((left, right), (right, left)):
                    names = _names_in(other)
                    if isinstance(side, ast.Name) and names is not None:
                        yield side, names


def _names_in(node: ast.Node) -> tuple[str, ...] | None:
    """Returns the names in a value of literals and names; None for another value."""
    if isinstance(node, ast.Name):
        return (node.name,)
    if not isinstance(
        node, ast.Literal | ast.Unary | ast.Binary | ast.OperatorChain | ast.ListLiteral
    ):
        return None
    parts = [_names_in(child) for child in node.children()]
    return None if None in parts else tuple(name for part in parts if part for name in part)


def _bare_names(nodes: Iterable[ast.Node]) -> Iterator[ast.Name]:
    for node in nodes:
        if isinstance(node, ast.Name):
            yield node
        if not isinstance(node, ast.Query):
            yield from _bare_names(node.children())


# -- names in parts that are left out --------------------------------------------------------------


def skipped_names(statement: ast.Node) -> Iterator[Check]:
    """Yields the checks of names in parts that AND, OR and IF may leave out.

    Queries and functions of time look up their names themselves, where they are evaluated. A name
    may come that the program assigns, or an entity that it asks for, as in
    `'cup' IN room AND z(room.cup) > 1`.
    """
    if "eval" in calls_of(statement):
        return
    names = tuple({part.name for part in statement.walk() if isinstance(part, ast.Name)})
    for place in _skipped_places(statement, is_skipped=False):
        yield partial(_unknown_in, place, names)


def _skipped_places(node: ast.Node, *, is_skipped: bool) -> Iterator[ast.Node]:
    """Yields the variables, the parts of worlds and the joints that a statement may not look up."""
    children: Iterable[ast.Node] = node.children()
    match node:
        case ast.Query(sources=sources):
            children = [source.value for source in sources] if is_skipped else ()
        case ast.Call(name=name) if name in OVER_TIME and not is_skipped:
            return
        case ast.Call(name=name, arguments=(_, ast.Literal(value=str()))) if is_skipped:
            if name in RELATIONS and RELATIONS[name].python_table == "joints":
                yield node
        case ast.Index(base=ast.Name(), indices=(ast.Literal(), *others)) if is_skipped:
            if all(isinstance(other, ast.Literal) for other in others):
                yield node
                return
        case ast.Name() if is_skipped:
            yield node
    for number, child in enumerate(children):
        yield from _skipped_places(child, is_skipped=is_skipped or (number > 0 and _decides(node)))


def _decides(node: ast.Node) -> bool:
    """Checks whether the first part of a node may leave others without evaluation."""
    match node:
        case ast.If() | ast.Binary(operator="AND" | "OR"):
            return True
        case ast.OperatorChain(operators=operators):
            return operators[0] in ("AND", "OR")
    return False


def _unknown_in(
    place: ast.Node, names: tuple[str, ...], scope: Scope
) -> Iterator[SelectScriptError]:
    """Yields the error of a place, if nothing there has its name, and nothing may come."""
    if isinstance(place, ast.Call):
        owner, joint = place.arguments
        entity, name = scope.entity(owner), _text_of(joint)
        if entity is not None and not scope.names.has(entity.world, "joint", name):
            yield scope.names.error(name, [entity.world], ["joint"], joint.span)
    elif not _may_come(place, names, scope):
        try:
            scope.value(place)
        except SelectScriptError as error:
            yield error


def _text_of(literal: ast.Node) -> str:
    assert isinstance(literal, ast.Literal)
    return str(literal.value)


def _may_come(place: ast.Node, names: tuple[str, ...], scope: Scope) -> bool:
    """Checks whether a variable or a part of a world may be there where it is evaluated."""
    base = place.base if isinstance(place, ast.Index) else place
    assert isinstance(base, ast.Name)
    text = scope.text or ""
    if base.name in scope.local or re.search(rf"\b{base.name}\s*=(?!=)", text):
        return True
    if not isinstance(place, ast.Index):
        return False
    world, key = scope.variable(base.name), _text_of(place.indices[0])
    if not isinstance(world, World):
        return world is not None
    is_asked = re.search(rf"(?<!\[)['\"]{re.escape(key)}['\"]", text) is not None
    was_there = key not in world and scope.names.has(world, "entity", key)
    texts = [value for name in names if isinstance(value := scope.variable(name), str)]
    return is_asked or was_there or key in texts


# -- names of entities ----------------------------------------------------------------------------


@dataclass(frozen=True)
class _NameSite:
    """A place where the name or the kind of an entity is compared with a text or a variable."""

    source: ast.Source | None  # the source of the entity; None if it is not known
    function: str  # the function whose value is compared: `id`, `name`, `kind` or `type`
    value: ast.Literal | ast.Name  # the text or the variable
    is_bare: bool  # whether the name is a bare one, which may be a key of a dict
    # The argument of the function if it is no element of a source; None if it is one.
    element: ast.Node | None = None


def unknown_names(statement: ast.Node) -> Iterator[Check]:
    """Yields the checks of names that no entity may have."""
    sites = tuple(_name_sites(statement, {}))
    if sites:
        yield partial(_unknown, sites)
    members = tuple(
        _NameSite(ast.Source(node.right.span, None, node.right), "name", node.left, is_bare=False)
        for node in statement.walk()
        if isinstance(node, ast.Binary) and node.operator == "IN" and isinstance(node.right, _NAMED)
        if isinstance(node.left, ast.Literal | ast.Name)
    )
    if members:
        yield partial(_not_yet_known, members)


def _name_sites(node: ast.Node, sources: Sources) -> Iterator[_NameSite]:
    """Yields the comparisons of names; `sources` by alias, None for the only one."""
    match node:
        case ast.Query():
            outside: Sources = {a: source for a, source in sources.items() if a is not None}
            inside = sources_in(node, sources)
            for child in node.children():
                yield from _name_sites(child, outside if isinstance(child, ast.Source) else inside)
            return
        case ast.Binary(operator="==" | "!=", left=left, right=right):
            for side, other in ((left, right), (right, left)):
                yield from _compared(side, (other,), sources)
        case ast.Binary(operator="IN", left=left, right=right):
            values = right.items if isinstance(right, ast.ListLiteral) else (right,)
            if not isinstance(right, ast.Literal):  # any text may be a part of a text
                yield from _compared(left, values, sources)
            match right:
                case ast.Query(
                    items=(item,), adapter=ast.AdapterClause(name="list"), recursion=None
                ):
                    yield from _compared(item, (left,), sources_in(right, sources))
            for item in right.items if isinstance(right, ast.ListLiteral) else ():
                yield from _compared(item, (left,), sources)
    for child in node.children():
        yield from _name_sites(child, sources)


def _compared(side: ast.Node, values: Iterable[ast.Node], sources: Sources) -> Iterator[_NameSite]:
    element: ast.Node | None = None
    match side:
        case ast.Call(name=name, arguments=(ast.This(alias=alias),)) if name in _NAME_FUNCTIONS:
            source, is_bare = sources.get(alias), False
        case ast.Call(name=name, arguments=(element,)) if name in _NAME_FUNCTIONS:
            source, is_bare = None, False
        case ast.QualifiedName(alias=alias, key=name) if name in _NAME_FUNCTIONS:
            source, is_bare = sources.get(alias), True
        case ast.Name(name=name) if name in _NAME_FUNCTIONS and None in sources:
            source, is_bare = sources[None], True
        case _:
            return
    for value in values:
        if isinstance(value, ast.Name) or (
            isinstance(value, ast.Literal) and type(value.value) is str
        ):
            yield _NameSite(source, name, value, is_bare, element)


def _not_yet_known(sites: Sequence[_NameSite], scope: Scope) -> Iterable[SelectScriptError]:
    """Warns of names that are looked for in a world: what has them may come."""
    for error in _unknown(sites, scope):
        scope.warn(error)
    return ()


def _unknown(sites: Sequence[_NameSite], scope: Scope) -> Iterable[SelectScriptError]:
    return islice(_all_unknown(sites, scope), MAX_UNKNOWN)


def _all_unknown(sites: Sequence[_NameSite], scope: Scope) -> Iterator[SelectScriptError]:
    for site in sites:
        value, local = site.value, scope.local
        if isinstance(site.element, ast.Name) and site.element.name in local:
            continue
        worlds, kinds = _owners_at(site, scope)
        if not worlds or (isinstance(value, ast.Name) and value.name in local):
            continue
        found = value.value if isinstance(value, ast.Literal) else scope.variable(value.name)
        for text in found if isinstance(found, list) else [found]:
            if isinstance(text, str) and not scope.names.is_known(text, worlds, kinds):
                yield scope.names.error(text, worlds, kinds, value.span)


def _owners_at(site: _NameSite, scope: Scope) -> tuple[list[World], list[NameKind]]:
    """Returns the worlds that the name may be of, none if unknown, and whose it may be."""
    if site.is_bare and scope.variable(site.function) is not None:
        return [], []
    is_kind = site.function in _KIND_FUNCTIONS
    of_entity: NameKind = "kind" if is_kind else "entity"
    of_link: NameKind = "full link" if site.function == "id" else "link"
    of_link = "kind of link" if is_kind else of_link
    if site.element is not None:
        handle = scope.handle_of(site.element)
        if handle is None:
            return [], []
        worlds = list(scope.worlds()) if handle.world is None else [handle.world]
        return worlds, [of_link if handle.is_link else of_entity]
    value = None if site.source is None else site.source.value
    if (
        isinstance(value, ast.Call)
        and value.name in ("links", "sites")
        and len(value.arguments) == 1
    ):
        (argument,) = value.arguments
        variable = scope.variable(argument.name) if isinstance(argument, _NAMED) else None
        return worlds_of(variable) or list(scope.worlds()), [of_link]
    if isinstance(value, _NAMED):
        variable = scope.variable(value.name)
        if isinstance(variable, list):
            return _owners_in(variable, of_entity, of_link, scope)
        is_of_links = isinstance(variable, Links) or (
            isinstance(variable, Past) and variable.table != "entities"
        )
        return worlds_of(variable), [of_link if is_of_links else of_entity]
    return ([] if site.is_bare else list(scope.worlds())), [of_entity, of_link]


def _owners_in(
    elements: list[Any], of_entity: NameKind, of_link: NameKind, scope: Scope
) -> tuple[list[World], list[NameKind]]:
    """Returns the worlds and the owners of names for a list, whose first element decides."""
    if not isinstance(elements[0] if elements else None, Handle):
        return [], []
    has_links = any(isinstance(element, Link) for element in elements)
    kinds: list[NameKind] = [of_entity, of_link] if has_links else [of_entity]
    return list(scope.worlds()), kinds
