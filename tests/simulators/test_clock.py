"""Simulated time is the number that a user writes for it, against the quotients of whole numbers."""

import math

import pybullet
import pytest

import ssduck
from ssduck.simulators.clock import Clock
from tests.support.bodies import solid


@pytest.mark.parametrize("rate", [50, 60, 100, 120, 200, 240, 333, 500, 1000, 2000])
def test_time_is_rounded_once(rate):
    assert [Clock(1 / rate, 0.0, steps).time for steps in range(3000)] == [
        steps / rate for steps in range(3000)
    ]


def test_time_goes_on_from_a_time_and_by_another_step():
    assert Clock(0.1, 0.1, 2).time == 0.3  # 0.1 + 2 * 0.1 is 0.30000000000000004
    assert Clock(0.03).after(7, 0.03).time == 0.21  # 7 * 0.03 is not
    assert Clock(0.002).after(300, 0.002).after(100, 0.001).time == 0.7
    odd = math.sqrt(2) / 1000
    assert Clock(odd).after(3, odd).time == pytest.approx(3 * odd, rel=1e-15)
    assert math.isnan(Clock(math.nan, 0.0, 1).time)


def test_a_query_up_to_a_time_has_its_tick(client):
    pybullet.setTimeStep(1 / 50, client)
    ball = solid(client, pybullet.GEOM_SPHERE, 1, radius=0.1)
    world = ssduck.World.attach(client, names={ball: "ball"})
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        for _ in range(40):
            pybullet.stepSimulation(client)
            world.tick()
        asked = "SELECT count(*) FROM sim{{}} WHERE time {} 0.7 AS value"
        assert ss.eval(asked.format("=")) == 1
        assert ss.eval(asked.format("<=")) == 36
