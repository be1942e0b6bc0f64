"""The narrow phase against oracles, at its edges, and with all that FCL does wrong."""

from __future__ import annotations

import itertools
import math
from concurrent.futures import ThreadPoolExecutor

import fcl
import numpy as np
import pybullet
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, QhullError

from ssduck.geometry import broad_phase, surfaces
from ssduck.geometry import common_volume as volumes
from ssduck.geometry import containment as overlap
from ssduck.geometry.containment import fraction_inside, world_hull
from ssduck.geometry.distance import CallCounter
from ssduck.geometry.mesh_distance import triangle_depths
from ssduck.geometry.narrow_phase import NarrowPhase
from ssduck.geometry.placed_solid import PlacedSolid
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import solid_of
from ssduck.geometry.surfaces import Surface
from tests.support import pairs
from tests.support.cases import sampled
from tests.support.pairs import Shape, ell
from tests.support.solids import STRAIGHT, box, capsule, cylinder, mesh_of, narrow, plane, sphere

ORIGIN = (0.0, 0.0, 0.0)


def floor(size=2.0, cells=4):
    """An open mesh: a square of the ground."""
    axis = np.linspace(-size / 2, size / 2, cells + 1)
    vertices = np.array([[x, y, 0] for x in axis for y in axis])
    faces = []
    for i, j in itertools.product(range(cells), repeat=2):
        n = i * (cells + 1) + j
        faces += [[n, n + cells + 1, n + 1], [n + 1, n + cells + 1, n + cells + 2]]
    return Geometry("mesh", (0, 0, 0), vertices, np.array(faces, np.int32))


def shape(geometry, position=ORIGIN, turn=STRAIGHT):
    turn = np.array(turn, float)
    return Shape(geometry.type, geometry, np.array(position, float), turn / np.linalg.norm(turn))


def gap(a, b, at=ORIGIN, turn=STRAIGHT):
    """The gap of one geometry at a place over another at the origin."""
    return pairs.gap(shape(a, at, turn), shape(b)).distance


def two(a, b, at=ORIGIN, turn=STRAIGHT):
    """Entity 0 at the origin, entity 1 at a place."""
    return narrow([(a, ORIGIN)], [(b, at, turn)])


# -- against oracles -----------------------------------------------------------------------


@pytest.mark.parametrize("kinds", pairs.COMBINATIONS, ids=" ".join)
def test_a_gap_is_what_the_oracle_says(kinds):
    bound = 1e-6 if "cylinder" in kinds else 1e-9
    for seed in range(10):
        error, found = pairs.error_of(*pairs.pair(kinds, seed))
        assert error <= bound, (seed, found)


@given(kinds=st.sampled_from(pairs.COMBINATIONS), seed=st.integers(0, 2**32))
@settings(max_examples=150)
def test_a_gap_is_symmetric(kinds, seed):
    a, b = pairs.pair(kinds, seed)
    one, other = pairs.gap(a, b), pairs.gap(b, a)
    assert one.distance == pytest.approx(other.distance, abs=2e-7)


@given(
    kinds=st.sampled_from(pairs.COMBINATIONS),
    seed=st.integers(0, 2**32),
    shift=st.tuples(*[st.floats(-5, 5)] * 3),
    turn=st.tuples(st.floats(0.1, 1), *[st.floats(-1, 1)] * 3),
)
@settings(max_examples=150)
def test_a_gap_stays_if_the_world_moves(kinds, seed, shift, turn):
    a, b = pairs.pair(kinds, seed)
    turn = np.array(turn) / np.linalg.norm(turn)
    moved = [pairs.moved(one, np.array(shift), turn) for one in (a, b)]
    assert pairs.gap(*moved).distance == pytest.approx(pairs.gap(a, b).distance, abs=2e-7)


@given(
    kinds=st.sampled_from(pairs.COMBINATIONS),
    seed=st.integers(0, 2**32),
    bounds=st.lists(st.floats(0, 3), min_size=2),
)
@settings(max_examples=80)
def test_what_is_near_is_near_for_more(kinds, seed, bounds):
    a, b = pairs.pair(kinds, seed)
    places = [[(one.geometry, one.position, one.quaternion)] for one in (a, b)]
    exact = narrow(*places).clearance(0, 1)
    tick = narrow(*places)
    for bound in bounds:
        found = tick.clearance(0, 1, limit=bound)
        assert found == (exact if exact <= bound else math.inf)


FCL = {
    "sphere": lambda size: fcl.Sphere(size[0]),
    "box": lambda size: fcl.Box(*size),
    "capsule": lambda size: fcl.Capsule(size[0], size[1]),
}


@pytest.mark.parametrize(
    "kinds", list(itertools.combinations_with_replacement(FCL, 2)), ids=" ".join
)
def test_formulas_agree_with_fcl(kinds):
    """Where nothing is parallel FCL's GJK is right, up to its tolerance."""
    random = np.random.default_rng(0)
    for _ in range(100):
        a, b = (
            Shape(k, pairs.geometry(k, random, is_round=False), *pairs.pose(random, is_round=False))
            for k in kinds
        )
        objects = [
            fcl.CollisionObject(
                FCL[one.kind](one.geometry.size), fcl.Transform(one.quaternion, one.position)
            )
            for one in (a, b)
        ]
        distance = fcl.distance(*objects, fcl.DistanceRequest(), fcl.DistanceResult())
        found = pairs.gap(a, b).distance
        assert max(0.0, found) == pytest.approx(max(0.0, distance), abs=2e-3)


@pytest.mark.parametrize(
    "kinds",
    [("box", "box"), ("sphere", "cylinder"), ("capsule", "box"), ("cylinder", "cylinder")],
    ids=" ".join,
)
def test_gaps_agree_with_pybullet(client, kinds):
    """Whose margins are up to 1 mm for each box and cylinder."""

    def body(one):
        a, b, _ = one.geometry.size
        halves = [length / 2 for length in one.geometry.size]
        number = getattr(pybullet, f"GEOM_{one.kind.upper()}")
        made = pybullet.createCollisionShape(
            number, radius=a, height=b, halfExtents=halves, physicsClientId=client
        )
        turn = np.roll(one.quaternion, -1)
        return pybullet.createMultiBody(
            0, made, basePosition=one.position, baseOrientation=turn, physicsClientId=client
        )

    random = np.random.default_rng(1)
    compared = 0
    for _ in range(60):
        a, b = (
            Shape(k, pairs.geometry(k, random, is_round=False), *pairs.pose(random, is_round=False))
            for k in kinds
        )
        found = pairs.gap(a, b).distance
        if found > 0.01:
            bodies = body(a), body(b)
            points = pybullet.getClosestPoints(*bodies, 10.0, physicsClientId=client)
            assert found == pytest.approx(min(point[8] for point in points), abs=3e-3)
            compared += 1
    assert compared > 5


# -- boundaries ----------------------------------------------------------------------------

# A shape that reaches 0.5 below its origin, and one whose top is at height 0.
OVER = {
    "box": box(),
    "sphere": sphere(),
    "cylinder": cylinder(),
    "capsule": capsule(0.25, 0.5),
    "hull": Geometry.hull([[0, 0, -0.5], [1, 0, 0], [0, 1, 0], [-1, -1, 0]]),
    "mesh": ell(1.0, 1.0, 1.0),
}
UNDER = {
    "plane": (plane(), ORIGIN),
    "box": (box(4, 4, 1), (0.1, 0.2, -0.5)),
    "floor": (box(200, 200, 10), (3.0, -7.0, -5.0)),
    "cylinder": (cylinder(3.0, 2.0), (0.1, 0.2, -1.0)),
    "hull": (Geometry.hull(solid_of(box(4, 4, 2)).core), (0.1, 0.2, -1.0)),
    "closed mesh": (mesh_of(box(4, 4, 2)), (0.1, 0.2, -1.0)),
    "ell": (ell(8.0, 4.0, 2.0), (2.0, 0.0, -1.0)),
    "open mesh": (floor(4.0), (0.1, 0.2, 0.0)),
}


@pytest.mark.parametrize("under", UNDER)
@pytest.mark.parametrize("over", OVER)
@pytest.mark.parametrize(
    "height", [0.3, 1e-3, 1e-5, 2e-6, 1e-7, 0.0, -1e-7, -0.9e-6, -1.1e-6, -1e-4, -1e-2]
)
def test_at_the_surface(over, under, height):
    """The clearance, the depth, and colliding from 1e-6 m on."""
    geometry, at = UNDER[under]
    tick = narrow([(geometry, at)], [(OVER[over], (0.0, 0.0, 0.5 + height))])
    assert tick.clearance(0, 1) == pytest.approx(max(0.0, height), abs=3e-9)
    assert tick.penetration(0, 1) == pytest.approx(max(0.0, -height), abs=2e-8)
    assert tick.collides(0, 1) is (height < -1e-6)
    for within in (0.0, abs(height) - 1e-8, abs(height) + 1e-8):
        expected = max(0.0, height) <= within
        if abs(max(0.0, height) - within) > 5e-9:
            assert (tick.clearance(0, 1, limit=within) <= within) is expected
    normal = tick.signed_distance(1, 0).normal
    assert normal == pytest.approx((0, 0, 1), abs=1e-4)


@pytest.mark.parametrize(("a", "b"), list(itertools.combinations_with_replacement(OVER, 2)))
def test_the_same_place_and_parallel_edges(a, b):
    """FCL ends the process on such a pair of cylinders, and is off by metres on boxes."""
    for x, y, z in itertools.product((0.0, 0.5, 1.0, 1.5), repeat=3):
        found = pairs.gap(shape(OVER[a], (x, y, z)), shape(OVER[b]))
        if a == b == "box":
            outside = [max(0.0, c - 1.0) for c in (x, y, z)]
            expected = math.hypot(*outside) if any(outside) else max(x, y, z) - 1.0
            assert found.distance == pytest.approx(expected, abs=1e-9)
        assert math.isfinite(found.distance)
        way = np.array(found.point_a) - found.point_b
        assert way == pytest.approx(found.distance * np.array(found.normal), abs=1e-9)


# -- what FCL does wrong -------------------------------------------------------------------


@pytest.mark.parametrize("over", OVER)
def test_half_spaces_are_solid_and_endless(over):
    tick = two(plane(), OVER[over], (1000.0, -2000.0, -50.0))
    assert tick.collides(0, 1)
    assert tick.penetration(0, 1) == pytest.approx(50.5)
    assert tick.clearance(0, 1) == 0.0
    assert tick.calls.calls == 0


def test_a_hardly_tilted_plane_is_not_its_box():
    slope = 3e-5
    tick = narrow([(plane((slope, 0, 1)), ORIGIN)], [(sphere(0.01), (-1000.0, 0.0, 0.02))])
    assert tick.collides(0, 1)


# (normals and positions of two half-spaces, gap)
HALF_SPACES = [
    ((0, 0, 1), (0, 0, 0), (0, 0, -1), (5, 0, 1), 1.0),
    ((0, 0, 1), (0, 0, 0), (0, 0, -1), (5, 0, 0), 0.0),
    ((0, 0, 1), (0, 0, 0), (0, 0, -1), (5, 0, -2), -2.0),
    ((0, 0, 1), (0, 0, 0), (0, 0, 1), (0, 0, 7), -math.inf),
    ((0, 0, 1), (0, 0, 0), (1, 0, 0), (9, 0, 7), -math.inf),
]


@pytest.mark.parametrize(("n", "p", "m", "q", "expected"), HALF_SPACES)
def test_two_half_spaces(n, p, m, q, expected):
    found = pairs.gap(shape(plane(n), p), shape(plane(m), q))
    assert found.distance == expected
    for point in (found.point_a, found.point_b):
        assert np.isfinite(point).all()
    if found.normal is None:
        assert np.dot(np.subtract(found.point_a, p), n) <= 1e-9
        assert np.dot(np.subtract(found.point_b, q), m) <= 1e-9


@pytest.mark.parametrize("number", [math.nan, math.inf])
@pytest.mark.parametrize("over", [*OVER, "plane"])
def test_a_pose_that_is_no_number_is_unknown(over, number):
    geometry = OVER.get(over, plane())
    for pose in (
        ((0.0, number, 0.0), STRAIGHT),
        (ORIGIN, (1.0, number, 0.0, 0.0)),
        (ORIGIN, (0.0, 0.0, 0.0, 0.0)),
    ):
        tick = narrow([(box(), ORIGIN)], [(geometry, *pose)])
        told = [
            tick.collides(0, 1),
            tick.clearance(0, 1),
            tick.penetration(1, 0),
            tick.nearest_points(0, 1),
        ]
        told += [
            tick.on(0, 1),
            tick.inside(0, 1),
            tick.inside(1, 0),
            tick.contains(0, 1),
            tick.solid_volume(1),
        ]
        assert told == [None] * 9


NO_SHAPES = [
    sphere(-1.0),
    sphere(math.nan),
    box(1, math.inf, 1),
    plane((0, 0, 0)),
    Geometry.hull([[0, 0, math.nan], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    Geometry("mesh", (0, 0, 0), np.eye(3), np.array([[0, 1, 3]], np.int32)),
    Geometry("mesh", (0, 0, 0), np.eye(3), np.array([[0, 1, -1]], np.int32)),
]


@pytest.mark.parametrize("geometry", NO_SHAPES, ids=lambda one: one.type)
def test_numbers_that_make_no_shape_are_unknown(geometry):
    solid = solid_of(geometry)
    boxes = np.array([[-1.0] * 3 + [1.0] * 3] * 2)
    tick = NarrowPhase(
        [solid, solid_of(box())],
        np.arange(2),
        np.zeros((2, 3)),
        np.tile(STRAIGHT, (2, 1)),
        boxes,
        [0, 1, 2],
        CallCounter(),
    )
    assert tick.collides(0, 1) is None
    assert tick.clearance(1, 0) is None
    assert tick.inside(0, 1) is None


@pytest.mark.parametrize(
    "geometry",
    [
        Geometry.hull(np.zeros((0, 3))),
        Geometry("mesh", (0, 0, 0), np.zeros((0, 3)), np.zeros((0, 3), np.int32)),
    ],
)
def test_what_has_no_points_meets_nothing(geometry):
    tick = narrow([(geometry, ORIGIN)], [(box(), ORIGIN)], [])
    for empty in (0, 2):
        assert tick.collides(empty, 1) is False
        assert tick.clearance(1, empty) is None
        assert tick.penetration(empty, 1) == 0.0
        assert tick.nearest_points(empty, 1) is None
        assert tick.on(1, empty) is False
        assert tick.inside(1, empty) is None
        assert tick.inside(empty, 1) == 0.0
        assert tick.solid_volume(empty) == 0.0


# (corners of a hull without an inside, gap to a unit box 2 above)
THIN = [
    ([[0, 0, 0]], 1.5),
    ([[0, 0, 0]] * 9, 1.5),
    ([[0, 0, 0], [0, 0, 1]], 0.5),
    ([[0, 0, 0], [1, 1, 1], [0.5, 0.5, 0.5]], math.sqrt(2 / 3)),
    ([[0, 0, 1], [1, 0, 1], [0, 1, 1]], 0.5),
    ([[-1, -1, 1.5], [1, -1, 1.5], [1, 1, 1.5], [-1, 1, 1.5], [0, 0, 1.5]], 0.0),
    ([[0, 0, 1.6], [1, 0, 1.6], [0, 1, 1.6]], -0.1),
    ([[0, 0, 1.6]], -0.1),
    ([[-1, 0, 1.6], [1, 0, 1.6]], -0.1),
]


@pytest.mark.parametrize(("corners", "expected"), THIN)
def test_thin_hulls(corners, expected):
    assert gap(box(), Geometry.hull(corners), (0, 0, 2)) == pytest.approx(expected, abs=1e-9)


def test_quaternions_need_not_have_length_one():
    turn = np.array([1.0, 0.0, 0.0, 1.0])
    for scale in (1e-3, 1.0, 7.0):
        tick = two(box(), box(4, 1, 1), (0, 0, 2), scale * turn)
        assert tick.clearance(0, 1) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "small",
    [
        box(0.1, 0.1, 0.1),
        sphere(0.05),
        cylinder(0.05, 0.1),
        capsule(0.03, 0.05),
        ell(0.1, 0.1, 0.1),
    ],
)
@pytest.mark.parametrize("inverted", [False, True])
def test_a_closed_mesh_is_solid(small, inverted):
    big = ell(2.0, 2.0, 2.0)
    if inverted:
        big = Geometry("mesh", (0, 0, 0), big.vertices, np.ascontiguousarray(big.faces[:, ::-1]))
    tick = two(big, small, (-0.5, 0.0, -0.5))
    assert tick.collides(0, 1)
    assert tick.clearance(0, 1) == 0.0
    assert 0.4 < tick.penetration(1, 0) < 0.6
    hollow = two(big, small, (0.5, 0.0, 0.5))
    assert hollow.clearance(0, 1) == pytest.approx(0.45, abs=0.01)
    assert not hollow.collides(0, 1)


def test_a_closed_mesh_inside_a_convex_shape_meets_it():
    for big in (box(3, 3, 3), sphere(2), cylinder(2, 3), capsule(2, 1), ell(9, 9, 9)):
        at = (-2.0, 0.0, -2.0) if big.type == "mesh" else ORIGIN
        tick = two(big, ell(0.5, 0.5, 0.5), at)
        assert tick.collides(0, 1), big.type
        assert tick.clearance(0, 1) == 0.0


def test_faces_that_do_not_agree_are_turned():
    whole = ell(1.0, 1.0, 1.0)
    faces = whole.faces.copy()
    faces[::3] = faces[::3, ::-1]
    solid = solid_of(Geometry("mesh", (0, 0, 0), whole.vertices, faces))
    assert solid.is_closed
    assert solid.volume == pytest.approx(0.75)


def test_copies_of_vertices_do_not_open_a_mesh():
    whole = ell(1.0, 1.0, 1.0)
    apart = Geometry(
        "mesh",
        (0, 0, 0),
        whole.vertices[whole.faces].reshape(-1, 3),
        np.arange(60, dtype=np.int32).reshape(-1, 3),
    )
    assert solid_of(apart).is_closed
    assert not solid_of(Geometry("mesh", (0, 0, 0), whole.vertices, whole.faces[1:])).is_closed


def test_a_convex_closed_mesh_is_a_hull():
    assert solid_of(mesh_of(box())).type == "hull"
    assert solid_of(mesh_of(box(), inverted=True)).volume == pytest.approx(1.0)


def test_a_mesh_with_faces_without_an_area():
    whole = ell(1.0, 1.0, 1.0)
    faces = np.concatenate((whole.faces, [[0, 0, 1], [2, 2, 2]])).astype(np.int32)
    solid = solid_of(Geometry("mesh", (0, 0, 0), whole.vertices, faces))
    assert solid.is_closed
    flat = Geometry(
        "mesh",
        (0, 0, 0),
        np.array([[0, 0, 0], [1, 0, 0], [2.0, 0, 0]]),
        np.array([[0, 1, 2]], np.int32),
    )
    assert gap(sphere(0.5), flat, (1, 0, 2)) == pytest.approx(1.5)


def test_an_open_mesh_is_a_surface():
    assert gap(sphere(0.1), floor(), (0, 0, -0.3)) == pytest.approx(0.2)
    assert two(floor(), sphere(0.1), (0, 0, 0.05)).collides(0, 1)


def test_nearest_points_of_a_sphere_and_a_mesh_are_in_the_world():
    tick = narrow(
        [(ell(1, 1, 1), (5, 6, 7), (1, 1, 0, 0))], [(sphere(0.5), (5, 6, 9), (0.3, 1, 0, 0))]
    )
    p, q = tick.nearest_points(0, 1)
    assert p == pytest.approx((5, 6, 7.5), abs=0.51)
    assert p[2] == pytest.approx(7.5)
    assert math.dist(q, (5, 6, 9)) == pytest.approx(0.5)
    assert math.dist(p, q) == pytest.approx(tick.clearance(0, 1))


def windings(points, triangles):
    """How often a surface winds around points: solid angles, van Oosterom and Strackee 1983."""
    to = triangles[None] - points[:, None, None]
    a, b, c = (to[:, :, k] for k in range(3))
    la, lb, lc = (np.linalg.norm(one, axis=2) for one in (a, b, c))
    above = (a * np.cross(b, c)).sum(2)
    ab, bc, ca = ((u * v).sum(2) for u, v in ((a, b), (b, c), (c, a)))
    below = la * lb * lc + ab * lc + bc * la + ca * lb
    return 2 * np.arctan2(above, below).sum(1) / (4 * math.pi)


def meshes():
    """Closed ones that are not convex; the last has two parts, one inside the other."""
    torus = trimesh.creation.torus(1.0, 0.4, major_sections=12, minor_sections=6)
    inner = frame(1.8, 1.2, 0.5)
    outer = frame()
    faces = np.concatenate((outer.faces, inner.faces[:, ::-1] + len(outer.vertices)))
    shell = Geometry("mesh", (0, 0, 0), np.concatenate((outer.vertices, inner.vertices)), faces)
    return [ell(1.0, 2.0, 1.0), frame(), of_trimesh(torus), shell]


@pytest.mark.parametrize("grid", [True, False])
def test_what_a_mesh_encloses(grid):
    """Points over its corners and edges too, and in the planes of its faces."""
    random = np.random.default_rng(3)
    for geometry in meshes():
        surface = solid_of(geometry).fine_surface
        points = random.integers(-16, 17, (1500, 3)) / 16
        if not grid:
            points = surface.vertices[random.integers(0, len(surface.vertices), (300, 4))]
            points = (points * random.dirichlet(np.ones(4), 300)[:, :, None]).sum(1)
            points = np.concatenate((points, points * [1, 1, 0] - [0, 0, 2], points[:, ::-1]))
        off = pairs.points_to_triangles(points, surface.triangles).min(1) > 1e-9
        around = windings(points[off], surface.triangles)
        assert 0 < (around > 0.5).sum() < len(around)
        for turn in (np.eye(3), shape(box(), turn=(1, 0.2, 0.3, 0.4)).matrix):
            turned = Surface(surface.vertices @ turn.T, surface.faces)
            assert (turned.encloses(points[off] @ turn.T) == (around > 0.5)).all()


@pytest.mark.parametrize("seed", range(40))
def test_the_depth_of_meshes_is_that_of_all_corners_and_triangles(seed):
    random = np.random.default_rng(seed)
    a, b = (
        shape(meshes()[random.integers(4)], random.uniform(-0.5, 0.5, 3), random.normal(size=4))
        for _ in range(2)
    )
    (s, _), (t, _) = pairs.triangles(a), pairs.triangles(b)
    depths = []
    for corners, other in ((s.reshape(-1, 3), t), (t.reshape(-1, 3), s)):
        inside = corners[windings(corners, other) > 0.5]
        depths += pairs.points_to_triangles(inside, other).min(1).tolist()
    i, j = np.array(sorted(pairs.crossings(s, t))).reshape(-1, 2).T
    depths += triangle_depths(s[i], t[j])[0].tolist()
    assert depths
    assert pairs.gap(a, b).distance == pytest.approx(-max(depths), abs=1e-9)


def test_many_corners_that_are_as_deep():
    slab = trimesh.creation.box((1, 1, 0.2))
    for _ in range(4):
        slab = slab.subdivide()
    dent = np.linalg.norm(slab.vertices - [0.5, 0.5, 0.1], axis=1) < 1e-6
    slab.vertices[dent] *= 0.99
    tick = two(ell(4, 4, 4), of_trimesh(slab), (-0.5, 0, -1.1))
    assert tick.penetration(0, 1) == pytest.approx(1.0, abs=1e-9)
    assert tick.calls.calls < len(slab.vertices)


def test_few_corners_and_triangles_of_deep_meshes_are_looked_at(monkeypatch):
    looked = []
    turns = surfaces._winding_signs
    monkeypatch.setattr(
        surfaces,
        "_winding_signs",
        lambda triangles: (looked.append(len(triangles)), turns(triangles))[1],
    )
    for count in (16, 64):
        torus = of_trimesh(trimesh.creation.torus(1.0, 0.3, 2 * count, count))
        corners = len(torus.vertices)
        looked.clear()
        tick = two(torus, torus, (0.5, 0.2, 0.1))
        assert tick.penetration(0, 1) == pytest.approx(0.29, abs=0.02)
        assert tick.calls.calls < 300
        assert sum(looked) < 30 * corners
        assert max(looked) <= 2 * broad_phase.PAIRS_AT_ONCE


def test_an_answer_does_not_depend_on_the_one_before():
    near, far = (box(), (0, 0, 1.2)), (box(), (0, 0, 3.0))
    tick = narrow([(box(), ORIGIN)], [near], [far])
    assert tick.clearance(0, 1) == pytest.approx(0.2)
    assert tick.clearance(0, 2) == pytest.approx(2.0)


# -- a tick --------------------------------------------------------------------------------


def test_spheres_tell_without_fcl():
    tick = narrow([(box(), ORIGIN)], [(box(), (0.2, 0, 0))], [(ell(1, 1, 1), (9, 9, 9))])
    assert tick.collides(0, 1)
    assert tick.clearance(0, 1) == 0.0
    assert not tick.collides(0, 2)
    assert tick.clearance(0, 2, limit=5.0) == math.inf
    assert tick.calls.calls == 0


def test_a_pair_is_asked_once_a_tick():
    tick = two(box(), box(), (0.3, 0.2, 1.2))
    for _ in range(3):
        assert tick.clearance(0, 1) == tick.clearance(1, 0) == pytest.approx(0.2)
        assert tick.nearest_points(0, 1) == tick.nearest_points(1, 0)[::-1]
        assert not tick.collides(1, 0)
        assert tick.penetration(0, 1) == 0.0
        assert tick.on(0, 1) is False
    assert tick.calls.calls == 1


def test_only_the_closest_shapes_are_asked():
    arm = [(box(0.1, 0.1, 0.9), (0, 0, z)) for z in range(10)]
    tick = narrow(arm, [(box(0.1, 0.1, 0.1), (0.5, 0.02, 0))])
    assert tick.clearance(0, 1) == pytest.approx(0.4)
    assert tick.calls.calls <= 2
    assert tick.clearance(0, 1, limit=0.1) == math.inf
    assert tick.clearance(1, 0, limit=0.4 + 1e-9) == pytest.approx(0.4)


def test_an_entity_is_all_its_shapes():
    table = [(box(2, 2, 0.1), (0, 0, 1)), (box(0.1, 0.1, 1), (0.9, 0.9, 0.5))]
    tick = narrow(table, [(sphere(0.1), (0, 0, 0.8))], [(sphere(0.1), (0.8, 0.9, 0.5))])
    assert tick.clearance(0, 1) == pytest.approx(0.05)
    assert tick.penetration(0, 2) == pytest.approx(0.05)
    assert tick.collides(2, 0)
    assert tick.solid_volume(0) == pytest.approx(0.41)


def test_an_entity_and_itself():
    tick = two(box(), box())
    assert tick.collides(0, 0) is False
    assert tick.clearance(0, 0) == 0.0
    assert tick.penetration(0, 0) == 0.0
    assert tick.on(0, 0) is False
    assert tick.nearest_points(0, 0) is None


def test_many_entities_as_one_by_one():
    random = np.random.default_rng(5)
    kinds = ["sphere", "box", "hull", "cylinder", "mesh"]
    shapes = [
        Shape(
            k,
            pairs.geometry(k, random, is_round=False),
            random.uniform(-1, 1, 3),
            pairs.pose(random, is_round=False)[1],
        )
        for k in kinds * 4
    ]
    tick = narrow(*([(one.geometry, one.position, one.quaternion)] for one in shapes))
    for i, j in itertools.combinations(range(len(shapes)), 2):
        alone = pairs.gap(shapes[i], shapes[j]).distance
        assert tick.collides(j, i) is (alone < -1e-6)
        assert tick.clearance(i, j) == pytest.approx(max(0.0, alone), abs=1e-7)


def test_threads_get_the_same():
    random = np.random.default_rng(6)
    places = [
        [(pairs.geometry("hull", random, is_round=False), random.uniform(-1, 1, 3))]
        for _ in range(12)
    ]
    every = list(itertools.combinations(range(12), 2))
    alone, together = narrow(*places), narrow(*places)
    expected = [alone.clearance(i, j) for i, j in every]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda pair: together.clearance(*pair), every * 3)) == expected * 3
    assert together.calls.calls == alone.calls.calls


# -- on, inside ----------------------------------------------------------------------------

TABLE = [(box(2, 1, 0.1), (0, 0, 0.95)), (box(0.1, 0.1, 0.9), (0.9, 0.4, 0.45))]

# (what, where, turn, whether it is on the table)
ON = [
    (box(0.2, 0.2, 0.2), (0, 0, 1.1), STRAIGHT, True),
    (box(0.2, 0.2, 0.2), (0, 0, 1.1009), STRAIGHT, True),
    (box(0.2, 0.2, 0.2), (0, 0, 1.1011), STRAIGHT, False),
    (box(0.2, 0.2, 0.2), (0, 0, 1.098), STRAIGHT, True),
    (box(0.2, 0.2, 0.2), (0.999, 0, 1.1), STRAIGHT, True),
    (box(0.2, 0.2, 0.2), (1.001, 0, 1.1), STRAIGHT, False),
    (box(0.2, 0.2, 0.2), (0, 0, 0.7), STRAIGHT, False),
    (box(0.2, 0.2, 0.2), (1.1, 0, 0.95), STRAIGHT, False),
    (sphere(0.1), (0.3, 0.2, 1.1), STRAIGHT, True),
    (cylinder(0.1, 0.2), (0.3, 0.2, 1.1), (1, 0, 0, 0.3), True),
    (cylinder(0.1, 0.2), (0.3, 0.2, 1.1), (1, 1, 0, 0), True),
    (capsule(0.1, 0.2), (0.3, 0.2, 1.2), STRAIGHT, True),
    (ell(0.2, 0.2, 0.2), (0.3, 0.2, 1.1), STRAIGHT, True),
]


@pytest.mark.parametrize(("what", "at", "turn", "expected"), ON)
def test_on(what, at, turn, expected):
    tick = narrow(TABLE, [(what, at, turn)])
    assert tick.on(0, 1) is expected
    assert tick.on(1, 0) is False


@pytest.mark.parametrize(
    ("degrees", "expected"), [(0, True), (29.9, True), (30.1, False), (80, False)]
)
@pytest.mark.parametrize("under", [plane(), box(9, 9, 9)])
def test_on_a_slope(degrees, expected, under):
    tilt = (math.cos(math.radians(degrees) / 2), math.sin(math.radians(degrees) / 2), 0, 0)
    normal = np.array([0, -math.sin(math.radians(degrees)), math.cos(math.radians(degrees))])
    top = 0.0 if under.type == "plane" else 4.5
    tick = narrow([(under, ORIGIN, tilt)], [(sphere(0.1), normal * (top + 0.1))])
    assert tick.on(0, 1) is expected


def test_on_the_ground():
    tick = narrow(
        [(plane(), ORIGIN)], [(box(), (50, 60, 0.5))], [(floor(), ORIGIN)], [(box(), (0, 0, 0.5))]
    )
    assert tick.on(0, 1) is True
    assert tick.on(2, 3) is True
    assert tick.on(1, 0) is False
    wall = narrow([(plane((1, 0, 0)), ORIGIN)], [(box(), (0.5, 0, 0))])
    assert wall.on(0, 1) is False


def test_what_is_not_over_another_is_not_on_it_however_deep():
    tick = two(ell(4, 4, 4), ell(4, 4, 4), (1.9, 2.01, -1))
    assert tick.on(0, 1) is False
    assert tick.calls.calls == 0
    assert tick.penetration(0, 1) > 0.0


def test_on_a_thin_shelf():
    rail = Geometry.hull([[-1, 0, 0], [1, 0, 0]])
    tick = narrow(
        [(rail, ORIGIN)], [(sphere(0.1), (0.5, 0, 0.1))], [(sphere(0.1), (0.5, 0.001, 0.1))]
    )
    assert tick.on(0, 1) is True
    assert tick.on(0, 2) is False


def frame(outer=2.0, inner=1.0, height=1.0):
    """A closed mesh: a square board with a square hole in it."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    rims = [(size, z) for z in (-height / 2, height / 2) for size in (outer, inner)]
    vertices = np.concatenate([np.column_stack((size * corners, [z] * 4)) for size, z in rims])
    faces = []
    for m in range(4):
        n = (m + 1) % 4
        out, hole, up, hole_up = ((m + k, n + k) for k in (0, 4, 8, 12))
        for (p, q), (r, t) in ((out, up), (hole_up, hole), (hole, out), (up, hole_up)):
            faces += [[p, q, t], [p, t, r]]
    return Geometry("mesh", (0, 0, 0), vertices, np.array(faces, np.int32))


def of_trimesh(mesh):
    return Geometry("mesh", (0, 0, 0), np.array(mesh.vertices), np.array(mesh.faces, np.int32))


CRATE = solid_of(box(2, 2, 2))
BOWL = Geometry("mesh", (0, 0, 0), CRATE.core, CRATE.faces[:-2])
# (a, b, where b is, share of b in a's hull)
INSIDE = [
    (box(2, 2, 2), box(), ORIGIN, 1.0),
    (box(2, 2, 2), box(), (0.5, 0.5, 0.5), 1.0),
    (box(2, 2, 2), box(), (1, 0, 0), 0.5),
    (box(2, 2, 2), box(), (1, 1, 1), 0.125),
    (box(2, 2, 2), box(), (1.5, 0, 0), 0.0),
    (box(2, 2, 2), box(), (7, 0, 0), 0.0),
    (box(), box(2, 2, 2), ORIGIN, 0.125),
    (box(2, 2, 2), ell(1, 1, 1), (1, 0, 0), 2 / 3),
    (box(2, 2, 2), ell(1, 1, 1), (0, 0, 0), 1.0),
    (ell(2, 2, 2), box(0.1, 0.1, 0.1), (0.2, 0, -0.2), 1.0),
    (BOWL, box(), (0, 0, 0.5), 1.0),
    (box(4, 4, 4), BOWL, (1, 0, 0), None),
    (plane(), box(), (0, 0, 0.25), 0.25),
    (plane(), box(), (0, 0, 0.5), 0.0),
    (box(), plane(), ORIGIN, 0.0),
    (box(), floor(), ORIGIN, None),
    (floor(), box(), ORIGIN, 0.0),
    (box(), Geometry.hull([[0, 0, 0], [1, 1, 1]]), ORIGIN, None),
    # a hole does not count, but is in the hull
    (box(), frame(), ORIGIN, 0.0),
    (box(0.5, 0.5, 9), frame(), ORIGIN, 0.0),
    (box(1, 2, 1), frame(), ORIGIN, 1 / 3),
    (box(9, 0.25, 9), frame(), ORIGIN, 1 / 12),
    (box(2, 2, 1), frame(), ORIGIN, 1.0),
    (box(2, 2, 1), frame(), (0, 0, 0.5), 0.5),
    (box(2, 2, 1), frame(), (1, 1, 0), 0.25),
    (ell(2, 2, 2), frame(), (0, 0, 0.5), 17 / 24),
    (plane(), frame(), (0, 0, 0.25), 0.25),
    (plane((1, 1, 0)), frame(), ORIGIN, 0.5),
    (frame(), box(), ORIGIN, 1.0),
    (frame(), frame(), (1, 0, 0), 0.5),
    (frame(), frame(4.0, 1.0), ORIGIN, 0.2),
    (frame(), box(), (1, 1, 0), 0.25),
    # one cut by many faces; one that has the other in it
    (sphere(9.0), box(0.1, 0.1, 0.1), (0, 5, 0), 1.0),
    (box(0.1, 0.1, 0.1), frame(), (0.75, 0, 0), 1e-3 / 3),
    (box(1e-4, 1e-4, 1e-4), box(4, 4, 4), (0.5, 0.3, 0.1), 1e-12 / 64),
    # thin ones
    (box(), box(2, 2, 1e-6), ORIGIN, 0.25),
    (box(1, 1, 1e-6), box(), ORIGIN, 1e-6),
]


@pytest.mark.parametrize(("a", "b", "at", "expected"), INSIDE)
def test_inside(a, b, at, expected):
    found = two(a, b, at).inside(0, 1)
    assert found == (expected if expected is None else pytest.approx(expected, abs=1e-9))


# (how far a unit box is moved along x in one of side 2, its share: exactly where it is 0 or 1)
SIDEWAYS = [
    (0.5 - 1e-6, 1.0),
    (0.5, 1.0),
    (0.5 + 9e-10, 1.0),
    (0.5 + 2e-9, 1 - 2e-9),
    (0.5 + 1e-6, 1 - 1e-6),
    (1.5 - 1e-6, 1e-6),
    (1.5 - 2e-9, 2e-9),
    (1.5 - 9e-10, 0.0),
    (1.5, 0.0),
    (1.5 + 1e-6, 0.0),
]


@pytest.mark.parametrize("b", [box(), mesh_of(box()), Geometry.hull(solid_of(box()).core)])
@pytest.mark.parametrize(("along", "share"), SIDEWAYS)
def test_inside_at_the_edges(along, share, b):
    found = two(box(2, 2, 2), b, (along, 0, 0)).inside(0, 1)
    assert found == (share if share in (0.0, 1.0) else pytest.approx(share, abs=1e-12))


# (how high a wall is over the middle of something of radius 0.5, the share below the wall)
WALLS = [(0.5 + 1e-6, 1.0), (0.5, 1.0), (0.5 - 9e-10, 1.0), (9e-10 - 0.5, 0.0), (-0.5, 0.0)]


@pytest.mark.parametrize("b", [sphere(), cylinder(), capsule()])
@pytest.mark.parametrize(("height", "share"), WALLS)
def test_round_shapes_that_touch_a_wall_are_exact(height, share, b):
    for way in (np.array([1.0, 0.0, 0.0]), np.array([0.6, 0.8, 0.0])):
        assert narrow([(plane(way), height * way)], [(b, ORIGIN)]).inside(0, 1) == share
        # The hull of a half-space and of a ball on the other side of the wall.
        raised = [(plane(way), -9 * way), (sphere(2.0), (height - 2) * way)]
        assert narrow(raised, [(b, ORIGIN)]).inside(0, 1) == share


def test_inside_of_several_shapes():
    """Each of b counts; of a there is one hull."""
    posts = [(box(0.5, 0.5, 1), (x, y, 0)) for x in (-0.75, 0.75) for y in (-0.75, 0.75)]
    row = [(box(), (x, 0, 0)) for x in (0, 1, 5)]
    assert narrow(posts, row).inside(0, 1) == pytest.approx(1.5 / 3)
    assert narrow(posts, [*row, (floor(), ORIGIN)]).inside(0, 1) == pytest.approx(1.5 / 3)
    # an open mesh has no volume, however small the rest is
    speck = (box(1e-3, 1e-3, 1e-3), ORIGIN)
    assert narrow(posts, [(BOWL, (9, 0, 0))]).inside(0, 1) is None
    assert narrow(posts, [(BOWL, (9, 0, 0)), speck]).inside(0, 1) == 1.0
    assert narrow(posts, [(box(), (1, 0, 0))] * 2).inside(0, 1) == pytest.approx(0.5)
    beams = [(box(1, 1.5, 1), (x, 0, 0)) for x in (0, 1)]
    assert narrow(beams, posts).inside(0, 1) == pytest.approx(0.25)


def cap(height):
    """The share of a ball of radius 1 below that height of a cut."""
    return (2 + 3 * height - height**3) / 4


# (a, b, where b is, share of b in a's hull): round ones
ROUND_INSIDE = [
    (plane(), sphere(1.0), (0, 0, 0.0), cap(0.0)),
    (plane(), sphere(1.0), (0, 0, 0.3), cap(-0.3)),
    (plane(), sphere(1.0), (0, 0, -0.9), cap(0.9)),
    (box(4, 4, 4), sphere(1.0), (2, 2, 2), 0.125),
    (box(4, 4, 4), cylinder(1.0, 2.0), (2, 0, 2), 0.25),
    (box(4, 4, 4), capsule(0.5, 2.0), (0, 0, 2), 0.5),
    (sphere(1.0), box(2, 2, 2), ORIGIN, math.pi / 6),
    (cylinder(1.0, 2.0), box(2, 2, 2), ORIGIN, math.pi / 4),
    (sphere(1.0), sphere(0.5), (0.4, 0.2, 0.1), 1.0),
    (sphere(0.5), sphere(1.0), ORIGIN, 0.125),
]


@pytest.mark.parametrize(("a", "b", "at", "expected"), ROUND_INSIDE)
def test_inside_of_round_shapes(a, b, at, expected):
    assert two(a, b, at).inside(0, 1) == pytest.approx(expected, abs=0.005)


@pytest.mark.parametrize("radius", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("overlap", [0.05, 0.3, 0.7])
def test_the_share_of_a_ball_in_a_ball(radius, overlap):
    """The volume of a lens: Weisstein, Sphere-Sphere Intersection."""
    d = 1 + radius - 2 * min(1, radius) * overlap
    around = d * d + 2 * d * (1 + radius) - 3 * (1 - radius) ** 2
    lens = math.pi * (1 + radius - d) ** 2 * around / (12 * d)
    found = two(sphere(1.0), sphere(radius), (0.6 * d, 0, 0.8 * d)).inside(0, 1)
    assert found == pytest.approx(lens / (4 / 3 * math.pi * radius**3), abs=3e-4)


def test_parts_of_a_mesh_that_overlap_count_each():
    middles = np.array([[0.0, 0.0, 0.0], [0.5, 0.3, 0.2], [0.3, 0.5, 0.4]])
    cubes = [trimesh.creation.box((1, 1, 1)).apply_translation(at) for at in middles]
    at = np.array([0.31, 0.22, 0.13])
    found = two(box(), of_trimesh(trimesh.util.concatenate(cubes)), tuple(-at)).inside(0, 1)
    expected = np.prod(1.0 - np.abs(middles - at), axis=1).sum() / 3
    assert found == pytest.approx(expected, abs=1e-12)


def share(a, b):
    return fraction_inside(world_hull([a.placed()]), [b.placed()])


def held(one, points, *, whole=False):
    """Which points (n, 3) are in a shape, or, if it is to be whole, in its hull."""
    local = (points - one.position) @ one.matrix
    (x, y, z), (a, b, c) = local.T, one.geometry.size
    beyond = np.maximum(np.abs(z) - b / 2, 0)
    match one.geometry.type:
        case "sphere":
            return np.linalg.norm(local, axis=1) <= a
        case "box":
            return (np.abs(local) <= np.array([a, b, c]) / 2).all(1)
        case "cylinder":
            return (np.hypot(x, y) <= a) & (beyond == 0)
        case "capsule":
            return np.hypot(np.hypot(x, y), beyond) <= a
        case "plane":
            return local @ one.geometry.size <= 0
    if one.kind == "mesh" and not whole:
        return pairs.enclosed(local, one.geometry.vertices[one.geometry.faces])
    try:
        equations = ConvexHull(one.geometry.vertices).equations
    except QhullError:
        return np.zeros(len(points), bool)
    return (local @ equations[:, :3].T <= -equations[:, 3]).all(1)


@sampled("kinds", list(itertools.product(pairs.KINDS, pairs.KINDS)), every=5, ids=" ".join)
def test_shares_as_by_counting_points(kinds):
    """Of points at random 0.07 is about four deviations of a share, 0.02 of the mean of ten."""
    random = np.random.default_rng(7)
    off = []
    for seed in range(10):
        a, b = pairs.pair(kinds, seed)
        corners = pairs.corners(b)[0] if b.kind != "plane" else np.zeros((1, 3))
        low, high = corners.min(0) - 0.5, corners.max(0) + 0.5
        if b.kind not in ("sphere", "capsule"):
            low, high = low + 0.5, high - 0.5
        points = random.uniform(low, high, (3000, 3))
        points = points[held(b, points)]
        found = share(a, b)
        if b.kind in ("plane", "flat", "open mesh"):
            assert found == (0.0 if b.kind == "plane" else None)
            continue
        off.append(found - held(a, points, whole=True).mean())
    assert np.abs(off).max(initial=0.0) <= 0.07
    assert abs(sum(off)) <= 0.2


SOLID_KINDS = [kind for kind in pairs.KINDS if kind not in ("plane", "flat", "open mesh")]
SEEDS = st.integers(0, 2**32)


@given(
    a=st.sampled_from(pairs.KINDS),
    b=st.sampled_from(SOLID_KINDS),
    seed=SEEDS,
    shift=st.tuples(*[st.floats(-1e3, 1e3)] * 3),
    turn=st.tuples(st.floats(0.1, 1), *[st.floats(-1, 1)] * 3),
)
@settings(max_examples=100)
def test_a_share_stays_if_the_world_moves(a, b, seed, shift, turn):
    both = pairs.pair((a, b), seed)
    turn = np.array(turn) / np.linalg.norm(turn)
    found = share(*both)
    assert 0.0 <= found <= 1.0
    assert share(*(pairs.moved(one, np.array(shift), turn) for one in both)) == pytest.approx(
        found, abs=1e-8
    )


@given(a=st.sampled_from(pairs.KINDS), seed=SEEDS, at=st.floats(0.01, 0.99))
@settings(max_examples=100)
def test_shares_of_the_parts_of_a_box_add_up(a, seed, at):
    hull, b = pairs.pair((a, "box"), seed)
    (x, y, z), along = b.geometry.size, b.matrix[:, 0]
    parts = [(at, at / 2 - 0.5), (1 - at, at / 2)]
    shares = [
        share(
            hull, Shape("box", box(x * part, y, z), b.position + x * middle * along, b.quaternion)
        )
        for part, middle in parts
    ]
    whole = sum(part * found for (part, _), found in zip(parts, shares, strict=True))
    assert share(hull, b) == pytest.approx(whole, abs=1e-8 / min(x, y, z))


@given(a=st.sampled_from(["box", "hull"]), b=st.sampled_from(["box", "hull"]), seed=SEEDS)
@settings(max_examples=100)
def test_what_two_share_is_in_either(a, b, seed):
    a, b = pairs.pair((a, b), seed)
    volumes = [solid_of(one.geometry).volume for one in (a, b)]
    if min(volumes) > 0.0:
        common = share(a, b) * volumes[1], share(b, a) * volumes[0]
        assert common[0] == pytest.approx(common[1], abs=1e-8)


@given(b=st.sampled_from(SOLID_KINDS), seed=SEEDS)
@settings(max_examples=100)
def test_half_spaces_share_all(b, seed):
    ground, b = pairs.pair(("plane", b), seed)
    sky = Shape("plane", plane(-np.array(ground.geometry.size)), ground.position, ground.quaternion)
    assert share(ground, b) + share(sky, b) == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize("size", [1e-7, 1e6, 1e9])
@pytest.mark.parametrize("kind", ["box", "sphere", "capsule", "cylinder", "mesh"])
def test_shares_do_not_depend_on_the_unit_of_length(kind, size):
    def found(unit):
        a = {
            "box": box(unit, unit, unit),
            "sphere": sphere(unit),
            "capsule": capsule(unit, unit),
            "cylinder": cylinder(unit, unit),
            "mesh": ell(unit, unit, unit),
        }[kind]
        at, turn = np.array([0.3, 0.1, 0.2]) * unit, np.array([1, 0.2, 0.3, 0.4])
        b = shape(ell(unit, unit, unit), at, turn)
        return share(shape(a), b), share(b, shape(a)), share(shape(plane()), shape(a, at, turn))

    assert found(size) == pytest.approx(found(1.0), abs=1e-6)


def contained(*entities):
    """Whether the first contains the second, asked before the share is known."""
    found = narrow(*entities).contains(0, 1)
    inside = narrow(*entities).inside(0, 1)
    assert found is (inside is not None and inside >= 0.95)
    return found


def larger(one, factor):
    """A shape that many times as large."""
    geometry = one.geometry
    size = geometry.size if one.kind == "plane" else tuple(factor * np.array(geometry.size))
    grown = Geometry(geometry.type, size, factor * geometry.vertices, geometry.faces)
    return Shape(one.kind, grown, one.position, one.quaternion)


@sampled("kinds", list(itertools.product(pairs.KINDS, pairs.KINDS)), every=5, ids=" ".join)
def test_what_is_contained_has_as_large_a_share(kinds):
    for seed, factor in itertools.product(range(3), (1.0, 2.0, 4.0)):
        a, b = pairs.pair(kinds, seed)
        a = larger(a, factor)
        contained(*([(one.geometry, one.position, one.quaternion)] for one in (a, b)))


# What sticks out of something that is 1 from its middle, along +x.
STICKS_OUT = [0.05 - 1e-9, 0.05 + 1e-9, 0.05 - 1e-4, 0.05 + 1e-4, 0.03, 0.06, 0.13, 0.14, 0.3]


@sampled("out", STICKS_OUT, every=4)
def test_what_is_contained_at_the_edges(out):
    around = (box(2, 2, 2), cylinder(1.0, 2.0), plane((1, 0, 0)))
    for b in (box(), sphere(), capsule(0.5, 1e-3), cylinder(), ell(1, 1, 1)):
        for a, turn in itertools.product(around, (STRAIGHT, (1, 0, 0.3, 0))):
            contained([(a, ORIGIN)], [(b, (0.5 + out, 0, 0), turn)])
    assert contained([(box(2, 2, 2), ORIGIN)], [(box(), (0.5 + out, 0, 0))]) is (out < 0.05)


def test_small_and_many_shapes_that_are_contained():
    tiny = (box(1e-9, 1, 1), (1 + 4e-10, 0, 0))
    assert contained([(box(2, 2, 2), ORIGIN)], [tiny])
    assert not contained([(box(2, 2, 2), ORIGIN)], [(box(1e-9, 1, 1), (1 + 3e-9, 0, 0))])
    posts = [(box(0.1, 0.1, 1), (x, y, 0)) for x in (-1, 1) for y in (-1, 1)]
    assert contained(posts, [(box(), (0.5, 0.5, 0))])
    assert contained(posts, [(box(0.2, 0.2, 0.2), (x, 0, 0)) for x in (-0.9, 0, 0.9)])
    assert not contained(posts, [(box(0.2, 0.2, 0.2), (x, 0, 0)) for x in (-0.9, 0, 0.9, 1.1)])
    assert not contained(posts, [(floor(0.1), ORIGIN)])
    assert contained(posts, [(floor(9.0), ORIGIN), (box(), ORIGIN)])
    assert not contained([(floor(), ORIGIN)], [(box(), ORIGIN)])
    assert not contained([(Geometry.hull(np.zeros((0, 3))), ORIGIN)], [(box(), ORIGIN)])
    ground = [(plane(), ORIGIN), (box(2, 2, 2), ORIGIN)]
    assert contained(ground, [(sphere(), (90, 0, 0.5))])
    assert not contained(ground, [(sphere(), (90, 0, 0.7))])
    assert not contained(ground, [(plane(), ORIGIN)])
    assert contained([*ground, (plane((1, 0, 0)), ORIGIN)], [(plane(), ORIGIN)])


@pytest.mark.slow
def test_few_shares_tell_what_is_contained(monkeypatch):
    cut, volume = [], overlap._volume_inside
    monkeypatch.setattr(
        overlap, "_volume_inside", lambda hull, some: (cut.append(some), volume(hull, some))[1]
    )
    random = np.random.default_rng(9)
    boxes = [
        [(box(*random.uniform(0.3, 1.0, 3)), random.uniform(0, 3.5, 3), random.normal(size=4))]
        for _ in range(100)
    ]
    tick, slow = narrow(*boxes), narrow(*boxes)
    every = list(itertools.permutations(range(100), 2))
    found = [tick.contains(i, j) for i, j in every]
    fast = len(cut)
    assert found == [slow.inside(i, j) >= 0.95 for i, j in every]
    assert 0 < 10 * fast < len(cut) - fast


@pytest.mark.slow
def test_large_meshes_are_compared_where_they_meet(monkeypatch):
    """Neither all pairs of their triangles, nor many at a time; the shares are of round ones."""
    torus = of_trimesh(trimesh.creation.torus(1.0, 0.4, major_sections=100, minor_sections=50))
    ball = of_trimesh(trimesh.creation.icosphere(subdivisions=4, radius=0.7))
    kept, cut = [], volumes._heights_below
    monkeypatch.setattr(
        volumes, "_heights_below", lambda *some: (kept.append(len(some[0])), cut(*some))[1]
    )
    for a, b, expected in (
        (ball, torus, 0.213),
        (torus, ball, 0.635),
        (torus, box(), 0.702),
        (box(), torus, 0.168),
        (sphere(0.7), torus, 0.213),
        (torus, sphere(0.7), 0.635),
        (sphere(0.7), sphere(0.7), 0.164),
    ):
        kept.clear()
        assert two(a, b, (0.9, 0.1, 0.05)).inside(0, 1) == pytest.approx(expected, abs=3e-3)
        count = sum(len(solid_of(one).closed_surface.faces) for one in (a, b))
        assert sum(kept) <= 12 * count
        assert max(kept) <= 2 * broad_phase.PAIRS_AT_ONCE


def test_hulls_of_half_spaces():
    ground = PlacedSolid(solid_of(plane()), ORIGIN, STRAIGHT)
    wall = PlacedSolid(solid_of(plane((1, 0, 0))), ORIGIN, STRAIGHT)
    block = PlacedSolid(solid_of(box()), (0.0, 0.0, 0.5), STRAIGHT)
    high = PlacedSolid(solid_of(box()), (9.0, 9.0, 1.0), STRAIGHT)
    assert fraction_inside(world_hull([ground, block]), [high]) == pytest.approx(0.5)
    assert fraction_inside(world_hull([ground, wall]), [high]) == 1.0
    assert fraction_inside(world_hull([ground, wall]), [ground]) == 1.0


# (shape, its volume)
VOLUMES = [
    (box(1, 2, 3), 6.0),
    (sphere(0.5), math.pi / 6),
    (cylinder(0.5, 2.0), math.pi / 2),
    (capsule(0.5, 2.0), math.pi / 2 + math.pi / 6),
    (ell(1, 2, 1), 1.5),
    (mesh_of(box(1, 2, 3)), 6.0),
    (Geometry.hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), 1 / 6),
    (floor(), 0.0),
    (plane(), math.inf),
]


@pytest.mark.parametrize(("geometry", "expected"), VOLUMES)
def test_volumes(geometry, expected):
    assert narrow([(geometry, (1, 2, 3), (1, 1, 0, 0))]).solid_volume(0) == pytest.approx(expected)


def test_solids_are_built_once_for_equal_contents():
    assert solid_of(box(1, 2, 3)) is solid_of(box(1, 2, 3))
    assert solid_of(box(1, 2, 3)) is not solid_of(box(1, 2, 4))


def test_the_deepest_points_of_cylinders_whose_best_direction_is_a_kink():
    """A millionth of a radian off it, both ends of a side are not quite as deep."""
    a, b = pairs.pair(("cylinder", "cylinder"), 20001661)
    assert pairs.error_of(a, b)[0] < 1e-6
