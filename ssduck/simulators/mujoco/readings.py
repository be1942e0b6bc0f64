"""Reads the poses and velocities of links from MuJoCo's arrays, and casts rays.

An array of each kind is copied at once, all of them into one: for few links, a copy takes as long
as a call. Velocities are computed when they are asked for.

MuJoCo's rays hit all that is drawn, from inside and outside. ssduck's hit what collides. So they
are cast in a copy of the model, whose geoms are in one group if they count, and in another if not:
those that do not collide, those of the body that a ray passes through, and those that it begins in.
A mesh is hit where its triangles are, not those of its hull.
"""

from __future__ import annotations

import copy
from collections.abc import Collection
from functools import partial
from typing import Any

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices, are_moderate
from ssduck.geometry.poses import cross, multiply, rotation_matrices
from ssduck.geometry.ray_casting import is_triangle_surface, ray_chords
from ssduck.geometry.solids import Solid, solid_of
from ssduck.simulators.interface import Body, LinkPoses, PosesSource, RayHits
from ssduck.simulators.mujoco.bodies import colliding_geoms, geometry_of, numbers_of, sites_on
from ssduck.simulators.mujoco.flexes import entity_roots
from ssduck.simulators.mujoco.library import mujoco

# MuJoCo's arrays of positions, orientations and twists of bodies, and of the centres of mass of
# their trees, which twists are stated at; and the numbers of a body in each. Its matrices differ
# from those that a past tick has of the orientations, in the last bits of some builds.
_ARRAYS = {"xpos": 3, "xquat": 4, "cvel": 6, "subtree_com": 3}
# Likewise, of sites.
_SITE_ARRAYS = {"site_xpos": 3}
# The ends of a link's position, orientation and twist among its numbers.
_POSITION, _ORIENTATION, _TWIST = 3, 7, 13


class LinkReader:
    """Reads the links of some bodies of a model."""

    def __init__(self, model: Any, bodies: tuple[Body, ...]) -> None:
        self.bodies, self._model = bodies, model
        # The number of each link, of a site that of its parent, and of the root of its tree.
        links = [
            body.handle + (number if link.region is None else link.parent)
            for body in bodies
            for number, link in enumerate(body.links)
        ]
        self._links = np.array(links, dtype=np.intp)
        self._roots = model.body_rootid[self._links].astype(np.intp)
        # Which of the links are sites, and the numbers of these.
        is_site = np.array([link.region is not None for b in bodies for link in b.links], bool)
        self._site_rows: Indices = np.flatnonzero(is_site)
        sites = [number for body in bodies for number in sites_on(model, numbers_of(body))]
        self._sites = np.array(sites, dtype=np.intp)
        is_all = np.array_equal(self._links, np.arange(model.nbody))
        # The places of their numbers among those of all arrays; None for all in order.
        self._places = None if is_all and not sites else self._places_of(model.nbody)
        # The last state, and its arrays as views of its memory, which stay the same.
        self._views: tuple[Any, list[Array]] | None = None

    def _places_of(self, count: int) -> Indices:
        """Returns the places of the links' numbers, part after part, and of all centres of mass."""
        starts = count * np.cumsum([0, *_ARRAYS.values()])
        parts = [
            start + size * self._links[:, None] + np.arange(size)
            for start, size in zip(starts[:-2].tolist(), list(_ARRAYS.values())[:-1], strict=True)
        ]
        first = starts[-1]
        for part, size in zip(parts, _SITE_ARRAYS.values(), strict=False):
            part[self._site_rows] = first + size * self._sites[:, None] + np.arange(size)
            first += size * self._model.nsite
        centres = np.arange(starts[-2], starts[-1])
        return np.concatenate([*(part.reshape(-1) for part in parts), centres])

    def read(self, state: Any) -> LinkPoses:
        """Returns the poses and velocities of all links in a state, body after body."""
        numbers = self._numbers(state)
        if len(self._sites):
            count = len(self._roots)
            turns = self._model.site_quat.take(self._sites, axis=0)
            orientations = numbers[_POSITION * count : _ORIENTATION * count].reshape(count, 4)
            orientations[self._site_rows] = multiply(orientations[self._site_rows], turns)
        return self._poses(numbers[None])

    def _poses(self, numbers: Array) -> LinkPoses:
        """Returns the poses and velocities at t ticks, one after the other, of (t, k) numbers."""
        count = len(self._roots)
        positions = numbers[:, : _POSITION * count].reshape(-1, 3)
        orientations = numbers[:, _POSITION * count : _ORIENTATION * count].reshape(-1, 4)
        return LinkPoses(
            positions,
            partial(rotation_matrices, orientations),
            partial(self._states, positions, orientations, numbers),
            are_finite=are_moderate(numbers.reshape(-1)),
            orientations=orientations,
            source=PosesSource(numbers[0], self._poses),
        )

    def _states(self, positions: Array, orientations: Array, numbers: Array) -> Array:
        """Returns the states of the links at t ticks, (t n, 13); see `LinkPoses`."""
        start = _TWIST * len(self._roots)
        twists = numbers[:, start - 6 * len(self._roots) : start].reshape(-1, 6)
        # Twists are stated at the centres of mass of the trees of all bodies.
        centres = numbers[:, start:].reshape(len(numbers), -1, 3).take(self._roots, axis=1)
        states = np.zeros((len(positions), 13))
        states[:, :3], states[:, 3:7] = positions, orientations
        arms = positions - centres.reshape(-1, 3)
        states[:, 7:10] = twists[:, 3:] + cross(twists[:, :3], arms)
        states[:, 10:] = twists[:, :3]
        return states

    def _numbers(self, state: Any) -> Array:
        """Returns MuJoCo's numbers of the links, part after part, and all centres of mass."""
        if self._views is None or self._views[0] is not state:
            names = [*_ARRAYS, *(() if self._places is None else _SITE_ARRAYS)]
            self._views = state, [getattr(state, name).reshape(-1) for name in names]
        numbers: Array = np.concatenate(self._views[1])
        return numbers if self._places is None else numbers.take(self._places)


# The groups of the geoms that rays hit, and of those that they do not hit.
_HIT, _PASSED = 0, 5
_GROUPS = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
# Versions of MuJoCo differ in whether rays also return the normals of what they hit.
_HAS_NORMALS = "normal:" in (mujoco.mj_multiRay.__doc__ or "")
# Those that do not leave planes out whose centre is beyond the cutoff.
_NO_CUTOFF = 1e10


class RayCaster:
    """Casts rays against the shapes of a model."""

    def __init__(self, model: Any, only: Collection[int] | None = None) -> None:
        self._model = copy.copy(model)
        # MuJoCo's rays pass through what is invisible.
        self._model.geom_rgba[:, 3] = 1.0
        self._roots = entity_roots(model)[model.geom_bodyid]
        self._geoms = colliding_geoms(model)
        if only is not None:
            self._geoms = self._geoms[np.isin(self._roots[self._geoms], list(only))]
        self._solids: dict[int, tuple[Solid, Array]] = {}

    def cast(self, data: Any, starts: Array, ends: Array, through: Indices) -> RayHits:
        """Returns the first root body that each ray hits; see `Simulator.cast_rays`."""
        bodies, fractions = np.full(len(starts), -1, dtype=np.intp), np.ones(len(starts))
        keys = np.column_stack((starts, through))
        # Rays of a sensor begin at one point, for which MuJoCo casts all at once.
        _, firsts, groups = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        for number, first in enumerate(firsts.tolist()):
            rays = np.flatnonzero(groups.reshape(-1) == number)
            self._choose(data, starts[first], int(through[first]))
            geoms, hits = self._cast_from(data, starts[first], ends[rays] - starts[first])
            is_hit = geoms >= 0
            bodies[rays[is_hit]] = self._roots[geoms[is_hit]]
            fractions[rays[is_hit]] = hits[is_hit]
        return RayHits(bodies, fractions)

    def _cast_from(self, data: Any, start: Array, vectors: Array) -> tuple[Indices, Array]:
        """Returns the geoms that rays from one point hit, -1 for none, and the fractions."""
        lengths = np.linalg.norm(vectors, axis=1)
        is_ray = lengths > 0.0
        units = vectors[is_ray] / lengths[is_ray, None]
        count = len(units)
        hit, distances = np.full(count, -1, np.int32), np.full(count, -1.0)
        if count:
            normals = {"normal": None} if _HAS_NORMALS else {}
            mujoco.mj_multiRay(
                m=self._model,
                d=data,
                pnt=np.ascontiguousarray(start),
                vec=units.reshape(-1),
                geomgroup=_GROUPS,
                flg_static=True,
                bodyexclude=-1,
                geomid=hit,
                dist=distances,
                nray=count,
                cutoff=float(lengths.max()) * 1.01 if _HAS_NORMALS else _NO_CUTOFF,
                **normals,
            )
        geoms, fractions = np.full(len(vectors), -1, np.intp), np.ones(len(vectors))
        is_near = (hit >= 0) & (distances >= 0.0) & (distances <= lengths[is_ray])
        near = np.flatnonzero(is_ray)[is_near]
        geoms[near] = hit[is_near]
        fractions[near] = distances[is_near] / lengths[near]
        return geoms, fractions

    def _choose(self, data: Any, start: Array, through: int) -> None:
        """Puts the geoms that rays from a point can hit into a group of their own."""
        groups = np.full(self._model.ngeom, _PASSED, dtype=np.int32)
        chosen = self._geoms[self._roots[self._geoms] != through]
        groups[chosen[~self._containing(data, start, chosen)]] = _HIT
        self._model.geom_group[:] = groups

    def _containing(self, data: Any, start: Array, geoms: Indices) -> Flags:
        """Returns whether each geom is convex and contains a point."""
        bounds = self._model.geom_rbound[geoms]
        distances = np.linalg.norm(data.geom_xpos[geoms] - start, axis=1)
        is_plane = bounds == 0.0
        flags: Flags = is_plane | (distances <= bounds * (1.0 + 1e-6))
        for place in np.flatnonzero(flags).tolist():
            flags[place] = self._contains(data, start, int(geoms[place]))
        return flags

    def _contains(self, data: Any, start: Array, geom: int) -> bool:
        if geom not in self._solids:
            geometry, centre, _ = geometry_of(self._model, geom)
            self._solids[geom] = solid_of(geometry), centre
        solid, centre = self._solids[geom]
        if not solid.is_convex or (is_triangle_surface(solid) and solid.offsets is None):
            return False
        matrix = data.geom_xmat[geom].reshape(3, 3)
        local = (start - data.geom_xpos[geom]) @ matrix - centre
        return bool(ray_chords(solid, local, np.zeros((1, 3))).contains)
