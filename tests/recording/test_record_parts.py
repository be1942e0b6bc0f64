"""Parts of a record's folder: one that is missing, swapped or of another record is noticed."""

import shutil
import warnings
from pathlib import Path

import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import RecordError
from ssduck.recording.paths import part_name
from ssduck.recording.stores.descriptions import read_description
from ssduck.recording.stores.files import write_json
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
    for table in ("ticks", "entities", "links"):
        for number in numbers:
            part(run, table, number).unlink()


def renamed_episode(run):
    shutil.copy(run / "episodes" / "lab-0.json", run / "episodes" / "lab-1.json")


DAMAGES = [
    ("ticks of a part in the middle", lambda r: part(r, "ticks", 1).unlink(), "000001.* missing"),
    ("two in the middle", lambda r: without(r, 1, 2), "000001.* is missing, and parts after it"),
    ("the first", lambda r: without(r, 0), "000000.* is missing, and parts after it"),
    ("rows of a part", lambda r: part(r, "entities", 2).unlink(), "is missing: the record was"),
    (
        "parts swapped",
        lambda r: swap(part(r, "entities", 1), part(r, "entities", 2)),
        "000001.* is another part, or of another record",
    ),
    (
        "all of two parts swapped",
        lambda r: [swap(part(r, t, 1), part(r, t, 2)) for t in ("ticks", "entities", "links")],
        "000001.* is another part",
    ),
    (
        "a part twice",
        lambda r: shutil.copy(part(r, "links", 1), part(r, "links", 2)),
        "000002.* is another part",
    ),
    (
        "a copy behind the last",
        lambda r: [
            shutil.copy(part(r, t, 3), part(r, t, 4)) for t in ("ticks", "entities", "links")
        ],
        "000004.* is another part",
    ),
    (
        "of another episode",
        lambda r: shutil.copy(part(r, "entities", 1, 0), part(r, "entities", 1)),
        "000001.* is another part, or of another record",
    ),
    (
        "of another table",
        lambda r: shutil.copy(part(r, "links", 1), part(r, "entities", 1)),
        "000001.* is another part",
    ),
    (
        "models of another episode",
        lambda r: shutil.copy(part(r, "models/entities", 0, 0), part(r, "models/entities", 0)),
        "000000.* is another part",
    ),
    (
        "the last of the models",
        lambda r: [file.unlink() for file in r.glob(f"models/*/{PLACE.format(0)}/{part_name(1)}")],
        "",
    ),
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


def test_a_whole_one_says_nothing(run):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with ssduck.open(run) as ss:
            assert len(ss.past("lab").ticks) == 1 + 2 * PARTS


def test_a_record_that_was_not_closed_ends_where_it_ends(run):
    about = run / "episodes" / "lab-1.json"
    told = read_description(about)
    assert told.pop("parts")["ticks"] == PARTS
    write_json(told, about)
    without(run, PARTS - 1)
    with ssduck.open(run) as ss:
        assert len(ss.past("lab").ticks) == 1 + 2 * (PARTS - 1)
