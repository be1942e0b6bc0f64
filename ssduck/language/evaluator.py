"""Evaluates expressions in Python: those outside queries, and those that SQL cannot express.

A part of a tree is compiled once to a function of a `Frame`, which holds the values of the current
row. Variables, functions and nested queries are looked up through the frame's `EvaluationScope`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any, Protocol, TypeAlias

from ssduck.errors import (
    ArgumentError,
    SelectScriptError,
    UnknownNameError,
    UnsupportedError,
    nearest,
)
from ssduck.formatting import as_evaluation_error, first_line, short_repr
from ssduck.language import ast
from ssduck.language.analysis import OVER_TIME, aliases_of, free_aliases, is_impure
from ssduck.language.evaluation_errors import argument_check, missing_source_error
from ssduck.language.operators import (
    ELEMENT_BYTES,
    binary,
    chain,
    check_size,
    counted,
    indexed,
    truth,
    unary,
)
from ssduck.language.value_history import LazyList, horizon_of
from ssduck.language.value_keys import MEMOS, NUMPYS, Memo, node_key, python_value
from ssduck.limits import UsageMeter

# The types of elements that become Python's and the language's.
_CONVERTED = (*NUMPYS, tuple)
# The size of a longer list is checked when it is made.
SMALL_LIST = 4
# The largest number of compiled parts; when it is reached, all are dropped.
MAX_COMPILED = 5000


class EvaluationScope(Protocol):
    """The part of the interpreter that an evaluator needs."""

    def variable(self, name: str) -> Any:
        """Returns a variable's value, or an UnknownNameError."""

    def has_variable(self, name: str) -> bool:
        """Checks whether there is a variable of that name."""

    def assign(self, name: str, value: Any) -> None:
        """Sets a variable."""

    def keep(self, name: str, value: Any, horizon: float) -> None:
        """Sets a variable that keeps its values for that many seconds."""

    def past_value(self, name: str, *age: Any) -> Any:
        """Returns the past value of a variable; all kept values if no age is given."""

    def check_call(self, node: ast.Call) -> None:
        """Checks that a function is known, and the number of its arguments."""

    def resolved_name(self, name: str) -> str:
        """Returns the name that calls a function: marked if a user's function replaces it."""

    def is_users(self, name: str) -> bool:
        """Checks whether that is a user's function."""

    def builtin(self, name: str) -> Callable[[list[Any]], Any] | None:
        """Returns a built-in function of plain values, even if a user's function replaces it."""

    def function(self, name: str) -> Callable[[list[Any]], Any] | None:
        """Returns a function that is no relation."""

    def over_time(self, node: ast.Call, frame: Frame) -> Any:
        """Returns the value of a call whose argument is evaluated at each recorded tick."""

    def call(self, node: ast.Call, arguments: list[Any], frame: Frame) -> Any:
        """Returns the value of a function call."""

    def query(self, node: ast.Query, frame: Frame) -> Any:
        """Returns the value of a nested query, which sees the rows of the outer ones."""

    def names(self) -> list[str]:
        """Returns the names of all variables and functions."""

    def deferred(self, node: ast.Node) -> LazyList:
        """Returns a list of the running program for the query that uses it."""

    def at_tick_of_rows(self, arguments: list[Any], frame: Frame) -> list[Any] | None:
        """Returns values, entities at the tick of the rows; None if one was not there then."""

    @property
    def meter(self) -> UsageMeter:
        """The usage of the running program's limits."""


@dataclass(eq=False, slots=True)
class Frame:
    """The values that an expression is evaluated over."""

    scope: EvaluationScope  # the part of the interpreter that knows names and queries
    # The current element of each source by alias; that of the only one by None, too.
    elements: Mapping[str | None, Any] = field(default_factory=dict)
    local: dict[str, Any] = field(default_factory=dict)  # the state variables
    placeholders: Mapping[str, Any] = field(default_factory=dict)  # what placeholders stand for
    columns: Sequence[Any] = ()  # the row from SQL
    # The values of the parts that are the same for all rows, and for all rows of a state.
    cached: dict[ast.Node, Any] = field(default_factory=dict)
    state: dict[ast.Node, Any] = field(default_factory=dict)
    # The elements of the queries around, on which a query does not depend.
    outer_elements: Mapping[str | None, Any] = field(default_factory=dict)
    # The results of users' functions in this row, by the key of the call.
    calls: dict[str, Any] = field(default_factory=dict, init=False)

    def row(
        self,
        elements: Mapping[str | None, Any],
        cached: dict[ast.Node, Any],
        columns: Sequence[Any] = (),
    ) -> Frame:
        """Returns the frame of a row of a query inside this one."""
        return Frame(
            self.scope,
            elements,
            self.local,
            self.placeholders,
            columns,
            cached,
            outer_elements=self.outer_elements,
        )

    def independent(self) -> Frame:
        """Returns the frame for a query that depends on no row around it."""
        return replace(self, outer_elements=self.elements)

    @property
    def is_outermost(self) -> bool:
        """Whether there are no rows and no state variables around the expression."""
        return not (self.elements or self.local or self.placeholders)

    def own_elements(self) -> list[Any]:
        """Returns the elements of this query, and of those around it that it depends on."""
        return [e for alias, e in self.elements.items() if self.outer_elements.get(alias) is not e]

    def value(self, node: ast.Node) -> Any:
        """Returns the value of an expression."""
        return compiled(node, self.scope)(self)


Thunk: TypeAlias = Callable[[Frame], Any]


# Weak keys would not help: the functions refer to their parts.
_COMPILED: dict[ast.Node, Thunk] = {}


def compiled(node: ast.Node, scope: EvaluationScope) -> Thunk:
    """Compiles a node to a function of a frame, once for each node."""
    thunk = _COMPILED.get(node)
    if thunk is None:
        if len(_COMPILED) >= MAX_COMPILED:
            _COMPILED.clear()
        thunk = _COMPILED[node] = ExpressionCompiler(scope).thunk(node)
    return thunk


class ExpressionCompiler:
    """Compiles nodes of a tree to functions of frames."""

    def __init__(
        self,
        scope: EvaluationScope,
        known: Mapping[ast.Node, Thunk] | None = None,
        constants: Collection[ast.Node] = (),
        state_constants: Collection[ast.Node] = (),
        *,
        memorize: bool = False,
        query: ast.Query | None = None,
    ) -> None:
        self._query = query
        self._scope = scope
        self._known = known or {}
        self._constants = constants
        self._state_constants = state_constants
        self._memorize = memorize

    def thunk(self, node: ast.Node) -> Thunk:
        """Returns the node as a function of a frame."""
        known = self._known.get(node)
        if known is not None:
            return known
        thunk = self._thunk(node)
        if node in self._constants:
            return _cached(node, thunk, attrgetter("cached"))
        return _cached(node, thunk, attrgetter("state")) if node in self._state_constants else thunk

    def condition(self, node: ast.Node) -> Callable[[Frame], bool]:
        """Returns the node as a condition: a function of a frame that returns True or False."""
        thunk = self.thunk(node)

        def holds(frame: Frame) -> bool:
            value = thunk(frame)
            return value if value is True or value is False else truth(value, node)

        return holds

    def calls_once(self, node: ast.Node) -> bool:
        """Checks whether a node is a call that is evaluated once a row, even if it is repeated."""
        return (
            self._memorize
            and isinstance(node, ast.Call)
            and self._scope.is_users(node.name)
            and not is_impure(node)
        )

    def _thunk(self, node: ast.Node) -> Thunk:
        match node:
            case ast.Literal(value=value):
                return lambda _: value
            case ast.ListLiteral(items=items):
                return self._list(node, items)
            case ast.Name(name=name):
                return self._name(node, name)
            case ast.Placeholder(name=name):
                return lambda frame: frame.placeholders[name]
            case ast.UnresolvedName():
                return self._unresolved_name(node)
            case ast.This(alias=alias):
                return self._element(node, alias)
            case ast.QualifiedName():
                return self._qualified_name(node)
            case ast.Call():
                return self._call(node)
            case ast.Index():
                return self._index(node)
            case ast.Unary():
                return unary(self, node)
            case ast.Binary():
                return binary(self, node)
            case ast.OperatorChain():
                return chain(self, node)
            case ast.If():
                return self._if(node)
            case ast.Assignment():
                return self._assignment(node)
            case ast.TimeIndex():
                return self._time_index(node)
            case ast.Query():
                for part in node.walk():
                    if isinstance(part, ast.Query):
                        aliases_of(part)  # an error even if no row evaluates it
                return _with_span(node, lambda frame: frame.scope.query(node, frame))
        raise UnsupportedError(f"{type(node).__name__} is not supported here", span=node.span)

    def _name(self, node: ast.Node, name: str) -> Thunk:
        placed = _with_span(node, lambda frame: _variable(frame, name))

        def value(frame: Frame) -> Any:
            local = frame.local
            return local[name] if name in local else placed(frame)

        return value

    def _time_index(self, node: ast.TimeIndex) -> Thunk:
        name, age = node.name, None if node.age is None else self.thunk(node.age)

        def value(frame: Frame) -> Any:
            _refuse_state(name, frame)
            return frame.scope.past_value(name, *(() if age is None else (age(frame),)))

        return _with_span(node, value)

    def _list(self, node: ast.Node, items: Sequence[ast.Node]) -> Thunk:
        thunks = [self.thunk(item) for item in items]
        # A list of few checked lists is not much larger than they are.
        large = len(items) > SMALL_LIST or any(isinstance(item, ast.ListLiteral) for item in items)

        def make(frame: Frame) -> list[Any]:
            values = [thunk(frame) for thunk in thunks]
            if large:
                check_size(values, node.span)
                frame.scope.meter.charge(ELEMENT_BYTES * len(values))
            return values

        return make

    def _element(self, node: ast.This, alias: str | None) -> Thunk:
        def element(frame: Frame) -> Any:
            try:
                return frame.elements[alias]
            except KeyError:
                raise missing_source_error(alias, frame.elements, node.span) from None

        return element

    def _qualified_name(self, node: ast.QualifiedName) -> Thunk:
        alias, key = node.alias, node.key
        element, index = self._element(node.this, alias), self.thunk(node.index)

        def value(frame: Frame) -> Any:
            if alias in frame.local or frame.scope.has_variable(alias):
                return index(frame)
            current = element(frame)
            if isinstance(current, dict):
                return indexed(current, key, node.span)
            call = node.call(frame.scope.resolved_name(key))
            frame.scope.check_call(call)
            return frame.scope.call(call, [current], frame)

        return _with_span(node, value)

    def _unresolved_name(self, node: ast.UnresolvedName) -> Thunk:
        name = node.name
        this = (ast.This(node.span, None),)

        def value(frame: Frame) -> Any:
            element = frame.elements.get(None)
            if isinstance(element, dict) and name in element:
                return element[name]
            if name in frame.local or frame.scope.has_variable(name):
                return _variable(frame, name)
            if isinstance(element, dict):
                known = [key for key in element if isinstance(key, str)] + frame.scope.names()
                raise UnknownNameError(
                    f"there is no key, variable or function {short_repr(name)}",
                    suggestions=nearest(name, known),
                )
            call = ast.Call(node.span, frame.scope.resolved_name(name), this, node.span)
            frame.scope.check_call(call)
            return frame.scope.call(call, [element], frame)

        return _with_span(node, value)

    def is_relation(self, node: ast.Node) -> bool:
        """Checks whether a part is a call of a relation."""
        return isinstance(node, ast.Call) and self._scope.function(node.name) is None

    def _call(self, node: ast.Call) -> Thunk:
        self._scope.check_call(node)
        if node.name in OVER_TIME:
            return _with_span(node, lambda frame: frame.scope.over_time(node, frame))
        thunks = [self.thunk(argument) for argument in node.arguments]
        function = self._scope.builtin(node.name)
        check = argument_check(node, self._query)
        if self.calls_once(node):  # the meaning of a name does not change while a query runs
            return self._memoized_call(node, thunks)

        def call(frame: Frame) -> Any:
            arguments = [thunk(frame) for thunk in thunks]
            try:
                if function is not None:
                    check(arguments)
                    return counted(frame, function(arguments))
                return frame.scope.call(node, arguments, frame)
            except SelectScriptError as error:
                error.span = error.span or node.span
                raise
            except (ValueError, ArithmeticError, MemoryError) as error:
                raise as_evaluation_error(error, node.span) from error

        return call

    def _memoized_call(self, node: ast.Call, thunks: Sequence[Thunk]) -> Thunk:
        """Compiles a call of a user's function to run once a row and once for equal arguments."""
        key, name = node_key(node), node.name
        function = self._scope.function(name)
        assert function is not None

        def call(frame: Frame) -> Any:
            calls = frame.calls
            if key in calls:
                return calls[key]
            arguments = frame.scope.at_tick_of_rows([thunk(frame) for thunk in thunks], frame)
            if arguments is None:
                return None
            memos = frame.cached.get(MEMOS)
            memo = function
            if memos is not None:
                memo = memos.get(name)
                if memo is None:
                    memo = memos[name] = Memo(function)
            value = calls[key] = memo(arguments)
            return value

        return _with_span(node, call)

    def _index(self, node: ast.Index) -> Thunk:
        base = self.thunk(node.base)
        indices = [(self.thunk(index), index.span) for index in node.indices]

        def element(frame: Frame) -> Any:
            value = base(frame)
            for index, span in indices:
                value = indexed(value, index(frame), span)
            return python_value(value) if isinstance(value, _CONVERTED) else value

        return element

    def _if(self, node: ast.If) -> Thunk:
        branches = [
            (self.condition(branch.condition), list(map(self.thunk, branch.then)))
            for branch in node.branches
        ]
        otherwise = list(map(self.thunk, node.otherwise))

        def choice(frame: Frame) -> Any:
            statements = next((then for condition, then in branches if condition(frame)), otherwise)
            value: Any = False
            for part in statements:
                value = part(frame)
            return value

        return choice

    def _assignment(self, node: ast.Assignment) -> Thunk:
        name, value = node.name, self.thunk(node.value)
        horizon = None if node.horizon is None else self._horizon(node.horizon)
        aliases = (
            free_aliases(node.value) if isinstance(node.value, ast.ListLiteral) else frozenset()
        )

        def assign(frame: Frame) -> Any:
            if node.value_start is not None:
                _check_assigned(node, frame)
            seconds = None if horizon is None else horizon(frame)
            if aliases and None not in aliases and not frame.elements:
                assigned: Any = frame.scope.deferred(node.value)
            else:
                assigned = value(frame)
            check_size(assigned, node.span)
            if seconds is not None:
                _refuse_state(name, frame)
                frame.scope.keep(name, assigned, seconds)
            elif name in frame.local:
                frame.local[name] = assigned
            else:
                frame.scope.assign(name, assigned)
            return assigned

        return assign if horizon is None else _with_span(node, assign)

    def _horizon(self, node: ast.Node) -> Thunk:
        """Returns the time for which an assignment keeps values, in seconds."""
        if isinstance(node, ast.UnboundedHorizon):
            return lambda _: math.inf
        value = self.thunk(node)
        return _with_span(node, lambda frame: horizon_of(value(frame)))


def _check_assigned(node: ast.Assignment, frame: Frame) -> None:
    """Checks that a query sets a variable that is there, or at least no column."""
    name, element = node.name, frame.elements.get(None)
    if name in frame.local or frame.scope.has_variable(name):
        return
    if node.is_bare or (isinstance(element, dict) and name in element):
        raise UnknownNameError(
            f"there is no variable {short_repr(name)} to assign here: "
            "write == to compare, or assign it before the query",
            span=node.span,
        )


def _refuse_state(name: str, frame: Frame) -> None:
    if name in frame.local:
        raise ArgumentError(f"{name} is a state variable here; state variables have no history")


def _with_span(node: ast.Node, thunk: Thunk) -> Thunk:
    """Adds the node's place to the errors that arise in it."""

    def placed(frame: Frame) -> Any:
        try:
            return thunk(frame)
        except SelectScriptError as error:
            error.span = error.span or node.span
            raise
        except (ValueError, ArithmeticError, MemoryError) as error:
            raise as_evaluation_error(error, node.span) from error

    return placed


def _cached(node: ast.Node, thunk: Thunk, values: Callable[[Frame], dict[ast.Node, Any]]) -> Thunk:
    def cached(frame: Frame) -> Any:
        cache = values(frame)
        if node in cache:
            return cache[node]
        return cache.setdefault(node, thunk(frame))

    return cached


def _variable(frame: Frame, name: str) -> Any:
    if name in frame.local:
        return frame.local[name]
    if not frame.scope.has_variable(name):
        element = frame.elements.get(None)
        if isinstance(element, dict) and name in element:
            message = f"there is no variable {short_repr(name)}; write this.{first_line(name)}"
            raise UnknownNameError(message)
    value = frame.scope.variable(name)
    # Outside all queries, it is returned unresolved.
    return resolved(value, frame) if isinstance(value, LazyList) and frame.elements else value


def resolved(deferred: LazyList, frame: Frame) -> Any:
    """Returns the value of a deferred list in the query that uses it."""
    try:
        return frame.value(deferred.node)
    except SelectScriptError as error:
        error.locate(deferred.text)
        raise
