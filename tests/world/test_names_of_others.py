"""Names and arguments of other libraries, and entities that were removed: errors say what there is."""

import pybullet
import pybullet_data
import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    RemovedEntityError,
    SelectScriptError,
    SqlError,
    UnknownNameError,
)


@pytest.fixture
def ball(client):
    pybullet.setGravity(0, 0, -10, physicsClientId=client)
    return pybullet.createMultiBody(1, basePosition=[0, 0, 5], physicsClientId=client)


@pytest.fixture
def ss(client, ball):
    with ssduck.Interpreter() as interpreter:
        world = ssduck.World.attach(client, names={ball: "ball"})
        interpreter.add_variable("lab", world).step(3)
        yield interpreter


# -- names ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("find", "name", "told"),
    [
        (lambda ss: ss, "remove_trigger", "del_trigger"),
        (lambda ss: ss, "query", "eval"),
        (lambda ss: ss, "save", "export"),
        (lambda ss: ss, "step", "run"),
        (lambda ss: ss["lab"], "eval", "ss.eval"),
        (lambda ss: ss["lab"], "dt", "timestep"),
        (lambda ss: ss["lab"], "reset", "begin_episode"),
        (lambda ss: ss["lab"], "history", "ss.past"),
        (lambda ss: ss["lab"]["ball"], "pos", "position"),
        (lambda ss: ss["lab"]["ball"], "set_pose", "move"),
        (lambda ss: ss["lab"]["ball"], "joint", "joints"),
    ],
)
def test_a_name_of_another_library_has_a_counterpart(ss, find, name, told):
    thing = find(ss)
    with pytest.raises(AttributeError, match=rf"has no attribute '{name}'; .*{told}"):
        getattr(thing, name)
    assert hasattr(type(ss) if "ss." in told else type(thing), told.removeprefix("ss."))
    assert "INSTEAD_OF" not in dir(thing)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda lab: lab.tick(dt=0.1), r"tick: .* 'dt'; .*tick\(steps=n\), or tick\(time=…\)"),
        (lambda lab: lab.tick(step=1), r"tick: .* 'step'; the arguments are steps, time; did you"),
        (lambda lab: lab.step(seconds=1), r"step: .* 'seconds'; run\(seconds\)"),
        (lambda lab: lab.run(1.0, time_step=0.1), r"run: .* 'time_step'; .*\.timestep"),
        (lambda lab: lab["ball"].move(pos=[0, 0, 1]), r"move: .* 'pos'; .* position=\[x, y, z\]"),
        (lambda lab: lab["ball"].move(quat=[1, 0, 0, 0]), r"move: .* 'quat'; .*xyzw="),
    ],
)
def test_an_argument_of_another_library_has_a_counterpart(ss, call, told):
    before = ss["lab"].time
    with pytest.raises(ArgumentError, match=told):
        call(ss["lab"])
    assert ss["lab"].time == before


@pytest.mark.slow
def test_joints_and_links_are_had_by_name(client):
    path = f"{pybullet_data.getDataPath()}/franka_panda/panda.urdf"
    arm = pybullet.loadURDF(path, useFixedBase=True, physicsClientId=client)
    pybullet.resetJointState(arm, 3, -1.5, physicsClientId=client)
    panda = ssduck.World.attach(client, names={arm: "panda"})["panda"]
    told = pybullet.getJointInfo(arm, 3, physicsClientId=client)
    joint = panda.joints[told[1].decode()]
    assert joint.position == pybullet.getJointState(arm, 3, physicsClientId=client)[0]
    assert joint.name == panda.joints[3].name
    assert panda.links[told[12].decode()] == panda.links[4]
    assert [one.name for one in panda.joints[1:3]] == [one.name for one in panda.joints][1:3]
    with pytest.raises(UnknownNameError, match=r"there is no 'panda_jiont4'; .*'panda_joint4'"):
        panda.joints["panda_jiont4"]


# -- sensors -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("rgb", "ball"), r"no sensor type 'rgb'; the types are depth_camera, "),
        (("ball", "lidar"), r"on: .* no entity 'lidar'.*type comes first: add_sensor\(type, on\)"),
        (("lidar", "bal"), r"add_sensor: on: world 'lab' has no entity 'bal'; did you mean 'ball'"),
    ],
)
def test_a_wrong_sensor_is_told_of(ss, arguments, told):
    with pytest.raises(SelectScriptError, match=told):
        ss["lab"].add_sensor(*arguments, max_range=1.0)


# -- what was removed ----------------------------------------------------------------------------


@pytest.mark.slow
def test_a_removed_entity_is_told_of_with_its_time(client, ss, ball, tmp_path):
    lab = ss["lab"]
    handle, z = lab["ball"], lab["ball"].position[2]
    link = handle.links[0]
    pybullet.removeBody(ball, client)
    lab.step()
    removal = rf"it was removed at {lab.time:g} s; .*lab{{…}}\.ball is that of an earlier time"
    for ask in (
        lambda: lab["ball"],
        lambda: ss.eval("z(lab.ball);"),
        lambda: ss.eval("SELECT id FROM lab WHERE above(lab.ball, this);"),
    ):
        with pytest.raises(UnknownNameError, match=rf"no entity 'ball'; {removal}"):
            ask()
    with pytest.raises(RemovedEntityError, match=removal):
        assert handle.position
    with pytest.raises(RemovedEntityError, match=removal):
        assert link.entity
    with pytest.raises(UnknownNameError, match=r"no entity 'other'$"):
        lab["other"]
    earlier = f"z(lab{{{lab.time - lab.timestep}}}.ball);"
    assert ss.eval(earlier) == z
    ss.export(tmp_path / "run")
    with ssduck.open(tmp_path / "run") as record:
        with pytest.raises(UnknownNameError, match=r"at other ticks of the record: lab{…}\.ball"):
            record.eval("z(lab.ball);")
        assert record.eval(earlier) == z
        with pytest.raises(ArgumentError, match=r"stays at its tick: it is there at other ticks"):
            record.eval(earlier.replace("z(", "greatest(z(").replace(")", "))"))
        last = lab.time - lab.timestep
        with pytest.raises(UnknownNameError) as caught:
            record.eval("greatest(z(lab.ball));")
        advice = caught.value.message.rpartition(", as ")[2].replace("{t}", f"{{{last}}}")
        assert record.eval(f"{advice};")[1] == pytest.approx(5.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "wrong",
    [
        "greatest(z(lab.ball));",
        "at({t}, z(lab.ball));",
        "greatest(z(lab{{{t}}}.ball));",
        "holds(collides(lab.ball, lab{{{t}}}.ball));",
    ],
)
def test_what_is_said_of_the_past_of_a_removed_entity_works(client, ss, ball, wrong):
    lab = ss["lab"]
    lab.step(5)
    pybullet.removeBody(ball, client)
    lab.step()
    with pytest.raises(SelectScriptError) as caught:
        ss.eval(wrong.format(t=lab.timestep))
    advice = caught.value.message.rpartition(", as ")[2]
    assert advice.startswith("SELECT greatest(z(this)) FROM lab{")
    _, found = ss.eval(f"{advice};")
    assert found == pytest.approx(5.0)  # where it was let fall
    of_all = advice.replace("greatest(z(this))", "holds(z(this) > -9)")
    assert ss.eval(f"{of_all};")[0][1] == pytest.approx(lab.time - lab.timestep)


def test_a_removed_sensor_is_told_of(ss):
    lab = ss["lab"]
    lab.add_sensor("lidar", "ball", "eye", max_range=1.0)
    lab.remove_sensor("eye")
    with pytest.raises(UnknownNameError, match=r"no entity 'eye'; it was removed at"):
        lab["eye"]
    lab.add_sensor("lidar", "ball", "eye", max_range=1.0)
    assert lab["eye"].kind == "sensor"
    lab.remove_sensor("eye")
    lab.begin_episode()
    with pytest.raises(UnknownNameError, match=r"no entity 'eye', only ball$"):
        lab["eye"]


# -- the past in SQL -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("statement", "told"),
    [
        ("FROM lab.history", "write entities_history, links_history"),
        ("SELECT * FROM history", "write entities_history"),
        ("FROM lab.entities{0.0}", "The past has tables of its own in SQL: .*entities_history"),
        ("SELECT z FROM lab{-0.5}", "The past has tables of its own(?s:.*)This is SelectScript"),
        ("FROM lab.before", "those of all recorded ticks entities_history and so on"),
    ],
)
def test_the_past_in_sql_has_tables_of_its_own(ss, statement, told):
    with pytest.raises(SqlError, match=told):
        ss.sql(statement)
    assert ss.sql("SELECT count(*) FROM entities_history").fetchall() == [(4,)]
    assert ss.sql("SELECT {'x': 1} AS point FROM entities").fetchall() == [({"x": 1},)]
