"""What people first give a batch: resets by time, masks, arrays of another order, contacts in part."""

import gymnasium
import mujoco
import numpy as np
import pytest

import ssduck
from ssduck.errors import ArgumentError, ProgramWarning
from ssduck.gym import VectorQueryWrapper
from tests.support.of_model import OfModel

REST = """
<mujoco><worldbody>
  <geom type="plane" size="2 2 .1"/>
  <body name="goal" mocap="true" pos="0 0 1"><geom size=".02" contype="0" conaffinity="0"/></body>
  <body name="box" pos="0 0 .05"><freejoint/>
    <geom type="box" size=".05 .05 .05" mass="1"/><site name="top" pos="0 0 .05"/>
  </body>
  <body name="arm" pos="1 0 1"><joint name="j" axis="0 1 0"/><geom size=".05" contype="0"/></body>
</worldbody></mujoco>
"""


@pytest.fixture
def ss():
    with ssduck.Interpreter() as ss:
        yield ss


def at_rest(xml=REST, steps=300):
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, steps)
    mujoco.mj_forward(model, data)
    return model, data


def batch(ss, count, xml=REST):
    """A model, its data at rest, and a batch `sim`."""
    model, data = at_rest(xml)
    return model, data, ss.add_variable("sim", ssduck.World.batch(model, count))


def many(data, count, *names):
    return {name: np.stack([getattr(data, name)] * count) for name in names}


GRIP = """
<mujoco><option gravity="0 0 0"/><worldbody>
  <body name="hand" pos="0 0 1"><freejoint/>
    <geom type="box" size=".01 .03 .03" pos="-.039 0 0"/>
    <geom type="sphere" size=".01" pos="{place}"/>
  </body>
  <body name="cube" pos="0 0 1"><freejoint/><geom type="capsule" size=".03 .001"/></body>
</worldbody></mujoco>
"""


@pytest.mark.parametrize(("place", "expected"), [(".039 0 0", True), ("-.039 0 .0", False)])
def test_a_grasp_does_not_depend_on_the_order_of_geoms(ss, place, expected):
    model, data = at_rest(GRIP.format(place=place), 0)
    normals = []
    for number, contact in enumerate(data.contact):
        force = np.zeros(6)
        mujoco.mj_contactForce(model, data, number, force)
        is_first = model.geom_bodyid[contact.geom1] == model.body("hand").id
        normals += [contact.frame[:3] * (1 if is_first else -1)] if force[0] > 0 else []
    assert any(a @ b <= -0.5 for a in normals for b in normals) is expected
    sim = ss.add_variable("sim", ssduck.World.batch(model, 2))
    sim.tick([data, data])
    assert ss.eval("grasped(sim.hand, sim.cube);").tolist() == [expected] * 2
    assert ss.eval("grasped(sim.cube, sim.hand);").tolist() == [expected] * 2


def test_the_world_of_an_environment_has_its_contacts(ss):
    _, data, sim = batch(ss, 2)
    sim.tick([data, data])
    one = ss.add_variable("one", sim.environment(1))
    force = ss.eval("force(one.box)[2];")
    assert force == pytest.approx(9.81, abs=1e-3)
    assert ss.eval("[inContact(one.box, one.world), contactForce(one.box, one.world)];") == [
        True,
        pytest.approx(9.81, abs=1e-3),
    ]
    assert len(ss.sql("SELECT * FROM one.contacts").fetchall()) == data.ncon
    assert one.time == data.time


def test_contacts_that_a_later_state_lacks_are_an_error(ss):
    _, data, sim = batch(ss, 2)
    sim.tick([data, data])
    assert ss.eval("force(sim.box)[2];") == pytest.approx([9.81] * 2, abs=1e-3)
    sim.tick(**many(data, 2, "xpos", "xquat"), time=data.time)
    for program in ("force(sim.box)[2];", "inContact(sim.box, sim.world);"):
        with pytest.raises(ArgumentError, match="contacts of these environments are not known"):
            ss.eval(program)


def test_whole_forces_need_whole_contacts(ss):
    model, data, sim = batch(ss, 1)
    forces = np.zeros((data.ncon, 6))
    for number in range(data.ncon):
        mujoco.mj_contactForce(model, data, number, forces[number])
    contact = {
        "geom": data.contact.geom[None],
        "dist": data.contact.dist[None],
        "force": forces[None, :, 0],
        "frame": data.contact.frame[None],
    }
    sim.tick(**many(data, 1, "xpos", "xquat"), contact=contact)
    assert ss.eval("contactForce(sim.box, sim.world);") == pytest.approx([9.81], abs=1e-3)
    for relation in ("force", "torque"):
        with pytest.raises(ArgumentError, match=f"{relation} needs the places and the frictions"):
            ss.eval(f"norm({relation}(sim.box)) < 1;")


def test_an_episode_begins_where_the_time_falls(ss, tmp_path):
    model, data = at_rest()
    sim = ss.add_variable("sim", ssduck.World.batch(model, 2, history=10))
    terms = ss.terms(
        reward={
            "least": "least(z(sim.box))[1]",
            "rate": "rate(z(sim.box))",
            "first": "initially(z(sim.box))",
            "held": "heldFor(z(sim.box) > 0)",
        }
    )
    qpos = many(data, 2, "qpos", "mocap_pos", "mocap_quat")
    for times, height in (
        ((0, 0), 0.5),
        ((1, 1), 0.3),
        ((2, 2), 0.4),
        ((0, 3), 0.9),
        ((1, 4), 0.8),
    ):
        qpos["qpos"][:, 2] = height
        sim.tick(**qpos, time=np.array(times, float))
        parts = terms().parts
    assert parts["least"] == pytest.approx([0.8, 0.3])
    assert parts["rate"] == pytest.approx([-0.1, -0.1])
    assert parts["first"] == pytest.approx([0.9, 0.5])
    assert parts["held"].tolist() == [1.0, 4.0]
    assert len(ss.export_batch(tmp_path / "lake")) == 3
    answers = ssduck.lake(tmp_path / "lake").ask("greatest(z(sim.box))[1];")
    assert sorted(answers["answer"].to_pylist()) == pytest.approx([0.5, 0.9, 0.9])


def test_of_ticks_of_one_time_the_last_one_counts(ss):
    _, data, sim = batch(ss, 2)
    terms = ss.terms(reward={"rate": "rate(z(sim.box))", "first": "initially(z(sim.box))"})
    qpos = many(data, 2, "qpos", "mocap_pos", "mocap_quat")
    found = []
    for time, height in ((0, 0.4), (0, 0.5), (1, 0.6), (1, 0.8)):
        qpos["qpos"][:, 2] = height
        sim.tick(**qpos, time=float(time))
        parts = terms().parts
        found.append((parts["rate"][0], parts["first"][1]))
    assert np.array(found) == pytest.approx(np.array([(0, 0.4), (0, 0.5), (0.1, 0.5), (0.3, 0.5)]))


def test_a_time_that_falls_beside_told_resets_is_told_of(ss):
    _, data, sim = batch(ss, 3)
    state = many(data, 3, "xpos", "xquat")
    sim.tick(**state, time=1.0)
    sim.reset([0])
    sim.tick(**state, time=np.array([0.0, 1.1, 1.1]))
    with pytest.warns(ProgramWarning, match="time has fallen in environment 2 without reset"):
        sim.tick(**state, time=np.array([0.1, 1.2, 0.0]))
    assert (sim.began == [2, 1, 3]).all()


def test_numbers_that_look_like_a_mask_are_an_error(ss):
    model, _ = at_rest()
    sim = ssduck.World.batch(model, 3)
    for wrong in (np.array([1, 0, 1]), [0, 0, 0]):
        with pytest.raises(
            ArgumentError, match=r"a mask has True and False, as mask.astype\(bool\)"
        ):
            sim.reset(wrong)
    for nothing in ([], np.zeros(0, int), np.zeros(3, bool)):
        sim.reset(nothing)
    ssduck.World.batch(model, 2).reset([0, 1])


def test_a_world_that_is_not_at_its_place_is_an_error(ss):
    _, data, sim = batch(ss, 2)
    state = many(data, 2, "xpos", "xquat")
    sim.tick(**state)
    for wrong in ({"xquat": state["xquat"][..., [1, 2, 3, 0]]}, {"xpos": state["xpos"] + 1}):
        with pytest.raises(ArgumentError, match="the first body is the world, at"):
            sim.tick(**state | wrong)
    assert ss.eval("z(sim.box);") == pytest.approx([data.body("box").xpos[2]] * 2)


def test_mocap_bodies_are_where_the_states_say(ss):
    _, data, sim = batch(ss, 2)
    state = many(data, 2, "qpos", "mocap_pos", "mocap_quat")
    state["mocap_pos"][:, 0] = [[0, 0, 2], [1, 0, 3]]
    sim.tick(**state)
    assert ss.eval("position(sim.goal);").tolist() == [[0, 0, 2], [1, 0, 3]]
    with pytest.warns(ProgramWarning, match="goal: no joint moves what is a mocap body"):
        sim.tick(qpos=state["qpos"])


def test_poses_of_a_body_with_a_site_are_those_of_its_base(ss):
    model, data = at_rest()
    with ssduck.Interpreter(recording=None) as base:
        world = base.add_variable("w", ssduck.World.attach(model, data))
        sim = ss.add_variable("sim", ssduck.World.batch(world, 2))
    pose = np.array([[0, 0, 0.7, 1, 0, 0, 0], [0, 0, 0.7, 0, 1, 0, 0.0]])
    sim.tick(poses={"box": pose})
    assert ss.eval("z(sim.box);").tolist() == [0.7, 0.7]
    assert ss.eval("z(sim.box.top);") == pytest.approx([0.75, 0.65])
    sim.tick(poses={"arm": pose + [1, 0, 0, 0, 0, 0, 0]})
    with pytest.raises(ArgumentError, match="joints of arm are not known: give tick joints="):
        ss.eval("joint(sim.arm, 'j');")
    sim.tick(poses={"arm": pose}, joints={"arm": np.array([[0.1], [0.2]])})
    assert ss.eval("joint(sim.arm, 'j');").tolist() == [0.1, 0.2]


def test_errors_say_what_arrays_have_to_do_with_them(ss):
    model, _ = at_rest()
    ss.add_variable("sim", ssduck.World.batch(model, 3))
    ss.add_variable("goal", np.array([0.1, 0.2, 0.3]))
    with pytest.raises(ssduck.SelectScriptError, match=r"goal has a value for each of 3 .*tolist"):
        ss.eval("distance(sim.box, goal);")
    ss.add_variable("goal", np.zeros((2, 3)))
    with pytest.raises(ssduck.SelectScriptError, match=r"of shape \(2, 3\), and there are 3 env"):
        ss.eval("distance(sim.box, goal);")


def test_a_term_that_is_nothing_is_not_told_of_as_nan(ss):
    _, data, sim = batch(ss, 2)
    terms = ss.terms(reward="since(z(sim.box) > 0.6)")
    sim.tick([data, data])
    with pytest.raises(ArgumentError, match=r"no pose is NaN: .* heldFor is 0 there"):
        terms()


BALL = """
<mujoco><worldbody>
  <body name="wall" pos="1 0 1"><geom type="box" size=".1 1 1"/></body>
  <body name="ball" pos="0 0 1"><freejoint/><geom size="{}"/></body>
</worldbody></mujoco>
"""


@pytest.mark.parametrize("size", [0.1, 0.3])
def test_a_vector_of_models_that_differ_is_told_of(size, recwarn):
    envs = gymnasium.vector.SyncVectorEnv(
        [lambda: OfModel(BALL.format(0.1)), lambda: OfModel(BALL.format(size))]
    )
    wrapped = VectorQueryWrapper(envs, reward="clearance(sim.ball, sim.wall)")
    wrapped.reset(seed=0)
    told = [str(w.message) for w in recwarn if "models of environments" in str(w.message)]
    assert len(told) == (size != 0.1)
    wrapped.close()


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
@pytest.mark.parametrize("adhesion", [0, 3])
def test_forces_of_constraints_are_those_of_contacts(ss, cone, adhesion):
    text = REST.replace("<mujoco>", f'<mujoco><option cone="{cone}"/>')
    if adhesion:
        if not hasattr(mujoco.MjModel, "geom_adhesion"):
            pytest.skip("MuJoCo has adhesion since 4")
        text = text.replace('type="plane"', f'type="plane" adhesion="{adhesion}"')
    _, data, sim = batch(ss, 2, text)
    names = ["geom", "dist", "efc_address", "dim"] + ["adhesion"] * bool(adhesion)
    contact = {name: np.stack([getattr(data.contact, name)] * 2) for name in names}
    poses = many(data, 2, "xpos", "xquat", "efc_force")
    sim.tick(**poses, contact=contact)
    weight = pytest.approx([9.81] * 2, abs=1e-3)
    assert ss.eval("contactForce(sim.box, sim.world);") == weight
    sim.tick([data, data])
    assert ss.eval("contactForce(sim.box, sim.world);") == weight
    if contact.pop("adhesion", None) is not None:
        with pytest.raises(ArgumentError, match="adhesion is"):
            sim.tick(**poses, contact=contact | {"adhesion": np.zeros((2, 9))})
        with pytest.raises(ArgumentError, match="contact needs adhesion"):
            sim.tick(**poses, contact=contact)
