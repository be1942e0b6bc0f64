"""What a dataset of LeRobot tells twice is the same twice, or an error."""

import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck.errors import RecordError

pytestmark = pytest.mark.filterwarnings("ignore:.*tells of poses; its record has no")

FPS, COUNT = 10, 5
DATA, ABOUT = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"
INFO = {
    "codebase_version": "v3.0",
    "fps": FPS,
    "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "features": {"p": {"names": ["cup.x", "cup.y", "cup.z"]}, "q": {"names": ["gripper"]}},
}
# The cup is at the height of its frame's number, so that a wrong order shows.
ROWS = {
    "p": [[0.5, -1.0, float(frame)] for frame in range(COUNT)],
    "q": [9.0] * COUNT,
    "timestamp": [frame / FPS for frame in range(COUNT)],
    "frame_index": [*range(COUNT)],
    "episode_index": [0] * COUNT,
}
EPISODE = {"episode_index": 0, "data/chunk_index": 0, "data/file_index": 0, "tasks": ["lift"]}
RIGHT = [(frame / FPS, "cup", 0.5, -1.0, float(frame)) for frame in range(COUNT)]


def written(place, info=None, rows=None, episodes=None):
    """Writes a dataset of one episode, with what is given in the place of what it has."""
    for name in (DATA, ABOUT):
        (place / name).parent.mkdir(parents=True)
    (place / "meta/info.json").write_text(json.dumps(INFO | (info or {})))
    columns = rows if isinstance(rows, pa.Table) else pa.table(ROWS | (rows or {}))
    pq.write_table(columns, place / DATA)
    pq.write_table(pa.Table.from_pylist(episodes or [EPISODE]), place / ABOUT)
    return place


def imported(dataset):
    ssduck.import_poses(dataset, dataset.parent / "r")
    with ssduck.open(dataset.parent / "r") as ss:
        return ss.sql("SELECT time, name, x, y, z FROM entities_history ORDER BY tick").fetchall()


ORDERS = ([3, 1, 2, 0, 4], [4, 3, 2, 1, 0], [1, 0, 2, 3, 4])
NESTED = [[[0.0, 1.0], [2.0, 3.0], [frame, 4.0]] for frame in range(COUNT)]


@pytest.mark.slow
@pytest.mark.parametrize("has_number", [True, False])
@pytest.mark.parametrize("order", ORDERS, ids=str)
def test_the_order_of_stored_rows_does_not_count(tmp_path, order, has_number):
    rows = pa.table(ROWS).take(order)
    rows = rows if has_number else rows.drop_columns("frame_index")
    assert imported(written(tmp_path / "d", rows=rows)) == RIGHT


VALID = {
    "as it is": {},
    "a length": {"episodes": [EPISODE | {"length": COUNT}]},
    "whole frames per second": {"info": {"fps": 10.0}},
    "timestamps of 32 bits": {"rows": {"timestamp": pa.array(ROWS["timestamp"], pa.float32())}},
    "poses of 32 bits": {"rows": {"p": pa.array(ROWS["p"], pa.list_(pa.float32(), 3))}},
    "a jitter that LeRobot permits": {"rows": {"timestamp": [0.0, 0.10009, 0.2, 0.3, 0.39991]}},
    "no task": {"episodes": [EPISODE | {"tasks": []}]},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", VALID)
def test_valid_datasets_are_read(tmp_path, name):
    assert imported(written(tmp_path / "d", **VALID[name])) == RIGHT


@pytest.mark.slow
def test_timestamps_of_a_long_episode_agree_although_they_have_32_bits(tmp_path):
    count = 40_001  # at 30 frames per second, 22 minutes: their rounding is 6e-5 s
    rows = {
        "p": [[0.0, 0.0, 0.0]] * count,
        "q": [0.0] * count,
        "timestamp": pa.array([frame / 30 for frame in range(count)], pa.float32()),
        "frame_index": [*range(count)],
        "episode_index": [0] * count,
    }
    found = imported(written(tmp_path / "d", info={"fps": 30}, rows=rows))
    assert (len(found), found[-1][0]) == (count, (count - 1) / 30)


def rows(**columns):
    return {"rows": columns}


def episode(**values):
    return {"episodes": [EPISODE | values]}


def features(**values):
    return {"info": {"features": values}}


TWICE = {"names": ["cup.x", "cup.y", "cup.z", "cup.z"]}
SHORT = [[0.0, 0, 1], [0.0, 0], [0.0, 0, 1, 2], [0.0, 0, 1], [0.0, 0, 1]]
WRONG = {
    "uneven timestamps": (
        rows(timestamp=[0.0, 0.1, 5.0, 9.0, 10.0]),
        "timestamp 5 s at the frame 2, which at 10 frames per second is at 0.2 s",
    ),
    "timestamps of another rate": ({"info": {"fps": 50}}, "timestamp 0.1 s at the frame 1, which"),
    "a timestamp is missing": (rows(timestamp=[0.0, 0.1, None, 0.3, 0.4]), "timestamp nan"),
    "timestamps against the frames": (
        rows(timestamp=[0.4, 0.3, 0.2, 0.1, 0.0]),
        "timestamp 0.4 s at the frame 0",
    ),
    "a frame twice": (rows(frame_index=[0, 1, 1, 2, 3]), "frame_index 1 where 2 is due"),
    "a frame is missing": (
        {"rows": pa.table(ROWS).take([0, 1, 3, 4])},
        "frame_index 3 where 2 is due",
    ),
    "a frame without a number": (rows(frame_index=[0, 1, None, 3, 4]), "where 2 is due"),
    "a number in two features": (
        features(**INFO["features"] | {"q": {"names": ["cup.x"]}}),
        "two numbers named 'cup.x', in the features p and q",
    ),
    "a name twice": (features(p=TWICE), "two numbers named 'cup.z', in the features p and p"),
    "more numbers than names": (rows(p=[[0.0, 0, 1, 7]] * COUNT), "has 4 numbers in a frame"),
    "fewer numbers": (rows(p=[[0.0, 0]] * COUNT), "has 2 numbers in a frame, and 3 names"),
    "now more, now fewer": (rows(p=SHORT), "numbers in a frame, and 3 names"),
    "no numbers at a frame": (rows(p=[None, *ROWS["p"][1:]]), "has no numbers in a frame"),
    "one number": (rows(p=[0.0] * COUNT), "has 1 numbers in a frame, and 3 names"),
    "nested lists": (rows(p=NESTED), "it has to be a list of 3 numbers"),
    "texts": (rows(p=[["1", "2", "3"]] * COUNT), "it has to be a list of 3 numbers"),
    "an episode twice": ({"episodes": [EPISODE] * 2}, "lists the episode 0 twice"),
    "an episode without frames": (episode(episode_index=7), "the episode 7 of"),
    "half an episode": (episode(episode_index=0.5), "whose episode_index is 0.5"),
    "a file of less than 0": (
        episode(**{"data/file_index": -1}),
        "whose data/file_index is -1",
    ),
    "another length": (episode(length=99), "its length is 99"),
    "a number as a task": (episode(tasks=[5]), "the task of the episode 0 is 5"),
    "a text of tasks": (episode(tasks="lift"), "are 'lift', no list"),
} | {
    f"fps {fps!r}": ({"info": {"fps": fps}}, "frames per second (fps in")
    for fps in (0, -10, float("nan"), float("inf"), 1e-310, 1e300, "50", True, None, [1])
}


@pytest.mark.parametrize("name", WRONG)
def test_a_dataset_that_contradicts_itself_is_an_error(tmp_path, name):
    given, message = WRONG[name]
    dataset = written(tmp_path / "d", **given)
    with pytest.raises(RecordError) as raised:
        ssduck.import_poses(dataset, tmp_path / "r")
    assert message in str(raised.value)
    assert not (tmp_path / "r").exists()


NAMES = {
    "p": {"names": ["cup.x", "cup.y", "cup.z", "lid.x", "grip"]},
    "q": {"names": {"motors": ["a"]}},
    "timestamp": {},
}


def test_what_is_not_read_is_told_of(tmp_path):
    """A feature whole, names of a feature that has poses, and further tasks of each episode."""
    rows = {"p": [[0.5, -1.0, float(frame), 1.0, 2.0] for frame in range(COUNT)]}
    second = EPISODE | {"episode_index": 1, "tasks": ["lift", "put"]}
    rows |= {"episode_index": [1] * COUNT}
    both = pa.concat_tables([pa.table(ROWS | rows | {"episode_index": [0] * COUNT}),
                             pa.table(ROWS | rows)])  # fmt: skip
    dataset = written(tmp_path / "d", {"features": NAMES}, both, [EPISODE, second])
    told = "not read: lid.x, grip of p, q, the task 'put' of episode 1$"
    with pytest.warns(UserWarning, match=told):
        ssduck.import_poses(dataset, tmp_path / "r")


def test_many_names_that_are_not_read_are_counted(tmp_path):
    names = ["cup.x", "cup.y", "cup.z", *(f"n{k}" for k in range(20))]
    rows = {"p": [[0.5, -1.0, 0.0, *[1.0] * 20]] * COUNT}
    dataset = written(tmp_path / "d", {"features": {"p": {"names": names}}}, rows)
    with pytest.warns(UserWarning, match=r"not read: n0, .*, n7 and 12 more of p$"):
        ssduck.import_poses(dataset, tmp_path / "r")


def test_a_part_of_an_orientation_is_an_error(tmp_path):
    """It was read as a rotation of length 2**0.5."""
    features = {"p": {"names": ["cup.x", "cup.y", "cup.z", "cup.qz"]}}
    rows = {"p": [[0.5, -1.0, 0.0, 1.0]] * COUNT}
    dataset = written(tmp_path / "d", {"features": features}, rows)
    with pytest.raises(RecordError, match="a part of the orientation of 'cup', qz: name all of"):
        ssduck.import_poses(dataset, tmp_path / "r")
