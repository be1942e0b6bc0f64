"""Poses from anywhere become records: the same rows and answers as those of a live recording."""

import warnings

import numpy as np
import polars as pl
import pyarrow as pa
import pybullet
import pytest

import ssduck
from ssduck import Recording
from ssduck.errors import ArgumentError, RecordError, SelectScriptError
from ssduck.schema import BOX, POSE
from tests.support.stage import Stage

TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
COLUMNS = ", ".join((*POSE, *TWIST, *BOX))
TURN = [0.5, -0.5, 0.5, 0.5]


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """A live record of PyBullet: a box and a ball that fall, tumbling, on a box that stands."""
    place = tmp_path_factory.mktemp("live") / "r"
    with Stage() as stage, ssduck.Interpreter(recording=None) as ss:
        pybullet.setGravity(0, 0, -9.81, stage.client)
        stage.box("board", half=[1, 1, 0.05])
        brick = stage.box("brick", (0, 0, 0.5), half=[0.1, 0.05, 0.2], mass=1)
        stage.sphere("ball", (0.25, 0, 0.3), radius=0.1, mass=1)
        pybullet.resetBaseVelocity(brick, [0, 0, 0], [3, 2, 1], stage.client)
        world = ss.add_variable("lab", stage.open())
        with ss.record_to(place, recording=Recording(tables=("entities",))):
            for _ in range(150):
                world.step()
    return place


SHAPES = {
    "board": {"box": [2, 2, 0.1], "movable": False},
    "brick": {"box": [0.2, 0.1, 0.4], "mass": 1},
    "ball": {"sphere": 0.1, "mass": 1},
}
QUESTIONS = [
    "SELECT clearance(lab.brick, this) FROM lab{} WHERE id == 'ball' AS list;",
    "SELECT tick FROM lab{} WHERE collides(this, lab.board) AS list;",
    "SELECT tick FROM lab{} WHERE above(lab.board, this) AS list;",
    "SELECT id, least(clearance(this, lab.board)) FROM lab WHERE id != 'board' AS list;",
]


@pytest.mark.slow
def test_the_rows_and_answers_are_those_of_a_live_record(live, tmp_path):
    with ssduck.open(live) as ss:
        rows = ss.sql(
            f"SELECT time, name, {COLUMNS} FROM entities_history ORDER BY tick, id"
        ).arrow()
        expected = [ss.eval(question) for question in QUESTIONS]
        first = ss.past("lab").ticks[0]
    written = ssduck.write_record(tmp_path / "w", SHAPES, rows.drop(BOX), world="lab")
    assert (written.ticks, written.complete, written.tables) == (151, True, ("entities",))
    with ssduck.open(tmp_path / "w") as ss:
        query = f"SELECT time, name, {COLUMNS} FROM entities_history ORDER BY tick, id"
        assert ss.sql(query).arrow() == rows  # to the last bit, boxes included
        answers = [ss.eval(question) for question in QUESTIONS]
    shift = first - 1  # the live record begins with another number
    assert answers[0] == expected[0]
    assert answers[1:3] == [[tick - shift for tick in ticks] for ticks in expected[1:3]]
    assert answers[3] == expected[3]
    assert 0 < len(answers[1]) < len(answers[2])
    assert ssduck.check(tmp_path / "w") == []


def falling(ticks=5):
    times = np.arange(ticks) / 8
    poses = np.zeros((ticks, 2, 7))
    poses[:, :, 3:] = TURN
    poses[:, 1, 2] = 1 - times
    return times, poses


TWO = {"table": {"box": [1, 1, 0.25]}, "cup": {"sphere": 0.125, "kind": "robot"}}


def table_of(times, poses):
    names = list(TWO)
    columns = dict(zip(POSE, poses.reshape(-1, 7).T, strict=True))
    return pa.table({"time": np.repeat(times, 2), "name": names * len(times), **columns})


def with_ticks(numbers):
    return table_of(TIMES, POSES).append_column("tick", [numbers])


TIMES, POSES = falling()
GIVEN = {
    "array": (POSES, TIMES),
    "dict": ({"cup": POSES[:, 1], "table": POSES[0, 0]}, TIMES),
    "arrow": (table_of(TIMES, POSES), None),
    "pandas": (table_of(TIMES, POSES).to_pandas().rename(index=lambda row: row + 10), None),
    "polars": (pl.from_arrow(table_of(TIMES, POSES)), None),
    "floats of 32 bits": (POSES.astype(np.float32), TIMES),
    "long quaternions": (np.concatenate((POSES[..., :3], POSES[..., 3:] * 7), axis=2), TIMES),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", GIVEN)
def test_each_form_of_poses_gives_the_same_record(tmp_path, kind):
    poses, times = GIVEN[kind]
    ssduck.write_record(tmp_path / "r", TWO, poses, times, tags={"task": "fall"})
    with ssduck.open(tmp_path / "r") as ss:
        rows = ss.sql(f"SELECT {', '.join(POSE)} FROM entities_history ORDER BY tick, id")
        assert np.array(rows.fetchall()).reshape(5, 2, 7).tolist() == POSES.tolist()
        assert ss.past("world").times == TIMES.tolist()
        (low, high) = ss.sql(
            "SELECT min(zmin), max(zmax) FROM entities_history WHERE name = 'cup'"
        ).fetchone()
        assert (low, high) == (1 - TIMES[-1] - 0.125, 1.125)
        assert ss.sql("SELECT count(vx), count(wz) FROM entities_history").fetchone() == (0, 0)
        assert ss.eval("SELECT id FROM world WHERE isRobot(this) AS list;") == ["cup"]
    assert ssduck.episodes(tmp_path / "r")[0].tags == {"task": "fall"}


@pytest.mark.slow
def test_positions_alone_and_no_shapes(tmp_path):
    ssduck.write_record(tmp_path / "r", ["a", "b"], POSES[..., :3], TIMES)
    with ssduck.open(tmp_path / "r") as ss:
        assert ss.eval("SELECT id FROM world WHERE above(world.a, this) AS list;") == ["b"]
        assert ss.sql("SELECT DISTINCT qw, qx FROM entities_history").fetchall() == [(1, 0)]
        with pytest.raises(SelectScriptError, match="not recorded"):
            ss.sql("SELECT * FROM contacts_history")


@pytest.mark.parametrize(
    ("program", "value"),
    [
        ("SELECT id FROM world WHERE speed(this) < 1 AS list;", []),
        ("SELECT id FROM world{} WHERE speed(this) < 1 AS list;", []),
        ("heldFor(speed(world.cup) < 1);", 0.0),
        ("speed(world.cup);", None),
    ],
)
def test_a_record_without_velocities_tells_of_it_once(tmp_path, program, value):
    ssduck.write_record(tmp_path / "without", TWO, POSES, TIMES)
    ssduck.write_record(tmp_path / "with", TWO, POSES, TIMES, velocities=np.zeros((5, 2, 6)))
    for name, count in (("without", 1), ("with", 0)):
        with ssduck.open(tmp_path / name) as ss, warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            ss.eval("SELECT id FROM world WHERE z(this) < 1;")
            assert caught == []
            found = [ss.eval(program), ss.eval(program)]
        told = ["velocities were not recorded" in str(one.message) for one in caught]
        assert told == [True] * count
        assert (found == [value, value]) is (name == "without")


@pytest.mark.slow
def test_velocities_are_kept(tmp_path):
    given = np.arange(60, dtype=float).reshape(5, 2, 6)
    ssduck.write_record(tmp_path / "a", TWO, POSES, TIMES, velocities=given)
    ssduck.write_record(tmp_path / "b", TWO, POSES, TIMES, velocities={"cup": given[:, 1]})
    for name, expected in (("a", 10), ("b", 5)):
        with ssduck.open(tmp_path / name) as ss:
            rows = ss.sql(
                f"SELECT {', '.join(TWIST)} FROM entities_history WHERE vx IS NOT NULL ORDER BY tick, id"
            ).fetchall()
        assert len(rows) == expected
        assert [list(row) for row in rows] == given[:, 2 - expected // 5 :].reshape(-1, 6).tolist()


@pytest.mark.slow
def test_an_entity_that_is_missing_at_a_tick_is_not_there(tmp_path):
    rows = table_of(TIMES, POSES)
    gone = rows.filter(pa.array([number != 5 for number in range(10)]))
    ssduck.write_record(tmp_path / "r", TWO, gone)
    with ssduck.open(tmp_path / "r") as ss:
        counts = ss.sql("SELECT count(*) FROM entities_history GROUP BY tick ORDER BY tick")
        assert counts.fetchall() == [(2,), (2,), (1,), (2,), (2,)]
        asked = "SELECT tick FROM world{} WHERE above(world.table, this) AS list;"
        assert ss.eval(asked) == [1, 2, 4, 5]


@pytest.mark.slow
def test_shapes_of_every_form(tmp_path):
    mesh = tmp_path / "wedge.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    forms = {
        "box": ({"box": [1, 2, 4]}, [-0.5, -1, -2, 0.5, 1, 2]),
        "sphere": ({"sphere": 0.5}, [-0.5, -0.5, -0.5, 0.5, 0.5, 0.5]),
        "cylinder": ({"cylinder": [0.5, 2]}, [-0.5, -0.5, -1, 0.5, 0.5, 1]),
        "capsule": ({"capsule": [0.5, 2]}, [-0.5, -0.5, -1.5, 0.5, 0.5, 1.5]),
        "ellipsoid": ({"ellipsoid": [0.5, 1, 2]}, [-0.5, -1, -2, 0.5, 1, 2]),
        "mesh": ({"mesh": mesh}, [0, 0, 0, 1, 1, 1]),
        "scaled": ({"mesh": str(mesh), "scale": 2}, [0, 0, 0, 2, 2, 2]),
        "stretched": ({"hull": mesh, "scale": [1, 2, 3]}, [0, 0, 0, 1, 2, 3]),
        "points": ({"hull": points, "position": [0, 0, 1]}, [0, 0, 1, 1, 1, 2]),
        "turned": ({"box": [1, 2, 4], "orientation": TURN}, [-1, -2, -0.5, 1, 2, 0.5]),
        "two": ({"shapes": [{"sphere": 1}, {"sphere": 1, "position": [3, 0, 0]}]}, [-1, -1, -1, 4, 1, 1]),
        "none": ({}, [0, 0, 0, 0, 0, 0]),
    }  # fmt: skip
    entities = {name: form for name, (form, _) in forms.items()}
    ssduck.write_record(tmp_path / "r", entities, {name: [0.0, 0, 0] for name in forms}, [0.0])
    with ssduck.open(tmp_path / "r") as ss:
        rows = ss.sql(f"SELECT name, {', '.join(BOX)} FROM entities").fetchall()
        boxes = {name: list(box) for name, *box in rows}
        assert boxes == {name: box for name, (_, box) in forms.items()}
        assert ss.eval("clearance(world.sphere, world.none);") == np.inf  # it has no shape


@pytest.mark.slow
def test_links_have_poses_and_shapes_of_their_own(tmp_path):
    arm = {
        "kind": "robot",
        "box": [0.1, 0.1, 0.1],
        "links": {"upper": {"box": [0.1, 0.1, 0.5], "mass": 2}, "hand": {"sphere": 0.1, "parent": "upper"}},
    }  # fmt: skip
    poses = {
        "arm": [0, 0, 0],
        "arm.upper": [0, 0, 0.5, 1, 0, 0, 0],
        "arm.hand": np.column_stack((TIMES, 0 * TIMES, 1 + TIMES)),
        "can": [0.5, 0, 1.5],
    }
    ssduck.write_record(tmp_path / "r", {"arm": arm, "can": {"sphere": 0.1}}, poses, TIMES)
    with ssduck.open(tmp_path / "r") as ss:
        x = ss.sql("SELECT x FROM links_history WHERE full_name = 'arm.hand' ORDER BY tick")
        assert [value for (value,) in x.fetchall()] == TIMES.tolist()
        assert ss.eval("clearance(world.arm.hand, world.can);") == 0.0
        asked = (
            "SELECT round(clearance(world.arm, this), 9) FROM world{} WHERE id == 'can' AS list;"
        )
        gaps = [max(np.hypot(0.5 - t, 0.5 - t) - 0.2, 0) for t in TIMES]
        assert ss.eval(asked) == pytest.approx(gaps, abs=1e-9)
        assert ss.sql("SELECT parent FROM links_model WHERE name = 'hand'").fetchone() == (1,)
    assert ssduck.check(tmp_path / "r") == []


# -- errors -------------------------------------------------------------------------------------

NAN, BACK, TURNLESS = POSES.copy(), TIMES.copy(), POSES.copy()
NAN[3, 1, 2], BACK[2], TURNLESS[1, 0, 3:] = np.nan, 0.0, 0.0
LONG = table_of(TIMES, POSES)
WRONG = [
    (TWO, NAN, TIMES, "poses: tick 3 has the value nan"),
    (TWO, {"table": [0, 0, np.inf], "cup": [0, 0, 0]}, TIMES, "has the value inf"),
    (TWO, POSES, BACK, "times: they are to ascend, and 0 s follows 0.125 s"),
    (TWO, POSES, [0, 1, 1, 2, 3], "1 s follows 1 s"),
    (TWO, POSES, [0, 1, np.nan, 2, 3], "times: tick 2 has the value nan"),
    (TWO, POSES, None, "times: give the time of each tick"),
    (TWO, POSES, TIMES[None], r"times: the shape is \(1, 5\)"),
    (TWO, POSES, ["a"] * 5, "times: expected an array of numbers"),
    (TWO, POSES[:4], TIMES, r"the shape is \(4, 2, 7\), and is to be \(5, 2, 7\) or"),
    (TWO, POSES[..., :6], TIMES, r"the shape is \(5, 2, 6\)"),
    (TWO, POSES[:0], TIMES[:0], "there is no tick"),
    (TWO, TURNLESS, TIMES, "at 0.125 s, the quaternion w, x, y, z of 'table'"),
    (TWO, {"tabel": POSES[:, 0], "cup": POSES[:, 1]}, TIMES, "did you mean 'table'"),
    (TWO, {"cup": POSES[:, 1]}, TIMES, "poses: 'table' has none"),
    (TWO, {"table": POSES[:3, 0], "cup": POSES[:, 1]}, TIMES, r"poses\['table'\]: the shape is"),
    (TWO, LONG.drop(["x"]), None, "the table has no column 'x'"),
    (TWO, LONG.drop(["qz"]), None, "the table has no column 'qz'"),
    (TWO, LONG.take(list(range(9, -1, -1))), None, "the rows are to ascend by time"),
    (TWO, pa.concat_tables([LONG.slice(0, 1), LONG]), None, "'table' has two rows at 0 s"),
    (TWO, with_ticks([1, 0] * 5), None, "the rows are to ascend by tick, and row 1, 0, follows 1"),
    (TWO, with_ticks([0.5] * 10), None, "the column 'tick' has other values than whole numbers"),
    (TWO, with_ticks([7] * 10), None, "tick 7 is at 0 s, and at 0.125 s"),
    (TWO, LONG, TIMES, "a table of poses has its own columns"),
    (["table"], LONG, None, "no entity or link is called 'cup'"),
    (["a", "a"], POSES, TIMES, "'a' is there twice"),
    ("ab", POSES, TIMES, "give a dict of descriptions by name"),
    ({"a": {}, "": {}}, POSES, TIMES, "a name is a text"),
    ({"a": {"boxes": [1, 1, 1]}, "b": {}}, POSES, TIMES, "did you mean 'box'"),
    ({"a": {"box": [1, 1]}, "b": {}}, POSES, TIMES, "expected 3 finite numbers"),
    ({"a": {"box": [1, 1, 0]}, "b": {}}, POSES, TIMES, "a length is not above 0"),
    ({"a": {"sphere": -1}, "b": {}}, POSES, TIMES, "a length is not above 0"),
    ({"a": {"plane": [0, 0, 0]}, "b": {}}, POSES, TIMES, "the normal has the length 0"),
    ({"a": {"box": [1, 1, 1], "sphere": 1}, "b": {}}, POSES, TIMES, "one form of"),
    ({"a": {"position": [1, 1, 1]}, "b": {}}, POSES, TIMES, "one form of"),
    ({"a": {"mesh": "no.obj"}, "b": {}}, POSES, TIMES, "no.obj cannot be read"),
    ({"a": {"kind": "robto"}, "b": {}}, POSES, TIMES, "did you mean 'robot'"),
    ({"a": {"mass": -1}, "b": {}}, POSES, TIMES, "less than 0"),
    ({"a": {"links": {"l": {"parent": "m"}}}}, POSES, TIMES, "is no link before it"),
    ({"a": {"links": {"b": {}}}, "a.b": {}}, POSES, TIMES, "is both an entity and a link"),
]  # fmt: skip


@pytest.mark.parametrize(("entities", "poses", "times", "message"), WRONG)
def test_what_is_wrong_is_an_error_and_writes_nothing(tmp_path, entities, poses, times, message):
    with pytest.raises(SelectScriptError, match=message):
        ssduck.write_record(tmp_path / "r", entities, poses, times)
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        *(
            ({"world": name}, "cannot have the name|cannot be a world's name")
            for name in ("memory", "Main", "pg_catalog", "two words", "")
        ),
        ({"tags": {"a": [1]}}, "a tag is a text"),
        ({"velocities": POSES}, r"velocities: the shape is \(5, 2, 7\)"),
    ],
)
def test_wrong_settings(tmp_path, settings, message):
    with pytest.raises(ArgumentError, match=message):
        ssduck.write_record(tmp_path / "r", TWO, POSES, TIMES, **settings)
    assert not (tmp_path / "r").exists()


# -- in batches ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_batches_give_the_rows_of_one_call(tmp_path):
    times, poses = falling(5000)
    ssduck.write_record(tmp_path / "one", TWO, poses, times)
    with ssduck.RecordWriter(tmp_path / "many", TWO) as writer:
        for batch in np.array_split(np.arange(5000), 7):
            writer.add(poses[batch], times[batch])
        with ssduck.open(tmp_path / "many") as ss:  # as far as it is written
            assert len(ss.past("world").ticks) == 5000
        assert ssduck.episodes(tmp_path / "many")[0].complete is False
    assert ssduck.episodes(tmp_path / "many")[0].complete is True
    query = f"SELECT tick, time, name, {', '.join((*POSE, *BOX))} FROM entities_history ORDER BY tick, id"
    rows = []
    for name in ("one", "many"):
        with ssduck.open(tmp_path / name) as ss:
            rows.append(ss.sql(query).arrow())
        assert ssduck.check(tmp_path / name) == []
    assert rows[0] == rows[1]
    assert rows[0].num_rows == 10_000


def test_a_wrong_batch_writes_nothing_and_the_others_stay(tmp_path):
    with ssduck.RecordWriter(tmp_path / "r", TWO) as writer:
        with pytest.raises(ArgumentError, match="nan"):
            writer.add(NAN, TIMES)
        assert not (tmp_path / "r").exists()
        writer.add(POSES, TIMES)
        with pytest.raises(ArgumentError, match=r"0 s follows 0\.5 s"):
            writer.add(POSES, TIMES)
        with pytest.raises(ArgumentError, match="nan"):
            writer.add(NAN, TIMES + 1)
        writer.add(POSES, TIMES + 1)
    (episode,) = ssduck.episodes(tmp_path / "r")
    assert (episode.ticks, episode.end, episode.complete) == (10, 1.5, True)
    with pytest.raises(ArgumentError, match="closed"):
        writer.add(POSES, TIMES + 2)


def test_a_writer_that_wrote_nothing_says_so(tmp_path):
    with (
        pytest.raises(ArgumentError, match="nothing was written"),
        ssduck.RecordWriter(tmp_path / "r", TWO),
    ):
        pass
    assert not (tmp_path / "r").exists()


def test_a_column_of_lists_is_no_column_of_numbers(tmp_path):
    rows = [{"time": [0.0], "name": "a", "x": 0.0, "y": 0.0, "z": 0.0}]
    with pytest.raises(ArgumentError, match="'time' has other values than numbers"):
        ssduck.write_record(tmp_path / "r", {"a": {"sphere": 0.1}}, pa.Table.from_pylist(rows))


def test_a_folder_whose_name_is_too_long_leaves_none(tmp_path):
    with pytest.raises(RecordError, match="cannot be written: File name too long"):
        ssduck.write_record(tmp_path / "new" / ("x" * 300), ["cup"], np.zeros((1, 1, 3)), [0.0])
    assert not (tmp_path / "new").exists()
