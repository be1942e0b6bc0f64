"""`torque` is the sum of the moments of MuJoCo's contact forces, as `mj_contactForce` tells them."""

import warnings

import mujoco
import numpy as np
import pytest

import ssduck
from tests.support.mjcf import simulated
from tests.support.warned import heard

pytestmark = pytest.mark.slow

# A bar that slides and turns on two balls.
SCENE = """<mujoco><option cone="{cone}"/><worldbody>
  <geom type="plane" size="0 0 1" condim="1"/>
  <body name="bar" pos="0 0 .1"><freejoint/>
    <geom type="sphere" size=".1" pos="-.3 0 0" condim="{dim}" margin="{margin}" friction=".9 .3 .2"/>
    <geom type="sphere" size=".1" pos=".4 .1 0" condim="{dim}" margin="{margin}" friction=".9 .3 .2"/>
    <body pos="0 .3 0"><joint axis="0 0 1"/><geom size=".05" pos="0 .1 0"/></body>
  </body></worldbody></mujoco>"""


def sliding(cone, dim, margin):
    """A bar on the floor that slides and turns."""
    model, data = simulated(SCENE.format(cone=cone, dim=dim, margin=margin))
    data.qpos[2] += margin / 2 - 0.005
    data.qvel[:] = [0.5, 0.2, 0, 0.3, 0, 3, 1]
    mujoco.mj_step(model, data, 2)
    return model, data


def moments(model, data, place):
    """The moments of the forces on the bar about a place, and those without a force."""
    of_forces, others = np.zeros(3), np.zeros(3)
    for number in range(data.ncon):
        contact, wrench = data.contact[number], np.zeros(6)
        mujoco.mj_contactForce(model, data, number, wrench)
        force, moment = wrench.reshape(2, 3) @ contact.frame.reshape(3, 3)
        of_forces += np.cross(contact.pos - place, force)
        others += moment
    return of_forces, others


@pytest.mark.parametrize("margin", [0, 0.04])
@pytest.mark.parametrize("dim", [3, 4, 6])
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_the_forces_act_where_mujoco_applies_them(cone, dim, margin):
    model, data = sliding(cone, dim, margin)
    place = data.body("bar").xpos.copy()
    expected, others = moments(model, data, place)
    assert np.abs(expected).max() > 0.1
    with ssduck.Interpreter() as ss, warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        lab = ss.add_variable("lab", ssduck.World.attach(model, data))
        assert ss.eval("torque(lab.bar);") == pytest.approx(expected, abs=1e-12)
        [(in_sql,)] = ss.sql("SELECT torque(e) FROM lab.entities e WHERE name = 'bar'").fetchall()
        assert in_sql == pytest.approx(expected, abs=1e-12)
        mujoco.mj_step(model, data, 1)
        lab.tick()
        assert ss.eval("initially(torque(lab.bar));") == pytest.approx(expected, abs=1e-12)
    texts = [str(w.message) for w in told if "torsional" in str(w.message)]
    assert len(texts) == (np.abs(others).max() > 0) == (dim > 3), told


@pytest.mark.parametrize(("dim", "told"), [(3, 0), (4, 1)])
def test_moments_of_the_past_are_told_of(dim, told):
    model, data = sliding("elliptic", dim, 0)
    with ssduck.Interpreter() as ss:
        lab = ss.add_variable("lab", ssduck.World.attach(model, data))
        data.qpos[2], data.qvel[:] = 5, 0  # nothing touches it any more
        for _ in range(2):
            mujoco.mj_step(model, data)
            lab.tick()
        program = "[initially(torque(lab.bar)), torque(lab.bar)];"
        (before, now), texts = heard(lambda: ss.eval(program), "torque lacks")
        assert np.abs(before).max() > 0.1
        assert now == [0, 0, 0]
        assert texts == (
            ["'lab': torque lacks the moments of torsional and rolling friction, which contacts of "
             "condim 4 and 6 have; mj_contactForce tells them"] * told
        )  # fmt: skip


def test_forces_alone_tell_of_no_moments():
    model, data = sliding("elliptic", 6, 0)
    with ssduck.Interpreter() as ss, warnings.catch_warnings():
        warnings.simplefilter("error")
        ss.add_variable("lab", ssduck.World.attach(model, data))
        assert ss.eval("force(lab.bar);")[2] > 0
