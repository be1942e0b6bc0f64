"""Functions of time of functions of time: an expression at each recorded tick of a world.

`always(z(cup) > 0.9 IMPLIES eventually(touching(cup, tray), 0, 5))` asks each tick for what holds
after it. The parts without functions of time are *series*: one query has the values of each at all
ticks. What functions of time and operators make of these are arrays, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass
from functools import reduce
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from ssduck import validation
from ssduck.columns.arrays import ArrayOperations, ArrayValues
from ssduck.columns.compiler import Expression, LeftToDuckDBError
from ssduck.columns.trees import TreeCompiler, kind_of
from ssduck.errors import ArgumentError, UnsupportedError
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Array, Flags
from ssduck.interpreter.over_time.functions import (
    OF_VALUES,
    TEMPORAL_FUNCTIONS,
    Fold,
    expressions_of,
    fold_of_operator,
    is_fold,
    operator_of,
)
from ssduck.interpreter.over_time.series import (
    TickColumns,
    TickSeries,
    are_last_of_their_times,
    is_true,
)
from ssduck.language import ast
from ssduck.language.analysis import IMPURE, OF_MARGINS, OVER_TIME, calls_of, free_aliases, mentions
from ssduck.language.builtins import BUILTINS
from ssduck.language.evaluator import Frame
from ssduck.language.value_keys import node_key
from ssduck.logic.traces import Trace, Window
from ssduck.recording.replay.past import common_moment, past_of
from ssduck.recording.replay.record import Record
from ssduck.sql.relations.registry import RELATIONS
from ssduck.world.handles import Handle

# Of more leaves, the oldest ones are dropped.
_MANY = 256


def is_nested(node: ast.Node) -> bool:
    """Checks whether a part has a function of time in it."""
    return not calls_of(node).isdisjoint(OVER_TIME)


@dataclass(frozen=True, eq=False)
class Column:
    """The values of an expression at n ticks."""

    values: npt.NDArray[Any]  # truth values, numbers or objects, (n,); any where unknown
    unknown: Flags  # (n,)

    @classmethod
    def of_objects(cls, values: list[Any]) -> Column:
        """Returns Python's values as a column; None is unknown."""
        unknown = np.array([value is None for value in values], np.bool_)
        types = {type(value) for value in values if value is not None}
        if types in ({bool}, {int}, {float}):
            (kind,) = types
            return cls(np.array([kind() if value is None else value for value in values]), unknown)
        return cls(np.fromiter(values, np.object_, len(values)), unknown)

    @property
    def objects(self) -> npt.NDArray[Any]:
        """Python's values, None where unknown, (n,)."""
        result = self.values.astype(np.object_)
        result[self.unknown] = None
        return result

    def tolist(self) -> list[Any]:
        """Returns Python's values; None where unknown."""
        values = self.objects if self.unknown.any() else self.values
        return list(values.tolist())


class NestedExpressions:
    """Evaluates expressions at all recorded ticks, and caches what depends on their texts only."""

    def __init__(
        self,
        series_of: Callable[[ast.Call, Frame], TickSeries],
        names_entities: Callable[[ast.Node, Frame], bool],
    ) -> None:
        self.series_of, self.names_entities = series_of, names_entities
        self._leaves: dict[str, ast.Call] = {}

    def leaf(self, node: ast.Node) -> ast.Call:
        """Returns the call whose series is that of a part; the same one for equal parts."""
        key = node_key(node)
        if key not in self._leaves:
            while len(self._leaves) >= _MANY:
                del self._leaves[next(iter(self._leaves))]
            self._leaves[key] = ast.Call(node.span, "changes", (node,), node.span)
        return self._leaves[key]

    def verdict(self, call: ast.Call, record: Record, frame: Frame) -> bool | float | None:
        """Returns the value of an operator: at the tick of the row, or else at its own tick.

        That is the last tick, or the first one of an operator that looks ahead. None while it is
        not decided, and where it is unknown.
        """
        ticks = self.ticks(call, record, frame)
        trace, place = ticks.trace(call), ticks.place_of(call, frame)
        low, high = trace.low[place].item(), trace.high[place].item()
        return low if low == high else None

    def at_row(
        self, call: ast.Call, frame: Frame, record_of: Callable[[], Record]
    ) -> tuple[Any] | None:
        """Returns the value of a call at the tick of a row of the past, alone in a tuple.

        None of the first row of some entities, and of other calls: each is read by itself. At the
        second row, all ticks are read.
        """
        own = [element for element in frame.own_elements() if isinstance(element, Handle)]
        rows = {element.world: element.moment for element in own if element.moment is not None}
        is_of_all = operator_of(call) is not None or is_fold(call)
        if not (rows and is_of_all) or frame.local or frame.placeholders:
            return None
        entities, cache = _entities_of_row(call, frame), cast("dict[Any, Any]", frame.cached)
        if entities is None:
            return None
        key = call, *entities
        if key not in cache:
            cache[key] = None
            return None
        if cache[key] is None:
            record = record_of()
            found = self.columns(call, record, frame)
            values = dict(zip(found.ticks.tolist(), found.values.tolist(), strict=True))
            cache[key] = record.world, values
        world, values = cache[key]
        row = rows.get(world)
        return (values[row.tick],) if row is not None and row.tick in values else None

    def fold(self, call: ast.Call, frame: Frame, record_of: Callable[[], Record]) -> Fold:
        """Returns the fold that an operator is; see `fold_of_operator`."""
        window = window_of(call, frame)
        return fold_of_operator(
            call.name, window, lambda: Ticks(self, record_of(), frame).conditions(call)
        )

    def columns(self, node: ast.Node, record: Record, frame: Frame) -> TickColumns:
        """Returns the values of an expression at all ticks until now."""
        ticks = self.ticks(node, record, frame)
        column = ticks.column(node)
        is_any = column.values.dtype == np.object_
        values = column.objects if is_any else np.ma.array(column.values, mask=column.unknown)
        numbers, _ = record.ticks_until_now()  # of those of one time, the last one counts for all
        return TickColumns(numbers, values[np.searchsorted(ticks.numbers, numbers)])

    def ticks(self, node: ast.Node, record: Record, frame: Frame) -> Ticks:
        """Returns the ticks until now; rows of the same entities share them."""
        entities, cache = _entities_of_row(node, frame), cast("dict[Any, Any]", frame.cached)
        if entities is None:
            return Ticks(self, record, frame)
        key = Ticks, record, *entities
        if key not in cache:
            cache[key] = Ticks(self, record, frame)
        ticks: Ticks = cache[key]
        return ticks


def _entities_of_row(node: ast.Node, frame: Frame) -> list[tuple[str, int]] | None:
    """Returns which entities of the rows around it a part reads; None if it reads other values."""
    elements = [frame.elements.get(alias) for alias in sorted(free_aliases(node), key=str)]
    handles = [element for element in elements if isinstance(element, Handle)]
    if len(handles) < len(elements):
        return None
    return [(handle.TABLE, handle.id) for handle in handles]


class Ticks:
    """The recorded ticks of a world until now, and expressions at each of them.

    Args:
        given: the values of variables at each tick, by name.
    """

    def __init__(
        self,
        expressions: NestedExpressions,
        record: Record,
        frame: Frame,
        given: Mapping[str, Column] | None = None,
    ) -> None:
        self._expressions, self.record, self._frame = expressions, record, frame
        self._given = given or {}
        numbers, times = record.ticks_until_now()
        are_last = are_last_of_their_times(times)
        self.numbers, self.times = numbers[are_last], times[are_last]
        is_behind = len(numbers) < len(record.ticks.numbers)  # of a replay
        # Whether more ticks may come: not where a finished record ends.
        self.is_open = record.goes_on or is_behind
        self.has_unknown = False  # whether a part that was read is unknown at a tick
        # The columns of expressions, by their keys, and those of them that queries have.
        self._columns: dict[str, Column] = {}
        self._read: dict[str, Column] = {}
        self._traces: dict[str, Trace] = {}  # those of conditions, by their keys

    def place_of(self, call: ast.Call, frame: Frame) -> int:
        """Returns the place of the tick of an operator that is in no other one."""
        moment = common_moment(self.record.world, (), frame.own_elements())
        if moment is not None:
            return int(np.searchsorted(self.numbers, moment.tick))
        return 0 if TEMPORAL_FUNCTIONS[call.name].looks_ahead else len(self.times) - 1

    def is_decided(self, operator: ast.Node, place: int) -> bool:
        """Checks whether ticks after the last one could not change an operator at a tick."""
        going_on = copy(self)
        going_on.is_open, going_on._traces = True, {}  # noqa: SLF001  # a copy of its own
        going_on._columns = dict(self._read)  # noqa: SLF001
        return bool(going_on.trace(operator).is_known[place])

    def conditions(self, call: ast.Call) -> list[Trace]:
        """Returns the conditions of an operator, or their margins, at each tick."""
        if not TEMPORAL_FUNCTIONS[call.name].of_margins:
            return [self.trace(part) for part in expressions_of(call)]
        return [self._margins(part) for part in expressions_of(call)]

    def _margins(self, node: ast.Node) -> Trace:
        """Returns margins; those of what looks ahead have the bounds of what is to come."""
        if any((form := operator_of(part)) and form.looks_ahead for part in node.walk()):
            match node:
                case ast.Call(name=name) if name.startswith(OF_MARGINS):
                    return self.trace(node)
                case ast.Unary(operator="-", operand=operand):
                    return ~self._margins(operand)
                case ast.Call(name="margin of AND", arguments=(ast.ListLiteral(items=items),)):
                    return reduce(Trace.__and__, map(self._margins, items))
                case ast.Call(name="margin of OR", arguments=(ast.ListLiteral(items=items),)):
                    return reduce(Trace.__or__, map(self._margins, items))
        column = self.column(node)
        margins = np.where(column.unknown, 0.0, column.values).astype(np.float64)
        return Trace.of(self.times, margins, column.unknown, is_open=self.is_open)

    # -- truth ------------------------------------------------------------------------------

    def trace(self, node: ast.Node) -> Trace:
        """Returns whether a condition holds at each tick."""
        key = node_key(node)
        if key not in self._traces:
            self._traces[key] = self._trace(node)
        return self._traces[key]

    def _trace(self, node: ast.Node) -> Trace:
        match node:
            case ast.Call() if (form := operator_of(node)) is not None:
                assert form.operator is not None
                return form.operator(*self.conditions(node), window_of(node, self._frame))
            case ast.Unary(operator="NOT", operand=operand) if self._is_made(node):
                return ~self.trace(operand)
            case ast.Binary(operator="AND" | "OR" as sign, left=left, right=right) if self._is_made(
                node
            ):
                return self._joined(sign, self.trace(left), right)
            case ast.OperatorChain(operators=("AND" | "OR" as sign, *_)) if self._is_made(node):
                result = self.trace(node.operands[0])
                for operand in node.operands[1:]:
                    result = self._joined(sign, result, operand)
                return result
        column = self.column(node)
        truth = column.values
        if truth.dtype != np.bool_:
            truth = np.array([is_true(value, node) for value in column.tolist()], np.bool_)
        return Trace.of(self.times, truth, column.unknown, is_open=self.is_open)

    def _is_made(self, node: ast.Node) -> bool:
        """Checks whether a part is made of others, and no query has its values."""
        return is_nested(node) or mentions(node, self._given) or len(_compared_numbers(node)) == 1

    def _joined(self, sign: str, trace: Trace, other: ast.Node) -> Trace:
        # What decides at no tick is not evaluated: it may be an error, as at a single tick.
        if sign == "AND":
            return trace & self.trace(other) if trace.high.any() else trace
        return trace if trace.low.all() else trace | self.trace(other)

    # -- values -----------------------------------------------------------------------------

    def column(self, node: ast.Node) -> Column:
        """Returns the values of an expression at each tick."""
        key = node_key(node)
        if key not in self._columns:
            self._columns[key] = self._column(node)
        return self._columns[key]

    def _column(self, node: ast.Node) -> Column:
        is_logic = (
            isinstance(node, ast.Unary | ast.Binary | ast.OperatorChain)
            and _sign_of(node) in _LOGIC
        )
        if self._is_made(node) and (is_logic or operator_of(node) is not None):
            trace = self.trace(node)
            return Column(trace.low, ~trace.is_known)
        match node:
            case ast.Call(name=name) if name in OVER_TIME:
                return self._of_function(node)
            case ast.Name(name=name) if name in self._given:
                return self._given[name]
            case ast.Call(name="getTime", arguments=()):
                return Column(self.times, np.zeros(len(self.times), np.bool_))
        if _is_of_values(node) and self._is_made(node):
            return self._computed(node)
        if mentions(node, self._given):
            raise UnsupportedError("it is computed at each tick by itself", span=node.span)
        if self._expressions.names_entities(node, self._frame):
            return self._series(node)
        return Column.of_objects([self._frame.value(node)] * len(self.times))

    def _series(self, node: ast.Node) -> Column:
        """Returns the values of a part that one query has at all ticks."""
        series = self._expressions.series_of(self._expressions.leaf(node), self._frame)
        _, values = series.at(past_of(self.record, None))
        if values.dtype == np.object_:
            column = Column.of_objects(values.tolist())
        else:
            column = Column(np.ma.getdata(values), np.ma.getmaskarray(values))
        self._read[node_key(node)] = column
        self.has_unknown = self.has_unknown or bool(column.unknown.any())
        return column

    def _of_function(self, call: ast.Call) -> Column:
        """Returns the values of a function of time, each from the ticks until its own."""
        fold = TEMPORAL_FUNCTIONS[call.name].fold
        if fold is None or len(call.arguments) > 1:
            return self._series(call)
        (expression,) = expressions_of(call)
        column = self.column(expression)
        values = column.tolist()
        if fold.is_of_condition:
            values = [is_true(value, expression) for value in values]
        return Column.of_objects(list(_folded(fold, self.times.tolist(), values)))

    def _computed(self, node: ast.Node) -> Column:
        """Returns what operators and functions of values make of parts."""
        parts: dict[str, Column] = {}

        def part_of(part: ast.Node) -> ast.Node | None:
            if part is node:
                return None
            is_made = self._is_made(part)
            is_part = not (_is_of_values(part) and is_made) and (
                is_made or self._expressions.names_entities(part, self._frame)
            )
            if is_part:
                name = f"part {len(parts)}"
                parts[name] = self.column(part)
                return ast.Placeholder(part.span, name)
            return None

        tree = node.replaced(part_of)
        unknown = np.zeros(len(self.times), np.bool_)
        for column in parts.values():
            unknown |= column.unknown
        values, left = self._by_arrays(tree, parts)
        rows = np.flatnonzero(left & ~unknown)
        if not len(rows):
            return Column(values, unknown)
        result = Column(values, unknown).tolist()
        lists = {name: column.tolist() for name, column in parts.items()}
        for row in rows.tolist():
            at_tick = {name: of_all[row] for name, of_all in lists.items()}
            result[row] = Frame(self._frame.scope, placeholders=at_tick).value(tree)
        return Column.of_objects(result)

    def _by_arrays(
        self, tree: ast.Node, parts: dict[str, Column]
    ) -> tuple[npt.NDArray[Any], Flags]:
        """Returns the values of a tree, and where each has to be computed by itself."""
        count = len(self.times)
        try:
            compute = self._compiled(tree, parts).compute
        except LeftToDuckDBError:
            return np.zeros(count, np.bool_), np.ones(count, np.bool_)
        left = np.zeros(count, np.bool_)

        def read(name: str) -> Array:
            values = parts[name].values
            if values.dtype.kind == "f":
                np.logical_or(left, np.isnan(values), out=left)
            return values[None]

        with np.errstate(all="ignore"):
            result = compute(ArrayValues(read, count, _NO_CALLS, left))
        return np.broadcast_to(np.atleast_2d(result)[0], (count,)), left

    def _compiled(self, tree: ast.Node, parts: dict[str, Column]) -> Expression:
        """Returns a tree as a function of arrays."""

        def given(node: ast.Placeholder) -> Expression:
            values = parts[node.name].values
            if values.dtype == np.object_:
                raise LeftToDuckDBError
            return Expression(kind_of(values[0]), lambda arrays: arrays[node.name])

        def variable(node: ast.Name) -> Expression:
            value = self._frame.value(node)
            return Expression(kind_of(value), _OPERATIONS.constant(value))

        return TreeCompiler(_OPERATIONS, None, {}, given, variable).of(tree)


def window_of(call: ast.Call, frame: Frame) -> Window:
    """Returns the window of an operator."""
    places = call.arguments[len(expressions_of(call)) :]
    bounds = [_bound(call, *named, frame) for named in zip(("from", "to"), places, strict=False)]
    window = Window(*bounds)
    if window.start > window.end:
        raise ArgumentError(
            f"{call.name}: from is {window.start:g} s and to is {window.end:g} s, and to is not to "
            "be less",
            span=call.span,
        )
    return window


def _bound(call: ast.Call, name: str, node: ast.Node, frame: Frame) -> float:
    calls = [part for part in node.walk() if isinstance(part, ast.Call | ast.Query)]
    if free_aliases(node) or not all(map(_is_of_values, calls)):
        raise ArgumentError(
            f"{call.name}: {name} is to be the same at all ticks and for all rows: a number or a "
            "variable",
            span=node.span,
        )
    value = frame.value(node)
    if not validation.is_number(value) or not value >= 0.0:
        way = "after" if TEMPORAL_FUNCTIONS[call.name].looks_ahead else "before"
        raise ArgumentError(
            f"{call.name}: {name} is a time {way} the tick, 0 s or more, not {short_repr(value)}",
            span=node.span,
        )
    return float(value)


_OPERATIONS = ArrayOperations("", is_exact=True)
_NO_CALLS: Any = None  # such a tree has no relations
_LOGIC = ("NOT", "AND", "OR")


def _sign_of(node: ast.Unary | ast.Binary | ast.OperatorChain) -> str:
    return node.operators[0] if isinstance(node, ast.OperatorChain) else node.operator


def _is_of_values(node: ast.Node) -> bool:
    """Checks whether a part is computed from the values of its own parts."""
    is_builtin = isinstance(node, ast.Call) and node.name in BUILTINS and node.name not in IMPURE
    return is_builtin or isinstance(node, OF_VALUES)


def _compared_numbers(node: ast.Node) -> set[str]:
    """Returns the keys of the numbers that a part compares with constants; "" for others.

    Conditions and margins of one number need one query for it, however many they are.
    """
    match node:
        case ast.Unary(operator="NOT" | "-", operand=operand):
            return _compared_numbers(operand)
        case ast.Binary(operator="AND" | "OR", left=left, right=right):
            return _compared_numbers(left) | _compared_numbers(right)
        case ast.Binary(operator=sign, left=ast.Call() as call, right=ast.Literal()) if (
            sign in _OF_NUMBERS
        ):
            return _key_of_number(call)
        case ast.Binary(operator=sign, left=ast.Literal(), right=ast.Call() as call) if (
            sign in _OF_NUMBERS
        ):
            return _key_of_number(call)
    return {"", node_key(node)}


_OF_NUMBERS = ("<", "<=", ">", ">=", "-")


def _key_of_number(call: ast.Call) -> set[str]:
    relation = RELATIONS.get(call.name)
    is_number = relation is not None and relation.result == "double"
    return {node_key(call)} if is_number else {"", node_key(call)}


def _folded(fold: Fold, times: list[float], values: list[Any]) -> Iterator[Any]:
    state = fold.first(times[0], values[0])
    yield fold.value(state, times[0])
    for time, value in zip(times[1:], values[1:], strict=True):
        state = fold.step(state, time, value)
        yield fold.value(state, time)
