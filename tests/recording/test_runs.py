"""Rows tell which run they are of: relations in SQL answer for that one, or say that they cannot."""

import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import EvaluationError, SelectScriptError, SqlError
from ssduck.schema import RECORDABLE
from tests.support.bodies import solid

ALL = Recording(tables=RECORDABLE)
# Of episode 0 and 1: how far the centres of two balls of radius 0.5 are apart, and the gap.
APART = (0.8, 1.3)
RADIUS = 0.5


def balls(client, apart):
    for x in (0, apart):
        solid(client, pybullet.GEOM_SPHERE, 0, [x, 0, 0], radius=RADIUS)
    return ssduck.World.attach(client)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A record of two episodes of one world's name."""
    place = tmp_path_factory.mktemp("runs") / "r"
    for apart in APART:
        client = pybullet.connect(pybullet.DIRECT)
        with ssduck.Interpreter(recording=ALL) as ss:
            ss.add_variable("lab", balls(client, apart)).step()
            ss.export(place)
        pybullet.disconnect(client)
    return place


@pytest.fixture(scope="module")
def opened(folder):
    with ssduck.open(folder) as ss:  # episode 1
        yield ss


def rows_of(folder, episode=None):
    chosen = "" if episode is None else f" WHERE episode = {episode}"
    return (
        f"(FROM read_parquet('{folder}/entities/**/*.parquet', hive_partitioning = true){chosen})"
    )


def asked(ss, what, rows):
    return ss.sql(
        f"WITH e AS {rows} SELECT {what} FROM e AS a JOIN e AS b USING (world, episode, tick) "
        "WHERE a.id < b.id"
    ).fetchall()


ANSWERS = {
    "clearance(a, b)": 0.3,
    "lab.clearance(a, b)": 0.3,
    "collides(a, b)": False,
    "near(a, b, 0.4)": True,
    "penetration(a, b)": 0.0,
    "touching(a, b)": False,
    "inContact(a, b)": False,
    "hasContact(a, b)": False,
    "contactForce(a, b)": 0.0,
    "isSensing(a, b)": False,
    "isBox(a)": False,
    "nearestPoints(a, b)[1][1]": 0.5,
    "solidVolume(a)": 4 / 3 * 3.141592653589793 * RADIUS**3,
}


@pytest.mark.parametrize("what", ANSWERS)
def test_rows_of_the_opened_episode_are_answered(opened, folder, what):
    assert asked(opened, what, rows_of(folder, 1)) == [(pytest.approx(ANSWERS[what]),)] * 2


# Without a call: boxes that are apart tell.
FOREIGN = [what for what in ANSWERS if not what.startswith("touching")]


@pytest.mark.parametrize("what", FOREIGN)
def test_rows_of_another_episode_are_an_error(opened, folder, what):
    with pytest.raises(SelectScriptError, match=r"belongs to the run|of another run"):
        asked(opened, what, rows_of(folder, 0))
    with pytest.raises(SelectScriptError, match=r"belongs to the run|of another run"):
        asked(opened, what, rows_of(folder))


@pytest.fixture(scope="module")
def live():
    client = pybullet.connect(pybullet.DIRECT)
    with ssduck.Interpreter(recording=ALL) as ss:
        world = ss.add_variable("lab", balls(client, 0.8))
        for x in (0.9, 1.3):
            body = pybullet.getBodyUniqueId(1, physicsClientId=client)
            pybullet.resetBasePositionAndOrientation(
                body, [x, 0, 0], [0, 0, 0, 1], physicsClientId=client
            )
            world.step()
        yield ss
    pybullet.disconnect(client)


@pytest.mark.slow
def test_rows_that_were_copied_are_answered_from_their_tick(live):
    live.sql("CREATE OR REPLACE TABLE copied AS SELECT * FROM entities_history")
    told = live.sql(
        "SELECT clearance(a, b) FROM copied a JOIN copied b USING (tick) WHERE a.id < b.id ORDER BY tick"
    ).fetchall()
    assert [gap for (gap,) in told] == pytest.approx([0.0, 0.0, 0.3])


CHANGED = [
    ("* REPLACE (x + 1 AS x)", EvaluationError, "differs from the record"),
    ("* REPLACE (-qw AS qw)", EvaluationError, "differs from the record"),
    ("* REPLACE (NULL::DOUBLE AS z)", EvaluationError, "differs from the record"),
    ("* REPLACE (run + 1 AS run)", EvaluationError, "belongs to the run"),
    ("* REPLACE (NULL::BIGINT AS run)", EvaluationError, "belongs to the run"),
    ("* REPLACE (99999 AS tick)", SelectScriptError, "tick"),
    ("* EXCLUDE (run)", SqlError, "whole rows of entities"),
    ("tick, id", SqlError, "whole rows of entities"),
]


@pytest.mark.parametrize(("columns", "error", "told"), CHANGED, ids=[row[0] for row in CHANGED])
def test_rows_that_were_changed_are_an_error(live, columns, error, told):
    with pytest.raises(error, match=told):
        live.sql(f"SELECT clearance(a, b) FROM (SELECT {columns} FROM entities) a, entities b")


def test_what_is_no_row_is_unknown(live):
    told = live.sql(
        "SELECT clearance(a, b), collides(a, b) FROM entities a LEFT JOIN entities b ON false"
    )
    assert told.fetchall() == [(None, None)] * 2
    same = "SELECT clearance(a, b) FROM (SELECT * REPLACE (x + 0 AS x) FROM entities) a, entities b"
    assert len(live.sql(same).fetchall()) == 4


@pytest.mark.slow
def test_rows_of_two_ticks_are_an_error(live):
    shapes = ("clearance(a, b)", "near(a, b, 0.01)", "collides(a, b)", "inside(a, b)")
    for what in (*shapes, "inContact(a, b)", "contactForce(a, b)", "isSensing(a, b)"):
        for same in ("a.id = b.id", "a.id < b.id"):
            with pytest.raises(SqlError, match=r"two ticks: compare those of one, in SQL a\.tick"):
                live.sql(
                    f"SELECT {what} FROM entities_history a, entities_history b "
                    f"WHERE a.tick < b.tick AND {same}"
                ).fetchall()


@pytest.mark.slow
def test_a_what_if_world_is_another_run(live):
    world = live.call_variable("lab")
    first = next(iter(world)).name
    live.add_variable("moved", world.what_if({first: [1, 0, 0, 0, 0.5, 0, 0]}))
    try:
        pairs = "SELECT {0}.clearance(a, b) FROM {1}.entities a, {1}.entities b WHERE a.id < b.id"
        (gap,) = live.sql(pairs.format("moved", "moved")).fetchone()
        assert gap == 0.0
        for one, other in (("lab", "moved"), ("moved", "lab")):
            with pytest.raises(EvaluationError, match="belongs to the run"):
                live.sql(pairs.format(one, other))
        runs = "SELECT count(DISTINCT run) FROM (FROM lab.entities UNION ALL FROM moved.entities)"
        assert live.sql(runs).fetchone() == (2,)
    finally:
        live.add_variable("moved", world)


@pytest.mark.slow
def test_a_run_is_the_same_wherever_it_is_kept(tmp_path, client):
    file = tmp_path / "r.duckdb"
    with ssduck.Interpreter(file, recording=ALL) as ss:
        world = ss.add_variable("lab", balls(client, 0.8))
        with ss.record_to(tmp_path / "live"):
            world.step()
        ss.export(tmp_path / "copy")
        runs = {ss.sql("SELECT any_value(run) FROM entities").fetchone()}
        runs |= set(ss.sql("SELECT DISTINCT run FROM entities_history").fetchall())
    for place in (file, tmp_path / "live", tmp_path / "copy"):
        with ssduck.open(place) as ss:
            for table in ("entities", "entities_history", "entities_model"):
                runs |= set(ss.sql(f"SELECT DISTINCT run FROM {table}").fetchall())
    assert len(runs) == 1
    ((run,),) = runs
    assert 0 < run < 2**53
