"""The contract of a tick: immutable, of one moment, read no more than is asked for; its columns."""

import threading

import pybullet
import pytest

import ssduck
from ssduck.errors import SimulatorError
from ssduck.schema import FRAMES, HISTORIES, STORED_TABLES, TABLES
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from tests.support.spy import Spy
from tests.support.stage import Stage
from tests.support.warned import heard


def scene(client):
    """Two boxes that fall and a floor."""
    pybullet.setGravity(0, 0, -10, physicsClientId=client)
    for mass, height in ((1, 1), (1, 2), (0, 0)):
        Stage(client).box(None, [0, 0, height], half=0.1, mass=mass)


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
    attached.request_tables(["links", "shapes", "joints", "contacts"])
    before = columns(attached, *STORED_TABLES)
    for _ in range(20):
        pybullet.stepSimulation(client)
    pybullet.resetBasePositionAndOrientation(0, [9, 9, 9], [0, 0, 0, 1], client)
    assert columns(attached, *STORED_TABLES) == before
    assert next(iter(attached)).position == pytest.approx([0, 0, 1])
    attached.tick()
    after = columns(attached, *STORED_TABLES)
    assert all(one != other for one, other in zip(after[:2], before[:2], strict=True))


def test_tables_that_nobody_asks_for_are_not_read(spied):
    world, spy = spied
    spy.read.clear()
    world.step()
    assert set(spy.read) == {"frames", "bodies"}
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", world)
        ss.eval("SELECT id, z FROM sim WHERE above(this, this);")
        ss.sql("SELECT * FROM entities, ticks, geometries")
        assert spy.read["joints"] == spy.read["contacts"] == 0
        ss.sql("FROM contacts")
        assert (spy.read["joints"], spy.read["contacts"]) == (0, 1)
        ss.sql("FROM contacts")
        assert spy.read["contacts"] == 1


def test_asking_reads_a_table_that_is_not_there_into_the_tick(spied):
    world, spy = spied
    world.tick()
    number, wall_time = world.snapshot.number, world.snapshot.tables["ticks"]["wall_time"][0]
    spy.read.clear()
    world.request_tables(["links"])
    world.request_tables(["links", "joints"])
    world.request_tables(["entities", "ticks", "geometries"])
    assert (world.snapshot.number, spy.read["joints"]) == (number, 1)
    assert world.snapshot.tables["ticks"]["wall_time"][0] == wall_time
    world.step()
    world.request_tables(["links", "joints"])
    assert (world.snapshot.number, spy.read["joints"]) == (number + 1, 2)


@pytest.mark.slow
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


@pytest.mark.slow
def test_queries_see_whole_ticks_while_another_thread_steps(spied):
    """All rows of an answer are of one tick, and say what its time makes them."""
    world, _ = spied
    done = threading.Event()

    def run():
        while not done.is_set():
            world.step()

    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        thread = threading.Thread(target=run)
        thread.start()
        try:
            seen = set()
            for _ in range(60):
                rows = ss.sql(
                    "SELECT e.tick, l.tick, e.time, e.vz, l.vz FROM entities e "
                    "JOIN links l ON l.entity = e.id"
                ).fetchall()
                assert len(rows) == 3
                assert len({tick for row in rows for tick in row[:2]}) == 1
                assert len({row[2] for row in rows}) == 1
                assert all(row[3] == row[4] for row in rows)
                seen.add(rows[0][0])
        finally:
            done.set()
            thread.join()
    assert len(seen) > 1


def test_ticks_are_numbered_and_timed(attached):
    first = attached.snapshot.number
    attached.step(24)
    assert attached.snapshot.number == first + 1
    (row,) = columns(attached, "ticks")[0]
    assert row["tick"] == first + 1
    assert row["time"] == pytest.approx(0.1)
    assert row["wall_time"] > 1.7e9
    assert set(attached.snapshot.tables["entities"]["tick"].tolist()) == {first + 1}


@pytest.mark.slow
def test_poses_that_are_no_numbers_become_null_and_are_told_once(attached, client):
    pybullet.resetBasePositionAndOrientation(0, [float("nan")] * 3, [0, 0, 0, 1], client)
    with pytest.warns(UserWarning, match="body_0.*NULL") as caught:
        attached.tick()
    assert [w.filename for w in caught] == [__file__]
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
        assert ss.sql("SELECT x FROM entities WHERE name = 'body_0'").fetchall() == [(1.0,)]


@pytest.mark.parametrize("what", ["position", "orientation", "velocity"])
def test_nothing_that_follows_from_an_unknown_number_is_known(attached, client, what):
    nan = float("nan")
    if what == "velocity":
        pybullet.resetBaseVelocity(1, [nan, 0, 0], [0, 0, 0], client)
    else:
        place, turn = [0, 0, 2], [0, 0, 0, 1]
        (place if what == "position" else turn)[0] = nan
        pybullet.resetBasePositionAndOrientation(1, place, turn, client)
    with pytest.warns(UserWarning, match=r"^body_1: .* is NULL") as caught:
        attached.tick(steps=0)
    attached.request_tables(["links", "shapes"])
    assert [w.filename for w in caught] == [__file__]
    entities, links, shapes = columns(attached, "entities", "links", "shapes")
    boxed = "xmin" if what != "velocity" else "vx"
    for table in (entities, links):
        assert [row[boxed] is None for row in table] == [False, True, False]
    assert [row["xmin"] is None for row in shapes] == [False, what != "velocity", False]
    assert not any(v is not None and v != v for row in entities for v in row.values())  # noqa: PLR0124
    assert [name for name, v in entities[0].items() if v is None] == ["parent"]


INF = float("inf")
EXPLODED = [
    ([0, 0, 0], [0, 0, 0, 1], [INF, 0, 0], [0, 0, 1]),
    ([0, 0, 0], [0, 0, 0, 1], [0, 0, 0], [0, -INF, 1]),
    ([INF, 0, 0], [0, 0, 0, 1], [0, 0, 0], [0, 0, 0]),
    ([0, 0, 0], [INF, 0, 0, 1], [0, 0, 0], [0, 0, 0]),
]


@pytest.mark.parametrize(("place", "turn", "linear", "angular"), EXPLODED)
@pytest.mark.parametrize("com", [0.0, 0.1])
def test_a_simulation_that_exploded_is_told_of_and_nothing_else_is(
    client, place, turn, linear, angular, com
):
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_CYLINDER, radius=0.1, height=1, physicsClientId=client
    )
    for height in (0, 5):
        pybullet.createMultiBody(
            1.0,
            shape,
            basePosition=[0, 0, height],
            baseInertialFramePosition=[com, 0, 0],
            physicsClientId=client,
        )
    world = ssduck.World.attach(client)
    sane = columns(world, "entities")[0][1]
    pybullet.resetBasePositionAndOrientation(0, place, turn, client)
    pybullet.resetBaseVelocity(0, linear, angular, client)
    _, told = heard(lambda: world.tick(steps=0))
    assert all("body_0: the simulator gives" in text for text in told)
    lost, other = columns(world, "entities")[0]
    unusual = [v for v in lost.values() if v is None or v in (INF, -INF)]
    assert len(unusual) > 1  # parent is unknown anyway
    assert {**other, "tick": 0} == {**sane, "tick": 0}


@pytest.mark.parametrize("broken", ["frames", "joints", "contacts"])
def test_a_read_that_fails_half_way_leaves_the_last_tick_whole(client, broken):
    """Even if bodies came and went before it."""
    scene(client)
    spy = Spy(PyBulletSimulator(client, owned=False))
    world = ssduck.World(spy)
    world.request_tables(["links", "joints", "shapes", "contacts"])
    before, names = columns(world, *STORED_TABLES), [e.name for e in world]
    pybullet.removeBody(0, client)
    pybullet.createMultiBody(1, basePosition=[5, 5, 5], physicsClientId=client)
    pybullet.createMultiBody(1, basePosition=[6, 6, 6], physicsClientId=client)
    spy.broken = (broken,)
    for _ in range(2):
        with pytest.raises(SimulatorError, match="broken"):
            world.tick()
        assert columns(world, *STORED_TABLES) == before
        assert [e.name for e in world] == names
    spy.broken = ()
    world.tick()
    assert [e.position[0] for e in world] == pytest.approx([0, 0, 5, 6])
    assert [row["x"] for row in columns(world, "links")[0]] == pytest.approx([0, 0, 5, 6])


def test_a_table_that_could_not_be_read_is_still_lacking(spied):
    world, spy = spied
    world.tick()
    spy.read.clear()
    spy.broken = ("contacts",)
    with pytest.raises(SimulatorError, match="broken"):
        world.request_tables(["contacts"])
    spy.broken = ()
    number = world.snapshot.number
    world.request_tables(["contacts"])
    assert (world.snapshot.number, spy.read["contacts"]) == (number, 1)


def test_a_table_that_is_asked_for_while_a_query_runs_is_still_lacking(attached):
    attached.tick(steps=0)
    with (
        attached.pinned(),
        pytest.raises(ssduck.SelectScriptError, match=r"a query on .* is running"),
    ):
        attached["body_0"].links  # noqa: B018
    attached.step(20)
    (link,) = attached["body_0"].links
    assert link.position == attached["body_0"].position


def test_a_query_holds_the_tick(attached):
    with attached.pinned():
        for act in (attached.step, attached.tick, lambda: attached["body_0"].move([1, 1, 1])):
            with pytest.raises(ssduck.SelectScriptError, match=r"a query on .* is running"):
                act()
    attached.step()


def test_the_poses_of_links_are_for_records_alone():
    assert FRAMES not in TABLES
    assert FRAMES not in HISTORIES
