"""The expressions of a task at each tick of an episode, a recorded one or one that goes on."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.over_time.functions import TEMPORAL_FUNCTIONS, expressions_of, is_fold
from ssduck.interpreter.over_time.nested import Column, Ticks
from ssduck.language import ast
from ssduck.language.analysis import mentions
from ssduck.language.evaluator import Frame


class ExpressionsAtTicks:
    """Expressions of entities of one world and of variables, at each tick of an episode."""

    def __init__(
        self, interpreter: Interpreter, expressions: Sequence[ast.Node], world: str
    ) -> None:
        self._execution = interpreter._execution  # noqa: SLF001  # one package
        self._world = world
        self._trees = list(map(self._execution.expanded, expressions))

    def values(
        self, times: Sequence[float], variables: Sequence[Mapping[str, Any]]
    ) -> list[list[Any]] | None:
        """Returns the values of all expressions at some ticks.

        Args:
            times: the times of ticks, s, each later than the one before.
            variables: the values of the variables at these.

        Returns:
            None if the record has other ticks, if a value is not known at each of them, or if a
            function of time is no fold, or has a variable, whose past is not the world's.
        """
        execution = self._execution
        for past in (part for tree in self._trees for part in tree.walk() if _reads_past(part)):
            if not (isinstance(past, ast.Call) and is_fold(past)) or mentions(past, variables[0]):
                return None
        world = execution.variable(self._world)
        given = {
            name: Column.of_objects([values[name] for values in variables]) for name in variables[0]
        }
        with execution.lock, execution.worlds_pinned(*self._trees):
            execution.begin_meter()
            record = execution.database.record_of(world)
            ticks = Ticks(execution.nested, record, Frame(execution), given)
            places = np.searchsorted(ticks.times, times)
            is_same = len(times) == len(ticks.times) or not given
            if not (is_same and np.array_equal(ticks.times[places], times)):
                return None
            columns = [ticks.column(tree) for tree in self._trees]
        if ticks.has_unknown or any(column.unknown[places].any() for column in columns):
            return None
        chosen = (column.values[places].tolist() for column in columns)
        return list(map(list, zip(*chosen, strict=True)))


class JudgedFolds:
    """The functions of time in expressions that are evaluated at each tick of an episode.

    It is an observer of ticks, which others may take, too; see `TickObserver`.
    """

    def __init__(
        self, interpreter: Interpreter, expressions: Sequence[ast.Node], variables: Collection[str]
    ) -> None:
        self._execution = interpreter._execution  # noqa: SLF001  # one package
        self._variables = frozenset(variables)
        trees = map(self._execution.expanded, expressions)
        found = [part for tree in trees for part in self._temporal(tree)]
        self._calls = [part for part in found if isinstance(part, ast.Call) and self._is_fold(part)]
        # Whether an expression needs the record of past ticks.
        self.need_record = len(self._calls) < len(found)
        # Whether expressions are to be evaluated at the next tick, and `settle` follows.
        self.are_asked = False

    def _temporal(self, node: ast.Node) -> Iterator[ast.Node]:
        """Yields the parts of an expression that read the past."""
        if isinstance(node, ast.TimeIndex):
            yield node
        if isinstance(node, ast.Call) and node.name in TEMPORAL_FUNCTIONS:
            yield node
            for part in expressions_of(node):
                yield from self._temporal(part)
        elif isinstance(node, ast.Query):  # of rows
            yield from (part for part in node.walk() if _reads_past(part))
        else:
            for child in node.children():
                yield from self._temporal(child)

    def _is_fold(self, call: ast.Call) -> bool:
        """Checks whether the value at a tick follows from that at the tick before."""
        if not is_fold(call, at_first=True):
            return False
        names = {part.name for part in call.walk() if isinstance(part, ast.Name)}
        for expression in expressions_of(call):
            whole = expression.base if isinstance(expression, ast.Index) else expression
            if isinstance(whole, ast.Name | ast.QualifiedName):
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
        if not self.need_record and any(map(execution.folds.misses, self._calls)):
            with execution.lock:
                execution.begin_meter()
                execution.folds.settle(self._calls)


def _reads_past(node: ast.Node) -> bool:
    return isinstance(node, ast.TimeIndex) or (
        isinstance(node, ast.Call) and node.name in TEMPORAL_FUNCTIONS
    )
