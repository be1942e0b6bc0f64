"""How a query runs: the types that a plan depends on, and the plan itself."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, Protocol

from sqlglot import exp

from ssduck.tree import (
    Call,
    Node,
    Query,
)
from ssduck.udfs import ValueType


@dataclass(frozen=True)
class Tag:
    """The type of a value: what a plan depends on.

    Attributes:
        type: what it is.
        element: of a list, what its elements are.
        length: of a list, how many it has.
        schema: of an entity, the world that it is in.
        nullable: of an entity, whether there may be none.
    """

    type: ValueType
    element: ValueType | None = None
    length: int | None = None
    schema: str | None = None
    nullable: bool = False


@dataclass(frozen=True)
class Shape:
    """What a source is, and what it is called.

    A source without a schema is a list of values, or of entities of one world if `tag` says so;
    one with a schema and no tag is a world.
    """

    alias: str
    schema: str | None
    tag: Tag | None


class Names(Protocol):
    """What the translator needs to know of the interpreter's names."""

    def has_variable(self, name: str) -> bool:
        """Whether there is a variable of that name."""

    def has_source(self, alias: str) -> bool:
        """Whether a query around this one has a source of that name."""

    def tag(self, node: Node) -> Tag:
        """The type of the value of an expression that depends on no row of this query."""

    def check_call(self, node: Call) -> None:
        """Complain of an unknown function, or of a wrong number of arguments."""


@dataclass(frozen=True)
class Binding:
    """A parameter of the SQL.

    Attributes:
        name: of the parameter.
        node: the expression that it is the value of,
        column: or the column of the entity that the expression is.
        source: instead, the source that it lists the elements of.
        type: of the value.
    """

    name: str
    node: Node | None = None
    column: str | None = None
    source: str | None = None
    type: ValueType = "list"


@dataclass(frozen=True)
class Output:
    """A column of the SQL: its place, and of an entity's id the world that it is of."""

    index: int
    schema: str | None


@dataclass(frozen=True)
class Item:
    """A value for each row: a column, or an expression over columns left to Python."""

    node: Node
    output: Output | None


@dataclass(eq=False)
class Plan:
    """How a query runs.

    Attributes:
        select: the SQL as sqlglot's tree; `sql` is its text.
        bindings: its parameters.
        constants: what does not depend on rows, with the types that the plan relies on.
        known: the columns by the part of the tree that they are the value of.
        conditions: parts of WHERE that are left to Python, in order.
        items: what is selected.
        names: what each selected item is called: a text, or an item to be evaluated.
        order: keys that are left to Python, with whether they descend.
        limit: LIMIT, if it is left to Python.
        elements: the column of each source's element, by alias.
        once: constants that are left to Python.
        bare: bare names that were looked up, and whether there was a variable of that name.
    """

    query: Query
    shapes: tuple[Shape, ...]
    select: exp.Select = field(default_factory=exp.Select)
    sql: str = ""
    bindings: list[Binding] = field(default_factory=list)
    constants: dict[Node, Tag] = field(default_factory=dict)
    known: dict[Node, Output] = field(default_factory=dict)
    conditions: list[Node] = field(default_factory=list)
    items: list[Item] = field(default_factory=list)
    names: list[str | Item] = field(default_factory=list)
    order: list[tuple[Item, bool]] = field(default_factory=list)
    limit: Node | None = None
    elements: dict[str, Output] = field(default_factory=dict)
    once: list[Node] = field(default_factory=list)
    bare: dict[str, bool] = field(default_factory=dict)

    @cached_property
    def outputs(self) -> list[Output] | None:
        """The columns that the selected items are, if nothing is left to Python."""
        if self.left or not all(isinstance(name, str) for name in self.names):
            return None
        return [item.output for item in self.items if item.output is not None]

    @property
    def numbers(self) -> dict[str, Literal["real", "integer"]] | None:
        """The types of its parameters if all of them are numbers."""
        types: dict[str, Literal["real", "integer"]] = {}
        for binding in self.bindings:
            if binding.type not in ("real", "integer"):
                return None
            types[binding.name] = binding.type
        return types

    def fits(self, shapes: tuple[Shape, ...], names: Names) -> bool:
        """Whether it runs as it is for sources of these shapes and the present variables."""
        return (
            self.shapes == shapes
            and all(names.has_variable(name) == known for name, known in self.bare.items())
            and all(names.tag(node) == tag for node, tag in self.constants.items())
        )

    @property
    def left(self) -> list[Node]:
        """What is left to Python."""
        items = [item.node for item in self.items if item.output is None]
        names = [name.node for name in self.names if isinstance(name, Item) and not name.output]
        keys = [item.node for item, _ in self.order]
        return [*self.conditions, *items, *names, *keys, *([self.limit] if self.limit else [])]
