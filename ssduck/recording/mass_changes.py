"""Warns of masses that change while a world is recorded: a record has the first ones only."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from ssduck.errors import SimulatorError, warn
from ssduck.formatting import joined_names
from ssduck.schema import MASSES

if TYPE_CHECKING:
    from ssduck.world.ticking import SteppedSimulation


class MassChanges:
    """The bodies of a record whose masses have changed since they were recorded."""

    def __init__(self) -> None:
        self._names: dict[int, str] = {}
        # How many of them a warning has named.
        self._warned = 0

    def add(self, id: int, name: str) -> None:
        """Adds a body by the id and the name of its entity."""
        self._names[id] = name

    def warn(self, world: SteppedSimulation) -> None:
        """Reads the masses of a recorded world, and warns once of each body whose mass changed."""
        with suppress(SimulatorError):  # the simulator may be gone
            world.request_tables((MASSES,))
        new = list(self._names.values())[self._warned :]
        self._warned += len(new)
        if new:
            warn(
                f"{world.name}: {joined_names(new)}: the mass was changed while it is recorded; "
                "recorded ticks have the mass that a body had when it was first recorded",
            )
