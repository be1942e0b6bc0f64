"""Ctrl-C ends the statement that runs."""

from __future__ import annotations

import signal

import duckdb
import pytest

import ssduck
from ssduck.database.connection import MEMORY, Connection
from ssduck.database.database import Database
from ssduck.errors import SqlError
from ssduck.limits import Limits


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
        failing(duckdb.InterruptException("INTERRUPT")),
        failing(RuntimeError("Query interrupted")),
    ],
)
def test_ctrl_c_wins_over_the_errors_that_duckdb_makes_of_it(database, then):
    with pytest.raises(KeyboardInterrupt):
        database._execute("", lambda: swallowed(then))
    assert database.rows("SELECT 42") == [(42,)]


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (duckdb.BinderException("no such thing"), SqlError),
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
