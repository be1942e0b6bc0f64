"""What is on or inside what."""

import itertools
import math

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given
from hypothesis import strategies as st

from ssduck.geometry.containment import fraction_inside, world_hull
from ssduck.geometry.placed_solid import PlacedSolid
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import solid_of
from tests.support import pairs
from tests.support.cases import generated, sampled
from tests.support.narrow_cases import ORIGIN, floor, frame, of_trimesh, shape, two
from tests.support.pairs import Shape, ell
from tests.support.solids import STRAIGHT, box, capsule, cylinder, mesh_of, narrow, plane, sphere

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
    if one.kind == "mesh" and not whole:
        return pairs.enclosed(local, one.geometry.vertices[one.geometry.faces])
    return pairs.held(one.geometry, local)


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


@pytest.mark.slow
@given(
    a=st.sampled_from(pairs.KINDS),
    b=st.sampled_from(SOLID_KINDS),
    seed=SEEDS,
    shift=st.tuples(*[st.floats(-1e3, 1e3)] * 3),
    turn=st.tuples(st.floats(0.1, 1), *[st.floats(-1, 1)] * 3),
)
def test_a_share_stays_if_the_world_moves(a, b, seed, shift, turn):
    both = pairs.pair((a, b), seed)
    turn = np.array(turn) / np.linalg.norm(turn)
    found = share(*both)
    assert 0.0 <= found <= 1.0
    assert share(*(pairs.moved(one, np.array(shift), turn) for one in both)) == pytest.approx(
        found, abs=1e-8
    )


@pytest.mark.slow
@given(a=st.sampled_from(pairs.KINDS), seed=SEEDS, at=st.floats(0.01, 0.99))
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


@pytest.mark.slow
@given(a=st.sampled_from(["box", "hull"]), b=st.sampled_from(["box", "hull"]), seed=SEEDS)
def test_what_two_share_is_in_either(a, b, seed):
    a, b = pairs.pair((a, b), seed)
    volumes = [solid_of(one.geometry).volume for one in (a, b)]
    if min(volumes) > 0.0:
        common = share(a, b) * volumes[1], share(b, a) * volumes[0]
        assert common[0] == pytest.approx(common[1], abs=1e-8)


@pytest.mark.slow
@given(b=st.sampled_from(SOLID_KINDS), seed=SEEDS)
def test_half_spaces_share_all(b, seed):
    ground, b = pairs.pair(("plane", b), seed)
    assume(b.placed().solid.volume > 0.0)  # of a hull, the corners may be in a plane
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
    for seed, factor in itertools.product(range(generated(1)), (1.0, 2.0, 4.0)):
        a, b = pairs.pair(kinds, seed)
        a = larger(a, factor)
        contained(*([(one.geometry, one.position, one.quaternion)] for one in (a, b)))


# What sticks out of something that is 1 from its middle, along +x.
STICKS_OUT = [0.05 - 1e-9, 0.05 + 1e-9, 0.05 - 1e-4, 0.05 + 1e-4, 0.03, 0.06, 0.13, 0.14, 0.3]


@pytest.mark.slow
@sampled("out", STICKS_OUT, every=8)
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
def test_shares_of_large_meshes_are_those_of_round_shapes():
    torus = of_trimesh(trimesh.creation.torus(1.0, 0.4, major_sections=100, minor_sections=50))
    ball = of_trimesh(trimesh.creation.icosphere(subdivisions=4, radius=0.7))
    for a, b, expected in (
        (ball, torus, 0.213),
        (torus, ball, 0.635),
        (torus, box(), 0.702),
        (box(), torus, 0.168),
        (sphere(0.7), torus, 0.213),
        (torus, sphere(0.7), 0.635),
        (sphere(0.7), sphere(0.7), 0.164),
    ):
        assert two(a, b, (0.9, 0.1, 0.05)).inside(0, 1) == pytest.approx(expected, abs=3e-3)


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


def test_the_deepest_points_of_cylinders_whose_best_direction_is_a_kink():
    """A millionth of a radian off it, both ends of a side are not quite as deep."""
    a, b = pairs.pair(("cylinder", "cylinder"), 20001661)
    assert pairs.error_of(a, b)[0] < 1e-6
