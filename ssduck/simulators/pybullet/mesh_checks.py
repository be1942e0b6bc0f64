"""Checks mesh files that would crash PyBullet, which reads them without a check."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from ssduck.errors import SceneError
from ssduck.simulators.pybullet.collada import collada_fault
from ssduck.simulators.scene_files import long_line_fault

_SCHEME = re.compile(r"(?:package|model|file):/{0,2}")
_VERTEX = re.compile(rb"^[ \t]*v[ \t]", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*f[ \t](.*)$", re.MULTILINE)
# Where PyBullet makes shapes of the faces before, of the vertices that it has read by then.
_GROUP = re.compile(rb"^[ \t]*(?:g|o|usemtl)[ \t]", re.MULTILINE)
# The number of a vertex at the beginning of a corner, before those of its texture and normal.
_CORNER = re.compile(rb"[+-]?[0-9]+")
# PyBullet reads numbers of 32 bits.
_MAX_NUMBER = 2**31 - 1


def check_meshes(model: Path, root: ET.Element) -> None:
    """Checks the OBJ, STL and COLLADA files that a model file names, as far as they are beside it.

    Args:
        model: the model file.
        root: its root element.

    Raises:
        SceneError: a part of one is missing, or a face has a vertex that is not there.
    """
    for name in _names_in(root):
        file = model.parent / name
        if file.suffix.lower() not in _CHECKS or "\0" in name:
            continue
        try:
            status = file.stat()
        except OSError:  # PyBullet says so, or finds it elsewhere
            continue
        fault = _fault_of(file, status.st_mtime_ns, status.st_size)
        if fault:
            raise SceneError(f"{file}: {fault}")


def _names_in(root: ET.Element) -> Iterator[str]:
    """Yields the names of mesh files in a model file, without schemes."""
    for part in root.iter("mesh"):
        for name in (part.get("filename"), part.get("file"), part.findtext("uri")):
            if name:
                yield _SCHEME.sub("", name.strip(), count=1)


@lru_cache(maxsize=64)
def _fault_of(file: Path, _time: int, _size: int) -> str:
    """Returns what is wrong with a mesh file, in words; nothing if it can be read."""
    return _CHECKS[file.suffix.lower()](file) if file.is_file() else "it is no file"


def _obj_fault(file: Path) -> str:
    """Returns what is wrong with an OBJ file, in words; nothing if it can be read."""
    content = file.read_bytes()
    if fault := long_line_fault(content):
        return fault
    faces = [(found.start(), _corners(found[1])) for found in _FACE.finditer(content)]
    if not faces:
        return ""
    faces = [face for face in faces if len(face[1]) > 2]  # PyBullet leaves out the others
    if not faces:
        return "no face has three corners"
    vertices = np.array([found.start() for found in _VERTEX.finditer(content)])
    groups = np.array([found.start() for found in _GROUP.finditer(content)] + [len(content)])
    starts = np.repeat([start for start, _ in faces], [len(corners) for _, corners in faces])
    numbers = np.array([number for _, corners in faces for number in corners])
    # A number below 0 counts back from the face; another one is looked up at the end of its group.
    before = vertices.searchsorted(starts)
    made = vertices.searchsorted(groups[groups.searchsorted(starts)])
    if ((numbers == 0) | (numbers > made) | (numbers < -before)).any():
        return f"a face refers to a missing vertex: there are {len(vertices)} in the file"
    return ""


def _corners(text: bytes) -> list[int]:
    """Returns the numbers of the vertices of a face; 0 for what begins with no number."""
    found = map(_CORNER.match, text.split(b"\0", 1)[0].split())
    return [0 if one is None else _bounded(int(one[0][:12])) for one in found]


def _bounded(number: int) -> int:
    return min(max(number, -_MAX_NUMBER), _MAX_NUMBER)


def _stl_fault(file: Path) -> str:
    """Returns what is wrong with an STL file, in words; nothing if it can be read."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        count = int.from_bytes(stream.read(84)[80:], "little")
    expected = 84 + 50 * count
    if size >= 84 and expected != size and expected % (1 << 32) == size:
        return f"it counts {count:,} triangles in {size:,} bytes"
    return ""


_CHECKS = {".obj": _obj_fault, ".dae": collada_fault, ".stl": _stl_fault}
