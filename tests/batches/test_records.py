"""Kept ticks of a batch are episodes of a lake, as those of simulations that are recorded alone."""

import mujoco
import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import ArgumentError, ProgramWarning, UnsupportedError
from tests.support.bodies import solid

XML = """
<mujoco>
  <worldbody>
    <geom name="ground" type="plane" size="2 2 .1"/>
    <body name="ball" pos="0 0 .3"><freejoint/><geom type="sphere" size=".04"/></body>
    <body name="door" pos="1 0 .3"><joint name="hinge" axis="0 0 1" damping=".1"/>
      <geom type="box" size=".1 .01 .1"/><site name="knob" pos=".1 0 0"/></body>
  </worldbody>
</mujoco>
"""
COUNT, STEPS, RESET_AT = 3, 60, 25
PROGRAMS = [
    "z(sim.ball);",
    "least(z(sim.ball));",
    "inContact(sim.ball, sim.world);",
    "heldFor(inContact(sim.ball, sim.world));",
    "joint(sim.door, 'hinge');",
    "position(sim.door.knob);",
    "speed(sim.ball);",
    "getTime();",
]


def start(model, data, number):
    mujoco.mj_resetData(model, data)
    data.qpos[2] += 0.1 * number
    data.qvel[-1] = number
    mujoco.mj_forward(model, data)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Simulations of which one is reset in between: as a batch, and each recorded alone."""
    model = mujoco.MjModel.from_xml_string(XML)
    simulations = [mujoco.MjData(model) for _ in range(COUNT)]
    folder = tmp_path_factory.mktemp("batch")
    own = tmp_path_factory.mktemp("own")
    with ssduck.Interpreter(recording=None) as ss:
        sim = ss.add_variable("sim", ssduck.World.batch(model, COUNT, history=STEPS))
        alone = [ssduck.Interpreter(recording=None) for _ in simulations]
        for number, data in enumerate(simulations):
            start(model, data, number)
        running = []
        for step in range(STEPS):
            for data in simulations if step else ():
                mujoco.mj_step(model, data)
            if step == RESET_AT:
                start(model, simulations[1], 1)
                sim.reset([1])
            sim.tick(simulations)
            for number, (other, data) in enumerate(zip(alone, simulations, strict=True)):
                if not step:
                    world = other.add_variable("sim", ssduck.World.attach((model, data)))
                    running.append(other.record_to(own / str(number)))
                else:
                    other.call_variable("sim").tick()
        for recording, other in zip(running, alone, strict=True):
            recording.close()
            other.close()
        of_batch = ss.export_batch(folder, tags={"even": np.arange(COUNT) % 2 == 0, "task": "fall"})
    assert world is not None
    return folder, own, of_batch


@pytest.mark.slow
@pytest.mark.parametrize("program", PROGRAMS)
def test_episodes_are_those_of_simulations_alone(recorded, program):
    folder, own, of_batch = recorded
    found = ssduck.lake(folder).ask(program, processes=1)["answer"].to_pylist()
    expected = [
        answer
        for number in range(COUNT)
        for answer in ssduck.lake(own / str(number)).ask(program, processes=1)["answer"].to_pylist()
    ]
    assert len(found) == len(of_batch) == COUNT + 1
    assert found == [pytest.approx(value, abs=1e-12) for value in expected]


def test_tags_are_of_each_environment(recorded):
    lake = ssduck.lake(recorded[0])
    for where, count in (("environment = 1", 2), ("even", 2), ("task = 'fall' AND NOT even", 2)):
        assert lake.ask("1;", where=where, processes=1).num_rows == count


def falling(**options):
    model = mujoco.MjModel.from_xml_string(XML)
    return ssduck.World.batch(model, COUNT, **options), [mujoco.MjData(model) for _ in range(COUNT)]


def test_ticks_that_were_dropped_are_told_of(tmp_path):
    sim, states = falling(history=2)
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", sim)
        for number in range(3):
            for data in states:
                data.time = number
            sim.tick(states)
        with pytest.warns(ProgramWarning, match="older ticks were dropped"):
            assert ss.export_batch(tmp_path / "run", environments=[2]) == [0]
        with ssduck.open(tmp_path / "run") as record:
            assert record.past("sim").times == [1.0, 2.0]


def test_poses_by_entity_are_recorded_without_contacts(client, tmp_path):
    body = solid(client, pybullet.GEOM_BOX, 1, halfExtents=[0.1] * 3)
    world = ssduck.World.attach(client, names={body: "cup"})
    with ssduck.Interpreter() as ss:
        sim = ss.add_variable("sim", ssduck.World.batch(world, 2, history=10))
        for step in range(3):
            poses = np.array([[0, 0, step, 1, 0, 0, 0], [0, 0, -step, 1, 0, 0, 0]], float)
            sim.tick(poses={"cup": poses}, time=0.1 * step)
        ss.export_batch(tmp_path / "run", environments=np.array([False, True]))
        with ssduck.open(tmp_path / "run") as record:
            assert record.eval("least(z(sim.cup));") == [0.2, -2.0]
            with pytest.raises(ssduck.SelectScriptError, match="contacts"):
                record.eval("inContact(sim.cup, sim.cup);")


def test_errors_say_what_to_do(tmp_path):
    sim, states = falling()
    with ssduck.Interpreter() as ss:
        with pytest.raises(ArgumentError, match="of which there are: none"):
            ss.export_batch(tmp_path / "run")
        ss.add_variable("sim", sim)
        with pytest.raises(ArgumentError, match=r"World.batch\(…, history=1000\)"):
            ss.export_batch(tmp_path / "run")
        with pytest.raises(UnsupportedError, match="export_batch writes them"):
            ss.record_to(tmp_path / "run")
    kept, states = falling(history=5)
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", kept).tick(states)
        for environments in ([3], [0.5], [True]):
            with pytest.raises(ArgumentError, match="export_batch"):
                ss.export_batch(tmp_path / "run", environments=environments)
        with pytest.raises(ArgumentError, match="one for each of the 3 environments"):
            ss.export_batch(tmp_path / "run", tags={"success": [True, False]})
        kept.tick(qpos=np.zeros((COUNT, 8)) + np.eye(8)[3])
        with pytest.raises(ArgumentError, match="give tick time"):
            ss.export_batch(tmp_path / "run")
