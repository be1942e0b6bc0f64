"""The random scenes of the benchmark of pairs are as described; all ways find the same in them."""

import numpy as np
import pytest

from benchmarks import pairs
from benchmarks.random_scenes import FORMS, KINDS, NEIGHBOURS, Piece, RandomScene, random_scene
from benchmarks.referee import bounds, may_touch, verdict

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
