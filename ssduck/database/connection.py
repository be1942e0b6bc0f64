"""How statements run in DuckDB: in time, told to the tracer, and their errors as ssduck's."""

from __future__ import annotations

import inspect
import os
import re
import threading
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NoReturn, TypeAlias, TypeVar

import duckdb
import pyarrow as pa
from sqlglot import exp

from ssduck.database import interrupts as ctrl_c
from ssduck.database.writer import WriterConnection
from ssduck.errors import (
    EvaluationError,
    LimitError,
    RecordError,
    SelectScriptError,
    SqlError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.formatting import short_repr
from ssduck.limits import Limits, UsageMeter
from ssduck.recording.paths import given_path
from ssduck.recording.recorder import Recorder
from ssduck.sql.relations.relation import IDENTIFYING_COLUMNS

T = TypeVar("T")

Parameters: TypeAlias = Sequence[Any] | Mapping[str, Any] | None

_REFUSALS = (duckdb.BinderException, duckdb.ParserException, duckdb.CatalogException)
# Seconds after which a statement whose time is over is interrupted again.
AGAIN = 0.02
# So many rows are fetched one by one.
_BY_ROW = 100
# Of these types DuckDB gives the same values by column; of others, numpy has no such values.
_BY_COLUMN = frozenset(("BIGINT", "INTEGER", "DOUBLE", "BOOLEAN", "VARCHAR"))
# The name of a database that is in no file.
MEMORY = ":memory:"
# What an attached file with a record is called; no world can be.
_ATTACHED = "ssduck record file"


class Connection:
    """A connection to DuckDB, which is closed when nothing refers to it.

    Args:
        path: a DuckDB file, or `":memory:"`.
        tracer: is told each statement before it runs.
        limits: what SQL may use.
        recorders: what waits in these is stored before it is closed.

    Attributes:
        meter: how much of its limits the running program has used.
    """

    def __init__(
        self,
        path: str,
        tracer: Callable[[str], None] | None,
        limits: Limits,
        recorders: list[Recorder],
    ) -> None:
        self._path = path if path == MEMORY else _place_of(path, is_written=True)
        try:
            self._connection = duckdb.connect(self._path)
        except duckdb.Error as error:
            raise SqlError(_unopened(path, error)) from error
        # Left open until Python ends, it would print complaints there.
        self._finalizer = weakref.finalize(self, _finish, self._connection, recorders, os.getpid())
        self._tracer = tracer
        self.meter = UsageMeter(limits)
        self._functions: set[str] = set()
        self._at_start: dict[str, Callable[[], None]] = {}
        # What a function raised while SQL called it: DuckDB keeps but its words.
        self._raised: list[BaseException] = []
        # The data are small and the queries many: a second thread costs more than it gives.
        self.run("SET threads = 1")
        # In DuckDB 2.0.0 a range join of a prepared statement ends the database at its second run,
        # from 1,000 rows on, where it is a merge join; a nested loop is right.
        self.run("SET merge_join_threshold = 1000000000")
        # It would be drawn on standard output, amid what a program prints there.
        self.run("SET enable_progress_bar = false")
        # A name that no table has is an error, not a variable of the caller's.
        self.run("SET python_enable_replacements = false")
        if self.is_file:
            self.run("SET wal_autocheckpoint = '1TB'")  # see Writer.settle

    def confine(self) -> None:
        """Let what comes do no more than the limits say."""
        limits = self.meter.limits
        if limits.memory is not None:
            memory = exp.Literal.string(f"{limits.memory}B").sql("duckdb")
            self.run(f"SET memory_limit = {memory}")
            # What does not fit is an error, and no file in the working directory.
            self.run("SET temp_directory = ''")
        if not limits.files:
            self.run("SET enable_external_access = false")
            self.run("SET lock_configuration = true")

    @property
    def is_file(self) -> bool:
        """Whether it is to a file."""
        return self._path != MEMORY

    @property
    def is_open(self) -> bool:
        """Whether it was not closed."""
        return self._finalizer.alive

    def close(self) -> None:
        """Store what waits, and close it.

        Raises:
            SqlError: what waits cannot be stored, for the disk is full, say; it is closed then.
        """
        self._finalizer()

    def writer(self) -> WriterConnection:
        """A connection of its own, for what is kept of a world."""
        return WriterConnection(self._connection, Path(self._path) if self.is_file else None)

    def attach(self, path: Path) -> str:
        """Let a DuckDB file be read; tells what it is called here.

        Raises:
            RecordError: it is no DuckDB file, or in use by another process.
        """
        try:
            file = exp.Literal.string(_place_of(str(path))).sql("duckdb")
        except SqlError as error:
            raise RecordError(error.message) from error
        name = exp.to_identifier(_ATTACHED, quoted=True).sql("duckdb")
        try:
            self.run(f"ATTACH {file} AS {name} (READ_ONLY)")
        except SqlError as error:
            raise RecordError(_unopened(str(path), error)) from error
        return _ATTACHED

    def show(self, name: str, table: pa.Table) -> None:
        """Let DuckDB see a table under a name."""
        self._connection.register(name, table)

    def unshow(self, name: str) -> None:
        """Let DuckDB forget a table."""
        self._connection.unregister(name)

    def add_function(
        self,
        name: str,
        function: Callable[..., Any],
        takes: Sequence[str],
        gives: str,
        *,
        at_start: Callable[[], None] | None = None,
        **how: Any,
    ) -> None:
        """Make a function one of SQL, by that name; replaces one that has it.

        What it raises is raised by the statement that called it.

        Args:
            name: what it is called.
            function: takes as many arguments; it must not keep this object alive.
            takes: the types of its arguments, in SQL.
            gives: that of its result.
            at_start: is called before each statement.
            how: what else DuckDB is to know of it.
        """
        if name in self._functions:
            self._connection.remove_function(name)
        raised = self._raised

        def call(*arguments: Any) -> Any:
            try:
                return function(*arguments)
            except BaseException as error:
                raised[:] = [error]
                raise

        _give_arity(call, len(takes))
        types: list[Any] = list(takes)
        result: Any = gives
        self._connection.create_function(name, call, types, result, **how)
        self._functions.add(name)
        if at_start is not None:
            self._at_start[name] = at_start

    # -- statements -----------------------------------------------------------------------

    def rows(self, sql: str, parameters: Parameters = None) -> list[tuple[Any, ...]]:
        """All rows of a statement that the translator wrote; the caller holds the worlds."""
        most = self.meter.limits.rows

        def fetched() -> list[tuple[Any, ...]]:
            result = self._connection.execute(sql, parameters)
            return _all_rows(result) if most is None else result.fetchmany(most + 1)

        rows = self._told(sql, fetched)
        self.meter.check_rows(len(rows))
        return rows

    def table(self, sql: str, parameters: Parameters) -> pa.Table:
        """All rows of a statement that a user wrote; the caller holds the worlds."""
        most = self.meter.limits.rows

        def fetched() -> pa.Table:
            relation = self._connection.sql(sql, params=parameters)
            if relation is None:
                return pa.table({})
            return (relation if most is None else relation.limit(most + 1)).to_arrow_table()

        table = self._told(sql, fetched)
        self.meter.check_rows(table.num_rows)
        return table

    def run(self, sql: str, *, timed: bool = False) -> None:
        """Run a statement of ssduck's own; whatever a program may take, it is not cut off."""
        self._told(sql, lambda: self._connection.execute(sql).fetchall(), timed=timed)

    def own_rows(self, sql: str, parameters: Parameters = None) -> list[tuple[Any, ...]]:
        """All rows of a statement of ssduck's own, which no time limit ends."""
        work = partial(self._connection.execute, sql, parameters)
        return self._told(sql, lambda: work().fetchall(), timed=False)

    def _told(self, sql: str, work: Callable[[], T], *, timed: bool = True) -> T:
        """Tell the tracer of a statement, run it, and end it in time.

        DuckDB's errors become ssduck's. At Ctrl-C, Python raises at the first call behind
        DuckDB's error, or in DuckDB, which makes an error of its own of it, or nothing.
        """
        if self._tracer is not None:
            self._tracer(sql)
        self._raised.clear()
        for begin in self._at_start.values():
            begin()
        listening = ctrl_c.InterruptListener(self._interrupt)
        try:
            result = self._in_time(work, listening, self._timer() if timed else None)
        except Exception as error:
            if not (listening.pressed or _is_duckdbs(error)):
                raise
            self._complain(error, interrupted=listening.pressed)
        if listening.pressed:
            raise KeyboardInterrupt
        return result

    def _in_time(
        self,
        work: Callable[[], T],
        listening: ctrl_c.InterruptListener,
        timer: threading.Timer | None,
    ) -> T:
        try:
            listening.enter()
            if timer is not None:
                timer.start()
            result = work()
        finally:
            try:
                _end(listening, timer)
            except KeyboardInterrupt:  # it may have come before the end
                _end(listening, timer)
                raise
        return result

    def _timer(self) -> threading.Timer | None:
        remaining = self.meter.remaining
        if remaining is None:
            return None

        def interrupt() -> None:
            # A statement that has not begun yet does not notice.
            self._interrupt()
            while not timer.finished.wait(AGAIN):
                self._interrupt()

        timer = threading.Timer(remaining, interrupt)
        timer.daemon = True
        return timer

    def _interrupt(self) -> None:
        with suppress(duckdb.Error):  # it was closed meanwhile
            self._connection.interrupt()

    def _complain(self, error: Exception, *, interrupted: bool) -> NoReturn:
        cause = self._raised.pop() if self._raised else None
        if isinstance(cause, KeyboardInterrupt):
            raise cause from None
        if interrupted:
            raise KeyboardInterrupt from error
        if isinstance(cause, LimitError | UnknownNameError | UnsupportedError | EvaluationError):
            raise cause from None
        if not self.is_open:
            raise SqlError("the interpreter is closed", is_final=True) from error
        self.meter.check_time()
        if isinstance(error, RuntimeError | duckdb.InterruptException):
            raise KeyboardInterrupt from error
        if isinstance(error, duckdb.OutOfMemoryException):
            raise LimitError(f"the query takes more memory than there is: {error}") from error
        refused = isinstance(error, _REFUSALS)
        raise SqlError(str(error).strip() + _hint(error), is_refused=refused) from error


_LACKS = re.compile('Could not find key "(\\w+)" in struct')


def _hint(error: Exception) -> str:
    """What to write where a row has not all columns that a relation of shapes reads."""
    found = _LACKS.search(str(error))
    if found is None or found.group(1) not in IDENTIFYING_COLUMNS:
        return ""
    return (
        f"\nRelations look at {', '.join(IDENTIFYING_COLUMNS)} of a row, to know whose it is: "
        "give them whole rows of entities (SELECT *); a record that is older than the column run "
        "is to be opened"
    )


def _all_rows(result: duckdb.DuckDBPyConnection) -> list[tuple[Any, ...]]:
    """All rows of a result: many of them column by column, which takes a quarter of the time."""
    rows: list[tuple[Any, ...]] = result.fetchmany(_BY_ROW)
    if len(rows) == _BY_ROW:
        if all(str(column[1]) in _BY_COLUMN for column in result.description):
            columns = result.fetchnumpy().values()
            rows.extend(zip(*(column.tolist() for column in columns), strict=True))
        else:
            rows.extend(result.fetchall())
    return rows


def _is_duckdbs(error: Exception) -> bool:
    """Whether DuckDB raised it; of Ctrl-C it tells by a RuntimeError."""
    if isinstance(error, RuntimeError):
        return "interrupted" in str(error).lower()
    return isinstance(error, duckdb.Error)


def _end(listening: ctrl_c.InterruptListener, timer: threading.Timer | None) -> None:
    listening.leave()
    if timer is not None:
        timer.cancel()
        if timer.is_alive():
            timer.join()  # so that it does not interrupt what comes next


def _place_of(path: str, *, is_written: bool = False) -> str:
    """The path of a file as DuckDB takes it: absolute, or `md:x` would be a service's.

    Raises:
        SqlError: the path has a character that DuckDB takes for another one, or none of a path.
    """
    try:
        place = str(given_path(path).absolute())
        place.encode()
    except (OSError, RuntimeError, ValueError) as error:
        raise SqlError(f"{short_repr(path)} is no path of a file: {error}") from error
    if "\0" in place or ("\\" in place and os.sep != "\\"):
        raise SqlError(
            f"{short_repr(path)} cannot be the path of a DuckDB file: DuckDB takes a backslash "
            "for a "
            "slash, and knows no null character"
        )
    if is_written and "?" in str(Path(place).parent):  # its log would be in a folder without it
        raise SqlError(
            f"{short_repr(path)} cannot be the path of a DuckDB file: DuckDB takes what is "
            "behind a "
            "question mark in the name of a folder for no part of it; rename the folder"
        )
    return place


def _unopened(path: str, error: Exception) -> str:
    """What to say where a file cannot be opened."""
    if "already attached" in str(error):
        return f"{path} is open in this process: close it first, or ask the interpreter that has it"
    if "lock" in str(error).lower():
        return (
            f"{path} is in use by another process, and DuckDB lets one at a time: close it there, "
            f"or export it there as Parquet, which any number can read: {str(error).strip()}"
        )
    return f"{path} cannot be opened: {str(error).strip()}"


def _finish(connection: duckdb.DuckDBPyConnection, recorders: list[Recorder], process: int) -> None:
    """Store what waits, and close; in a process that was forked, leave that to the other one."""
    if os.getpid() != process:
        return
    if any(recorder.is_stored_here for recorder in recorders):  # what collects garbage
        threading.Thread(target=_finish, args=(connection, recorders, process)).start()
        return
    failed = None
    try:
        for recorder in recorders:
            try:
                recorder.flush()
            except SelectScriptError as error:
                failed = failed or error
    finally:  # else its functions, which may refer to it, would keep it until Python ends
        connection.close()
    if failed is not None:
        raise failed


def _give_arity(call: Callable[..., Any], count: int) -> None:
    """Tell DuckDB how many arguments a function takes."""
    kinds = [inspect.Parameter(f"a{i}", inspect.Parameter.POSITIONAL_ONLY) for i in range(count)]
    call.__signature__ = inspect.Signature(kinds)  # type: ignore[attr-defined]
