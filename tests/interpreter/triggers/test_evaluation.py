"""When triggers are evaluated, and for which worlds."""

import math
from fractions import Fraction

import numpy as np
import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from tests.support.cases import sampled
from tests.support.triggering import HEIGHT, Times, falling, state

# -- when it is evaluated ------------------------------------------------------------------------


@pytest.mark.slow
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


@sampled(("steps", "interval", "evaluations", "ticks"), EVALUATED, every=3)
def test_how_often(ss, sim, steps, interval, evaluations, ticks):
    ss.add_trigger("t", HEIGHT, interval, lambda _: None)
    before = sim.snapshot.number
    assert sim.step(steps, every=None) is sim
    assert state(ss, "t").evaluations == 1 + evaluations
    assert sim.snapshot.number - before == ticks


@pytest.mark.slow
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
                sim.step(count, every=None)
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
    sim.step(84, every=None)
    assert sim.snapshot.number == before + 1
    ss.resume_trigger("t")  # at 0.45 s
    ss.resume_trigger("t")
    assert not state(ss, "t").paused
    sim.step(36)
    assert times == [0, 0.1, 0.5, 0.6]


# -- which worlds --------------------------------------------------------------------------------


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


@pytest.mark.slow
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


def test_a_program_without_worlds_has_its_first_result():
    got = []
    with ssduck.Interpreter() as ss:
        ss.add_trigger("t", "SELECT this FROM [1, 2] AS list;", 0.1, got.append)
    assert got == [[1, 2]]
