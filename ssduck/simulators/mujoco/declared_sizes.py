"""Checks the sizes that an MJCF file declares, before MuJoCo makes what they describe.

A few lines may describe millions of bodies, a texture of gigabytes, or as much memory. MuJoCo then
works until the memory ends, and cannot be interrupted.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssduck.errors import SceneError
from ssduck.simulators.model_xml import parse_tolerantly

# The largest number of elements of a model, with copies; of pixels, heights, measured values and
# user's numbers, in all; of bytes of MuJoCo's own memory for a step.
MAX_ELEMENTS, MAX_NUMBERS, MAX_MEMORY = 1_000_000, 100_000_000, 4 << 30
# The largest number of files that a model includes, and of models that are attached.
MAX_FILES = 200
# The attributes whose product is a number of bodies.
_COUNTS = {
    "replicate": ("count",),
    "composite": ("count",),
    "flexcomp": ("count", "cellcount"),
}
# A point of <flexcomp> is a body of up to two triangles, or of six tetrahedra; MuJoCo works as long
# for each of them.
_ELEMENTS_OF_A_POINT = {2: 3, 3: 10}
# The attributes whose product is a number of numbers.
_NUMBERS = {
    "texture": ("width", "height", "nchannel"),
    "hfield": ("nrow", "ncol"),
    "numeric": ("size",),
    "global": ("offwidth", "offheight"),
}
# The same, of whatever is within these elements.
_NUMBERS_WITHIN = {"sensor": ("dim", "num", "nsample"), "actuator": ("actdim", "nsample")}
# The textures of which MuJoCo makes six squares.
_CUBES = ("cube", "skybox")
# The places of the numbers in params whose product is a number of points, by the kind of mesh; and
# the numbers of a point, with those of MuJoCo's work: a million points take it some GB or a minute.
# MuJoCo compares each corner of a cone with each.
_POINTS = {
    "plate": (0, 1),
    "wedge": (0, 1),
    "cone": (0, 0),
    "supersphere": (0, 0),
    "supertorus": (0, 0),
}
_NUMBERS_OF_A_POINT = 1000
# The attributes of <size> that are numbers of numbers.
_SIZES = ("nuserdata", "nkey", "njmax", "nconmax", "nstack")
_SIZES_EACH = "nuser_"
_UNITS = {"K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40, "P": 1 << 50, "E": 1 << 60}

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
    """Checks that an MJCF file, with those that it includes and attaches, is of a usual size."""
    size = _Models().size(file)
    if size.elements > MAX_ELEMENTS:
        raise SceneError(
            f"{file}: the model has more than {MAX_ELEMENTS:,} elements, counting those that "
            "replicate, composite, flexcomp and attach make"
        )
    if size.numbers > MAX_NUMBERS:
        raise SceneError(
            f"{file}: the model has more than {MAX_NUMBERS:,} numbers in all, counting those of "
            "textures, meshes, height fields, sensors and actuators"
        )


def check_iterations(options: Any, file: Path) -> None:
    """Checks that a step of a model does not iterate for hours."""
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


@dataclass(frozen=True)
class _Size:
    """Numbers of elements and of numbers, at most one more than the bounds."""

    elements: int = 0
    numbers: int = 0

    def __add__(self, other: _Size) -> _Size:
        return self.plus(other)

    def plus(self, other: _Size, copies: int = 1) -> _Size:
        """Returns this size and copies of another."""
        return _Size(
            min(self.elements + copies * other.elements, MAX_ELEMENTS + 1),
            min(self.numbers + copies * other.numbers, MAX_NUMBERS + 1),
        )


class _Models:
    """Measures model files, which may attach others."""

    def __init__(self) -> None:
        # The sizes by file; None while a file is measured.
        self._sizes: dict[Path, _Size | None] = {}

    def size(self, file: Path) -> _Size:
        """Returns the size of a model."""
        key = file.resolve()
        if key not in self._sizes:
            self._sizes[key] = None
            if len(self._sizes) > MAX_FILES:
                raise SceneError(f"{file}: <model>: more than {MAX_FILES} models are attached")
            files = _Files(file)
            root = files.read(file)
            attached = {} if root is None else self._attached(root, files)
            # Each is read, and copied wherever it is attached.
            own = _Size() if root is None else _size(root, file, attached)
            if root is not None:
                own = own.plus(_Size(numbers=_numbers_of_each(root)), own.elements)
            self._sizes[key] = sum(attached.values(), own)
        size = self._sizes[key]
        if size is None:  # MuJoCo would read it until the stack overflows
            raise SceneError(f"{file}: <model>: the model attaches itself")
        return size

    def _attached(self, root: ET.Element, files: _Files) -> dict[str, _Size]:
        """Returns the sizes of the models that a model may attach, by name."""
        sizes: dict[str, _Size] = {}
        for element in root.iter("model"):
            for place in files.places(element.get("file")):
                name = element.get("name") or _model_name(place)
                sizes[name] = sizes.get(name, _Size()) + self.size(place)
        return sizes


class _Files:
    """The files of a model: the main one, and those that it includes."""

    def __init__(self, main: Path) -> None:
        self._main = main
        # The files that were read, and their folders, in this order.
        self._read: set[Path] = set()
        self._folders: dict[Path, None] = {}

    def places(self, name: str | None) -> list[Path]:
        """Returns the files of a name, as a file of this model may mean them.

        MuJoCo looks beside the main file, then beside that with the name; a backslash is a slash.
        """
        places = [folder / (name or "").replace("\\", "/") for folder in self._folders]
        found = {place.resolve(): place for place in reversed(places) if name and place.is_file()}
        return [*reversed(found.values())]

    def read(self, file: Path) -> ET.Element | None:
        """Returns the root of a file, with those of included files within each <include>."""
        self._read.add(file.resolve())
        self._folders[file.parent] = None
        if len(self._read) > MAX_FILES:
            raise SceneError(f"{self._main}: <include>: more than {MAX_FILES} files are included")
        root = _read(file)
        for element in [] if root is None else list(root.iter("include")):
            for inner in self.places(element.get("file")):
                if inner.resolve() not in self._read:
                    included = self.read(inner)
                    if included is not None:
                        element.append(included)
        return root


def _read(file: Path) -> ET.Element | None:
    """Returns the root of a file; None for one that cannot be read, which MuJoCo reports."""
    try:
        return parse_tolerantly(file.read_bytes())[0]
    except (ET.ParseError, OSError, ValueError):
        return None


def _model_name(file: Path) -> str:
    root = _read(file)
    return "" if root is None else root.get("model", "")


def _size(root: ET.Element, main: Path, attached: Mapping[str, _Size]) -> _Size:
    """Returns the size of a model, with all copies."""
    total = _Size(numbers=_declared_numbers(root, main))
    waiting = [(root, 1)]
    while waiting:
        element, copies = waiting.pop()
        total = total.plus(_Size(elements=1), copies)
        if total.elements > MAX_ELEMENTS:
            return total
        copies *= _product(element, _COUNTS.get(element.tag, ()))
        if element.tag in ("composite", "flexcomp"):
            total = total.plus(_Size(elements=_elements_of_a_point(element)), copies)
            copies = 1
        elif element.tag == "attach":
            total = total.plus(attached.get(element.get("model", ""), _Size()), copies)
        waiting += [(child, copies) for child in element]
    return total


def _elements_of_a_point(element: ET.Element) -> int:
    """Returns how many elements MuJoCo makes for each point of <composite> or <flexcomp>."""
    if element.tag == "composite":
        return 1
    is_solid = len([word for word in element.get("count", "").split() if word != "1"]) > 2
    return _ELEMENTS_OF_A_POINT[3 if is_solid or element.get("dim") == "3" else 2]


def _declared_numbers(root: ET.Element, main: Path) -> int:
    """Returns how many numbers the assets, sensors, actuators and sizes of a model have."""
    within = {
        child: names
        for tag, names in _NUMBERS_WITHIN.items()
        for parent in root.iter(tag)
        for child in parent.iter()
    }
    pixels = max((_product(camera, ("resolution",)) for camera in root.iter("camera")), default=1)
    elements = list(root.iter())
    total = 0
    for element in elements:
        for names, count in _numbers(element, within.get(element, ())):
            _check_bound(count, MAX_NUMBERS, element, names, main)
            total += count
        if element.tag == "rangefinder" and element.get("camera") is not None:
            total += pixels
        if element.tag == "size":
            _check_bound(_memory(element), MAX_MEMORY, element, "memory", main)
    # Any element may be an actuator with the largest default.
    defaults = (child for parent in root.iter("default") for child in parent.iter())
    largest = max((_product(child, _NUMBERS_WITHIN["actuator"]) for child in defaults), default=1)
    return total + len(elements) * (largest - 1)


def _numbers(element: ET.Element, names_within: tuple[str, ...]) -> Iterator[tuple[str, int]]:
    """Yields what an element tells of, and how many numbers that has, if more than one."""
    names = _NUMBERS.get(element.tag, names_within)
    count = _product(element, names)
    if element.tag == "texture" and element.get("type", "cube") in _CUBES:
        count = 6 * _product(element, ("width", "width", "nchannel"))
    elif element.tag == "mesh" and element.get("params") is not None:
        names, words = ("params",), element.get("params", "").split()
        places = _POINTS.get(element.get("builtin", ""), (0,))
        count = _NUMBERS_OF_A_POINT * _number(
            [word for at in places for word in words[at : at + 1]]
        )
    if count > 1:
        yield " times ".join(name for name in names if name in element.attrib), count
    if element.tag == "size":
        for name in element.attrib:
            if name in _SIZES or name.startswith(_SIZES_EACH):
                yield name, _product(element, (name,))


def _numbers_of_each(root: ET.Element) -> int:
    """Returns how many numbers each element may have besides: user's, and those of keys."""
    return sum(
        _product(size, (name,))
        for size in root.iter("size")
        for name in size.attrib
        if name.startswith(_SIZES_EACH) or name == "nkey"
    )


def _check_bound(count: int, bound: int, element: ET.Element, what: str, main: Path) -> None:
    if count > bound:
        raise SceneError(f"{main}: <{element.tag}>: {what} is more than {bound:,}")


def _memory(element: ET.Element) -> int:
    """Returns the bytes that <size> asks for in its attribute memory, as in 10M."""
    text = element.get("memory", "").strip()
    unit = _UNITS.get(text[-1:].upper(), 1)
    return _number([text.rstrip("KMGTPEkmgtpe")]) * unit


def _product(element: ET.Element, names: tuple[str, ...]) -> int:
    """Returns the product of the numbers in attributes."""
    return math.prod(_number(element.get(name, "").split()) for name in names)


def _number(words: list[str]) -> int:
    """Returns the product of numbers; what is no number, or less than 1, counts as 1."""
    product = 1
    for word in words:
        try:
            number = float(word)
        except ValueError:
            continue
        if math.isfinite(number):
            product *= max(1, int(min(number, 1e12)))
        elif number > 0:
            product *= 10**12
    return product
