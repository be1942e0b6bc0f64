"""Writes files that are complete or not there at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path


def temporary_path(place: Path) -> Path:
    """Returns the path of a file until it is complete."""
    return place.with_name(f".{place.name}.unfinished")


def write_atomically(place: Path, write: Callable[[Path], None]) -> None:
    """Writes a file under a temporary name, and renames it when it is on the disk."""
    temporary = temporary_path(place)
    try:
        write(temporary)
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(place)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    _sync_folder(place.parent)


def _sync_folder(folder: Path) -> None:
    """Writes the names in a folder to the disk, where the system supports it."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
