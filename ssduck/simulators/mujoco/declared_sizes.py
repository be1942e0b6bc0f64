"""Checks the sizes that an MJCF file declares, before MuJoCo makes what they describe.

A few lines may describe millions of bodies, a texture of gigabytes, or as much memory. MuJoCo then
works until the memory ends, and cannot be interrupted.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ssduck.errors import SceneError
from ssduck.simulators.model_xml import parse_xml

# The largest number of elements of a model, with copies; of pixels, heights and user's numbers.
MAX_ELEMENTS, MAX_NUMBERS = 1_000_000, 100_000_000
# The attributes whose product is a number of bodies or of numbers.
_COUNTS = {
    "replicate": ("count",),
    "composite": ("count",),
    "flexcomp": ("count",),
}
_NUMBERS = {
    "texture": ("width", "height"),
    "hfield": ("nrow", "ncol"),
}
# The attributes of <size> that are numbers of numbers.
_SIZES = ("nuserdata", "nkey", "njmax", "nconmax", "nstack")
_SIZES_EACH = "nuser_"

# The largest number of iterations of a kind in a step, and of those within each other.
MAX_ITERATIONS, MAX_PRODUCT = 10_000, 1_000_000
# The settings of <option> that are numbers of iterations; those of a line are within each other.
_ITERATIONS = (
    ("iterations", "ls_iterations"),
    ("sdf_iterations", "sdf_initpoints"),
    ("noslip_iterations",),
    ("ccd_iterations",),
)


def check_declared_sizes(file: Path) -> None:
    """Checks that an MJCF file, with those that it includes and attaches, is of a usual size.

    Raises:
        SceneError: they describe more.
    """
    if _Models().count(file) > MAX_ELEMENTS:
        raise SceneError(
            f"{file}: the model has more than {MAX_ELEMENTS:,} elements, counting those that "
            "replicate, composite, flexcomp and attach make"
        )


def check_iterations(options: Any, file: Path) -> None:
    """Checks that a step of a model does not iterate for hours.

    Args:
        options: the options of the model as MuJoCo has read them, wherever they are set.
        file: the file of the scene.

    Raises:
        SceneError: it may.
    """
    for names in _ITERATIONS:
        numbers = [getattr(options, name) for name in names]
        for name, number in zip(names, numbers, strict=True):
            if number > MAX_ITERATIONS:
                raise SceneError(
                    f"{file}: <option>: {name} is {number:,}, more than {MAX_ITERATIONS:,}"
                )
        if math.prod(numbers) > MAX_PRODUCT:
            raise SceneError(
                f"{file}: <option>: {' times '.join(names)} is {math.prod(numbers):,}, more than "
                f"{MAX_PRODUCT:,}"
            )


class _Models:
    """Counts the elements of model files, which may attach others."""

    def __init__(self) -> None:
        # The numbers of elements by file; None while a file is counted.
        self._counts: dict[Path, int | None] = {}

    def count(self, file: Path) -> int:
        """Returns the number of elements of a model, at most one more than the bound.

        Raises:
            SceneError: it attaches itself, which MuJoCo would read until the stack overflows.
        """
        key = file.resolve()
        if key not in self._counts:
            self._counts[key] = None
            root = _with_included(file, file, {key})
            attached = {} if root is None else self._attached(root, file)
            # Each is read, and copied wherever it is attached.
            total = sum(attached.values()) + _count(root, file, attached)
            self._counts[key] = min(total, MAX_ELEMENTS + 1)
        count = self._counts[key]
        if count is None:
            raise SceneError(f"{file}: <model>: the model attaches itself")
        return count

    def _attached(self, root: ET.Element, file: Path) -> dict[str, int]:
        """Returns the numbers of elements of the models that a model may attach, by name."""
        counts: dict[str, int] = {}
        for element in root.iter("model"):
            if (name := element.get("file")) is not None:
                place = file.parent / name
                counts[element.get("name") or _model_name(place)] = self.count(place)
        return counts


def _read(file: Path) -> ET.Element | None:
    """Returns the root of a file; None for one that cannot be read, which MuJoCo reports."""
    try:
        return parse_xml(file.read_bytes())
    except (ET.ParseError, OSError, ValueError):
        return None


def _model_name(file: Path) -> str:
    root = _read(file)
    return "" if root is None else root.get("model", "")


def _with_included(file: Path, main: Path, files: set[Path]) -> ET.Element | None:
    """Returns the root of a file, with those of included files within each <include>."""
    root = _read(file)
    for element in [] if root is None else list(root.iter("include")):
        inner = main.parent / element.get("file", "")
        if inner.resolve() not in files:
            files.add(inner.resolve())
            included = _with_included(inner, main, files)
            if included is not None:
                element.append(included)
    return root


def _count(root: ET.Element | None, main: Path, attached: Mapping[str, int]) -> int:
    """Returns the number of elements of a model, with all copies."""
    total = 0
    waiting = [] if root is None else [(root, 1)]
    while waiting:
        element, copies = waiting.pop()
        total += copies
        if total > MAX_ELEMENTS:
            return total
        _check_numbers(element, main)
        copies *= _product(element, _COUNTS.get(element.tag, ()))
        if element.tag in ("composite", "flexcomp"):
            total += copies
            copies = 1
        elif element.tag == "attach":
            total += copies * attached.get(element.get("model", ""), 0)
        waiting += [(child, copies) for child in element]
    return total


def _check_numbers(element: ET.Element, main: Path) -> None:
    names = [(name,) for name in element.attrib if _is_size(element, name)]
    for together in (*names, _NUMBERS.get(element.tag, ())):
        if _product(element, together) > MAX_NUMBERS:
            what = " times ".join(together)
            raise SceneError(f"{main}: <{element.tag}>: {what} is more than {MAX_NUMBERS:,}")


def _is_size(element: ET.Element, name: str) -> bool:
    return element.tag == "size" and (name in _SIZES or name.startswith(_SIZES_EACH))


def _product(element: ET.Element, names: tuple[str, ...]) -> int:
    """Returns the product of the numbers in attributes; what is no number counts as 1."""
    product = 1
    for name in names:
        for word in element.get(name, "").split():
            try:
                number = float(word)
            except ValueError:
                continue
            if math.isfinite(number):
                product *= max(1, int(min(number, 1e12)))
            elif number > 0:
                product *= 10**12
    return product
