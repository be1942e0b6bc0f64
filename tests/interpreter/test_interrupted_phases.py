"""Ctrl-C ends whatever an interpreter does within seconds, and the next program runs."""

import os
import signal
import sys
import threading
import time
from itertools import count

import pytest

import ssduck
from ssduck.lazy import import_whole
from tests.support.cases import sampled

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

# When the signal comes, and how long it may take on a busy machine, s.
BEFORE, WITHIN = 0.15, 5.0
ALL_ENTITIES = "SELECT obj FROM kitchen AS"
SUM = " + ".join(["1"] * 200_000)

# All of them take many times as long as the signal does; they run until it is heard.
PROGRAMS = {
    "parsing": f"{SUM};",
    "parsing a list": f"x = [{', '.join(['[1, 2]'] * 100_000)}];",
    "row by row": "SELECT round(a.this / 7 + b.this, 2) FROM a=numbers, b=numbers AS list;",
    "the narrow phase": ("SELECT clearance(a.this, b.this) FROM a=kitchen{}, b=kitchen{} AS list;"),
    "relations over time": (
        "SELECT a.id, b.id FROM a=kitchen, b=kitchen "
        "WHERE holds(clearance(a.this, b.this) > 0.01) AS list;"
    ),
    "voxels": f"{ALL_ENTITIES} voxelgrid(0.01);",
    "rays": "SELECT obj FROM kitchen WHERE isSensor(this) AS sensorgrid(0.5, 0.003);",
    "facts": "SELECT above(a.this, b.this) FROM a=kitchen{}, b=kitchen AS prolog;",
}
STATEMENTS = {
    "planning SQL": f"SELECT {SUM}",
    "a join": "SELECT count(*) FROM range(1000000) a, range(1000000) b WHERE a.range * b.range % 7 = 3",
    "fetching": "SELECT range, 'row ' || range, [range, range] FROM range(100000000)",
}


@pytest.fixture(scope="module")
def kitchen():
    with ssduck.load("kitchen") as ss:
        ss.call_variable("kitchen").step(60, every=1)
        ss.add_variable("numbers", list(range(3000)))
        yield ss


def is_interrupted(ss, call, question="SELECT id, z FROM kitchen AS list;"):
    """Asserts that Ctrl-C ends a call that is made again and again, and the answers are as before.

    It is pressed again if nothing happens: Python drops a KeyboardInterrupt that is raised while it
    collects garbage.
    """
    ended = threading.Event()

    def press():
        while not ended.wait(BEFORE):
            pressed.append(time.monotonic())
            os.kill(os.getpid(), signal.SIGINT)
            ended.wait(WITHIN / 2)

    def again_and_again():
        while True:
            call()

    pressed = []
    before = ss.eval(question)
    presser = threading.Thread(target=press)
    presser.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            again_and_again()
    finally:
        ended.set()
        presser.join()
    assert time.monotonic() - pressed[-1] < WITHIN
    assert len(pressed) < 8
    assert ss.eval(question) == before


@sampled("name", PROGRAMS, every=len(PROGRAMS))
def test_programs(kitchen, name):
    is_interrupted(kitchen, lambda: kitchen.eval(PROGRAMS[name]))


@pytest.mark.parametrize("name", STATEMENTS)
def test_statements(kitchen, name):
    is_interrupted(kitchen, lambda: kitchen.sql(STATEMENTS[name]).fetchall())


@pytest.mark.parametrize("form", ["image(640, 480)", "environment", "mesh"])
def test_result_forms(kitchen, form):
    is_interrupted(kitchen, lambda: kitchen.eval(f"{ALL_ENTITIES} {form};"))


def test_exporting(kitchen, tmp_path):
    numbers = count()
    kitchen.export(tmp_path / str(next(numbers)))
    is_interrupted(kitchen, lambda: kitchen.export(tmp_path / str(next(numbers))))
    found = [
        episode
        for path in tmp_path.iterdir()
        if path.name.isdigit()
        for episode in ssduck.episodes(path)
    ]
    kept = len(kitchen.eval("kitchen{};").times)
    assert {(episode.complete, episode.ticks) for episode in found} == {(True, kept)}


def test_opening(kitchen, tmp_path):
    kitchen.export(tmp_path / "run")

    def open_and_ask():
        with ssduck.open(tmp_path / "run") as ss:
            ss.eval("SELECT id FROM kitchen{} WHERE z > 1 AS list;")

    is_interrupted(kitchen, open_and_ask)


def test_loading(kitchen):
    is_interrupted(kitchen, lambda: ssduck.load("kitchen").close())


def test_importing(tmp_path, monkeypatch):
    """A library that catches every exception while it is imported is whole nevertheless."""
    (tmp_path / "catching.py").write_text(
        "import os, signal\n"
        "try:\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    part = 1\n"
        "except BaseException:\n"
        "    part = None\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        import_whole("catching")
    assert sys.modules.pop("catching").part == 1
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_rays_of_mujoco(tmp_path):
    pytest.importorskip("mujoco")
    boxes = "".join(
        f'<body name="b{n}" pos="{n % 20} {n // 20} 1"><geom type="box" size=".2 .2 .2"/></body>'
        for n in range(200)
    )
    (tmp_path / "field.xml").write_text(f"<mujoco><worldbody>{boxes}</worldbody></mujoco>")
    with ssduck.load(tmp_path / "field.xml") as ss:
        world = ss.call_variable("field")
        scanner = world.add_sensor(
            "lidar", on=world["b90"], name="scanner", max_range=30, layers=60
        )

        def scan():
            world.step()
            assert len(scanner.ranges) == 21_600

        is_interrupted(ss, scan, "SELECT id FROM field AS list;")


def test_recording(tmp_path):
    """What was ticked before Ctrl-C is in the record, and the rest of the run, too."""
    with ssduck.load("kitchen") as ss:
        world = ss.call_variable("kitchen")
        recording = ss.record_to(tmp_path / "run", recording=ssduck.Recording(flush_every=0.02))
        is_interrupted(ss, world.step, "SELECT id FROM kitchen AS list;")
        world.step()
        recording.close()
        time_at_end = world.time
    with ssduck.open(tmp_path / "run") as record:
        sql = "SELECT count(DISTINCT tick), max(tick) - min(tick), max(time) FROM entities_history"
        count, last, stored = record.sql(sql).fetchone()
    (episode,) = ssduck.episodes(tmp_path / "run")
    assert episode.complete
    assert count == last + 1 > 2
    assert stored == time_at_end
