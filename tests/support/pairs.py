"""Random pairs of shapes, and oracles of their gaps without ssduck's own geometry.

Half of the pairs have sizes, places and turns from a few round numbers, so that edges are
parallel and faces meet: what distance algorithms get wrong.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, QhullError

from ssduck.geometry.distance import CallCounter, SignedDistance, signed_distance
from ssduck.geometry.mesh_distance import mesh_distance, mesh_penetration
from ssduck.geometry.placed_solid import PlacedSolid
from ssduck.geometry.proofs.contact_directions import NOT_UPWARD, UPWARD, decide_upward
from ssduck.geometry.proofs.cores import ConvexCores, PlacedCores
from ssduck.geometry.proofs.gjk import decide_gaps
from ssduck.geometry.proofs.verdicts import ABOVE, BELOW, UNDECIDED
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import SolidsOfShapes, solid_of

KINDS = (
    "sphere", "box", "cylinder", "capsule", "ellipsoid", "plane", "hull", "flat", "mesh", "open mesh",
)  # fmt: skip
COMBINATIONS = list(itertools.combinations_with_replacement(KINDS, 2))
TURNS = [
    (1, 0, 0, 0),
    (1, 1, 0, 0),
    (1, 0, 0, 1),
    (1, 1, 1, 1),
    (math.cos(0.3), 0, 0, math.sin(0.3)),
]
MESHES = ("mesh", "open mesh")
SIDES = 64
ROUND_POINT = 5e-3
# Of these the distances to other shapes are computed by steps that converge.
SWEPT = {"cylinder", "ellipsoid"}


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape at a pose."""

    kind: str
    geometry: Geometry
    position: np.ndarray
    quaternion: np.ndarray

    @property
    def matrix(self):
        w, x, y, z = self.quaternion
        rows = [[w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)]]
        rows += [[2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)]]
        rows += [[2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z]]
        return np.array(rows)

    def placed(self):
        return PlacedSolid(
            solid_of(self.geometry),
            tuple(map(float, self.position)),
            tuple(map(float, self.quaternion)),
        )

    def at(self, position, quaternion=None):
        turn = self.quaternion if quaternion is None else quaternion
        return Shape(self.kind, self.geometry, np.asarray(position, float), np.asarray(turn, float))


def geometry(kind, random, is_round):
    a, b, c = random.choice([0.25, 0.5, 1.0], 3) if is_round else random.uniform(0.05, 1.0, 3)
    match kind:
        case "sphere":
            return Geometry.primitive(kind, (a / 2, 0, 0))
        case "box":
            return Geometry.primitive(kind, (a, b, c))
        case "cylinder" | "capsule":
            return Geometry.primitive(kind, (a / 2, b, 0))
        case "ellipsoid":
            return Geometry.primitive(kind, (a / 2, b / 2, c / 2))
        case "plane":
            normal = (0, 0, 1) if is_round else random.normal(size=3)
            return Geometry.primitive(kind, normal / np.linalg.norm(normal))
        case "hull":
            count = int(random.integers(4, 30))
            return Geometry.hull(
                random.integers(-2, 3, (count, 3)) / 4
                if is_round
                else random.normal(size=(count, 3)) * 0.3
            )
        case "flat":
            points = (
                random.integers(-2, 3, (6, 3)) / 4 if is_round else random.normal(size=(6, 3)) * 0.3
            )
            points[:, 2] = 0
            return Geometry.hull(points)
        case "mesh":
            return ell(a, b, c)
    return Geometry("mesh", (0, 0, 0), patch_vertices(a, b, c), PATCH)


def ell(a, b, c):
    """Returns an L along y, with sides a by c: the hull of it is not it."""
    rim = np.array([[0, 0], [1, 0], [1, 0.5], [0.5, 0.5], [0.5, 1], [0, 1]]) - 0.5
    low = np.column_stack((rim[:, 0] * a, np.full(6, -b / 2), rim[:, 1] * c))
    vertices = np.concatenate((low, low + [0, b, 0]))
    caps = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    faces = caps + [(i + 6, k + 6, j + 6) for i, j, k in caps]
    for n in range(6):
        m = (n + 1) % 6
        faces += [(n, n + 6, m), (m, n + 6, m + 6)]
    return Geometry("mesh", (0, 0, 0), vertices, np.array(faces, np.int32))


PATCH = np.array(
    [(4, n, m) for n, m in ((0, 1), (1, 2), (2, 5), (5, 8), (8, 7), (7, 6), (6, 3), (3, 0))],
    np.int32,
)


def patch_vertices(a, b, c):
    """Returns nine points of a saddle."""
    grid = [(x, y) for x in (-0.5, 0, 0.5) for y in (-0.5, 0, 0.5)]
    return np.array([[x * a, y * b, x * y * c] for x, y in grid])


def pose(random, is_round):
    if is_round:
        turn = np.array(TURNS[random.integers(len(TURNS))], float)
        return random.integers(-4, 5, 3) / 4, turn / np.linalg.norm(turn)
    turn = random.normal(size=4)
    return random.uniform(-0.7, 0.7, 3), turn / np.linalg.norm(turn)


def pair(kinds, seed):
    """Returns two random shapes of some kinds."""
    random = np.random.default_rng(seed)
    is_round = bool(random.integers(2))
    return tuple(
        Shape(kind, geometry(kind, random, is_round), *pose(random, is_round)) for kind in kinds
    )


def gap(a, b, calls=None):
    """Returns ssduck's signed distance of two shapes."""
    one, other = a.placed(), b.placed()
    calls = calls or CallCounter()
    kinds = {one.solid.type, other.solid.type}
    if "mesh" in kinds and "plane" not in kinds:
        return mesh_distance(one, other, calls) or mesh_penetration(one, other, calls)
    return signed_distance(one, other, calls)


# -- many at once --------------------------------------------------------------------------


def bodies(shapes):
    """Places shapes for `decide_gaps`."""
    solids = [solid_of(one.geometry) for one in shapes]
    placed = [one.placed() for one in shapes]
    turns = np.array([one.matrix_rows for one in placed]).reshape(-1, 9).T
    places = list(zip(placed, solids, strict=True))
    centres = np.array([one.to_world(*s.centre) for one, s in places]).T
    inner = np.array([one.to_world(*s.inscribed_centre) for one, s in places]).T
    indices = np.arange(len(shapes))
    return PlacedCores(
        ConvexCores(SolidsOfShapes(solids, indices)),
        *map(np.ascontiguousarray, (turns, centres, inner)),
    )


def verdicts(shape_pairs, bound):
    """Returns the verdicts on pairs of shapes, as they are and swapped."""
    cores = bodies([shape for pair in shape_pairs for shape in pair])
    first = np.arange(0, 2 * len(shape_pairs), 2)
    return tuple(
        decide_gaps(cores, one, other, np.full(len(one), bound)).verdicts
        for one, other in ((first, first + 1), (first + 1, first))
    )


def wrong_verdicts(shape_pairs, gaps, bound):
    """Returns the indices of pairs of shapes whose verdicts contradict their gaps."""
    wrong = np.zeros(len(shape_pairs), bool)
    for result in verdicts(shape_pairs, bound):
        wrong |= ((result == BELOW) & (gaps >= bound)) | ((result == ABOVE) & (gaps <= bound))
    return np.flatnonzero(wrong).tolist()


def wrong_normals(shape_pairs, rises, min_height):
    """Returns the indices of pairs of which a verdict contradicts the z of their contact normals.

    And the number of undecided pairs; all are also compared swapped.
    """
    cores = bodies([shape for pair in shape_pairs for shape in pair])
    first = np.arange(0, 2 * len(shape_pairs), 2)
    wrong, undecided = np.zeros(len(shape_pairs), bool), 0
    for sign, one, other in ((1.0, first, first + 1), (-1.0, first + 1, first)):
        result = decide_upward(cores, one, other, min_height).verdicts
        wrong |= (result == UPWARD) & (sign * rises < min_height)
        wrong |= (result == NOT_UPWARD) & (sign * rises >= min_height)
        undecided += int((result == UNDECIDED).sum())
    return np.flatnonzero(wrong).tolist(), undecided


# -- oracles -------------------------------------------------------------------------------


def reach(shape, direction):
    """Returns the support function of a shape in a unit direction."""
    local = shape.matrix.T @ direction
    a, b, c = shape.geometry.size
    base = float(shape.position @ direction)
    match shape.geometry.type:
        case "sphere":
            return base + a
        case "box":
            return base + float(np.abs(local) @ (a, b, c)) / 2
        case "cylinder":
            return base + abs(local[2]) * b / 2 + a * math.hypot(local[0], local[1])
        case "capsule":
            return base + abs(local[2]) * b / 2 + a
        case "ellipsoid":
            return base + math.sqrt(float((local * (a, b, c)) @ (local * (a, b, c))))
        case "plane":
            return base if np.linalg.norm(local - shape.geometry.size) < 1e-7 else math.inf
    return base + float((shape.geometry.vertices @ local).max())


def corners(shape, sides=SIDES):
    """Returns points in the world and a radius: the shape is their hull, grown by the radius."""
    a, b, c = shape.geometry.size
    match shape.geometry.type:
        case "sphere":
            local, radius = np.zeros((1, 3)), a
        case "capsule":
            local, radius = np.array([[0, 0, -b / 2], [0, 0, b / 2]]), a
        case "cylinder":
            angles = np.arange(sides) * 2 * math.pi / sides
            ring = np.stack((np.cos(angles), np.sin(angles)), 1) * a
            local = np.column_stack((np.tile(ring, (2, 1)), np.repeat([-b / 2, b / 2], sides)))
            radius = 0.0
        case "ellipsoid":
            local, radius = spiral(sides**2 // 4) * (a, b, c), 0.0
        case "box":
            local = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * (a, b, c)
            radius = 0.0
        case _:
            local, radius = shape.geometry.vertices, 0.0
    return local @ shape.matrix.T + shape.position, radius


def spiral(count):
    """Returns points on the unit ball, evenly spread."""
    height, turn = 1 - (2 * np.arange(count) + 1) / count, np.arange(count) * 2.399963229728653
    return np.stack((np.cos(turn), np.sin(turn), height), 1) * np.stack(
        (np.sqrt(1 - height**2),) * 2 + (np.ones(count),), 1
    )


def is_in(shape, point, slack):
    """Checks whether a convex shape contains a point, with some slack."""
    x, y, z = shape.matrix.T @ (np.asarray(point) - shape.position)
    a, b, c = shape.geometry.size
    match shape.geometry.type:
        case "sphere":
            return math.hypot(x, y, z) <= a + slack
        case "box":
            return abs(x) <= a / 2 + slack and abs(y) <= b / 2 + slack and abs(z) <= c / 2 + slack
        case "cylinder":
            return math.hypot(x, y) <= a + slack and abs(z) <= b / 2 + slack
        case "capsule":
            return math.hypot(x, y, z - min(max(z, -b / 2), b / 2)) <= a + slack
        case "ellipsoid":
            return math.hypot(x / (a + slack), y / (b + slack), z / (c + slack)) <= 1
        case "plane":
            return float(np.dot((x, y, z), shape.geometry.size)) <= slack
    vertices = shape.geometry.vertices
    # A convex combination of corners that is the point up to the slack: a linear program.
    count = len(vertices)
    matrix = np.vstack((np.hstack((vertices.T, np.eye(3), -np.eye(3))), [1.0] * count + [0.0] * 6))
    cost = [0.0] * count + [1.0] * 6
    result = linprog(cost, A_eq=matrix, b_eq=(x, y, z, 1.0), bounds=(0, None), method="highs")
    return result.status == 0 and result.fun <= 3 * slack + 1e-7


def convex_error(a, b, result: SignedDistance):
    """Returns the deviation of a separation of convex shapes from proved bounds.

    Points in the shapes bound the distance from above, the direction bounds it from below; the
    direction bounds the depth from above, and the difference of all corners from below.
    """
    if result.normal is None:
        parallel = np.allclose(a.matrix @ a.geometry.size, -(b.matrix @ b.geometry.size), atol=1e-8)
        return math.inf if parallel or result.distance > -math.inf else 0.0
    normal = np.array(result.normal)
    error = max(abs(float(normal @ normal) - 1), _identity(result))
    error = max(error, abs(reach(b, normal) + reach(a, -normal) + result.distance))
    # Near its minimum the depth of a round side hardly changes: its points are less exact.
    slack = ROUND_POINT if result.distance < 1e-9 and {a.kind, b.kind} & SWEPT else 1e-5
    is_inside = is_in(a, result.point_a, slack) and is_in(b, result.point_b, slack)
    error = error if is_inside else math.inf
    if result.distance < 0 and "plane" not in (a.kind, b.kind):
        error = max(error, depth_error(a, b, result))
    return error


def depth_error(a, b, result):
    (p, r), (q, s) = corners(a, 48), corners(b, 48)
    core = -result.distance - r - s
    if core <= 0:
        return 0.0  # the cores are separate: proved like a distance
    depth = least_depth(p, q)
    if {a.kind, b.kind} & SWEPT:  # the depth of a polyhedron inside is a lower bound
        return max(0.0, depth - core) if depth >= 0.9 * core - 0.01 else math.inf
    return abs(depth - core)


def least_depth(p, q):
    """Returns the depth of the hulls of two sets of points, by that of their difference."""
    difference = (p[:, None] - q[None]).reshape(-1, 3)
    try:
        return max(0.0, float(-ConvexHull(difference).equations[:, 3].max()))
    except QhullError:
        return 0.0


def _identity(result):
    way = np.array(result.point_a) - result.point_b - result.distance * np.array(result.normal)
    return float(np.abs(way).max())


def triangles(shape):
    """Returns the triangles of a shape's core in the world, and the radius around them.

    ssduck cuts faces into triangles: the depths of crossing triangles depend on how.
    """
    surface = solid_of(shape.geometry).surface
    return surface.triangles @ shape.matrix.T + shape.position, corners(shape)[1]


def points_to_triangles(p, t):
    """Returns the distances of points (n, 3) from triangles (m, 3, 3), (n, m)."""
    best = np.full((len(p), len(t)), math.inf)
    for k in range(3):
        start, way = t[:, k], t[:, (k + 1) % 3] - t[:, k]
        square = np.maximum((way * way).sum(1), 1e-300)
        share = np.clip(np.einsum("nmi,mi->nm", p[:, None] - start, way) / square, 0, 1)
        off = p[:, None] - start - share[:, :, None] * way
        best = np.minimum(best, np.linalg.norm(off, axis=2))
    u, v = t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
    normal = np.cross(u, v)
    square = (normal * normal).sum(1)
    full = square > 1e-24
    below = np.where(full, square, 1.0)
    off = p[:, None] - t[:, 0]
    x = np.einsum("nmi,mi->nm", np.cross(off, v[None]), normal) / below
    y = np.einsum("nmi,mi->nm", np.cross(u[None], off), normal) / below
    height = np.abs(np.einsum("nmi,mi->nm", off, normal)) / np.sqrt(below)
    inside = (x >= 0) & (y >= 0) & (x + y <= 1) & full
    return np.where(inside, np.minimum(best, height), best)


def edges_to_edges(s, t):
    """Returns the least distance of the edges of triangles within both edges."""
    p, u = s.reshape(-1, 3), (np.roll(s, -1, 1) - s).reshape(-1, 3)
    q, v = t.reshape(-1, 3), (np.roll(t, -1, 1) - t).reshape(-1, 3)
    r = p[:, None] - q[None]
    a, e = (u * u).sum(1)[:, None], (v * v).sum(1)[None]
    b, c, f = u @ v.T, np.einsum("nmi,ni->nm", r, u), np.einsum("nmi,mi->nm", r, v)
    below = a * e - b * b
    sound = below > 1e-12 * a * e
    below = np.where(sound, below, 1.0)
    x, y = (b * f - c * e) / below, (a * f - b * c) / below
    inner = sound & (x > 0) & (x < 1) & (y > 0) & (y < 1)
    off = np.linalg.norm(r + x[:, :, None] * u[:, None] - y[:, :, None] * v[None], axis=2)
    return float(np.where(inner, off, math.inf).min())


def surface_distance(s, t):
    """Returns the least distance of triangles that do not cross."""
    ends = (
        points_to_triangles(s.reshape(-1, 3), t).min(),
        points_to_triangles(t.reshape(-1, 3), s).min(),
    )
    return min(*map(float, ends), edges_to_edges(s, t))


def crossings(s, t):
    """Returns the triangles (i, j) that cross: an edge of one goes through the other."""
    return set(_pierced(s, t)) | {(i, j) for j, i in _pierced(t, s)}


def _pierced(s, t):
    """Yields (i, j): an edge of triangle i of s goes through triangle j of t."""
    u, v = t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
    normal = np.cross(u, v)
    square = (normal * normal).sum(1)
    for k in range(3):
        start, way = s[:, k], s[:, (k + 1) % 3] - s[:, k]
        along = way @ normal.T
        off = start[:, None] - t[None, :, 0]
        height = np.einsum("nmi,mi->nm", off, normal)
        sound = (np.abs(along) > 1e-12) & (square > 1e-24)
        share = -height / np.where(sound, along, 1.0)
        at = off + share[:, :, None] * way[:, None]
        below = np.where(square > 1e-24, square, 1.0)
        x = np.einsum("nmi,mi->nm", np.cross(at, v[None]), normal) / below
        y = np.einsum("nmi,mi->nm", np.cross(u[None], at), normal) / below
        hit = sound & (share >= 0) & (share <= 1) & (x >= 0) & (y >= 0) & (x + y <= 1)
        yield from zip(*(index.tolist() for index in np.nonzero(hit)), strict=True)


_SKEW = np.array([0.5377, 0.2219, 0.8134])


def windings(points, triangles):
    """How often a surface winds around points: solid angles, van Oosterom and Strackee 1983."""
    to = triangles[None] - points[:, None, None]
    a, b, c = (to[:, :, k] for k in range(3))
    la, lb, lc = (np.linalg.norm(one, axis=2) for one in (a, b, c))
    above = (a * np.cross(b, c)).sum(2)
    ab, bc, ca = ((u * v).sum(2) for u, v in ((a, b), (b, c), (c, a)))
    below = la * lb * lc + ab * lc + bc * la + ca * lb
    return 2 * np.arctan2(above, below).sum(1) / (4 * math.pi)


def held(geometry, points):
    """Which points (…, 3) of its frame a convex shape, or the hull of a mesh, holds."""
    (x, y, z), (a, b, c) = np.moveaxis(points, -1, 0), geometry.size
    beyond = np.maximum(abs(z) - b / 2, 0)
    match geometry.type:
        case "sphere":
            return x**2 + y**2 + z**2 <= a**2
        case "box":
            return (abs(x) <= a / 2) & (abs(y) <= b / 2) & (abs(z) <= c / 2)
        case "cylinder":
            return (np.hypot(x, y) <= a) & (beyond == 0)
        case "capsule":
            return np.hypot(np.hypot(x, y), beyond) <= a
        case "ellipsoid":
            return (x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2 <= 1
        case "plane":
            return points @ geometry.size <= 0
    try:
        equations = ConvexHull(geometry.vertices).equations
    except QhullError:
        return np.zeros(points.shape[:-1], bool)
    return (points @ equations[:, :3].T <= -equations[:, 3]).all(-1)


def enclosed(points, t):
    """Returns which points (n, 3) a closed surface encloses: a ray crosses it an odd number of times."""
    rays = np.stack((points, points + 50 * _SKEW, points + 50 * _SKEW), 1)
    hits = np.zeros(len(points), int)
    for i, _ in set(_pierced(rays, t)):
        hits[i] += 1
    return hits % 2 == 1


def is_solid(shape):
    return shape.kind in ("box", "hull", "cylinder", "ellipsoid", "mesh")


def mesh_error(a, b, result: SignedDistance):
    """Returns the deviation of a separation from a mesh from that of all its triangles."""
    (s, r), (t, q) = triangles(a), triangles(b)
    error = max(_identity(result), abs(float(np.dot(result.normal, result.normal)) - 1))
    crossed = crossings(s, t)
    depths = []
    for x, y, z in ((a, s, t), (b, t, s)):
        other = b if x is a else a
        if is_solid(other):
            points = y.reshape(-1, 3)
            points = points[enclosed(points, z)]
            if len(points):
                depths.append(float(points_to_triangles(points, z).min(1).max()))
    if not crossed and not depths:
        return max(error, abs(surface_distance(s, t) - r - q - result.distance))
    depths += [least_depth(s[i], t[j]) for i, j in crossed]
    return max(error, abs(max(depths) + r + q + result.distance))


def error_of(a, b):
    """Returns the error of ssduck's result, and the result."""
    result = gap(a, b)
    if {a.kind, b.kind} & set(MESHES) and "plane" not in (a.kind, b.kind):
        return mesh_error(a, b, result), result
    if {a.kind, b.kind} & set(MESHES):
        normal = np.array(result.normal)
        return abs(reach(b, normal) + reach(a, -normal) + result.distance), result
    return convex_error(a, b, result), result


def moved(shape, shift, turn):
    """Returns a shape turned about the origin and shifted."""
    turner = Shape(shape.kind, shape.geometry, shift, turn)
    w, (x, y, z) = turn[0], turn[1:]
    s, u = shape.quaternion[0], shape.quaternion[1:]
    product = np.array(
        [w * s - np.dot((x, y, z), u), *(w * u + s * turn[1:] + np.cross(turn[1:], u))]
    )
    return shape.at(turner.matrix @ shape.position + shift, product)
