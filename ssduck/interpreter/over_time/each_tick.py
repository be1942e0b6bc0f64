"""Evaluates expressions at each tick of a recorded episode, from a few queries over all ticks.

Whatever names entities alone is a *series*: one query has its values at all ticks. A function of
time folds one. What is left, of variables and of these values, is computed tick by tick.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

from ssduck.errors import SelectScriptError, UnsupportedError
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.over_time.functions import (
    OF_VALUES,
    TEMPORAL_FUNCTIONS,
    expressions_of,
    is_fold,
    parts_of,
)
from ssduck.language.analysis import IMPURE
from ssduck.language.builtins import BUILTINS
from ssduck.language.evaluator import Frame
from ssduck.language.tree import (
    Call,
    Index,
    Name,
    Node,
    Placeholder,
    QualifiedName,
    Query,
    TimeIndex,
)
from ssduck.language.value_keys import node_key
from ssduck.sql.relations.registry import RELATIONS


class ExpressionsAtTicks:
    """Expressions of entities of one world and of variables, at each tick of an episode."""

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
        expand = self._execution.expanded
        self._trees = [self._of_values(expand(expression)) for expression in expressions]

    def _of_values(self, node: Node) -> Node:
        """Returns an expression with placeholders for what differs from tick to tick."""
        if isinstance(node, Name) and node.name in self._variables:
            return Placeholder(node.span, node.name)
        if isinstance(node, Call) and node.name in TEMPORAL_FUNCTIONS:
            return self._fold(node)
        if self._is_of_entities(node):
            return self._placeholder(Call(node.span, "changes", (node,), node.span))
        is_builtin = isinstance(node, Call) and node.name in BUILTINS and node.name not in IMPURE
        if not (isinstance(node, OF_VALUES) or is_builtin):
            raise UnsupportedError("it is computed at each tick by itself", span=node.span)
        children = {id(child): self._of_values(child) for child in node.children()}
        return node.replaced(lambda part: children.get(id(part)))

    def _fold(self, call: Call) -> Node:
        """Returns what stands for a call of a function of time."""
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
            times, values = (column.tolist() for column in series.at(series.past(None)))
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


class JudgedFolds:
    """The functions of time in expressions that are evaluated at each tick of an episode.

    It is an observer of ticks, which others may take, too; see `TickObserver`.
    """

    def __init__(
        self, interpreter: Interpreter, expressions: Sequence[Node], variables: Collection[str]
    ) -> None:
        self._execution = interpreter._execution  # noqa: SLF001  # one package
        self._variables = frozenset(variables)
        trees = map(self._execution.expanded, expressions)
        found = [part for tree in trees for part in self._temporal(tree)]
        self._calls = [part for part in found if isinstance(part, Call) and self._is_fold(part)]
        # Whether an expression needs the record of past ticks.
        self.need_record = len(self._calls) < len(found)
        # Whether expressions are to be evaluated at the next tick, and `settle` follows.
        self.are_asked = False

    def _temporal(self, node: Node) -> Iterator[Node]:
        """Yields the parts of an expression that read the past."""
        if isinstance(node, TimeIndex):
            yield node
        if isinstance(node, Call) and node.name in TEMPORAL_FUNCTIONS:
            yield node
            for part in expressions_of(node):
                yield from self._temporal(part)
        elif isinstance(node, Query):  # of rows
            yield from (part for part in node.walk() if _reads_past(part))
        else:
            for child in node.children():
                yield from self._temporal(child)

    def _is_fold(self, call: Call) -> bool:
        """Checks whether the value at a tick follows from that at the tick before."""
        if not is_fold(call):
            return False
        names = {part.name for part in call.walk() if isinstance(part, Name)}
        for expression in expressions_of(call):
            whole = expression.base if isinstance(expression, Index) else expression
            if isinstance(whole, Name | QualifiedName):
                return False  # an entity at the tick before has to be read there
        is_simple = self._execution.folds.takes(call, Frame(self._execution))
        return is_simple and names.isdisjoint(self._variables)

    def due(self, _: object) -> float:
        """Returns infinity: it requests no tick."""
        return math.inf

    def ticked(self, _: object) -> None:
        """Adds the tick, whoever has taken it."""
        if not self.are_asked:
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
