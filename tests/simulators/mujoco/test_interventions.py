"""Bodies of MuJoCo worlds that hold others, do not collide, are hidden or removed."""

import numpy as np
import pytest

import ssduck
from ssduck.errors import RemovedEntityError, StateError, UnsupportedError
from tests.support.mjcf import simulated

mujoco = pytest.importorskip("mujoco")

YARD = """<mujoco model="yard"><option timestep="0.002"/><worldbody>
<geom name="floor" type="plane" size="0 0 1"/>
<body name="gripper" pos="0 0 1"><joint name="lift" type="slide" axis="0 0 1" damping="20"/>
  <geom type="box" size=".1 .1 .02" mass="2" friction=".01"/>
  <body name="finger" pos=".12 0 -.06"><geom type="box" size=".02 .1 .08" mass=".1" friction=".01"/></body>
</body>
<body name="ball" pos="0 0 .93"><freejoint/><geom type="sphere" size=".05" mass=".3" friction=".01"/></body>
<body name="crate" pos="2 0 .1"><freejoint/><geom type="box" size=".1 .1 .1" mass="1" rgba="1 0 0 1"/>
  <geom type="sphere" size=".01" contype="0" conaffinity="0" pos="0 0 .1"/></body>
<body name="lid" pos="2 0 .22"><freejoint/><geom type="box" size=".1 .1 .02" mass=".2"/></body>
</worldbody>
<actuator><position name="servo" joint="lift" kp="2000" kv="200"/></actuator>
{}</mujoco>"""


@pytest.fixture
def yard(tmp_path):
    (tmp_path / "yard.xml").write_text(YARD.format(""))
    with ssduck.load(tmp_path / "yard.xml") as ss:
        yield ss["yard"]


def attached(extra=""):
    model, data = simulated(YARD.format(extra))
    return ssduck.World.attach(model, data), model, data


def ids(world):
    return {entity.name: entity.id for entity in world}


# -- holding ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_what_is_held_goes_where_the_gripper_goes(yard):
    gripper, ball = yard["gripper"], yard["ball"]
    before, known = np.array(ball.position), ids(yard)
    gripper.hold(ball)
    assert ball.position == pytest.approx(before)  # it moves nothing
    gripper.drive({"lift": 0.4})
    yard.step(1500)
    apart = np.array(ball.position) - gripper.position
    assert ball.position[2] == pytest.approx(before[2] + 0.4, abs=0.03)
    assert apart == pytest.approx(before - [0, 0, 1.0], abs=5e-3)
    with pytest.raises(StateError, match="gripper holds ball already"):
        gripper.hold(ball)
    gripper.release(ball)
    yard.step(200)
    assert ball.position[2] < before[2] + 0.2  # it falls
    with pytest.raises(StateError, match="gripper does not hold ball"):
        gripper.release(ball)
    assert ids(yard) == known
    assert yard.simulator.episode == 0


@pytest.mark.slow
def test_a_link_holds_what_touches_it(yard):
    with pytest.raises(StateError, match="0 links of 'finger' and beyond are within"):
        yard["gripper"].hold(yard["ball"], "finger")
    yard["ball"].move([0.05, 0, 0.93])
    yard["gripper"].hold(yard["ball"], "finger")
    yard.step(200)
    assert yard["ball"].position == pytest.approx([0.05, 0, 0.93], abs=0.02)


def test_there_are_so_many_holds(yard):
    """The ninth one is told what to do."""
    holding = yard.simulator.add_constraint
    bodies = {body.name: body for body in yard.simulator._bodies}
    for _ in range(8):
        holding(bodies["gripper"], 0, bodies["ball"])
    with pytest.raises(UnsupportedError, match=r"all 8 of the model hold something.*declare <weld"):
        holding(bodies["gripper"], 0, bodies["lid"])


def test_a_model_of_the_users_needs_a_weld():
    world, _, _ = attached()
    with pytest.raises(UnsupportedError, match=r"the model has none.*name='ssduck_hold' body1="):
        world["gripper"].hold(world["ball"])
    spare = "<equality><weld name='ssduck_hold' body1='gripper' active='false'/></equality>"
    world, model, data = attached(spare)
    world["gripper"].hold(world["ball"])
    mujoco.mj_step(model, data, 500)
    world.tick()
    assert world["ball"].position[2] > 0.8
    assert world.simulator.episode == 0


@pytest.mark.slow
def test_copies_and_saved_worlds_hold_on(yard, tmp_path):
    yard["gripper"].hold(yard["ball"])
    yard["gripper"].drive({"lift": 0.1})
    yard.step(300)
    copy = yard.excerpt(yard)
    with ssduck.load(yard.save(tmp_path / "saved")) as ss:
        saved = ss["yard"]
        for world in (yard, copy, saved):
            world.step(300)
            assert world["ball"].position[2] == pytest.approx(yard["ball"].position[2], abs=1e-3)
        assert yard["ball"].position[2] > 0.9
    copy["gripper"].release(copy["ball"])
    copy.step(300)
    assert copy["ball"].position[2] < 0.8
    assert yard["ball"].position[2] > 0.9


# -- collisions, pictures, removal --------------------------------------------------------------


@pytest.mark.slow
def test_a_disabled_body_falls_through_and_keeps_its_shapes(yard):
    known = ids(yard)
    yard.step(50)
    yard["crate"].enabled = False
    assert not yard["crate"].enabled
    assert ids(yard) == known
    low, high = np.array(yard["crate"].aabb)
    assert high - low == pytest.approx([0.2, 0.2, 0.2], abs=0.01)
    yard.step(100)
    assert yard["crate"].position[2] < 0.0
    assert yard["lid"].position[2] < 0.2
    yard["crate"].move([2, 1, 0.5])
    yard["crate"].enabled = True
    yard.step(500)
    assert yard["crate"].position[2] == pytest.approx(0.1, abs=0.01)
    assert ids(yard) == known


@pytest.mark.slow
def test_a_disabled_body_of_explicit_pairs(tmp_path):
    pair = "<contact><pair geom1='a' geom2='b'/></contact>"
    text = (
        "<mujoco><worldbody><body name='low'><geom name='a' type='box' size='1 1 .1' contype='0' "
        "conaffinity='0'/></body><body name='high' pos='0 0 .21'><freejoint/><geom name='b' size='.1' "
        f"contype='0' conaffinity='0'/></body></worldbody>{pair}</mujoco>"
    )
    (tmp_path / "pairs.xml").write_text(text)
    with ssduck.load(tmp_path / "pairs.xml") as ss:
        world = ss["pairs"]
        world.step(100)
        assert world["high"].position[2] > 0.19
        world["low"].enabled = False
        world.step(200)
        assert world["high"].position[2] < 0.0
        world["high"].move([0, 0, 0.5])
        world["low"].enabled = True
        world.step(1000)
        assert world["high"].position[2] == pytest.approx(0.2, abs=0.02)


def test_rays_pass_through_a_disabled_body(yard):
    yard.add_sensor(
        "range_finder",
        "gripper",
        "eye",
        position=(2, 0, 0),
        orientation=(0.5**0.5, 0, 0.5**0.5, 0),
        max_range=5.0,
    )
    ss = ssduck.Interpreter()
    ss.add_variable("yard", yard)
    for is_enabled, seen in ((True, "lid"), (False, "crate"), (True, "lid")):
        yard["lid"].enabled = is_enabled
        assert ss.eval("SELECT id FROM yard WHERE isSensing(yard.eye, this) AS list;") == [seen]


def test_a_hidden_body_is_transparent_and_collides(yard):
    model = yard.simulator.model
    geoms = np.flatnonzero(model.geom_bodyid == model.body("crate").id)
    before = model.geom_rgba[geoms].copy()
    yard["crate"].visible = False
    assert not yard["crate"].visible
    assert (model.geom_rgba[geoms, 3] == 0).all()
    assert yard["lid"].visible
    yard.step(100)
    assert yard["lid"].position[2] > 0.2
    yard["crate"].visible = True
    assert np.array_equal(model.geom_rgba[geoms], before)


@pytest.mark.slow
def test_a_removed_body_is_gone(yard, tmp_path):
    crate = yard["crate"]
    yard.remove("crate")
    assert {entity.name for entity in yard} == {"world", "gripper", "ball", "lid"}
    with pytest.raises(RemovedEntityError):
        crate.position  # noqa: B018
    yard.step(300)
    assert yard["lid"].position[2] == pytest.approx(0.02, abs=0.01)
    with pytest.raises(UnsupportedError, match="crate: a MuJoCo model still has bodies"):
        yard.save(tmp_path / "saved")
    copy = yard.excerpt(["lid", "world"])
    assert {entity.name for entity in copy} == {"world", "lid"}


def test_what_is_switched_off_is_on_in_a_new_model():
    models = [mujoco.MjModel.from_xml_string(YARD.format("")) for _ in range(2)]
    pairs = [(model, mujoco.MjData(model)) for model in models]
    made = pairs[:1]
    world = ssduck.World.attach(lambda: made[-1])
    world["crate"].enabled = False
    world["lid"].visible = False
    made.append(pairs[1])
    world.tick()
    assert world["crate"].enabled
    assert world["lid"].visible
    assert models[0].geom_contype.tolist() != models[1].geom_contype.tolist()


@pytest.mark.slow
def test_copies_keep_what_is_off_and_files_do_not(yard, tmp_path):
    yard["crate"].enabled = False
    yard["lid"].visible = False
    copy = yard.excerpt(yard)
    for world in (yard, copy):
        assert not world["crate"].enabled
        assert not world["lid"].visible
        low, high = np.array(world["crate"].aabb)
        assert high - low == pytest.approx([0.2, 0.2, 0.2], abs=0.01)
    copy["crate"].enabled = copy["lid"].visible = True
    copy.step(200)
    assert copy["crate"].position[2] == pytest.approx(0.1, abs=0.01)
    assert copy.simulator.model.geom_rgba[:, 3].min() == 1.0
    with pytest.warns(
        UserWarning, match="crate, lid: MJCF has no bodies that are disabled or hidden"
    ):
        file = yard.save(tmp_path / "saved")
    with ssduck.load(file) as ss:
        ss["yard"].step(200)
        assert ss["yard"]["crate"].position[2] == pytest.approx(0.1, abs=0.01)
    assert not yard["crate"].enabled
