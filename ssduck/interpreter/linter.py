"""Finds probable mistakes in programs: parts that have a meaning, but hardly the intended one.

A name that no entity has, a variable that hides a function, a text in the place of a name. The
parser notes the mistakes that the text alone shows; those that depend on variables, functions and
worlds are looked up here before each statement runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import islice
from typing import Any
from weakref import WeakKeyDictionary

from ssduck.errors import (
    ArgumentError,
    ProgramWarning,
    SelectScriptError,
    SourceSpan,
    warn,
)
from ssduck.formatting import name_path, short_repr
from ssduck.interpreter.known_names import KnownNames, handle_of
from ssduck.interpreter.misread_relations import (
    VOLUME_NOTE,
    as_conditions,
    has_volume,
    has_volume_in_sql,
    misread_calls,
    of_entities,
    same_rows,
    unfit,
)
from ssduck.interpreter.suspect_values import VECTORS, Suspects, mistakes_in, suspects_of
from ssduck.language.analysis import OVER_TIME, states
from ssduck.language.tree import (
    Assignment,
    Binary,
    Call,
    Index,
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
from ssduck.recording.replay.past import Past
from ssduck.sql.name_comparisons import NameKind, name_comparisons
from ssduck.world.entities import Entity
from ssduck.world.handles import Handle
from ssduck.world.links import Link, Links
from ssduck.world.world import World

# The functions that return the name or the kind of an entity.
_NAME_FUNCTIONS = ("id", "name", "kind", "type")
_KIND_FUNCTIONS = _NAME_FUNCTIONS[2:]
# The functions that SQL's users know as columns; so common as variables that they may hide them.
_COLUMNS = frozenset(("name", "kind"))


# The relations that hold as conditions whatever the world is like, with what they are.
_NO_CONDITIONS = {
    **dict.fromkeys(("id", "name", "type", "kind"), "a text"),
    **dict.fromkeys(VECTORS, "a list"),
}


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
        assigned: the variables that the statement sets.
        texts: texts in the place of a name.
        sources: texts behind FROM.
        aliases: bare names in a query that are also aliases of its sources.
        bare: names that are selected, or keys.
        conditions: names that are conditions, or are compared with a constant in one.
        columns: bare names in GROUP BY, HAVING and ORDER BY that are also names of columns.
        suspects: comparisons, columns and ages to look at.
        as_conditions: what stands as a condition, and may be an entity or a list.
        of_entities: calls that ask for shapes or boxes.
        misread: calls of relations that read as something else, with what is told of each.
        same_rows: what is told of `this` beside the same row of a nested query by its name.
        has_volume: whether it names `volume`.
    """

    names: list[NameSite] = field(default_factory=list)
    assigned: list[tuple[str, SourceSpan]] = field(default_factory=list)
    texts: list[tuple[str, SourceSpan]] = field(default_factory=list)
    sources: list[tuple[str, SourceSpan]] = field(default_factory=list)
    aliases: list[tuple[str, SourceSpan]] = field(default_factory=list)
    bare: list[tuple[str, SourceSpan]] = field(default_factory=list)
    conditions: list[tuple[str, SourceSpan]] = field(default_factory=list)
    columns: list[tuple[str, SourceSpan]] = field(default_factory=list)
    suspects: Suspects = field(default_factory=Suspects)
    as_conditions: tuple[Node, ...] = ()
    of_entities: tuple[Call, ...] = ()
    misread: tuple[tuple[Call, str], ...] = ()
    same_rows: tuple[tuple[str, SourceSpan], ...] = ()
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
        same_rows=tuple(same_rows(statement)),
        has_volume=has_volume(statement),
    )
    _collect(statement, {}, None, facts)
    return facts


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
    facts.conditions += [
        (name.name, name.span)
        for name in _condition_names(conditions)
        if name.name not in state_names
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


def _condition_names(nodes: Iterable[Node]) -> Iterator[Name]:
    """Yields bare names that are conditions themselves, or are compared with a constant."""
    for node in nodes:
        match node:
            case Name():
                yield node
            case Binary(operator="AND" | "OR" | "XOR", left=left, right=right):
                yield from _condition_names((left, right))
            case OperatorChain(operators=("AND" | "OR" | "XOR", *_), operands=operands):
                yield from _condition_names(operands)
            case Unary(operator="NOT", operand=operand):
                yield from _condition_names((operand,))
            case Binary(left=Name() as name, right=other) if _is_constant(other):
                yield name
            case Binary(left=other, right=Name() as name) if _is_constant(other):
                yield name


def _is_constant(node: Node) -> bool:
    """Checks whether a value is a literal, or arithmetic of literals."""
    return isinstance(node, Literal | Unary | Binary | OperatorChain) and all(
        map(_is_constant, node.children())
    )


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


class Linter:
    """Finds probable mistakes in the programs of an interpreter, and reports each once.

    Args:
        variable: a function that returns the value of a variable; None if there is none.
        is_function: a function that checks whether a function has a name.
        worlds: a function that returns the worlds.
        recorded: a function that returns the names of all entities in a world's record.
        type_of_relation: a function that returns the type of a relation's result; None if a name
            is no relation.
    """

    def __init__(
        self,
        variable: Callable[[str], Any],
        is_function: Callable[[str], bool],
        worlds: Callable[[], Iterable[World]],
        recorded: Callable[[World], Iterable[str]],
        type_of_relation: Callable[[str], str | None],
    ) -> None:
        self._variable = variable
        self._type_of_relation = type_of_relation
        self._is_function = is_function
        self._worlds = worlds
        self._names = KnownNames(recorded)
        # The parts to look up in each statement; None if there are none.
        self._facts: WeakKeyDictionary[Node, StatementFacts | None] = WeakKeyDictionary()
        self._reported: set[tuple[str | None, str]] = set()
        self._is_volume_told = False

    def check(
        self, text: str, statement: Node, local: Mapping[str, Any]
    ) -> list[SelectScriptError]:
        """Returns the probable mistakes in a statement, as errors.

        Args:
            text: the text of the program.
            statement: the statement.
            local: the state variables at its place.
        """
        try:
            facts = self._facts[statement]
        except KeyError:
            found = facts_of(replace(statement))  # a copy: facts do not keep their key alive
            facts = self._facts[statement] = None if found.is_empty else found
        if facts is None:
            return []
        mistakes = [
            *self._hiding_names(facts),
            *self._quoted_names(facts, text),
            *self._unknown_entities(facts, local),
            *mistakes_in(facts.suspects, self._variable, self._type_of_relation),
            *(
                ArgumentError(message, span=call.span)
                for call, message in facts.misread
                if self._is_relation(call.name)
            ),
            *(ArgumentError(message, span=span) for message, span in facts.same_rows),
            *self._always_true(facts),
            *self._unfit_entities(facts),
        ]
        if facts.has_volume and self._variable("volume") is None and self._is_relation("volume"):
            self._tell_of_volume()
        for error in mistakes:
            error.locate(text)
        return mistakes

    def check_sql(
        self, sql: str, parameters: Sequence[Any] | Mapping[str, Any] | None = None
    ) -> list[SelectScriptError]:
        """Returns the names and kinds in a statement of raw SQL that nothing has, as errors."""
        if has_volume_in_sql(sql):
            self._tell_of_volume()
        comparisons = name_comparisons(sql)
        if not comparisons:
            return []
        worlds = list(self._worlds())
        mistakes: list[SelectScriptError] = []
        for comparison in comparisons if worlds else ():
            schema, text = comparison.schema, comparison.text(parameters)
            owners = [w for w in worlds if w.name == schema] if schema else worlds[:1]
            if text is not None and owners and not self._is_name(text, owners, [comparison.kind]):
                mistakes.append(self._names.error(text, owners, [comparison.kind], comparison.span))
        for error in mistakes:
            error.locate(sql)
        return mistakes[:MAX_UNKNOWN]

    def _is_relation(self, name: str) -> bool:
        return self._type_of_relation(name) is not None

    def _always_true(self, facts: StatementFacts) -> Iterator[SelectScriptError]:
        """Yields an error for each condition that is an entity, a text or a list with elements."""
        for node in facts.as_conditions:
            what = self._without_a_question(node)
            if what:
                advice = "compare it with something, as in z(this) > 1"
                message = f"{what}, which always holds as a condition: {advice}"
                yield ArgumentError(message, span=node.span)

    def _without_a_question(self, node: Node) -> str:
        """Returns what a condition is that is neither true nor false; '' for another one."""
        match node:
            case Call(name=name) | Name(name=name):
                value = self._variable(name)
                if value is None or isinstance(node, Call):
                    what = _NO_CONDITIONS.get(name) if self._is_relation(name) else None
                    return f"{name} is {what}" if what else ""
                return f"{name} is an entity" if isinstance(value, Handle) else ""
            case QualifiedName() | Index():
                named = self._entity(node)
                return (
                    f"{name_path(named.world.name, named.name)} is an entity"
                    if named is not None
                    else ""
                )
        return ""

    def _unfit_entities(self, facts: StatementFacts) -> Iterator[SelectScriptError]:
        """Yields an error for each entity in a relation that tells nothing of it."""
        for call in facts.of_entities:
            if self._is_relation(call.name):
                for told, span in unfit(call, [self._entity(part) for part in call.arguments]):
                    yield ArgumentError(told, span=span)

    def _entity(self, node: Node) -> Entity | None:
        """Returns the entity of a world that an expression names; None if it is none."""
        match node:
            case (
                QualifiedName(alias=alias, key=key)
                | Index(base=Name(name=alias), indices=(Literal(value=str() as key),))
            ):
                world = self._variable(alias)
                found = world[key] if isinstance(world, World) and key in world else None
                return found if isinstance(found, Entity) else None
        return None

    def _tell_of_volume(self) -> None:
        """Warns, once, of what `volume` is: published programs use it, so it is no mistake."""
        if not self._is_volume_told:
            self._is_volume_told = True
            warn(VOLUME_NOTE, ProgramWarning)

    def is_new(self, error: SelectScriptError) -> bool:
        """Checks whether an error was not reported before."""
        if len(self._reported) > MAX_REPORTS:
            self._reported.clear()
        key = (error.text, error.message)
        is_new = key not in self._reported
        self._reported.add(key)
        return is_new

    def _hiding_names(self, facts: StatementFacts) -> Iterator[SelectScriptError]:
        for name, span in facts.assigned:
            if self._is_function(name) and name not in _COLUMNS | OVER_TIME:
                yield ArgumentError(hiding_message(name), span=span)
        for name, span in facts.columns:
            if self._variable(name) is not None:
                message = f"{name} is the variable here, and not the column of that name"
                yield ArgumentError(message, span=span)
        for name, span in (*facts.bare, *facts.conditions):
            is_hidden = self._is_function(name) and self._variable(name) is not None
            may_hide = OVER_TIME if (name, span) in facts.conditions else _COLUMNS | OVER_TIME
            if is_hidden and name not in may_hide:
                yield ArgumentError(hiding_message(name), span=span)
        for name, span in facts.aliases:
            if self._is_function(name) and self._variable(name) is None:
                message = f"{name} is the function here; the element of the source is {name}.this"
                yield ArgumentError(message, span=span)
            elif self._variable(name) is not None:
                message = f"{name} is the variable here; the element of the source is {name}.this"
                yield ArgumentError(message, span=span)

    def _quoted_names(self, facts: StatementFacts, text: str) -> Iterator[SelectScriptError]:
        for name, span in facts.texts:
            if text[span.start : span.start + 1] == '"' and self._is_function(name):
                message = f'"{name}" is a text; the function is written without quotes: {name}'
                yield ArgumentError(message, span=span)
        for name, span in facts.sources:
            if isinstance(self._variable(name), World | Past | list):
                message = (
                    f"{short_repr(name)} is a text, and the only element; the variable is {name}"
                )
                yield ArgumentError(message, span=span)

    # -- names of entities ------------------------------------------------------------------

    def _unknown_entities(
        self, facts: StatementFacts, local: Mapping[str, Any]
    ) -> Iterator[SelectScriptError]:
        return islice(self._all_unknown_entities(facts, local), MAX_UNKNOWN)

    def _all_unknown_entities(
        self, facts: StatementFacts, local: Mapping[str, Any]
    ) -> Iterator[SelectScriptError]:
        for site in facts.names:
            if isinstance(site.element, Name) and site.element.name in local:
                continue
            worlds, kinds = self._owners_at(site)
            if not worlds:
                continue
            value = site.value
            if isinstance(value, Literal):
                texts: list[Any] = [value.value]
            elif value.name in local:
                continue
            else:
                variable = self._variable(value.name)
                texts = variable if isinstance(variable, list) else [variable]
            for text in texts:
                if isinstance(text, str) and not self._is_name(text, worlds, kinds):
                    yield self._names.error(text, worlds, kinds, value.span)

    def _is_name(self, text: str, worlds: list[World], kinds: list[NameKind]) -> bool:
        return any(self._names.has(world, kind, text) for world in worlds for kind in kinds)

    def _owners_at(self, site: NameSite) -> tuple[list[World], list[NameKind]]:
        """Returns the worlds that the name may be of, none if unknown, and whose it may be."""
        if site.is_bare and self._variable(site.function) is not None:
            return [], []
        is_kind = site.function in _KIND_FUNCTIONS
        of_entity: NameKind = "kind" if is_kind else "entity"
        of_link: NameKind = "full link" if site.function == "id" else "link"
        of_link = "kind of link" if is_kind else of_link
        if site.element is not None:
            handle = handle_of(site.element, self._variable)
            if handle is None:
                return [], []
            worlds = list(self._worlds()) if handle.world is None else [handle.world]
            return worlds, [of_link if handle.is_link else of_entity]
        value = None if site.source is None else site.source.value
        if (
            isinstance(value, Call)
            and value.name in ("links", "sites")
            and len(value.arguments) == 1
        ):
            (argument,) = value.arguments
            variable = self._variable(argument.name) if isinstance(argument, _NAMED) else None
            return _worlds_of(variable) or list(self._worlds()), [of_link]
        if isinstance(value, _NAMED):
            variable = self._variable(value.name)
            if isinstance(variable, list):
                return self._owners_in(variable, of_entity, of_link)
            is_of_links = isinstance(variable, Links) or (
                isinstance(variable, Past) and variable.table != "entities"
            )
            return _worlds_of(variable), [of_link if is_of_links else of_entity]
        return ([] if site.is_bare else list(self._worlds())), [of_entity, of_link]

    def _owners_in(
        self, elements: list[Any], of_entity: NameKind, of_link: NameKind
    ) -> tuple[list[World], list[NameKind]]:
        """Returns the worlds and the owners of names for a list, whose first element decides."""
        if not isinstance(elements[0] if elements else None, Handle):
            return [], []
        has_links = any(isinstance(element, Link) for element in elements)
        kinds: list[NameKind] = [of_entity, of_link] if has_links else [of_entity]
        return list(self._worlds()), kinds


_NAMED = (Name, TimeIndex)


def _worlds_of(variable: Any) -> list[World]:
    """Returns the world that a variable holds, or whose past it is; none for other values."""
    if isinstance(variable, Past | Links):
        return [variable.world]
    return [variable] if isinstance(variable, World) else []


# The largest number of reported mistakes that are remembered.
MAX_REPORTS = 10_000
# The largest number of unknown names that are reported in a statement.
MAX_UNKNOWN = 20


def hiding_message(name: str) -> str:
    """Returns the message about a variable that has the name of a function."""
    return (
        f"the variable {name} hides the function {name}: a bare {name} is the variable; "
        f"{name}(…) still calls the function"
    )
