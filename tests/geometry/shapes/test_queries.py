"""Queries about shapes in both languages, and of several worlds."""

import itertools
import math

import duckdb
import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import SelectScriptError, SqlError, UnsupportedError
from ssduck.interpreter import query_runner as queries
from ssduck.sql.relations.registry import RELATIONS
from tests.support.cases import sampled
from tests.support.shape_cases import FORMS
from tests.support.stage import BOX, PLANE, pairs_of

# -- forms of queries ----------------------------------------------------------------------------


COMPARED = [
    "clearance({}, {}) < 0.2", "0.2 > clearance({}, {})", "clearance({}, {}) <= half",
    "half >= clearance({}, {})", "clearance({}, {}) <= 0", "clearance({}, {}) < -1",
    "penetration({}, {}) > 0", "0 < penetration({}, {})", "penetration({}, {}) >= 0.05",
    "inside({}, {}) > 0.5", "0.5 <= inside({}, {})",
]  # fmt: skip

ANYWAY = [
    "clearance({}, {}) > 1", "NOT clearance({}, {}) < 0.2", "clearance({}, {}) == 0",
    "penetration({}, {}) >= 0", "penetration({}, {}) <= 0", "inside({}, {}) >= 0",
    "inside({}, {}) > -half", "clearance({}, {}) < mass({}) + 0.5",
]  # fmt: skip


def boxes_apart(a, b):
    """How far apart the boxes of two entities are along the axis where they are farthest."""
    (low, high), (lower, higher) = a.aabb, b.aabb
    return max(np.max(np.subtract(low, higher)), np.max(np.subtract(lower, high)))


@pytest.mark.slow
@sampled("condition", COMPARED + ANYWAY, every=4)
def test_what_is_compared_with_a_number(row, condition, monkeypatch):
    monkeypatch.setattr(queries, "FEW_ROWS", 0)
    ss, slow, world = row
    near = sum(boxes_apart(a, b) <= 0.5 + 1e-9 for a, b in itertools.combinations(world, 2))
    for sides in (("p.this", "q.this"), ("b1", "this"), ("this", "b1")):
        first, second = sides
        sources = "p=sim, q=sim" if first == "p.this" else "sim"
        asked = condition.format(first, second, first)
        selected = "[id(p.this), id(q.this)]" if first == "p.this" else "id(this)"
        world.tick()
        before = world.snapshot.calls.pairs
        found = ss.eval(f"SELECT {selected} FROM {sources} WHERE {asked} AS list;")
        compared = world.snapshot.calls.pairs - before
        assert found == slow.eval(f"SELECT {selected} FROM {sources} WHERE {asked} AS list;")
        if condition in COMPARED:
            assert compared <= near < 10


@sampled(("program", "expected"), FORMS, every=2)
def test_forms_of_selectscript(row, program, expected, monkeypatch):
    monkeypatch.setattr(queries, "FEW_ROWS", 0)
    ss, slow, _ = row
    fast = ss.eval(program)
    assert fast == slow.eval(program)
    if expected is not None:
        assert fast == expected


SQL_FORMS = [
    ("SELECT a.name FROM entities a, entities b WHERE collides(a, b)", ["b0", "b1"]),
    ("SELECT left_one.name FROM entities left_one, entities other WHERE collides(left_one, other)", ["b0", "b1"]),
    ("SELECT p.name FROM entities p, entities q WHERE q.name = 'b0' AND collides(p, q)", ["b1"]),
    ("SELECT p.name FROM sim.entities p, sim.entities q WHERE sim.collides(p, q)", ["b0", "b1"]),
    ("SELECT p.name FROM entities p WHERE EXISTS (SELECT 1 FROM entities q WHERE collides(p, q))", ["b0", "b1"]),
    ("SELECT p.name FROM entities p WHERE NOT EXISTS (SELECT 1 FROM entities q WHERE touching(p, q))", []),
    ("SELECT p.name FROM entities p LEFT JOIN entities q ON collides(p, q) WHERE q.name IS NULL", ["b2", "b3", "floor"]),
    ("SELECT p.name FROM entities p WHERE collides(p, (SELECT e FROM entities e WHERE e.name = 'b0'))", ["b1"]),
    ("SELECT p.name FROM entities p, (SELECT * FROM entities WHERE name = 'b0') q WHERE NOT touching(p, q)", ["b0", "b2", "b3"]),
    ("SELECT CASE WHEN \"on\"(q, p) THEN p.name ELSE '-' END FROM entities p, entities q WHERE q.name = 'floor'",
     ["-", "b0", "b1", "b2", "b3"]),
    ("WITH t AS (SELECT * FROM entities) SELECT p.name FROM t p, t q WHERE collides(p, q)", ["b0", "b1"]),
    ("SELECT p.name FROM entities p JOIN entities q ON collides(p, q) OR p.name = 'b3' AND q.name = 'b3'", ["b0", "b1", "b3"]),
]  # fmt: skip


@pytest.mark.parametrize(("query", "expected"), SQL_FORMS)
def test_forms_of_sql(row, query, expected):
    ss, _, _ = row
    assert sorted(name for (name,) in ss.sql(query).fetchall()) == expected


def test_a_distance_may_be_an_integer(row):
    ss, _, _ = row
    assert ss.eval("SELECT id FROM sim WHERE near(b3, this, 3) AS list;") == ["floor", "b2"]


def test_functions_of_texts_are_as_they_were(row):
    """DuckDB has a contains and a position of its own."""
    ss, slow, _ = row
    for interpreter in (ss, slow):
        assert interpreter.eval("SELECT id FROM sim WHERE 'oo' IN id(this) AS list;") == ["floor"]
    assert ss.sql("SELECT contains('abc', 'b'), position('b' IN 'abc')").fetchall() == [(True, 2)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("values", "one", "other"),
    [
        ("[1, 2]", "2", "3"),
        ("[1, 2]::BIGINT[]", "2", "3"),
        ("[1, 2]::UTINYINT[2]", "2", "3"),
        ("[0.5, 1.5]", "1.5", "2.5"),
        ("[0.5, 1.5]::DOUBLE[]", "1.5", "2"),
        ("['a', 'b']", "'b'", "'c'"),
        ("[true]", "true", "false"),
        ("[DATE '2026-01-01']", "DATE '2026-01-01'", "DATE '2026-01-02'"),
        ("[TIMESTAMP '2026-01-01']", "TIMESTAMP '2026-01-01'", "TIMESTAMP '2026-01-02'"),
        ("[INTERVAL 1 HOUR]", "INTERVAL 60 MINUTE", "INTERVAL 1 DAY"),
    ],
)
def test_lists_keep_what_they_contain(row, values, one, other):
    """DuckDB makes `contains` of IN, which is a relation, too."""
    ss, _, _ = row
    ss.sql("SELECT count(*) FROM entities a, entities b WHERE contains(a, b)")
    for call in ("contains(l, {})", "{} IN l"):
        tests = ", ".join(call.format(value) for value in (one, other, "NULL"))
        rows = ss.sql(f"SELECT {tests} FROM (SELECT {values} AS l)").fetchall()
        with duckdb.connect() as plain:
            assert rows == plain.sql(f"SELECT {tests} FROM (SELECT {values} AS l)").fetchall()
        assert rows == [(True, False, None)]


# -- worlds --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_name_of_a_world_has_its_functions(stage):
    stage.box("a")
    stage.box("b", (0.9, 0, 0))
    world = stage.open()
    ss, _ = stage.interpreters(one=world)
    ss.add_variable("two", world)
    count = "SELECT count(*) FROM {0}.entities p, {0}.entities q WHERE {0}.collides(p, q)"
    for name in ("one", "two"):
        assert ss.sql(count.format(name)).fetchone() == (2,)
        assert len(ss.sql(f"FROM {name}.colliding_pairs()")) == 2
    assert ss.sql(
        "SELECT count(*) FROM entities p, entities q WHERE collides(p, q)"
    ).fetchone() == (2,)
    other = ss.add_variable("other", world.what_if({"b": [1, 0, 0, 0, 3, 0, 0]}))
    assert ss.sql(count.format("one")).fetchone() == (2,)
    ss.add_variable("one", other)
    assert (
        ss.sql(count.format("one")).fetchone() == ss.sql(count.format("other")).fetchone() == (0,)
    )
    assert ss.sql(count.format("two")).fetchone() == (2,)


@pytest.mark.slow
def test_a_question_about_one_world_reads_no_other(stage, client):
    stage.box("a")
    world = stage.open()
    box = pybullet.createCollisionShape(BOX, halfExtents=[0.5] * 3, physicsClientId=client)
    body = pybullet.createMultiBody(0, box, physicsClientId=client)
    other = ssduck.World.attach(client)
    for ss in stage.interpreters(sim=world, other=other):
        before = other.snapshot.number
        pybullet.resetBasePositionAndOrientation(body, [3, 0, 0], [0, 0, 0, 1], client)
        for program in ("SELECT id FROM sim WHERE collides(this, a) AS list;", "collides(a, a);"):
            ss.eval(program)
        ss.sql("SELECT sim.collides(p, p) FROM sim.entities p")
        ss.sql("FROM sim.contacts")
        assert other.snapshot.number == before
    ss.sql("FROM other.joints")
    assert other.snapshot.number > before


@pytest.mark.slow
def test_a_world_that_goes_without_its_name_is_read(stage, client):
    stage.box("a")
    ss, _ = stage.interpreters(sim=stage.open())
    box = pybullet.createCollisionShape(BOX, halfExtents=[0.5] * 3, physicsClientId=client)
    pybullet.createMultiBody(0, box, physicsClientId=client)
    ss.add_variable("other", ssduck.World.attach(client))
    ss.sql("USE other")
    assert ss.sql("SELECT entity FROM shapes").fetchall() == [(1,)]


@pytest.mark.slow
def test_rows_of_another_tick_are_not_compared(stage):
    stage.box("a", mass=1.0)
    stage.box("b", (0.9, 0, 0))
    world = stage.open()
    ss = ssduck.Interpreter(recording=None)
    ss.add_variable("sim", world)
    ss.sql("FROM shapes")  # reading them for the first time is a tick
    ss.sql("CREATE TABLE kept AS FROM entities")
    count = "SELECT count(*) FROM {} p, {} q WHERE {}"
    assert ss.sql(count.format("kept", "kept", "collides(p, q)")).fetchone() == (2,)
    world.step(1)
    for condition in (
        "collides(p, q)",
        "near(p, q, 0.1)",
        "inside(p, q) > 0",
        "solidVolume(p) > 0",
    ):
        for first, second in (("kept", "kept"), ("kept", "entities")):
            with pytest.raises(
                (UnsupportedError, SqlError), match=r"not recorded|of two ticks|at one tick"
            ):
                ss.sql(count.format(first, second, condition))
    assert ss.sql(count.format("entities", "entities", "collides(p, q)")).fetchone() == (2,)


@pytest.mark.slow
def test_of_several_worlds_sql_says_which(stage):
    stage.box("a")
    stage.box("b", (0.9, 0, 0))
    world = stage.open()
    ss, _ = stage.interpreters(kitchen=world)
    maybe = ss.add_variable("maybe", world.what_if({"b": [1, 0, 0, 0, 3, 0, 0]}))
    rows = "SELECT p.name FROM {0}.entities p, {0}.entities q WHERE {1}collides(p, q)"
    assert len(ss.sql(rows.format("kitchen", "kitchen.")).fetchall()) == 2
    assert ss.sql(rows.format("maybe", "maybe.")).fetchall() == []
    calls = ["collides(p, q)", "isBox(p)", "contactForce(p, q)", "solidVolume(p)"]
    for call in [*calls, "isSensing(p, q)", "sensingAmount(p, q)", "sensingEnvIDs(p)"]:
        with pytest.raises(SqlError, match=r"write the name of the world before it"):
            ss.sql(f"SELECT {call} FROM kitchen.entities p, kitchen.entities q")
    # One that asks only for columns is for all.
    assert len(pairs_of(ss, "overlaps(p, q)")) == 2
    assert ss.eval("SELECT id FROM maybe WHERE clearance(this, this) == 0.0 AS list;") == ["a", "b"]
    assert ss.sql(
        "SELECT maybe.clearance(p, q) FROM maybe.entities p, maybe.entities q WHERE p.id < q.id"
    ).fetchall() == [(2.0,)]
    assert maybe.snapshot.calls.pairs > 0


@pytest.mark.slow
def test_relations_of_two_worlds(stage):
    stage.box("a")
    stage.box("b", (0.9, 0, 0))
    world = stage.open()
    other = world.what_if({"b": [1, 0, 0, 0, 3, 0, 0]})
    for ss in stage.interpreters(one=world):
        ss.add_variable("two", other)
        program = "SELECT id(p.this) FROM p=one, q=two WHERE {}(p.this, q.this) AS list;"
        for name, relation in RELATIONS.items():
            types = [p.type for p in relation.parameters[: relation.required_count]]
            if relation.tables and types == ["entity", "entity"]:
                calls = [f"{name}(one.a, two.b);"]
                calls += [program.format(name)] if relation.result == "boolean" else []
                for call in calls:
                    with pytest.raises(SelectScriptError, match="these entities are of two worlds"):
                        ss.eval(call)
        assert ss.eval("above(one.a, two.b);") is False  # of positions alone


@pytest.mark.slow
def test_forces_of_the_last_step(stage):
    pybullet.setGravity(0, 0, -10, physicsClientId=stage.client)
    stage.add("ground", PLANE)
    stage.box("crate", (0, 0, 0.5), mass=3.0)
    stage.box("lid", (0, 0, 5), mass=1.0)
    world = stage.open()
    for ss in stage.interpreters(sim=world):
        world.step(240)
        assert ss.eval("[inContact(ground, crate), inContact(crate, ground)];") == [True, True]
        assert ss.eval("inContact(ground, ground);") is False
        assert ss.eval("contactForce(ground, crate) + contactForce(crate, ground);") > 50
        assert ss.sql(
            "SELECT p.name, q.name FROM entities p, entities q WHERE inContact(p, q) AND p.id < q.id"
            " AND p.name = 'ground'"
        ).fetchall()
    assert ss.eval("contactForce(ground, ground);") == 0.0


@pytest.mark.slow
@sampled("first", ["selectscript", "sql"], every=2)
def test_a_crate_at_rest_on_a_ramp_is_held_by_its_contacts(stage, first):
    pybullet.setGravity(0, 0, -10, physicsClientId=stage.client)
    turn = (math.sin(0.15), 0, 0, math.cos(0.15))  # by 0.3 about x
    up = np.array([0, -math.sin(0.3), math.cos(0.3)])
    ramp = stage.box("ramp", half=[5.0, 5.0, 0.1], turn=turn)
    crate = stage.box("crate", tuple(up * 0.6), mass=3.0, turn=turn)
    for body in (ramp, crate):
        pybullet.changeDynamics(body, -1, lateralFriction=1.5, physicsClientId=stage.client)
    world = stage.open()
    for ss in stage.interpreters(sim=world):
        world.step(240)
        programs = ("SELECT force FROM sim AS list;", "SELECT torque FROM sim AS list;")
        found = [] if first == "sql" else list(map(ss.eval, programs))
        on_ramp, on_crate = ss.sql("SELECT force(e), torque(e) FROM entities e").fetchall()
        assert found in ([], [[on_ramp[0], on_crate[0]], [on_ramp[1], on_crate[1]]])
        assert on_crate[0] == pytest.approx([0, 0, 30], abs=1e-3)
        assert on_ramp[0] == pytest.approx([0, 0, -30], abs=1e-3)
        assert on_crate[1] == pytest.approx([0, 0, 0], abs=1e-3)
        x, y, _ = world["crate"].position  # where its 30 N push down
        assert on_ramp[1] == pytest.approx([-30 * y, 30 * x, 0], abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("place", ["", "sim."])
def test_pairs_as_tables(row, place):
    ss, _, world = row
    world.tick()
    named = (
        "SELECT e.name, f.name FROM {} p, entities e, entities f WHERE e.id = p.a AND f.id = p.b"
    )
    for table, condition in (
        ("colliding_pairs()", "collides(e, f)"),
        ("pairs_within(0.5)", "near(e, f, 0.5)"),
        ("pairs_within(0)", "touching(e, f, 0.0)"),
        ("pairs_within(-1)", "FALSE"),
    ):
        expected = ss.sql(f"SELECT e.name, f.name FROM entities e, entities f WHERE {condition}")
        found = ss.sql(named.format(place + table)).fetchall()
        assert sorted(found) == sorted(expected.fetchall())
    world["b3"].move([0.5, 0, 0])
    assert ("b3", "b0") in ss.sql(named.format(f"{place}colliding_pairs()")).fetchall()
    world["b3"].move([5, 0, 0])
