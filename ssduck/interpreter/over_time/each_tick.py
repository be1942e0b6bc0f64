"""Evaluates expressions at each tick of a recorded episode, from a few queries over all ticks.

Whatever names entities alone is a *series*: one query has its values at all ticks. A function of
time folds one. What is left, of variables and of these values, is computed tick by tick.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from ssduck.errors import UnsupportedError
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS, parts_of
from ssduck.language.analysis import IMPURE
from ssduck.language.builtins import BUILTINS
from ssduck.language.evaluator import Frame
from ssduck.language.tree import (
    Binary,
    Branch,
    Call,
    If,
    ListLiteral,
    Literal,
    Name,
    Node,
    OperatorChain,
    Placeholder,
    QualifiedName,
    Query,
    TimeIndex,
    Unary,
)
from ssduck.language.value_keys import node_key
from ssduck.sql.relations.registry import RELATIONS

# What is computed from values alone.
_OF_VALUES = (Literal, ListLiteral, Unary, Binary, OperatorChain, Branch, If)


class ExpressionsAtTicks:
    """Expressions of entities of one world and of variables, at each tick of an episode.

    Args:
        interpreter: has the world, at the last tick of an episode.
        expressions: the expressions.
        world: the name of the world.
        variables: the names of the variables whose values differ from tick to tick.
    """

    def __init__(
        self,
        interpreter: Interpreter,
        expressions: Sequence[Node],
        world: str,
        variables: Collection[str],
    ) -> None:
        self._execution = interpreter._execution  # noqa: SLF001  # one package
        self._world, self._variables = world, variables
        self._series: dict[str, Call] = {}
        self._trees = [self._of_values(expression) for expression in expressions]

    def _of_values(self, node: Node) -> Node:
        """Returns an expression with placeholders for what differs from tick to tick."""
        if isinstance(node, Name) and node.name in self._variables:
            return Placeholder(node.span, node.name)
        if isinstance(node, Call) and node.name in TEMPORAL_FUNCTIONS:
            return self._fold(node)
        if self._is_of_entities(node):
            return self._placeholder(Call(node.span, "changes", (node,), node.span))
        is_builtin = isinstance(node, Call) and node.name in BUILTINS and node.name not in IMPURE
        if not (isinstance(node, _OF_VALUES) or is_builtin):
            raise UnsupportedError("it is computed at each tick by itself", span=node.span)
        children = {id(child): self._of_values(child) for child in node.children()}
        return node.replaced(lambda part: children.get(id(part)))

    def _fold(self, call: Call) -> Node:
        """Returns what stands for a call of a function of time."""
        expansion = self._execution.temporal.expansion(call)
        if expansion is not None:
            return self._of_values(expansion)
        expression, other = parts_of(call)
        is_fold = TEMPORAL_FUNCTIONS[call.name].fold is not None and other is None
        if not (is_fold and self._is_of_entities(expression)):
            raise UnsupportedError("it is computed at each tick by itself", span=call.span)
        return self._placeholder(call)

    def _placeholder(self, call: Call) -> Node:
        key = node_key(call)
        self._series.setdefault(key, call)
        return Placeholder(call.span, key)

    def _is_of_entities(self, node: Node) -> bool:
        """Checks whether an expression names entities of the world, and nothing else."""
        names = [part.name for part in node.walk() if isinstance(part, Name)]
        names += [part.alias for part in node.walk() if isinstance(part, QualifiedName)]
        is_known = all(
            part.name in RELATIONS or (part.name in BUILTINS and part.name not in IMPURE)
            for part in node.walk()
            if isinstance(part, Call)
        )
        is_past = any(isinstance(part, TimeIndex | Query) for part in node.walk())
        return bool(names) and set(names) == {self._world} and is_known and not is_past

    def values(
        self, times: Sequence[float], variables: Sequence[Mapping[str, Any]]
    ) -> list[list[Any]] | None:
        """Returns the values of all expressions at some ticks.

        Args:
            times: the times of ticks, s, each later than the one before.
            variables: the values of the variables at these.

        Returns:
            None if the record has other ticks.
        """
        series = {key: self._values_of(call) for key, call in self._series.items()}
        if not all(time in values for values in series.values() for time in times):
            return None
        result = []
        for time, own in zip(times, variables, strict=True):
            placeholders = {**{key: values[time] for key, values in series.items()}, **own}
            frame = Frame(self._execution, placeholders=placeholders)
            result.append([frame.value(tree) for tree in self._trees])
        return result

    def _values_of(self, call: Call) -> dict[float, Any]:
        """Returns the values of an expression, or of its fold, by the times of all ticks."""
        execution = self._execution
        with execution.lock, execution.worlds_pinned(call):
            execution.begin_meter()
            series = execution.series(call, Frame(execution))
            times, values = series.at(series.past(None))
        if None in values:
            raise UnsupportedError("whether it is known is found at each tick", span=call.span)
        fold = TEMPORAL_FUNCTIONS[call.name].fold
        if fold is None:
            return dict(zip(times, values, strict=True))
        if fold.is_of_condition:
            values = list(map(series.is_true, values))
        state: Any = None
        result = {}
        for place, (time, value) in enumerate(zip(times, values, strict=True)):
            state = fold.step(state, time, value) if place else fold.first(time, value)
            result[time] = fold.value(state, time)
        return result
