"""Arguments, checked before anything happens: of public functions, and those in programs.

Numbers of numpy count as Python's. True and False are no numbers, and a text that looks like
a number is none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError, NumberError, StateError
from ssduck.formatting import shown

# More steps than that take years: the number is a mistake.
MOST_STEPS = 10**12
# Pictures are at most that wide and high, pixels.
MOST_PIXELS = 8192


def whole(
    value: Any, what: str, *, least: int, most: int | None = None, kind: str | None = None
) -> int:
    """A whole number within bounds, both included.

    Args:
        value: what was given.
        what: which argument of which function it is; the message begins with it.
        least: the lower bound.
        most: the upper bound; None for none.
        kind: what the message says that it is not, in place of a number within these bounds.

    Raises:
        NumberError: it is no whole number, or not within the bounds.
    """
    if is_whole(value) and least <= value and (most is None or value <= most):
        return int(value)
    bounds = f"{least} or more" if most is None else f"from {least} to {most:,}"
    raise NumberError(f"{what}: {shown(value)} is no {kind or f'whole number, {bounds}'}")


def steps(value: Any, what: str, of_seconds: str) -> int:
    """A number of steps of a simulation, 0 or more.

    Args:
        value: what was given.
        what: which argument of which function it is; the message begins with it.
        of_seconds: the call that takes seconds, {} for them; named where they may be meant.

    Raises:
        NumberError: it is none.
    """
    if not is_whole(value):
        hint = f"; for seconds there is {of_seconds.format(value)}" if _is_time(value) else ""
        raise NumberError(f"{what}: {shown(value)} is no whole number of steps{hint}")
    if value < 0:
        raise NumberError(f"{what}: a simulation cannot run {shown(int(value))} steps")
    if value > MOST_STEPS:
        raise NumberError(f"{what}: {shown(int(value))} steps are more than {MOST_STEPS:,}")
    return int(value)


def steps_in(seconds: float, timestep: float, what: str) -> int:
    """How many steps of a length, s, a time is, rounded to the nearest number.

    Raises:
        NumberError: more than a simulation can run.
    """
    count = seconds / timestep + 0.5
    if not count < MOST_STEPS:
        raise NumberError(f"{what}: {seconds:g} s are more than {MOST_STEPS:,} steps")
    return math.floor(count)


def finite(value: Any, what: str, unit: str) -> float:
    """A finite number; the message calls it by its unit, "seconds" say.

    Raises:
        NumberError: it is none.
    """
    number = as_float(value)
    if number is None or not math.isfinite(number):
        raise NumberError(f"{what}: {shown(value)} is no finite number of {unit}")
    return number


def seconds(value: Any, what: str) -> float:
    """A finite duration, s, that is not negative.

    Raises:
        NumberError: it is none.
    """
    number = as_float(value)
    if number is None or not 0.0 <= number < math.inf:
        raise NumberError(f"{what}: {shown(value)} is no time; seconds, 0 or more")
    return number


def positive(value: Any, what: str, kind: str) -> float:
    """A finite number above 0; the message says which kind of value was expected.

    Raises:
        NumberError: it is none.
    """
    number = as_float(value)
    if number is None or not 0.0 < number < math.inf:
        raise NumberError(f"{what}: {shown(value)} is no {kind}")
    return number


def picture_size(width: Any, height: Any, what: str) -> tuple[int, int]:
    """The width and height of a picture, pixels.

    Raises:
        NumberError: one is no whole number, less than 1 or more than `MOST_PIXELS`.
    """
    sizes = (("width", width), ("height", height))
    wide, high = (
        whole(value, f"{what}: {name}", least=1, most=MOST_PIXELS) for name, value in sizes
    )
    return wide, high


def flag(value: Any, what: str) -> bool:
    """True or False; 1 and 0 stand for them.

    Raises:
        ArgumentError: it is none of these.
    """
    if not isinstance(value, bool | np.bool_) and not (is_whole(value) and value in (0, 1)):
        raise ArgumentError(f"{what}: {shown(value)} is not True or False")
    return bool(value)


def numbers(values: Any) -> bool:
    """Whether these are real numbers in a list, a tuple or an array of one dimension."""
    if isinstance(values, np.ndarray):
        return values.ndim == 1 and values.dtype.kind in "iuf"
    return isinstance(values, Sequence) and all(map(is_real, values))


def finite_array(values: Any, count: int, what: str) -> npt.NDArray[np.float64]:
    """So many finite numbers as an array.

    Raises:
        StateError: they are not; it begins with `what`.
    """
    try:
        array = np.asarray(values if numbers(values) else (), dtype=np.float64)
    except OverflowError:  # a whole number beyond all floats
        array = np.zeros(0)
    if array.shape != (count,) or not np.isfinite(array).all():
        found = list(values) if isinstance(values, np.ndarray) else values
        raise StateError(f"{what}: expected {count} finite numbers, found {shown(found)}")
    return array


# -- arguments in programs: behind AS, in {…} -----------------------------------------------


def number_argument(value: Any, what: str, unit: str = "") -> float:
    """A finite number; `unit` tells of what it is one, " of seconds" say.

    Raises:
        ArgumentError: it is none.
    """
    found = as_float(value)
    if found is None:
        raise ArgumentError(f"{what} is a number{unit}, not {shown(value)}")
    if not math.isfinite(found):
        raise ArgumentError(f"{what} is a finite number{unit}, not {shown(value)}")
    return found


def seconds_argument(value: Any, what: str = "an age") -> float:
    """A finite number of seconds, which may be negative.

    Raises:
        ArgumentError: it is none.
    """
    return number_argument(value, what, " of seconds")


def numbers_argument(values: Any, count: int, what: str, form: str) -> list[float]:
    """So many finite numbers in a list; `form` tells what they are.

    Raises:
        ArgumentError: they are others.
    """
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if not isinstance(values, list | tuple) or len(values) != count:
        raise ArgumentError(f"{what} is {form}, not {shown(values)}")
    return [number_argument(value, what) for value in values]


def length_argument(value: Any, what: str) -> float:
    """A length above 0, m.

    Raises:
        ArgumentError: it is none.
    """
    length = number_argument(value, what)
    if length <= 0.0:
        raise ArgumentError(f"{what} is above 0 m, not {shown(value)}")
    return length


def whole_argument(value: Any, what: str, least: int, most: int) -> int:
    """A whole number between two, both included.

    Raises:
        ArgumentError: it is none.
    """
    if not is_whole(value) or not least <= value <= most:
        raise ArgumentError(f"{what} is a whole number from {least} to {most}, not {shown(value)}")
    return int(value)


# -- kinds of values ------------------------------------------------------------------------


def _is_time(value: Any) -> bool:
    number = as_float(value)
    return number is not None and 0.0 <= number < math.inf


def is_whole(value: Any) -> bool:
    """Whether it is a whole number by its type."""
    return isinstance(value, Integral) and not isinstance(value, bool | np.bool_)


def is_real(value: Any) -> bool:
    """Whether it is a real number by its type; infinities and NaN are."""
    return isinstance(value, Real) and not isinstance(value, bool | np.bool_)


def as_float(value: Any) -> float | None:
    """A real number as a float, one that is too large as infinity; None for anything else."""
    if not is_real(value):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
