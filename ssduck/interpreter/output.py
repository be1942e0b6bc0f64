"""The AS clause: finds the adapter that it names, and makes the result from the rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeAlias

from ssduck.adapters.registry import Adapter, Selection, all_adapters, find
from ssduck.errors import ArgumentError, FunctionError, LimitError, SelectScriptError, SourceSpan
from ssduck.formatting import error_text
from ssduck.language.clauses import (
    Rows,
    Selected,
    SelectedValue,
    check_columns,
    checked_count,
    formed,
)
from ssduck.language.evaluator import Frame
from ssduck.language.tree import Literal, Name, Query, TimeIndex
from ssduck.recording.replay.past import Past
from ssduck.world.world import World

QueryRunner: TypeAlias = Callable[
    [Query, Frame, Callable[[Sequence[SelectedValue]], None]], Selected
]


@dataclass(frozen=True)
class AsClause:
    """The result form of a query.

    Attributes:
        name: the name behind AS.
        adapter: the adapter of that name.
        arguments: the values of its positional arguments.
        named: the values of its named arguments.
        span: the place of the clause; None if the query has no AS.
    """

    name: str
    adapter: Adapter
    arguments: tuple[Any, ...] = ()
    named: Mapping[str, Any] = field(default_factory=dict)
    span: SourceSpan | None = None

    def value(self, query: Query, frame: Frame, run: QueryRunner) -> Any:
        """Returns the result of a query: made from its rows, or from those of each group or path.

        Args:
            query: the query to run.
            frame: the scope and the rows around it.
            run: the function that runs it, while the caller holds the worlds.

        Raises:
            LimitError: the form writes a file and files are switched off, or the time is up.
        """
        if self.adapter.writes and not frame.scope.meter.limits.files:
            raise LimitError(f"AS {self.name}: files are switched off here", span=self.span)
        check = check_columns if self.adapter.needs == "columns" else _accept_columns
        worlds = partial(_source_worlds, query, frame)

        def read(count: int | None) -> Rows:
            asked = query if count is None else _with_limit(query, count, frame)
            found = run(asked, frame, check)
            assert isinstance(found, Rows)
            return found

        def made(selection: Selection) -> Any:
            value = self._make(selection)
            frame.scope.meter.check_time()  # what a form does is one step, however long
            return value

        if self.adapter.needs == "query" and not query.group and query.recursion is None:
            selection = Selection(read, query, worlds)
            try:
                return made(selection)
            finally:
                selection.close()
        selected = run(query, frame, check)
        return formed(selected, lambda rows: made(Selection(lambda _: rows, query, worlds)))

    def _make(self, selection: Selection) -> Any:
        """Returns the result of the adapter; its errors name the form and the place."""
        try:
            if self.adapter.needs == "entities" and selection.rows and not selection.entities:
                raise ArgumentError(
                    "no column holds an entity; select them as obj(this), "
                    "or as obj where there is one source"
                )
            return self.adapter.make(selection, *self.arguments, **self.named)
        except SelectScriptError as error:
            if error.span is None:
                error.message = f"AS {self.name}: {error.message}"
                error.span = self.span
            raise
        except Exception as error:
            raise FunctionError(
                f"AS {self.name}: {type(error).__name__}: {error_text(error)}", span=self.span
            ) from error


def as_clause_of(query: Query, frame: Frame) -> AsClause:
    """Returns the result form of a query, its arguments evaluated; `dict` if it has none.

    Raises:
        UnknownNameError: no form has that name; the error suggests the nearest names.
        ArgumentError: the form does not take these arguments.
    """
    named = query.adapter
    if named is None:
        return AsClause("dict", find("dict"))
    try:
        adapter = find(named.name)
    except SelectScriptError as error:
        error.span = named.span
        raise
    arguments = tuple(frame.value(argument) for argument in named.arguments)
    by_name = {argument.name: frame.value(argument.value) for argument in named.named}
    if adapter.is_plain and not arguments and not by_name:
        return AsClause(named.name, adapter, span=named.span)
    try:
        adapter.signature.bind(None, *arguments, **by_name)
    except TypeError as error:
        raise ArgumentError(
            f"AS {named.name}: {error}; it is {adapter.usage}", span=named.span
        ) from error
    return AsClause(named.name, adapter, arguments, by_name, named.span)


def help_of_result_forms() -> str:
    """Returns the text of `help('AS')`: all result forms with their arguments."""
    told = [f"{form.usage}\n    {form.help}" for form in all_adapters()]
    return "\n".join(["AS", "What a query's rows become.", *told])


def _with_limit(query: Query, count: int, frame: Frame) -> Query:
    """Returns the query with a limit on its rows."""
    if query.limit is not None:
        count = min(count, checked_count(frame.value(query.limit), "LIMIT", query.limit))
    return replace(query, limit=Literal(query.span, count))


def _source_worlds(query: Query, frame: Frame) -> list[World]:
    """Returns the worlds among a query's sources, each at its tick and once."""
    found: dict[World, None] = {}
    for source in query.sources:
        if isinstance(source.value, Query):
            found.update(dict.fromkeys(_source_worlds(source.value, frame)))
        elif isinstance(source.value, Name | TimeIndex):
            value = frame.value(source.value)
            if isinstance(value, World):
                found.setdefault(value)
            elif isinstance(value, Past) and value.ticks:
                found.setdefault(value.at(value.ticks[-1]))
    return list(found)


def _accept_columns(_: object) -> None:
    """Accepts any columns, also two of one name."""
