"""An episode's beginning and its opening look at few of the others."""

import json
from itertools import islice
from pathlib import Path

import duckdb
import pytest

import ssduck
from ssduck import Recording
from ssduck.database import schemas
from ssduck.database.schemas import drop_statements
from ssduck.errors import RecordError
from ssduck.recording.stores.descriptions import read_description
from ssduck.recording.stores.parquet_layout import FolderRun
from ssduck.schema import TABLES

EPISODES = 100


class Looks:
    """Counts the files of `episodes` that are looked at, and the runs that are asked for ticks."""

    def __init__(self, monkeypatch):
        self.files = []
        self.runs = []
        stat, has_ticks = Path.stat, FolderRun.has_ticks.fget
        assert has_ticks is not None

        def counted(own, **options):
            if own.parent.name == "episodes":
                self.files.append(own.name)
            return stat(own, **options)

        def asked(own):
            self.runs.append(own.number)
            return has_ticks(own)

        monkeypatch.setattr(Path, "stat", counted)
        monkeypatch.setattr(FolderRun, "has_ticks", property(asked))


def _record(run, client):
    world = ssduck.World.attach(client, name="lab")
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("lab", world)
        ss.record_to(run, recording=Recording(tables=("entities",))).close()


@pytest.fixture
def run(tmp_path, client):
    """A folder with an episode, and the descriptions of many more."""
    place = tmp_path / "run"
    _record(place, client)
    about = read_description(place / "episodes" / "lab-0.json")
    for number in range(1, EPISODES):
        text = json.dumps(about | {"episode": number})
        (place / "episodes" / f"lab-{number}.json").write_text(text)
    return place


@pytest.mark.slow
def test_an_episode_begins_after_a_few_looks(run, client, monkeypatch):
    looks = Looks(monkeypatch)
    _record(run, client)
    assert (run / "episodes" / f"lab-{EPISODES}.json").is_file()
    assert 1 < len([name for name in set(looks.files) if name != f"lab-{EPISODES}.json"]) < 16
    _record(run, client)
    with ssduck.open(run) as ss:
        assert ss.past("lab").ticks == [1]
    assert [e.number for e in ssduck.episodes(run)] == list(range(EPISODES + 2))


@pytest.mark.slow
@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 7, 8, 9])
def test_the_next_number(tmp_path, client, count):
    for _ in range(count + 1):
        _record(tmp_path / "run", client)
    assert [e.number for e in ssduck.episodes(tmp_path / "run")] == list(range(count + 1))


def test_the_last_episode_is_opened_at_once(run, client, monkeypatch):
    _record(run, client)
    looks = Looks(monkeypatch)
    ssduck.open(run).close()
    assert looks.runs == [EPISODES]
    assert set(looks.files) <= {f"lab-{EPISODES}.json"}
    looks.runs.clear()
    ssduck.open(run, episode=0).close()
    assert looks.runs == [0]
    with pytest.raises(
        RecordError, match="no episode 5 has ticks; episodes with ticks: 0 of 'lab'"
    ):
        ssduck.open(run, episode=5)


def _begin(path, client):
    with ssduck.Interpreter(str(path)) as ss:
        ss.add_variable("lab", ssduck.World.attach(client))


@pytest.mark.slow
def test_the_last_episode_of_a_file_is_opened_at_once(tmp_path, client, monkeypatch):
    path = tmp_path / "run.duckdb"
    for _ in range(4):
        _begin(path, client)
    from ssduck.interpreter import archives

    read = []
    description = archives._description

    def counted(path, schema, texts):
        read.append(schema)
        return description(path, schema, texts)

    monkeypatch.setattr(archives, "_description", counted)
    with ssduck.open(path) as ss:
        assert ss.past("lab").ticks == [1]
    assert set(read) == {"lab_record_3"}
    assert [e.number for e in ssduck.episodes(path)] == [0, 1, 2, 3]


@pytest.mark.slow
@pytest.mark.parametrize("dropped", [0, 1, 3])
def test_views_on_the_worlds_of_a_killed_process_are_dropped(
    tmp_path, client, monkeypatch, dropped
):
    path = tmp_path / "run.duckdb"
    with monkeypatch.context() as killed:
        killed.setattr(
            schemas, "drop_statements", lambda *a, **o: islice(drop_statements(*a, **o), dropped)
        )
        _begin(path, client)
    names = "SELECT view_name FROM duckdb_views() WHERE schema_name = 'lab'"
    with duckdb.connect(str(path)) as plain:
        assert {name for (name,) in plain.execute(names).fetchall()} & set(TABLES)
    ssduck.Interpreter(str(path)).close()
    with duckdb.connect(str(path)) as plain:
        left = {name for (name,) in plain.execute(names).fetchall()}
        assert left >= {"entities_history", "links_history"}
        assert not left & set(TABLES)
        assert plain.execute("SELECT tick FROM lab.ticks_history").fetchall() == [(1,)]
