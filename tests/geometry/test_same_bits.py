"""Symmetric measures are the same to the last bit, in either order and through every door."""

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.geometry.poses import compose, cross, multiply, rotate, rotation_matrices
from tests.support.bodies import solid
from tests.support.urdf import box_obj, collision, joint, link, robot

pytestmark = pytest.mark.filterwarnings("ignore:.*PyBullet does not give back")
RECORDED = ssduck.Recording(tables=("entities", "links", "shapes", "contacts"))


@pytest.fixture
def heap(client, write):
    """Bodies of every kind that fall on each other, an arm of two links among them."""
    pybullet.setGravity(0, 0, -10, client)
    random = np.random.default_rng(4)
    own = {"physicsClientId": client}
    write("cube.obj", box_obj((-0.1, -0.15, -0.2), (0.1, 0.15, 0.2)))
    ring = "".join(
        collision('<box size="0.5 0.1 0.1"/>', xyz=(0, y, 0), rpy=(0.1, 0, turn))
        for y, turn in ((0.2, 0.0), (-0.2, 0.3))
    )
    limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
    mesh = collision('<mesh filename="cube.obj"/>', rpy=(0.3, 0.2, 0.1))
    arm = robot(
        link("base", shapes=mesh, com=(0.01, 0, 0)),
        link("arm", shapes=mesh + collision('<cylinder radius="0.1" length="0.3"/>')),
        joint("turn", "revolute", "base", "arm", xyz=(0.3, 0, 0.1), rpy=(0.5, 0, 0), limit=limit),
    )
    kinds = [
        {"kind": pybullet.GEOM_BOX, "halfExtents": [0.2, 0.1, 0.15]},
        {"kind": pybullet.GEOM_SPHERE, "radius": 0.15},
        {"kind": pybullet.GEOM_CYLINDER, "radius": 0.15, "height": 0.3},
        {"kind": pybullet.GEOM_CAPSULE, "radius": 0.1, "height": 0.3},
        {"kind": pybullet.GEOM_MESH, "vertices": random.normal(size=(9, 3)) * 0.15},
    ]
    names = {solid(client, pybullet.GEOM_PLANE): "ground"}

    def turned():
        turn = random.normal(size=4)
        return (turn / np.linalg.norm(turn)).tolist()

    for n, kind in enumerate(kinds * 2):
        place = (*random.uniform(-0.2, 0.2, 2), 0.3 + 0.25 * n)
        names[solid(client, mass=1, place=place, turn=turned(), **kind)] = f"e{n}"
    for name, text in (("ring", robot(link("ring", shapes=ring))), ("arm", arm)):
        path = write(f"{name}.urdf", text)
        body = pybullet.loadURDF(str(path), (0, 0, 3.0 + len(names) / 9), turned(), **own)
        names[body] = name
    return ssduck.World.attach(client, names=names)


MEASURES = ("clearance", "penetration", "contactForce", "nearestPoints")


def measured(rows, source="a={0}, b={0}", world="sim"):
    """A query of all measures of all pairs, in SelectScript."""
    asked = ", ".join(f"{name}(a.this, b.this)" for name in rows)
    return (
        f"SELECT [id(a.this), id(b.this), {asked}] FROM {source.format(world)} "
        "WHERE id(a.this) != id(b.this) AND id(a.this) != 'ground' AS list;"
    )


def by_pair(found):
    return {(a, b): values for a, b, *values in found}


def exact_key(values):
    """Numbers as they are told apart: -0.0 is not 0.0."""
    return repr(values)


@pytest.mark.long
def test_in_either_order_and_through_every_door(heap, tmp_path):
    with ssduck.Interpreter(str(tmp_path / "run.duckdb"), recording=RECORDED) as ss:
        ss.add_variable("sim", heap)
        for _ in range(20):
            heap.step(16)
        live = by_pair(ss.eval(measured(MEASURES)))
        assert sum(force > 0 for _, _, force, _ in live.values()) > 10
        for (a, b), (*values, points) in live.items():
            if b != "ground":
                assert exact_key([*values, points[::-1]]) == exact_key(live[b, a])
        now = heap.time
        doors = {
            "past": ss.eval(
                measured(MEASURES, "a={0}{{now}}, b={0}{{now}}").replace("now", str(now))
            ),
            "window": ss.eval(measured(MEASURES, "a={0}{{-0.001}}, b={0}{{-0.001}}")),
        }
        with ssduck.Interpreter(row_by_row=True, recording=None) as slow:
            slow.add_variable("sim", heap)
            doors["row by row"] = slow.eval(measured(MEASURES))
        geometric = [name for name in MEASURES if name != "contactForce"]
        with ssduck.Interpreter() as other:
            other.add_variable("maybe", heap.what_if({}))
            maybe = by_pair(other.eval(measured(geometric, world="maybe")))
        earlier = ss.eval(measured(MEASURES, "a={0}{{0.5}}, b={0}{{0.5}}"))
        some = [pair for pair in live if "ground" not in pair][::7]
        alone = {pair: one_by_one(ss, pair, now) for pair in some}
        ss.export(tmp_path / "run")
    for door, found in doors.items():
        told = by_pair(found)
        assert told.keys() == live.keys()
        for pair, values in live.items():
            assert exact_key(told[pair]) == exact_key(values), (door, pair)
    for pair, (gap, depth, _, points) in live.items():
        assert exact_key(maybe[pair]) == exact_key([gap, depth, points]), pair
    for pair, found in alone.items():
        gap, depth, force, points = live[pair]
        assert exact_key(found) == exact_key([gap, depth, force, points]), pair
    for place in ("run", "run.duckdb"):
        with ssduck.open(tmp_path / place) as opened:
            for text, expected in (("sim", live), ("sim{0.5}", by_pair(earlier))):
                found = by_pair(opened.eval(measured(MEASURES, "a={0}, b={0}", text)))
                for pair, values in expected.items():
                    assert exact_key(found[pair]) == exact_key(values), (place, text, pair)


def one_by_one(ss, pair, now):
    """Of two entities alone, in rows of the past, the later one first."""
    a, b = sorted(pair, reverse=True)
    asked = [f"{name}(p, q)" for name in MEASURES]
    rows = ss.sql(
        f"SELECT {', '.join(asked)} FROM entities_history p, entities_history q "
        f"WHERE p.tick = q.tick AND p.name = '{a}' AND q.name = '{b}' "
        "AND p.tick = (SELECT max(tick) FROM ticks_history)"
    ).fetchall()
    ((gap, depth, force, points),) = rows
    points = [list(point) for point in points]
    return [gap, depth, force, points if (a, b) == pair else points[::-1]]


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 8, 15, 16, 17, 33])
@pytest.mark.parametrize("start", [0, 1, 5])
def test_a_pose_does_not_depend_on_those_beside_it(count, start):
    chance = np.random.default_rng(0)
    turns, others = chance.normal(size=(2, 64, 4))
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    points, vectors = chance.normal(size=(2, 64, 3))
    some = slice(start, start + count)
    for work, parts in (
        (rotation_matrices, (turns,)),
        (multiply, (turns, others)),
        (cross, (points, vectors)),
        (lambda q, v: rotate(rotation_matrices(q), v), (turns, vectors)),
        (lambda *four: np.hstack(compose(*four)), (points, turns, vectors, others)),
    ):
        few = work(*(part[some].copy() for part in parts))
        assert np.array_equal(few, work(*parts)[some])
