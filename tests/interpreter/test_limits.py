"""What programs from elsewhere may use; Ctrl-C; programs that another thread stops."""

import gc
import subprocess
import sys
import threading
import time

import pytest

import ssduck
from ssduck.errors import LimitError, SqlError
from ssduck.interpreter.stopping import StopRequest
from tests.support.cases import sampled
from tests.support.timing import HANGS

BIG = "SELECT a.this FROM a=n, b=n, c=n, d=n, e=n, f=n WHERE "


@pytest.fixture
def strict():
    yield from _confined(seconds=0.5)


@pytest.fixture
def patient():
    """One whose time does not run out before the other limits, however busy the machine is."""
    yield from _confined(seconds=HANGS)


def _confined(seconds, **changes):
    limits = ssduck.Limits.strict(
        seconds=seconds, rows=1000, memory=200_000_000, **changes, require=()
    )
    gc.disable()  # what other tests have left takes as long as a program may
    try:
        with ssduck.Interpreter(limits=limits) as interpreter:
            interpreter.add_variable("n", list(range(100)))
            interpreter.eval("kept = 1;")
            yield interpreter
    finally:
        gc.enable()


def fails(interpreter, act, kind, words):
    """It ends in time, changes nothing, and the session goes on."""
    started = time.process_time()
    with pytest.raises(kind, match=words):
        act()
    assert time.process_time() - started < 20
    assert interpreter.eval("kept;") == 1
    assert interpreter.eval("SELECT this FROM n WHERE this > 97 AS list;") == [98, 99]


ESCAPES = [
    "COPY (SELECT 1) TO 'out.csv'",
    "FROM read_csv('/etc/passwd')",
    "FROM read_text('/etc/passwd')",
    "FROM glob('/*')",
    "FROM '/etc/passwd'",
    "ATTACH 'other.db'",
    "EXPORT DATABASE 'folder'",
    "INSTALL httpfs",
    "LOAD httpfs",
    "SET enable_external_access = true",
    "SET lock_configuration = false",
    "SET memory_limit = '100GB'",
    "SET threads = 8",
    "RESET memory_limit",
    "PRAGMA threads=4",
    "FROM strict",
    "FROM a_local",
]


@pytest.fixture
def without_files():
    """One that takes any statement, so that DuckDB itself refuses those that reach files."""
    yield from _confined(seconds=HANGS, select_only=False)


@pytest.mark.slow
@sampled("text", ESCAPES, every=3)
def test_sql_reaches_nothing_outside(strict, without_files, text, tmp_path, monkeypatch):
    import pandas as pd

    monkeypatch.chdir(tmp_path)
    a_local = pd.DataFrame({"a": [1]})
    fails(without_files, lambda: without_files.sql(text), SqlError, ".")
    fails(strict, lambda: strict.sql(text), (LimitError, SqlError), ".")
    assert list(tmp_path.iterdir()) == []
    assert len(a_local) == 1


LONG_BUT_FLAT = [
    "SELECT '" + "(" * 5000 + "'",
    "SELECT E'\\'" + "(" * 5000 + "'",
    "SELECT $a$" + "(" * 5000 + "$a$",
    "SELECT 1 /* " + "(" * 5000 + " */ -- " + "[" * 5000,
    "SELECT " + "(1) + " * 200 + "1",
    "SELECT '" + "a " * 300_000 + "'",
]


@pytest.mark.slow
@pytest.mark.parametrize("text", LONG_BUT_FLAT, ids=lambda text: text[:15])
def test_brackets_in_texts_and_comments_do_not_count(text):
    with ssduck.Interpreter(limits=ssduck.Limits.strict(seconds=60.0, require=())) as ss:
        assert len(ss.sql(text)) == 1


def test_what_is_no_text_is_an_error_under_limits_too(patient):
    fails(patient, lambda: patient.sql("SELECT '\ud800'"), SqlError, "surrogate")


@pytest.mark.slow
@pytest.mark.parametrize("row_by_row", [False, True])
def test_the_clock_is_looked_at_between_slow_functions(row_by_row):
    calls = []

    def slow(number):
        calls.append(number)
        time.sleep(0.05)
        return number

    limits = ssduck.Limits(seconds=0.2)
    with ssduck.Interpreter(limits=limits, row_by_row=row_by_row) as ss:
        ss.add_variable("n", list(range(200)))
        ss.add_function("slow", slow, "Takes its time.")
        with pytest.raises(LimitError, match="took more than"):
            ss.eval("SELECT this FROM n WHERE slow(this) < 0 AS list;")
    assert len(calls) < 30


def test_ssducks_own_statements_are_not_cut_off(client):
    with ssduck.Interpreter(limits=ssduck.Limits(seconds=1e-9)) as ss:
        ss.add_variable("w", ssduck.World.attach(client))
        ss.add_variable("n", list(range(100)))
        with pytest.raises(LimitError, match="took more than"):
            ss.eval(BIG + "round(a.this + b.this) == -1 AS list;")
        assert ss.call_variable("w").name == "w"


def test_depth_is_how_many_rows_a_path_may_have():
    program = "SELECT this FROM [1] START WITH n=1 CONNECT BY n=n+1 STOP WITH n == {} AS list;"
    with ssduck.Interpreter(limits=ssduck.Limits(depth=5)) as interpreter:
        assert len(interpreter.eval(program.format(5))[0]) == 5
        with pytest.raises(LimitError, match="more than 5 rows"):
            interpreter.eval(program.format(6))


LOOKED_AT = [
    "SELECT a.this FROM a=n, b=n AS list;",
    "SELECT a.this FROM a=n, b=n WHERE a.this + b.this == -1 AS list;",
    "count(SELECT same(a.this) FROM a=n START WITH s=0 CONNECT BY s=s+1 STOP WITH s==2 AS list);",
    "SELECT this FROM n WHERE s == 5 START WITH s=0 CONNECT BY s=s+1 STOP WITH s > 2 AS list;",
]


@pytest.mark.parametrize("query", LOOKED_AT)
def test_rows_that_python_looks_at_are_counted(query):
    limits = ssduck.Limits(rows=1000)
    with ssduck.Interpreter(limits=limits, row_by_row=True) as interpreter:
        interpreter.add_variable("n", list(range(100)))
        interpreter.add_function("same", lambda value: value)
        with pytest.raises(LimitError, match="looks at more than 1000 rows") as caught:
            interpreter.eval(query)
        assert caught.value.span is not None
        # Each query has its own thousand.
        program = "SELECT count(SELECT b.this FROM b=n AS list) + a.this FROM a=n AS list;"
        assert interpreter.eval(program) == list(range(100, 200))


HANDLED = """
import os, signal, threading, ssduck
pressed = []
signal.signal(signal.SIGINT, lambda *_: pressed.append(1))
ss = ssduck.Interpreter()
threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
count = 0
while not pressed:
    (count,) = ss.sql("SELECT count(*) FROM range(3000000) WHERE range % 7 = 1").fetchone()
assert count == 428572
"""


@pytest.mark.slow
def test_a_handler_of_the_users_has_ctrl_c():
    """It does not stop the query; what it does is its own affair."""
    done = subprocess.run(
        [sys.executable, "-c", HANDLED], capture_output=True, text=True, timeout=HANGS, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


# -- stopped by another thread --------------------------------------------------------------------

ENDLESS = "SELECT count(*) FROM range(9000000) a, range(9000000) b WHERE a.range + b.range = 7"


@pytest.fixture(params=[None, 3600])
def stoppable(request):
    with ssduck.Interpreter(limits=ssduck.Limits(seconds=request.param)) as ss:
        yield ss


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 0.001, 0.3])
def test_a_statement_is_stopped_whenever_that_is_asked(stoppable, delay):
    stop = StopRequest()
    timer = threading.Timer(delay, stop.make)
    timer.start()
    with stop.applies_to(stoppable), pytest.raises(LimitError, match="was stopped"):
        stoppable.sql(ENDLESS)
    timer.join()
    assert stoppable.sql("SELECT 42").fetchall() == [(42,)]


def test_a_program_in_python_is_stopped(stoppable):
    stop, calls = StopRequest(), []

    def slow(number):
        calls.append(number)
        if len(calls) == 5:
            stop.make()
        return number

    stoppable.add_variable("n", list(range(10_000)))
    stoppable.add_function("slow", slow, "Counts its calls.")
    with stop.applies_to(stoppable), pytest.raises(LimitError, match="was stopped"):
        stoppable.eval("SELECT this FROM n WHERE slow(this) < 0 AS list;")
    assert len(calls) == 5
    assert stoppable.eval("SELECT this FROM [0, 1] WHERE this < 1 AS list;") == [0]


def test_a_program_that_begins_after_the_request_is_stopped(stoppable):
    stop = StopRequest()
    stop.make()
    stop.make()
    with stop.applies_to(stoppable), pytest.raises(LimitError, match="was stopped"):
        stoppable.sql(ENDLESS)


def test_a_request_applies_to_its_interpreter_only(stoppable):
    stop = StopRequest()
    stop.make()
    with stop.applies_to(stoppable), ssduck.Interpreter() as other:
        assert other.sql("SELECT 42").fetchall() == [(42,)]
    assert stoppable.sql("SELECT 42").fetchall() == [(42,)]
