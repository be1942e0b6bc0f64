"""Warns of a loop that steps its own client and forgets `tick`."""

from __future__ import annotations

import threading
from contextlib import suppress
from types import CodeType

import numpy as np

from ssduck.errors import ProgramWarning, SimulatorError, calling_place, warn
from ssduck.simulators.interface import Body, Simulator
from ssduck.world.layout import TableLayout
from ssduck.world.snapshot import Snapshot

# The largest number of bodies with joints, and of others, whose poses are compared.
_SAMPLE = 4


class StaleTickCheck:
    """Compares the poses of some bodies of an attached client with those of the last tick.

    Reading all poses would cost as much as a tick at each query. Each place in the user's program
    is told once of poses, and once of a simulation that is another one.
    """

    def __init__(self) -> None:
        self._told: set[tuple[tuple[CodeType, int], bool]] = set()
        self._thread = 0
        # The compared bodies of a layout.
        self._sample: tuple[TableLayout | None, tuple[Body, ...]] = None, ()

    def note_tick(self) -> None:
        """Notes which thread takes the ticks: others may ask between a step and its tick."""
        self._thread = threading.get_ident()

    def check(self, world: str, simulator: Simulator, snapshot: Snapshot) -> None:
        """Warns if the client has moved on since the last tick, once in each place."""
        if not simulator.is_external or self._thread != threading.get_ident():
            return
        with suppress(SimulatorError):  # the last tick can be queried without the client
            bodies = self._bodies(snapshot)
            has_changed = simulator.has_moved_on(bodies)
            if not has_changed and not (
                bodies and not simulator.keeps_time and _have_moved(bodies, simulator, snapshot)
            ):
                return
            told = calling_place(), has_changed
            if told in self._told:
                return
            self._told.add(told)
            calls = "step"
            if not simulator.keeps_time:
                calls = (
                    "stepSimulation, or tick(steps=n) after n of them, and begin_episode() after a "
                    "reset"
                )
            warn(
                f"{world}: the client has moved on since the last tick, which queries see "
                f"(t={snapshot.time:g} s); call tick() after each {calls}",
                ProgramWarning,
            )

    def _bodies(self, snapshot: Snapshot) -> tuple[Body, ...]:
        layout = snapshot.layout
        if self._sample[0] is not layout:
            bodies = layout.moving_bodies.bodies
            jointed = [body for body in bodies if body.joints]
            others = [body for body in bodies if body.movable and not body.joints]
            # Of the others, the last loaded.
            self._sample = layout, (*jointed[:_SAMPLE], *others[-_SAMPLE:])
        return self._sample[1]


def _have_moved(bodies: tuple[Body, ...], simulator: Simulator, snapshot: Snapshot) -> bool:
    """Checks whether some bodies are elsewhere than at the last tick."""
    now = simulator.read_link_poses(bodies).states[:, :3]
    for group, poses in snapshot.body_groups:
        if group is snapshot.layout.moving_bodies:
            rows = np.concatenate([np.arange(len(poses.states))[group.runs[b]] for b in bodies])
            return not np.array_equal(now, poses.states[rows, :3], equal_nan=True)
    return False
