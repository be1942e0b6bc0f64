"""Creates an object unless there is one, and changes one that nobody else changed meanwhile.

pyarrow has no such requests of S3 (`If-None-Match`, `If-Match`); boto3 has, which the extra `s3`
installs. A store that does not know them says so, and nothing is written then.
"""

from __future__ import annotations

import os
import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from ssduck.errors import RecordError
from ssduck.recording.stores.object_store import ObjectPath, endpoint_and_region

# How often an object is read and changed again because somebody else changed it meanwhile.
ATTEMPTS = 20
# The longest pause before that, s.
_PAUSE = 0.2
# A store answers so if the condition does not hold, or if another request is under way.
_MEANWHILE = (409, 412)


class _ChangedMeanwhileError(Exception):
    """The condition of a request did not hold."""


def create_object(place: ObjectPath, content: bytes) -> bool:
    """Creates an object unless there is one; returns whether there was none.

    Raises:
        RecordError: boto3 is not installed.
        OSError: the store refuses it.
    """
    try:
        with _answers(place):
            _client().put_object(**_address(place), Body=content, IfNoneMatch="*")
    except _ChangedMeanwhileError:
        return False
    return True


def change_object(place: ObjectPath, change: Callable[[bytes], bytes]) -> None:
    """Replaces the content of an object by what a function makes of it.

    If somebody else changes the object meanwhile, it is read and changed again.

    Raises:
        RecordError: boto3 is not installed; others changed the object each time.
        OSError: there is no such object, or the store refuses it.
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
