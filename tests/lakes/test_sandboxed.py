"""A lake of records from elsewhere is asked in a sandbox."""

import pytest

import ssduck
from ssduck.errors import UnsupportedError

STRICT = ssduck.Limits.strict(seconds=5)


@pytest.fixture(scope="module")
def lakes(recorded):
    """The lake in this process, and in a sandbox."""
    with ssduck.lake(recorded, limits=STRICT) as sandboxed:
        yield ssduck.lake(recorded), sandboxed


def test_its_answers_are_those_of_this_process(lakes):
    here, there = lakes
    names = ["world", "episode", "ticks", "start", "end"]
    assert there.episodes.select(names).equals(here.episodes.select(names))
    program, where = "x(sim.gripper) > 0.0;", "episode < 3"
    assert there.ask(program).equals(here.ask(program))
    assert there.ask(program, where).equals(here.ask(program, where))
    assert here.ask(program, limits=STRICT).equals(here.ask(program))
    terms = {"success": "x(sim.gripper) > 0.01", "reward": "x(sim.gripper)"}
    assert there.score(**terms).equals(here.score(**terms))
    assert there.sql(program) == here.sql(program)


def test_an_error_is_that_of_its_episode(lakes):
    with pytest.warns(ssduck.ProgramWarning, match="no answer"):
        errors = lakes[1].ask("x(sim.griper);")["error"].to_pylist()
    assert all("did you mean 'gripper'" in error for error in errors)


def test_what_leads_out_of_its_folder_is_not_read(folder, tmp_path):
    (tmp_path / "outside").mkdir()
    for number, file in enumerate(sorted(folder.rglob("*.parquet"))):
        file.rename(tmp_path / "outside" / str(number))
        file.symlink_to(tmp_path / "outside" / str(number))
    with (
        pytest.warns(ssduck.ProgramWarning, match="no answer: 5 episodes failed"),
        ssduck.lake(folder, limits=STRICT) as lake,
    ):
        assert lake.ask("1;")["error"].null_count == 0


def test_nothing_is_written_into_its_folder(folder):
    before = {file: file.stat().st_mtime_ns for file in folder.rglob("*")}
    with ssduck.lake(folder, limits=STRICT) as lake:
        lake.ask("1;")
    assert {file: file.stat().st_mtime_ns for file in folder.rglob("*")} == before


def test_what_it_cannot_do_is_told(lakes, folder):
    with pytest.raises(UnsupportedError, match="processes: one process of a sandbox answers"):
        lakes[1].ask("1;", processes=4)
    with pytest.raises(UnsupportedError, match="tag: limits"):
        lakes[0].tag("done", "True;", limits=STRICT)
    with pytest.raises(UnsupportedError, match="is no folder or file"):
        ssduck.lake(folder / "*", limits=STRICT)
