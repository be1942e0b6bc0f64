"""Ctrl-C while a function of SQL is made: it can be made again."""

import pytest

from ssduck.database.connection import MEMORY, Connection
from ssduck.limits import Limits


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
