"""All that collides in a tick, found at once, is what is found pair by pair."""

import numpy as np
import pybullet
import pytest

import ssduck
from tests.support.bodies import create_linked_body
from tests.support.cases import sampled
from tests.support.stage import Stage

BOTH = "SELECT id(a.this), id(b.this) FROM a=w, b=w WHERE collides(a.this, b.this) AS list;"
# A condition on one of the two alone: then pairs are asked about one by one.
ONE_BY_ONE = BOTH.replace(" AS list", " AND z(a.this) > -100 AS list")


def turned(rng):
    quaternion = rng.normal(size=4)
    return (quaternion / np.linalg.norm(quaternion)).tolist()


def shape(client, kind, rng):
    """A shape of a kind, of random size."""
    a, b, c = rng.uniform(0.05, 0.25, 3).tolist()
    if kind == "hull":
        points = rng.normal(size=(12, 3)) * 0.15
        return pybullet.createCollisionShape(
            pybullet.GEOM_MESH, vertices=points.tolist(), physicsClientId=client
        )
    made = {
        "box": {"shapeType": pybullet.GEOM_BOX, "halfExtents": [a, b, c]},
        "sphere": {"shapeType": pybullet.GEOM_SPHERE, "radius": a},
        "capsule": {"shapeType": pybullet.GEOM_CAPSULE, "radius": a, "height": b},
        "cylinder": {"shapeType": pybullet.GEOM_CYLINDER, "radius": a, "height": b},
        "plane": {"shapeType": pybullet.GEOM_PLANE},
    }[kind]
    return pybullet.createCollisionShape(**made, physicsClientId=client)


def fill(client, kinds, seed, side=1.6):
    """A body of each kind, anywhere in a cube, turned at random."""
    rng = np.random.default_rng(seed)
    for kind in kinds:
        pybullet.createMultiBody(
            1,
            shape(client, kind, rng),
            basePosition=rng.uniform(0, side, 3).tolist(),
            baseOrientation=[0, 0, 0, 1] if kind == "plane" else turned(rng),
            physicsClientId=client,
        )


@pytest.fixture
def ask(client):
    """The pairs that a program gives at a new tick."""
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("w", ssduck.World.attach(client))

        def asked(program):
            world.tick()
            found = ss.eval(program)
            return list(zip(found[::2], found[1::2], strict=True))

        yield asked


MIXED = ["box"] * 20 + ["sphere"] * 10 + ["capsule"] * 6 + ["cylinder"] * 6 + ["hull"] * 6
SCENES = {"boxes": ["box"] * 60, "mixed": MIXED, "on the ground": ["plane", *MIXED]}


@pytest.mark.slow
@sampled("seed", range(3), every=3)
@pytest.mark.parametrize("kinds", SCENES.values(), ids=SCENES)
def test_at_once_is_one_by_one(client, ask, kinds, seed):
    fill(client, kinds, seed)
    assert ask(BOTH) == ask(ONE_BY_ONE) != []


@pytest.mark.parametrize("angle", [0.0, 1e-8, 0.3, np.pi / 2])
@sampled(("depth", "collides"), [(-1e-6, 0), (0, 0), (0.9e-6, 0), (1.1e-6, 1)], every=2)
def test_the_boundary_of_boxes(client, ask, angle, depth, collides):
    turn = [0, 0, np.sin(angle / 2), np.cos(angle / 2)]
    for z, orientation in ((0.0, [0, 0, 0, 1]), (1.0 - depth, turn)):
        Stage(client).box(None, [0, 0, z], turn=orientation, mass=1)
    assert len(ask(BOTH)) == len(ask(ONE_BY_ONE)) == 2 * collides


@pytest.mark.slow
def test_links_of_one_robot_do_not_count(client, ask):
    sphere = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.2, physicsClientId=client)
    create_linked_body(client, 1, sphere, linkPositions=[[0.1, 0, 0]])
    pybullet.createMultiBody(1, sphere, basePosition=[0.4, 0, 0], physicsClientId=client)
    found = ask(BOTH)
    assert found == ask(ONE_BY_ONE)
    assert len(found) == 2


def test_nothing_collides_in_an_empty_world(ask):
    assert ask(BOTH) == []


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
