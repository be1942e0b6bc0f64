"""A lake in an object store: a local S3 server, on the loopback."""

import json

import pytest

import ssduck
from ssduck.errors import RecordError
from ssduck.lakes.lake import MANIFEST
from ssduck.recording.stores.object_store import ObjectPath
from tests.lakes.conftest import EPISODES
from tests.support.cases import generated
from tests.support.lake_episodes import REWARD, SUCCESS
from tests.support.lake_questions import PROGRAMS, answer_of, by_itself, tags_by_two_lakes
from tests.support.s3_server import s3_server

pytest.importorskip("moto.server", reason="moto, a local S3 server, is missing")
pytest.importorskip("fsspec", reason="the extra s3 is not installed")


@pytest.fixture(scope="module")
def address(recorded):
    with s3_server("runs"):
        place = ObjectPath("s3://runs/of today/record")
        for file in recorded.rglob("*"):
            if file.is_file() and not file.name.startswith(MANIFEST):
                (place / file.relative_to(recorded).as_posix()).write_bytes(file.read_bytes())
        yield "s3://runs/of today"


@pytest.mark.slow
def test_the_same_answers(address, recorded, monkeypatch):
    local, remote = ssduck.lake(recorded), ssduck.lake(address)
    assert remote.episodes["path"].to_pylist() == [f"{address}/record"] * EPISODES
    for name in ("id", "ticks", "entities", "return", "size", "error"):
        assert remote.episodes[name].equals(local.episodes[name])
    with monkeypatch.context() as patch:
        patch.setattr("ssduck.lakes.workers.answer_by_itself", None)  # all are asked together
        for name in ("last tick", "least clearance"):
            wanted = local.ask(PROGRAMS[name], processes=1)
            assert remote.ask(PROGRAMS[name], processes=1)["answer"].equals(wanted["answer"])
    score = remote.score(SUCCESS, reward=REWARD, processes=1)
    assert score["return"].equals(local.score(SUCCESS, reward=REWARD, processes=1)["return"])


@pytest.mark.slow
def test_the_manifest_is_there_and_tags_are_written(address, monkeypatch):
    lake = ssduck.lake(address)
    assert lake.manifest == ObjectPath(f"{address}/{MANIFEST}.parquet")
    assert lake.manifest.is_file()
    assert lake.set_tags({"task": "pick"}, "episode = 1") == 1
    monkeypatch.setattr("ssduck.lakes.scan._described", None)  # nothing is read anew
    again = ssduck.lake(address)
    assert again._entries == lake._entries
    assert again.select("task = 'pick'")["episode"].to_pylist() == [1]


@pytest.mark.slow
def test_tags_of_two_lakes_are_kept(address):
    assert tags_by_two_lakes(address) == [(1, 2), (1, 2)]


@pytest.mark.slow
def test_a_closed_episode_has_a_summary_in_the_store(address, recorded, monkeypatch):
    place = "s3://runs/closed"
    with ssduck.open(recorded, "sim", 1) as ss:
        ss.export(place)
    monkeypatch.setattr("ssduck.lakes.scan._computed", None)  # its files are not read
    (entry,) = ssduck.lake(place).entries
    assert entry.error is None
    assert entry.ticks == ssduck.lake(recorded).entries[1].ticks


def test_nothing_there(address):
    with pytest.raises(RecordError, match="there is no record"):
        ssduck.lake("s3://runs/of tomorrow")


# Names that are patterns, or parts of a URL, beside names that they would match or leave.
NAMES = ["rec[12]", "rec1", "rec*", "rec?", "rec#1", "rec", "rec%31", "rec[!a]\\b"][: generated(3)]
ASKED = [
    "SELECT tick, x(this) FROM sim{} WHERE id(this) == 'gripper' AS list;",
    "least(clearance(sim.gripper, sim.cup));",
]


@pytest.mark.long
def test_names_that_are_patterns_are_names(address, recorded, monkeypatch):
    """Each record has another episode, so that reading another record is seen."""
    wanted = {}
    for number, name in enumerate(NAMES):
        episode = number % EPISODES
        with ssduck.open(recorded, "sim", episode) as ss:
            ss.export(f"s3://runs/names/{name}")
        wanted[f"s3://runs/names/{name}"] = [by_itself(recorded, episode, one) for one in ASKED]
    assert wanted["s3://runs/names/rec[12]"] != wanted["s3://runs/names/rec1"]
    for place, answers in wanted.items():
        with ssduck.open(place) as ss:
            assert [answer_of(ss, program) for program in ASKED] == answers
    lake = ssduck.lake("s3://runs/names")
    for index, program in enumerate(ASKED):
        if index:  # all are asked together
            monkeypatch.setattr("ssduck.lakes.workers.answer_by_itself", None)
        rows = lake.ask(program, processes=1).to_pylist()
        found = {row["path"]: (row["answer"], row["error"]) for row in rows}
        texts = {place: answers[index] for place, answers in wanted.items()}
        assert found == {place: (json.loads(t), e) for place, (t, e) in texts.items()}


@pytest.mark.long
def test_records_below_a_record(address, recorded):
    for number, name in enumerate(("outer", "outer/night")):
        with ssduck.open(recorded, "sim", number) as ss:
            ss.export(f"s3://runs/nested/{name}")
    lake = ssduck.lake("s3://runs/nested")
    assert lake.episodes["path"].to_pylist() == [
        f"s3://runs/nested/{name}" for name in ("outer", "outer/night")
    ]
    for entry in lake.entries:
        assert not any(file.name.startswith("night/") for file in entry.files)
    program = PROGRAMS["last tick"]
    answers = lake.ask(program, processes=1)["answer"].to_pylist()
    assert answers == [by_itself(recorded, number, program)[0] for number in range(2)]


@pytest.mark.long
def test_an_address_with_a_pattern_lists_no_others(address, recorded, monkeypatch):
    from fsspec.implementations.arrow import ArrowFSWrapper

    with ssduck.open(recorded, "sim", 0) as ss:
        ss.export("s3://runs/alone/rec[1]")
    monkeypatch.setattr(ArrowFSWrapper, "glob", None)
    with ssduck.open("s3://runs/alone/rec[1]") as ss:
        assert ss.sql("SELECT count(*) FROM entities_history").fetchone()[0] > 0


@pytest.mark.slow
def test_a_sandbox_opens_what_was_fetched(address, recorded):
    limits = ssduck.Limits.strict(progress=False)
    with ssduck.open(f"{address}/record", episode=1, limits=limits) as sealed:
        world = sealed.worlds[0].name
        found = sealed.eval(f"SELECT id, x, z FROM {world};")
    with ssduck.open(recorded, episode=1) as own:
        assert found == own.eval(f"SELECT id, x, z FROM {world};") != []
    with pytest.raises(RecordError, match="nothing here"):
        ssduck.open(f"{address}/nothing here", limits=limits)
