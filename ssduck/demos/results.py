"""Keeps files and folders of demonstrations without overwriting existing ones."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from itertools import chain, count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from PIL import Image

from ssduck.errors import SelectScriptError

Say: TypeAlias = Callable[[str], None]  # writes one or several lines
Picture: TypeAlias = "npt.NDArray[np.uint8] | Image.Image"


def save(picture: Picture, target: Path) -> None:
    """Writes a picture in the format of the suffix."""
    image = picture if isinstance(picture, Image.Image) else Image.fromarray(picture)
    try:
        image.save(target, optimize=True)
    except (OSError, ValueError) as error:  # ValueError: unknown suffix
        reason = error.strerror if isinstance(error, OSError) else error
        raise SelectScriptError(f"{target} cannot be written: {reason}") from error


def keep_picture(picture: Picture, target: Path) -> Path:
    """Writes a picture as `keep` does; returns its path."""
    return keep(target, lambda path: save(picture, path))


def keep(target: Path, write: Callable[[Path], object]) -> Path:
    """Writes files to a path or, if it exists, to a new one beside it, like kitchen_2.png.

    Existing files stay. If they are equal to the new ones, nothing is written. Returns the path.
    """
    numbered = (target.with_stem(f"{target.stem}_{number}") for number in count(2))
    for path in chain([target], numbered):
        with TemporaryDirectory() as folder:
            new_files = Path(folder)
            write(new_files / path.name)
            try:
                if _move(new_files, path.parent):
                    return path
            except OSError as error:
                reason = error.strerror or error
                raise SelectScriptError(f"{path} cannot be written: {reason}") from error
    raise AssertionError("there are more numbers than files")


def _move(new_files: Path, folder: Path) -> bool:
    """Moves new files into a folder, unless a different file has the name of one of them."""
    pairs = [(new, folder / new.name) for new in new_files.iterdir()]
    if any(old.exists() and _contents(new) != _contents(old) for new, old in pairs):
        return False
    for new, old in pairs:
        if not old.exists():
            shutil.move(new, old)
    return True


def _contents(path: Path) -> bytes | dict[Path, bytes]:
    """Returns the bytes of a file, or those of all files in a folder."""
    if path.is_file():
        return path.read_bytes()
    return {file.relative_to(path): file.read_bytes() for file in path.rglob("*") if file.is_file()}
