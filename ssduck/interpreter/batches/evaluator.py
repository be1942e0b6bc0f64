"""Evaluates programs over a batch, each expression over all environments at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ssduck.columns.arrays import Array
from ssduck.errors import (
    ArgumentError,
    ProgramWarning,
    SelectScriptError,
    UnsupportedError,
    warn,
)
from ssduck.formatting import joined_names, short_repr
from ssduck.geometry.arrays import Flags, Indices
from ssduck.interpreter.batches.columns import ENV
from ssduck.interpreter.batches.expressions import Answers, CompiledExpressions, Engine, meaning_of
from ssduck.interpreter.batches.folds import ArrayFold, fold_of
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.over_time.functions import (
    TEMPORAL_FUNCTIONS,
    expressions_of,
    operator_of,
    parts_of,
)
from ssduck.language import ast
from ssduck.language.analysis import VERDICT, calls_of, variables_of
from ssduck.language.evaluator import Frame
from ssduck.language.value_keys import node_key
from ssduck.simulators.environments import to_numpy
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.handles import Handle
from ssduck.world.world import World

# The placeholder that has the simulated times.
_TIME = "time of the environment"


class BatchExpressions:
    """Expressions over all environments of a batch, compiled when they are evaluated first."""

    def __init__(self, execution: Execution, engine: Engine, nodes: Sequence[ast.Node]) -> None:
        self._execution, self._engine = execution, engine
        self._world = engine.world
        self._folds: dict[str, _KeptFold] = {}
        # The variables that have a value for each environment.
        self._arrays: set[str] = set()
        # The expressions, with placeholders for what arrays provide.
        nodes = [execution.expanded(node) for node in nodes]
        self.substituted = [node.replaced(self._replacement) for node in nodes]
        parts = (part for node in self.substituted for part in node.walk())
        self._read = {part.name for part in parts if isinstance(part, ast.Placeholder)}
        # The sums of whole forces over the contacts of an entity.
        self._sums = sorted(frozenset().union(*map(calls_of, nodes)) & {"force", "torque"})
        self._compiled: CompiledExpressions | None = None
        self._meaning: object = None  # what has to be the same for these
        names = frozenset().union(*map(variables_of, nodes))
        # The variables whose type may change.
        self._names = names - {name for name in names if self._is_world(name)}

    def _is_world(self, name: str) -> bool:
        scope = self._execution
        return scope.has_variable(name) and isinstance(scope.variable(name), BatchWorld)

    def _replacement(self, node: ast.Node) -> ast.Node | None:
        """Returns a placeholder for what arrays provide."""
        match node:
            case ast.Call(name="getTime"):
                return ast.Placeholder(node.span, _TIME)
            case ast.Name(name="env") if not self._execution.has_variable(ENV):
                return ast.Placeholder(node.span, ENV)
            case ast.Call(name=name) if name in TEMPORAL_FUNCTIONS:
                return self._fold(node)
            case ast.TimeIndex(name=name) if self._is_world(name):
                raise UnsupportedError(
                    f"{name}{{…}} is the past of one world, and a batch keeps none: previous, "
                    "initially, heldFor and their like keep what they need",
                    span=node.span,
                )
            case ast.Name(name=name) if per_environment(self._execution, name, self._world.count):
                self._arrays.add(name)
                return ast.Placeholder(node.span, name)
        return None

    def _fold(self, call: ast.Call) -> ast.Node:
        """Returns the placeholder of a function of time."""
        if parts_of(call)[1] is not None:
            raise UnsupportedError(
                f"{call.name}(…) of another time needs a record, and a batch keeps none",
                span=call.span,
            )
        for part in (part for inner in expressions_of(call) for part in inner.walk()):
            form = operator_of(part)
            if form is not None and form.looks_ahead:
                raise UnsupportedError(
                    f"{form.name} inside {call.name} needs later ticks, and a batch keeps none of "
                    "them: ask it by itself, or write what looks back, such as once",
                    span=part.span,
                )
        fold, key = fold_of(call, Frame(self._execution)), node_key(call)
        key = VERDICT + key if operator_of(call) else key
        if key not in self._folds:
            inner = BatchExpressions(self._execution, self._engine, expressions_of(call))
            kept = self._folds[key] = _KeptFold(call.name, fold, inner, self._world)
            self._world.before_tick(kept.settle)
        return ast.Placeholder(call.span, key)

    def has_same_arrays(self) -> bool:
        """Checks whether the same variables have a value for each environment as at first."""
        count = self._world.count
        if ENV in self._read and self._execution.has_variable(ENV):
            return False
        return all(
            per_environment(self._execution, name, count) == (name in self._arrays)
            for name in self._names
        )

    # -- evaluation -------------------------------------------------------------------------

    def answers(self) -> list[Answers]:
        """Returns the values of the expressions."""
        execution = self._execution
        with execution.lock, self._world.lock:  # in this order, as other programs
            if not execution.is_running:
                execution.begin_meter()
            try:
                return self._answers()
            except SelectScriptError as error:
                about = self._about_arrays()
                error.message += "" if error.message.endswith(about) else about
                raise

    def _about_arrays(self) -> str:
        """Returns what arrays of users may have to do with an error."""
        count, parts = self._world.count, []
        for name in sorted(self._names):
            value = self._execution.variable_or_none(name)
            shape = getattr(value, "shape", ())
            if name in self._arrays:
                parts.append(f"{name} has a value for each of {count} environments")
                if len(shape) == 1:
                    parts[-1] += f" (for one list of all, give {name}.tolist())"
            elif len(shape) > 1:
                parts.append(
                    f"{name} is of shape {tuple(shape)}, and there are {count} environments"
                )
        return "".join(f"; {part}" for part in parts)

    def _answers(self) -> list[Answers]:
        self._check_contacts()
        given, unknown = self.given()
        compiled = self._current(given)
        count = self._world.count
        found, lefts = compiled.values(given, unknown, count)
        self._engine.warn_of(n for n, v in zip(self.substituted, found, strict=True) if v is None)
        nowhere = np.zeros(0, np.intp)
        rows = [
            np.arange(count) if values is None else np.flatnonzero(left) if left.any() else nowhere
            for values, left in zip(found, lefts, strict=True)
        ]
        single = self._one_by_one(rows, given, unknown)
        return [_assembled(*parts, count) for parts in zip(found, rows, single, strict=True)]

    def _check_contacts(self) -> None:
        """Checks that contacts have what sums of whole forces need."""
        contacts = self._world.environments.contacts if self._sums else None
        if contacts is not None and not contacts.is_whole:
            raise ArgumentError(
                f"{self._sums[0]} needs the places and the frictions of contacts, which arrays do "
                "not have: contactForce has the normal force; tick takes a list of MjData, too, "
                "which has all"
            )

    def given(self) -> tuple[dict[str, Array], dict[str, Flags]]:
        """Returns the values of placeholders, and where they are unknown."""
        given: dict[str, Array] = {}
        unknown: dict[str, Flags] = {}
        if _TIME in self._read:
            given[_TIME] = self._world.times
        if ENV in self._read:
            given[ENV] = np.arange(self._world.count)
        for name in self._arrays:
            given[name] = per_environment_values(self._execution, name, self._world.count)
        for key, kept in self._folds.items():
            kept.update()
            answers = kept.fold.answers()
            given[key] = answers.values
            if answers.unknown.any():
                unknown[key] = answers.unknown
        return given, unknown

    def _current(self, given: Mapping[str, Array]) -> CompiledExpressions:
        """Returns the compiled expressions for the present types of variables."""
        compiled, execution = self._compiled, self._execution
        if (
            compiled is not None
            and self._meaning is meaning_of(execution, is_complete=compiled.is_complete)
            and compiled.is_current(Frame(execution))
        ):
            return compiled
        # Of an expression that fails everywhere, one environment tells.
        samples = at_environment(given, {}, 0)
        with self._world.at(0), execution.worlds_pinned(*self.substituted):
            compiled = CompiledExpressions(self._engine, execution, self.substituted, samples)
        self._compiled = compiled
        self._meaning = meaning_of(execution, is_complete=compiled.is_complete)
        return compiled

    def _one_by_one(
        self,
        rows: Sequence[Indices],
        given: Mapping[str, Array],
        unknown: Mapping[str, Flags],
    ) -> list[list[Any]]:
        """Returns the values of expressions in some environments, each computed by itself."""
        values: list[list[Any]] = [[] for _ in rows]
        chosen = [set(numbers.tolist()) for numbers in rows]
        for number in sorted(set().union(*chosen)):
            places = [place for place, numbers in enumerate(chosen) if number in numbers]
            nodes = [self.substituted[place] for place in places]
            samples = at_environment(given, unknown, number)
            frame = Frame(self._execution, placeholders=samples)
            with self._world.at(number), self._execution.worlds_pinned(*nodes):
                for place, node in zip(places, nodes, strict=True):
                    try:
                        value = plain(frame.value(node), node)
                    except SelectScriptError as error:
                        nan = self._world.snapshot.entities_with_nan(may_lack_velocities=True)
                        if not (isinstance(error, ArgumentError) and nan):
                            error.message = f"environment {number}: {error.message}"
                            raise
                        value = None
                    values[place].append(value)
        return values

    def check(self) -> None:
        """Evaluates the expressions in the first environment, for their errors and warnings."""
        given, unknown = self.given()
        frame = Frame(self._execution, placeholders=at_environment(given, unknown, 0))
        try:
            with self._world.at(0), self._execution.worlds_pinned(*self.substituted):
                for node in self.substituted:
                    frame.value(node)
        except ArgumentError:
            self.answers()  # it may tell of an array that the states lack
            raise


def plain(value: Any, node: ast.Node) -> Any:
    """Returns a value that is no entity: a handle has one world, and no environment."""
    for part in value if isinstance(value, list) else ():
        plain(part, node)
    if isinstance(value, Handle | World):
        raise UnsupportedError(
            "an entity of a batch is in every environment: ask for its name or its numbers, such "
            "as id(this), and for env",
            span=node.span,
        )
    return value


class _KeptFold:
    """A function of time with the last version of the batch that is in its state."""

    def __init__(
        self, name: str, fold: ArrayFold, expression: BatchExpressions, world: BatchWorld
    ) -> None:
        self.fold, self._expression, self._world = fold, expression, world
        self._name = name
        self._version: int | None = None
        # The time at which the episode of each environment began, s.
        self._starts: Array = np.full(world.count, np.nan)
        # The error of the expression at an earlier tick, and the version of that.
        self._failure: tuple[SelectScriptError, int] | None = None
        if world.version > 1:
            warn(
                f"{name}: a batch keeps no record: its past begins now; ask first before the "
                "first step",
                ProgramWarning,
            )

    def settle(self) -> None:
        """Adds the present tick before the next one; an error waits until somebody asks."""
        try:
            self.update()
        except SelectScriptError as error:
            self._failure = error, self._world.version

    def update(self) -> None:
        """Adds the present tick, unless the state has it."""
        world = self._world
        if self._version == world.version:
            return
        if self._failure is not None:
            error, version = self._failure
            if not (world.began > version).all():
                raise error
            self._failure = self._version = None
        if world.version and not world.environments.has_times:
            raise ArgumentError(
                f"{self._name} needs the simulated time: give tick time=…, one number or one for "
                "each environment, s"
            )
        answers = self._expression.answers()
        is_new = self._version is None
        are_first = np.full(world.count, is_new) | (world.began > (self._version or 0))
        times = world.times
        self._starts = np.where(are_first, times, self._starts)
        # Of several ticks of one time, the last one counts.
        self.fold.step(times, answers, times == self._starts)
        if world.version:  # before that, the state is that of the model
            self._version = world.version


def at_environment(
    given: Mapping[str, Array], unknown: Mapping[str, Flags], environment: int
) -> dict[str, Any]:
    """Returns the values of placeholders in an environment as Python's; None for unknown ones."""
    return {
        name: None
        if name in unknown and unknown[name][environment]
        else array[environment].tolist()
        if isinstance(array[environment], np.ndarray | np.generic)
        else array[environment]
        for name, array in given.items()
    }


def _assembled(values: Array | None, rows: Indices, single: Sequence[Any], count: int) -> Answers:
    """Returns values of arrays, with those of some environments from elsewhere."""
    unknown = np.zeros(count, np.bool_)
    if values is not None and values.dtype.kind == "f" and values.ndim == 1:
        unknown = np.isnan(values)
    if not len(rows):
        assert values is not None
        return Answers(values, unknown)
    if values is None:
        return answers_of(single)
    unknown[rows] = [value is None for value in single]
    result = np.array(values)
    for row, value in zip(rows.tolist(), single, strict=True):
        if value is not None:
            result[row] = value
    return Answers(result, unknown)


def answers_of(values: Sequence[Any]) -> Answers:
    """Returns the values of all environments, None for unknown ones, as arrays."""
    unknown = np.array([value is None for value in values], np.bool_)
    known = next((value for value in values if value is not None), float("nan"))
    return Answers(_array([known if value is None else value for value in values]), unknown)


def _array(values: list[Any]) -> Array:
    """Returns values as an array: of numbers, truths or lists of these, or else of objects."""
    types = set(map(type, values))
    if types <= {bool} or types <= {int, float}:
        return np.array(values)
    if types == {list} and len(set(map(len, values))) == 1:
        elements = {type(element) for value in values for element in value}
        if elements <= {int, float} or elements <= {bool}:
            return np.array(values)
    result = np.zeros(len(values), object)
    result[:] = values
    return result


def per_environment(execution: Execution, name: str, count: int) -> bool:
    """Checks whether a variable is an array with a value for each environment."""
    value = execution.variable(name) if execution.has_variable(name) else None
    shape: Any = getattr(value, "shape", None)
    if shape is None or isinstance(value, np.generic):
        return False
    return len(shape) in (1, 2) and int(shape[0]) == count


def per_environment_values(execution: Execution, name: str, count: int) -> Array:
    """Returns the values of such a variable, (n,) or (n, length)."""
    if not per_environment(execution, name, count):
        raise ArgumentError(
            f"{name} had a value for each of {count} environments, and is now "
            f"{short_repr(execution.variable_or_none(name))}"
        )
    array = to_numpy(execution.variable(name), name)
    return array.astype(np.float64) if array.dtype.kind == "f" else array


def without_unknown(answers: Answers, what: str) -> Array:
    """Returns values; unknown numbers are NaN."""
    values, unknown = answers.values, answers.unknown
    if not unknown.any():
        return values
    if values.dtype.kind == "b":
        numbers = joined_names([str(number) for number in np.flatnonzero(unknown)], 5)
        raise ArgumentError(
            f"{what} is unknown in {int(unknown.sum())} environments ({numbers}): a "
            "number that it reads is NaN there, and ss.terms(…, nan=…) says what it is then; or it "
            "is not decided yet, and does not hold so far in IF(…; TRUE; FALSE)"
        )
    if values.dtype.kind in "fiu":
        condition = unknown if values.ndim == 1 else unknown[:, None]
        return np.where(condition, np.nan, values)
    result = values.astype(object)
    result[unknown] = None
    return result
