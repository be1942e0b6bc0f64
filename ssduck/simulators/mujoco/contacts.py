"""Reads the contact points of a MuJoCo simulation, and its margins.

MuJoCo's rule for how far apart two geoms are at most when they press depends on its version. Until
3.4, the larger margin counts, less the larger gap; until 3.8, the sum of both, less both gaps;
since then the sum, whatever the gaps. A <pair> has a margin of its own, and `o_margin` replaces all
if the model overrides contacts.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from typing import Any

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.margins import Margins
from ssduck.simulators.interface import ContactPoints
from ssduck.simulators.mujoco.flexes import entity_roots, flexes_of
from ssduck.simulators.mujoco.library import copied_data, mujoco

# Of the numbers of a wrench, those that are forces; the others are moments.
_FORCE_AXES = 3
_PYRAMIDAL = int(mujoco.mjtCone.mjCONE_PYRAMIDAL)
# The flag that lets bodies sleep; 0 before MuJoCo 3.4.
_SLEEP = int(getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", 0))


class ContactReader:
    """Reads the contacts of a model, with those of sleeping bodies.

    Points at a distance, which margins allow, count if they press. A contact has one point, where
    its forces act on both sides.

    MuJoCo neither lists nor computes the contacts of sleeping bodies. A copy of the data is
    computed with all bodies awake, once for as long as the same ones sleep where they are: so the
    contacts are those of the step in which they fell asleep.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        # (geoms + 1,), the body of each geom; that of -1, which is no geom, is -1.
        self._bodies = np.append(model.geom_bodyid.astype(np.intp), -1)
        # (bodies + 1,), the first body of the entity of each body; that of -1 is -1.
        self.roots = np.append(entity_roots(model), -1)
        self._flexes = flexes_of(model)
        self._known: tuple[tuple[bytes, ...], ContactPoints] | None = None

    def read(self, data: Any, only: Collection[int] | None = None) -> ContactPoints:
        """Returns the contacts of the last step of data; those of some root bodies, or of all."""
        model, listed = self._model, self._listed(data, only)
        if not (model.opt.enableflags & _SLEEP):
            return listed
        is_asleep = np.append(data.tree_asleep >= 0, False)
        if not is_asleep.any():
            return listed
        # The tree of what does not move is -1: it does not sleep either.
        trees = model.body_treeid
        sleepers = is_asleep[trees]
        poses = data.xpos[sleepers].tobytes(), data.xquat[sleepers].tobytes()
        key = sleepers.tobytes(), *poses, bytes([model.opt.cone])
        is_awake = ~sleepers & (trees >= 0)
        if self._known is None or self._known[0] != key:
            copied = copied_data(model, data, mujoco.MjData(model))
            flags = model.opt.enableflags
            try:
                model.opt.enableflags = flags & ~_SLEEP
                mujoco.mj_forward(model, copied)
            finally:
                model.opt.enableflags = flags
            known = self._listed(copied, only)
            are_awake = is_awake[known.bodies + known.links].any(axis=1)
            self._known = key, known.only(~are_awake)
        awake = listed.only(is_awake[listed.bodies + listed.links].any(axis=1))
        return ContactPoints.joined([awake, self._known[1]])[0]

    def _listed(self, data: Any, only: Collection[int] | None) -> ContactPoints:
        """Returns the contacts that MuJoCo lists; normals point from the first side to the second.

        There may be contacts of other root bodies from the step before they were left out.
        """
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
        roots = self.roots.take(bodies)
        wrenches = _wrenches(contact, data.efc_force, self._model.opt.cone == _PYRAMIDAL)
        depths, forces = -contact.dist, wrenches[:, 0]
        are_of_bodies = (roots >= 0).all(axis=1)
        are_kept = are_of_bodies & ((depths >= 0.0) | (forces > 0.0))
        if only is not None:
            are_kept &= np.isin(roots, list(only)).all(axis=1)
        frames = contact.frame.reshape(-1, 3, 3)
        has_moments = contact.dim.max(initial=0) > _FORCE_AXES
        points = ContactPoints(
            bodies=roots,
            links=bodies - roots,
            points=np.repeat(contact.pos[:, None], 2, axis=1),
            normals=-frames[:, 0],
            depths=depths,
            forces=forces,
            frictions=-(wrenches[:, 1:2] * frames[:, 1] + wrenches[:, 2:3] * frames[:, 2]),
            has_moments=has_moments and bool(wrenches[are_of_bodies, _FORCE_AXES:].any()),
        )
        return points if are_kept.all() else points.only(are_kept)


def _wrenches(contact: Any, efc_forces: Array, is_pyramidal: bool) -> Array:
    """Returns the wrenches of contacts in their frames, (n, 6), as `mj_contactForce` does."""
    addresses, dims = contact.efc_address, contact.dim
    wrenches, is_active = np.zeros((len(dims), 6)), addresses >= 0
    # Most contacts are of one dimension, and all press.
    is_uniform = bool(is_active.all() and (dims == dims[:1]).all())
    for dim in (dims[:1] if is_uniform else np.unique(dims[is_active])).tolist():
        rows = slice(None) if is_uniform else np.flatnonzero(is_active & (dims == dim))
        first = addresses[rows, None]
        if not is_pyramidal or dim == 1:
            wrenches[rows, :dim] = efc_forces[first + np.arange(dim)]
            continue
        # A pyramid has two edges for each axis of friction; their forces add up to the normal one.
        edges = efc_forces[first + np.arange(2 * (dim - 1))].reshape(-1, dim - 1, 2)
        wrenches[rows, 0] = edges.sum(axis=(1, 2))
        differences = edges[:, :, 0] - edges[:, :, 1]
        wrenches[rows, 1:dim] = differences * contact.friction[rows, : dim - 1]
    adhesion = getattr(contact, "adhesion", None)  # since MuJoCo 4
    if adhesion is not None and adhesion.any():
        wrenches[is_active, 0] -= adhesion[is_active]
    return wrenches


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
