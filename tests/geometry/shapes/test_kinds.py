"""Kinds of shapes, the number of compared pairs, and the registry."""

import itertools
import math

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.language.intervals import RELATIONS_OF_INTERVALS
from ssduck.sql.relations.registry import RELATIONS
from tests.support.shape_cases import CAPSULE, CYLINDER, HOLDS, SHAPES, approx
from tests.support.stage import PLANE, pairs_of
from tests.support.urdf import box_obj, collision, joint, link, robot

# -- kinds of shapes -----------------------------------------------------------------------------


KINDS = ("isBox", "isSphere", "isCylinder", "isCapsule", "isPlane", "isTriMesh")


@pytest.mark.slow
def test_kinds_of_shapes_and_their_volumes(stage, write):
    path = str(write("cube.obj", box_obj((0, 0, 0), (1, 2, 3))))
    stage.box("box", half=[0.5, 1.0, 1.5])
    stage.sphere("ball", radius=0.5)
    stage.add("tin", CYLINDER, radius=0.5, height=2.0)
    stage.add("pill", CAPSULE, radius=0.5, height=2.0)
    stage.add("ground", PLANE)
    stage.add("hull", pybullet.GEOM_MESH, fileName=path)
    body = pybullet.createMultiBody(1.0, -1, physicsClientId=stage.client)
    stage.names[body] = "none"
    ball = math.pi / 6
    expected = {
        "box": ("isBox", 6.0), "ball": ("isSphere", ball), "tin": ("isCylinder", math.pi / 2),
        "pill": ("isCapsule", math.pi / 2 + ball), "ground": ("isPlane", math.inf),
        "hull": ("isTriMesh", 6.0), "none": (None, 0.0),
    }  # fmt: skip
    for ss in stage.interpreters(sim=stage.open()):
        for name, (kind, volume) in expected.items():
            flags = ss.eval(f"[{', '.join(f'{word}({name})' for word in KINDS)}];")
            assert [word for word, flag in zip(KINDS, flags, strict=True) if flag] == [kind] * (
                kind is not None
            )
            assert ss.eval(f"solidVolume({name});") == pytest.approx(volume)
        assert ss.eval("SELECT id FROM sim WHERE isPlane(this) AS list;") == ["ground"]
        assert ss.eval("SELECT id FROM sim WHERE hasBody(this) AS list;") == ["none"]


@pytest.mark.slow
def test_what_has_no_shapes(stage):
    """It meets nothing, is infinitely far from all, and fits where its position is."""
    stage.box("a")
    body = pybullet.createMultiBody(1.0, -1, physicsClientId=stage.client)
    stage.names[body] = "none"
    world = stage.open()
    world.add_sensor("range_finder", "a", "eye", max_range=1.0)
    for ss in stage.interpreters(sim=world):
        for other in ("none", "eye"):
            assert ss.eval(f"[clearance(a, {other}), penetration(a, {other})];") == [math.inf, 0.0]
            assert ss.eval(f"[inside(a, {other}), solidVolume({other})];") == [0.0, 0.0]
            assert ss.eval(f"nearestPoints(a, {other});") is None
            for name in sorted(n for n in HOLDS if RELATIONS[n].geometry) + ["inContact"]:
                assert ss.eval(f"[{name}(a, {other}), {name}({other}, a)];") == [False, False]
            assert ss.eval(f"near(a, {other}, 1e9);") is False


@pytest.mark.slow
def test_the_ground_is_solid_and_endless(stage):
    stage.add("ground", PLANE)
    for name, height in (("under", -9.0), ("deep", 0.25), ("at", 0.5), ("over", 2.0)):
        stage.sphere(name, (1e3, 0, height))
    for ss in stage.interpreters(sim=stage.open()):
        names = ("under", "deep", "at", "over")
        told = [ss.eval(f"[clearance(ground, {n}), penetration(ground, {n})];") for n in names]
        assert np.array(told) == approx([[0, 9.5], [0, 0.25], [0, 0], [1.5, 0]])
        assert ss.eval("SELECT id FROM sim WHERE collides(ground, this) AS list;") == [
            "under",
            "deep",
        ]
        assert ss.eval("SELECT id FROM sim WHERE on(ground, this) AS list;") == [
            "under",
            "deep",
            "at",
        ]
        assert ss.eval("SELECT id FROM sim WHERE nextTo(ground, this) AS list;") == []
        assert ss.eval("SELECT id FROM sim WHERE contains(ground, this) AS list;") == ["under"]
        assert ss.eval("SELECT id FROM sim WHERE near(ground, this, 1.5) AS list;") == list(names)


@pytest.mark.slow
def test_a_bowl_is_not_its_hull(stage, write):
    """A mesh that is not convex: a box of five walls with a ball in it."""
    walls = [((-1, -1, 0), (1, 1, 0.1)), ((-1, -1, 0), (-0.9, 1, 1)), ((0.9, -1, 0), (1, 1, 1)),
             ((-1, -1, 0), (1, -0.9, 1)), ((-1, 0.9, 0), (1, 1, 1))]  # fmt: skip
    text = "".join(box_obj(low, high, 8 * n, f"w{n}") for n, (low, high) in enumerate(walls))
    write("bowl.obj", text)
    shape = collision('<mesh filename="bowl.obj" concave="yes"/>')
    shape = shape.replace("<collision", '<collision concave="yes"')
    stage.urdf("bowl", write("bowl.urdf", robot(link("l", mass=0, shapes=shape))))
    stage.sphere("ball", (0, 0, 0.6), radius=0.2)
    world = stage.open()
    for ss in stage.interpreters(sim=world):
        world["ball"].move([0, 0, 0.6])
        assert ss.eval("clearance(bowl, ball);") == pytest.approx(0.3, abs=1e-6)
        assert ss.eval("[collides(bowl, ball), contains(bowl, ball)];") == [False, True]
        world["ball"].move([0, 0, 0.3])
        assert ss.eval("on(bowl, ball);") is True
        world["ball"].move([0.85, 0, 0.6])
        assert ss.eval("collides(bowl, ball);") is True


@pytest.mark.slow
def test_links_count(stage, write):
    """A relation holds for the closest of an entity's links."""
    cube = collision('<box size="0.2 0.2 0.2"/>')
    limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
    text = robot(
        link("base", shapes=cube),
        link("arm", shapes=cube),
        joint("slide", "prismatic", "base", "arm", xyz=(1, 0, 0), axis=(1, 0, 0), limit=limit),
    )
    stage.urdf("arm", write("arm.urdf", text))
    stage.box("wall", (3, 0, 0))
    world = stage.open()
    for ss in stage.interpreters(sim=world):
        for out, gap in ((0.0, 1.4), (1.0, 0.4), (1.4, 0.0), (1.5, -0.1)):
            world["arm"].move([0, 0, 0], joints=[out])
            assert ss.eval("clearance(arm, wall);") == pytest.approx(max(0.0, gap), abs=1e-6)
            assert ss.eval("penetration(arm, wall);") == pytest.approx(max(0.0, -gap), abs=1e-6)
        assert ss.eval("solidVolume(arm);") == pytest.approx(0.016)
        assert ss.eval("collides(arm, arm);") is False


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*no number")
def test_a_pose_that_is_no_number_is_unknown(stage):
    stage.box("a")
    lost = stage.box("lost", (3, 0, 0), mass=1.0)
    world = stage.open()
    ss, _ = stage.interpreters(sim=world)
    nan = [math.nan] * 3
    pybullet.resetBasePositionAndOrientation(lost, nan, [0, 0, 0, 1], stage.client)
    world.tick()
    flags = (
        "collides", "touching", "on", "supports", "restsOn", "contains", "enclosed", "nextTo",
        "overlaps",
    )  # fmt: skip
    values = ("clearance", "penetration", "inside", "nearestPoints")
    for name in flags + values:
        for first, second in (("a", "lost"), ("lost", "a")):
            rows = ss.sql(
                f'SELECT "{name}"(p, q) FROM entities p, entities q '
                f"WHERE p.name = '{first}' AND q.name = '{second}'"
            ).fetchall()
            assert rows == [(None,)], name
    assert pairs_of(ss, "NOT collides(p, q) AND p.id <> q.id") == []
    assert pairs_of(ss, "collides(p, q)") == []


# -- what it costs -------------------------------------------------------------------------------


def crowd(stage, count):
    """Small boxes here and there, about two of which meet another one; how many pairs meet."""
    random = np.random.default_rng(count)
    side = (count / 4) ** (1 / 3)
    for n in range(count):
        stage.box(f"e{n}", random.uniform(0, side, 3).tolist(), half=0.2)
    world = stage.open()
    corners = np.array([entity.aabb for entity in world])
    low, high = corners[:, 0], corners[:, 1]

    def meeting(apart=0.0):
        meets = (low[:, None] <= high[None] + apart + 1e-8).all(2)
        return int(np.triu(meets & meets.T, 1).sum())

    return world, meeting


COSTS = [
    ("SELECT count(*) FROM entities p, entities q WHERE collides(p, q)", 0.0),
    ("SELECT count(*) FROM entities p, entities q WHERE NOT collides(p, q)", 0.0),
    ("SELECT count(*) FROM entities p, entities q WHERE collides(p, q) OR p.z > 1e9", 0.0),
    ("SELECT sum(penetration(p, q)) FROM entities p, entities q", 0.0),
    ("SELECT count(*) FROM entities p LEFT JOIN entities q ON collides(p, q)", 0.0),
    ("SELECT count(*) FROM entities p WHERE EXISTS (SELECT 1 FROM entities q WHERE collides(p, q))", 0.0),
    ("SELECT sum(CASE WHEN touching(p, q) THEN 1 ELSE 0 END) FROM entities p, entities q", 0.001),
    ("SELECT count(*) FROM entities p, entities q WHERE near(p, q, 0.1)", 0.1),
    ('SELECT count(*) FROM entities p, entities q WHERE "on"(p, q)', 0.001),
    ("SELECT count(*) FROM entities p, entities q WHERE contains(p, q)", 0.0),
    ("SELECT a.this FROM a=sim, b=sim WHERE collides(a.this, b.this);", 0.0),
    ("SELECT a.this FROM a=sim, b=sim WHERE near(a.this, b.this, 0.1);", 0.1),
    ("SELECT a.this FROM a=sim, b=sim WHERE touching(a.this, b.this) AND id(a.this) == 'e0';", 0.001),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("count", [50, 300, pytest.param(1000, marks=pytest.mark.long)])
def test_only_pairs_whose_boxes_meet_are_compared(stage, count):
    world, meeting = crowd(stage, count)
    assert meeting() > count / 10
    ss, _ = stage.interpreters(sim=world)
    for query, apart in COSTS:
        ask = ss.eval if query.endswith(";") else lambda text: ss.sql(text).fetchall()
        world.tick()
        before = ss.statistics()["sim"]
        ask(query)
        after = ss.statistics()["sim"]
        assert after.pairs - before.pairs <= meeting(apart), query
        assert after.calls - before.calls <= meeting(apart), query
        ask(query)
        assert ss.statistics()["sim"] == after, f"{query}: asked again in the same tick"


def test_statistics_and_explain(row):
    ss, slow, world = row
    assert ss.statistics() == slow.statistics()
    world.tick()
    before = ss.statistics()["sim"]
    ss.eval("SELECT id FROM sim WHERE collides(b0, this) AS list;")
    after = ss.statistics()["sim"]
    assert 0 < after.pairs - before.pairs <= 2
    assert after.calls - before.calls <= 2
    for interpreter in (ss, slow):
        told = interpreter.explain(
            "SELECT id FROM sim WHERE near(b0, this, 0.1) AND clearance(b1, this) < 1;"
        )
        assert "-- the narrow phase: near, on pairs whose boxes are at most d apart" in told
        assert "-- the narrow phase: clearance, on every pair" in told
        assert "narrow phase" not in interpreter.explain(
            "SELECT id FROM sim WHERE above(b0, this);"
        )


# -- the registry, and the kitchen ---------------------------------------------------------------


@pytest.mark.slow
def test_duckdb_tells_what_functions_do(row):
    ss, _, _ = row
    told = ss.sql(
        "SELECT DISTINCT database_name, function_name, comment FROM duckdb_functions() "
        "WHERE function_type = 'macro' AND comment IS NOT NULL"
    ).fetchall()
    comments = {name: comment for place, name, comment in told if place == "temp"}
    of_intervals = {name: allen.about for name, allen in RELATIONS_OF_INTERVALS.items()}
    assert comments == of_intervals | {r.name: r.help for r in RELATIONS.values()}
    in_world = {name for place, name, _ in told if place != "temp"}
    assert in_world == {relation.name for relation in RELATIONS.values() if relation.tables}


@pytest.mark.long
def test_the_kitchen():
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        kitchen.step(480)
        for name in ("table", "plate_b4e7"):
            ss.add_variable(name, kitchen[name])
        on_it = set(ss.eval("SELECT id FROM kitchen WHERE on(table, this) AS list;"))
        assert on_it == {"cup_58a2", "cup_905a", "cup_b6af", "cup_d441",
                         "plate_496f", "plate_835a", "plate_fa76"}  # fmt: skip
        holding = ss.eval("SELECT id FROM kitchen WHERE contains(this, plate_b4e7) AS list;")
        assert sorted(holding) == ["kitchen", "microwave"]
        every = set(pairs_of(ss, "contains(p, q)"))
        assert {pair for pair in every if pair[0] != "kitchen"} == {("microwave", "plate_b4e7")}
        shares = ss.sql("SELECT inside(p, q) FROM entities p, entities q").fetchall()
        assert all(0.0 <= share <= 1.0 for (share,) in shares)
        found = ss.sql(
            "SELECT penetration(p, q), supports(p, q) OR supports(q, p) "
            "FROM entities p, entities q WHERE collides(p, q)"
        ).fetchall()
        # What stands is pressed into what it stands on, by the slop of the physics solver.
        assert found
        assert all(depth < 2e-5 and stands for depth, stands in found)


@pytest.mark.long
def test_all_pairs_of_entities_have_an_answer(stage):
    """Each of the registry's relations of shapes, of each combination of shapes."""
    for (n, (kind, size)), height in itertools.product(enumerate(SHAPES), (0.0, 0.3)):
        stage.add(f"e{n}_{int(height > 0)}", kind, (0.1 * n, 0, height), **size)
    stage.add("ground", PLANE)
    ss, _ = stage.interpreters(sim=stage.open())
    for name, relation in RELATIONS.items():
        if relation.geometry and relation.required_count == 2:
            rows = ss.sql(f'SELECT "{name}"(p, q) FROM entities p, entities q').fetchall()
            assert not any(value is None for (value,) in rows), name
