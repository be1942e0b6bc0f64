"""Many simulations of one MuJoCo model, from arrays as MJX and MuJoCo Warp have them, or `MjData`.

The arrays have the names and the shapes of `mujoco.MjData`, behind an axis of environments.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from functools import cached_property, partial
from operator import attrgetter
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from ssduck.errors import ArgumentError, ProgramWarning, StateError, warn
from ssduck.formatting import joined_names, short_repr
from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.poses import cross, multiply
from ssduck.simulators.environments import (
    EnvironmentContacts,
    Environments,
    EnvironmentSimulator,
    States,
    check_lengths,
    checked,
    kept,
    times_of,
    to_numpy,
)
from ssduck.simulators.interface import SCALAR_JOINTS, Body, ContactPoints, LinkPoses
from ssduck.simulators.mujoco.bodies import joint_numbers, number_of, numbers_of, sites_on
from ssduck.simulators.mujoco.contacts import ContactReader
from ssduck.simulators.mujoco.library import mujoco
from ssduck.simulators.mujoco.readings import LinkReader
from ssduck.simulators.mujoco.simulator import MuJoCoSimulator

# What a contact has: the numbers of its geoms, their distance, m, and what is known besides.
_OF_CONTACTS = ("geom", "dist", "force", "frame", "efc_address", "dim", "adhesion")
_MOCAP = ("mocap_pos", "mocap_quat")
# What follows from joint positions and velocities.
_COMPUTED = ("xpos", "xquat", "site_xpos", "cvel", "subtree_com")
# The world may be off its place by rounding, m.
_WORLD_TOLERANCE = 1e-3


def environments_of(model: Any, count: int) -> EnvironmentSimulator:
    """Returns environments of a model, all in its initial state."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    simulator = MuJoCoSimulator(lambda: (model, data), owned=False)
    described = simulator.describe()
    bodies = [] if described is None else described[0]
    states = MuJoCoEnvironments(model, data, count)
    return EnvironmentSimulator(bodies, states, simulator, simulator.read_margins)


class MuJoCoEnvironments(Environments):
    """The states of environments of a model; its data is what kinematics are computed with."""

    def __init__(self, model: Any, data: Any, count: int) -> None:
        super().__init__(count)
        self._model, self._data = model, data
        self._shapes: dict[str, tuple[int, ...]] = {
            name: getattr(data, name).shape
            for name in (*_COMPUTED, "qpos", "qvel", "qfrc_actuator", *_MOCAP)
        }
        self.accepted = [*self._shapes, "time", "contact", "efc_force"]
        self._arrays: dict[str, npt.NDArray[Any]] = {
            name: np.broadcast_to(getattr(data, name), (count, *shape))
            for name, shape in self._shapes.items()
        }
        self._unknown = {
            name: np.broadcast_to(np.nan, array.shape) for name, array in self._arrays.items()
        }
        # The numbers of bodies and sites that were read, by the name of the array and their place.
        self._columns: dict[tuple[str, int], Array] = {}
        # Before the first tick there are none, so that terms can be checked.
        nothing = np.zeros(0, np.intp), ContactPoints.none()
        self._contacts: EnvironmentContacts | None = EnvironmentContacts(*nothing)
        # Reads the contacts of `MjData`, and whether anything has asked for any.
        self._read_contacts: Callable[[], EnvironmentContacts] | None = None
        self._wants_contacts = False
        # The arrays that the last states did not have.
        self._missing: AbstractSet[str] = frozenset()
        self._readers: list[LinkReader] = []
        self._joint_numbers: dict[Body, Indices] = {}
        self._has_told_of_mocap = False

    def update(self, states: States, arrays: Mapping[str, Any]) -> None:
        if isinstance(states, Sequence):
            self._take(states)
            return
        if isinstance(states, Mapping):
            states, arrays = None, {**states, **arrays}
        given = {name: value for name, value in arrays.items() if value is not None}
        there = ", ".join(self.accepted)
        self.check_names(given, f"array of a state of MuJoCo; there are {there}")
        if states is not None:
            inner = getattr(states, "_impl", None)  # where MJX has some arrays
            for name in self.accepted:
                value = getattr(inner, name, None)
                value = getattr(states, name, None) if value is None else value
                if value is not None:
                    given.setdefault(name, value)
        if "qpos" not in given and not {"xpos", "xquat"} <= given.keys():
            raise ArgumentError(
                "tick: give the poses of all bodies, xpos=… and xquat=…, or the joint positions "
                "qpos=… (and qvel=…), from which MuJoCo computes them"
            )
        known = {
            name: kept(given[name], f"tick: {name}", (self.count, *shape))
            for name, shape in self._shapes.items()
            if name in given
        }
        if "xquat" in known:
            check_lengths(known["xquat"], "tick: xquat")
        _check_world(known)
        time = given.get("time")
        times = self.times if time is None else times_of(time, self.count)
        contact = given.get("contact")
        contacts = None if contact is None else self._contacts_of(contact, given.get("efc_force"))
        if not {"xpos", "xquat"} <= known.keys():
            known = self._forward(known)
        self._missing = self._shapes.keys() - known.keys()
        self._arrays, self._contacts, self._read_contacts = self._unknown | known, contacts, None
        self._columns = {}
        self.times, self.has_times = times, time is not None
        self.sample = given.get("xpos", given.get("qpos"))

    def _take(self, states: Sequence[Any]) -> None:
        """Takes the states of a list of `MjData`."""
        if len(states) != self.count or not all(type(s).__name__ == "MjData" for s in states):
            raise ArgumentError(
                f"tick: give a list of {self.count} MjData, one for each environment"
            )
        names = [name for name, shape in self._shapes.items() if 0 not in shape]
        columns = zip(*map(attrgetter(*names), states), strict=True)
        stacked = self._arrays | {
            name: np.concatenate(parts).reshape(self.count, *self._shapes[name])
            for name, parts in zip(names, columns, strict=True)
        }
        self._arrays, self._contacts, self.sample = stacked, None, None
        self._columns, self._missing = {}, frozenset()
        self.times, self.has_times = np.array([state.time for state in states]), True
        self._read_contacts = partial(self._contacts_in, tuple(states), self.times.copy())
        if self._wants_contacts:
            self._contacts = self._read_contacts()

    def _contacts_in(self, states: Sequence[Any], times: Array) -> EnvironmentContacts:
        """Returns the contacts of a list of `MjData` at the tick."""
        if any(state.time != time for state, time in zip(states, times.tolist(), strict=True)):
            raise StateError(
                "the simulations have moved on since the last tick, whose contacts nothing had "
                "asked for: call tick, then ask again"
            )
        self._wants_contacts = True
        of_each = [self._contact_reader.read(state) for state in states]
        points, counts = ContactPoints.joined(of_each)
        return EnvironmentContacts(np.repeat(np.arange(self.count), counts), points)

    def _forward(self, known: dict[str, Any]) -> dict[str, Any]:
        """Adds the poses and velocities that follow from joint positions and velocities."""
        model, data = self._model, self._data
        self._warn_of_mocap(known)
        computed = {name: np.zeros((self.count, *self._shapes[name])) for name in _COMPUTED}
        velocities = known.get("qvel")
        for number, positions in enumerate(known["qpos"]):
            data.qpos[:] = positions
            data.qvel[:] = 0.0 if velocities is None else velocities[number]
            for name in known.keys() & _MOCAP:
                getattr(data, name)[:] = known[name][number]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            for name, values in computed.items():
                values[number] = getattr(data, name)
        if velocities is None:
            del computed["cvel"]
        return known | computed

    def _warn_of_mocap(self, known: Mapping[str, Any]) -> None:
        """Warns, once, of bodies that no joint moves, and that are taken to be at their places."""
        if self._has_told_of_mocap or not self._model.nmocap or "mocap_pos" in known:
            return
        self._has_told_of_mocap = True
        numbers = np.flatnonzero(self._model.body_mocapid >= 0).tolist()
        names = joined_names([self._model.body(number).name for number in numbers])
        warn(
            f"tick: {names}: no joint moves what is a mocap body, and qpos does not say where it "
            "is: it is taken to be where the model has it; give mocap_pos=… and mocap_quat=…, too",
            ProgramWarning,
        )

    @cached_property
    def _contact_reader(self) -> ContactReader:
        return ContactReader(self._model)

    # -- reading ----------------------------------------------------------------------------

    def link_poses(self, bodies: tuple[Body, ...], environment: int) -> LinkPoses:
        reader = next((one for one in self._readers if one.bodies is bodies), None)
        if reader is None:
            reader = LinkReader(self._model, bodies)
            self._readers = [reader, *self._readers[:3]]
        state = {
            name: np.array(values[environment], np.float64) for name, values in self._arrays.items()
        }
        return reader.read(SimpleNamespace(**state))

    def frames(self, body: Body, link: int) -> tuple[Array, Array]:
        number = number_of(body, link)
        orientations = self._column("xquat", number)
        if body.links[link].region is None:
            return self._column("xpos", number), orientations
        self._check_known("places of sites", "site_xpos")
        site = sites_on(self._model, numbers_of(body))[link - body.rigid_count]
        turn = np.broadcast_to(self._model.site_quat[site], orientations.shape)
        return self._column("site_xpos", site), multiply(orientations, turn)

    def velocities(self, body: Body, link: int) -> Array:
        self._check_known("velocities", "cvel", "subtree_com")
        number = number_of(body, link)
        twists = self._column("cvel", number)
        root = int(self._model.body_rootid[number])
        arms = self.frames(body, link)[0] - self._column("subtree_com", root)
        # Each column is contiguous, here as everywhere.
        angular, linear = twists.T[:3], twists.T[3:]
        return np.concatenate((linear + cross(angular.T, arms).T, angular)).T

    def joints(self, body: Body) -> Array:
        if body not in self._joint_numbers:
            self._joint_numbers[body] = joint_numbers(self._model, [body])
        numbers = self._joint_numbers[body]
        positions, velocities = self._model.jnt_qposadr[numbers], self._model.jnt_dofadr[numbers]
        places = {"qpos": positions, "qvel": velocities, "qfrc_actuator": velocities}
        columns = [self._arrays[name][:, own] for name, own in places.items()]
        values = np.stack(columns, axis=-1, dtype=np.float64)
        values[:, [joint.type not in SCALAR_JOINTS for joint in body.joints]] = np.nan
        return values

    def check_joints(self, body: Body) -> None:  # noqa: ARG002  # the states have all
        self._check_known("positions of joints", "qpos")

    @property
    def knows_contacts(self) -> bool:
        return self._contacts is not None or self._read_contacts is not None

    @property
    def contacts(self) -> EnvironmentContacts | None:
        if self._contacts is None and self._read_contacts is not None:
            self._contacts = self._read_contacts()
        return self._contacts

    def _check_known(self, what: str, *names: str) -> None:
        """Checks that the last states had some arrays."""
        if not self._missing.isdisjoint(names):
            arrays = " and ".join(f"{name}=…" for name in names)
            raise ArgumentError(
                f"the {what} of these environments are not known: give tick {arrays}, or the data "
                "of MJX, or qpos=… and qvel=…"
            )

    def _column(self, name: str, place: int) -> Array:
        """Returns the numbers of a body or a site, (n, columns); each column is contiguous."""
        key = name, place
        if key not in self._columns:
            own = self._arrays[name][:, place]
            self._columns[key] = np.array(own.T, np.float64, order="C").T
        return self._columns[key]

    def _contacts_of(self, contact: Any, efc_forces: Any) -> EnvironmentContacts:
        """Returns contacts from arrays (n, m, …), without those that do not meet."""
        if not isinstance(contact, Mapping):
            contact = {name: getattr(contact, name, None) for name in _OF_CONTACTS}
        parts = {name: contact[name] for name in _OF_CONTACTS if contact.get(name) is not None}
        if not {"geom", "dist"} <= parts.keys():
            raise ArgumentError(
                "tick: contact has geom (n, m, 2), the numbers of the geoms, and dist (n, m), m"
            )
        geoms = checked(parts["geom"], "tick: contact: geom", (self.count, "m", 2)).astype(np.intp)
        distances = checked(parts["dist"], "tick: contact: dist", (self.count, geoms.shape[1]))
        if geoms.max(initial=-1) >= self._model.ngeom:
            raise ArgumentError(
                f"tick: contact: geom has the number {geoms.max()}, and the model has "
                f"{self._model.ngeom} geoms, from 0"
            )
        forces = np.full(distances.shape, np.nan)
        if "force" in parts:
            forces = checked(parts["force"], "tick: contact: force", distances.shape)
        elif efc_forces is not None and {"efc_address", "dim"} <= parts.keys():
            rows = to_numpy(efc_forces, "tick: efc_force").astype(np.float64)
            addresses, dims = (to_numpy(parts[name], name) for name in ("efc_address", "dim"))
            forces = self._normal_forces(rows, addresses, dims, distances.shape)
            adhesion = self._adhesion_of(parts, distances.shape)
            forces -= np.where(addresses >= 0, adhesion, 0.0)
        # A contact that margins allow counts if it presses, as those of a single simulation do.
        are_there = (geoms >= 0).all(axis=-1) & ((distances <= 0.0) | (forces > 0.0))
        environments, places = np.nonzero(are_there)
        chosen = geoms[environments, places]
        normals = np.full((len(chosen), 3), np.nan)
        if "frame" in parts:
            frames = to_numpy(parts["frame"], "tick: contact: frame")
            frames = frames.reshape(*distances.shape, 3, 3)
            normals = -frames[environments, places, 0].astype(np.float64)
        numbers = self._model.geom_bodyid[chosen]
        handles = self._contact_reader.roots[numbers]  # the first body of an entity
        nothing = np.full((len(chosen), 3), np.nan)
        points = ContactPoints(
            handles,
            numbers - handles,
            np.stack((nothing, nothing), axis=1),
            normals,
            -distances[environments, places].astype(np.float64),
            forces[environments, places].astype(np.float64),
            nothing,
        )
        has_forces = "force" in parts or efc_forces is not None
        return EnvironmentContacts(
            environments, points, has_forces, has_normals="frame" in parts, is_whole=False
        )

    def _adhesion_of(self, contact: Mapping[str, Any], shape: tuple[int, ...]) -> Array:
        """Returns the forces (n, m), N, of adhesion, which those of constraints include."""
        names = ("geom_adhesion", "pair_adhesion")  # since MuJoCo 4
        if "adhesion" in contact:
            return checked(contact["adhesion"], "tick: contact: adhesion", shape)
        if any(np.any(getattr(self._model, name, 0.0)) for name in names):
            raise ArgumentError(
                "tick: geoms of this model have adhesion: contact needs adhesion (n, m), N, or "
                "force (n, m), N, as mj_contactForce tells it"
            )
        return np.zeros(shape)

    def _normal_forces(
        self, rows: Array, addresses: Indices, dims: Indices, shape: tuple[int, ...]
    ) -> Array:
        """Returns the normal forces of contacts (n, m), N: sums of the edges of pyramidal cones."""
        is_pyramidal = self._model.opt.cone == int(mujoco.mjtCone.mjCONE_PYRAMIDAL)
        counts = np.where((dims > 1) & is_pyramidal, 2 * (dims - 1), 1)
        addresses, counts = np.broadcast_to(addresses, shape), np.broadcast_to(counts, shape)
        environments = np.arange(shape[0])[:, None]
        forces = np.zeros(shape)
        for edge in range(int(counts.max(initial=0))):
            is_there = (edge < counts) & (addresses >= 0)
            places = np.where(is_there, addresses + edge, 0)
            forces += np.where(is_there, rows[environments, places], 0.0)
        return forces


def _check_world(known: Mapping[str, npt.NDArray[Any]]) -> None:
    """Checks that the world, the first body, is where it always is."""
    for name, place in (("xpos", (0.0, 0.0, 0.0)), ("xquat", (1.0, 0.0, 0.0, 0.0))):
        if name not in known or not known[name].shape[1]:
            continue
        own = known[name][:, 0]
        errors = np.abs(own.T.copy() - np.array(place)[:, None])
        if np.fmax.reduce(errors, axis=None) > _WORLD_TOLERANCE:
            first = own[errors.max(axis=0).argmax()].tolist()
            raise ArgumentError(
                f"tick: {name}: the first body is the world, at {list(place)}, and it is at "
                f"{short_repr(first)}: the bodies are in the order of the model, quaternions are "
                "w, x, y, z, and positions in the world frame"
            )
