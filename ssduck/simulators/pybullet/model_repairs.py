"""Finds mesh files that would crash PyBullet, and writes model files as it is to read them.

Measured with PyBullet 3.2.7. It knows OBJ, COLLADA and binary STL files; a file of another kind is
an error, an STL file in text, or what has no faces, a shape without a surface.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Mapping
from functools import cache, lru_cache
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from ssduck.errors import SceneError
from ssduck.formatting import short_repr
from ssduck.geometry.mesh_files import load_mesh
from ssduck.simulators.model_xml import obj_text

_SCHEME = re.compile(r"(?:package|model|file):/{0,2}")
_VERTEX = re.compile(rb"^[ \t]*v[ \t]", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*f[ \t](.*)$", re.MULTILINE)
# Where PyBullet makes shapes of the faces before, of the vertices that it has read by then.
_GROUP = re.compile(rb"^[ \t]*(?:g|o|usemtl)[ \t]", re.MULTILINE)
# The number of a vertex at the beginning of a corner, before those of its texture and normal.
_CORNER = re.compile(rb"[+-]?[0-9]+")
# A corner: the numbers of a vertex, of its texture and of its normal, from 1 on or from the end.
_NUMBER = rb"[+-]?0*[1-9][0-9]*"
_WORD = re.compile(
    _NUMBER + rb"(?:/|/" + _NUMBER + rb"|/(?:" + _NUMBER + rb")?/" + _NUMBER + rb")?"
)
# PyBullet reads a line of a mesh file in pieces of so many bytes, and one of a model file.
PIECE, MODEL_PIECE = 1023, 8191
# A line that PyBullet may take for several.
_LONG_LINE = re.compile(rb"[^\n]{%d,}" % PIECE)
# The beginning of a line that is no comment.
_TOLD = re.compile(rb"[ \t]*[a-z]")
# The beginning of a file that Git LFS has in place of a large one.
_POINTER = b"version https://git-lfs"
# PyBullet reads numbers of 32 bits.
_MAX_NUMBER = 2**31 - 1


def check_meshes(model: Path, root: ET.Element) -> None:
    """Checks the OBJ, STL and COLLADA files that a model file names, where PyBullet finds them."""
    for part in root.iter("mesh"):
        file = find_mesh(model, mesh_name(part, root))
        if file is not None and (fault := _facts_of(file).fault):
            raise SceneError(f"{file}: {fault}")


def find_mesh(model: Path, name: str) -> Path | None:
    """Returns where PyBullet finds a mesh: beside its model, or in a folder above; else None."""
    name = _SCHEME.sub("", name, count=1)
    if not name or "\0" in name:
        return None
    folders = [*model.absolute().parents, *map(Path, (".", "..", "../.."))]
    places = (folder / name.lstrip("/") for folder in folders)
    return next((place for place in places if os.path.exists(place)), None)  # noqa: PTH110  # any name


class _MeshFacts(NamedTuple):
    fault: str = ""  # what would crash PyBullet, in words; nothing if it can be read
    is_readable: bool = False  # whether PyBullet reads triangles, if it is not damaged
    is_pointer: bool = False  # whether it is a pointer that Git LFS has in place of a large file


def _facts_of(file: Path) -> _MeshFacts:
    try:
        status = file.stat()
        return _facts_of_version(file, status.st_mtime_ns, status.st_size)
    except OSError as error:
        return _MeshFacts(f"it cannot be read: {error.strerror}")


@lru_cache(maxsize=256)
def _facts_of_version(file: Path, _time: int, size: int) -> _MeshFacts:
    suffix = file.suffix.lower()
    if not file.is_file():
        return _MeshFacts("it is no file" if suffix in _CHECKS else "")
    content = file.read_bytes()
    is_pointer = content.startswith(_POINTER)
    match suffix:
        case ".obj":
            is_readable = any(len(_words(face[1])) > 2 for face in _FACE.finditer(content))
        case ".stl":
            is_readable = size == 84 + 50 * _triangle_count(content)
        case _:
            is_readable = suffix == ".dae" and not is_pointer
    fault = _CHECKS[suffix](content) if suffix in _CHECKS else ""
    return _MeshFacts(fault, is_readable, is_pointer)


def _triangle_count(content: bytes) -> int:
    """Returns the number of triangles that the header of a binary STL file tells."""
    return int.from_bytes(content[80:84], "little")


def _obj_fault(content: bytes) -> str:
    """Returns what is wrong with an OBJ file, in words; nothing if it can be read."""
    if fault := _line_fault(content):
        return fault
    lines = [(found.start(), _words(found[1])) for found in _FACE.finditer(content)]
    if not lines:
        return ""
    groups = np.array([found.start() for found in _GROUP.finditer(content)] + [len(content)])
    second = groups[groups.searchsorted(lines[0][0])]
    for start, words in lines:
        # PyBullet ends there, and frees what it has not made if this is behind the first group.
        if start > second and not all(map(_WORD.fullmatch, words)):
            told = short_repr(b" ".join(words).decode(errors="backslashreplace"))
            return f"a face has a corner that is none: {told}"
    faces = [(start, list(map(_vertex, words))) for start, words in lines]
    faces = [face for face in faces if len(face[1]) > 2]  # PyBullet leaves out the others
    if not faces:
        return "no face has three corners"
    vertices = np.array([found.start() for found in _VERTEX.finditer(content)])
    starts = np.repeat([start for start, _ in faces], [len(corners) for _, corners in faces])
    numbers = np.array([number for _, corners in faces for number in corners])
    # A number below 0 counts back from the face; another one is looked up at the end of its group.
    before = vertices.searchsorted(starts)
    made = vertices.searchsorted(groups[groups.searchsorted(starts)])
    if ((numbers == 0) | (numbers > made) | (numbers < -before)).any():
        return f"a face refers to a missing vertex: there are {len(vertices)} in the file"
    return ""


def _line_fault(content: bytes) -> str:
    """Returns that PyBullet would take a line for several that tell of other things, if so."""
    for found in _LONG_LINE.finditer(content):
        line = found[0]
        others = (line[start : start + PIECE] for start in range(PIECE, len(line), PIECE))
        if line.lstrip()[:1] != b"#" or any(map(_TOLD.match, others)):
            number = content.count(b"\n", 0, found.start()) + 1
            return (
                f"line {number} has {len(line):,} bytes, and PyBullet reads lines in pieces of "
                f"{PIECE:,}"
            )
    return ""


def _words(text: bytes) -> list[bytes]:
    """Returns the corners of a face; C's texts end at a null character."""
    return text.split(b"\0", 1)[0].split()


def _vertex(word: bytes) -> int:
    """Returns the number of the vertex of a corner; 0 for what begins with no number."""
    found = _CORNER.match(word)
    number = 0 if found is None else int(found[0][:12])
    return min(max(number, -_MAX_NUMBER), _MAX_NUMBER)


def _stl_fault(content: bytes) -> str:
    """Returns what is wrong with an STL file, in words; nothing if it can be read."""
    size, count = len(content), _triangle_count(content)
    expected = 84 + 50 * count
    if size >= 84 and expected != size and expected % (1 << 32) == size:
        return f"it counts {count:,} triangles in {size:,} bytes"
    return ""


# -- COLLADA ---------------------------------------------------------------------------------------


# The elements that PyBullet looks for, with a prefix.
_PREFIXED = re.compile(
    rb"<[^\s<>/:!?]+:(?:COLLADA|asset|library_\w+|geometry|mesh|source|float_array|accessor|vertices|"
    rb"input|triangles|p|technique_common|visual_scene|node|instance_geometry)[\s/>]"
)
# The largest offset of a number in the indices of a corner.
_MAX_OFFSET = 64


def _collada_fault(content: bytes) -> str:
    """Returns what would crash PyBullet in a COLLADA file, in words; nothing if it can be read."""
    if b"<!DOCTYPE" in content:  # readers differ in what they take entities for
        return "<!DOCTYPE> is not supported"
    # PyBullet takes the text of an element up to a comment.
    parts = ET.TreeBuilder(insert_comments=True, insert_pis=True)
    try:
        root = ET.fromstring(content, ET.XMLParser(target=parts))  # noqa: S314  # no entities
    except (ET.ParseError, ValueError) as error:
        return f"it is no XML: {error}"
    for part in root.iter():
        if isinstance(part.tag, str):  # that of a comment is a function
            part.tag = part.tag.rpartition("}")[2]
    if root.tag != "COLLADA":
        return "it has no <COLLADA>"
    if _PREFIXED.search(content):
        return "its elements have a prefix, as in <a:COLLADA>, which PyBullet does not know"
    try:
        for name in ("asset", "library_geometries"):
            _child(root, name)
        for path, key in _NEEDED.items():
            for part in root.iterfind(path):
                _attribute(part, key)
        for mesh in root.iterfind("library_geometries[1]/geometry/mesh"):
            _check_mesh(mesh)
    except ValueError as error:
        return str(error)
    return ""


# Attributes that PyBullet reads without a check, by the paths of their elements.
_NEEDED = {
    "asset[1]/unit": "meter",
    "scene/instance_visual_scene": "url",
    "library_visual_scenes/visual_scene": "id",
    "library_geometries[1]/geometry": "id",
}


def _check_mesh(mesh: ET.Element) -> None:
    """Checks the triangles of a mesh; PyBullet reads no source of a mesh without any."""
    sources = {_attribute(part, "id"): part for part in mesh.iterfind("source")}
    vertices = _child(mesh, "vertices")
    if mesh.find("triangles") is None:
        return
    counts = {name: _row_count(part) for name, part in sources.items()}
    rows = [(_attribute(i, "semantic"), _count_of(i, counts)) for i in vertices.iterfind("input")]
    positions = [count for semantic, count in rows if semantic == "POSITION"]
    if not positions:
        raise ValueError("<vertices> has no positions")
    counts[_attribute(vertices, "id")] = positions[0]
    for triangles in mesh.iterfind("triangles"):
        _check_triangles(triangles, counts)


def _check_triangles(triangles: ET.Element, counts: Mapping[str, int]) -> None:
    bounds: dict[int, int] = {}
    semantics = set()
    for part in triangles.iterfind("input"):
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
    accessor = source.find("technique_common[1]/accessor")
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


def _child(part: ET.Element, name: str) -> ET.Element:
    child = part.find(name)
    if child is None:
        raise ValueError(f"<{part.tag}> has no <{name}>")
    return child


def _attribute(part: ET.Element, key: str) -> str:
    value = part.get(key)
    if not value:
        raise ValueError(f"a <{part.tag}> has no {key}")
    return value


def _number(part: ET.Element, key: str) -> int:
    return int(_attribute(part, key)[:18])


_CHECKS = {".obj": _obj_fault, ".dae": _collada_fault, ".stl": _stl_fault}


# The attributes of <compiler> in MJCF files that name a folder, by the element of the files.
_FOLDERS = {"mesh": "meshdir", "texture": "texturedir"}
# The elements that name a file which PyBullet reads.
_WITH_FILES = (*_FOLDERS, "cdf")


def named_owner(part: ET.Element, parents: Mapping[ET.Element, ET.Element]) -> str:
    """Returns the name of the nearest named element that has a part, or is it; else nothing."""
    while part.tag in ("robot", "world") or not part.get("name"):
        if part not in parents:
            return ""
        part = parents[part]
    return str(part.get("name"))


def replace_meshes(model: Path, format: str, root: ET.Element) -> list[str]:
    """Gives PyBullet meshes that it can read: converts others, and leaves out what cannot be read.

    Returns what is left out, in words. A shape that collides stays if its file is not there, so
    that PyBullet refuses the model.
    """
    told: list[str] = []
    parents = {child: parent for parent in root.iter() for child in parent}
    for part in list(root.iter("mesh")):
        name = mesh_name(part, root)
        file = find_mesh(model, name) if name else None
        facts = _MeshFacts() if file is None else _facts_of(file)
        if not name or facts.is_readable:
            continue
        fault = "it is not there"
        if file is not None:
            if facts.fault and not facts.is_pointer:
                continue  # which is an error
            try:
                status = file.stat()
                _set_name(part, str(_converted(file, status.st_mtime_ns, status.st_size)))
                continue
            except (OSError, ValueError) as error:
                fault = str(error)
                if facts.is_pointer:
                    fault = f"{file} is a pointer of Git LFS; `git lfs pull` fetches the mesh"
        shape = parents.get(parents.get(part, root), root)  # <visual><geometry><mesh/>
        if format == "mjcf":  # PyBullet tells of what is not there
            told += [f"the mesh {name!r} is left out: {fault}"] if file is not None else []
            continue
        if shape.tag == "collision" and not name.lower().endswith((".obj", ".stl", ".dae")):
            owner = named_owner(shape, parents)
            raise SceneError(f"the mesh {name!r} of {owner} cannot be read: {fault}")
        if shape.tag == "collision" and file is None:
            continue  # which is PyBullet's error
        if shape.tag in ("visual", "collision") and shape in parents:
            parents[shape].remove(shape)
            does = "is not drawn" if shape.tag == "visual" else "does not collide"
            told.append(f"the mesh {name!r} of {named_owner(shape, parents)} {does}: {fault}")
    return told


def write_for_pybullet(model: Path, format: str, root: ET.Element, folder: Path) -> Path:
    """Writes a model into another folder, with the places of its files; returns the new file.

    In the new file, the lines are short, and texts have no comments, entities and the like in them:
    readers of XML take these for other texts than PyBullet does.
    """
    for part in root.iter():
        if part.tag in _WITH_FILES and (name := mesh_name(part, root)):
            file = find_mesh(model, name)
            if file is not None:
                _set_name(part, str(file))
    if format == "mjcf":
        for compiler in root.iter("compiler"):
            for key in (*_FOLDERS.values(), "assetdir"):
                compiler.attrib.pop(key, None)
    path = folder / "model"  # without an ending: it is no file of the scene
    try:
        ET.indent(root)
        content = ET.tostring(root, encoding="utf-8")
    except RecursionError:
        raise SceneError("its nesting is too deep") from None
    longest = max(map(len, content.split(b"\n")))
    if longest > MODEL_PIECE:
        raise SceneError(
            f"an element has {longest:,} bytes: PyBullet reads lines in pieces of "
            f"{MODEL_PIECE:,}, and would read another model"
        )
    path.write_bytes(content)
    return path


def mesh_name(part: ET.Element, root: ET.Element) -> str:
    """Returns the name of the file of a <mesh> or <texture>; empty if it has none."""
    if file := part.get("file"):  # of MJCF
        compilers = list(root.iter("compiler"))
        keys = (_FOLDERS[part.tag], "assetdir")
        folder = next((c.get(k) for k in keys for c in compilers if c.get(k)), "")
        return f"{folder.rstrip('/')}/{file}" if folder else file
    return part.get("filename") or (part.findtext("uri") or "").strip()


def _set_name(part: ET.Element, name: str) -> None:
    uri = part.find("uri")
    if uri is not None:
        uri.text = name
    else:
        part.set("file" if part.get("file") else "filename", name)


@lru_cache(maxsize=256)
def _converted(file: Path, _time: int, _size: int) -> Path:
    """Returns an OBJ file of the triangles of a mesh file."""
    mesh = load_mesh(file, (1.0, 1.0, 1.0))
    path = Path(tempfile.mkdtemp(dir=_folder().name)) / f"{file.stem}.obj"
    path.write_text(obj_text(mesh.vertices, mesh.faces), encoding="utf-8")
    return path


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    """Returns the folder of the converted meshes, which is there as long as the process."""
    return tempfile.TemporaryDirectory(prefix="ssduck")
