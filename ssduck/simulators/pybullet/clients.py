"""PyBullet, imported silently: the output of its C code, its clients, and their bodies."""

from __future__ import annotations

import gc
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import repeat

from ssduck.errors import SimulatorError


@contextmanager
def new_client() -> Iterator[int]:
    """Connects a new client, and disconnects it if the body of the `with` statement fails."""
    client = _connected()
    if client < 0:
        # Worlds that are no longer referenced keep their clients until they are collected.
        gc.collect()
        client = _connected()
    if client < 0:
        raise SimulatorError("PyBullet could not make another client; close worlds")
    try:
        yield client
    except BaseException:
        with captured():  # PyBullet reports the memory of an empty model file
            pybullet.disconnect(client)
        raise


def _connected() -> int:
    try:
        return int(pybullet.connect(pybullet.DIRECT))
    except pybullet.error:
        return -1


def all_handles_of(client: int) -> list[int]:
    """Returns the numbers of the bodies of a client's simulation.

    A client keeps a list of bodies. `createMultiBody(batchPositions=…)` adds the last one only.
    """
    pybullet.syncBodyInfo(client)
    pybullet.syncUserData(physicsClientId=client)  # the list of bodies had those of each
    return handles_of(client)


def handles_of(client: int) -> list[int]:
    """Returns the numbers of the bodies in a client's list; see `all_handles_of`."""
    count = pybullet.getNumBodies(client)
    return list(map(pybullet.getBodyUniqueId, range(count), repeat(client)))


@contextmanager
def captured() -> Iterator[list[str]]:
    """Captures the output of C code; at the end the list holds the lines."""
    lines: list[str] = []
    saved: dict[int, int] = {}
    with tempfile.TemporaryFile() as sink:
        try:
            for stream, number in ((sys.stdout, 1), (sys.stderr, 2)):
                if stream is not None:
                    stream.flush()
                with suppress(OSError):  # a daemon may have closed it
                    saved[number] = os.dup(number)
                    os.dup2(sink.fileno(), number)
            yield lines
        finally:
            for number, copy in saved.items():
                os.dup2(copy, number)
                os.close(copy)
            sink.seek(0)
            lines += sink.read().decode(errors="replace").splitlines()


with captured():  # PyBullet prints its build time
    import pybullet

__all__ = ["captured", "pybullet"]
