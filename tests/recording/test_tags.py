"""Each episode has an id of its own, and the tags that it was recorded with."""

from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from uuid import UUID

import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import ArgumentError, ProgramWarning
from ssduck.recording.episode import parsed_tag
from ssduck.recording.stores.parquet import write_tags
from ssduck.recording.stores.parquet_layout import FolderRun
from tests.support.command_line import answer, ssduck_, write_scene

TAGS = {"task": "pick", "success": True, "return": 12.5, "attempt": 3}
ENTITIES = Recording(tables=("entities",))


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("scene")) / "two.toml"


def recorded(scene, place, tags=None):
    with ssduck.load(scene) as ss, ss.record_to(place, recording=ENTITIES, tags=tags):
        ss.run(0.02)
    return ssduck.episodes(place)[-1]


@pytest.mark.slow
def test_each_run_has_an_id_of_its_own_that_stays(scene, tmp_path):
    made = [recorded(scene, tmp_path / name) for name in ("a", "b", "b")]
    assert len({UUID(episode.id) for episode in made}) == 3
    assert {UUID(episode.id).version for episode in made} == {4}
    assert ssduck.episodes(tmp_path / "b") == made[1:]
    assert ssduck.check(tmp_path / "b") == []


@pytest.mark.slow
def test_tags_are_read_back_with_their_types(scene, tmp_path):
    tags = recorded(scene, tmp_path / "a", TAGS).tags
    assert tags == TAGS
    assert [*map(type, tags.values())] == [str, bool, float, int]
    assert recorded(scene, tmp_path / "a").tags == {}


@pytest.mark.slow
def test_a_running_recording_and_a_closed_one_get_further_tags(scene, tmp_path):
    with (
        ssduck.load(scene) as ss,
        ss.record_to(tmp_path / "r", recording=ENTITIES, tags={"task": "pick"}) as recording,
    ):
        ss.run(0.02)
        recording.tag({"success": False, "seed": 7})
        assert recording.episode.tags == {"task": "pick", "success": False, "seed": 7}
    (before,) = ssduck.episodes(tmp_path / "r")
    write_tags(FolderRun(tmp_path / "r", before.world, before.number), {"success": True})
    (after,) = ssduck.episodes(tmp_path / "r")
    assert after.tags == {"task": "pick", "success": True, "seed": 7}
    assert (after.id, after.complete, after.ticks) == (before.id, True, before.ticks)
    assert ssduck.check(tmp_path / "r") == []


def tag_many(place, name):
    for number in range(20):
        write_tags(FolderRun(place, "two", 0), {f"{name}_{number}": number})


@pytest.mark.slow
def test_threads_and_processes_tag_an_episode_that_ends(scene, tmp_path):
    place = tmp_path / "r"
    process = get_context("spawn").Process(target=tag_many, args=(place, "process"))
    with ThreadPoolExecutor() as pool:
        with ssduck.load(scene) as ss, ss.record_to(place, recording=ENTITIES):
            ss.run(0.02)
            process.start()
            tagged = [pool.submit(tag_many, place, name) for name in "abc"]
        for one in tagged:
            one.result()
    process.join()
    (episode,) = ssduck.episodes(place)
    names = ("process", "a", "b", "c")
    assert episode.tags == {f"{name}_{number}": number for name in names for number in range(20)}
    assert episode.complete


@pytest.mark.slow
def test_a_database_has_ids_and_tags_and_an_export_keeps_the_tags(scene, tmp_path):
    file = tmp_path / "r.duckdb"
    with ssduck.load(scene, file, recording=None) as ss:
        ss.record("two", ENTITIES, tags=TAGS)
        ss.run(0.02)
    (stored,) = ssduck.episodes(file)
    assert (stored.tags, UUID(stored.id).version) == (TAGS, 4)
    with ssduck.open(file) as ss:
        ss.export(tmp_path / "copy", tags={"task": "place"})
    (copied,) = ssduck.episodes(tmp_path / "copy")
    assert copied.tags == TAGS | {"task": "place"}
    assert copied.id != stored.id


@pytest.mark.slow
def test_a_memory_record_is_exported_with_its_tags(scene, tmp_path):
    with ssduck.load(scene) as ss:
        ss.record("two", ENTITIES, tags=TAGS)
        ss.run(0.02)
        ss.export(tmp_path / "r")
    assert ssduck.episodes(tmp_path / "r")[0].tags == TAGS


@pytest.mark.parametrize(
    "tags",
    [
        {"a": float("nan")},
        {"a": float("inf")},
        {"a": None},
        {"a": [1]},
        {"a": 1 << 53},
        {"": 1},
        {"a\nb": 1},
        {1: 1},
        ["a"],
        {f"t{number}": 1 for number in range(1001)},
    ],
)
def test_another_tag_is_an_error_and_records_nothing(scene, tmp_path, tags):
    with ssduck.load(scene) as ss, pytest.raises(ArgumentError, match="tag"):
        ss.record_to(tmp_path / "r", tags=tags)
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("task=pick", ("task", "pick")),
        ("note=a=b", ("note", "a=b")),
        ("n=3", ("n", 3)),
        ("r=-1.5e3", ("r", -1500.0)),
        ("ok=true", ("ok", True)),
        ("ok=True", ("ok", "True")),
        ('n="3"', ("n", "3")),
        ("n=", ("n", "")),
        ("n=null", ("n", "null")),
        ("n=NaN", ("n", "NaN")),
        ("n=[1]", ("n", "[1]")),
        (f"n={1 << 53}", ("n", str(1 << 53))),
    ],
)
def test_tags_on_the_command_line(text, expected):
    name, value = parsed_tag(text)
    assert (name, value, type(value)) == (*expected, type(expected[1]))


@pytest.mark.parametrize("text", ["task", "=pick"])
def test_a_tag_without_a_name_or_value_is_an_error(text):
    with pytest.raises(ArgumentError, match="tag"):
        parsed_tag(text)


@pytest.mark.slow
@pytest.mark.parametrize("output", ["r", "r.duckdb"])
def test_the_commands_take_tags_and_list_them(scene, tmp_path, output):
    place = str(tmp_path / output)
    answer(
        "record", str(scene), "--seconds", "0.01", "-o", place, "--tag", "task=pick", "--tag", "n=3"
    )
    (episode,) = ssduck.episodes(place)
    assert episode.tags == {"task": "pick", "n": 3}
    assert "n=3 task=pick" in answer("episodes", place)


PROGRAMS = ["z(two.a) > 0.5", "on(two.table, two.a) AND True;", "SELECT id FROM two AS list;"]
TEXTS = ["pick", "a-b", "run/2024-11-01", "Smith (2024)", "file.txt", "select the cup", "x > 3", ""]


@pytest.mark.slow
def test_a_text_that_is_a_program_is_told_of(scene, tmp_path):
    place = tmp_path / "r"
    with ssduck.load(scene) as ss:
        ss.run(0.02)
        ss.export(place, tags={f"t{n}": text for n, text in enumerate(TEXTS)})
        for text in PROGRAMS:
            with pytest.warns(
                ProgramWarning, match=r"tags\['good'\] is the text .*--program 'good=…'"
            ):
                ss.export(tmp_path / "other", tags={"good": text})  # kept as it is
        with (
            ss.record_to(tmp_path / "live", recording=ENTITIES) as recording,
            pytest.warns(ProgramWarning, match=r"lake\.tag\('good', program\)"),
        ):
            recording.tag({"good": PROGRAMS[0]})
    with pytest.warns(ProgramWarning, match=r"tags\['good'\] is the text"):
        ssduck.lake(place).set_tags({"good": PROGRAMS[0]})
    assert ssduck.episodes(place)[0].tags["good"] == PROGRAMS[0]
    told = ssduck_("tag", str(place), f"fine={PROGRAMS[1]}").stderr
    assert "tags['fine'] is the text 'on(two.table, two.a) AND True;'" in told
