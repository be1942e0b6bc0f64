"""The terms of a task over all environments of a batch: `Interpreter.terms`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ssduck.columns.arrays import Array
from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.formatting import joined_names, short_repr
from ssduck.geometry.arrays import Flags
from ssduck.gym.judge import is_decided_later
from ssduck.gym.terms import CONDITIONS, Reward, Term, Terms, WhereNaN, compiled
from ssduck.language import ast
from ssduck.world.batches.batch_world import BatchWorld

if TYPE_CHECKING:
    from ssduck.interpreter.interpreter import Interpreter


@dataclass(frozen=True, eq=False)
class BatchJudgement:
    """The values of terms in n environments, as arrays of the library that the states came in.

    Attributes:
        success: (n,), whether the task is done; None without such a term.
        failure: (n,), whether it has failed; None without such a term, and without NaN that is one.
        stop: (n,), whether the episode ends; likewise.
        reward: (n,), the sum of the parts; None without a reward.
        parts: the parts of the reward by name, (n,) each.
    """

    success: Any
    failure: Any
    stop: Any
    reward: Any
    parts: Mapping[str, Any]


class BatchTerms:
    """The terms of a task over a batch; a call returns their values at its last tick.

    Args:
        interpreter: has the batch.
        success: a condition: whether the task is done.
        failure: a condition: whether it has failed.
        reward: a number, or numbers by name, which are added.
        stop_when: a condition that ends an episode. It may use `success` and `failure` by name, as
            a reward may.
        world: the name of the batch; None for the only one.
        nan: what a term is in an environment in which it cannot be computed, since a number of the
            state is NaN: `"error"`; `"failure"`, where the episode has failed and ends, and the
            part of the reward is 0; or a number for the part of the reward, where a condition is
            False.

    Attributes:
        terms: the terms.

    Raises:
        ArgumentError: a term is of the wrong type, or there is no batch of that name.
        SelectScriptError: a term is wrong otherwise; the message begins with its key.
    """

    def __init__(
        self,
        interpreter: Interpreter,
        success: str | None = None,
        failure: str | None = None,
        reward: Reward | None = None,
        stop_when: str | None = None,
        *,
        world: str | None = None,
        nan: WhereNaN = "error",
    ) -> None:
        self.terms = Terms.of(success, failure, reward, stop_when, nan=nan)
        self._interpreter, self._world = interpreter, _batch(interpreter, world)
        programs = {
            term.key: compiled(interpreter, term.key, term.text).tree for term in self.terms
        }
        trees = {key: program.statements[0] for key, program in programs.items()}
        nodes = [self._expanded(term, trees) for term in self.terms]
        # What is not decided yet does not hold.
        self._decided_later = [
            term.is_condition and is_decided_later(node)
            for term, node in zip(self.terms, nodes, strict=True)
        ]
        for term, node in zip(self.terms, nodes, strict=True):
            try:
                interpreter.over_batch([node], self._world, programs[term.key])
            except SelectScriptError as error:
                error.message = f"{term.key}: {error.message}"
                raise
        self._expressions = interpreter.over_batch(nodes, self._world)

    def __call__(self) -> BatchJudgement:
        """Returns the values of the terms at the last tick.

        Raises:
            ArgumentError: a value is of the wrong type, or unknown without `nan`.
            SelectScriptError: a term failed in an environment, whose number the error has.
        """
        world, nan = self._world, self.terms.nan
        answers = self._expressions.answers()
        values, failed = [], np.zeros(world.count, np.bool_)
        for term, answer, is_later in zip(self.terms, answers, self._decided_later, strict=True):
            own, unknown = _typed(term, answer.values, answer.unknown)
            if is_later:
                own &= ~unknown
            elif unknown.any():
                if nan == "error":
                    raise self._unknown_error(term, unknown)
                fill = 0.0 if nan == "failure" or term.is_condition else nan
                own = np.where(unknown, own.dtype.type(fill), own)
                failed |= unknown
            values.append(own)
        left = iter(values)
        flags = [None if term is None else next(left) for term in self.terms.conditions.values()]
        if nan == "failure" and failed.any():
            flags[0] = None if flags[0] is None else flags[0] & ~failed
            flags[1:] = [failed if flag is None else flag | failed for flag in flags[1:]]
        parts = dict(zip(self.terms.parts, left, strict=True))
        reward = np.sum(list(parts.values()), axis=0) if parts else None
        success, failure, stop, reward = (
            None if value is None else world.given_back(value) for value in (*flags, reward)
        )
        given = {name: world.given_back(value) for name, value in parts.items()}
        return BatchJudgement(success, failure, stop, reward, given)

    def _unknown_error(self, term: Term, unknown: Flags) -> ArgumentError:
        numbers = np.flatnonzero(unknown)
        named = joined_names([str(number) for number in numbers], 5)
        with self._world.at(int(numbers[0])):
            has_nan = bool(self._world.snapshot.entities_with_nan(may_lack_velocities=True))
        if not has_nan:
            return ArgumentError(
                f"{term.key}: {term.text!r} has no value in environment {named}, where no pose is "
                "NaN: the states lack a number that it reads, such as a velocity, or a part is "
                "nothing there, as since is where its condition does not hold: heldFor is 0 there"
            )
        return term.nan_error(f"a number that it reads is NaN in environment {named}")

    def _expanded(self, term: Term, trees: Mapping[str, ast.Node]) -> ast.Node:
        """Returns a term with the conditions that it names."""

        def visit(node: ast.Node) -> ast.Node | None:
            if not (isinstance(node, ast.Name) and node.name in CONDITIONS):
                return None
            if term.key in CONDITIONS:
                raise ArgumentError(f"{term.key} cannot use {node.name}: write its term out")
            if node.name not in trees:
                raise ArgumentError(f"{term.key} uses {node.name}, and there is no such term")
            return trees[node.name]

        return trees[term.key].replaced(visit)


def _batch(interpreter: Interpreter, name: str | None) -> BatchWorld:
    """Returns the batch of a name, or the only one."""
    batches = {w.name: w for w in interpreter.worlds if isinstance(w, BatchWorld)}
    if name is not None:
        world = interpreter[name]
        if not isinstance(world, BatchWorld):
            raise ArgumentError(
                f"terms: {name!r} is {short_repr(world)}, no batch, which World.batch makes"
            )
        return world
    if len(batches) != 1:
        known = f" of {', '.join(batches)}" if batches else ": World.batch makes one"
        raise ArgumentError(f"terms: name the batch by world=…{known}")
    return next(iter(batches.values()))


def _typed(term: Term, values: Array, unknown: Flags) -> tuple[Array, Flags]:
    """Returns values of a term's type, and where they are unknown."""
    kind = values.dtype.kind
    if values.ndim == 1 and term.is_condition and kind == "b":
        return values, unknown
    if values.ndim == 1 and not term.is_condition and kind in "fiu":
        numbers = values.astype(np.float64)
        return numbers, unknown | np.isnan(numbers)
    known = values[~unknown]
    if not len(known):
        return np.zeros(len(values), np.bool_ if term.is_condition else np.float64), unknown
    term.check(known[0].tolist() if isinstance(known[0], np.ndarray | np.generic) else known[0])
    raise ArgumentError(f"{term.key}: {term.text!r} is of several types")
