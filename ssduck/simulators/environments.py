"""The states of many simulations of one model or world, each an *environment*, in arrays."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError, UnknownNameError, nearest
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.margins import Margins
from ssduck.simulators.clock import Clock
from ssduck.simulators.interface import SCALAR_JOINTS, Body, ContactPoints, LinkPoses, Simulator
from ssduck.simulators.kinematics import absolute_states, relative_states
from ssduck.simulators.partial import PartialSimulator, unsupported

# The libraries whose arrays cannot change.
_JAX = ("jax", "jaxlib")
# By so much the squares of the lengths of quaternions of single precision may differ from 1.
_LENGTH_TOLERANCE = 2e-3
NO_CONTACTS = (
    "the contacts of these environments are not known: give tick the data of MJX, or contact="
    "{'geom': (n, m, 2), 'dist': (n, m), 'force': (n, m)}"
)
# Arrays of any library, by name, with the environments on the first axis; or an object that has
# them as attributes, such as the data of MJX.
States: TypeAlias = Any


@dataclass(frozen=True, eq=False)
class EnvironmentContacts:
    """The contacts of all environments."""

    environments: Indices  # (m,), the environment of each contact, ascending
    # The contacts; the places where they are, and frictions, are NaN where not given.
    points: ContactPoints
    has_forces: bool = True  # whether their forces are known
    has_normals: bool = True  # whether their normals are known
    is_whole: bool = True  # whether their places and frictions are known

    def of(self, environment: int) -> ContactPoints:
        """Returns the contacts of an environment."""
        return self.points.only(self.environments == environment)


class Environments(ABC):
    """The states of many simulations of one model.

    Positions are metres, orientations quaternions w, x, y, z, in the world frame.
    """

    accepted: Sequence[str]  # the names of the arrays of a state

    def __init__(self, count: int) -> None:
        self.count = count  # the number n of environments
        # (n,), the simulated time of each, s, and whether the last states had times.
        self.times, self.has_times = np.zeros(count), False
        # An array of the last states as it was given, for the library of answers.
        self.sample: Any = None

    def check_names(self, given: Iterable[str], told: str) -> None:
        """Checks that arrays of some names are accepted."""
        for name in given:
            if name not in self.accepted:
                raise ArgumentError(
                    f"tick: {name!r} is no {told}", suggestions=nearest(name, self.accepted)
                )

    @abstractmethod
    def update(self, states: States, arrays: Mapping[str, Any]) -> None:
        """Takes the states that are read from now on."""

    def reset(self, environments: Indices) -> None:
        """Sets the times of some environments to 0; their states come with the next tick."""
        self.times = self.times.copy()  # earlier ones may be kept
        self.times[environments] = 0.0

    @abstractmethod
    def link_poses(self, bodies: tuple[Body, ...], environment: int) -> LinkPoses:
        """Returns the poses of the links of some bodies in an environment, body after body."""

    @abstractmethod
    def frames(self, body: Body, link: int) -> tuple[Array, Array]:
        """Returns the positions (n, 3) and the orientations (n, 4) of a link."""

    @abstractmethod
    def velocities(self, body: Body, link: int) -> Array:
        """Returns the linear (m/s) and angular (rad/s) velocities of a frame, (n, 6); or NaN."""

    @abstractmethod
    def joints(self, body: Body) -> Array:
        """Returns positions, velocities and efforts of joints, (n, joints, 3); NaN if unknown."""

    @abstractmethod
    def check_joints(self, body: Body) -> None:
        """Checks that the positions of a body's joints are known."""

    @property
    def knows_contacts(self) -> bool:
        """Whether the contacts are known; they may be read when they are asked for."""
        return False

    @property
    def contacts(self) -> EnvironmentContacts | None:
        """The contacts; None if they are not known."""
        return None


class EnvironmentSimulator(PartialSimulator):
    """The chosen one of many environments, from 0, as a `Simulator` that others run.

    Args:
        bodies: the bodies of the model.
        environments: their states; those of another tick may take their place.
        template: a simulator that has the bodies, and draws those of each environment.
        margins: returns the margins of shapes, as `Simulator.read_margins` does; by default those
            as described.
    """

    is_external = True
    keeps_time = True
    disabled: frozenset[Body] = frozenset()
    hidden: frozenset[Body] = frozenset()
    step = unsupported("step", "step your simulations, then give tick their state")

    def __init__(
        self,
        bodies: Sequence[Body],
        environments: Environments,
        template: Simulator,
        margins: Callable[[Sequence[Body]], Margins] | None = None,
    ) -> None:
        self.environments, self.chosen = environments, 0
        self.template = template
        self.backend, self.timestep = template.backend, template.timestep
        self._bodies = tuple(bodies)
        self._new: list[Body] = list(bodies)
        self._margins = margins

    def of(self, environment: int, environments: Environments) -> EnvironmentSimulator:
        """Returns one of the environments as a simulator of its own, with states of its own."""
        own = EnvironmentSimulator(self._bodies, environments, self.template, self._margins)
        own.chosen = environment
        return own

    @property
    def time(self) -> float:
        return float(self.environments.times[self.chosen])

    @property
    def clock(self) -> Clock:
        return Clock(self.timestep, self.time)

    def describe(self) -> tuple[list[Body], list[Body]] | None:
        new, self._new = self._new, []
        return (new, []) if new else None

    def read_link_poses(self, bodies: tuple[Body, ...]) -> LinkPoses:
        return self.environments.link_poses(bodies, self.chosen)

    def read_joints(self, bodies: Sequence[Body]) -> Array:
        parts = [self.environments.joints(body)[self.chosen] for body in bodies]
        return np.concatenate([np.zeros((0, 3)), *parts])

    def read_margins(self, bodies: Sequence[Body]) -> Margins:
        return (self._margins or super().read_margins)(bodies)

    def read_contacts(self) -> ContactPoints:
        contacts = self.environments.contacts
        return ContactPoints.none() if contacts is None else contacts.of(self.chosen)


def to_numpy(value: Any, name: str) -> npt.NDArray[Any]:
    """Returns an array of any library as one of NumPy; one on a device is copied to memory."""
    detached = value.detach() if hasattr(value, "detach") else value  # torch's, with a gradient
    on_host = detached.cpu() if hasattr(detached, "cpu") else detached
    try:
        array = np.asarray(on_host)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ArgumentError(f"{name}: {short_repr(value)} is no array: {error}") from None
    if array.dtype.kind not in "fiub":
        raise ArgumentError(f"{name}: an array of numbers is expected, not of {array.dtype}")
    return array


def like(values: npt.NDArray[Any], sample: Any) -> Any:
    """Returns a copy of an array of NumPy, of the library and on the device of another array."""
    copied = np.array(values)
    if type(sample).__module__.partition(".")[0] == "torch":
        import torch

        return torch.from_numpy(copied).to(sample.device)
    if isinstance(sample, np.ndarray) or not hasattr(sample, "__array_namespace__"):
        return copied
    return sample.__array_namespace__().asarray(copied, device=sample.device)


def kept(value: Any, name: str, shape: tuple[int | str, ...]) -> npt.NDArray[Any]:
    """Returns a checked array that stays as it is: simulators write the next state into theirs."""
    array = checked(value, name, shape)
    return array if type(value).__module__.partition(".")[0] in _JAX else np.array(array)


def checked(value: Any, name: str, shape: tuple[int | str, ...]) -> npt.NDArray[Any]:
    """Returns an array of a shape, of which a text stands for any number, as one of NumPy's."""
    array = to_numpy(value, name)
    fits = array.ndim == len(shape) and all(
        isinstance(expected, str) or actual == expected
        for actual, expected in zip(array.shape, shape, strict=True)
    )
    if not fits:
        first, *others = shape
        lacks_first = array.shape == tuple(others) or (array.ndim and array.shape[0] != first)
        hint = f": the first axis is the {first} environments" if lacks_first else ""
        raise ArgumentError(
            f"{name} is of shape {array.shape}, not ({', '.join(map(str, shape))}){hint}"
        )
    return array


def times_of(time: Any, count: int) -> Array:
    """Returns the simulated times of environments, s, (count,), from one number or an array."""
    given = to_numpy(time, "tick: time")
    times = checked(given, "tick: time", (count,)) if given.ndim else np.full(count, given)
    if not np.isfinite(times).all():
        raise ArgumentError("tick: time: simulated seconds are finite numbers")
    return np.array(times, np.float64)


def check_lengths(orientations: npt.NDArray[Any], name: str) -> None:
    """Checks that quaternions (n, m, 4) are of length 1; NaN is of a state that diverged."""
    w, x, y, z = (orientations[..., axis] for axis in range(4))
    squares = w * w + x * x + y * y + z * z
    least, most = squares.min(initial=1.0), squares.max(initial=1.0)
    if not 1.0 - _LENGTH_TOLERANCE <= least <= most <= 1.0 + _LENGTH_TOLERANCE:
        for environment, place in np.argwhere(np.abs(squares - 1.0) > _LENGTH_TOLERANCE).tolist():
            raise ArgumentError(
                f"{name}: the quaternion w, x, y, z at ({environment}, {place}) is of length "
                f"{np.sqrt(squares[environment, place]):.3g}, not 1"
            )


# The numbers of a pose, and of a pose with velocities.
_POSE, _STATE = 7, 13


class BodyEnvironments(Environments):
    """The states of environments that have the bodies of a world; see `Environments`.

    Args:
        bodies: the bodies by the names of their entities.
        states: the states of the links of each body at first, (links, 13); see `LinkPoses`.
        joints: the positions, velocities and efforts of its joints at first, (joints, 3).
        count: the number of environments.
    """

    accepted = ("poses", "joints", "time")

    def __init__(
        self,
        bodies: Mapping[str, Body],
        states: Mapping[Body, Array],
        joints: Mapping[Body, Array],
        count: int,
    ) -> None:
        super().__init__(count)
        self._bodies = bodies
        self._states, self._joints = (
            {body: np.broadcast_to(own, (count, *own.shape)) for body, own in initial.items()}
            for initial in (states, joints)
        )
        # The bodies with joints whose poses were given without these.
        self._moved: frozenset[Body] = frozenset()

    def update(self, states: States, arrays: Mapping[str, Any]) -> None:
        given = {**(states or {}), **arrays}
        self.check_names(
            given,
            "part of a state; give poses={'cup': (n, 7)}, joints={'arm': (n, joints)} and time",
        )
        posed = self._read(given, "poses", self._poses_of)
        jointed = self._read(given, "joints", self._joints_of)
        time = given.get("time")
        times = self.times if time is None else times_of(time, self.count)
        self.times, self.has_times = times, time is not None
        self.sample = next(iter((given.get("poses") or {}).values()), self.sample)
        self._states, self._joints = self._states | posed, self._joints | jointed
        self._moved = (self._moved | {body for body in posed if body.joints}) - jointed.keys()

    def _read(
        self, given: Mapping[str, Any], part: str, read: Callable[[str, Body, Any], Array]
    ) -> dict[Body, Array]:
        """Returns what a part of a state says of bodies, by a function of name, body and values."""
        by_name = given.get(part) or {}
        if not isinstance(by_name, Mapping):
            raise ArgumentError(f"tick: {part}: give a dict of arrays by the names of entities")
        for name in by_name:
            if name not in self._bodies:
                raise UnknownNameError(
                    f"tick: {part}: no body has the name {name!r}",
                    suggestions=nearest(name, list(self._bodies)),
                )
        return {self._bodies[n]: read(n, self._bodies[n], values) for n, values in by_name.items()}

    def _poses_of(self, name: str, body: Body, values: Any) -> Array:
        """Returns the states of a body's links, (n, links, 13)."""
        key, links = f"tick: poses[{name!r}]", len(body.links)
        array = to_numpy(values, key)
        if array.ndim == 2:
            if any(link.region is None for link in body.links[1:]) and any(
                joint.type != "fixed" for joint in body.joints
            ):
                raise ArgumentError(
                    f"{key}: {name} has {links} links, which joints move: give the poses of all, "
                    f"({self.count}, {links}, 7)"
                )
            array = array[:, None]
        size = array.shape[-1] if array.shape[-1] in (_POSE, _STATE) else _POSE
        rows = 1 if array.shape[1] == 1 else links
        own = checked(array, key, (self.count, rows, size)).astype(np.float64)
        check_lengths(own[..., 3:7], key)
        if size == _POSE:
            own = np.concatenate((own, np.full((*own.shape[:2], _STATE - _POSE), np.nan)), axis=2)
        return own if rows == links else self._rigid(body, own[:, 0])

    def _rigid(self, body: Body, base: Array) -> Array:
        """Returns the states of all links of a body without joints, from those of its base."""
        first = self._states[body][0]
        within = relative_states(np.broadcast_to(first[0], first.shape), first)
        within[:, 7:] = 0.0
        links = np.tile(within, (self.count, 1))
        states = absolute_states(np.repeat(base, len(first), axis=0), links)
        return states.reshape(self.count, len(first), _STATE)

    def _joints_of(self, name: str, body: Body, values: Any) -> Array:
        """Returns positions, velocities and efforts of a body's joints, (n, joints, 3)."""
        key, count = f"tick: joints[{name!r}]", len(body.joints)
        scalar = [place for place, j in enumerate(body.joints) if j.type in SCALAR_JOINTS]
        array = to_numpy(values, key)
        wanted = len(scalar) if array.ndim == 2 and array.shape[1] == len(scalar) else count
        own = checked(array, key, (self.count, wanted)).astype(np.float64)
        result = np.full((self.count, count, 3), np.nan)
        result[:, scalar if wanted == len(scalar) else slice(None), 0] = own
        return result

    # -- reading ----------------------------------------------------------------------------

    def link_poses(self, bodies: tuple[Body, ...], environment: int) -> LinkPoses:
        parts = [np.zeros((0, _STATE)), *(self._states[body][environment] for body in bodies)]
        states = np.concatenate(parts)
        return LinkPoses(states[:, :3], states)

    def frames(self, body: Body, link: int) -> tuple[Array, Array]:
        states = self._states[body][:, link]
        return states[:, :3], states[:, 3:7]

    def velocities(self, body: Body, link: int) -> Array:
        velocities: Array = self._states[body][:, link, 7:]
        return velocities

    def joints(self, body: Body) -> Array:
        return self._joints[body]

    def check_joints(self, body: Body) -> None:
        if body in self._moved:
            name = next(name for name, one in self._bodies.items() if one is body)
            raise ArgumentError(
                f"the positions of the joints of {name} are not known: give tick "
                f"joints={{{name!r}: (n, joints)}} with its poses"
            )
