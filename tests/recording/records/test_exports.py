"""What records contain, and errors of records."""

import json
import shutil

import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import ArgumentError, EvaluationError, RecordError, SqlError
from ssduck.recording.stores.descriptions import read_description
from tests.support.cases import sampled
from tests.support.recorded import (
    ALL,
    PAST,
    PRESENT,
    end_part,
    live_lab,
    lively,
    rows,
)

# -- what is written -----------------------------------------------------------------------------


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
@sampled("every", [1, 3], every=2)
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
        x = ss.sql("SELECT x FROM entities_history WHERE name = 'ball' ORDER BY tick").fetchall()
    assert [value is None for (value,) in x] == [False, True]
    assert any(row[6] is None for row in wanted["entities"])
    for path in ("run", "run.duckdb"):
        with ssduck.open(tmp_path / path) as opened:
            assert {name: rows(opened, name) for name in (*PRESENT, *PAST)} == wanted


# -- errors --------------------------------------------------------------------------------------


@pytest.fixture
def record(tmp_path, archive):
    """A folder with a record of two parts."""
    return archive.copy(write_two_parts, tmp_path / "run")


def write_two_parts(place):
    client = pybullet.connect(pybullet.DIRECT)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client, names=lively(client)))
        with ss.record_to(place) as writing:
            world.step()
            assert end_part(writing) == world.snapshot.number
            world.step()
    pybullet.disconnect(client)


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
    told = read_description(record / "ssduck.json")
    _json(record, "ssduck.json", json.dumps(told | {"version": number}))


DAMAGES = [
    (shutil.rmtree, "there is no record .*run: neither a folder nor a DuckDB file"),
    (lambda r: (r / "ssduck.json").unlink(), "run is no record of ssduck: it has no ssduck.json"),
    (lambda r: _json(r, "ssduck.json", "{"), "ssduck.json is damaged"),
    (lambda r: _json(r, "ssduck.json", "{}"), "ssduck.json is of another format"),
    (lambda r: _json(r, "ssduck.json", "[]"), "ssduck.json is damaged: it has no JSON object"),
    (lambda r: _version(r, 2), "of version 2; this ssduck reads those up to 1: install a newer"),
    (lambda r: _version(r, 0), "it has no version"),
    (lambda r: _version(r, "1"), "it has no version"),
    (lambda r: _json(r, "episodes/lab-0.json", "{"), "lab-0.json is damaged"),
    (lambda r: _json(r, "episodes/lab-0.json", "{}"), "lab-0.json is damaged: it lacks"),
    (
        lambda r: _cut(r, "shapes"),
        "shapes/.*part-000001.* is no complete Parquet file; `ssduck check --repair` drops",
    ),
    (lambda r: _cut(r, "ticks"), "part-000001.parquet is damaged"),
    (lambda r: (r / "shapes" / PART).unlink(), "part-000001.parquet is missing: the record was"),
    (lambda r: _spoil(r, "ticks"), "part-000001.parquet is damaged: it is no complete"),
    (lambda r: (r / "models/links/world=lab/episode=0/part-000000.parquet").unlink(), "missing"),
    (lambda r: shutil.rmtree(r / "ticks"), "no tick of 'lab' was stored"),
    (lambda r: shutil.rmtree(r / "episodes"), "lab-0.json is missing, and ticks of its"),
]


@sampled(("damage", "told"), DAMAGES, every=3, ids=[told[:40] for _, told in DAMAGES])
def test_records_that_cannot_be_opened(record, damage, told):
    damage(record)
    with pytest.raises(RecordError, match=told):
        ssduck.open(record)


def test_what_is_not_recorded_cannot_be_opened(record):
    for chosen, told in (
        ({"world": "lap"}, "no world 'lap' is recorded.* mean 'lab'"),
        ({"episode": 3}, "no episode 3 has ticks; episodes with ticks: 0 of 'lab'"),
    ):
        with pytest.raises(RecordError, match=told):
            ssduck.open(record, **chosen)


@pytest.mark.parametrize(
    "how", [_cut, lambda r, table: (r / table / PART).unlink()], ids=["cut", "gone"]
)
def test_a_damaged_part_can_be_left_out(record, how):
    how(record, "contacts")
    with pytest.raises(RecordError, match=r"contacts/.*/part-000001.parquet .*ssduck check"):
        ssduck.open(record)
    with (
        pytest.warns(UserWarning, match="part-000001.parquet .*; left out: tick 3"),
        ssduck.open(record, partial=True) as opened,
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
        assert next(iter(opened)) == "lab"
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


def test_a_folder_below_a_file(tmp_path, client):
    lively(client)
    (tmp_path / "file").touch()
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", ssduck.World.attach(client))
        with pytest.raises(RecordError, match=r"file/run cannot be written: .*Not a directory"):
            ss.export(tmp_path / "file" / "run")


def test_a_world_without_a_record_is_told_of_with_the_call(tmp_path, client):
    with ssduck.Interpreter(recording=None) as ss:
        with pytest.raises(EvaluationError, match=r"there is no world"):
            ss.export(tmp_path / "run")
        ss.add_variable("lab", ssduck.World.attach(client))
        with pytest.raises(EvaluationError, match=r"ss\.record\('lab', ssduck\.Recording\(\)\)"):
            ss.export(tmp_path / "run")
    assert not (tmp_path / "run").exists()
