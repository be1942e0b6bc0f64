"""Writes files of records all or nothing, with checksums (CRC-32), and checks them.

The checksums find damages, not forgeries. The footer of a Parquet file has two: that of all bytes
before the footer, and that of the footer, computed with zeros in its own place. So a footer is
checked without the data. A file of a log has one, of all its bytes, and a JSON file has that of its
content.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import threading
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

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


# The bytes that begin and end a Parquet file.
_MAGIC = b"PAR1"
# The length of a footer and the magic, bytes.
_TAIL = 4 + len(_MAGIC)
# The number of bytes of a file that are summed at a time: they stay in the cache of a processor.
_PIECE = 1 << 18
# A reader of few ticks leaves out the groups of rows that have none of them.
ROWS_OF_A_GROUP = 1 << 14
_KEY = b"ssduck checksums"
_DIGITS = rb"[0-9a-f]{8}"
_FOOTER_SUMS = re.compile(rb"crc32 of data (%s), of footer (%s)" % (_DIGITS, _DIGITS))
_FILE_SUM = re.compile(rb"crc32 of file (%s)" % _DIGITS)
_NONE = b"0" * 8
# The key of the checksum of a JSON file.
CHECKSUM_KEY = "crc32"
NOT_COMPLETE = "is damaged: it is no complete Parquet file"
WRONG_CHECKSUM = "is damaged: its checksum is wrong"


def _hex(checksum: int) -> bytes:
    return b"%08x" % checksum


# -- Parquet files ----------------------------------------------------------------------------


def write_parquet(rows: pa.Table, place: Path, **options: Any) -> int:
    """Writes rows, with their metadata, to a Parquet file with checksums, all or nothing."""
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(sink, rows.schema, write_page_checksum=True, **options) as writer:
        writer.write_table(rows, row_group_size=ROWS_OF_A_GROUP)
        sums = b"crc32 of data %s, of footer %s" % (_NONE, _NONE)
        writer.add_key_value_metadata({_KEY: sums})
    content = memoryview(sink.getvalue())
    length = int.from_bytes(content[-_TAIL:-4], "little") + _TAIL
    data = content[:-length]
    data_sum = zlib.crc32(data)
    footer = _with_footer_sums(bytes(content[-length:]), data_sum)

    def write(file: Path) -> None:
        with file.open("wb", buffering=0) as stream:
            _write_all(stream, data)
            _write_all(stream, memoryview(footer))

    write_atomically(place, write)
    return zlib.crc32(footer, data_sum)


def _write_all(stream: Any, content: memoryview) -> None:
    while content:
        content = content[stream.write(content) :]


def footer_of(file: Path) -> bytes | None:
    """Returns the footer of a Parquet file; None if the file does not end in one."""
    with file.open("rb", buffering=0) as stream:
        size = stream.seek(0, 2)
        stream.seek(-min(size, _TAIL), 2)
        length = int.from_bytes(stream.read()[:4], "little") + _TAIL
        stream.seek(-min(size, length), 2)
        footer: bytes = stream.read()
    is_whole = footer[-4:] == _MAGIC and len(footer) == length <= size - len(_MAGIC)
    return footer if is_whole else None


def footer_problem(footer: bytes | None, *, has_checksums: bool) -> str | None:
    """Returns what is wrong with a footer; None for nothing."""
    if footer is None:
        return NOT_COMPLETE
    match = _last(_FOOTER_SUMS, footer)
    if match is None:
        return WRONG_CHECKSUM if has_checksums else None
    is_right = match.group(2) == _hex(_footer_sum(footer, *match.span(2)))
    return None if is_right else WRONG_CHECKSUM


def parquet_problem(content: bytes, *, has_checksums: bool) -> str | None:
    """Returns what is wrong with the content of a Parquet file; None for nothing."""
    footer = footer_in(content)
    is_complete = content[-4:] == _MAGIC and len(footer) + len(_MAGIC) <= len(content)
    problem = footer_problem(footer if is_complete else None, has_checksums=has_checksums)
    match = _last(_FOOTER_SUMS, footer)
    if problem is None and match is not None:
        data = memoryview(content)[: -len(footer)]
        problem = None if match.group(1) == _hex(zlib.crc32(data)) else WRONG_CHECKSUM
    return problem


def verified_parquet(file: Path, *, has_checksums: bool) -> pq.ParquetFile:
    """Returns a Parquet file, which is in memory and was checked."""
    content = file.read_bytes()
    problem = parquet_problem(content, has_checksums=has_checksums)
    if problem is not None:
        raise RecordError(f"{file} {problem}")
    return pq.ParquetFile(pa.BufferReader(content))


def checksum_of(file: Path) -> int:
    """Returns the CRC-32 of a file of any size."""
    checksum = 0
    with file.open("rb", buffering=0) as stream:
        while piece := stream.read(_PIECE):
            checksum = zlib.crc32(piece, checksum)
    return checksum


def footer_in(content: bytes) -> bytes:
    """Returns what the end of the content of a Parquet file says is its footer."""
    return content[-int.from_bytes(content[-_TAIL:-4], "little") - _TAIL :]


def _with_footer_sums(footer: bytes, data_sum: int) -> bytes:
    """Returns a footer with the checksums that it is to have."""
    match = _last(_FOOTER_SUMS, footer)
    assert match is not None
    first, last = match.span(1)
    start, end = match.span(2)
    footer = footer[:first] + _hex(data_sum) + footer[last:]
    return footer[:start] + _hex(_footer_sum(footer, start, end)) + footer[end:]


def _footer_sum(footer: bytes, start: int, end: int) -> int:
    """Returns the checksum of a footer, which is to stand between two places in it."""
    return zlib.crc32(footer[end:], zlib.crc32(_NONE, zlib.crc32(footer[:start])))


def _last(pattern: re.Pattern[bytes], content: bytes | bytearray) -> re.Match[bytes] | None:
    """Returns the last match: names of entities are in a footer, too, before it."""
    matches = list(pattern.finditer(content))
    return matches[-1] if matches else None


# -- files of a log ---------------------------------------------------------------------------

# Metadata of a file that is to have a checksum in its place.
UNSEALED = {_KEY: b"crc32 of file " + _NONE}


def write_sealed(content: memoryview, place: Path) -> None:
    """Writes a file with its checksum in the place of the metadata `UNSEALED`."""
    match = _FILE_SUM.search(content)
    assert match is not None
    start, end = match.span(1)
    checksum = memoryview(_hex(zlib.crc32(content)))
    with place.open("wb", buffering=0) as stream:
        for part in (content[:start], checksum, content[end:]):
            _write_all(stream, part)


def log_problem(content: bytes, *, has_checksums: bool) -> str | None:
    """Returns what is wrong with the content of a file that was sealed; None for nothing."""
    match = _FILE_SUM.search(content)
    if match is None:
        return WRONG_CHECKSUM if has_checksums else None
    start, end = match.span(1)
    view = memoryview(content)
    expected = zlib.crc32(view[end:], zlib.crc32(_NONE, zlib.crc32(view[:start])))
    return None if match.group(1) == _hex(expected) else WRONG_CHECKSUM


# -- JSON files -------------------------------------------------------------------------------


def write_json(content: Mapping[str, Any], file: Path) -> None:
    """Writes a JSON object with its checksum to a file, all or nothing."""
    write_atomically(file, lambda place: place.write_text(json_text(content), encoding="utf-8"))


def json_text(content: Mapping[str, Any]) -> str:
    """Returns a JSON object with its checksum."""
    values = {key: value for key, value in content.items() if key != CHECKSUM_KEY}
    return json.dumps(values | {CHECKSUM_KEY: _json_sum(values)}, indent=2) + "\n"


def pop_checksum(content: dict[str, Any]) -> bool:
    """Removes the checksum of a JSON object; returns whether it is right, or there is none."""
    checksum = content.pop(CHECKSUM_KEY, None)
    return checksum is None or checksum == _json_sum(content)


def _json_sum(content: Mapping[str, Any]) -> str:
    return _hex(zlib.crc32(json.dumps(content, sort_keys=True).encode())).decode()
