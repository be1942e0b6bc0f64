"""What callbacks of triggers may do, with and without queues."""

import gc
import threading
import warnings

import pytest

import ssduck
from ssduck.interpreter.triggers.registry import TriggerWarning
from tests.support.timing import HANGS
from tests.support.triggering import HEIGHT, Times, falling, state, until
from tests.support.warned import silent

# -- what a callback may do ----------------------------------------------------------------------


@pytest.mark.slow
def test_a_callback_may_query_and_move(ss, sim):
    heights = []

    def callback(_):
        heights.append(round(ss.eval(HEIGHT), 3))
        sim["ball"].move([0, 0, 10])

    program = "SELECT id FROM sim WHERE z(this) < 9 AS list;"
    ss.add_trigger("low", program, 1 / 240, callback, when="rising")
    sim.step(240)
    assert len(heights) == 2  # 1 m takes 0.447 s
    assert heights == pytest.approx([8.98] * 2, abs=0.03)


def test_a_callback_may_add_and_remove_triggers(ss, sim):
    got = []

    def first(_):
        got.append("first")
        ss.del_trigger("first")
        ss.add_trigger("first", HEIGHT, 0, lambda _: got.append("second"))
        if "doomed" in [t.name for t in ss.triggers()]:
            ss.del_trigger("doomed")

    ss.add_variable("v", 1)
    ss.add_trigger("first", "v;", 0, lambda _: None)
    ss.del_trigger("first")
    ss.add_trigger("start", "v;", 0, lambda value: value == 2 and first(None), when="change")
    ss.add_trigger("first", "v;", 1e6, lambda _: None)
    ss.add_trigger("doomed", "v;", 0, lambda value: got.append(f"doomed {value}"))
    ss.add_variable("v", 2)
    sim.step()
    assert got == ["doomed 1", "first", "second"]
    sim.step()
    assert got == ["doomed 1", "first", "second", "second"]


@pytest.mark.parametrize("interval", [0, 1 / 240, 0.01])
def test_stepping_in_a_callback_does_not_recurse(ss, sim, interval):
    """The steps are run; what became due meanwhile is evaluated after the next step."""
    calls = []

    def callback(_):
        calls.append(1)
        if len(calls) > 1:
            sim.step(24)
            assert sim.time > 0

    ss.add_trigger("t", HEIGHT, interval, callback)
    before = sim.time
    sim.step(10)
    evaluated = 10 if interval < 0.01 else len(calls) - 1
    assert len(calls) == 1 + evaluated
    assert sim.time - before == pytest.approx((10 + 24 * evaluated) / 240)


def test_stepping_another_world_in_a_callback(ss, sim, other):
    """A trigger about both is at work already; one about the other is told."""
    got, times = [], Times(other)
    ss.add_variable("n", 1)
    ss.add_function("times", lambda: sim.time + other.time)
    ss.add_trigger("both", "times();", 0, lambda _: got.append(1) or other.step(3))
    ss.add_trigger("second", "SELECT z FROM other;", 0, times)
    first = other.snapshot.number
    sim.step(4)
    assert len(got) == 5
    assert len(times) == 13
    assert other.snapshot.number == first + 12


def test_what_becomes_due_while_a_callback_steps(ss, sim):
    """Its own due times are passed over, those of others are made up for."""
    times, others = Times(sim), []
    ss.add_trigger("other", HEIGHT, 0.1, lambda _: others.append(round(sim.time * 240)))
    ss.add_trigger("t", HEIGHT, 0.1, lambda _: times(0) or sim.step(29))
    assert others == [0, 24]  # the world was not being stepped then
    sim.step(24)  # in which the callback steps from 48 to 77
    assert times == [0, 0.2]
    assert others == [0, 24, 48, 78]


def test_closing_in_a_callback(client):
    ss = ssduck.Interpreter()
    sim = ss.add_variable("sim", falling(client))
    ss.add_trigger("t", HEIGHT, 0, lambda height: height < 10 and ss.close())
    sim.step(5)  # the world is the client's owner's
    assert sim.time == pytest.approx(5 / 240)
    assert ss.triggers() == []


def test_ctrl_c_in_a_callback_is_heard(ss, sim):
    def callback(height):
        if height < 10:
            raise KeyboardInterrupt

    ss.add_trigger("t", HEIGHT, 0.1, callback)
    with pytest.raises(KeyboardInterrupt):
        sim.step(240)
    assert sim.time == pytest.approx(0.1)
    ss.del_trigger("t")
    sim.step(24)
    assert sim.time == pytest.approx(0.2)


# -- queues --------------------------------------------------------------------------------------


def test_a_slow_callback_has_a_thread_of_its_own(ss, sim):
    got, threads, go = [], set(), threading.Event()

    def slow(result):
        threads.add(threading.current_thread().name)
        got.append(result)
        go.wait(HANGS)

    ss.add_variable("v", 0)
    ss.add_trigger("t", "v;", 0, slow, queue=2)
    until(lambda: got == [0])
    for value in range(1, 6):
        ss.add_variable("v", value)
        sim.step()
    found = state(ss, "t")
    assert (found.firings, found.pending, found.dropped) == (6, 2, 3)
    go.set()
    until(lambda: len(got) == 3)
    assert got == [0, 4, 5]  # the oldest went
    assert threads == {"trigger t"}


def test_a_queue_tells_of_errors(ss, sim):
    def callback(height):
        raise ValueError(f"not at {height:.4f}")

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ss.add_trigger("t", HEIGHT, 0, callback, queue=1)
        until(lambda: caught)
    assert caught[0].category is TriggerWarning
    assert "trigger 't': its callback failed: ValueError: not at 10.0" in str(caught[0].message)
    assert str(state(ss, "t").error) == "not at 10.0000"
    # What is a warning elsewhere may be an error; the thread goes on.
    with silent():
        sim.step()
        until(lambda: state(ss, "t").failures == 2)


def named(name):
    return [thread for thread in threading.enumerate() if thread.name == name]


@pytest.mark.slow
@pytest.mark.parametrize("way", ["del_trigger", "close", "del"])
def test_threads_end(client, way):
    got = []
    ss = ssduck.Interpreter()
    sim = ss.add_variable("sim", falling(client))
    ss.add_trigger(way, HEIGHT, 0, got.append, queue=1)
    until(lambda: got)
    assert len(named(f"trigger {way}")) == 1
    if way == "close":
        ss.close()
        assert not named("trigger close")
    elif way == "del_trigger":
        ss.del_trigger(way)
        until(lambda: not named("trigger del_trigger"))
        ss.close()
    else:
        del ss
        gc.collect()
        until(lambda: not named("trigger del"))
    count = len(got)
    sim.step(3)
    assert len(got) == count


def test_a_queue_whose_callback_removes_its_trigger_and_steps(ss, sim):
    got = []

    def callback(result):
        got.append(result)
        sim.step(2)
        ss.del_trigger("t")
        ss.close()

    ss.add_trigger("t", HEIGHT, 0, callback, queue=1)
    until(lambda: not named("trigger t"))
    assert got == [10.0]
    assert sim.time == pytest.approx(2 / 240)


@pytest.mark.slow
def test_closing_does_not_wait_for_ever(ss, sim, monkeypatch):
    monkeypatch.setattr("ssduck.interpreter.triggers.registry.PATIENCE", 0.05)
    go = threading.Event()
    got = []
    ss.add_trigger("t", HEIGHT, 0, lambda _: got.append(1) or go.wait(HANGS), queue=1)
    until(lambda: got)
    with pytest.warns(TriggerWarning, match="trigger 't': its callback is still running") as caught:
        ss.close()
    assert [w.filename for w in caught] == [__file__]
    go.set()
