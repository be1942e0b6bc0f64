"""Forms that write a file: where to, and that it takes the place of another at once."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

from ssduck.adapters.base import Selection
from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr


def check_file(selection: Selection, file: Any) -> Path:
    """The path of the one file that a query writes.

    Raises:
        ArgumentError: it is no path of a file, or there are groups or paths, of which each would
            replace the file of the one before.
    """
    query = selection.query
    if query.group or query.recursion is not None:
        raise ArgumentError(
            "each group and each path would replace the file of the one before; select without "
            "GROUP BY or CONNECT BY"
        )
    if not isinstance(file, str) or not _is_path(file):
        raise ArgumentError(f"the file is to be a path in quotes, not {short_repr(file)}")
    return Path(file)


def _is_path(file: str) -> bool:
    """Whether a file can have that path."""
    try:
        file.encode()
    except UnicodeEncodeError:
        return False
    return "\0" not in file and bool(Path(file).name)


def replace_file(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file beside a path, then put it there, so that nobody sees a part of it.

    Raises:
        ArgumentError: it cannot be written.
    """
    beside = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}")
    try:
        try:
            with beside.open("wb") as stream:
                write(stream)
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as error:
        raise ArgumentError(f"{path}: {error.strerror or error}") from error
