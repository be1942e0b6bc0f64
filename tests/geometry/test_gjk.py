"""What is decided for many pairs at once is what is found pair by pair."""

import itertools
import math

import numpy as np
import pytest

from ssduck.geometry.narrow_phase import MIN_DEPTH
from ssduck.geometry.proofs import cores, gjk
from ssduck.geometry.proofs.verdicts import ABOVE, UNDECIDED
from ssduck.geometry.queries import MIN_PAIRS_AT_ONCE, ShapeQueries
from ssduck.geometry.shapes import Geometry
from ssduck.geometry.solids import solid_of
from ssduck.geometry.tick_shapes import PairPredicate
from ssduck.schema import ID_FACTOR
from tests.support import pairs
from tests.support.cases import generated, sampled
from tests.support.narrow_cases import shape
from tests.support.solids import STRAIGHT, box, capsule, cylinder, mesh_of, narrow, plane, sphere

CONVEX = ("sphere", "box", "cylinder", "capsule", "ellipsoid", "hull", "flat")
COMBINATIONS = list(itertools.combinations_with_replacement(CONVEX, 2))
COLLIDE = PairPredicate("colliding", MIN_DEPTH)
BOUNDS = (-MIN_DEPTH, 0.0, 1e-3, 0.05, 0.3)


def undecided(two, bounds=BOUNDS):
    """The gaps less the bounds where nothing is decided; what is decided is right."""
    gaps = np.array([pairs.gap(*pair).distance for pair in two])
    left = []
    for bound in bounds:
        assert pairs.wrong_verdicts(two, gaps, bound) == []
        left += [(gaps - bound)[found == UNDECIDED] for found in pairs.verdicts(two, bound)]
    return np.concatenate(left)


@pytest.mark.slow
@sampled("kinds", COMBINATIONS, every=3, ids=" ".join)
def test_verdicts_are_what_gaps_say(kinds):
    left = undecided([pairs.pair(kinds, seed) for seed in range(60)])
    assert (np.abs(left) > 1e-6).sum() <= 0.02 * 60 * 2 * len(BOUNDS)


# -- what algorithms get wrong -----------------------------------------------------------------

CUBE = Geometry.hull(solid_of(box()).core)
STACKED = {
    "box": box(),
    "cube": CUBE,
    "cylinder": cylinder(),
    "prism": Geometry.hull(solid_of(cylinder()).surface.vertices),
    "octahedron": Geometry.hull(np.vstack((np.eye(3), -np.eye(3))) / 2),
    "sphere": sphere(),
    "capsule": capsule(0.25, 0.5),
}
OFF = [(0, 0), (0.25, 0), (0.1, 0.07), (1, 0), (0.999999, 0), (0.5, 0.5)]
TURNS = [STRAIGHT, (1, 0, 0, 0.3), (1, 0, 0, 1)]
FAR = [(0, 0, 0), (1e4, -1e4, 1e4)]
DEPTHS = [-1e-3, -1e-5, -2e-6, 0, 0.5e-6, 0.9e-6, 1.1e-6, 2e-6, 1e-5, 1e-4, 1e-2, 0.3, 1]  # fmt: skip


@pytest.mark.slow
@sampled("depth", DEPTHS, every=6)
def test_stacked(depth):
    """Parallel faces that touch, or are hardly in each other, also 10 km away."""
    two = [
        (shape(a, far), shape(b, np.array(far) + [*off, 1 - depth], turn))
        for a, b in itertools.combinations_with_replacement(STACKED.values(), 2)
        for (i, off), (j, turn), (k, far) in itertools.product(*map(enumerate, (OFF, TURNS, FAR)))
        if (i + j + k) % 2 == 0 or generated(1) > 1
    ]
    left = undecided(two, (-MIN_DEPTH, 0.0, 2e-3))
    assert (left > 1e-6).sum() <= 0.02 * 6 * len(two)  # few of those that are apart


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_sizes_from_a_millimetre_to_a_kilometre(seed):
    random = np.random.default_rng(seed)

    def any_size(kind):
        size = 10.0 ** random.uniform(-3, 3)
        made = pairs.geometry(kind, random, is_round=False)
        if kind in ("hull", "flat"):
            count = int(random.choice([8, 40, 300]))
            points = random.normal(size=(count, 3)) * [1, 1, kind == "hull"]
            return Geometry.hull(points * size * 10.0 ** random.uniform(-1.5, 0, 3))
        return Geometry.primitive(kind, np.array(made.size) * size)

    two = []
    for kinds in COMBINATIONS * 3:
        first, second = map(any_size, kinds)
        way = random.normal(size=3)
        apart = random.uniform() * sum(solid_of(one).bounding_radius for one in (first, second))
        far = random.normal(size=3) * random.choice([0, 1e4])
        turned = [random.normal(size=4) for _ in range(2)]
        place = far + way / np.linalg.norm(way) * apart
        two.append((shape(first, far, turned[0]), shape(second, place, turned[1])))
    left = undecided(two, (-MIN_DEPTH, 0.0, 1e-3, 1.0))
    assert (np.abs(left) > 1e-6).sum() <= 3


@pytest.mark.parametrize("is_right", [True, False])
def test_directions_to_try_first_do_no_harm(is_right):
    two = [pairs.pair(kinds, seed) for kinds in COMBINATIONS for seed in range(4)]
    found = [(pair, pairs.gap(*pair)) for pair in two]
    found = [(pair, gap) for pair, gap in found if gap.distance > 0.01]
    bodies = pairs.bodies([shape for pair, _ in found for shape in pair])
    first = np.arange(0, 2 * len(found), 2)
    directions = np.array([gap.normal for _, gap in found]).T
    if not is_right:
        directions = np.random.default_rng(3).normal(size=directions.shape)
        directions[:, ::7] = 0.0
    gaps = np.array([gap.distance for _, gap in found])
    for share, is_above in ((0.99, True), (1.01, False)):
        decided = gjk.decide_gaps(bodies, first, first + 1, share * gaps, directions=directions)
        assert ((decided.verdicts == ABOVE) == is_above).all()


def test_parts_of_all_pairs_are_as_all(monkeypatch):
    random = np.random.default_rng(3)
    two = [pairs.pair(kinds, int(random.integers(1000))) for kinds in COMBINATIONS * 3]
    together = pairs.verdicts(two, 0.01)
    monkeypatch.setattr(gjk, "PAIRS_AT_ONCE", 7)
    monkeypatch.setattr(cores, "MAX_POINTS", 20)
    for found, expected in zip(pairs.verdicts(two, 0.01), together, strict=True):
        assert found.tolist() == expected.tolist()


# -- a tick ------------------------------------------------------------------------------------

NOWHERE = (math.nan, 0.0, 0.0)
ELL = pairs.ell(1.0, 0.6, 0.8)
PATCH = Geometry("mesh", (0, 0, 0), pairs.patch_vertices(1, 1, 1), pairs.PATCH)
ALL = [box(0.5, 0.4, 0.3), sphere(0.3), capsule(0.2, 0.4), cylinder(0.3, 0.4), CUBE, ELL, PATCH]
ALL += [Geometry.primitive("ellipsoid", (0.3, 0.2, 0.4))]
ALL += [mesh_of(cylinder()), Geometry.hull([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), plane((0, 0.6, 0.8))]
APART = [0.0, 1e-3, 0.1, 0.25, 3.0, math.inf]


def crowd(seed, *, is_round, side=1.5):
    """Entities of one to three shapes, two of them lost, two without shapes."""
    random = np.random.default_rng(seed)
    entities = []
    for _ in range(22):
        shapes = []
        for _ in range(random.integers(1, 4)):
            place = random.uniform(0, side, 3)
            turn = pairs.pose(random, is_round)[1]
            place = np.round(place * 4) / 4 if is_round else place
            shapes.append((ALL[random.integers(len(ALL))], place, turn))
        entities.append(shapes)
    entities[3][0] = (box(), NOWHERE, STRAIGHT)
    entities[5].append((box(), (0, 0, 0), (0, 0, 0, 0)))
    entities[7:9] = [[], [(Geometry.hull(np.zeros((0, 3))), (0, 0, 0), STRAIGHT)]]
    entities[9].append((Geometry.primitive("sphere", (-1, 0, 0)), (0, 0, 0), STRAIGHT))
    return entities


def boxes_apart(tick, i, j):
    """How far apart two entities' boxes are along the axis where they are farthest."""
    a, b = (tick.places.boxes[tick.starts[e] : tick.starts[e + 1]] for e in (i, j))
    gaps = np.maximum(a[:, None, :3] - b[None, :, 3:], b[None, :, :3] - a[:, None, 3:]).max(2)
    return gaps.min(initial=math.inf)


@pytest.mark.slow
@pytest.mark.parametrize("is_round", [False, True])
@sampled("seed", range(4), every=4)
def test_all_pairs_of_a_tick(seed, is_round):
    entities = crowd(seed, is_round=is_round)
    together, alone = narrow(*entities), narrow(*entities)
    every = list(itertools.combinations(range(len(entities)), 2))
    collide = [pair for pair in every if alone.collides(*pair)]
    assert together.all_pairs(COLLIDE).pairs == collide
    assert collide
    gaps = {pair: alone.clearance(*pair) for pair in every}
    for apart in APART:
        near = [pair for pair in every if gaps[pair] is not None and gaps[pair] <= apart]
        assert together.all_pairs(PairPredicate("within", apart)).pairs == near
        asked = narrow(*entities)  # anew: what is farther need not be known
        found = {pair: asked.clearance(*pair, apart) for pair in every}
        assert [
            pair for pair in every if (found[pair] or 0) <= apart and gaps[pair] is not None
        ] == near


@pytest.mark.parametrize("apart", [-1e-9, -1.0, -math.inf, math.nan])
def test_nothing_is_nearer_than_nothing(apart):
    tick = narrow([(box(), (0, 0, 0))], [(box(), (0.5, 0, 0))])
    assert tick.all_pairs(PairPredicate("within", apart)).pairs == []


# Two shapes along x, and how far apart they are when their origins are 0.
BESIDE = {
    "boxes": (box(), box(), 1.0),
    "spheres": (sphere(), sphere(), 1.0),
    "capsule and sphere": (capsule(0.5, 1), sphere(0.25), 0.75),
    "box and cylinder": (box(), cylinder(0.25), 0.75),
    "cube and octahedron": (CUBE, STACKED["octahedron"], 1.0),
    "plane and cube": (plane((1, 0, 0)), CUBE, 0.5),
    "mesh and box": (ELL, box(), 1.0),
}


@pytest.mark.parametrize("apart", [0.0, 1e-3, 0.1, 10.0])
@pytest.mark.parametrize("name", BESIDE)
def test_at_the_bound(name, apart):
    """A tenth of a micrometre nearer or farther is told apart; at the bound, both ways agree."""
    a, b, touching = BESIDE[name]
    for more, expected in ((-1e-7, True), (0.0, None), (1e-7, False)):
        tick = narrow([(a, (0, 0, 0))], [(b, (touching + apart + more, 0, 0))])
        found = tick.all_pairs(PairPredicate("within", apart)).pairs == [(0, 1)]
        assert found is (tick.clearance(0, 1) <= apart)
        assert expected is None or found is expected


@pytest.mark.parametrize("name", BESIDE)
@pytest.mark.parametrize(("depth", "expected"), [(0.0, False), (0.8e-6, False), (1.2e-6, True)])
def test_at_the_depth_that_collides(name, depth, expected):
    a, b, touching = BESIDE[name]
    tick = narrow([(a, (0, 0, 0))], [(b, (touching - depth, 0, 0))])
    assert (tick.all_pairs(COLLIDE).pairs == [(0, 1)]) is expected
    assert tick.collides(0, 1) is expected


@pytest.mark.parametrize("size", [0.0, 1e-200, 1e-150, 1e100, 1e150])
@pytest.mark.parametrize("solid", [box, lambda size, *_: sphere(size)])
def test_sizes_beyond_any_scene(solid, size):
    """What is too large to be squared is not decided by squares."""
    large = solid(size, size, size)
    tick = narrow([(large, (0, 0, 0))], [(large, (size / 4, 0, 0))], [(sphere(1.0), (0, 0, 0))])
    expected = [(0, 1), (0, 2), (1, 2)] if size > 1 else [(0, 2), (1, 2)]
    assert tick.all_pairs(COLLIDE).pairs == expected
    assert tick.all_pairs(PairPredicate("within", 0.1)).pairs == [(0, 1), (0, 2), (1, 2)]


# Of a body of a metre.
BOXES = np.array([[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]]).T


# -- many questions ----------------------------------------------------------------------------


def convex_crowd(count, seed=0):
    random = np.random.default_rng(seed)
    side = (count / 4) ** (1 / 3)
    return [
        [
            (
                pairs.geometry(CONVEX[n % 5], random, is_round=False),
                random.uniform(0, side, 3),
                random.normal(size=4),
            )
        ]
        for n in range(count)
    ]


@pytest.mark.slow
def test_many_questions_are_answered_together():
    entities = [*convex_crowd(150), [(box(), (math.nan, 0, 0))], [(box(), (0, 0, 0))]]
    tick, alone = narrow(*entities), narrow(*entities)
    numbers = {n: n for n in range(len(entities))}
    shapes = ShapeQueries(tick, numbers, BOXES, np.zeros(0, np.int64))
    every = list(itertools.combinations(numbers, 2))
    meeting = [pair for pair in every if boxes_apart(tick, *pair) <= 0.05]
    unknown = [(149, 150), (151, 150)]
    assert len(meeting) > 2 * MIN_PAIRS_AT_ONCE
    for i, j in [*meeting, *unknown, *every[:200]]:
        assert shapes.collides(j, i, MIN_DEPTH) is alone.collides(i, j)
        near = alone.clearance(i, j)
        assert shapes.near(j, i, 0.05) is (None if near is None else near <= 0.05)


def test_ids_of_all_that_are_near():
    tick = narrow(*([(box(), (1.5 * n, 0, 0))] for n in range(3)))
    shapes = ShapeQueries(tick, {7: 0, 3: 1, 5: 2, 9: 3}, BOXES, np.array([9, 7, 5, 3]))
    assert shapes.all_within(0.4).numbers == []
    found = shapes.all_within(0.5)
    pairs = [divmod(number, ID_FACTOR) for number in found.numbers]
    assert pairs == [(3, 5), (3, 7), (5, 3), (7, 3)]
    places = np.stack((found.first, found.second), axis=1)
    assert found.ids[places].tolist() == [list(pair) for pair in pairs]
    assert shapes.all_colliding(MIN_DEPTH).numbers == []
