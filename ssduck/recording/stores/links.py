"""Checks that no symbolic link leads out of the folder of a record."""

from __future__ import annotations

import os
from itertools import accumulate
from pathlib import Path

from ssduck.errors import RecordError
from ssduck.recording.stores.object_store import ObjectPath


def files_in(folder: Path, place: Path) -> set[str]:
    """Returns the names of the files in a folder of a record.

    Raises:
        RecordError: a link leaves the folder of the record.
    """
    if isinstance(place, ObjectPath):
        return {entry.name for entry in place.iterdir()}
    entries = list(os.scandir(place))
    for entry in entries:
        if entry.is_symlink():
            check_inside(folder, place / entry.name)
    return {entry.name for entry in entries if entry.is_file()}


def check_inside(folder: Path, place: Path) -> None:
    """Checks that no symbolic link leads out of a record's folder.

    Raises:
        RecordError: one does, or leads back to itself.
    """
    if isinstance(place, ObjectPath):
        return
    names = place.parts[len(folder.parts) :]
    below = accumulate(names, os.path.join, initial=str(folder))
    next(below)  # the folder itself may be reached by a link
    if not any(map(os.path.islink, below)):
        return
    try:
        if place.resolve().is_relative_to(folder.resolve()):
            return
    except (OSError, RuntimeError):  # a link to itself
        pass
    raise RecordError(f"{place} is a symbolic link that leaves {folder}: put a copy in its place")
