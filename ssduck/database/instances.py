"""DuckDB files, and databases in memory: opening and closing them, and what their errors mean.

An interpreter that is closed gives its database in memory back if no statement of a user has run in
it: making one takes longer than a small query.
"""

from __future__ import annotations

import atexit
import os
import re
import stat
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import duckdb
from sqlglot import exp

from ssduck.errors import SqlError, UnsupportedError
from ssduck.formatting import short_repr
from ssduck.recording.paths import expand_path
from ssduck.recording.stores.object_store import duckdb_objects
from ssduck.sql.relations.relation import IDENTIFYING_COLUMNS


def absolute_path(path: str, *, is_written: bool = False) -> str:
    """Returns the absolute path of a file, because `md:x` would name a service for DuckDB."""
    try:
        absolute = str(expand_path(path).absolute())
        absolute.encode()
    except (OSError, RuntimeError, ValueError) as error:
        raise SqlError(f"{short_repr(path)} is not the path of a file: {error}") from error
    if "\0" in absolute or ("\\" in absolute and os.sep != "\\"):
        raise SqlError(
            f"{short_repr(path)} cannot be the path of a DuckDB file: DuckDB reads a backslash "
            "as a slash, and allows no null character"
        )
    # DuckDB would write its log to another folder.
    if is_written and "?" in str(Path(absolute).parent):
        raise SqlError(
            f"{short_repr(path)} cannot be the path of a DuckDB file: DuckDB ignores the "
            "part of a folder's name from a question mark on; rename the folder"
        )
    return absolute


def log_of(path: Path) -> Path:
    """Returns the log of a DuckDB file, which DuckDB keeps beside the file that a link leads to."""
    return Path(f"{os.path.realpath(path)}.wal")


def spill_of(path: str) -> str:
    """Returns the folder of what a query on a DuckDB file has no room for in memory."""
    return f"{os.path.realpath(path)}.tmp"


def check_beside(path: str, *, is_written: bool = False) -> None:
    """Checks what DuckDB reads and writes beside a file: it would follow any link there.

    A link that the path itself is, or has in it, is the user's, and is followed.
    """
    log = log_of(Path(path))
    for ending in ("", *_OTHER_LOGS):
        _check_kind(f"{log}{ending}", stat.S_ISREG, f"DuckDB keeps the log of {path} there")
    if not is_written:
        return
    file = Path(path)
    if file.is_symlink() and not file.exists():
        raise SqlError(
            f"{path} is a symbolic link to what is not there: give the path of the new file itself"
        )
    if file.exists() and not file.is_file():
        raise SqlError(f"{path} is no file: give the path of a DuckDB file, or of a new one")
    spill, use = spill_of(path), f"DuckDB puts there what queries on {path} have no room for"
    _check_kind(spill, stat.S_ISDIR, use, kind="folder")
    for name in _names_in(spill):
        _check_kind(name, stat.S_ISREG, use)


# What DuckDB adds to the name of a log while it makes another one of it.
_OTHER_LOGS = (".checkpoint", ".recovery")


def _names_in(folder: str) -> Iterator[str]:
    """Yields the paths in a folder, if it is there."""
    try:
        with os.scandir(folder) as entries:
            yield from (entry.path for entry in entries)
    except OSError:  # DuckDB says what is wrong with it, if it needs it
        return


def _check_kind(place: str, is_right: Callable[[int], bool], use: str, kind: str = "file") -> None:
    """Checks that nothing is at a place, or what DuckDB makes there."""
    try:
        mode = os.lstat(place).st_mode
    except OSError:  # it is not there, or DuckDB says what is wrong
        return
    if stat.S_ISLNK(mode):
        raise SqlError(f"{place} is a symbolic link, but {use}: remove the link")
    if not is_right(mode):
        raise SqlError(f"{place} is no {kind}, but {use}: move it elsewhere")


def open_error_text(path: str, error: BaseException) -> str:
    """Returns the message about a file that cannot be opened."""
    if "already attached" in str(error):
        return f"{path} is open in this process: close it first, or use the interpreter that has it"
    if is_damage(error):
        return damage_text(Path(path), error)
    if _LOCKED in str(error):
        process = _PROCESS.search(str(error))
        number = f" ({process.group()})" if process else ""
        return (
            f"{path} is in use by another process{number}, and DuckDB allows one at a time: close "
            "it there; or write to a folder, which any number can read: record_to(…) and "
            "export(…) there, `ssduck record -o FOLDER`"
        )
    return f"{path} cannot be opened: {str(error).strip()}"


_PROCESS = re.compile(r"PID \d+")
# What DuckDB says of a file that another process has opened.
_LOCKED = "Could not set lock on file"
# What to do with a file of which something may be readable.
CHECK_HINT = "`ssduck check` lists what can be read"
_DAMAGES = (duckdb.SerializationException, duckdb.InternalException, duckdb.FatalException)


def is_damage(error: BaseException) -> bool:
    """Checks whether an error of DuckDB says that a file is damaged."""
    text = str(error).lower()
    return isinstance(error, _DAMAGES) or "checksum" in text or "corrupt" in text


def damage_text(path: Path, error: BaseException) -> str:
    """Returns the message about a damaged DuckDB file."""
    log = log_of(path)
    hint = CHECK_HINT
    if log.exists():
        hint = (
            f"if its log {log} is, `ssduck check --repair` renames the log, and what was moved to "
            "the file before can be read"
        )
    return f"{path} is damaged: {str(error).strip()}; {hint}"


_MISSING_FIELD = re.compile('Could not find key "(\\w+)" in struct')


def hint_of(error: Exception) -> str:
    """Returns a hint for a row that lacks a column which a relation of shapes reads."""
    match = _MISSING_FIELD.search(str(error))
    if match is None or match.group(1) not in IDENTIFYING_COLUMNS:
        return ""
    return (
        f"\nRelations identify an entity by {', '.join(IDENTIFYING_COLUMNS)} of its row: "
        "select whole rows of entities (SELECT *), and open a record that lacks the column run "
        "with ssduck.open"
    )


_NEEDED = re.compile(r"required extension '(\w+)")


def needed_extension(error: Exception) -> str | None:
    """Returns the extension of DuckDB that a statement lacks, if an error says so.

    DuckDB's message names the folder of the user where it would be.
    """
    match = _NEEDED.search(str(error))
    return None if match is None else match.group(1)


MEMORY = ":memory:"
# The format of files: the one of DuckDB's version with long-term support, which later versions read
# too; and small blocks, since each column of each table of an episode takes one at least.
_FORMAT = "STORAGE_VERSION 'v1.4.0', BLOCK_SIZE 16384"
# The name of a file's database in SQL. DuckDB would name it after the file, and then no world can
# have that name; no world can have this one.
FILE_NAME = '"ssduck file"'
# In DuckDB 2.0, an IE join (of two range conditions and 1,000 rows or more) in a prepared
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
