"""Reads model files as XML, for names and settings that PyBullet does not report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

from ssduck.errors import SceneError
from ssduck.formatting import joined_names, short_repr
from ssduck.simulators.model_xml import parse_tolerantly
from ssduck.simulators.pybullet.bodies import MAX_JOINTS
from ssduck.simulators.pybullet.ignored_parts import (
    check_numbers,
    first_of,
    free_bodies,
    has_unknown_angles,
    ignored_parts,
)
from ssduck.simulators.pybullet.mesh_checks import cut_lines
from ssduck.simulators.pybullet.model_repairs import (
    free_continuous_joints,
    join_numbers,
    names_folders,
    reads_otherwise,
    replace_meshes,
    write_for_pybullet,
)
from ssduck.simulators.pybullet.sdf_frames import place_frames
from ssduck.simulators.scene_bodies import BodySpec

# Elements of SDF files whose text PyBullet reads without a check.
_TEXTS = frozenset(
    (
        *("parent", "child", "pose", "static", "mass", "ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
        *("uri", "scale", "size", "radius", "length", "normal", "diffuse"),
        *("lateral_friction", "rolling_friction", "spinning_friction", "restitution"),
        *("inertia_scaling", "stiffness"),
        *("xyz", "lower", "upper", "effort", "damping", "friction"),
    )
)
# Elements of SDF models that PyBullet does not read.
_UNREAD = ("plugin", "sensor", "surface", "frame", "gripper")
# The length of the longest names of models, links and joints, bytes.
MAX_NAME = 1023
# The longest piece of a line that PyBullet reads at once, bytes.
MAX_LINE = 8191
# The types of MJCF shapes that need a size.
_SIZED = ("box", "sphere", "capsule", "cylinder")


@dataclass(frozen=True, eq=False)
class ModelFile:
    """A model file as XML.

    Attributes:
        file: the path.
        format: one of `MODEL_FILES`.
        root: the root element, as PyBullet is to read it.
        is_other: whether PyBullet would read something else in the file, so that it gets another.
        is_cut: whether PyBullet reads another model in the file, since it cuts long lines.
        left_out: what is left out, in words.
    """

    file: Path
    format: str
    root: ET.Element
    is_other: bool
    is_cut: bool
    left_out: list[str]

    @classmethod
    def read(cls, spec: BodySpec) -> ModelFile:
        """Reads the file of a scene entry."""
        assert isinstance(spec.model, Path)
        try:
            content = spec.model.read_bytes()
            root, is_other = parse_tolerantly(content)
        except (ET.ParseError, OSError, ValueError) as error:
            raise SceneError(f"it cannot be read as XML: {error}") from error
        is_cut = not is_other and _is_cut(content, root)
        is_other |= reads_otherwise(content) | join_numbers(root)
        if spec.source == "sdf":
            is_other |= _fill_texts(root) | place_frames(root)
        elif spec.source == "urdf":
            is_other |= free_continuous_joints(root)
        elif spec.source == "mjcf":
            is_other |= names_folders(root)
        has_changed, left_out = replace_meshes(spec.model, spec.source, root)
        return cls(spec.model, spec.source, root, is_other or has_changed, is_cut, left_out)

    def for_pybullet(self, folder: Path) -> Path:
        """Returns a file in which PyBullet reads what the file means: it, or one in a folder."""
        if not self.is_other:
            return self.file
        return write_for_pybullet(self.file, self.format, self.root, folder)

    def check(self) -> list[str]:
        """Checks that the file does not crash PyBullet; tells what it leaves out or takes for 0."""
        _check_formats(self.root)
        if self.format == "mjcf":
            for world in self.root.iterfind("worldbody"):
                self._check_world(world)
        for model in self._models():
            _check_names([model, *(part for part in model if part.tag in ("link", "joint"))])
            for joint in model.iterfind("joint"):
                if joint.get("type") is None:
                    raise SceneError(f"the joint {joint.get('name')!r} has no type")
            if self.format == "sdf":
                _check_texts(model)
            _check_roots(model)
            _check_count(model, self.format)
        doubts = check_numbers(self.format, self.root)
        if self.is_cut:
            raise SceneError(
                f"PyBullet reads lines in pieces of {MAX_LINE:,} bytes, and would read another "
                "model: write it on several lines"
            )
        return [*first_of(self.left_out, "meshes"), *doubts]

    def _check_world(self, world: ET.Element) -> None:
        """Checks the `<worldbody>` of an MJCF file."""
        _check_names(part for part in world.iter() if part.tag in ("body", "joint", "geom"))
        for tree in world.findall("body"):
            bodies = Counter(body.get("name") for body in tree.iter("body"))
            twice = next((name for name, count in bodies.items() if name and count > 1), None)
            if twice is not None:
                raise SceneError(f"{bodies[twice]} bodies have the name {short_repr(twice)}")
        sizes = (geom.get("size") for geom in self.root.iterfind(".//default/geom"))
        has_default_size = any(sizes)
        for geom in world.iter("geom"):
            if geom.get("type") in _SIZED and geom.get("size") is None and not has_default_size:
                raise SceneError(f"a <geom> of the type {geom.get('type')!r} has no size")
        default = self.root.find("default/joint")
        is_limited = None if default is None else default.get("limited")
        for joint in world.iter("joint"):  # PyBullet takes no range from the defaults
            if joint.get("limited", is_limited) == "true" and joint.get("range") is None:
                raise SceneError(f"the limited joint {joint.get('name', '')!r} has no range")

    def ignored(self, fixed: bool) -> list[str]:
        """Returns what PyBullet ignores or reads otherwise, in words; see `ignored_parts`."""
        parts = ignored_parts(self.format, self.root)
        found = [f"ignores {'; '.join(parts)}"] if parts else []
        if self.format == "mjcf":
            free = [] if fixed else free_bodies(self.root)
            if free:
                found.append(
                    f"leaves {joined_names(free)} free; MuJoCo fixes bodies without a joint, "
                    "as fixed = true does"
                )
            if has_unknown_angles(self.root):
                found.append("takes angles for radians without <compiler>, MuJoCo for degrees")
        return found

    def static_models(self) -> set[int]:
        """Returns the indices of the static models of an SDF file.

        PyBullet reads `1`, but not `true`.
        """
        return {
            number
            for number, model in enumerate(self._models())
            if (model.findtext("static") or "").strip().lower() in ("1", "true")
        }

    def names(self) -> set[str | None]:
        """Returns the names that an MJCF file gives to the bodies and shapes of its world."""
        paths = ("worldbody/body", "worldbody/geom")
        return {part.get("name") for path in paths for part in self.root.iterfind(path)}

    def _models(self) -> list[ET.Element]:
        """Returns the models of a URDF or SDF file that PyBullet loads, in its order."""
        if self.format != "sdf":
            return [self.root] if self.format == "urdf" else []
        world = self.root.find("world")
        return (self.root if world is None else world).findall("model")


def _is_cut(content: bytes, root: ET.Element) -> bool:
    """Checks whether a model is another one as PyBullet reads it, which cuts long lines."""
    cut = cut_lines(content, MAX_LINE)
    if cut == content:
        return False
    try:
        return _told(parse_tolerantly(cut)[0]) != _told(root)
    except (ET.ParseError, ValueError):
        return True


def _told(root: ET.Element) -> list[tuple[str, dict[str, str], list[str]]]:
    """Returns what the elements of a model tell."""
    return [(part.tag, part.attrib, (part.text or "").split()) for part in root.iter()]


def _check_formats(root: ET.Element) -> None:
    """Checks that no text is a format: PyBullet prints texts by C's printf."""
    for part in root.iter():
        texts = [part.tag, *part.attrib, *part.attrib.values()]
        texts += [part.text or ""] if part.tag in _TEXTS else []
        wrong = next((text for text in texts if "%" in text), None)
        if wrong is not None:
            raise SceneError(
                f"<{part.tag}>: {short_repr(wrong)} has a %, which PyBullet takes for a format"
            )


def _check_names(parts: Iterable[ET.Element]) -> None:
    for part in parts:
        name = part.get("name")
        if name == "":
            raise SceneError(f"a <{part.tag}> has an empty name")
        if name is not None and len(name.encode()) > MAX_NAME:
            raise SceneError(
                f"a <{part.tag}> has a name of {len(name.encode())} bytes; at most {MAX_NAME}"
            )


def _fill_texts(root: ET.Element) -> bool:
    """Takes attributes `value`, as in URDF, for texts that are empty; returns whether there are."""
    empty = [part for part in root.iter() if part.tag in _TEXTS and not len(part)]
    filled = [part for part in empty if not (part.text or "").strip() and part.get("value")]
    for part in filled:
        part.text = part.get("value")
    return bool(filled)


def _check_texts(part: ET.Element) -> None:
    """Checks the texts that PyBullet reads in a model of an SDF file."""
    waiting = [part]
    while waiting:  # a file from a stranger may be nested deeply
        part = waiting.pop()
        if part.tag in _UNREAD:
            continue
        if part.tag in _TEXTS and len(part):
            raise SceneError(f"a <{part.tag}> has a <{part[0].tag}> where a text is due")
        if part.tag in _TEXTS and not (part.text or "").strip():
            raise SceneError(f"a <{part.tag}> is empty")
        waiting += reversed(part)


def _check_count(model: ET.Element, format: str) -> None:
    """Checks that PyBullet has room for the joints of a model."""
    count = len(model.findall("joint"))
    if count > MAX_JOINTS:
        other = '; load(…, simulator="mujoco") reads it' if format == "urdf" else ""
        raise SceneError(
            f"the model {model.get('name')!r} has {count} joints, and PyBullet has room for "
            f"{MAX_JOINTS} in a body, fixed ones included{other}"
        )


def _check_roots(model: ET.Element) -> None:
    """Checks that the joints of a model of a URDF or SDF file make its links a tree."""
    links = {link.get("name") for link in model.findall("link")}
    joints = [joint.get("name", "") for joint in model.findall("joint") if joint.get("name")]
    children = [
        child.get("link") or (child.text or "").strip() for child in model.iterfind("joint/child")
    ]
    for what, names in (("joints have the name", joints), ("joints have the child", children)):
        name, count = next(iter(Counter(names).most_common(1)), ("", 0))
        if count > 1:
            raise SceneError(f"{count} {what} {short_repr(name)}")
    roots = sorted(str(name) for name in links - set(children))
    if len(roots) > 1:
        raise SceneError(
            f"the model {model.get('name')!r} has {len(roots)} links without a parent "
            f"({joined_names(roots)}); PyBullet needs joints that connect them"
        )
