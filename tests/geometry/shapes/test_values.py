"""Values and edges of the relations of shapes."""

import math

import numpy as np
import pytest

from ssduck.sql.relations.registry import RELATIONS
from tests.support.cases import sampled
from tests.support.shape_cases import EDGE, HOLDS, TURNED, approx
from tests.support.stage import Stage, pairs_of

# -- values, and the edges -----------------------------------------------------------------------


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


@sampled(("expression", "position", "value"), VALUES, every=3)
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
    ("hasContact(a, b)", (0.5, 0, 0), False),
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


@pytest.mark.slow
@sampled(("condition", "position", "holds"), EDGES, every=2)
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


@pytest.mark.slow
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


# -- where others look from ----------------------------------------------------------------------


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


@pytest.mark.slow
@sampled(("degrees", "offset", "side"), TURNED, every=3)
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
