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

from ssduck.database.file_paths import check_beside, spill_of
from ssduck.errors import UnsupportedError
from ssduck.recording.stores.object_store import duckdb_objects

MEMORY = ":memory:"
# The format of files: the one of DuckDB's version with long-term support, which later versions read
# too; and small blocks, since each column of each table of an episode takes one at least.
_FORMAT = "STORAGE_VERSION 'v1.4.0', BLOCK_SIZE 16384"
# The name of a file's database in SQL. DuckDB would name it after the file, and then no world can
# have that name; no world can have this one.
FILE_NAME = '"ssduck file"'
# In DuckDB 2.0.0, an IE join (of two range conditions and 1,000 rows or more) in a prepared
# statement invalidates the database at its second run. DuckDB plans others then, but for SEMI and
# ANTI joins.
NO_IE_JOINS = "SET merge_join_threshold = 1000000000"
# For small data and many queries, a second thread costs more time than it saves. The footers of a
# record of many parts are read once. The name of an unknown table is an error, not a Python
# variable of the caller. One text takes less than four.
_SETTINGS = (
    f"SET threads = 1; {NO_IE_JOINS}; SET parquet_metadata_cache = true; "
    "SET python_enable_replacements = false"
)
# Whether DuckDB may draw its progress on standard output, which it does in notebooks only. In one
# without ipywidgets it is off, and setting it is an error.
_PROGRESS = "SELECT current_setting('enable_progress_bar')"
_may_draw = True
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


def open_file(path: str) -> duckdb.DuckDBPyConnection:
    """Returns a connection to a DuckDB file, which is created if there is none.

    Its database has the name `FILE_NAME`; each other connection has to `USE` it.
    """
    check_beside(path, is_written=True)
    literal = exp.Literal.string(path).sql("duckdb")
    is_new = True
    with suppress(OSError):  # attaching it says what is wrong
        is_new = not Path(path).stat().st_size
    connection = duckdb.connect(MEMORY)
    try:
        options = f"TYPE duckdb, {_FORMAT}" if is_new else "TYPE duckdb"
        connection.execute(f"ATTACH {literal} AS {FILE_NAME} ({options})")
        spill = exp.Literal.string(spill_of(path)).sql("duckdb")
        connection.execute(f"SET temp_directory = {spill}")
    except BaseException:
        connection.close()
        raise
    return connection


POOL = InstancePool()
atexit.register(POOL.close)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=POOL.leave)


def set_up(connection: duckdb.DuckDBPyConnection) -> None:
    """Sets what each connection for statements of programs needs."""
    global _may_draw  # noqa: PLW0603  # it is found once a process
    connection.execute(_SETTINGS)
    if _may_draw:
        _may_draw = connection.execute(_PROGRESS).fetchall() != [(False,)]
    if _may_draw:
        connection.execute("SET enable_progress_bar = false")


def reach_objects(connection: duckdb.DuckDBPyConnection) -> bool:
    """Lets a connection read objects of the S3 store of the environment; returns True."""
    try:
        if not connection.filesystem_is_registered("s3"):
            connection.register_filesystem(duckdb_objects())
    except ModuleNotFoundError as error:
        raise UnsupportedError(
            "fsspec is not installed, by which DuckDB reads objects; pip install 'ssduck[s3]' does "
            "it"
        ) from error
    return True
