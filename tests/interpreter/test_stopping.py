"""Another thread stops programs: in DuckDB, in Python, and before they begin."""

import threading

import pytest

import ssduck
from ssduck.errors import LimitError
from ssduck.interpreter.stopping import StopRequest

BIG = "SELECT count(*) FROM range(9000000) a, range(9000000) b WHERE a.range + b.range = 7"


@pytest.fixture(params=[None, 3600])
def ss(request):
    with ssduck.Interpreter(limits=ssduck.Limits(seconds=request.param)) as ss:
        yield ss


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 0.001, 0.3])
def test_a_statement_is_stopped_whenever_that_is_asked(ss, delay):
    stop = StopRequest()
    timer = threading.Timer(delay, stop.make)
    timer.start()
    with stop.applies_to(ss), pytest.raises(LimitError, match="was stopped"):
        ss.sql(BIG)
    timer.join()
    assert ss.sql("SELECT 42").fetchall() == [(42,)]


def test_a_program_in_python_is_stopped(ss):
    stop, calls = StopRequest(), []

    def slow(number):
        calls.append(number)
        if len(calls) == 5:
            stop.make()
        return number

    ss.add_variable("n", list(range(10_000)))
    ss.add_function("slow", slow, "Counts its calls.")
    with stop.applies_to(ss), pytest.raises(LimitError, match="was stopped"):
        ss.eval("SELECT this FROM n WHERE slow(this) < 0 AS list;")
    assert len(calls) == 5
    assert ss.eval("SELECT this FROM [0, 1] WHERE this < 1 AS list;") == [0]


def test_a_program_that_begins_after_the_request_is_stopped(ss):
    stop = StopRequest()
    stop.make()
    stop.make()
    with stop.applies_to(ss), pytest.raises(LimitError, match="was stopped"):
        ss.sql(BIG)


def test_a_request_applies_to_its_interpreter_only(ss):
    stop = StopRequest()
    stop.make()
    with stop.applies_to(ss), ssduck.Interpreter() as other:
        assert other.sql("SELECT 42").fetchall() == [(42,)]
    assert ss.sql("SELECT 42").fetchall() == [(42,)]
