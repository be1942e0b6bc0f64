"""A local S3 server on the loopback."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from ssduck.recording.stores import object_store


@contextmanager
def s3_server(bucket: str) -> Iterator[str]:
    """Yields the address of a server with a bucket, which the environment names meanwhile."""
    from moto.server import ThreadedMotoServer
    from pyarrow.fs import S3FileSystem

    running = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    running.start()
    host, port = running.get_host_and_port()
    settings = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_REGION": "us-east-1",
        "AWS_EC2_METADATA_DISABLED": "true",
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, value in settings.items():
            patch.setenv(name, value)
        S3FileSystem(
            endpoint_override=f"{host}:{port}", scheme="http", allow_bucket_creation=True
        ).create_dir(bucket)
        yield f"http://{host}:{port}"
    object_store._s3.cache_clear()
    running.stop()
