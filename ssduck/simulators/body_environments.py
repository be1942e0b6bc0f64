"""Many copies of the bodies of a world, with poses from any simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ssduck.errors import ArgumentError, UnknownNameError, nearest
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.poses import cross, multiply, rotate, rotation_matrices
from ssduck.simulators.environments import (
    EnvironmentContacts,
    Environments,
    States,
    check_lengths,
    checked,
    times_of,
    to_numpy,
)
from ssduck.simulators.interface import SCALAR_JOINTS, Body, LinkPoses

# The numbers of a pose, and of a pose with velocities.
_POSE, _STATE = 7, 13


class BodyEnvironments:
    """The states of environments that have the bodies of a world; see `Environments`.

    Args:
        bodies: the bodies by the names of their entities.
        states: the states of the links of each body at first, (links, 13); see `LinkPoses`.
        joints: the positions, velocities and efforts of its joints at first, (joints, 3).
        count: the number of environments.
    """

    knows_contacts = False
    contacts: EnvironmentContacts | None = None

    def __init__(
        self,
        bodies: Mapping[str, Body],
        states: Mapping[Body, Array],
        joints: Mapping[Body, Array],
        count: int,
    ) -> None:
        self._bodies, self.count = bodies, count
        self.times, self.has_times = np.zeros(count), False
        self.sample: Any = None
        self._states = {
            body: np.broadcast_to(own, (count, *own.shape)) for body, own in states.items()
        }
        self._joints = {
            body: np.broadcast_to(own, (count, *own.shape)) for body, own in joints.items()
        }
        # The bodies with joints whose poses were given without these.
        self._moved: frozenset[Body] = frozenset()

    @property
    def accepted(self) -> Sequence[str]:
        return ("poses", "joints", "time")

    def update(self, states: States, arrays: Mapping[str, Any]) -> None:
        given = {**(states or {}), **arrays}
        for name in given:
            if name not in self.accepted:
                raise ArgumentError(
                    f"tick: {name!r} is no part of a state; give poses={{'cup': (n, 7)}}, "
                    "joints={'arm': (n, joints)} and time",
                    suggestions=nearest(name, self.accepted),
                )
        new_states, new_joints = dict(self._states), dict(self._joints)
        for name, values in self._named(given, "poses"):
            body = self._bodies[name]
            new_states[body] = self._poses_of(name, body, values)
        for name, values in self._named(given, "joints"):
            body = self._bodies[name]
            new_joints[body] = self._joints_of(name, body, values)
        time = given.get("time")
        times = self.times if time is None else times_of(time, self.count)
        self.times, self.has_times = times, time is not None
        self.sample = next(iter((given.get("poses") or {}).values()), self.sample)
        self._states, self._joints = new_states, new_joints
        of_joints = frozenset(self._bodies[name] for name, _ in self._named(given, "joints"))
        posed = frozenset(self._bodies[name] for name, _ in self._named(given, "poses"))
        self._moved = (self._moved | {body for body in posed if body.joints}) - of_joints

    def _named(self, given: Mapping[str, Any], part: str) -> Sequence[tuple[str, Any]]:
        """Returns the names and arrays of a part of a state."""
        by_name = given.get(part) or {}
        if not isinstance(by_name, Mapping):
            raise ArgumentError(f"tick: {part}: give a dict of arrays by the names of entities")
        for name in by_name:
            if name not in self._bodies:
                raise UnknownNameError(
                    f"tick: {part}: no body has the name {name!r}",
                    suggestions=nearest(name, list(self._bodies)),
                )
        return list(by_name.items())

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
        conjugate = first[0, 3:7] * np.array([1.0, -1.0, -1.0, -1.0])
        inverse = rotation_matrices(conjugate[None])
        result = np.zeros((self.count, len(first), _STATE))
        matrices = rotation_matrices(base[:, 3:7])
        for number, link in enumerate(first):
            inner = rotate(inverse, (link[:3] - first[0, :3])[None])
            turn = multiply(conjugate[None], link[None, 3:7])
            arms = rotate(matrices, np.broadcast_to(inner, (self.count, 3)))
            result[:, number, :3] = base[:, :3] + arms
            result[:, number, 3:7] = multiply(base[:, 3:7], np.broadcast_to(turn, (self.count, 4)))
            result[:, number, 7:10] = base[:, 7:10] + cross(base[:, 10:], arms)
            result[:, number, 10:] = base[:, 10:]
        return result

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

    def reset(self, environments: Indices) -> None:
        self.times = self.times.copy()  # earlier ones may be kept
        self.times[environments] = 0.0

    # -- reading ----------------------------------------------------------------------------

    def link_poses(self, bodies: tuple[Body, ...], environment: int) -> LinkPoses:
        parts = [np.zeros((0, _STATE)), *(self._states[body][environment] for body in bodies)]
        states = np.concatenate(parts)
        with np.errstate(invalid="ignore"):
            return LinkPoses(states[:, :3], rotation_matrices(states[:, 3:7]), states)

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


_: type[Environments] = BodyEnvironments
