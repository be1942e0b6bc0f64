"""Names that users of PyBullet bring: the error says what to write, and nothing that is far from it."""

from __future__ import annotations

import pytest

import ssduck
from ssduck.errors import SelectScriptError


@pytest.fixture(scope="module")
def ss(stage):
    for name in ("cup", "can"):
        stage.sphere(name, radius=0.1, mass=1)
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", stage.open())
        yield ss


# (call, what the error says to write)
WORDS = [
    ("getBasePositionAndOrientation(sim.cup)", "write position(e) and orientation(e)"),
    ("getBaseVelocity(sim.cup)", "write velocity(e)"),
    ("getLinkState(sim.cup, 0)", "position(room.panda.hand)"),
    ("getJointState(sim.cup, 0)", "joint(entity, 'name')"),
    ("joint_position(sim.cup, 'j')", "joint(entity, 'name')"),
    ("getNumJoints(sim.cup)", "joint(entity, 'name')"),
    ("getContactPoints(sim.cup)", "inContact(a, b)"),
    ("getClosestPoints(sim.cup, sim.can, 1)", "nearestPoints(a, b)"),
    ("getAABB(sim.cup)", "did you mean 'aabb'?"),
    ("is_on(sim.cup, sim.can)", "did you mean 'on'?"),
    ("get_distance(sim.cup, sim.can)", "did you mean 'distance'?"),
    ("isUpright(sim.cup)", "did you mean 'upright'?"),
    ("stacked(sim.cup, sim.can)", "write on(support, thing)"),
    ("is_stacked_on(sim.cup, sim.can)", "write on(support, thing)"),
    ("isGrasping(sim.cup, sim.can)", "write grasped(a, b)"),
    ("isHolding(sim.cup, sim.can)", "write grasped(a, b)"),
    ("gap(sim.cup, sim.can)", "write clearance(a, b)"),
    ("closestTo(sim.cup)", "ORDER BY distance(this, room.cup) LIMIT 1"),
    ("upsideDown(sim.cup)", "write tilt(e) > 2.8"),
    ("angvel(sim.cup)", "write angularVelocity(e)"),
    ("canSee(sim.cup, sim.can)", "write isSensing(sensor, entity)"),
    ("attached(sim.cup, sim.can)", "constraints of the simulator are not kept"),
    ("between(z(sim.cup), 0, 1)", "write x BETWEEN a AND b"),
    ("range(5)", "a list is written [0, 1, 2]"),
    ("touches(sim.cup, sim.can)", "write touching(a, b)"),
    ("stepSimulation()", "queries change no world"),
    ("abov(sim.cup, sim.can)", "did you mean 'above'?"),
    ("SELECT id FROM sim WHERE on", "write on(sim.cup, this), say"),
    ("SELECT id FROM sim WHERE near", "write near(a, b, d), say"),
    ("SELECT id FROM sim WHERE mas > 1", "did you mean 'mass'?"),
]


@pytest.mark.parametrize(("call", "advice"), WORDS)
def test_the_error_says_what_to_write(ss, call, advice):
    with pytest.raises(SelectScriptError) as caught:
        ss.eval(f"{call};")
    assert advice in str(caught.value).splitlines()[0]


@pytest.mark.parametrize("word", ["slacker", "gab", "ranged", "canSeam", "stacker"])
def test_what_is_near_to_no_function_is_given_none(ss, word):
    with pytest.raises(SelectScriptError) as caught:
        ss.eval(f"{word}(sim.cup);")
    assert caught.value.suggestions == ()


@pytest.mark.parametrize(
    "program", ["distance(sim.cup, p);", "SELECT id FROM sim WHERE distance(this, p) < 1;"]
)
def test_a_point_with_nan_is_told_of(ss, program):
    with pytest.raises(SelectScriptError, match="a number of the list is NaN"):
        ss.eval(program, {"p": [0, 0, float("nan")]})
