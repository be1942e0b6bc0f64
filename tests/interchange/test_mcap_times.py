"""Frames of MCAP files that are told of at times of their own, in other frames, and not for ever."""

import numpy as np
import pytest

import ssduck
from ssduck.errors import ArgumentError, RecordError
from ssduck.interchange import mcap_reader
from tests.support.command_line import answer

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra mcap is not installed")
pytestmark = pytest.mark.filterwarnings("ignore:.*tells of poses; its record has no")

MS = 10**6
# Some day of 2025, ns: a double has 238 ns there.
DAY = 1_764_000_000 * 10**9
# A quarter of a turn about z: w, x, y, z.
QUARTER = (0.5**0.5, 0.0, 0.0, 0.5**0.5)


def stamp(moment):
    from google.protobuf.timestamp_pb2 import Timestamp

    return None if moment is None else Timestamp(seconds=moment // 10**9, nanos=moment % 10**9)


def at(moment, child, place, parent="world", turn=(1.0, 0.0, 0.0, 0.0), logged=None):
    """Returns a transform, with a stamp unless the moment is None, and the time of its log, ns."""
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

    one = FrameTransform(timestamp=stamp(moment), parent_frame_id=parent, child_frame_id=child)
    one.translation.x, one.translation.y, one.translation.z = place
    one.rotation.w, one.rotation.x, one.rotation.y, one.rotation.z = turn
    return "/tf", moment, one, (moment or 0) if logged is None else logged


def scene(moment, gone=None, drawn=()):
    """Returns a change of the scene: what comes, or a deletion of an id or, for "*", of all."""
    from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    update = SceneUpdate()
    for id in drawn:
        update.entities.add(id=id, frame_id="world")
    if gone is not None:
        kind = SceneEntityDeletion.ALL if gone == "*" else SceneEntityDeletion.MATCHING_ID
        update.deletions.add(timestamp=stamp(moment), type=kind, id=gone.strip("*"))
    return "/markers", moment, update, moment


def log(file, messages):
    from mcap_protobuf.writer import Writer

    with file.open("wb") as stream, Writer(stream) as writer:
        for topic, _, message, logged in messages:
            writer.write_message(topic, message, log_time=logged, publish_time=logged)
    return file


def imported(tmp_path, messages, **options):
    """Returns the rows of a log's record: time, name, x, y, z, in the order of the ticks."""
    ssduck.import_poses(log(tmp_path / "log.mcap", messages), tmp_path / "r", **options)
    with ssduck.open(tmp_path / "r") as ss:
        return ss.sql(
            "SELECT time, name, x, y, z FROM entities_history ORDER BY tick, id"
        ).fetchall()


def cup(ks=range(1, 10)):
    return [at(DAY + 10 * k * MS, "cup", (0, 0, k / 100)) for k in ks]


OTHERS = {
    "told of once": [at(DAY, "table", (0, 0, 0))],
    "told of once, without a stamp": [at(None, "table", (0, 0, 0), logged=DAY)],
    "with a stamp of 0": [at(0, "table", (0, 0, 0), logged=DAY)],
    "at another rate": [at(DAY + (40 * k + 5) * MS, "table", (0, 0, 0)) for k in range(3)],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_each_frame_is_where_it_was_told_of_last(tmp_path, name):
    found = imported(tmp_path, [*OTHERS[name], *cup()])
    both = [(time, z) for time, frame, _, _, z in found if frame == "cup"]
    tables = [time for time, frame, *_ in found if frame == "table"]
    assert [z for _, z in both] == [k / 100 for k in range(1, 10)]
    assert {time for time, _ in both} <= set(tables)
    assert DAY / 1e9 <= min(tables) <= max(tables) == DAY / 1e9 + 0.09
    with ssduck.open(tmp_path / "r") as ss:
        assert ss.eval("distance(world.table, world.cup);") == 0.09


@pytest.mark.slow
def test_no_value_is_lost_and_each_is_the_last_one(tmp_path):
    """Three frames with times of their own, against a search in what was told."""
    generator = np.random.default_rng(7)
    told = {}
    for name, count in {"a": 60, "b": 25, "c": 3}.items():
        moments = np.sort(generator.choice(3_000, count, replace=False)).tolist()
        told[name] = [(m * MS, float(k)) for k, m in enumerate(moments)]
    messages = [at(m, n, (v, 0, 0), logged=5) for n, parts in told.items() for m, v in parts]
    found = imported(tmp_path, [m for m in messages if m[1]])
    for time, name, x, *_ in found:
        assert x == [v for m, v in told[name] if m <= round(time * 1e9)][-1]
    for name, parts in told.items():
        values = {x for _, each, x, *_ in found if each == name}
        assert values == {v for m, v in parts if m}
    assert len({time for time, *_ in found}) < 88  # messages at about one time are one tick


@pytest.mark.slow
def test_a_frame_ends_where_a_message_says_so(tmp_path):
    """By its id, with all that is in the scene, and until it comes again."""
    table = at(0, "table", (0, 0, 0))
    seconds = [k * 10**9 for k in range(7)]
    messages = [table, *(at(s, "hand", (0, 0, 1)) for s in seconds)]
    messages += [at(0, "cup", (1, 0, 0)), scene(0, drawn=["cup", "table", "arrow"])]
    messages += [scene(seconds[2], gone="cup"), at(seconds[3], "cup", (2, 0, 0))]
    messages += [scene(seconds[3], drawn=["cup"]), scene(seconds[5], gone="*")]
    found = imported(tmp_path, messages)
    cups = [(time, x) for time, name, x, *_ in found if name == "cup"]
    assert cups == [(0, 1), (1, 1), (3, 2), (4, 2)]
    assert [time for time, name, *_ in found if name == "table"] == [0, 1, 2, 3, 4]
    assert [time for time, name, *_ in found if name == "hand"] == [0, 1, 2, 3, 4, 5, 6]


@pytest.mark.slow
def test_a_grid_has_the_last_value_of_each_frame(tmp_path):
    messages = [*OTHERS["at another rate"], *cup()]
    found = imported(tmp_path, messages, rate=40)
    grid = [DAY + (5 + 25 * k) * MS for k in range(4)]
    assert [time for time, name, *_ in found if name == "table"] == [m / 1e9 for m in grid]
    cups = [(time, z) for time, name, _, _, z in found if name == "cup"]
    assert cups == [(m / 1e9, z) for m, z in zip(grid[1:], [0.03, 0.05, 0.08], strict=True)]


def test_the_command_has_the_grid(tmp_path):
    log(tmp_path / "log.mcap", cup())
    told = answer("import", str(tmp_path / "log.mcap"), "-o", str(tmp_path / "r"), "--rate", "50")
    assert told.startswith("5 ticks of 'world'")


@pytest.mark.parametrize(
    ("rate", "message"),
    [
        (0, "rate: 0 is no number of ticks per second"),
        ("fast", "rate: 'fast' is no number"),
        (1e12, "rate: at most 1e\\+09 ticks"),
        (1e9, "rate: 120,000,001 ticks of 2 frames are more than 100,000,000 poses"),
    ],
)
def test_wrong_rates(tmp_path, rate, message):
    with pytest.raises(ArgumentError, match=message):
        imported(tmp_path, cup([0, 12]), rate=rate)
    assert not (tmp_path / "r").exists()


def test_datasets_of_frames_have_no_rate(tmp_path):
    with pytest.raises(ArgumentError, match="rate: a dataset of LeRobot has frames per second"):
        ssduck.import_poses(tmp_path, tmp_path / "r", rate=10)


@pytest.mark.slow
def test_a_slow_grid_is_one_tick(tmp_path):
    assert len(imported(tmp_path, cup(), rate=1e-300)) == 1


def test_more_poses_than_a_file_may_have(tmp_path, monkeypatch):
    monkeypatch.setattr(mcap_reader, "MAX_POSES", 17)
    with pytest.raises(RecordError, match=r"9 ticks of 2 frames.*give the ticks per second, rate="):
        imported(tmp_path, cup())


@pytest.mark.slow
def test_portions_give_the_rows_of_one(tmp_path, monkeypatch):
    messages = [*OTHERS["at another rate"], *cup()]
    whole = imported(tmp_path, messages)
    monkeypatch.setattr(mcap_reader, "_AT_ONCE", 2)
    (tmp_path / "again").mkdir()
    assert imported(tmp_path / "again", messages) == whole


@pytest.mark.slow
def test_stamps_of_a_simulation_begin_with_0(tmp_path):
    """Though its log has the time of the day."""
    messages = [at(k * MS, "cup", (k, 0, 0), logged=DAY + k * MS) for k in range(3)]
    messages.append(at(None, "table", (0, 0, 0), logged=DAY))
    found = imported(tmp_path, messages)
    assert [(time, x) for time, name, x, *_ in found if name == "cup"] == [
        (0, 0), (0.001, 1), (0.002, 2)
    ]  # fmt: skip
    assert [time for time, name, *_ in found if name == "table"] == [0, 0.001, 0.002]


@pytest.mark.slow
def test_without_stamps_the_log_has_the_times(tmp_path):
    found = imported(tmp_path, [at(None, "cup", (k, 0, 0), logged=k * MS) for k in range(4)])
    assert [(time, x) for time, _, x, *_ in found] == [(k / 1000, k) for k in range(4)]


@pytest.mark.slow
def test_stamps_are_whole_nanoseconds(tmp_path):
    """Also where doubles of seconds are the same."""
    found = imported(tmp_path, [at(DAY + 100 * k, "cup", (k, 0, 0)) for k in range(4)])
    assert [x for _, _, x, *_ in found] == [0, 1, 2, 3]
    assert found[0][0] == found[1][0] == DAY / 1e9


def matrix(place, angle):
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    turn[:3, 3] = place
    return turn


@pytest.mark.slow
def test_frames_in_frames_are_placed_in_the_world(tmp_path):
    """A chain of seven whose links turn, each told of at times of its own, against matrices."""
    generator, told, messages = np.random.default_rng(3), [], []
    for link in range(7):
        for moment in (np.arange(8) * (link + 1) * 10 + link).tolist():
            place, angle = generator.normal(size=3), generator.uniform(-3, 3)
            told.append((link, moment, matrix(place, angle)))
            turn = (2 * np.cos(angle / 2), 0, 0, 2 * np.sin(angle / 2))  # of any length
            parent = f"link{link - 1}" if link else "map"
            messages.append(at(moment * MS or None, f"link{link}", place, parent, turn))
    found = imported(tmp_path, messages)
    assert len(found) > 150
    for time, name, *place in found:
        chain = np.eye(4)
        for link in range(int(name.removeprefix("link")) + 1):
            known = [m for k, moment, m in told if k == link and moment <= round(time * 1000)]
            chain = chain @ known[-1]
        assert place == pytest.approx(chain[:3, 3].tolist(), abs=1e-12)
    seen = [time for time, name, *_ in found if name == "link6"]
    assert min(seen) >= 0.006  # not before all frames that it is in


@pytest.mark.slow
def test_what_is_in_a_frame_that_is_gone_is_gone(tmp_path):
    messages = [at(0, "tray", (1, 0, 0), turn=QUARTER), at(0, "cup", (0.5, 0, 0), "tray")]
    messages += [at(k * 10**9, "lamp", (0, 0, 2)) for k in range(4)]
    messages += [scene(2 * 10**9, gone="tray"), at(3 * 10**9, "cup", (9, 0, 0))]
    found = imported(tmp_path, messages)
    cups = [(time, x, pytest.approx(y)) for time, name, x, y, _ in found if name == "cup"]
    assert cups == [(0, 1, 0.5), (1, 1, 0.5), (3, 9, 0)]  # then in another frame


def test_frames_in_a_circle_are_an_error(tmp_path):
    (tmp_path / "whole").mkdir()
    both = [at(0, "a", (0, 0, 0), "b"), at(0, "b", (0, 0, 0), "a")]
    with pytest.raises(RecordError, match="each frame is relative to another one, in a circle"):
        imported(tmp_path / "whole", both)
    told = [at(0, "a", (0, 0, 0)), at(0, "b", (0, 0, 0), "a"), at(10**9, "a", (0, 0, 0), "b")]
    with pytest.raises(RecordError, match="at 1 s, 'a' is relative to itself, through other"):
        imported(tmp_path, told)
    assert not (tmp_path / "r").exists()


@pytest.mark.slow
def test_two_poses_of_a_frame_at_one_time_are_told_of(tmp_path):
    same, other = at(0, "cup", (1, 0, 0)), at(10**9, "cup", (2, 0, 0))
    with pytest.warns(UserWarning, match="not read: 1 pose before another one of the same frame"):
        found = imported(tmp_path, [same, same, other, at(10**9, "cup", (3, 0, 0))])
    assert [(time, x) for time, _, x, *_ in found] == [(0, 1), (1, 3)]


@pytest.mark.slow
def test_shapes_are_given_for_some_frames(tmp_path):
    """And an entity is there when all of its links are."""
    messages = [at(0, "arm", (0, 0, 0)), at(0, "lamp", (0, 0, 0)), at(10**9, "lamp", (1, 0, 0))]
    messages += [at(10**9, "arm.hand", (1, 0, 0), "arm"), at(0, "shelf", (4, 0, 0))]
    entities = {"arm": {"links": {"hand": {"sphere": 0.1}}}, "shelf": {"box": [1, 1, 1]}}
    found = imported(tmp_path, messages, entities=entities)
    assert [(time, name) for time, name, *_ in found] == [
        (0, "shelf"), (0, "lamp"), (1, "arm"), (1, "shelf"), (1, "lamp")
    ]  # fmt: skip
    with pytest.raises(ArgumentError, match="does not tell of 'shelv'; did you mean 'shelf'"):
        imported(tmp_path, messages, entities={"shelv": {}})


@pytest.mark.slow
@pytest.mark.parametrize("rate", [None, 1000])
def test_ticks_at_one_time_are_imported_again(tmp_path, rate):
    """A tick after a step and one after a hand moved something; and what was not there."""
    rows = {
        "tick": [1, 1, 2, 3, 3, 4],
        "time": [0.0, 0.0, 0.0, 0.1, 0.1, 0.1],
        "name": ["cup", "table", "cup", "cup", "table", "cup"],
        "x": [0.0, 5.0, 1.0, 2.0, 6.0, 3.0],
        "y": [0.0] * 6,
        "z": [0.0] * 6,
    }
    import pyarrow as pa

    (tmp_path / "own").mkdir()
    place = tmp_path / "own" / "r"
    ssduck.write_record(place, ["cup", "table"], pa.table(rows))
    answer("export", str(place), "-o", str(tmp_path / "out"), "--format", "mcap")
    ssduck.import_poses(tmp_path / "out/world-0.mcap", tmp_path / "r", rate=rate)
    with ssduck.open(tmp_path / "r") as ss:
        found = ss.sql("SELECT tick, time, name, x FROM entities_history ORDER BY tick, id")
        expected = list(zip(*(rows[name] for name in ("tick", "time", "name", "x")), strict=True))
        if rate is None:
            assert found.fetchall() == expected
        else:  # the last of each time
            last = [row[1:] for row in found.fetchall() if row[1] in (0.0, 0.1)]
            assert last == [(0.0, "cup", 1.0), (0.1, "cup", 3.0)]


# -- messages and chunks ----------------------------------------------------------------------

PLAIN = {"parent_frame_id": "map", "child_frame_id": "cup", "rotation": {"w": 1.0}}


def write_transforms(file, *transforms, compression="ZSTD", **about):
    """Writes poses of frames, one a second."""
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from mcap.writer import CompressionType, Writer
    from mcap_protobuf.schema import register_schema

    with file.open("wb") as stream:
        writer = Writer(stream, compression=getattr(CompressionType, compression))
        writer.start()
        schema = register_schema(writer, FrameTransform)
        channel = writer.register_channel("/tf", "protobuf", schema)
        if about:
            writer.add_metadata("ssduck", about)
        for second, transform in enumerate(transforms):
            moved = FrameTransform(**transform)
            moved.timestamp.seconds = second
            writer.add_message(channel, second, moved.SerializeToString(), second)
        writer.finish()
    return file


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4", "NONE"])
def test_poses_in_chunks_are_read(tmp_path, compression):
    file = write_transforms(tmp_path / "a.mcap", *[PLAIN] * 3, compression=compression)
    (episode,) = ssduck.import_poses(file, tmp_path / "r")
    assert episode.ticks == 3


@pytest.mark.parametrize(
    ("change", "about", "message"),
    [
        ({"rotation": {}}, {}, "the quaternion 0, 0, 0, 0"),
        ({"child_frame_id": ""}, {}, "a frame without a name"),
        ({"child_frame_id": "a\x07"}, {}, "'a\\\\x07'"),
        ({}, {"world": '"Memory"'}, "a world cannot have the name 'Memory'"),
    ],
)
def test_a_message_that_is_no_pose_is_an_error_of_the_file(tmp_path, change, about, message):
    file = write_transforms(tmp_path / "a.mcap", PLAIN | change, **about)
    with pytest.raises(RecordError, match=f"a.mcap.*{message}"):
        ssduck.import_poses(file, tmp_path / "r")
    assert not (tmp_path / "r").exists()
