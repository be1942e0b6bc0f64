"""Reads the poses and velocities of links from MuJoCo's arrays, and casts rays.

Velocities are computed when they are asked for.

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
from ssduck.geometry.poses import cross, multiply
from ssduck.geometry.ray_casting import is_triangle_surface, ray_chords
from ssduck.geometry.solids import Solid, solid_of
from ssduck.simulators.interface import Body, LinkPoses, RayHits
from ssduck.simulators.mujoco.bodies import (
    colliding_geoms,
    geometry_of,
    number_of,
    numbers_of,
    sites_on,
)
from ssduck.simulators.mujoco.flexes import entity_roots
from ssduck.simulators.mujoco.library import mujoco


class LinkReader:
    """Reads the links of some bodies of a model."""

    def __init__(self, model: Any, bodies: tuple[Body, ...]) -> None:
        self.bodies, self._model = bodies, model
        # The number of each link; the root of the tree of each body.
        links = [number_of(body, link) for body in bodies for link in range(len(body.links))]
        self._links = np.array(links, dtype=np.intp)
        self._roots = model.body_rootid.astype(np.intp)
        # Which of the links are sites, and the numbers of these.
        is_site = np.array([link.region is not None for b in bodies for link in b.links], bool)
        self._site_rows: Indices = np.flatnonzero(is_site)
        sites = [number for body in bodies for number in sites_on(model, numbers_of(body))]
        self._sites = np.array(sites, dtype=np.intp)

    def read(self, state: Any) -> LinkPoses:
        """Returns the poses and velocities of all links in a state, body after body."""
        # Twists are stated at the centres of mass of the trees of all bodies.
        centres = state.subtree_com.take(self._roots, axis=0)
        every = np.concatenate((state.xpos, state.xquat, state.cvel, centres), axis=1)
        numbers = every.take(self._links, axis=0)
        positions, orientations = numbers[:, :3], numbers[:, 3:7]
        if len(self._sites):
            positions[self._site_rows] = state.site_xpos.take(self._sites, axis=0)
            turns = self._model.site_quat.take(self._sites, axis=0)
            orientations[self._site_rows] = multiply(orientations[self._site_rows], turns)
        return LinkPoses(
            positions,
            partial(_states, numbers),
            are_finite=are_moderate(numbers.reshape(-1)),
            orientations=orientations,
        )


def _states(numbers: Array) -> Array:
    """Returns the states of links, (n, 13), of poses, twists and centres of mass, (n, 16)."""
    states = numbers[:, :13].copy()
    arms = numbers[:, :3] - numbers[:, 13:]
    states[:, 7:10] = numbers[:, 10:13] + cross(numbers[:, 7:10], arms)
    states[:, 10:] = numbers[:, 7:10]
    return states


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
            chosen = self._geoms[self._roots[self._geoms] != through[first]]
            self._model.geom_group[:] = _PASSED
            self._model.geom_group[chosen[~self._containing(data, starts[first], chosen)]] = _HIT
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

    def _containing(self, data: Any, start: Array, geoms: Indices) -> Flags:
        """Returns whether each geom is convex and contains a point."""
        bounds = self._model.geom_rbound[geoms]
        distances = np.linalg.norm(data.geom_xpos[geoms] - start, axis=1)
        is_plane = bounds == 0.0
        flags: Flags = is_plane | (distances <= bounds * (1.0 + 1e-6))
        for place in np.flatnonzero(flags).tolist():
            geom = int(geoms[place])
            if geom not in self._solids:
                geometry, centre, _ = geometry_of(self._model, geom)
                self._solids[geom] = solid_of(geometry), centre
            solid, centre = self._solids[geom]
            if not solid.is_convex or (is_triangle_surface(solid) and solid.offsets is None):
                flags[place] = False
            else:
                matrix = data.geom_xmat[geom].reshape(3, 3)
                local = (start - data.geom_xpos[geom]) @ matrix - centre
                flags[place] = ray_chords(solid, local, np.zeros((1, 3))).contains
        return flags
