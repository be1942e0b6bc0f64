"""Records: what was recorded is opened as it was, by ssduck and by others; nothing is lost."""

from __future__ import annotations

import json
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import duckdb
import pandas as pd
import polars as pl
import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    RecordError,
    SqlError,
    UnsupportedError,
)
from ssduck.schema import RECORDABLE
from tests.support.bodies import create_linked_body
from tests.support.cases import sampled
from tests.support.timing import HANGS
from tools import kill

ROOT = Path(__file__).resolve().parents[2]
ALL = Recording(tables=RECORDABLE)
KINDS = ["folder", "live", "file"]
POSIX = pytest.mark.skipif(os.name != "posix", reason="limits and signals of POSIX")
# What a world shows in SQL: the present, and what is kept of it.
PRESENT = (*RECORDABLE, "ticks", "geometries")
PAST = tuple(f"{table}_history" for table in (*RECORDABLE, "ticks"))
MODELS = tuple(
    f"{table}_model" for table in ("entities", "links", "joints", "shapes", "geometries")
)


def rows(ss, table, where=""):
    return ss.sql(f'SELECT * FROM "{table}" {where} ORDER BY ALL').fetchall()


def sphere(client, place, radius=0.1):
    """A ball that falls; its number."""
    shape = pybullet.createCollisionShape(
        pybullet.GEOM_SPHERE, radius=radius, physicsClientId=client
    )
    return pybullet.createMultiBody(1, shape, basePosition=place, physicsClientId=client)


def lively(client, names=()):
    """A world of a board, balls that fall on it and an arm of two links; it changes on its way."""
    pybullet.setGravity(0, 0, -9.81, client)
    box = {"physicsClientId": client}
    board = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[2, 2, 0.05], **box)
    arm = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.05, 0.05, 0.3], **box)
    bodies = {
        "board": pybullet.createMultiBody(0, board, basePosition=[0, 0, -0.05], **box),
        "ball": sphere(client, [0.5, 0, 0.3]),
        "other": sphere(client, [-0.5, 0, 0.2]),
        "arm": create_linked_body(
            client,
            0,
            arm,
            basePosition=[0, 1, 0.3],
            linkPositions=[[0, 0, 0.3]],
            linkInertialFramePositions=[[0, 0, 0.3]],
            linkJointTypes=[pybullet.JOINT_REVOLUTE],
            linkJointAxis=[[1, 0, 0]],
        ),
    }
    named = {bodies[old]: new for old, new in zip(bodies, names, strict=False)}
    return {number: named.get(number, name) for name, number in bodies.items()}


def live_lab(ss, client, recording=ALL, ticks=40):
    """A world `lab` of which bodies came and went, one has been switched off, with a sensor."""
    numbers = lively(client)
    world = ss.add_variable("lab", ssduck.World.attach(client, names=numbers))
    world.add_sensor(
        "range_finder",
        "arm",
        "eye",
        position=[0, -0.2, 0],
        orientation=[0.5**0.5, 0, 0.5**0.5, 0],
        max_range=5.0,
    )
    ss.record("lab", recording)
    for tick in range(ticks):
        if tick == 10:
            pybullet.removeBody(next(n for n, name in numbers.items() if name == "ball"), client)
        if tick == 15:
            sphere(client, [0.2, 0.2, 0.05], radius=0.15)
        if tick == 20:
            ss.flush()
            world["other"].enabled = False
        if tick == 30:
            world["other"].enabled = True
        world.step(2)
    return world


@pytest.fixture(scope="module")
def kitchen(tmp_path_factory):
    """The kitchen live, from a folder, written live to a folder, and from a DuckDB file."""
    place = tmp_path_factory.mktemp("kitchen")
    recorded = place / "run.duckdb"
    ss = ssduck.load("kitchen", recorded, recording=ALL)
    with ss.record_to(place / "live") as live:
        for tick in range(25):
            if tick == 12:
                live.flush()
                ss.flush()
            ss.call_variable("kitchen").step(4)
    ss.export(place / "folder")
    answers = {program: answer(ss, program) for program in PROGRAMS["kitchen"]}
    tables = {name: rows(ss, name) for name in (*PRESENT, *PAST, *MODELS)}
    ss.close()
    opened = {
        "folder": ssduck.open(place / "folder"),
        "live": ssduck.open(place / "live"),
        "file": ssduck.open(recorded),
    }
    yield answers, tables, opened
    for each in opened.values():
        each.close()


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """The same of a world whose bodies come and go."""
    place = tmp_path_factory.mktemp("lab")
    client = pybullet.connect(pybullet.DIRECT)
    ss = ssduck.Interpreter(place / "run.duckdb", recording=None)
    live_lab(ss, client)
    ss.export(place / "folder")
    ss.flush()
    answers = {program: answer(ss, program) for program in PROGRAMS["lab"]}
    tables = {name: rows(ss, name) for name in (*PRESENT, *PAST, *MODELS)}
    ss.close()
    pybullet.disconnect(client)
    opened = {
        "folder": ssduck.open(place / "folder"),
        "file": ssduck.open(place / "run.duckdb"),
    }
    # What was opened can be written again.
    opened["folder"].export(place / "copy")
    opened["live"] = ssduck.open(place / "copy")
    yield answers, tables, opened
    for each in opened.values():
        each.close()


PROGRAMS = {
    "kitchen": [
        "SELECT id, position, orientation, mass, aabb FROM kitchen AS list;",
        "SELECT id(this) FROM kitchen WHERE isRobot(this) ORDER BY z(this) AS list;",
        "table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;"
        " SELECT id FROM kitchen WHERE above(table, this) AS list;",
        "table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;"
        " SELECT id, clearance(table, this) FROM kitchen WHERE on(table, this) AS list;",
        "SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen"
        " WHERE collides(a.this, b.this) AS list;",
        "SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen"
        " WHERE near(a.this, b.this, 0.002) AS list;",
        "SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen"
        " WHERE inContact(a.this, b.this) AND id(a.this) < id(b.this) AS list;",
        "SELECT id(a.this), id(b.this) FROM a=kitchen, b=kitchen"
        " WHERE isSensor(a.this) AND isSensing(a.this, b.this) AS list;",
        "SELECT id(this), tick(this), time, z FROM kitchen{0.2} AS list;",
        "SELECT id(this), tick(this) FROM kitchen{-0.1}"
        " WHERE isRobot(this) AND x(this) > 0 AS list;",
        "SELECT id(a.this), id(b.this), tick(a.this) FROM a=kitchen{-0.05}, b=kitchen{-0.05}"
        " WHERE touching(a.this, b.this) AND id(a.this) < id(b.this) AS list;",
        "count(SELECT this FROM kitchen{} AS list);",
        "getTime();",
    ],
    "lab": [
        "SELECT id, type, tick, position, velocity, isEnabled(this) FROM lab{} AS list;",
        "SELECT id, isSphere(this), isBox(this), volume(this) FROM lab{} AS list;",
        "SELECT id(a.this), id(b.this), tick(a.this), penetration(a.this, b.this)"
        " FROM a=lab{}, b=lab{} WHERE collides(a.this, b.this) AS list;",
        "SELECT id(a.this), id(b.this), clearance(a.this, b.this) FROM a=lab{0.1}, b=lab{0.1}"
        " WHERE id(a.this) < id(b.this) AS list;",
        "SELECT id(a.this), id(b.this), contactForce(a.this, b.this) FROM a=lab, b=lab"
        " WHERE inContact(a.this, b.this) AS list;",
        "SELECT id(a.this), id(b.this) FROM a=lab, b=lab"
        " WHERE isSensor(a.this) AND isSensing(a.this, b.this) AS list;",
        "SELECT id, x, y, z FROM lab WHERE isSensor(this) AS list;",
    ],
}


def answer(ss, program):
    """What a program gives, or why it does not."""
    try:
        return repr(ss.eval(program))
    except ssduck.SelectScriptError as error:
        return repr(error)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("program", PROGRAMS["kitchen"])
def test_the_kitchen_answers_as_it_did(kitchen, program, kind):
    answers, _, opened = kitchen
    assert answer(opened[kind], program) == answers[program]
    assert "Error(" not in answers[program]
    assert answers[program] not in ("[]", "0")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("program", PROGRAMS["lab"])
def test_a_world_that_changed_answers_as_it_did(lab, program, kind):
    answers, _, opened = lab
    assert answer(opened[kind], program) == answers[program]
    assert "Error(" not in answers[program]
    assert answers[program] != "[]"


@pytest.mark.parametrize("kind", KINDS)
@sampled("table", [*PRESENT, *PAST, *MODELS], every=4)
@pytest.mark.parametrize("world", [pytest.param("kitchen", marks=pytest.mark.slow), "lab"])
def test_tables_are_the_same_row_for_row(request, world, table, kind):
    _, tables, opened = request.getfixturevalue(world)
    assert rows(opened[kind], table) == tables[table]
    assert tables[table]


@pytest.mark.slow
def test_each_past_tick_is_the_same(tmp_path, client):
    with ssduck.Interpreter(recording=None) as ss:
        live_lab(ss, client, Recording(), ticks=30).request_tables(["shapes"])
        ss.export(tmp_path / "run")
        with ssduck.open(tmp_path / "run") as opened:
            for time in ss.past("lab").times:
                program = f"SELECT obj, tick, pose, velocity, aabb FROM lab{{{time!r}}} AS list;"
                assert repr(opened.eval(program)) == repr(ss.eval(program))
                program = (
                    "SELECT id(a.this), id(b.this), distance(a.this, b.this) FROM "
                    f"a=lab{{{time!r}}}, b=lab{{{time!r}}} WHERE near(a.this, b.this, 0.1) AS list;"
                )
                assert opened.eval(program) == ss.eval(program)


def test_the_time_of_day_goes_along(tmp_path, client):
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client))
        world.step()
        ss.export(tmp_path / "run")
        wanted = rows(ss, "ticks_history")
    with ssduck.open(tmp_path / "run") as opened:
        assert rows(opened, "ticks") == wanted[1:]
        opened.call_variable("lab").seek(0.0)
        assert rows(opened, "ticks") == wanted[:1]


def test_handles_of_a_record_tell_and_cannot_be_moved(kitchen):
    opened = kitchen[2]["folder"]
    world = opened.call_variable("kitchen")
    assert repr(world) == (
        "<RecordedWorld 'kitchen': 37 entities, ticks 2 to 27, t=0 s to 0.416667 s>"
    )
    cup = world["cup_905a"]
    assert (cup.kind, len(cup.position), cup.mass > 0) == ("kinbody", 3, True)
    assert len(world["barrett_4918"].joints) == len(world["barrett_4918"].links) - 1
    with pytest.raises(UnsupportedError, match="recorded tick"):
        cup.move([0, 0, 1])
    with pytest.raises(UnsupportedError, match="is itself a record"):
        opened.record("kitchen", Recording())
    with pytest.raises(UnsupportedError, match="is itself a record"):
        opened.record_to("elsewhere", "kitchen")
    assert not Path("elsewhere").exists()


def python(code, *arguments):
    """What Python prints in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@sampled("kind", ["folder", "file"], every=2)
def test_a_record_needs_no_simulator(tmp_path, client, kind):
    path = tmp_path / ("run.duckdb" if kind == "file" else "run")
    with ssduck.Interpreter(path if kind == "file" else ":memory:", recording=None) as ss:
        live_lab(ss, client)
        if kind == "folder":
            ss.export(path)
    code = """
import sys, ssduck
with ssduck.open(sys.argv[1]) as ss:
    print(ss.eval("SELECT id(a.this) FROM a=lab{-0.1}, b=lab{-0.1} WHERE collides(a.this, b.this) AS list;"))
    print(ss.sql("SELECT count(*) FROM links_history").fetchall(), ssduck.episodes(sys.argv[1])[0].ticks)
print("pybullet" in sys.modules)
"""
    assert python(code, path).splitlines()[-1] == "False"


# -- as others read it ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two episodes of one world and one of another; something unfinished lies about."""
    place = tmp_path_factory.mktemp("records") / "it's a folder, ü"
    client = pybullet.connect(pybullet.DIRECT)
    with ssduck.Interpreter(recording=None) as ss:
        live_lab(ss, client, ticks=5)
        ss.export(place)
        ss.call_variable("lab").step()
        ss.export(place)
        other = pybullet.connect(pybullet.DIRECT)
        sphere(other, [0, 0, 1])
        ss.add_variable("still", ssduck.World.attach(other))
        ss.record("still", ALL)
        ss.export(place, "still")
        pybullet.disconnect(other)
    pybullet.disconnect(client)
    for table in RECORDABLE:
        (place / table / "world=lab/episode=0/.part-000001.parquet.unfinished").write_bytes(b"PAR1")
    return place


@sampled("table", [*RECORDABLE, "ticks"], every=7)
def test_others_read_the_folder_as_it_is(folder, table):
    place = folder / table
    scanned = duckdb.sql(f"SELECT * FROM '{str(place).replace(chr(39), chr(39) * 2)}/**/*.parquet'")
    columns = ssduck.schema.TABLES[table].names
    assert scanned.columns == [*columns, "episode", "world"]
    kept = {"double": "DOUBLE", "integer": "BIGINT", "string": "VARCHAR", "boolean": "BOOLEAN"}
    types = [kept[column.type] for column in ssduck.schema.TABLES[table].columns]
    assert [str(type) for type in scanned.types[:-2]] == types
    assert [str(type) for type in scanned.types[-2:]] == ["BIGINT", "VARCHAR"]
    counts = {}
    for world, episode in (("lab", 0), ("lab", 1), ("still", 0)):
        with ssduck.open(folder, world, episode) as ss:
            counts[world, episode] = len(rows(ss, f"{table}_history"))
    found = scanned.aggregate("world, episode, count(*)", "world, episode").fetchall()
    assert {tuple(row[:2]): row[2] for row in found} == {k: n for k, n in counts.items() if n}
    frame = pd.read_parquet(place)
    assert [*frame.columns] == [*columns, "world", "episode"]
    assert len(frame) == sum(counts.values())
    lazy = pl.scan_parquet(f"{place}/**/*.parquet", hive_partitioning=True).collect()
    assert lazy.columns == [*columns, "world", "episode"]
    assert lazy.height == sum(counts.values())


@pytest.mark.slow
def test_episodes_are_told_and_opened_by_world_and_number(folder):
    told = ssduck.episodes(folder)
    assert [(e.world, e.number, e.ticks) for e in told] == [
        ("lab", 0, 6),
        ("lab", 1, 7),
        ("still", 0, 1),
    ]
    assert told[0].tables == tuple(sorted(RECORDABLE))
    assert (told[1].first_tick, told[1].last_tick) == (3, 9)
    assert told[1].end == pytest.approx(11 / 240)
    with ssduck.open(folder) as ss:
        assert ss.call_variable("lab").snapshot.number == 9
        assert len(ss.call_variable("still")) == 1
        assert ss.sql("SELECT count(*) FROM still.entities_history").fetchall() == [(1,)]
    with ssduck.open(folder, episode=0) as ss:
        assert ss.call_variable("lab").snapshot.number == 8
    with ssduck.open(folder, episode=1) as ss:
        assert ss.names()[0] == "lab"
        assert not ss.has_variable("still")


def test_a_newer_episode_that_holds_nothing_does_not_hide_an_older_one(tmp_path, client):
    with ssduck.Interpreter(recording=None) as ss:
        live_lab(ss, client, ticks=3)
        ss.export(tmp_path / "run")
        writing = ss.record_to(tmp_path / "run")
        assert writing.episode.ticks == 0
        assert writing.episode.last_tick is None
        (tmp_path / "run" / "episodes" / "lab-2.json").touch()  # about to begin
        with ssduck.open(tmp_path / "run") as opened:
            assert opened.past("lab").ticks[-1] == ss.past("lab").ticks[-1]
        with pytest.raises(RecordError, match="no episode 1 has ticks; episodes with ticks: 0 of"):
            ssduck.open(tmp_path / "run", episode=1)
        writing.close()
        assert writing.episode.ticks == 1


# -- what is written --------------------------------------------------------------------------


@sampled(
    ("chosen", "found"),
    [
        (["ball"], ["ball"]),
        (["eye"], ["arm", "eye"]),
        ("SELECT obj FROM lab WHERE isSphere(this) AS list;", ["lab_5", "other"]),
    ],
    every=3,
    ids=["name", "sensor", "program"],
)
def test_some_entities_are_exported(tmp_path, client, chosen, found):
    with ssduck.Interpreter(recording=None) as ss:
        world = live_lab(ss, client)
        (new,) = [e.name for e in world if e.name not in ("board", "other", "arm", "eye")]
        found = sorted(new if name == "lab_5" else name for name in found)
        ss.export(tmp_path / "names", entities=chosen)
        if not isinstance(chosen, str) and all(name in world for name in chosen):
            ss.export(tmp_path / "handles", entities=[world[name] for name in chosen])
            assert len(ssduck.episodes(tmp_path / "handles")) == 1
        listed = ", ".join(f"'{name}'" for name in found)
        wanted = rows(ss, "entities_history", f"WHERE name IN ({listed})")
        shapes = rows(
            ss,
            "shapes_history",
            f"WHERE entity IN (FROM entities_model SELECT id WHERE name IN ({listed}))",
        )
        if "ball" in found:  # which is no longer there
            with ssduck.open(tmp_path / "names") as opened:
                assert len(opened.call_variable("lab")) == 0
                assert opened.eval("SELECT id FROM lab{0.0} AS list;") == ["ball"]
    with ssduck.open(tmp_path / "names") as opened:
        assert rows(opened, "entities_history") == wanted
        assert rows(opened, "shapes_history") == shapes
        assert (
            sorted({row[0] for row in opened.sql("SELECT name FROM entities_model").fetchall()})
            == found
        )
    (episode,) = ssduck.episodes(tmp_path / "names")
    assert episode.entities is not None


@sampled(
    ("start", "end", "ticks"),
    [
        (None, None, range(13)),
        (0.0, None, range(13)),
        (0.025, 0.05, range(6, 13)),
        (0.025 + 1e-10, 0.05 - 1e-10, range(6, 13)),
        (0.025 + 1e-6, 0.05 - 1e-6, range(7, 12)),
        (0.025 - 1e-6, 0.05 + 1e-6, range(6, 13)),
        (-5, 0.0, range(1)),
        (0.05, 99, range(12, 13)),
    ],
    every=4,
)
def test_a_span_of_time_is_exported(tmp_path, client, start, end, ticks):
    lively(client)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client))
        for _ in range(12):
            world.step()
        ss.export(tmp_path / "run", start=start, end=end)
    with ssduck.open(tmp_path / "run") as opened:
        assert opened.past("lab").ticks == [tick + 1 for tick in ticks]


def test_ticks_that_there_are_none_of(tmp_path, client):
    lively(client)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client))
        world.step()
        for span in ({"start": 5.0}, {"end": -1.0}, {"start": 0.003, "end": 0.002}):
            with pytest.raises(EvaluationError, match="no tick of 'lab' of that time is recorded"):
                ss.export(tmp_path / "run", **span)
        with pytest.raises(ArgumentError, match="no entity 'boll' to be recorded"):
            ss.export(tmp_path / "run", entities=["boll"])
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("every", [1, 3])
@sampled("tables", [(), ("links",), ("joints", "contacts")], every=3, ids=str)
def test_recordings_of_any_kind_are_the_same_again(tmp_path, client, tables, every):
    recording = Recording(tables=tables, every=every, changed=every == 3)
    with ssduck.Interpreter(recording=None) as ss:
        live_lab(ss, client, recording)
        program = "SELECT id(a.this), id(b.this), tick(a.this), clearance(a.this, b.this) FROM a=lab{}, b=lab{} WHERE near(a.this, b.this, 0.2) AS list;"
        wanted = ss.eval(program)
        ss.export(tmp_path / "a")
        with ssduck.open(tmp_path / "a") as first:
            assert first.eval(program) == wanted
            first.export(tmp_path / "b")
            with ssduck.open(tmp_path / "b") as second:
                assert second.eval(program) == wanted
                for table in ("entities", "ticks", *tables):
                    name = f"{table}_history"
                    assert rows(second, name) == rows(first, name) == rows(ss, name)
                for table in {"links", "joints", "contacts"} - set(tables):
                    with pytest.raises(SqlError, match=f"the table of {table} of 'lab' is not"):
                        rows(second, f"{table}_history")
    assert [e.every for p in "ab" for e in ssduck.episodes(tmp_path / p)] == [every, every]


ODD = ["it's", 'a "quoted" one', "../../up", "ü=ö/😀\n,", " ; DROP TABLE x; --"]


@pytest.mark.slow
def test_names_of_any_letters(tmp_path, client):
    numbers = lively(client, ODD)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("küche", ssduck.World.attach(client, names=numbers, name="../up"))
        world.step(3)
        ss.export(tmp_path / "run", entities=ODD[:4])
        wanted = rows(ss, "entities_history")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]
    with ssduck.open(tmp_path / "run") as opened:
        assert rows(opened, "entities_history") == wanted
        assert opened.call_variable("küche")[ODD[2]].name == ODD[2]
    assert [e.world for e in ssduck.episodes(tmp_path / "run")] == ["küche"]


def test_one_world_of_two_names_is_recorded_under_the_first(tmp_path, client):
    lively(client)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("a", ssduck.World.attach(client, name="old"))
        ss.add_variable("b", world)
        assert list(ss.export(tmp_path / "run")) == ["a"]
    assert ssduck.episodes(tmp_path / "run")[0].world == "a"


@pytest.mark.slow
def test_nothing_touches_anything(tmp_path, client):
    sphere(client, [0, 0, 1])
    with ssduck.Interpreter(tmp_path / "run.duckdb", recording=ALL) as ss:
        ss.add_variable("lab", ssduck.World.attach(client)).step()
        ss.export(tmp_path / "run")
    for path in ("run", "run.duckdb"):
        with ssduck.open(tmp_path / path) as opened:
            for table in ("contacts", "sensings", "joints"):
                assert rows(opened, table) == rows(opened, f"{table}_history") == []
            program = "SELECT id FROM lab{} WHERE inContact(this, this) AS list;"
            assert opened.eval("SELECT id FROM lab WHERE inContact(this, this) AS list;") == []
            assert "Error" not in answer(opened, program) or "contacts" in answer(opened, program)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*no number")
def test_what_is_unknown_stays_unknown(tmp_path, client):
    numbers = lively(client)
    lost = next(number for number, name in numbers.items() if name == "ball")
    with ssduck.Interpreter(tmp_path / "run.duckdb", recording=ALL) as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client, names=numbers))
        pybullet.resetBasePositionAndOrientation(lost, [float("nan"), 0, 0], [0, 0, 0, 1], client)
        world.tick()
        ss.export(tmp_path / "run")
        wanted = {name: rows(ss, name) for name in (*PRESENT, *PAST)}
    assert any(row[6] is None for row in wanted["entities"])
    for path in ("run", "run.duckdb"):
        with ssduck.open(tmp_path / path) as opened:
            assert {name: rows(opened, name) for name in (*PRESENT, *PAST)} == wanted


# -- errors -----------------------------------------------------------------------------------


@pytest.fixture
def record(tmp_path, client):
    """A folder with a record of two parts."""
    numbers = lively(client)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client, names=numbers))
        with ss.record_to(tmp_path / "run") as writing:
            world.step()
            assert writing.flush() == world.snapshot.number
            world.step()
    return tmp_path / "run"


PART = "world=lab/episode=0/part-000001.parquet"


def _cut(record, table):
    file = record / table / PART
    file.write_bytes(file.read_bytes()[:-20])


def _spoil(record, table):
    file = record / table / PART
    file.write_bytes(b"PAR1" + b"x" * 100 + b"PAR1")


def _json(record, name, text):
    (record / name).write_text(text)


def _version(record, number):
    told = json.loads((record / "ssduck.json").read_text())
    _json(record, "ssduck.json", json.dumps(told | {"version": number}))


DAMAGES = [
    (
        shutil.rmtree,
        {},
        "there is no record .*run: neither a folder nor a DuckDB file",
    ),
    (
        lambda r: (r / "ssduck.json").unlink(),
        {},
        "run is no record of ssduck: it has no ssduck.json",
    ),
    (lambda r: _json(r, "ssduck.json", "{"), {}, "ssduck.json is damaged"),
    (lambda r: _json(r, "ssduck.json", "[]"), {}, "ssduck.json is damaged: it has no JSON object"),
    (lambda r: _json(r, "ssduck.json", "{}"), {}, "ssduck.json is of another format"),
    (
        lambda r: _version(r, 2),
        {},
        "of version 2; this ssduck reads those up to 1: install a newer",
    ),
    (lambda r: _version(r, "1"), {}, "it has no version"),
    (lambda r: _json(r, "episodes/lab-0.json", "{"), {}, "lab-0.json is damaged"),
    (
        lambda r: _json(r, "episodes/lab-0.json", "{}"),
        {},
        "lab-0.json is damaged: it lacks",
    ),
    (
        lambda r: _cut(r, "shapes"),
        {},
        "shapes/.*part-000001.* is no complete Parquet file; remove .*ticks",
    ),
    (lambda r: _cut(r, "ticks"), {}, "part-000001.parquet is damaged"),
    (lambda r: _spoil(r, "ticks"), {}, "part-000001.parquet is damaged: it is no complete"),
    (
        lambda r: (r / "shapes" / PART).unlink(),
        {},
        "part-000001.parquet is missing: the record was",
    ),
    (
        lambda r: (r / "models/links/world=lab/episode=0/part-000000.parquet").unlink(),
        {},
        "missing",
    ),
    (lambda r: shutil.rmtree(r / "ticks"), {}, "no tick of 'lab' was stored"),
    (lambda r: shutil.rmtree(r / "episodes"), {}, "nothing is recorded there"),
    (lambda r: None, {"world": "lap"}, "no world 'lap' is recorded.* mean 'lab'"),
    (lambda r: None, {"episode": 3}, "no episode 3 has ticks; episodes with ticks: 0 of 'lab'"),
]


@sampled(("damage", "chosen", "told"), DAMAGES, every=4, ids=[told[:40] for *_, told in DAMAGES])
def test_records_that_cannot_be_opened(record, damage, chosen, told):
    damage(record)
    with pytest.raises(RecordError, match=told):
        ssduck.open(record, **chosen)


@pytest.mark.parametrize(
    "how", [_cut, lambda r, table: (r / table / PART).unlink()], ids=["cut", "gone"]
)
def test_without_its_ticks_a_damaged_part_is_not_counted(record, how):
    how(record, "contacts")
    with pytest.raises(
        RecordError, match=r"remove .*ticks/world=lab/episode=0/part-000001.parquet to open"
    ):
        ssduck.open(record)
    (record / "ticks" / PART).unlink()
    with (
        pytest.warns(UserWarning, match="closed with 2 parts, and ends after 1 of them"),
        ssduck.open(record) as opened,
    ):
        assert len(opened.past("lab").ticks) == 2


def test_what_was_being_written_when_it_was_killed_is_not_counted(record):
    """Files of a part, and of what entities are, whose last ones are not there."""
    for table in ("entities", "contacts"):
        place = record / table / "world=lab" / "episode=0"
        shutil.copy(place / "part-000001.parquet", place / "part-000002.parquet")
    for table in ("geometries", "shapes", "links"):
        place = record / "models" / table / "world=lab" / "episode=0"
        shutil.copy(place / "part-000000.parquet", place / "part-000001.parquet")
    with ssduck.open(record) as opened:
        assert len(opened.past("lab").ticks) == 3
        assert opened.eval("SELECT id FROM lab AS list;") == ["board", "ball", "other", "arm"]


def test_a_damaged_episode_hides_no_other(record):
    for world in ("lab", "other"):
        (record / "episodes" / f"{world}-7.json").write_text("{")
    with ssduck.open(record) as opened:
        assert opened.names()[0] == "lab"
    with pytest.raises(RecordError, match=r"lab-7.json is damaged"):
        ssduck.episodes(record)


def test_a_folder_of_something_else_stays_as_it_is(tmp_path, client):
    lively(client)
    (tmp_path / "thesis.tex").write_text("x")
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client))
        for write in (ss.export, ss.record_to):
            with pytest.raises(
                RecordError, match=r"has something else in it, and is no record.*empty"
            ):
                write(tmp_path)
            with pytest.raises(RecordError, match=r"thesis.tex"):
                write(tmp_path / "thesis.tex")
        world.step()
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    with pytest.raises(RecordError, match=r"is no record of ssduck: it has no ssduck.json"):
        ssduck.open(tmp_path)
    with pytest.raises(RecordError, match=r"thesis.tex cannot be opened: .*not a valid DuckDB"):
        ssduck.open(tmp_path / "thesis.tex")


@POSIX
@pytest.mark.skipif(os.name == "posix" and os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written(tmp_path, client):
    lively(client)
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", ssduck.World.attach(client))
        with pytest.raises(RecordError, match=r"cannot be written: .*Permission denied"):
            ss.export(tmp_path / "run")


def test_a_folder_below_a_file(tmp_path, client):
    lively(client)
    (tmp_path / "file").touch()
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", ssduck.World.attach(client))
        with pytest.raises(RecordError, match=r"file/run cannot be written: .*Not a directory"):
            ss.export(tmp_path / "file" / "run")


# -- DuckDB files -----------------------------------------------------------------------------

RECORDER = """
import os, signal, sys
import ssduck
from ssduck.demos.kitchen import KITCHEN
ss = ssduck.load("kitchen", sys.argv[1])
kitchen = ss.call_variable("kitchen")
for _ in range(10):
    kitchen.step()
print(ss.flush()["kitchen"], flush=True)
if sys.argv[2] == "wait":
    sys.stdin.readline()
kitchen.step()
if sys.argv[2] == "kill":
    os.kill(os.getpid(), signal.SIGKILL)
ss.close()
"""


def recorder(path, end):
    return subprocess.Popen(
        [sys.executable, "-c", RECORDER, str(path), end],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
@POSIX
def test_a_file_holds_what_was_flushed_and_the_next_run_is_an_episode(tmp_path):
    path = tmp_path / "run.duckdb"
    for end, number in (("kill", 0), ("close", 1), ("kill", 2)):
        told, _ = recorder(path, end).communicate(timeout=HANGS)
        last = ssduck.episodes(path)[-1]
        assert (last.number, last.first_tick) == (number, 1)
        assert last.last_tick == int(told) + (end == "close")
        with ssduck.open(path) as ss:
            assert "ticks 1 to 11" in repr(ss.call_variable("kitchen")) or end == "close"
            assert ss.past("kitchen").ticks == list(range(1, last.last_tick + 1))
    with ssduck.open(path, episode=0) as ss:
        count = len(rows(ss, "entities_history"))
    assert count == 11 * 37
    client = pybullet.connect(pybullet.DIRECT)
    with ssduck.Interpreter(path) as ss:
        ss.add_variable("lab", ssduck.World.attach(client))
    pybullet.disconnect(client)
    with duckdb.connect(path) as plain:
        views = plain.sql(
            "SELECT schema_name, view_name FROM duckdb_views() WHERE NOT internal AND NOT temporary"
        ).fetchall()
        assert ("kitchen_record_0", "entities_history") in views
        assert ("lab", "entities_history") in views
        for schema, view in views:
            plain.sql(f"SELECT * FROM {schema}.{view}").fetchall()
        for episode in range(3):
            (found,) = plain.sql(
                f"SELECT count(*) FROM kitchen_record_{episode}.entities_history"
            ).fetchall()[0]
            assert found in (11 * 37, 12 * 37)
    assert [(e.world, e.number) for e in ssduck.episodes(path)] == [
        ("kitchen", 0), ("kitchen", 1), ("kitchen", 2), ("lab", 0),
    ]  # fmt: skip


@pytest.mark.slow
def test_a_file_in_use_is_told_of(tmp_path):
    path = tmp_path / "run.duckdb"
    with recorder(path, "wait") as process:
        try:
            process.stdout.readline()
            for use in (ssduck.open, ssduck.episodes):
                with pytest.raises(
                    RecordError, match=r"in use by another process.*export it there"
                ):
                    use(path)
            with pytest.raises(SqlError, match="in use by another process"):
                ssduck.Interpreter(path)
        finally:
            process.communicate("\n", timeout=HANGS)
    assert ssduck.episodes(path)[0].ticks == 12


@pytest.mark.slow
def test_a_file_can_be_opened_many_times_but_not_where_it_is_recorded_into(tmp_path, client):
    path = tmp_path / "run.duckdb"
    with ssduck.Interpreter(path) as ss:
        ss.add_variable("lab", ssduck.World.attach(client))
        ss.flush()
        with pytest.raises(RecordError, match="is open in this process: close it first"):
            ssduck.open(path)
    before = path.read_bytes()
    with ssduck.open(path) as one, ssduck.open(path) as two:
        assert rows(one, "ticks_history") == rows(two, "ticks_history")
        code = "import ssduck, sys; print(ssduck.open(sys.argv[1]).past('lab').ticks)"
        assert python(code, path) == "[1]\n"
    assert path.read_bytes() == before


def test_files_that_hold_no_record(tmp_path):
    (tmp_path / "empty.duckdb").touch()
    (tmp_path / "text.duckdb").write_text("x" * 5000)
    duckdb.connect(tmp_path / "other.duckdb").close()
    for name, told in (
        ("empty", "cannot be opened"),
        ("text", "not a valid DuckDB database file"),
        ("other", "nothing is recorded in the DuckDB file"),
        ("missing", "neither a folder nor a DuckDB file"),
    ):
        with pytest.raises(RecordError, match=told):
            ssduck.open(tmp_path / f"{name}.duckdb")
    assert not (tmp_path / "missing.duckdb").exists()


@pytest.mark.parametrize(
    ("about", "told"),
    [
        ("{", "is damaged: lab_record_0 lacks its description"),
        ('{"version": 1}', "is damaged: lab_record_0 lacks its description"),
        (None, "lab_record_0 in .* is a record of version 9; .*install a newer one"),
        ("bad", "is damaged: it has no valid recording settings"),
    ],
)
def test_files_of_another_version_or_damaged(tmp_path, client, about, told):
    path = tmp_path / "run.duckdb"
    with ssduck.Interpreter(path) as ss:
        ss.add_variable("lab", ssduck.World.attach(client))
    with duckdb.connect(path) as plain:
        ((kept,),) = plain.sql('SELECT about FROM lab_record_0."ssduck record"').fetchall()
        if about is None:
            about = json.dumps(json.loads(kept) | {"version": 9})
        if about == "bad":
            about = json.dumps(json.loads(kept) | {"recording": {"tables": ["nothing"]}})
        plain.execute('UPDATE lab_record_0."ssduck record" SET about = ?', [about])
    with pytest.raises(RecordError, match=told):
        ssduck.open(path)


def test_names_that_recorded_runs_have_are_taken(tmp_path, client):
    with ssduck.Interpreter(tmp_path / "run.duckdb") as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client))
        with pytest.raises(ArgumentError, match="a recorded run has it in SQL"):
            ss.add_variable("lab_record_0", world)
        with pytest.raises(ArgumentError, match="no entity 'nobody'"):
            ss.record("lab", Recording(entities=("nobody",)))
        world.step()
        assert ss.past("lab").ticks == [1, 2]  # it was recorded on


def test_what_was_never_closed_is_stored_when_the_interpreter_is(tmp_path, client):
    ss = ssduck.Interpreter()
    world = ss.add_variable("lab", ssduck.World.attach(client))
    ss.record_to(tmp_path / "run")
    world.step()
    ss.close()
    world.step()
    assert ssduck.episodes(tmp_path / "run")[0].last_tick == world.snapshot.number - 1
    with ssduck.open(tmp_path / "run") as opened:  # an empty world, then and now
        assert opened.eval("count(SELECT this FROM lab{} AS list);") == 0


# -- a full disk ------------------------------------------------------------------------------

FULL = """
import resource, signal, sys
import pybullet, ssduck
from ssduck import Recording
from ssduck.errors import SelectScriptError
from ssduck.schema import RECORDABLE

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
kind, path = sys.argv[1:]

def limit(size):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

client = pybullet.connect(pybullet.DIRECT)
pybullet.setGravity(0, 0, -9.81)
for place in range(40):
    ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1)
    pybullet.createMultiBody(1, ball, basePosition=[place, 0, 1])
world = ssduck.World.attach(client, name="lab")
kept = Recording(tables=("links",))
if kind == "file":
    ss = ssduck.Interpreter(path, recording=kept)
    ss.add_variable("lab", world)
    flush = ss.flush
else:
    ss = ssduck.Interpreter()
    ss.add_variable("lab", world)
    writing = ss.record_to(path, "lab", kept)
    flush = writing.flush
for _ in range(50):
    world.step()
flush()
print("stored", world.snapshot.number)
limit(30_000 if kind == "folder" else 900_000)
failed = 0
for tick in range(2600):
    try:
        world.step()
    except SelectScriptError as error:
        failed += 1
        told = str(error)
try:
    flush()
except SelectScriptError as error:
    failed += 1
    told = str(error)
print("failed", bool(failed), "is whole" in told, "until there is room" in told)
assert ss.sql("SELECT count(*) FROM lab.entities").fetchall() == [(40,)]
limit(resource.RLIM_INFINITY)
world.step()
flush()
print("again", world.snapshot.number)
ss.close()
"""


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize("kind", ["folder", "file"])
def test_a_full_disk_loses_nothing(tmp_path, kind):
    path = tmp_path / ("run.duckdb" if kind == "file" else "run")
    stored, failed, again = python(FULL, kind, path).splitlines()
    assert (stored, failed) == ("stored 52", "failed True True True")
    last = int(again.removeprefix("again "))
    with ssduck.open(path) as ss:
        assert ss.past("lab").ticks == list(range(2, last + 1))
        counts = ss.sql("SELECT tick, count(*) FROM entities_history GROUP BY tick").fetchall()
        assert len(counts) == last - 1
        assert {count for _, count in counts} == {40}
        assert ss.sql("SELECT count(*) FROM links_history").fetchall() == [(40 * (last - 1),)]
    assert not list(tmp_path.rglob("*.unfinished"))


EXPORT = """
import resource, signal, sys, ssduck
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
with ssduck.load("kitchen") as ss:
    ss.export(sys.argv[1])
    resource.setrlimit(resource.RLIMIT_FSIZE, (4_000, resource.RLIM_INFINITY))
    try:
        ss.export(sys.argv[1])
    except ssduck.SelectScriptError as error:
        print(type(error).__name__)
"""


@pytest.mark.slow
@POSIX
def test_half_an_export_is_taken_back(tmp_path):
    assert python(EXPORT, tmp_path / "run") == "RecordError\n"
    assert [e.number for e in ssduck.episodes(tmp_path / "run")] == [0]
    assert not list(tmp_path.rglob("episode=1"))


# -- killed -----------------------------------------------------------------------------------


@POSIX
@sampled("seed", range(6), every=6)
def test_killed_recorders_leave_whole_records(seed):
    """The short form of `python -m tools.kill`."""
    run = kill.Run(kill.KINDS["both"])
    run.add(seed)
    assert run.faults == {}
