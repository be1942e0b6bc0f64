"""All pairs of a tick of which a relation holds, found at once, are those found pair by pair."""

import itertools
import math

import numpy as np
import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck.geometry.proofs.footprints import OUTSIDE, OVER, ground_boxes, over_verdicts
from ssduck.geometry.proofs.verdicts import UNDECIDED
from ssduck.geometry.solids import solid_of
from ssduck.schema import ID_FACTOR
from tests.support.bodies import create_linked_body, solid
from tests.support.cases import sampled
from tests.support.pairs import geometry
from tests.support.solids import box as solid_box
from tests.support.solids import narrow
from tests.support.stage import Stage


def turned(rng):
    quaternion = rng.normal(size=4)
    return (quaternion / np.linalg.norm(quaternion)).tolist()


def shape(kind, rng):
    """A shape of a kind, of random size."""
    a, b, c = rng.uniform(0.05, 0.25, 3).tolist()
    if kind == "hull":
        points = rng.normal(size=(12, 3)) * 0.15
        return {"kind": pybullet.GEOM_MESH, "vertices": points.tolist()}
    return {
        "box": {"kind": pybullet.GEOM_BOX, "halfExtents": [a, b, c]},
        "sphere": {"kind": pybullet.GEOM_SPHERE, "radius": a},
        "capsule": {"kind": pybullet.GEOM_CAPSULE, "radius": a, "height": b},
        "cylinder": {"kind": pybullet.GEOM_CYLINDER, "radius": a, "height": b},
        "plane": {"kind": pybullet.GEOM_PLANE},
    }[kind]


def fill(client, kinds, seed, side=1.6):
    """A body of each kind, anywhere in a cube, turned at random."""
    rng = np.random.default_rng(seed)
    for kind in kinds:
        made, place = shape(kind, rng), rng.uniform(0, side, 3).tolist()
        turn = [0, 0, 0, 1] if kind == "plane" else turned(rng)
        solid(client, mass=1, place=place, turn=turn, **made)


MIXED = ["box"] * 10 + ["sphere"] * 4 + ["capsule"] * 4 + ["cylinder"] * 4 + ["hull"] * 6
SCENES = {"boxes": ["box"] * 28, "hulls": ["hull"] * 20, "on the ground": ["plane", *MIXED]}
CONDITIONS = ("collides(a.this, b.this)", "near(a.this, b.this, 0.05)", "touching(a.this, b.this)")
CONDITIONS += ("on(a.this, b.this)", "collides(a.this, b.this, 0.01)")


def drift(client, random, far):
    """Moves two of three bodies by about a distance."""
    for body in range(pybullet.getNumBodies(client)):
        if body % 3 == 0:
            continue
        place, turn = pybullet.getBasePositionAndOrientation(body, client)
        place, turn = (np.array(v) + random.normal(size=len(v)) * far for v in (place, turn))
        pybullet.resetBasePositionAndOrientation(
            body, place, turn / np.linalg.norm(turn), physicsClientId=client
        )


@pytest.mark.slow
@sampled(("scene", "condition"), list(itertools.product(SCENES, CONDITIONS)), every=4)
def test_a_world_that_moves_answers_as_one_that_compares_pair_by_pair(client, scene, condition):
    query = f"SELECT id(a.this), id(b.this) FROM a=w, b=w WHERE {condition} AS list;"
    # A condition on one of the two alone: then pairs are asked about one by one.
    one_by_one = query.replace(" AS list", " AND z(a.this) > -1e9 AS list")
    fill(client, SCENES[scene], 8, side=0.8)
    random = np.random.default_rng(9)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("w", ssduck.World.attach(client))
        for far in [0.0, 1e-4] + [1e-3] * 6 + [1e-9] * 2 + [5e-3] * 3 + [0.02, 0.0, 0.3]:
            drift(client, random, far)
            world.tick()
            found = ss.eval(query)
            assert found
            with ssduck.Interpreter() as other:
                other.add_variable("w", ssduck.World.attach(client))
                assert other.eval(one_by_one) == found


@pytest.mark.slow
def test_links_of_one_robot_do_not_count(client):
    sphere = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.2, physicsClientId=client)
    create_linked_body(client, 1, sphere, linkPositions=[[0.1, 0, 0]])
    pybullet.createMultiBody(1, sphere, basePosition=[0.4, 0, 0], physicsClientId=client)
    with ssduck.Interpreter() as ss:
        ss.add_variable("w", ssduck.World.attach(client))
        found = ss.eval("SELECT a.id, b.id FROM a=w, b=w WHERE collides(a.this, b.this) AS list;")
        assert sorted(found) == ["body_0", "body_0", "body_1", "body_1"]


IN_ORDER = {
    "a=w, b=w": ["collides(a.this, b.this)", "collides(b.this, a.this)", "on(b.this, a.this)"],
    "b=w, a=w": ["collides(a.this, b.this)", "near(a.this, b.this, 0.3)", "on(a.this, b.this)"],
    "a=w, n=[2, 1], b=w": ["collides(b.this, a.this)"],
    "n=[2, 1], a=w, b=w": ["collides(a.this, b.this) AND near(b.this, a.this, 0.1)"],
    "c=w, a=w, b=w": [
        "collides(a.this, b.this)",
        "collides(a.this, b.this) AND collides(c.this, a.this)",
        "collides(c.this, a.this) AND near(b.this, a.this, 0.1)",
        "collides(c.this, b.this) AND collides(a.this, b.this)",
    ],
}


@pytest.mark.slow
@sampled(
    ("sources", "condition"),
    [(key, one) for key, some in IN_ORDER.items() for one in some],
    every=4,
)
def test_pairs_are_in_the_order_of_the_sources(client, sources, condition):
    """Whichever of them a pair is of, and in whatever order a relation has them."""
    fill(client, ["box"] * 4, 4, side=0.3)
    for z in (11, 12, 10):
        Stage(client).box(None, [0, 0, z], mass=1)
    named = ", ".join(f"id({name}.this)" for name in "abc" if f"{name}=w" in sources)
    program = f"SELECT {named} FROM {sources} WHERE {condition} AS list;"
    world, found = ssduck.World.attach(client), []
    for row_by_row in (False, True):
        with ssduck.Interpreter(row_by_row=row_by_row) as ss:
            ss.add_variable("w", world)
            found.append(ss.eval(program))
    assert found[0] == found[1] != []


# -- what is on something -------------------------------------------------------------------------


def found(client):
    """Returns the pairs that are found at once, and those pair by pair, in two new worlds."""
    at_once, one_by_one = ssduck.World.attach(client), ssduck.World.attach(client)
    for world in (at_once, one_by_one):
        world.snapshot.request_tables(("shapes",))
        world.tick()
    numbers = at_once.snapshot.shapes().all_on().numbers
    shapes = one_by_one.snapshot.shapes()
    ids = [entity.id for entity in one_by_one]
    expected = [(a, b) for a in ids for b in ids if a != b and shapes.on(a, b)]
    return [divmod(number, ID_FACTOR) for number in numbers], expected


def box(client, place, half, turn=(0, 0, 0, 1)):
    solid(client, pybullet.GEOM_BOX, 1, place, turn, halfExtents=half)


@pytest.mark.slow
@given(
    tilt=st.one_of(
        st.sampled_from([0.0, 30.0, 90.0, 45.0, 30 - 1e-7, 30 + 1e-7]), st.floats(0, 180)
    ),
    spin=st.sampled_from([0.0, 0.3, math.pi / 4]),
    depth=st.sampled_from([0.0, 1e-12, 1e-10, 1e-9, 1e-6, 1e-3, 0.02, -1e-10, -1e-9, -5e-4, -2e-3]),
    along=st.one_of(
        st.sampled_from([0.0, 0.5, 0.5 + 1e-9, 0.5 - 1e-9, 0.51, 0.49]), st.floats(0, 1)
    ),
)
def test_boxes_at_the_boundaries(tilt, spin, depth, along):
    """A box on a tilted one, just in or above it, about 30 degrees, about the edge."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        turn = pybullet.getQuaternionFromEuler((math.radians(tilt), 0, 0))
        up = np.array(pybullet.getMatrixFromQuaternion(turn)).reshape(3, 3)[:, 2]
        across = np.array(pybullet.getMatrixFromQuaternion(turn)).reshape(3, 3)[:, 0]
        turned = pybullet.multiplyTransforms(
            (0, 0, 0), turn, (0, 0, 0), pybullet.getQuaternionFromEuler((0, 0, spin))
        )[1]
        box(client, (0, 0, 0), (0.5, 0.5, 0.25), turn)
        box(client, up * (0.35 - depth) + across * along, (0.1, 0.1, 0.1), turned)
        at_once, one_by_one = found(client)
        assert at_once == one_by_one
    finally:
        pybullet.disconnect(client)


@pytest.mark.parametrize("kind", ["box", "cylinder", "capsule", "hull"])
def test_centres_over_footprints_are_what_single_pairs_say(kind):
    random = np.random.default_rng(5)
    turns = random.normal(size=(300, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    shape = geometry(kind, random, True)
    lower = (shape, np.zeros(3), turns[0])
    reach = solid_of(shape).bounding_radius
    uppers = [
        (solid_box(0.02, 0.02, 0.02), (*random.uniform(-reach, reach, 2), 1.0), turn)
        for turn in turns[1:]
    ]
    scene = narrow([lower], *([upper] for upper in uppers))
    a, b = np.zeros(len(uppers), np.intp), np.arange(1, len(uppers) + 1)
    tick, starts = scene.arrays, np.array(scene.starts)
    expected = np.array([scene.is_over(0, int(other)) for other in b])
    centres = sum(ground_boxes(tick.boxes, starts, b)) / 2
    boxes = ground_boxes(tick.boxes, starts, a)
    verdicts = over_verdicts(tick, starts, a, centres)
    with_boxes = over_verdicts(tick, starts, a, centres, boxes)
    assert ((with_boxes == verdicts) | (verdicts == UNDECIDED)).all()
    assert expected[verdicts == OVER].all()
    assert not expected[verdicts == OUTSIDE].any()
    assert np.count_nonzero(verdicts == UNDECIDED) < len(b) / 10
    assert 0 < expected.sum() < len(b)
