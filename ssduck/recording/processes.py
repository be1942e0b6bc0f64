"""Keeps forked processes from reading a record that their parent has opened."""

from __future__ import annotations

import os
from pathlib import Path

from ssduck.errors import RecordError


class OpenedRecord:
    """A record that a process has opened.

    DuckDB and the Parquet library read with threads, which a forked process lacks: it would wait
    for them forever.

    Args:
        path: the record.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._process = os.getpid()

    def check_process(self) -> None:
        """Checks that this is the process that has opened the record.

        Raises:
            RecordError: it was forked from that process.
        """
        if os.getpid() != self._process:
            raise RecordError(
                f"{self.path} was opened by the process {self._process}, from which this one was "
                "forked: open it anew here"
            )
