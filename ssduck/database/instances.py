"""Databases in memory that are used again: making one takes longer than a small query.

An interpreter that is closed gives its database back if no statement of a user's has run in it, so
that all that is in it is known and can be removed.
"""

from __future__ import annotations

import atexit
import os
import threading

import duckdb

MEMORY = ":memory:"
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


POOL = InstancePool()
atexit.register(POOL.close)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=POOL.leave)
