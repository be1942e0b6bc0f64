"""Writes paths of files as DuckDB is to read them."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

from sqlglot import exp

from ssduck.errors import RecordError
from ssduck.recording.stores.object_store import ObjectPath, is_address

_PATTERN = re.compile(r"[*?[]")


def file_list(files: Sequence[Path]) -> str:
    """Returns a list of files of parts, in SQL."""
    separator = "/" if isinstance(files[0], ObjectPath) else os.sep
    folders = {
        folder: exp.Literal.string(exact_path(folder) + separator).sql("duckdb")[:-1]
        for folder in {file.parent for file in files}
    }
    names = ", ".join(f"{folders[file.parent]}{file.name}'" for file in files)  # by `part_name`
    return f"[{names}]"


def exact_path(place: Path) -> str:
    """Returns a path with `*`, `?` and `[` escaped, which DuckDB reads as patterns.

    Raises:
        RecordError: the path also has a backslash, which DuckDB takes for a slash then.
    """
    return pattern_of(str(place.resolve()))


def pattern_of(path: str) -> str:
    """Returns the same for an absolute path without links, or an address."""
    if not _PATTERN.search(path):
        return path
    if not is_address(path) and "\\" in path and os.sep != "\\":
        raise RecordError(
            f"{path} cannot be read: DuckDB takes a backslash in such a name for a slash; rename "
            "the folder"
        )
    return _PATTERN.sub(r"[\g<0>]", path)
