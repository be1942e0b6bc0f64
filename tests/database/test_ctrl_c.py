"""Ctrl-C reaches the statement that it is meant for, and nothing stays behind."""

from __future__ import annotations

import dis
import signal
import socket
import subprocess
import sys
import threading

import duckdb
import pytest

import ssduck
from ssduck.database import running as ctrl_c
from ssduck.database.connection import MEMORY, Connection
from ssduck.database.database import Database
from ssduck.errors import SqlError
from ssduck.limits import Limits
from tests.support.timing import HANGS


@pytest.fixture(autouse=True)
def left_as_it_was():
    """Signals are written nowhere, and nobody listens, before and after each test."""
    kept = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, kept)
    assert signal.set_wakeup_fd(-1) == -1
    assert ctrl_c._line is None or ctrl_c._line.current is None


@pytest.fixture
def ss():
    with ssduck.Interpreter() as interpreter:
        interpreter.add_variable("n", list(range(3000)))
        yield interpreter


@pytest.fixture
def database():
    database = Database(":memory:", None)
    yield database.connection
    database.close()


def press():
    signal.raise_signal(signal.SIGINT)


# -- Ctrl-C is never lost -------------------------------------------------------------------


def swallowed(then):
    """What DuckDB's glue does with a KeyboardInterrupt."""
    with pytest.raises(KeyboardInterrupt):
        press()
    return then()


def failing(error):
    def fail():
        # One of its own: the traceback of a parameter would keep the connection until Python ends.
        raise type(error)(*error.args)

    return fail


@pytest.mark.parametrize(
    "then",
    [
        failing(duckdb.InvalidInputException("KeyboardInterrupt")),
        failing(duckdb.BinderException("no such thing")),
        failing(RuntimeError("Query interrupted")),
        failing(RuntimeError("something else")),
        failing(TypeError("something else")),
        list,
    ],
)
def test_ctrl_c_wins_whatever_duckdb_makes_of_it(database, then):
    with pytest.raises(KeyboardInterrupt):
        database._execute("", lambda: swallowed(then))
    assert database.rows("SELECT 42") == [(42,)]


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (duckdb.InvalidInputException("KeyboardInterrupt"), SqlError),
        (RuntimeError("something else"), RuntimeError),
        (TypeError("something else"), TypeError),
    ],
)
def test_without_ctrl_c_errors_are_what_they_are(database, error, kind):
    with pytest.raises(kind):
        database._execute("", failing(error))


QUERY = "SELECT h(a.this) FROM a=n WHERE h(a.this) > 5 AS list;"


def test_ctrl_c_in_a_function_shows_where_it_was(ss):
    def h(value: int) -> int:
        if value == 1000:
            press()
        return value

    ss.add_function("h", h)
    with pytest.raises(KeyboardInterrupt) as caught:
        ss.eval(QUERY)
    assert "press" in [entry.name for entry in caught.traceback]
    assert ss.eval("count(n);") == 3000


def test_a_function_that_makes_an_error_of_ctrl_c_does_not_keep_it(ss):
    calls = []

    def h(value: int) -> int:
        calls.append(value)
        try:
            press()
        except KeyboardInterrupt:
            raise ValueError("something else") from None
        return value

    ss.add_function("h", h)
    with pytest.raises(KeyboardInterrupt):
        ss.eval(QUERY)
    assert len(calls) == 1


# -- others' signals ------------------------------------------------------------------------


@pytest.fixture
def wakeup():
    """Someone else's place that signals are written to."""
    reader, writer = socket.socketpair()
    for end in (reader, writer):
        end.setblocking(False)
    kept = signal.signal(signal.SIGTERM, lambda *_: None)
    signal.set_wakeup_fd(writer.fileno())
    yield reader
    assert signal.set_wakeup_fd(-1) == writer.fileno()
    signal.signal(signal.SIGTERM, kept)
    reader.close()
    writer.close()


def test_whoever_was_told_of_signals_is_told_still(database, wakeup):
    def work():
        with ssduck.Interpreter() as inner:
            inner._database.connection._execute("", lambda: signal.raise_signal(signal.SIGTERM))
        swallowed(list)

    with pytest.raises(KeyboardInterrupt):
        database._execute("", work)
    assert wakeup.recv(64) == bytes([signal.SIGTERM, signal.SIGINT])


# -- nothing stays behind -------------------------------------------------------------------

OURS = {
    ctrl_c.InterruptListener.enter.__code__,
    ctrl_c.InterruptListener.leave.__code__,
    Connection._execute.__code__,
    Connection._run_in_time.__code__,
}


class Presser:
    """Presses Ctrl-C once, at the point of that number where Python looks for it in our code."""

    def __init__(self, when):
        self.when = when
        self.count = 0
        self.last = {}

    def __call__(self, frame, event, _):
        if frame.f_code not in OURS:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            last = self.last.get(frame)
            self.last[frame] = dis.opname[frame.f_code.co_code[frame.f_lasti]]
            if last is None or last.startswith(("CALL", "RESUME", "JUMP_BACKWARD")):
                self.count += 1
                if self.count == self.when:
                    raise KeyboardInterrupt
        return self


def pressed_at(database, when):
    """Whether there was a point of that number at all, and Ctrl-C was raised."""
    presser = Presser(when)
    before = sys.gettrace()
    sys.settrace(presser)
    try:
        database._execute("", int)
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    assert presser.count < when
    return False


def test_ctrl_c_at_any_point_leaves_all_as_it_was(monkeypatch):
    timers = []

    class Timer(threading.Timer):
        def __init__(self, *args):
            super().__init__(*args)
            timers.append(self)

    monkeypatch.setattr(threading, "Timer", Timer)
    database = Database(":memory:", None, Limits(seconds=10_000)).connection
    database.run("SELECT 1")
    when = 1
    while pressed_at(database, when):
        assert signal.set_wakeup_fd(-1) == -1, when
        assert ctrl_c._line.current is None, when
        assert not ctrl_c._line.lock.locked(), when
        assert all(timer.ident is None or timer.finished.is_set() for timer in timers), when
        timers.clear()
        when += 1
    assert when > 20
    assert database.rows("SELECT 42") == [(42,)]
    database.close()


# -- children -------------------------------------------------------------------------------

FORKED = """
import os, signal, ssduck
from ssduck.database import running as ctrl_c

def in_child():
    assert signal.set_wakeup_fd(-1) == -1
    assert ctrl_c._line is None
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        pass
    with ssduck.Interpreter() as inner:
        assert inner.sql("SELECT 42").fetchone() == (42,)
    assert signal.set_wakeup_fd(-1) == -1

def h(value: float) -> float:
    if value == 97.0:
        child = os.fork()
        if child == 0:
            try:
                in_child()
            except BaseException:
                import traceback
                traceback.print_exc()
                os._exit(1)
            os._exit(0)
        assert os.waitpid(child, 0)[1] == 0
    return value

ss = ssduck.Interpreter()
ss.add_variable("n", [float(x) for x in range(100)])
ss.add_function("h", h)
assert ss.eval("SELECT this FROM n WHERE h(this) > 97 AS list;") == [98.0, 99.0]
assert signal.set_wakeup_fd(-1) == -1
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="it has no fork")
def test_a_child_does_not_tell_its_parents_line():
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORKED],
        capture_output=True,
        text=True,
        timeout=HANGS,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")


# -- while functions are registered ----------------------------------------------------------------


class Interrupted:
    """DuckDB's connection, in which Ctrl-C comes before or after a function is made."""

    def __init__(self, connection, comes_after):
        self._connection, self._comes_after = connection, comes_after

    def __getattr__(self, name):
        return getattr(self._connection, name)

    def create_function(self, *arguments, **options):
        if self._comes_after:
            self._connection.create_function(*arguments, **options)
        raise KeyboardInterrupt


@pytest.mark.parametrize("comes_after", [False, True])
def test_a_function_is_made_again(monkeypatch, comes_after):
    connection = Connection(MEMORY, None, Limits(), [])
    register = ("doubled", lambda number: 2 * number, ["BIGINT"], "BIGINT")
    with monkeypatch.context() as patch:
        patch.setattr(connection, "_connection", Interrupted(connection._connection, comes_after))
        with pytest.raises(KeyboardInterrupt):
            connection.register_function(*register)
    for _ in range(2):
        connection.register_function(*register)
        assert connection.rows("SELECT doubled(21)") == [(42,)]
    connection.close()
