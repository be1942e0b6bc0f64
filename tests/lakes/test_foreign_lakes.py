"""Lakes of strangers: nothing outside is read, and what is wrong is the error of one episode."""

import json
import os
import shutil
import zlib
from dataclasses import replace

import mujoco
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck.errors import ArgumentError, RecordError
from ssduck.lakes.engines import answer_locally
from ssduck.lakes.groups import EntryFiles, EpisodeGroup
from ssduck.lakes.groups import _checked_parts as checked_parts
from ssduck.lakes.lake import MANIFEST
from ssduck.lakes.manifest import SCHEMA, read_manifest
from ssduck.lakes.questions import ProgramQuestion
from ssduck.lakes.workers import answer_episodes, forget_readers
from ssduck.recording.stores.batched_parts import ReadPart, ReadParts
from ssduck.recording.stores.checksums import json_text, write_parquet
from ssduck.recording.stores.parquet_layout import FolderRun
from tests.lakes.conftest import EPISODES
from tests.support.cases import sampled
from tests.support.lake_questions import whole_answer_of

PROGRAM = "count(SELECT id FROM sim AS list);"
FILE = f"{MANIFEST}.parquet"
ENTITIES = "entities/world=sim/episode=1"
STEPS = "gym/sim-1.json"
LEAVES = "is a symbolic link that leaves"


def ask(folder):
    rows = ssduck.lake(folder).ask(PROGRAM, processes=1).to_pylist()
    return {row["episode"]: row["error"] for row in rows}


def moved(place):
    """Moves a file or a folder out of its record, and links to it."""

    def change(folder):
        outside = folder.parent / "outside"
        (folder / place).rename(outside)
        (folder / place).symlink_to(outside)

    return change


def linked(place, target):
    def change(folder):
        (folder / place).unlink(missing_ok=True)
        (folder / place).symlink_to(target)

    return change


def pipe(place):
    def change(folder):
        (folder / place).unlink(missing_ok=True)
        os.mkfifo(folder / place)

    return change


# A change of the second episode, and its error.
CHANGES = {
    "a pipe beside the parts": (pipe(f"{ENTITIES}/more.parquet"), None),
    "a pipe beside the models": (pipe("models/links/world=sim/episode=1/more"), None),
    "a pipe as steps": (pipe(STEPS), None),
    "a device beside the parts": (linked(f"{ENTITIES}/more.parquet", "/dev/zero"), LEAVES),
    "a device as steps": (linked(STEPS, "/dev/zero"), LEAVES),
    "a link to nothing": (linked(f"{ENTITIES}/more.parquet", "/nowhere"), LEAVES),
    "a part elsewhere": (moved(f"{ENTITIES}/part-000000.parquet"), LEAVES),
    "parts elsewhere": (moved(ENTITIES), LEAVES),
}


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no pipes in folders")
@pytest.mark.parametrize("change", CHANGES)
def test_links_and_pipes_are_not_read(folder, change):
    apply, error = CHANGES[change]
    apply(folder)
    for _ in range(2):  # without a manifest, and with one
        errors = ask(folder)
        assert sorted(errors) == list(range(EPISODES))
        assert [n for n, message in errors.items() if message] == ([] if error is None else [1])
        assert error is None or error in errors[1]


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no pipes in folders")
@pytest.mark.parametrize("change", [pipe(FILE), linked(FILE, "/dev/zero"), linked(FILE, "../a")])
def test_a_manifest_is_a_file(folder, change):
    (folder.parent / "a").write_text("kept")
    change(folder)
    assert not any(ask(folder).values())
    assert (folder.parent / "a").read_text() == "kept"


def forged(folder, **values):
    """Changes the second row of a manifest."""
    file = folder / FILE
    rows = pq.read_table(file).to_pylist()
    rows[1] |= values
    write_parquet(pa.Table.from_pylist(rows, schema=SCHEMA), file)


@pytest.mark.slow
@sampled(
    "values",
    [
        {"path": "/etc", "world": "other"},
        {"path": "../..", "world": "other"},
        {"tags": "[1]"},
        {"tags": "[" * 100_000},
        {"tags": json.dumps({"a": {"b": 1}})},
        {"tags": json.dumps({"": 1})},
        {"tables": None},
        {"tables": ["ticks", "../../entities"]},
        {"tables": ["ticks", "entities"]},
        {"ticks": None},
        {"ticks": 10**12},
        {"world": None},
        {"files": [{"name": "/etc/passwd", "size": 1, "modified": 1, "checksum": 1}]},
        {"files": [{"name": "a", "size": 1 << 62, "modified": 1, "checksum": 1}] * 2},
        {"files": [{"name": "a", "size": -1, "modified": 1, "checksum": 1}]},
        {"files": [{"name": "a", "size": None, "modified": 1, "checksum": 1}]},
    ],
    every=2,
)
def test_a_forged_manifest_changes_no_answer_and_names_nothing_outside(folder, values):
    wanted = ssduck.lake(folder).ask(PROGRAM, processes=1)
    forged(folder, **values)
    lake = ssduck.lake(folder)
    assert set(lake.episodes["path"].to_pylist()) == {str(folder)}
    assert lake.ask(PROGRAM, processes=1) == wanted
    lake.set_tags({"seen": True}, "episode = 1")
    assert ssduck.lake(folder).select("seen")["episode"].to_pylist() == [1]


ROWS = "count(SELECT id FROM sim{} AS list);"


@pytest.mark.slow
def test_a_file_beside_the_parts_is_not_read(folder):
    wanted = ssduck.lake(folder).ask(ROWS, processes=1)
    part = folder / ENTITIES / "part-000000.parquet"
    (part.parent / "more.parquet").write_bytes(part.read_bytes())
    for _ in range(2):  # without an entry in the manifest, and with one
        assert ssduck.lake(folder).ask(ROWS, processes=1) == wanted


@pytest.mark.slow
def test_a_file_that_a_manifest_lists_twice_is_read_once(folder):
    wanted = ssduck.lake(folder).ask(ROWS, processes=1)
    row = pq.read_table(folder / FILE).to_pylist()[1]
    again = [file for file in row["files"] if file["name"].startswith(ENTITIES)]
    forged(folder, files=row["files"] + again)
    assert ssduck.lake(folder).ask(ROWS, processes=1) == wanted


@pytest.mark.parametrize("name", ["row", "ROW", "ssduck row", "Episode", 'a" FROM b; --'])
def test_a_tag_of_any_name_selects_no_other_episodes(folder, name):
    ssduck.lake(folder).set_tags({name: 0}, "episode = 2")
    lake = ssduck.lake(folder)
    assert lake.select("episode = 2")["episode"].to_pylist() == [2]
    assert len(lake.select("ticks > 0")) == EPISODES


@pytest.mark.slow
@pytest.mark.parametrize("text", ["(" * 5000 + "true" + ")" * 5000, "NOT " * 5000 + "true"])
def test_a_condition_nested_too_deeply_is_an_error(recorded, text):
    with pytest.raises(ArgumentError, match="nested too deeply"):
        ssduck.lake(recorded).select(text)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no pipes in folders")
@pytest.mark.parametrize("change", [pipe(STEPS), linked(STEPS, "/dev/zero")])
def test_steps_that_are_no_file_are_not_scored(folder, change):
    change(folder)
    rows = ssduck.lake(folder).score("z(sim.cup) > 9", processes=1).to_pylist()
    assert [row["episode"] for row in rows if row["error"]] == [1]


MODEL = """
<mujoco>
  <worldbody>
    <body name="table" pos="0 0 .2"><geom type="box" size=".6 .6 .2"/></body>
    <body name="{cup}" pos="0 0 .5"><freejoint/><geom type="sphere" size="{size}"/></body>
    {more}
  </worldbody>
</mujoco>
"""
BALL = '<body name="ball" pos="0 .3 .6"><freejoint/><geom type="sphere" size=".02"/></body>'
# Episodes that a forged manifest has as of the group of the first: other words of the model, the
# name of the world, the number of its steps and its recording.
FORGERIES = {
    "the same": {},
    "another shape": {"size": 0.03},
    "another name": {"cup": "mug"},
    "more entities": {"more": BALL},
    "another world": {"name": "lab"},
    "other tables": {"tables": ("links",)},
    "other ticks": {"every": 3},
    "recorded entities": {"entities": ("cup",)},
}
QUESTIONS = (
    "least(clearance(sim.table, sim.cup));",
    "holds(near(sim.table, sim.cup, 0.04));",
    "holds(z(sim.cup) > 0.48);",
    "count(SELECT id FROM sim AS list);",
    "SELECT tick(this) FROM contacts(sim{}) AS list;",
)


def record(folder, *, cup="cup", size=0.05, more="", name="sim", **recording):
    model = mujoco.MjModel.from_xml_string(MODEL.format(cup=cup, size=size, more=more))
    data = mujoco.MjData(model)
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable(name, ssduck.World.attach(model, data))
        with ss.record_to(folder, recording=ssduck.Recording(**recording)):
            for _ in range(20):
                mujoco.mj_step(model, data, 5)
                world.step()


def by_themselves(entry):
    """The answers of an episode that is opened by itself."""
    with ssduck.open(entry.path, entry.world, entry.episode) as ss:
        return [whole_answer_of(ss, program) for program in QUESTIONS]


@pytest.mark.slow
@sampled("forgery", FORGERIES, every=4)
def test_forged_groups_change_no_answer(tmp_path, forgery):
    record(tmp_path / "a")
    record(tmp_path / "b", **FORGERIES[forgery])
    file = tmp_path / FILE
    ssduck.lake(tmp_path)
    rows = pq.read_table(file).to_pylist()
    groups = {row["group"] for row in rows}
    assert len(groups) == (1 if forgery == "the same" else 2)
    for row in rows:
        row["group"] = "forged"
    write_parquet(pa.Table.from_pylist(rows, schema=SCHEMA), file)
    lake = ssduck.lake(tmp_path)
    assert {entry.group for entry in lake.entries} == {"forged"}
    entries = lake.entries
    expected = [by_themselves(entry) for entry in entries]
    for step in (1, -1):  # either is the first of the group
        forget_readers()
        for program, answers in zip(QUESTIONS, zip(*expected[::step], strict=True), strict=True):
            asked = answer_locally(ProgramQuestion(program), [entries[::step]], 1)
            assert list(asked) == [(0, list(answers))], program


def test_episodes_with_the_same_models_are_of_one_group(recorded):
    first, *others = ssduck.lake(recorded).entries
    group = EpisodeGroup(first)
    for _ in range(2):
        for entry in others:
            group.check(entry, ReadParts())


def test_models_are_compared_by_bytes_where_labels_differ(recorded, monkeypatch):
    first, *others = ssduck.lake(recorded).entries
    group = EpisodeGroup(first)
    decoded = []
    monkeypatch.setattr(
        "ssduck.lakes.groups._checked_parts",
        lambda files, *rest: decoded.append(files[0].path) or checked_parts(files, *rest),
    )
    for entry in others:
        group.check(entry, ReadParts())
    assert len(decoded) == len(others)  # the entities have the number of the run
    assert all("/models/entities/" in path for path in decoded)


@pytest.mark.parametrize("table", ["links", "geometries"])
def test_a_model_with_right_checksums_and_other_rows_is_of_another_group(folder, table):
    first, second, *_ = ssduck.lake(folder).entries
    name = f"models/{table}/world=sim/episode=1/part-000000.parquet"
    rows = pq.read_table(folder / name, partitioning=None)
    column = {"links": "mass", "geometries": "size_x"}[table]
    values = pa.array([value * 1.5 for value in rows[column].to_pylist()])
    write_parquet(rows.set_column(rows.column_names.index(column), column, values), folder / name)
    checksum = zlib.crc32((folder / name).read_bytes())
    files = [replace(f, checksum=checksum) if f.name == name else f for f in second.files]
    group = EpisodeGroup(first)
    with pytest.raises(RecordError, match="is another than its group has"):
        group.check(replace(second, files=tuple(files)), ReadParts())


def test_a_manifest_of_too_many_values_is_read_anew(folder, monkeypatch):
    ssduck.lake(folder)
    count = sum(
        group.column(n).num_values
        for group in [pq.read_metadata(folder / FILE).row_group(0)]
        for n in range(group.num_columns)
    )
    for most, entries in ((count, EPISODES), (count - 1, 0)):
        monkeypatch.setattr("ssduck.lakes.manifest.MAX_VALUES", most)
        assert len(read_manifest(folder / FILE)) == entries


@pytest.mark.slow
def test_columns_of_other_types_are_the_error_of_one_episode(folder):
    entries = list(ssduck.lake(folder).entries)
    name = f"{ENTITIES}/part-000000.parquet"
    rows = pq.read_table(folder / name, partitioning=None)
    texts = rows["tick"].cast(pa.string())
    rows = rows.set_column(rows.column_names.index("tick"), "tick", texts)
    write_parquet(rows, folder / name)
    checksum = zlib.crc32((folder / name).read_bytes())
    files = [replace(f, checksum=checksum) if f.name == name else f for f in entries[1].files]
    entries[1] = replace(entries[1], files=tuple(files))
    for asked in (entries, entries[1:]):
        forget_readers()
        ((_, answers),) = answer_locally(ProgramQuestion(PROGRAM), [asked], 1)
        assert [one.error is None for one in answers] == [e is not entries[1] for e in asked]


@pytest.mark.parametrize("table", ["ticks", "entities", "models/entities"])
def test_a_part_of_another_episode_is_an_error_though_the_manifest_knows_it(folder, table):
    name = "part-000000.parquet"
    ssduck.lake(folder)
    part = folder / f"{table}/world=sim/episode=1/{name}"
    part.write_bytes((folder / f"{table}/world=sim/episode=2/{name}").read_bytes())
    files = pq.read_table(folder / FILE).to_pylist()[1]["files"]
    (own,) = [file for file in files if file["name"] == part.relative_to(folder).as_posix()]
    status = part.stat()
    own |= {"size": status.st_size, "modified": status.st_mtime_ns}
    forged(folder, files=[{**own, "checksum": zlib.crc32(part.read_bytes())}, *_others(files, own)])
    errors = ask(folder)
    assert [number for number, error in errors.items() if error] == [1]
    assert "is another part, or of another record" in errors[1]


def _others(files, own):
    return [file for file in files if file is not own]


class CameraQuestion(ProgramQuestion):
    """Asks where the camera is that a picture would be taken with."""

    def answering(self, interpreter):
        return lambda present, _: list(present.worlds[0].camera.eye)


@pytest.mark.slow
def test_a_batch_has_the_recorded_camera_of_each_episode(folder, monkeypatch):
    eyes = {number: [1.0 + number % 2, 2.0, 3.0] for number in range(EPISODES)}
    for number, eye in eyes.items():
        file = folder / f"episodes/sim-{number}.json"
        camera = {"eye": eye, "target": [0.0, 0.0, 0.0], "fov": 40.0}
        file.write_text(json_text(json.loads(file.read_text()) | {"camera": camera}))
    shutil.rmtree(folder / "index")  # the summaries say that all have the default camera
    entries = ssduck.lake(folder).entries
    assert len({entry.group for entry in entries}) == 2
    monkeypatch.setattr("ssduck.lakes.workers.answer_by_itself", None)  # all are in a batch
    answers = answer_episodes(CameraQuestion(PROGRAM), entries)
    assert [json.loads(answer.text) for answer in answers] == list(eyes.values())


@pytest.mark.slow
def test_a_manifest_that_groups_other_cameras_changes_none(folder):
    file = folder / "episodes/sim-1.json"
    camera = {"eye": [5.0, 5.0, 5.0], "target": [0.0, 0.0, 0.0], "fov": 40.0}
    file.write_text(json_text(json.loads(file.read_text()) | {"camera": camera}))
    entries = ssduck.lake(folder).entries
    wrong = [replace(entry, group=entries[0].group) for entry in entries]
    answers = answer_episodes(CameraQuestion(PROGRAM), wrong)
    assert [json.loads(one.text) == [5.0, 5.0, 5.0] for one in answers] == [
        number == 1 for number in range(EPISODES)
    ]


@pytest.mark.parametrize("table", ["entities", "ticks"])
def test_a_part_of_too_many_rows_is_not_read_with_others(folder, monkeypatch, table):
    """The sums of the manifest are right, but the part claims more rows than a part has."""
    lake = ssduck.lake(folder)
    file = folder / f"{table}/world=sim/episode=1/part-000000.parquet"
    metadata = pq.read_metadata(file)
    most = metadata.num_rows * metadata.num_columns
    entry = next(one for one in lake.entries if one.episode == 1)
    run = FolderRun(folder, entry.world, entry.episode)
    (batched,) = EntryFiles(entry, run.key).parts(table)
    part = ReadPart(batched, batched.content())
    assert part.content == file.read_bytes()
    assert part.rows().num_rows == metadata.num_rows
    monkeypatch.setattr("ssduck.recording.stores.stored_columns.MAX_VALUES", most - 1)
    with pytest.raises(RecordError, match=f"claims {metadata.num_rows:,} rows, more than"):
        ReadPart(batched, part.content).rows()
