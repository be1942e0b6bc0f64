"""Checks that the files of a scene from a stranger are in the folder of the scene."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import NoReturn
from xml.etree import ElementTree as ET

from ssduck.errors import SceneError
from ssduck.formatting import short_repr
from ssduck.simulators.scene_bodies import MODEL_SUFFIXES
from ssduck.simulators.scenes import Scene

_SCHEME = re.compile(r"(?:package|model|file):/{0,2}")
# The elements of URDF files that name a file that is read.
_NAMED = frozenset(("mesh", "texture", "visual", "collision"))
# The attributes of any element of MJCF files that name one: of a mesh, a picture, another model.
_MJCF_FILE = re.compile(r"file(?!name)(?:right|left|up|down|front|back)?")
# The elements of SDF files whose text is the name of a file.
_URI = (".//mesh/uri", ".//heightmap/uri")
# The attributes of <compiler> in MJCF files that name a folder.
_FOLDERS = ("meshdir", "texturedir", "assetdir")
# The keys of materials that end in the name of a picture.
_PICTURES = ("map_", "bump", "disp", "decal", "refl", "norm")


def check_files_inside(scene: Scene) -> None:
    """Checks that a scene names files of its own folder only: models, meshes and textures.

    A simulator looks for a file in other folders, too, if it is not there.

    Raises:
        SceneError: a file is elsewhere, or a model file cannot be checked.
    """
    folder = scene.path.resolve().parent
    for body in scene.bodies:
        if isinstance(body.model, Path):
            if not body.model.resolve().is_relative_to(folder):
                _refuse(scene.path, str(body.model), folder)
            _check_model(body.model, folder, set())


def _check_model(model: Path, folder: Path, checked: set[Path]) -> None:
    """Checks the files that a model file names, and those that included ones name.

    Args:
        model: the model file.
        folder: the folder of the scene.
        checked: the model files that were checked; receives this one.
    """
    if model in checked:
        return
    checked.add(model)
    try:
        content = model.read_bytes()
        if b"<!DOCTYPE" in content:  # readers differ in what they take entities for
            raise SceneError(f"{model}: <!DOCTYPE> is not allowed (Limits: files)")
        root = ET.fromstring(content)  # noqa: S314  # without <!DOCTYPE>, it has no entities
    except (ET.ParseError, OSError, ValueError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"{model} cannot be read: {error}") from error
    compilers = root.findall(".//compiler")
    inner = [part.get(key, "") for part in compilers for key in _FOLDERS if part.get(key)]
    places = [model.parent]
    for name in inner:
        _check_name(model, name, folder)
        places.append(model.parent / name)
    for name in _names_in(root):
        file = _file_inside(model, name, places, folder)
        if file.suffix.lower() == ".obj":
            _check_materials(file, folder)
        elif file.suffix.lower() in MODEL_SUFFIXES:
            _check_model(file.resolve(), folder, checked)


def _names_in(root: ET.Element) -> Iterator[str]:
    """Yields the names of files in a model file, without schemes."""
    for part in root.iter():
        for attribute, name in part.attrib.items():
            is_urdf = attribute == "filename" and part.tag in _NAMED
            if name and (is_urdf or _MJCF_FILE.fullmatch(attribute)):
                yield _SCHEME.sub("", name, count=1)
    for path in _URI:
        for part in root.iterfind(path):
            yield _SCHEME.sub("", (part.text or "").strip(), count=1)


def _file_inside(model: Path, name: str, places: Iterable[Path], folder: Path) -> Path:
    """Returns the file of a name in one of some folders, all of which are in a folder."""
    _check_name(model, name, folder)
    files = [place / name for place in places if (place / name).is_file()]
    inside = [file for file in files if file.resolve().is_relative_to(folder)]
    if not files:
        raise SceneError(f"{model}: there is no file {short_repr(name)} beside it (Limits: files)")
    # A simulator may look into the working directory first.
    other = Path(name)
    if inside != files or (other.exists() and not other.samefile(inside[0])):
        _refuse(model, name, folder)
    return inside[0]


def _check_name(source: Path, name: str, folder: Path) -> None:
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts or "\0" in name or ":" in name:
        _refuse(source, name, folder)


def _check_materials(mesh: Path, folder: Path) -> None:
    """Checks the files of materials that a mesh names, and the pictures that these name."""
    for line in _lines(mesh):
        if line[:1] == ["mtllib"]:
            for name in line[1:]:
                _check_name(mesh, name, folder)
                materials = mesh.parent / name
                if not materials.resolve().is_relative_to(folder):
                    _refuse(mesh, name, folder)
                for key, *words in _lines(materials) if materials.is_file() else ():
                    if key.lower().startswith(_PICTURES) and words:
                        _check_name(materials, words[-1], folder)


def _lines(file: Path) -> Iterator[list[str]]:
    """Yields the words of each line that has some."""
    for line in file.read_text("utf-8", errors="replace").splitlines():
        if words := line.split():
            yield words


def _refuse(source: Path, name: str, folder: Path) -> NoReturn:
    raise SceneError(
        f"{source}: {short_repr(name)} is not in {folder}, and files elsewhere are not read "
        "(Limits: files); put a copy there"
    )
