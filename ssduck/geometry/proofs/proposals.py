"""Decides pairs of convex shapes by directions and points that FCL proposes, if there are few.

For a few pairs, a call of FCL for each is faster than a step of GJK for all of them. Its distance
of solids that are apart proposes their nearest points, and the direction between them. Its contact
of solids that meet proposes a point of both, and the contact normal. FCL may be wrong: its
distances of boxes and cylinders with parallel edges are. Only what a proof makes of a proposal
counts:

* The supports of the shapes against any direction bound their signed distance from below.
* Of any point of each shape, the balls around them in the shapes bound it from above: the distance
  of the points less both radii. Of shapes that meet, it is one point, moved along the direction to
  where it is equally deep in both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.proofs.columns import column_lengths
from ssduck.geometry.proofs.cores import PlacedCores
from ssduck.geometry.proofs.gjk import tolerances
from ssduck.geometry.proofs.interiors import SHRINK, ConvexInteriors, SomeInteriors
from ssduck.geometry.proofs.verdicts import Decisions
from ssduck.geometry.solids import Solid

# The number of pairs that are remembered to be apart.
_MAX_APART = 4096

# The positions (n, 3) and the rotations (n, 3, 3) of shapes.
Poses: TypeAlias = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Proposals:
    """Directions and points that may prove verdicts on n pairs of shapes.

    Attributes:
        points: (2, 3, n), on or in the first shapes, and the second ones, in the world.
        directions: (3, n), from the second to the first, of any length.
        meet: (n,), whether the shapes are thought to overlap, around the points.
    """

    points: Array
    directions: Array
    meet: Flags


class Proposer:
    """Decides pairs of shapes of a table by what FCL proposes.

    FCL's objects are placed anew for each proposal.

    Args:
        solids: the distinct solids.
        solid_indices: (n,), the index of each shape's solid.
    """

    def __init__(self, solids: Sequence[Solid], solid_indices: Indices) -> None:
        self._solids, self._solid_indices = solids, solid_indices
        self._apart: set[tuple[int, int]] = set()  # pairs that were apart when last proposed

    @cached_property
    def interiors(self) -> ConvexInteriors:
        """The interiors of the shapes, made when first needed: a table of many ticks needs none."""
        return ConvexInteriors(self._solids, self._solid_indices)

    def decide(
        self, bodies: PlacedCores, poses: Poses, first: Indices, second: Indices, bounds: Array
    ) -> Decisions:
        """Decides pairs whose signed distances are proved to be beyond the bounds.

        Args:
            bodies: the shapes.
            poses: the positions (shapes, 3) and the rotations (shapes, 3, 3) of all shapes.
            first: (n,), shapes with known interiors.
            second: (n,), the same.
            bounds: (n,), metres.
        """
        proposals = proposals_of(self.ask(poses, first, second))
        proof = Proof(bodies, self.interiors, proposals, first, second)
        error = tolerances(bodies, first, second)
        return Decisions.of_interval(proof.least, proof.greatest, bounds, error)

    @cached_property
    def _objects(self) -> list[Any]:
        """The object of each shape; None for shapes that FCL does not compare."""
        import fcl

        indices, known = self._solid_indices.tolist(), self.interiors.are_known.tolist()
        geometries: dict[int, Any] = {}
        for index, is_known in zip(indices, known, strict=True):
            if is_known and index not in geometries:
                geometries[index] = _geometry(self._solids[index])
        return [
            fcl.CollisionObject(geometries[index]) if is_known else None
            for index, is_known in zip(indices, known, strict=True)
        ]

    def ask(self, poses: Poses, first: Indices, second: Indices) -> Array:
        """Returns what FCL says of pairs of shapes with known interiors, (n, 3, 3).

        It is a point on the first shape, a point on the second one, and the contact normal from the
        second to the first; 0 for shapes that do not meet.
        """
        import fcl

        objects, distance, collide = self._objects, fcl.distance, fcl.collide
        wanted, contact = (
            fcl.DistanceRequest(enable_nearest_points=True),
            fcl.CollisionRequest(enable_contact=True),
        )
        positions, matrices = poses
        pairs = list(zip(first.tolist(), second.tolist(), strict=True))
        for shape in {shape for pair in pairs for shape in pair}:
            objects[shape].setRotation(matrices[shape])
            objects[shape].setTranslation(positions[shape])
        were_apart = self._apart
        if len(were_apart) > _MAX_APART:
            were_apart.clear()
        rows: list[Array] = []
        for pair in pairs:
            one, other = objects[pair[0]], objects[pair[1]]
            # Both probably are as they were; FCL compares twice where they are not.
            is_apart = False
            if pair in were_apart:
                nearest = fcl.DistanceResult()  # a new one each time: FCL only lowers its distance
                is_apart = distance(one, other, wanted, nearest) > 0.0
            if not is_apart:
                meeting = fcl.CollisionResult()
                collide(one, other, contact, meeting)
                if contacts := meeting.contacts:
                    were_apart.discard(pair)
                    deepest = contacts[0]
                    rows += (deepest.pos, deepest.pos, -deepest.normal)
                    continue
                were_apart.add(pair)
                nearest = fcl.DistanceResult()
                distance(one, other, wanted, nearest)
            rows += (*nearest.nearest_points, _NO_DIRECTION)
        return np.concatenate(rows).reshape(-1, 3, 3)


def proposals_of(asked: Array) -> Proposals:
    """Returns proposals of what FCL says of pairs; see `Proposer.ask`."""
    on_first, on_second, directions = asked.transpose(1, 2, 0)
    meet = np.asarray(directions.any(axis=0))
    directions = np.where(meet, directions, on_first - on_second)
    return Proposals(np.array((on_first, on_second)), directions, meet)


_NO_DIRECTION = np.zeros(3)


def _geometry(solid: Solid) -> Any:
    """Returns FCL's geometry of a convex solid with an inside."""
    import fcl

    radius, half = solid.radius, solid.core[-1].tolist()
    if solid.type == "box":
        return fcl.Box(*(2.0 * side for side in half))
    if solid.type == "sphere":
        return fcl.Sphere(radius)
    if solid.type == "capsule":
        return fcl.Capsule(radius, 2.0 * half[2])
    if solid.type == "cylinder":
        return fcl.Cylinder(solid.disc_radius, 2.0 * half[2])
    if solid.type == "ellipsoid":
        return fcl.Ellipsoid(*solid.semi_axes)
    counts = np.full((len(solid.faces), 1), 3)
    corners = np.concatenate((counts, solid.faces), axis=1)
    return fcl.Convex(solid.core, len(solid.faces), corners.ravel())


class Proof:
    """Bounds of the signed distances of pairs of shapes, of whatever is proposed.

    Args:
        bodies: the shapes.
        interiors: their interiors.
        proposals: points and directions.
        first: (n,), shapes with known interiors.
        second: (n,), the same.

    Attributes:
        least: (n,), what the signed distances are at least, metres.
        greatest: (n,), what they are at most.
        directions: (3, n), of unit length.
        local: (3, 2 n), the points on the first shapes, then those on the second, in their frames
            from the solids' centres.
        meet: (n,), whether the shapes may overlap, so that the points are the same.
    """

    def __init__(
        self,
        bodies: PlacedCores,
        interiors: ConvexInteriors,
        proposals: Proposals,
        first: Indices,
        second: Indices,
    ) -> None:
        both = np.concatenate((first, second))
        inner, centres = interiors.of(both), bodies.centres.take(both, axis=1)
        lengths = column_lengths(proposals.directions)
        is_long = lengths > 0.0
        self.directions = proposals.directions / np.where(is_long, lengths, 1.0)
        self.directions[2] += ~is_long  # any direction of length 1 gives a bound
        between_points = proposals.points[0] - proposals.points[1]
        on_shapes = np.concatenate(proposals.points, axis=1) - centres
        vectors = on_shapes, _outward(self.directions), _outward(0.5 * between_points)
        local, outward, halves = bodies.to_local(both, np.array(vectors))
        self.least = self._least(inner, outward, centres)
        self.meet = proposals.meet | (self.least < 0.0)
        halves *= np.concatenate((self.meet, self.meet))
        local += halves
        self.local = self._balanced(inner, outward, local)
        self.local += SHRINK * (inner.inscribed_offsets - self.local)
        self.greatest = self._greatest(inner, column_lengths(between_points) * ~self.meet)

    def _least(self, inner: SomeInteriors, outward: Array, centres: Array) -> Array:
        """Returns bounds from below, (n,): by the supports of the shapes against the directions."""
        heights, count = inner.heights(outward), self.directions.shape[1]
        offsets = centres[:, :count] - centres[:, count:]
        least: Array = np.einsum("cn,cn->n", self.directions, offsets)
        least -= heights[:count]
        least -= heights[count:]
        return least

    def _balanced(self, inner: SomeInteriors, outward: Array, local: Array) -> Array:
        """Returns points (3, 2 n); those of shapes that meet are about equally deep in both."""
        if self.meet.any():
            depths, count = inner.depths(local), len(self.meet)
            steps = 0.5 * (depths[:count] - depths[count:])
            steps *= self.meet
            local += np.concatenate((steps, -steps)) * outward
        return local

    def _greatest(self, inner: SomeInteriors, apart: Array) -> Array:
        """Returns bounds from above, (n,): by the balls in the shapes around the points.

        Args:
            inner: the interiors.
            apart: (n,), the distances of the points.
        """
        depths, count = inner.depths(self.local), len(apart)
        radii = depths - inner.margins
        greatest: Array = apart - radii[:count] - radii[count:]
        greatest[(depths[:count] < 0.0) | (depths[count:] < 0.0)] = np.inf
        return greatest


def _outward(vectors: Array) -> Array:
    """Returns the negative vectors (3, n) for the first shapes, and these for the second."""
    both: Array = np.concatenate((-vectors, vectors), axis=1)
    return both
