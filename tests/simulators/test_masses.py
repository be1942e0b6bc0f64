"""Masses that change in a simulation: `changeDynamics`, seen at the next tick."""

import pybullet
import pybullet_data
import pytest

import ssduck
from tests.support.bodies import solid
from tests.support.cases import sampled
from tests.support.urdf import collision, joint, link, robot

# A chain of eight boxes.
ARM = robot(
    *(link(f"l{n}", shapes=collision('<box size="0.05 0.05 0.1"/>')) for n in range(8)),
    *(joint(f"j{n}", "continuous", f"l{n}", f"l{n + 1}", xyz=(0, 0, 0.2)) for n in range(7)),
)


@pytest.fixture
def sim(client, write):
    """A world of a cube of 1 kg and an arm of several links, attached."""
    solid(client, pybullet.GEOM_BOX, 1.0, [0, 0, 1], halfExtents=[0.1] * 3)
    pybullet.loadURDF(str(write("arm.urdf", ARM)), useFixedBase=True, physicsClientId=client)
    return ssduck.World.attach(client, names={0: "cube", 1: "arm"})


def change(client, handle, link, mass):
    pybullet.changeDynamics(handle, link, mass=mass, physicsClientId=client)


def sql(ss, name):
    (row,) = ss.sql(f"SELECT mass FROM sim.entities WHERE name = '{name}'").fetchall()
    return row[0]


# Ways to ask for a mass.
WAYS = {
    "sql": sql,
    "macro": lambda ss, name: ss.sql(
        f"SELECT sim.mass(e) FROM sim.entities e WHERE name = '{name}'"
    ).fetchall()[0][0],
    "relation": lambda ss, name: ss.eval(
        f"SELECT mass FROM sim WHERE id(this) == '{name}' AS value;"
    ),
    "dot": lambda ss, name: ss.eval(f"mass(sim.{name});"),
    "entity": lambda ss, name: ss.call_variable("sim")[name].mass,
    "links": lambda ss, name: sum(link.mass for link in ss.call_variable("sim")[name].links),
    "what_if": lambda ss, name: ss.call_variable("sim").what_if({})[name].mass,
    "links table": lambda ss, name: ss.sql(
        "SELECT sum(l.mass) FROM sim.links l JOIN sim.entities e ON e.id = l.entity "
        f"WHERE e.name = '{name}'"
    ).fetchall()[0][0],
}


@pytest.mark.parametrize("row_by_row", [False, True])
@sampled("way", WAYS, every=4)
def test_a_changed_mass_is_seen_at_the_next_tick(sim, client, way, row_by_row):
    ss = ssduck.Interpreter(row_by_row=row_by_row)
    ss.add_variable("sim", sim)
    ask = WAYS[way]
    arm = sum(pybullet.getDynamicsInfo(1, link, client)[0] for link in range(-1, 7))
    assert (ask(ss, "cube"), ask(ss, "arm")) == (1.0, pytest.approx(arm))
    change(client, 0, -1, 7.5)
    change(client, 1, 6, 3.0)
    assert (ask(ss, "cube"), ask(ss, "arm")) == (1.0, pytest.approx(arm))  # of this tick
    last = sum(pybullet.getDynamicsInfo(1, link, client)[0] for link in range(-1, 7))
    sim.tick()
    assert (ask(ss, "cube"), ask(ss, "arm")) == (7.5, pytest.approx(last))
    change(client, 0, -1, 2.0)
    sim.step(3)
    assert ask(ss, "cube") == 2.0


def test_masses_of_bodies_that_come_and_go(sim, client):
    ss = ssduck.Interpreter()
    ss.add_variable("sim", sim)
    change(client, 0, -1, 7.5)
    cube = sim["cube"]
    pybullet.removeBody(1, client)
    sim.tick()
    assert cube.mass == 7.5
    pybullet.removeBody(0, client)
    assert sql(ss, "cube") == 7.5  # nobody has taken a tick yet
    sim.tick()
    assert len(ss.sql("SELECT mass FROM entities")) == 0


@pytest.mark.slow
def test_masses_of_a_world_that_ssduck_made():
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        table = next(m.body for m in kitchen.snapshot.entities if m.name == "cup_905a")
        number = ss.sql("SELECT max(tick) FROM ticks").fetchall()
        change(kitchen.simulator.client, table.handle, -1, 7.5)
        kitchen.tick()
        assert ss.eval("SELECT mass FROM kitchen WHERE id(this) == 'cup_905a' AS value;") == 7.5
        # Asking for masses takes no tick.
        assert ss.sql("SELECT max(tick) FROM ticks").fetchall() == [(number[0][0] + 1,)]


@pytest.mark.slow
def test_a_soft_body_has_no_mass_and_no_known_velocity(client):
    """PyBullet tells numbers for it that are no velocity."""
    pybullet.resetSimulation(pybullet.RESET_USE_DEFORMABLE_WORLD, client)
    pybullet.setGravity(0, 0, -9.81, client)
    cloth = pybullet.loadSoftBody(
        f"{pybullet_data.getDataPath()}/cloth_z_up.obj",
        basePosition=[0, 0, 1],
        mass=1,
        useMassSpring=1,
        physicsClientId=client,
    )
    ball = solid(client, pybullet.GEOM_SPHERE, 1, [0, 0, 9], radius=0.1)
    with (
        pytest.warns(UserWarning, match="velocity is unknown .* the mass is told as 0"),
        pytest.warns(UserWarning, match="cloth: .* a velocity that is no number"),
    ):
        world = ssduck.World.attach(client, names={cloth: "cloth", ball: "ball"})
    with ssduck.Interpreter() as ss:
        ss.add_variable("sim", world)
        for _ in range(10):
            pybullet.stepSimulation(client)
            world.tick()
        assert ss.eval("mass(sim.cloth)") == 0.0
        assert ss.eval("speed(sim.cloth)") is None
        assert ss.eval("settled(sim.cloth)") is None
        assert ss.eval("rate(z(sim.cloth))") == pytest.approx(-9.81 * 10 / 240, abs=0.05)
        assert ss.eval("speed(sim.ball)") == pytest.approx(9.81 * 10 / 240, rel=1e-2)


def of_handle(ss, past):
    ss.add_variable("c", past)
    return ss.eval("mass(c);")


# What asks for the mass that the cube had at a past tick, of an interpreter and a past handle.
PAST = {
    "at a time": lambda ss, _: ss.eval(
        "SELECT mass(this) FROM sim{0} WHERE z(this) > 0.5 AS list;"
    )[0],
    "of all ticks": lambda ss, _: ss.eval("SELECT mass FROM sim{} WHERE z(this) > 0.5 AS list;")[0],
    "of a variable": lambda ss, _: ss.eval(
        "p = sim{0}; SELECT mass(this) FROM p WHERE id(this) == 'cube' AS value;"
    ),
    "nested": lambda ss, _: ss.eval(
        "count(SELECT this FROM (SELECT this FROM sim{0} WHERE mass(this) == 1 AS list) AS list);"
    ),
    "least": lambda ss, _: ss.eval("least(mass(sim.cube));")[1],
    "holds": lambda ss, _: 1.0 if ss.eval("holds(mass(sim.cube) == 1);") else None,
    "of a handle": of_handle,
    "entity": lambda _, past: past.mass,
    "links": lambda _, past: past.links[0].mass,
    "history": lambda ss, _: ss.sql(
        "SELECT mass FROM sim.entities_history WHERE name = 'cube'"
    ).fetchall()[0][0],
    "star": lambda ss, _: (
        ss.sql("FROM links_history WHERE entity = (SELECT id FROM entities WHERE name = 'cube')")
        .df()
        .iloc[0]["mass"]
    ),
    "model": lambda ss, _: (
        ss.sql("SELECT m.* FROM entities_model AS m WHERE m.name = 'cube'").df().iloc[0]["mass"]
    ),
}


IN_PROGRAMS = [way for way in PAST if way not in ("entity", "links", "history", "star", "model")]


@pytest.mark.slow
@sampled(
    ("way", "row_by_row"),
    [*((way, False) for way in PAST), *((way, True) for way in IN_PROGRAMS)],
    every=6,
)
def test_a_past_mass_of_a_body_that_was_changed_comes_with_a_warning(sim, client, way, row_by_row):
    ss = ssduck.Interpreter(
        row_by_row=row_by_row, recording=ssduck.Recording(tables=("entities", "links"))
    )
    ss.add_variable("sim", sim)
    sim.tick()
    (past,) = ss.eval("SELECT this FROM sim{0} WHERE id(this) == 'cube' AS list;")
    ask = PAST[way]
    assert ask(ss, past) == 1.0  # without a word: nothing has changed
    change(client, 0, -1, 7.5)
    sim.tick()
    ss.eval("SELECT id FROM sim{0} AS list;")
    ss.sql("SELECT id, count(*) FROM entities_history GROUP BY id")
    with pytest.warns(UserWarning, match="sim: cube: the mass was changed") as told:
        assert ask(ss, past) == 1.0
    assert [one.filename for one in told] == [__file__]
    assert ask(ss, past) == 1.0  # it is told once
    change(client, 1, 6, 3.0)
    sim.tick()
    with pytest.warns(UserWarning, match="sim: arm: the mass was changed"):
        ask(ss, past)
    assert ss.eval("mass(sim.cube);") == 7.5
    pybullet.disconnect(client)
    assert ask(ss, past) == 1.0  # what is recorded is there without the simulator


@pytest.mark.slow
def test_a_mass_that_changed_before_recording_begins(sim, client, tmp_path):
    sim.tick()
    change(client, 0, -1, 7.5)
    change(client, 1, 6, 3.0)
    sim.tick()
    arm = sum(pybullet.getDynamicsInfo(1, link, client)[0] for link in range(-1, 7))
    ss = ssduck.Interpreter()
    ss.add_variable("sim", sim)
    sim.tick()
    past = "SELECT DISTINCT mass FROM sim.entities_history ORDER BY mass"
    assert ss.sql(past).fetchall() == [(7.5,), (pytest.approx(arm),)]
    assert ss.eval("SELECT mass FROM sim{} WHERE id(this) == 'cube' AS list;") == [7.5, 7.5]
    with ss.record_to(tmp_path / "folder", "sim"):
        sim.tick()
    ss.export(tmp_path / "run")
    for name in ("run", "folder"):
        with ssduck.open(tmp_path / name) as opened:
            assert opened.sql(past).fetchall() == [(7.5,), (pytest.approx(arm),)]
            assert opened.eval("mass(sim.cube);") == 7.5


@pytest.mark.slow
@sampled("place", ["export", "folder", "file"], every=3)
def test_a_record_of_a_mass_that_was_changed_comes_with_a_warning(sim, client, tmp_path, place):
    ss = ssduck.Interpreter(tmp_path / "run.duckdb" if place == "file" else ":memory:")
    ss.add_variable("sim", sim)
    recorded = ss.record_to(tmp_path / "run", "sim") if place == "folder" else None
    sim.tick()
    change(client, 0, -1, 7.5)
    sim.tick()
    store = {"export": lambda: ss.export(tmp_path / "run"), "file": ss.close}
    with pytest.warns(UserWarning, match="sim: cube: the mass was changed"):
        (store[place] if recorded is None else recorded.close)()
    with ssduck.open(tmp_path / ("run.duckdb" if place == "file" else "run")) as opened:
        assert opened.eval("mass(sim.cube);") == 1.0
