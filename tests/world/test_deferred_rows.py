"""Rows are written when something reads them, and are those of the present tick then."""

import signal

import mujoco
import numpy as np
import pytest

import ssduck
from ssduck.geometry.poses import rotation_matrices, unit_quaternions
from ssduck.world import ctrl_c
from ssduck.world.tick_geometry import TickPlaces
from tests.support.gym_environments import PUSH
from tests.support.mjcf import simulated

RADIUS = 0.05
HIGHEST = "SELECT zmax FROM lab.entities WHERE name = 'ball'"


@pytest.fixture
def lab():
    model, data = simulated(PUSH)
    data.qpos[3] = 1.0  # the ball falls
    mujoco.mj_forward(model, data)
    with ssduck.Interpreter() as ss:
        yield ss, ss.add_variable("lab", ssduck.World.attach(model, data)), model, data


PARTS = "SELECT zmax FROM lab.{} WHERE entity = (SELECT id FROM lab.entities WHERE name = 'ball')"

READERS = {
    "a property": lambda ss, world: world["ball"].aabb[1][2],
    "SQL": lambda ss, world: ss.sql(HIGHEST).fetchall()[0][0],
    "a query": lambda ss, world: ss.eval("SELECT aabb FROM lab WHERE id == 'ball' AS list;")[0][5],
    "a condition": lambda ss, world: ss.eval("aabb(lab.ball);")[5],
    "a table": lambda ss, world: world.snapshot.tables["entities"]["zmax"][-1].item(),
    "a record": lambda ss, world: ss.sql(
        "SELECT zmax FROM lab.entities_history WHERE name = 'ball' ORDER BY tick DESC LIMIT 1"
    ).fetchall()[0][0],
    "a what-if world": lambda ss, world: world.what_if()["ball"].aabb[1][2],
    "a trigger": lambda ss, world: ss["seen"][5],
    "a link": lambda ss, world: world["ball"].links[0].aabb[1][2],
    "SQL of links": lambda ss, world: ss.sql(PARTS.format("links")).fetchall()[0][0],
    "SQL of shapes": lambda ss, world: ss.sql(PARTS.format("shapes")).fetchall()[0][0],
    "a query of links": lambda ss, world: ss.eval("aabb(links(lab.ball)[0]);")[5],
    "the record of links": lambda ss, world: ss.sql(
        PARTS.format("links_history") + " ORDER BY tick DESC LIMIT 1"
    ).fetchall()[0][0],
    "a copy's links": lambda ss, world: world.what_if()["ball"].links[0].aabb[1][2],
}


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_they_are_of_the_present_tick(lab, read):
    ss, world, model, data = lab
    ss.add_trigger("box", "aabb(lab.ball);", 0.001, lambda value: ss.add_variable("seen", value))
    heights = []
    for _ in range(5):
        mujoco.mj_step(model, data, 5)
        mujoco.mj_forward(model, data)
        world.tick()
        assert ss.eval("z(lab.ball) > 0;")
        heights.append(data.body("ball").xpos[2] + RADIUS)
        assert read(ss, world) == pytest.approx(heights[-1], abs=1e-12)
    assert len(set(heights)) == 5


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_unknown_numbers_have_unknown_boxes_at_once(lab, number):
    ss, world, _, data = lab
    data.xpos[-1] = number
    with pytest.warns(UserWarning, match="ball: the simulator gives"):
        world.tick()
    assert ss.sql("SELECT zmax FROM lab.entities WHERE name = 'ball'").fetchall() in (
        [(None,)],
        [(np.inf,)],
    )
    data.xpos[-1] = 1.0
    world.tick()
    assert world["ball"].aabb[1][2] == pytest.approx(1.0 + RADIUS)


def contacts_of(model, data, *names):
    """Returns the number of contacts of two bodies, and whether one presses, by MuJoCo alone."""
    numbers, force = sorted(model.body(name).id for name in names), np.zeros(6)
    rows = [
        row
        for row in range(data.ncon)
        if sorted(model.geom_bodyid[data.contact[row].geom].tolist()) == numbers
    ]
    forces = []
    for row in rows:
        mujoco.mj_contactForce(model, data, row, force)
        forces.append(force[0])
    return len(rows), any(one > 0 for one in forces)


COUNT = "SELECT count(*) FROM lab.contacts c JOIN lab.entities e ON c.b = e.id WHERE name = 'ball'"


@pytest.mark.slow
def test_contacts_are_of_the_present_tick(lab):
    _, _, model, data = lab
    seen = []
    with ssduck.Interpreter(recording=None) as other:
        world = other.add_variable("lab", ssduck.World.attach(model, data))
        pressing = other.compile("SELECT inContact(lab.table, lab.ball) FROM [0] AS list;")
        both = other.compile(
            "p = inContact(lab.ball, lab.table);"
            " SELECT id FROM lab WHERE inContact(this, lab.table) AND p AS list;"
        )
        data.qpos[3] = 0.5  # above the table
        for tick in range(60):
            mujoco.mj_step(model, data, 5)
            world.tick()
            count, is_pressing = contacts_of(model, data, "table", "ball")
            assert other.eval(pressing) == [is_pressing]
            if tick % 2:  # else the next tick comes before the table is written
                assert other.sql(COUNT).fetchall() == [(count,)]
            if tick % 3 == 0:
                assert ("ball" in other.eval(both)) == is_pressing
            seen.append(count)
    assert 0 in seen
    assert any(seen)


SHAPES = """
<mujoco><worldbody>
  <geom type="plane" size="1 1 .1"/>
  <body name="arm" pos="0 0 .5"><joint type="hinge" axis="0 1 0"/>
    <geom type="box" size=".1 .2 .3" pos=".1 0 .2" euler="10 20 30"/>
    <geom type="capsule" size=".1 .2" pos="-.3 .1 0" quat=".5 .1 .7 .2"/>
    <body pos="0 .4 .2" euler="5 6 7"><joint type="ball"/>
      <geom type="cylinder" size=".1 .2" euler="40 0 10"/>
      <geom type="ellipsoid" size=".1 .2 .3" pos=".1 .2 .3"/></body></body>
  <body name="ball" pos="1 0 1" euler="1 2 3"><freejoint/><geom size=".1"/></body>
</worldbody></mujoco>
"""


BOX = """
<mujoco><worldbody><geom name="fixed" type="box" size=".1 .1 .1" pos="2 0 0"/>
  <body pos="0 0 1" quat=".5 .1 .7 .2"><freejoint/><geom type="box" size=".1 .2 .3" {}/></body>
</worldbody></mujoco>
"""
POSES = ("", 'pos=".1 0 0"', 'quat=".6 .8 0 0"')
COLUMNS = "x, y, z, qw, qx, qy, qz, xmin, ymin, zmin, xmax, ymax, zmax"


@pytest.mark.slow
@pytest.mark.parametrize("text", [SHAPES, *map(BOX.format, POSES)], ids=["", *POSES])
def test_a_shape_is_where_mujoco_and_the_table_have_it(text):
    """Those that are where their links are take these poses as they are."""
    model, data = simulated(text)
    data.qvel[:] = np.linspace(1, 3, model.nv)
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable("lab", ssduck.World.attach(model, data))
        for _ in range(3):
            mujoco.mj_step(model, data, 20)
            mujoco.mj_kinematics(model, data)
            world.tick()
            places = TickPlaces(world.snapshot.layout, world.snapshot.body_groups)
            assert places.positions == pytest.approx(data.geom_xpos, abs=1e-12)
            matrices = rotation_matrices(unit_quaternions(places.orientations)).reshape(-1, 9)
            assert matrices == pytest.approx(data.geom_xmat, abs=1e-12)
            rows = ss.sql(f"SELECT {COLUMNS} FROM lab.shapes").fetchall()
            arrays = np.hstack((places.positions, places.orientations, places.boxes))
            assert arrays.tolist() == list(map(list, rows))


UNIX = pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="Windows has no such signal")


@UNIX
def test_a_handler_is_called_as_often_as_its_signal_came():
    """`ssduck record` ends after one, and at once after two."""
    calls = []

    def first(number, _):
        calls.append("first")
        signal.signal(number, second)

    def second(*_):
        calls.append("second")

    kept = signal.signal(signal.SIGTERM, first)
    try:
        with ctrl_c.deferred():
            with ctrl_c.deferred():
                signal.raise_signal(signal.SIGTERM)
                signal.raise_signal(signal.SIGTERM)
            assert not calls
        assert calls == ["first", "second"]
        with ctrl_c.deferred():
            signal.raise_signal(signal.SIGTERM)
            with ctrl_c.allowed():
                assert calls[2:] == ["second"]
                signal.signal(signal.SIGTERM, first)
            signal.raise_signal(signal.SIGTERM)
        assert calls[3:] == ["first"]
        assert signal.getsignal(signal.SIGTERM) is second
    finally:
        signal.signal(signal.SIGTERM, kept)
