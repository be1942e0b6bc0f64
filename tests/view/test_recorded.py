"""What a page gets of recorded ticks: poses in bulk, changes of answers, intervals, plots."""

import json
import struct

import numpy as np
import pytest

import ssduck
from ssduck.language.intervals import changes_of, column_of

pytest.importorskip("websockets", reason="the extra view is not installed")
from ssduck.adapters.grid_values import Grid
from ssduck.view.answers import drawing_of
from ssduck.view.facts import facts_of
from ssduck.view.frames import Frame, track_of
from ssduck.view.live import LiveSource
from ssduck.view.scans import Scan
from ssduck.view.server import SentTicks
from tests.support.cases import sampled
from tests.support.viewing import POSES, TRACK, asked, binary, opened, told

CUP = "cup_905a"


@pytest.fixture(scope="module")
def ss(record):
    with ssduck.open(record) as ss:
        yield ss


def frames(world, numbers):
    for number in numbers:
        yield Frame.of(world.ticker.record.at(number).snapshot)


@pytest.mark.slow
def test_a_track_has_the_poses_of_each_tick(ss):
    world = ss.worlds[0]
    numbers = world.ticker.record.ticks.numbers.tolist()
    frame = Frame.of(world.snapshot)
    track = track_of(world.ticker.record, frame, 10, 30)
    assert track.first == 10
    assert len(track.poses) == 30
    assert 0 < len(track.moving) < len(track.base)
    for place, expected in enumerate(frames(world, numbers[10:40])):
        poses = track.base.copy()
        poses[track.moving] = track.poses[place]
        assert np.array_equal(poses, expected.poses)


@pytest.mark.parametrize(("first", "count", "expected"), [(0, 1, 1), (60, 99, None), (10**6, 5, 0)])
def test_a_track_ends_with_the_record(ss, first, count, expected):
    world = ss.worlds[0]
    total = len(world.ticker.record.ticks)
    track = track_of(world.ticker.record, Frame.of(world.snapshot), first, count)
    if expected == 0:
        assert track is None
    else:
        assert len(track.poses) == (expected or total - first)


@pytest.mark.slow
def test_a_track_of_another_scene_is_none(tmp_path):
    with ssduck.load("kitchen") as ss:
        kitchen = ss["kitchen"]
        with ss.record_to(tmp_path / "run"):
            kitchen.step(2)
            kitchen[CUP].visible = False
            kitchen.step(2)
            kitchen.remove(CUP)
            kitchen.step(2)
    with ssduck.open(tmp_path / "run") as record:
        world = record.worlds[0]
        frame = Frame.of(world.snapshot)  # the last one, without the cup
        total = len(world.ticker.record.ticks)
        assert track_of(world.ticker.record, frame, 0, total) is None
        assert track_of(world.ticker.record, frame, total - 1, 1) is not None


PROGRAMS = [
    f"on(kitchen.table, kitchen.{CUP});",
    "SELECT id FROM kitchen WHERE on(kitchen.table, this) ORDER BY id;",
    f"SELECT z FROM kitchen WHERE id(this) == '{CUP}';",
    "1;",
    f"z(kitchen.{CUP}) > 1.2;",
]


@pytest.mark.slow
@sampled("program", PROGRAMS, every=4)
def test_a_scan_finds_each_change(record, program):
    """The oracle asks at each tick, and compares."""
    with ssduck.open(record) as ss:
        world = ss.worlds[0]
        times = np.unique(world.ticker.record.ticks.times)
        values = []
        for time in times.tolist():
            world.seek(time)
            values.append(repr(_rounded(ss.eval(program))))
        scan = Scan(ss, world, program, "selectscript")
        while scan.advance(0.05):
            pass
        progress = scan.progress
    changes = [time for time, _ in changes_of(times, column_of(values))]
    assert [start for start, _, _ in progress["runs"]] == changes
    assert progress["done"]
    assert progress["exact"]


def _rounded(value):
    if isinstance(value, list):
        return [_rounded(part) for part in value]
    if isinstance(value, dict):
        return [_rounded(part) for part in value.values()]
    return round(value, 3) + 0.0 if isinstance(value, float) else value


# -- over the socket --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def socket(served):
    with opened(served.url) as socket:
        yield socket


@pytest.mark.slow
def test_the_ticks_and_a_track_are_sent(served, ss):
    with opened(served.url) as socket:  # the ticks are sent once
        message = told(socket, type="ticks")
        assert message["times"] == ss.worlds[0].ticker.record.ticks.times.tolist()
        binary(socket, POSES)
        socket.send(json.dumps({"type": "track", "id": 3, "first": 0, "count": 16}))
        data = binary(socket, TRACK)
    length = struct.unpack_from("<II", data)[1]
    head = json.loads(data[8 : 8 + length])
    assert (head["id"], head["first"], head["count"]) == (3, 0, 16)
    numbers = np.frombuffer(data, "<f4", offset=8 + length)
    assert len(numbers) == 7 * (head["links"] + 16 * len(head["rows"]))


@pytest.mark.parametrize(
    ("first", "count"), [(-1, 5), (0, 0), (0, 10**9), ("0", 5), (None, 5), (True, 5), (10**6, 5)]
)
def test_a_wrong_track_is_none(socket, first, count):
    assert asked(socket, type="track", first=first, count=count)["none"]


@pytest.mark.slow
def test_a_scan_is_sent_bit_by_bit(socket, ss):
    program = PROGRAMS[0]
    socket.send(json.dumps({"type": "scan", "id": "s", "text": program}))
    message = told(socket, id="s", done=True)
    changes = [time for time, _ in ss.eval(f"changes(on(kitchen.table, kitchen.{CUP}));")]
    assert [start for start, _, _ in message["runs"]] == changes


def test_a_scan_with_an_error_says_so(socket):
    message = asked(socket, type="scan", id="e", text="kitchen.frigde;")
    assert message["error"]["suggestions"] == ["fridge"]


@pytest.mark.slow
def test_intervals_are_bars_over_the_whole_record(socket, ss):
    times = ss.worlds[0].ticker.record.ticks.times
    program = f"holds(on(kitchen.table, kitchen.{CUP}));"
    answer = asked(socket, type="ask", text=program, at=float(times[3]))
    assert answer["lanes"] == [["holds", ss.eval(program)]]
    assert answer["columns"] == ["begin", "end"]
    answer = asked(socket, type="ask", text=program, at=float(times[-1]))
    assert (answer["columns"], answer["rows"]) == (["begin", "end"], ss.eval(program))
    query = (
        f"SELECT id, holds(on(kitchen.table, this)) AS t FROM kitchen WHERE id(this) == '{CUP}';"
    )
    answer = asked(socket, type="ask", text=query, at=float(times[-1]))
    assert answer["lanes"] == [[CUP, ss.eval(program)]]


def test_a_column_is_plotted(socket, ss):
    id = ss.worlds[0][CUP].id
    answer = asked(socket, type="plot", entity=id, column="z")
    query = "SELECT time, z FROM entities_history WHERE id = ? ORDER BY tick"
    assert answer["points"] == [list(row) for row in ss.sql(query, [id])]
    assert asked(socket, type="plot", entity=id, column="zz")["error"]["suggestions"]
    assert asked(socket, type="plot", entity=id, column='z" FROM x --')["error"]


@pytest.mark.slow
def test_a_robot_has_its_links_and_joints(socket, ss):
    robot = ss.worlds[0]["barrett_4918"]
    answer = asked(socket, type="pick", entity=robot.id)
    assert [row[0] for row in answer["links"]] == [link.name for link in robot.links]
    names = [name for (name,) in ss.sql("SELECT name FROM joints WHERE entity = ?", [robot.id])]
    assert [row[0] for row in answer["joints"]] == names
    assert names
    points = asked(socket, type="plot", entity=robot.id, column="", joint=names[0])["points"]
    assert len(points) == len(ss.worlds[0].ticker.record.ticks)


@pytest.mark.slow
def test_unknown_velocities_are_not_told(tmp_path):
    """NaN is no number of JSON: a page would not understand the answer."""
    ssduck.write_record(tmp_path / "r", ["cup", "pot"], np.zeros((2, 2, 3)), [0.0, 0.1])
    with ssduck.open(tmp_path / "r") as ss:
        facts = facts_of(ss, ss.worlds[0], 1)
    assert facts["facts"]["position (m)"] == [0.0, 0.0, 0.0]
    assert "NaN" not in json.dumps(facts)


# -- parts ------------------------------------------------------------------------------------


class Ticks:
    def __init__(self, *numbers):
        self.numbers = np.array(numbers, dtype=np.int64)
        self.times = self.numbers / 10.0


def test_a_page_gets_each_tick_once():
    sent, known = SentTicks(), []
    numbers = []
    for ticks in (
        Ticks(),
        Ticks(1, 2),
        Ticks(1, 2, 3),
        Ticks(2, 3, 4),
        Ticks(8, 9),
        Ticks(1),
        Ticks(),
    ):
        message = sent.message(ticks, [])
        if message is not None:
            kept = [] if message["anew"] else known[len(known) - message["keep"] :]
            known = kept + message["times"]
            kept = [] if message["anew"] else numbers[len(numbers) - message["keep"] :]
            numbers = kept + message["numbers"]
        assert known == ticks.times.tolist()
        assert numbers == ticks.numbers.tolist()
        assert sent.message(ticks, []) is None


def test_firings_are_sent_when_there_are_more():
    sent = SentTicks()
    sent.message(Ticks(1), [])
    assert sent.message(Ticks(1), [("t", 0.1)])["firings"] == [("t", 0.1)]
    assert sent.message(Ticks(1), [("t", 0.1)]) is None


@pytest.mark.parametrize(
    ("cells", "kind"),
    [
        (np.eye(3, dtype=bool), "grid"),
        (np.array([[0.0, 4.0]]), "grid"),
        (np.ones((2, 2, 2)), "cloud"),
    ],
)
def test_a_grid_is_drawn_in_place(cells, kind):
    import base64

    grid = Grid(cells, (1.0, 2.0, 3.0)[: cells.ndim], 0.5)
    drawing = drawing_of(grid)
    assert drawing["kind"] == kind
    if kind == "grid":
        shares = np.frombuffer(base64.b64decode(drawing["shares"]), np.uint8).reshape(cells.shape)
        assert np.array_equal(shares == 255, cells == cells.max())
        assert drawing["origin"] == [1.0, 2.0]
    else:
        points = np.frombuffer(base64.b64decode(drawing["points"]), "<f4").reshape(-1, 3)
        assert np.allclose(points.min(axis=0), [1.25, 2.25, 3.25])
        assert len(points) == 8


def test_other_values_are_not_drawn():
    assert drawing_of([1, 2]) is None


@pytest.mark.slow
def test_a_removed_body_has_its_colours_in_the_past(client):
    pybullet = pytest.importorskip("pybullet")

    def ball(colour):
        look = pybullet.createVisualShape(
            pybullet.GEOM_SPHERE, radius=0.1, rgbaColor=colour, physicsClientId=client
        )
        return pybullet.createMultiBody(1, -1, look, physicsClientId=client)

    def colours(time):
        message = source.scene(source.frame(time))
        head = json.loads(message[8 : 8 + struct.unpack_from("<I", message, 4)[0]])
        return [colour for _, _, _, colour in head["shapes"]]

    red, blue = [1, 0, 0, 1], [0, 0, 1, 1]
    number = ball(red)
    with ssduck.Interpreter() as ss:
        source = LiveSource(ss, ss.add_variable("lab", ssduck.World.attach(client)), "lab")
        assert colours(None) == [red]
        pybullet.removeBody(number, client)
        assert ball(blue) == number
        source.world.tick()
        assert (colours(None), colours(0.0)) == ([blue], [red])
