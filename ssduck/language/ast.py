"""The abstract syntax tree of a program: frozen nodes that know their place in the text.

Names are looked up when a program runs.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

from ssduck.errors import SourceSpan

# The fields that are places in the text.
_PLACES = frozenset(("span", "name_span", "value_start"))


@dataclass(frozen=True, eq=False)
class Node:
    """A part of a program; `span` is its place in the text.

    Nodes are compared by identity, so that they are quick to look up.
    """

    span: SourceSpan

    def children(self) -> Iterator[Node]:
        """Yields the nodes directly below this one, in text order."""
        for name in self.__dataclass_fields__:  # faster than `fields`
            value = getattr(self, name)
            for item in value if isinstance(value, tuple) else (value,):
                if isinstance(item, Node):
                    yield item

    def walk(self) -> Iterator[Node]:
        """Yields the node itself and all below it."""
        yield self
        for child in self.children():
            yield from child.walk()

    def outline(self) -> str:
        """Returns the node and all below it as text, without their places.

        >>> from ssduck.language.parser import parse
        >>> parse("IF(x > 1; 'far'; 'near');").statements[0].outline()
        "If(Binary('>', Name('x'), Literal(1)), [Literal('far')], [Literal('near')])"
        """

        def text(value: Any) -> str:
            if isinstance(value, tuple):
                return f"[{', '.join(map(text, value))}]"
            return value.outline() if isinstance(value, Node) else repr(value)

        values = (
            getattr(self, field.name)
            for field in fields(self)
            if field.name not in _PLACES and getattr(self, field.name) != field.default
        )
        return f"{type(self).__name__}({', '.join(map(text, values))})"

    def replaced(self, change: Callable[[Node], Node | None]) -> Node:
        """Returns the node with parts of it changed, from the outside in.

        Args:
            change: a function that returns the replacement of a part, or None to visit its parts.

        Returns:
            The node itself if nothing changes.
        """
        changed = change(self)
        if changed is not None:
            return changed
        parts: dict[str, Any] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            part: Any = value
            if isinstance(value, Node):
                part = value.replaced(change)
            elif isinstance(value, tuple):
                part = tuple(v.replaced(change) if isinstance(v, Node) else v for v in value)
                part = value if all(map(operator.is_, part, value)) else part
            if part is not value:
                parts[field.name] = part
        return replace(self, **parts) if parts else self


@dataclass(frozen=True, eq=False)
class Literal(Node):
    """A number, a text, True or False."""

    value: int | float | str | bool


@dataclass(frozen=True, eq=False)
class ListLiteral(Node):
    """`[a, b, …]`."""

    items: tuple[Node, ...]


@dataclass(frozen=True, eq=False)
class Name(Node):
    """A variable, or in SELECT, GROUP BY and ORDER BY a key or a function of `this`."""

    name: str


@dataclass(frozen=True, eq=False)
class UnresolvedName(Node):
    """A name in SELECT, GROUP BY or ORDER BY whose meaning differs from row to row.

    It is a key of the current element if that is a dict with the key, else a variable, else a
    function of `this`. The parser makes none; a `Name` becomes one when the sources are known.
    """

    name: str


@dataclass(frozen=True, eq=False)
class Placeholder(Node):
    """A value that the frame provides; the parser makes none."""

    name: str


@dataclass(frozen=True, eq=False)
class TimeIndex(Node):
    """`v{5.0}`: a value of a variable's history; `v{}`, the whole history, has no age."""

    name: str
    age: Node | None


@dataclass(frozen=True, eq=False)
class This(Node):
    """The current element of a source: `this`, or `alias.this`."""

    alias: str | None


@dataclass(frozen=True, eq=False)
class QualifiedName(Node):
    """`a.id`, where `a` is an alias: a key of the current element, or a function of it.

    If there is a variable of the alias's name, it means `index`: an element of the variable.
    """

    alias: str
    key: str
    index: Index

    @cached_property
    def this(self) -> This:
        """The current element."""
        return This(self.span, self.alias)

    def call(self, name: str) -> Call:
        """Returns the function of it."""
        return Call(self.span, name, (self.this,), self.index.indices[0].span)

    def children(self) -> Iterator[Node]:
        """Yields no nodes: `index` is evaluated only if there is a variable of that name."""
        return iter(())


@dataclass(frozen=True, eq=False)
class Call(Node):
    """`f(a, b)`; `name_span` is the place of `f` alone."""

    name: str
    arguments: tuple[Node, ...]
    name_span: SourceSpan


@dataclass(frozen=True, eq=False)
class Index(Node):
    """`x[i]`, `x[i, j]` and `x.key`."""

    base: Node
    indices: tuple[Node, ...]


@dataclass(frozen=True, eq=False)
class Unary(Node):
    """`-x`, `+x`, `NOT x`; `x IS NULL`, whose operator is `IS NULL`."""

    operator: str
    operand: Node


@dataclass(frozen=True, eq=False)
class Binary(Node):
    """`a + b` and the like; the operator as in `LEVELS`."""

    operator: str
    left: Node
    right: Node


@dataclass(frozen=True, eq=False)
class OperatorChain(Node):
    """`a + b - c …`: a long chain of operators of one level, which is kept flat."""

    operators: tuple[str, ...]  # the operators, one less than operands
    operands: tuple[Node, ...]  # the operands from the left
    ends: tuple[int, ...]  # the end of each operand in the text

    def until(self, index: int) -> SourceSpan:
        """Returns the place of the operands up to this one."""
        return SourceSpan(self.span.start, self.ends[index])


@dataclass(frozen=True, eq=False)
class Branch(Node):
    """An `IF` that is the whole else branch of another one, without its own else branch."""

    condition: Node
    then: tuple[Node, ...]


@dataclass(frozen=True, eq=False)
class If(Node):
    """`IF(condition; then, …; else, …)`: its value is the last one of a branch."""

    condition: Node  # the first condition
    then: tuple[Node, ...]  # the expressions to evaluate if it holds
    otherwise: tuple[Node, ...]  # the expressions to evaluate if no condition holds
    else_ifs: tuple[Branch, ...] = ()  # the further conditions, in order, and their expressions

    @property
    def branches(self) -> tuple[Branch, ...]:
        """All conditions and their expressions."""
        return (Branch(self.span, self.condition, self.then), *self.else_ifs)


@dataclass(frozen=True, eq=False)
class UnboundedHorizon(Node):
    """`{}` in `name{} = value`: a horizon without end."""


@dataclass(frozen=True, eq=False)
class Assignment(Node):
    """`name = value`, or `name{horizon} = value`."""

    name: str  # the name of the variable
    horizon: Node | None  # the time for which the variable keeps its values
    value: Node  # the new value
    is_bare: bool = False  # whether it is a whole item of SELECT, where `==` may be meant
    # The place of the value in the text where `=` may compare, which is in SELECT, GROUP BY and
    # ORDER BY; None elsewhere.
    value_start: int | None = None


@dataclass(frozen=True, eq=False)
class Source(Node):
    """One entry of FROM: its alias, and the value whose elements are its rows."""

    alias: str | None
    value: Node

    @property
    def is_table(self) -> bool:
        """Whether its elements are the rows of a nested query, as dicts."""
        return isinstance(self.value, Query) and (
            self.value.adapter is None or self.value.adapter.name in ("dict", "dictionary")
        )


@dataclass(frozen=True, eq=False)
class OrderKey(Node):
    """One entry of ORDER BY."""

    value: Node
    descending: bool


@dataclass(frozen=True, eq=False)
class Recursion(Node):
    """`START WITH … CONNECT BY … STOP WITH …`; `memorize` is the n of `MEMORIZE n`.

    `start` and `step` are assignments to state variables, and other expressions.
    """

    start: tuple[Node, ...]
    no_cycle: bool
    unique: bool
    memorizes: bool
    memorize: Node | None
    maximum: Node | None
    step: tuple[Node, ...]
    stop: Node


@dataclass(frozen=True, eq=False)
class AdapterClause(Node):
    """`AS name(arguments)`."""

    name: str  # the name of the result form
    arguments: tuple[Node, ...] = ()  # its positional arguments
    named: tuple[Assignment, ...] = ()  # its named arguments
    # Whether a nested query has it as in SQL: a value is of one row at most, and nothing without a
    # row; the rows of all groups are together.
    of_sql: bool = False
    # Whether a value must not be nothing: `<>` and NOT IN hold of it here, but not in SQL.
    is_required: bool = False


@dataclass(frozen=True, eq=False)
class Query(Node):
    """A SELECT; no items mean `*`. Without `is_ordered`, its rows may come in any order."""

    items: tuple[Node, ...]
    sources: tuple[Source, ...]
    where: Node | None = None
    recursion: Recursion | None = None
    group: tuple[Node, ...] = ()
    having: Node | None = None
    order: tuple[OrderKey, ...] = ()
    limit: Node | None = None
    adapter: AdapterClause | None = None
    distinct: bool = False
    offset: Node | None = None
    is_ordered: bool = True


@dataclass(frozen=True)
class Suspicion:
    """A probable mistake: a construct that is valid, but rarely intended."""

    span: SourceSpan  # its place
    message: str  # the reason, and a correction
    is_grave: bool = False  # whether it is an error in a term of success or reward


@dataclass(frozen=True, eq=False)
class Program:
    """A parsed text: its statements in order, and the probable mistakes in it."""

    text: str
    statements: tuple[Node, ...]
    explain: str = ""  # `EXPLAIN` or `WHY`, if it begins with that
    suspicions: tuple[Suspicion, ...] = ()


# The largest number of nested operands; SQL allows more.
MAX_NESTING = 32
# The largest number of joined conditions in SQL; DuckDB's time grows with their square.
MAX_CHAIN = 400


class OperandRow:
    """The operands of a chain of operators, as they are parsed.

    Attributes:
        start: where the text of the first operand begins.
        operators: the operators between them.
        operands: the operands.
        ends: where the text of each ends.
    """

    def __init__(self, start: int, first: Node, end: int) -> None:
        self.start = start
        self.operators: list[str] = []
        self.operands = [first]
        self.ends = [end]

    def add(self, operator: str, operand: Node, end: int) -> None:
        """Adds an operand, with the operator before it and the end of its text."""
        self.operators.append(operator)
        self.operands.append(operand)
        self.ends.append(end)

    def node(self) -> Node:
        """Returns the node of the whole chain."""
        if len(self.operands) > MAX_NESTING:
            span = SourceSpan(self.start, self.ends[-1])
            return OperatorChain(
                span, tuple(self.operators), tuple(self.operands), tuple(self.ends)
            )
        node, *others = self.operands
        for sign, operand, end in zip(self.operators, others, self.ends[1:], strict=True):
            node = Binary(SourceSpan(self.start, end), sign, node, operand)
        return node


def conjuncts(node: Node | None) -> Iterator[Node]:
    """Returns the parts of a condition that AND joins, in order; the whole if they are too many.

    >>> from ssduck.language.parser import parse
    >>> [part.outline() for part in conjuncts(parse("a AND b AND c;").statements[0])]
    ["Name('a')", "Name('b')", "Name('c')"]
    """
    return iter(()) if node is None else joined(node, "AND", MAX_CHAIN)


def joined(node: Node, sign: str, most: float) -> Iterator[Node]:
    """Yields what an operator such as OR joins, in order; a chain of more than `most` is whole."""
    match node:
        case Binary(operator=own) | OperatorChain(operators=(own, *_)) if own == sign:
            if len(operands := tuple(node.children())) <= most:
                for operand in operands:
                    yield from joined(operand, sign, most)
                return
    yield node
