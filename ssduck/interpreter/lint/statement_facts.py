"""Finds the parts of a statement that may be mistakes, to be looked up before it runs.

The linter (`ssduck.interpreter.lint.linter`) looks them up: that depends on variables and worlds.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields

from ssduck.errors import SourceSpan
from ssduck.interpreter.lint.angles import AngleSite, angle_sites
from ssduck.interpreter.lint.columns import is_comparison, unnamed
from ssduck.interpreter.lint.misread_relations import (
    RowRole,
    as_conditions,
    has_volume,
    misread_calls,
    of_entities,
    row_roles,
    same_rows,
)
from ssduck.interpreter.lint.suspect_values import Suspects, suspects_of
from ssduck.language.analysis import states
from ssduck.language.tree import (
    Assignment,
    Binary,
    Call,
    ListLiteral,
    Literal,
    Name,
    Node,
    OperatorChain,
    QualifiedName,
    Query,
    Source,
    This,
    TimeIndex,
    Unary,
)

# The functions that return the name or the kind of an entity.
_NAME_FUNCTIONS = ("id", "name", "kind", "type")


@dataclass(frozen=True)
class NameSite:
    """A place where the name or the kind of an entity is compared with a text or a variable.

    Attributes:
        source: the source of the entity; None if it is not known.
        function: the function whose value is compared: `id`, `name`, `kind` or `type`.
        value: the text or the variable.
        is_bare: whether the name is a bare one, which may be a key of a dict.
        element: the argument of the function if it is no element of a source; None if it is one.
    """

    source: Source | None
    function: str
    value: Literal | Name
    is_bare: bool
    element: Node | None = None


@dataclass
class StatementFacts:
    """The parts of a statement to look up.

    Attributes:
        names: the places where names of entities are compared.
        members: names that are looked for in a variable, perhaps a world.
        assigned: the variables that the statement sets.
        texts: texts in the place of a name.
        sources: texts behind FROM.
        aliases: bare names in a query that are also aliases of its sources.
        bare: names that are selected, or keys.
        conditions: names that are conditions, or are compared with constants and other names in
            one, which each has.
        columns: bare names in GROUP BY, HAVING and ORDER BY that are also names of columns.
        suspects: comparisons, columns and ages to look at.
        as_conditions: what stands as a condition, and may be an entity or a list.
        of_entities: calls that ask for shapes or boxes.
        misread: calls of relations that read as something else, with what is told of each.
        angles: angles that are compared with values.
        same_rows: what is told of `this` beside the same row of a nested query by its name.
        compared: names that are compared, each with something else.
        row_roles: relations of each row of a query whose arguments may be swapped.
        has_volume: whether it names `volume`.
    """

    names: list[NameSite] = field(default_factory=list)
    members: list[NameSite] = field(default_factory=list)
    assigned: list[tuple[str, SourceSpan]] = field(default_factory=list)
    texts: list[tuple[str, SourceSpan]] = field(default_factory=list)
    sources: list[tuple[str, SourceSpan]] = field(default_factory=list)
    aliases: list[tuple[str, SourceSpan]] = field(default_factory=list)
    bare: list[tuple[str, SourceSpan]] = field(default_factory=list)
    conditions: list[tuple[str, SourceSpan, tuple[str, ...]]] = field(default_factory=list)
    columns: list[tuple[str, SourceSpan]] = field(default_factory=list)
    suspects: Suspects = field(default_factory=Suspects)
    as_conditions: tuple[Node, ...] = ()
    of_entities: tuple[Call, ...] = ()
    misread: tuple[tuple[Call, str], ...] = ()
    angles: tuple[AngleSite, ...] = ()
    same_rows: tuple[tuple[str, SourceSpan], ...] = ()
    compared: tuple[Name, ...] = ()
    row_roles: tuple[RowRole, ...] = ()
    has_volume: bool = False

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to look up."""
        return not any(getattr(self, kind.name) for kind in fields(self))


_OuterSources = Mapping[str, Source]


def facts_of(statement: Node) -> StatementFacts:
    """Returns the parts of a statement to look up."""
    facts = StatementFacts(
        suspects=suspects_of(statement),
        as_conditions=tuple(as_conditions(statement)),
        of_entities=tuple(of_entities(statement)),
        misread=tuple(misread_calls(statement)),
        angles=tuple(angle_sites(statement)),
        same_rows=tuple(same_rows(statement)),
        compared=tuple(_compared_names(statement)),
        row_roles=tuple(row_roles(statement)),
        has_volume=has_volume(statement),
    )
    _collect(statement, {}, None, facts)
    return facts


def _compared_names(statement: Node) -> Iterator[Name]:
    """Yields the names that are compared; x != x asks for what is no number."""
    for node in statement.walk():
        if isinstance(node, Binary) and is_comparison(node):
            names = [side for side in (node.left, node.right) if isinstance(side, Name)]
            if len({name.name for name in names}) == len(names):
                yield from names


def _collect(
    node: Node, outer_sources: _OuterSources, only_source: Source | None, facts: StatementFacts
) -> None:
    match node:
        case Query():
            _collect_from_query(node, outer_sources, facts)
            return
        case Assignment(name=name, span=span, is_bare=False):
            if len(name) > 1:  # shorter names are checked where they are used
                facts.assigned.append((name, SourceSpan(span.start, span.start + len(name))))
        case Binary(operator="==" | "!=", left=left, right=right):
            for side, other in ((left, right), (right, left)):
                _collect_name_site(side, (other,), outer_sources, only_source, facts)
        case Binary(operator="IN", left=left, right=right):
            values = right.items if isinstance(right, ListLiteral) else (right,)
            if not isinstance(right, Literal):  # any text may be a part of a text
                _collect_name_site(left, values, outer_sources, only_source, facts)
            if isinstance(left, Literal | Name) and isinstance(right, Name | TimeIndex):
                source = Source(right.span, None, right)
                facts.members.append(NameSite(source, "name", left, is_bare=False))
            if isinstance(right, Query):
                _collect_from_list(left, right, outer_sources, facts)
            for item in right.items if isinstance(right, ListLiteral) else ():
                _collect_name_site(item, (left,), outer_sources, only_source, facts)
    for child in node.children():
        _collect(child, outer_sources, only_source, facts)


def _collect_from_query(query: Query, outer_sources: _OuterSources, facts: StatementFacts) -> None:
    sources = {source.alias: source for source in query.sources if source.alias is not None}
    only_source = query.sources[0] if len(query.sources) == 1 else None
    for source in query.sources:
        _collect(source.value, outer_sources, None, facts)
        if isinstance(source.value, Literal) and isinstance(source.value.value, str):
            facts.sources.append((source.value.value, source.value.span))
    visible_sources = {**outer_sources, **sources}
    for child in query.children():
        if not isinstance(child, Source):
            _collect(child, visible_sources, only_source, facts)
    keys = [*query.items, *query.group, *(key.value for key in query.order)]
    facts.texts += [
        (node.value, node.span)
        for node in keys
        if isinstance(node, Literal) and isinstance(node.value, str)
    ]
    state_names = states(query)
    column_names = {
        part.arguments[-1].value
        for part in query.items
        if isinstance(part, Call) and part.name == "to" and isinstance(part.arguments[-1], Literal)
    }
    column_nodes = [*query.group, *(key.value for key in query.order)]
    column_nodes += [] if query.having is None else [query.having]
    facts.columns += [
        (node.name, node.span)
        for node in _bare_names(column_nodes)
        if node.name in column_names - state_names
    ]
    facts.bare += [
        (node.name, node.span)
        for node in keys
        if isinstance(node, Name) and node.name not in state_names
    ]
    conditions = [part for part in (query.where, query.having) if part is not None]
    conditions += [item for item in map(unnamed, query.items) if is_comparison(item)]
    facts.conditions += [
        (name.name, name.span, others)
        for name, others in _condition_names(conditions)
        if state_names.isdisjoint((name.name, *others))
    ]
    hidden_aliases = {
        s.alias for s in query.sources if not isinstance(s.value, Name | TimeIndex)
    } - {None}
    hidden_aliases |= {
        s.alias for s in query.sources if isinstance(s.value, Name) and s.value.name != s.alias
    }
    hidden_aliases -= state_names
    parts = (child for child in query.children() if not isinstance(child, Source))
    facts.aliases += [(n.name, n.span) for n in _bare_names(parts) if n.name in hidden_aliases]


def _collect_from_list(
    value: Node, query: Query, outer_sources: _OuterSources, facts: StatementFacts
) -> None:
    """Collects a text that is looked for in the names that a nested query has as a list."""
    is_list = query.adapter is not None and query.adapter.name == "list"
    if is_list and len(query.items) == 1 and query.recursion is None:
        sources = {source.alias: source for source in query.sources if source.alias is not None}
        only_source = query.sources[0] if len(query.sources) == 1 else None
        visible_sources = {**outer_sources, **sources}
        _collect_name_site(query.items[0], (value,), visible_sources, only_source, facts)


def _condition_names(nodes: Iterable[Node]) -> Iterator[tuple[Name, tuple[str, ...]]]:
    """Yields bare names that are conditions, or are compared with constants and other names.

    Each has the names that it is compared with: where all are variables, no row has a part in it.
    """
    for node in nodes:
        match node:
            case Name():
                yield node, ()
            case Binary(operator="AND" | "OR" | "XOR", left=left, right=right):
                yield from _condition_names((left, right))
            case OperatorChain(operators=("AND" | "OR" | "XOR", *_), operands=operands):
                yield from _condition_names(operands)
            case Unary(operator="NOT", operand=operand):
                yield from _condition_names((operand,))
            case Binary(left=left, right=right):
                for side, other in ((left, right), (right, left)):
                    names = _names_in(other)
                    if isinstance(side, Name) and names is not None:
                        yield side, names


def _names_in(node: Node) -> tuple[str, ...] | None:
    """Returns the names in a value of literals and names; None for another value."""
    if isinstance(node, Name):
        return (node.name,)
    if not isinstance(node, Literal | Unary | Binary | OperatorChain | ListLiteral):
        return None
    parts = [_names_in(child) for child in node.children()]
    return None if None in parts else tuple(name for part in parts if part for name in part)


def _bare_names(nodes: Iterable[Node]) -> Iterator[Name]:
    for node in nodes:
        if isinstance(node, Name):
            yield node
        if not isinstance(node, Query):
            yield from _bare_names(node.children())


def _collect_name_site(
    side: Node,
    values: Iterable[Node],
    outer_sources: _OuterSources,
    only_source: Source | None,
    facts: StatementFacts,
) -> None:
    element: Node | None = None
    match side:
        case Call(name=name, arguments=(This(alias=alias),)) if name in _NAME_FUNCTIONS:
            source, is_bare = only_source if alias is None else outer_sources.get(alias), False
        case Call(name=name, arguments=(element,)) if name in _NAME_FUNCTIONS:
            source, is_bare = None, False
        case QualifiedName(alias=alias, key=name) if name in _NAME_FUNCTIONS:
            source, is_bare = outer_sources.get(alias), True
        case Name(name=name) if name in _NAME_FUNCTIONS and only_source is not None:
            source, is_bare = only_source, True
        case _:
            return
    for value in values:
        if isinstance(value, Name) or (isinstance(value, Literal) and type(value.value) is str):
            facts.names.append(NameSite(source, name, value, is_bare, element))
