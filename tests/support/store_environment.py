"""Names an object store on the loopback in the environment."""

from contextlib import contextmanager

import pytest

from ssduck.recording.stores import object_store


@contextmanager
def store_environment(address, **others):
    """Has the environment name a store, and forgets it afterwards.

    Args:
        address: the address of the server.
        others: further variables of the environment.
    """
    settings = {
        "AWS_ENDPOINT_URL": address,
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_REGION": "us-east-1",
        "AWS_EC2_METADATA_DISABLED": "true",
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (settings | others).items():
            patch.setenv(name, value)
        try:
            yield
        finally:
            object_store._s3.cache_clear()
