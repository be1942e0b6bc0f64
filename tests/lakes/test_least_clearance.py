"""`least(clearance(a, b))` compares shapes at few ticks, and gives what comparing all of them gives."""

from itertools import combinations
from unittest.mock import patch

import pytest

import ssduck
from ssduck.geometry import pair_batch
from tests.support.lake_episodes import record_episodes

BODIES = ("gripper", "cup", "wall", "thing_5", "thing_6")
PAIRS = [*combinations(BODIES, 2), ("table", "cup"), ("table", "gripper")]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def moving(tmp_path_factory):
    folder = tmp_path_factory.mktemp("moving") / "record"
    record_episodes(folder, 1, first=3, steps=60)
    return folder


def values(folder, text):
    """Returns the values of expressions of two bodies, in a record that is opened for them."""
    with ssduck.open(folder) as record:
        return [record.eval(text.format(a, b)) for a, b in PAIRS]


def test_the_least_of_all_ticks(moving):
    found = values(moving, "least(clearance(sim.{0}, sim.{1}));")
    assert found == values(moving, "least(clearance(sim.{0}, sim.{1}) + 0);")
    assert found == values(moving, "least(clearance(sim.{1}, sim.{0}));")
    assert len({time for time, _ in found}) > 3
    assert {0.0} < {value for _, value in found}


def test_the_least_of_a_window(moving):
    found = values(moving, "least(clearance(sim.{0}, sim.{1}), -0.3);")
    assert found == values(moving, "least(clearance(sim.{0}, sim.{1}) + 0, -0.3);")


@pytest.mark.parametrize("pair", [("gripper", "wall"), ("gripper", "table")])
def test_what_excludes_nothing_is_given_up(moving, pair):
    verdicts = pair_batch.proven_verdicts
    with (
        ssduck.open(moving) as record,
        patch.object(pair_batch, "proven_verdicts", side_effect=verdicts) as asked,
    ):
        found = record.eval("least(clearance(sim.{}, sim.{}));".format(*pair))
        assert found[1] > 0.0
    assert asked.call_count < 20
