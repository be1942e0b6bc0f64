"""A connection to DuckDB for recorded ticks."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa

from ssduck.database.instances import damage_text, is_damage, log_of
from ssduck.database.running import translated
from ssduck.errors import RecordError, SqlError
from ssduck.recording.opened_record import OpenedRecord

# The size of DuckDB's log, in bytes, from which on it is moved to the file. That takes tenths of a
# second, and rewrites some earlier rows, so that fewer and larger moves take less time.
LONG_LOG = 1 << 26
_INCOMING = "rows to be stored"


class WriterConnection:
    """A connection of its own to the same database, for the recorded ticks of a world.

    It writes regardless of other connections, and reads on another one, which sees a
    transaction only after its end.
    """

    def __init__(
        self,
        connection: duckdb.DuckDBPyConnection,
        reading: duckdb.DuckDBPyConnection,
        file: Path | None = None,
        record: OpenedRecord | None = None,
    ) -> None:
        self._record = record
        self._connection = connection
        self._reading = reading
        self._file = file
        self._lock = threading.RLock()
        self._reading_lock = threading.RLock()

    def run(self, sql: str) -> None:
        """Runs a statement."""
        with self._lock, _storing_errors():
            self._connection.execute(sql).fetchall()

    def checkpoint(self) -> None:
        """Makes DuckDB move stored rows from its log into its file, if there are many.

        DuckDB would do so by itself, but invalidates the database if the disk is full then.
        """
        if self._file is None:
            return
        log = log_of(self._file)
        with self._lock, _storing_errors(), suppress(OSError, duckdb.TransactionException):
            size = log.stat().st_size
            if size > LONG_LOG and shutil.disk_usage(log.parent).free > 4 * size:
                self._connection.execute("CHECKPOINT")

    def insert(self, place: str, rows: pa.Table) -> None:
        """Adds rows to a table, by the names of its columns."""
        self._run_on_rows(f"INSERT INTO {place} BY NAME", rows)

    def insert_new(self, place: str, rows: pa.Table) -> None:
        """Creates a table from rows."""
        self._run_on_rows(f"CREATE TABLE {place} AS", rows)

    def _run_on_rows(self, statement: str, rows: pa.Table) -> None:
        with self._lock, _storing_errors():
            self._connection.register(_INCOMING, rows)
            try:
                self.run(f'{statement} SELECT * FROM "{_INCOMING}"')  # noqa: S608
            except BaseException:
                with suppress(duckdb.Error):  # before the rollback of an aborted transaction
                    self._connection.unregister(_INCOMING)
                raise
            self._connection.unregister(_INCOMING)

    def rows(
        self,
        sql: str,
        parameters: Sequence[Any] = (),
        tables: Mapping[str, pa.Table] | None = None,
    ) -> pa.Table:
        """Returns all rows of a SELECT, which may read the given tables."""
        self._check_record()
        try:
            with self._reading_lock, translated(), ExitStack() as stack:
                for name, table in (tables or {}).items():
                    self._reading.register(name, table)
                    stack.callback(self._reading.unregister, name)
                return self._reading.sql(sql, params=parameters).to_arrow_table()
        except duckdb.Error as error:
            raise self._reading_error(error) from error

    def fetchall(self, sql: str) -> list[tuple[Any, ...]]:
        """Returns all rows of a SELECT, as tuples."""
        self._check_record()
        try:
            with self._reading_lock, translated():
                return self._reading.execute(sql).fetchall()
        except duckdb.Error as error:
            raise self._reading_error(error) from error

    def _check_record(self) -> None:
        if self._record is not None:
            self._record.check()

    def _reading_error(self, error: duckdb.Error) -> SqlError | RecordError:
        if self._record is None:
            return SqlError(f"recorded ticks cannot be read: {error}")
        if is_damage(error):
            return RecordError(damage_text(self._record.path, error))
        return RecordError(f"{self._record.path} cannot be read: {error}")

    def close(self) -> None:
        """Closes the connection."""
        self._reading.close()
        self._connection.close()


@contextmanager
def _storing_errors() -> Iterator[None]:
    """Turns DuckDB's errors while rows are stored into ssduck's, or into KeyboardInterrupt."""
    try:
        with translated():
            yield
    except duckdb.FatalException as error:
        raise SqlError(
            f"DuckDB closed the database: {error}; the rows stored before are in the file: close "
            "this interpreter, and open the file again",
            is_final=True,
        ) from error
    except duckdb.Error as error:
        raise SqlError(
            f"recorded ticks cannot be stored: {error}; the rows stored before are "
            "intact, and the others wait in memory until there is space"
        ) from error
