"""Simulators that lack methods of `Simulator`: their base class, and one in which nothing moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np

from ssduck.errors import UnsupportedError
from ssduck.geometry.arrays import Array
from ssduck.geometry.margins import Margins
from ssduck.simulators.clock import Clock
from ssduck.simulators.interface import DEFAULT_BACKEND, Body, ContactPoints, LinkPoses


def unsupported(action: str, instead: str = "") -> Callable[..., Any]:
    """Returns a method that raises `UnsupportedError`.

    Args:
        action: what the simulator cannot do, to follow "cannot".
        instead: what the user can do instead, for the end of the message.
    """
    advice = f"; {instead}" if instead else ""
    return _refusing(lambda simulator: f"{type(simulator).__name__} cannot {action}{advice}")


def _refusing(message: Callable[[Any], str]) -> Callable[..., Any]:
    """Returns a method that raises `UnsupportedError`, with the message for its simulator."""

    def refuse(self: object, *_: Any, **__: Any) -> NoReturn:
        raise UnsupportedError(message(self))

    return refuse


class PartialSimulator:
    """The methods of `Simulator` that ticks do not need; most raise `UnsupportedError`.

    A simulator derives from it and overrides the methods that it supports. Masses and margins are
    those of the bodies as described.

    >>> PartialSimulator().remove(None)
    Traceback (most recent call last):
    ssduck.errors.UnsupportedError: PartialSimulator cannot remove bodies
    """

    keeps_time = False
    episode = 0

    begin_episode = unsupported("begin an episode")
    set_clock = unsupported("follow the clock of an external simulation")
    cast_rays = unsupported("cast the rays of sensors")
    photograph = render = segment = unsupported("draw images")
    place = unsupported("move bodies")
    set_joints = unsupported("set joints")
    drive = unsupported("drive joints")
    has_constraint = add_constraint = remove_constraint = unsupported("connect bodies")
    enable = unsupported("switch collisions on or off")
    show = unsupported("show or hide bodies")
    remove = unsupported("remove bodies")

    def has_moved_on(self, sample: Sequence[Any]) -> bool:  # noqa: ARG002
        """Returns False: nothing changes between two ticks."""
        return False

    def read_masses(self, bodies: Sequence[Body]) -> list[list[float]]:
        """Returns the masses of bodies' links as they were described, kg."""
        return [body.masses for body in bodies]

    def read_margins(self, bodies: Sequence[Body]) -> Margins:
        """Returns the margins of bodies' shapes as they were described."""
        return Margins(np.array([margin for body in bodies for margin in body.margins]))

    def close(self) -> None:
        """Does nothing: it holds no resources."""


@dataclass(frozen=True, eq=False)
class StaticSimulator(PartialSimulator):
    """The known state of bodies, behind the interface of a simulator.

    It runs what-if worlds and recorded ticks.
    """

    time: float  # simulated seconds
    # The poses of the links, by the sequence of bodies that are read together.
    link_poses: Mapping[tuple[Body, ...], LinkPoses]
    joints: Mapping[Body, Array]  # position, velocity and effort of each body's joints, (joints, 3)
    disabled: frozenset[Body]  # the bodies that take no part in collisions
    hidden: frozenset[Body]  # the bodies that are not drawn
    contacts: ContactPoints = field(default_factory=ContactPoints.none)  # the contacts of the tick
    description: str = "a what-if world"  # the noun for the world in errors
    is_external: bool = False
    backend: str = DEFAULT_BACKEND  # the backend that makes running simulations of its bodies
    margins: Margins | None = None  # those of pairs of shapes, too; None for those of the bodies
    timestep = 0.0  # there are no steps

    @property
    def clock(self) -> Clock:
        return Clock(self.timestep, self.time)

    def describe(self) -> None:
        """Returns None: no body comes or goes."""

    def read_link_poses(self, bodies: tuple[Body, ...]) -> LinkPoses:
        return self.link_poses[bodies]

    def read_joints(self, bodies: Sequence[Body]) -> Array:
        return np.concatenate([np.zeros((0, 3)), *(self.joints[body] for body in bodies)])

    def read_margins(self, bodies: Sequence[Body]) -> Margins:
        return super().read_margins(bodies) if self.margins is None else self.margins

    def read_contacts(self) -> ContactPoints:
        return self.contacts

    step = _refusing(
        lambda it: (
            f"{it.description} is not simulated: it cannot be stepped; step the world that "
            "it was taken from"
        )
    )
    begin_episode = set_clock = place = set_joints = drive = enable = show = remove = _refusing(
        lambda it: (
            f"{it.description} does not change: ask what if, "
            "world.what_if({name: pose}, joints={name: {joint: value}})"
        )
    )
    has_constraint = add_constraint = remove_constraint = place
    cast_rays = photograph = _refusing(
        lambda it: f"sensors perceive nothing in {it.description}: no simulation casts their rays"
    )
    render = segment = _refusing(
        lambda it: f"{it.description} has no picture: no simulator draws it"
    )
