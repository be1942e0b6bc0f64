"""The contract of a tick: immutable, of one moment, read no more than is asked for."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import SimulatorError
from ssduck.simulators.pybullet import PyBulletSimulator
from ssduck.snapshot import FORGOTTEN_AFTER
from ssduck.tables import TABLES, LiveTable


class Spy:
    """A simulator that counts what is read of another, and of how many bodies."""

    def __init__(self, simulator):
        self._simulator = simulator
        self.read = Counter()

    def __getattr__(self, name):
        return getattr(self._simulator, name)

    def read_frames(self, bodies):
        self.read["frames"] += 1
        self.read["bodies"] += len(bodies)
        return self._simulator.read_frames(bodies)

    def read_joints(self, bodies):
        self.read["joints"] += 1
        return self._simulator.read_joints(bodies)

    def read_contacts(self):
        self.read["contacts"] += 1
        return self._simulator.read_contacts()


def scene(client):
    """Two boxes that fall and a floor."""
    pybullet.setGravity(0, 0, -10, physicsClientId=client)
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[0.1] * 3, physicsClientId=client
    )
    for mass, height in ((1, 1), (1, 2), (0, 0)):
        pybullet.createMultiBody(mass, shape, basePosition=[0, 0, height], physicsClientId=client)


@pytest.fixture
def spied(client):
    """A world that ssduck steps itself, and the spy on its simulator."""
    scene(client)
    spy = Spy(PyBulletSimulator(client, owned=True))
    return ssduck.World(spy), spy


@pytest.fixture
def attached(client):
    scene(client)
    return ssduck.World.attach(client)


def columns(world, *names):
    """A copy of the tables as they are now."""
    return [world.snapshot.tables[name].arrow.to_pylist() for name in names]


def test_a_tick_does_not_change_when_the_simulator_moves_on(attached, client):
    attached.ask(["links", "shapes", "joints", "contacts"])
    before = columns(attached, *TABLES)
    for _ in range(20):
        pybullet.stepSimulation(client)
    pybullet.resetBasePositionAndOrientation(0, [9, 9, 9], [0, 0, 0, 1], client)
    assert columns(attached, *TABLES) == before
    assert next(iter(attached)).position == pytest.approx([0, 0, 1])
    attached.tick()
    after = columns(attached, *TABLES)
    assert all(one != other for one, other in zip(after[:2], before[:2], strict=True))


def test_tables_that_nobody_asks_for_are_not_read(spied):
    world, spy = spied
    spy.read.clear()
    world.step()
    assert set(spy.read) == {"frames", "bodies"}
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        ss.eval("SELECT id, z FROM sim WHERE above(this, this);")
        ss.sql("SELECT * FROM entities, ticks, geometries")
        assert spy.read["joints"] == spy.read["contacts"] == 0
        ss.sql("FROM contacts")
        assert (spy.read["joints"], spy.read["contacts"]) == (0, 1)
        ss.sql("FROM contacts")
        assert spy.read["contacts"] == 1


def test_asking_takes_one_fresh_tick_if_the_table_is_not_there(spied):
    world, _ = spied
    number = world.snapshot.number
    world.ask(["links"])
    assert world.snapshot.number == number + 1
    world.ask(["links"])
    world.ask(["entities", "ticks", "geometries"])
    assert world.snapshot.number == number + 1
    world.ask(["links", "joints", "contacts"])
    assert world.snapshot.number == number + 2
    world.step()
    world.ask(["links", "joints", "contacts"])
    assert world.snapshot.number == number + 3


def test_tables_are_forgotten_after_a_while(spied):
    world, spy = spied
    world.ask(["contacts"])
    spy.read.clear()
    for _ in range(FORGOTTEN_AFTER + 10):
        world.tick()
    assert FORGOTTEN_AFTER - 2 <= spy.read["contacts"] <= FORGOTTEN_AFTER
    read = spy.read["contacts"]
    world.ask(["contacts"])
    assert spy.read["contacts"] == read + 1


def test_all_tables_of_a_query_are_of_one_moment(attached, client):
    """Even if the simulator moved on between the tick and the first question for a table."""
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", attached)
        for _ in range(20):
            pybullet.stepSimulation(client)
        rows = ss.sql(
            "SELECT e.z, l.z, s.z, e.tick, l.tick, s.tick FROM entities e "
            "JOIN links l ON l.entity = e.id JOIN shapes s ON s.entity = e.id"
        ).fetchall()
        assert len(rows) == 3
        for entity, link, shape, *ticks in rows:
            assert entity == link == pytest.approx(shape)
            assert len(set(ticks)) == 1


def test_a_body_that_cannot_move_is_read_once(spied):
    world, spy = spied
    spy.read.clear()
    for _ in range(5):
        world.step()
    assert spy.read["bodies"] == 5 * 2


def test_buffers_stay_where_they_are(attached, client):
    """DuckDB is shown them once: the same Arrow table, the same memory."""
    table = attached.snapshot.tables["entities"]
    arrow, version, address = table.arrow, table.version, table["z"].ctypes.data
    heights = arrow["z"].to_pylist()
    attached.step(50)
    assert table.arrow is arrow
    assert (table.version, table["z"].ctypes.data) == (version, address)
    assert arrow["z"].to_pylist() != heights
    pybullet.removeBody(0, client)
    attached.tick()
    assert table.version > version
    assert table.arrow.num_rows == 2


def test_ticks_are_numbered_and_timed(attached):
    first = attached.snapshot.number
    attached.step(24)
    assert attached.snapshot.number == first + 1
    (row,) = columns(attached, "ticks")[0]
    assert row["tick"] == first + 1
    assert row["time"] == pytest.approx(0.1)
    assert row["wall_time"] > 1.7e9
    assert set(attached.snapshot.tables["entities"]["tick"].tolist()) == {first + 1}


def test_poses_that_are_no_numbers_become_null_and_are_told_once(attached, client):
    pybullet.resetBasePositionAndOrientation(0, [float("nan")] * 3, [0, 0, 0, 1], client)
    with pytest.warns(UserWarning, match="body_0.*NULL"):
        attached.tick()
    attached.tick()  # a second warning would be an error here
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", attached)
        assert ss.sql("SELECT name FROM entities WHERE x IS NULL AND xmax IS NULL").fetchall() == [
            ("body_0",)
        ]
        assert ss.sql("SELECT count(*) FROM entities WHERE isnan(z)").fetchone() == (0,)
        assert ss.eval("SELECT id FROM sim WHERE x(this) > -1 AS list;") == ["body_1", "body_2"]
        lost = attached["body_0"]
        ss.add_variable("lost", lost)
        assert ss.eval("SELECT id FROM sim WHERE above(lost, this) AS list;") == []
        assert ss.eval("SELECT id FROM sim WHERE distance(lost, this) >= 0 AS list;") == []
    pybullet.resetBasePositionAndOrientation(0, [1, 2, 3], [0, 0, 0, 1], client)
    attached.tick()
    assert attached["body_0"].position == pytest.approx([1, 2, 3])


def test_a_failed_read_leaves_the_last_tick_whole(client):
    own = pybullet.connect(pybullet.DIRECT)
    scene(own)
    world = ssduck.World.attach(own)
    world.ask(["links", "contacts"])
    before = columns(world, *TABLES)
    pybullet.disconnect(own)
    for act in (world.tick, world.step):
        with pytest.raises(SimulatorError, match="disconnected"):
            act()
    assert columns(world, *TABLES) == before


def test_a_query_holds_the_tick(attached):
    with attached.held():
        for act in (attached.step, attached.tick, lambda: attached["body_0"].move([1, 1, 1])):
            with pytest.raises(ssduck.SelectScriptError, match=r"a query on .* is running"):
                act()
    attached.step()


def test_equal_shapes_are_one_geometry(attached):
    (shapes, geometries) = columns(attached, "shapes", "geometries")
    assert len(shapes) == 3
    assert len(geometries) == 1
    assert geometries[0]["type"] == "box"
    assert geometries[0]["size_x"] == pytest.approx(0.2)


@pytest.mark.parametrize("name", TABLES)
def test_tables_may_be_empty(name):
    table = LiveTable(TABLES[name])
    assert table.arrow.num_rows == 0
    assert table.arrow.column_names == [column.name for column in TABLES[name]]
    table.fill(2, {})
    table.written()
    assert table.arrow.num_rows == 2


def test_unknown_numbers_come_and_go_in_a_table():
    table = LiveTable(TABLES["ticks"])
    table.fill(1, {"tick": [1]})
    table["time"][:] = np.nan
    table.written()
    assert table.arrow["time"].to_pylist() == [None]
    table["time"][:] = 2.5
    table.written()
    assert table.arrow["time"].to_pylist() == [2.5]
    whole = table.arrow
    table["time"][:] = 3.5
    table.written()
    assert table.arrow is whole
    assert whole["time"].to_pylist() == [3.5]
