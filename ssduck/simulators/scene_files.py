"""Checks that the files of a scene from a stranger are in the folder of the scene.

Simulators differ in where they look for a file: beside the model or the file that includes it, in
folders that `<compiler>` names anywhere, with or without the folders in its name. Every such path
is made of the words between the slashes of names. So whatever can be reached in the folder by these
words, in any order, is to be a file or a folder inside.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal, NoReturn, TypeAlias
from xml.etree import ElementTree as ET

from ssduck.errors import SceneError
from ssduck.formatting import short_repr
from ssduck.simulators.model_xml import parse_xml
from ssduck.simulators.scene_bodies import MODEL_SUFFIXES
from ssduck.simulators.scenes import Scene, scene_file

# What a file is read as, and so which files it names.
Role: TypeAlias = Literal["model", "OBJ", "COLLADA", "materials", "picture"]

_SCHEME = re.compile(r"(?:package|model|file):/{0,2}")
# The elements of URDF files that name a file that is read.
_NAMED = frozenset(("mesh", "texture", "visual", "collision", "cdf"))
# The attributes of any element of MJCF files that name one: of a mesh, a picture, another model.
_MJCF_FILE = re.compile(r"file(?!name)(?:right|left|up|down|front|back)?")
# The elements of MJCF files that name another model, whatever its name ends in.
_MODELS = frozenset(("include", "model"))
# What readers take for other texts: entities, and the pieces of a text.
_UNEQUAL = {b"<!DOCTYPE": "<!DOCTYPE>", b"<![CDATA[": "<![CDATA[]]>"}
# The elements of SDF files whose <uri> is the name of a file.
_WITH_URI = frozenset(("mesh", "heightmap"))
# The attributes of <compiler> in MJCF files that name a folder.
_FOLDERS = ("meshdir", "texturedir", "assetdir")
# The meshes that name other files by the ends of their names.
_MESHES: dict[str, Role] = {".obj": "OBJ", ".dae": "COLLADA"}
# The names of files of materials in OBJ files; trimesh joins lines, and finds the word anywhere.
_MATERIALS = re.compile(r"mtllib([^\n]*)")
_JOINED_LINES = re.compile(r"\\\r?\n")
# The names of pictures in files of materials, after options.
_PICTURES = re.compile(r"(?:^|\s)(?:map_|bump|disp|decal|refl|norm)\S*([^\n]*)", re.IGNORECASE)
_WORD = re.compile(r"\S+")
# The largest length of a name, letters, and number of words of a line that has one.
MAX_NAME, MAX_WORDS = 500, 16
# The greatest size of the files of a scene whose names are read, and of a scene.toml, bytes.
MAX_READ, MAX_TOML = 128 * 2**20, 4 * 2**20
# The greatest number of places where files of such names may be.
MAX_PLACES = 400_000
# The longest piece of a line of OBJ files and of materials that PyBullet reads at once, bytes.
PIECE = 1023
# Where PyBullet looks beside the working directory.
_DATA = ("", "data", "../data", "../../data")


def check_scene_inside(scene: str | Path, folder: Path | None = None) -> None:
    """Checks that the file of a scene is in a folder, before it is read.

    Args:
        scene: the file, or its folder.
        folder: the folder; None for the one that the path of the file names.
    """
    file = scene_file(Path(scene))
    own = Path(os.path.realpath(file.parent if folder is None else folder))
    real = os.path.realpath(file)
    if not Path(real).is_relative_to(own):
        _refuse(file, real, own)
    if file.suffix.lower() == ".toml" and _size(file) > MAX_TOML:
        raise SceneError(f"{file} has more than {MAX_TOML:,} bytes (Limits: files)")


def check_files_inside(scene: Scene) -> tuple[Path, ...]:
    """Checks that a scene names files of its own folder only: models, meshes and textures.

    A simulator looks for a file in other folders, too, if it is not there.

    Returns:
        The files that it may read, and others of such names in the folder.
    """
    files = _SceneFiles(scene.path.resolve().parent)
    for body in scene.bodies:
        if isinstance(body.model, Path):
            files.add_model(body.model.resolve(), scene.path)
    return files.check()


def files_beside(scene: Scene) -> tuple[Path, ...]:
    """Returns the models of a scene, and the files beside them that they name."""
    found: dict[Path, None] = {}
    for body in scene.bodies:
        if isinstance(body.model, Path):
            found[body.model] = None
            found.update(dict.fromkeys(_named_beside(body.model)))
    return tuple(found)


def _named_beside(model: Path) -> Iterator[Path]:
    try:
        root = parse_xml(model.read_bytes(), with_comments=True)
    except (ET.ParseError, OSError, ValueError):
        return  # the simulator tells of it
    for part in root.iter():
        for text in (*part.attrib.values(), part.text or ""):
            name = _SCHEME.sub("", text.strip(), count=1)
            if name and "\0" not in name and os.path.isfile(model.parent / name):  # noqa: PTH113
                yield model.parent / name


@dataclass(frozen=True)
class _NamedFile:
    """A file that has to be there: the file that names it, and the name."""

    source: Path
    name: str
    is_mjcf: bool


class _SceneFiles:
    """The files of a scene by their names."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._words: set[str] = set()
        self._roles: dict[str, set[Role]] = {}
        self._checked: set[tuple[Path, Role]] = set()
        self._required: dict[_NamedFile, None] = {}
        self._model_folders: dict[Path, None] = {}
        self._inner: dict[str, None] = {}
        self._place_count = self._bytes = 0

    def add_model(self, model: Path, source: Path) -> None:
        """Adds a model file that the scene names."""
        if not model.is_relative_to(self._folder):
            _refuse(source, str(model), self._folder)
        self._add_words(str(model.relative_to(self._folder)))
        self._read(model, "model")

    def check(self) -> tuple[Path, ...]:
        """Checks all files that a simulator may read, and returns them."""
        known = -1
        files: tuple[Path, ...] = ()
        while known != len(self._checked):  # a file that is read may name others
            known, files = len(self._checked), tuple(self._reachable())
            for file in files:
                for role in sorted(self._roles.get(_flat(file.name), ())):
                    self._read(file, role)
        for named in self._required:
            self._check_place(named)
        return files

    def _reachable(self) -> Iterator[Path]:
        """Yields the files in the folder whose paths are made of the words."""
        waiting, seen = [self._folder], {self._folder}
        while waiting:
            folder = waiting.pop()
            for name in _names_in_folder(folder):
                if _flat(name) not in self._words:
                    continue
                path = folder / name
                real = Path(os.path.realpath(path))
                if not real.is_relative_to(self._folder):
                    _refuse(path, str(real), self._folder)
                if real.is_dir():
                    waiting += [real] if real not in seen else []
                    seen.add(real)
                elif real.is_file():
                    yield path
                elif real.exists():
                    raise SceneError(f"{path} is no regular file (Limits: files)")

    def _read(self, file: Path, role: Role) -> None:
        """Adds the names in a file, once."""
        if (file, role) in self._checked:
            return
        self._checked.add((file, role))
        self._bytes += 0 if role == "picture" else _size(file)
        if self._bytes > MAX_READ:
            raise SceneError(
                f"{file}: the models of a scene, and the meshes and materials that name other "
                f"files, have at most {MAX_READ:,} bytes in all (Limits: files)"
            )
        match role:
            case "model":
                self._read_model(file)
            case "OBJ":
                text = _text_as_read(file)
                self._add_parts(file, _MATERIALS, text, "materials")
                self._add_parts(file, _MATERIALS, _JOINED_LINES.sub("", text), "materials")
            case "materials":
                self._add_parts(file, _PICTURES, _text_as_read(file), "picture")
            case "COLLADA":
                for part in _root(file).iter("init_from"):
                    self._add_name(file, _SCHEME.sub("", _plain_text(file, part)))

    def _read_model(self, model: Path) -> None:
        """Adds the names of files and folders in a model file."""
        root = _root(model)
        self._model_folders[model.parent] = None
        for part in root.iter("compiler"):
            for key in _FOLDERS:
                if name := part.get(key, ""):
                    self._add_name(model, name)
                    self._inner[name] = None
        is_mjcf = root.tag not in ("robot", "sdf", "gazebo", "world")
        for tag, text in _names_in(model, root):
            self._add_words(text)
            name = _SCHEME.sub("", text, count=1)
            self._add_name(model, name)
            self._required[_NamedFile(model, name, is_mjcf)] = None
            if tag in _MODELS or name.lower().endswith(MODEL_SUFFIXES):
                self._add_role(name, "model")
            for suffix, role in _MESHES.items():
                if name.lower().endswith(suffix):
                    self._add_role(name, role)

    def _add_parts(self, file: Path, pattern: re.Pattern[str], text: str, role: Role) -> None:
        """Adds what readers may take for names in the lines that a pattern finds."""
        for found in pattern.finditer(text):
            for name in _parts(file, found[1]):
                self._add_name(file, name)
                self._add_role(name, role)
                self._check_elsewhere(file, name, [file.parent / name])

    def _add_name(self, source: Path, name: str) -> None:
        self._check_name(source, name)
        self._add_words(name)

    def _add_words(self, name: str) -> None:
        for parts in (name.split("/"), re.split(r"[/\\]", name)):
            self._words.update(_flat(form) for word in parts for form in (word, word.strip()))

    def _add_role(self, name: str, role: Role) -> None:
        for last in (name.rpartition("/")[2], re.split(r"[/\\]", name)[-1]):
            self._roles.setdefault(_flat(last), set()).add(role)

    def _check_name(self, source: Path, name: str) -> None:
        path = PurePosixPath(name.replace("\\", "/"))
        if path.is_absolute() or ".." in path.parts or "\0" in name or ":" in name:
            _refuse(source, name, self._folder)
        if len(name) > MAX_NAME:
            raise SceneError(f"{source}: {short_repr(name)} has more than {MAX_NAME} letters")
        if "%" in name:
            raise SceneError(
                f"{source}: {short_repr(name)} has a %, which PyBullet takes for a format"
            )

    def _check_place(self, named: _NamedFile) -> None:
        """Checks that a file is where a simulator looks first, and not elsewhere, too."""
        names = [named.name]
        folders = [named.source.parent]
        if named.is_mjcf:
            folders += self._model_folders
            names += [f"{inner}/{named.name}" for inner in self._inner]
        bare = re.split(r"[/\\]", named.name)[-1] if named.is_mjcf else named.name
        bares = [bare, *(f"{inner}/{bare}" for inner in self._inner if named.is_mjcf)]
        self._count_places(len(folders) * (len(names) + len(bares)))
        files = [folder / name for folder in folders for name in (*names, *bares)]
        there = [file for file in files if os.path.isfile(file)]  # noqa: PTH113  # of any name
        if not there:
            raise SceneError(
                f"{named.source}: there is no file {short_repr(named.name)} beside it "
                "(Limits: files)"
            )
        for name in names:
            self._check_elsewhere(named.source, name, there)

    def _check_elsewhere(self, source: Path, name: str, files: list[Path]) -> None:
        """Checks that no other file has a name in the working directory or above the folder."""
        places = [Path(data) for data in _DATA] + list(self._folder.parents)
        self._count_places(len(places))
        for place in places:
            other = place / name
            if os.path.exists(other) and not any(_are_same(other, file) for file in files):  # noqa: PTH110
                _refuse(source, str(other), self._folder)

    def _count_places(self, count: int) -> None:
        """Counts places where files may be: to look at each takes some microseconds."""
        self._place_count += count
        if self._place_count > MAX_PLACES:
            raise SceneError(
                f"the files in {self._folder} name so many others, or folders, that these may be "
                f"in more than {MAX_PLACES:,} places (Limits: files)"
            )


def _size(file: Path) -> int:
    """Returns the size of a file, bytes; 0 if there is none, of which its reader tells."""
    try:
        return file.stat().st_size
    except OSError:
        return 0


def _are_same(file: Path, other: Path) -> bool:
    return os.path.exists(other) and file.samefile(other)  # noqa: PTH110


def _names_in_folder(folder: Path) -> list[str]:
    try:
        return sorted(path.name for path in folder.iterdir())
    except OSError as error:  # what cannot be listed may still be opened by its name
        raise SceneError(f"{folder} cannot be read: {error.strerror}") from error


def _root(model: Path) -> ET.Element:
    """Returns the root of a model file."""
    try:
        if not model.is_file():  # a pipe would be waited for
            raise SceneError(f"{model} is no regular file (Limits: files)")
        content = model.read_bytes()
        for word, name in _UNEQUAL.items():
            if word in content:
                raise SceneError(f"{model}: {name} is not allowed (Limits: files)")
        return parse_xml(content, with_comments=True)
    except (ET.ParseError, OSError, ValueError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"{model} cannot be read: {error}") from error


def _names_in(model: Path, root: ET.Element) -> Iterator[tuple[str, str]]:
    """Yields the names of files in a model file, each with its element."""
    for part in root.iter():
        for attribute, name in part.attrib.items():
            is_urdf = attribute == "filename" and part.tag in _NAMED
            if name and (is_urdf or _MJCF_FILE.fullmatch(attribute)):
                yield part.tag, name
        if part.tag in _WITH_URI:
            for uri in part.iterfind("uri"):
                yield part.tag, _plain_text(model, uri)


def _plain_text(model: Path, part: ET.Element) -> str:
    """Returns the text of an element that names a file, as any reader takes it."""
    text = part.text or ""
    if len(part) or text != text.strip():
        whole = "".join(part.itertext())
        raise SceneError(
            f"{model}: <{part.tag}> has blanks, comments or elements beside the name of the file "
            f"{short_repr(whole)} (Limits: files); write the name alone"
        )
    return text


def _parts(file: Path, line: str) -> Iterator[str]:
    """Yields the words of a line, and all that lie side by side: names may have blanks."""
    spans = [word.span() for word in _WORD.finditer(line)]
    if len(spans) > MAX_WORDS:
        raise SceneError(
            f"{file}: {short_repr(line.strip())} has more than {MAX_WORDS} words (Limits: files)"
        )
    for index, (start, _) in enumerate(spans):
        for _, end in spans[index:]:
            yield line[start:end]


def _flat(name: str) -> str:
    """Returns a name in a form that is equal for readers that differ in white space and case."""
    return re.sub(r"\s", " ", name).casefold()


def _text_as_read(file: Path) -> str:
    """Returns the text of a file, then the same as PyBullet reads it, if that is another one."""
    content = file.read_bytes()
    cut = cut_lines(content, PIECE)
    both = content if cut == content else content + b"\n" + cut
    return both.decode("utf-8", errors="surrogateescape")


def cut_lines(content: bytes, size: int) -> bytes:
    """Returns a file as PyBullet reads it: each piece of so many bytes of a line is a line."""
    return re.sub(rb"[^\n]{%d}(?=[^\n])" % size, rb"\g<0>\n", content)


def _refuse(source: Path, name: str, folder: Path) -> NoReturn:
    raise SceneError(
        f"{source}: {short_repr(name)} is not in {folder}, and files elsewhere are not read "
        "(Limits: files); put a copy there"
    )
