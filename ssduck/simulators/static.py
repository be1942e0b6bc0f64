"""Bodies at given poses: a `Simulator` in which no time passes and nothing moves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from ssduck.errors import UnsupportedError
from ssduck.geometry.arrays import Array
from ssduck.simulators.clock import Clock
from ssduck.simulators.interface import Body, Contact, LinkPoses


@dataclass(frozen=True, eq=False)
class StaticSimulator:
    """What is known of the bodies, behind the interface of a simulator.

    Attributes:
        time: simulated seconds.
        frames: of the bodies that are read together.
        joints: position, velocity and effort of each body's joints, (joints, 3).
        disabled: the bodies that take no part in collisions.
        hidden: the bodies that are not drawn.
        called: what such a world is called in errors.
        timestep: seconds of a step; there are none.
    """

    time: float
    frames: Mapping[tuple[Body, ...], LinkPoses]
    joints: Mapping[Body, Array]
    disabled: frozenset[Body]
    hidden: frozenset[Body]
    called: str = "a what-if world"
    watched: bool = False
    timestep: float = 0.0

    @property
    def clock(self) -> Clock:
        """A clock that stands still."""
        return Clock(self.timestep, self.time)

    def describe(self) -> None:
        """None comes, none goes."""

    def read_frames(self, bodies: tuple[Body, ...], *, links_move: bool) -> LinkPoses:  # noqa: ARG002
        """All frames of these bodies; the velocities of links are known in any case."""
        return self.frames[bodies]

    def read_joints(self, bodies: Sequence[Body]) -> Array:
        """Position, velocity and effort of these bodies' joints, (joints, 3)."""
        return np.concatenate([np.zeros((0, 3)), *(self.joints[body] for body in bodies)])

    def read_masses(self, bodies: Sequence[Body]) -> list[list[float]]:
        """As they are known."""
        return [body.masses for body in bodies]

    def read_margins(self, bodies: Sequence[Body]) -> list[list[float]]:
        """As they are known."""
        return [body.margins for body in bodies]

    def read_contacts(self) -> Iterable[Contact]:
        """None are known: they are what a solver finds."""
        return ()

    def step(self, count: int) -> None:  # noqa: ARG002
        """Refuse."""
        raise UnsupportedError(
            f"{self.called} is not simulated: it cannot be stepped; step the world that it was "
            "taken of"
        )

    def _refuse(self, *_: Any) -> NoReturn:
        raise UnsupportedError(
            f"{self.called} does not change: ask what if, "
            "world.what_if({name: pose}, joints={name: {joint: value}})"
        )

    set_clock = place = set_joints = drive = enable = show = remove = _refuse
    are_tied = tie = untie = _refuse

    def _perceive(self, *_: Any) -> NoReturn:
        raise UnsupportedError(
            f"sensors perceive nothing in {self.called}: no simulation casts their rays"
        )

    cast_rays = photograph = _perceive

    def render(self, *_: Any, **__: Any) -> NoReturn:
        """Refuse."""
        raise UnsupportedError(f"{self.called} has no picture: no simulator draws it")

    segment = render

    def close(self) -> None:
        """It holds nothing."""
