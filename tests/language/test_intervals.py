"""Since when, how long and when something held: over the recorded ticks, and as SQL."""

import math
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    SelectScriptError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.interpreter.over_time import series
from ssduck.language.intervals import RELATIONS_OF_INTERVALS, changes_of, column_of, intervals_of
from tests.support.bodies import client_of
from tests.support.cases import sampled
from tests.support.stage import Stage

STEP = 1 / 240


@contextmanager
def _opened():
    """An interpreter and one row by row on a world whose ball is put at a height, tick by tick."""
    with Stage() as stage:
        stage.box("board", half=[1, 1, 0.1])
        stage.sphere("ball", (0, 0, 1), radius=0.1, mass=1)
        world = stage.open()
        ss, rows = stage.interpreters(lab=world)
        yield ss, rows, world


@pytest.fixture
def lab():
    with _opened() as made:
        yield made


@pytest.fixture(scope="module")
def unmoved():
    """A lab for tests that do not change it."""
    with _opened() as made:
        yield made


def _put(world, heights):
    """Put the ball at heights, one a step; gives the times of these ticks."""
    times = []
    for height in heights:
        world.simulator.step(1)
        world["ball"].move([0, 0, height])
        times.append(world.time)
    return times


def _evaluated(lab, program):
    ss, rows, _ = lab
    found = ss.eval(program)
    assert repr(rows.eval(program)) == repr(found)
    return found


# -- against what a loop finds ----------------------------------------------------------------


@pytest.mark.slow
@given(st.lists(st.booleans(), max_size=40))
def test_intervals_are_those_of_a_loop(holding):
    times = [0.5 * number for number in range(len(holding))]
    found = intervals_of(times, holding)
    # What holds at a tick holds until the next one; of the last tick only the instant is known.
    inside = [any(start <= t < end or t == start for start, end in found) for t in times]
    last_holds = bool(holding) and holding[-1]
    assert inside[:-1] == holding[:-1]
    assert (bool(found) and found[-1][1] == times[-1] and last_holds) or not last_holds
    assert all(a[1] < b[0] for a, b in pairwise(found))
    assert all(start <= end for start, end in found)


@pytest.mark.slow
@given(st.lists(st.sampled_from([True, False, 1, 0, "a", None, 1.5]), max_size=30))
def test_changes_are_those_of_a_loop(values):
    times = list(map(float, range(len(values))))
    found = changes_of(np.array(times), column_of(values))
    wanted = [
        [time, value]
        for place, (time, value) in enumerate(zip(times, values, strict=True))
        if place == 0 or repr(values[place - 1]) != repr(value)
    ]
    assert repr(found) == repr(wanted)


@pytest.mark.slow
@given(st.sampled_from([[0.5, 0.0, -0.0, math.nan], [1, 2, 3], [True, False, True]]), st.data())
def test_changes_of_columns_are_those_of_objects(some, data):
    values = data.draw(st.lists(st.sampled_from([*some, None]), min_size=1, max_size=30))
    known = np.array([some[0] if value is None else value for value in values])
    column = np.ma.array(known, mask=[value is None for value in values])
    times = np.arange(float(len(values)))
    assert repr(changes_of(times, column)) == repr(changes_of(times, column_of(values)))


def test_a_long_window_is_what_numpy_finds_by_hand(lab):
    """Of the ticks of one time the last one counts; at the first ones the entity is not there."""
    _, _, world = lab
    client = world.simulator.client
    early = [world.time]
    for _ in range(150):
        world.step()
        early.append(world.time)
    body = Stage(client).sphere("new", radius=0.1, mass=1)
    heights, late = np.round(np.random.default_rng(5).uniform(0.5, 1.5, 250), 1), []
    for height in heights.tolist():
        world.simulator.step(1)
        pybullet.resetBasePositionAndOrientation(body, [0, 0, height], [0, 0, 0, 1], client)
        world.tick()
        late.append(world.time)
    (new,) = [entity for entity in world if entity.id == 3]
    for each in lab[:2]:
        each.add_variable("new", new)
    times = np.array([*early, *late])
    z = np.concatenate((np.full(len(early), np.nan), heights))
    both_unknown = np.isnan(z[1:]) & np.isnan(z[:-1])
    places = np.flatnonzero(np.append(True, (z[1:] != z[:-1]) & ~both_unknown))
    changes = [[times[i], None if np.isnan(z[i]) else z[i]] for i in places]
    edges = np.flatnonzero(np.diff(z > 0.9, prepend=False, append=False))
    held = np.append(times, times[-1])[edges].reshape(-1, 2).tolist()
    assert _evaluated(lab, "changes(z(new));") == changes
    assert _evaluated(lab, "holds(z(new) > 0.9);") == held
    assert _evaluated(lab, "least(z(new));") == [times[np.nanargmin(z)], np.nanmin(z)]
    assert _evaluated(lab, "greatest(z(new));") == [times[np.nanargmax(z)], np.nanmax(z)]
    pybullet.removeBody(body, client)


ENDS = st.tuples(st.integers(0, 6), st.integers(0, 6)).map(lambda ends: sorted(map(float, ends)))


@given(ENDS, ENDS)
def test_relations_of_intervals_are_those_of_points(a, b):
    held = {name for name, r in RELATIONS_OF_INTERVALS.items() if r.holds(*a, *b)}
    wanted = {
        "before": a[1] < b[0],
        "meets": a[1] == b[0],
        "overlaps": a[0] < b[0] < a[1] < b[1],
        "during": b[0] < a[0] and a[1] < b[1],
    }
    assert held == {name for name, holds in wanted.items() if holds}


@pytest.mark.parametrize("name", list(RELATIONS_OF_INTERVALS))
@sampled(
    ("a", "b"),
    [
        ([0.0, 1.0], [2.0, 3.0]),
        ([0.0, 2.0], [2.0, 3.0]),
        ([0.0, 2.5], [2.0, 3.0]),
        ([2.2, 2.5], [2.0, 3.0]),
        ([2.0, 2.5], [2.0, 3.0]),
    ],
    every=3,
    ids=str,
)
def test_sql_and_the_language_agree_on_intervals(unmoved, name, a, b):
    ss, _, _ = unmoved
    holds = RELATIONS_OF_INTERVALS[name].holds(*a, *b)
    assert _evaluated(unmoved, f"{name}({a}, {b});") is holds
    assert ss.sql(f'SELECT "{name}"($a, $b)', {"a": a, "b": b}).fetchall() == [(holds,)]


# -- over the recorded ticks ------------------------------------------------------------------

HEIGHTS = [0.21, 0.5, 0.21, 0.21, 0.9, 0.25, 0.22]


@sampled("near", [0.005, 0.015, 0.03, 0.1, 1.0], every=3, ids=str)
def test_holds_is_what_a_loop_over_ticks_finds(lab, near):
    _put(lab[2], HEIGHTS)
    found = _evaluated(lab, f"holds(near(ball, board, {near}));")
    ticks = (
        lab[0]
        .sql("SELECT time, z FROM entities_history WHERE name = 'ball' ORDER BY tick")
        .fetchall()
    )
    told = [z - 0.2 <= near for _, z in ticks]
    assert found == intervals_of([time for time, _ in ticks], told)


@pytest.mark.slow
def test_since_is_what_a_loop_over_ticks_finds(lab, monkeypatch):
    """The ticks are read in several pieces, and the first two have the same time."""
    monkeypatch.setattr(series, "FIRST_TICKS", 2)
    _put(lab[2], HEIGHTS)
    ticks = dict(
        lab[0]
        .sql("SELECT time, z FROM entities_history WHERE name = 'ball' ORDER BY tick")
        .fetchall()
    )
    for height in (*HEIGHTS, 0.0, 2.0):
        expected = None
        for time, z in reversed(ticks.items()):
            if z < height:
                break
            expected = time
        assert _evaluated(lab, f"since(z(ball) >= {height});") == expected


def test_the_closest_approach(lab):
    times = _put(lab[2], [0.5, 0.3, 0.25, 0.4])
    time, distance = _evaluated(lab, "least(clearance(ball, board));")
    assert (time, distance) == (pytest.approx(times[2]), pytest.approx(0.05, abs=1e-6))
    late = _evaluated(lab, f"least(clearance(ball, board), {-0.5 * STEP});")
    assert late[1] == pytest.approx(0.2, abs=0.01)


def test_rows_are_asked_about_one_by_one(lab):
    _put(lab[2], [0.21, 0.5])
    program = "SELECT id(this), heldFor(z(this) < 2) FROM lab AS list;"
    now = lab[2].time
    assert _evaluated(lab, program) == ["board", now, "ball", now]


@pytest.mark.slow
def test_an_entity_that_was_not_there_ends_what_holds(lab):
    ss, _, world = lab
    client = world.simulator.client
    world.step(5)
    body = Stage(client).sphere("new", (0, 0, 3), radius=0.1, mass=1)
    world.step()
    came = world.time
    (new,) = [entity for entity in world if entity.id == 3]
    world.step()
    for each in lab[:2]:
        each.add_variable("new", new)
    assert _evaluated(lab, "holds(above(ball, new) OR z(new) > 0);") == [[came, world.time]]
    assert ss.eval("since(z(new) > 0);") == came
    pybullet.removeBody(body, client)


@sampled(
    ("program", "error", "told"),
    [
        ("holds(1 < 2);", ArgumentError, "holds takes an expression of entities"),
        ("holds([] == (SELECT this FROM lab));", UnsupportedError, "without a query"),
        ("holds(near(ball, bord, 1));", UnknownNameError, "did you mean 'board'"),
        ("since(z(ball) > 0, 1);", ArgumentError, "since takes 1 argument"),
        ("holds();", ArgumentError, "holds takes 1 to 2 arguments"),
        ("holds(z(ball) > 0, 'a');", ArgumentError, "number of seconds"),
        ("holds(z(ball) > 0, 99.0);", EvaluationError, "there is no tick at 99 s"),
        ("lifted(ball);", SelectScriptError, "lifted"),
        ("lifted(lab.bal, 0.1);", SelectScriptError, "'ball'"),
        ("lifted(0.3, 0.1);", SelectScriptError, "lifted|entit"),
        ("lifted(ball, 'high');", SelectScriptError, "high|text"),
        ("meets([1, 2], 3);", ArgumentError, r"an interval is \[start, end\]"),
        ("meets([2, 1], [1, 2]);", ArgumentError, r"an interval is \[start, end\]"),
        ("initially(z(ball), 1.0);", ArgumentError, "initially takes 1 argument"),
        ("greatest(id(ball));", SelectScriptError, "greatest takes an expression of numbers"),
    ],
    every=3,
)
def test_what_is_no_expression_over_time(lab, program, error, told):
    for each in lab[:2]:
        with pytest.raises(error, match=told):
            each.eval(program)


def test_entities_of_two_worlds(lab, stage):
    stage.sphere("other")
    other = stage.open()
    lab[0].add_variable("attic", other)
    lab[0].add_variable("other", other["other"])
    with pytest.raises(UnsupportedError, match="holds takes entities of one world"):
        lab[0].eval("holds(distance(ball, other) > 1);")


# -- as SQL -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_intervals_in_sql_are_those_of_the_language(lab):
    ss, _, world = lab
    _put(world, HEIGHTS)
    ss.sql(
        "CREATE TEMP VIEW touching AS SELECT a.tick, a.time, near(a, b, 0.02) AS holds "
        "FROM entities_history a JOIN entities_history b USING (tick) "
        "WHERE a.name = 'ball' AND b.name = 'board'"
    )
    rows = ss.sql("FROM intervals('touching')").fetchall()
    wanted = ss.eval("holds(near(ball, board, 0.02));")
    assert [[start, end] for start, end, _ in rows if end > start] == [
        interval for interval in wanted if interval[1] > interval[0]
    ]
    assert [still for _, _, still in rows] == [False] * (len(rows) - 1) + [True]
    row = ss.sql("FROM duckdb_functions() WHERE function_name = 'intervals'").fetchall()
    assert len(row) == 1


def test_of_what_came_later_nothing_is_known_initially(lab):
    ss, rows, world = lab
    Stage(client_of(world)).sphere("late", (3, 0, 1), radius=0.1, mass=1)
    world.tick()
    late = next(entity for entity in world if entity.position[0] > 2)
    for each in (ss, rows):
        each.add_variable("late", late)
    assert _evaluated(lab, "initially(z(late));") is None
    for program in ("previous(z(late));", "rate(z(late));", "at(0.0, position(late));"):
        assert _evaluated(lab, program) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rise", "expected"), [(0.0, False), (0.25 - 1e-9, False), (0.25, True), (0.5, True)]
)
def test_lifted_has_its_boundary_at_the_height(lab, rise, expected):
    start = _evaluated(lab, "z(ball);")
    _put(lab[2], [0.7, start + rise])  # only the first tick and the present one matter
    rise = _evaluated(lab, "z(ball);") - start
    assert _evaluated(lab, "lifted(ball, 0.25);") is (rise >= 0.25) is expected
    program = "SELECT id FROM lab WHERE lifted(this, 0.25) AS list;"
    assert _evaluated(lab, program) == ["ball"] * expected
    assert _evaluated(lab, "lifted(ball, 0);")
