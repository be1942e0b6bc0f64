"""Functions of time in expressions that are evaluated at each tick of an episode."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress

from ssduck.errors import SelectScriptError
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS, parts_of
from ssduck.language.evaluator import Frame
from ssduck.language.tree import Call, Index, Name, Node, QualifiedName, Query, TimeIndex


class JudgedFolds:
    """The functions of time in expressions that are evaluated at each tick of an episode.

    It is an observer of ticks, which others may take, too; see `TickObserver`.

    Args:
        interpreter: evaluates the expressions.
        expressions: the expressions.
        variables: the names of the variables, whose values a later tick may lack.

    Attributes:
        need_record: whether an expression needs the record of past ticks.
    """

    def __init__(
        self, interpreter: Interpreter, expressions: Sequence[Node], variables: Collection[str]
    ) -> None:
        self._execution = interpreter._execution  # noqa: SLF001  # one package
        self._variables = frozenset(variables)
        found = [part for expression in expressions for part in self._temporal(expression)]
        self._calls = [part for part in found if isinstance(part, Call) and self._is_fold(part)]
        self.need_record = len(self._calls) < len(found)

    def _temporal(self, node: Node) -> Iterator[Node]:
        """Yields the parts of an expression that read the past."""
        if isinstance(node, TimeIndex):
            yield node
        if isinstance(node, Call) and node.name in TEMPORAL_FUNCTIONS:
            expansion = self._execution.temporal.expansion(node)
            yield from [node] if expansion is None else self._temporal(expansion)
        elif isinstance(node, Query):  # of rows
            yield from (part for part in node.walk() if _reads_past(part))
        else:
            for child in node.children():
                yield from self._temporal(child)

    def _is_fold(self, call: Call) -> bool:
        """Checks whether the value at a tick follows from that at the tick before."""
        if TEMPORAL_FUNCTIONS[call.name].fold is None:
            return False
        expression, other = parts_of(call)
        names = {part.name for part in expression.walk() if isinstance(part, Name)}
        whole = expression.base if isinstance(expression, Index) else expression
        if other is not None or isinstance(whole, Name | QualifiedName):
            return False  # an entity at the tick before has to be read there
        is_simple = self._execution.folds.takes(call, Frame(self._execution))
        return is_simple and names.isdisjoint(self._variables)

    def due(self, _: object) -> float:
        """Returns infinity: it requests no tick."""
        return math.inf

    def ticked(self, _: object) -> None:
        """Adds the tick, whoever has taken it."""
        self.settle()

    def settle(self) -> None:
        """Adds the present tick to the functions that no expression needed at it."""
        execution = self._execution
        missed = [call for call in self._calls if execution.folds.misses(call)]
        if missed and not self.need_record:
            with execution.lock:
                execution.begin_meter()
                for call in missed:
                    with suppress(SelectScriptError):
                        Frame(execution).value(call)


def _reads_past(node: Node) -> bool:
    return isinstance(node, TimeIndex) or (
        isinstance(node, Call) and node.name in TEMPORAL_FUNCTIONS
    )
