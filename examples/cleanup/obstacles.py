"""Tests many postures of a robot at once for clearance from obstacles and from itself.

The shapes are those of the current tick, compared by the batched narrow phase of relations
(`ssduck.geometry.proofs.gjk`); undecided pairs count as too near.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from examples.cleanup.kinematics import KinematicChain, poses
from ssduck.geometry.arrays import Array, Flags, Indices
from ssduck.geometry.broad_phase import Pairs
from ssduck.geometry.proofs.cores import ConvexCores, PlacedCores
from ssduck.geometry.proofs.gjk import decide_gaps
from ssduck.geometry.proofs.verdicts import ABOVE
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.geometry.solids import Solid, SolidsOfShapes, solid_of
from ssduck.world.entities import Entity

# The number of postures tested at a time.
BATCH = 64
# A margin of boxes: those of round shapes are computed from points on them, m.
BOX_MARGIN = 1e-3


@dataclass(frozen=True, eq=False)
class ObstacleShape:
    """A convex shape: its solid, and its pose (4, 4) in the frame of its link or in the world."""

    solid: Solid
    pose: Array
    link: int = -1


@dataclass(frozen=True, eq=False)
class HeldEntity:
    """A held entity: the link that holds it, and its hull in the frame of that link."""

    link: int
    entity: Entity
    shape: ObstacleShape


def shapes_of(entity: Entity) -> list[ObstacleShape]:
    """Returns the shapes of an entity in the frames of its links."""
    snapshot = entity.world.snapshot
    body = entity.body_of(snapshot.entities[snapshot.rows[entity.id]], "look at")
    return [_shape(placed) for placed in body.shapes]


def _shape(placed: PlacedGeometry) -> ObstacleShape:
    pose = poses(placed.position[None], placed.orientation[None])[0]
    return ObstacleShape(solid_of(placed.geometry), pose, placed.frame)


@dataclass(frozen=True, eq=False)
class Wall:
    """A shape in the world and its box."""

    shape: ObstacleShape
    low: Array
    high: Array


def walls_of(entity: Entity) -> list[Wall]:
    """Returns the shapes of an entity in the world at the current tick."""
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
    return Wall(shape, points.min(axis=0) - BOX_MARGIN, points.max(axis=0) + BOX_MARGIN)


def hull_in(frame: Array, entity: Entity) -> ObstacleShape:
    """Returns the convex hull of the shapes of an entity in the frame of a pose (4, 4)."""
    points = np.concatenate([_points(wall.shape) for wall in walls_of(entity)])
    local = (points - frame[:3, 3]) @ frame[:3, :3]
    return ObstacleShape(solid_of(Geometry.hull(local)), np.eye(4))


def _points(shape: ObstacleShape) -> Array:
    points: Array = shape.solid.points @ shape.pose[:3, :3].T + shape.pose[:3, 3]
    return points


class Obstacles:
    """The obstacles of a robot at a tick.

    Args:
        chain: the kinematic chain of the robot.
        robot: the handle of the robot.
        walls: the shapes of the obstacles.
        held: the entity in the hand.
        hand: the links of the hand, which may touch each other and the held entity.
    """

    def __init__(
        self,
        chain: KinematicChain,
        robot: Entity,
        walls: Sequence[Wall],
        held: HeldEntity | None = None,
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
            (np.arange(walls), walls + np.tile(np.arange(count), BATCH))
        ).astype(np.intp)
        self._cores = ConvexCores(SolidsOfShapes(solids, numbers))
        self._links = np.array([shape.link for shape in self.shapes], dtype=np.intp)
        self._local = np.array([shape.pose for shape in self.shapes])
        self._centre = _homogeneous([shape.solid.centre for shape in self.shapes])
        self._inner = _homogeneous([shape.solid.inscribed_centre for shape in self.shapes])
        self._radii = np.array([shape.solid.bounding_radius for shape in self.shapes])
        poses_in_world = np.array([wall.pose for wall in self.walls]).reshape(-1, 4, 4)
        self._wall_rotations = poses_in_world[:, :3, :3].reshape(-1, 9).T
        centres = _homogeneous([wall.solid.centre for wall in self.walls])
        inner = _homogeneous([wall.solid.inscribed_centre for wall in self.walls])
        self._wall_centres = np.einsum("nab,nb->na", poses_in_world, centres)[:, :3].T
        self._wall_inner = np.einsum("nab,nb->na", poses_in_world, inner)[:, :3].T

    def clear(
        self,
        bases: Array,
        positions: Array,
        clearance: float,
        *,
        moving: Collection[int] | None = None,
        self_clearance: float | None = None,
    ) -> Flags:
        """Checks whether the robot keeps clear in each of some postures, (n,).

        Args:
            bases: (n, 4, 4), poses of the base link.
            positions: (n, joints), rad.
            clearance: the clearance from obstacles, metres.
            moving: the links to test; None for all.
            self_clearance: the clearance between links that are not neighbours, one of them
                `moving`, metres; None skips this test.
        """
        is_clear = np.ones(len(positions), dtype=bool)
        for start in range(0, len(positions), BATCH):
            batch = slice(start, start + BATCH)
            is_clear[batch] = self._clear(
                bases[batch], positions[batch], clearance, moving, self_clearance
            )
        return is_clear

    def _clear(
        self,
        bases: Array,
        positions: Array,
        clearance: float,
        moving: Collection[int] | None,
        self_clearance: float | None,
    ) -> Flags:
        count = len(positions)
        poses_in_world = self.chain.frames(bases, positions)[:, self._links] @ self._local
        centres = (poses_in_world @ self._centre[:, :, None])[..., :3, 0]
        cores = self._placed_cores(poses_in_world, centres)
        is_clear = np.ones(count, dtype=bool)
        tested = np.flatnonzero(
            np.ones(len(self._links), bool)
            if moving is None
            else np.isin(self._links, list(moving))
        )
        for (first, second), bound in (
            (self._near_walls(centres, tested, clearance), clearance),
            (self._near_itself(centres, tested, self_clearance), self_clearance or 0.0),
        ):
            bounds = np.full(len(first), bound)
            verdicts = decide_gaps(cores, first, second, bounds).verdicts
            posture = (first - len(self.walls)) // len(self._links)
            is_clear[posture[verdicts != ABOVE]] = False
        return is_clear

    def _placed_cores(self, poses_in_world: Array, centres: Array) -> PlacedCores:
        inner = (poses_in_world @ self._inner[:, :, None])[..., :3, 0]
        rotations = poses_in_world[..., :3, :3].reshape(-1, 9).T
        return PlacedCores(
            self._cores,
            np.ascontiguousarray(np.concatenate((self._wall_rotations, rotations), axis=1)),
            np.concatenate((self._wall_centres, centres.reshape(-1, 3).T), axis=1),
            np.concatenate((self._wall_inner, inner.reshape(-1, 3).T), axis=1),
        )

    def _near_walls(self, centres: Array, tested: Indices, clearance: float) -> Pairs:
        """Returns pairs of shapes of robot and obstacles whose spheres and boxes are near."""
        tested_centres = centres[:, tested]
        radii = self._radii[tested] + clearance
        low = (tested_centres - radii[:, None]).min(axis=(0, 1))
        high = (tested_centres + radii[:, None]).max(axis=(0, 1))
        walls = np.flatnonzero(((self._low <= high) & (self._high >= low)).all(axis=1))
        squared_distances = np.zeros((*tested_centres.shape[:2], len(walls)))
        for axis in range(3):
            coordinates = tested_centres[:, :, axis, None]
            gap = np.maximum(
                self._low[walls, axis] - coordinates, coordinates - self._high[walls, axis]
            )
            np.maximum(gap, 0.0, out=gap)
            squared_distances += gap * gap
        is_near = squared_distances <= (radii * radii)[:, None]
        posture, shape, wall = np.nonzero(is_near)
        first = len(self.walls) + posture * len(self._links) + tested[shape]
        return first, walls[wall]

    def _near_itself(self, centres: Array, tested: Indices, clearance: float | None) -> Pairs:
        if clearance is None:
            return np.zeros(0, np.intp), np.zeros(0, np.intp)
        s, t = self._self_pairs(tested)
        offsets = centres[:, s] - centres[:, t]
        radii = self._radii[s] + self._radii[t] + clearance
        posture, pair = np.nonzero(np.einsum("npa,npa->np", offsets, offsets) <= radii * radii)
        base = len(self.walls) + posture * len(self._links)
        return base + s[pair], base + t[pair]

    def _self_pairs(self, tested: Indices) -> Pairs:
        """Returns pairs of shapes of the robot to test: not of neighbour links nor of the hand."""
        parents = np.array([link.parent for link in self.chain.body.links])
        links, is_tested = self._links, np.zeros(len(self._links), bool)
        is_tested[tested] = True
        s, t = np.triu_indices(len(links), 1)
        i, j = links[s], links[t]
        in_hand = np.isin(links, self.hand)
        is_pair = (i != j) & (parents[i] != j) & (parents[j] != i) & ~(in_hand[s] & in_hand[t])
        is_pair &= is_tested[s] | is_tested[t]
        return s[is_pair], t[is_pair]


def _homogeneous(points: Sequence[tuple[float, float, float]]) -> Array:
    array = np.ones((len(points), 4))
    array[:, :3] = np.array(points).reshape(-1, 3)
    return array
