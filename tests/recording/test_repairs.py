"""What a check repairs, and what is written through no link."""

import shutil
from pathlib import Path

import pytest

import ssduck
from ssduck.errors import RecordError
from ssduck.interchange.conversion import write_runs
from ssduck.recording import folder_check
from ssduck.recording.folder_episodes import runs_in
from ssduck.recording.stores.files import write_atomically
from tests.support.forged import part


@pytest.fixture
def record(small_records, tmp_path):
    return Path(shutil.copytree(small_records / "folder", tmp_path / "record"))


@pytest.mark.filterwarnings("ignore")
def test_nothing_is_written_through_links_with_the_names_of_unfinished_files(
    record, small_records, tmp_path
):
    outside = tmp_path / "mine"
    part(record, "ticks").write_bytes(b"torn")
    outside.write_text("mine")
    names = [record / "a.mcap", *(file for file in record.rglob("*") if file.is_file())]
    for file in names:
        file.with_name(f".{file.name}.unfinished").symlink_to(outside)
    ssduck.check(record, repair=True)
    ssduck.lake(record).set_tags({"mine": 1})
    assert outside.read_text() == "mine"
    run = runs_in(small_records / "folder")[0]
    pytest.importorskip("foxglove_schemas_protobuf", reason="the extra mcap is not installed")
    write_runs([run], record / "a.mcap", "mcap")
    assert outside.read_text() == "mine"
    assert (record / "a.mcap").is_file()


def test_a_repair_that_cannot_write_is_an_error_of_the_record(record, monkeypatch):
    part(record, "ticks").write_bytes(b"torn")

    def fails(file):
        raise OSError(27, "File too large")

    monkeypatch.setattr(folder_check, "set_aside", fails)
    with pytest.raises(RecordError, match=f"{record} cannot be repaired: File too large"):
        ssduck.check(record, repair=True)


def test_a_link_to_nothing_is_set_aside(record):
    (record / "gym").mkdir()
    (record / "gym/lab-0.json").symlink_to(record / "nothing")
    (damage,) = ssduck.check(record, repair=True)
    assert damage.is_repaired
    assert not (record / "gym/lab-0.json").is_symlink()
    assert not ssduck.check(record)


def test_what_is_no_record_is_said_as_before(tmp_path):
    with pytest.raises(RecordError, match=f"^{tmp_path} is no record of ssduck"):
        ssduck.check(tmp_path)


def test_ctrl_c_leaves_no_unfinished_file(tmp_path):
    def write(place):
        place.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "a.json", write)
    assert not list(tmp_path.iterdir())
