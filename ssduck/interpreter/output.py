"""What a query says behind AS: the adapter with its arguments, and what it makes of the rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeAlias

from ssduck.adapters.registry import Adapter, Selection, find, forms
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
from ssduck.recording.replay.past import PastTicks
from ssduck.world.world import World

Run: TypeAlias = Callable[[Query, Frame, Callable[[Sequence[SelectedValue]], None]], Selected]


@dataclass(frozen=True)
class AsClause:
    """An adapter as a query names it.

    Attributes:
        name: the name behind AS.
        adapter: what it is.
        arguments: the values in brackets.
        named: those with names.
        span: where it stands; None if the query has no AS.
    """

    name: str
    adapter: Adapter
    arguments: tuple[Any, ...] = ()
    named: Mapping[str, Any] = field(default_factory=dict)
    span: SourceSpan | None = None

    def value(self, query: Query, frame: Frame, run: Run) -> Any:
        """What it makes of a query: of its rows, or of each group's or path's.

        Args:
            query: what is run.
            frame: what is around it.
            run: what runs it, while the caller holds the worlds.

        Raises:
            LimitError: it writes a file, and files are switched off; or the time is up.
        """
        if self.adapter.writes and not frame.scope.meter.limits.files:
            raise LimitError(f"AS {self.name}: files are switched off here", span=self.span)
        check = check_columns if self.adapter.needs == "columns" else _unchecked
        worlds = partial(_worlds, query, frame)

        def read(count: int | None) -> Rows:
            asked = query if count is None else _first(query, count, frame)
            found = run(asked, frame, check)
            assert isinstance(found, Rows)
            return found

        def made(selection: Selection) -> Any:
            value = self._made(selection)
            frame.scope.meter.check_time()  # what a form does is one step, however long
            return value

        if self.adapter.needs == "query" and not query.group and query.recursion is None:
            selection = Selection(read, query, worlds)
            try:
                return made(selection)
            finally:
                selection.end()
        selected = run(query, frame, check)
        return formed(selected, lambda rows: made(Selection(lambda _: rows, query, worlds)))

    def _made(self, selection: Selection) -> Any:
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


def form_of(query: Query, frame: Frame) -> AsClause:
    """The form that a query names, its arguments evaluated; `dict` if it names none.

    Raises:
        UnknownNameError: there is none of that name, with the nearest names.
        ArgumentError: it does not take these arguments.
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


def help_of_forms() -> str:
    """What `help('AS')` tells: all forms with their arguments."""
    told = [f"{form.usage}\n    {form.help}" for form in forms()]
    return "\n".join(["AS", "What a query's rows become.", *told])


def _first(query: Query, count: int, frame: Frame) -> Query:
    """The query with so many rows at most."""
    if query.limit is not None:
        count = min(count, checked_count(frame.value(query.limit), "LIMIT", query.limit))
    return replace(query, limit=Literal(query.span, count))


def _worlds(query: Query, frame: Frame) -> list[World]:
    """The worlds that a query's sources are, each at its tick, once."""
    found: dict[World, None] = {}
    for source in query.sources:
        if isinstance(source.value, Query):
            found.update(dict.fromkeys(_worlds(source.value, frame)))
        elif isinstance(source.value, Name | TimeIndex):
            value = frame.value(source.value)
            if isinstance(value, World):
                found.setdefault(value)
            elif isinstance(value, PastTicks) and value.ticks:
                found.setdefault(value.at(value.ticks[-1]))
    return list(found)


def _unchecked(_: object) -> None:
    """Columns of one name are no trouble."""
