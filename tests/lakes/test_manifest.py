"""The manifest tells of each episode, and damage is one row of errors."""

import io
import json
import os
import shutil
import zlib

import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck.errors import ArgumentError, RecordError
from ssduck.lakes import workers
from ssduck.lakes.lake import MANIFEST
from ssduck.recording.stores.files import json_text
from tests.lakes.conftest import EPISODES, STEPS
from tests.support.cases import sampled
from tests.support.command_line import write_scene
from tests.support.lake_questions import PROGRAMS, by_itself, tags_by_two_lakes

QUESTION = PROGRAMS["last tick"]


def part(folder, number, table="entities", name="part-000000.parquet"):
    return folder / f"{table}/world=sim/episode={number}/{name}"


def ask(folder, program=QUESTION, **arguments):
    rows = ssduck.lake(folder).ask(program, processes=1, **arguments).to_pylist()
    return {row["episode"]: (row["answer"], row["error"]) for row in rows}


def test_columns(recorded):
    lake = ssduck.lake(recorded)
    rows = lake.episodes.to_pylist()
    assert len(lake) == len(rows) == EPISODES
    episode = ssduck.episodes(recorded)[2]
    row = rows[2]
    wanted = {
        "path": str(recorded), "world": "sim", "episode": 2, "id": episode.id, "complete": True,
        "ticks": STEPS + 1, "first_tick": episode.first_tick, "end": episode.end, "error": None,
        "return": episode.tags["return"], "success": False, "every": 1,
    }  # fmt: skip
    assert {name: row[name] for name in wanted} == wanted
    assert {"cup", "wall"} < set(row["entities"])
    own = [f for f in recorded.rglob("*") if f.is_file() and "episode=2" in str(f)]
    own += [recorded / "ssduck.json", recorded / "episodes/sim-2.json", recorded / "gym/sim-2.json"]
    assert row["size"] == sum(file.stat().st_size for file in own)


def test_the_seed_of_an_episode_is_a_column(recorded):
    seeds = ssduck.lake(recorded).episodes["seed"].to_pylist()
    assert len(set(seeds)) == EPISODES
    program = "heldFor(z(sim.cup) > 0);"
    assert list(ask(recorded, program, where=f"seed = {seeds[3]} AND error IS NULL")) == [3]


def test_written_read_and_rebuilt(folder, monkeypatch):
    lake = ssduck.lake(folder)
    file = folder / f"{MANIFEST}.parquet"
    assert lake.manifest == file
    assert pq.read_table(file).num_rows == EPISODES
    with monkeypatch.context() as patch:
        patch.setattr("ssduck.lakes.scan._described", None)  # nothing is read anew
        assert ssduck.lake(folder)._entries == lake._entries
    for content in (b"", b"PAR1", file.read_bytes()[:-40], None):
        file.unlink() if content is None else file.write_bytes(content)
        assert ssduck.lake(folder)._entries == lake._entries
        assert pq.read_table(file).num_rows == EPISODES


@pytest.mark.slow
def test_new_changed_and_missing_episodes(folder):
    ssduck.lake(folder)
    with ssduck.open(folder, "sim", 1) as ss:
        ss.export(folder)
    assert [e.episode for e in ssduck.lake(folder)._entries] == list(range(EPISODES + 1))
    (folder / "episodes/sim-3.json").unlink()
    for place in list(folder.rglob("episode=3")):
        shutil.rmtree(place)
    answers = ask(folder)
    assert answers[3] == (None, f"episode 3 of 'sim' in {folder} is missing: its files were there "
                          "when the manifest was made")  # fmt: skip
    assert answers[EPISODES] == answers[1]
    assert ask(folder)[3] == answers[3]  # it is known from then on
    lake = ssduck.lake(folder)
    lake.refresh(forget_missing=True)
    assert [e.episode for e in lake._entries] == [0, 1, 2, 4, 5]
    assert 3 not in ask(folder)


def newer(folder):
    content = json.loads((folder / "ssduck.json").read_text()) | {"version": 2}
    (folder / "ssduck.json").write_text(json_text(content))


def flipped(file, place=500):
    content = bytearray(file.read_bytes())
    content[place] ^= 1
    file.write_bytes(content)


DAMAGES = {
    "a flipped byte": (lambda f: flipped(part(f, 1)), "its checksum is wrong"),
    "a flipped footer": (lambda f: flipped(part(f, 1), -100), "is damaged"),
    "a truncated part": (lambda f: part(f, 1).write_bytes(part(f, 1).read_bytes()[:900]), "damaged"),
    "an empty description": (lambda f: (f / "episodes/sim-1.json").write_text(""), "sim-1.json"),
    "half a description": (lambda f: (f / "episodes/sim-1.json").write_text('{"wor'), "sim-1.json"),
    "no description": (lambda f: (f / "episodes/sim-1.json").unlink(), "sim-1.json is missing"),
    "no part": (lambda f: part(f, 1).unlink(), "is missing"),
    "no model": (lambda f: part(f, 1, "models/shapes").unlink(), "is missing"),
    "another part": (lambda f: shutil.copy(part(f, 2), part(f, 1)), "another part"),
}  # fmt: skip


@pytest.mark.slow
@sampled("is_known", [False, True], ids=["before the manifest", "after it"], every=2)
@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_one_row(folder, damage, is_known):
    whole = {number: by_itself(folder, number, QUESTION) for number in (0, 2)}
    if is_known:
        ssduck.lake(folder)
    break_it, message = DAMAGES[damage]
    break_it(folder)
    answers = ask(folder)
    assert sorted(answers) == list(range(EPISODES))
    assert answers[1][0] is None
    assert message in answers[1][1]
    assert {number: answers[number] for number in whole} == whole
    assert [number for number, (_, error) in answers.items() if error] == [1]


def test_damage_while_it_is_asked(folder):
    """The manifest was read, and a file changes before its episode is asked."""
    lake = ssduck.lake(folder)
    flipped(part(folder, 2))
    rows = lake.ask(QUESTION, processes=1).to_pylist()
    assert [row["episode"] for row in rows if row["error"]] == [2]


def test_a_newer_version_is_an_error_of_its_episodes(folder, recorded, tmp_path):
    newer(folder)
    shutil.copytree(recorded, tmp_path / "today")
    answers = ssduck.lake(tmp_path).ask(QUESTION, processes=1).to_pylist()
    errors = {row["path"]: row["error"] for row in answers}
    assert len(answers) == 2 * EPISODES
    assert "version 2" in errors[str(folder)]
    assert errors[str(tmp_path / "today")] is None


@pytest.mark.slow
def test_a_half_written_episode(folder):
    content = json.loads((folder / "episodes/sim-4.json").read_text())
    del content["parts"]
    (folder / "episodes/sim-4.json").write_text(json_text(content))
    episodes = ssduck.lake(folder).episodes
    assert episodes["complete"].to_pylist()[3:] == [True, False]
    assert ask(folder)[4] == by_itself(folder, 4, QUESTION)


def test_tags_of_two_lakes_are_kept(folder):
    assert tags_by_two_lakes(folder) == [(1, 2), (1, 2)]


@pytest.mark.slow
def test_patterns_files_and_folders(recorded, tmp_path):
    for name in ("a/night", "b/day", "b/night", "c[1]/night"):
        shutil.copytree(recorded, tmp_path / name)
    with ssduck.open(recorded, "sim", 0) as ss, ssduck.Interpreter(tmp_path / "own.duckdb") as own:
        own.add_variable("sim", ss["sim"])
    assert len(ssduck.lake(tmp_path / "*/night")) == 3 * EPISODES
    assert len(ssduck.lake(tmp_path / "**/day")) == EPISODES
    assert len(ssduck.lake(tmp_path / "c[1]")) == EPISODES
    assert len(ssduck.lake(f"file://{tmp_path / 'b'}")) == 2 * EPISODES
    with pytest.raises(RecordError, match="there is no record"):
        ssduck.lake(tmp_path / "d*")
    with pytest.raises(RecordError, match="there is no record"):
        ssduck.lake(tmp_path / "nothing")


@pytest.mark.slow
def test_records_in_the_folder_of_a_record(recorded, folder):
    for name in ("night", "night/late/again"):
        shutil.copytree(recorded, folder / name)
    with ssduck.open(folder, "sim", 0) as ss:
        ss.export(folder / "day.duckdb")
    rows = ssduck.lake(folder).episodes.to_pylist()
    places = [os.path.relpath(row["path"], folder) for row in rows]
    assert places == [
        *["."] * EPISODES, "day.duckdb", *["night"] * EPISODES, *["night/late/again"] * EPISODES
    ]  # fmt: skip
    assert not any(row["error"] for row in rows)
    sizes = [row["size"] for row in rows if row["path"] == str(folder)]
    assert sizes == ssduck.lake(folder / "night/late").episodes["size"].to_pylist()


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("patience", [0.0, 60.0])
def test_a_terminal_shows_how_many_episodes_a_long_listing_has_read(folder, monkeypatch, patience):
    monkeypatch.setattr("ssduck.recording.replay.progress.DELAY", patience)
    monkeypatch.setattr("ssduck.recording.replay.progress.INTERVAL", 0.0)
    monkeypatch.setattr("sys.stderr", terminal := Terminal())
    assert len(ssduck.lake(folder)) == EPISODES
    assert (f"{EPISODES}/?" in terminal.getvalue()) == (patience == 0)


@pytest.mark.slow
def test_tags_are_for_all_episodes_or_none(tmp_path):
    scene = write_scene(tmp_path) / "two.toml"
    (tmp_path / "lake").mkdir()
    for name in ("a", "b.duckdb", "c"):
        database = tmp_path / "lake" / name if name.endswith(".duckdb") else ":memory:"
        with ssduck.load(scene, database) as ss:
            ss.run(0.02)
            if database == ":memory:":
                ss.export(tmp_path / "lake" / name)
    lake = ssduck.lake(tmp_path / "lake")
    assert len(lake) == 3
    with pytest.raises(RecordError, match=r"b\.duckdb is a DuckDB file"):
        lake.set_tags({"task": "pick"})
    assert [entry.tags for entry in ssduck.lake(tmp_path / "lake").entries] == [{}] * 3
    assert lake.set_tags({"task": "pick"}, "path LIKE '%/c'") == 1


def test_tags_that_differ_in_case_only(folder):
    lake = ssduck.lake(folder)
    assert lake.set_tags({"goal": 1, "Goal": 2}, "episode = 0") == 1
    assert lake.set_tags({"Goal": 1}, "episode = 1") == 1
    for where, episodes in (
        ('"goal" = 1', [0]),
        ('"Goal" = 1', [1]),
        ("Goal = 2 AND goal = 1 AND EPISODE = 0", [0]),
    ):
        assert lake.ask("1;", where=where, processes=1)["episode"].to_pylist() == episodes
    with pytest.raises(ArgumentError, match=r"GOAL may be '[Gg]oal' and '[Gg]oal'"):
        lake.ask("1;", where="GOAL = 1")


@pytest.mark.slow
def test_tags(folder):
    lake = ssduck.lake(folder)
    assert lake.set_tags({"task": "pick", "grade": 2}, "episode < 3") == 3
    answers = lake.tag("reach", "greatest(x(sim.gripper))[1];", processes=1)
    assert lake.episodes["reach"].to_pylist() == answers["answer"].to_pylist()
    lake.tag(
        "near", "SELECT near(sim.gripper, sim.cup, 0.3) FROM [1];", "task = 'pick'", processes=1
    )
    again = ssduck.lake(folder)
    assert again._entries == lake._entries
    rows = again.episodes.select(["task", "grade", "near"]).to_pylist()
    assert rows[:3] == [{"task": "pick", "grade": 2, "near": rows[0]["near"]}] * 3
    assert isinstance(rows[0]["near"], bool)
    assert rows[3:] == [{"task": None, "grade": None, "near": None}] * (EPISODES - 3)
    assert ssduck.episodes(folder)[0].tags["grade"] == 2
    with pytest.raises(ArgumentError, match="tag"):
        lake.tag("many", "[1, 2];", processes=1)
    with pytest.raises(ArgumentError, match="task"):
        lake.set_tags({"task": [1]})
    with pytest.raises(ArgumentError, match="there is no argument 'proceses'"):
        lake.tag("near", "1;", proceses=1)


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("", "give a condition"),
        ("taks = 1", "no column or tag taks"),
        ("1 = 1) OR (1 = 1", "is no condition"),
        ("1 = 1; DROP TABLE episodes", "is no condition"),
        ("episode IN (SELECT 1)", "has a query"),
        ("oops(episode) = 1", "is no condition"),
        ("episodes.episode = 1", "no column or tag"),
        ("sum(episode) > 1", "is no condition"),
        ("episode = 'one'", "is no condition"),
        ("episode = ?", "is no condition"),
    ],
)
def test_conditions_are_expressions_only(recorded, where, message):
    with pytest.raises(ArgumentError, match=message.replace("(", r"\(")):
        ssduck.lake(recorded).select(where)


@pytest.mark.parametrize(
    ("where", "count"),
    [
        ("NOT success AND ticks BETWEEN 1 AND 100", EPISODES),
        ("list_contains(entities, 'cup') AND world LIKE 's%'", EPISODES),
        ("Episode IN (1, 3) OR abs(-episode) = 0", 3),
        ("lower(upper(world)) = 'sim' AND starts_with(world, 's')", EPISODES),
        ('"return" IS NULL', 0),
        ("-episode * 2 + 1 >= -1", 2),
        ("/* none */ episode = 9", 0),
        ("len(regexp_extract(world, 's(.*)', 1)) = 2 AND episode % 2 = 0", 3),
    ],
)
def test_conditions(recorded, where, count):
    assert ssduck.lake(recorded).select(where).num_rows == count


# -- DuckDB files --------------------------------------------------------------------------------

IN_FILE = "count(SELECT id FROM two{} AS list);"


def record_file(file, scene, duration):
    file.unlink(missing_ok=True)
    with ssduck.load(scene, database=file) as ss:
        ss.run(duration)


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path) / "two.toml"


@pytest.fixture
def file(tmp_path, scene):
    (tmp_path / "lake").mkdir()
    record_file(tmp_path / "lake/a.duckdb", scene, 0.02)
    record_file(tmp_path / "lake/b.duckdb", scene, 0.03)
    return tmp_path / "lake/b.duckdb"


def ask_file(lake):
    return [(row["answer"], row["error"]) for row in lake.ask(IN_FILE, processes=1).to_pylist()]


def test_the_manifest_has_size_and_checksum(file):
    lake = ssduck.lake(file.parent)
    for entry in lake.entries:
        (own,) = entry.files
        content = (file.parent / own.name).read_bytes()
        assert (own.size, own.checksum) == (len(content), zlib.crc32(content))
    sizes = [(file.parent / name).stat().st_size for name in ("a.duckdb", "b.duckdb")]
    assert lake.episodes["size"].to_pylist() == sizes


@pytest.mark.slow
def test_a_damaged_file_is_one_error(file):
    lake = ssduck.lake(file.parent)
    answers = ask_file(lake)
    assert [error for _, error in answers] == [None, None]
    status, content = file.stat(), bytearray(file.read_bytes())
    content[-1] ^= 1  # in no block that is read
    file.write_bytes(content)
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))
    workers._checksum.cache_clear()  # as in another process
    for damaged in (lake, ssduck.lake(file.parent)):
        kept, (answer, error) = ask_file(damaged)
        assert kept == answers[0]
        assert answer is None
        assert f"{file} is damaged" in error


@pytest.mark.slow
def test_a_file_that_was_written_since_is_read_as_it_is(file, scene):
    lake = ssduck.lake(file.parent)
    (kept, _), (before, _) = ask_file(lake)
    record_file(file, scene, 0.05)
    (same, _), (after, error) = ask_file(lake)
    assert (same, error) == (kept, None)
    assert after > before
