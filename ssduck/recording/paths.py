"""Recognizes records, and expands the paths of them that callers pass."""

from __future__ import annotations

from pathlib import Path

# The position and value of the mark in DuckDB files.
_MAGIC = slice(8, 12), b"DUCK"


def expand_path(path: str | Path) -> Path:
    """Returns a path with `~` and `~/…` replaced by the home folder, as in a shell.

    Raises:
        RuntimeError: the home folder is unknown.
    """
    text = str(path)
    return Path(path).expanduser() if text == "~" or text.startswith("~/") else Path(path)


def is_record(location: str | Path) -> bool:
    """Checks whether a path is the folder or file of a record; names of shipped scenes are not."""
    from ssduck.simulators.scenes import shipped_scenes

    path = Path(location)
    if str(location) in shipped_scenes():
        return False
    if not path.is_file():
        return path.is_dir()
    position, magic = _MAGIC
    with path.open("rb") as file:
        return file.read(position.stop)[position] == magic
