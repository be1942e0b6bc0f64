"""Lets records be in an object store: `ObjectPath` is an address there with the methods of a path.

An object is there as a whole or not at all, as a file is here once it was renamed. There are no
folders, links and renames. What is created or changed by several processes goes through
`ssduck.recording.stores.conditional_objects`.
"""

from __future__ import annotations

import fnmatch
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import urlsplit

from ssduck.errors import RecordError

if TYPE_CHECKING:
    from pyarrow.fs import FileInfo, FileSystem

_ADDRESS = re.compile(r"s3:/+(?P<key>.+)", re.DOTALL)
_PREFIX = "s3://"
# What the environment says of the store, beside the credentials, which the library reads itself.
_ENDPOINTS = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL")


class ObjectPath(type(Path())):  # type: ignore[misc]  # the path of this system
    """An address in an object store, `s3://bucket/run`: a path whose files are objects.

    Credentials, region and endpoint are those of the environment (`AWS_…`).
    """

    @property
    def key(self) -> str:
        """The bucket and the name, without the protocol."""
        match = _ADDRESS.fullmatch(super().__str__())
        assert match is not None
        return match["key"]

    def __str__(self) -> str:
        return _PREFIX + self.key

    def __repr__(self) -> str:
        return f"ObjectPath({str(self)!r})"

    def __hash__(self) -> int:
        return hash((ObjectPath, self.key))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ObjectPath) and other.key == self.key

    @property
    def _store(self) -> FileSystem:
        return file_system()

    @property
    def _info(self) -> FileInfo:
        with _readable(self):
            return self._store.get_file_info(self.key)

    def absolute(self) -> Self:
        """Returns itself: an address is absolute."""
        return self

    def resolve(self, strict: bool = False) -> Self:  # noqa: ARG002
        """Returns itself: there are no links."""
        return self

    def expanduser(self) -> Self:
        """Returns itself."""
        return self

    def exists(self, **_: Any) -> bool:
        """Checks whether there is an object, or one below it."""
        return bool(self._info.type != _types().NotFound)

    def is_file(self, **_: Any) -> bool:
        """Checks whether there is an object."""
        return bool(self._info.type == _types().File)

    def is_dir(self, **_: Any) -> bool:
        """Checks whether there is an object below it."""
        return bool(self._info.type == _types().Directory)

    def is_symlink(self) -> bool:
        """Returns False."""
        return False

    def stat(self, **_: Any) -> Any:
        """Returns the size of an object, as `st_size`."""
        info = self._info
        if info.type != _types().File:
            raise FileNotFoundError(2, "there is no such object", str(self))
        return SimpleNamespace(
            st_size=info.size, st_mode=stat.S_IFREG, st_mtime=info.mtime_ns / 1e9
        )

    lstat = stat

    def iterdir(self) -> Iterator[Self]:
        """Yields what is directly below it."""
        from pyarrow.fs import FileSelector

        with _readable(self):
            found = self._store.get_file_info(FileSelector(self.key, allow_not_found=True))
        yield from (type(self)(_PREFIX + info.path) for info in found)

    def glob(self, pattern: str, **_: Any) -> Iterator[Self]:
        """Yields what is directly below it and has a name like a pattern."""
        yield from (entry for entry in self.iterdir() if fnmatch.fnmatchcase(entry.name, pattern))

    def open(self, mode: str = "r", *_: Any, **__: Any) -> Any:
        """Opens an object to be read."""
        if mode != "rb":
            raise OSError(95, "an object is written as a whole", str(self))
        with _readable(self):
            return self._store.open_input_file(self.key)

    def read_bytes(self) -> bytes:
        """Returns the content of an object."""
        with self.open("rb") as stream:
            content: bytes = stream.read()
        return content

    def write_bytes(self, content: Any) -> int:
        """Writes an object."""
        with _readable(self), self._store.open_output_stream(self.key) as stream:
            stream.write(content)
        return len(content)

    def mkdir(self, *_: Any, **__: Any) -> None:
        """Does nothing: there are no folders."""

    def unlink(self, missing_ok: bool = False) -> None:
        """Removes an object."""
        if missing_ok and not self.exists():
            return
        with _readable(self):
            self._store.delete_file(self.key)

    def rename(self, target: Any) -> Any:
        """Copies an object to another address, and removes it here."""
        with _readable(self):
            self._store.move(self.key, ObjectPath(str(target)).key)
        return target

    replace = rename


class _readable:  # noqa: N801  # a context
    """Gives errors of the library the address, and the type that errors of files have."""

    def __init__(self, path: ObjectPath) -> None:
        self._path = path

    def __enter__(self) -> None:
        pass

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if isinstance(error, OSError) and error.strerror is None:
            kind = FileNotFoundError if "Path does not exist" in str(error) else OSError
            raise kind(5, f"the store says: {error}", str(self._path)) from error


def _types() -> Any:
    from pyarrow.fs import FileType

    return FileType


def file_system() -> FileSystem:
    """Returns the S3 store of the environment.

    Raises:
        RecordError: this pyarrow cannot reach one.
    """
    return _s3(*endpoint_and_region(), os.getpid())


def endpoint_and_region() -> tuple[str | None, str | None]:
    """Returns the address of the store and its region, as the environment has them."""
    endpoint = next(filter(None, map(os.environ.get, _ENDPOINTS)), None)
    return endpoint, os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION")


@lru_cache(maxsize=4)
def _s3(endpoint: str | None, region: str | None, process: int) -> FileSystem:  # noqa: ARG001
    try:
        from pyarrow.fs import S3FileSystem
    except ImportError as error:
        raise RecordError("this pyarrow cannot reach an S3 store") from error
    settings: dict[str, Any] = {} if region is None else {"region": region}
    if endpoint is not None:
        url = urlsplit(endpoint)
        settings |= {"endpoint_override": url.netloc or endpoint, "scheme": url.scheme or "https"}
    return S3FileSystem(**settings)


def is_address(text: object) -> bool:
    """Checks whether a text or a path is an address in an object store.

    The text `s3:/run` is a local path. `Path("s3://bucket/run")` has one slash, too, and is an
    address unless there is a folder `s3:` here.
    """
    if isinstance(text, ObjectPath):
        return True
    if isinstance(text, Path):
        return _ADDRESS.fullmatch(str(text)) is not None and not Path(text.parts[0]).exists()
    return str(text).startswith(_PREFIX) and str(text) != _PREFIX


def written(place: ObjectPath, write: Callable[[Path], None]) -> None:
    """Writes an object as a whole, by a function that writes a file."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / place.name
        write(file)
        place.write_bytes(file.read_bytes())


def remove_tree(place: Path) -> None:
    """Removes a folder, or all objects below an address; whatever cannot be removed stays."""
    if not isinstance(place, ObjectPath):
        shutil.rmtree(place, ignore_errors=True)
    elif place.is_dir():
        file_system().delete_dir(place.key)


def parquet_source(file: Path) -> Any:
    """Returns what the Parquet library opens: a path, or an open object."""
    return file.open("rb") if isinstance(file, ObjectPath) else file
