"""What demonstrations leave behind: files and folders that overwrite nothing that is there."""

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
    """Write a picture as `keep` does; tells where it is."""
    from ssduck.demos.drawing import save

    return keep(target, lambda path: save(picture, path))


def keep(target: Path, write: Callable[[Path], object]) -> Path:
    """Write something to a path, or to the first free one beside it, kitchen_2.png say.

    What is there stays as it is. If it is the same already, nothing is written.

    Args:
        target: the path; its folder is there.
        write: writes a file or a folder to a path that it is given, and may write others beside
            it, whose names begin like its.

    Returns:
        Where it is.

    Raises:
        SelectScriptError: it cannot be written.
    """
    for place in _places(target):
        with TemporaryDirectory() as folder:
            made = Path(folder)
            write(made / place.name)
            try:
                if _puts(made, place.parent):
                    return place
            except OSError as error:
                message = f"{place} cannot be written: {error.strerror or error}"
                raise SelectScriptError(message) from error
    raise AssertionError("there are more numbers than files")


def _places(target: Path) -> Iterator[Path]:
    yield target
    for number in count(2):
        yield target.with_stem(f"{target.stem}_{number}")


def _puts(made: Path, folder: Path) -> bool:
    """Put everything into a folder, or nothing if something else is there by a name of it."""
    there = [(new, folder / new.name) for new in made.iterdir()]
    if any(old.exists() and not _are_same(new, old) for new, old in there):
        return False
    for new, old in there:
        if not old.exists():
            shutil.move(new, old)
    return True


def _are_same(one: Path, other: Path) -> bool:
    """Whether two files, or all in two folders, are the same."""
    if one.is_file() or other.is_file():
        return one.is_file() and other.is_file() and filecmp.cmp(one, other, shallow=False)
    parts = {path.relative_to(one) for path in one.rglob("*")}
    if parts != {path.relative_to(other) for path in other.rglob("*")}:
        return False
    return all(_are_same(one / part, other / part) for part in parts if not (one / part).is_dir())
