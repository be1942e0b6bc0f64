"""Opening a record reads its ticks and models; the current tick is restored when it is read."""

import pybullet
import pytest

import ssduck
from ssduck.recording.replay.record import Record
from ssduck.recording.stores import parquet_archive
from tests.support.bodies import solid

STEPS = 5
HEIGHTS = [1.0, 2.0]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder and a file with the same record of two spheres, of which one falls."""
    place = tmp_path_factory.mktemp("opening")
    client = pybullet.connect(pybullet.DIRECT)
    for mass, height in enumerate(HEIGHTS):
        solid(client, pybullet.GEOM_SPHERE, mass, [0, 0, height], radius=0.1)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
    world = ssduck.World.attach(client, {0: "still", 1: "falling"})
    with ssduck.Interpreter(place / "run.duckdb") as ss:
        ss.add_variable("lab", world)
        with ss.record_to(place / "run"):
            world.step(STEPS)
    pybullet.disconnect(client)
    return {"folder": place / "run", "file": place / "run.duckdb"}


@pytest.fixture
def work(monkeypatch):
    """The ticks that are restored and the rows that are read."""
    done = []
    restore, rows = Record.restore, parquet_archive._rows_of_ticks

    def counted_restore(record, tick):
        done.append(f"tick {tick}")
        return restore(record, tick)

    def counted_rows(file, *arguments):
        done.append(file.parts[-4])
        return rows(file, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Record, "restore", counted_restore)
    monkeypatch.setattr(parquet_archive, "_rows_of_ticks", counted_rows)
    return done


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_the_past_needs_no_current_tick(runs, kind, work):
    with ssduck.open(runs[kind]) as ss:
        lab, ticks = ss.call_variable("lab"), ss.past("lab").ticks
        assert len(ticks) >= STEPS
        assert ss.eval("SELECT id, tick FROM lab{} WHERE z > 1.5 AS list;") == [
            value for tick in ticks for value in ("falling", tick)
        ]
        assert ss.eval("SELECT id FROM lab{0.0} WHERE z < 1.5 AS list;") == ["still"]
        assert ss.past("lab", -2.5 / 240).ticks == ticks[-3:]
        assert (lab.time, lab.timestep) == pytest.approx((STEPS / 240, 1 / 240))
        assert work == []
        heights = [lab[name].position[2] for name in ("still", "falling")]
        assert ss.eval("SELECT z FROM lab AS list;") == heights
        assert work.count(f"tick {ticks[-1]}") == 1


READS = [
    len,
    lambda lab: [entity.name for entity in lab],
    lambda lab: "still" in lab,
    lambda lab: lab["falling"].position[2],
    lambda lab: lab.what_if({"still": [1, 0, 0, 0, 5, 5, 5]})["still"].position[2],
    lambda lab: lab.seek(1 / 240)["falling"].position[2],
    lambda lab: lab.seek(0.0).step(2).time,
    lambda lab: lab.snapshot.tables["ticks"]["wall_time"][0] > 1e9,
    repr,
]


@pytest.mark.parametrize("number", range(len(READS)))
def test_whatever_is_read_first(runs, number):
    """It is the same as after a program about the current tick."""
    with ssduck.open(runs["folder"]) as first, ssduck.open(runs["folder"]) as second:
        second.eval("SELECT id FROM lab AS list;")
        worlds = [ss.call_variable("lab") for ss in (first, second)]
        assert [world.ticker.is_restored for world in worlds] == [False, True]
        lazily, eagerly = (READS[number](world) for world in worlds)
        assert lazily == eagerly


@pytest.mark.slow
def test_raw_sql_reads_the_current_tick(runs):
    with ssduck.open(runs["file"]) as ss:
        rows = ss.sql("SELECT name, tick FROM lab.entities ORDER BY name").fetchall()
        last = ss.past("lab").ticks[-1]
        assert rows == [("falling", last), ("still", last)]
