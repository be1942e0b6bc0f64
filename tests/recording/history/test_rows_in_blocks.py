"""The rows of recorded ticks are those that each tick had, whenever they are asked for."""

import signal

import mujoco
import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.recording.buffers import RowBuffer
from ssduck.schema import RECORDED
from tests.support.bodies import create_linked_body, solid

TABLES = ("entities", "links", "joints", "shapes", "contacts", "sensings")
MODEL = """
<mujoco><worldbody>
  <geom type="plane" size="0 0 1"/>
  <body name="cart" pos="0 0 .5"><freejoint/><geom size=".1 .2 .3" type="box"/>
    <geom size=".1" pos="0 0 .4"/>
    <body name="arm" pos="0 0 .6" quat=".9 .1 .3 .2"><joint axis="0 1 0"/>
      <geom type="capsule" size=".05" fromto="0 0 0 .4 0 0"/><site name="tip" pos=".4 0 0"/></body>
  </body>
  <body name="ball" pos=".05 0 2"><freejoint/><geom size=".15" condim="4"/></body>
  <body name="can" pos="1 0 .3" quat=".7 .7 0 .1"><freejoint/>
    <geom type="cylinder" size=".1 .15"/></body>
</worldbody></mujoco>
"""
LASER = {"min_angle": -1.0, "max_angle": 1.0, "resolution": 0.1, "max_range": 5.0}


def _in_mujoco():
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    return ssduck.World.attach(model, data), lambda: mujoco.mj_step(model, data, 9)


def _in_pybullet(client):
    pybullet.setGravity(0, 0, -10, client)
    here = {"physicsClientId": client}
    box = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.1, 0.2, 0.3], **here)
    solid(client, pybullet.GEOM_PLANE, 0)
    for height in (0.4, 1.2, 2.0):
        create_linked_body(
            client,
            1,
            box,
            basePosition=[height / 9, 0, height],
            baseInertialFramePosition=[0.01, 0.02, 0],
            baseInertialFrameOrientation=[0, 0.1, 0, 0.995],
            linkPositions=[[0.3, 0, 0]],
            linkInertialFramePositions=[[0, 0.02, 0]],
            linkJointTypes=[pybullet.JOINT_REVOLUTE],
        )
    return ssduck.World.attach(client), lambda: [pybullet.stepSimulation(client) for _ in range(9)]


def _rows(world, table):
    live = world.snapshot.tables[table]
    return zip(*map(live.values, RECORDED[table].tick_columns.names), strict=True)


@pytest.mark.parametrize("asked_every", [1, 7, 1000])
@pytest.mark.parametrize("simulator", ["mujoco", "pybullet"])
def test_rows_of_the_history_are_those_of_the_ticks(client, simulator, asked_every):
    world, step = _in_mujoco() if simulator == "mujoco" else _in_pybullet(client)
    host = world.snapshot.entities[-1].name
    turned = {"position": [0.1, 0.02, 0.3], "orientation": [0.5, 0.1, 0.7, 0.5]}
    world.add_sensor("planar_laser", on=host, name="laser", **turned, **LASER)
    with ssduck.Interpreter(recording=Recording(tables=TABLES)) as ss:
        ss.add_variable("sim", world)
        first = world.tick().snapshot.number
        expected = {table: list(_rows(world, table)) for table in TABLES}
        for number in range(1, 150):
            step()
            if number == 80:  # the entities are others from this tick on
                world.add_sensor("contact_sensor", on=host, name="touch")
            else:
                if number == 100 and simulator == "pybullet":
                    pybullet.removeBody(1, client)
                world.tick()
            for table in TABLES:
                expected[table] += _rows(world, table)
            if number % asked_every == 0:
                assert ss.sql("SELECT max(tick) FROM contacts_history").fetchall()
        for table, rows in expected.items():
            columns = ", ".join(f'"{name}"' for name in RECORDED[table].tick_columns.names)
            query = f"SELECT {columns} FROM {table}_history WHERE tick >= {first}"
            if table == "links":  # sites are links, and have a view of their own
                query += f" UNION ALL SELECT {columns} FROM sites_history WHERE tick >= {first}"
            found = ss.sql(query).fetchall()
            assert sorted(map(repr, found)) == sorted(repr(tuple(row)) for row in rows)
            assert len(rows) > 99


@pytest.fixture
def falling():
    """A box that falls onto the floor, with a recorded world that is attached to it."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option cone="elliptic"/><worldbody><geom type="plane" size="3 3 0.1"/>'
        '<body name="box" pos="0 0 0.1"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>'
        "</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("sim", ssduck.World.attach(model, data))
        yield ss, world, model, data


def rows_of_ticks(ss, table):
    (row,) = ss.sql(f"SELECT count(*), count(DISTINCT tick) FROM sim.{table}_history").fetchall()
    return row


def test_a_tick_that_cannot_be_written_loses_no_other(falling):
    ss, world, model, data = falling
    errors = 0
    for number in range(200):
        mujoco.mj_step(model, data)
        if number == 50:
            model.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL  # between a step and its tick
        try:
            world.tick()
        except IndexError:
            errors += 1
    assert errors == 1
    assert rows_of_ticks(ss, "ticks") == (200, 200)  # with the one before the first step
    assert rows_of_ticks(ss, "entities") == (400, 200)
    assert ss.eval("heldFor(z(sim.box) > 0.0);") > 0.3


def test_ctrl_c_while_rows_are_written_writes_them_once(falling, monkeypatch):
    ss, world, model, data = falling
    for _ in range(30):
        mujoco.mj_step(model, data)
        world.tick()
    add, calls = RowBuffer.add, []

    def interrupted(buffer, rows):
        calls.append(1)
        if len(calls) == 2:  # between two tables
            signal.raise_signal(signal.SIGINT)
        add(buffer, rows)

    with monkeypatch.context() as patch:
        patch.setattr(RowBuffer, "add", interrupted)
        with pytest.raises(KeyboardInterrupt):
            ss.sql("SELECT count(*) FROM sim.entities_history")
    assert len(calls) > 1
    assert rows_of_ticks(ss, "ticks") == (31, 31)
    assert rows_of_ticks(ss, "entities") == (62, 31)
