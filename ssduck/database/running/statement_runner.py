"""Runs statements on a connection, traced and in time: `StatementRunner`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NoReturn, TypeVar

import duckdb

from ssduck.database.fetched_rows import (
    is_duckdb_error,
)
from ssduck.database.file_paths import (
    damage_text,
    hint_of,
    is_damage,
    needed_extension,
)
from ssduck.database.running import interrupts as ctrl_c
from ssduck.database.running.interrupts import DEADLINES
from ssduck.errors import (
    EvaluationError,
    LimitError,
    RecordError,
    SqlError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.limits import Limits, UsageMeter
from ssduck.recording.opened_record import OpenedRecord

T = TypeVar("T")

_REFUSAL_ERRORS = (duckdb.BinderException, duckdb.ParserException, duckdb.CatalogException)
# Errors that a file may cause.
_READING_ERRORS = (duckdb.IOException, duckdb.InvalidInputException, duckdb.SerializationException)
# Errors of functions that SQL calls, which stay as they are.
_OWN_ERRORS = (LimitError, UnknownNameError, UnsupportedError, EvaluationError, RecordError)


class StatementRunner(ABC):
    """Runs statements on a connection to DuckDB, traced, and interrupts them in time.

    Args:
        connection: the connection.
        tracer: a function that is called with each statement before it runs; None for none.
        limits: the limits of SQL.

    Attributes:
        meter: the use of the running program's limits.
    """

    def __init__(
        self,
        connection: duckdb.DuckDBPyConnection,
        tracer: Callable[[str], None] | None,
        limits: Limits,
    ) -> None:
        self._connection = connection
        self._tracer = tracer
        self.meter = UsageMeter(limits)
        # A record that is read.
        self._opened: OpenedRecord | None = None
        # The attached file with a record.
        self._attached: Path | None = None
        # What functions do before each statement.
        self._at_start: dict[str, Callable[[], None]] = {}
        # The exception of a function that SQL called: DuckDB keeps its text only.
        self._raised: list[BaseException] = []

    @property
    @abstractmethod
    def is_open(self) -> bool:
        """Whether the connection is open."""

    def _execute(self, sql: str, work: Callable[[], T], *, timed: bool = True) -> T:
        """Traces a statement, runs it, and interrupts it when the time is up.

        DuckDB's errors become ssduck's. At Ctrl-C, Python raises at the first call after
        DuckDB's error, or inside DuckDB, which makes another error of it, or none.
        """
        if self._opened is not None:
            self._opened.check()
        if self._tracer is not None:
            self._tracer(sql)
        self._raised.clear()
        for begin in self._at_start.values():
            begin()
        listener = ctrl_c.InterruptListener(self._interrupt)
        try:
            result = self._run_in_time(work, listener, is_timed=timed)
        except Exception as error:
            if isinstance(error, MemoryError):
                raise LimitError("the query needs more memory than available") from error
            if not (listener.pressed or is_duckdb_error(error)):
                raise
            self._raise_error(error, interrupted=listener.pressed)
        if listener.pressed:
            raise KeyboardInterrupt
        return result

    def _run_in_time(
        self, work: Callable[[], T], listener: ctrl_c.InterruptListener, *, is_timed: bool
    ) -> T:
        is_timed = is_timed and self.meter.deadline is not None
        try:
            listener.enter()
            if is_timed:
                DEADLINES.begin(listener, self.meter, self._interrupt)
            result = work()
        finally:
            try:
                _end(listener, is_timed=is_timed)
            except KeyboardInterrupt:  # it may have come before `_end` was done
                _end(listener, is_timed=is_timed)
                raise
        return result

    def _interrupt(self) -> None:
        with suppress(duckdb.Error):  # it was closed meanwhile
            self._connection.interrupt()

    def _raise_error(self, error: Exception, *, interrupted: bool) -> NoReturn:
        cause = self._raised.pop() if self._raised else None
        if isinstance(cause, KeyboardInterrupt):
            raise cause from None
        if interrupted:
            raise KeyboardInterrupt from error
        if isinstance(cause, _OWN_ERRORS):
            raise cause from None
        if not self.is_open:
            raise SqlError("the interpreter is closed", is_final=True) from error
        self.meter.check_time()
        if isinstance(error, RuntimeError | duckdb.InterruptException):
            raise KeyboardInterrupt from error
        if self._attached is not None and is_damage(error):
            raise RecordError(damage_text(self._attached, error)) from error
        if isinstance(error, duckdb.OutOfMemoryException):
            raise LimitError(f"the query needs more memory than available: {error}") from error
        if not self.meter.limits.files and (extension := needed_extension(error)) is not None:
            raise LimitError(
                f"the statement needs DuckDB's extension {extension!r}, which is not loaded, and "
                "files are switched off here (Limits: files)"
            ) from error
        if self._opened is not None and isinstance(error, _READING_ERRORS):
            unreadable = self._opened.reading_error(str(error))
            if unreadable is not None:
                raise unreadable from error
        text = str(error).strip()
        refused = isinstance(error, _REFUSAL_ERRORS)
        raise SqlError(text + hint_of(error), is_refused=refused) from error


def _end(listener: ctrl_c.InterruptListener, *, is_timed: bool) -> None:
    listener.leave()
    if is_timed:
        DEADLINES.end(listener)  # so that it does not interrupt what comes next
