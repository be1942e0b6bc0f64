"""DuckDB files in a lake: the manifest has their sizes and checksums, which are compared."""

import os
import zlib

import pytest

import ssduck
from ssduck.lakes import workers
from tests.support.command_line import write_scene

PROGRAM = "count(SELECT id FROM two{} AS list);"


def record(file, scene, duration):
    file.unlink(missing_ok=True)
    with ssduck.load(scene, database=file) as ss:
        ss.run(duration)


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path) / "two.toml"


@pytest.fixture
def file(tmp_path, scene):
    (tmp_path / "lake").mkdir()
    record(tmp_path / "lake/a.duckdb", scene, 0.02)
    record(tmp_path / "lake/b.duckdb", scene, 0.03)
    return tmp_path / "lake/b.duckdb"


def ask(lake):
    return [(row["answer"], row["error"]) for row in lake.ask(PROGRAM, processes=1).to_pylist()]


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
    answers = ask(lake)
    assert [error for _, error in answers] == [None, None]
    status, content = file.stat(), bytearray(file.read_bytes())
    content[-1] ^= 1  # in no block that is read
    file.write_bytes(content)
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))
    workers._checksum.cache_clear()  # as in another process
    for damaged in (lake, ssduck.lake(file.parent)):
        kept, (answer, error) = ask(damaged)
        assert kept == answers[0]
        assert answer is None
        assert f"{file} is damaged" in error


@pytest.mark.slow
def test_a_file_that_was_written_since_is_read_as_it_is(file, scene):
    lake = ssduck.lake(file.parent)
    (kept, _), (before, _) = ask(lake)
    record(file, scene, 0.05)
    (same, _), (after, error) = ask(lake)
    assert (same, error) == (kept, None)
    assert after > before
