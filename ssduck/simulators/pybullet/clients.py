"""PyBullet clients: connecting new ones, and the bodies that a client has."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import repeat

from ssduck.errors import SimulatorError
from ssduck.simulators.pybullet.console import pybullet


@contextmanager
def new_client() -> Iterator[int]:
    """A new client, that is disconnected again if what is done with it fails.

    Raises:
        SimulatorError: there are as many as PyBullet can have.
    """
    client = _connected()
    if client < 0:
        # Worlds that nobody has any more may wait to be collected, and hold theirs so long.
        gc.collect()
        client = _connected()
    if client < 0:
        raise SimulatorError("PyBullet could not make another client; close worlds")
    try:
        yield client
    except BaseException:
        pybullet.disconnect(client)
        raise


def _connected() -> int:
    try:
        return int(pybullet.connect(pybullet.DIRECT))
    except pybullet.error:
        return -1


def handles_of(client: int) -> list[int]:
    """The numbers of the client's bodies."""
    count = pybullet.getNumBodies(client)
    return list(map(pybullet.getBodyUniqueId, range(count), repeat(client)))
