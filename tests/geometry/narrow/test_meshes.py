"""Pairs that FCL alone decides wrongly."""

import math

import numpy as np
import pytest
import trimesh

from ssduck.geometry.distance import CallCounter
from ssduck.geometry.mesh_distance import triangle_depths
from ssduck.geometry.narrow_phase import NarrowPhase
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import solid_of
from ssduck.geometry.surfaces import Surface
from ssduck.geometry.tick_shapes import ShapeTable
from ssduck.geometry.tick_solids import ShapePlaces
from tests.support import pairs
from tests.support.narrow_cases import ORIGIN, OVER, floor, frame, of_trimesh, shape, two
from tests.support.pairs import ell
from tests.support.solids import STRAIGHT, box, capsule, cylinder, mesh_of, narrow, plane, sphere


def gap(a, b, at=ORIGIN, turn=STRAIGHT):
    """The gap of one geometry at a place over another at the origin."""
    return pairs.gap(shape(a, at, turn), shape(b)).distance


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
        ShapeTable([solid, solid_of(box())], np.arange(2), np.arange(2)),
        ShapePlaces(np.zeros((2, 3)), np.tile(STRAIGHT, (2, 1)), boxes),
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


def meshes():
    """Closed ones that are not convex; the last has two parts, one inside the other."""
    torus = trimesh.creation.torus(1.0, 0.4, major_sections=12, minor_sections=6)
    inner = frame(1.8, 1.2, 0.5)
    outer = frame()
    faces = np.concatenate((outer.faces, inner.faces[:, ::-1] + len(outer.vertices)))
    shell = Geometry("mesh", (0, 0, 0), np.concatenate((outer.vertices, inner.vertices)), faces)
    return [ell(1.0, 2.0, 1.0), frame(), of_trimesh(torus), shell]


@pytest.mark.slow
@pytest.mark.parametrize("grid", [True, False])
def test_what_a_mesh_encloses(grid):
    """Points over its corners and edges too, and in the planes of its faces."""
    random = np.random.default_rng(3)
    for geometry in meshes():
        surface = solid_of(geometry).surface
        points = random.integers(-16, 17, (1500, 3)) / 16
        if not grid:
            points = surface.vertices[random.integers(0, len(surface.vertices), (300, 4))]
            points = (points * random.dirichlet(np.ones(4), 300)[:, :, None]).sum(1)
            points = np.concatenate((points, points * [1, 1, 0] - [0, 0, 2], points[:, ::-1]))
        off = pairs.points_to_triangles(points, surface.triangles).min(1) > 1e-9
        around = pairs.windings(points[off], surface.triangles)
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
        inside = corners[pairs.windings(corners, other) > 0.5]
        depths += pairs.points_to_triangles(inside, other).min(1).tolist()
    i, j = np.array(sorted(pairs.crossings(s, t))).reshape(-1, 2).T
    depths += triangle_depths(s[i], t[j])[0].tolist()
    assert depths
    assert pairs.gap(a, b).distance == pytest.approx(-max(depths), abs=1e-9)


@pytest.mark.slow
def test_many_corners_that_are_as_deep():
    slab = trimesh.creation.box((1, 1, 0.2))
    for _ in range(4):
        slab = slab.subdivide()
    dent = np.linalg.norm(slab.vertices - [0.5, 0.5, 0.1], axis=1) < 1e-6
    slab.vertices[dent] *= 0.99
    tick = two(ell(4, 4, 4), of_trimesh(slab), (-0.5, 0, -1.1))
    assert tick.penetration(0, 1) == pytest.approx(1.0, abs=1e-9)
    assert tick.calls.calls < len(slab.vertices)


def test_an_answer_does_not_depend_on_the_one_before():
    near, far = (box(), (0, 0, 1.2)), (box(), (0, 0, 3.0))
    tick = narrow([(box(), ORIGIN)], [near], [far])
    assert tick.clearance(0, 1) == pytest.approx(0.2)
    assert tick.clearance(0, 2) == pytest.approx(2.0)
