"""Rows that are looked up for all pairs of a tick are those of the SQL, and of Python row by row."""

import math
import warnings

import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck.errors import LimitError, SelectScriptError
from ssduck.sql import translator
from tests.support.stage import Stage

# Boxes of half a metre at the distances from each other that the conditions name, a stack, a
# ball in a box, and a body that nothing is near.
PLACES = {
    "table": (0, 0, 0),
    "plate": (0, 0, 1.0),
    "cup": (0, 0, 2.0),
    "deep": (0.9, 0, 0),
    "near": (0, 1.1, 0),
    "Zebra": (0, -1.25, 0),
    "far": (9, 9, 9),
}
RELATIONS = (
    "collides({0}, {1})",
    "collides({0}, {1}, 0.1)",
    "collides({0}, {1}, 0)",
    "near({0}, {1}, 0.1)",
    "near({0}, {1}, gap)",
    "near({0}, {1}, whole)",
    "near({0}, {1}, 0)",
    "near({0}, {1}, z({0}))",
    "near({0}, {1}, sqrt(z({0}) + 1.5))",
    "near({0}, {1}, IF(z({0}) > 0.5; 0.5; gap))",
    "touching({0}, {1})",
    "touching({0}, {1}, 0.1)",
    "restsOn({0}, {1})",
    "on({0}, {1})",
    "above({0}, {1})",
    "below({0}, {1})",
    "within({0}, {1})",
)
SIDES = (("a", "b"), ("b", "a"), ("a.this", "b.this"), ("obj(a)", "obj(b)"))
CONDITIONS = ("", " AND id(a) < id(b)", " AND id(b) <= id(a)", " AND id(a) != id(b)")
CONDITIONS += (" AND id(a) == id(b)", " AND id(a) < id(b) AND id(b) > 'cup'", " AND z(a) > 0")
SELECTIONS = ("id(a), id(b)", "a", "b, a", "a.this, id(b.this)", "x(a), z(b), isRobot(a)", "1")
SELECTIONS += ("[id(a), 1], x(b)", "id(a) TO name, id(b)", "volume(a)", "*", "DISTINCT id(a)")
ENDS = ("", "AS list", "AS value", "AS dict", "ORDER BY id(b) AS list", "LIMIT 2 AS list")
ENDS += ("OFFSET 1 AS list", "GROUP BY id(a) AS list")


def fill(stage):
    for name, place in PLACES.items():
        stage.box(name, place, half=0.25 if name == "far" else 0.5)
    stage.sphere("ball", (0, 0, 1.2), radius=0.25)


@pytest.fixture(scope="module")
def ways():
    """Interpreters of the same world, by how they run: looked up, by SQL, row by row."""
    stage = Stage()
    fill(stage)
    world = stage.open()
    looked_up, row_by_row = stage.interpreters(w=world)
    by_sql, _ = stage.interpreters(w=world)
    for ss in (looked_up, row_by_row, by_sql):
        ss.add_variable("gap", 0.125)
        ss.add_variable("whole", 1)
    yield {"looked up": looked_up, "SQL": by_sql, "row by row": row_by_row}
    stage.close()


def outcome(ss, program):
    """Returns the value of a program with the types in it, or its error."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            value = ss.eval(program)
    except SelectScriptError as error:
        return type(error), str(error)
    return typed(value)


def typed(value):
    if isinstance(value, list):
        return [typed(part) for part in value]
    if isinstance(value, dict):
        return [(typed(key), typed(part)) for key, part in value.items()]
    if isinstance(value, float) and math.isnan(value):
        return float, "nan"
    return type(value), value


def outcomes(ways, program):
    """Returns what a program comes to, by the way; the SQL is that without a look-up."""
    result = {name: outcome(ss, program) for name, ss in ways.items() if name != "SQL"}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(translator, "pair_lookup", lambda *_: None)
        result["SQL"] = outcome(ways["SQL"], program)
    return result


programs = st.builds(
    lambda relation, sides, condition, selection, end: (
        f"SELECT {selection} FROM a=w, b=w WHERE {relation.format(*sides)}{condition} {end};"
    ),
    *map(st.sampled_from, (RELATIONS, SIDES, CONDITIONS, SELECTIONS, ENDS)),
)


@pytest.mark.slow
@given(programs)
def test_ways_agree(ways, program):
    results = outcomes(ways, program)
    assert results["looked up"] == results["SQL"], program
    assert results["looked up"] == results["row by row"], program


@pytest.mark.parametrize("relation", RELATIONS)
@pytest.mark.parametrize("sides", SIDES[:2])
def test_each_relation_in_both_orders(ways, relation, sides):
    query = f"SELECT id(a), id(b) FROM a=w, b=w WHERE {relation.format(*sides)} AS list;"
    results = outcomes(ways, query)
    assert results["looked up"] == results["SQL"] == results["row by row"]
    assert results["looked up"]


def test_what_rests_on_the_other_follows_the_order_of_the_arguments(ways):
    ss = ways["looked up"]
    above = ss.eval("SELECT id(b) FROM a=w, b=w WHERE restsOn(a, b) AND id(a) == 'plate' AS list;")
    below = ss.eval("SELECT id(b) FROM a=w, b=w WHERE restsOn(b, a) AND id(a) == 'plate' AS list;")
    assert above == ["cup", "ball"]
    assert below == ["table"]


@pytest.mark.slow
@pytest.mark.parametrize("depth", ["-1", "0 - 1", "below"])
def test_errors_are_those_of_the_sql(ways, depth):
    for ss in ways.values():
        ss.add_variable("below", -0.5)
    query = f"SELECT id(a), id(b) FROM a=w, b=w WHERE collides(a, b, {depth}) AS list;"
    results = outcomes(ways, query)
    assert results["looked up"] == results["SQL"]
    assert "depth" in results["looked up"][1]


@pytest.mark.slow
def test_a_parameter_may_change_its_value_and_its_type(ways):
    query = "SELECT id(b) FROM a=w, b=w WHERE near(a, b, far_away) AND id(a) <= id(b) AS list;"
    for value, count in ((0.0, None), (0.25, None), (100, 28), (math.inf, None), (None, None)):
        for ss in ways.values():
            ss.add_variable("far_away", value)
        results = outcomes(ways, query)
        assert results["looked up"] == results["SQL"] == results["row by row"]
        assert count is None or len(results["looked up"]) == count


@pytest.mark.slow
def test_limits_count_the_rows():
    stage = Stage()
    fill(stage)
    world = stage.open()
    with ssduck.Interpreter(limits=ssduck.Limits(rows=3)) as ss:
        ss.add_variable("w", world)
        with pytest.raises(LimitError):
            ss.eval("SELECT id(a) FROM a=w, b=w WHERE near(a, b, 0.2);")
        assert len(ss.eval("SELECT id(a) FROM a=w, b=w WHERE collides(a, b, 0.2);")) == 2
    stage.close()


@pytest.mark.slow
def test_bodies_come_and_go():
    stage = Stage()
    fill(stage)
    world = stage.open()
    query = "SELECT id(a), id(b) FROM a=w, b=w WHERE collides(a, b) AND id(a) < id(b) AS list;"
    with ssduck.Interpreter() as ss:
        ss.add_variable("w", world)
        before = ss.eval(query)
        added = stage.box("new", (9.2, 9, 9), half=0.25)
        world.tick()
        angles = {"min_angle": 0, "max_angle": 90, "resolution": 2}
        world.add_sensor("planar_laser", world["table"], max_range=1.0, **angles)
        world.tick()
        assert sorted(ss.eval(query)) == sorted([*before, "body_8", "far"])
        pybullet.removeBody(added, stage.client)
        world.tick()
        assert ss.eval(query) == before
    stage.close()
