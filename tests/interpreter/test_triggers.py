"""Triggers, and worlds that run in simulated time."""

from __future__ import annotations

import contextlib
import gc
import math
import os
import signal
import threading
import time
import warnings
import weakref
from collections import Counter
from fractions import Fraction

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pybullet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ssduck
from ssduck.errors import ArgumentError, SimulatorError, UnknownNameError, UnsupportedError
from ssduck.interpreter.triggers.diff import canonical_key, copy_of, difference, is_true, rows_of
from ssduck.interpreter.triggers.registry import TriggerWarning
from ssduck.world import running
from tests.support.cases import sampled
from tests.support.timing import HANGS


def falling(client, height=10.0):
    """A ball that falls; nothing below it."""
    pybullet.setGravity(0, 0, -10, physicsClientId=client)
    shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, physicsClientId=client)
    ball = pybullet.createMultiBody(1, shape, basePosition=[0, 0, height], physicsClientId=client)
    return ssduck.World.attach(client, names={ball: "ball"})


@pytest.fixture
def told():
    """The statements that `ss` sends to DuckDB."""
    return []


@pytest.fixture
def ss(told):
    with ssduck.Interpreter(tracer=told.append) as interpreter:
        yield interpreter


@pytest.fixture
def sim(ss, client):
    """A world with a ball that falls, 240 steps a second."""
    return ss.add_variable("sim", falling(client))


@pytest.fixture
def other(ss):
    """A second world, 100 steps a second."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setTimeStep(0.01, client)
    yield ss.add_variable("other", falling(client))
    pybullet.disconnect(client)


def state(ss, name):
    (found,) = [state for state in ss.triggers() if state.name == name]
    return found


class Times(list):
    """A callback that takes down when it was called."""

    def __init__(self, world):
        super().__init__()
        self.world = world

    def __call__(self, result):
        self.append(round(self.world.time, 9))


HEIGHT = "SELECT z FROM sim WHERE id(this) == 'ball' AS value;"


# -- when it is evaluated ----------------------------------------------------------------------


def test_the_first_result_is_a_change(ss, sim):
    got = []
    ss.add_trigger("low", "SELECT id FROM sim WHERE z(this) < 9 AS list;", 0.1, got.append)
    assert got == [[]]
    sim.step(240)
    assert got == [[], ["ball"]]
    sim.step(240)
    assert got == [[], ["ball"]]
    assert ss.triggers() == [state(ss, "low")]
    low = state(ss, "low")
    assert (low.evaluations, low.firings, low.result, low.paused) == (21, 2, ["ball"], False)
    assert (low.interval, low.failures, low.error) == (0.1, 0, None)


def test_the_tutorials_spellings(ss, sim):
    got = []
    ss.addTrigger("height", ss.compile(HEIGHT), 1, got.append)
    ss.delTrigger("height")
    sim.step(480)
    assert got == [10.0]
    assert ss.triggers() == []


# steps of 1/240 s, interval, evaluations after the first, ticks
EVALUATED = [
    (240, 0.1, 10, 10),  # exactly on simulated time
    (24, 0.1, 1, 1),  # due at the very end: no second tick there
    (23, 0.1, 0, 1),
    (25, 0.1, 1, 2),
    (5, 1 / 240, 5, 5),
    (5, 1 / 480, 5, 5),  # shorter than a step
    (5, 1e-30, 5, 5),
    (5, 5e-324, 5, 5),
    (5, 0, 5, 5),
    (0, 0, 1, 1),  # a tick is taken
    (0, 0.1, 0, 1),
    (240, 1e9, 0, 1),
    (240, 1.7e308, 0, 1),
    (7, 2.5 / 240, 2, 3),  # after 3 steps and after 5, and the end
]


@pytest.mark.parametrize(("steps", "interval", "evaluations", "ticks"), EVALUATED)
def test_how_often(ss, sim, steps, interval, evaluations, ticks):
    ss.add_trigger("t", HEIGHT, interval, lambda _: None)
    before = sim.snapshot.number
    assert sim.step(steps) is sim
    assert state(ss, "t").evaluations == 1 + evaluations
    assert sim.snapshot.number - before == ticks


@pytest.mark.slow
@settings(max_examples=30)
@given(
    timestep=st.sampled_from(["0.001", "0.002", "0.004", "0.01", "0.03", "1/240", "1/60", "1/7"]),
    interval=st.fractions(Fraction(1, 1000), 1, max_denominator=1000),
    before=st.integers(0, 50),
    steps=st.lists(st.integers(1, 120), min_size=1, max_size=6),
)
def test_no_drift(timestep, interval, before, steps):
    """It is evaluated at the first step at or after each multiple of its interval, no other."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        step = Fraction(timestep)
        pybullet.setTimeStep(float(step), client)
        with ssduck.Interpreter() as ss:
            sim = ss.add_variable("sim", ssduck.World.attach(client)).step(before)
            times = []
            ss.add_function("now", lambda: times.append(sim.time) or len(times))
            ss.add_trigger("t", "now();", float(interval), lambda _: None)
            first, total = sim.snapshot.number, sum(steps)
            for count in steps:
                sim.step(count)
            due = {
                math.ceil(k * interval / step) for k in range(1, int(total * step / interval) + 2)
            }
            due = sorted(n for n in due if n <= total)
            assert times[1:] == pytest.approx([float((before + n) * step) for n in due], rel=1e-9)
            ends = set(np.cumsum(steps).tolist())
            assert sim.snapshot.number - first == len(ends.union(due))
    finally:
        pybullet.disconnect(client)


def test_time_that_has_gone_on_for_long(ss, sim):
    """A day of simulated time, in which sums of steps are off by rounding."""
    sim.tick(time=86400.1)
    times = Times(sim)
    ss.add_trigger("t", HEIGHT, 0.1, times)
    sim.step(240)
    assert times == pytest.approx([86400.1 + k / 10 for k in range(11)])


def test_the_clients_time_step_may_change(ss, sim, client):
    times = Times(sim)
    ss.add_trigger("t", HEIGHT, 0.1, times)
    sim.step(48)
    pybullet.setTimeStep(0.025, client)
    sim.step(8)
    assert times == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])


def test_ticks_without_steps(ss, sim, client):
    """Ticks of the same time: each is looked at if the interval is 0."""
    got, never = [], []
    ss.add_trigger("each", HEIGHT, 0, got.append)
    ss.add_trigger("timed", HEIGHT, 0.001, never.append)
    for height in (5.0, 5.0, 6.0):
        pybullet.resetBasePositionAndOrientation(0, [0, 0, height], [0, 0, 0, 1], client)
        sim.tick(steps=0)
    assert got == [10.0, 5.0, 6.0]
    assert never == [10.0]
    sim["ball"].move([0, 0, 7])  # told of with the next tick
    assert got == [10.0, 5.0, 6.0]
    sim.tick(steps=0)
    assert got == [10.0, 5.0, 6.0, 7.0]


def test_pause_and_resume(ss, sim):
    times = Times(sim)
    ss.add_trigger("t", HEIGHT, 0.1, times)
    sim.step(24)
    ss.pause_trigger("t")
    ss.pause_trigger("t")
    assert state(ss, "t").paused
    before = sim.snapshot.number
    sim.step(84)
    assert sim.snapshot.number == before + 1
    ss.resume_trigger("t")  # at 0.45 s
    ss.resume_trigger("t")
    assert not state(ss, "t").paused
    sim.step(36)
    assert times == [0, 0.1, 0.5, 0.6]


# -- which worlds ------------------------------------------------------------------------------


def test_it_goes_by_the_time_of_the_worlds_that_it_is_about(ss, sim, other):
    times = Times(sim)
    ss.add_trigger("t", HEIGHT, 0.1, times)
    other.step(100)
    assert times == [0]
    sim.step(24)
    assert times == [0, 0.1]


@pytest.mark.parametrize(
    "program", ["SELECT a.this FROM a=sim, b=other;", "n;", "env = sim; with = other; n;"]
)
def test_if_it_is_about_several_whichever_steps(ss, sim, other, program):
    """So it is if it is about none."""
    ss.add_variable("n", 1)
    ss.add_trigger("t", program, 0.1, lambda _: None)
    sim.step(48)
    assert state(ss, "t").evaluations == 3
    other.step(10)
    assert state(ss, "t").evaluations == 4


def test_in_lockstep_it_is_evaluated_once_a_moment(ss, sim, other):
    ss.add_variable("n", 1)
    seen = []
    ss.add_function("seen", lambda: seen.append((round(sim.time, 6), round(other.time, 6))))
    ss.add_trigger("t", "seen();", 0.1, lambda _: None)
    ss.run(0.3)
    assert seen == [(0, 0), (0.1, 0.1), (0.2, 0.2), (0.3, 0.3)]


def test_a_world_that_comes_later(ss, client):
    got = []
    ss.add_variable("n", 1)
    ss.add_trigger("t", "n;", 0.1, got.append)
    late = ss.add_variable("late", falling(client))
    late.step(24)
    assert state(ss, "t").evaluations == 2
    ss.add_trigger("of_it", "SELECT id FROM late AS list;", 0.1, got.append)
    ss.del_trigger("t")
    assert got == [1, ["ball"]]


def test_a_name_may_come_to_stand_for_another_world(ss, sim, client):
    got = []
    ss.add_trigger("t", "SELECT id FROM sim AS list;", 0.1, got.append)
    second = pybullet.connect(pybullet.DIRECT)
    try:
        empty = ss.add_variable("sim", ssduck.World.attach(second))
        sim.step(240)
        assert got == [["ball"]]
        empty.step(24)
        assert got == [["ball"], []]
    finally:
        pybullet.disconnect(second)


def test_a_program_may_make_a_name_stand_for_another_world(ss, sim, other):
    ss.eval("env = sim;")
    ss.add_trigger("t", "SELECT this FROM env;", 0.1, lambda _: None)
    ss.eval("env = other;")
    sim.step(48)
    assert state(ss, "t").evaluations == 1
    other.step(20)
    assert state(ss, "t").evaluations == 3


# -- what fires --------------------------------------------------------------------------------

NAN = float("nan")
# options, results one after another, what the callback gets
FIRED = [
    ({}, [1, 1, 2, 2, 1], [1, 2, 1]),
    ({}, [None, None, 1], [None, 1]),
    ({}, [[], [1], [1], [1, 2], [2, 1]], [[], [1], [1, 2], [2, 1]]),
    ({}, [1, True, 1.0, 2], [1, 2]),  # equal is no change
    ({}, [NAN, NAN, 0.0, -0.0], [NAN, 0.0]),
    ({"when": "rising"}, [[], [1], [1, 2], [], [3]], [[1], [3]]),
    ({"when": "rising"}, [True, True, False, True], [True, True]),
    ({"when": "rising"}, [0, NAN, None, "", 0.5], [0.5]),
    ({"when": "falling"}, [[], [1], [], [], [1], []], [[], []]),
    ({"when": "falling"}, [False, True, False], [False]),
    # Evaluated each 1/240 s: held for two of them is held for 2/240 s.
    ({"debounce": 2 / 240}, [1, 1, 1, 2, 1, 2, 2, 2, 2], [1, 2]),
    ({"debounce": 2 / 240}, [1, 2, 3, 3, 3], [3]),
    ({"debounce": 2 / 240, "when": "rising"}, [0, 1, 2, 0, 1, 2, 3, 4], [3]),
    ({"debounce": 2 / 240, "when": "falling"}, [1, 1, 1, 0, 1, 0, 0, 0], [0]),
    ({"debounce": 1 / 240, "rows": True}, [[1], [1], [2], [1], [1, 2], [1, 2]], [([1], []), ([2], [])]),
    ({"rows": True}, [[], [1], [2, 1], [1, 2], [2]], [([1], []), ([2], []), ([], [1])]),
    ({"rows": True}, [[1, 1], [1], [1, 1, 1]], [([1, 1], []), ([], [1]), ([1, 1], [])]),
    ({"rows": True}, [[{"a": [1]}], [{"a": [2]}, {"a": [1]}]], [([{"a": [1]}], []), ([{"a": [2]}], [])]),
    ({"rows": True}, [None, 3, 3, 4], [([3], []), ([4], [3])]),
    ({"rows": True, "when": "rising"}, [[1], [1, 2], [], [2, 3]], [([1], []), ([2, 3], [1])]),
]  # fmt: skip


@pytest.mark.parametrize(("options", "results", "expected"), FIRED)
def test_what_fires(ss, sim, options, results, expected):
    got = []
    ss.add_variable("v", results[0])
    ss.add_trigger("t", "v;", 0, got.append, **options)
    for result in results[1:]:
        ss.add_variable("v", result)
        sim.step()
    if options.get("rows"):
        assert all(isinstance(change, ssduck.Changed) for change in got)
        got = [(change.added, change.removed) for change in got]
    assert repr(got) == repr(expected)  # as NaN is not itself


def test_what_holds_is_not_known_while_it_is_paused(ss, sim):
    times = Times(sim)
    ss.add_variable("v", 1)
    ss.add_trigger("t", "v;", 0.1, times, debounce=0.25)
    ss.pause_trigger("t")
    sim.step(240)
    ss.resume_trigger("t")
    sim.step(240)
    assert times == [1.4]


def test_debounce_is_simulated_time(ss, sim):
    """0.25 s at evaluations each 0.1 s: the third one after the first."""
    times = Times(sim)
    ss.add_variable("v", 1)
    ss.add_trigger("t", "v;", 0.1, times, debounce=0.25)
    sim.step(240)
    assert times == [0.3]


ROWS = st.lists(st.one_of(st.integers(0, 3), st.lists(st.integers(0, 1), max_size=2)), max_size=6)


@given(ROWS, ROWS)
def test_what_is_added_and_removed_makes_one_of_the_other(before, now):
    def bag(rows):
        return Counter(map(repr, rows))

    change = difference(before, now)
    assert bag(before) + bag(change.added) - bag(change.removed) == bag(now)
    assert not bag(change.added) & bag(change.removed)
    assert bool(change) == (bag(before) != bag(now))


class Odd:
    """A value of a type that nobody knows, and that cannot be hashed."""

    def __init__(self, number):
        self.number = number

    def __eq__(self, other):
        return self.number == other.number

    __hash__ = None


ALIKE = [
    (NAN, float("nan")),
    (1, 1.0),
    (0.0, -0.0),
    ([1, [NAN]], [1, [float("nan")]]),
    ({"a": 1, "b": [2]}, {"b": [2], "a": 1}),
    ({1, 2}, frozenset((2, 1))),
    (np.float64(2), 2.0),
    (np.array([0.0, NAN]), np.array([-0.0, NAN])),
    (np.array(["a", None], dtype=object), np.array(["a", None], dtype=object)),
    (np.zeros((2, 0)), np.zeros((2, 0))),
    (pd.DataFrame({"a": [1.0, NAN]}), pd.DataFrame({"a": [1.0, NAN]})),
    (pl.DataFrame({"a": [1, None]}), pl.DataFrame({"a": [1, None]})),
    (pa.table({"a": [1]}), pa.table({"a": [1]})),
    (Odd(1), Odd(1)),
    ([Odd([1])], [Odd([1])]),
]
UNLIKE = [
    (1, 2),
    (1, "1"),
    (None, 0),
    (None, []),
    ([1], (1,)),
    ([1, 2], [2, 1]),
    ({"a": 1}, {"a": 2}),
    (np.array([1, 2]), np.array([1, 3])),
    (np.zeros(2), np.zeros((1, 2))),
    (pd.DataFrame({"a": [1]}), pd.DataFrame({"a": [2]})),
    (pd.DataFrame({"a": [1]}), pd.DataFrame({"b": [1]})),
    (pl.DataFrame({"a": [1]}), pl.DataFrame({"a": [1, 1]})),
    (Odd(1), Odd(2)),
]


@pytest.mark.parametrize(("one", "other"), ALIKE)
def test_results_that_are_alike(one, other):
    assert canonical_key(one) == canonical_key(other)
    assert hash(canonical_key(one)) == hash(canonical_key(other))
    assert canonical_key(copy_of(one)) == canonical_key(one)


@pytest.mark.parametrize(("one", "other"), UNLIKE)
def test_results_that_are_not(one, other):
    assert canonical_key(one) != canonical_key(other)


def test_what_stands_for_a_result_does_not_change_with_it():
    for value, change in (
        (np.zeros(2), lambda v: v.fill(1)),
        (odd := Odd([1]), lambda v: v.number.append(2)),
        ([[1]], lambda v: v[0].append(2)),
    ):
        before, copy = canonical_key(value), copy_of(value)
        change(value)
        assert canonical_key(value) != before
        assert canonical_key(copy) == before
    assert odd.number == [1, 2]


def test_handles_are_alike_if_they_are_of_the_same_entity(sim):
    assert canonical_key(sim["ball"]) == canonical_key(sim["ball"])
    assert copy_of([sim["ball"]]) == [sim["ball"]]
    assert canonical_key(sim) == canonical_key(sim)


@pytest.mark.parametrize(
    ("value", "truth"),
    [
        (None, False), (0, False), (0.0, False), (NAN, False), (np.float32("nan"), False), ("", False),
        ([], False), ({}, False), (np.zeros(0), False), (pd.DataFrame({"a": []}), False),
        (pl.DataFrame({"a": []}), False), (pa.table({"a": []}), False), (False, False),
        (1, True), ([0], True), (np.zeros(2), True), (pd.DataFrame({"a": [0]}), True), ("0", True),
    ],
)  # fmt: skip
def test_what_is_true(value, truth):
    assert is_true(value) is truth


def test_rows_of(sim):
    assert rows_of(None) == []
    assert rows_of(3) == [3]
    assert rows_of((1, 2)) == [1, 2]
    assert rows_of(np.eye(2)) == [[1, 0], [0, 1]]
    assert rows_of(pd.DataFrame({"a": [1, 2]})) == [{"a": 1}, {"a": 2}]
    assert rows_of(sim) == [sim["ball"]]


def test_rows_of_a_world_are_its_entities(ss, sim, client):
    got = []
    ss.add_trigger("who", "sim;", 0, got.append, rows=True)
    pybullet.removeBody(0, physicsClientId=client)
    sim.step()
    assert [[len(change.added), len(change.removed)] for change in got] == [[1, 0], [0, 1]]


def test_a_result_belongs_to_the_callback(ss, sim):
    """Whatever it does to it; and nobody changes it afterwards."""
    got = []

    def callback(result):
        got.append(list(result))
        result.append("mine")

    shared = ["a"]
    ss.add_variable("v", shared)
    ss.add_trigger("t", "v;", 0, callback)
    state(ss, "t").result.append("also mine")
    sim.step()
    assert got == [["a"]]
    assert shared == ["a"]
    shared.append("b")
    sim.step()
    assert got == [["a"], ["a", "b"]]
    assert state(ss, "t").result == ["a", "b"]


# -- errors ------------------------------------------------------------------------------------


@pytest.mark.parametrize("interval", [1, np.float32(1), np.int64(1), Fraction(1)])
def test_numbers_of_any_kind(ss, sim, interval):
    ss.add_trigger("t", HEIGHT, interval, lambda _: None, debounce=interval)
    sim.run(interval, every=np.int64(100), realtime=np.float32(1000))
    assert state(ss, "t").evaluations == 2
    assert type(state(ss, "t").interval) is float


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"interval": -0.1}, "interval: -0.1 is no time; seconds, 0 or more"),
        ({"interval": NAN}, "interval: nan is no time"),
        ({"interval": float("inf")}, "interval: inf is no time"),
        ({"interval": "1"}, "interval: '1' is no time"),
        ({"interval": True}, "interval: True is no time"),
        ({"debounce": -1}, "debounce: -1 is no time"),
        ({"when": "rise"}, "when: 'rise' is none of .*did you mean 'rising'"),
        ({"when": 1}, "when: 1 is none of"),
        ({"rows": 1}, "rows: 1 is not True or False"),
        ({"queue": 0}, "queue: 0 is no size; 1 or more"),
        ({"queue": True}, "queue: True is no size"),
        ({"queue": 1.5}, "queue: 1.5 is no size"),
        ({"name": ""}, "name: '' is not a non-empty text"),
        ({"name": 3}, "name: 3 is not a non-empty text"),
        ({"program": 3}, "program: 3 is neither a text nor a compiled program"),
        ({"callback": 3}, "callback: 3 is no function"),
    ],
)
def test_wrong_arguments(ss, sim, arguments, said):
    given = {"name": "t", "program": HEIGHT, "interval": 1, "callback": print, **arguments}
    with pytest.raises(ArgumentError, match=said):
        ss.add_trigger(**given)
    assert ss.triggers() == []


@pytest.mark.parametrize(
    ("program", "error"),
    [
        ("SELECT id FROM sim WHERE", ssduck.SelectScriptError),
        ("SELECT id FROM simm;", LookupError),
        ("SELECT id FROM sim WHERE isRobott(this);", LookupError),
        ("1 / 0;", ArithmeticError),
    ],
)
def test_a_program_that_cannot_be_evaluated_is_not_added(ss, sim, program, error):
    with pytest.raises(error):
        ss.add_trigger("t", program, 1, print)
    assert ss.triggers() == []
    sim.step(240)


def test_names(ss, sim):
    ss.add_trigger("door", HEIGHT, 1, lambda _: None)
    with pytest.raises(ArgumentError, match="there is a trigger 'door' already; del_trigger"):
        ss.add_trigger("door", HEIGHT, 1, lambda _: None)
    for verb in (ss.del_trigger, ss.pause_trigger, ss.resume_trigger):
        with pytest.raises(UnknownNameError, match="no trigger 'dor'; did you mean 'door'"):
            verb("dor")


def test_a_callback_that_raises_does_not_stop_the_world(ss, sim):
    def callback(result):
        raise ValueError("too low" if result < 10 else "at the top")

    with pytest.warns(
        TriggerWarning, match="trigger 't': its callback failed: ValueError: at the top"
    ) as caught:
        ss.add_trigger("t", HEIGHT, 0.1, callback)
    assert [w.filename for w in caught] == [__file__]
    with pytest.warns(TriggerWarning, match="ValueError: too low") as caught:
        sim.step(240)
    assert sim.time == pytest.approx(1)
    assert len([w for w in caught if "too low" in str(w.message)]) == 1
    found = state(ss, "t")
    assert (found.evaluations, found.firings, found.failures) == (11, 11, 11)
    assert isinstance(found.error, ValueError)
    assert str(found.error) == "too low"


def test_a_program_that_fails_does_not_stop_the_world(ss, sim):
    got = []
    ss.add_variable("v", 1)
    ss.add_trigger("t", "10 / v;", 0, got.append)
    ss.add_variable("v", 0)
    with pytest.warns(
        TriggerWarning, match="trigger 't': its program failed: EvaluationError"
    ) as caught:
        sim.step(3)
    assert [w.filename for w in caught] == [__file__]
    ss.eval("clear('v');")
    with pytest.warns(TriggerWarning, match="UnknownNameError: there is no variable 'v'") as caught:
        sim.step(2)
    assert len(caught) == 1
    ss.add_variable("v", 0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim.step()  # that was told of already
    ss.add_variable("v", 5)
    sim.step()
    assert got == [10, 2]
    assert state(ss, "t").failures == 6
    assert isinstance(state(ss, "t").error, ArithmeticError)


def test_a_failure_ends_what_has_to_hold(ss, sim):
    got = []
    ss.add_variable("v", 1)
    ss.add_trigger("t", "10 / v;", 0, got.append, debounce=2 / 240)
    for value in (1, 0, 1, 1):
        ss.add_variable("v", value)
        with pytest.warns(TriggerWarning) if value == 0 else contextlib.nullcontext():
            sim.step()
    assert got == []
    sim.step()
    assert got == [10]


def test_values_that_cannot_be_compared_do_not_stop_the_world(ss, sim):
    class Wild:
        def __eq__(self, other):
            raise RuntimeError("not with me")

        __hash__ = None

    ss.add_variable("v", Wild())
    ss.add_trigger("t", "v;", 0, lambda _: None)
    with pytest.warns(TriggerWarning, match="not with me"):
        sim.step()


# -- what a callback may do --------------------------------------------------------------------


def test_a_callback_may_query_and_move(ss, sim):
    heights = []

    def callback(_):
        heights.append(round(ss.eval(HEIGHT), 3))
        sim["ball"].move([0, 0, 10])

    program = "SELECT id FROM sim WHERE z(this) < 9 AS list;"
    ss.add_trigger("low", program, 1 / 240, callback, when="rising")
    sim.step(240)
    assert len(heights) == 2  # 1 m takes 0.447 s
    assert heights == pytest.approx([8.98] * 2, abs=0.03)


def test_a_callback_may_add_and_remove_triggers(ss, sim):
    got = []

    def first(_):
        got.append("first")
        ss.del_trigger("first")
        ss.add_trigger("first", HEIGHT, 0, lambda _: got.append("second"))
        if "doomed" in [t.name for t in ss.triggers()]:
            ss.del_trigger("doomed")

    ss.add_variable("v", 1)
    ss.add_trigger("first", "v;", 0, lambda _: None)
    ss.del_trigger("first")
    ss.add_trigger("start", "v;", 0, lambda value: value == 2 and first(None), when="change")
    ss.add_trigger("first", "v;", 1e6, lambda _: None)
    ss.add_trigger("doomed", "v;", 0, lambda value: got.append(f"doomed {value}"))
    ss.add_variable("v", 2)
    sim.step()
    assert got == ["doomed 1", "first", "second"]
    sim.step()
    assert got == ["doomed 1", "first", "second", "second"]


def test_a_trigger_may_end_itself_at_once(ss, sim):
    got = []
    ss.add_trigger("once", HEIGHT, 0, lambda _: (got.append(1), ss.del_trigger("once")))
    sim.step(5)
    assert got == [1]


@pytest.mark.parametrize("interval", [0, 1 / 240, 0.01])
def test_stepping_in_a_callback_does_not_recurse(ss, sim, interval):
    """The steps are run; what became due meanwhile is evaluated after the next step."""
    calls = []

    def callback(_):
        calls.append(1)
        if len(calls) > 1:
            sim.step(24)
            assert sim.time > 0

    ss.add_trigger("t", HEIGHT, interval, callback)
    before = sim.time
    sim.step(10)
    evaluated = 10 if interval < 0.01 else len(calls) - 1
    assert len(calls) == 1 + evaluated
    assert sim.time - before == pytest.approx((10 + 24 * evaluated) / 240)


def test_stepping_another_world_in_a_callback(ss, sim, other):
    """A trigger about both is at work already; one about the other is told."""
    got, times = [], Times(other)
    ss.add_variable("n", 1)
    ss.add_function("times", lambda: sim.time + other.time)
    ss.add_trigger("both", "times();", 0, lambda _: got.append(1) or other.step(3))
    ss.add_trigger("second", "SELECT z FROM other;", 0, times)
    first = other.snapshot.number
    sim.step(4)
    assert len(got) == 5
    assert len(times) == 13
    assert other.snapshot.number == first + 12


def test_what_becomes_due_while_a_callback_steps(ss, sim):
    """Its own due times are passed over, those of others are made up for."""
    times, others = Times(sim), []
    ss.add_trigger("other", HEIGHT, 0.1, lambda _: others.append(round(sim.time * 240)))
    ss.add_trigger("t", HEIGHT, 0.1, lambda _: times(0) or sim.step(29))
    assert others == [0, 24]  # the world was not being stepped then
    sim.step(24)  # in which the callback steps from 48 to 77
    assert times == [0, 0.2]
    assert others == [0, 24, 48, 78]


def test_closing_in_a_callback(client):
    ss = ssduck.Interpreter()
    sim = ss.add_variable("sim", falling(client))
    ss.add_trigger("t", HEIGHT, 0, lambda height: height < 10 and ss.close())
    sim.step(5)  # the world is the client's owner's
    assert sim.time == pytest.approx(5 / 240)
    assert ss.triggers() == []


def test_ctrl_c_in_a_callback_is_heard(ss, sim):
    def callback(height):
        if height < 10:
            raise KeyboardInterrupt

    ss.add_trigger("t", HEIGHT, 0.1, callback)
    with pytest.raises(KeyboardInterrupt):
        sim.step(240)
    assert sim.time == pytest.approx(0.1)
    ss.del_trigger("t")
    sim.step(24)
    assert sim.time == pytest.approx(0.2)


# -- queues ------------------------------------------------------------------------------------


def until(condition):
    end = time.monotonic() + HANGS
    while not condition():
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.001)


def test_a_slow_callback_has_a_thread_of_its_own(ss, sim):
    got, threads, go = [], set(), threading.Event()

    def slow(result):
        threads.add(threading.current_thread().name)
        got.append(result)
        go.wait(HANGS)

    ss.add_variable("v", 0)
    ss.add_trigger("t", "v;", 0, slow, queue=2)
    until(lambda: got == [0])
    for value in range(1, 6):
        ss.add_variable("v", value)
        sim.step()
    found = state(ss, "t")
    assert (found.firings, found.pending, found.dropped) == (6, 2, 3)
    go.set()
    until(lambda: len(got) == 3)
    assert got == [0, 4, 5]  # the oldest went
    assert threads == {"trigger t"}


def test_a_queue_tells_of_errors(ss, sim):
    def callback(height):
        raise ValueError(f"not at {height:.4f}")

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ss.add_trigger("t", HEIGHT, 0, callback, queue=1)
        until(lambda: caught)
    assert caught[0].category is TriggerWarning
    assert "trigger 't': its callback failed: ValueError: not at 10.0" in str(caught[0].message)
    assert str(state(ss, "t").error) == "not at 10.0000"
    # What is a warning elsewhere may be an error; the thread goes on.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim.step()
        until(lambda: state(ss, "t").failures == 2)


def named(name):
    return [thread for thread in threading.enumerate() if thread.name == name]


@pytest.mark.parametrize("way", ["del_trigger", "close", "del"])
def test_threads_end(client, way):
    got = []
    ss = ssduck.Interpreter()
    sim = ss.add_variable("sim", falling(client))
    ss.add_trigger(way, HEIGHT, 0, got.append, queue=1)
    until(lambda: got)
    assert len(named(f"trigger {way}")) == 1
    if way == "close":
        ss.close()
        assert not named("trigger close")
    elif way == "del_trigger":
        ss.del_trigger(way)
        until(lambda: not named("trigger del_trigger"))
        ss.close()
    else:
        del ss
        gc.collect()
        until(lambda: not named("trigger del"))
    count = len(got)
    sim.step(3)
    assert len(got) == count


def test_a_queue_whose_callback_removes_its_trigger_and_steps(ss, sim):
    got = []

    def callback(result):
        got.append(result)
        sim.step(2)
        ss.del_trigger("t")
        ss.close()

    ss.add_trigger("t", HEIGHT, 0, callback, queue=1)
    until(lambda: not named("trigger t"))
    assert got == [10.0]
    assert sim.time == pytest.approx(2 / 240)


def test_closing_does_not_wait_for_ever(ss, sim, monkeypatch):
    monkeypatch.setattr("ssduck.interpreter.triggers.registry.PATIENCE", 0.05)
    go = threading.Event()
    got = []
    ss.add_trigger("t", HEIGHT, 0, lambda _: got.append(1) or go.wait(HANGS), queue=1)
    until(lambda: got)
    with pytest.warns(TriggerWarning, match="trigger 't': its callback is still running") as caught:
        ss.close()
    assert [w.filename for w in caught] == [__file__]
    go.set()


# -- threads and locks -------------------------------------------------------------------------


@pytest.mark.slow
def test_queries_and_steps_in_two_threads(ss, sim):
    """The interpreter's lock comes before the worlds': triggers are told under none."""
    ended, results, errors = threading.Event(), [], []

    def ask():
        try:
            while not ended.is_set():
                results.append(ss.eval("SELECT a.this FROM a=sim, b=sim AS list;"))
                ss.sql("SELECT max(z) FROM sim.entities").fetchall()
        except BaseException as error:
            errors.append(error)
            raise

    ss.add_trigger("t", HEIGHT, 0, lambda _: ss.eval(HEIGHT))
    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    stepper = threading.Thread(target=lambda: sim.step(300), daemon=True)
    stepper.start()
    stepper.join(HANGS)
    assert not stepper.is_alive(), "a deadlock"
    ended.set()
    thread.join(HANGS)
    assert not thread.is_alive()
    assert not errors
    assert results
    assert state(ss, "t").evaluations == 301


def test_two_threads_that_step(ss, sim):
    """Neither waits for the other's callbacks; all steps are run."""
    ss.add_trigger("t", HEIGHT, 0, lambda _: ss.eval(HEIGHT))
    threads = [threading.Thread(target=sim.step, args=(100,), daemon=True) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(HANGS)
        assert not thread.is_alive(), "a deadlock"
    assert sim.time == pytest.approx(200 / 240)
    before = state(ss, "t").evaluations
    sim.step()
    assert state(ss, "t").evaluations == before + 1


class Follower:
    """Wants a tick each so many seconds."""

    def __init__(self, period):
        self.period = period
        self.times = []
        self.free = []

    def due(self, world):
        return (len(self.times) + 1) * self.period

    def ticked(self, world):
        if world.reached(self.due(world)):
            self.times.append(round(world.time, 9))
        # Another thread can have the world's lock now.
        thread = threading.Thread(target=self._try, args=(world,))
        thread.start()
        thread.join()

    def _try(self, world):
        self.free.append(world.lock.acquire(timeout=HANGS))
        world.lock.release()


def test_followers(sim):
    follower = Follower(0.05)
    sim.follow(follower)
    sim.follow(follower)
    before = sim.snapshot.number
    sim.step(36)
    assert follower.times == [0.05, 0.1, 0.15]
    assert sim.snapshot.number == before + 3
    sim.tick()
    assert follower.free == [True] * 4
    sim.unfollow(follower)
    sim.step(36)
    assert len(follower.free) == 4


def test_a_world_does_not_keep_its_followers(sim):
    follower = Follower(0.05)
    gone = weakref.ref(follower)
    sim.follow(follower)
    del follower
    gc.collect()
    assert gone() is None
    before = sim.snapshot.number
    sim.step(240)
    assert sim.snapshot.number == before + 1


@sampled("queue", [None, 1], every=2)
def test_triggers_keep_nothing_alive(queue):
    ss = ssduck.load("kitchen")
    world = ss.call_variable("kitchen")
    got = []
    ss.add_trigger("t", "SELECT this FROM kitchen;", 0, got.append, queue=queue)
    world.step(2)
    until(lambda: got)
    gone = weakref.ref(ss), weakref.ref(world)
    del ss
    gc.collect()
    assert gone[0]() is None
    got.clear()
    world.step(2)
    assert got == []
    del world
    gc.collect()
    until(lambda: gone[1]() is None)


# -- what it costs -----------------------------------------------------------------------------


def test_what_it_costs_is_one_statement_an_evaluation(ss, sim, told):
    ss.add_trigger("t", HEIGHT, 0.1, lambda _: None)
    sim.step(24)
    told.clear()
    sim.step(240)
    assert len(told) == 10
    assert len(set(told)) == 1  # planned once
    assert told[0].startswith("EXECUTE")
    told.clear()
    sim.step(20)
    assert told == []


def test_nothing_is_run_if_nothing_has_changed(ss, sim, other, told):
    """Evaluated at the other world's steps as well, it runs where one of its worlds has a new tick."""
    still = ss.add_variable("still", sim.what_if())
    ss.add_variable("least", 5)
    ss.add_function("heavy", lambda thing: True)
    queries = {
        "one": "SELECT id FROM still WHERE z(this) > least AS list;",
        "impure": "SELECT print(id) FROM still AS list;",
        "users": "SELECT id FROM still WHERE heavy(this) AS list;",
        "timed": "SELECT getTime() FROM still AS list;",
    }
    for name, query in queries.items():
        ss.add_trigger(name, query, 0, lambda _: None)
    told.clear()
    # The what-if world takes no steps: what is about it alone is looked at by hand.
    triggers = ss._triggers
    for name in queries:
        before = len(told)
        triggers._evaluate(triggers._by_name[name])
        assert (len(told) == before) == (name == "one"), name
    assert state(ss, "one").evaluations == 2
    ss.add_variable("least", 20)
    triggers._evaluate(triggers._by_name["one"])
    assert state(ss, "one").result == []
    assert still.time == 0


@pytest.mark.parametrize(
    ("program", "is_known"),
    [
        ("SELECT id FROM sim WHERE z(this) > least;", True),
        ("SELECT a.this FROM a=sim, b=sim WHERE collides(a.this, b.this);", True),
        ("SELECT id FROM sim; 3;", False),
        ("v = SELECT id FROM sim;", False),
        ("EXPLAIN SELECT id FROM sim;", False),
        ("SELECT var('v') FROM sim;", False),
        ("SELECT a.this FROM a=sim, b=sim WHERE isSensing(a.this, b.this);", False),
        ("", False),
    ],
)
def test_programs_whose_results_are_known_to_stay(ss, sim, program, is_known):
    ss.add_variable("least", 5)
    ss.add_variable("v", 5)
    ss.add_trigger("t", program, 1, lambda _: None)
    assert (ss._triggers._by_name["t"].dependencies is not None) == is_known


def test_two_worlds_that_step_together(ss, sim, other, told):
    """Both tell of the same moment; the second time nothing is run."""
    ss.add_trigger("t", "SELECT a.this, b.this FROM a=sim, b=other AS list;", 0, lambda _: None)
    ss.run(0.01)
    before = state(ss, "t").evaluations
    told.clear()
    ss.run(0.05)
    moments = len([sql for sql in told if sql.startswith("EXECUTE")])
    assert moments < state(ss, "t").evaluations - before


# -- running in simulated time -----------------------------------------------------------------

# seconds, options, steps, ticks
RUNS = [
    (1.0, {}, 240, 1),
    (0.1, {}, 24, 1),
    (0.0, {}, 0, 1),
    (0.5 / 240, {}, 1, 1),  # to the nearest step
    (0.4 / 240, {}, 0, 1),
    (1.49 / 240, {}, 1, 1),
    (0.1, {"every": 10}, 24, 3),
    (0.1, {"every": 12}, 24, 2),
    (0.1, {"every": 1000}, 24, 1),
    (0.1, {"every": 1}, 24, 24),
]


@pytest.mark.parametrize(("seconds", "options", "steps", "ticks"), RUNS)
def test_run(sim, seconds, options, steps, ticks):
    before = sim.snapshot.number
    assert sim.run(seconds, **options) is sim
    assert sim.time == pytest.approx(steps / 240)
    assert sim.snapshot.number - before == ticks


def test_a_run_stops_where_triggers_are_due(ss, sim):
    times = Times(sim)
    ss.add_trigger("t", HEIGHT, 0.1, times)
    before = sim.snapshot.number
    sim.run(1.0, every=60)
    assert times == [k / 10 for k in range(11)]
    assert sim.snapshot.number - before == 12  # each 0.1 s and each 0.25 s


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"seconds": -1}, "seconds: -1 is no time"),
        ({"seconds": NAN}, "seconds: nan is no time"),
        ({"seconds": 1, "every": 0}, "every: 0 is no number of steps"),
        ({"seconds": 1, "every": 1.5}, "every: 1.5 is no number of steps"),
        ({"seconds": 1, "realtime": 0}, "realtime: 0 is no speed"),
        ({"seconds": 1, "realtime": NAN}, "realtime: nan is no speed"),
        ({"seconds": 1, "progress": "yes"}, "progress: 'yes' is not"),
    ],
)
def test_wrong_arguments_of_a_run(sim, arguments, said):
    with pytest.raises(ArgumentError, match=said):
        sim.run(**arguments)
    assert sim.time == 0


def test_several_worlds_run_in_lockstep(ss, sim, other):
    seen = []
    ss.add_trigger("a", HEIGHT, 0.25, lambda _: seen.append((sim.time, other.time)))
    ss.add_trigger("b", "SELECT z FROM other;", 0.1, lambda _: seen.append((sim.time, other.time)))
    ss.run(1.0)
    assert len(seen) == 2 + 4 + 10
    for one, two in seen:
        assert one == pytest.approx(two, abs=0.01)
    assert (sim.time, other.time) == pytest.approx((1.0, 1.0))


@settings(max_examples=30)
@given(
    steps=st.lists(
        st.sampled_from(["0.001", "0.003", "0.01", "1/240", "1/7"]), min_size=1, max_size=3
    ),
    seconds=st.floats(0, 2),
    every=st.none() | st.integers(1, 50),
)
def test_worlds_end_at_the_step_that_is_nearest(steps, seconds, every):
    clients = [pybullet.connect(pybullet.DIRECT) for _ in steps]
    try:
        worlds = []
        for client, step in zip(clients, map(Fraction, steps), strict=True):
            pybullet.setTimeStep(float(step), client)
            worlds.append(ssduck.World.attach(client))
        running.run(worlds, seconds, every=every)
        for world, step in zip(worlds, map(float, map(Fraction, steps)), strict=True):
            assert abs(world.time - seconds) <= step / 2 * (1 + 1e-9)
    finally:
        for client in clients:
            pybullet.disconnect(client)


def test_what_was_not_simulated_does_not_run(ss, sim):
    with (
        ssduck.Interpreter() as empty,
        pytest.raises(UnknownNameError, match="there is no world to run"),
    ):
        empty.run(1)
    maybe = ss.add_variable("maybe", sim.what_if())
    assert maybe.timestep == 0
    with pytest.raises(UnsupportedError, match="cannot be stepped"):
        maybe.run(1)
    ss.run(0.1)
    assert sim.time == pytest.approx(0.1)
    assert maybe.time == 0


class Clock:
    """A clock on the wall that only sleeping moves on; each step of a world takes so long."""

    def __init__(self):
        self.now = 100.0
        self.slept = []

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += seconds


@pytest.fixture
def clock(monkeypatch):
    found = Clock()
    monkeypatch.setattr(running, "time", found)
    return found


@pytest.mark.parametrize(
    ("realtime", "options", "ticks", "seconds"),
    [(True, {}, 30, 1.0), (2.0, {}, 15, 0.5), (0.5, {}, 60, 2.0), (True, {"every": 60}, 4, 1.0)],
)
def test_real_time(sim, clock, realtime, options, ticks, seconds):
    before = sim.snapshot.number
    sim.run(1.0, realtime=realtime, **options)
    assert clock.now - 100 == pytest.approx(seconds)
    assert sim.snapshot.number - before == ticks


def test_a_run_that_is_late_makes_up_for_it(ss, sim, clock):
    def late(height):
        if 9 < height < 10:
            clock.now += 0.25

    ss.add_trigger("t", "SELECT z FROM sim AS value;", 0.4, late)
    sim.run(1.0, realtime=True)
    assert clock.now - 100 == pytest.approx(1.0)
    assert 0.0 in clock.slept


def test_the_bar_is_for_terminals(sim, capsys):
    sim.run(0.1, progress=True)
    assert capsys.readouterr() == ("", "")
    sim.run(0.1, progress="always")
    out, err = capsys.readouterr()
    assert out == ""
    assert "0.1 of 0.1 s simulated" in err
    assert sim.time == pytest.approx(0.2)


def test_ctrl_c_ends_a_run_at_a_tick(sim):
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        sim.run(1e6)
    timer.join()
    assert 0 < sim.time < 1e6
    assert sim.time == sim._simulator.time
    assert sim["ball"].position[2] == pytest.approx(
        pybullet.getBasePositionAndOrientation(0, sim._simulator.client)[0][2]
    )


def test_a_client_that_goes_ends_a_run(ss, sim, client):
    ss.add_trigger("t", HEIGHT, 0.1, lambda height: height < 10 and pybullet.disconnect(client))
    with pytest.raises(SimulatorError, match="disconnected"):
        sim.run(1)
    assert sim.time == pytest.approx(0.1)
