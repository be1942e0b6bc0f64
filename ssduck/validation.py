"""Checks the arguments of public functions.

NumPy's numbers count as Python's. True, False and texts of digits are not numbers.
Each function takes the value and the name of the argument for the message, such as "run: seconds",
and raises an ArgumentError that has it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from os import PathLike
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError, NumberError, StateError, nearest
from ssduck.formatting import joined_names, short_repr

# More steps than this would take years: the number is a mistake.
MAX_STEPS = 10**12
# The schemas and databases that DuckDB has already.
_SCHEMAS = frozenset(("main", "memory", "temp", "system", "pg_catalog", "information_schema"))
# The largest width and height of a picture, pixels.
MAX_PIXELS = 8192


# -- arguments --------------------------------------------------------------------------------


def no_others(
    given: Mapping[str, object], function: str, known: Sequence[str], instead: Mapping[str, str]
) -> None:
    """Checks that a function was called without other keywords than its own."""
    for name in given:
        told = instead.get(name, f"the arguments are {joined_names(known)}")
        raise ArgumentError(
            f"{function}: there is no argument {name!r}; {told}",
            suggestions=() if name in instead else nearest(name, known),
        )


# -- numbers ----------------------------------------------------------------------------------


def integer(
    value: Any,
    argument: str,
    *,
    minimum: int,
    maximum: int | None = None,
    expected: str | None = None,
) -> int:
    """Returns an integer within bounds, which are included.

    >>> integer(3, "show: rows", minimum=0)
    3
    >>> integer(-1, "show: rows", minimum=0)
    Traceback (most recent call last):
    ssduck.errors.NumberError: show: rows: -1 is no whole number, 0 or more
    """
    if is_integer(value) and minimum <= value and (maximum is None or value <= maximum):
        return int(value)
    if expected is None:
        bounds = f"{minimum} or more" if maximum is None else f"from {minimum} to {maximum:,}"
        expected = f"whole number, {bounds}"
    raise NumberError(f"{argument}: {short_repr(value)} is no {expected}")


def tick_interval(value: Any, argument: str) -> int | None:
    """Returns the number of steps between two ticks, 1 or more, or None."""
    if value is None:
        return None
    return integer(value, argument, minimum=1, expected="number of steps; 1 or more")


def step_count(value: Any, argument: str, call_with_seconds: str) -> int:
    """Returns a number of simulation steps, 0 or more.

    >>> step_count(0.5, "step", "run({})")
    Traceback (most recent call last):
    ssduck.errors.NumberError: step: 0.5 is no whole number of steps; for seconds there is run(0.5)
    """
    if not is_integer(value):
        hint = f"; for seconds there is {call_with_seconds.format(value)}"
        hint = hint if _is_duration(value) else ""
        raise NumberError(f"{argument}: {short_repr(value)} is no whole number of steps{hint}")
    if value < 0:
        raise NumberError(f"{argument}: a simulation cannot run {short_repr(int(value))} steps")
    if value > MAX_STEPS:
        raise NumberError(f"{argument}: {short_repr(int(value))} steps are more than {MAX_STEPS:,}")
    return int(value)


def steps_in(seconds: float, timestep: float, argument: str) -> int:
    """Returns the number of time steps in a duration, rounded to the nearest."""
    count = seconds / timestep + 0.5
    if not count < MAX_STEPS:
        raise NumberError(f"{argument}: {seconds:g} s are more than {MAX_STEPS:,} steps")
    return math.floor(count)


def finite_number(value: Any, argument: str, unit: str) -> float:
    """Returns a finite number; the message names its unit, for example "seconds"."""
    number = as_float(value)
    if number is None or not math.isfinite(number):
        raise NumberError(f"{argument}: {short_repr(value)} is no finite number of {unit}")
    return number


def duration(value: Any, argument: str) -> float:
    """Returns a finite duration of 0 s or more."""
    if not _is_duration(value):
        raise NumberError(f"{argument}: {short_repr(value)} is no time; seconds, 0 or more")
    return float(value)


def positive_number(value: Any, argument: str, expected: str) -> float:
    """Returns a finite number above 0; the message names the expected kind of value."""
    number = as_float(value)
    if number is None or not 0.0 < number < math.inf:
        raise NumberError(f"{argument}: {short_repr(value)} is no {expected}")
    return number


def picture_size(width: Any, height: Any, argument: str) -> tuple[int, int]:
    """Returns the width and height of a picture, pixels."""
    return (
        integer(width, f"{argument}: width", minimum=1, maximum=MAX_PIXELS),
        integer(height, f"{argument}: height", minimum=1, maximum=MAX_PIXELS),
    )


# -- numbers, by messages that state a rule: "spacing is above 0 m, not -1" ---------------------


def number(value: Any, subject: str, unit: str = "") -> float:
    """Returns a finite number.

    >>> number("2", "an age", "seconds")
    Traceback (most recent call last):
    ssduck.errors.ArgumentError: an age is a number of seconds, not '2'
    """
    kind = f"number of {unit}" if unit else "number"
    result = as_float(value)
    if result is None:
        raise ArgumentError(f"{subject} is a {kind}, not {short_repr(value)}")
    if not math.isfinite(result):
        raise ArgumentError(f"{subject} is a finite {kind}, not {short_repr(value)}")
    return result


def seconds(value: Any, subject: str = "an age") -> float:
    """Returns a finite number of seconds, which may be negative."""
    return number(value, subject, "seconds")


def number_list(values: Any, count: int, subject: str, expected: str) -> list[float]:
    """Returns finite numbers from a list, a tuple or an array.

    >>> number_list([1, 2], 3, "size", "[x, y, z]")
    Traceback (most recent call last):
    ssduck.errors.ArgumentError: size is [x, y, z], not [1, 2]
    """
    if isinstance(values, np.ndarray):
        values = values.tolist()
    return [number(value, subject) for value in sequence(values, count, f"{subject} is {expected}")]


def length(value: Any, subject: str) -> float:
    """Returns a finite length above 0 m."""
    result = number(value, subject)
    if result <= 0.0:
        raise ArgumentError(f"{subject} is above 0 m, not {short_repr(value)}")
    return result


def integer_between(value: Any, subject: str, minimum: int, maximum: int) -> int:
    """Returns an integer within bounds, which are included."""
    if not is_integer(value) or not minimum <= value <= maximum:
        raise ArgumentError(
            f"{subject} is a whole number from {minimum} to {maximum}, not {short_repr(value)}"
        )
    return int(value)


def integer_above_0(value: Any, rule: str) -> int:
    """Returns an integer above 0; the message is the rule and the value."""
    if not is_integer(value) or value < 1:
        raise NumberError(f"{rule}, not {short_repr(value)}")
    return int(value)


def number_above_0(value: Any, rule: str, *, may_be_infinite: bool = False) -> float:
    """Returns a number above 0; the message is the rule and the value."""
    result = as_float(value)
    if result is None or not result > 0.0 or not (may_be_infinite or math.isfinite(result)):
        raise NumberError(f"{rule}, not {short_repr(value)}")
    return result


def finite_array(values: Any, count: int, argument: str) -> npt.NDArray[np.float64]:
    """Returns finite numbers as an array of shape (count,).

    >>> finite_array([0, 0, 1], 3, "cup: position")
    array([0., 0., 1.])
    """
    try:
        array = np.asarray(values if are_numbers(values) else (), dtype=np.float64)
    except OverflowError:  # an integer beyond all floats
        array = np.zeros(0)
    if array.shape != (count,) or not np.isfinite(array).all():
        plain = list(values) if isinstance(values, np.ndarray) else values
        raise StateError(f"{argument}: expected {count} finite numbers, found {short_repr(plain)}")
    return array


# -- other values -----------------------------------------------------------------------------


def boolean(value: Any, argument: str) -> bool:
    """Returns True or False; 1 and 0 stand for them.

    >>> boolean(1, "Interpreter: strict")
    True
    """
    if is_boolean(value):
        return bool(value)
    raise ArgumentError(f"{argument}: {short_repr(value)} is not True or False")


def path(value: Any, argument: str) -> str:
    """Returns a path as text."""
    if not isinstance(value, str | PathLike):
        raise ArgumentError(f"{argument}: {short_repr(value)} is no path")
    return str(value)


def instance(value: Any, kind: type, argument: str) -> None:
    """Checks that a value is None or of a class."""
    if value is not None and not isinstance(value, kind):
        raise ArgumentError(f"{argument}: {short_repr(value)} is no {kind.__name__}")


def function(value: Any, argument: str) -> Callable[..., Any]:
    """Returns a callable.

    >>> function(3, "add_trigger: callback")
    Traceback (most recent call last):
    ssduck.errors.ArgumentError: add_trigger: callback: 3 is no function
    """
    if not callable(value):
        raise ArgumentError(f"{argument}: {short_repr(value)} is no function")
    result: Callable[..., Any] = value
    return result


def identifier(value: Any, owner: str) -> str:
    """Returns a name of letters, digits and `_`.

    >>> identifier("2nd", "a variable")
    Traceback (most recent call last):
    ssduck.errors.ArgumentError: '2nd' cannot be a variable's name: letters, digits and _ only
    """
    if not isinstance(value, str) or not value.isidentifier():
        raise ArgumentError(
            f"{short_repr(value)} cannot be {owner}'s name: letters, digits and _ only"
        )
    return value


def world_name(name: Any) -> str:
    """Returns the name of a world, whose tables are a schema of that name."""
    if identifier(name, "a world").casefold() in _SCHEMAS:
        raise ArgumentError(
            f"a world cannot have the name {name!r}: DuckDB has a schema or database so named, "
            "and a world's tables are a schema; choose another name"
        )
    return str(name)


def text(value: Any, rule: str) -> str:
    """Returns a text.

    >>> text(3, "eval takes a text")
    Traceback (most recent call last):
    ssduck.errors.ArgumentError: eval takes a text, not 3
    """
    if not isinstance(value, str):
        raise ArgumentError(f"{rule}, not {short_repr(value)}")
    return value


def sequence(value: Any, length: int, rule: str) -> list[Any] | tuple[Any, ...]:
    """Returns a list or a tuple of a length."""
    if not isinstance(value, list | tuple) or len(value) != length:
        raise ArgumentError(f"{rule}, not {short_repr(value)}")
    return value


def mapping(value: Any, rule: str) -> Mapping[Any, Any]:
    """Returns a dict; an empty one for None."""
    if not isinstance(value, Mapping | None):
        raise ArgumentError(f"{rule}, not as {short_repr(value)}")
    return value or {}


# -- kinds of values --------------------------------------------------------------------------


def are_numbers(values: Any) -> bool:
    """Checks whether values are real numbers in a list, a tuple or a one-dimensional array."""
    if isinstance(values, np.ndarray):
        return values.ndim == 1 and values.dtype.kind in "iuf"
    return isinstance(values, Sequence) and all(map(is_number, values))


def is_integer(value: Any) -> bool:
    """Checks whether a value is of an integer type."""
    return isinstance(value, Integral) and not isinstance(value, bool | np.bool_)


def is_number(value: Any) -> bool:
    """Checks whether a value is of a real number type; infinities and NaN are numbers."""
    return isinstance(value, Real) and not isinstance(value, bool | np.bool_)


def as_float(value: Any) -> float | None:
    """Returns a real number as a float, infinity if it is too large; None for other values."""
    if not is_number(value):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _is_duration(value: Any) -> bool:
    number = as_float(value)
    return number is not None and 0.0 <= number < math.inf


def is_boolean(value: Any) -> bool:
    """Checks whether a value is True, False, 1 or 0."""
    return isinstance(value, bool | np.bool_) or (is_integer(value) and value in (0, 1))
