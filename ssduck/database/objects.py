"""Lets DuckDB read the objects of an object store."""

from __future__ import annotations

import duckdb

from ssduck.errors import UnsupportedError
from ssduck.recording.stores.object_store import file_system


def reach_objects(connection: duckdb.DuckDBPyConnection) -> None:
    """Lets a connection read objects of the S3 store of the environment.

    Raises:
        UnsupportedError: the extra `s3` is not installed.
    """
    try:
        from fsspec.implementations.arrow import ArrowFSWrapper
    except ModuleNotFoundError as error:
        raise UnsupportedError(
            "fsspec is not installed, by which DuckDB reads objects; pip install 'ssduck[s3]' does "
            "it"
        ) from error
    if not connection.filesystem_is_registered("s3"):
        named = type("S3Objects", (ArrowFSWrapper,), {"protocol": "s3"})
        connection.register_filesystem(named(file_system()))
