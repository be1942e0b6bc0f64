"""Chains of operators of one precedence level, and the nodes that they become.

Few operands are nested from the left. Many are kept in a flat node, so that neither parsing nor
evaluation recurses deeply.
"""

from __future__ import annotations

from collections.abc import Iterator

from ssduck.errors import SourceSpan
from ssduck.language.tree import Binary, Node, OperatorChain

# The largest number of nested operands; SQL allows more.
MAX_NESTING = 32
# The largest number of joined conditions in SQL; DuckDB's time grows with their square.
MAX_CHAIN = 400


class OperandRow:
    """The operands of a chain of operators, as they are parsed.

    Args:
        start: where the text of the first operand begins.
        first: the first operand.
        end: where its text ends.

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
        for operator, operand, end in zip(self.operators, others, self.ends[1:], strict=True):
            node = Binary(SourceSpan(self.start, end), operator, node, operand)
        return node


def conjuncts(node: Node | None) -> Iterator[Node]:
    """Yields the parts of a condition that AND joins, in order; the whole if they are too many.

    >>> from ssduck.language.parser import parse
    >>> [part.outline() for part in conjuncts(parse("a AND b AND c;").statements[0])]
    ["Name('a')", "Name('b')", "Name('c')"]
    """
    match node:
        case Binary(operator="AND", left=left, right=right):
            yield from conjuncts(left)
            yield from conjuncts(right)
        case OperatorChain(operators=("AND", *_), operands=operands) if len(operands) <= MAX_CHAIN:
            for operand in operands:
                yield from conjuncts(operand)
        case Node():
            yield node
