"""Recognizes records, and expands the paths of them that callers pass."""

from __future__ import annotations

from pathlib import Path

from ssduck.recording.stores.object_store import ObjectPath, is_address

# The position and value of the mark in DuckDB files.
_MAGIC = slice(8, 12), b"DUCK"


def expand_path(path: str | Path) -> Path:
    """Returns a path with `~` and `~/…` replaced by the home folder, as in a shell.

    `s3://bucket/run` is an address in an object store.

    Raises:
        RuntimeError: the home folder is unknown.
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
