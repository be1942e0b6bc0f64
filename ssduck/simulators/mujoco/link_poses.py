"""Reads the poses and velocities of links from MuJoCo's arrays.

An array of each kind is copied at once, all of them into one: for few links, a copy takes as long
as a call. Velocities are computed when they are asked for.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from ssduck.geometry.arrays import Array, Indices, are_moderate
from ssduck.geometry.poses import cross, multiply, rotation_matrices
from ssduck.simulators.interface import Body, LinkPoses, PosesSource
from ssduck.simulators.mujoco.bodies import numbers_of, sites_on

# MuJoCo's arrays of positions, orientations and twists of bodies, and of the centres of mass of
# their trees, which twists are stated at; and the numbers of a body in each. Its matrices differ
# from those that a past tick has of the orientations, in the last bits of some builds.
_ARRAYS = {"xpos": 3, "xquat": 4, "cvel": 6, "subtree_com": 3}
# Likewise, of sites.
_SITE_ARRAYS = {"site_xpos": 3}
# The ends of a link's position, orientation and twist among its numbers.
_POSITION, _ORIENTATION, _TWIST = 3, 7, 13


class LinkReader:
    """Reads the links of some bodies.

    Args:
        model: the model.
        bodies: the bodies.

    Attributes:
        bodies: see above.
    """

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
