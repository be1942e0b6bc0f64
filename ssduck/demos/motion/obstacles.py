"""Whether a robot is clear of what is around it, and of itself, for many postures at once.

The shapes are those of the world's tick, compared by the batched narrow phase of relations
(`ssduck.geometry.gjk`); what it leaves undecided counts as too near.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ssduck.demos.motion.kinematics import KinematicChain, poses
from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.broad_phase import Pairs
from ssduck.geometry.gjk import ABOVE, ConvexCores, PlacedCores, classify_gaps
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.geometry.solids import Solid, solid_of
from ssduck.world.entities import Entity

# Postures that are looked at together.
TOGETHER = 64
# Boxes around what is round are of points on it, which are that much too near, m.
PAD = 1e-3


@dataclass(frozen=True, eq=False)
class ObstacleShape:
    """A convex shape: its solid, and its pose (4, 4) in its link's frame, or in the world."""

    solid: Solid
    pose: Array
    link: int = -1


@dataclass(frozen=True, eq=False)
class Held:
    """What the hand holds: the link that holds it, and its shapes in that link's frame."""

    link: int
    entity: Entity
    shape: ObstacleShape


def shapes_of(entity: Entity) -> list[ObstacleShape]:
    """The shapes of an entity in its links' frames, at its world's tick."""
    snapshot = entity.world.snapshot
    body = entity.body_of(snapshot.members[snapshot.rows[entity.id]], "look at")
    return [_shape(placed) for placed in body.shapes]


def _shape(placed: PlacedGeometry) -> ObstacleShape:
    pose = poses(placed.position[None], placed.orientation[None])[0]
    return ObstacleShape(solid_of(placed.geometry), pose, placed.frame)


@dataclass(frozen=True, eq=False)
class Wall:
    """A shape in the world, and its box."""

    shape: ObstacleShape
    low: Array
    high: Array


def walls_of(entity: Entity) -> list[Wall]:
    """The shapes of an entity where they are at its world's tick."""
    shapes = shapes_of(entity)
    if all(shape.link == 0 for shape in shapes):
        frames = poses(np.array([entity.position]), np.array([entity.orientation]))
    else:
        links = entity.links
        frames = poses(
            np.array([link.position for link in links]),
            np.array([link.orientation for link in links]),
        )
    return [_wall(ObstacleShape(shape.solid, frames[shape.link] @ shape.pose)) for shape in shapes]


def _wall(shape: ObstacleShape) -> Wall:
    points = _points(shape)
    return Wall(shape, points.min(axis=0) - PAD, points.max(axis=0) + PAD)


def hull_in(frame: Array, entity: Entity) -> ObstacleShape:
    """The convex hull of an entity's shapes, in the frame of a pose (4, 4)."""
    points = np.concatenate([_points(wall.shape) for wall in walls_of(entity)])
    local = (points - frame[:3, 3]) @ frame[:3, :3]
    return ObstacleShape(solid_of(Geometry.hull(local)), np.eye(4))


def _points(shape: ObstacleShape) -> Array:
    points: Array = shape.solid.points @ shape.pose[:3, :3].T + shape.pose[:3, 3]
    return points


class Obstacles:
    """What a robot has to keep clear of, at a tick.

    Args:
        chain: the robot.
        robot: its handle.
        walls: what is in its way.
        held: what its hand holds.
        hand: the links of the hand, which may touch each other and what it holds.
    """

    def __init__(
        self,
        chain: KinematicChain,
        robot: Entity,
        walls: Sequence[Wall],
        held: Held | None = None,
        hand: Sequence[int] = (),
    ) -> None:
        self.chain = chain
        self.shapes = shapes_of(robot)
        self.hand = list(hand)
        if held is not None:
            self.shapes.append(ObstacleShape(held.shape.solid, held.shape.pose, held.link))
        self.walls = [wall.shape for wall in walls]
        self._low = np.array([wall.low for wall in walls]).reshape(-1, 3)
        self._high = np.array([wall.high for wall in walls]).reshape(-1, 3)
        self._prepare()

    def _prepare(self) -> None:
        solids = [shape.solid for shape in (*self.walls, *self.shapes)]
        count, walls = len(self.shapes), len(self.walls)
        numbers = np.concatenate(
            (np.arange(walls), walls + np.tile(np.arange(count), TOGETHER))
        ).astype(np.intp)
        self._cores = ConvexCores(solids, numbers)
        self._links = np.array([shape.link for shape in self.shapes], dtype=np.intp)
        self._local = np.array([shape.pose for shape in self.shapes])
        self._centre = _homogeneous([shape.solid.centre for shape in self.shapes])
        self._inner = _homogeneous([shape.solid.inscribed_centre for shape in self.shapes])
        self._reach = np.array([shape.solid.bounding_radius for shape in self.shapes])
        placed = np.array([wall.pose for wall in self.walls]).reshape(-1, 4, 4)
        self._wall_turns = placed[:, :3, :3].reshape(-1, 9).T
        centres = _homogeneous([wall.solid.centre for wall in self.walls])
        inner = _homogeneous([wall.solid.inscribed_centre for wall in self.walls])
        self._wall_centres = np.einsum("nab,nb->na", placed, centres)[:, :3].T
        self._wall_inner = np.einsum("nab,nb->na", placed, inner)[:, :3].T

    def clear(
        self,
        bases: Array,
        positions: Array,
        apart: float,
        *,
        moving: Collection[int] | None = None,
        itself: float | None = None,
    ) -> Flags:
        """Whether the robot keeps its distance in each of these postures, (n,).

        Args:
            bases: (n, 4, 4), of its base link.
            positions: (n, joints), rad.
            apart: metres, from everything else.
            moving: the links that are looked at; None for all.
            itself: metres, between links that are not neighbours, one of them `moving`; None
                not to look.
        """
        found = np.ones(len(positions), dtype=bool)
        for start in range(0, len(positions), TOGETHER):
            some = slice(start, start + TOGETHER)
            found[some] = self._clear(bases[some], positions[some], apart, moving, itself)
        return found

    def _clear(
        self,
        bases: Array,
        positions: Array,
        apart: float,
        moving: Collection[int] | None,
        itself: float | None,
    ) -> Flags:
        count = len(positions)
        placed = self.chain.frames(bases, positions)[:, self._links] @ self._local
        centres = (placed @ self._centre[:, :, None])[..., :3, 0]
        bodies = self._bodies(placed, centres)
        is_free = np.ones(count, dtype=bool)
        looked_at = np.flatnonzero(
            np.ones(len(self._links), bool)
            if moving is None
            else np.isin(self._links, list(moving))
        )
        for (first, second), bound in (
            (self._near_walls(centres, looked_at, apart), apart),
            (self._near_itself(centres, looked_at, itself), itself or 0.0),
        ):
            verdicts = classify_gaps(bodies, first, second, bound)
            posture = (first - len(self.walls)) // len(self._links)
            is_free[posture[verdicts != ABOVE]] = False
        return is_free

    def _bodies(self, placed: Array, centres: Array) -> PlacedCores:
        inner = (placed @ self._inner[:, :, None])[..., :3, 0]
        turns = placed[..., :3, :3].reshape(-1, 9).T
        return PlacedCores(
            self._cores,
            np.ascontiguousarray(np.concatenate((self._wall_turns, turns), axis=1)),
            np.concatenate((self._wall_centres, centres.reshape(-1, 3).T), axis=1),
            np.concatenate((self._wall_inner, inner.reshape(-1, 3).T), axis=1),
        )

    def _near_walls(self, centres: Array, looked_at: Indices, apart: float) -> Pairs:
        """Shapes of the robot and of what is around whose spheres and boxes are near."""
        some = centres[:, looked_at]
        reach = self._reach[looked_at] + apart
        low = (some - reach[:, None]).min(axis=(0, 1))
        high = (some + reach[:, None]).max(axis=(0, 1))
        walls = np.flatnonzero(((self._low <= high) & (self._high >= low)).all(axis=1))
        far = np.zeros((*some.shape[:2], len(walls)))
        for axis in range(3):
            along = some[:, :, axis, None]
            gap = np.maximum(self._low[walls, axis] - along, along - self._high[walls, axis])
            np.maximum(gap, 0.0, out=gap)
            far += gap * gap
        near = far <= (reach * reach)[:, None]
        posture, shape, wall = np.nonzero(near)
        first = len(self.walls) + posture * len(self._links) + looked_at[shape]
        return first, walls[wall]

    def _near_itself(self, centres: Array, looked_at: Indices, apart: float | None) -> Pairs:
        if apart is None:
            return np.zeros(0, np.intp), np.zeros(0, np.intp)
        s, t = self._own_pairs(looked_at)
        way = centres[:, s] - centres[:, t]
        reach = self._reach[s] + self._reach[t] + apart
        posture, pair = np.nonzero(np.einsum("npa,npa->np", way, way) <= reach * reach)
        base = len(self.walls) + posture * len(self._links)
        return base + s[pair], base + t[pair]

    def _own_pairs(self, looked_at: Indices) -> Pairs:
        """Pairs of the robot's shapes that may meet: not of neighbours, nor of the hand's."""
        parents = np.array([link.parent for link in self.chain.body.links])
        links, looks = self._links, np.zeros(len(self._links), bool)
        looks[looked_at] = True
        s, t = np.triu_indices(len(links), 1)
        i, j = links[s], links[t]
        in_hand = np.isin(links, self.hand)
        apart = (i != j) & (parents[i] != j) & (parents[j] != i) & ~(in_hand[s] & in_hand[t])
        apart &= looks[s] | looks[t]
        return s[apart], t[apart]


def _homogeneous(points: Sequence[tuple[float, float, float]]) -> Array:
    array = np.ones((len(points), 4))
    array[:, :3] = np.array(points).reshape(-1, 3)
    return array
