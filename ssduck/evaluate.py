"""Values of expressions in Python: of what stands outside a query, and of what SQL cannot do.

A part of a tree is compiled once to a function of a `Frame`: of what the part sees where it is
evaluated. Variables, functions and nested queries are looked up through the frame's `Scope`.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Protocol, TypeAlias, cast
from weakref import WeakKeyDictionary

from ssduck.dependencies import free_aliases, is_impure
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    SelectScriptError,
    Span,
    UnknownNameError,
    UnsupportedError,
    nearest,
)
from ssduck.limits import Meter
from ssduck.tree import (
    Aged,
    Assignment,
    Bare,
    Binary,
    Call,
    Given,
    If,
    Index,
    ListOf,
    Literal,
    Name,
    Node,
    Query,
    This,
    Unary,
)

# Larger results are refused: they are mistakes, and nothing could stop them.
MOST_BITS = 1_000_000
MOST_ELEMENTS = 10_000_000
FEW = 4


class Scope(Protocol):
    """What an evaluator needs of the interpreter."""

    def variable(self, name: str) -> Any:
        """A variable's value, or an UnknownNameError."""

    def has_variable(self, name: str) -> bool:
        """Whether there is a variable of that name."""

    def assign(self, name: str, value: Any) -> None:
        """Set a variable."""

    def check_call(self, node: Call) -> None:
        """Complain of an unknown function, or of a wrong number of arguments."""

    def is_users(self, name: str) -> bool:
        """Whether that is a user's function."""

    def builtin(self, name: str) -> Callable[[list[Any]], Any] | None:
        """A function of plain values that comes with the language, and stays what it is."""

    def call(self, node: Call, arguments: list[Any], frame: Frame) -> Any:
        """The value of a function call."""

    def query(self, node: Query, frame: Frame) -> Any:
        """The value of a nested query, which sees the rows of the outer ones."""

    def names(self) -> list[str]:
        """The names of all variables and functions."""

    def deferred(self, node: Node) -> Deferred:
        """A list of the running program for the query that uses it."""

    @property
    def meter(self) -> Meter:
        """How much of its limits the running program has used."""


class Frame:
    """What an expression sees where it is evaluated.

    Args:
        scope: variables, functions, queries.
        elements: the current element of each source, by alias; that of the only source also
            by None.
        local: the state variables of a path through a hierarchical query.
        given: the values of `Given` parts.
        columns: what SQL has fetched for this row.
        kept: the values of parts that are the same for all rows, once they are known.
        state: the same of parts that are the same for all rows of a state.
    """

    __slots__ = ("calls", "columns", "elements", "given", "kept", "local", "scope", "state")

    def __init__(
        self,
        scope: Scope,
        elements: Mapping[str | None, Any] | None = None,
        local: dict[str, Any] | None = None,
        given: Mapping[str, Any] | None = None,
        columns: Sequence[Any] = (),
        kept: dict[Node, Any] | None = None,
        state: dict[Node, Any] | None = None,
    ) -> None:
        self.scope = scope
        self.elements = elements if elements is not None else {}
        self.local = local if local is not None else {}
        self.given = given if given is not None else {}
        self.columns = columns
        self.kept = kept if kept is not None else {}
        self.state = state if state is not None else {}
        self.calls: dict[str, Any] = {}

    def row(
        self,
        elements: Mapping[str | None, Any],
        kept: dict[Node, Any],
        columns: Sequence[Any] = (),
    ) -> Frame:
        """The frame of a row of a query that this one is around."""
        return Frame(self.scope, elements, self.local, self.given, columns, kept)

    def value(self, node: Node) -> Any:
        """The value of an expression.

        Raises:
            SelectScriptError: with the offending part's place.
        """
        return compiled(node, self.scope)(self)


Thunk: TypeAlias = Callable[[Frame], Any]


class Deferred:
    """A list that mentions elements of sources that are not there yet.

    It is resolved in the query that uses it.

    Args:
        node: the list, or a list or text that contains it.
        text: the program that it is from.
    """

    def __init__(self, node: Node, text: str) -> None:
        self.node = node
        self.text = text

    def __repr__(self) -> str:
        return f"<list for the query that uses it: {self.source}>"

    @property
    def source(self) -> str:
        """How it was written."""
        return self.text[self.node.span.start : self.node.span.end]


_COMPILED: WeakKeyDictionary[Node, Thunk] = WeakKeyDictionary()


def compiled(node: Node, scope: Scope) -> Thunk:
    """A part as a function of a frame; made once for a part, names checked each time."""
    thunk = _COMPILED.get(node)
    if thunk is None:
        thunk = _COMPILED[node] = Compiler(scope).thunk(node)
    return thunk


class Compiler:
    """Makes functions of frames from parts of a tree.

    Args:
        scope: names are checked with it, whether a row comes to them or not.
        known: parts whose values are known, as functions of a frame.
        constants: parts that are the same for all rows: evaluated once, when first needed.
        of_state: parts that are the same for all rows of a state.
        memorize: whether a user's function called twice alike in a row is called once; not
            where variables change between the calls.
    """

    def __init__(
        self,
        scope: Scope,
        known: Mapping[Node, Thunk] | None = None,
        constants: Collection[Node] = (),
        of_state: Collection[Node] = (),
        *,
        memorize: bool = False,
    ) -> None:
        self._scope = scope
        self._known = known or {}
        self._constants = constants
        self._of_state = of_state
        self._memorize = memorize

    def thunk(self, node: Node) -> Thunk:
        """A part as a function of a frame."""
        known = self._known.get(node)
        if known is not None:
            return known
        thunk = self._thunk(node)
        if node in self._constants:
            return _kept(node, thunk)
        return _kept_in_state(node, thunk) if node in self._of_state else thunk

    def _thunk(self, node: Node) -> Thunk:
        match node:
            case Literal(value=value):
                return lambda _: value
            case ListOf(items=items):
                return self._list(node, items)
            case Name(name=name):
                return self._name(node, name)
            case Given(name=name):
                return lambda frame: frame.given[name]
            case Bare():
                return self._bare(node)
            case This(alias=alias):
                return self._element(node, alias)
            case Call():
                return self._call(node)
            case Index():
                return self._index(node)
            case Unary(operator=sign, operand=operand):
                inner = self.thunk(operand)
                return lambda frame: apply_unary(sign, inner(frame), node.span)
            case Binary():
                return self._binary(node)
            case If():
                return self._choice(node)
            case Assignment(horizon=None):
                return self._assignment(node)
            case Query():
                return _placed(node, lambda frame: frame.scope.query(node, frame))
            case Aged() | Assignment():
                raise UnsupportedError(
                    "variables with a history, name{…}, are not supported yet", span=node.span
                )
        raise UnsupportedError(f"{type(node).__name__} is not supported here", span=node.span)

    def _name(self, node: Node, name: str) -> Thunk:
        placed = _placed(node, lambda frame: _variable(frame, name))

        def value(frame: Frame) -> Any:
            local = frame.local
            return local[name] if name in local else placed(frame)

        return value

    def _list(self, node: Node, items: Sequence[Node]) -> Thunk:
        thunks = [self.thunk(item) for item in items]
        # What is made of few lists is not much larger than they are, and these were checked.
        large = len(items) > FEW or any(isinstance(item, ListOf) for item in items)

        def make(frame: Frame) -> list[Any]:
            values = [thunk(frame) for thunk in thunks]
            if large:
                check_size(values, node.span)
            return values

        return make

    def _element(self, node: This, alias: str | None) -> Thunk:
        def element(frame: Frame) -> Any:
            try:
                return frame.elements[alias]
            except KeyError:
                raise _no_element(alias, frame, node.span) from None

        return element

    def _bare(self, node: Bare) -> Thunk:
        name = node.name
        call = Call(node.span, name, (This(node.span, None),), node.span)

        def value(frame: Frame) -> Any:
            element = frame.elements.get(None)
            if isinstance(element, dict) and name in element:
                return element[name]
            if name in frame.local or frame.scope.has_variable(name):
                return _variable(frame, name)
            if isinstance(element, dict):
                keys = [key for key in element if isinstance(key, str)]
                raise UnknownNameError(
                    f"there is no key, variable or function {name!r}",
                    suggestions=nearest(name, [*keys, *frame.scope.names()]),
                )
            frame.scope.check_call(call)
            return frame.scope.call(call, [element], frame)

        return _placed(node, value)

    def _call(self, node: Call) -> Thunk:
        self._scope.check_call(node)
        thunks = [self.thunk(argument) for argument in node.arguments]

        function = self._scope.builtin(node.name)

        def call(frame: Frame) -> Any:
            arguments = [thunk(frame) for thunk in thunks]
            try:
                if function is not None:
                    return function(arguments)
                return frame.scope.call(node, arguments, frame)
            except SelectScriptError as error:
                error.span = error.span or node.span
                raise
            except (ValueError, ArithmeticError, MemoryError) as error:
                raise _unusable(error, node.span) from error

        if not self._memorize or not self._scope.is_users(node.name) or is_impure(node):
            return call
        key = written(node)

        def once_a_row(frame: Frame) -> Any:
            calls = frame.calls
            if key not in calls:
                calls[key] = call(frame)
            return calls[key]

        return once_a_row

    def _index(self, node: Index) -> Thunk:
        base = self.thunk(node.base)
        indices = [(self.thunk(index), index.span) for index in node.indices]

        def element(frame: Frame) -> Any:
            value = base(frame)
            for index, span in indices:
                value = _indexed(value, index(frame), span)
            return value

        return element

    def _binary(self, node: Binary) -> Thunk:
        sign = node.operator
        left, right = self.thunk(node.left), self.thunk(node.right)
        if sign == "AND":
            return lambda frame: _truth(left(frame), node) and _truth(right(frame), node)
        if sign == "OR":
            return lambda frame: _truth(left(frame), node) or _truth(right(frame), node)
        if sign in _GROWING:
            return lambda frame: apply(sign, left(frame), right(frame), node.span)
        operate = _OPERATORS[sign]

        def operation(frame: Frame) -> Any:
            a, b = left(frame), right(frame)
            try:
                return operate(a, b)
            except Exception:  # noqa: BLE001  # `apply` tells which
                return apply(sign, a, b, node.span)

        return operation

    def _choice(self, node: If) -> Thunk:
        condition = self.thunk(node.condition)
        then = [self.thunk(part) for part in node.then]
        otherwise = [self.thunk(part) for part in node.otherwise]

        def choice(frame: Frame) -> Any:
            value: Any = False
            for part in then if _truth(condition(frame), node.condition) else otherwise:
                value = part(frame)
            return value

        return choice

    def _assignment(self, node: Assignment) -> Thunk:
        name, value = node.name, self.thunk(node.value)
        seen = free_aliases(node.value) if isinstance(node.value, ListOf) else frozenset()

        def assign(frame: Frame) -> Any:
            if None not in seen and not seen <= frame.elements.keys():
                assigned: Any = frame.scope.deferred(node.value)
            else:
                assigned = value(frame)
            check_size(assigned, node.span)
            if name in frame.local:
                frame.local[name] = assigned
            else:
                frame.scope.assign(name, assigned)
            return assigned

        return assign


def _placed(node: Node, thunk: Thunk) -> Thunk:
    """With its place told to the errors that arise in it."""

    def placed(frame: Frame) -> Any:
        try:
            return thunk(frame)
        except SelectScriptError as error:
            error.span = error.span or node.span
            raise
        except (ValueError, ArithmeticError, MemoryError) as error:
            raise _unusable(error, node.span) from error

    return placed


def _kept(node: Node, thunk: Thunk) -> Thunk:
    def kept(frame: Frame) -> Any:
        if node not in frame.kept:
            frame.kept[node] = thunk(frame)
        return frame.kept[node]

    return kept


def _kept_in_state(node: Node, thunk: Thunk) -> Thunk:
    def kept(frame: Frame) -> Any:
        state = frame.state
        if node not in state:
            state[node] = thunk(frame)
        return state[node]

    return kept


def _variable(frame: Frame, name: str) -> Any:
    if name in frame.local:
        return frame.local[name]
    if not frame.scope.has_variable(name):
        element = frame.elements.get(None)
        if isinstance(element, dict) and name in element:
            raise UnknownNameError(f"there is no variable {name!r}; write this.{name}")
    value = frame.scope.variable(name)
    return resolved(value, frame) if isinstance(value, Deferred) else value


def resolved(deferred: Deferred, frame: Frame) -> Any:
    """The value of a deferred list where it is used; itself where its sources are not yet."""
    if not free_aliases(deferred.node) <= frame.elements.keys():
        return deferred
    try:
        return frame.value(deferred.node)
    except SelectScriptError as error:
        error.locate(deferred.text)
        raise


def _no_element(alias: str | None, frame: Frame, span: Span) -> SelectScriptError:
    names = [name for name in frame.elements if name is not None]
    if alias is not None:
        return UnknownNameError(
            f"there is no source {alias!r} here",
            span=span,
            suggestions=nearest(alias, names) or names[:3],
        )
    if names:
        told = ", ".join(f"{name}.this" for name in names)
        return ArgumentError(f"'this' alone is ambiguous here; write one of {told}", span=span)
    return UnknownNameError(
        "there is no 'this' here: it is the element of a query's only source", span=span
    )


def _indexed(value: Any, index: Any, span: Span) -> Any:
    try:
        return value[index]
    except (IndexError, KeyError) as error:
        size = f"{len(value)} elements" if isinstance(value, list) else f"keys {list(value)}"
        near = nearest(index, map(str, value)) if isinstance(value, dict) else ()
        raise EvaluationError(
            f"no element {index!r}: there are {size}", span=span, suggestions=near
        ) from error
    except TypeError as error:
        raise ArgumentError(f"{_kind(value)} has no element {index!r}", span=span) from error


def _truth(value: Any, node: Node) -> bool:
    try:
        return bool(value)
    except (ValueError, TypeError, ArithmeticError) as error:
        raise _unusable(error, node.span) from error


def _unusable(error: Exception, span: Span) -> EvaluationError:
    """Of values that Python brought in: an array that is neither true nor false, say."""
    return EvaluationError(f"{type(error).__name__}: {error}", span=span)


_OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "XOR": lambda left, right: bool(left) != bool(right),
    "IN": lambda left, right: left in right,
    "==": operator.eq,
    "!=": operator.ne,
    ">=": operator.ge,
    ">": operator.gt,
    "<=": operator.le,
    "<": operator.lt,
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": operator.mod,
    "^": operator.pow,
}
_UNARY: dict[str, Callable[[Any], Any]] = {
    "NOT": operator.not_,
    "-": operator.neg,
    "+": operator.pos,
}
_GROWING = frozenset("+*^")


def apply(sign: str, left: Any, right: Any, span: Span | None = None) -> Any:
    """The value of a binary operator other than AND and OR.

    Raises:
        EvaluationError: a division by zero, or a result that is too large.
        ArgumentError: values that the operator does not take.
    """
    if sign in _GROWING and _is_endless(sign, left, right):
        raise EvaluationError(f"the result of {sign} is too large", span=span)
    try:
        value = _OPERATORS[sign](left, right)
    except ZeroDivisionError as error:
        raise EvaluationError("division by zero", span=span) from error
    except OverflowError as error:
        raise EvaluationError(f"the result of {sign} is too large", span=span) from error
    except TypeError as error:
        raise ArgumentError(
            f"{sign} does not take {_kind(left)} and {_kind(right)}", span=span
        ) from error
    except (ValueError, ArithmeticError, RecursionError) as error:
        raise EvaluationError(f"{type(error).__name__}: {error}", span=span) from error
    if isinstance(value, complex):
        raise EvaluationError(f"{sign} of these has no real value", span=span)
    return value


def _is_endless(sign: str, left: Any, right: Any) -> bool:
    """Whether a power, a product or a repetition would take all time and memory there is."""
    if isinstance(left, int) and isinstance(right, int):
        if sign == "^":
            return abs(left) > 1 and right * left.bit_length() > MOST_BITS
        return sign == "*" and left.bit_length() + right.bit_length() > MOST_BITS
    if sign == "+" and isinstance(left, str | list) and type(left) is type(right):
        return len(left) + len(right) > MOST_ELEMENTS
    if sign == "*":
        for sequence, times in ((left, right), (right, left)):
            if isinstance(sequence, str | list) and isinstance(times, int):
                return len(sequence) * times > MOST_ELEMENTS
    return False


def check_size(value: Any, span: Span) -> None:
    """Refuse a list of lists of lists that would take for ever to print or to compare.

    Raises:
        EvaluationError: it has more than `MOST_ELEMENTS`, all the way down.
    """
    if type(value) is list and _leaves(value, {}) > MOST_ELEMENTS:
        raise EvaluationError("the list is too large", span=span)


def _leaves(values: list[Any], counted: dict[int, int]) -> int:
    """How many elements a list has, all the way down; each list is counted once."""
    count = len(values)
    for value in values:
        if type(value) is list:
            if id(value) not in counted:
                counted[id(value)] = _leaves(value, counted)
            count += counted[id(value)]
    return count


def apply_unary(sign: str, value: Any, span: Span) -> Any:
    """The value of NOT, - or +.

    Raises:
        ArgumentError: a sign before what is no number.
    """
    try:
        return _UNARY[sign](value)
    except TypeError as error:
        raise ArgumentError(f"{sign} does not take {_kind(value)}", span=span) from error
    except ValueError as error:
        raise _unusable(error, span) from error


def _kind(value: Any) -> str:
    """What a value is, in words."""
    if value is None:
        return "nothing"
    words = {
        bool: "True or False",
        int: "a number",
        float: "a number",
        str: "a text",
        list: "a list",
    }
    return words.get(type(value), type(value).__name__)


def written(node: Node) -> str:
    """A part so that parts are written alike if they mean the same where they stand."""
    match node:
        case Literal(value=value):
            return repr(value)
        case Name(name=name) | Bare(name=name) | Given(name=name):
            return name
        case This(alias=alias):
            return "this" if alias is None else f"{alias}.this"
        case Query():
            return f"query {id(node)}"
    parts = ", ".join(map(written, node.children()))
    told = getattr(node, "name", getattr(node, "operator", ""))
    return f"{type(node).__name__} {told}({parts})"


_ATOMS = frozenset((int, float, str, bool, type(None)))


def hashable(value: Any) -> Any:
    """What stands for a value in sets: alike for equal values, lists and dicts included.

    Raises:
        ArgumentError: values of its type cannot be told apart.
    """
    kind = type(value)
    if kind in _ATOMS:
        return value
    if kind is list or kind is tuple:
        return (kind, *[part if type(part) in _ATOMS else hashable(part) for part in value])
    if kind is dict:
        return (dict, frozenset((key, hashable(part)) for key, part in value.items()))
    try:
        hash(value)
    except TypeError as error:
        raise ArgumentError(f"{_kind(value)} cannot be told apart from others: {error}") from error
    return cast("Any", value)


class Keys:
    """Numbers for values: the same for equal ones; for one search.

    Lists that were seen before are known by what they are, without being looked into; they
    must not change meanwhile.
    """

    def __init__(self) -> None:
        self._numbers: dict[Any, int] = {}
        self._seen: dict[int, tuple[Any, int]] = {}

    def of(self, values: tuple[Any, ...], names: tuple[Any, ...]) -> int:
        """The number of what is selected of a row, and what it is called."""
        parts = [value if type(value) in _ATOMS else self._part(value) for value in values]
        return self._number((tuple(parts), hashable(names)))

    def _part(self, value: Any) -> Any:
        if type(value) is not list:
            return hashable(value)
        seen = self._seen.get(id(value))
        if seen is None:
            parts = [part if type(part) in _ATOMS else self._part(part) for part in value]
            seen = self._seen[id(value)] = (value, self._number((list, *parts)))
        return (list, seen[1])

    def _number(self, key: Any) -> int:
        return self._numbers.setdefault(key, len(self._numbers))
