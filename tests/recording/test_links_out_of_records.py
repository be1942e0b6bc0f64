"""Symbolic links in a record from a stranger: a check names them, and a repair renames nothing."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pybullet
import pytest

import ssduck
from ssduck.errors import RecordError
from ssduck.interchange.conversion import write_runs
from ssduck.interchange.macros import COLUMNS, write_pairs
from ssduck.recording import episode_steps, folder_check
from ssduck.recording.episode_steps import EpisodeSteps
from ssduck.recording.folder_episodes import runs_in
from ssduck.recording.stores import descriptions
from ssduck.recording.stores.atomic_files import write_atomically
from ssduck.recording.stores.parquet_layout import FolderRun
from tests.support.archive import Archive
from tests.support.forged import EPISODE, describe, make_records, part

EPISODES = "episodes/lab-0.json"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, archive: Archive) -> Path:
    place = tmp_path_factory.mktemp("linked")
    archive.copy(make_records, place)
    return place


def linked(made: Path, kind: str, to: Path, place: str) -> tuple[Path, Path]:
    """Returns a record with a link in a place, and the other record that it leads to."""
    record, other = (
        Path(shutil.copytree(made / kind, to / name)) for name in ("record", "another")
    )
    if (record / place).is_dir():
        shutil.rmtree(record / place)
    else:
        (record / place).unlink()
    (record / place).symlink_to(other / place)
    return record, other


def contents(record: Path) -> dict[str, bytes]:
    files = (file for file in record.rglob("*") if file.is_file())
    return {str(file.relative_to(record)): file.read_bytes() for file in files}


@pytest.mark.parametrize("harm", ["another key", "a broken part", "nothing else"])
@pytest.mark.parametrize(
    "place", ["entities", "ticks/world=lab", f"joints/{EPISODE}", f"models/links/{EPISODE}"]
)
def test_a_repair_renames_nothing_outside(
    made: Path, tmp_path: Path, place: str, harm: str
) -> None:
    record, other = linked(made, "folder", tmp_path, place)
    if harm == "another key":
        describe(record / EPISODES, key="0" * 16)
    elif harm == "a broken part":
        part(record, "contacts").write_bytes(b"broken")
    before = contents(other), contents(record)
    for repair in (False, True):
        (damage,) = ssduck.check(record, repair=repair)
        assert damage.file.is_relative_to(record / place)
        assert damage.problem.startswith(f"is a symbolic link that leaves {record}")
        assert not damage.is_repaired
    assert (contents(other), contents(record)) == before


def test_nor_files_of_a_log(made: Path, tmp_path: Path) -> None:
    record, other = linked(made, "unfinished", tmp_path, "log")
    describe(record / EPISODES, key="0" * 16)
    before = contents(other)
    (damage,) = ssduck.check(record, repair=True)
    assert (damage.file, damage.is_repaired) == (record / "log" / EPISODE, False)
    assert contents(other) == before


def test_a_part_that_is_a_link_is_taken_out(made: Path, tmp_path: Path) -> None:
    """Its own name is in the record, and what it leads to is not."""
    file = f"joints/{EPISODE}/part-000000.parquet"
    record, other = linked(made, "folder", tmp_path, file)
    before = contents(other)
    (damage,) = ssduck.check(record)
    assert (damage.file, damage.is_repaired) == (record / file, False)
    assert "is a symbolic link" in damage.problem
    (damage,) = ssduck.check(record, repair=True)
    assert damage.is_repaired
    assert (record / f"{file}.damaged").is_symlink()
    assert contents(other) == before


def test_a_link_within_the_record_is_none(made: Path, tmp_path: Path) -> None:
    record = Path(shutil.copytree(made / "folder", tmp_path / "record"))
    (record / "joints").rename(record / "elsewhere")
    (record / "joints").symlink_to(record / "elsewhere")
    assert ssduck.check(record, repair=True) == []


# -- writing to a stranger's record ---------------------------------------------------------------


def _export(made: Path, record: Path) -> None:
    with ssduck.open(made / "folder") as ss:
        ss.export(record)


def _record(_: Path, record: Path) -> None:
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.createMultiBody(1, physicsClientId=client)
    with ssduck.Interpreter() as ss:
        ss.add_variable("lab", ssduck.World.attach(client))
        with ss.record_to(record):
            pass


def _write(_: Path, record: Path) -> None:
    shapes = {"cup": {"box": [0.1] * 3}}
    ssduck.write_record(record, shapes, np.zeros((1, 1, 3)), np.zeros(1), world="lab")


@pytest.mark.parametrize("write", [_export, _record, _write])
@pytest.mark.parametrize(
    "place",
    [
        "ssduck.json", "episodes", "entities", "entities/world=lab", "entities/world=lab/episode=1",
        "ticks", "models", "models/links/world=lab", "log", "index", "episodes/lab-1.json",
    ],
)  # fmt: skip
def test_nothing_is_written_through_a_link(
    made: Path, tmp_path: Path, place: str, write: Callable[[Path, Path], None]
) -> None:
    record, outside = Path(shutil.copytree(made / "folder", tmp_path / "record")), tmp_path / "out"
    if (record / place).exists():
        (record / place).rename(outside)
    elif "." not in place:
        outside.mkdir()
    (record / place).parent.mkdir(parents=True, exist_ok=True)
    (record / place).symlink_to(outside)
    before = everything(tmp_path)
    with pytest.raises(RecordError, match="is a symbolic link that leaves"):
        write(made, record)
    assert everything(tmp_path) == before


def everything(place: Path) -> dict[str, bytes]:
    """Returns the folders and files below a place, and what files have."""
    return {
        str(one.relative_to(place)): one.read_bytes() if one.is_file() else b""
        for one in place.rglob("*")
    }


def test_steps_and_pairs_are_not_either(made: Path, tmp_path: Path) -> None:
    record, steps = with_steps(made, tmp_path)
    outside = tmp_path / "outside"
    (record / episode_steps.FOLDER).rename(outside)
    (record / episode_steps.FOLDER).symlink_to(outside)
    (record / "pairs").symlink_to(outside)
    before = everything(tmp_path)
    with pytest.raises(RecordError, match="is a symbolic link that leaves"):
        steps.write(record, "lab", 0)
    with pytest.raises(RecordError, match="is a symbolic link that leaves"):
        write_pairs(FolderRun(record, "lab", 0), COLUMNS.empty_table(), 0.1)
    assert everything(tmp_path) == before


# -- the steps of episodes ------------------------------------------------------------------------

STEPS = f"{episode_steps.FOLDER}/lab-0.json"


def with_steps(made: Path, to: Path) -> tuple[Path, EpisodeSteps]:
    """Returns a record whose episode has steps, and these."""
    record = Path(shutil.copytree(made / "folder", to / "record"))
    steps = EpisodeSteps({"reward": "1"}, seed=7, options={"level": [1, None]}, success=False)
    steps.add_tick(1, 0.5, {"goal": [0.1, 2], "name": "left"})
    steps.add_tick(2, 0.75, {"goal": [0.1, 3], "name": "right"})
    steps.rewards.append(0.1)
    steps.add_action([1.0, -0.25])
    steps.write(record, "lab", 0)
    return record, steps


@pytest.mark.parametrize("place", [STEPS, episode_steps.FOLDER])
def test_no_steps_of_elsewhere_are_read(made: Path, tmp_path: Path, place: str) -> None:
    record, _ = with_steps(made, tmp_path)
    (record / place).rename(tmp_path / "outside")
    (record / place).symlink_to(tmp_path / "outside")
    with pytest.raises(RecordError, match="is a symbolic link that leaves"):
        EpisodeSteps.read(record, "lab", 0)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ('{"private": 1}', "is damaged.*the steps of the episode|'version' is to be a number"),
        ("not steps", "is damaged"),
        (" " * 2000 + "{}", "has more than 1,000 bytes"),
    ],
)
def test_no_other_file_is_read(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str, words: str
) -> None:
    record, _ = with_steps(made, tmp_path)
    (record / STEPS).write_text(content)
    if "1,000" in words:
        monkeypatch.setattr(descriptions, "MAX_DESCRIPTION", 1000)
    with pytest.raises(RecordError, match=words) as error:
        EpisodeSteps.read(record, "lab", 0)
    assert STEPS in str(error.value)


@pytest.mark.filterwarnings("ignore")
def test_nothing_is_written_through_links_with_the_names_of_unfinished_files(
    made: Path, tmp_path: Path
) -> None:
    record, outside = Path(shutil.copytree(made / "folder", tmp_path / "record")), tmp_path / "mine"
    part(record, "ticks").write_bytes(b"torn")
    outside.write_text("mine")
    names = [record / "a.mcap", *(file for file in record.rglob("*") if file.is_file())]
    for file in names:
        file.with_name(f".{file.name}.unfinished").symlink_to(outside)
    ssduck.check(record, repair=True)
    ssduck.lake(record).set_tags({"mine": 1})
    assert outside.read_text() == "mine"
    run = runs_in(made / "folder")[0]
    pytest.importorskip("foxglove_schemas_protobuf", reason="the extra mcap is not installed")
    write_runs([run], record / "a.mcap", "mcap")
    assert outside.read_text() == "mine"
    assert (record / "a.mcap").is_file()


def test_a_repair_that_cannot_write_is_an_error_of_the_record(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = Path(shutil.copytree(made / "folder", tmp_path / "record"))
    part(record, "ticks").write_bytes(b"torn")

    def fails(file: Path) -> None:
        raise OSError(27, "File too large")

    monkeypatch.setattr(folder_check, "set_aside", fails)
    with pytest.raises(RecordError, match=f"{record} cannot be repaired: File too large"):
        ssduck.check(record, repair=True)


def test_a_link_to_nothing_is_set_aside(made: Path, tmp_path: Path) -> None:
    record = Path(shutil.copytree(made / "folder", tmp_path / "record"))
    (record / "gym").mkdir()
    (record / "gym/lab-0.json").symlink_to(record / "nothing")
    (damage,) = ssduck.check(record, repair=True)
    assert damage.is_repaired
    assert not (record / "gym/lab-0.json").is_symlink()
    assert not ssduck.check(record)


def test_what_is_no_record_is_said_as_before(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=f"^{tmp_path} is no record of ssduck"):
        ssduck.check(tmp_path)


def test_ctrl_c_leaves_no_unfinished_file(tmp_path: Path) -> None:
    def write(place: Path) -> None:
        place.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "a.json", write)
    assert not list(tmp_path.iterdir())
