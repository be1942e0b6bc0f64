"""The relations: each registered one is complete, the same in both languages, and exact at its edges."""

import math

import numpy as np
import pybullet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlglot import exp

import ssduck
from ssduck.errors import UnknownNameError
from ssduck.geometry.queries import ShapeQueries
from ssduck.schema import TABLES
from ssduck.sql.relations.geometry_query import GeometryQuery
from ssduck.sql.relations.registry import RELATIONS, geometry_udfs
from ssduck.sql.relations.relation import Parameter
from ssduck.sql.relations.shapes import shape_relation
from tests.support.cases import sampled
from tests.support.stage import Stage

EDGE = 1e-9


def boxes(*places):
    """A world of boxes: (name, half extents, position); the first is at hand as variable `a`."""
    stage = Stage()
    for name, halves, position in places:
        stage.box(name, position, halves)
    return stage.client, stage.open()


@pytest.fixture(scope="module")
def pair():
    """Two boxes a and b; b is put where a test wants it."""
    client, world = boxes(("a", [1.0, 2.0, 0.5], [0, 0, 0.5]), ("b", [0.1] * 3, [0, 0, 0]))
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        ss.eval("a = SELECT obj FROM sim WHERE id(this) == 'a' AS value;")
        yield ss, world["b"]
    pybullet.disconnect(client)


# The box of a reaches from (-1, -2, 0) to (1, 2, 1). (relation, position of b, holds)
EDGES = [
    ("above", (0, 0, 1 + EDGE), True),
    ("above", (0, 0, 1), True),
    ("above", (0, 0, 1 - EDGE), False),
    ("above", (1, 2, 1), True),
    ("above", (-1, -2, 5), True),
    ("above", (1 + EDGE, 0, 1), False),
    ("above", (-1 - EDGE, 0, 1), False),
    ("above", (0, 2 + EDGE, 1), False),
    ("above", (0, -2 - EDGE, 1), False),
    ("below", (0, 0, 0.5 - EDGE), True),
    ("below", (0, 0, 0.5), False),
    ("below", (0, 0, 0.5 + EDGE), False),
    ("below", (1, 2, -3), True),
    ("below", (1 + EDGE, 0, 0), False),
    ("below", (0, -2 - EDGE, 0), False),
    ("within", (0, 0, 0.5), True),
    ("within", (1 - EDGE, 2 - EDGE, 1 - EDGE), True),
    ("within", (-1 + EDGE, -2 + EDGE, EDGE), True),
    ("within", (1, 0, 0.5), False),
    ("within", (-1, 0, 0.5), False),
    ("within", (0, 2, 0.5), False),
    ("within", (0, 0, 1), False),
    ("within", (0, 0, 0), False),
    ("within", (0, 0, 1 + EDGE), False),
]


@pytest.mark.parametrize(("relation", "position", "holds"), EDGES)
def test_edges(pair, relation, position, holds):
    ss, b = pair
    b.move(position)
    assert ss.eval(f"SELECT id FROM sim WHERE {relation}(a, this) AS list;") == ["b"] * holds
    assert (
        ss.eval(
            f"SELECT id(q.this) FROM p=sim, q=sim WHERE {relation}(p.this, q.this) AND p.this == a AS list;"
        )
        == ["b"] * holds
    )
    rows = ss.sql(
        f"SELECT b.name FROM entities a, entities b WHERE a.name = 'a' AND {relation}(a, b)"
    ).fetchall()
    assert rows == [("b",)] * holds


def test_values_of_an_entity(pair):
    ss, b = pair
    turn = np.array([0.5, -0.5, 0.5, 0.5])
    b.move([0.3, -0.2, 4.0], turn)
    program = (
        "SELECT id, type, obj, position, x, y, z, orientation, pose, volume, aabbVolume, "
        "isEnabled, isVisible, environmentID, isRobot, isSensor, isKinbody, robot, kinbody, "
        "gravityMode, rot "
        "FROM sim WHERE id(this) == 'b';"
    )
    (found,) = ss.eval(program)
    expected = {
        "id": "b", "type": "kinbody", "obj": b, "position": [0.3, -0.2, 4.0], "x": 0.3, "y": -0.2,
        "z": 4.0, "orientation": [0.5, -0.5, 0.5, 0.5],
        "pose": [0.5, -0.5, 0.5, 0.5, 0.3, -0.2, 4.0], "volume": 0.001, "aabbVolume": 0.008,
        "isEnabled": True, "isVisible": True, "environmentID": b.id, "isRobot": False,
        "isSensor": False, "isKinbody": True, "robot": None, "kinbody": b,
        "gravityMode": False, "rot": [[0, -1, 0], [0, 0, 1], [-1, 0, 0]],
    }  # fmt: skip
    assert list(found) == list(expected)
    if found["orientation"][0] < 0:  # q and -q are the same orientation
        found["orientation"] = [-number for number in found["orientation"]]
        found["pose"][:4] = found["orientation"]
    for name, value in expected.items():
        if isinstance(value, float | list):
            assert np.array(found[name]) == pytest.approx(np.array(value), abs=1e-6), name
        else:
            assert found[name] == value, name


POINTS = st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(POINTS, POINTS)
def test_distance_is_symmetric_and_that_of_math(pair, p, q):
    ss, _ = pair
    ss.add_variable("p", p)
    ss.add_variable("q", q)
    there, back = ss.eval("[distance(p, q), distance(q, p)];")
    assert there == back == pytest.approx(math.dist(p, q), rel=1e-12)


def oracle(relation, a, b):
    """The definitions of the manual, as a loop over getters would have them."""
    (low, high), (x, y, z) = a.aabb, b.position
    footprint = low[0] <= x <= high[0] and low[1] <= y <= high[1]
    if relation == "above":
        return footprint and z >= high[2]
    if relation == "below":
        return footprint and z < (low[2] + high[2]) / 2
    return all(lo < value < hi for lo, value, hi in zip(low, b.position, high, strict=True))


@pytest.mark.slow
@sampled("relation", ["above", "below", "within"], every=3)
def test_random_scenes_agree_with_a_loop(relation):
    random = np.random.default_rng(7)
    places = [
        (f"box_{i}", random.uniform(0.1, 1.0, 3).tolist(), random.uniform(-1.5, 1.5, 3).tolist())
        for i in range(40)
    ]
    client, world = boxes(*places)
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        expected = [
            (a.name, b.name) for a in world for b in world if a != b and oracle(relation, a, b)
        ]
        assert len(expected) > 20
        program = (
            f"SELECT to(id(a.this), 'a'), to(id(b.this), 'b') FROM a=sim, b=sim "
            f"WHERE {relation}(a.this, b.this);"
        )
        assert [(row["a"], row["b"]) for row in ss.eval(program)] == expected
        rows = ss.sql(f"SELECT a.name, b.name FROM entities a, entities b WHERE {relation}(a, b)")
        assert sorted(rows.fetchall()) == sorted(expected)
    pybullet.disconnect(client)


# -- the registry -------------------------------------------------------------------------------


@pytest.mark.parametrize("relation", RELATIONS.values(), ids=lambda r: r.name)
def test_every_relation_is_complete(relation, pair):
    ss, _ = pair
    assert relation.about.endswith(".")
    assert relation.help.splitlines()[-1] == f"Usage: {relation.usage}"
    assert ss.eval(f"help('{relation.name}');") == f"{relation.name}\n{relation.help}"
    assert all(parameter.meaning for parameter in relation.parameters)
    assert relation.required_count in relation.expressions
    # It is a function of rows in raw SQL, too; position needs quotes, being a word of SQL's.
    required = relation.parameters[: relation.required_count]
    values = {"double": "0.5", "string": "'lid'"}
    arguments = ", ".join(values.get(p.type, "aba"[n]) for n, p in enumerate(required))
    statement = f'SELECT "{relation.name}"({arguments}) FROM entities a, entities b'
    if relation.name == "joint":  # these boxes have none
        with pytest.raises(UnknownNameError, match="no entity of 'sim' has a joint 'lid'"):
            ss.sql(statement)
        return
    assert len(ss.sql(statement).fetchall()) == 4


@pytest.mark.parametrize("relation", RELATIONS.values(), ids=lambda r: r.name)
def test_a_formula_reads_its_parameters_only(relation):
    """Any other name would be that of a row or a column of the query around it."""
    rows = {p.name for p in relation.parameters if p.type in ("entity", "place")}
    values = {p.name for p in relation.parameters} - rows
    columns = {column.name for column in TABLES["entities"].columns}
    for formula in relation.expressions.values():
        for column in formula.find_all(exp.Column):
            if column.find_ancestor(exp.Select) is not None:
                continue
            if column.table:
                assert column.table in rows, column.sql()
                assert column.name in columns, column.sql()
            else:
                assert column.name in values, column.sql()


def wrong_relation(result="boolean", names="ab", **query):
    parameters = tuple(Parameter(name, "entity", "an entity") for name in names)
    relation = shape_relation(
        "wrong", result, GeometryQuery(**query), "Is wrong.", parameters=parameters
    )
    return geometry_udfs([*RELATIONS.values(), relation])


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"result": "double", "function": ShapeQueries.clearance}, "wrong: state `otherwise`"),
        ({"result": "string", "function": ShapeQueries.on, "otherwise": "''"}, "not string"),
        ({"names": "pq", "function": ShapeQueries.on}, "are called a and b"),
        ({"function": ShapeQueries.near}, "describes 'narrow near' differently"),
    ],
)
def test_a_wrong_entry_of_shapes_is_an_error(entry, message):
    with pytest.raises(ValueError, match=message):
        wrong_relation(**entry)
