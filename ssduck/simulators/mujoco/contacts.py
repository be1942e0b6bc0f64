"""Keeps the contact points of a MuJoCo simulation, and computes what is asked of them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.simulators.interface import ContactPoints
from ssduck.simulators.mujoco.library import mujoco

# The largest number of contacts whose forces are compared one by one, which is faster then.
_FEW = 16


@dataclass(frozen=True, eq=False)
class GeomOwners:
    """The bodies of geoms by their numbers; that of -1, which is no geom, is -1.

    Attributes:
        bodies: (geoms + 1,), the body of each geom.
        roots: (geoms + 1,), the root of its tree.
    """

    bodies: Indices
    roots: Indices

    @classmethod
    def of(cls, model: Any) -> Self:
        """Returns those of the geoms of a model."""
        bodies = model.geom_bodyid.astype(np.intp)
        roots = model.body_rootid[bodies].astype(np.intp)
        return cls(np.append(bodies, -1), np.append(roots, -1))


class MuJoCoContacts:
    """The contact points of the last step between geoms.

    MuJoCo's arrays are copied at once, and read when something is asked: most programs ask for the
    contacts of two bodies. MuJoCo's normal points from the first geom to the second. Points at a
    distance, which margins allow, count if they press.

    Args:
        model: the model.
        data: its data.
        owners: the bodies of its geoms.
        only: the root bodies whose contacts count; None for all. There may be contacts of others
            from the step before they were left out.
    """

    def __init__(
        self, model: Any, data: Any, owners: GeomOwners, only: Collection[int] | None
    ) -> None:
        contact = data.contact
        self._owners, self._only = owners, only
        self._is_pyramidal = model.opt.cone == int(mujoco.mjtCone.mjCONE_PYRAMIDAL)
        self._geoms, self._distances = contact.geom.copy(), contact.dist.copy()
        self._addresses, self._dims = contact.efc_address.copy(), contact.dim.copy()
        self._frames, self._middles = contact.frame.copy(), contact.pos.copy()
        self._frictions, self._efc_forces = contact.friction.copy(), data.efc_force.copy()

    @cached_property
    def _roots(self) -> Indices:
        """The root bodies of each contact, (n, 2)."""
        roots: Indices = self._owners.roots.take(self._geoms)
        return roots

    def between(self, a: int, b: int, *, pressing: bool) -> tuple[Indices, Indices]:
        """Returns the bodies and links of the contacts of two bodies; see `Contacts`."""
        is_a, is_b = self._roots == a, self._roots == b
        rows = (is_a & is_b[:, ::-1]).nonzero()[0]
        is_kept = self._are_pressing(rows)
        if not pressing:
            is_kept |= self._distances.take(rows) <= 0.0
        rows = rows[is_kept]
        roots = self._roots.take(rows, axis=0)
        return roots, self._owners.bodies.take(self._geoms.take(rows, axis=0)) - roots

    def _are_pressing(self, rows: Indices) -> Flags:
        """Checks which contacts have a positive normal force."""
        if len(rows) <= _FEW:
            return np.array([self._is_pressing(row) for row in rows.tolist()], bool)
        are_pressing: Flags = self._forces(rows)[:, 0] > 0.0
        return are_pressing

    def _is_pressing(self, row: int) -> bool:
        """Checks whether the normal force of a contact is positive; see `_forces`."""
        first, dim = int(self._addresses[row]), int(self._dims[row])
        if first < 0:
            return False
        count = 2 * (dim - 1) if self._is_pyramidal and dim > 1 else 1
        edges: list[float] = self._efc_forces[first : first + count].tolist()
        return sum(edges) > 0.0

    def all(self) -> ContactPoints:
        """Returns all contact points."""
        return self._all

    @cached_property
    def _all(self) -> ContactPoints:
        roots = self._roots
        rows: Indices = np.arange(len(roots))
        forces = self._forces(rows)
        is_kept = (roots >= 0).all(axis=1) & ((self._distances <= 0.0) | (forces[:, 0] > 0.0))
        if self._only is not None:
            is_kept &= np.isin(roots, list(self._only)).all(axis=1)
        if not is_kept.any():
            return ContactPoints.none()
        frames, depths = self._frames.reshape(-1, 3, 3), -self._distances
        middles, bodies = self._middles, self._owners.bodies.take(self._geoms)
        if not is_kept.all():
            forces, roots, bodies = forces[is_kept], roots[is_kept], bodies[is_kept]
            frames, depths, middles = frames[is_kept], depths[is_kept], middles[is_kept]
        half = 0.5 * depths[:, None] * frames[:, 0]
        points = np.zeros((len(depths), 2, 3))
        np.add(middles, half, out=points[:, 0])
        np.subtract(middles, half, out=points[:, 1])
        return ContactPoints(
            bodies=roots,
            links=bodies - roots,
            points=points,
            normals=-frames[:, 0],
            depths=depths,
            forces=forces[:, 0],
            frictions=-np.einsum("nk,nki->ni", forces[:, 1:], frames[:, 1:]),
        )

    def _forces(self, rows: Indices) -> Array:
        """Returns the forces of the first geoms on the second in the frames of contacts, (n, 3).

        They are the normal force and the two friction forces, as `mj_contactForce` returns them.
        """
        addresses = self._addresses.take(rows).astype(np.intp)
        dims = self._dims.take(rows)
        forces = np.zeros((len(rows), 3))
        is_active = addresses >= 0
        if not is_active.any():
            return forces
        # Most contacts are of one dimension, and all press.
        is_uniform = is_active.all() and (dims == dims[0]).all()
        every = np.arange(len(rows))
        for dim in dims[:1].tolist() if is_uniform else np.unique(dims[is_active]).tolist():
            chosen = every if is_uniform else np.flatnonzero(is_active & (dims == dim))
            first = addresses[chosen]
            if not self._is_pyramidal or dim == 1:
                axes = min(dim, 3)
                forces[chosen, :axes] = self._efc_forces[first[:, None] + np.arange(axes)]
                continue
            # A pyramid has two edges for each axis of friction; their forces add up to the normal
            # one.
            edges = self._efc_forces[first[:, None] + np.arange(2 * (dim - 1))]
            edges = edges.reshape(len(chosen), dim - 1, 2)
            forces[chosen, 0] = edges.sum(axis=(1, 2))
            axes = min(dim - 1, 2)
            differences = edges[:, :axes, 0] - edges[:, :axes, 1]
            frictions = self._frictions[rows[chosen], :axes]
            forces[chosen, 1 : 1 + axes] = differences * frictions
        return forces
