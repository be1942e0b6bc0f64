"""Symbolic links in a record from a stranger: a check names them, and a repair renames nothing."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import ssduck
from tests.support.forged import EPISODE, describe, make_records, part

EPISODES = "episodes/lab-0.json"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("linked")
    make_records(place)
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
