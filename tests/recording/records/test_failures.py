"""Full disks and killed processes leave whole records."""

import pytest

import ssduck
from tests.support.cases import generated, sampled
from tests.support.recorded import POSIX, python
from tools import kill, kill_work

# -- a full disk ---------------------------------------------------------------------------------


FULL = """
import resource, signal, sys
import pybullet, ssduck
from ssduck import Recording
from ssduck.errors import SelectScriptError
from ssduck.schema import RECORDABLE

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
kind, path = sys.argv[1:]

def limit(size):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

client = pybullet.connect(pybullet.DIRECT)
pybullet.setGravity(0, 0, -9.81)
for place in range(40):
    ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1)
    pybullet.createMultiBody(1, ball, basePosition=[place, 0, 1])
world = ssduck.World.attach(client, name="lab")
kept = Recording(tables=("links",))
if kind == "file":
    ss = ssduck.Interpreter(path, recording=kept)
    ss.add_variable("lab", world)
    flush = ss.flush
else:
    ss = ssduck.Interpreter()
    ss.add_variable("lab", world)
    writing = ss.record_to(path, "lab", kept)
    flush = writing.flush
for _ in range(50):
    world.step()
flush()
print("stored", world.snapshot.number)
limit(30_000 if kind == "folder" else 900_000)
failed = 0
for tick in range(2600):
    try:
        world.step()
    except SelectScriptError as error:
        failed += 1
        told = str(error)
try:
    flush()
except SelectScriptError as error:
    failed += 1
    told = str(error)
print("failed", bool(failed), "are intact" in " ".join(told.split()), "until there is" in told)
assert ss.sql("SELECT count(*) FROM lab.entities").fetchall() == [(40,)]
limit(resource.RLIM_INFINITY)
world.step()
flush()
print("again", world.snapshot.number)
ss.close()
"""


@pytest.mark.slow
@POSIX
@sampled("kind", ["folder", "file"], every=2)
def test_a_full_disk_loses_nothing(tmp_path, kind):
    path = tmp_path / ("run.duckdb" if kind == "file" else "run")
    stored, failed, again = python(FULL, kind, path).splitlines()
    assert (stored, failed) == ("stored 51", "failed True True True")
    last = int(again.removeprefix("again "))
    with ssduck.open(path) as ss:
        assert ss.past("lab").ticks == list(range(1, last + 1))
        counts = ss.sql("SELECT tick, count(*) FROM entities_history GROUP BY tick").fetchall()
        assert len(counts) == last
        assert {count for _, count in counts} == {40}
        assert ss.sql("SELECT count(*) FROM links_history").fetchall() == [(40 * last,)]
    assert not list(tmp_path.rglob("*.unfinished"))


# -- killed --------------------------------------------------------------------------------------


@pytest.mark.slow
@POSIX
@sampled("seed", range(generated(3)), every=3)
def test_killed_recorders_leave_whole_records(seed):
    """The short form of `python -m tools.kill`."""
    run = kill.Run(kill.KINDS["both"], slack=5.0)  # the machine may be busy
    run.add(seed)
    assert run.faults == {}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return kill_work.Run(tuple(kill_work.WORK), tmp_path_factory.mktemp("records"))


@pytest.mark.long
@POSIX
# Exports, closing and so on in turn; folders below the number of works, files from it on.
@pytest.mark.parametrize("seed", [0, 7, 2, 9, 4, 11])
def test_killed_work_leaves_whole_records(run, seed):
    """The short form of `python -m tools.kill_work`."""
    run.add(seed)
    assert run.faults == {}
