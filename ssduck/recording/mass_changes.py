"""Masses that change while a world is recorded: records tell those that bodies had at first."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from ssduck.errors import SimulatorError, warn
from ssduck.formatting import joined_names
from ssduck.schema import MASSES

if TYPE_CHECKING:
    from ssduck.world.ticking import SteppedSimulation


class MassChanges:
    """The bodies of a record whose masses are known to have changed since they were recorded."""

    def __init__(self) -> None:
        self._names: dict[int, str] = {}
        # How many of them users were warned of.
        self._warned = 0

    def note(self, id: int, name: str) -> None:
        """Take note of one, by its id."""
        self._names[id] = name

    def warn(self, world: SteppedSimulation) -> None:
        """Read the masses of a world that is recorded, and warn of those that changed, once."""
        with suppress(SimulatorError):  # which may be gone
            world.request_tables((MASSES,))
        new = list(self._names.values())[self._warned :]
        self._warned += len(new)
        if new:
            warn(
                f"{world.name}: {joined_names(new)}: the mass was changed while it is recorded; "
                "recorded "
                "ticks tell the mass that a body had when it was first recorded",
            )
