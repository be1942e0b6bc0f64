"""Sandboxes import nothing from the current folder, and are asked of lakes; processes end at once."""

import signal
import subprocess
import sys
import threading
import time

import pytest

import ssduck
from ssduck.errors import UnsupportedError
from tests.support.command_line import BOX
from tests.support.rising_cups import write_rising_cups

# What Python imports when a process starts, and what ssduck does.
MODULES = ("multiprocessing", "queue", "html", "json", "selectors", "base64", "ssduck")


@pytest.fixture
def foreign(tmp_path, monkeypatch):
    """The current folder: a record, and files with the names of modules."""
    folder = tmp_path / "foreign"
    write_rising_cups(folder / "record", 3, 4)
    for name in MODULES:
        mark = f"open({str(tmp_path / 'run')!r}, 'a').write({name!r})\n"
        (folder / f"{name}.py").write_text(mark)
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.slow
def test_a_sandbox_starts_no_file_of_the_folder(foreign):
    code = "import sys; sys.path.insert(0, ''); import queue"
    subprocess.run([sys.executable, "-c", code], check=False)
    assert (foreign.parent / "run").exists()  # as Python does by itself
    (foreign.parent / "run").unlink()
    with ssduck.open("record", limits=ssduck.Limits.strict()) as ss:
        assert ss.eval("1 + 2;") == 3
    assert not (foreign.parent / "run").exists()


@pytest.mark.slow
def test_the_trial_of_a_scene_starts_no_file_of_the_folder(foreign):
    for name in ("pybullet", "numpy", "pickle", "hashlib"):
        (foreign / f"{name}.py").write_text(f"open({str(foreign.parent / 'run')!r}, 'a')\n")
    (foreign / "box.urdf").write_text(BOX)
    with ssduck.load("box.urdf", limits=ssduck.Limits.strict()) as ss:
        assert ss.eval("SELECT id FROM box AS list;") == ["box"]
    assert not (foreign.parent / "run").exists()


# A product of 2^30 rows at each tick, two cups by thirty names: no batch of it ends in an hour.
NAMES = [f"a{number}" for number in range(30)]
ENDLESS = "count(SELECT a0.x FROM " + ", ".join(f"{name}=lab{{}}" for name in NAMES)
ENDLESS += f" WHERE {' + '.join(f'{name}.x' for name in NAMES)} > -1e9 AS list);"
ASKING = f"""
import sys, ssduck
if __name__ == "__main__":
    lake = ssduck.lake(sys.argv[1])
    lake.ask("1;", processes=2, batch=1)
    print("asks", flush=True)
    try:
        lake.ask({ENDLESS!r}, processes=2, batch=1)
    except KeyboardInterrupt:
        print(lake.ask("2;", processes=2, batch=1)["answer"].to_pylist(), flush=True)
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
def test_ctrl_c_ends_the_processes_of_a_question(tmp_path):
    """They are not in the group of a notebook's process that is interrupted."""
    record = write_rising_cups(tmp_path / "record", 3, 12)
    script = tmp_path / "asks.py"
    script.write_text(ASKING)
    process = subprocess.Popen([sys.executable, script, record], stdout=subprocess.PIPE, text=True)
    late = threading.Timer(120, process.kill)
    late.start()
    with process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "asks\n"
            time.sleep(3)  # the processes are at work
            assert process.poll() is None
            process.send_signal(signal.SIGINT)
            assert process.stdout.readline() == "[2, 2, 2]\n"
        finally:
            late.cancel()
            process.kill()


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
