"""The states of many simulations of one model, each an *environment*, in arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.margins import Margins
from ssduck.simulators.clock import Clock
from ssduck.simulators.interface import Body, ContactPoints, LinkPoses, Simulator
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


class Environments(Protocol):
    """The states of many simulations of one model.

    Positions are metres, orientations quaternions w, x, y, z, in the world frame.
    """

    count: int  # the number n of environments
    times: Array  # (n,), the simulated time of each, s
    has_times: bool  # whether the last states had times
    sample: Any  # an array of the last states as it was given, for the library of answers

    @property
    def accepted(self) -> Sequence[str]:
        """The names of the arrays of a state."""

    def update(self, states: States, arrays: Mapping[str, Any]) -> None:
        """Takes the states that are read from now on."""

    def reset(self, environments: Indices) -> None:
        """Notes that some environments begin a new episode, at the next states."""

    def link_poses(self, bodies: tuple[Body, ...], environment: int) -> LinkPoses:
        """Returns the poses of the links of some bodies in an environment, body after body."""

    def frames(self, body: Body, link: int) -> tuple[Array, Array]:
        """Returns the positions (n, 3) and the orientations (n, 4) of a link."""

    def velocities(self, body: Body, link: int) -> Array:
        """Returns the linear (m/s) and angular (rad/s) velocities of a frame, (n, 6); or NaN."""

    def joints(self, body: Body) -> Array:
        """Returns positions, velocities and efforts of joints, (n, joints, 3); NaN if unknown."""

    def check_joints(self, body: Body) -> None:
        """Checks that the positions of a body's joints are known."""

    @property
    def knows_contacts(self) -> bool:
        """Whether the contacts are known; they may be read when they are asked for."""

    @property
    def contacts(self) -> EnvironmentContacts | None:
        """The contacts; None if they are not known."""


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
        margins: Callable[[Sequence[Body]], list[list[float]] | Margins] | None = None,
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

    def read_link_poses(self, bodies: tuple[Body, ...], *, with_velocities: bool) -> LinkPoses:  # noqa: ARG002
        return self.environments.link_poses(bodies, self.chosen)

    def read_joints(self, bodies: Sequence[Body]) -> Array:
        parts = [self.environments.joints(body)[self.chosen] for body in bodies]
        return np.concatenate([np.zeros((0, 3)), *parts])

    def read_masses(self, bodies: Sequence[Body]) -> list[list[float]]:
        return [body.masses for body in bodies]

    def read_margins(self, bodies: Sequence[Body]) -> list[list[float]] | Margins:
        described = [body.margins for body in bodies]
        return described if self._margins is None else self._margins(bodies)

    def read_contacts(self) -> ContactPoints:
        contacts = self.environments.contacts
        return ContactPoints.none() if contacts is None else contacts.of(self.chosen)

    def close(self) -> None:
        """Does nothing: it holds no resources."""


def to_numpy(value: Any, name: str) -> npt.NDArray[Any]:
    """Returns an array of any library as one of NumPy; one on a device is copied to memory."""
    if isinstance(value, np.ndarray):
        array = value
    else:
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
    if _library_of(sample) == "torch":
        import torch

        return torch.from_numpy(copied).to(sample.device)
    if isinstance(sample, np.ndarray) or not hasattr(sample, "__array_namespace__"):
        return copied
    return sample.__array_namespace__().asarray(copied, device=sample.device)


def _library_of(array: Any) -> str:
    return type(array).__module__.partition(".")[0]


def kept(value: Any, name: str, shape: tuple[int | str, ...]) -> npt.NDArray[Any]:
    """Returns a checked array that stays as it is: simulators write the next state into theirs."""
    array = checked(value, name, shape)
    return array if _library_of(value) in _JAX else np.array(array)


def checked(value: Any, name: str, shape: tuple[int | str, ...]) -> npt.NDArray[Any]:
    """Returns an array of a shape, of which a text stands for any number, as one of NumPy's."""
    array = to_numpy(value, name)
    fits = array.ndim == len(shape) and all(
        isinstance(expected, str) or actual == expected
        for actual, expected in zip(array.shape, shape, strict=True)
    )
    if not fits:
        expected = ", ".join(map(str, shape))
        hint = ""
        first, *others = shape
        if array.shape == tuple(others) or (array.ndim and array.shape[0] != first):
            hint = f": the first axis is the {first} environments"
        raise ArgumentError(f"{name} is of shape {array.shape}, not ({expected}){hint}")
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
