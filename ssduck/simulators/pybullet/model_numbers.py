"""Checks the numbers of model files that PyBullet loads as they are."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from xml.etree import ElementTree as ET

from ssduck.errors import SceneError
from ssduck.formatting import short_repr


@dataclass(frozen=True)
class _Rule:
    """What numbers are to be: finite, and a condition on each.

    Attributes:
        least: the least number.
        may_be_zero: whether they may be 0.
        may_be_infinite: whether they may be infinite.
    """

    least: float = -math.inf
    may_be_zero: bool = True
    may_be_infinite: bool = False

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
_LIMIT, _SCALE = _Rule(may_be_infinite=True), _Rule(may_be_zero=False)
# The rules by format, tag and attribute; the attribute of a text is empty.
_RULES: Mapping[str, Mapping[tuple[str, str], _Rule]] = MappingProxyType(
    {
        "urdf": {
            ("mass", "value"): _SIZE,
            **{("inertia", f"i{axes}"): _FINITE for axes in ("xx", "xy", "xz", "yy", "yz", "zz")},
            ("box", "size"): _SIZE,
            **{(tag, "radius"): _SIZE for tag in ("sphere", "cylinder", "capsule")},
            **{(tag, "length"): _SIZE for tag in ("cylinder", "capsule")},
            ("plane", "normal"): _FINITE,
            ("mesh", "scale"): _SCALE,
            ("origin", "xyz"): _FINITE,
            ("origin", "rpy"): _FINITE,
            ("axis", "xyz"): _FINITE,
            **{("limit", name): _LIMIT for name in ("lower", "upper", "effort", "velocity")},
        },
        "sdf": {
            ("mass", ""): _SIZE,
            **{(f"i{axes}", ""): _FINITE for axes in ("xx", "xy", "xz", "yy", "yz", "zz")},
            **{(tag, ""): _SIZE for tag in ("size", "radius", "length")},
            **{(tag, ""): _FINITE for tag in ("pose", "normal", "xyz")},
            ("scale", ""): _SCALE,
            **{(tag, ""): _LIMIT for tag in ("lower", "upper", "effort")},
        },
        "mjcf": {
            ("geom", "size"): _SIZE,
            **{(tag, "pos"): _FINITE for tag in ("geom", "body", "joint")},
            **{(tag, "quat"): _FINITE for tag in ("geom", "body")},
            ("geom", "fromto"): _FINITE,
            ("mesh", "scale"): _SCALE,
            ("joint", "axis"): _FINITE,
            ("joint", "range"): _LIMIT,
        },
    }
)


def check_numbers(format: str, root: ET.Element) -> None:
    """Checks the numbers of a model file.

    PyBullet takes other texts for 0. It takes negative masses and sizes that are no numbers as they
    are, and poses and answers are wrong or unknown then.

    Args:
        format: one of `MODEL_FILES`.
        root: the root element of the file.

    Raises:
        SceneError: a number is not finite, or a mass or a size is negative, or a scale is 0.
    """
    rules = _RULES[format]
    for part in root.iter():
        for (tag, attribute), text in _texts(part):
            rule = rules.get((tag, attribute))
            fault = rule.fault(_numbers(text)) if rule is not None else ""
            if fault:
                what = f"<{tag} {attribute}>" if attribute else f"<{tag}>"
                raise SceneError(f"{what} {fault}: {short_repr(text.strip())}")


def _texts(part: ET.Element) -> Iterator[tuple[tuple[str, str], str]]:
    """Yields the texts of an element, by its tag and the attribute."""
    yield (part.tag, ""), part.text or ""
    for attribute, text in part.attrib.items():
        yield (part.tag, attribute), text


def _numbers(text: str) -> list[float]:
    """Returns the numbers in a text; words that are none are left out."""
    numbers = []
    for word in text.split():
        try:
            numbers.append(float(word))
        except ValueError:
            continue
    return numbers
