"""Finds what PyBullet ignores in model files, and numbers that it loads as they are.

Each entry was measured with PyBullet 3.2.7: a body moves as if its file did not have the part.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from xml.etree import ElementTree as ET

from ssduck.errors import SceneError
from ssduck.formatting import joined_names, short_repr

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
        _, bracket, attribute = path.partition("[@")
        key = attribute.rstrip("]")
        parts = [part for part in root.iterfind(path) if _has_effect(part, key)]
        if parts:
            what = f"<{parts[0].tag} {key}>" if bracket else f"<{parts[0].tag}>"
            found.append(what + _of_owners(parts, parents))
    macros = {part.tag for part in root.iter() if part.tag.startswith("xacro:")}
    found += [f"<{macro}>" for macro in sorted(macros)]
    if format == "urdf":
        floating = [joint for joint in root.iterfind("joint") if joint.get("type") == "floating"]
        found += ["the motion of floating joints" + _of_owners(floating, {})] if floating else []
    return found


def _has_effect(part: ET.Element, key: str) -> bool:
    """Checks whether a part, or an attribute of it, says more than the default."""
    text = part.get(key, "") if key else part.text or ""
    words = text.split()
    return not _NO_EFFECT.issuperset(words) if words else not key


def _of_owners(parts: Iterable[ET.Element], parents: Mapping[ET.Element, ET.Element]) -> str:
    """Returns the names of what has some parts, in words."""
    names = dict.fromkeys(name for part in parts if (name := named_owner(part, parents)))
    return f" of {joined_names(list(names), _MAX_OWNERS)}" if names else ""


def named_owner(part: ET.Element, parents: Mapping[ET.Element, ET.Element]) -> str:
    """Returns the name of the nearest named element that has a part, or is it; else nothing."""
    while part.tag in ("robot", "world") or not part.get("name"):
        if part not in parents:
            return ""
        part = parents[part]
    return str(part.get("name"))


def free_bodies(root: ET.Element) -> list[str]:
    """Returns the names of an MJCF file's bodies without joints, which PyBullet leaves free."""
    bodies = [body for world in root.iterfind("worldbody") for body in world.iterfind("body")]
    return [
        body.get("name") or "a body without a name"
        for body in bodies
        if body.find("joint") is None
        and body.find("freejoint") is None
        and body.find("geom") is not None
    ]


def has_unknown_angles(root: ET.Element) -> bool:
    """Checks whether PyBullet takes the angles of an MJCF file for radians, MuJoCo for degrees."""
    return root.find("compiler") is None and any(
        joint.get("range") is not None and joint.get("type", "hinge") == "hinge"
        for joint in root.iter("joint")
    )


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

# The beginning of a word that C takes for a number.
_BEGINNING = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")
# The greatest number of doubtful numbers, or of meshes, in a warning.
_MAX_TOLD = 5


def check_numbers(format: str, root: ET.Element) -> list[str]:
    """Checks the numbers of a model file; tells, in words, what PyBullet takes for 0."""
    rules = _RULES[format]
    parents = {child: parent for parent in root.iter() for child in parent}
    doubts: dict[str, int] = {}
    for part in root.iter():
        for (tag, attribute), text in _texts(part):
            rule = rules.get((tag, attribute))
            words = text.split()
            if rule is None or not words:
                continue
            what = f"<{tag} {attribute}>" if attribute else f"<{tag}>"
            numbers = [_number(word) for word in words]
            known = [number for number in numbers if number is not None]
            fault = rule.fault(known)
            if format == "sdf" and rule is _POSE and len(words) < 6:
                fault = f"has {len(words)} numbers, not 6"
            if fault:
                raise SceneError(f"{what} {fault}: {short_repr(text.strip())}")
            if doubt := _doubt(rule, words, numbers):
                owner = named_owner(part, parents)
                doubt = f"{what}{owner and f' of {owner}'} {doubt}"
                doubts[doubt] = doubts.get(doubt, 0) + 1
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


def _texts(part: ET.Element) -> Iterator[tuple[tuple[str, str], str]]:
    """Yields the texts of an element, by its tag and the attribute."""
    yield (part.tag, ""), part.text or ""
    for attribute, text in part.attrib.items():
        yield (part.tag, attribute), text


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None
