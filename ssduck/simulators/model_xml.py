"""Model files as XML: read as simulators do, in UTF-8 and without namespaces, and written.

Numbers are written with all digits.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any
from xml.etree import ElementTree as ET
from xml.parsers import expat

import numpy as np

from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import rotation_matrices
from ssduck.simulators.naming import unique_name

# What expat refuses and simulators read over: comments with --, and declarations anywhere.
_READ_OVER = re.compile(r"<!--.*?-->|<\?.*?\?>", re.DOTALL)
_BARE = re.compile(r"&(?!(?:amp|lt|gt|quot|apos|#\w+);)")
# Characters that no XML file can have: names of a world may have them.
_NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")

# What ssduck adds to the MJCF files that it writes, and reads back: a key, which is the state that
# a world begins with, and texts of this name and that of an entity, with the kind of the entity if
# its joints do not tell.
STATE_KEY, KIND_PREFIX = "ssduck", "ssduck kind of "
# MJCF's sizes of primitives, as parts of those of `Geometry`: half lengths.
MJCF_SIZES: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "box": (0.5, 0.5, 0.5),
        "sphere": (1.0,),
        "cylinder": (1.0, 0.5),
        "capsule": (1.0, 0.5),
        "ellipsoid": (1.0, 1.0, 1.0),
    }
)
# The folder of meshes, pictures and heights, beside an MJCF file.
ASSETS = "assets"


# -- reading ---------------------------------------------------------------------------------------


def parse_tolerantly(content: bytes) -> ET.Element:
    """Returns the root of a model file as PyBullet reads it.

    Prefixes stay in names, also those without a namespace. Comments with `--`, declarations
    anywhere, a single `&`, other encodings than UTF-8, and anything behind a null character are
    taken, as by PyBullet.
    """
    try:
        return _parsed(content)
    except expat.ExpatError:
        pass
    content = content.partition(b"\0")[0]  # texts of C end there
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    text = _READ_OVER.sub(lambda found: "\n" * found[0].count("\n"), text)
    try:
        return _parsed(_BARE.sub("&amp;", text).lstrip().encode())
    except expat.ExpatError as error:
        raise ET.ParseError(str(error)) from error


def _parsed(content: bytes) -> ET.Element:
    """Parses XML without namespaces."""
    builder = ET.TreeBuilder()
    parser = expat.ParserCreate("utf-8")  # expat bounds the growth of entities
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(content, True)
    return builder.close()


def number_in(word: str) -> float | None:
    """Returns the number that a word is; None if it is none."""
    try:
        return float(word)
    except ValueError:
        return None


# -- writing ---------------------------------------------------------------------------------------


def add_part(parent: ET.Element, tag: str, /, **values: Any) -> ET.Element:
    """Adds an element with attributes: texts, numbers, or rows of numbers."""
    texts = {key: v if isinstance(v, str) else numbers_text(v) for key, v in values.items()}
    return ET.SubElement(parent, tag, texts)


def numbers_text(numbers: Any) -> str:
    """Returns a number, or several with blanks between them, as a text.

    >>> numbers_text(1), numbers_text((0.1, 2))
    ('1.0', '0.1 2.0')
    """
    return " ".join(map(repr, np.asarray(numbers, np.float64).reshape(-1).tolist()))


def unique_names(names: Iterable[str]) -> list[str]:
    r"""Makes names of a model distinct, not empty, and such that XML can have them.

    >>> unique_names(["leg", "leg", "", "a\0b"])
    ['leg', 'leg_2', '_', 'a_b']
    """
    unique: dict[str, None] = {}
    for name in names:
        unique[unique_name(_NOT_IN_XML.sub("_", name) or "_", unique)] = None
    return list(unique)


def obj_text(vertices: Array, faces: Iterable[Iterable[int]]) -> str:
    """Returns an OBJ file of vertices (n, 3) and the numbers of the corners of faces."""
    lines = ["v " + numbers_text(corner) for corner in vertices]
    lines += ["f " + " ".join(str(int(corner) + 1) for corner in face) for face in faces]
    return "\n".join(lines) + "\n"


def roll_pitch_yaw(orientation: Array) -> tuple[float, float, float]:
    """Returns roll, pitch and yaw, rad, of a quaternion w, x, y, z: R = Rz(yaw) Ry(pitch) Rx(roll).

    They are arctangents: the arcsine of PyBullet's function loses half of the digits near 90°.
    """
    matrix = rotation_matrices(np.asarray(orientation, dtype=np.float64)[None])[0]
    level = math.hypot(matrix[0, 0], matrix[1, 0])
    pitch = math.atan2(-matrix[2, 0], level)
    if level < 1e-9:  # straight up or down: only the difference of roll and yaw matters
        return math.atan2(-matrix[1, 2], matrix[1, 1]), pitch, 0.0
    roll, yaw = math.atan2(matrix[2, 1], matrix[2, 2]), math.atan2(matrix[1, 0], matrix[0, 0])
    return roll, pitch, yaw
