"""Checks the paths of files that result forms write, and replaces files atomically."""

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
    """Returns the path of the file that a query writes.

    Raises:
        ArgumentError: it is not a file path, or the query has GROUP BY or CONNECT BY, so that
            each group or path would replace the file of the previous one.
    """
    query = selection.query
    if query.group or query.recursion is not None:
        raise ArgumentError(
            "each group or path would replace the file of the previous one; select without "
            "GROUP BY or CONNECT BY"
        )
    if not isinstance(file, str) or not _is_path(file):
        raise ArgumentError(f"the file must be a path in quotes, not {short_repr(file)}")
    return Path(file)


def _is_path(file: str) -> bool:
    """Checks whether a file can have the path."""
    try:
        file.encode()
    except UnicodeEncodeError:
        return False
    return "\0" not in file and bool(Path(file).name)


def replace_file(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Writes a temporary file and renames it, so that no reader sees an incomplete file.

    Raises:
        ArgumentError: the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}")
    try:
        try:
            with temporary.open("wb") as stream:
                write(stream)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise ArgumentError(f"{path}: {error.strerror or error}") from error
