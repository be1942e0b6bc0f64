"""Makes the random scenes of `benchmarks.pairs`; measures nothing itself.

A random scene has the size at which the axis-aligned box of a body meets `NEIGHBOURS` others on
average. Bisection finds the side for each scene: a small scene has a larger share of its bodies at
the border, and is denser. A scene of 10,000 bodies takes some seconds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import pybullet
from scipy.spatial.transform import Rotation

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.broad_phase import overlapping_pairs

NEIGHBOURS = 7.0
# The number of different shapes of each kind, which the bodies share.
PIECES = 32
KINDS = {
    "boxes": ("box",),
    "hulls": ("hull",),
    "mixed": ("sphere", "capsule", "box", "cylinder", "hull"),
}
FORMS = ("cube", "table-top")
# Between two ticks a body moves by so many metres and turns by so many radians: at 240 Hz, 0.5 m/s
# and 2 rad/s. After half a period it moves back.
STEP, TURN = 2e-3, 8e-3
PERIOD = 8
# Each body in a direction of its own, or all by the same vector, metres, whose parts are exact.
MOTIONS = ("apart", "together")
_SHIFT = np.array([0.25, 0.125, 0.0])
# The share of the bodies on a table-top that stand on another one.
STACKED = 0.25
_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_AXES = np.concatenate((np.eye(3), -np.eye(3)))


@dataclass(frozen=True, eq=False)
class Piece:
    """A convex shape: the hull of points, grown by a ball or by a disc across z.

    Attributes:
        kind: box, sphere, capsule, cylinder or hull.
        size: the half-extents of a box, the radius (and length) of a round shape.
        points: (n, 3), m.
        ball: the radius of the ball, m.
        disc: the radius of the disc, m.
        input_points: the points of a hull from which PyBullet computes `points`.
    """

    kind: str
    size: tuple[float, ...]
    points: Array
    ball: float = 0.0
    disc: float = 0.0
    input_points: Array | None = None

    def farthest(self, directions: Array) -> Array:
        """Returns the points of the shape that are farthest in unit directions, both (n, 3)."""
        result: Array = (
            self.points[np.argmax(directions @ self.points.T, axis=1)] + self.ball * directions
        )
        if self.disc:
            across = directions * (1.0, 1.0, 0.0)
            length = np.linalg.norm(across, axis=1, keepdims=True)
            result = result + self.disc * across / np.where(length > 0.0, length, 1.0)
        return result


@dataclass(frozen=True, eq=False)
class RandomScene:
    """A random scene of bodies with one shape each.

    Attributes:
        pieces: the different shapes.
        of: (n,), the index of each body's shape.
        positions: (n, 3), metres.
        orientations: (n, 4), unit quaternions x, y, z, w.
        met: (m, 2), pairs of bodies whose boxes meet.
        motion: one of `MOTIONS`.
    """

    pieces: Sequence[Piece]
    of: Indices
    positions: Array
    orientations: Array
    met: Indices
    motion: str = "apart"

    def __len__(self) -> int:
        return len(self.of)

    @property
    def neighbours(self) -> float:
        """The mean number of boxes that the box of a body meets."""
        return 2.0 * len(self.met) / len(self)

    def at(self, tick: int) -> RandomScene:
        """Returns the scene at a tick: the bodies move to and fro."""
        steps = min(tick % PERIOD, -tick % PERIOD)
        if self.motion == "together":
            return replace(self, positions=self.positions + _SHIFT * steps)
        rng = np.random.default_rng(len(self))
        ways, axes = (_unit(rng.normal(size=(len(self), 3))) for _ in range(2))
        turns = Rotation.from_rotvec(axes * (TURN * steps)) * Rotation.from_quat(self.orientations)
        return replace(
            self, positions=self.positions + ways * (STEP * steps), orientations=turns.as_quat()
        )

    def piece(self, body: int) -> Piece:
        """Returns the shape of a body."""
        return self.pieces[int(self.of[body])]

    def matrix(self, body: int) -> Array:
        """Returns the rotation matrix of a body."""
        result: Array = Rotation.from_quat(self.orientations[body]).as_matrix()
        return result


# -- shapes -------------------------------------------------------------------------------------


def _pieces(kinds: Sequence[str], rng: np.random.Generator) -> list[Piece]:
    client = pybullet.connect(pybullet.DIRECT)
    try:
        return [_piece(kind, rng, client) for kind in kinds for _ in range(PIECES)]
    finally:
        pybullet.disconnect(client)


def _piece(kind: str, rng: np.random.Generator, client: int) -> Piece:
    """Returns a shape of random size, 6 to 24 cm across."""
    a, b, c = map(float, rng.uniform(0.03, 0.12, 3))
    axis = np.array([[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]])
    match kind:
        case "box":
            return Piece(kind, (a, b, c), _CORNERS * (a, b, c))
        case "sphere":
            return Piece(kind, (a,), np.zeros((1, 3)), ball=a)
        case "capsule":
            return Piece(kind, (a / 2, b), axis * b, ball=a / 2)
        case "cylinder":
            return Piece(kind, (a, 2 * b), axis * 2 * b, disc=a)
    points = _scattered(rng) * (a, b, c)
    return Piece("hull", (), _pybullet_corners(points, client), input_points=points)


def _scattered(rng: np.random.Generator) -> Array:
    """Returns 8 to 40 random points on a sphere."""
    return _unit(rng.normal(size=(int(rng.integers(8, 41)), 3)))


def _unit(vectors: Array) -> Array:
    result: Array = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return result


def _pybullet_corners(points: Array, client: int) -> Array:
    """Returns the corners of PyBullet's hull of points, which are rounded.

    PyBullet rounds to a 10,000th of the size, and would round the corners again.
    """
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_MESH, vertices=points.tolist(), physicsClientId=client
    )
    body = pybullet.createMultiBody(1, shape, physicsClientId=client)
    return np.array(pybullet.getMeshData(body, -1, physicsClientId=client)[1])


def _shape(piece: Piece, client: int) -> int:
    """Creates a shape in PyBullet."""
    size = piece.size
    match piece.kind:
        case "box":
            settings = {"shapeType": pybullet.GEOM_BOX, "halfExtents": size}
        case "sphere":
            settings = {"shapeType": pybullet.GEOM_SPHERE, "radius": size[0]}
        case "capsule":
            settings = {"shapeType": pybullet.GEOM_CAPSULE, "radius": size[0], "height": size[1]}
        case "cylinder":
            settings = {"shapeType": pybullet.GEOM_CYLINDER, "radius": size[0], "height": size[1]}
        case _:
            assert piece.input_points is not None
            points = piece.input_points.tolist()
            settings = {"shapeType": pybullet.GEOM_MESH, "vertices": points}
    number: int = pybullet.createCollisionShape(**settings, physicsClientId=client)
    return number


@contextmanager
def bodies_of(scene: RandomScene) -> Iterator[tuple[int, list[int]]]:
    """Yields a client with the bodies of a scene, and their numbers in PyBullet."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        shapes = [_shape(piece, client) for piece in scene.pieces]
        places = zip(
            scene.of.tolist(), scene.positions.tolist(), scene.orientations.tolist(), strict=True
        )
        yield (
            client,
            [
                pybullet.createMultiBody(
                    1.0,
                    shapes[piece],
                    basePosition=position,
                    baseOrientation=orientation,
                    physicsClientId=client,
                )
                for piece, position, orientation in places
            ],
        )
    finally:
        pybullet.disconnect(client)


# -- scenes -------------------------------------------------------------------------------------


def random_scene(form: str, kind: str, count: int, seed: int = 0) -> RandomScene:
    """Returns a random scene in one of `FORMS`, of one of `KINDS`."""
    rng = np.random.default_rng([seed, count, FORMS.index(form), list(KINDS).index(kind)])
    pieces = _pieces(KINDS[kind], rng)
    of = rng.integers(len(pieces), size=count)
    turns = Rotation.random(count, rng) if form == "cube" else _flat_turns(count, rng)
    boxes = _boxes(pieces, of, turns)
    places = rng.uniform(-0.5, 0.5, (count, 3))
    if form == "cube":
        positions = _spread(boxes, places, np.zeros((count, 3)))
    else:
        places, offsets = _stacked(boxes, places, rng)
        positions = _spread(boxes, places, offsets)
    met = np.sort(np.column_stack(overlapping_pairs(boxes + np.tile(positions.T, (2, 1)))), axis=1)
    return RandomScene(pieces, of, positions, turns.as_quat(), met)


def _flat_turns(count: int, rng: np.random.Generator) -> Rotation:
    """Returns rotations onto one of four sides and about z; half of them by quarter turns."""
    sides: Array = rng.integers(4, size=count).astype(np.float64)
    upright = Rotation.from_rotvec(_along(0, sides * 0.5 * np.pi))
    quarters: Array = rng.uniform(0.0, 4.0, count)
    aligned = rng.random(count) < 0.5
    quarters[aligned] = np.round(quarters[aligned])
    return Rotation.from_rotvec(_along(2, quarters * 0.5 * np.pi)) * upright


def _along(axis: int, angles: Array) -> Array:
    """Returns rotation vectors along an axis."""
    vectors = np.zeros((len(angles), 3))
    vectors[:, axis] = angles
    return vectors


def _boxes(pieces: Sequence[Piece], of: Indices, turns: Rotation) -> Array:
    """Returns the boxes around the bodies at the origin, (6, n)."""
    corners = [
        np.einsum("ij,ij->i", _AXES, pieces[piece].farthest(_AXES @ turn) @ turn.T)
        for piece, turn in zip(of.tolist(), turns.as_matrix(), strict=True)
    ]
    extents = np.array(corners).T
    return np.concatenate((-extents[3:], extents[:3]))


def _stacked(boxes: Array, places: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Returns places on the ground and offsets: some bodies stand on another one."""
    count = len(places)
    upper = int(count * STACKED)
    lower = rng.permutation(np.arange(upper, count))[:upper]
    places = places * (1.0, 1.0, 0.0)
    places[:upper] = places[lower]
    offsets = np.zeros((count, 3))
    offsets[:, 2] = -boxes[2]
    offsets[:upper, 2] += boxes[5, lower] - boxes[2, lower]
    offsets[:upper, :2] = rng.uniform(-0.02, 0.02, (upper, 2))
    return places, offsets


def _spread(boxes: Array, places: Array, offsets: Array) -> Array:
    """Returns positions `places * side + offsets` with the desired number of neighbours."""
    low, high = 0.0, 2.0 * float((boxes[3:] - boxes[:3]).max()) * len(places)
    for _ in range(40):
        side = (low + high) / 2
        result = overlapping_pairs(boxes + np.tile((places * side + offsets).T, (2, 1)))[0]
        if 2 * len(result) > NEIGHBOURS * len(places):
            low = side
        else:
            high = side
        if high - low < 1e-4 * high:
            break
    positions: Array = places * high + offsets
    return positions
