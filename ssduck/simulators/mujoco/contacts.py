"""Keeps the contact points of a MuJoCo simulation, and computes what is asked of them; margins.

MuJoCo's rule for how far apart two geoms are at most when they press depends on its version. Until
3.4, the larger margin counts, less the larger gap; until 3.8, the sum of both, less both gaps;
since then the sum, whatever the gaps. A <pair> has a margin of its own, and `o_margin` replaces all
if the model overrides contacts.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, Self

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.margins import Margins
from ssduck.simulators.interface import ContactPoints
from ssduck.simulators.mujoco.flexes import entity_roots, flexes_of
from ssduck.simulators.mujoco.library import copied_data, mujoco

# Of the numbers of a wrench, those that are forces; the others are moments.
_FORCE_AXES = 3
# The arrays that have a row for each contact.
_ROWS = ("bodies", "distances", "addresses", "dims", "frames", "middles", "frictions")
_PYRAMIDAL = int(mujoco.mjtCone.mjCONE_PYRAMIDAL)
# The flag that lets bodies sleep; 0 before MuJoCo 3.4.
_SLEEP = int(getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", 0))


class ContactReader:
    """Reads the contacts of a model, with those of sleeping bodies.

    MuJoCo neither lists nor computes these. A copy of the data is computed with all bodies awake,
    once for as long as the same ones sleep where they are: so the contacts are those of the step in
    which they fell asleep.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        # (geoms + 1,), the body of each geom; that of -1, which is no geom, is -1.
        self._bodies = np.append(model.geom_bodyid.astype(np.intp), -1)
        # (bodies + 1,), the first body of the entity of each body; that of -1 is -1.
        self.roots = np.append(entity_roots(model), -1)
        self._flexes = flexes_of(model)
        self._known: tuple[tuple[bytes, ...], MuJoCoContacts] | None = None

    def read(self, data: Any, only: Collection[int] | None = None) -> MuJoCoContacts:
        """Returns the contacts of the last step of data; those of some root bodies, or of all."""
        model, listed = self._model, self._listed(data, only)
        if not (model.opt.enableflags & _SLEEP):
            return listed
        is_asleep = np.append(data.tree_asleep >= 0, False)
        if not is_asleep.any():
            return listed
        # The tree of what does not move is -1: it does not sleep either.
        trees = np.append(model.body_treeid, -1)
        sleepers = is_asleep[trees[:-1]]
        poses = data.xpos[sleepers].tobytes(), data.xquat[sleepers].tobytes()
        key = sleepers.tobytes(), *poses, bytes([model.opt.cone])
        is_awake = ~is_asleep[trees] & (trees >= 0)
        if self._known is None or self._known[0] != key:
            copied = copied_data(model, data, mujoco.MjData(model))
            flags = model.opt.enableflags
            try:
                model.opt.enableflags = flags & ~_SLEEP
                mujoco.mj_forward(model, copied)
            finally:
                model.opt.enableflags = flags
            known = self._listed(copied, only)
            self._known = key, known.chosen(~is_awake[known.bodies].any(axis=1))
        awake = listed.chosen(is_awake[listed.bodies].any(axis=1))
        return awake.followed_by(self._known[1])

    def _listed(self, data: Any, only: Collection[int] | None) -> MuJoCoContacts:
        """Returns the contacts that MuJoCo lists."""
        contact = data.contact
        bodies: Indices = self._bodies.take(contact.geom)
        if self._flexes and bodies.min(initial=0) < 0:
            for side in (0, 1):
                flexes, elements, vertices = (
                    numbers[:, side] for numbers in (contact.flex, contact.elem, contact.vert)
                )
                for flex in self._flexes:
                    rows = (flexes == flex.number).nonzero()[0]
                    parts = contact.pos[rows], elements[rows], vertices[rows]
                    bodies[rows, side] = flex.nearest(data, *parts)
        return MuJoCoContacts(
            self.roots,
            only,
            bool(self._model.opt.cone == _PYRAMIDAL),
            bodies,
            contact.dist.copy(),
            contact.efc_address.copy(),
            contact.dim.copy(),
            contact.frame.copy(),
            contact.pos.copy(),
            contact.friction.copy(),
            data.efc_force.copy(),
        )


@dataclass(frozen=True, eq=False)
class MuJoCoContacts:
    """The contact points of the last step.

    They are computed when something is asked: most programs ask for the contacts of two bodies.
    MuJoCo's normal points from the first side to the second. Points at a distance, which margins
    allow, count if they press. A contact has one point, where its forces act on both sides.
    """

    roots: Indices  # the first body of the entity of each body; see `ContactReader`
    # The root bodies whose contacts count; None for all. There may be contacts of others from the
    # step before they were left out.
    only: Collection[int] | None
    is_pyramidal: bool  # whether the friction cones of the step were pyramids
    # MuJoCo's arrays of the contacts, (n, …); the forces of all constraints.
    bodies: Indices  # (n, 2); -1 for none
    distances: Array
    addresses: Indices
    dims: Indices
    frames: Array
    middles: Array
    frictions: Array
    efc_forces: Array

    def chosen(self, are_chosen: Flags) -> Self:
        """Returns some of them."""
        return replace(self, **{name: getattr(self, name)[are_chosen] for name in _ROWS})

    def followed_by(self, other: Self) -> Self:
        """Returns these and those of another step."""
        addresses = np.where(other.addresses < 0, -1, other.addresses + len(self.efc_forces))
        later = replace(other, addresses=addresses)
        joined: dict[str, Any] = {
            name: np.concatenate((getattr(self, name), getattr(later, name)))
            for name in (*_ROWS, "efc_forces")
        }
        return replace(self, **joined)

    @cached_property
    def _roots(self) -> Indices:
        """The root bodies of each contact, (n, 2)."""
        roots: Indices = self.roots.take(self.bodies)
        return roots

    def between(self, a: int, b: int, *, pressing: bool) -> tuple[Indices, Indices]:
        # Most programs ask for two bodies: the forces of others are not computed.
        is_a, is_b = self._roots == a, self._roots == b
        rows = (is_a & is_b[:, ::-1]).any(axis=1).nonzero()[0]
        are_kept = self._wrenches(rows)[:, 0] > 0.0
        if not pressing:
            are_kept |= self.distances.take(rows) <= 0.0
        roots = self._roots.take(rows[are_kept], axis=0)
        return roots, self.bodies.take(rows[are_kept], axis=0) - roots

    def all(self) -> ContactPoints:
        return self._all

    @cached_property
    def has_moments(self) -> bool:
        if self.dims.max(initial=0) <= _FORCE_AXES:
            return False
        return bool(self._every_wrench[(self._roots >= 0).all(axis=1), _FORCE_AXES:].any())

    @cached_property
    def _every_wrench(self) -> Array:
        return self._wrenches(np.arange(len(self._roots)))

    @cached_property
    def _all(self) -> ContactPoints:
        roots, forces = self._roots, self._every_wrench[:, :_FORCE_AXES]
        are_kept = (roots >= 0).all(axis=1)
        are_kept &= (self.distances <= 0.0) | (forces[:, 0] > 0.0)
        if self.only is not None:
            are_kept &= np.isin(roots, list(self.only)).all(axis=1)
        if not are_kept.any():
            return ContactPoints.none()
        frames, depths = self.frames.reshape(-1, 3, 3), -self.distances
        middles, bodies = self.middles, self.bodies
        if not are_kept.all():
            forces, roots, bodies = forces[are_kept], roots[are_kept], bodies[are_kept]
            frames, depths, middles = frames[are_kept], depths[are_kept], middles[are_kept]
        return ContactPoints(
            bodies=roots,
            links=bodies - roots,
            points=np.repeat(middles[:, None], 2, axis=1),
            normals=-frames[:, 0],
            depths=depths,
            forces=forces[:, 0],
            frictions=-(forces[:, 1:2] * frames[:, 1] + forces[:, 2:] * frames[:, 2]),
        )

    def _wrenches(self, rows: Indices) -> Array:
        """Returns the wrenches of contacts in their frames, (n, 6), as `mj_contactForce` does."""
        addresses = self.addresses.take(rows).astype(np.intp)
        dims = self.dims.take(rows)
        forces = np.zeros((len(rows), 6))
        is_active = addresses >= 0
        if not is_active.any():
            return forces
        # Most contacts are of one dimension, and all press.
        is_uniform = is_active.all() and (dims == dims[0]).all()
        every = np.arange(len(rows))
        for dim in dims[:1].tolist() if is_uniform else np.unique(dims[is_active]).tolist():
            chosen = every if is_uniform else np.flatnonzero(is_active & (dims == dim))
            first = addresses[chosen]
            if not self.is_pyramidal or dim == 1:
                forces[chosen, :dim] = self.efc_forces[first[:, None] + np.arange(dim)]
                continue
            # A pyramid has two edges for each axis of friction; their forces add up to the normal
            # one.
            edges = self.efc_forces[first[:, None] + np.arange(2 * (dim - 1))]
            edges = edges.reshape(len(chosen), dim - 1, 2)
            forces[chosen, 0] = edges.sum(axis=(1, 2))
            differences = edges[:, :, 0] - edges[:, :, 1]
            frictions = self.frictions[rows[chosen], : dim - 1]
            forces[chosen, 1:dim] = differences * frictions
        return forces


# Two spheres in contact, whose margins and gaps tell the rule.
_TWO = """<mujoco><worldbody><geom size=".1" margin=".5" gap=".25"/><body><freejoint/>
<geom size=".1" margin=".125" gap=".0625"/></body></worldbody></mujoco>"""
_OVERRIDE = int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
_ARRAYS = ("geom_margin", "geom_gap", "flex_margin", "flex_gap", "pair_margin", "pair_gap")


@cache
def _rule() -> tuple[bool, bool]:
    """Returns whether margins are added, and whether gaps are subtracted; MuJoCo itself tells."""
    model = mujoco.MjModel.from_xml_string(_TWO)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    margin = float(data.contact.includemargin[0])
    if margin == 0.5 - 0.25:
        return False, True
    return True, margin == 0.625 - 0.3125


def margin_content(model: Any) -> bytes:
    """Returns the numbers that the margins follow from."""
    numbers = [getattr(model, name).tobytes() for name in (*_ARRAYS, "pair_geom1", "pair_geom2")]
    override = model.opt.o_margin if model.opt.enableflags & _OVERRIDE else -1.0
    return b"".join((*numbers, np.float64(override).tobytes()))


def margins_of(model: Any) -> Margins:
    """Returns the margins of the geoms of a model, followed by those of its flexes."""
    are_added, has_gaps = _rule()
    own = np.concatenate((model.geom_margin, model.flex_margin))
    gaps = np.concatenate((model.geom_gap, model.flex_gap)) * has_gaps
    of_pairs, pair_gaps = model.pair_margin.copy(), model.pair_gap * has_gaps
    if model.opt.enableflags & _OVERRIDE:
        of_pairs[of_pairs >= 0.0] = model.opt.o_margin
        own[:] = model.opt.o_margin * (0.5 if are_added else 1.0)
    # Pairs of what is disabled never meet; they keep the margins of their geoms.
    is_on = of_pairs >= 0.0
    first, second = model.pair_geom1[is_on], model.pair_geom2[is_on]
    of_pairs = np.maximum(of_pairs - pair_gaps, 0.0)[is_on]
    if are_added:
        numbers = own - gaps
        if (numbers >= 0.0).all() and np.array_equal(numbers[first] + numbers[second], of_pairs):
            return Margins(numbers)
    # Geoms of a <pair> are a class each, all others by what they have.
    is_of_pair = np.isin(np.arange(len(own)), np.concatenate((first, second)))
    keys = np.column_stack((own, gaps, np.where(is_of_pair, np.arange(len(own)), -1)))
    kinds, classes = np.unique(keys, axis=0, return_inverse=True)
    classes = classes.reshape(-1)
    combine = np.add if are_added else np.maximum
    of_classes = combine(kinds[:, None, :2], kinds[:, :2])  # of each two classes: margins, gaps
    of_classes = np.maximum(of_classes[..., 0] - of_classes[..., 1], 0.0)
    one, other = classes[first], classes[second]
    of_classes[one, other] = of_classes[other, one] = of_pairs
    # A half of the largest: the sum of two is at least their margin.
    numbers = 0.5 * of_classes.max(axis=1, initial=0.0)
    if np.array_equal(numbers[:, None] + numbers, of_classes):
        return Margins(numbers[classes])
    return Margins(numbers[classes], classes, of_classes)
