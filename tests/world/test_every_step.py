"""`step` and `run` take a tick at each physics step: what happened when is exact to a step."""

import os
import signal
import threading

import pybullet
import pytest

import ssduck
from tests.support.stage import Stage

STEP = 1 / 240


def falling_ball():
    """Returns a client with a ball above a floor."""
    stage = Stage()
    pybullet.setGravity(0, 0, -9.81, stage.client)
    stage.box("floor", half=[1, 1, 0.1])
    body = stage.sphere("ball", (0, 0, 0.5), radius=0.1, mass=1)
    pybullet.changeDynamics(body, -1, restitution=0.8, physicsClientId=stage.client)
    return stage.client


@pytest.fixture
def twins():
    """Two clients of the same simulation: ssduck steps one, the test the other."""
    clients = falling_ball(), falling_ball()
    yield clients
    for client in clients:
        pybullet.disconnect(client)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["step", "run", "interpreter"])
def test_contacts_are_exact_to_a_step(twins, way):
    mine, plain = twins
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.attach(mine, names={0: "floor", 1: "ball"}))
        if way == "step":
            sim.step(240)
        else:
            (sim if way == "run" else ss).run(1.0)
        heights, points = [], []
        for step in range(1, 241):
            pybullet.stepSimulation(plain)
            heights.append(pybullet.getBasePositionAndOrientation(1, plain)[0][2])
            found = pybullet.getContactPoints(physicsClientId=plain)
            points += [(step + 1, point[9]) for point in found if point[8] <= 0 or point[9] > 0]
        rows = ss.sql("SELECT tick, force FROM contacts_history ORDER BY tick").fetchall()
        assert sorted(rows) == sorted(points) != []
        rows = ss.sql(
            "SELECT z FROM entities_history WHERE name = 'ball' AND tick > 1 ORDER BY tick"
        )
        assert [z for (z,) in rows.fetchall()] == heights
        touching = {tick - 1 for tick, _ in points}
        bounds = [n for n in range(1, 241) if (n in touching) != (n - 1 in touching)]
        intervals = ss.eval("holds(inContact(sim.floor, sim.ball));")
        expected = [[a * STEP, b * STEP] for a, b in zip(bounds[::2], bounds[1::2], strict=False)]
        assert intervals[: len(expected)] == [pytest.approx(pair, abs=1e-12) for pair in expected]


@pytest.mark.parametrize(
    ("steps", "options", "ticks"),
    [
        (0, {}, 1),
        (1, {}, 1),
        (10, {}, 10),
        (10, {"every": 1}, 10),
        (10, {"every": 3}, 4),
        (10, {"every": 5}, 2),
        (10, {"every": 10}, 1),
        (10, {"every": 11}, 1),
        (10, {"every": None}, 1),
    ],
)
@pytest.mark.parametrize("way", ["step", "run"])
def test_every(twins, steps, options, ticks, way):
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.attach(twins[0]))
        if way == "step":
            sim.step(steps, **options)
        else:
            sim.run(steps * STEP, **options)
        assert sim.time == pytest.approx(steps * STEP)
        times = ss.past("sim").times
        assert len(times) == 1 + ticks
        assert times[-1] == sim.time


def test_ticks_that_nobody_gets_are_not_taken(twins):
    class Observer:
        ticks = 0

        def due(self, _):
            return float("inf")

        def ticked(self, _):
            self.ticks += 1

    sim = ssduck.World.attach(twins[0])
    sim.step(10)
    sim.run(10 * STEP)
    assert sim.snapshot.number == 3
    observer = Observer()
    sim.follow(observer)
    sim.step(10)
    sim.run(10 * STEP, every=5)
    assert observer.ticks == 12
    assert sim.snapshot.number == 15
    sim.unfollow(observer)
    sim.step(10)
    assert sim.snapshot.number == 16
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", sim)
        sim.step(10)
        assert sim.snapshot.number == 17
        ss.record("sim", ssduck.Recording(every=5))
        sim.step(10)
        assert len(ss.past("sim").times) == 3
        what_if = ss.add_variable("other", sim.what_if())
        with pytest.raises(ssduck.SelectScriptError, match="cannot be stepped"):
            what_if.step(2)


@pytest.mark.slow
def test_worlds_in_lockstep_keep_their_own_steps():
    clients = falling_ball(), falling_ball()
    pybullet.setTimeStep(1 / 100, clients[1])
    with ssduck.Interpreter() as ss:
        for number, client in enumerate(clients):
            ss.add_variable(f"sim{number}", ssduck.World.attach(client))
        ss.run(1.0)
        assert len(ss.past("sim0").times) == 241
        assert len(ss.past("sim1").times) == 101
    for client in clients:
        pybullet.disconnect(client)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.003, 0.01, 0.02, 0.03, 0.05, 0.08])
def test_ctrl_c_leaves_whole_ticks(twins, seconds):
    """Wherever it comes, the tables are those of the simulator, and no tick is lost or partial."""
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.attach(twins[0]))
        timer = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):  # noqa: PT012  # it may come at once
            timer.start()
            sim.step(10**6)
        timer.join()
        position, _ = pybullet.getBasePositionAndOrientation(1, twins[0])
        assert ss.sql(
            "SELECT z FROM entities WHERE kind = 'kinbody' ORDER BY id DESC"
        ).fetchone() == (pytest.approx(position[2], abs=1e-12),)
        steps = round(sim.time / STEP)
        rows = ss.sql("SELECT tick, count(*) FROM entities_history GROUP BY tick ORDER BY tick")
        assert rows.fetchall() == [(tick, 2) for tick in range(1, steps + 2)]
        assert ss.past("sim").ticks == list(range(1, steps + 2))
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
