"""Reads tables of a TOML file key by key; errors name the file and the key."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

from ssduck import validation
from ssduck.errors import SceneError, nearest

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

# The largest whole number: simulators take 32 bits.
MAX_WHOLE = 2**31 - 1
# The default of required keys.
REQUIRED: Any = object()


class TomlTable:
    """A TOML table that is read key by key, so that unknown keys are found."""

    def __init__(self, path: Path | None, where: str, values: dict[str, Any]) -> None:
        self.path = path
        self.where = where
        self.values = values
        self.read_keys: set[str] = set()

    def fail(self, key: str, reason: str, suggestions: tuple[str, ...] = ()) -> NoReturn:
        """Raises an error about a key."""
        raise SceneError(f"{self.place(key)}: {reason}", suggestions=suggestions)

    def place(self, key: str) -> str:
        """Returns the name of a key with its tables and its file."""
        file = f"{self.path}: " if self.path else ""
        return f"{file}{self.where}.{key}" if self.where else f"{file}{key}"

    def end(self) -> None:
        """Raises an error if there are keys that were not read."""
        for key in self.values:
            if key not in self.read_keys:
                self.fail(key, "there is no such key", nearest(key, self.read_keys))

    def text(self, key: str, default: str = REQUIRED, *, empty: bool = False) -> str:
        """Returns a string; not blank unless `empty` allows it."""

        def fits(value: object) -> bool:
            return isinstance(value, str) and (empty or value.strip() != "")

        return self._get(key, default, fits, "a text")  # type: ignore[no-any-return]

    def flag(self, key: str, default: bool) -> bool:
        """Returns a truth value."""
        return self._get(key, default, lambda value: isinstance(value, bool), "true or false")  # type: ignore[no-any-return]

    def number(
        self,
        key: str,
        default: float = REQUIRED,
        above: float = -math.inf,
        at_least: float = -math.inf,
        below: float = math.inf,
        at_most: float = math.inf,
    ) -> float:
        """Returns a finite number within bounds."""
        value = float(self._get(key, default, _is_number, "a finite number"))
        if value <= above:
            self.fail(key, f"{value:g} is not above {above:g}")
        if value >= below:
            self.fail(key, f"{value:g} is not below {below:g}")
        if value < at_least:
            self.fail(key, f"{value:g} is less than {at_least:g}")
        if value > at_most:
            self.fail(key, f"{value:g} is more than {at_most:g}")
        return value

    def numbers(
        self, key: str, count: int, default: tuple[float, ...] = REQUIRED, *, meaning: str = ""
    ) -> tuple[float, ...]:
        """Returns a tuple of `count` finite numbers; errors name their meaning."""
        expected = f"{count} finite numbers" + (f" ({meaning})" if meaning else "")
        numbers = self._get(key, default, lambda value: _are_numbers(value, count), expected)
        return tuple(map(float, numbers))

    def vector(self, key: str, default: Vector = REQUIRED) -> Vector:
        """Returns three finite numbers."""
        x, y, z = self.numbers(key, 3, default, meaning="x, y, z")
        return (x, y, z)

    def unit_vector(self, key: str) -> Vector:
        """Returns a direction, scaled to unit length."""
        x, y, z = self.vector(key)
        length = math.hypot(x, y, z)
        if length < 1e-9:
            self.fail(key, "not a direction: it has length 0")
        return (x / length, y / length, z / length)

    def quaternion(self, key: str) -> Quaternion:
        """Returns a quaternion, scaled to unit length; one far from unit length is an error."""
        w, x, y, z = self.numbers(key, 4, (1.0, 0.0, 0.0, 0.0), meaning="w, x, y, z")
        length = math.sqrt(w * w + x * x + y * y + z * z)
        if abs(length - 1.0) > 1e-3:
            self.fail(key, f"not a rotation: w, x, y, z have length {length:.4g}, not 1")
        return (w / length, x / length, y / length, z / length)

    def colour(self, key: str, default: tuple[float, ...]) -> tuple[float, ...]:
        """Returns red, green, blue and alpha, from 0 to 1; the alpha of three numbers is 1."""

        def fits(value: Any) -> bool:
            return _are_numbers(value, 3, 4) and all(0.0 <= number <= 1.0 for number in value)

        numbers = self._get(key, default, fits, "3 or 4 numbers from 0 to 1")
        red, green, blue, alpha = (*map(float, numbers), 1.0)[:4]
        return red, green, blue, alpha

    def one_of(self, keys: Sequence[str]) -> str:
        """Returns the one of some keys that the table has; it must have exactly one."""
        present = [key for key in keys if key in self.values]
        self.read_keys.update(present)
        listed = f"one of {', '.join(keys)}"
        if not present:
            for key in self.values:
                near = nearest(key, keys) if key not in self.read_keys else ()
                if near:
                    self.fail(key, "there is no such key", near[:1])
            self.fail(keys[0], f"missing; a body has {listed}")
        if len(present) > 1:
            self.fail(present[1], f"there is {present[0]!r} already; a body has {listed}")
        return present[0]

    def all_numbers(self) -> dict[str, float]:
        """Returns the numbers of all keys."""
        return {key: self.number(key) for key in list(self.values)}

    def whole(
        self, key: str, at_least: float = -MAX_WHOLE, at_most: float = MAX_WHOLE
    ) -> int | None:
        """Returns an integer within bounds; None if the key is missing."""
        if key not in self.values:
            self.read_keys.add(key)
            return None
        value = self.number(key, at_least=at_least, at_most=at_most)
        if not value.is_integer():
            self.fail(key, f"{value:g} is no whole number")
        return int(value)

    def table(self, key: str, expected: str = "a table") -> TomlTable:
        """Returns a table in this one."""
        values = self._get(key, {}, lambda value: isinstance(value, dict), expected)
        return TomlTable(self.path, f"{self.where}.{key}" if self.where else key, values)

    def tables(self, key: str) -> Iterator[TomlTable]:
        """Yields the tables of an array of tables."""

        def fits(value: object) -> bool:
            return isinstance(value, list) and all(isinstance(entry, dict) for entry in value)

        for index, values in enumerate(self._get(key, [], fits, f"tables, written [[{key}]]")):
            yield TomlTable(self.path, f"{key}[{index}]", values)

    def _get(self, key: str, default: Any, fits: Callable[[Any], bool], expected: str) -> Any:
        self.read_keys.add(key)
        if key not in self.values:
            if default is REQUIRED:
                similar = nearest(key, set(self.values) - self.read_keys, 1)
                self.fail(key, f"missing, but there is {similar[0]!r}" if similar else "missing")
            return default
        value = self.values[key]
        if not fits(value):
            self.fail(key, f"expected {expected}, found {value!r}")
        return value


def _are_numbers(values: Any, *counts: int) -> bool:
    return (
        isinstance(values, list | tuple) and len(values) in counts and all(map(_is_number, values))
    )


def _is_number(value: Any) -> bool:
    # math.isfinite would fail on an integer of 400 digits.
    return validation.is_number(value) and -1e300 < value < 1e300
