"""Writes files that are complete or not there at all."""

from __future__ import annotations

import os
import secrets
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from ssduck.errors import RecordError
from ssduck.recording.stores.object_store import ObjectPath, create_object, written

_fcntl: Any = import_module("fcntl") if os.name == "posix" else None
_lock = threading.Lock()


def temporary_path(place: Path) -> Path:
    """Returns the path of a file or a folder until it is complete.

    No other process has it, and nobody can have put a link there, which would be written through.
    """
    return place.with_name(f".{secrets.token_hex(8)}.unfinished")


def write_atomically(place: Path, write: Callable[[Path], object]) -> None:
    """Writes a file under a temporary name, and renames it when it is on the disk."""
    if isinstance(place, ObjectPath):
        written(place, write)
        return
    temporary = temporary_path(place)
    try:
        write(temporary)
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(place)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(place.parent)


def write_with_folders(place: Path, write: Callable[[Path], None]) -> None:
    """Writes a file, all or nothing, and the folders that it is in."""
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(place, write)
    except RecordError:
        raise
    except OSError as error:
        raise RecordError(f"{place} cannot be written: {error.strerror}") from error


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Waits until no other writer is in such a context for a folder, whose files may be changed.

    Writers are the threads of this process, and on POSIX other processes of this machine.
    """
    with _lock, ExitStack() as opened:
        if _fcntl is not None and not isinstance(folder, ObjectPath):
            with suppress(OSError):  # some file systems of networks have no locks
                handle = os.open(folder, os.O_RDONLY)
                opened.callback(os.close, handle)
                _fcntl.flock(handle, _fcntl.LOCK_EX)
        yield


def is_temporary(file: Path) -> bool:
    """Checks whether a file or a folder is one that is not complete yet."""
    return file.name.startswith(".") and file.name.endswith(".unfinished")


def create_file(place: Path, text: str) -> bool:
    """Creates a file with a text unless there is one; returns whether there was none.

    Of several processes that create it at the same time, one does, and the others see all of it.
    """
    if isinstance(place, ObjectPath):
        return create_object(place, text.encode())
    temporary = temporary_path(place)
    try:
        with temporary.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        try:
            os.link(temporary, place)
        except FileExistsError:
            return False
        except OSError:  # the file system has no links
            try:
                with place.open("x", encoding="utf-8") as file:
                    file.write(text)
            except FileExistsError:
                return False
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()
    sync_folder(place.parent)
    return True


def sync_folder(folder: Path) -> None:
    """Writes the names in a folder to the disk, where the system supports it."""
    if os.name != "posix" or isinstance(folder, ObjectPath):
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
