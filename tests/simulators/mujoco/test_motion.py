"""Moving, driving and asking what if, compared with MuJoCo's own kinematics."""

from copy import copy as copied

import numpy as np
import pytest

import ssduck
from ssduck.errors import StateError, UnknownNameError, UnsupportedError
from tests.support.mjcf import LAB, random_state, simulated

mujoco = pytest.importorskip("mujoco")

# Every kind of joint in every order on one body, off its origin, with references other than 0.
CHAIN = """
<mujoco><worldbody>
  <body name="robot" pos=".1 .2 .3" quat=".8 .1 -.4 .2">
    <joint name="x" type="slide" axis="1 0 0"/><joint name="turn" axis="0 .6 .8" pos=".1 .2 -.1" ref="20"/>
    <joint name="lift" type="slide" axis="0 0 1" ref=".3"/><geom size=".1"/>
    <body name="elbow" pos=".3 .1 0" quat=".7 .2 .3 -.1">
      <joint name="a" axis="1 0 0" pos="0 .1 .2"/><joint name="b" axis="0 1 0" pos=".2 0 0" ref="-30"/>
      <joint name="c" axis=".6 0 .8" pos=".05 .1 .1"/><geom size=".1"/>
      <body pos="0 0 .4"><joint name="slide" type="slide" axis="0 1 0"/><geom size=".1"/>
        <body pos=".1 0 0"><joint name="wrist" type="ball" pos="0 .1 0"/><geom size=".1"/>
          <body pos=".1 .1 0"><joint name="tip" axis="0 1 0" pos=".2 0 0"/><geom size=".1"/></body>
  </body></body></body></body>
  <body name="mixed" pos="3 0 0"><joint name="first" type="slide" axis="1 0 0"/>
    <joint name="ball" type="ball"/><geom size=".1"/></body>
</worldbody></mujoco>
"""
SCALAR = ("x", "turn", "lift", "a", "b", "c", "slide", "tip")


@pytest.fixture(scope="module")
def chain():
    return mujoco.MjModel.from_xml_string(CHAIN)


@pytest.fixture
def lab():
    model, data = simulated(LAB)
    return ssduck.World.attach(model, data), model, data


def states_of(world):
    world.request_tables(["links"])
    return world.snapshot.tables["links"].doubles("x", "wz").T


@pytest.mark.parametrize("seed", range(6))
def test_what_if_moves_joints_as_mujoco_does(chain, seed):
    """Joints that are given are at rest at their positions; the others keep their velocities."""
    data, other = mujoco.MjData(chain), mujoco.MjData(chain)
    random_state(chain, data, seed)
    rng = np.random.default_rng(seed)
    moved = dict.fromkeys(rng.choice(SCALAR, rng.integers(1, 5), replace=False).tolist())
    moved = {name: float(rng.uniform(-1, 1)) for name in moved}
    other = copied(data)
    for name, position in moved.items():
        joint = chain.joint(name)
        other.qpos[joint.qposadr[0]], other.qvel[joint.dofadr[0]] = position, 0.0
    mujoco.mj_forward(chain, other)
    asked = ssduck.World.attach(chain, data).what_if(joints={"robot": moved})
    expected = ssduck.World.attach(chain, other)
    found, known = states_of(asked), states_of(expected)
    signs = np.sign(np.sum(found[:, 3:7] * known[:, 3:7], axis=1))[:, None]
    assert found[:, :3] == pytest.approx(known[:, :3], abs=1e-9)
    assert found[:, 3:7] * signs == pytest.approx(known[:, 3:7], abs=1e-9)
    # A link whose only joint moved is at rest relative to its parent; others add up.
    assert found[:, 7:] == pytest.approx(known[:, 7:], abs=1e-9)


def test_what_if_needs_the_positions_of_later_joints(chain):
    data = mujoco.MjData(chain)
    world = ssduck.World.attach(chain, data)
    with pytest.raises(UnsupportedError, match=r"'ball' moves a link with others.*not one number"):
        world.what_if(joints={"mixed": {"first": 0.1}})


def test_what_if_moves_bodies(lab):
    world, _, data = lab
    asked = world.what_if({"ball": [1, 0, 0, 0, 5, 6, 7], "arm": [0, 0, 0, 1, 1, 1, 1]})
    assert list(asked["ball"].position) == [5, 6, 7]
    assert list(asked["arm"].position) == [1, 1, 1]
    assert np.array_equal(world["ball"].position, data.xpos[3])


def test_bodies_are_moved_in_the_data_and_fixed_ones_in_the_model(lab):
    world, model, data = lab
    data.qvel[:] = 1.0
    world["ball"].move([1, 2, 3], [0, 0, 0, 2])
    assert list(world["ball"].pose) == [0, 0, 0, 1, 1, 2, 3]
    joint = model.joint(model.body("ball").jntadr[0])
    assert data.qvel[joint.dofadr[0] :][:6].tolist() == [0] * 6
    assert data.qvel[:6].tolist() == [1] * 6  # the box
    world["hand"].move([4, 4, 4])
    assert data.mocap_pos[0].tolist() == list(world["hand"].position) == [4, 4, 4]
    world["table"].move([0, 0, 0.3])
    assert model.body("table").pos.tolist() == list(world["table"].position) == [0, 0, 0.3]
    with pytest.raises(UnsupportedError, match="the base of 'arm' moves by its joints: set turn"):
        world["arm"].move([0, 0, 0])
    with pytest.raises(UnsupportedError, match="the world body does not move"):
        world["world"].move([0, 0, 0])


def test_joints_are_set_by_name_and_within_limits(lab):
    world, model, data = lab
    data.qvel[:] = 1.0
    world["arm"].move(joints={"bend": 0.5, "turn": -2.0})
    assert data.joint("bend").qpos[0] == 0.5
    assert data.joint("turn").qvel[0] == 0.0
    assert data.joint("push").qvel[0] == 1.0
    assert {j.name: j.position for j in world["arm"].joints}["turn"] == -2.0
    kept = copied(data)
    mujoco.mj_kinematics(model, kept)
    assert np.array_equal(data.xpos, kept.xpos)
    for joints, error, text in (
        ({"bent": 0}, UnknownNameError, "no joint 'bent'; did you mean 'bend'"),
        ({"bend": 2.0}, StateError, "limits"),
        ({"wrist": 0.1}, ssduck.errors.ArgumentError, "is spherical; only"),
    ):
        with pytest.raises(error, match=text):
            world["arm"].move(joints=joints)


def test_joints_are_driven_by_servos(lab):
    world, model, data = lab
    world["arm"].drive({"bend": 0.4}, velocities={"turn": -1.5})
    assert (data.actuator("servo").ctrl[0], data.actuator("spin").ctrl[0]) == (0.4, -1.5)
    for arguments, text in (
        (({"push": 0.1},), "no position actuator; it has 'force'"),
        ((None, {"bend": 1.0}), "no velocity actuator; it has 'servo'"),
        (({"bend": 0.1}, None, {"bend": 5.0}), "is that of its model"),
    ):
        with pytest.raises(UnsupportedError, match=text):
            world["arm"].drive(*arguments)
    model.actuator("servo").ctrllimited, model.actuator("servo").ctrlrange = 1, [-0.1, 0.1]
    with pytest.raises(StateError, match=r"the control 0\.3 is not from -0\.1 to 0\.1"):
        world["arm"].drive({"bend": 0.3})
    assert data.actuator("servo").ctrl[0] == 0.4


def test_servos_of_a_loaded_file_hold_what_is_set(tmp_path):
    path = tmp_path / "lab.xml"
    path.write_text(LAB)
    with ssduck.load(path, recording=None) as ss:
        arm = ss.call_variable("lab")["arm"]
        arm.move(joints={"bend": 0.7})
        assert arm.world.simulator.data.actuator("servo").ctrl[0] == 0.7


# An actuator with two controls, which MuJoCo 4 has, before one with one.
SERVOS = """
<mujoco><option gravity="0 0 0"/><worldbody>
  <body name="a"><joint name="ja" type="slide"/><geom size=".1"/></body>
  <body name="b" pos="1 0 0"><joint name="jb" type="slide"/><geom size=".1"/></body>
</worldbody>
<actuator>
  <dcmotor name="motor" joint="ja" motorconst="1" resistance="1" input="pos vel" controller="10 0 5"/>
  <position name="servo" joint="jb" kp="100" kv="10" ctrlrange="-.5 .5"/>
</actuator></mujoco>
"""


@pytest.mark.skipif(not hasattr(mujoco.MjModel, "actuator_ctrladr"), reason="MuJoCo before 4")
def test_actuators_with_several_controls(tmp_path):
    path = tmp_path / "pair.xml"
    path.write_text(SERVOS)
    with ssduck.load(path, recording=None) as ss:
        world = ss.call_variable("pair")
        data = world.simulator.data
        world["b"].move(joints={"jb": 0.1})
        assert data.ctrl.tolist() == [0.0, 0.0, 0.1]
        world["b"].drive({"jb": 0.3})
        assert data.ctrl.tolist() == [0.0, 0.0, 0.3]
        world.step(500)
        assert world["b"].joints[0].position == pytest.approx(0.3, abs=0.1)
        with pytest.raises(StateError, match=r"the control 0\.6 is not from -0\.5 to 0\.5"):
            world["b"].drive({"jb": 0.6})
        with pytest.raises(UnsupportedError, match="no position actuator; it has 'motor'"):
            world["a"].drive({"ja": 0.1})


@pytest.mark.slow
def test_records_have_several_joints_of_a_link(lab, tmp_path):
    """The kinematics of a past tick need anchors, references and positions of the record."""
    world, model, data = lab
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", world)
        with ss.record_to(tmp_path / "run"):
            random_state(model, data, 3)
            data.time += 1.0
            world.tick()
        expected = states_of(world.what_if(joints={"arm": {"push": 0.2, "bend": -0.3}}))
    with ssduck.open(tmp_path / "run") as ss:
        past = ss.call_variable("lab")
        found = states_of(past.what_if(joints={"arm": {"push": 0.2, "bend": -0.3}}))
        assert found == pytest.approx(expected, abs=1e-12)
        assert ss.eval("joint(lab.arm, 'bend');") == data.joint("bend").qpos[0]
        rows = ss.sql("SELECT name, anchor_z, reference FROM lab.joints_model WHERE link = 1")
        assert rows.fetchall() == [("push", 0.0, 0.1), ("bend", 0.1, 0.0)]
