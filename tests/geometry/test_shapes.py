"""Relations of the shapes themselves: closed forms, edges, both languages, and what they cost."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pybullet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import ssduck
from ssduck.errors import SelectScriptError, SqlError, UnsupportedError
from ssduck.interpreter import query_runner as queries
from ssduck.language.intervals import RELATIONS_OF_INTERVALS
from ssduck.sql.relations.registry import RELATIONS
from tests.support.cases import sampled
from tests.support.stage import BOX, PLANE, SPHERE, Stage, pairs_of
from tests.support.urdf import box_obj, collision, joint, link, robot

CYLINDER, CAPSULE = pybullet.GEOM_CYLINDER, pybullet.GEOM_CAPSULE
EDGE = 2e-9
# The relations that hold of two entities or not.
HOLDS = {
    name
    for name, relation in RELATIONS.items()
    if relation.result == "boolean"
    and [p.type for p in relation.parameters[: relation.required_count]] == ["entity"] * 2
}


@pytest.fixture
def stage():
    made = Stage()
    yield made
    made.close()


@pytest.fixture(scope="module")
def pair():
    """Two unit boxes a and b; b is put where a test wants it."""
    made = Stage()
    made.box("a")
    made.box("b", (5, 0, 0))
    world = made.open()
    ss, slow = made.interpreters(sim=world)
    yield ss, slow, world["b"]
    made.close()


# -- values, and the edges ---------------------------------------------------------------------

# Of a unit box at the origin and another one: (expression, position of b, value)
VALUES = [
    ("clearance(a, b)", (1.75, 0, 0), 0.75),
    ("clearance(a, b)", (4, 5, 0), 5.0),
    ("clearance(a, b)", (2, 3, 3), 3.0),
    ("clearance(a, b)", (1, 0, 0), 0.0),
    ("clearance(a, b)", (0.5, 0, 0), 0.0),
    ("clearance(a, a)", (1, 0, 0), 0.0),
    ("penetration(a, b)", (0.9, 0, 0), 0.1),
    ("penetration(a, b)", (0.9, 0.95, 0), 0.05),
    ("penetration(a, b)", (0, 0, 0), 1.0),
    ("penetration(a, b)", (1, 0, 0), 0.0),
    ("penetration(a, b)", (3, 0, 0), 0.0),
    ("penetration(a, a)", (0, 0, 0), 0.0),
    ("inside(a, b)", (0, 0, 0), 1.0),
    ("inside(a, b)", (0.25, 0, 0), 0.75),
    ("inside(a, b)", (0.5, 0.5, 0.5), 0.125),
    ("inside(a, b)", (1, 0, 0), 0.0),
    ("inside(a, b)", (7, 0, 0), 0.0),
    ("inside(a, a)", (0, 0, 0), 0.0),
    ("solidVolume(b)", (0, 0, 0), 1.0),
    ("nearestPoints(a, a)", (3, 0, 0), [[0, 0, 0], [0, 0, 0]]),
    ("contactForce(a, b)", (0.5, 0, 0), 0.0),
    ("pos(b)", (1, 2, 3), [1, 2, 3]),
    ("[posX(b), posY(b), posZ(b)]", (1, 2, 3), [1, 2, 3]),
    ("quat(b)", (1, 2, 3), [1, 0, 0, 0]),
    ("aabb(b)", (1, 2, 3), [0.5, 1.5, 1.5, 2.5, 2.5, 3.5]),
    ("mass(b)", (1, 2, 3), 0.0),
]


def approx(value):
    return pytest.approx(np.array(value), abs=1e-9)


@pytest.mark.parametrize(("expression", "position", "value"), VALUES)
def test_values(pair, expression, position, value):
    ss, slow, b = pair
    b.move(position)
    for interpreter in (ss, slow):
        assert np.array(interpreter.eval(f"{expression};")) == approx(value)
        told = interpreter.eval(f"SELECT to({expression}, 'it') FROM sim WHERE id(this) == 'b';")
        assert np.array(told[0]["it"]) == approx(value)
    ((found,),) = ss.sql(
        f"SELECT {expression} FROM entities a, entities b WHERE a.name = 'a' AND b.name = 'b'"
    ).fetchall()
    assert np.array(found) == approx(value)


# Two unit boxes meet at 1; (condition, position of b, whether it holds)
EDGES = [
    ("overlaps(a, b)", (1 - EDGE, 0, 0), True),
    ("overlaps(a, b)", (1, 1, 1), True),
    ("overlaps(a, b)", (1 + EDGE, 0, 0), False),
    ("collides(a, b)", (1 - 2e-6, 0, 0), True),
    ("collides(a, b)", (1 - 5e-7, 0, 0), False),
    ("collides(a, b)", (1, 0, 0), False),
    ("collision(a, b)", (0.5, 0, 0), True),
    ("collision(a, b)", (1 + EDGE, 0, 0), False),
    ("touching(a, b)", (0.5, 0, 0), True),
    ("touching(a, b)", (1, 0, 0), True),
    ("touching(a, b)", (1.001 - EDGE, 0, 0), True),
    ("touching(a, b)", (1.001 + EDGE, 0, 0), False),
    ("touching(a, b, 0.5)", (1.5 - EDGE, 0, 0), True),
    ("touching(a, b, 0.5)", (1.5 + EDGE, 0, 0), False),
    ("touching(a, b, 0.0)", (1 + EDGE, 0, 0), False),
    ("near(a, b, 0.5)", (1.5, 0, 0), True),
    ("near(a, b, 0.5)", (1.5 - EDGE, 0, 0), True),
    ("near(a, b, 0.5)", (1.5 + EDGE, 0, 0), False),
    # The boxes grown by 0.5 meet at a corner, the shapes are 0.7 apart there.
    ("near(a, b, 0.5)", (1.4, 1.4, 0), False),
    ("near(a, b, 5.0)", (4, 5, 0), True),
    ("on(a, b)", (0, 0, 1), True),
    ("on(a, b)", (0, 0, 1.001 - EDGE), True),
    ("on(a, b)", (0, 0, 1.001 + EDGE), False),
    ("on(a, b)", (0.5 - EDGE, 0.5 - EDGE, 1), True),
    ("on(a, b)", (0.5 + 1e-6, 0, 1), False),
    ("on(a, b)", (1, 0, 0), False),
    ("on(a, b)", (0, 0, -1), False),
    ("on(b, a)", (0, 0, -1), True),
    ("supports(a, b)", (0, 0, 1), True),
    ("supports(b, a)", (0, 0, 1), False),
    ("contains(a, b)", (0.05 - EDGE, 0, 0), True),
    ("contains(a, b)", (0.05 + EDGE, 0, 0), False),
    ("contains(a, b)", (0, 0, 0), True),
    # A third of the mean of six sides of 1.
    ("nextTo(a, b)", (1 + 1 / 3 - EDGE, 0, 0), True),
    ("nextTo(a, b)", (1 + 1 / 3 + EDGE, 0, 0), False),
    ("nextTo(a, b)", (1.1, 0, 1 - EDGE), True),
    ("nextTo(a, b)", (0, 0, 1 + EDGE), False),
    ("inBox(b, [1.0, 2.0, 3.0], [2.0, 3.0, 4.0])", (1, 2, 3), True),
    ("inBox(b, [1.0, 2.0, 3.0], [2.0, 3.0, 4.0])", (2, 3, 4), True),
    ("inBox(b, [1.0, 2.0, 3.0], [2.0, 3.0, 4.0])", (1 - EDGE, 2, 3), False),
    ("inBox(b, [1.0, 2.0, 3.0], [2.0, 3.0, 4.0])", (2, 3, 4 + EDGE), False),
    ("fitsBox(b, [1.0, 1.0, 1.0], [2.0, 2.0, 2.0])", (1.5, 1.5, 1.5), True),
    ("fitsBox(b, [1.0, 1.0, 1.0], [2.0, 2.0, 2.0])", (1.5 + EDGE, 1.5, 1.5), False),
    ("inSphere(b, [0.0, 0.0, 0.0], 5.0)", (3, 4, 0), True),
    ("inSphere(b, [0.0, 0.0, 0.0], 5.0)", (3, 4 + EDGE, 0), False),
    ("inSphere(b, a, 5.0)", (0, 3, 4), True),
    ("inContact(a, b)", (0.5, 0, 0), False),
    ("isBox(b)", (0, 0, 0), True),
    ("isSphere(b)", (0, 0, 0), False),
    ("hasBody(b)", (0, 0, 0), False),
]


def in_sql(condition):
    """A condition as raw SQL has it: `on` is a word of its own, and a point is a struct."""
    text = condition.replace("on(", '"on"(') if condition.startswith("on(") else condition
    for x, y, z in ((1.0, 2.0, 3.0), (2.0, 3.0, 4.0), (1.0,) * 3, (2.0,) * 3, (0.0,) * 3):
        text = text.replace(f"[{x}, {y}, {z}]", f"{{'x': {x}, 'y': {y}, 'z': {z}}}")
    return text


@pytest.mark.parametrize(("condition", "position", "holds"), EDGES)
def test_edges(pair, condition, position, holds):
    ss, slow, b = pair
    b.move(position)
    for interpreter in (ss, slow):
        assert interpreter.eval(f"{condition};") is holds
        of_rows = condition.replace("b)", "this)").replace("b,", "this,").replace("(b", "(this")
        found = interpreter.eval(f"SELECT id FROM sim WHERE {of_rows} AND id(this) == 'b' AS list;")
        assert found == ["b"] * holds
    rows = ss.sql(
        "SELECT b.name FROM entities a, entities b "
        f"WHERE a.name = 'a' AND b.name = 'b' AND {in_sql(condition)}"
    )
    assert rows.fetchall() == [("b",)] * holds


def test_nearest_points_are_as_far_apart_as_the_clearance(pair):
    ss, slow, b = pair
    b.move([3, 0.2, 0.1], [0.8, 0.0, 0.6, 0.0])
    for interpreter in (ss, slow):
        (on_a, on_b), gap = interpreter.eval("[nearestPoints(a, b), clearance(a, b)];")
        assert math.dist(on_a, on_b) == pytest.approx(gap, abs=1e-9)
        assert on_a[0] == pytest.approx(0.5, abs=1e-9)
        (back_b, back_a) = interpreter.eval("nearestPoints(b, a);")
        assert math.dist(back_a, on_a) < 1e-6 or math.dist(back_a, back_b) == pytest.approx(gap)


@sampled("position", [(0, 0, 0), (0.9, 0, 0), (0, 0, 1), (1.05, 0, 0)], every=4)
def test_a_relation_with_itself_is_false_and_symmetry_is_as_registered(pair, position):
    ss, slow, b = pair
    b.move(position)
    for name in sorted(HOLDS):
        assert pairs_of(ss, f'"{name}"(p, q) AND p.id = q.id') == []
        for interpreter in (ss, slow):
            there, back, self_ = interpreter.eval(f"[{name}(a, b), {name}(b, a), {name}(a, a)];")
            assert self_ is False
            if RELATIONS[name].is_symmetric:
                assert there is back


SHAPES = [(BOX, {"halfExtents": [0.3, 0.2, 0.4]}), (SPHERE, {"radius": 0.3}),
          (CYLINDER, {"radius": 0.2, "height": 0.7}), (CAPSULE, {"radius": 0.2, "height": 0.5})]  # fmt: skip
ASKED = (
    "SELECT p.id, q.id, clearance(p, q), penetration(p, q), collides(p, q), touching(p, q, 0.01), "
    'near(p, q, 0.3), nearestPoints(p, q), "on"(p, q) '
    "FROM entities p, entities q ORDER BY ALL"
)


def twisted(turn, half):
    """A quaternion, turned about the vertical by twice an angle."""
    w, i, j, k = turn
    c, s = math.cos(half), math.sin(half)
    return c * w - s * k, c * i - s * j, c * j + s * i, c * k + s * w


@pytest.mark.slow
@settings(max_examples=5, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 10**6),
    shift=st.tuples(*[st.floats(-3, 3)] * 3),
    angle=st.floats(-math.pi, math.pi),
)
def test_moving_the_world_changes_nothing(stage, seed, shift, angle):
    """Turned about the vertical, so that what is on something stays on it."""
    random = np.random.default_rng(seed)
    world = stage.open()
    while len(world) < 6:
        kind, size = SHAPES[random.integers(len(SHAPES))]
        stage.add(f"e{len(world)}", kind, **size)
        world = stage.open()
    cos, sin = math.cos(angle), math.sin(angle)
    places = {e.name: random.uniform(-0.6, 0.6, 3) for e in world}
    turns = {e.name: random.normal(size=4) for e in world}
    found = []
    for moved in (False, True):
        poses = {}
        for name, place in places.items():
            turn = turns[name] / np.linalg.norm(turns[name])
            if moved:
                about = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
                poses[name] = [*twisted(turn, angle / 2), *(about @ place + shift)]
            else:
                poses[name] = [*turn, *place]
        with ssduck.Interpreter() as ss:
            ss.add_variable("sim", world.what_if(poses))
            found.append(ss.sql(ASKED).fetchall())
    for one, other in zip(*found, strict=True):
        for value, same in zip(one, other, strict=True):
            if isinstance(value, bool | int):
                assert value == same
            elif isinstance(value, float):
                assert value == pytest.approx(same, abs=1e-6)


def test_near_is_monotone(stage):
    random = np.random.default_rng(3)
    for n in range(12):
        kind, size = SHAPES[n % 4]
        stage.add(f"e{n}", kind, random.uniform(-1, 1, 3).tolist(), **size)
    ss, _ = stage.interpreters(sim=stage.open())
    before = set()
    for d in (0.0, 1e-6, 0.01, 0.1, 0.3, 0.31, 1.0, 5.0):
        now = set(pairs_of(ss, f"near(p, q, {d})"))
        assert before <= now
        clear = set(pairs_of(ss, f"p.id <> q.id AND clearance(p, q) <= {d}"))
        assert now == clear
        before = now
    assert len(before) == 12 * 11


# -- where others look from -------------------------------------------------------------------

# The viewer at the origin looks along +x: (position of b, relative to a, what it is)
SIDES = [
    ((1, 0.5, 0), "behind"),
    ((1, 1, 0), "behind"),
    ((1, -1, 9), "behind"),
    ((-1, 0.5, 0), "inFrontOf"),
    ((-1, -1, 0), "inFrontOf"),
    ((0.5, 1, 0), "leftOf"),
    ((1, 1 + EDGE, 0), "leftOf"),
    ((0.5, -1, 0), "rightOf"),
    ((-1, -1 - EDGE, 0), "rightOf"),
    ((0, 0, 1), None),
]


TURNED = [
    (degrees, offset, side)
    for degrees in (0, 90, -30)
    for offset, side in SIDES
    # Turned, what is a tie or nearly one is rounded to either side.
    if not degrees or side is None or abs(abs(offset[0]) - abs(offset[1])) > 1e-6
]


@pytest.fixture(scope="module")
def viewed():
    """Two boxes a and b and an eye; b and the eye are put where a test wants them."""
    made = Stage()
    made.box("a")
    made.box("b", (5, 0, 0))
    made.sphere("eye", (-9, 2, 1))
    world = made.open()
    yield *made.interpreters(sim=world), world
    made.close()


@pytest.mark.parametrize(("degrees", "offset", "side"), TURNED)
def test_sides(viewed, degrees, offset, side):
    *both, world = viewed
    angle = math.radians(degrees)
    cos, sin = math.cos(angle), math.sin(angle)
    x, y, z = offset
    world["b"].move((cos * x - sin * y, sin * x + cos * y, z))
    world["eye"].move((-9, 2, 1), (math.cos(angle / 2), 0, 0, math.sin(angle / 2)))
    names = ("behind", "inFrontOf", "leftOf", "rightOf")
    for ss in both:
        assert [n for n in names if ss.eval(f"{n}(a, b, eye);")] == [side] * (side is not None)
        assert not any(ss.eval(f"{n}(a, a, eye);") for n in names)
        rows = ss.sql(
            "SELECT behind(a, b, v), inFrontOf(a, b, v), leftOf(a, b, v), rightOf(a, b, v) FROM "
            "entities a, entities b, entities v WHERE (a.name, b.name, v.name) = ('a', 'b', 'eye')"
        ).fetchall()
        assert rows == [tuple(n == side for n in names)]


# -- forms of queries --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def row():
    """Boxes in a row: 0 and 1 collide, 1 and 2 touch, 3 is alone; all on a floor."""
    made = Stage()
    made.box("floor", (0, 0, -1), [20.0, 20.0, 0.5])
    for n, x in enumerate((0.0, 0.9, 1.9, 5.0)):
        made.box(f"b{n}", (x, 0, 0))
    world = made.open()
    ss, slow = made.interpreters(sim=world)
    for interpreter in (ss, slow):
        interpreter.add_variable("half", 0.5)
    yield ss, slow, world
    made.close()


FORMS = [
    ("SELECT id FROM sim WHERE collides(b0, this) AS list;", ["b1"]),
    ("SELECT id FROM sim WHERE collides(this, b0) AS list;", ["b1"]),
    ("SELECT to(id(p.this), 'p'), to(id(q.this), 'q') FROM p=sim, q=sim WHERE collides(p.this, q.this) AS list;",
     ["b0", "b1", "b1", "b0"]),
    ("SELECT id FROM sim WHERE NOT touching(floor, this) AS list;", ["floor"]),
    ("SELECT id FROM sim WHERE NOT touching(b1, this) AS list;", ["b1", "b3"]),
    ("SELECT id FROM sim WHERE collides(b0, this) OR id(this) == 'b3' AS list;", ["b1", "b3"]),
    ("SELECT id FROM sim WHERE collides(b0, this) XOR touching(b1, this) AS list;", ["floor", "b0", "b1", "b2"]),
    ("SELECT IF(on(floor, this); id(this); '-') FROM sim AS list;", ["-", "b0", "b1", "b2", "b3"]),
    ("SELECT id FROM p=sim WHERE count(SELECT q.this FROM q=sim WHERE collides(p.this, q.this) AS list) > 0 AS list;",
     ["b0", "b1"]),
    ("SELECT id FROM p=sim WHERE [] == (SELECT q.this FROM q=sim WHERE near(p.this, q.this, 0.5) AND NOT id(q.this) == 'floor' AS list) AS list;",
     ["b3"]),
    ("SELECT id FROM sim WHERE near(b2, this, 2.0) AND NOT touching(b2, this) AS list;", ["b0"]),
    ("SELECT id FROM sim WHERE collides(this, b0) == True AS list;", ["b1"]),
    ("SELECT id FROM sim ORDER BY clearance(b3, this), id LIMIT 3 AS list;", ["b3", "floor", "b2"]),
    *(
        (f"SELECT [id(p.this), id(q.this)] FROM p=sim, q=sim WHERE {condition} ORDER BY id(p.this), id(q.this) AS list;", expected)
        for condition, expected in (
            ("near(p.this, q.this, 1.0) AND id(p.this) < id(q.this) AND NOT 'floor' IN [id(p.this), id(q.this)]", None),
            ("near(p.this, q.this, half + 0.5)", None),
            ("near(p.this, q.this, -1)", []),
            ("near(p.this, q.this, 1e300)", None),
            ("touching(p.this, q.this)", None),
            ("touching(q.this, p.this, half)", None),
            ("on(p.this, q.this)", [["floor", "b0"], ["floor", "b1"], ["floor", "b2"], ["floor", "b3"]]),
            ("supports(q.this, p.this) AND collides(p.this, q.this)", None),
            ("contains(p.this, q.this)", None),
            ("near(p.this, q.this, 0.1) AND near(q.this, p.this, 0.1)", None),
            ("near(p.this, q.this, mass(p.this))", None),
            ("near(p.this, p.this, 0.1)", []),
        )
    ),
]  # fmt: skip


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


@pytest.mark.parametrize("condition", COMPARED + ANYWAY)
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


@pytest.mark.parametrize(("program", "expected"), FORMS)
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


# -- worlds ------------------------------------------------------------------------------------


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
    ss.sql("FROM other.shapes")
    assert other.snapshot.number > before


def test_a_world_that_goes_without_its_name_is_read(stage, client):
    stage.box("a")
    ss, _ = stage.interpreters(sim=stage.open())
    box = pybullet.createCollisionShape(BOX, halfExtents=[0.5] * 3, physicsClientId=client)
    pybullet.createMultiBody(0, box, physicsClientId=client)
    ss.add_variable("other", ssduck.World.attach(client))
    ss.sql("USE other")
    assert ss.sql("SELECT entity FROM shapes").fetchall() == [(1,)]


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
            with pytest.raises(UnsupportedError, match=r"its ticks are not recorded|at one tick"):
                ss.sql(count.format(first, second, condition))
    assert ss.sql(count.format("entities", "entities", "collides(p, q)")).fetchone() == (2,)


def test_of_several_worlds_sql_says_which(stage):
    stage.box("a")
    stage.box("b", (0.9, 0, 0))
    world = stage.open()
    ss, _ = stage.interpreters(kitchen=world)
    maybe = ss.add_variable("maybe", world.what_if({"b": [1, 0, 0, 0, 3, 0, 0]}))
    rows = "SELECT p.name FROM {0}.entities p, {0}.entities q WHERE {1}collides(p, q)"
    assert len(ss.sql(rows.format("kitchen", "kitchen.")).fetchall()) == 2
    assert ss.sql(rows.format("maybe", "maybe.")).fetchall() == []
    for name in ("collides(p, q)", "isBox(p)", "contactForce(p, q)", "solidVolume(p)"):
        with pytest.raises(SqlError, match=r"write the name of the world before it"):
            ss.sql(f"SELECT {name} FROM kitchen.entities p, kitchen.entities q")
    # One that asks only for columns is for all.
    assert len(pairs_of(ss, "overlaps(p, q)")) == 2
    assert ss.eval("SELECT id FROM maybe WHERE clearance(this, this) == 0.0 AS list;") == ["a", "b"]
    assert ss.sql(
        "SELECT maybe.clearance(p, q) FROM maybe.entities p, maybe.entities q WHERE p.id < q.id"
    ).fetchall() == [(2.0,)]
    assert maybe.snapshot.calls.pairs > 0


def test_relations_of_two_worlds(stage):
    stage.box("a")
    stage.box("b", (0.9, 0, 0))
    world = stage.open()
    other = world.what_if({"b": [1, 0, 0, 0, 3, 0, 0]})
    for ss in stage.interpreters(one=world):
        ss.add_variable("two", other)
        program = "SELECT id(p.this) FROM p=one, q=two WHERE {}(p.this, q.this) AS list;"
        with pytest.raises(SelectScriptError, match="collides: these entities are of two worlds"):
            ss.eval(program.format("collides"))
        assert ss.eval(program.format("inContact")) == []


def test_a_what_if_is_asked_of_its_own_poses(stage):
    stage.box("a")
    stage.box("b", (3, 0, 0))
    world = stage.open()
    for x in (0.5, 1.0, 1.25, 4.0):
        with ssduck.Interpreter() as ss:
            ss.add_variable("maybe", world.what_if({"b": [1, 0, 0, 0, x, 0, 0]}))
            found = ss.eval("SELECT clearance(a.this, b.this) FROM a=maybe, b=maybe AS list;")
            assert found == pytest.approx([0, max(0, x - 1), max(0, x - 1), 0])


def test_the_next_query_sees_what_was_moved(stage):
    stage.box("a")
    stage.box("b", (3, 0, 0))
    world = stage.open()
    for ss in stage.interpreters(sim=world):
        for x in (3, 0.5, 1.0, 2.0):
            world["b"].move([x, 0, 0])
            assert ss.eval("clearance(a, b);") == pytest.approx(max(0.0, x - 1), abs=1e-12)
            assert ss.eval("collides(a, b);") is (x < 1)


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


# -- kinds of shapes ---------------------------------------------------------------------------

KINDS = ("isBox", "isSphere", "isCylinder", "isCapsule", "isPlane", "isTriMesh")


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


# -- what it costs -----------------------------------------------------------------------------


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
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("count", [50, 300, 1000])
def test_only_pairs_whose_boxes_meet_are_compared(stage, count):
    world, meeting = crowd(stage, count)
    assert meeting() > count / 10
    ss, _ = stage.interpreters(sim=world)
    counter = world.snapshot.calls
    for query, apart in COSTS:
        world.tick()
        before = counter.pairs, counter.calls
        ss.sql(query).fetchall()
        assert counter.pairs - before[0] <= meeting(apart), query
        assert counter.calls - before[1] <= meeting(apart), query
        after = counter.pairs, counter.calls
        ss.sql(query).fetchall()
        assert (counter.pairs, counter.calls) == after, f"{query}: asked again in the same tick"


@sampled("count", [50, 300, 1000], every=3)
def test_selectscript_compares_only_pairs_whose_boxes_meet(stage, count):
    world, meeting = crowd(stage, count)
    counter = world.snapshot.calls
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        program = "SELECT a.this FROM a=sim, b=sim WHERE {} AS list;"
        for condition, apart in (
            ("collides(a.this, b.this)", 0.0),
            ("near(a.this, b.this, 0.1)", 0.1),
            ("touching(a.this, b.this) AND id(a.this) == 'e0'", 0.001),
        ):
            world.tick()
            before = counter.pairs, counter.calls
            ss.eval(program.format(condition))
            assert counter.pairs - before[0] <= meeting(apart)
            assert counter.calls - before[1] <= meeting(apart)
            after = counter.pairs, counter.calls
            ss.eval(program.format(condition))
            assert (counter.pairs, counter.calls) == after


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


# Where many pairs are asked about one by one, those that nobody asked about stay uncompared.
FAR = [
    ("SELECT id FROM sim WHERE near(ground, this, 2.5) AS list;", 1),
    ("SELECT id FROM sim WHERE near(ground, this, 1e9) AS list;", 1),
    ("SELECT id FROM sim WHERE near(b0, this, 20) AS list;", 1),
    ("SELECT id(p.this) FROM p=sim, q=sim WHERE nextTo(p.this, q.this) AS list;", 40),
]


@sampled(("program", "each"), FAR, every=4)
def test_few_pairs_of_a_world_with_a_ground(stage, program, each):
    random = np.random.default_rng(5)
    stage.add("ground", PLANE)
    for number, place in enumerate(random.uniform(0, 6, (300, 3)).tolist()):
        turn = random.normal(size=4)
        stage.box(f"b{number}", place, [0.15, 0.1, 0.12], turn=turn / np.linalg.norm(turn))
    world = stage.open()
    ss, _ = stage.interpreters(sim=world)
    before = world.snapshot.calls.pairs
    ss.eval(program)
    assert world.snapshot.calls.pairs - before <= 300 * each
    world.tick()
    before = world.snapshot.calls.pairs
    ss.eval(
        "SELECT id(p.this) FROM p=sim, q=sim WHERE near(p.this, q.this, z(p.this) / 8 + 0.01) AS list;"
    )
    assert world.snapshot.calls.pairs - before <= 301 * 150
    assert not world.snapshot.shapes()._narrow._results


# -- the registry, and the kitchen -------------------------------------------------------------


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


@pytest.mark.slow
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


@pytest.mark.slow
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
