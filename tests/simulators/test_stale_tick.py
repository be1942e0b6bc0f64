"""A loop that forgets `tick` is told at each query of a tick left behind, once in each place."""

import threading

import pybullet
import pytest

import ssduck
from ssduck import ProgramWarning
from tests.support.bodies import solid
from tests.support.urdf import joint, link, robot
from tests.support.warned import heard

QUERIES = [
    ("program", lambda ss: ss.eval("SELECT id, z FROM sim;")),
    ("handle", lambda ss: ss.eval("z(ball);")),
    ("sql", lambda ss: ss.sql("SELECT z FROM entities").fetchall()),
    ("table", lambda ss: ss.sql("SELECT * FROM joints").fetchall()),
    ("history", lambda ss: ss.sql("SELECT count(*) FROM entities_history").fetchall()),
    ("temporal", lambda ss: ss.eval("holds(z(ball) > 0);")),
    ("what if", lambda ss: ss.call_variable("sim").what_if()),
]


@pytest.fixture
def sim(client):
    """A ball that falls beside a floor that stands still, in a client that the test steps."""
    pybullet.setGravity(0, 0, -9.81, client)
    shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, physicsClientId=client)
    pybullet.createMultiBody(0, shape, basePosition=[5, 0, 0], physicsClientId=client)
    pybullet.createMultiBody(1, shape, basePosition=[0, 0, 1], physicsClientId=client)
    world = ssduck.World.attach(client, names={0: "floor", 1: "ball"})
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        ss.add_variable("ball", world["ball"])
        yield ss, world


def warned(act):
    return heard(act, "has moved on")[1]


@pytest.mark.parametrize(("name", "query"), QUERIES, ids=[name for name, _ in QUERIES])
def test_every_query_says_so_once(client, sim, name, query):
    ss, _ = sim
    assert warned(lambda: query(ss)) == []  # nothing has moved yet
    pybullet.stepSimulation(client)
    with pytest.warns(ProgramWarning, match=r"sim: the client has moved on .* call tick\(\)"):
        query(ss)
    for _ in range(3):
        pybullet.stepSimulation(client)
        assert warned(lambda: query(ss)) == []


def test_each_place_is_told_once(client, sim):
    ss, world = sim

    def loop():
        for _ in range(3):
            pybullet.stepSimulation(client)
            ss.eval("SELECT z FROM sim;")
            ss.eval("z(ball);")

    assert len(warned(loop)) == 2
    world.tick()
    assert warned(lambda: ss.eval("z(ball);")) == []
    pybullet.stepSimulation(client)
    assert len(warned(lambda: ss.eval("z(ball);"))) == 1


@pytest.mark.parametrize("is_loaded_again", [False, True])
def test_a_reset_without_a_tick_is_told_again(client, sim, *, is_loaded_again):
    ss, world = sim

    def ask():
        ss.eval("z(ball);")

    pybullet.stepSimulation(client)
    assert len(warned(ask)) == 1
    pybullet.resetSimulation(physicsClientId=client)
    if is_loaded_again:
        for height in (0, 1):
            pybullet.createMultiBody(height, basePosition=[0, 0, height], physicsClientId=client)
    (message,) = warned(ask)
    assert "begin_episode() after a reset" in message
    assert warned(ask) == []
    world.begin_episode()
    assert warned(lambda: ss.eval("SELECT z FROM sim;")) == []


@pytest.mark.parametrize("change", ["step", "reset", "teleport", "model"])
def test_what_a_loop_changes_in_mujoco(change):
    mujoco = pytest.importorskip("mujoco")
    text = (
        "<mujoco><worldbody><body name='a' pos='0 0 1'><freejoint/><geom size='.1'/></body>"
        "</worldbody></mujoco>"
    )

    class Environment:
        def __init__(self):
            self.model = mujoco.MjModel.from_xml_string(text)
            self.data = mujoco.MjData(self.model)

    environment = Environment()
    mujoco.mj_step(environment.model, environment.data)
    with ssduck.Interpreter() as ss:
        ss["sim"] = world = ssduck.World.attach(environment)
        assert warned(lambda: ss.eval("z(sim.a);")) == []
        match change:
            case "step":
                mujoco.mj_step(environment.model, environment.data)
            case "reset":
                mujoco.mj_resetData(environment.model, environment.data)
            case "teleport":
                environment.data.qpos[0] = 2
                mujoco.mj_forward(environment.model, environment.data)
            case _:
                environment.__init__()
        assert len(warned(lambda: ss.eval("z(sim.a);"))) == 1
        world.tick()
        assert warned(lambda: ss.eval("z(sim.a);")) == []


@pytest.mark.slow
def test_a_loop_that_takes_its_ticks_is_not_told(client, sim):
    ss, world = sim

    def loop():
        for _ in range(30):
            pybullet.stepSimulation(client)
            world.tick()
            for _, query in QUERIES:
                query(ss)
        world.step(5)
        world.run(0.1)
        ss.eval("SELECT z FROM sim;")
        world["ball"].move([0, 0, 2])
        ss.eval("SELECT z FROM sim;")

    assert warned(loop) == []
    pybullet.resetBasePositionAndOrientation(1, [0, 0, 3], [0, 0, 0, 1], client)
    assert len(warned(lambda: ss.eval("SELECT z FROM sim;"))) == 1


def test_a_joint_that_moves_counts(client, write):
    """The base of an arm stands still."""
    limit = '<limit lower="-1" upper="1" effort="10" velocity="1"/>'
    model = robot(
        link("a"), link("b", com=(0.1, 0, 0)), joint("j", "revolute", "a", "b", limit=limit)
    )
    path = str(write("arm.urdf", model))
    pybullet.loadURDF(path, useFixedBase=True, physicsClientId=client)
    world = ssduck.World.attach(client)
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        assert warned(lambda: ss.eval("SELECT id FROM sim;")) == []
        pybullet.resetJointState(0, 0, 0.5, physicsClientId=client)
        assert len(warned(lambda: ss.eval("SELECT id FROM sim;"))) == 1


@pytest.mark.slow
def test_a_world_that_ssduck_steps_is_never_compared(monkeypatch):
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        kitchen.step(2)

        def fail(*_, **__):
            raise AssertionError

        monkeypatch.setattr(kitchen.simulator, "read_link_poses", fail)
        assert warned(lambda: ss.eval("SELECT id FROM kitchen;")) == []


def test_another_thread_may_ask_between_a_step_and_its_tick(client, sim):
    ss, _ = sim
    pybullet.stepSimulation(client)

    def ask():
        thread = threading.Thread(target=lambda: ss.eval("SELECT id FROM sim;"))
        thread.start()
        thread.join()

    assert warned(ask) == []
    assert len(warned(lambda: ss.eval("SELECT id FROM sim;"))) == 1


def test_a_client_that_is_gone_is_not_compared(client, sim):
    ss, _ = sim
    pybullet.stepSimulation(client)
    pybullet.disconnect(client)
    assert warned(lambda: ss.eval("SELECT id, z FROM sim;")) == []


def test_bodies_that_come_and_go(client, sim):
    ss, world = sim
    pybullet.removeBody(1, client)
    assert len(warned(lambda: ss.eval("SELECT id FROM sim;"))) == 1
    world.tick()
    pybullet.createMultiBody(1, basePosition=[0, 0, 1], physicsClientId=client)
    assert len(warned(lambda: ss.eval("SELECT id FROM sim;"))) == 1
    world.tick()
    assert warned(lambda: ss.eval("SELECT id FROM sim;")) == []
    pybullet.stepSimulation(client)
    assert len(warned(lambda: ss.eval("SELECT id FROM sim;"))) == 1


@pytest.fixture
def other(sim):
    """A second client with a ball, whose world is `other`."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -9.81, client)
    solid(client, pybullet.GEOM_SPHERE, 1, [0, 0, 1], radius=0.1)
    sim[0].add_variable("other", ssduck.World.attach(client, names={0: "egg"}))
    yield client
    pybullet.disconnect(client)


OF_SIM = [
    lambda ss: ss.eval("SELECT id, z FROM sim;"),
    lambda ss: ss.eval("z(ball);"),
    lambda ss: ss.eval("holds(z(sim.ball) > 0);"),
    lambda ss: ss.sql("SELECT z FROM sim.entities").fetchall(),
    lambda ss: ss.sql("SELECT z FROM entities").fetchall(),
]
OF_OTHER = [
    lambda ss: ss.eval("SELECT id, z FROM other;"),
    lambda ss: ss.eval("z(other.egg);"),
    lambda ss: ss.eval("holds(z(other.egg) > 0);"),
    lambda ss: ss.sql("SELECT z FROM other.entities").fetchall(),
    lambda ss: ss.sql('SELECT z FROM other."entities_history"').fetchall(),
    lambda ss: ss.sql("FROM Other.links").fetchall(),
]


@pytest.mark.slow
@pytest.mark.parametrize("is_first", [True, False])
def test_only_worlds_that_a_query_reads_are_compared(client, other, sim, *, is_first):
    """Worlds that are stepped by turns are not told between the step of one and its tick."""
    ss, _ = sim
    pybullet.stepSimulation(client if is_first else other)
    reading, not_reading = (OF_SIM, OF_OTHER) if is_first else (OF_OTHER, OF_SIM)
    for query in not_reading:
        assert warned(lambda query=query: query(ss)) == []
    messages = warned(lambda: [query(ss) for query in reading])
    assert len(messages) == len(reading)
    assert all(message.startswith("sim:" if is_first else "other:") for message in messages)


def test_a_join_reads_all_of_its_worlds(client, other, sim):
    ss, _ = sim
    pybullet.stepSimulation(client)
    pybullet.stepSimulation(other)
    messages = warned(lambda: ss.sql("SELECT a.z, b.z FROM entities a, other.entities b"))
    assert sorted(message.partition(":")[0] for message in messages) == ["other", "sim"]
