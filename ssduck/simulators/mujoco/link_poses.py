"""Reads the poses and velocities of links from MuJoCo's arrays.

An array of each kind is copied at once, all of them into one: for few links, a copy takes as long
as a call. Velocities are computed when they are asked for.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.poses import cross, multiply, rotation_matrices
from ssduck.simulators.interface import Body, LinkPoses
from ssduck.simulators.mujoco.bodies import numbers_of, sites_on

# MuJoCo's arrays of positions, orientations and twists of bodies, and of the centres of mass of
# their trees, which twists are stated at; and the numbers of a body in each. Its matrices differ
# from those that a past tick has of the orientations, in the last bits of some builds.
_ARRAYS = {"xpos": 3, "xquat": 4, "cvel": 6, "subtree_com": 3}
# Likewise, of sites.
_SITE_ARRAYS = {"site_xpos": 3}
# The ends of a link's position, orientation and twist among its numbers.
_POSITION, _ORIENTATION, _TWIST = 3, 7, 13
# If the squares of numbers add up to less, sums of their products are finite.
_MODERATE = 1e100
# BLAS multiplies longer vectors in threads, which takes far longer.
_UNTHREADED = 8192


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
        """Returns the places of the links' numbers, part after part, and of all centres of mass.

        Args:
            count: the number of bodies.
        """
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
        count = len(self._roots)
        numbers = self._numbers(state)
        positions = numbers[: _POSITION * count].reshape(count, 3)
        orientations = numbers[_POSITION * count : _ORIENTATION * count].reshape(count, 4)
        twists = numbers[_ORIENTATION * count : _TWIST * count].reshape(count, 6)
        if len(self._sites):
            turns = self._model.site_quat.take(self._sites, axis=0)
            orientations[self._site_rows] = multiply(orientations[self._site_rows], turns)
        parts = positions, orientations, twists, numbers[_TWIST * count :].reshape(-1, 3)
        return LinkPoses(
            positions,
            partial(rotation_matrices, orientations),
            partial(_states, parts, self._roots),
            are_finite=_are_moderate(numbers),
            orientations=orientations,
        )

    def _numbers(self, state: Any) -> Array:
        """Returns MuJoCo's numbers of the links, part after part, and all centres of mass."""
        if self._views is None or self._views[0] is not state:
            names = [*_ARRAYS, *(() if self._places is None else _SITE_ARRAYS)]
            self._views = state, [getattr(state, name).reshape(-1) for name in names]
        numbers: Array = np.concatenate(self._views[1])
        return numbers if self._places is None else numbers.take(self._places)


def _states(parts: tuple[Array, Array, Array, Array], roots: Indices) -> Array:
    """Returns the states of n links; see `LinkPoses`.

    Args:
        parts: positions (n, 3), orientations (n, 4), twists (n, 6), and the centres of mass of the
            trees of all bodies, (bodies, 3): twists are stated at those.
        roots: (n,), the number of the root of each link's tree.
    """
    positions, orientations, twists, centres = parts
    states = np.zeros((len(positions), 13))
    states[:, :3], states[:, 3:7] = positions, orientations
    arms = positions - centres.take(roots, axis=0)
    states[:, 7:10] = twists[:, 3:] + cross(twists[:, :3], arms)
    states[:, 10:] = twists[:, :3]
    return states


def _are_moderate(numbers: Array) -> bool:
    """Checks whether numbers are finite, and so are sums of their products."""
    if len(numbers) <= _UNTHREADED:
        return bool(np.dot(numbers, numbers) < _MODERATE)
    parts = (numbers[n : n + _UNTHREADED] for n in range(0, len(numbers), _UNTHREADED))
    return sum(float(np.dot(part, part)) for part in parts) < _MODERATE
