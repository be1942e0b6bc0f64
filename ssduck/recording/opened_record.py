"""Keeps a record that was opened from being read by a forked process, or in place of another."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

from ssduck.errors import RecordError, RecordPermissionError, record_error
from ssduck.recording.stores.descriptions import read_description
from ssduck.recording.stores.history_sql import pattern_of
from ssduck.recording.stores.object_store import ObjectPath

# What a description says of an episode that no other one has.
_OWN_KEYS = ("id", "started")
# The path of a part in a record, as ssduck names it.
_PART = re.compile(r"[\w=./\\-]*")
# What changes with the content of a file; None if there is none.
FileStatus: TypeAlias = tuple[int, int, int] | None


class OpenedRecord:
    """A record that a process has opened.

    DuckDB and the Parquet library read with threads, which a forked process lacks: it would wait
    for them forever.
    """

    def __init__(
        self,
        path: Path,
        about_file: Path | None = None,
        description: Mapping[str, Any] | None = None,
        status: FileStatus = None,
    ) -> None:
        self.path = path
        self._process = os.getpid()
        self._about_file = None if isinstance(path, ObjectPath) else about_file
        self._identity = _identity(description or {})
        self._status = status

    def check(self) -> None:
        """Checks that this process has opened the record, and that no other one took its place.

        Parts that are replaced by themselves are not noticed.
        """
        if os.getpid() != self._process:
            raise RecordError(
                f"{self.path} was opened by the process {self._process}, from which this one was "
                "forked: open it anew here"
            )
        if self._about_file is None or (status := file_status(self._about_file)) == self._status:
            return
        if status is None:
            raise _absence_error(self._about_file)
        if _identity(read_description(self._about_file)) != self._identity:
            raise RecordError(
                f"{self._about_file} is of another recording than when it was opened: open it anew"
            )
        self._status = status  # tags were added, or the recording ended

    def reading_error(self, text: str) -> RecordError | None:
        """Returns the error for a message of DuckDB's; None if it names no file of the record.

        A part may have been removed or changed since it was checked.
        """
        if isinstance(self.path, ObjectPath):
            named = str(self.path) in text
            return RecordError(f"{self.path} cannot be read: {text}") if named else None
        folder = str(self.path.resolve())
        # DuckDB may name the file or its pattern, or the file by way of a link.
        for name in (folder, pattern_of(folder), str(self.path)):
            before, _, after = text.partition(f"{name}{os.sep}")
            if before != text:
                part = _PART.match(after)
                return _reading_error(self.path / (part.group() if part else ""), text)
        return None


def _reading_error(file: Path, text: str) -> RecordError:
    """Returns the error for a message of DuckDB's that it cannot read a file."""
    try:
        file.stat()
    except OSError as error:
        return record_error(f"{file} cannot be read: {error.strerror}", error)
    if "Permission denied" in text:
        return RecordPermissionError(f"{file} cannot be read: Permission denied")
    return RecordError(f"{file} cannot be read: {text}")


def _absence_error(file: Path) -> RecordError:
    """Returns the error for a file that was there, and has no status now."""
    try:
        file.stat()
    except PermissionError as error:
        return record_error(f"{file} cannot be read: {error.strerror}", error)
    except OSError:
        pass
    return RecordError(f"{file} is missing: it was removed after it was opened")


def _identity(description: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(description.get(key) for key in _OWN_KEYS)


def file_status(file: Path) -> FileStatus:
    """Returns what changes with the content of a file; None if there is none."""
    try:
        status = os.stat(file)  # noqa: PTH116  # half the time of `Path.stat`
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns
