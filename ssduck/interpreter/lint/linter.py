"""Finds probable mistakes in programs: parts that have a meaning, but hardly the intended one.

A name that no entity has, a variable that hides a function, a text in the place of a name. The
parser notes the mistakes that the text alone shows. What depends on variables, functions and worlds
is found once in each statement, as checks, which are made before each run.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

from ssduck.errors import ArgumentError, ProgramWarning, SelectScriptError, SourceSpan, warn
from ssduck.interpreter.lint.angles import angles, degrees_in_sql
from ssduck.interpreter.lint.foregone import foregone
from ssduck.interpreter.lint.misread_relations import is_nan, misread_relations, swapped_rows
from ssduck.interpreter.lint.names_in_programs import (
    MAX_UNKNOWN,
    hidden_names,
    skipped_names,
    unknown_names,
)
from ssduck.interpreter.lint.scope import Check, KnownNames, Scope, entity_of
from ssduck.interpreter.lint.suspect_values import suspect_values
from ssduck.language import ast
from ssduck.sql.user_sql import name_comparisons
from ssduck.world.world import World

# Each yields the checks of a statement.
_FINDERS: tuple[Callable[[ast.Node], Iterable[Check]], ...] = (
    hidden_names,
    unknown_names,
    skipped_names,
    suspect_values,
    misread_relations,
    angles,
    foregone,
)
# The largest number of reported mistakes that are remembered.
MAX_REPORTS = 10_000
_VOLUME_NOTE = (
    "volume is an eighth of the volume of the box, as published; solidVolume is that of the "
    "shapes, aabbVolume that of the box (told once)"
)
_VOLUME_IN_SQL = re.compile(r"\bvolume\s*\(", re.IGNORECASE)
_NAN_IN_SQL = "a parameter is NaN, no number: DuckDB takes it for greater than all numbers"
_COMPARED_PARAMETER = re.compile(r"[<>=]\s*(\?|\$\w+)|(\?|\$\w+)\s*[<>=]")


class Linter:
    """Finds probable mistakes in the programs of an interpreter, and reports each once.

    Args:
        variable: returns the value of a variable; None if there is none.
        is_function: checks whether a function has a name.
        worlds: returns the worlds.
        recorded: returns the names of all entities in a world's record.
        type_of_relation: returns the type of a relation's result; None if a name is no relation.
        finds: checks whether a query has a row; None if it cannot run.
        value: returns the value of a variable or of a part of a world.
    """

    def __init__(
        self,
        variable: Callable[[str], Any],
        is_function: Callable[[str], bool],
        worlds: Callable[[], Iterable[World]],
        recorded: Callable[[World], Iterable[str]],
        type_of_relation: Callable[[str], str | None],
        finds: Callable[[ast.Query], bool | None],
        value: Callable[[ast.Node], Any],
    ) -> None:
        self._scope = Scope(
            variable,
            is_function,
            worlds,
            type_of_relation,
            finds,
            value,
            self._warn_of,
            KnownNames(recorded),
        )
        self._checks: WeakKeyDictionary[ast.Node, tuple[Check, ...]] = WeakKeyDictionary()
        self._reported: set[tuple[str | None, str]] = set()
        self._is_volume_told = False

    def check(
        self, text: str, statement: ast.Node, local: Mapping[str, Any]
    ) -> list[SelectScriptError]:
        """Returns the probable mistakes in a statement, as errors."""
        try:
            checks = self._checks[statement]
        except KeyError:
            copy = replace(statement)  # checks do not keep their key alive
            found = [check for find in _FINDERS for check in find(copy)]
            named = (part.name for part in copy.walk() if isinstance(part, ast.Call | ast.Name))
            if "volume" in named:
                found.append(self._tell_of_volume)
            checks = self._checks[statement] = tuple(found)
        if not checks:
            return []
        scope = replace(self._scope, text=text, local=local)
        mistakes = [error for check in checks for error in check(scope)]
        for error in mistakes:
            error.locate(text)
        return mistakes

    def check_sql(
        self, sql: str, parameters: Sequence[Any] | Mapping[str, Any] | None = None
    ) -> list[SelectScriptError]:
        """Returns the names and kinds in a statement of raw SQL that nothing has, as errors."""
        scope = replace(self._scope, text=sql)
        if _VOLUME_IN_SQL.search(sql):
            self._tell_of_volume(None)
        comparisons = name_comparisons(sql)
        worlds = list(scope.worlds())
        mistakes: list[SelectScriptError] = list(degrees_in_sql(sql, parameters))
        if parameters and (place := _COMPARED_PARAMETER.search(sql)):
            values = parameters.values() if isinstance(parameters, Mapping) else parameters
            if any(map(is_nan, values)):
                mistakes.append(ArgumentError(_NAN_IN_SQL, span=SourceSpan(*place.span())))
        for comparison in comparisons if worlds else ():
            schema, text, kinds = comparison.schema, comparison.text(parameters), [comparison.kind]
            owners = [w for w in worlds if w.name == schema] if schema else worlds[:1]
            if text is None or not owners:
                continue
            if not scope.names.is_known(text, owners, kinds):
                mistakes.append(scope.names.error(text, owners, kinds, comparison.span))
            elif (entity := entity_of(owners[0], text)) is not None and kinds == ["entity"]:
                mistakes += swapped_rows(comparison.relations, entity, scope)
        for error in mistakes:
            error.locate(sql)
        return mistakes[:MAX_UNKNOWN]

    def _warn_of(self, error: SelectScriptError) -> None:
        """Warns of a mistake, once."""
        if self.is_new(error):
            warn(str(error), ProgramWarning)

    def _tell_of_volume(self, scope: Scope | None) -> Iterable[SelectScriptError]:
        """Warns, once, of what `volume` is: published programs use it, so it is no mistake."""
        is_relation = scope is None or (
            scope.variable("volume") is None and scope.is_relation("volume")
        )
        if is_relation and not self._is_volume_told:
            self._is_volume_told = True
            warn(_VOLUME_NOTE, ProgramWarning)
        return ()

    def is_new(self, error: SelectScriptError) -> bool:
        """Checks whether an error was not reported before."""
        if len(self._reported) > MAX_REPORTS:
            self._reported.clear()
        key = (error.text, error.message)
        is_new = key not in self._reported
        self._reported.add(key)
        return is_new
