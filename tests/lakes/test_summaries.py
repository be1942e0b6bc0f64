"""Summaries of closed episodes: the manifest is made of them, and they change no answer."""

import json
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pybullet
import pytest

import ssduck
from ssduck.recording.stores.files import json_text
from tests.lakes.conftest import EPISODES
from tests.support.forged import flip_bit
from tests.support.lake_questions import PROGRAMS

QUESTION = PROGRAMS["last tick"]
SUMMARY = "index/world=sim/episode={}/summary.json"


@pytest.fixture
def computed(monkeypatch):
    """The episodes whose summaries are computed from all files."""
    from ssduck.lakes import scan

    numbers = []
    compute = scan._computed
    monkeypatch.setattr(
        scan, "_computed", lambda run, *rest: numbers.append(run.number) or compute(run, *rest)
    )
    return numbers


def entries(folder):
    """The entries of a lake, without the files of the summaries."""
    return [
        replace(e, files=tuple(f for f in e.files if not f.name.endswith("summary.json")))
        for e in ssduck.lake(folder).entries
    ]


def without_summaries(folder):
    for file in folder.rglob("summary.json"):
        file.unlink()
    return entries(folder)


def edited(**values):
    """Changes the second summary, whose checksum is right."""

    def change(file):
        file.write_text(json_text(json.loads(file.read_text()) | values))

    return change


def other(file):
    shutil.copy(str(file).replace("episode=1", "episode=2"), file)


def with_file(file):
    content = json.loads(file.read_text())
    content["files"]["/etc/passwd"] = [1, 1, 1]
    file.write_text(json_text(content))


# What is wrong with a summary, which is not used then.
WRONG = {
    "missing": lambda file: file.unlink(),
    "empty": lambda file: file.write_bytes(b""),
    "truncated": lambda file: file.write_bytes(file.read_bytes()[:-200]),
    "flipped": flip_bit,
    "of another episode": other,
    "of another key": edited(key="0" * 16),
    "no files": edited(files={}),
    "a further file": with_file,
    "files of another kind": edited(files={"ticks": [1, 2]}),
    "no text": edited(group=1),
    "infinite": edited(end=float("inf")),
    "no ticks": edited(ticks=0),
    "too many ticks": edited(ticks=1 << 70),
    "names of another kind": edited(entities=[1]),
}


def test_the_manifest_of_closed_episodes_is_made_of_summaries(folder, computed):
    quick = entries(folder)
    assert computed == []
    (folder / "ssduck-manifest.parquet").unlink()
    assert without_summaries(folder) == quick
    assert computed == list(range(EPISODES))


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_summary_is_not_used(folder, recorded, computed, wrong):
    (folder / "ssduck-manifest.parquet").unlink(missing_ok=True)
    WRONG[wrong](folder / SUMMARY.format(1))
    found = entries(folder)
    assert computed == [1]
    assert [replace(e, path="") for e in found] == [
        replace(e, path="", files=f.files) for e, f in zip(entries(recorded), found, strict=True)
    ]
    own = {file.name: file.checksum for file in found[1].files}
    assert own == {f.name: f.checksum for f in entries(recorded)[1].files}


FORGERIES = {
    "ticks": {"ticks": 3, "last_tick": 2},
    "times": {"start": -1.0, "end": 99.0},
    "group": {"group": "forged"},
    "no group": {"group": None},
    "entities": {"entities": ["nothing"]},
}


@pytest.mark.slow
@pytest.mark.parametrize("forgery", FORGERIES)
def test_a_forged_summary_changes_no_answer(folder, recorded, forgery):
    wanted = ssduck.lake(recorded).ask(QUESTION, processes=1)["answer"].to_pylist()
    for number in (1, 3):
        edited(**FORGERIES[forgery])(folder / SUMMARY.format(number))
    rows = ssduck.lake(folder).ask(QUESTION, processes=1)
    assert rows["answer"].to_pylist() == wanted
    assert rows["error"].null_count == EPISODES


@pytest.mark.parametrize("keeps_time", [False, True], ids=["a new time", "the same time"])
def test_a_part_that_changed_after_its_summary_is_noticed(folder, keeps_time):
    part = folder / "entities/world=sim/episode=1/part-000000.parquet"
    times = part.stat()
    flip_bit(part)
    if keeps_time:
        os.utime(part, ns=(times.st_atime_ns, times.st_mtime_ns))
    rows = ssduck.lake(folder).ask(QUESTION, processes=1).to_pylist()
    assert [row["episode"] for row in rows if row["error"]] == [1]
    assert "its checksum is wrong" in rows[1]["error"]


def test_a_copy_with_other_times_is_read_anew(recorded, tmp_path, computed):
    shutil.copytree(recorded, tmp_path / "copy", copy_function=shutil.copyfile)
    for file in (tmp_path / "copy").rglob("*.parquet"):
        os.utime(file, (1, 1))
    assert len(entries(tmp_path / "copy")) == EPISODES
    assert computed == list(range(EPISODES))


@pytest.mark.slow
def test_tags_and_further_files_leave_a_summary_right(folder, computed):
    (folder / "ssduck-manifest.parquet").unlink(missing_ok=True)
    with ssduck.open(folder, "sim", 1) as ss:
        ss.export(folder, tags={"task": "pick"})
    lake = ssduck.lake(folder)
    assert lake.set_tags({"seen": True}) == EPISODES + 1
    (folder / "ssduck-manifest.parquet").unlink()
    assert entries(folder)[-1].tags["task"] == "pick"
    assert all(entry.tags["seen"] for entry in entries(folder))
    assert computed == []


@pytest.mark.slow
def test_several_recorders_at_once_and_one_that_is_not_closed(tmp_path, computed):
    def run():
        client = pybullet.connect(pybullet.DIRECT)
        world = ssduck.World.attach(client, name="lab")
        with ssduck.Interpreter(recording=None) as ss:
            ss.add_variable("lab", world)
            with ss.record_to(tmp_path / "together") as recording:
                world.step(5)
                recording.flush()
                world.step(3)
        pybullet.disconnect(client)

    with ThreadPoolExecutor(3) as pool:
        for recorder in [pool.submit(run) for _ in range(3)]:
            recorder.result()
    assert [e.ticks for e in entries(tmp_path)] == [9] * 3
    assert computed == []
    file = tmp_path / "together/episodes/lab-1.json"
    content = json.loads(file.read_text())
    del content["parts"]
    file.write_text(json_text(content))
    (tmp_path / "together/index/world=lab/episode=1/summary.json").unlink()
    assert [e.complete for e in entries(tmp_path)] == [True, False, True]
    assert computed == [1]
