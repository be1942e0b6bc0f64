"""Paths of records as callers give them."""

from __future__ import annotations

from pathlib import Path


def given_path(path: str | Path) -> Path:
    """The path as it is, but that `~` and `~/…` begin at the home folder, as in a shell.

    Raises:
        RuntimeError: the home folder is not known.
    """
    text = str(path)
    return Path(path).expanduser() if text == "~" or text.startswith("~/") else Path(path)
