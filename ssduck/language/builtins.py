"""Functions of plain values: the built-in ones, and those that users add."""

from __future__ import annotations

import copy
import inspect
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, reduce, wraps
from types import FunctionType
from typing import Any

from ssduck import validation
from ssduck.errors import ArgumentError, FunctionError, LimitError, SelectScriptError
from ssduck.formatting import argument_in_words, error_text, first_line, short_repr
from ssduck.language.analysis import BINARY_NAMES
from ssduck.language.operators import apply, apply_unary, check_size
from ssduck.language.value_keys import ATOMS, NUMPYS, equality_key, python_key, tuple_or_vector

# Sums of squares below this may have lost digits: doubles below 2.2e-308 have fewer of them.
LEAST_SQUARE = 1e-290
# More digits than a double has before or after the decimal point, from 5e-324 to 1.8e308.
_MAX_DIGITS = 400


@dataclass(frozen=True)
class Function:
    """A Python function in the language."""

    name: str  # its name in programs
    # The function; lists and dicts are copied before and after a call. NumPy's numbers and booleans
    # in its results become Python's, and tuples of numbers lists.
    call: Callable[..., Any]
    help: str  # the text of `help('name')` after the name
    min_arguments: int  # the least number of arguments
    max_arguments: int | None  # the largest number of arguments; None for any number
    builtin: bool = False  # whether it is a part of the language
    hints: object = None  # the types in its signature, for SQL; None if SQL cannot call it

    @classmethod
    def of(
        cls, name: str, call: Callable[..., Any], help: str | None = None, hints: object = None
    ) -> Function:
        """Returns a user's function; its arity is that of its signature."""
        min_arguments, max_arguments = _arity(call)
        text = help if help is not None else inspect.getdoc(call) or f"Usage: {name}(...)"
        return cls(name, call, text, min_arguments, max_arguments, hints=hints)

    def __call__(self, arguments: Sequence[Any]) -> Any:
        """Calls the function."""
        try:
            if self.builtin:  # these do not change their arguments
                value = self.call(*arguments)
                return value.item() if isinstance(value, NUMPYS) else value
            value = self.call(*map(_copied, arguments))
            return value if type(value) in ATOMS else _plain_result(value)
        except (LimitError, RecursionError):
            raise
        except SelectScriptError as error:
            if not self.builtin:
                raise self._function_error(error, first_line(error.message)) from error
            if isinstance(error, ArgumentError) and error.span is None:
                raise ArgumentError(f"{self.name}: {error.message}") from error
            raise
        except Exception as error:
            if not self.builtin:
                raise self._function_error(error, error_text(error)) from error
            raise ArgumentError(self._refusal_message(arguments)) from error

    def _refusal_message(self, arguments: Sequence[Any]) -> str:
        """Returns the message for arguments that a built-in function does not take."""
        values_text = ", ".join(map(argument_in_words, arguments)) or "no arguments"
        # "Returns ….\nUsage: pow(base, exponent) -> number" has "pow(base, exponent)".
        usage = self.help.rpartition("Usage: ")[2].partition(" -> ")[0]
        instead = ""
        has_lists = any(type(one) is list and list in map(type, one) for one in arguments)
        if self.name in ("avg", "sum") and has_lists:
            rows = "(SELECT x(this) FROM … AS list)"
            instead = f"; of each number write {self.name}{rows}, …"
        return f"{self.name} does not take {values_text}: {usage}{instead}"

    def _function_error(self, error: Exception, why: str) -> FunctionError:
        return FunctionError(f"{self.name}: {type(error).__name__}: {why}")


def _copied(value: Any) -> Any:
    """Returns a copy of a list or a dict, and of what is in it; handles stay what they are."""
    if type(value) is list:
        return [part if type(part) in ATOMS else _copied(part) for part in value]
    if type(value) is dict:
        return {key: _copied(element) for key, element in value.items()}
    return copy.deepcopy(value) if isinstance(value, list | dict) else value


def _plain_result(value: Any) -> Any:
    """Returns the result of a function as `python_value` does, with lists copied."""
    if type(value) is list:
        return [part if type(part) in ATOMS else _plain_result(part) for part in value]
    if type(value) is tuple:
        return tuple_or_vector([p if type(p) in ATOMS else _plain_result(p) for p in value])
    if type(value) is dict:
        return {python_key(key): _plain_result(element) for key, element in value.items()}
    return value.item() if isinstance(value, NUMPYS) else value


def _arity(call: Callable[..., Any]) -> tuple[int, int | None]:
    """Returns the least and the largest number of arguments by position; None for any number."""
    if isinstance(call, FunctionType) and not vars(call):  # no decorator gave it a signature
        code, defaults = call.__code__, call.__defaults__ or ()
        is_variadic = bool(code.co_flags & inspect.CO_VARARGS)
        return code.co_argcount - len(defaults), None if is_variadic else code.co_argcount
    try:
        parameters = inspect.signature(call).parameters.values()
    except (TypeError, ValueError):  # some functions in C have no signature
        return 0, None
    positional = [p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    min_arguments = sum(p.default is p.empty for p in positional)
    is_variadic = any(p.kind is p.VAR_POSITIONAL for p in parameters)
    return min_arguments, None if is_variadic else len(positional)


def _uniq(values: list[Any]) -> list[Any]:
    """Returns the distinct values, in order of first appearance."""
    if ATOMS.issuperset(map(type, values)):
        return list(dict.fromkeys(values))
    distinct: dict[Any, Any] = {}
    for value in values:
        distinct.setdefault(equality_key(value), value)
    return list(distinct.values())


def _avg(values: list[Any]) -> Any:
    return sum(values) / len(values)


def _stddev(values: list[float]) -> float | None:  # sqrt(Σ (value - mean)² / (count - 1))
    count = len(values)
    if count <= 1:
        return None
    mean = math.fsum(values) / count
    return math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (count - 1))


def _median(values: list[float]) -> float:
    if any(map(math.isnan, values)):
        return math.nan  # NaN has no place in an order
    ordered, middle = sorted(values), len(values) // 2
    return (ordered[middle] + ordered[~middle]) / 2  # ~middle: as far from the end


def _norm(vector: list[float]) -> float:
    # ((x² + y²) + z²) + …, as SQL adds: the same to the last bit. sum() of Python 3.12 rounds less.
    total = reduce(operator.add, (x * x for x in vector), 0.0)
    is_exact = LEAST_SQUARE <= total < math.inf or not any(vector)
    return math.sqrt(total) if is_exact else math.hypot(*vector)


def _list_function(call: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Returns a function of the elements of a list; the letters of a text are not elements."""

    @wraps(call)  # so that addFunction('sum', sum) of an old program is known to change nothing
    def call_on_list(values: Any) -> Any:
        if isinstance(values, str | bytes):
            raise TypeError("a text is not a list")
        return call(values)

    return call_on_list


def _builtin(name: str, call: Callable[..., Any], about: str, usage: str) -> Function:
    """Returns a built-in function with as many arguments as its usage, as `f(a, b[, c])`."""
    max_arguments = 1 + usage.count(",")
    min_arguments = max_arguments - usage.count("[,")
    return Function(
        name, call, f"{about}\nUsage: {usage}", min_arguments, max_arguments, builtin=True
    )


@wraps(str)
def _text(value: Any) -> str:
    check_size(value)
    return str(value)


def _round(number: float, digits: int | None = None) -> float:
    if digits is not None and abs(digits) > _MAX_DIGITS:
        raise ValueError(f"a number has fewer than {digits} digits")
    return round(number, digits)


def _clip(number: float, low: float, high: float) -> float:
    if isinstance(number, str | list | tuple):
        raise TypeError("only numbers are clipped")
    clipped = min(max(number, low), high)
    return float(clipped) if float in map(type, (number, low, high)) else clipped


_LIST_FUNCTIONS = (
    _builtin(
        "count",
        len,
        "Returns the number of elements of a list, or of characters of a text.",
        "count(list) -> int",
    ),
    *(
        _builtin(name, _list_function(call), about, f"{name}(list) -> {result}")
        for name, call, about, result in (
            ("sum", sum, "Returns the sum of the numbers in a list.", "number"),
            ("min", min, "Returns the least element of a list.", "value"),
            ("max", max, "Returns the greatest element of a list.", "value"),
            ("avg", _avg, "Returns the mean of the numbers in a list.", "float"),
            ("median", _median, "Returns the median of the numbers in a list.", "float"),
            (
                "stddev",
                _stddev,
                (
                    "Returns the standard deviation of the numbers in a list as a sample: the sum "
                    "of squares is divided by their count less one; nothing for one number."
                ),
                "float",
            ),
            (
                "uniq",
                _uniq,
                "Returns the distinct elements of a list, in order of first appearance.",
                "list",
            ),
        )
    ),
)

_NUMBER_FUNCTIONS = tuple(
    _builtin(name, call, f"Returns {result}.", f"{name}(number) -> number")
    for name, call, result in (
        ("abs", abs, "the absolute value of a number"),
        ("sqrt", math.sqrt, "the square root of a number"),
        ("exp", math.exp, "e to the power of a number"),
        ("log", math.log, "the natural logarithm of a number"),
        ("floor", math.floor, "the largest integer that is not above a number"),
        ("ceil", math.ceil, "the smallest integer that is not below a number"),
        ("sin", math.sin, "the sine of an angle in radians"),
        ("cos", math.cos, "the cosine of an angle in radians"),
        ("tan", math.tan, "the tangent of an angle in radians"),
        ("asin", math.asin, "the arc sine of a number, in radians"),
        ("acos", math.acos, "the arc cosine of a number, in radians"),
        ("atan", math.atan, "the arc tangent of a number, in radians"),
        ("tanh", math.tanh, "the hyperbolic tangent of a number, from -1 to 1"),
    )
)

_OTHER_FUNCTIONS = (
    _builtin(
        "round",
        _round,
        "Returns a number rounded to a number of decimal digits, 0 by default.",
        "round(number[, digits]) -> number",
    ),
    _builtin(
        "pow",
        partial(apply, "^"),
        "Returns the base to the power of the exponent.",
        "pow(base, exponent) -> number",
    ),
    _builtin(
        "atan2",
        math.atan2,
        "Returns the angle of the vector (x, y) from the x axis, in radians, from -pi to pi.",
        "atan2(y, x) -> float",
    ),
    _builtin(
        "clip",
        _clip,
        "Returns a number, or the nearer of two limits if it is not between them.",
        "clip(number, low, high) -> number",
    ),
    _builtin(
        "norm",
        _list_function(_norm),
        "Returns the Euclidean norm of a list of numbers: the length of a vector.",
        "norm(list) -> float",
    ),
    _builtin("str", _text, "Returns a value as a text.", "str(value) -> str"),
    _builtin(
        "int",
        int,
        "Returns a number or a text as an integer; digits after the decimal point are cut off.",
        "int(value) -> int",
    ),
    _builtin("float", float, "Returns a number or a text as a float.", "float(value) -> float"),
)

# Without the operators whose names are words of the language; `pow` is above.
_OPERATOR_FUNCTIONS = (
    _builtin("neg", partial(apply_unary, "-"), "Returns -a.", "neg(a) -> number"),
    *(
        _builtin(name, partial(apply, sign), f"Returns a {sign} b.", f"{name}(a, b) -> value")
        for sign, name in BINARY_NAMES.items()
        if not sign.isalpha() and sign != "^"
    ),
)

# The functions of numbers alone.
NUMBER_FUNCTIONS = frozenset(
    (*(f.name for f in _NUMBER_FUNCTIONS), "round", "pow", "atan2", "clip", "int", "float")
)

AGGREGATES: dict[str, Function] = {function.name: function for function in _LIST_FUNCTIONS}

# least(a, b) of SQL is min([a, b]) here, where least itself is over time.
EXTREMES = {"least": "min", "greatest": "max"}

# The margins of AND, of OR and of what has none (ssduck.logic.margins), with the function of a list
# that they are; nothing where a part is nothing, of which `min` and `max` tell as of a mistake.
EXTREMES_OF_MARGINS = {"margin of AND": "min", "margin of OR": "max"}
MARGIN_OF_TRUTH = "margin of truth"
# The second argument of `scale`, which is to be above 0.
UNIT_OF_SCALE = "unit of scale"
# The number of an entity, by which the rows of several are told apart.
NUMBER_OF_ENTITY = "number of entity"


def _unit_of_scale(unit: Any) -> Any:
    if not (validation.is_number(unit) and unit > 0.0):
        message = "the unit is a number above 0, by which the margin is divided"
        raise ArgumentError(f"{message}, not {short_repr(unit)}")
    return unit


BUILTINS: dict[str, Function] = {
    function.name: function
    for function in _LIST_FUNCTIONS + _NUMBER_FUNCTIONS + _OTHER_FUNCTIONS + _OPERATOR_FUNCTIONS
}
for _name, _function in (
    ("margin of AND", lambda margins: None if None in margins else min(margins)),
    ("margin of OR", lambda margins: None if None in margins else max(margins)),
    (MARGIN_OF_TRUTH, lambda holds: holds if holds is None else math.inf if holds else -math.inf),
    (NUMBER_OF_ENTITY, lambda entity: entity.id),
):
    BUILTINS[_name] = Function(_name, _function, "", 1, 1, builtin=True)
BUILTINS[UNIT_OF_SCALE] = Function("scale", _unit_of_scale, "", 1, 1, builtin=True)
