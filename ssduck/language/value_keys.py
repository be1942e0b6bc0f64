"""Hashable keys for values and for parts of a tree, and functions that remember their results."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from typing import Any, cast
from weakref import WeakKeyDictionary

import numpy as np

from ssduck.errors import ArgumentError, SourceSpan
from ssduck.formatting import type_in_words
from ssduck.language import ast

_node_keys: WeakKeyDictionary[ast.Node, str] = WeakKeyDictionary()


def node_key(node: ast.Node) -> str:
    """Returns a key of a part of a tree; parts with equal keys have the same meaning."""
    key = _node_keys.get(node)
    if key is None:
        key = _node_keys[node] = _key_of(node)
    return key


def _key_of(node: ast.Node) -> str:
    if isinstance(node, ast.Query):
        return f"Query({id(node)})"
    values = (getattr(node, field.name) for field in fields(node))
    parts = ", ".join(_field_key(value) for value in values if not isinstance(value, SourceSpan))
    return f"{type(node).__name__}({parts})"


def _field_key(value: Any) -> str:
    """Returns the key of a part's field: a part, several parts, or a name, a number, a text."""
    if isinstance(value, tuple):
        return f"({', '.join(map(_field_key, value))})"
    return node_key(value) if isinstance(value, ast.Node) else repr(value)


ATOMS = frozenset((int, float, str, bool, type(None)))
NUMPYS = (np.bool_, np.integer, np.floating, np.str_)
# What a tuple has that is a list to the language.
_VECTOR_PARTS = frozenset((int, float, list))


def python_value(value: Any) -> Any:
    """Returns a value in which Python's numbers, booleans and texts replace NumPy's.

    NumPy's numbers overflow, and are infinite where Python's raise. Tuples of numbers become lists,
    since simulators return positions as such, and no tuple equals a list. The result is the value
    itself if it contains none of these.
    """
    kind = type(value)
    if kind is dict:
        parts = {python_key(key): python_value(part) for key, part in value.items()}
        same = all(map(operator.is_, parts.values(), value.values()))
        return value if same and all(map(operator.is_, parts, value)) else parts
    if kind is list and ATOMS.issuperset(map(type, value)):
        return value
    if kind is list or kind is tuple:
        elements: Any = list(map(python_value, value))
        elements = elements if kind is list else tuple_or_vector(elements)
        same = type(elements) is kind and all(map(operator.is_, elements, value))
        return value if same else elements
    return value.item() if isinstance(value, NUMPYS) else value


def python_key(key: Any) -> Any:
    """Returns the key of a dict as `python_value` does, but tuples stay tuples."""
    if type(key) is not tuple:
        return python_value(key)
    parts = tuple(map(python_key, key))
    return key if all(map(operator.is_, parts, key)) else parts


def tuple_or_vector(parts: list[Any]) -> list[Any] | tuple[Any, ...]:
    """Returns the parts of a tuple: a list if they are numbers, or lists; else a tuple."""
    return parts if _VECTOR_PARTS.issuperset(map(type, parts)) else tuple(parts)


def equality_key(value: Any) -> Any:
    """Returns a hashable key of a value: equal for equal values, lists and dicts included."""
    kind = type(value)
    if kind in ATOMS:
        return value
    if kind is list or kind is tuple:
        return (kind, *[part if type(part) in ATOMS else equality_key(part) for part in value])
    if kind is dict:
        return (dict, frozenset((key, equality_key(part)) for key, part in value.items()))
    try:
        hash(value)
    except TypeError as error:
        raise ArgumentError(
            f"{type_in_words(value)} cannot be compared with others: {error}"
        ) from error
    return cast("Any", value)


_EXACT_ATOMS = frozenset((int, str, bool, type(None)))


def exact_key(value: Any) -> Any:
    """Returns a hashable key of a value: equal only for values that no function can distinguish.

    1, 1.0 and True are equal, and so are 0.0 and -0.0, but `str` distinguishes them. Equal values
    of other types may differ in such ways, too.
    """
    kind = type(value)
    if kind in _EXACT_ATOMS:
        return (kind, value)
    if kind is float:
        return (float, repr(value))
    if kind is list or kind is tuple:
        types = tuple(map(type, value))
        if _EXACT_ATOMS.issuperset(types):
            return (kind, types, *value)
        return (kind, *map(exact_key, value))
    if kind is dict:
        return (dict, *[(exact_key(key), exact_key(part)) for key, part in value.items()])
    moment = getattr(value, "moment", None)  # an entity at another tick is another one
    return (kind, equality_key(value), _distinguishing_text(value), moment and moment.tick)


def _distinguishing_text(value: Any) -> str:
    try:
        return repr(value)
    except Exception as error:
        raise ArgumentError(f"{type_in_words(value)} cannot be compared with others") from error


class ValueKeys:
    """Short keys of values, quick to look up, for one search.

    Lists that occurred before are recognized by identity; they must not change meanwhile.
    """

    def __init__(self) -> None:
        self._seen: dict[int, tuple[Any, int]] = {}
        self._exact: dict[Any, int] = {}
        self._equal: dict[int, Any] = {}
        self._numbers: dict[Any, int] = {}

    def exact(self, values: Iterable[Any]) -> tuple[Any, ...]:
        """Returns a key of each value, equal only for values that no function can distinguish."""
        numbered = self._seen
        return tuple(
            [
                numbered[id(value)][1] if id(value) in numbered else self._exact_key(value)
                for value in values
            ]
        )

    def _exact_key(self, value: Any) -> Any:
        if type(value) is not list:
            return exact_key(value)
        number = self._exact.setdefault(exact_key(value), len(self._exact))
        self._seen[id(value)] = (value, number)
        return number

    def of(self, values: tuple[Any, ...], names: tuple[Any, ...]) -> int:
        """Returns a number for the selected values and names of a row, the same for equal rows."""
        parts = [value if type(value) in ATOMS else self._part(value) for value in values]
        called = names if ATOMS.issuperset(map(type, names)) else equality_key(names)
        return self._numbers.setdefault((*parts, called), len(self._numbers))

    def _part(self, value: Any) -> Any:
        if type(value) is not list:
            return equality_key(value)
        entry = self._seen.get(id(value))
        if entry is None:
            return (list, *[part if type(part) in ATOMS else self._part(part) for part in value])
        part = self._equal.get(entry[1])
        if part is None:
            part = self._equal[entry[1]] = equality_key(value)
        return part


# The key of a query's memos in a frame's cache; no program contains this part.
MEMOS = ast.Placeholder(SourceSpan(0, 0), "memos")
# The largest number of results of a function; when it is reached, all are dropped.
MAX_STORED = 10_000
# After TRIAL_CALLS calls, a function with fewer hits than one in _MIN_CALLS_PER_HIT is not cached.
TRIAL_CALLS = 2_000
_MIN_CALLS_PER_HIT = 8


class Memo:
    """A function that remembers its results.

    Arguments are compared exactly: 1, 1.0 and True differ, and so do 0.0 and -0.0. Calls whose
    arguments have no keys are not cached. Identical objects are not compared, because lists do not
    change while a query runs.
    """

    def __init__(self, call: Callable[[list[Any]], Any], *, by_identity: bool = True) -> None:
        self._call = call
        self._uses_identity = by_identity
        self._keys = ValueKeys()
        self._by_identity: dict[tuple[int, ...], tuple[Sequence[Any], Any]] = {}
        self._by_key: dict[tuple[Any, ...], Any] = {}
        self._call_count = self._hit_count = 0
        self._is_useful = True

    def __call__(self, arguments: list[Any]) -> Any:
        """Returns the result of the function for these values."""
        if not self._is_useful:
            return self._call(arguments)
        self._call_count += 1
        identity = tuple(map(id, arguments))
        entry = self._by_identity.get(identity)
        if entry is not None:
            self._hit_count += 1
            return entry[1]
        try:
            key = (
                self._keys.exact(arguments)
                if self._uses_identity
                else tuple(map(exact_key, arguments))
            )
        except (ArgumentError, RecursionError):
            return self._call(arguments)
        if key in self._by_key:
            self._hit_count += 1
            value = self._by_key[key]
        else:
            value = self._by_key[key] = self._call(arguments)
        if self._uses_identity:  # it keeps them alive, so that their ids stay theirs
            self._by_identity[identity] = (arguments, value)
        self._tidy()
        return value

    def _tidy(self) -> None:
        if len(self._by_identity) > MAX_STORED or len(self._by_key) > MAX_STORED:
            self._clear()
        if (
            self._call_count == TRIAL_CALLS
            and self._hit_count * _MIN_CALLS_PER_HIT < self._call_count
        ):
            self._is_useful = False
            self._clear()

    def forget(self) -> None:
        """Drops all results, for the next query."""
        self._clear()
        self._call_count = self._hit_count = 0
        self._is_useful = True

    def _clear(self) -> None:
        self._by_identity.clear()
        self._by_key.clear()
        self._keys = ValueKeys()
