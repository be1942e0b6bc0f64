"""The paths of records: as callers pass them, and the names of the files and folders in one."""

from __future__ import annotations

import json
import re
from functools import lru_cache
from pathlib import Path

from ssduck.recording.stores.object_store import ObjectPath, is_address

# The position and value of the mark in DuckDB files.
_MAGIC = slice(8, 12), b"DUCK"


def expand_path(path: str | Path) -> Path:
    """Returns a path with `~` and `~/…` replaced by the home folder, as in a shell.

    `s3://bucket/run` is an address in an object store.
    """
    if is_address(path):
        return ObjectPath(str(path))
    text = str(path)
    return Path(path).expanduser() if text == "~" or text.startswith("~/") else Path(path)


def is_record(location: str | Path) -> bool:
    """Checks whether a path is the folder or file of a record; names of shipped scenes are not."""
    from ssduck.simulators.scenes import shipped_scenes

    if is_address(location):
        return True
    path = Path(location)
    if str(location) in shipped_scenes():
        return False
    if not path.is_file():
        return path.is_dir()
    position, magic = _MAGIC
    with path.open("rb") as file:
        return file.read(position.stop)[position] == magic


# -- the names of parts and episodes ----------------------------------------------------------

# The name of the format: footers have the labels of their files under it.
FORMAT = "ssduck record"
# The largest number of digits of a part and of an episode keeps them below 10**9.
_PART = re.compile(r"part-([0-9]{6}|[1-9][0-9]{6,8})\.parquet")
_FOLDER = re.compile(r"episode=(0|[1-9][0-9]{0,8})")
_FILE = re.compile(r"(.+)-(0|[1-9][0-9]{0,8})\.json")


def part_numbers(place: Path) -> list[int]:
    """Returns the numbers of the files of parts in a folder, ascending."""
    matches = map(_PART.fullmatch, names_in(place))
    return sorted(int(match.group(1)) for match in matches if match)


def part_name(number: int) -> str:
    """Returns the file name of a part."""
    return f"part-{number:06d}.parquet"


def part_number(file: Path) -> int:
    """Returns the number of a part from its file."""
    match = _PART.fullmatch(file.name)
    assert match is not None
    return int(match.group(1))


def episode_number(place: Path) -> int:
    """Returns the number of an episode from a folder of its files, such as `ticks/…/episode=0`."""
    match = _FOLDER.fullmatch(place.name)
    assert match is not None
    return int(match.group(1))


def label_of(key: str, table: str, number: int | str) -> bytes:
    """Returns the label of a part of a table, of the episode with a key."""
    return b'{"episode": %s, %s' % (json.dumps(key).encode(), _end_of_label(table, number))


@lru_cache(maxsize=1024)
def _end_of_label(table: str, number: int | str) -> bytes:
    return json.dumps({"table": table, "part": number}).encode()[1:]


def episode_numbers(place: Path) -> set[int]:
    """Returns the numbers of the episodes that have a folder in a folder of a world."""
    matches = map(_FOLDER.fullmatch, names_in(place))
    return {int(match.group(1)) for match in matches if match}


def names_in(place: Path) -> list[str]:
    """Returns the names in a folder, or nothing if there is none."""
    return [entry.name for entry in place.iterdir()] if place.is_dir() else []


def episodes_named(place: Path) -> list[tuple[str, int]]:
    """Returns the worlds and numbers in the names of files of a folder, such as `sim-0.json`."""
    matches = map(_FILE.fullmatch, names_in(place))
    return sorted((match.group(1), int(match.group(2))) for match in matches if match)
