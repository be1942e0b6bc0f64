"""Raw SQL over a batch reads the rows of all environments, as its simulations have them."""

import mujoco
import numpy as np
import pytest

import ssduck
from ssduck.errors import ArgumentError, SelectScriptError, UnsupportedError
from tests.batches.conftest import COUNT, simulations

# Each attached world counts its own ticks, and has a number of its own.
OWN = {"entities": "tick, run", "joints": "tick", "contacts": "tick"}


def rows_of(ss, table):
    return ss.sql(f"SELECT * EXCLUDE ({OWN[table]}) FROM sim.{table}").fetchall()


def approximately(rows):
    return [[pytest.approx(v, nan_ok=True) if type(v) is float else v for v in row] for row in rows]


@pytest.mark.parametrize("table", OWN)
def test_tables_are_those_of_each_environment(batch, table):
    ss, _, model, states = batch
    expected = [
        (number, *row)
        for number, one in enumerate(states.worlds(model))
        for row in rows_of(one, table)
    ]
    found = rows_of(ss, table)
    assert [list(row) for row in found] == approximately(expected)
    assert len({row[0] for row in found}) > 1
    names = ss.sql(f"SELECT * FROM sim.{table}").columns
    assert names[0] == "env"
    assert names[1:] == states.single[0].sql(f"SELECT * FROM sim.{table}").columns


def test_a_statement_reads_the_last_tick(batch):
    ss, sim, _, states = batch
    text = "SELECT env, z FROM sim.entities WHERE name = 'cube' ORDER BY env"
    before = ss.sql(text)
    heights = [data.xpos[2, 2] for data in states]
    for data in states:
        data.xpos[2, 2] += 1
    sim.tick(states)
    assert ss.sql(text).fetchall() == [(n, height + 1) for n, height in enumerate(heights)]
    assert before.fetchall() == list(enumerate(heights))
    assert ss.sql("SELECT DISTINCT tick FROM entities").fetchall() == [(sim.version,)]
    # A program reads one environment after the other from the same tables as before.
    assert ss.eval("SELECT str(z(this)) FROM sim WHERE id = 'cube' AS list;") == [
        str(data.xpos[2, 2]) for data in states
    ]


def test_joins_parameters_and_other_worlds():
    model, states = simulations()
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", ssduck.World.batch(model, COUNT)).tick(states)
        ss.add_variable("room", ssduck.World.attach(model, states[3]))
        ss.add_variable("low", 0.36)
        joined = ss.sql(
            "SELECT a.env, a.name, b.name FROM sim.entities a JOIN sim.entities AS b "
            "ON a.env = b.env AND a.name < b.name AND a.z > $low AND b.z > $low "
            "ORDER BY a.env, a.id, b.id",
            {"low": 0.36},
        ).fetchall()
        program = (
            "SELECT env, a.id AS one, b.id AS other FROM a=sim, b=sim "
            "WHERE a.id < b.id AND z(a.this) > low AND z(b.this) > low;"
        )
        assert [tuple(row.values()) for row in ss.eval(program)] == joined
        assert joined
        moved = ss.sql(
            "WITH e AS (SELECT * FROM sim.entities) SELECT env, room.entities.name FROM e "
            "JOIN room.entities USING (id) WHERE e.x = room.entities.x AND e.name = 'cube'"
        ).fetchall()
        assert moved == [(3, "cube")]
        assert ss.sql("SELECT count(*) FROM room.entities").fetchall() == [(5,)]
        ss.sql("CREATE TABLE kept AS SELECT 1 AS one")
        assert ss.sql("SELECT one FROM kept").fetchall() == [(1,)]
    states.close()


@pytest.mark.filterwarnings("ignore:.*that is no number")
def test_numbers_that_are_not_known_are_null(batch):
    ss, sim, _, states = batch
    arrays = {name: np.stack([getattr(d, name) for d in states]) for name in ("xpos", "xquat")}
    arrays["xpos"][2, 2] = np.nan
    sim.tick(arrays)
    unknown = ss.sql("SELECT env, name FROM sim.entities WHERE x IS NULL").fetchall()
    assert unknown == [(2, "cube")]
    assert ss.sql("SELECT count(vx) FROM sim.entities").fetchall() == [(0,)]
    for table, array in (("joints", "qpos="), ("contacts", "contact=")):
        with pytest.raises(ArgumentError, match=array):
            ss.sql(f"SELECT * FROM sim.{table}")


def test_batches_of_other_simulators():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body name='cup'><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    single = ssduck.World.attach(model, mujoco.MjData(model))
    with ssduck.Interpreter(recording=None) as ss:
        sim = ss.add_variable("sim", ssduck.World.batch(single, 3))
        poses = np.tile([0.0, 0, 0, 1, 0, 0, 0], (3, 1))
        poses[:, 0] = [1, 2, 3]
        sim.tick(poses={"cup": poses}, time=[0.1, 0.2, 0.3])
        rows = ss.sql("SELECT env, time, x FROM sim.entities WHERE name = 'cup'").fetchall()
        assert rows == [(0, 0.1, 1.0), (1, 0.2, 2.0), (2, 0.3, 3.0)]


REFUSED = [
    ("SELECT a.env FROM sim.entities a, sim.entities b WHERE touching(a, b)", r"ss\.eval"),
    ("SELECT * FROM sim.links", r"entities.*environment\(0\)"),
    ("CREATE TABLE kept AS SELECT * FROM sim.entities", "batch"),
    ("SELECT count(*) FROM sim.entities_history", "batch"),
]


@pytest.mark.parametrize(("text", "message"), REFUSED)
def test_what_raw_sql_cannot_says_what_to_write(batch, text, message):
    with pytest.raises(UnsupportedError, match=message):
        batch[0].sql(text)


def test_wrong_columns_are_an_error(batch):
    with pytest.raises(SelectScriptError, match="name"):
        batch[0].sql("SELECT nme FROM sim.entities")


def test_limits_hold_over_a_batch():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body name='a'/></worldbody></mujoco>"
    )
    with ssduck.Interpreter(recording=None, limits=ssduck.Limits(rows=1_000_000)) as ss:
        ss.add_variable("sim", ssduck.World.batch(model, 3)).tick(qpos=np.zeros((3, 0)))
        assert ss.sql("SELECT count(*) FROM sim.entities").fetchall() == [(3,)]
        with pytest.raises(SelectScriptError, match="rows"):
            ss.sql("FROM sim.entities a, sim.entities b, sim.entities c, range(1000000)")
