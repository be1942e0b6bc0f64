"""The small record of a run, which `ssduck demo cleanup` asks: it has the chosen ticks, unchanged."""

import subprocess
import sys
from pathlib import Path

import pytest

import ssduck
from examples.cleanup.recorded import record, thin
from ssduck.demos.cleanup import RUN
from ssduck.errors import SelectScriptError

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
POSES = "SELECT tick, name, x, y, z, qw, qx, qy, qz, xmin, zmax FROM entities_history ORDER BY ALL"
JOINTS = "SELECT tick, entity, name, position FROM joints_history ORDER BY ALL"
GAPS = "SELECT id, clearance(kitchen.table, this) FROM kitchen WHERE isRobot(this);"


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A record of 20 ticks, and four of them."""
    folder = tmp_path_factory.mktemp("runs")
    with ssduck.load("kitchen") as ss:
        spec = ssduck.Recording(tables=("entities", "joints"), entities=["barrett_4918", "table"])
        with ss.record_to(folder / "whole", recording=spec) as recording:
            ss.worlds[0]["barrett_4918"].drive({"j1": 0.5, "j2": 0.5})
            for _ in range(19):
                ss.worlds[0].step()
            recording.tag({"holding it": 7})
    thin(folder / "whole", folder / "thin", {1, 7, 8, 20})
    return folder


@pytest.mark.parametrize("query", [POSES, JOINTS])
def test_chosen_ticks_are_as_they_were(folders, query):
    with ssduck.open(folders / "whole") as whole, ssduck.open(folders / "thin") as thinned:
        rows = whole.sql(query).fetchall()
        assert {row[0] for row in rows} == {*range(1, 21)}
        expected = [row for row in rows if row[0] in {1, 7, 8, 20}]
        assert thinned.sql(query).fetchall() == expected
        assert len({row[-1] for row in expected}) > 4


def test_shapes_and_tags_stay(folders):
    with ssduck.open(folders / "whole") as whole, ssduck.open(folders / "thin") as thinned:
        for ss in (whole, thinned):
            ss.call_variable("kitchen").seek_tick(8)
        assert thinned.eval(GAPS) == whole.eval(GAPS)
    (episode,) = ssduck.episodes(folders / "thin")
    assert (episode.tags, episode.ticks, episode.complete) == ({"holding it": 7}, 4, True)


def test_velocities_are_unknown(folders):
    with ssduck.open(folders / "thin") as ss:
        query = "SELECT count(vx), count(wz), count(z) FROM entities_history"
        assert ss.sql(query).fetchall() == [(0, 0, 8)]
        assert ss.sql("SELECT count(velocity) FROM joints_history").fetchall() == [(0,)]


def test_the_shipped_record_is_small_and_whole():
    size = sum(path.stat().st_size for path in RUN.rglob("*") if path.is_file())
    assert size < 500_000
    (episode,) = ssduck.episodes(RUN)
    assert episode.tags["seed"] == 0
    with ssduck.open(RUN) as ss:
        ticks = {tick for (tick,) in ss.sql("SELECT tick FROM ticks_history").fetchall()}
    assert {tick for event, tick in episode.tags.items() if event != "seed"} <= ticks


def test_no_folder_is_overwritten(tmp_path):
    with pytest.raises(SelectScriptError, match="exists: choose another folder"):
        record(None, None, print, tmp_path, seed=0)


def test_the_program_tells_its_options():
    command = [sys.executable, "-m", "examples.cleanup", "--help"]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert all(option in told.stdout for option in ("--seed", "--out", "--record"))
