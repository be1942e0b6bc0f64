"""Reads model files as XML: what PyBullet does not report of them, ignores, or loads as it is.

Each entry of the tables of ignored parts was measured with PyBullet 3.2.7: a body moves as if its
file did not have the part.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from xml.etree import ElementTree as ET

from ssduck.errors import SceneError
from ssduck.formatting import joined_names, short_repr
from ssduck.simulators.model_xml import number_in, parse_tolerantly
from ssduck.simulators.pybullet.bodies import MAX_JOINTS
from ssduck.simulators.pybullet.model_repairs import named_owner, replace_meshes
from ssduck.simulators.pybullet.sdf_frames import place_frames
from ssduck.simulators.scene_bodies import BodySpec

# Where the ignored elements are, in ElementTree's XPath, by format. Attributes are in brackets.
IGNORED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "urdf": (
            ".//mimic",
            ".//transmission",
            ".//gazebo",
            ".//sensor",
            ".//ros2_control",
            ".//safety_controller",
            ".//dynamics[@friction]",
        ),
        "sdf": (
            ".//include",
            ".//light",
            ".//sensor",
            ".//plugin",
            ".//actor",
            ".//physics",
            ".//gripper",
            ".//surface",
            ".//model/model",
            ".//joint/pose",
            ".//axis2",
            ".//axis/dynamics/friction",
            ".//velocity_decay",
            ".//self_collide",
            "./world/gravity",
            "./world/wind",
            "./world/state",
            "./world[2]",
            ".//submesh",
            ".//pose[@relative_to]",
            ".//pose[@frame]",
            ".//xyz[@expressed_in]",
            ".//model[@placement_frame]",
        ),
        "mjcf": (
            *("./include", "./actuator", "./sensor", "./tendon", "./equality", "./contact"),
            *("./keyframe", "./option", "./size", "./extension", "./deformable"),
            *(".//light", ".//camera", ".//composite", ".//flexcomp", ".//frame", ".//replicate"),
            *(".//attach", ".//plugin"),
            *(f".//body[@{turn}]" for turn in ("euler", "axisangle", "zaxis", "xyaxes")),
            *(f".//geom[@{turn}]" for turn in ("euler", "zaxis", "xyaxes")),
            *(f".//geom[@{name}]" for name in ("mass", "density")),
            *(f".//body[@{name}]" for name in ("mocap", "gravcomp")),
            *(f".//joint[@{name}]" for name in ("damping", "stiffness", "armature")),
            *(f".//joint[@{name}]" for name in ("frictionloss", "springref", "ref")),
        ),
    }
)
# The number of named owners of a part in a message.
_MAX_OWNERS = 3
# Values of parts without effect.
_NO_EFFECT = {"0", "0.0", "false"}


def ignored_parts(format: str, root: ET.Element) -> list[str]:
    """Returns the parts of a model file that PyBullet ignores, in words."""
    parents = {child: parent for parent in root.iter() for child in parent}
    found = []
    for path in IGNORED[format]:
        key = path.partition("[@")[2].rstrip("]")
        parts = [part for part in root.iterfind(path) if _has_effect(part, key)]
        if parts:
            what = f"<{parts[0].tag} {key}>" if key else f"<{parts[0].tag}>"
            found.append(what + _of_owners(parts, parents))
    macros = {part.tag for part in root.iter() if part.tag.startswith("xacro:")}
    found += [f"<{macro}>" for macro in sorted(macros)]
    if floating := root.findall("joint[@type='floating']") if format == "urdf" else []:
        found.append("the motion of floating joints" + _of_owners(floating, {}))
    return found


def _has_effect(part: ET.Element, key: str) -> bool:
    """Checks whether a part, or an attribute of it, says more than the default."""
    words = (part.get(key, "") if key else part.text or "").split()
    return not _NO_EFFECT.issuperset(words) if words else not key


def _of_owners(parts: Iterable[ET.Element], parents: Mapping[ET.Element, ET.Element]) -> str:
    """Returns the names of what has some parts, in words."""
    names = dict.fromkeys(name for part in parts if (name := named_owner(part, parents)))
    return f" of {joined_names(list(names), _MAX_OWNERS)}" if names else ""


@dataclass(frozen=True)
class _Rule:
    """What numbers are to be: finite, and a condition on each."""

    least: float = -math.inf
    may_be_zero: bool = True
    may_be_infinite: bool = False
    count: int | None = None  # of more, PyBullet takes the first

    def fault(self, numbers: list[float]) -> str:
        """Returns what is wrong with numbers, in words; nothing if they are right."""
        if any(map(math.isnan, numbers)):
            return "is not a number"
        if not self.may_be_infinite and any(map(math.isinf, numbers)):
            return "is not finite"
        if any(number < self.least for number in numbers):
            return "is negative"
        if not self.may_be_zero and 0.0 in numbers:
            return "is 0"
        return ""


_FINITE, _SIZE = _Rule(), _Rule(least=0.0)
_VECTOR, _POSE = _Rule(count=3), _Rule(count=6)
_NORMAL = _Rule(count=3)
_LIMIT, _SCALE = _Rule(may_be_infinite=True), _Rule(may_be_zero=False)
# The rules by format, tag and attribute; the attribute of a text is empty.
_RULES: Mapping[str, Mapping[tuple[str, str], _Rule]] = MappingProxyType(
    {
        "urdf": {
            ("mass", "value"): _SIZE,
            **{("inertia", f"i{axes}"): _FINITE for axes in ("xx", "xy", "xz", "yy", "yz", "zz")},
            ("box", "size"): _Rule(least=0.0, count=3),
            **{(tag, "radius"): _SIZE for tag in ("sphere", "cylinder", "capsule")},
            **{(tag, "length"): _SIZE for tag in ("cylinder", "capsule")},
            ("plane", "normal"): _NORMAL,
            ("mesh", "scale"): _SCALE,
            ("origin", "xyz"): _VECTOR,
            ("origin", "rpy"): _VECTOR,
            ("axis", "xyz"): _VECTOR,
            ("dynamics", "damping"): _FINITE,
            **{("limit", name): _LIMIT for name in ("lower", "upper", "effort", "velocity")},
        },
        "sdf": {
            ("mass", ""): _SIZE,
            **{(f"i{axes}", ""): _FINITE for axes in ("xx", "xy", "xz", "yy", "yz", "zz")},
            **{(tag, ""): _SIZE for tag in ("size", "radius", "length")},
            ("damping", ""): _FINITE,
            ("pose", ""): _POSE,
            **{(tag, ""): _VECTOR for tag in ("normal", "xyz")},
            ("scale", ""): _SCALE,
            **{(tag, ""): _LIMIT for tag in ("lower", "upper", "effort")},
        },
        "mjcf": {
            ("geom", "size"): _SIZE,
            **{(tag, "pos"): _VECTOR for tag in ("geom", "body", "joint")},
            **{(tag, "quat"): _Rule(count=4) for tag in ("geom", "body")},
            ("geom", "fromto"): _POSE,
            ("mesh", "scale"): _SCALE,
            ("joint", "axis"): _VECTOR,
            ("joint", "range"): _LIMIT,
        },
    }
)

# A text of numbers and white space.
_NUMBERS = re.compile(r"[\s\d.eE+-]*\d[\s\d.eE+-]*")
# The beginning of a word that C takes for a number.
_BEGINNING = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")
# The greatest number of doubtful numbers, or of meshes, in a warning.
_MAX_TOLD = 5


def check_numbers(format: str, root: ET.Element) -> list[str]:
    """Checks the numbers of a model file; tells, in words, what PyBullet takes for 0."""
    rules = _RULES[format]
    parents = {child: parent for parent in root.iter() for child in parent}
    doubts: Counter[str] = Counter()
    for part in root.iter():
        for attribute, text in (("", part.text or ""), *part.items()):
            rule = rules.get((part.tag, attribute))
            words = text.split()
            if rule is None or not words:
                continue
            what = f"<{part.tag} {attribute}>" if attribute else f"<{part.tag}>"
            numbers = [number_in(word) for word in words]
            fault = rule.fault([number for number in numbers if number is not None])
            if format == "sdf" and rule is _POSE and len(words) < 6:
                fault = f"has {len(words)} numbers, not 6"
            if fault:
                raise SceneError(f"{what} {fault}: {short_repr(text.strip())}")
            if doubt := _doubt(rule, words, numbers):
                owner = named_owner(part, parents)
                doubts[f"{what}{owner and f' of {owner}'} {doubt}"] += 1
    told = [text if count == 1 else f"{text} ({count} times)" for text, count in doubts.items()]
    return first_of(told, "numbers")


def first_of(told: list[str], what: str) -> list[str]:
    """Returns the first of many texts, and how many more things there are."""
    omitted = len(told) - _MAX_TOLD
    return told[:_MAX_TOLD] + ([f"{omitted} more such {what}"] if omitted > 0 else [])


def _doubt(rule: _Rule, words: list[str], numbers: list[float | None]) -> str:
    """Returns what PyBullet takes for another number, in words; nothing if all are as they are."""
    if rule is _NORMAL and not any(numbers):
        return ""  # the plane is an error
    if rule.count is not None and len(words) < rule.count:
        return (
            f"has {short_repr(' '.join(words))} for {rule.count} numbers: PyBullet takes 0 for all"
        )
    other = next((w for w, number in zip(words, numbers, strict=True) if number is None), None)
    if other is None:
        return ""
    found = _BEGINNING.match(other)
    taken = f"takes {found[0]}, its beginning," if found else "takes 0"
    return f"has {short_repr(other)}, which is no number: PyBullet {taken} for it"


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
# The types of MJCF shapes that need a size.
_SIZED = ("box", "sphere", "capsule", "cylinder")


@dataclass(frozen=True, eq=False)
class ModelFile:
    """A model file as XML."""

    file: Path  # the path
    format: str  # one of `MODEL_FILES`
    root: ET.Element  # the root element, as PyBullet is to read it
    left_out: list[str]  # what is left out, in words

    @classmethod
    def read(cls, spec: BodySpec) -> ModelFile:
        """Reads the file of a scene entry."""
        assert isinstance(spec.model, Path)
        try:
            root = parse_tolerantly(spec.model.read_bytes())
        except (ET.ParseError, OSError, ValueError) as error:
            raise SceneError(f"it cannot be read as XML: {error}") from error
        is_sdf = spec.source == "sdf"
        # PyBullet separates numbers at blanks, not at tabs and new lines.
        for part in root.iter():
            if part.text and _NUMBERS.fullmatch(part.text):
                part.text = " ".join(part.text.split())
            is_empty = not len(part) and not (part.text or "").strip()
            if is_sdf and part.tag in _TEXTS and is_empty and part.get("value"):
                part.text = part.get("value")  # as in URDF
        if is_sdf:
            place_frames(root)
        elif spec.source == "urdf":
            # PyBullet keeps ranges that URDF does not: such a joint turns as far as it likes.
            for limit in root.iterfind("joint[@type='continuous']/limit"):
                limit.attrib.pop("lower", None)
                limit.attrib.pop("upper", None)
        left_out = replace_meshes(spec.model, spec.source, root)
        return cls(spec.model, spec.source, root, left_out)

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
            count = len(model.findall("joint"))
            if count > MAX_JOINTS:
                other = '; load(…, simulator="mujoco") reads it' if self.format == "urdf" else ""
                raise SceneError(
                    f"the model {model.get('name')!r} has {count} joints, and PyBullet has room "
                    f"for {MAX_JOINTS} in a body, fixed ones included{other}"
                )
        doubts = check_numbers(self.format, self.root)
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
            free = [
                body.get("name") or "a body without a name"
                for body in self.root.iterfind("worldbody/body[geom]")
                if body.find("joint") is None and body.find("freejoint") is None
            ]
            if free and not fixed:
                found.append(
                    f"leaves {joined_names(free)} free; MuJoCo fixes bodies without a joint, "
                    "as fixed = true does"
                )
            joints = self.root.iterfind(".//joint[@range]")
            hinges = [joint for joint in joints if joint.get("type", "hinge") == "hinge"]
            if hinges and self.root.find("compiler") is None:
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
