"""DuckDB files that are damaged, in use or closed to the user: the error says which it is."""

import os
import shutil
import subprocess
import sys

import pytest

import ssduck
from ssduck.errors import RecordError, SqlError
from tests.support.cases import sampled
from tests.support.command_line import ssduck_
from tests.support.recorded import nobody

HEADER = 12_288


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, archive):
    """A DuckDB file with two episodes."""
    return archive.copy(write_two_episodes, tmp_path_factory.mktemp("recorded")) / "run.duckdb"


def write_two_episodes(folder):
    with ssduck.load("kitchen", folder / "run.duckdb") as ss:
        ss["kitchen"].step()
        ss.record("kitchen", ssduck.Recording())
        ss["kitchen"].step()


@pytest.fixture
def file(recorded, tmp_path):
    return shutil.copy(recorded, tmp_path / "run.duckdb")


DOORS = {
    "open": ssduck.open,
    "an episode": lambda file: ssduck.open(file, episode=0),
    "partial": lambda file: ssduck.open(file, partial=True),
    "strict": lambda file: ssduck.open(file, limits=ssduck.Limits.strict()),
    "episodes": ssduck.episodes,
    "check": ssduck.check,
    "repair": lambda file: ssduck.check(file, repair=True),
}


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has other permissions")
@sampled("door", DOORS, every=4)
@pytest.mark.parametrize("ending", ["", ".wal"])
def test_a_file_without_permission(file, door, ending):
    ssduck.check(file)  # imports what another user may not read
    for folder in file.parents:
        if folder.stat().st_uid == os.getuid() and not folder.stat().st_mode & 1:
            folder.chmod(0o711)
    closed = file.with_name(file.name + ending)
    closed.touch()
    closed.chmod(0)
    before = sorted(file.parent.iterdir())
    told = f'"{closed}": Permission denied'
    with nobody(), pytest.raises(RecordError, match=told) as caught:
        DOORS[door](file)
    assert isinstance(caught.value, PermissionError)
    assert str(caught.value).startswith(f"{file} cannot be opened")
    assert sorted(file.parent.iterdir()) == before


def flipped(file):
    """Flips a bit in each block, and checks that DuckDB sees it."""
    content = bytearray(file.read_bytes())
    for place in range(HEADER + 100, len(content), 4096):
        content[place] ^= 1
    file.write_bytes(content)
    return file


def test_a_file_that_cannot_be_opened(file):
    """No check tells more of it, and it is not in use: a block is no lock."""
    flipped(file)
    told = "nothing of it can be read: put a copy back"
    for door in ("check", "repair"):
        with pytest.raises(RecordError, match=told) as caught:
            DOORS[door](file)
        assert str(caught.value).startswith(f"{file} is damaged")
        assert "ssduck check" not in str(caught.value)
    done = ssduck_("check", "--repair", str(file))
    assert done.exit_code == 1
    assert told in done.stderr
    with pytest.raises(SqlError, match=r"is damaged.*block.*`ssduck check`") as caught:
        ssduck.load("kitchen", file)
    assert "in use" not in str(caught.value)


USES = (
    "import ssduck, sys; ss = ssduck.load('kitchen', sys.argv[1]); print('on', flush=True); input()"
)


@pytest.mark.slow
@sampled("door", DOORS, every=7)
def test_a_file_in_use(door, recorded, tmp_path):
    """Its log stays where it is, though the path says that it is damaged."""
    (tmp_path / "damaged").mkdir()
    file = shutil.copy(recorded, tmp_path / "damaged" / "run.duckdb")
    with subprocess.Popen(
        [sys.executable, "-c", USES, str(file)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout.readline() == "on\n"
        log = file.with_name("run.duckdb.wal")
        assert log.exists()
        told = rf"in use by another process \(PID {process.pid}\).*write to a folder"
        with pytest.raises(RecordError, match=told):
            DOORS[door](file)
        with pytest.raises(SqlError, match="in use by another process"):
            ssduck.Interpreter(file)
        assert sorted(file.parent.iterdir()) == [file, log]
        process.communicate("\n")
    assert ssduck.check(file) == []
    assert len(ssduck.episodes(file)) == 3
