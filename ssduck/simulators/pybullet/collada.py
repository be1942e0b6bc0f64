"""Checks COLLADA files (.dae), which PyBullet reads without looking whether parts are there."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from ssduck.formatting import short_repr

# The elements that PyBullet looks for, with a prefix.
_PREFIXED = re.compile(
    rb"<[^\s<>/:!?]+:(?:COLLADA|asset|library_\w+|geometry|mesh|source|float_array|accessor|vertices|"
    rb"input|triangles|p|technique_common|visual_scene|node|instance_geometry)[\s/>]"
)
# The largest offset of a number in the indices of a corner.
_MAX_OFFSET = 64


def collada_fault(file: Path) -> str:
    """Returns what would crash PyBullet in a COLLADA file, in words; nothing if it can be read."""
    content = file.read_bytes()
    if b"<!DOCTYPE" in content:  # readers differ in what they take entities for
        return "<!DOCTYPE> is not supported"
    # PyBullet takes the text of an element up to a comment.
    parts = ET.TreeBuilder(insert_comments=True, insert_pis=True)
    try:
        root = ET.fromstring(content, ET.XMLParser(target=parts))  # noqa: S314  # no entities
    except (ET.ParseError, ValueError) as error:
        return f"it is no XML: {error}"
    if _name(root) != "COLLADA":
        return "it has no <COLLADA>"
    if _PREFIXED.search(content):
        return "its elements have a prefix, as in <a:COLLADA>, which PyBullet does not know"
    try:
        for unit in _children(_child(root, "asset"), "unit"):
            _attribute(unit, "meter")
        for scene in _children(root, "scene"):
            for shown in _children(scene, "instance_visual_scene"):
                _attribute(shown, "url")
        for scenes in _children(root, "library_visual_scenes"):
            for scene in _children(scenes, "visual_scene"):
                _attribute(scene, "id")
        for geometry in _children(_child(root, "library_geometries"), "geometry"):
            _attribute(geometry, "id")
            for mesh in _children(geometry, "mesh"):
                _check_mesh(mesh)
    except ValueError as error:
        return str(error)
    return ""


def _check_mesh(mesh: ET.Element) -> None:
    """Checks the triangles of a mesh; PyBullet reads no source of a mesh without any.

    Raises:
        ValueError: a part is missing, or a triangle has a corner that is not there.
    """
    sources = {_attribute(part, "id"): part for part in _children(mesh, "source")}
    vertices = _child(mesh, "vertices")
    if next(_children(mesh, "triangles"), None) is None:
        return
    counts = {name: _row_count(part) for name, part in sources.items()}
    inputs = list(_children(vertices, "input"))
    places = [i for i in inputs if _attribute(i, "semantic") == "POSITION"]
    if not places:
        raise ValueError("<vertices> has no positions")
    for part in inputs:
        _count_of(part, counts)
    counts[_attribute(vertices, "id")] = _count_of(places[0], counts)
    for triangles in _children(mesh, "triangles"):
        _check_triangles(triangles, counts)


def _check_triangles(triangles: ET.Element, counts: Mapping[str, int]) -> None:
    bounds: dict[int, int] = {}
    semantics = set()
    for part in _children(triangles, "input"):
        semantics.add(_attribute(part, "semantic"))
        offset = _number(part, "offset")
        if not 0 <= offset <= _MAX_OFFSET:
            raise ValueError(f"an offset is {offset}")
        bounds[offset] = min(_count_of(part, counts), bounds.get(offset, 1 << 62))
    if "VERTEX" not in semantics:
        raise ValueError("<triangles> has no <input> of vertices")
    width = max(bounds) + 1
    indices = np.array([int(word[:18]) for word in (_child(triangles, "p").text or "").split()])
    if not len(indices):
        raise ValueError("<p> is empty")
    if len(indices) < 3 * width * _number(triangles, "count"):
        raise ValueError("<triangles> has fewer corners than it counts")
    for offset, bound in bounds.items():
        column = indices[offset::width]
        if len(column) and not 0 <= column.min() <= column.max() < bound:
            raise ValueError("a triangle refers to a missing vertex")


def _row_count(source: ET.Element) -> int:
    """Returns the number of points of a <source>."""
    numbers = _child(source, "float_array")
    _attribute(numbers, "id")
    count = len((numbers.text or "").split())
    common = next(_children(source, "technique_common"), None)
    accessor = None if common is None else next(_children(common, "accessor"), None)
    if accessor is None:
        raise ValueError("a <source> has no <accessor>")
    stride = _number(accessor, "stride")
    if stride < 1 or not 0 < _number(numbers, "count") <= count:
        raise ValueError("a <float_array> has not the numbers that it counts")
    return count // stride


def _count_of(part: ET.Element, counts: Mapping[str, int]) -> int:
    """Returns the number of points of the source of an <input>."""
    source = _attribute(part, "source").removeprefix("#")
    if source not in counts:
        raise ValueError(f"there is no <source> {short_repr(source)}")
    return counts[source]


def _name(part: ET.Element) -> str:
    """Returns the name of an element without its namespace."""
    return str(part.tag).rpartition("}")[2]


def _children(part: ET.Element, name: str) -> Iterator[ET.Element]:
    return (child for child in part if _name(child) == name)


def _child(part: ET.Element, name: str) -> ET.Element:
    child = next(_children(part, name), None)
    if child is None:
        raise ValueError(f"<{_name(part)}> has no <{name}>")
    return child


def _attribute(part: ET.Element, key: str) -> str:
    value = part.get(key)
    if not value:
        raise ValueError(f"a <{_name(part)}> has no {key}")
    return value


def _number(part: ET.Element, key: str) -> int:
    return int(_attribute(part, key)[:18])
