"""What programs from elsewhere may use; Ctrl-C."""

from __future__ import annotations

import gc
import signal
import subprocess
import sys
import time
from functools import partial

import pytest

import ssduck
from ssduck.errors import ArgumentError, LimitError, SelectScriptError, SqlError
from ssduck.limits import Limits, UsageMeter
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
        seconds=seconds, rows=1000, memory=200_000_000, **changes
    ).in_process
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


ENDLESS = [
    (BIG + "round(a.this + b.this) == -1 AS list;", "took more|more memory|more than 1000 rows"),
    (
        "SELECT this FROM n START WITH s=0 CONNECT BY s=s+1 STOP WITH False AS list;",
        "took more|more than 1000 rows|more memory",
    ),
    (
        "SELECT this FROM n WHERE s == 5 START WITH s=0 CONNECT BY s=s+1 STOP WITH s > 9 AS list;",
        "took more|more than 1000 rows|more memory",
    ),
    (
        "SELECT this, s FROM n START WITH s=0 CONNECT BY MEMORIZE s=s+1 STOP WITH False AS list;",
        "levels|took more|more memory|more than 1000 rows",
    ),
    ("SELECT a.this FROM a=n, b=n AS list;", "more than 1000 rows"),
    ("SELECT round(a.this) FROM a=n, b=n AS list;", "more than 1000 rows"),
    (
        "SELECT (SELECT b.this FROM b=n, c=n WHERE b.this > a.this AS list) FROM a=n, d=n, e=n AS list;",
        "rows|took more|more memory",
    ),
    ("eval('1');", "eval is switched off"),
    ("SELECT this FROM n WHERE eval('True') AS list;", "eval is switched off"),
]


@pytest.mark.slow
@sampled(("program", "words"), ENDLESS, every=3)
def test_programs_end(strict, program, words):
    fails(strict, lambda: strict.eval(program), LimitError, words)


LARGE = [
    "x = 3; " + "x = x * x; " * 60 + "x;",
    "x = 'a'; " + "x = x + x; " * 60 + "x;",
    "x = [1]; " + "x = [x, x]; " * 60 + "x == [x, x];",
    "x = [1]; " + "x = x + x; " * 60 + "x;",
    "10 ^ 10 ^ 1000000;",
    "pow(10, 10000000000);",
    "round(123, -10000000000);",
    "'a' * 100000000000;",
    "[1] * 100000000000;",
]


@pytest.mark.slow
@sampled("program", LARGE, every=3)
def test_results_without_measure_are_refused(patient, program):
    fails(patient, lambda: patient.eval(program), SelectScriptError, "large|digits|memory")


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


SQL = [
    (
        "SELECT count(*) FROM range(10000000) a, range(10000000) b WHERE a.range = b.range + 7",
        "more than 0.5 s|more memory",
    ),
    (
        "SELECT count(*) FROM range(1000000) a, range(1000000) b WHERE a.range * b.range = -7",
        "more than 0.5 s",
    ),
    ("FROM range(1001)", "more than 1000 rows"),
    ("SELECT list(range) FROM range(100000000)", "more memory|more than 0.5 s"),
]


@pytest.mark.slow
@sampled(("text", "words"), SQL, every=2)
def test_sql_ends(strict, text, words):
    fails(strict, lambda: strict.sql(text), LimitError, words)


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
    with ssduck.Interpreter(limits=ssduck.Limits.strict(seconds=60.0).in_process) as ss:
        assert len(ss.sql(text)) == 1


def test_what_is_no_text_is_an_error_under_limits_too(patient):
    fails(patient, lambda: patient.sql("SELECT '\ud800'"), SqlError, "surrogate")


@pytest.mark.long
def test_a_limit_within_a_function_that_sql_calls():
    limits = ssduck.Limits(seconds=0.5)
    with ssduck.Interpreter(limits=limits) as interpreter:

        def slow(value: int) -> int:
            time.sleep(0.001)
            return value

        interpreter.add_variable("n", list(range(100_000)))
        interpreter.add_function("slow", slow)
        started = time.process_time()
        with pytest.raises(LimitError, match=r"more than 0\.5 s"):
            interpreter.eval("SELECT this FROM n WHERE slow(this) < 0 AS list;")
        assert time.process_time() - started < 20
        assert interpreter.eval("SELECT this FROM [0, 1] WHERE this < 1 AS list;") == [0]


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


@pytest.mark.parametrize("name", ["seconds", "rows", "memory", "depth"])
@pytest.mark.parametrize("value", [0, -1, True])
def test_limits_are_more_than_nothing(name, value):
    with pytest.raises(ArgumentError, match=f"{name} must be more than 0"):
        ssduck.Limits(**{name: value})


def test_depth_is_how_many_rows_a_path_may_have():
    program = "SELECT this FROM [1] START WITH n=1 CONNECT BY n=n+1 STOP WITH n == {} AS list;"
    with ssduck.Interpreter(limits=ssduck.Limits(depth=5)) as interpreter:
        assert len(interpreter.eval(program.format(5))[0]) == 5
        with pytest.raises(LimitError, match="more than 5 rows"):
            interpreter.eval(program.format(6))


def test_without_limits_files_may_be_read(tmp_path):
    (tmp_path / "a.csv").write_text("a\n1\n")
    with ssduck.Interpreter() as interpreter:
        assert interpreter.sql("FROM read_csv($1)", [str(tmp_path / "a.csv")]).fetchall() == [(1,)]


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


INTERRUPTED = """
import signal, time, ssduck
ss = ssduck.Interpreter()
ss.add_variable("n", list(range(3000)))
ss.eval("kept = 1;")
def slow(value: int) -> int:
    time.sleep(0.0005)
    return value
ss.add_function("slow", slow)
ss.add_function("any", lambda value: value)
for statement in {}:
    try:
        print("ready", flush=True)
        eval(statement)
    except KeyboardInterrupt:
        assert ss.eval("kept;") == 1
        assert ss.eval("SELECT this FROM n WHERE this < 1 AS list;") == [0]
        assert ss.sql("SELECT 42").fetchone() == (42,)
        assert signal.set_wakeup_fd(-1) == -1
        print("went on", flush=True)
"""
# DuckDB makes one task of it, at whose end only it looks for signals.
PRODUCT = "SELECT count(*) FROM range(10000000) a, range(10000000) b"
LONG = [
    'ss.eval("kept = 2; SELECT count(SELECT a.this FROM a=n, b=n, c=n WHERE a.this*b.this*c.this == -1 AS list) FROM d=n, e=n AS list;")',
    'ss.eval("kept = 2; SELECT a.this FROM a=n, b=n WHERE any(a.this) == -1 AS list;")',
    'ss.eval("kept = 2; SELECT a.this FROM a=n, b=n WHERE slow(a.this + b.this) == -1 AS list;")',
    'ss.eval("kept = 2; SELECT any(this) FROM n WHERE s == 9 START WITH s=0 CONNECT BY s=s+1 STOP WITH s > 9 AS list;")',
    'ss.eval("kept = 2; SELECT a.this FROM a=n, b=n, c=n, d=n WHERE a.this*b.this*c.this*d.this == -1 AS list;")',
    f'ss.sql("{PRODUCT} WHERE a.range * b.range = -7")',
    f'ss.sql("CREATE TABLE t AS {PRODUCT} WHERE a.range * b.range = -7")',
    f'ss.sql("{PRODUCT} WHERE a.range < b.range")',
]


@pytest.mark.slow
@sampled("statements", [[LONG[0], LONG[5]], [*LONG[1:5], *LONG[6:]]], every=2)
def test_ctrl_c_stops_a_query_and_the_session_goes_on(statements):
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED.format(statements)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        for statement in statements:
            assert process.stdout.readline() == "ready\n", statement
            time.sleep(0.3)
            process.send_signal(signal.SIGINT)
            assert process.stdout.readline() == "went on\n", statement
        assert process.communicate(timeout=HANGS) == ("", "")
    finally:
        process.kill()


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


def test_each_step_looks_at_the_time_and_whether_the_program_was_stopped():
    asked = []

    def use(meter):
        count = meter.combination_counter()
        for _ in range(10):
            meter.step(), meter.charge(1), count()

    for limits in (Limits(), Limits.strict(seconds=3600).in_process, Limits(rows=100)):
        use(UsageMeter(limits))
    use(UsageMeter(Limits.strict().in_process, lambda: asked.append(1)))
    assert len(asked) == 30
    for stopped in (None, lambda: True):
        late = UsageMeter(Limits.strict(seconds=3600 if stopped else 0.001).in_process, stopped)
        time.sleep(0.002)
        for use_once in (late.step, partial(late.charge, 1), late.combination_counter()):
            with pytest.raises(LimitError):
                use_once()
