"""Decides pairs of convex shapes by directions and points that FCL proposes, if there are few.

For a few pairs, a call of FCL for each is faster than a step of GJK for all of them. Its distance
of solids that are apart proposes their nearest points, and the direction between them. Its contact
of solids that meet proposes a point of both, and the contact normal. FCL may be wrong: its
distances of boxes and cylinders with parallel edges are. Only what a proof makes of a proposal
counts:

* The supports of the shapes against any direction bound their signed distance from below.
* Of any point of each shape, the balls around them in the shapes bound it from above: the distance
  of the points less both radii.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.proofs.columns import column_lengths
from ssduck.geometry.proofs.cores import PlacedCores
from ssduck.geometry.proofs.gjk import tolerances
from ssduck.geometry.proofs.interiors import ConvexInteriors
from ssduck.geometry.proofs.verdicts import Decisions
from ssduck.geometry.solids import Solid

# Points are moved by this fraction towards the middle of the shape, so that they are surely in it.
_SHRINK = 1e-8
# The number of pairs that are remembered to be apart.
_MAX_APART = 4096


class Proposer:
    """FCL's objects of the shapes of a table, which are placed anew for each proposal.

    Args:
        solids: the distinct solids.
        solid_indices: (n,), the index of each shape's solid.
    """

    def __init__(self, solids: Sequence[Solid], solid_indices: Indices) -> None:
        self.interiors = ConvexInteriors(solids, solid_indices)
        self._solids, self._solid_indices = solids, solid_indices
        self._apart: set[tuple[int, int]] = set()  # pairs that were apart when last proposed

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

    def propose(
        self, positions: Array, matrices: Array, first: Indices, second: Indices
    ) -> tuple[Array, Array]:
        """Returns points of pairs of shapes, and directions from the second to the first.

        Args:
            positions: (shapes, 3), of all shapes.
            matrices: (shapes, 3, 3), their rotations.
            first: (n,), shapes with known interiors.
            second: (n,), the same.

        Returns:
            The points on the first and those on the second, (2, 3, n), and directions, (3, n), not
            of unit length: 0 where they are those between the points.
        """
        import fcl

        objects, distance, collide = self._objects, fcl.distance, fcl.collide
        wanted, contact = (
            fcl.DistanceRequest(enable_nearest_points=True),
            fcl.CollisionRequest(enable_contact=True),
        )
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
            nearest = fcl.DistanceResult()  # a new object each time: FCL only lowers its distance
            is_apart = pair in were_apart and distance(one, other, wanted, nearest) > 0.0
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
        proposals = np.concatenate(rows).reshape(-1, 3, 3).transpose(1, 2, 0)
        return proposals[:2], proposals[2]


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


def decide_by_proposals(
    bodies: PlacedCores,
    interiors: ConvexInteriors,
    proposed: tuple[Array, Array],
    first: Indices,
    second: Indices,
    bounds: Array,
) -> Decisions:
    """Decides pairs whose signed distances points and directions prove to be beyond the bounds.

    Args:
        bodies: the shapes.
        interiors: their interiors.
        proposed: points (2, 3, n) in the world, and directions (3, n); see `Proposer.propose`.
        first: (n,), shapes with known interiors.
        second: (n,), the same.
        bounds: (n,), metres.
    """
    cores, count = bodies.cores, len(first)
    points, directions = proposed
    between_points = points[0] - points[1]
    meet = directions.any(axis=0)
    directions = np.where(meet, directions, between_points)
    lengths = column_lengths(directions)
    directions /= np.where(lengths > 0.0, lengths, 1.0)
    both = np.concatenate((first, second))
    centres = bodies.centres.take(both, axis=1)
    vectors = np.array((points.swapaxes(0, 1).reshape(3, -1), np.tile(directions, 2)))
    vectors[0] -= centres
    np.negative(vectors[1, :, :count], out=vectors[1, :, :count])
    local, outward = bodies.to_local(both, vectors)
    # From below: by the supports.
    heights = bodies.support_heights(both, outward)
    between = np.einsum("cn,cn->n", directions, centres[:, :count] - centres[:, count:])
    least = between - heights[:count] - heights[count:]
    least[lengths == 0.0] = -np.inf
    are_balls = interiors.are_balls.take(both)
    if (shifted := meet & (are_balls[:count] | are_balls[count:])).any():
        # FCL's point is not in the middle of the overlap along its direction.
        middle = 0.5 * (between - heights[:count] + heights[count:])
        middle -= np.einsum("cn,cn->n", outward[:, count:], local[:, count:])
        middle *= shifted
        local += np.concatenate((-middle, middle)) * outward
    # From above: by the balls around the points.
    local += _SHRINK * (cores.inscribed_offsets.take(both, axis=1) - local)
    depths = interiors.depths(both, local)
    sizes = cores.bounding_radius.take(both)
    radii = depths - 2.0 * _SHRINK * sizes
    greatest = column_lengths(between_points) - radii[:count] - radii[count:]
    greatest[(depths[:count] < 0.0) | (depths[count:] < 0.0)] = np.inf
    return Decisions.of_interval(least, greatest, bounds, tolerances(bodies, first, second))
