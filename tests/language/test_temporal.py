"""Variables with a history: what is kept, what is given of it, in both evaluators."""

import math

import numpy as np
import pybullet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import ssduck
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    FunctionError,
    ParseError,
    UnknownNameError,
)
from ssduck.interpreter import query_runner as queries
from ssduck.language.parser import parse
from ssduck.language.value_history import SAME_TIME, ValueHistory, past_value, with_assignment
from tests.support.bodies import solid
from tests.support.cases import sampled

STEP = 0.25


def box_world(client, name="w"):
    """A world of one box whose steps take a quarter of a second."""
    pybullet.setTimeStep(STEP, client)
    pybullet.setGravity(0, 0, 0, client)
    body = solid(client, pybullet.GEOM_BOX, 1.0, [0, 0, 0.5], halfExtents=[0.1] * 3)
    return ssduck.World.attach(client, name=name, names={body: "box"})


@pytest.fixture(params=[False, True], ids=["sql", "rows"])
def ss(request, client, monkeypatch):
    """An interpreter of each kind; lists are sources of SQL, however short."""
    monkeypatch.setattr(queries, "FEW_ROWS", 0)
    with ssduck.Interpreter(row_by_row=request.param) as interpreter:
        interpreter.add_variable("w", box_world(client))
        yield interpreter


def run(ss, *script):
    """Run programs, and step by so many seconds between them."""
    for part in script:
        if isinstance(part, str):
            ss.eval(part)
        else:
            ss.call_variable("w").step(round(part / STEP))


# 'a' at 0.5 s, 'b' at 1 s, 'c' at 2 s; it is 3 s.
ABC = (
    *("v{H} = 'x';", "clear('v');", 0.5),
    *("v{H} = 'a';", 0.5, "v{H} = 'b';", 1.0, "v{H} = 'c';", 1.0),
)


# (horizon, program, value)
GIVEN = [
    # all that is kept, the horizon included
    ("", "v{};", ["a", "b", "c"]),
    ("10", "v{};", ["a", "b", "c"]),
    ("2.5", "v{};", ["a", "b", "c"]),
    ("2.499", "v{};", ["b", "c"]),
    ("2", "v{};", ["b", "c"]),
    ("1.999", "v{};", ["c"]),
    ("1", "v{};", ["c"]),
    ("0.999", "v{};", []),
    ("0", "v{};", []),
    ("1 + 1.0", "v{};", ["b", "c"]),
    # the variable itself
    ("", "v;", "c"),
    ("0", "v;", "c"),
    ("0", "var('v') + v;", "cc"),
    # the last seconds
    ("", "v{-1};", ["c"]),
    ("", "v{-0.999};", []),
    ("", "v{-1.999};", ["c"]),
    ("", "v{-2.0};", ["b", "c"]),
    ("", "v{-2.001};", ["b", "c"]),
    ("", "v{-2.5};", ["a", "b", "c"]),
    ("", "v{-1000};", ["a", "b", "c"]),
    ("2", "v{-1000};", ["b", "c"]),
    ("2", "v{-1.5};", ["c"]),
    # the value in force at a time
    ("", "v{0.5};", "a"),
    ("", "v{0.999};", "a"),
    ("", "v{1};", "b"),
    ("", "v{1.0};", "b"),
    ("", "v{1.999};", "b"),
    ("", "v{2};", "c"),
    ("", "v{getTime()};", "c"),
    ("", "v{getTime() - 1.5};", "b"),
    # in the future
    ("", "v{1000};", "c"),
    ("0", "v{1000};", "c"),
    # before the horizon one older value is kept for it
    ("1.5", "v{};", ["c"]),
    ("1.5", "v{1.5};", "b"),
    ("0.5", "v{2.5};", "c"),
    ("0", "v{3};", "c"),
    # in queries: sources
    ("", "SELECT this FROM v{} AS list;", ["a", "b", "c"]),
    ("", "SELECT x.this FROM x = v{-2.0} AS list;", ["b", "c"]),
    ("", "SELECT v.this, x.this FROM v{-1}, x=v{-2} AS list;", ["c", "b", "c", "c"]),
    ("", "SELECT this FROM v{1} AS list;", ["b"]),
    ("", "SELECT this FROM v AS list;", ["c"]),
    ("0", "SELECT this FROM v{} AS list;", []),
    # in the clauses
    ("", "SELECT this FROM ['a', 'b'] WHERE this == v{1} AS list;", ["b"]),
    ("", "SELECT this FROM ['a', 'b', 'd'] WHERE NOT this IN v{} AS list;", ["d"]),
    ("", "SELECT v{1} FROM [1, 2] AS list;", ["b", "b"]),
    ("", "SELECT v{1}, this FROM [1];", [{"v": "b", "this": 1}]),
    ("", "SELECT to(v{1}, v{2}) FROM [1];", [{"c": "b"}]),
    ("", "SELECT v{this} FROM [2.5, 0.75, 1] AS list;", ["c", "a", "b"]),
    ("", "SELECT this FROM [2.5, 0.75, 1] WHERE v{this} != 'a' AS list;", [2.5, 1]),
    ("", "SELECT this FROM [2.5, 0.75, 1] ORDER BY v{this} AS list;", [0.75, 1, 2.5]),
    ("", "SELECT this FROM [-2, -1] ORDER BY count(v{this}) AS list;", [-1, -2]),
    ("", "SELECT this FROM [2.5, 0.75, 1, 3] GROUP BY v{this} AS list;", {"c": [2.5, 3], "a": [0.75], "b": [1]}),
    ("", "SELECT id FROM w WHERE z(this) < count(v{}) AND v{z(this)} == 'a' AS list;", ["box"]),
    ("", "SELECT v{z} FROM w AS list;", ["a"]),
    ("", "SELECT this FROM [1, 2, 3] LIMIT count(v{-1}) AS list;", [1]),
    ("", "SELECT this FROM [0] WHERE this > 0 AS value(v{1});", "b"),
    # in nested and hierarchical ones
    ("", "SELECT x.this FROM x=v{} WHERE 1 < count(SELECT y.this FROM y=v{} WHERE y.this >= x.this AS list) AS list;", ["a", "b"]),
    ("", "SELECT t.this FROM t=[1, 2] WHERE 'b' IN (SELECT y.this FROM y=v{-t.this} AS list) AS list;", [2]),
    ("", "SELECT t.this FROM t=[1, 2] WHERE 'b' == (SELECT v{t.this} FROM y=[1] AS value) AS list;", [1]),
    ("", "SELECT this FROM v{-2} START WITH s = v{0.5} CONNECT BY s = v{1} STOP WITH s == v{1} AS list;", [["b", "b"], ["b", "c"], ["c", "b"], ["c", "c"]]),
    ("", "SELECT this FROM [1.0, 2.0] START WITH s = 0 CONNECT BY s = s + this STOP WITH v{s + this} == 'c' AS list;", [[1.0, 1.0], [1.0, 2.0], [2.0]]),
    # elsewhere
    ("", "[v{1}, v{2}];", ["b", "c"]),
    ("", "u = v{}; clear('v'); u;", ["a", "b", "c"]),
    ("", "eval('v{1}');", "b"),
    ("", "IF(v{1} == 'b'; v{-1}; v{});", ["c"]),
    ("", "count(v{}[0]) + 0;", 1),
    ("3", "v{} = 'd'; v{};", ["a", "b", "c", "d"]),
]  # fmt: skip


@sampled(("horizon", "program", "value"), GIVEN, every=5)
def test_what_is_given(ss, horizon, program, value):
    run(ss, *(part.replace("H", horizon) if isinstance(part, str) else part for part in ABC))
    assert ss.eval(program) == value


# (script, program, value)
KEPT = [
    # each run adds one, of the same time too; the last of them is in force
    (["v{0} = 1; v{0} = 2; v{0} = 3;"], "[v{}, v{0}];", [[1, 2, 3], 3]),
    (["v{0} = 1;", 0.25], "[v{}, v, v{0.25}];", [[], 1, 1]),
    # 0, however it is written, is the beginning of simulated time
    (["v{} = 1;", 1, "v{} = 2;"], "[v{0}, v{0.0}, v{-0.0}, v{-0}, v{1 - getTime()}];", [1, 1, 1, 1, 1]),
    (["v{} = 1; v{} = 1;", 0.25, "v{} = 1;"], "v{};", [1, 1, 1]),
    (["v{} = u{} = 1; v{} = (u{} = 2) + 1;"], "[u{}, v{}];", [[1, 2], [1, 3]]),
    # a plain assignment makes a plain variable, and begins anew
    (["v{} = 1; v = 2; v{} = 3;"], "v{};", [3]),
    (["v = 1;", 1, "v{} = 2;"], "v{};", [2]),
    (["v{} = 1; clear('v'); v{} = 2;"], "v{};", [2]),
    (["v{} = 1; clear(); v{} = 2;"], "v{};", [2]),
    # a horizon counts from its assignment on
    (["v{} = 1;", 1, "v{} = 2;", 1, "v{1.5} = 3;"], "v{};", [2, 3]),
    (["v{} = 1;", 1, "v{} = 2;", 1, "v{0.5} = 3; v{} = 4;"], "v{};", [2, 3, 4]),
    (["v{} = 1;", 1, "v{} = 2;", 1, "v{0.5} = 3; v{} = 4;"], "v{1.5};", 2),
    (["v{0.25} = 1;", 1, "v{0.25} = 2;", 1, "v{} = 3;"], "v{};", [2, 3]),
    (["v{9} = 1;", 1, "v{1} = 2;", 1], "v{};", [2]),
    (["v{9} = 1;", 1, "v{1} = 2;", 1.25], "v{};", []),
    # what an assignment may have in it
    (["v{} = 1; v{} = count(v{}) + v{0} + v; v{} = v{};"], "v{};", [1, 3, [1, 3]]),
    (["h = 1; v{h + 1} = 1;", 2], "v{};", [1]),
    (["h = 1; v{h + 1} = 1;", 2.25], "v{};", []),
    (["h{} = 1; v{h{0}} = 1;", 1], "v{};", [1]),
    (["v{} = [1, 'a', [2]]; v{} = SELECT obj FROM w AS value;"], "[v{0} == v, id(v{}[1]), v{}[0]];", [True, "box", [1, "a", [2]]]),
    (["v{} = SELECT this FROM [5] AS dict;"], "v{}[0][0].this;", 5),
    # within a query, once for each row
    (["SELECT this FROM [1, 2, 3] WHERE IF(True; v{} = this, True) AS list;"], "v{};", [1, 2, 3]),
    (["v{} = 0; u = SELECT count(v{}) FROM [1, 2, 3] WHERE IF(True; v{} = this, True) AS list;"], "u;", [4, 4, 4]),
    # more decimals than a step has
    (["v{2.2} = 1;", 2, "v{2.2} = 2;", 0.25], "v{};", [2]),
]  # fmt: skip


@sampled(("script", "program", "value"), KEPT, every=4)
def test_what_is_kept(ss, script, program, value):
    run(ss, *script)
    assert ss.eval(program) == value


def test_a_plan_is_made_anew_when_the_type_of_what_was_changes(ss):
    program = ss.compile("SELECT this FROM v{} WHERE this IN [1, 'a'] AS list;")
    of_one = ss.compile("SELECT this == v{getTime()} FROM [1, 'a', 2.5] AS list;")
    run(ss, "v{1} = 1;")
    assert ss.eval(program) == [1]
    assert ss.eval(of_one) == [True, False, False]
    run(ss, 1, "v{1} = 'a';")
    assert ss.eval(program) == [1, "a"]
    assert ss.eval(of_one) == [False, True, False]
    run(ss, 1, "v{1} = 2.5;", 0.25)
    run(ss, 1)
    assert ss.eval(program) == []
    assert ss.eval(of_one) == [False, False, True]
    run(ss, "w2 = w;")
    assert ss.eval("SELECT id FROM w2 WHERE v{20} == 2.5 AS list;") == ["box"]


def test_what_was_given_at_a_constant_time_is_in_conditions_of_rows(client):
    with ssduck.Interpreter() as ss:
        ss.add_variable("w", box_world(client))
        ss.eval("v{} = 0.25; h = 1;")
        text = "SELECT id FROM w WHERE z(this) > v{h} AND count(v{}) == 1 AS list;"
        assert ss.eval(text) == ["box"]


# (script, program, error, the offending text, words)
MISTAKES = [
    ([], "u{5};", UnknownNameError, "u{5}", "there is no variable 'u'"),
    (["speed{} = 1;"], "sped{5};", UnknownNameError, "sped{5}", "no variable 'sped'"),
    (["v = 1;"], "v{5};", ArgumentError, "v{5}", "v has no history; v{5.0} = … keeps one"),
    (["v{} = 1; v = 1;"], "v{};", ArgumentError, "v{}", "v has no history"),
    (["v{} = 1;"], "v{'a'};", ArgumentError, "v{'a'}", "a number of seconds, not 'a'"),
    (["v{} = 1;"], "v{True};", ArgumentError, "v{True}", "a number of seconds, not True"),
    (["v{} = 1;"], "v{[1]};", ArgumentError, "v{[1]}", "a number of seconds, not [1]"),
    (["v{} = 1;"], "v{1e999};", ArgumentError, "v{1e999}", "a finite number of seconds, not inf"),
    (["v{} = 1;"], "v{10 ^ 400};", ArgumentError, "v{10 ^ 400}", "a finite number of seconds"),
    (["v{} = 1;"], "v{-1e999};", ArgumentError, "v{-1e999}", "a finite number of seconds"),
    (["v{} = 1;"], "v{none()};", ArgumentError, "v{none()}", "a number of seconds, not None"),
    (["v{} = 1;"], "v{1 / 0};", EvaluationError, "1 / 0", "division by zero"),
    ([], "v{-1} = 1;", ArgumentError, "-1", "a horizon must be at least 0 s, not -1"),
    ([], "v{'a'} = 1;", ArgumentError, "'a'", "a horizon is a number of seconds, not 'a'"),
    ([], "v{1e999} = 1;", ArgumentError, "1e999", "a horizon is a finite number of seconds"),
    ([], "v{1e999 - 1e999} = 1;", ArgumentError, "1e999 - 1e999", "a finite number"),
    ([], "v{False} = 1;", ArgumentError, "False", "a horizon is a number of seconds"),
    ([], "v{v} = 1;", UnknownNameError, "v", "no variable 'v'"),
    ([], "v{5} = w;", ArgumentError, "v{5} = w", "a world cannot be kept"),
    ([], "v{} = [a.this];", ArgumentError, "v{} = [a.this]", "has no history"),
    (["u = [a.this];"], "v{} = u;", ArgumentError, "v{} = u", "has no history"),
    ([], "w{1.5};", EvaluationError, "w{1.5}", "'w' is recorded from 0 s to 0 s"),
    ([1, "v{} = 1;", 1], "v{0.5};", EvaluationError, "v{0.5}", "v: 0.5 s is before the kept values, 1 s to 2 s"),
    (["v{1} = 1;", 1.5, "v{1} = 2;", 0.5], "v{0.999};", EvaluationError, "v{0.999}", "v: 0.999 s is before the kept values, 1 s to 2 s; a longer horizon keeps more"),
    (["v{1} = 1;", 2], "v{0};", EvaluationError, "v{0}", "before the kept values, 1 s to 2 s"),
    (["v{1} = 1;", 2], "SELECT v{0} FROM [1];", EvaluationError, "v{0}", "before the kept values"),
    (["v{1} = 1;", 2], "SELECT v{this} FROM [1.5, 0.5];", EvaluationError, "v{this}", "0.5 s is before"),
    (["v{} = 1;"], "SELECT v{0} FROM [1, 2] START WITH v = 1 CONNECT BY v = 2 STOP WITH v == 2;", ArgumentError, "v{0}", "v is a state variable here"),
    ([], "SELECT this FROM [1] WHERE IF(True; s{} = 1, True) START WITH s = 1 CONNECT BY s = 2 STOP WITH s == 2;", ArgumentError, "s{} = 1", "s is a state variable here"),
    ([], "SELECT this FROM [1] START WITH v{5} = 1 CONNECT BY v = 2 STOP WITH 1;", ParseError, "{", "a state variable has no history"),
]  # fmt: skip


@sampled(("script", "program", "kind", "offending", "words"), MISTAKES, every=4)
def test_mistakes(ss, script, program, kind, offending, words):
    ss.add_function("none", lambda: None)
    run(ss, *script)
    with pytest.raises(kind) as caught:
        ss.eval(program)
    error = caught.value
    assert words in error.message
    assert program[error.span.start : error.span.end] == offending


def test_the_nearest_name_is_suggested(ss):
    run(ss, "speed{} = 1;")
    with pytest.raises(UnknownNameError) as caught:
        ss.eval("sped{1};")
    assert caught.value.suggestions[0] == "speed"


def test_a_mistake_that_no_row_comes_to_is_none(ss):
    run(ss, "v{1} = 1;", 2)
    assert ss.eval("SELECT v{0} FROM [] AS list;") == []
    assert ss.eval("SELECT IF(this > 1; this; v{0}) FROM [2] AS list;") == [2]


def test_there_is_no_time_without_a_world():
    with ssduck.Interpreter() as ss:
        with pytest.raises(UnknownNameError, match="no world, so no simulated time") as caught:
            ss.eval("v{5} = 1;")
        assert caught.value.span is not None
        with pytest.raises(UnknownNameError, match="there is no variable 'v'"):
            ss.eval("v;")


# -- programs that fail, and what Python does ------------------------------------------------


@pytest.mark.parametrize(
    "program",
    ["v{} = 2; v{} = 3; 1 / 0;", "v{1} = 2; 1 / 0;", "v = 2; 1 / 0;", "clear('v'); nosuch;"],
)
def test_a_program_that_fails_adds_nothing(ss, program):
    run(ss, "v{} = 0;", 1, "v{} = 1;", 1)
    before = ss.history("v")
    for _ in range(3):
        with pytest.raises(ssduck.SelectScriptError):
            ss.eval(program)
        assert ss.history("v") == before
    assert ss.eval("v{} = 4; v{};") == [0, 1, 4]
    assert ss.history("v") == [*before, (2.0, 4)]


def test_explaining_adds_nothing(ss):
    run(ss, "v{} = 0;")
    ss.explain("v{} = 1; SELECT this FROM v{};")
    assert ss.history("v") == [(0.0, 0)]


def test_a_program_within_a_program_that_fails_adds_nothing(ss):
    def inner():
        ss.eval("v{} = 2; 1 / 0;")

    ss.add_function("inner", inner)
    run(ss, "v{} = 1;")
    with pytest.raises(FunctionError):
        ss.eval("v{} = 3; inner();")
    assert ss.eval("v{};") == [1]


def test_histories_in_python(ss):
    run(ss, 1, "v{2} = 1; v{2} = [2];", 1.5, "v{2} = 'three';")
    assert ss.history("v") == [(1.0, 1), (1.0, [2]), (2.5, "three")]
    assert ss.call_variable("v") == "three"
    run(ss, 1)
    assert ss.history("v") == [(2.5, "three")]
    run(ss, 9)
    assert ss.history("v") == []
    assert ss.call_variable("v") == "three"
    ss.add_variable("v", 5)
    with pytest.raises(ArgumentError, match="v has no history"):
        ss.history("v")
    with pytest.raises(UnknownNameError, match="no variable 'u'"):
        ss.history("u")
    with pytest.raises(ArgumentError, match="w has no history"):
        ss.history("w")


def test_what_is_given_may_be_changed(ss):
    run(ss, "v{} = 1;")
    ss.eval("v{};").append(5)
    ss.history("v").clear()
    assert ss.eval("v{};") == [1]


def test_values_are_those_that_a_plain_variable_would_have(ss):
    given = [1, [2]]
    ss.add_variable("given", given)
    ss.add_function("same", lambda: given)
    ss.add_function("grown", lambda value: value.append(3) or value)
    run(ss, "v{} = given; u = given; v{} = same(); u2 = same(); x = grown(v);")
    assert ss.call_variable("v") == [1, [2]]
    assert ss.eval("v{}[0];") is ss.eval("u;")
    given.append(4)
    assert ss.eval("[v{}[1], v{}[1] == u2, v{}[0] == u];") == [[1, [2]], True, True]


def test_times_of_numpy_are_times(ss):
    ss.add_function("half", lambda: np.float32(0.5))
    run(ss, "v{half()} = 1;", 0.5, "v{} = 2;")
    assert ss.eval("[v{half()}, v{-half()}];") == [2, [1, 2]]


def test_entities_of_the_past_are_of_the_present_tick(ss, client):
    run(ss, "b{} = SELECT obj FROM w AS value;", 1)
    ss.call_variable("w")["box"].move(position=[0, 0, 7])
    ss.call_variable("w").tick()
    assert ss.eval("z(b{0});") == pytest.approx(7.0)
    assert ss.eval("SELECT z(b{0}) FROM [1] WHERE b{0} IN b{} AS list;") == pytest.approx([7.0])


def test_entities_of_the_past_may_be_of_another_world(ss, second):
    young = ss.add_variable("young", box_world(second, "young"))
    run(ss, "b{} = SELECT obj FROM young AS value;", 1, "b{} = SELECT obj FROM w AS value;")
    assert ss.eval("[b{0} == b, b{0} IN young, b IN young];") == [False, True, False]
    statements = parse("inContact(b{0}, b{0});").statements
    assert young in ss._execution.worlds_of(statements)  # so that its contacts are read
    assert ss.eval("inContact(b{0}, b{0});") is False


# -- time that goes back --------------------------------------------------------------------


@pytest.fixture
def second():
    number = pybullet.connect(pybullet.DIRECT)
    yield number
    pybullet.disconnect(number)


def test_a_younger_world_forgets_what_is_later(ss, second):
    run(ss, "v{9} = 0;", 1, "v{9} = 1;", 1, "v{9} = 2; u{0.5} = 2;")
    young = box_world(second, "young")
    young.step(round(1 / STEP))
    ss.add_variable("w", young)
    assert ss.eval("getTime();") == 1.0
    assert ss.eval("[v{}, v{1}, v{5}, v];") == [[0, 1], 1, 1, 2]
    assert ss.eval("u{};") == []
    with pytest.raises(EvaluationError, match="u: no value is kept: it is 1 s, before"):
        ss.eval("u{1};")
    # What was forgotten is not back when the time is.
    young.step(round(3 / STEP))
    assert ss.eval("v{9} = 4; v{};") == [0, 1, 4]
    assert ss.eval("u{9} = 4; u{};") == [4]


def test_a_second_world_does_not_matter(ss, second):
    run(ss, "v{9} = 0;", 1, "v{9} = 1;")
    ss.add_variable("young", box_world(second, "young"))
    assert ss.eval("v{};") == [0, 1]


# -- against a model ------------------------------------------------------------------------


class Model:
    """What a history is, said plainly: all of it is looked at each time."""

    def __init__(self):
        self.values, self.horizon = [], None

    def forget(self, now):
        if self.horizon is not None:
            past = [(t, v) for t, v in self.values if t <= now]
            old = [entry for entry in past if entry[0] < now - self.horizon]
            self.values = old[-1:] + past[len(old) :]

    def add(self, value, horizon, now):
        self.forget(now)
        self.horizon = horizon
        self.forget(now)
        self.values.append((now, value))

    def within(self, seconds, now):
        begin = now - min(seconds, self.horizon)
        return [(t, v) for t, v in self.values if begin <= t <= now]

    def at(self, time, now):
        past = [(t, v) for t, v in self.values if t <= now]
        if not past or time < max(past[0][0], now - self.horizon):
            return None
        return [v for t, v in past if t <= time][-1]


# Quarters are exact, so that the boundaries are met often.
SPANS = st.integers(0, 12).map(lambda quarters: quarters / 4)
HORIZONS = st.one_of(SPANS, st.just(math.inf))
OPERATIONS = st.lists(
    st.one_of(
        st.tuples(st.just("wait"), SPANS),
        st.tuples(st.just("add"), HORIZONS),
        st.tuples(st.just("fail"), HORIZONS),
        st.tuples(st.just("forget"), st.none()),
        st.tuples(st.just("back"), SPANS),
    ),
    max_size=25,
)


@pytest.mark.slow
@given(operations=OPERATIONS)
def test_histories_are_like_the_model(operations):
    model, held, now = Model(), None, 0.0
    for number, (what, amount) in enumerate(operations):
        if what == "wait":
            now += amount
        elif what == "back":
            now = max(0.0, now - amount)
            model.forget(now)
            held = held and held.until(now).recent(now)
        elif what == "forget":
            model.forget(now)
            held = held and held.until(now).recent(now)
        elif what == "fail" and held is not None:
            with_assignment(held, "failed", amount, now)
        elif what == "add":
            model.add(number, amount, now)
            held = with_assignment(held, number, amount, now)
            assert held.last == number
        if held is not None:
            check(model, held, now)


def check(model, held, now):
    """All that can be asked for is what the model says."""
    assert held.horizon == model.horizon
    assert held.within(math.inf, now) == model.within(math.inf, now)
    assert past_value("v", held, (), lambda: now) == [v for _, v in model.within(math.inf, now)]
    for quarter in range(-8, 24):
        time = quarter / 4
        if time < 0:
            expected = [v for _, v in model.within(-time, now)]
            assert past_value("v", held, (time,), lambda: now) == expected
            continue
        expected = model.at(time, now)
        if expected is None:
            with pytest.raises(EvaluationError, match=r"v: .*kept"):
                past_value("v", held, (time,), lambda: now)
        else:
            assert past_value("v", held, (time,), lambda: now) == expected


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(operations=OPERATIONS)
def test_programs_are_like_the_model(ss, operations):
    world = ss.call_variable("w")
    ss.eval("clear();")
    model, begin = Model(), world.time
    for number, (what, amount) in enumerate(operations):
        horizon = "" if amount == math.inf else amount
        if what == "wait":
            world.step(round(amount / STEP))
        elif what == "add":
            ss.eval(f"v{{{horizon}}} = {number};")
            model.add(number, amount, world.time)
        elif what == "fail":
            with pytest.raises(EvaluationError):
                ss.eval(f"v{{{horizon}}} = {number}; 1 / 0;")
    now = world.time
    if model.horizon is None:
        return
    assert ss.history("v") == model.within(math.inf, now)
    spans = [0.25, 1.0, 2.75]
    told = ss.eval(f"SELECT v{{-this}} FROM {spans} AS list;")
    assert told == [[v for _, v in model.within(span, now)] for span in spans]
    assert ss.eval("SELECT this FROM v{} AS list;") == [v for _, v in model.within(math.inf, now)]
    times = [begin + quarter / 4 for quarter in range(12)]
    known = [time for time in times if model.at(time, now) is not None]
    assert ss.eval(f"SELECT v{{this}} FROM {known} AS list;") == [model.at(t, now) for t in known]


@given(step=st.integers(1, 5000), back=st.integers(0, 5000), every=st.sampled_from([60, 100, 240]))
def test_times_are_the_same_however_they_are_rounded(step, back, every):
    """`v{0.7}` is the value of the 168th step of 1/240 s, though that is at 0.7000000000000001 s."""
    size = 1 / every
    now = (step + back) * size
    held = with_assignment(
        with_assignment(None, "before", math.inf, (step - 1) * size), "then", math.inf, step * size
    )
    assert held.at(step / every, now) == "then"
    assert held.at(float(f"{step * size:.12f}"), now) == "then"
    assert [v for _, v in held.within(back / every, now)] == ["then"]
    assert held.at(step * size - 2 * SAME_TIME, now) == "before"
    short = with_assignment(None, "then", back / every, step * size)
    assert [v for _, v in short.within(math.inf, now)] == ["then"]
    assert short.within(math.inf, now + 2 * SAME_TIME) == []


# -- what it costs ---------------------------------------------------------------------------


def test_what_is_out_of_the_horizon_is_let_go_without_assignments(ss):
    class Large:
        alive = 0

        def __init__(self):
            Large.alive += 1

        def __del__(self):
            Large.alive -= 1

    ss.add_function("large", Large)
    run(ss, "v{1} = large();", *(part for _ in range(20) for part in (0.25, "v{1} = large();")))
    assert 5 <= Large.alive <= 14
    run(ss, 9, "1 + 1;")
    assert Large.alive == 1  # v is one


@pytest.mark.slow
def test_a_hundred_thousand_assignments(client):
    with ssduck.Interpreter() as ss:
        ss.add_variable("w", box_world(client))
        add = ss.compile("v{} = 1;")
        for _ in range(100_000):
            ss.eval(add)
        assert ss.eval("[count(v{}), v{0}];") == [100_000, 1]


def test_what_has_grown_from_one_history_is_not_mixed():
    trunk = with_assignment(with_assignment(None, 1, math.inf, 0.0), 2, math.inf, 1.0)
    left, right = (with_assignment(trunk, name, math.inf, 2.0) for name in ("left", "right"))
    back = with_assignment(trunk, "back", math.inf, 0.5)
    assert isinstance(trunk, ValueHistory)
    assert trunk.within(math.inf, 2.0) == [(0.0, 1), (1.0, 2)]
    assert left.within(math.inf, 2.0) == [(0.0, 1), (1.0, 2), (2.0, "left")]
    assert right.within(math.inf, 2.0) == [(0.0, 1), (1.0, 2), (2.0, "right")]
    assert back.within(math.inf, 2.0) == [(0.0, 1), (0.5, "back")]
