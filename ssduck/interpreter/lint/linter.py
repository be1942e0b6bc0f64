"""Finds probable mistakes in programs: parts that have a meaning, but hardly the intended one.

A name that no entity has, a variable that hides a function, a text in the place of a name. The
parser notes the mistakes that the text alone shows; those that depend on variables, functions and
worlds are looked up here before each statement runs.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
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
from ssduck.interpreter.lint.angles import degrees_in, degrees_in_sql
from ssduck.interpreter.lint.known_names import KnownNames, handle_of
from ssduck.interpreter.lint.misread_relations import (
    CARRIED,
    VOLUME_NOTE,
    SwappedRoles,
    has_volume_in_sql,
    spelled_relation,
    swapped,
    unfit,
)
from ssduck.interpreter.lint.statement_facts import NameSite, StatementFacts, facts_of
from ssduck.interpreter.lint.suspect_values import VECTORS, mistakes_in
from ssduck.language.analysis import OVER_TIME
from ssduck.language.tree import (
    Call,
    Index,
    Literal,
    Name,
    Node,
    QualifiedName,
    Query,
    TimeIndex,
)
from ssduck.recording.replay.past import Past
from ssduck.sql.name_comparisons import NameKind, RelationOfRows, name_comparisons
from ssduck.world.entities import Entity
from ssduck.world.handles import Handle, Link, Links
from ssduck.world.world import World

# The functions that return the kind of an entity.
_KIND_FUNCTIONS = ("kind", "type")
# The functions that SQL's users know as columns; so common as variables that they may hide them.
_COLUMNS = frozenset(("name", "kind"))


# The relations that hold as conditions whatever the world is like, with what they are.
_NO_CONDITIONS = {
    **dict.fromkeys(("id", "name", "type", "kind"), "a text"),
    **dict.fromkeys(VECTORS, "a list"),
}


class Linter:
    """Finds probable mistakes in the programs of an interpreter, and reports each once.

    Args:
        variable: a function that returns the value of a variable; None if there is none.
        is_function: a function that checks whether a function has a name.
        type_of_relation: a function that returns the type of a relation's result; None if a name
            is no relation.
        finds: a function that checks whether a query has a row; None if it cannot run.
    """

    def __init__(
        self,
        variable: Callable[[str], Any],
        is_function: Callable[[str], bool],
        worlds: Callable[[], Iterable[World]],
        recorded: Callable[[World], Iterable[str]],
        type_of_relation: Callable[[str], str | None],
        finds: Callable[[Query], bool | None],
    ) -> None:
        self._variable = variable
        self._type_of_relation = type_of_relation
        self._is_function = is_function
        self._worlds = worlds
        self._names = KnownNames(recorded)
        self._roles = SwappedRoles(finds)
        # The parts to look up in each statement; None if there are none.
        self._facts: WeakKeyDictionary[Node, StatementFacts | None] = WeakKeyDictionary()
        self._reported: set[tuple[str | None, str]] = set()
        self._is_volume_told = False

    def check(
        self, text: str, statement: Node, local: Mapping[str, Any]
    ) -> list[SelectScriptError]:
        """Returns the probable mistakes in a statement, as errors."""
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
            *self._unknown_entities(facts.names, local),
            *mistakes_in(facts.suspects, self._variable, self._type_of_relation),
            *(
                ArgumentError(message, span=call.span)
                for call, message in facts.misread
                if call.name in OVER_TIME or self._is_relation(call.name)
            ),
            *degrees_in(facts.angles, self._variable, self._type_of_relation),
            *(ArgumentError(message, span=span) for message, span in facts.same_rows),
            *self._always_true(facts),
            *(
                ArgumentError(_NAN.format(name.name), span=name.span)
                for name in facts.compared
                if _is_nan(self._variable(name.name))
            ),
            *self._unfit_entities(facts),
        ]
        for unknown in self._unknown_entities(facts.members, local):
            self._warn_of(unknown, text)  # it may come
        for error, is_sure in self._swapped_roles(facts):
            if is_sure:
                mistakes.append(error)
            else:
                self._warn_of(error, text)
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
        worlds = list(self._worlds())
        mistakes: list[SelectScriptError] = list(degrees_in_sql(sql, parameters))
        if parameters and (place := _COMPARED_PARAMETER.search(sql)):
            values = parameters.values() if isinstance(parameters, Mapping) else parameters
            if any(map(_is_nan, values)):
                mistakes.append(ArgumentError(_NAN_IN_SQL, span=SourceSpan(*place.span())))
        for comparison in comparisons if worlds else ():
            schema, text = comparison.schema, comparison.text(parameters)
            owners = [w for w in worlds if w.name == schema] if schema else worlds[:1]
            if text is not None and owners and not self._is_name(text, owners, [comparison.kind]):
                mistakes.append(self._names.error(text, owners, [comparison.kind], comparison.span))
            elif text is not None and owners and comparison.kind == "entity":
                mistakes += self._swapped_rows(
                    comparison.relations, _entity_of(owners[0], text), sql
                )
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

    def _swapped_roles(self, facts: StatementFacts) -> Iterator[tuple[SelectScriptError, bool]]:
        """Yields the relations of rows whose arguments are swapped, and whether that is sure."""
        for site in facts.row_roles:
            worlds = _worlds_of(rows := self._variable(site.source.name))
            if isinstance(rows, list) and isinstance(rows[0] if rows else None, Entity):
                worlds = [rows[0].world]
            named = site.value.value if isinstance(site.value, Literal) else None
            for world in worlds:
                entity = self._entity(site.value) if named is None else _entity_of(world, named)
                if entity is None or entity.world is not world:
                    continue
                is_past = isinstance(site.source, TimeIndex) or isinstance(rows, Past)
                is_known = self._variable(world.name) is world and self._is_relation(site.name)
                if is_known and self._roles.are_swapped(site.name, entity, is_past=is_past):
                    path = name_path(world.name, entity.name)
                    other = (site.other, path) if site.other else (path,)
                    error = ArgumentError(swapped(site.name, site.row, *other), span=site.span)
                    yield error, site.name in CARRIED

    def _swapped_rows(
        self, relations: Iterable[RelationOfRows], entity: Entity | None, sql: str
    ) -> Iterator[SelectScriptError]:
        """Yields an error for each relation in raw SQL of rows and an entity that is swapped."""
        for call in relations:
            name = spelled_relation(call.name)
            if (
                name
                and entity is not None
                and self._roles.are_swapped(name, entity, is_past=call.is_past)
            ):
                path = name_path(entity.world.name, entity.name)
                error = ArgumentError(swapped(call.name, *call.rows, path), span=call.span)
                if name in CARRIED:
                    yield error
                else:
                    self._warn_of(error, sql)

    def _entity(self, node: Node) -> Entity | None:
        """Returns the entity of a world that an expression names; None if it is none."""
        match node:
            case Name(name=name):
                value = self._variable(name)
                return value if isinstance(value, Entity) and value.is_there else None
            case (
                QualifiedName(alias=alias, key=key)
                | Index(base=Name(name=alias), indices=(Literal(value=str() as key),))
            ):
                return _entity_of(self._variable(alias), key)
        return None

    def _warn_of(self, error: SelectScriptError, text: str) -> None:
        """Warns, once, of what may well be meant, so that it is an error nowhere."""
        error.locate(text)
        if self.is_new(error):
            warn(str(error), ProgramWarning)

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
        bare = [(name, span, (), _COLUMNS | OVER_TIME) for name, span in facts.bare]
        conditions = [(*condition, OVER_TIME) for condition in facts.conditions]
        for name, span, others, may_hide in (*bare, *conditions):
            is_hidden = self._is_function(name) and name not in may_hide
            if is_hidden and all(self._variable(one) is not None for one in (name, *others)):
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
        self, sites: Iterable[NameSite], local: Mapping[str, Any]
    ) -> Iterator[SelectScriptError]:
        return islice(self._all_unknown_entities(sites, local), MAX_UNKNOWN)

    def _all_unknown_entities(
        self, sites: Iterable[NameSite], local: Mapping[str, Any]
    ) -> Iterator[SelectScriptError]:
        for site in sites:
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


def _entity_of(world: Any, name: Any) -> Entity | None:
    """Returns the entity of a world that has a name; None if it is no world, or has none."""
    return world[name] if isinstance(world, World) and name in world else None


def _worlds_of(variable: Any) -> list[World]:
    """Returns the world that a variable holds, or whose past it is; none for other values."""
    if isinstance(variable, Past | Links):
        return [variable.world]
    return [variable] if isinstance(variable, World) else []


# What is told of a number that is compared.
_NAN = "{} is NaN, no number: no comparison with it holds but !="

_NAN_IN_SQL = "a parameter is NaN, no number: DuckDB takes it for greater than all numbers"
_COMPARED_PARAMETER = re.compile(r"[<>=]\s*(\?|\$\w+)|(\?|\$\w+)\s*[<>=]")


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)


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
