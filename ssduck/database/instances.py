"""Databases in memory that are used again: making one takes longer than a small query.

An interpreter that is closed gives its database back if no statement of a user's has run in it, so
that all that is in it is known and can be removed.
"""

from __future__ import annotations

import atexit
import os
import threading
from contextlib import suppress
from pathlib import Path

import duckdb
from sqlglot import exp

MEMORY = ":memory:"
# The format of files: the one of DuckDB's version with long-term support, which later versions read
# too; and small blocks, since each column of each table of an episode takes one at least.
_FORMAT = "STORAGE_VERSION 'v1.4.0', BLOCK_SIZE 16384"
_NEW_FILE = '"new file"'
# The largest number of databases that wait for an interpreter.
MAX_WAITING = 2


class InstancePool:
    """The databases in memory that wait for an interpreter, each with a connection to it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[duckdb.DuckDBPyConnection] = []
        self._left: list[duckdb.DuckDBPyConnection] = []
        self._is_closed = False

    def take(self) -> duckdb.DuckDBPyConnection:
        """Returns a connection to an empty database."""
        with self._lock:
            if self._waiting:
                return self._waiting.pop()
        return duckdb.connect(MEMORY)

    def give_back(self, connection: duckdb.DuckDBPyConnection) -> None:
        """Keeps a database that is empty again, or closes it."""
        with self._lock:
            if not self._is_closed and len(self._waiting) < MAX_WAITING:
                self._waiting.append(connection)
                return
        connection.close()

    def leave(self) -> None:
        """Leaves the databases to the parent process: a forked child lacks their threads."""
        self._lock = threading.Lock()
        self._left, self._waiting = self._waiting, []

    def close(self) -> None:
        """Closes all databases; one that is open when Python ends prints errors."""
        with self._lock:
            self._is_closed = True
            waiting, self._waiting = self._waiting, []
        for connection in waiting:
            connection.close()


def create_file(path: str) -> None:
    """Creates a DuckDB file unless there is one, in the format of this module."""
    file = Path(path)
    with suppress(OSError, duckdb.Error):  # connecting to it fails, too, and says why
        if file.exists() and file.stat().st_size:
            return
        literal = exp.Literal.string(path).sql("duckdb")
        connection = POOL.take()
        try:
            connection.execute(f"ATTACH {literal} AS {_NEW_FILE} ({_FORMAT})")
            connection.execute(f"DETACH {_NEW_FILE}")
        finally:
            POOL.give_back(connection)


POOL = InstancePool()
atexit.register(POOL.close)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=POOL.leave)
