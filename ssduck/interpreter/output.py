"""The AS clause: finds the adapter that it names, and makes the result from the rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeAlias
from weakref import WeakKeyDictionary

from ssduck.adapters.base import Adapter, Selection, made_bytes
from ssduck.adapters.registry import all_adapters, find
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    FunctionError,
    LimitError,
    SelectScriptError,
    SourceSpan,
)
from ssduck.formatting import error_text, first_line
from ssduck.interpreter.planner import Planner
from ssduck.language import ast
from ssduck.language.clauses import (
    Groups,
    Rows,
    Selected,
    SelectedValue,
    check_columns,
    checked_count,
    formed,
)
from ssduck.language.evaluator import Frame
from ssduck.recording.replay.past import Past
from ssduck.world.handles import Links
from ssduck.world.world import World

QueryRunner: TypeAlias = Callable[
    [ast.Query, Frame, Callable[[Sequence[SelectedValue]], None]], Selected
]


@dataclass(frozen=True)
class AsClause:
    """The result form of a query."""

    name: str  # the name behind AS
    adapter: Adapter  # the adapter of that name
    arguments: tuple[Any, ...] = ()  # the values of its positional arguments
    named: Mapping[str, Any] = field(default_factory=dict)  # the values of its named arguments
    span: SourceSpan | None = None  # the place of the clause; None if the query has no AS

    def value(self, query: ast.Query, frame: Frame, run: QueryRunner) -> Any:
        """Returns the result of a query: made from its rows, or those of each group or path."""
        meter = frame.scope.meter
        if self.adapter.writes and not meter.limits.files:
            raise LimitError(f"AS {self.name}: files are switched off here", span=self.span)
        check = check_columns if self.adapter.needs == "columns" else accept_columns
        worlds = partial(_source_worlds, query, frame)

        def read(count: int | None) -> Rows:
            limited = query if count is None else _with_limit(query, count, frame)
            rows = run(limited, frame, check)
            assert isinstance(rows, Rows)
            return rows

        def make(selection: Selection) -> Any:
            value = self._make(selection)
            if meter.limits.memory is not None and not isinstance(value, World):
                meter.charge(made_bytes(value))
            meter.step()
            return value

        if self.adapter.needs == "query" and not query.group and query.recursion is None:
            selection = Selection(read, query, worlds, meter)
            try:
                return make(selection)
            finally:
                selection.close()
        selected = run(query, frame, check)
        if self.adapter.joins_groups and query.recursion is None:
            selected = _together(selected)
        if query.adapter is not None and query.adapter.of_sql:
            selected = _together(selected)
            if self.name == "value":
                return _scalar(selected, query)
            if query.adapter.is_required and any(None in row for row in selected.values):
                raise EvaluationError(
                    "the nested query has a row without a value, and no value is NOT IN it in SQL; "
                    "leave it out: WHERE … IS NOT NULL",
                    span=query.span,
                )
        return formed(selected, lambda rows: make(Selection(lambda _: rows, query, worlds, meter)))

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


class ResultForms:
    """Makes the results of queries in the forms that they name.

    Args:
        planner: plans and runs the queries.
        worlds_pinned: pins the worlds that a query reads.
    """

    def __init__(
        self, planner: Planner, worlds_pinned: Callable[..., AbstractContextManager[None]]
    ) -> None:
        self._planner, self._worlds_pinned = planner, worlds_pinned
        self._queries: WeakKeyDictionary[ast.Query, dict[Adapter, ast.Query]] = WeakKeyDictionary()

    def result(self, node: ast.Query, frame: Frame, form: AsClause) -> Any:
        """Returns the result that a form makes from the rows of a query."""
        adapted = self.query_of(node, form.adapter)
        # The result is made of one tick, too.
        is_settled = not self._planner.may_repeat(adapted)
        with self._worlds_pinned(adapted, is_settled=is_settled):
            return form.value(adapted, frame, self._planner.run)

    def query_of(self, node: ast.Query, adapter: Adapter) -> ast.Query:
        """Returns the query to run for a form; the same one each time, as plans are cached."""
        if adapter.select is None:
            return node
        queries = self._queries.setdefault(node, {})
        if adapter not in queries:
            queries[adapter] = adapter.select(node)
        return queries[adapter]


def _together(selected: Selected) -> Rows:
    """Returns the rows of all groups."""
    if not isinstance(selected, Groups):
        assert isinstance(selected, Rows)
        return selected
    groups = [_together(group) for group in selected.groups.values()]
    return joined_rows(groups or [selected.empty])


def joined_rows(parts: Sequence[Rows]) -> Rows:
    """Returns rows one after the other; the names of columns may differ from row to row."""
    values = [row for part in parts for row in part.values]
    if not any(isinstance(part.names, list) for part in parts):
        return Rows(values, parts[0].names)
    names = (p.names if isinstance(p.names, list) else [p.names] * len(p.values) for p in parts)
    return Rows(values, [each for part in names for each in part])


def _scalar(rows: Rows, query: ast.Query) -> Any:
    """Returns the value of a nested query of SQL: nothing if it has no row."""
    if len(rows.values) > 1:
        raise EvaluationError(
            f"the nested query has {len(rows.values)} rows, and its value is compared or computed "
            "with; aggregate them (min, max, avg), or write LIMIT 1 or IN",
            span=query.span,
        )
    value = rows.values[0][0] if rows.values else None
    if value is None and query.adapter is not None and query.adapter.is_required:
        raise EvaluationError(
            "the nested query has no value, and nothing is unequal to it in SQL; "
            "exclude this case, by EXISTS (…) AND … for example",
            span=query.span,
        )
    return value


def as_clause_of(query: ast.Query, frame: Frame) -> AsClause:
    """Returns the result form of a query, its arguments evaluated; `dict` if it has none."""
    clause = query.adapter
    if clause is None:
        return AsClause("dict", find("dict"))
    try:
        adapter = find(clause.name)
    except SelectScriptError as error:
        error.span = clause.span
        raise
    arguments = tuple(frame.value(argument) for argument in clause.arguments)
    by_name = {argument.name: frame.value(argument.value) for argument in clause.named}
    if adapter.is_plain and not arguments and not by_name:
        return AsClause(clause.name, adapter, span=clause.span)
    try:
        adapter.signature.bind(None, *arguments, **by_name)
    except TypeError as error:
        raise ArgumentError(
            f"AS {clause.name}: {error}; its usage: {adapter.usage}; its value: "
            f"{first_line(adapter.help)}",
            span=clause.span,
        ) from error
    return AsClause(clause.name, adapter, arguments, by_name, clause.span)


# The text of `help('IMPLIES')` and of other words after the word.
HELP_OF_WORDS = {
    "IMPLIES": "Checks if a condition holds wherever another one does: a IMPLIES b is NOT a OR b. "
    "It is looser than OR, and a IMPLIES b IMPLIES c is a IMPLIES (b IMPLIES c). "
    "always(a IMPLIES eventually(b, 0, 1)): whenever a holds, b does within a second.\n"
    "Usage: a IMPLIES b -> bool",
    "XOR": "Checks if exactly one of two conditions holds.\nUsage: a XOR b -> bool",
    "WHY": "Before a program that ends with a condition: the parts of this, each with its value, "
    "its margin, the tick that decides it, and what would change it.\nUsage: WHY condition",
    "EXPLAIN": "Before a program: the SQL of its queries, and what Python evaluates.\n"
    "Usage: EXPLAIN program",
}


def help_of_result_forms() -> str:
    """Returns the text of `help('AS')`: all result forms with their arguments."""
    entries = [f"{form.usage}\n    {form.help}" for form in all_adapters()]
    return "\n".join(["AS", "The results that are made from a query's rows.", *entries])


def help_of_result_form(name: str) -> str | None:
    """Returns the text of `help('image')` or `help('AS image')`; None if there is no such form."""
    forms = {other: form for form in all_adapters() for other in form.names}
    form = forms.get(name.removeprefix("AS ").strip())
    return None if form is None else f"{form.usage}\n{form.help}"


def _with_limit(query: ast.Query, count: int, frame: Frame) -> ast.Query:
    if query.limit is not None:
        count = min(count, checked_count(frame.value(query.limit), "LIMIT", query.limit))
    return replace(query, limit=ast.Literal(query.span, count))


def _source_worlds(query: ast.Query, frame: Frame) -> list[World]:
    """Returns the worlds among a query's sources, each at its tick and once."""
    worlds: dict[World, None] = {}
    for source in query.sources:
        match source.value:
            case ast.Query() as inner:
                worlds.update(dict.fromkeys(_source_worlds(inner, frame)))
            case ast.Name() | ast.TimeIndex() | ast.Call(name="links" | "sites"):
                value = frame.value(source.value)
                if isinstance(value, World):
                    worlds.setdefault(value)
                elif isinstance(value, Links):
                    worlds.setdefault(value.world)
                elif isinstance(value, Past) and value.ticks:
                    worlds.setdefault(value.at(value.ticks[-1]))
    return list(worlds)


def accept_columns(_: object) -> None:
    """Accepts any columns, also two of one name."""
