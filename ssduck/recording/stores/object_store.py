"""Lets records be in an object store: `ObjectPath` is an address there with the methods of a path.

An object is there as a whole or not at all, as a file is here once it was renamed. There are no
folders, links and renames.

What several processes create or change goes by conditional requests (`If-None-Match`, `If-Match`),
which pyarrow lacks and boto3 has; the extra `s3` installs it. A store that does not know them says
so, and nothing is written then.
"""

from __future__ import annotations

import fnmatch
import os
import random
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import urlsplit

from ssduck.errors import RecordError
from ssduck.formatting import short_repr

if TYPE_CHECKING:
    from pyarrow.fs import FileInfo, FileSystem

_ADDRESS = re.compile(r"s3:/+(?P<key>.+)", re.DOTALL)
_PREFIX = "s3://"
# What the environment says of the store, beside the credentials, which the library reads itself.
_ENDPOINTS = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL")


class ObjectError(RecordError):
    """An object cannot be read: the store refuses it, fails, or claims what cannot be."""


class MissingObjectError(ObjectError, FileNotFoundError):
    """There is no such object."""


class ObjectPath(type(Path())):  # type: ignore[misc]  # the path of this system
    """An address in an object store, `s3://bucket/run`: a path whose files are objects.

    Credentials, region and endpoint are those of the environment (`AWS_…`). What cannot be read
    raises an ObjectError.
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
        with reading(self):
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

    def stat(self, **_: Any) -> Any:
        """Returns the size of an object, as `st_size`."""
        info = self._info
        if info.type != _types().File:
            raise _missing(self)
        return SimpleNamespace(
            st_size=info.size, st_mode=stat.S_IFREG, st_mtime=info.mtime_ns / 1e9
        )

    def iterdir(self) -> Iterator[Self]:
        """Yields what is directly below it."""
        from pyarrow.fs import FileSelector

        with reading(self):
            found = self._store.get_file_info(FileSelector(self.key, allow_not_found=True))
        yield from (type(self)(_PREFIX + info.path) for info in found)

    def glob(self, pattern: str, **_: Any) -> Iterator[Self]:
        """Yields what is directly below it and has a name like a pattern."""
        yield from (entry for entry in self.iterdir() if fnmatch.fnmatchcase(entry.name, pattern))

    @contextmanager
    def open(self, mode: str = "r", *_: Any, **__: Any) -> Iterator[Any]:
        """Opens an object to be read, in a `with` statement."""
        if mode != "rb":
            raise OSError(95, "an object is written as a whole", str(self))
        with reading(self), self._store.open_input_file(self.key) as stream:
            yield stream

    def read_bytes(self) -> bytes:
        """Returns the content of an object."""
        with self.open("rb") as stream:
            size, content = stream.size(), stream.read()
            if len(content) < size:
                raise _cannot_read(self, f"its last {size - len(content):,} bytes are missing")
        return bytes(content)

    def write_bytes(self, content: Any) -> int:
        """Writes an object."""
        with _writing(self), self._store.open_output_stream(self.key) as stream:
            stream.write(content)
        return len(content)

    def mkdir(self, *_: Any, **__: Any) -> None:
        """Does nothing: there are no folders."""

    def unlink(self, missing_ok: bool = False) -> None:
        """Removes an object."""
        if missing_ok and not self.exists():
            return
        with _writing(self):
            self._store.delete_file(self.key)

    def rename(self, target: Any) -> Any:
        """Copies an object to another address, and removes it here."""
        with _writing(self):
            self._store.move(self.key, ObjectPath(str(target)).key)
        return target

    replace = rename


@contextmanager
def reading(path: ObjectPath) -> Iterator[None]:
    """Makes errors of the library those of a record, which name the object and what to do."""
    try:
        yield
    except RecordError:
        raise
    except OSError as error:
        if "Path does not exist" in str(error):
            raise _missing(path) from error
        raise _cannot_read(path, f"the store says: {error}") from error
    except (OverflowError, MemoryError, ValueError, NotImplementedError) as error:
        raise _cannot_read(path, f"{type(error).__name__}: {error}") from error


def _missing(path: ObjectPath) -> ObjectError:
    reason = "it was removed meanwhile, or the store lists what is not there; put it back"
    error = MissingObjectError(f"{path} is missing: {reason}")
    error.strerror = reason  # as those of files have
    return error


def _cannot_read(path: ObjectPath, problem: str) -> ObjectError:
    advice = "check the address, the credentials (AWS_…) and the network, or try again"
    error = ObjectError(f"{path} cannot be read: {problem}; {advice}")
    error.strerror = f"{problem}; {advice}"
    return error


@contextmanager
def _writing(path: ObjectPath) -> Iterator[None]:
    """Gives errors of the library the address, and the type that errors of files have."""
    try:
        yield
    except OSError as error:
        if error.strerror is not None:
            raise
        kind = FileNotFoundError if "Path does not exist" in str(error) else OSError
        raise kind(5, f"the store says: {error}", str(path)) from error


def _types() -> Any:
    from pyarrow.fs import FileType

    return FileType


def file_system() -> FileSystem:
    """Returns the S3 store of the environment."""
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


def written(place: ObjectPath, write: Callable[[Path], object]) -> None:
    """Writes an object as a whole, by a function that writes a file."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / place.name
        write(file)
        place.write_bytes(file.read_bytes())


def fetch(place: ObjectPath, folder: Path) -> Path:
    """Copies an object, or all below an address, into a folder, and returns where it is.

    Raises:
        RecordError: it cannot be read, or a name leads out of the folder.
    """
    from pyarrow.fs import FileSelector

    copy, store = Path(folder, place.name), file_system()
    with reading(place):
        found = [store.get_file_info(place.key)]
        if found[0].type == _types().Directory:
            found = store.get_file_info(FileSelector(place.key, recursive=True))
    for info in found:
        parts = Path(info.path).relative_to(place.key).parts
        if ".." in parts:
            raise RecordError(f"{place}: the name {short_repr(info.path)} leads elsewhere")
        if info.type == _types().File:
            file = copy.joinpath(*parts)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(ObjectPath(_PREFIX + info.path).read_bytes())
    if not copy.exists():
        raise _missing(place)
    return copy


def remove_tree(place: Path) -> None:
    """Removes a folder, or all objects below an address; whatever cannot be removed stays."""
    if not isinstance(place, ObjectPath):
        shutil.rmtree(place, ignore_errors=True)
    elif place.is_dir():
        file_system().delete_dir(place.key)


def parquet_source(file: Path) -> Any:
    """Returns what the Parquet library opens: a path, or the content of an object."""
    import pyarrow as pa

    return pa.BufferReader(file.read_bytes()) if isinstance(file, ObjectPath) else file


# -- objects for DuckDB -----------------------------------------------------------------------

_MAGIC = re.compile(r"[*?[]")
# A letter of a pattern that stands for itself.
_ESCAPED = re.compile(r"\[([*?[])\]")


def duckdb_objects() -> Any:
    """Returns the objects of the store of the environment as DuckDB reads them, by fsspec."""
    from fsspec.implementations.arrow import ArrowFSWrapper

    class Objects(ArrowFSWrapper):  # type: ignore[misc]  # fsspec has no types
        """The objects of a store, by their addresses."""

        protocol = "s3"

        @classmethod
        def _strip_protocol(cls, path: str) -> str:
            """Returns the key of an address, which is no URL: `?` and `#` are letters of it."""
            return path.removeprefix("s3://")

        def glob(self, path: str, maxdepth: int | None = None, **options: Any) -> Any:
            """Returns the keys that a pattern matches; it lists nothing for one address."""
            if _MAGIC.search(_ESCAPED.sub("", path)):
                return super().glob(path, maxdepth, **options)
            exact = self._strip_protocol(_ESCAPED.sub(r"\1", path))
            return [exact] if self.exists(exact) else []

    return Objects(file_system())


# -- conditional requests ---------------------------------------------------------------------

# How often an object is read and changed again because somebody else changed it meanwhile.
ATTEMPTS = 20
# The longest pause before that, s.
_PAUSE = 0.2
# A store answers so if the condition does not hold, or if another request is under way.
_MEANWHILE = (409, 412)


class _ChangedMeanwhileError(Exception):
    """The condition of a request did not hold."""


def create_object(place: ObjectPath, content: bytes) -> bool:
    """Creates an object unless there is one; returns whether there was none."""
    try:
        with _answers(place):
            _client().put_object(**_address(place), Body=content, IfNoneMatch="*")
    except _ChangedMeanwhileError:
        return False
    return True


def change_object(place: ObjectPath, change: Callable[[bytes], bytes]) -> None:
    """Replaces the content of an object by what a function makes of it.

    If somebody else changes the object meanwhile, it is read and changed again.
    """
    for _ in range(ATTEMPTS):
        with _answers(place):
            found = _client().get_object(**_address(place))
            content = found["Body"].read()
        changed = change(content)
        try:
            with _answers(place):
                tag = found["ETag"]
                _client().put_object(**_address(place), Body=changed, IfMatch=tag)
        except _ChangedMeanwhileError:
            time.sleep(random.uniform(0.0, _PAUSE))  # noqa: S311  # no secret
        else:
            return
    raise RecordError(
        f"{place} was changed by others {ATTEMPTS} times while it was to be written: try again"
    )


def _address(place: ObjectPath) -> dict[str, str]:
    bucket, _, name = place.key.partition("/")
    return {"Bucket": bucket, "Key": name}


@contextmanager
def _answers(place: ObjectPath) -> Iterator[None]:
    """Gives errors of the library the address, and the type that errors of files have."""
    try:
        from botocore.exceptions import BotoCoreError, ClientError
    except ImportError as error:
        raise RecordError(
            "to begin or change an episode in an object store needs boto3: pip install 'ssduck[s3]'"
        ) from error
    try:
        yield
    except ClientError as error:
        status = error.response.get("ResponseMetadata", {}).get("HTTPStatusCode")
        if status in _MEANWHILE:
            raise _ChangedMeanwhileError from error
        kind = FileNotFoundError if status == 404 else OSError
        raise kind(5, f"the store says: {error}", str(place)) from error
    except BotoCoreError as error:
        raise OSError(5, f"the store says: {error}", str(place)) from error


def _client() -> Any:
    return _client_of(*endpoint_and_region(), os.getpid())


@lru_cache(maxsize=4)
def _client_of(endpoint: str | None, region: str | None, process: int) -> Any:  # noqa: ARG001
    import boto3
    from botocore.config import Config

    # Stores other than Amazon's have a bucket in the path, and may know no other checksums.
    style = {} if endpoint is None else {"addressing_style": "path"}
    config = Config(
        s3=style,
        request_checksum_calculation="when_required",
        response_checksum_validation="when_required",
    )
    return boto3.client("s3", endpoint_url=endpoint, region_name=region, config=config)
