"""Long programs over recorded ticks: they show their progress, and can be interrupted."""

import io
import os
import re
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType

import pybullet
import pytest

import ssduck
from ssduck.errors import LimitError
from ssduck.geometry.tick_solids import ShapeComparisons
from ssduck.interpreter.query_runner import PlannedQuery
from ssduck.limits import Limits, _clock
from ssduck.recording.replay import batch_queries, progress
from ssduck.recording.replay.batch_queries import EntityShapes
from tests.support.stage import Stage

TICKS = 30
ASKED = "holds(on(board, ball));"


class Terminal(io.StringIO):
    """A stream that says that it is a terminal."""

    def isatty(self):
        return True


@pytest.fixture
def world():
    """A ball that falls on a board."""
    with Stage() as stage:
        pybullet.setGravity(0, 0, -9.81, physicsClientId=stage.client)
        stage.box("board", half=[1, 1, 0.1])
        stage.sphere("ball", (0, 0, 0.21), radius=0.1, mass=1)
        yield stage.open()


def _asking(world, limits=None):
    ss = ssduck.Interpreter(limits=limits)
    ss.add_variable("sim", world)
    for name in ("board", "ball"):
        ss.add_variable(name, world[name])
    for _ in range(TICKS):
        world.step()
    return ss


@pytest.fixture
def slow(monkeypatch):
    """Each tick is a batch, and every report is due."""
    monkeypatch.setattr(batch_queries, "MAX_BATCH_SIZE", 1)
    monkeypatch.setattr(progress, "DELAY", 0.0)
    monkeypatch.setattr(progress, "INTERVAL", 0.0)


def _shown(monkeypatch, ss, stream):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", stream)
    ss.eval(ASKED)
    return stream.getvalue()


@pytest.mark.slow
def test_a_terminal_shows_how_many_are_done(monkeypatch, world, slow):
    with _asking(world) as ss:
        shown = _shown(monkeypatch, ss, Terminal())
        assert "comparing shapes at recorded ticks" in shown
        numbers = [tuple(map(int, pair)) for pair in re.findall(r"(\d+)/(\d+)", shown)]
        total = len(ss.past("sim").record.answer_cache)
        assert 1 < total <= len(ss.past("sim").ticks)
        assert set(numbers) == {(done, total) for done in range(1, total + 1)}
        # What was answered is not compared again.
        assert _shown(monkeypatch, ss, Terminal()) == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stream", "limits", "delay"),
    [
        pytest.param(io.StringIO, None, 0.0, id="no terminal"),
        pytest.param(Terminal, Limits(progress=False), 0.0, id="switched off"),
        pytest.param(Terminal, None, 1e9, id="a short program"),
    ],
)
def test_others_show_nothing(monkeypatch, world, slow, stream, limits, delay):
    monkeypatch.setattr(progress, "DELAY", delay)
    with _asking(world, limits) as ss:
        assert _shown(monkeypatch, ss, stream()) == ""


@pytest.mark.slow
def test_other_threads_show_nothing(monkeypatch, world, slow):
    with _asking(world) as ss, ThreadPoolExecutor(1) as other:
        assert other.submit(_shown, monkeypatch, ss, Terminal()).result() == ""


@pytest.mark.slow
def test_a_notebook_shows_a_line(monkeypatch, world, slow):
    # A stand-in for the display of a kernel, which runs in no test.
    display = ModuleType("IPython.display")
    monkeypatch.setitem(sys.modules, "IPython", ModuleType("IPython"))
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    lines = []

    class Handle:
        def update(self, bundle, *, raw):
            assert raw
            lines.append(bundle["text/plain"])

    def shown(bundle, *, raw, display_id):
        assert raw
        assert display_id
        lines.append(bundle["text/plain"])
        return Handle()

    monkeypatch.setattr(display, "display", shown, raising=False)
    monkeypatch.setattr(progress, "_is_notebook", lambda: True)
    with _asking(world) as ss:
        ss.eval(ASKED)
        total = len(ss.past("sim").record.answer_cache)
    assert lines[0] == ""
    assert lines[1].startswith(f"comparing shapes at recorded ticks: 1 of {total}")
    assert lines[-2].endswith(f"{total} of {total} (100%)")
    assert lines[-1] == ""


def _at_batch(monkeypatch, number, action):
    """Has an action happen before a batch; the list has the sizes of the batches that began."""
    begun = []
    place = EntityShapes._batch

    def batch(self, *arguments):
        begun.append(len(arguments[2]))
        if len(begun) == number:
            action()
        return place(self, *arguments)

    monkeypatch.setattr(EntityShapes, "_batch", batch)
    return begun


@pytest.mark.slow
def test_ctrl_c_leaves_all_as_it_was(monkeypatch, world, slow):
    with _asking(world) as ss:
        ss.eval("times = 1;")
        ticks, now = ss.past("sim").ticks, world.time
        begun = _at_batch(monkeypatch, 5, lambda: os.kill(os.getpid(), signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):
            ss.eval(f"times = 2; times = {ASKED}")
        assert len(begun) == 5
        assert ss.eval("times;") == 1
        assert world.time == now
        assert ss.past("sim").ticks == ticks
        monkeypatch.undo()
        interrupted = ss.eval(ASKED)
    assert interrupted
    assert interrupted[0][0] > 0.0


def _expire(meter):
    """Has the time of a program be up from now on."""
    meter._deadline = meter._first_look = 0.0
    meter.step = _clock(0.0, meter.limits.seconds, None)


def test_the_time_limit_ends_it_between_two_batches(monkeypatch, world, slow):
    with _asking(world, Limits(seconds=1000)) as ss:

        def expire():
            _expire(ss._database.connection.meter)

        begun = _at_batch(monkeypatch, 3, expire)
        with pytest.raises(LimitError, match="1000 s"):
            ss.eval(ASKED)
        assert len(begun) == 3


@pytest.mark.parametrize(
    ("program", "method"),
    [
        ("greatest(clearance(board, ball));", "distance"),
        ("least(penetration(board, ball));", "signed_distance"),
    ],
)
def test_the_time_limit_ends_it_within_a_batch(monkeypatch, world, program, method):
    compared = []
    compare = getattr(ShapeComparisons, method)
    with _asking(world, Limits(seconds=1000)) as ss:

        def count(self, *shapes):
            compared.append(shapes)
            if len(compared) == 2:
                _expire(ss._database.connection.meter)
            return compare(self, *shapes)

        monkeypatch.setattr(ShapeComparisons, method, count)
        with pytest.raises(LimitError, match="1000 s"):
            ss.eval(program)
    assert len(compared) == 2


def test_the_time_limit_ends_it_while_rows_become_entities(monkeypatch, world):
    convert = PlannedQuery._converted
    with _asking(world, Limits(seconds=1000)) as ss:

        def late(self, *arguments):
            _expire(ss._database.connection.meter)
            with pytest.raises(LimitError, match="1000 s"):
                convert(self, *arguments)
            raise LimitError("in time")

        monkeypatch.setattr(PlannedQuery, "_converted", late)
        with pytest.raises(LimitError, match="in time"):
            ss.eval("SELECT obj FROM sim{} AS list;")
