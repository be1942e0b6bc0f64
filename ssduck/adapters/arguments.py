"""The arguments behind AS, checked."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ssduck import validation
from ssduck.errors import ArgumentError
from ssduck.formatting import shown


def number(value: Any, what: str) -> float:
    """A finite number.

    Raises:
        ArgumentError: it is none.
    """
    found = validation.as_float(value)
    if found is None:
        raise ArgumentError(f"{what} is a number, not {shown(value)}")
    if not math.isfinite(found):
        raise ArgumentError(f"{what} is a finite number, not {shown(value)}")
    return found


def numbers(values: Any, count: int, what: str, form: str) -> list[float]:
    """So many finite numbers in a list; `form` tells what they are.

    Raises:
        ArgumentError: they are others.
    """
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if not isinstance(values, list | tuple) or len(values) != count:
        raise ArgumentError(f"{what} is {form}, not {shown(values)}")
    return [number(value, what) for value in values]


def positive(value: Any, what: str) -> float:
    """A length above 0, m.

    Raises:
        ArgumentError: it is none.
    """
    length = number(value, what)
    if length <= 0.0:
        raise ArgumentError(f"{what} is above 0 m, not {shown(value)}")
    return length


def whole(value: Any, what: str, least: int, most: int) -> int:
    """A whole number between two, both included.

    Raises:
        ArgumentError: it is none.
    """
    if not validation.is_whole(value) or not least <= value <= most:
        raise ArgumentError(f"{what} is a whole number from {least} to {most}, not {shown(value)}")
    return int(value)
