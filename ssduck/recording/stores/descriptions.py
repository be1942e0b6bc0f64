"""Reads and changes the JSON objects that describe records, and checks their values.

Users edit them, and other programs write them, so that any value may be of any type or missing.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssduck.errors import RecordError, record_error
from ssduck.formatting import short_repr
from ssduck.recording.episode import are_tags
from ssduck.recording.stores.files import (
    CHECKSUM_KEY,
    WRONG_CHECKSUM,
    json_text,
    pop_checksum,
    sole_writer,
    write_json,
)
from ssduck.recording.stores.object_store import ObjectPath, change_object
from ssduck.schema import RECORDED
from ssduck.simulators.scenes import Camera

_ID = re.compile("-".join(f"[0-9a-f]{{{digits}}}" for digits in (8, 4, 4, 4, 12)))


@dataclass(frozen=True)
class Value:
    """A value of a JSON object."""

    expected: str  # a right value, in words
    fits: Callable[[Any], bool]  # checks a value
    is_required: bool = True  # whether the object must have it


# The values of an object, by key. Further keys are those of later versions.
Description = Mapping[str, Value]


def is_whole(value: Any, least: int) -> bool:
    """Checks whether a value is a whole number from `least` on that a double has exactly."""
    return type(value) is int and least <= value < 1 << 53


def is_names(value: Any) -> bool:
    """Checks whether a value is a list of texts."""
    return isinstance(value, list) and all(isinstance(name, str) for name in value)


def _is_parts(value: Any) -> bool:
    return isinstance(value, list) and all(is_whole(number, 0) for number in value)


def _is_id(value: Any) -> bool:
    return isinstance(value, str) and _ID.fullmatch(value) is not None


def _is_tables(value: Any) -> bool:
    """Checks a list of recorded tables, whose names are those of folders."""
    has_right_names = is_names(value) and RECORDED.keys() >= set(value)
    return has_right_names and len(set(value)) == len(value) and {"ticks", "entities"} <= set(value)


def _is_finite(number: Any) -> bool:
    return type(number) in (int, float) and abs(number) < 1e300


def _is_camera(value: Any) -> bool:
    """Checks a camera: it sees something."""
    if not isinstance(value, dict):
        return False
    eye, target, fov = (value.get(name) for name in ("eye", "target", "fov"))
    points = all(
        isinstance(point, list) and len(point) == 3 and all(map(_is_finite, point))
        for point in (eye, target)
    )
    is_angle = isinstance(fov, int | float) and not isinstance(fov, bool) and 0.0 < fov < 180.0
    return points and eye != target and is_angle


TEXT = Value("a text", lambda value: isinstance(value, str))
_OBJECT = Value("an object", lambda value: isinstance(value, dict))
# What describes an episode wherever it is.
_EPISODE = {
    "id": Value("a UUID", _is_id),
    "tags": Value("an object of texts and numbers", are_tags, is_required=False),
    "started": TEXT,
    "recording": _OBJECT,
    "camera": Value("a camera that sees something", _is_camera, is_required=False),
    "order": Value("a number", lambda value: is_whole(value, 0), is_required=False),
}
_COUNT = Value("a number of parts", lambda value: is_whole(value, 0), is_required=False)
# What describes an episode in a folder.
EPISODE: Description = {
    "world": Value("a name", lambda value: isinstance(value, str), is_required=False),
    "episode": Value("a number", lambda value: is_whole(value, 0), is_required=False),
    "key": TEXT,
    "tables": Value("a list of recorded tables, with ticks and entities", _is_tables),
    "parts": Value("an object", lambda value: isinstance(value, dict), is_required=False),
    "checksums": Value("a text", lambda value: isinstance(value, str), is_required=False),
    "removed": Value("a list of parts", _is_parts, is_required=False),
    **_EPISODE,
}
# What it says of the recording, and of the number of complete parts.
RECORDING: Description = {
    "every": Value("a number of ticks", lambda value: is_whole(value, 1), is_required=False),
    "entities": Value(
        "a list of names, or null",
        lambda value: value is None or is_names(value),
        is_required=False,
    ),
}
PARTS: Description = {"ticks": _COUNT, "models": _COUNT}
# What describes an episode in a DuckDB file.
DATABASE_EPISODE: Description = {
    "version": Value("a number", lambda value: is_whole(value, 1)),
    "world": TEXT,
    "complete": Value("true or false", lambda value: isinstance(value, bool)),
    **_EPISODE,
}


def read_description(file: Path) -> dict[str, Any]:
    """Returns the JSON object in a file."""
    if not file.is_file():
        raise RecordError(f"{file} cannot be read: there is no such file")
    try:
        content = file.read_bytes()
    except OSError as error:
        raise record_error(f"{file} cannot be read: {error.strerror}", error) from error
    return checked_description(content, str(file))


def checked_description(content: bytes, source: str) -> dict[str, Any]:
    """Returns the JSON object in the content of a file, whose checksum is right."""
    description = parse_description(content, source)
    if not pop_checksum(description):
        raise RecordError(
            f"{source} {WRONG_CHECKSUM}; remove its key {CHECKSUM_KEY!r} if you edited it"
        )
    return description


def change_description(file: Path, change: Callable[[dict[str, Any]], Mapping[str, Any]]) -> None:
    """Replaces the JSON object in a file by what a function makes of it.

    Of several processes that do so at the same time, each sees what the one before has written.
    """
    if isinstance(file, ObjectPath):
        source = str(file)
        change_object(
            file,
            lambda content: json_text(change(checked_description(content, source))).encode(),
        )
        return
    with sole_writer(file.parent):
        write_json(change(read_description(file)), file)


def parse_description(text: str | bytes, source: str) -> dict[str, Any]:
    """Returns the JSON object in a text."""
    try:
        decoded = text.decode() if isinstance(text, bytes) else text
        content = json.loads(decoded)
    except ValueError as error:
        raise RecordError(f"{source} is damaged: {error}") from error
    if not isinstance(content, dict):
        raise RecordError(f"{source} is damaged: it has no JSON object")
    return content


def check_description(
    content: Mapping[str, Any], description: Description, source: str, lack: str
) -> None:
    """Checks the values of a JSON object."""
    for key, value in description.items():
        if key not in content:
            if value.is_required:
                raise RecordError(f"{source} is damaged: it lacks {lack}: there is no {key!r}")
        elif not value.fits(content[key]):
            raise RecordError(
                f"{source} is damaged: {key!r} is to be {value.expected}, not "
                f"{short_repr(content[key])}"
            )


def camera_text(camera: Camera) -> dict[str, Any]:
    """Returns a camera for the description of a record."""
    return {"eye": list(camera.eye), "target": list(camera.target), "fov": camera.fov}


def camera_of(description: Mapping[str, Any]) -> Camera:
    """Returns the camera of a description that was checked; that of any scene if it has none."""
    if "camera" not in description:
        return Camera()
    values = description["camera"]
    return Camera(tuple(values["eye"]), tuple(values["target"]), values["fov"])
