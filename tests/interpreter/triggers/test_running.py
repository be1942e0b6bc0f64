"""Worlds that run in simulated time."""

import os
import signal
import threading
from fractions import Fraction

import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck.errors import ArgumentError, SimulatorError, UnknownNameError, UnsupportedError
from ssduck.world import stepping
from tests.support.cases import sampled
from tests.support.triggering import HEIGHT, Times

# seconds, options, steps, ticks
RUNS = [
    (1.0, {"every": None}, 240, 1),
    (0.1, {"every": None}, 24, 1),
    (0.1, {}, 24, 24),
    (0.0, {}, 0, 1),
    (0.5 / 240, {}, 1, 1),  # to the nearest step
    (0.4 / 240, {}, 0, 1),
    (1.49 / 240, {}, 1, 1),
    (1.0, {}, 240, 240),
    (0.1, {"every": 10}, 24, 3),
    (0.1, {"every": 12}, 24, 2),
    (0.1, {"every": 1000}, 24, 1),
    (0.1, {"every": 1}, 24, 24),
]


@sampled(("seconds", "options", "steps", "ticks"), RUNS, every=3)
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
        ({"seconds": 1, "every": 0}, "every: 0 is no number of steps"),
        ({"seconds": 1, "realtime": 0}, "realtime: 0 is no speed"),
        ({"seconds": 1, "progress": "yes"}, "progress: 'yes' is not"),
    ],
)
def test_wrong_arguments_of_a_run(sim, arguments, said):
    with pytest.raises(ArgumentError, match=said):
        sim.run(**arguments)
    assert sim.time == 0


@pytest.mark.slow
def test_several_worlds_run_in_lockstep(ss, sim, other):
    seen = []
    ss.add_trigger("a", HEIGHT, 0.25, lambda _: seen.append((sim.time, other.time)))
    ss.add_trigger("b", "SELECT z FROM other;", 0.1, lambda _: seen.append((sim.time, other.time)))
    ss.run(1.0)
    assert len(seen) == 2 + 4 + 10
    for one, two in seen:
        assert one == pytest.approx(two, abs=0.01)
    assert (sim.time, other.time) == pytest.approx((1.0, 1.0))


@pytest.mark.slow
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
        stepping.run(worlds, seconds, every=every)
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
    monkeypatch.setattr(stepping, "time", found)
    return found


@pytest.mark.parametrize(
    ("realtime", "options", "ticks", "seconds"),
    [
        (True, {}, 240, 1.0),
        (2.0, {"every": 16}, 15, 0.5),
        (0.5, {}, 240, 2.0),
        (True, {"every": 60}, 4, 1.0),
        (True, {"every": None}, 1, 1.0),
    ],
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


@pytest.mark.slow
def test_ctrl_c_ends_a_run_at_a_tick(sim):
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        sim.run(1e6)
    timer.join()
    assert 0 < sim.time < 1e6
    assert sim.time == sim.simulator.time
    assert sim["ball"].position[2] == pytest.approx(
        pybullet.getBasePositionAndOrientation(0, sim.simulator.client)[0][2]
    )


def test_a_client_that_goes_ends_a_run(ss, sim, client):
    ss.add_trigger("t", HEIGHT, 0.1, lambda height: height < 10 and pybullet.disconnect(client))
    with pytest.raises(SimulatorError, match="disconnected"):
        sim.run(1)
    assert sim.time == pytest.approx(0.1)
