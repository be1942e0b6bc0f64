"""Values of expressions in Python: of what stands outside a query, and of what SQL cannot do.

A part of a tree is compiled once to a function of a `Frame`: of what the part sees where it is
evaluated. Variables, functions and nested queries are looked up through the frame's `Scope`.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import islice
from typing import Any, Protocol, TypeAlias, cast
from weakref import WeakKeyDictionary

from ssduck.dependencies import aliases_of, free_aliases, is_impure
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
# So many keys and letters of what is wrong are told.
MOST_KEYS = 20
MOST_LETTERS = 200


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

    def function(self, name: str) -> Callable[[list[Any]], Any] | None:
        """A function that is no relation."""

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

    def condition(self, node: Node) -> Callable[[Frame], bool]:
        """A part as a function that tells whether it holds."""
        thunk = self.thunk(node)
        if isinstance(node, Binary) and node.operator in _CHAINS:
            return thunk  # which is True or False

        def holds(frame: Frame) -> bool:
            value = thunk(frame)
            return value if value is True or value is False else truth(value, node)

        return holds

    def calls_once(self, node: Node) -> bool:
        """Whether a part is a call that is made once for a row, however often it is written."""
        return (
            self._memorize
            and isinstance(node, Call)
            and self._scope.is_users(node.name)
            and not is_impure(node)
        )

    def is_deferred(self, node: Node) -> bool:
        """Whether a part is a variable that holds a list for the query that uses it."""
        return (
            isinstance(node, Name)
            and self._scope.has_variable(node.name)
            and isinstance(self._scope.variable(node.name), Deferred)
        )

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
                if sign == "NOT":
                    holds = self.condition(operand)
                    return lambda frame: not holds(frame)
                inner = self.thunk(operand)
                return lambda frame: apply_unary(sign, inner(frame), node.span)
            case Binary():
                return self._binary(node)
            case If():
                return self._choice(node)
            case Assignment(horizon=None):
                return self._assignment(node)
            case Query():
                for part in node.walk():
                    if isinstance(part, Query):
                        aliases_of(part)  # is an error whether a row comes to it or not
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
        if self.calls_once(node):  # what a name means does not change while a query runs
            function = self._scope.function(node.name)

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

        if not self.calls_once(node):
            return call
        key = written(node)

        def once_a_row(frame: Frame) -> Any:
            calls = frame.calls
            if key in calls:
                return calls[key]
            value = calls[key] = call(frame)
            return value

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
        if sign in _CHAINS:
            return self._chain(node)
        operate = _OPERATORS[sign]
        if sign in _GROWING:
            left, right = self.thunk(node.left), self.thunk(node.right)
            quick = _QUICK[sign]

            def growing(frame: Frame) -> Any:
                a, b = left(frame), right(frame)
                if type(a) is type(b) and type(a) in quick:
                    return operate(a, b)
                return apply(sign, a, b, node.span)

            return growing
        left, right = self._operand(node.left), self._operand(node.right)

        def operation(frame: Frame) -> Any:
            a, b = left(frame), right(frame)
            try:
                return operate(a, b)
            except Exception:  # noqa: BLE001  # `apply` tells which
                return apply(sign, a, b, node.span)

        return operation

    def _operand(self, node: Node) -> Thunk:
        """A side of an operator, which keeps nothing of it: a list is made once."""
        if not isinstance(node, ListOf) or not _is_written_out(node):
            return self.thunk(node)
        fixed = self._thunk(node)(Frame(self._scope))
        return lambda _: fixed

    def _chain(self, node: Binary) -> Callable[[Frame], bool]:
        """AND, OR: the right side counts if the left one does not decide."""
        decides = node.operator == "OR"
        left, right = self.thunk(node.left), self.thunk(node.right)

        def holds(frame: Frame) -> bool:
            value = left(frame)
            if value is not True and value is not False:
                value = truth(value, node.left)
            if value is decides:
                return decides
            value = right(frame)
            return value if value is True or value is False else truth(value, node.right)

        return holds

    def _choice(self, node: If) -> Thunk:
        condition = self.condition(node.condition)
        then = [self.thunk(part) for part in node.then]
        otherwise = [self.thunk(part) for part in node.otherwise]

        def choice(frame: Frame) -> Any:
            value: Any = False
            for part in then if condition(frame) else otherwise:
                value = part(frame)
            return value

        return choice

    def _assignment(self, node: Assignment) -> Thunk:
        name, value = node.name, self.thunk(node.value)
        seen = free_aliases(node.value) if isinstance(node.value, ListOf) else frozenset()

        def assign(frame: Frame) -> Any:
            if seen and None not in seen and not frame.elements:
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


def _is_written_out(node: Node) -> bool:
    if isinstance(node, ListOf):
        return all(map(_is_written_out, node.items))
    return isinstance(node, Literal)


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
        known = frame.kept
        if node in known:
            return known[node]
        value = known[node] = thunk(frame)
        return value

    return kept


def _kept_in_state(node: Node, thunk: Thunk) -> Thunk:
    def kept(frame: Frame) -> Any:
        known = frame.state
        if node in known:
            return known[node]
        value = known[node] = thunk(frame)
        return value

    return kept


def _variable(frame: Frame, name: str) -> Any:
    if name in frame.local:
        return frame.local[name]
    if not frame.scope.has_variable(name):
        element = frame.elements.get(None)
        if isinstance(element, dict) and name in element:
            raise UnknownNameError(f"there is no variable {name!r}; write this.{name}")
    value = frame.scope.variable(name)
    # Outside all queries it is passed on as it is.
    return resolved(value, frame) if isinstance(value, Deferred) and frame.elements else value


def resolved(deferred: Deferred, frame: Frame) -> Any:
    """The value of a deferred list in the query that uses it.

    Raises:
        UnknownNameError: the query has no such source.
    """
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
    except (SelectScriptError, RecursionError):
        raise
    except (IndexError, KeyError) as error:
        raise _no_such(value, index, span, error) from error
    except TypeError as error:
        raise ArgumentError(f"{_kind(value)} has no element {_shown(index)}", span=span) from error
    except Exception as error:
        raise _unusable(error, span) from error


def _no_such(value: Any, index: Any, span: Span, error: Exception) -> EvaluationError:
    """Of an element that is not there, with what is there."""
    missing = f"no element {_shown(index)}"
    if isinstance(value, dict):
        keys = list(islice(value, MOST_KEYS))
        more = ", …" if len(value) > MOST_KEYS else ""
        told = ", ".join(map(_shown, keys))
        near = nearest(index, map(str, keys))
        return EvaluationError(
            f"{missing}: there are keys [{told}{more}]", span=span, suggestions=near
        )
    if isinstance(value, list | tuple | str):
        return EvaluationError(f"{missing}: there are {len(value)} elements", span=span)
    return EvaluationError(f"{missing}: {_bounded(str(error))}", span=span)


def _shown(value: Any) -> str:
    """A value as it is written, if that is not too long."""
    return _bounded(repr(value))


def _bounded(text: str) -> str:
    """The first line of a text, if that is not too long."""
    line = text.strip().partition("\n")[0]
    return line if len(line) <= MOST_LETTERS else f"{line[:MOST_LETTERS]}…"


def truth(value: Any, node: Node) -> bool:
    """Whether a value holds.

    Raises:
        EvaluationError: it is neither true nor false.
    """
    try:
        return bool(value)
    except (SelectScriptError, RecursionError):
        raise
    except Exception as error:
        raise _unusable(error, node.span) from error


def _unusable(error: Exception, span: Span | None) -> EvaluationError:
    """Of values that Python brought in: an array that is neither true nor false, say.

    Their libraries have errors of their own, of whatever kind and length.
    """
    return EvaluationError(f"{type(error).__name__}: {_bounded(str(error))}", span=span)


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
    "-": operator.neg,
    "+": operator.pos,
}
_GROWING = frozenset("+*^")
# Of two values of these types a result is never too large.
_QUICK = {"+": frozenset((int, float)), "*": frozenset((float,)), "^": frozenset[type]()}
_CHAINS = frozenset(("AND", "OR"))


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
    except SelectScriptError:
        raise
    except Exception as error:
        raise _unusable(error, span) from error
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
        if type(value) is not list:
            continue
        if list not in map(type, value):
            count += len(value)
        elif id(value) in counted:
            count += counted[id(value)]
        else:
            known = counted[id(value)] = _leaves(value, counted)
            count += known
    return count


def apply_unary(sign: str, value: Any, span: Span) -> Any:
    """The value of - or +.

    Raises:
        ArgumentError: a sign before what is no number.
    """
    try:
        return _UNARY[sign](value)
    except TypeError as error:
        raise ArgumentError(f"{sign} does not take {_kind(value)}", span=span) from error
    except (SelectScriptError, RecursionError):
        raise
    except Exception as error:
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
        Deferred: "a list for the query that uses it",
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


_EXACT_ATOMS = frozenset((int, str, bool, type(None)))


def exactly(value: Any) -> Any:
    """What stands for a value in sets: alike only for values that no function tells apart.

    1, 1.0 and True are equal, and so are 0.0 and -0.0; `str` tells them apart.

    Raises:
        ArgumentError: values of its type cannot be told apart.
    """
    kind = type(value)
    if kind in _EXACT_ATOMS:
        return (kind, value)
    if kind is float:
        return (float, repr(value))
    if kind is list or kind is tuple:
        return (kind, *map(exactly, value))
    if kind is dict:
        return (dict, *[(exactly(key), exactly(part)) for key, part in value.items()])
    return (kind, hashable(value))


class Keys:
    """What stands for values, so that it is quick to look up; for one search.

    Lists that were seen before are known by what they are, without being looked into; they
    must not change meanwhile.
    """

    def __init__(self) -> None:
        self._seen: dict[int, tuple[Any, int]] = {}
        self._exact: dict[Any, int] = {}
        self._equal: dict[int, Any] = {}
        self._numbers: dict[Any, int] = {}

    def exact(self, values: Iterable[Any]) -> tuple[Any, ...]:
        """What stands for each of some values, alike only for what no function tells apart."""
        seen = self._seen
        return tuple(
            [seen[id(value)][1] if id(value) in seen else self._exactly(value) for value in values]
        )

    def _exactly(self, value: Any) -> Any:
        if type(value) is not list:
            return exactly(value)
        number = self._exact.setdefault(exactly(value), len(self._exact))
        self._seen[id(value)] = (value, number)
        return number

    def of(self, values: tuple[Any, ...], names: tuple[Any, ...]) -> int:
        """A number for what is selected of a row and what it is called, alike for equal ones."""
        parts = [value if type(value) in _ATOMS else self._part(value) for value in values]
        called = names if _ATOMS.issuperset(map(type, names)) else hashable(names)
        return self._numbers.setdefault((*parts, called), len(self._numbers))

    def _part(self, value: Any) -> Any:
        if type(value) is not list:
            return hashable(value)
        seen = self._seen.get(id(value))
        if seen is None:
            return (list, *[part if type(part) in _ATOMS else self._part(part) for part in value])
        part = self._equal.get(seen[1])
        if part is None:
            part = self._equal[seen[1]] = hashable(value)
        return part
