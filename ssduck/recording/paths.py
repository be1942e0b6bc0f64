"""Expands the paths of records that callers pass."""

from __future__ import annotations

from pathlib import Path


def expand_path(path: str | Path) -> Path:
    """Returns a path with `~` and `~/…` replaced by the home folder, as in a shell.

    Raises:
        RuntimeError: the home folder is unknown.
    """
    text = str(path)
    return Path(path).expanduser() if text == "~" or text.startswith("~/") else Path(path)
