"""The random scenes of the benchmark of pairs are as described; all ways find the same in them."""

from __future__ import annotations

import numpy as np
import pytest

import ssduck
from benchmarks import adapters, checksums, pair_relations, pairs, recorded
from benchmarks.random_scenes import FORMS, KINDS, NEIGHBOURS, Piece, RandomScene, random_scene
from benchmarks.referee import bounds, may_touch, verdict
from ssduck.recording.folder_check import check_folder

pytestmark = pytest.mark.long

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2.0
BOX = Piece("box", (0.5, 0.5, 0.5), CORNERS)
SPHERE = Piece("sphere", (0.5,), np.zeros((1, 3)), ball=0.5)
CYLINDER = Piece("cylinder", (0.5, 1.0), np.array([[0, 0, -0.5], [0, 0, 0.5]]), disc=0.5)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", KINDS)
def test_all_ways_find_the_same_pairs(form, kind):
    found = pairs.measure(form, kind, 40, rounds=1, max_seconds=0.0)
    assert pairs.failures([found]) == []
    assert found.collisions > 20
    assert found.statistics["ours"].calls <= len(found.scene.met)
    # A box on another meets it or not, by rounding; SQL asks about those that nearly do.
    assert found.statistics["sql"].pairs <= 1.1 * len(found.scene.met)
    assert set(found.times) <= set(pairs.WAYS)


def test_the_tables(capsys):
    status = pairs.main(
        ["--sizes", "20", "30", "--forms", "cube", "--kinds", "boxes", "--rounds", "1"]
    )
    printed = capsys.readouterr().out
    assert status == 0
    assert printed.count("| cube, boxes |") == 4
    assert "at 30 bodies at most 1.5 of FCL's tree" in printed
    assert "DISAGREEMENT" not in printed


@pytest.mark.long
def test_the_tables_of_relations(capsys):
    arguments = ["--sizes", "20", "--forms", "cube", "--rounds", "1"]
    assert pair_relations.main(arguments) == 0
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines() if "| 20 |" in line]
    relations = ["collides", "near", "touching", "on"]
    expected = [(motion, name) for motion in ("apart", "together") for name in relations] * 2
    assert [(row[2], row[3]) for row in rows] == expected
    assert all(row[-1] == "0 |" for row in rows if row[3] != "on")


def test_without_coal(monkeypatch, capsys):
    monkeypatch.setattr(pairs, "coal_or_none", lambda: None)
    assert (
        pairs.main(["--sizes", "20", "--forms", "cube", "--kinds", "boxes", "--rounds", "1"]) == 0
    )
    assert capsys.readouterr().out.count("| not installed |") == 2


def test_a_wrong_answer_is_a_failure(monkeypatch, capsys):
    right = pairs.SsduckScene.pairs
    monkeypatch.setattr(pairs.SsduckScene, "pairs", lambda self, names: right(self, names)[1:])
    status = pairs.main(["--sizes", "40", "--forms", "cube", "--kinds", "boxes", "--rounds", "1"])
    assert status == 1
    assert "DISAGREEMENT: cube, boxes, 40: FCL, tree" in capsys.readouterr().out


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("count", [50, 500])
def test_boxes_meet_as_many_others_as_wanted(form, count):
    made = random_scene(form, "mixed", count)
    assert made.neighbours == pytest.approx(NEIGHBOURS, abs=0.3)
    assert np.array_equal(made.positions, random_scene(form, "mixed", count).positions)


@pytest.mark.parametrize(
    ("one", "other", "apart", "depth"),
    [
        (BOX, BOX, 0.9, 0.1),
        (BOX, SPHERE, 0.75, 0.25),
        (CYLINDER, CYLINDER, 0.8, 0.2),
        (CYLINDER, SPHERE, 0.99, 0.01),
        (BOX, CYLINDER, 0.5, 0.5),
    ],
)
def test_the_referee(one, other, apart, depth):
    places = np.array([[0.0, 0.0, 0.0], [apart, 0.0, 0.0], [2.0, 0.0, 0.0]])
    turns = np.array([[0.0, 0.0, 0.0, 1.0]] * 3)
    three = RandomScene([one, other], np.array([0, 1, 1]), places, turns, np.zeros((0, 2), int))
    least, most = bounds(three, 0, 1, depth)
    assert least <= depth + 1e-9
    assert most >= depth - 1e-9
    assert verdict(three, 0, 1, 0.9 * depth)
    assert verdict(three, 0, 1, 1.1 * depth) is False
    assert verdict(three, 0, 2, 1e-6) is False
    assert may_touch(three, 0, 1, 1.1 * depth)
    assert not may_touch(three, 0, 1, 0.9 * depth)
    assert not may_touch(three, 0, 2, 0.1)


@pytest.mark.long
def test_the_tables_of_recorded_time(capsys):
    small = "--sizes 5 --ticks 8 --long 200 --near 20 --window 8 --gigabytes 0.0005 --rounds 1"
    assert recorded.main(small.split()) == 0
    printed = capsys.readouterr().out
    headers = (
        recorded.COST,
        recorded.BYTES,
        recorded.OVER,
        recorded.NEAR,
        recorded.WINDOW,
        recorded.OPENED,
    )
    for header in headers:
        assert f"| {' | '.join(header)} |" in printed
    assert printed.count("| 5 boxes |") == 2
    assert printed.count("| opening") == 6
    assert (
        printed.count("| a small episode |")
        == printed.count("| recording the kitchen at 240 Hz |")
        == 1
    )


def test_what_checksums_cost_is_of_records_with_and_without_them(monkeypatch, tmp_path):
    monkeypatch.setattr(checksums, "TICKS", 20)
    with ssduck.load("kitchen", recording=None) as ss:
        with checksums._no_checksums():
            checksums._record(ss, tmp_path / "bare")
            for text in checksums.STATEMENTS.values():
                checksums._ask(tmp_path / "bare", "sql", text)
        checksums._record(ss, tmp_path / "sealed")
    assert not check_folder(tmp_path / "sealed")
    assert check_folder(tmp_path / "bare")


def test_grids_and_rays(monkeypatch):
    few = {
        "map(0.22, 0.2)": adapters.Comparison(
            f"{adapters.ALL} map(0.22, 0.2);", adapters.rays_down, "rays"
        ),
        "sensorgrid(0.24, 0.2)": adapters.Comparison(
            "SELECT obj FROM kitchen WHERE isSensor(this) AS sensorgrid(0.24, 0.2);",
            adapters.rays_from_sensors,
            "rays",
        ),
    }
    monkeypatch.setattr(adapters, "COMPARISONS", few)
    monkeypatch.setattr(adapters, "ROUNDS", 1)
    rows = list(adapters.rows())
    assert [row[:2] for row in rows] == [
        ("environment", ""),
        ("map(0.22, 0.2)", "546"),
        ("sensorgrid(0.24, 0.2)", "546"),
    ]
    assert all(len(row) == len(adapters.HEADER) for row in rows)


@pytest.mark.parametrize("many", [1, 7, adapters.MAX_RAYS])
def test_all_rays_are_cast(monkeypatch, many):
    monkeypatch.setattr(adapters, "MAX_RAYS", many)
    with ssduck.load("kitchen") as ss:
        kitchen = ss.call_variable("kitchen")
        grid = ss.eval(f"{adapters.ALL} map(0.9, 0.5);")
        hits = [hit for part in adapters.rays_down(kitchen, grid)() for hit in part]
    assert len(hits) == grid.cells.size
    assert sum(hit[0] >= 0 for hit in hits) > 0
