"""Running a query's plan: its SQL on one tick, then what is left to Python on the rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, cmp_to_key
from typing import Any, TypeAlias

from ssduck.adapters import Rows
from ssduck.database import Database, Statement
from ssduck.errors import ArgumentError, EvaluationError, SelectScriptError
from ssduck.evaluate import Evaluator, apply
from ssduck.plan import Item, Output, Plan, Shape, Tag
from ssduck.tree import Node, Query, Source
from ssduck.world import Entity, World

# Larger integers are not all numbers that a DOUBLE can be.
_EXACT = 2**53

SchemaOf: TypeAlias = Callable[[World], str]


def tag_of(value: Any, schema_of: SchemaOf) -> Tag:
    """The type of a value, as far as SQL knows it.

    Args:
        value: any value.
        schema_of: gives the schema of a world.
    """
    match value:
        case bool():
            return Tag("flag")
        case int():
            return Tag("integer" if abs(value) < _EXACT else "any")
        case float():
            return Tag("real" if math.isfinite(value) else "any")
        case str():
            return Tag("text")
        case None:
            return Tag("nothing")
        case Entity():
            return Tag("entity", schema=schema_of(value.world))
        case list():
            tags = {tag_of(element, schema_of) for element in value}
            if tags == {Tag("real"), Tag("integer")}:  # a list of numbers for distance, IN, ==
                tags = {Tag("real")}
            tag = tags.pop() if len(tags) == 1 else Tag("any")
            if tag.type in ("real", "integer", "text"):
                # A plan depends on whether it is a point, not on how long the list is.
                return Tag("list", tag.type, 3 if len(value) == 3 else None)
    return Tag("any")


def shapes_of(query: Query, values: Sequence[Any], schema_of: SchemaOf) -> tuple[Shape, ...]:
    """What the sources of a query are.

    Raises:
        ArgumentError: two sources have the same name.
    """
    shapes = [
        _shape(source, value, index, schema_of)
        for index, (source, value) in enumerate(zip(query.sources, values, strict=True))
    ]
    for index, shape in enumerate(shapes):
        if shape.alias in (other.alias for other in shapes[:index]):
            raise ArgumentError(
                f"two sources are called {shape.alias!r}; write FROM a={shape.alias}, b=…",
                span=query.sources[index].span,
            )
    return tuple(shapes)


def _shape(source: Source, value: Any, index: int, schema_of: SchemaOf) -> Shape:
    alias = source.alias or (f"source_{index + 1}" if index else "this")
    if isinstance(value, World):
        return Shape(alias, schema_of(value), None)
    tags = {tag_of(element, schema_of) for element in elements_of(value)}
    tag = tags.pop() if len(tags) == 1 else Tag("any")
    return Shape(alias, None, tag if tag.type in _LISTED else Tag("any"))


_LISTED = frozenset(("entity", "real", "integer", "text", "flag"))


def elements_of(value: Any) -> Sequence[Any]:
    """The elements of a source that is no world: those of a list, else the value alone."""
    return value if isinstance(value, list | tuple) else [value]


class Planned:
    """A query with its plan, ready to run.

    Args:
        plan: how it runs.
        database: where its SQL runs.
    """

    def __init__(self, plan: Plan, database: Database) -> None:
        self.plan = plan
        self._database = database
        self._statement: Statement | None = None
        numbers = plan.numbers
        if numbers is not None:
            self._statement = Statement(database, plan.select, numbers)

    def forget(self) -> None:
        """Let the database forget it."""
        if self._statement is not None:
            self._statement.forget()

    def run(self, outer: Evaluator, sources: Mapping[str, Any]) -> Rows:
        """The rows of the query; the caller holds the worlds.

        Args:
            outer: knows the variables, and the rows of the queries around this one.
            sources: the value of each source, by alias.
        """
        plan = self.plan
        fetched = self._fetched(_parameters(plan, outer, sources))
        worlds = self._database.worlds
        once: dict[Node, list[Any]] = {**outer.once, **{node: [] for node in plan.once}}
        this_run = _Run(plan, outer, sources, worlds, once)
        outputs = plan.outputs
        if outputs is not None:  # nothing is left to Python
            values = [tuple(this_run.output(o, row) for o in outputs) for row in fetched]
            return Rows(values, tuple(map(str, plan.names)))
        return _finished(this_run, [_Row(this_run, values) for values in fetched])

    def _fetched(self, parameters: dict[str, Any]) -> list[tuple[Any, ...]]:
        # A buffer of numbers has no place for an unknown one.
        if self._statement is None or None in parameters.values():
            return self._database.rows(self.plan.sql, parameters or None)
        return self._statement.rows(parameters)


def _finished(run: _Run, rows: list[_Row]) -> Rows:
    """What Python makes of the rows that SQL left."""
    plan = run.plan
    rows = [row for row in rows if all(map(row.value, plan.conditions))]
    if plan.order:
        rows = _ordered(rows, plan.order)
    if plan.limit is not None:
        rows = rows[: _count(run.outer.value(plan.limit), plan.limit)]
    values = [tuple(map(row.item, plan.items)) for row in rows]
    if all(isinstance(name, str) for name in plan.names):
        return Rows(values, tuple(map(str, plan.names)))
    return Rows(values, [tuple(map(row.name, plan.names)) for row in rows])


def _parameters(plan: Plan, outer: Evaluator, sources: Mapping[str, Any]) -> dict[str, Any]:
    """The values of the SQL's parameters."""
    bound = {}
    for binding in plan.bindings:
        if binding.source is not None:
            tag = next(shape.tag for shape in plan.shapes if shape.alias == binding.source)
            bound[binding.name] = _listed(elements_of(sources[binding.source]), tag)
        elif binding.node is not None:
            bound[binding.name] = _bound_value(outer, binding.node, binding.column)
    return bound


def _bound_value(outer: Evaluator, node: Node, column: str | None) -> Any:
    value = outer.value(node)
    try:
        return value.column(column) if column else value
    except SelectScriptError as error:  # an entity that is gone
        error.span = error.span or node.span
        raise


def _listed(elements: Sequence[Any], tag: Tag | None) -> list[Any]:
    """What stands for the elements of a source in SQL: of what SQL does not know, the count."""
    if tag is not None and tag.type == "entity":
        return [element.column("id") for element in elements]
    return [0] * len(elements) if tag is None or tag.type == "any" else list(elements)


@dataclass(frozen=True)
class _Run:
    """One run of a plan; `once` holds what is the same for all rows, from when it is needed."""

    plan: Plan
    outer: Evaluator
    sources: Mapping[str, Any]
    worlds: Mapping[str, World]
    once: dict[Node, list[Any]]

    def output(self, output: Output, values: tuple[Any, ...]) -> Any:
        """The value of a column; an entity's id as its handle."""
        value = values[output.index]
        if output.schema is None or value is None:
            return value
        return self.worlds[output.schema].entity(value)


class _Row:
    """One row that SQL left, and what Python makes of it."""

    def __init__(self, run: _Run, values: tuple[Any, ...]) -> None:
        self._run = run
        self._values = values

    @cached_property
    def _evaluator(self) -> Evaluator:
        run, plan = self._run, self._run.plan
        known = dict(run.outer.known)
        known.update((part, self.output(output)) for part, output in plan.known.items())
        elements: dict[str | None, Any] = dict(run.outer.elements)
        elements.update((shape.alias, self._element(shape)) for shape in plan.shapes)
        if len(plan.shapes) == 1:
            elements[None] = elements[plan.shapes[0].alias]
        return Evaluator(run.outer.scope, known, elements, run.once)

    def _element(self, shape: Shape) -> Any:
        """The current element of a source; of values that SQL does not know, SQL has the number."""
        element = self.output(self._run.plan.elements[shape.alias])
        if shape.tag is not None and shape.tag.type == "any":
            return elements_of(self._run.sources[shape.alias])[element - 1]
        return element

    def value(self, node: Node) -> Any:
        """The value of a part that was left to Python."""
        return self._evaluator.value(node)

    def output(self, output: Output) -> Any:
        """The value of a column."""
        return self._run.output(output, self._values)

    def item(self, item: Item) -> Any:
        """The value of a selected item or of a key."""
        return self.value(item.node) if item.output is None else self.output(item.output)

    def name(self, name: str | Item) -> Any:
        """What this row calls a column."""
        return name if isinstance(name, str) else self.item(name)


def _ordered(rows: list[_Row], keys: Sequence[tuple[Item, bool]]) -> list[_Row]:
    """The rows by their keys; rows with equal keys stay in their order."""

    def compare(left: _Row, right: _Row) -> int:
        for item, descending in keys:
            a, b = left.item(item), right.item(item)
            if a != b:
                less = bool(apply("<", a, b, item.node.span))
                return -1 if less != descending else 1
        return 0

    return sorted(rows, key=cmp_to_key(compare))


def _count(value: Any, node: Node) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise EvaluationError(f"LIMIT takes a number of rows, not {value!r}", span=node.span)
    return value
