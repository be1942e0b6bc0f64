"""Which results fire a trigger, and errors."""

import contextlib
from collections import Counter

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck.errors import ArgumentError, UnknownNameError
from ssduck.interpreter.triggers.conditions import (
    canonical_key,
    copy_of,
    difference,
    is_true,
    rows_of,
)
from ssduck.interpreter.triggers.registry import TriggerWarning
from tests.support.cases import sampled
from tests.support.triggering import HEIGHT, NAN, Times, state
from tests.support.warned import silent

# -- what fires ----------------------------------------------------------------------------------


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


@sampled(("options", "results", "expected"), FIRED, every=2)
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


@pytest.mark.parametrize("paused", [0, 1])
def test_debounce_is_simulated_time_in_which_a_trigger_is_not_paused(ss, sim, paused):
    """0.25 s at evaluations each 0.1 s: the third one after the first."""
    times = Times(sim)
    ss.add_variable("v", 1)
    ss.add_trigger("t", "v;", 0.1, times, debounce=0.25)
    if paused:
        ss.pause_trigger("t")
        sim.step(240)
        ss.resume_trigger("t")
    sim.step(240)
    assert times == [[0.3], [1.4]][paused]


ROWS = st.lists(st.one_of(st.integers(0, 3), st.lists(st.integers(0, 1), max_size=2)), max_size=6)


@pytest.mark.slow
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


# -- errors --------------------------------------------------------------------------------------


@sampled(
    ("arguments", "said"),
    [
        ({"interval": -0.1}, "interval: -0.1 is no time; seconds, 0 or more"),
        ({"threshold": -1}, "threshold: -1 is less than 0"),
        ({"threshold": NAN}, "threshold: nan is no finite number of metres"),
        ({"when": "rise"}, "when: 'rise' is none of .*did you mean 'rising'"),
        ({"when": 1}, "when: 1 is none of"),
        ({"rows": 1}, "rows: 1 is not True or False"),
        ({"queue": 0}, "queue: 0 is no size; 1 or more"),
        ({"name": ""}, "name: '' is not a non-empty text"),
        ({"name": 3}, "name: 3 is not a non-empty text"),
        ({"program": 3}, "program: 3 is neither a text nor a compiled program"),
        ({"callback": 3}, "callback: 3 is no function"),
    ],
    every=4,
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
    with silent():
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


# -- episodes --------------------------------------------------------------------------------------

LOW = "z(sim.lab_1) < 9;"


@pytest.mark.parametrize(
    ("options", "program", "expected"),
    [
        ({}, LOW, [[True], [True]]),
        ({"when": "rising"}, LOW, [[True], [True]]),
        ({"when": "falling"}, f"NOT {LOW}", [[], []]),
        ({"rows": True}, "SELECT id FROM sim AS list;", [[1], []]),  # still those of the last call
        ({"rows": True, "when": "rising"}, "SELECT id FROM sim AS list;", [[1], [0]]),
    ],
)
@pytest.mark.parametrize("interval", [0.0, 0.004])
def test_an_episode_begins_with_a_first_result(client, interval, options, program, expected):
    body = pybullet.createMultiBody(1, basePosition=[0, 0, 1], physicsClientId=client)
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.attach(client, names={body: "lab_1"}))
        got = []
        ss.add_trigger("low", program, interval, got.append, **options)
        found = []
        for _ in range(2):
            for _ in range(5):
                pybullet.stepSimulation(client)
                sim.tick()
            found.append(shown(got))
            got.clear()
            sim.begin_episode()
    assert found == expected


def shown(got):
    """The results of a trigger; how many rows were added, where it gets changes."""
    return [one if one is True else len(one.added) for one in got]


def test_an_episode_of_another_world_begins_nothing(client, ss, sim):
    with ssduck.Interpreter() as other:
        mine = other.add_variable("mine", ssduck.World.attach(client))
        yours = other.add_variable("yours", ssduck.World.attach(pybullet.connect(pybullet.DIRECT)))
        got = []
        other.add_trigger("there", "SELECT id FROM mine AS list;", 0, got.append)
        yours.begin_episode()
        mine.tick()
        assert len(got) == 1
        mine.begin_episode()
        assert len(got) == 2


@pytest.mark.parametrize("when", ["change", "rising"])
def test_another_world_of_the_name_begins_with_a_first_result(client, when):
    other = pybullet.connect(pybullet.DIRECT)
    got = []
    with ssduck.Interpreter() as ss:
        for number in (client, other):
            body = pybullet.createMultiBody(1, basePosition=[0, 0, 1], physicsClientId=number)
            sim = ss.add_variable("sim", ssduck.World.attach(number, names={body: "lab_1"}))
            if number == client:
                ss.add_trigger("low", LOW, 0, got.append, when=when)
            ss.add_variable("v", number)  # binds no world
            sim.step(3)
    pybullet.disconnect(other)
    assert got == [True, True]
