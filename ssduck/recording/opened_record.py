"""Keeps a record that was opened from being read by a forked process, or in place of another."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ssduck.errors import RecordError
from ssduck.recording.stores.descriptions import read_description
from ssduck.recording.stores.object_store import ObjectPath

# What a description says of an episode that no other one has; older ones lack the first.
_OWN_KEYS = ("id", "started")


class OpenedRecord:
    """A record that a process has opened.

    DuckDB and the Parquet library read with threads, which a forked process lacks: it would wait
    for them forever.

    Args:
        path: the record.
        about_file: the file that describes the opened episode of a folder; None for other records.
        description: its content.
    """

    def __init__(
        self,
        path: Path,
        about_file: Path | None = None,
        description: Mapping[str, Any] | None = None,
    ) -> None:
        self.path = path
        self._process = os.getpid()
        self._about_file = None if isinstance(path, ObjectPath) else about_file
        self._identity = _identity(description or {})
        self._status = None if self._about_file is None else _status(self._about_file)

    def check(self) -> None:
        """Checks that this process has opened the record, and that no other one took its place.

        Parts that are replaced by themselves are not noticed.

        Raises:
            RecordError: it was forked from that process, or the episode was removed or replaced.
        """
        if os.getpid() != self._process:
            raise RecordError(
                f"{self.path} was opened by the process {self._process}, from which this one was "
                "forked: open it anew here"
            )
        if self._about_file is None or (status := _status(self._about_file)) == self._status:
            return
        if status is None:
            raise RecordError(f"{self._about_file} is missing: it was removed after it was opened")
        if _identity(read_description(self._about_file)) != self._identity:
            raise RecordError(
                f"{self._about_file} is of another recording than when it was opened: open it anew"
            )
        self._status = status  # tags were added, or the recording ended


def _identity(description: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(description.get(key) for key in _OWN_KEYS)


def _status(file: Path) -> tuple[int, int, int] | None:
    """Returns what changes with the content of a file; None if there is none."""
    try:
        status = os.stat(file)  # noqa: PTH116  # half the time of `Path.stat`
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns
