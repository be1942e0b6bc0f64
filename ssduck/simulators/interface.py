"""The interface between ssduck and a simulator.

A simulator describes its bodies once, and returns the poses of their links tick after tick.
Link 0 of a body is its base. Poses are those of the link frames
(not of the centres of mass), in the world frame. Lengths are metres, angles radians, and
quaternions w, x, y, z.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.margins import Margins
from ssduck.geometry.poses import cross, rotation_matrices
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.simulators.clock import Clock
from ssduck.simulators.scenes import Camera

Kind: TypeAlias = Literal["robot", "kinbody", "sensor"]
JointType: TypeAlias = Literal["revolute", "prismatic", "spherical", "planar", "free", "fixed"]
# The types of joints whose position is one number.
SCALAR_JOINTS = ("revolute", "prismatic")
# The simulator of worlds that do not name one.
DEFAULT_BACKEND = "pybullet"


@dataclass(frozen=True)
class Link:
    """A rigid part of a body, or a site on one: a named frame with a region around it.

    Attributes:
        name: the name of the link.
        parent: the index of its parent among the links of the body; -1 for the base.
        mass: kg.
        region: of a site, its region: a sphere, capsule, cylinder, ellipsoid or box around the
            origin of its frame, by which nothing collides; None for a rigid part.
        geoms: the names of its shapes in the simulator, for messages.
    """

    name: str
    parent: int
    mass: float
    region: Geometry | None = None
    geoms: tuple[str, ...] = field(default=(), compare=False)


@dataclass(frozen=True)
class Joint:
    """The connection of a link to its parent.

    Limits are radians or metres, efforts newton metres or newtons. None means no limit.

    Attributes:
        name: the name of the joint.
        type: the type of its motion.
        link: the index of the link that it moves, relative to its parent; the base moves relative
            to the world.
        lower: the lower limit of its position.
        upper: the upper limit of its position.
        max_effort: the greatest effort of its motor.
        max_velocity: its greatest velocity.
        axis: in the frame of `link`. A revolute joint turns the link about a unit axis. A prismatic
            joint shifts it by position times axis. For other types it is 0.
        anchor: a point of the axis, in the frame of `link`, m.
        reference: the position at which the joint moves nothing, rad or m.

    Several joints may move one link: each moves it together with the axes of the later ones, so
    that `axis` and `anchor` are those in the frame before the later joints move it.
    """

    name: str
    type: JointType
    link: int
    lower: float | None
    upper: float | None
    max_effort: float | None
    max_velocity: float | None
    axis: tuple[float, float, float] = (0.0, 0.0, 0.0)
    anchor: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reference: float = 0.0


@dataclass(frozen=True, eq=False)
class Body:
    """The links, joints and shapes of a body.

    Attributes:
        handle: the simulator's number of the body. Simulators may reuse the number of a removed
            body.
        name: as given by the scene, the caller or the model file; not yet unique.
        kind: robot or kinbody.
        movable: whether the simulation can move any of its links.
        links: link 0 is the base; parents come before their children. Sites come last: each is
            fixed to its parent, a rigid part.
        joints: any number for each link, in the order of the links.
        shapes: the collision shapes; `PlacedGeometry.frame` is the index of the link.
        visuals: of a recorded body, what was drawn of it; None if the simulator tells, or nobody.
        unread: the kinds of the named parts of the model that worlds do not read, for messages.
    """

    handle: int
    name: str
    kind: Kind
    movable: bool
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    shapes: tuple[PlacedGeometry, ...]
    visuals: tuple[PlacedGeometry, ...] | None = None
    unread: Mapping[str, str] = field(default_factory=dict)

    @property
    def masses(self) -> list[float]:
        """The masses of the links when the body was described, kg."""
        return [link.mass for link in self.links]

    @property
    def rigid_count(self) -> int:
        """The number of links that are no sites."""
        return sum(link.region is None for link in self.links)

    @property
    def margins(self) -> list[float]:
        """The collision margins of the shapes when the body was described, m."""
        return [shape.margin for shape in self.shapes]

    @property
    def has_stand_ins(self) -> bool:
        """Whether a bounding box is known to stand in for one of its shapes."""
        return any(shape.exact is False for shape in self.shapes)

    @property
    def bends(self) -> bool:
        """Whether spheres about vertices stand in for a form that bends."""
        return any(s.exact is False and s.geometry.type == "sphere" for s in self.shapes)


class LinkPoses:
    """The poses and velocities of n links in the world.

    Args:
        positions: (n, 3), the origins of the link frames, or a function of these poses that returns
            them when they are needed.
        states: (n, 13), or a function that returns them when they are needed: a point of the link
            (its centre of mass) x y z, the orientation of the link frame w x y z, the velocity of
            the point x y z, the angular velocity x y z.
        are_finite: whether the states are surely finite.
        orientations: (n, 4), those of the states, if they are there before these.

    Attributes:
        are_finite: see above.
    """

    def __init__(
        self,
        positions: Array | Callable[[LinkPoses], Array],
        states: Array | Callable[[], Array],
        *,
        are_finite: bool = False,
        orientations: Array | None = None,
    ) -> None:
        self.are_finite = are_finite
        self._positions, self._states, self._orientations = positions, states, orientations

    @classmethod
    def joined(cls, ticks: Sequence[LinkPoses]) -> LinkPoses:
        """Returns the poses of the same links at several ticks, one tick after the other."""
        if len(ticks) == 1:
            return ticks[0]
        positions = np.concatenate([tick.positions for tick in ticks])
        states = np.concatenate([tick.states for tick in ticks])
        return cls(positions, states, are_finite=all(tick.are_finite for tick in ticks))

    @cached_property
    def positions(self) -> Array:
        """The origins of the link frames, (n, 3)."""
        return self._positions(self) if callable(self._positions) else self._positions

    @cached_property
    def matrices(self) -> Array:
        """The orientations of the link frames, (n, 3, 3): those of the quaternions, to the bit."""
        with np.errstate(invalid="ignore"):
            return rotation_matrices(self.orientations)

    @cached_property
    def states(self) -> Array:
        """The states, (n, 13)."""
        return self._states() if callable(self._states) else self._states

    @property
    def orientations(self) -> Array:
        """The orientations of the link frames, (n, 4)."""
        return self.states[:, 3:7] if self._orientations is None else self._orientations

    def states_at(self, points: Array, links: Indices) -> Array:
        """Returns the states of some links, stated at other points of them.

        Args:
            points: (m, 3), points of the links, in the world.
            links: (m,), the rows of the links.

        Returns:
            (m, 13), as `states`.
        """
        states = self.states.take(links, axis=0)
        states[:, 7:10] += cross(states[:, 10:], points - states[:, :3])
        states[:, :3] = points
        return states


@dataclass(frozen=True)
class ContactPoints:
    """Contact points of the physics solver, in the world; normals point from body b to body a.

    Attributes:
        bodies: (n, 2), the handles of bodies a and b.
        links: (n, 2), the links of bodies a and b.
        points: (n, 2, 3), the points on a and on b where the forces act, m.
        normals: (n, 3), of length 1.
        depths: (n,), the penetration depths, m.
        forces: (n,), the forces along the normals, N.
        frictions: (n, 3), the friction forces on a, N.
        has_moments: whether some have moments besides their forces, which `torque` leaves out.
    """

    bodies: Indices
    links: Indices
    points: Array
    normals: Array
    depths: Array
    forces: Array
    frictions: Array
    has_moments: bool = False

    @classmethod
    @cache
    def none(cls) -> ContactPoints:
        """Returns no contact points, the same each time."""
        pairs, vectors, numbers = np.zeros((0, 2), dtype=np.intp), np.zeros((0, 3)), np.zeros(0)
        return cls(pairs, pairs, np.zeros((0, 2, 3)), vectors, numbers, numbers, vectors)

    @classmethod
    def joined(cls, ticks: Sequence[ContactPoints]) -> tuple[ContactPoints, Indices]:
        """Returns all contacts of several ticks, and the number of each tick's."""
        columns: dict[str, Any] = {
            name: np.concatenate([getattr(one, name) for one in ticks]) for name in ticks[0].columns
        }
        points = cls(**columns, has_moments=any(one.has_moments for one in ticks))
        return points, np.array([len(one) for one in ticks], np.intp)

    def only(self, chosen: Flags | slice) -> ContactPoints:
        """Returns some of them."""
        return replace(self, **{name: values[chosen] for name, values in self.columns.items()})

    @property
    def columns(self) -> dict[str, Any]:
        """The arrays by their names."""
        return {name: values for name, values in vars(self).items() if name != "has_moments"}

    def between(self, a: int, b: int, *, pressing: bool) -> tuple[Indices, Indices]:
        """Returns the bodies and links, (n, 2) each, of those of two bodies: all, or that press."""
        is_of_both = (self.bodies == (a, b)).all(axis=1) | (self.bodies == (b, a)).all(axis=1)
        rows = (is_of_both & (self.forces > 0) if pressing else is_of_both).nonzero()[0]
        return self.bodies[rows], self.links[rows]

    def __len__(self) -> int:
        return len(self.depths)


@dataclass(frozen=True)
class MotorTarget:
    """The target of a joint's motor from the next step on.

    Attributes:
        position: the position to reach and to hold, rad or m; None for velocity control.
        velocity: the velocity to hold if there is no position, rad/s or m/s.
        effort: the greatest effort, N m or N.
        speed: the greatest speed on the way to the position, rad/s or m/s; None for no limit.
    """

    position: float | None
    velocity: float
    effort: float
    speed: float | None


@dataclass(frozen=True, eq=False)
class RayHits:
    """The bodies that n rays hit first.

    Attributes:
        bodies: (n,), the handles of the bodies; -1 for no hit.
        fractions: (n,), the fraction of its length at which each ray hits; 1 for no hit.
    """

    bodies: Indices
    fractions: Array


@dataclass(frozen=True, eq=False)
class CameraView:
    """The view of a camera on a body. The camera looks along its +x axis; +z is up.

    Attributes:
        position: (3,), in the world.
        matrix: (3, 3), its orientation in the world.
        fov: the vertical field of view, degrees.
        width: of the image, pixels.
        height: of the image, pixels.
    """

    position: Array
    matrix: Array
    fov: float
    width: int
    height: int


class Simulator(Protocol):
    """One running simulation.

    Ticks need `describe`, the properties and the methods `read_…`. Each of the other methods serves
    one function of worlds. A method that a simulator does not support raises `UnsupportedError`.
    """

    @property
    def backend(self) -> str:
        """The name of its backend, which copies and saves it; see `BACKENDS`."""

    @property
    def time(self) -> float:
        """Simulated seconds since the start."""

    @property
    def timestep(self) -> float:
        """The length of the next step, simulated seconds; 0 if there are no steps."""

    @property
    def clock(self) -> Clock:
        """The clock that counts simulated time; a new object after each step."""

    @property
    def keeps_time(self) -> bool:
        """Whether an external simulation counts its own time; else the ticks tell it.

        Such a time may fall where the user has reset the simulation: a new episode begins.
        """

    @property
    def episode(self) -> int:
        """A number that changes when the user is known to have reset the simulation."""

    def begin_episode(self) -> None:
        """Changes `episode`, since the user has reset an external simulation; time may fall."""

    def set_clock(self, clock: Clock) -> None:
        """Replaces the clock of an external simulation that does not keep its time."""

    @property
    def is_external(self) -> bool:
        """Whether the user runs it: bodies may come, go and move between two ticks."""

    @property
    def disabled(self) -> frozenset[Body]:
        """The bodies that take no part in collisions; the same object until they change."""

    @property
    def hidden(self) -> frozenset[Body]:
        """The bodies that are not drawn; the same object until they change."""

    def describe(self) -> tuple[list[Body], list[Body]] | None:
        """Returns the bodies that came and those that went since the last call; None if none did.

        A `Body` stays the same object until it goes. A body that comes back is a new object.
        """

    def read_link_poses(self, bodies: tuple[Body, ...]) -> LinkPoses:
        """Returns the poses of all links of some bodies, body after body, as they are now.

        The arrays are not written to afterwards. The bodies are the same object for as long as they
        are the same.
        """

    def read_joints(self, bodies: Sequence[Body]) -> Array:
        """Returns the position, velocity and effort of the joints of some bodies, (joints, 3).

        They are NaN for a joint whose position is not one number.
        """

    def read_masses(self, bodies: Sequence[Body]) -> list[list[float]]:
        """Returns the masses of bodies' links, kg; the last known ones if a body is gone."""

    def read_margins(self, bodies: Sequence[Body]) -> Margins:
        """Returns the margins of all shapes of bodies; the last known ones if a body is gone.

        The same object if the simulator knows that nothing has changed.
        """

    def has_moved_on(self, sample: Sequence[Body]) -> bool:
        """Checks whether the user changed an external simulation since the last tick.

        Args:
            sample: some bodies of the last tick. A simulation that does not keep its time has them
                checked for being there still; their poses are compared elsewhere.
        """

    def read_contacts(self) -> ContactPoints:
        """Returns the contact points of the last step; later steps do not change them."""

    def cast_rays(self, starts: Array, ends: Array, through: Indices) -> RayHits:
        """Returns the first body that each ray hits now.

        A ray does not hit a body that it begins in.

        Args:
            starts: (n, 3), the starts of the rays.
            ends: (n, 3), their ends.
            through: (n,), the handle of the body that each ray passes through.
        """

    def photograph(self, view: CameraView) -> npt.NDArray[np.uint8]:
        """Returns the colour image of a camera on a body, without shadows, (height, width, 3)."""

    def step(self, count: int) -> None:
        """Advances by a number of steps."""

    def place(self, body: Body, position: Array, orientation: Array) -> None:
        """Puts the base link frame of a body at a pose, at rest."""

    def set_joints(self, body: Body, positions: Mapping[int, float]) -> None:
        """Sets joints of a body, at rest: rad or m, by the index of the joint."""

    def drive(self, body: Body, motors: Mapping[int, MotorTarget]) -> None:
        """Sets motors of a body for the next steps, by the index of the joint."""

    def has_constraint(self, body: Body, other: Body) -> bool:
        """Checks whether a fixed constraint connects a link of a body to the base of another."""

    def add_constraint(self, body: Body, link: int, other: Body) -> None:
        """Adds a fixed constraint between a link of a body and the base of another, as they are."""

    def remove_constraint(self, body: Body, other: Body) -> None:
        """Removes the fixed constraints between links of a body and the base of another."""

    def enable(self, body: Body, on: bool) -> None:
        """Switches the collisions of a body on or off."""

    def show(self, body: Body, on: bool) -> None:
        """Shows or hides a body in images."""

    def remove(self, body: Body) -> None:
        """Removes a body; `describe` reports that it went."""

    def render(
        self, camera: Camera, width: int, height: int, *, shadow: bool
    ) -> npt.NDArray[np.uint8]:
        """Returns the colour image of a camera, (height, width, 3), with or without shadows."""

    def segment(self, camera: Camera, width: int, height: int) -> tuple[Indices, Indices]:
        """Returns the handle of the body in each pixel, (height, width), and its link's number.

        Both are -1 where there is no body.
        """

    def close(self) -> None:
        """Releases the simulation; one that the user made goes on running."""
