"""Parts of a record's folder: one that is missing, swapped or of another record is noticed."""

import shutil
from pathlib import Path

import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import RecordError
from ssduck.recording.paths import part_name
from tests.support.bodies import solid
from tests.support.recorded import end_part

PARTS = 4
PLACE = "world=lab/episode={}"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A record of two episodes of four parts each, of a ball that falls."""
    place = tmp_path_factory.mktemp("parts") / "run"
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -9.81, client)
    solid(client, pybullet.GEOM_SPHERE, 1, radius=0.1)
    with ssduck.Interpreter() as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client))
        for _ in range(2):
            with ss.record_to(place, recording=Recording(tables=("entities", "links"))) as writing:
                for part in range(PARTS):
                    if part == 2:  # what entities are has two parts, too
                        solid(client, pybullet.GEOM_SPHERE, 1, [3, 0, 0], radius=0.1)
                    world.step()
                    world.step()
                    end_part(writing)
    pybullet.disconnect(client)
    return place


@pytest.fixture
def run(made, tmp_path):
    return Path(shutil.copytree(made, tmp_path / "run"))


def part(run, table, number, episode=1):
    return run / table / PLACE.format(episode) / part_name(number)


def swap(one, other):
    between = one.with_name("between")
    one.rename(between)
    other.rename(one)
    between.rename(other)


def without(run, *numbers):
    for table in TABLES:
        for number in numbers:
            part(run, table, number).unlink()


def renamed_episode(run):
    shutil.copy(run / "episodes" / "lab-0.json", run / "episodes" / "lab-1.json")


TABLES = ("ticks", "entities", "links")


def swapped(*tables):
    return lambda run: [swap(part(run, table, 1), part(run, table, 2)) for table in tables]


def copied(*pairs):
    """Returns a change that copies parts to others; each is a table, a number and an episode."""
    return lambda run: [shutil.copy(part(run, *old), part(run, *new)) for old, new in pairs]


def without_last_models(run):
    for file in run.glob(f"models/*/{PLACE.format(0)}/{part_name(1)}"):
        file.unlink()


DAMAGES = [
    ("ticks of a part in the middle", lambda r: part(r, "ticks", 1).unlink(), "000001.* missing"),
    ("two in the middle", lambda r: without(r, 1, 2), "000001.* is missing, and parts after it"),
    ("the first", lambda r: without(r, 0), "000000.* is missing, and parts after it"),
    ("rows of a part", lambda r: part(r, "entities", 2).unlink(), "is missing: the record was"),
    ("parts swapped", swapped("entities"), "000001.* is another part, or of another record"),
    ("all of two parts swapped", swapped(*TABLES), "000001.* is another part"),
    ("a part twice", copied((("links", 1), ("links", 2))), "000002.* is another part"),
    ("a copy behind the last", copied(*(((t, 3), (t, 4)) for t in TABLES)), "000004.* is another"),
    ("of another episode", copied((("links", 1, 0), ("links", 1))), "000001.* is another part, or"),
    ("of another table", copied((("links", 1), ("entities", 1))), "000001.* is another part"),
    (
        "models of another episode",
        copied((("models/entities", 0, 0), ("models/entities", 0))),
        "000000.* is another part",
    ),
    ("the last of the models", without_last_models, ""),
    (
        "an episode copied",
        renamed_episode,
        "lab-1.json describes episode 0 of 'lab': it was renamed",
    ),
]


@pytest.mark.parametrize(("damage", "told"), [d[1:] for d in DAMAGES], ids=[d[0] for d in DAMAGES])
def test_what_is_not_whole_is_noticed(run, damage, told):
    damage(run)
    episode = 1 if told else 0
    with pytest.raises(RecordError, match=told or "models/entities.* is missing"):
        ssduck.open(run, episode=episode)


@pytest.mark.parametrize("left", range(1, PARTS))
def test_a_record_that_ends_early_says_so(run, left):
    without(run, *range(left, PARTS))
    with pytest.raises(RecordError, match=f"closed with {PARTS} parts"):
        ssduck.open(run)
    with (
        pytest.warns(UserWarning, match="is missing: the record was") as caught,
        ssduck.open(run, partial=True) as ss,
    ):
        assert len(ss.past("lab").ticks) == 1 + 2 * left
    assert {warning.filename for warning in caught} == {__file__}
