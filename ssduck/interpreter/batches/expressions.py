"""Compiles expressions to functions of arrays over the environments of a batch.

The translator makes SQL of an expression, or of parts of it, as for a single world. `columns` makes
functions of arrays of the SQL, over the columns that it reads. What the translator leaves to
Python, operators and functions of numbers, follows the tree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeVar
from typing import Literal as OneOf

import numpy as np
from sqlglot import exp

from ssduck.columns.arrays import Array, ArrayOperations, ArrayValues
from ssduck.columns.compiler import Compiler, Compute, Expression, Kind, LeftToDuckDBError
from ssduck.columns.selects import PLAIN
from ssduck.columns.trees import TreeCompiler, kind_of
from ssduck.database.values import to_sql
from ssduck.errors import ProgramWarning, warn
from ssduck.formatting import joined_names
from ssduck.geometry.arrays import Flags
from ssduck.interpreter.batches.columns import CHANGING, EnvironmentColumns
from ssduck.interpreter.batches.kernels import EnvironmentShapes, kernels_of
from ssduck.interpreter.execution import Execution
from ssduck.interpreter.over_time.live import select_of
from ssduck.interpreter.query_runner import PlannedQuery
from ssduck.language import ast
from ssduck.language.analysis import calls_of
from ssduck.language.evaluator import Frame
from ssduck.language.value_keys import ATOMS
from ssduck.sql.plan import ParameterBinding
from ssduck.sql.relation_calls import PAIR_CALL, PairCall
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.handles import Handle

T = TypeVar("T")
# So many environments are asked one by one with a warning.
MANY = 256


@dataclass(frozen=True, eq=False)
class Answers:
    """The values of an expression in n environments."""

    values: Array  # (n,), or (n, length) of lists; anything where it is unknown
    unknown: Flags  # (n,), where they are unknown


@dataclass(eq=False)
class Engine:
    """What reads a batch: the columns of its entities, shapes, and functions by name."""

    world: BatchWorld  # the batch
    schema: str  # the schema of its tables
    columns: EnvironmentColumns = field(init=False)
    shapes: EnvironmentShapes = field(init=False)
    operations: ArrayOperations = field(init=False)

    def __post_init__(self) -> None:
        self.columns = EnvironmentColumns(self.world)
        self.shapes = EnvironmentShapes(self.world, self.columns)
        kernels = kernels_of(self.world, self.columns)
        self.operations = ArrayOperations(self.schema, kernels, is_exact=False)
        self._slow: set[ast.Node] = set()

    def warn_of(self, nodes: Iterable[ast.Node]) -> None:
        """Warns, once of each, of parts for which many environments are asked one by one."""
        for node in set(nodes).difference(self._slow):
            self._slow.add(node)
            if self.world.count >= MANY:
                calls = joined_names(sorted(calls_of(node))) or "nothing"
                warn(
                    f"each of {self.world.count} environments is asked by itself, which is slow: "
                    f"arrays cannot have the value of what calls {calls}",
                    ProgramWarning,
                )


class Leaves:
    """The values that expressions read: columns, placeholders and variables."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self._kinds: dict[str, Kind] = {}
        self._readers: dict[str, Callable[[Mapping[str, Array]], Array]] = {}
        # Whether the numbers that were read may be NaN; where nothing tells, each is checked.
        self._may_be_nan: dict[str, Callable[[], bool]] = {}
        # Parts without columns, which the SQL takes as parameters.
        self._parts: dict[str, Expression] = {}
        # Variables, whose values may be others at the next evaluation, by the keys of leaves; and
        # those that are entities.
        self._variables: dict[str, tuple[ast.Node, Any]] = {}
        self._entities: list[tuple[ast.Node, Handle]] = []

    # -- compilation ------------------------------------------------------------------------

    def renamed(
        self, sql: exp.Expr, bindings: Sequence[ParameterBinding], frame: Frame
    ) -> exp.Expr:
        """Returns SQL in which parameters are the keys of leaves."""
        return _renamed(sql, {b.name: self._bound(b, frame) for b in bindings if b.node})

    def _bound(self, binding: ParameterBinding, frame: Frame) -> str:
        """Returns the key of a parameter of SQL, and notes how it is read."""
        node, name = binding.node, binding.column
        assert node is not None
        if self.note_given(node, frame):
            key = f"{id(node)} given"
            self._parts[key] = self.tree(frame).of(node)
            return key
        value = frame.value(node)
        if isinstance(value, Handle):
            if isinstance(node, ast.Name):
                self._entities.append((node, value))
            if value.world is not self.engine.world or value.moment is not None:
                raise LeftToDuckDBError
            name = name or "id"
            key = f"{value.id} {name}"
            if name in CHANGING:
                self.note(key, "double", self._column(value.id, name))
                may_be_nan = self.engine.columns.may_be_nan
                self._may_be_nan[key] = partial(may_be_nan, value.id, name)
            elif name == "tick":
                world = self.engine.world
                self.note(key, "integer", lambda _: np.array([[world.version]]))
            else:
                self._constant(key, value.id if name == "id" else value.column(name))
            return key
        if name is not None:
            raise LeftToDuckDBError
        return self._variable(node, value)

    def _variable(self, node: ast.Node, value: Any) -> str:
        """Notes an expression without columns, whose value may be another one later."""
        key = f"{id(node)} value"
        self._constant(key, value)
        self._variables[key] = node, value
        return key

    def tree(
        self,
        frame: Frame,
        sql: Mapping[ast.Node, exp.Expr] | None = None,
        compiler: Compiler | None = None,
    ) -> TreeCompiler:
        """Returns what makes functions of a tree."""

        def variable(node: ast.Name) -> Expression:
            key = self._variable(node, frame.value(node))
            return Expression(self._kinds[key], lambda values: values[key])

        return TreeCompiler(self.engine.operations, compiler, sql or {}, self.given, variable)

    def note_given(self, node: ast.Node, frame: Frame) -> bool:
        """Notes the placeholders in an expression; returns whether there are any."""
        found = [part for part in node.walk() if isinstance(part, ast.Placeholder)]
        for part in found:
            sample, name = frame.placeholders[part.name], part.name
            kind: Kind = "list" if isinstance(sample, list) else kind_of(sample)
            self.note(f"{name} given", kind, lambda given, name=name: given[name])  # type: ignore[misc]
        return bool(found)

    def _column(self, id: int, name: str) -> Callable[[Mapping[str, Array]], Array]:
        columns, shapes = self.engine.columns, self.engine.shapes
        return lambda _: shapes.of_rows(columns.column(id, name))

    def _constant(self, key: str, value: Any) -> None:
        """Notes a value that is the same in all environments."""
        value = to_sql(value)
        is_list = isinstance(value, list)
        if is_list and not (value and set(map(type, value)) <= {float, int}):
            raise LeftToDuckDBError
        array = np.array([[value]], dtype=np.float64 if is_list else None)
        self.note(key, "list" if is_list else kind_of(value), lambda _: array)
        is_nan = array.dtype.kind == "f" and bool(np.isnan(array).any())
        self._may_be_nan[key] = lambda: is_nan

    def note(self, key: str, kind: Kind, read: Callable[[Mapping[str, Array]], Array]) -> None:
        """Notes a leaf: its type, and a function that returns its values, (rows,) or (1, 1)."""
        self._kinds[key], self._readers[key] = kind, read

    def expression(self, sql: exp.Expr) -> Expression | None:
        """Returns a parameter, or a column of a row, as an expression."""
        if isinstance(sql, exp.Parameter) and sql.name in self._parts:
            return self._parts[sql.name]
        key = f"column {sql.table}.{sql.name}" if isinstance(sql, exp.Column) else sql.name
        if key not in self._kinds:
            return None
        return Expression(self._kinds[key], lambda values: values[key])

    def given(self, node: ast.Placeholder) -> Expression:
        """Returns a placeholder as an expression."""
        key = f"{node.name} given"
        if key not in self._kinds:
            raise LeftToDuckDBError
        return Expression(self._kinds[key], lambda values: values[key])

    # -- evaluation -------------------------------------------------------------------------

    def is_current(self, frame: Frame) -> bool:
        """Takes the present values of variables; returns whether they have the same types."""
        for key, (node, before) in self._variables.items():
            value = frame.value(node)
            if value is before and type(value) in ATOMS:
                continue
            if type(value) is not type(before):
                return False
            self._variables[key] = node, value
            try:
                self._constant(key, value)
            except LeftToDuckDBError:
                return False
        return all(frame.value(node) == entity for node, entity in self._entities)

    def evaluated(
        self,
        evaluate: Callable[[ArrayValues], T],
        given: Mapping[str, Array],
        unknown: Mapping[str, Flags],
        count: int,
    ) -> tuple[T, Flags]:
        """Returns what a function makes of the values of the leaves.

        Args:
            evaluate: the function.
            given: the values of placeholders, (count,) or (count, length).
            unknown: where they are unknown.
            count: the number of rows.

        Returns:
            Its result, and the rows that have to be evaluated by themselves, (count,).
        """
        for is_checked in (False, True):
            left = np.zeros(count, np.bool_)
            values = self._values(given, unknown, count, left, is_checked=is_checked)
            # Unless numbers are checked, numpy tells of a NaN that an operation makes.
            told: OneOf["ignore", "raise"] = "ignore" if is_checked else "raise"
            try:
                with np.errstate(invalid=told, divide=told, over="ignore"):
                    return evaluate(values), left
            except FloatingPointError:
                continue
        raise AssertionError("checked numbers raise no error")

    def _values(
        self,
        given: Mapping[str, Array],
        unknown: Mapping[str, Flags],
        count: int,
        left: Flags,
        *,
        is_checked: bool,
    ) -> ArrayValues:
        def read(key: str) -> Array:
            array = self._readers[key](given)
            may_be_nan = self._may_be_nan.get(key)
            if may_be_nan() if may_be_nan else array.dtype.kind == "f":
                _leave_unknown(array, left)
            if unknown and (name := key.removesuffix(" given")) in unknown:
                np.logical_or(left, unknown[name], out=left)
            return array if array.ndim > 1 and len(array) == 1 else array[None]

        return ArrayValues(read, count, self.engine.shapes, left, is_checked=is_checked)


def _renamed(sql: exp.Expr, names: Mapping[str, str]) -> exp.Expr:
    whole = exp.Paren(this=sql.copy())
    for part in list(whole.walk()):
        if isinstance(part, exp.Parameter) and part.name in names:
            part.replace(exp.Parameter(this=exp.var(names[part.name])))
        pair = part.meta.get(PAIR_CALL)
        if isinstance(pair, PairCall):
            part.meta[PAIR_CALL] = replace(pair, ids=tuple(_renamed(id, names) for id in pair.ids))
    result: exp.Expr = whole.this
    return result


def _leave_unknown(array: Array, left: Flags) -> None:
    """Leaves the rows in which a number is NaN, whether or not it matters there."""
    if array.shape[0] == 1 != left.shape[0]:
        return
    if np.isnan(np.add.reduce(array, axis=None)):
        is_nan = np.isnan(array)
        np.logical_or(left, is_nan.any(axis=-1) if array.ndim > 1 else is_nan, out=left)


def meaning_of(execution: Execution, *, is_complete: bool) -> object:
    """Returns what is replaced where expressions may have to be compiled anew.

    If arrays cannot have all of them, other values of variables may be such as these can have.
    """
    return execution.planner.generation if is_complete else execution.stamp


class CompiledExpressions:
    """Expressions that are evaluated together over all environments."""

    def __init__(
        self,
        engine: Engine,
        execution: Execution,
        nodes: Sequence[ast.Node],
        samples: Mapping[str, Any],
    ) -> None:
        self._execution, self._leaves = execution, Leaves(engine)
        frame = Frame(execution, placeholders=samples)
        plans = [self._plan(node, frame) for node in nodes]
        roots = [sql for plan in plans if plan is not None for sql in plan.values()]
        self._compiler = Compiler(engine.operations, self._leaves.expression, roots)
        self._computes = [
            None if plan is None else self._computed(node, plan, frame)
            for node, plan in zip(nodes, plans, strict=True)
        ]
        self.is_complete = None not in self._computes  # whether arrays can have all of them
        self.is_current = self._leaves.is_current

    def _plan(self, node: ast.Node, frame: Frame) -> dict[ast.Node, exp.Expr] | None:
        """Returns the SQL of the parts of an expression that have some; None if arrays lack any."""
        planned = self._execution.planner.planned(select_of(node), frame)
        self._leaves.note_given(node, frame)
        if planned is None:
            return {}
        try:
            return {
                part: self._leaves.renamed(sql, planned.plan.bindings, frame)
                for part, sql in _sql_parts(node, planned).items()
            }
        except LeftToDuckDBError:
            return None

    def _computed(
        self, node: ast.Node, sql: Mapping[ast.Node, exp.Expr], frame: Frame
    ) -> Compute | None:
        """Returns an expression as a function; None if arrays cannot have its value."""
        try:
            return self._leaves.tree(frame, sql, self._compiler).of(node).compute
        except LeftToDuckDBError:
            return None

    def values(
        self, given: Mapping[str, Array], unknown: Mapping[str, Flags], count: int
    ) -> tuple[list[Array | None], list[Flags]]:
        """Returns the values of the expressions.

        Returns:
            The values, (count,) or (count, length), None of those that arrays cannot have; and
            where each has to be evaluated by itself, (count,).
        """

        def evaluate(values: ArrayValues) -> tuple[list[Array | None], bool]:
            return [value_of(compute, values) for compute in self._computes], values.is_checked

        (found, is_checked), left = self._leaves.evaluated(evaluate, given, unknown, count)
        if is_checked or not left.any():
            return found, [left] * len(found)
        # Where no operation made a NaN, one in the result is that of an unknown number.
        return found, [_still_left(values, left) for values in found]


def _still_left(values: Array | None, left: Flags) -> Flags:
    """Returns the rows that are left whose values are not the number NaN."""
    if values is None or values.ndim > 1 or values.dtype.kind != "f":
        return left
    still: Flags = left & ~np.isnan(values)
    return still


def value_of(compute: Compute | None, values: ArrayValues) -> Array | None:
    """Returns the value of an expression in each row; None if arrays cannot have it."""
    if compute is None:
        return None
    try:
        return _broadcast(compute(values), values.count)
    except (LeftToDuckDBError, IndexError):
        return None


def _broadcast(result: Array, count: int) -> Array:
    """Returns values (1, count) or (1, count, length) without the first axis."""
    if result.shape[:2] == (1, count):
        row: Array = result[0]
        return row
    if result.ndim > 2:
        return np.broadcast_to(result[0], (count, result.shape[-1]))
    return np.broadcast_to(np.atleast_2d(result)[0], (count,))


def _sql_parts(node: ast.Node, planned: PlannedQuery) -> dict[ast.Node, exp.Expr]:
    plan = planned.plan
    columns = plan.select.expressions
    parts = plan.known if plan.outputs is None else {node: plan.outputs[0]}
    return {
        part: columns[output.index]
        for part, output in parts.items()
        if output.sql_type.type in PLAIN
    }
