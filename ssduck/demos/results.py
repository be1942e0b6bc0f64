"""Keeps files and folders of demonstrations without overwriting existing ones."""

from __future__ import annotations

import filecmp
import shutil
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from ssduck.errors import SelectScriptError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    from PIL import Image


def keep_picture(picture: npt.NDArray[np.uint8] | Image.Image, target: Path) -> Path:
    """Writes a picture as `keep` does; returns its path."""
    from ssduck.demos.drawing import save

    return keep(target, lambda path: save(picture, path))


def keep(target: Path, write: Callable[[Path], object]) -> Path:
    """Writes files to a path or, if it exists, to a new one beside it, like kitchen_2.png.

    Existing files stay. If they are equal to the new ones, nothing is written.

    Args:
        target: the path, in an existing folder.
        write: writes a file or a folder to the given path, and possibly further files beside it,
            whose names begin with the same stem.

    Returns:
        The path that was written or that was equal already.

    Raises:
        SelectScriptError: the files cannot be written.
    """
    for path in _candidates(target):
        with TemporaryDirectory() as folder:
            new_files = Path(folder)
            write(new_files / path.name)
            try:
                if _move(new_files, path.parent):
                    return path
            except OSError as error:
                message = f"{path} cannot be written: {error.strerror or error}"
                raise SelectScriptError(message) from error
    raise AssertionError("there are more numbers than files")


def _candidates(target: Path) -> Iterator[Path]:
    yield target
    for number in count(2):
        yield target.with_stem(f"{target.stem}_{number}")


def _move(new_files: Path, folder: Path) -> bool:
    """Moves new files into a folder, unless a different file has the name of one of them."""
    pairs = [(new, folder / new.name) for new in new_files.iterdir()]
    if any(old.exists() and not _are_same(new, old) for new, old in pairs):
        return False
    for new, old in pairs:
        if not old.exists():
            shutil.move(new, old)
    return True


def _are_same(one: Path, other: Path) -> bool:
    """Checks whether two files, or all files of two folders, are equal."""
    if one.is_file() or other.is_file():
        return one.is_file() and other.is_file() and filecmp.cmp(one, other, shallow=False)
    parts = {path.relative_to(one) for path in one.rglob("*")}
    if parts != {path.relative_to(other) for path in other.rglob("*")}:
        return False
    return all(_are_same(one / part, other / part) for part in parts if not (one / part).is_dir())
