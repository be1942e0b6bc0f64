"""Where SQL has other ideas than Python: infinities, what is no number, names that SQL folds."""

import math
from contextlib import contextmanager

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import RemovedEntityError
from ssduck.interpreter import query_runner as queries
from tests.support.cases import sampled
from tests.support.stage import PLANE, Stage

EVALUATORS = {"SQL": {}, "row by row": {"row_by_row": True}}


@contextmanager
def opened(evaluator):
    """A ground plane, whose box is infinite, and two boxes; short lists become SQL, too."""
    with Stage() as stage, pytest.MonkeyPatch.context() as patch:
        patch.setattr(queries, "FEW_ROWS", 0)
        stage.add("ground", PLANE)
        stage.box("low", (0, 0, 0.5))
        stage.box("high", (3, 0, 2.5))
        with ssduck.Interpreter(**EVALUATORS[evaluator]) as interpreter:
            interpreter.add_variable("w", stage.open())
            yield interpreter


@pytest.fixture(params=EVALUATORS)
def ss(request):
    with opened(request.param) as interpreter:
        yield interpreter


@pytest.fixture(scope="module", params=EVALUATORS)
def steady(request):
    """The same for programs that change nothing."""
    with opened(request.param) as interpreter:
        yield interpreter


NAN = math.nan
# (program, value)
NO_NUMBERS = [
    # The plane's box less itself, and what DuckDB would say of it: NaN is equal, and greatest.
    ("SELECT aabbVolume(this) - aabbVolume(this) FROM w AS list;", [NAN, 0.0, 0.0]),
    ("SELECT id FROM w WHERE aabbVolume(this) - aabbVolume(this) > 0 AS list;", []),
    ("SELECT id FROM w WHERE aabbVolume(this) - aabbVolume(this) == 0 AS list;", ["low", "high"]),
    ("SELECT id FROM w WHERE aabbVolume(this) - aabbVolume(this) != 0 AS list;", ["ground"]),
    ("SELECT id FROM w WHERE 1 < aabbVolume(this) / aabbVolume(this) AS list;", []),
    ("SELECT id FROM w WHERE aabbVolume(this) * 0 >= 0 AS list;", ["low", "high"]),
    ("SELECT id FROM w WHERE aabbVolume(this) * 2 >= 1 AS list;", ["ground", "low", "high"]),
    ("SELECT id FROM w WHERE aabbVolume(this) % 3 <= 5 AS list;", ["low", "high"]),
    ("SELECT id FROM w WHERE 2 % aabbVolume(this) == 2 AS list;", ["ground"]),
    (
        "SELECT id FROM w WHERE (aabbVolume(this) - aabbVolume(this)) IN [0, 1] AS list;",
        ["low", "high"],
    ),
    ("SELECT id FROM w WHERE aabbVolume(this) - 5 > 0 AS list;", ["ground"]),
    (
        "SELECT id FROM w WHERE sum([aabbVolume(this), -aabbVolume(this)]) == 0 AS list;",
        ["low", "high"],
    ),
    # Reals that grow beyond all others.
    ("SELECT this * 1e308 * 10 - this * 1e308 * 10 == 0 FROM [0.05, 5.5] AS list;", [True, False]),
    ("SELECT this * 1e308 * 10 > 1e308 FROM [0.5, 5.5] AS list;", [True, True]),
    (
        "SELECT max(SELECT a.this * 1e308 * 10 FROM a=[0.5, 5.5] AS list) FROM b=[1] AS list;",
        [math.inf],
    ),
]


@sampled(("program", "value"), NO_NUMBERS, every=3)
def test_no_numbers_compare_as_in_python(steady, program, value):
    assert repr(steady.eval(program)) == repr(value)


@pytest.mark.parametrize("function", ["sin", "cos", "tan"])
def test_no_angle_is_infinite(steady, function):
    with pytest.raises(ssduck.SelectScriptError, match="does not take inf"):
        steady.eval(f"SELECT {function}(aabbVolume(this)) FROM w AS list;")
    finite = steady.eval(
        f"SELECT {function}(aabbVolume(this)) FROM w WHERE id(this) == 'low' AS list;"
    )
    assert finite == [getattr(math, function)(1.0)]


OF_STATES = [
    f"START WITH {n} = 0 CONNECT BY {n} = {n} + this STOP WITH {n} + this >= 3"
    for n in ("counted", "place", "found", "paths", "steps", "item", "PLACE")
]
OF_STATES += ["START WITH a = 0, A = 1 CONNECT BY a = A, A = a + this STOP WITH a + A + this >= 4"]


@pytest.mark.parametrize("states", OF_STATES)
def test_states_may_have_any_name(steady, states):
    assert steady.eval(f"SELECT this FROM [1, 2] {states} AS list;") == [
        [1, 1, 1],
        [1, 1, 2],
        [1, 2],
        [2, 1],
        [2, 2],
    ]


@pytest.mark.parametrize("how", ["", "MEMORIZE 3"])
def test_a_graph_may_have_such_states_too(ss, how):
    found = [
        ss.eval(
            f"SELECT this, {name} FROM [1, 2] START WITH {name} = 0 CONNECT BY {how} "
            f"{name} = {name} + this STOP WITH {name} + this >= 3 AS list;"
        )
        for name in ("level", "found", "place")
    ]
    assert found[0] == found[1] == found[2]
    assert found[0]


def test_a_list_of_zeros_that_change_their_sign(ss):
    """A list that stays the same is written into the statement; 0.0 == -0.0."""
    program = ss.compile("SELECT n.this FROM w=w, n=zeros AS list;")
    for sign in ("", "", "-", "-", ""):
        ss.eval(f"zeros = [{sign}0.0, {sign}0.0];")
        assert repr(ss.eval(program)) == repr([float(f"{sign}0.0")] * 6)


def test_numbers_of_numpy_in_lists(ss):
    ss.add_variable("numbers", [np.float64(0.5), np.float64(1e300), np.float64(3)])
    program = ss.compile("SELECT n.this FROM w=w, n=numbers WHERE n.this < 1e200 AS list;")
    for _ in range(4):
        assert ss.eval(program) == [0.5, 3.0] * 3


@pytest.mark.parametrize("sign", "%^")
def test_long_chains_do_not_grow_without_end(ss, sign):
    other = "7.5" if sign == "%" else "1"
    chain = f" {sign} ".join(["n.this", *[other] * 40])
    program = f"SELECT {chain} FROM w=w, n=[3.5] AS list;"
    assert ss.eval(program) == [3.5] * 3
    assert len(ss.explain(program)) < 20_000


@sampled(
    ("program", "value"),
    [
        ("SELECT id FROM w WHERE this == gone AS list;", []),
        ("SELECT id FROM w WHERE this != gone AS list;", ["ground", "low"]),
        ("SELECT id FROM w WHERE this IN [gone] AS list;", []),
        ("SELECT id FROM w WHERE this IN both AS list;", ["low"]),
        ("SELECT id FROM w WHERE gone AS list;", ["ground", "low"]),
        ("SELECT count(this) FROM [gone, gone] AS list;", None),
        ("SELECT this == kept FROM both AS list;", [False, True]),
    ],
    every=3,
)
def test_what_is_gone_is_equal_to_nothing_else(ss, program, value):
    kept, gone = ss.eval("SELECT obj FROM w WHERE id(this) IN ['low', 'high'] AS list;")
    world = ss.call_variable("w")
    pybullet.removeBody(2, physicsClientId=world.simulator.client)
    world.tick()
    ss.add_variable("gone", gone)
    ss.add_variable("kept", kept)
    ss.add_variable("both", [gone, kept])
    if value is None:
        with pytest.raises(ssduck.SelectScriptError, match="count"):
            ss.eval(program)
    else:
        assert ss.eval(program) == value


@pytest.mark.parametrize(
    "program",
    [
        "z(gone);",
        "SELECT z(this) FROM [gone];",
        *(
            f"SELECT {call} FROM w AS list;"
            for call in ("z(gone)", "id(gone)", "above(gone, this)", "above(this, gone)")
        ),
    ],
)
def test_what_is_gone_has_no_relations(ss, program):
    gone = ss.eval("SELECT obj FROM w WHERE id(this) == 'high' AS value;")
    world = ss.call_variable("w")
    pybullet.removeBody(2, physicsClientId=world.simulator.client)
    world.tick()
    ss.add_variable("gone", gone)
    with pytest.raises(RemovedEntityError, match="'high' is no longer in world 'w'") as caught:
        ss.eval(program)
    if "[gone]" not in program:
        span = caught.value.span
        assert program[span.start : span.end] == "gone"


def test_rows_keep_their_order_beside_a_nested_query(ss):
    ss.add_variable("records", [{"k": k, "r": r} for k, r in ((1.0, 5), (-7.0, 3), (3.5, 1))] * 20)
    found = ss.eval(
        "SELECT a.this['r'], count(SELECT id FROM w WHERE z(this) < a.this['k'] AS list) FROM a=records AS list;"
    )
    assert found == [5, 2, 3, 0, 1, 3] * 20


def test_hundreds_of_sources(ss):
    assert ss.eval(f"SELECT n.this FROM n=[1, 2], {', '.join(['1'] * 300)} AS list;") == [1, 2]


# What SQL would leave out, or look at in another order: an error in it is one on both ways.
LEFT_OUT = [
    "SELECT this FROM l WHERE this IN [this, 1/(this-1)] AS list;",
    "SELECT this FROM l WHERE [this, 1/(this-1)][0] < 3 AS list;",
    "SELECT this FROM l WHERE NOT [1/(this-1)] AS list;",
    "SELECT IF([1/(this-1)]; 1; 2) FROM l AS list;",
    "SELECT a.this FROM a=l WHERE 1/(a.this-1) IN (SELECT b.this FROM b=[a.this] WHERE b.this > 1000 AS list) AS list;",
    "SELECT a.this FROM a=l WHERE (SELECT 1/p.this FROM p=[a.this+5, a.this-1] AS value) > 0 AS list;",
    "SELECT (SELECT p.this FROM p=[a.this, 1/(a.this-1)] AS value) FROM a=l AS list;",
    "SELECT count(SELECT p.this FROM p=[a.this, 1/(a.this-1)] AS list) FROM a=l AS list;",
    "SELECT a.this FROM a=l WHERE a.this IN (SELECT p.this FROM p=[a.this, a.this-1] WHERE 1/p.this > 0 AS list) AS list;",
]


def test_a_key_that_orders_nothing_may_be_an_error(ss):
    program = "SELECT (SELECT 5 FROM b=l ORDER BY [0.5, 1.5][a.this] AS value) FROM a=[{}] AS list;"
    ss.add_variable("l", [1.0, 2.0])
    assert ss.eval(program.format("0, 1")) == [5, 5]
    with pytest.raises(ssduck.SelectScriptError, match="no element 2"):
        ss.eval(program.format("0, 2"))


@pytest.mark.parametrize("program", LEFT_OUT)
def test_what_sql_would_leave_out_is_an_error_too(steady, program):
    steady.add_variable("l", [float(number) for number in range(1, 100)])
    with pytest.raises(ssduck.SelectScriptError, match="division by zero"):
        steady.eval(program)


@pytest.mark.parametrize(
    ("program", "value"),
    [
        (
            "SELECT (SELECT s+q.this FROM q=[1,2] AS list) FROM [1,2] START WITH s=0 "
            "CONNECT BY s=s+1 STOP WITH s==1 LIMIT 1 AS list;",
            [[[1, 2], [2, 3]]],
        ),
        (
            "SELECT p.this FROM p=[1] WHERE 5 IN (SELECT z FROM q=w AS list) START WITH z=5 "
            "CONNECT BY z=z+1 STOP WITH z==6 LIMIT 1 AS list;",
            [[1]],
        ),
    ],
)
def test_nested_queries_see_the_states_by_their_names(steady, program, value):
    assert steady.eval(program) == value


@pytest.mark.parametrize(
    ("program", "value"),
    [
        ("SELECT [{n}]==[{n}] FROM a=l LIMIT 1 AS list;", [False]),
        ("SELECT {n} IN [1.0, {n}] FROM a=l LIMIT 1 AS list;", [False]),
        ("SELECT count(uniq([{n}, {n}])) FROM a=l LIMIT 1 AS list;", [2]),
    ],
)
def test_one_that_is_no_number_is_not_another(steady, program, value):
    steady.add_variable("l", [1e308] * 80)
    assert steady.eval(program.format(n="(a.this*10-a.this*10)")) == value


def test_a_name_in_a_nested_query_that_becomes_a_variable(ss):
    program = ss.compile("SELECT (SELECT z FROM q=w LIMIT 1 AS value) FROM w AS list;")
    assert ss.eval(program) == [0.0] * 3
    ss.eval("z = 7;")
    assert ss.eval(program) == [7] * 3
