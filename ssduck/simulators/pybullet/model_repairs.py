"""Writes model files anew where PyBullet would read other numbers, or cannot read a mesh.

Measured with PyBullet 3.2.7. It separates numbers at blanks, not at tabs and new lines. It knows
OBJ, COLLADA and binary STL files; a file of another kind is an error, an STL file in text, or what
has no faces, a shape without a surface.
"""

from __future__ import annotations

import re
import tempfile
from functools import cache, lru_cache
from pathlib import Path
from xml.etree import ElementTree as ET

from ssduck.errors import SceneError
from ssduck.geometry.mesh_files import load_mesh
from ssduck.simulators.model_xml import obj_text
from ssduck.simulators.pybullet.ignored_parts import named_owner
from ssduck.simulators.pybullet.mesh_checks import find_mesh, is_pointer, is_readable, mesh_fault

# A text of numbers and white space.
_NUMBERS = re.compile(r"[\s\d.eE+-]*\d[\s\d.eE+-]*")
_BREAK = re.compile(r"[\t\n\r]")
_ATTRIBUTE = re.compile(rb"=\s*(?:\"([^\"<]*)\"|'([^'<]*)')")
# What readers of XML take for other texts than PyBullet does: entities, and pieces of a text.
_OTHER_TEXT = re.compile(rb"<!DOCTYPE|<!\[CDATA\[|[^>\s]\s*<!--|-->\s*[^<\s]")
# The attributes of <compiler> in MJCF files that name a folder, by the element of the files.
_FOLDERS = {"mesh": "meshdir", "texture": "texturedir"}


def reads_otherwise(content: bytes) -> bool:
    """Checks whether PyBullet takes an attribute or a text of a model file for another one."""
    if _OTHER_TEXT.search(content):
        return True
    texts = (found[1] or found[2] or b"" for found in _ATTRIBUTE.finditer(content))
    return any(_has_breaks(text.decode(errors="replace")) for text in texts)


def join_numbers(root: ET.Element) -> bool:
    """Separates the numbers in texts of elements by blanks; returns whether one was not so."""
    found = [part for part in root.iter() if part.text and _has_breaks(part.text)]
    for part in found:
        part.text = " ".join((part.text or "").split())
    return bool(found)


def _has_breaks(text: str) -> bool:
    return bool(_BREAK.search(text)) and _NUMBERS.fullmatch(text) is not None


def free_continuous_joints(root: ET.Element) -> bool:
    """Removes the ranges of the continuous joints of a URDF file; returns whether there are any.

    PyBullet keeps them, and URDF does not: a joint from 0 to 0 turns as far as it likes.
    """
    ranges = [
        limit
        for joint in root.iterfind("joint")
        if joint.get("type") == "continuous"
        for limit in joint.iterfind("limit")
        if limit.get("lower") or limit.get("upper")
    ]
    for limit in ranges:
        limit.attrib.pop("lower", None)
        limit.attrib.pop("upper", None)
    return bool(ranges)


def names_folders(root: ET.Element) -> bool:
    """Checks whether an MJCF file names a folder that PyBullet does not find: it adds no slash."""
    return any(
        compiler.get(key) and (key == "assetdir" or not compiler.get(key, "").endswith("/"))
        for compiler in root.iter("compiler")
        for key in ("meshdir", "assetdir")
    )


def replace_meshes(model: Path, format: str, root: ET.Element) -> tuple[bool, list[str]]:
    """Gives PyBullet meshes that it can read: converts others, and leaves out what cannot be read.

    Returns whether the model has changed, and what is left out, in words. A shape that collides
    stays if its file is not there, so that PyBullet refuses the model.
    """
    changed, told = False, []
    parents = {child: parent for parent in root.iter() for child in parent}
    for part in list(root.iter("mesh")):
        name = mesh_name(part, root)
        file = find_mesh(model, name) if name else None
        if not name or (file is not None and is_readable(file)):
            continue
        fault = "it is not there"
        if file is not None:
            if not is_pointer(file) and mesh_fault(file):
                continue  # which is an error
            try:
                _set_name(
                    part, str(_converted(file, (status := file.stat()).st_mtime_ns, status.st_size))
                )
                changed = True
                continue
            except (OSError, ValueError) as error:
                fault = str(error)
                if is_pointer(file):
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
            changed = True
            does = "is not drawn" if shape.tag == "visual" else "does not collide"
            told.append(f"the mesh {name!r} of {named_owner(shape, parents)} {does}: {fault}")
    return changed, told


def write_for_pybullet(model: Path, format: str, root: ET.Element, folder: Path) -> Path:
    """Writes a model into another folder, with the places of its files; returns the new file."""
    for part in root.iter():
        if part.tag in ("mesh", "texture") and (name := mesh_name(part, root)):
            file = find_mesh(model, name)
            if file is not None:
                _set_name(part, str(file))
    if format == "mjcf":
        for compiler in root.iter("compiler"):
            for key in (*_FOLDERS.values(), "assetdir"):
                compiler.attrib.pop(key, None)
    path = folder / "model"  # without an ending: it is no file of the scene
    ET.indent(root)
    ET.ElementTree(root).write(path, encoding="utf-8")
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
