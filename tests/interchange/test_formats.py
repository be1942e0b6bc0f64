"""Records in the formats of other tools, read back by the libraries of these, and imported."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pybullet
import pytest

import ssduck
from ssduck.errors import ArgumentError, RecordError, SelectScriptError
from ssduck.interchange.conversion import write_runs
from ssduck.interchange.lerobot import JOINTS, POSES, write_dataset
from ssduck.interchange.mcap import METADATA
from ssduck.interchange.mcap import TICKS as TICKS_TOPIC
from ssduck.interchange.motion import motion_of
from ssduck.interpreter.archives import folder_run
from ssduck.recording.folder_episodes import runs_in
from ssduck.recording.stores.parquet_layout import FolderRun
from ssduck.schema import POSE
from tests.support.command_line import answer, ssduck_
from tests.support.recorded import ALL, live_lab, lively

TICKS = 49


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    """Two episodes of a board, balls, and an arm whose joint moves, each tick at 1/240 s."""
    place = tmp_path_factory.mktemp("formats") / "r"
    for task in ("drop", "swing"):
        client = pybullet.connect(pybullet.DIRECT)
        with ssduck.Interpreter(recording=None) as ss:
            world = ss.add_variable("lab", ssduck.World.attach(client, names=lively(client)))
            with ss.record_to(place, recording=ALL, tags={"task": task, "success": task == "drop"}):
                world.step(TICKS - 1)
        pybullet.disconnect(client)
    return place


def rows(place, episode=None):
    with ssduck.open(place, episode=episode) as ss:
        names = ", ".join(POSE)
        links = f"SELECT time, full_name, {names} FROM links_history WHERE link > 0"
        return ss.sql(
            f"SELECT time, name, {names} FROM entities_history UNION ALL {links} ORDER BY ALL"
        ).fetchall()


# -- LeRobot ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def dataset(record, tmp_path_factory):
    place = tmp_path_factory.mktemp("lerobot") / "d"
    return write_dataset(place, map(motion_of, runs_in(record)))


def test_a_dataset_has_the_published_layout(record, dataset):
    """Its files are those that LeRobotDatasetMetadata 3.0 loads, with the values that it reads."""
    info = json.loads((dataset / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["splits"]) == (
        "v3.0",
        240,
        {"train": "0:2"},
    )
    totals = (info["total_episodes"], info["total_frames"], info["total_tasks"])
    assert totals == (2, 2 * TICKS, 2)
    tasks = pd.read_parquet(dataset / "meta/tasks.parquet")
    assert tasks.index.name == "task"
    assert tasks["task_index"].to_dict() == {"drop": 0, "swing": 1}
    episodes = pq.read_table(dataset / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [e["tasks"] for e in episodes] == [["drop"], ["swing"]]
    spans = [(e["dataset_from_index"], e["dataset_to_index"], e["length"]) for e in episodes]
    assert spans == [(0, TICKS, TICKS), (TICKS, 2 * TICKS, TICKS)]
    path = info["data_path"].format(chunk_index=0, file_index=0)
    file = pq.ParquetFile(dataset / path)
    assert [file.metadata.row_group(n).num_rows for n in range(file.num_row_groups)] == [TICKS] * 2
    frames = file.read().to_pandas()
    assert list(frames["index"]) == list(range(2 * TICKS))
    assert list(frames["frame_index"]) == [*range(TICKS)] * 2
    # LeRobot checks that timestamps differ by 1 / fps within 1e-4 s.
    for _, part in frames.groupby("episode_index"):
        assert np.abs(np.diff(part["timestamp"]) - 1 / 240).max() < 1e-4
    for name, feature in info["features"].items():
        values = np.stack(frames[name].to_numpy())
        assert list(values.shape[1:] or (1,)) == feature["shape"]
        assert str(values.dtype) == feature["dtype"]
        assert feature["names"] is None or len(feature["names"]) == feature["shape"][0]
    motion = motion_of(runs_in(record)[1])
    values = np.stack(frames[POSES].to_numpy())[TICKS:]
    assert (values == motion.poses.reshape(TICKS, -1)).all()  # to the last bit
    with ssduck.open(record, episode=1) as ss:
        angles = ss.sql("SELECT position FROM joints_history ORDER BY tick").fetchall()
    assert [(angle,) for angle in np.stack(frames[JOINTS].to_numpy())[TICKS:].tolist()] == angles
    assert info["features"][JOINTS]["names"] == list(motion.joints)


def test_statistics_are_those_of_the_frames(dataset):
    frames = pq.read_table(dataset / "data/chunk-000/file-000.parquet").to_pandas()
    stats = json.loads((dataset / "meta/stats.json").read_text())
    episodes = pq.read_table(dataset / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for name, told in stats.items():
        values = np.stack(frames[name].to_numpy()).reshape(2 * TICKS, -1).astype(float)
        parts = [(told, values)]
        for number, episode in enumerate(episodes):
            kinds = ("min", "max", "mean", "std", "count", "q50")
            one = {kind: episode[f"stats/{name}/{kind}"] for kind in kinds}
            part = values[number * TICKS : (number + 1) * TICKS]
            parts.append((one, part))
            assert one["q50"] == pytest.approx(np.median(part, axis=0), abs=1e-6)
        for one, part in parts:
            assert one["count"] == [len(part)]
            for kind in ("min", "max", "mean", "std"):
                expected = getattr(np, kind)(part, axis=0)
                assert one[kind] == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.slow
def test_a_dataset_is_imported_again(record, dataset, tmp_path):
    with pytest.warns(UserWarning, match="has no shapes.*; not read: observation.state"):
        episodes = ssduck.import_poses(dataset, tmp_path / "r")
    assert [episode.world for episode in episodes] == ["lab", "lab"]  # as it was recorded
    assert [episode.tags for episode in episodes] == [
        {"task": "drop", "success": True},
        {"task": "swing", "success": False},
    ]
    with ssduck.open(tmp_path / "r", episode=1) as ss:
        found = ss.sql(f"SELECT time, name, {', '.join(POSE)} FROM entities_history ORDER BY ALL")
        found = found.fetchall()
    expected = rows(record, 1)
    assert [row[1:] for row in found] == [row[1:] for row in expected]
    assert [row[0] for row in found] == pytest.approx([row[0] for row in expected], abs=1e-12)


def test_frames_per_second_choose_ticks(record, tmp_path):
    (run, _) = runs_in(record)
    write_dataset(tmp_path / "d", [motion_of(run)], fps=30)
    frames = pq.read_table(tmp_path / "d/data/chunk-000/file-000.parquet").to_pandas()
    values = np.stack(frames[POSES].to_numpy())
    assert (values == motion_of(run).poses[::8].reshape(7, -1)).all()


@pytest.mark.slow
def test_what_is_no_dataset_is_an_error(record, tmp_path):
    uneven = np.array([0.0, 0.1, 0.2, 0.35])
    ssduck.write_record(tmp_path / "a", ["cup"], np.zeros((4, 1, 3)), uneven)
    ssduck.write_record(tmp_path / "a", ["cup"], np.zeros((3, 1, 3)), [0, 0.1, 0.2])
    ssduck.write_record(tmp_path / "a", ["pot"], np.zeros((3, 1, 3)), [0, 0.1, 0.2])
    ssduck.write_record(tmp_path / "a", ["cup"], np.zeros((1, 1, 3)), [0])
    ssduck.write_record(tmp_path / "a", ["cup"], np.zeros((3, 1, 3)), [0, 0.05, 0.1])
    ssduck.write_record(tmp_path / "a", ["cup"], np.zeros((2, 1, 3)), [0, 5e-324])
    cases = [
        ([0], None, "not evenly spaced"),
        ([3], None, "has one tick"),
        ([5], None, "no fraction of 1 s"),
        ([1, 4], None, "has 20 ticks per second, and the episodes before it 10"),
        ([1, 0], None, "not evenly spaced"),
        ([1, 2], None, "has other observation.environment_state .* such as 'cup.qw'"),
        ([], None, "there is no episode"),
    ]
    runs = runs_in(tmp_path / "a")
    for chosen, fps, message in cases:
        with pytest.raises(ArgumentError, match=message):
            write_dataset(tmp_path / "d", [motion_of(runs[n]) for n in chosen], fps)
        assert not (tmp_path / "d").exists()
    write_dataset(tmp_path / "e", [motion_of(runs[n]) for n in (0, 3)], 10)
    frames = pq.read_table(tmp_path / "e/data/chunk-000/file-000.parquet")
    assert frames["episode_index"].to_pylist() == [0, 0, 0, 0, 1]
    with pytest.raises(RecordError, match="is not empty"):
        write_dataset(tmp_path / "e", [motion_of(runs[0])], 10)


@pytest.mark.slow
def test_an_entity_that_comes_later_is_no_dataset(client, tmp_path):
    with ssduck.Interpreter(recording=ALL) as ss:
        live_lab(ss, client)
        ss.export(tmp_path / "r")
    pybullet.disconnect(client)
    with pytest.raises(ArgumentError, match="has no pose at"):
        write_dataset(tmp_path / "d", map(motion_of, runs_in(tmp_path / "r")), 120)
    answer("export", str(tmp_path / "r"), "-o", str(tmp_path / "d"), "--format", "lerobot",
           "--entities", "board", "--entities", "other", "--fps", "120")  # fmt: skip
    info = json.loads((tmp_path / "d/meta/info.json").read_text())
    assert info["features"][POSES]["shape"] == [14]


# -- MCAP ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def mcap_file(record, tmp_path_factory):
    pytest.importorskip("foxglove_schemas_protobuf", reason="the extra mcap is not installed")
    place = tmp_path_factory.mktemp("mcap") / "run.mcap"
    assert write_runs([FolderRun(record, "lab", 0)], place, "mcap") == [place]
    return place


def messages(file, topic):
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [(m.log_time, told) for _, _, m, told in reader.iter_decoded_messages([topic])]


def test_doubles_of_an_mcap_file_are_those_of_the_record(record, mcap_file):
    motion = motion_of(FolderRun(record, "lab", 0))
    told = messages(mcap_file, "/tf")
    assert [moment for moment, _ in told] == [round(t * 1e9) for t in motion.times]
    for (moment, transforms), poses in zip(told, motion.poses, strict=True):
        assert [t.child_frame_id for t in transforms.transforms] == motion.names
        for one, pose in zip(transforms.transforms, poses.tolist(), strict=True):
            p, q = one.translation, one.rotation
            assert [p.x, p.y, p.z, q.w, q.x, q.y, q.z] == pose
            assert one.parent_frame_id == "world"
            assert one.timestamp.seconds * 10**9 + one.timestamp.nanos == moment


FORMS = {
    "box": {"box": [1, 2, 4]},
    "sphere": {"sphere": 0.5},
    "ellipsoid": {"ellipsoid": [0.5, 1, 2]},
    "cylinder": {"cylinder": [0.5, 2], "position": [0, 0, 1], "orientation": [0, 1, 0, 0]},
    "capsule": {"capsule": [0.5, 2]},
    "hull": {"hull": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]},
    "plane": {"plane": [0, 0, 1]},
    "none": {},
}


@pytest.fixture(scope="module")
def forms(tmp_path_factory):
    place = tmp_path_factory.mktemp("forms") / "r"
    ssduck.write_record(place, FORMS, {name: [0.0, 0, 1] for name in FORMS}, [0.0, 1.0])
    return folder_run(place, None, None)


def test_each_form_of_shapes_is_in_the_scene(forms, tmp_path):
    pytest.importorskip("foxglove_schemas_protobuf", reason="the extra mcap is not installed")
    write_runs([forms], tmp_path / "forms.mcap", "mcap")
    ((_, update),) = messages(tmp_path / "forms.mcap", "/scene")
    entities = {entity.id: entity for entity in update.entities}

    def size(primitive):
        return [primitive.size.x, primitive.size.y, primitive.size.z]

    assert size(entities["box"].cubes[0]) == [1, 2, 4]
    assert size(entities["sphere"].spheres[0]) == [1, 1, 1]
    assert size(entities["ellipsoid"].spheres[0]) == [1, 2, 4]
    (cylinder,) = entities["cylinder"].cylinders
    assert (size(cylinder), cylinder.bottom_scale, cylinder.top_scale) == ([1, 1, 2], 1, 1)
    place, turn = cylinder.pose.position, cylinder.pose.orientation
    assert [place.z, turn.w, turn.x, turn.y, turn.z] == [1, 0, 1, 0, 0]
    boxes = {"capsule": [1, 1, 3], "hull": [1, 1, 1], "plane": [20, 20, 0]}
    for name, expected in boxes.items():
        (triangles,) = entities[name].triangles
        points = np.array([[p.x, p.y, p.z] for p in triangles.points])
        assert np.ptp(points, axis=0) == pytest.approx(expected, abs=1e-9)
        assert max(triangles.indices) == len(points) - 1
        assert len(triangles.indices) % 3 == 0
    assert all(entity.frame_locked and entity.frame_id == id for id, entity in entities.items())
    drawn = entities["none"]
    assert not [*drawn.cubes, *drawn.spheres, *drawn.cylinders, *drawn.triangles]


@pytest.mark.slow
def test_entities_that_go_are_deleted_from_the_scene(client, tmp_path):
    pytest.importorskip("foxglove_schemas_protobuf", reason="the extra mcap is not installed")
    with ssduck.Interpreter(recording=ALL) as ss:
        live_lab(ss, client)
        ss.export(tmp_path / "r")
    pybullet.disconnect(client)
    answer("export", str(tmp_path / "r"), "-o", str(tmp_path / "out"), "--format", "mcap")
    updates = messages(tmp_path / "out" / "lab-0.mcap", "/scene")
    assert [[d.id for d in update.deletions] for _, update in updates][:2] == [[], ["ball"]]
    assert len(updates[2][1].entities) == 1


@pytest.mark.slow
def test_an_mcap_file_is_imported_again(record, mcap_file, tmp_path):
    with pytest.warns(UserWarning, match="tells of poses; its record has no shapes"):
        (episode,) = ssduck.import_poses(mcap_file, tmp_path / "r")
    assert (episode.world, episode.tags) == ("lab", {"task": "drop", "success": True})
    assert rows(tmp_path / "r") == rows(record, 0)  # links and times, to the last bit
    shapes = {
        "board": {"box": [4, 4, 0.1]},
        "ball": {"sphere": 0.1},
        "other": {"sphere": 0.1},
        "arm": {"links": {"link1": {}}},
    }
    with pytest.warns(UserWarning, match="its record has no contacts"):
        ssduck.import_poses(mcap_file, tmp_path / "s", entities=shapes)
    asked = "SELECT round(clearance(lab.board, this), 9) FROM lab{} WHERE id == 'ball' AS list;"
    with ssduck.open(tmp_path / "s") as imported, ssduck.open(record, episode=0) as original:
        assert imported.eval(asked) == original.eval(asked)


@pytest.mark.slow
def test_ticks_of_one_nanosecond_keep_their_times(tmp_path):
    pytest.importorskip("foxglove_schemas_protobuf", reason="the extra mcap is not installed")
    times = [0.0, 1e-10, 2e-10, 1.0, 1.0 + 4e-16, 1.5]
    poses = np.arange(3.0 * len(times)).reshape(-1, 1, 3)
    ssduck.write_record(tmp_path / "r", ["can"], poses, times, world="lab")
    write_runs(runs_in(tmp_path / "r"), tmp_path / "out.mcap", "mcap")
    with pytest.warns(UserWarning, match="its record has no shapes"):
        ssduck.import_poses(tmp_path / "out.mcap", tmp_path / "again")
    with ssduck.open(tmp_path / "again") as ss:
        assert ss.eval("SELECT time FROM lab{} AS list;") == times
        assert ss.eval("SELECT x FROM lab{} AS list;") == poses[:, 0, 0].tolist()


@pytest.mark.parametrize("time", [-0.5, 1e10])
def test_times_that_mcap_has_not_are_an_error(tmp_path, time):
    pytest.importorskip("foxglove_schemas_protobuf", reason="the extra mcap is not installed")
    ssduck.write_record(tmp_path / "r", ["cup"], np.zeros((1, 1, 3)), [time])
    with pytest.raises(ArgumentError, match=r"a tick at .* s: times in an MCAP file are from 0 s"):
        write_runs(runs_in(tmp_path / "r"), tmp_path / "out.mcap", "mcap")
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.slow
def test_files_of_others(tmp_path):
    """Poses by topics and transforms are read; other topics are named."""
    pytest.importorskip("foxglove_schemas_protobuf", reason="the extra mcap is not installed")
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.Log_pb2 import Log
    from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
    from mcap_protobuf.writer import Writer

    def write(name, parents):
        with (tmp_path / name).open("wb") as stream, Writer(stream) as writer:
            for second in range(3):
                pose = PoseInFrame(frame_id=parents[0])
                pose.timestamp.seconds = second
                pose.pose.position.x, pose.pose.orientation.w = second / 3, 1.0
                writer.write_message("/cup", pose, second, second)
                parent = parents[min(second + 1, len(parents) - 1)]
                moved = FrameTransform(parent_frame_id=parent, child_frame_id="hand")
                moved.timestamp.seconds = second
                moved.translation.z, moved.rotation.w = second / 7, 1.0
                writer.write_message("/tf", moved, second, second)
                writer.write_message("/log", Log(message="x"), second, second)
        return tmp_path / name

    with pytest.warns(UserWarning, match="not read: /log"):
        ssduck.import_poses(write("a.mcap", ("map", "map")), tmp_path / "r")
    with ssduck.open(tmp_path / "r") as ss:
        found = ss.sql("SELECT name, time, x, z FROM entities_history ORDER BY ALL").fetchall()
    hand = [("hand", float(n), 0.0, n / 7) for n in range(3)]
    assert found == [("cup", float(n), n / 3, 0.0) for n in range(3)] + hand
    for name, parents in {"b": ("map", "base"), "changed": ("map", "base", "map")}.items():
        with pytest.raises(RecordError, match=r"'cup' is relative to 'map', and 'hand' to 'base'"):
            ssduck.import_poses(write(f"{name}.mcap", parents), tmp_path / "s")
    cut = write("d.mcap", ("map", "map"))
    for content in (b"not MCAP", cut.read_bytes()[:200]):
        cut.write_bytes(content)
        with pytest.raises(RecordError, match="cannot be read as an MCAP file"):
            ssduck.import_poses(cut, tmp_path / "s")
    assert not (tmp_path / "s").exists()


# (what a stranger's file says, words of the error)
FORGED_MCAP = [
    ("tags", b"[1]", "its tags are no object"),
    ("tags", b"[" * 100_000, "cannot be read as an MCAP file"),
    ("ticks", b"[1]", "cannot be read as an MCAP file"),
    ("ticks", b'{"time": [1]}', "cannot be read as an MCAP file"),
    ("ticks", b'{"time": 1' + b"0" * 400 + b"}", "cannot be read as an MCAP file"),
    ("ticks", b"[" * 100_000, "cannot be read as an MCAP file"),
    ("seconds", 1 << 62, "cannot be read as an MCAP file"),
]


@pytest.mark.parametrize(("part", "content", "message"), FORGED_MCAP)
def test_a_forged_mcap_file_is_an_error(tmp_path, part, content, message):
    pytest.importorskip("foxglove_schemas_protobuf", reason="the extra mcap is not installed")
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from mcap_protobuf.writer import Writer

    with (tmp_path / "a.mcap").open("wb") as stream, Writer(stream) as writer:
        plain = writer._writer
        if part == "tags":
            plain.add_metadata(METADATA, {"tags": content.decode()})
        if part == "ticks":
            schema = plain.register_schema("tick", "jsonschema", b"{}")
            channel = plain.register_channel(TICKS_TOPIC, "json", schema)
            plain.add_message(channel, 0, content, 0)
        moved = FrameTransform(parent_frame_id="map", child_frame_id="hand")
        moved.timestamp.seconds, moved.rotation.w = content if part == "seconds" else 0, 1.0
        writer.write_message("/tf", moved, 0, 0)
    with pytest.raises(RecordError, match=message):
        ssduck.import_poses(tmp_path / "a.mcap", tmp_path / "r")
    assert not (tmp_path / "r").exists()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*tells of poses")
def test_a_damaged_mcap_file_has_its_poses_or_is_an_error(record, mcap_file, tmp_path):
    content, right, errors = mcap_file.read_bytes(), rows(record, 0), 0
    for number in range(20):
        damaged = bytearray(content)
        damaged[len(content) * number // 20 + 9] ^= 255
        (tmp_path / "a.mcap").write_bytes(damaged)
        try:
            ssduck.import_poses(tmp_path / "a.mcap", tmp_path / f"{number}")
        except RecordError as error:
            assert "cannot be read as an MCAP file" in error.message
            errors += 1
        else:
            assert rows(tmp_path / f"{number}") == right
    assert errors > 10  # the index is not read


def _info(**values):
    def change(dataset):
        content = json.loads((dataset / "meta/info.json").read_text()) | values
        (dataset / "meta/info.json").write_text(json.dumps(content))

    return change


def _tags(text):
    def change(dataset):
        (file,) = (dataset / "meta/episodes").glob("*/*.parquet")
        about = pq.read_table(file).to_pylist()
        about[0]["ssduck/tags"] = text
        pq.write_table(pa.Table.from_pylist(about), file)

    return change


DATA, ABOUT = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"
FORGED_DATASETS = {
    "no file": (_info(data_path="../outside"), "no such file"),
    "features": (_info(features=[1]), "tells of no named frames"),
    "tags": (_tags("[1]"), "its tags are no object"),
}


@pytest.mark.parametrize("name", FORGED_DATASETS)
def test_a_forged_dataset_is_an_error(dataset, tmp_path, name):
    change, message = FORGED_DATASETS[name]
    place = Path(shutil.copytree(dataset, tmp_path / "d"))
    change(place)
    with pytest.raises(RecordError, match=re.escape(message)):
        ssduck.import_poses(place, tmp_path / "r")
    assert not (tmp_path / "r").exists()


# -- Rerun --------------------------------------------------------------------------------------


def test_a_recording_of_rerun(record, tmp_path):
    pytest.importorskip("rerun", reason="the extra rerun is not installed")
    chunk = pytest.importorskip("rerun.chunk", reason="this rerun-sdk reads no files")
    motion = motion_of(FolderRun(record, "lab", 0))
    (file,) = write_runs([motion.run], tmp_path / "run.rrd", "rrd")
    found = []
    for part in chunk.RrdReader(str(file)).stream().to_chunks():
        rows = part.to_record_batch()
        name = "Transform3D:translation"
        if str(part.entity_path) == "/world/ball" and name in rows.schema.names:
            found += [point[0] for point in rows[name].to_pylist()]
    assert np.array(found) == pytest.approx(motion.poses[:, 1, :3], rel=1e-6)  # of 32 bits


def test_each_form_of_shapes_is_in_a_recording_of_rerun(forms, tmp_path):
    pytest.importorskip("rerun", reason="the extra rerun is not installed")
    chunk = pytest.importorskip("rerun.chunk", reason="this rerun-sdk reads no files")
    (file,) = write_runs([forms], tmp_path / "forms.rrd", "rrd")
    parts = list(chunk.RrdReader(str(file)).stream().to_chunks())
    drawn = {str(part.entity_path): " ".join(part.to_record_batch().schema.names) for part in parts}
    kinds = {
        "box": "Boxes3D",
        "sphere": "Ellipsoids3D",
        "ellipsoid": "Ellipsoids3D",
        "cylinder": "Cylinders3D",
        "capsule": "Mesh3D",
        "hull": "Mesh3D",
        "plane": "Mesh3D",
    }
    for name, kind in kinds.items():
        assert kind in drawn[f"/world/{name}/shape_0"]
    assert "/world/none/shape_0" not in drawn


# -- the commands -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # the command writes them
def test_the_commands_export_and_import(record, tmp_path):
    out = str(tmp_path / "d")
    assert answer("export", str(record), "-o", out, "--format", "lerobot") == f"{out}\n"
    answer("export", str(record), "-o", out + "1", "--format", "lerobot", "--episode", "1")
    info = json.loads((tmp_path / "d1/meta/info.json").read_text())
    assert (info["total_episodes"], info["total_frames"]) == (1, TICKS)
    result = ssduck_("import", out, "-o", str(tmp_path / "r"), "--world", "lab")
    lines = result.stdout.splitlines()
    assert lines == [f"49 ticks of 'lab': episode {n} in {tmp_path / 'r'}" for n in (0, 1)]
    assert result.stderr.startswith("warning: ")


@pytest.mark.slow
def test_a_part_of_a_record_in_a_file_is_exported(record, tmp_path):
    answer("export", str(record), "-o", str(tmp_path / "d"), "--format", "lerobot",
           "--entities", "ball", "--start", "0.05", "--end", "0.1")  # fmt: skip
    info = json.loads((tmp_path / "d/meta/info.json").read_text())
    assert (info["total_frames"], info["features"][POSES]["shape"]) == (2 * 13, [7])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--format", "lerbot"], "did you mean 'lerobot'"),
        (["--format", "mcap", "--fps", "30"], "frames per second are for lerobot"),
        (["--fps", "30"], "--fps is for lerobot"),
        (["--format", "mcap", "--pairs", "1"], "only records have a table of pairs"),
        (["--format", "mcap", "--episode", "7"], "no such episode"),
    ],
)
def test_wrong_exports(record, tmp_path, arguments, message):
    try:
        result = ssduck_("export", str(record), "-o", str(tmp_path / "x"), *arguments)
    except SelectScriptError as error:
        assert message in str(error)
    else:
        assert result.exit_code != 0
        assert message in result.stderr
    assert not (tmp_path / "x").exists()


def test_two_episodes_are_no_file(record, tmp_path):
    message = r"there are 2: choose one \(--world, --episode\), or name a folder"
    with pytest.raises(ArgumentError, match=message):
        write_runs(runs_in(record), tmp_path / "x.mcap", "mcap")


def test_a_wrong_format_names_the_right_ones(record, tmp_path):
    with pytest.raises(ArgumentError, match="choose one of lerobot, mcap, rrd"):
        write_runs(runs_in(record), tmp_path / "x", "foo")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"codebase_version": "v2.1"}, "version 'v2.1'"),
        ({"codebase_version": "v3.0", "features": {"action": {"names": ["a"]}}}, "its features are action"),
        ({"codebase_version": "v3.0"}, "tells of no named frames"),
    ],
)  # fmt: skip
def test_other_datasets_are_errors(tmp_path, content, message):
    (tmp_path / "d/meta").mkdir(parents=True)
    (tmp_path / "d/meta/info.json").write_text(json.dumps(content))
    with pytest.raises(RecordError, match=message):
        ssduck.import_poses(tmp_path / "d", tmp_path / "r")
    with pytest.raises(RecordError, match="there is no file or folder"):
        ssduck.import_poses(tmp_path / "none", tmp_path / "r")
