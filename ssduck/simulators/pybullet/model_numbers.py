"""Checks the numbers of model files that PyBullet loads as they are."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from xml.etree import ElementTree as ET

from ssduck.errors import SceneError
from ssduck.formatting import short_repr
from ssduck.simulators.pybullet.ignored_parts import named_owner


@dataclass(frozen=True)
class _Rule:
    """What numbers are to be: finite, and a condition on each.

    Attributes:
        least: the least number.
        may_be_zero: whether they may be 0.
        may_be_infinite: whether they may be infinite.
        count: how many there are; of more, PyBullet takes the first.
    """

    least: float = -math.inf
    may_be_zero: bool = True
    may_be_infinite: bool = False
    count: int | None = None

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
    """Checks the numbers of a model file.

    PyBullet takes negative masses and sizes that are no numbers as they are, and poses and answers
    are wrong or unknown then.

    Args:
        format: one of `MODEL_FILES`.
        root: the root element of the file.

    Returns:
        What PyBullet takes for 0, since it is no number, in words.

    Raises:
        SceneError: a number is not finite, or a mass or a size is negative, or a scale is 0, or a
            pose has less than six numbers.
    """
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
