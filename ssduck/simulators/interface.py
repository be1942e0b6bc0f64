"""What ssduck needs of a simulator; one module a simulator implements it.

A simulator describes its bodies once (what they are made of) and then answers, tick after
tick, where their frames are. Frame 0 of a body is its base link, frame i + 1 its link i.
Positions and orientations are those of the link frames (not of the centres of mass), in the
world; orientations are w, x, y, z.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.poses import cross
from ssduck.geometry.shapes import PlacedGeometry
from ssduck.simulators.clock import Clock
from ssduck.simulators.scenes import Camera

Kind: TypeAlias = Literal["robot", "kinbody", "sensor"]
# The types of joints whose position is one number.
SCALAR_JOINTS = ("revolute", "prismatic")


@dataclass(frozen=True)
class Link:
    """A link of a body: its name, its parent's index among the links (none: -1), its mass."""

    name: str
    parent: int
    mass: float


@dataclass(frozen=True)
class Joint:
    """A joint between a link and its parent.

    Limits are radians or metres; `effort` newton metres or newtons; none is None.

    Attributes:
        axis: in the frame of `link`, which has its origin on it. A revolute joint turns the
            link about it, and it is of length 1; a prismatic one shifts it by position times
            axis; of other types it is 0.
    """

    name: str
    type: Literal["revolute", "prismatic", "spherical", "planar", "fixed"]
    link: int
    lower: float | None
    upper: float | None
    max_effort: float | None
    max_velocity: float | None
    axis: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Body:
    """What a body is made of.

    Attributes:
        handle: the simulator's own number; simulators may use it again for another body.
        name: as the scene, the caller or the model's file says; not yet unique.
        kind: robot or kinbody.
        movable: whether the simulation can move any of its frames.
        links: link 0 is the base; parents come before their children.
        joints: one for each link but the base, in the order of the links.
        shapes: collision shapes; `PlacedGeometry.frame` is the index of the link.
    """

    handle: int
    name: str
    kind: Kind
    movable: bool
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    shapes: tuple[PlacedGeometry, ...]

    @property
    def masses(self) -> list[float]:
        """Those of the links, kg, as they were read with the body."""
        return [link.mass for link in self.links]

    @property
    def margins(self) -> list[float]:
        """Those of the shapes, m, as they were read with the body."""
        return [shape.margin for shape in self.shapes]

    @property
    def has_stand_ins(self) -> bool:
        """Whether a box is known to stand in for some of its shapes."""
        return any(shape.exact is False for shape in self.shapes)


@dataclass(frozen=True, eq=False)
class LinkPoses:
    """Where n link frames are and how their links move, in the world.

    Attributes:
        positions: (n, 3), of the frames' origins.
        matrices: (n, 3, 3), their orientations.
        states: (n, 13): a point of the link (its centre of mass) x y z, the orientation of the
            frame w x y z, the velocity of that point x y z, the angular velocity x y z.
    """

    positions: Array
    matrices: Array
    states: Array

    def at(self, points: Array, links: Indices) -> Array:
        """The states (n, 13) of these links, told of points (n, 3) of theirs."""
        states = self.states.take(links, axis=0)
        states[:, 7:10] += cross(states[:, 10:], points - states[:, :3])
        states[:, :3] = points
        return states


@dataclass(frozen=True)
class Contact:
    """A contact point of the solver, in the world frame; the normal points from b to a.

    Attributes:
        force: along the normal, N.
        friction: across it, on a, N.
    """

    body_a: int
    link_a: int
    body_b: int
    link_b: int
    point_a: tuple[float, float, float]
    point_b: tuple[float, float, float]
    normal: tuple[float, float, float]
    depth: float
    force: float
    friction: tuple[float, float, float]


@dataclass(frozen=True)
class MotorTarget:
    """What the motor of a joint is to do from the next step on.

    Attributes:
        position: where it takes the joint and holds it, rad or m; None for one that turns.
        velocity: how fast it turns the joint, rad/s or m/s, if it has no position to take it to.
        effort: the most that it gives, N m or N.
        speed: how fast it goes to its position at most, rad/s or m/s; None for no bound.
    """

    position: float | None
    velocity: float
    effort: float
    speed: float | None


@dataclass(frozen=True, eq=False)
class RayHits:
    """What n rays end on.

    Attributes:
        bodies: (n,), the bodies' handles; -1 for none.
        fractions: (n,), how far along its way each ray ends; 1 for none.
    """

    bodies: Indices
    fractions: Array


@dataclass(frozen=True, eq=False)
class CameraView:
    """What a camera on a body looks at: along its own +x, +z up.

    Attributes:
        position: (3,), in the world.
        matrix: (3, 3), its orientation in the world.
        fov: the vertical angle, degrees.
        width: of the picture, pixels.
        height: of the picture, pixels.
    """

    position: Array
    matrix: Array
    fov: float
    width: int
    height: int


class Simulator(Protocol):
    """One running simulation."""

    @property
    def time(self) -> float:
        """Simulated seconds since the start."""

    @property
    def timestep(self) -> float:
        """Simulated seconds that the next step takes; 0 where there are no steps."""

    @property
    def clock(self) -> Clock:
        """What counts the simulated time; another one with each step."""

    def set_clock(self, clock: Clock) -> None:
        """Go by another clock: of a simulation that others step, the ticks tell the time."""

    @property
    def watched(self) -> bool:
        """Whether others may add, remove and move bodies between two ticks, and step it."""

    @property
    def disabled(self) -> frozenset[Body]:
        """The bodies that take no part in collisions; the same object until they change."""

    @property
    def hidden(self) -> frozenset[Body]:
        """The bodies that are not drawn; the same object until they change."""

    def describe(self) -> tuple[list[Body], list[Body]] | None:
        """Bodies that came and bodies that went since the last call; None if none did."""

    def read_frames(self, bodies: tuple[Body, ...], *, links_move: bool) -> LinkPoses:
        """All frames of these bodies, body after body, as they are now.

        Args:
            bodies: the same object as long as they are the same.
            links_move: whether velocities of links other than bases are asked for; else they
                may be NaN.
        """

    def read_joints(self, bodies: Sequence[Body]) -> Array:
        """Position, velocity and effort of these bodies' joints, (joints, 3)."""

    def read_masses(self, bodies: Sequence[Body]) -> list[list[float]]:
        """The masses of these bodies' links as they are now, kg; of what is gone, as they were."""

    def read_margins(self, bodies: Sequence[Body]) -> list[list[float]]:
        """The collision margins of these bodies' shapes, m; of what is gone, as they were."""

    def read_contacts(self) -> Iterable[Contact]:
        """The contacts of the last step."""

    def cast_rays(self, starts: Array, ends: Array, through: Indices) -> RayHits:
        """The nearest body that each ray meets, as everything is now; none that it begins in.

        Args:
            starts: (n, 3), where they begin.
            ends: (n, 3), where they end at the latest.
            through: (n,), the handle of the body that each passes through.
        """

    def photograph(self, view: CameraView) -> npt.NDArray[np.uint8]:
        """A colour picture without shadows, (height, width, 3)."""

    def step(self, count: int) -> None:
        """Advance by that many steps."""

    def place(self, body: Body, position: Array, orientation: Array) -> None:
        """Put a body's base link frame there, at rest."""

    def set_joints(self, body: Body, positions: Mapping[int, float]) -> None:
        """Set joints of a body, at rest: radians or metres by the number of the joint's link."""

    def drive(self, body: Body, motors: Mapping[int, MotorTarget]) -> None:
        """Set motors of a body's joints, by the number of the joint's link, for the next steps."""

    def are_tied(self, body: Body, other: Body) -> bool:
        """Whether the base of another body is tied to a link of a body, rigidly."""

    def tie(self, body: Body, link: int, other: Body) -> None:
        """Tie the base of another body to a link of a body, rigidly, as they are now."""

    def untie(self, body: Body, other: Body) -> None:
        """Remove what ties them so."""

    def enable(self, body: Body, on: bool) -> None:
        """Let a body take part in collisions, or not."""

    def show(self, body: Body, on: bool) -> None:
        """Draw a body, or do not."""

    def remove(self, body: Body) -> None:
        """Take a body out; `describe` tells that it went."""

    def render(
        self, camera: Camera, width: int, height: int, *, shadow: bool
    ) -> npt.NDArray[np.uint8]:
        """A colour picture, (height, width, 3), with shadows or without."""

    def segment(self, camera: Camera, width: int, height: int) -> Indices:
        """The handle of the body that each pixel of it shows, (height, width); -1 for none."""

    def close(self) -> None:
        """Give up what the simulator holds; a client that the user made stays connected."""
