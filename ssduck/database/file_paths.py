"""Checks the paths of DuckDB files, and says what DuckDB's errors mean."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import duckdb

from ssduck.errors import SqlError
from ssduck.formatting import short_repr
from ssduck.recording.paths import expand_path
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
    if is_written and "?" in str(
        Path(absolute).parent
    ):  # DuckDB would write its log to another folder
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

    Args:
        path: the path of the DuckDB file.
        is_written: whether the file is opened to be written, too.
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
