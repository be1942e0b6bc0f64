"""The one door to DuckDB: worlds as schemas, statements, and the tick that they run on."""

from __future__ import annotations

import inspect
import os
import re
import shutil
import threading
import weakref
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import accumulate, count
from pathlib import Path
from typing import Any, Literal, NoReturn, TypeAlias, TypeVar

import duckdb
import pyarrow as pa
from duckdb.func import FunctionNullHandling, PythonUDFType
from sqlglot import exp

from ssduck import ctrl_c
from ssduck.catalog import TABLE_MACROS, described, dropped, looking_up
from ssduck.errors import (
    ArgumentError,
    EvaluationError,
    LimitError,
    RecordError,
    SelectScriptError,
    Span,
    SqlError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.export import exported
from ssduck.functions import Function
from ssduck.history import (
    ABOUT,
    Archive,
    History,
    Near,
    Shown,
    history_name,
    model_name,
    not_recorded,
)
from ssduck.limits import Limits, Meter
from ssduck.memory import Memory
from ssduck.models import MODELS
from ssduck.record import PAIR, Record
from ssduck.recorded_world import RecordedWorld
from ssduck.recorder import MEMORY_TICKS, RING_TICKS, Recorder
from ssduck.recording import RECORDABLE, Recording, check_names
from ssduck.rings import FRAMES
from ssduck.sealed import PART_TICKS, Folder, FolderRecording
from ssduck.shapes import ANSWERS, Shapes
from ssduck.tables import TABLES, Column, LiveTable
from ssduck.then import TOLD
from ssduck.types import Signature, Tag, converter, is_exactly
from ssduck.udfs import NARROW, THEN, THEN_COLLIDING, THEN_TOLD
from ssduck.world import UNNAMED, World

T = TypeVar("T")

Parameters: TypeAlias = Sequence[Any] | Mapping[str, Any] | None

_REFUSALS = (duckdb.BinderException, duckdb.ParserException, duckdb.CatalogException)
# Schemas that DuckDB has already.
_TAKEN = frozenset(("main", "temp", "system", "pg_catalog", "information_schema"))
# The tables that a word in a statement stands for: a table's name, or that of a relation that
# looks things up in some.
_TABLES_OF = {
    **{name.lower(): frozenset((name,)) for name in TABLES},
    **{relation.name.lower(): relation.tables for relation in looking_up()},
    **{table.name: frozenset(("shapes",)) for table in TABLE_MACROS},
}
_TABLE_WORDS = re.compile(rf"\b({'|'.join(_TABLES_OF)})\b", re.IGNORECASE | re.ASCII)
_KEEPS_A_QUERY = re.compile(r"\b(CREATE|PREPARE)\b", re.IGNORECASE)
# What lets tables of another world than the first go without its name.
_CHANGES_THE_FIRST = re.compile(r"\b(USE|search_path|schema)\b", re.IGNORECASE)


# SQL with more words, or with more brackets around one of them, takes DuckDB's parser a time that
# nothing ends.
MOST_WORDS = 200_000
MOST_BRACKETS = 100
# Seconds after which a statement whose time is over is interrupted again.
AGAIN = 0.02

# So many rows are fetched one by one.
_BY_ROW = 100
# Of these types DuckDB gives the same values by column; of others, numpy has no such values.
_BY_COLUMN = frozenset(("BIGINT", "INTEGER", "DOUBLE", "BOOLEAN", "VARCHAR"))

# What our prepared statements are called, in front of a number and of the tables that they read.
_OURS = "ssduck statement "
# The tables of a world whose buffers may be made anew.
_KNOWN = frozenset((*TABLES, *map(history_name, ("ticks", *RECORDABLE, FRAMES))))
# What refers to a world's buffers, as a regular expression in SQL.
_LOST = exp.Literal.string(r'"world \d+: ').sql("duckdb")
# No source can be called so, for it is no name.
_PARAMETERS = "the parameters"


class Statement:
    """A SELECT that DuckDB plans once and runs many times.

    Planning is most of what a small query costs. DuckDB keeps the plan of a prepared statement
    only if it has no parameters; so these become the columns of a table of one row, which is
    written in place. Such a plan goes on reading the buffers that it was made for; when
    buffers are made anew, it is made anew.

    Args:
        database: where it runs.
        select: the SELECT, its parameters as `exp.Parameter`.
        types: of the parameters, by name; all of them numbers.
    """

    _numbers = count(1)

    def __init__(
        self,
        database: Database,
        select: exp.Select,
        types: Mapping[str, Literal["real", "integer"]],
    ) -> None:
        self._database = database
        # The entities' buffers are made anew, too, when nothing else of the worlds is as it was.
        self._reads = frozenset(("entities", *(t.name for t in select.find_all(exp.Table))))
        self._name = _statement_name(next(self._numbers), self._reads)
        self._row = LiveTable(tuple(Column(name, type, "") for name, type in types.items()))
        self._row.fill(1, {})
        self._prepared_for: int | None = None
        tree = select.copy()
        self._has_parameters = bool(types)
        if types:
            _read_parameters(tree, exp.table_(self._name, quoted=True, alias=_PARAMETERS))
        name = exp.to_identifier(self._name, quoted=True).sql("duckdb")
        self._prepare = f"PREPARE {name} AS {tree.sql('duckdb')}"
        self._execute = f"EXECUTE {name}"
        self._deallocate = f"DEALLOCATE {name}"

    def rows(self, values: Mapping[str, float]) -> list[tuple[Any, ...]]:
        """All rows for these values of the parameters; the caller holds the worlds."""
        for name, value in values.items():
            self._row[name][0] = value
        generation = self._database.generation(self._reads)
        if self._prepared_for != generation:
            if self._has_parameters:
                self._database.show(self._name, self._row.arrow)
            self._database.run(self._prepare, timed=True)
            self._prepared_for = generation
        try:
            return self._database.rows(self._execute)
        except SelectScriptError:
            self._release()
            raise

    def _release(self) -> None:
        """Let go of the memory that DuckDB keeps for a statement that failed."""
        self._prepared_for = None
        with suppress(SelectScriptError):
            self._database.run(self._deallocate)

    def forget(self) -> None:
        """Let DuckDB forget it."""
        if self._prepared_for == self._database.generation(self._reads):
            self._database.run(self._deallocate)
            self._prepared_for = None
        if self._has_parameters:
            self._database.unshow(self._name)


def _statement_name(number: int, reads: Iterable[str]) -> str:
    """What a prepared statement of ours is called."""
    return f"{_OURS}{number} {' '.join(sorted(_KNOWN & set(reads)))}"


def _check_length(sql: str) -> None:
    """Complain of SQL that DuckDB would parse for a long time; it cannot be stopped there.

    Raises:
        LimitError: it is too long, or nested too deeply.
    """
    letters = sql.encode("utf-8", "replace")  # DuckDB itself complains of what is no letter
    words = duckdb.tokenize(letters.decode())
    if len(words) > MOST_WORDS:
        raise LimitError(f"SQL of {len(words)} words; under a limit it may have {MOST_WORDS}")
    depth = 0
    for place, _ in words:
        depth += _DEEPER.get(letters[place], 0)
        if depth > MOST_BRACKETS:
            start = len(letters[:place].decode())
            told = f"SQL nested deeper than {MOST_BRACKETS} brackets"
            raise LimitError(told, text=sql, span=Span(start, start + 1))


_DEEPER = {**dict.fromkeys(b"([{", 1), **dict.fromkeys(b")]}", -1)}


def _usable(value: Any, tag: Tag) -> Any:
    """A value that SQL gives back as it is: it would make 3.0 of 3, and nothing of a NaN."""
    if not is_exactly(value, tag):
        raise ValueError("no value for SQL")
    return value


def _give_arity(call: Callable[..., Any], count: int) -> None:
    """Tell DuckDB how many arguments a function takes."""
    kinds = [inspect.Parameter(f"a{i}", inspect.Parameter.POSITIONAL_ONLY) for i in range(count)]
    call.__signature__ = inspect.Signature(kinds)  # type: ignore[attr-defined]


def _read_parameters(tree: exp.Select, row: exp.Expr) -> None:
    """Make parameters columns of a table of one row, in each SELECT that has some."""
    reading: list[exp.Select] = []
    for parameter in list(tree.find_all(exp.Parameter)):
        select = parameter.find_ancestor(exp.Select)
        assert isinstance(select, exp.Select)
        if not any(select is other for other in reading):
            reading.append(select)
        parameter.replace(exp.column(parameter.name, table=_PARAMETERS, quoted=True))
    for select in reading:
        if select.args.get("from_"):
            # In front of joins whose conditions have some in them.
            joins = select.args.get("joins") or []
            select.set("joins", [exp.Join(this=row.copy(), kind="CROSS"), *joins])
        else:
            select.from_(row.copy(), copy=False)


@dataclass
class _Bound:
    """A world in this database.

    Attributes:
        world: the world.
        key: what its buffers are called among DuckDB's temporary views.
        schemas: its names here; the first is the one that ssduck's own statements use.
        versions: those of the tables that DuckDB has been shown.
        kept: its history; None if its ticks are not recorded.
    """

    world: World
    key: str
    schemas: list[str] = field(default_factory=list)
    versions: dict[str, int] = field(default_factory=dict)
    kept: _Kept | None = None

    def shapes(self, tick: int | None, ids: Sequence[int]) -> Shapes:
        """The shapes at a tick, those of some entities at least, or at the present one.

        Raises:
            EvaluationError: the tick is not recorded.
        """
        snapshot = self.world.snapshot
        if tick is None or tick == snapshot.number:
            return snapshot.shapes()
        if self.kept is None:
            raise UnsupportedError(
                f"the shapes of {self.world.name!r} are known of its tick {snapshot.number} only: "
                "its ticks are not recorded, so that rows of another one cannot be compared"
            )
        return self.kept.record.shapes(tick, ids)

    def told(self, what: str, tick: int, a: int, b: int) -> list[float]:
        """What contacts or sensors told at a recorded tick.

        Raises:
            UnsupportedError: they are not recorded.
        """
        if self.kept is None:
            raise UnsupportedError(f"the ticks of {self.world.name!r} are not recorded")
        record = self.kept.record

        def rows(table: str) -> Mapping[str, Any]:
            if table not in record.tables:
                raise UnsupportedError(not_recorded(table, self.world.name))
            return record.rows(table, tick)

        return TOLD[what](rows, a, b)


@dataclass(frozen=True)
class _Kept:
    """The history of a world: who keeps it, where, and how it is told.

    Attributes:
        history: where it is stored.
        record: tells it.
        recorder: keeps it; None if it is only read.
        shown: the rows that DuckDB is shown where they are, by table.
    """

    history: Archive
    record: Record
    recorder: Recorder | None = None
    shown: tuple[Mapping[str, Shown], ...] = ()


class Writer:
    """A connection of its own to the same database, for what is kept of a world.

    It writes whatever other connections do, and reads on another one, which sees nothing of a
    transaction before its end.

    Args:
        connection: to the database.
        file: where that is; None for memory.
    """

    def __init__(self, connection: duckdb.DuckDBPyConnection, file: Path | None = None) -> None:
        self._connection = connection.cursor()
        self._reading = connection.cursor()
        self._file = file
        self._lock = threading.RLock()
        self._reading_lock = threading.RLock()

    def run(self, sql: str) -> None:
        """Run a statement.

        Raises:
            SqlError: DuckDB cannot, for the disk is full, say.
        """
        with self._lock, _storing_errors():
            self._connection.execute(sql).fetchall()

    def settle(self) -> None:
        """Let DuckDB move what was stored from its log into its file, if there is much of it.

        DuckDB would do so by itself, but gives the database up where the disk is full then.

        Raises:
            SqlError: DuckDB cannot.
        """
        if self._file is None:
            return
        log = self._file.with_name(f"{self._file.name}.wal")
        with self._lock, _storing_errors(), suppress(OSError, duckdb.TransactionException):
            size = log.stat().st_size
            if size > LONG_LOG and shutil.disk_usage(log.parent).free > 4 * size:
                self._connection.execute("CHECKPOINT")

    def insert(self, place: str, rows: pa.Table) -> None:
        """Add rows to a table, by the names of its columns."""
        self._take_in(f"INSERT INTO {place} BY NAME", rows)

    def insert_new(self, place: str, rows: pa.Table) -> None:
        """Make a table of rows."""
        self._take_in(f"CREATE TABLE {place} AS", rows)

    def _take_in(self, what: str, rows: pa.Table) -> None:
        """Run a statement that takes all rows of a table."""
        with self._lock:
            self._connection.register(_INCOMING, rows)
            try:
                self.run(f'{what} SELECT * FROM "{_INCOMING}"')  # noqa: S608
            finally:
                self._connection.unregister(_INCOMING)

    def rows(
        self,
        sql: str,
        parameters: Sequence[Any] = (),
        tables: Mapping[str, pa.Table] | None = None,
    ) -> pa.Table:
        """All rows of a SELECT; it may read tables that are given."""
        with self._reading_lock, ExitStack() as stack:
            for name, table in (tables or {}).items():
                self._reading.register(name, table)
                stack.callback(self._reading.unregister, name)
            try:
                return self._reading.sql(sql, params=parameters).to_arrow_table()
            except duckdb.Error as error:
                raise SqlError(f"what was recorded cannot be read: {error}") from error

    def fetchall(self, sql: str) -> list[tuple[Any, ...]]:
        """All rows of a SELECT, as tuples."""
        with self._reading_lock:
            try:
                return self._reading.execute(sql).fetchall()
            except duckdb.Error as error:
                raise SqlError(f"what was recorded cannot be read: {error}") from error

    def close(self) -> None:
        """Close the connection."""
        self._reading.close()
        self._connection.close()


@contextmanager
def _storing_errors() -> Iterator[None]:
    """DuckDB's errors while something is stored become ssduck's."""
    try:
        yield
    except duckdb.FatalException as error:
        raise SqlError(
            f"DuckDB has given up: {error}; what was stored before is in the file: close "
            "this interpreter, and open the file again",
            is_final=True,
        ) from error
    except duckdb.Error as error:
        raise SqlError(
            f"what is recorded cannot be stored: {error}; what was stored before is "
            "whole, and what was not is kept until there is room"
        ) from error


# Bytes of DuckDB's log that are worth the tenths of a second that moving them takes: it
# rewrites some of what was moved before, so that more at a time take less.
LONG_LOG = 1 << 26
_INCOMING = "rows to be stored"
# What an attached file with a record is called; no world can be.
_ATTACHED = "ssduck record file"
_HISTORIES = tuple(map(history_name, ("ticks", *RECORDABLE)))
_MODELS = tuple(map(model_name, MODELS))


class Database:
    """A DuckDB connection with worlds in it.

    Args:
        path: a DuckDB file, or `":memory:"`.
        tracer: is told each statement before it runs.
        limits: what SQL may use.

    Attributes:
        meter: how much of its limits the running program has used.
    """

    def __init__(
        self,
        path: str,
        tracer: Callable[[str], None] | None,
        limits: Limits | None = None,
        recording: Recording | None = None,
    ) -> None:
        self._path = path
        try:
            self._connection = duckdb.connect(path)
        except duckdb.Error as error:
            raise SqlError(_unopened(path, error)) from error
        self._recording = recording
        # What waits is stored at the end, too.
        self._recorders: list[Recorder] = []
        # Left open until Python ends, it would print complaints there.
        self._finalizer = weakref.finalize(
            self, _finish, self._connection, self._recorders, os.getpid()
        )
        self._tracer = tracer
        self._lock = threading.RLock()
        self.meter = Meter(limits or Limits())
        self._functions: set[str] = set()
        # What a function raised while SQL called it: DuckDB keeps but its words.
        self._raised: list[BaseException] = []
        self._bound: list[_Bound] = []
        # The functions of the narrow phase know the worlds by their names, and not this object.
        self._narrow_worlds: dict[str, _Bound] = {}
        self._numbers = count(1)
        # Counts up, by table, when prepared statements that read it lose their validity.
        self._generations = dict.fromkeys(_KNOWN, 0)
        self._asked_for_good: set[str] = set()
        self._first_changes = False
        # The data are small and the queries many: a second thread costs more than it gives.
        self.run("SET threads = 1")
        # In DuckDB 2.0.0 a range join of a prepared statement ends the database at its second run,
        # from 1,000 rows on, where it is a merge join; a nested loop is right.
        self.run("SET merge_join_threshold = 1000000000")
        # It would be drawn on standard output, amid what a program prints there.
        self.run("SET enable_progress_bar = false")
        # A name that no table has is an error, not a variable of the caller's.
        self.run("SET python_enable_replacements = false")
        if self._is_file:
            self.run("SET wal_autocheckpoint = '1TB'")  # see Writer.settle
            self._forget_lost_views()
        for name in NARROW:
            self._add_narrow(name)
        for name in THEN:
            self._add_then(name)
        self._add_told()
        # The worlds whose relations and tables users' SQL was told of; None: not even the others.
        self._told_of: set[str] | None = None
        self._confine(self.meter.limits)

    def _confine(self, limits: Limits) -> None:
        if limits.memory is not None:
            memory = exp.Literal.string(f"{limits.memory}B").sql("duckdb")
            self.run(f"SET memory_limit = {memory}")
            # What does not fit is an error, and no file in the working directory.
            self.run("SET temp_directory = ''")
        if not limits.files:
            self.run("SET enable_external_access = false")
            self.run("SET lock_configuration = true")

    def close(self) -> None:
        """Close the connection; a file keeps no views or macros on worlds that are gone.

        Raises:
            SqlError: what waits cannot be stored, for the disk is full, say; it is closed then.
        """
        with self._lock:
            if not self._finalizer.alive:
                return
            try:
                for bound in self._bound:
                    kept = bound.kept
                    self._stop(bound)
                    for schema in bound.schemas:
                        self._leave(schema, kept)
            finally:
                self._finalizer()

    @property
    def _is_file(self) -> bool:
        return self._path != ":memory:"

    def _leave(self, schema: str, kept: _Kept | None) -> None:
        """Leave the schema of a world without what needs ssduck."""
        for statement in dropped(schema, described=schema in (self._told_of or ())):
            self.run(statement)
        if not self._is_file:
            return
        history = kept.history if kept is not None else None
        if not isinstance(history, History):
            history = None
        for name in (*_HISTORIES, *_MODELS):
            if history is not None and name in history.views:
                self._make_view(schema, name, f"SELECT * FROM {history.place(name)}")  # noqa: S608
            else:
                view = exp.table_(name, db=schema, quoted=True).sql("duckdb")
                self.run(f"DROP VIEW IF EXISTS {view}")

    def _forget_lost_views(self) -> None:
        """Drop the views on worlds of a process that was killed."""
        lost = self._own_rows(
            "SELECT schema_name, view_name FROM duckdb_views() WHERE NOT internal AND NOT "  # noqa: S608
            f"temporary AND regexp_matches(sql, {_LOST})"
        )
        for schema, name in lost:
            self.run(f"DROP VIEW {exp.table_(name, db=schema, quoted=True).sql('duckdb')}")

    def attach(self, path: Path) -> str:
        """Let a DuckDB file be read; tells what it is called here.

        Raises:
            RecordError: it is no DuckDB file, or in use by another process.
        """
        file = exp.Literal.string(str(path.resolve())).sql("duckdb")
        name = exp.to_identifier(_ATTACHED, quoted=True).sql("duckdb")
        try:
            self.run(f"ATTACH {file} AS {name} (READ_ONLY)")
        except SqlError as error:
            raise RecordError(_unopened(str(path), error)) from error
        return _ATTACHED

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
        """All rows of a statement that a user wrote.

        The tables that its text names are asked for. A view or a prepared statement asks again
        when it is used, under another name; so what such a statement names is asked for from
        then on.
        """
        if self.meter.limits.seconds is not None:
            _check_length(sql)
        words = {word.lower() for word in _TABLE_WORDS.findall(sql)}
        asked = {table for word in words for table in _TABLES_OF[word]}
        if _KEEPS_A_QUERY.search(sql):
            self._asked_for_good |= asked
        with self.held(asked | self._asked_for_good, self._named_in(sql)):
            self._tell_sql()
            return self._arrow(sql, parameters)

    def _named_in(self, sql: str) -> list[World] | None:
        """The worlds that a statement may be about; None for all, where it may use another one.

        The first one's tables go without its name.
        """
        self._first_changes |= _CHANGES_THE_FIRST.search(sql) is not None
        if self._asked_for_good or self._first_changes or _KEEPS_A_QUERY.search(sql):
            return None
        text = sql.casefold()
        return [
            bound.world
            for number, bound in enumerate(self._bound)
            if number == 0 or any(schema.casefold() in text for schema in bound.schemas)
        ]

    @contextmanager
    def held(
        self,
        tables: set[str] | frozenset[str] = frozenset(),
        worlds: Collection[World] | None = None,
    ) -> Iterator[None]:
        """Hold all worlds at their tick while statements run.

        Args:
            tables: those that are read, of the simulators if need be.
            worlds: of which worlds; None for all.
        """
        with ExitStack() as stack:
            stack.enter_context(self._lock)
            # In one order in all databases, so that no two wait for each other.
            for bound in sorted(self._bound, key=lambda bound: bound.world.serial):
                asked = worlds is None or any(bound.world is world for world in worlds)
                stack.enter_context(bound.world.held(tables if asked else ()))
            for bound in self._bound:
                if bound.kept is not None and bound.kept.recorder is not None:
                    stack.enter_context(bound.kept.recorder.reading)
                self._show(bound)
            yield

    def _arrow(self, sql: str, parameters: Parameters) -> pa.Table:
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

    def _own_rows(self, sql: str, parameters: Parameters = None) -> list[tuple[Any, ...]]:
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
        listening = ctrl_c.Listening(self._interrupt)
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
        self, work: Callable[[], T], listening: ctrl_c.Listening, timer: threading.Timer | None
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
        if not self._finalizer.alive:
            raise SqlError("the interpreter is closed", is_final=True) from error
        self.meter.check_time()
        if isinstance(error, RuntimeError | duckdb.InterruptException):
            raise KeyboardInterrupt from error
        if isinstance(error, duckdb.OutOfMemoryException):
            raise LimitError(f"the query takes more memory than there is: {error}") from error
        refused = isinstance(error, _REFUSALS)
        raise SqlError(str(error).strip(), is_refused=refused) from error

    # -- functions ------------------------------------------------------------------------

    def add_function(self, signature: Signature, function: Function) -> None:
        """Make a user's function one of SQL; replaces one of that signature."""
        if signature.name in self._functions:
            self._connection.remove_function(signature.name)
        converters = [converter(tag, self.worlds, self.records) for tag in signature.parameters]
        raised = self._raised  # the function must not keep this object alive

        def call(*arguments: Any) -> Any:
            try:
                values = [
                    value if convert is None else convert(value)
                    for convert, value in zip(converters, arguments, strict=True)
                ]
                return _usable(function(values), signature.result)
            except BaseException as error:
                raised[:] = [error]
                raise

        _give_arity(call, len(converters))
        types: list[Any] = [tag.sql_type for tag in signature.parameters]
        result = signature.result.sql_type
        self._connection.create_function(signature.name, call, types, result)
        self._functions.add(signature.name)

    def _add_narrow(self, name: str) -> None:
        """Make a function of the narrow phase one of SQL: of a world's name, and of entities."""
        taken, result = NARROW[name]
        entities = taken.count("BIGINT")  # twice as many: of each its tick and its id
        answer, worlds, raised = ANSWERS[name], self._narrow_worlds, self._raised

        def call(world: str, *arguments: Any) -> Any:
            if None in arguments:
                return None
            try:
                if world not in worlds:
                    raise UnknownNameError(f"there is no world {world!r} here any more")
                ticks = set(arguments[:entities:2])
                if len(ticks) > 1:
                    raise UnsupportedError(
                        "shapes are compared at one tick: these rows are of the ticks "
                        f"{' and '.join(map(str, sorted(ticks)))} of {world!r}"
                    )
                ids = arguments[1:entities:2]
                shapes = worlds[world].shapes(ticks.pop() if ticks else None, ids)
                return answer(shapes, *ids, *arguments[entities:])
            except BaseException as error:
                raised[:] = [error]
                raise

        types: list[Any] = ["VARCHAR", *taken]
        _give_arity(call, len(types))
        self._connection.create_function(
            name,
            call,
            types,
            result,
            null_handling=FunctionNullHandling.SPECIAL,  # it may yield none
            side_effects=result == "BIGINT[]",  # all pairs of a tick: not to be found for good
        )

    def _add_then(self, name: str) -> None:
        """Make a function of the narrow phase over many ticks one of SQL."""
        worlds, raised = self._narrow_worlds, self._raised
        collide = name == THEN_COLLIDING

        def found(
            world: str, first: int, last: int, a: int, b: int, apart: float = 0.0
        ) -> pa.StructArray:
            kept = worlds[world].kept
            if kept is None:
                raise EvaluationError(f"the ticks of {world!r} are not recorded")
            pairs = kept.record.pairs(Near(first, last, a, b, apart), collide=collide)
            return pa.StructArray.from_arrays(list(map(pa.array, pairs)), names=PAIR)

        def call(*arguments: pa.ChunkedArray) -> pa.ListArray:
            try:
                rows = zip(*(values.to_pylist() for values in arguments), strict=True)
                answers = [found(*row) for row in rows]
                ends = accumulate(map(len, answers), initial=0)
                offsets = pa.array(ends, pa.int32())
                return pa.ListArray.from_arrays(offsets, pa.concat_arrays(answers))
            except BaseException as error:
                raised[:] = [error]
                raise

        taken: list[Any] = ["VARCHAR", *["BIGINT"] * 4, *([] if collide else ["DOUBLE"])]
        _give_arity(call, len(taken))
        yields: Any = f"STRUCT({', '.join(f'{column} BIGINT' for column in PAIR)})[]"
        # In columns: as lists, some thousand pairs took as long as comparing them.
        self._connection.create_function(
            name, call, taken, yields, type=PythonUDFType.ARROW, side_effects=True
        )

    def _add_told(self) -> None:
        """Make what contacts and sensors told at recorded ticks a function of SQL."""
        worlds, raised = self._narrow_worlds, self._raised

        def call(world: str, what: str, tick: int, a: int, b: int) -> list[float]:
            try:
                return worlds[world].told(what, tick, a, b)
            except BaseException as error:
                raised[:] = [error]
                raise

        types: list[Any] = ["VARCHAR", "VARCHAR", "BIGINT", "BIGINT", "BIGINT"]
        _give_arity(call, len(types))
        self._connection.create_function(THEN_TOLD, call, types, "DOUBLE[]", side_effects=True)

    # -- worlds ---------------------------------------------------------------------------

    def bind(self, name: str, world: World) -> None:
        """Make the schema of that name that of a world's tables; it may have several.

        Raises:
            ArgumentError: DuckDB has a schema or a database of that name, or another world has
                one that differs in case only, which DuckDB does not tell apart.
        """
        with self._lock:
            self._check_schema(name)
            self._unbind(name, world)
            if world.name == UNNAMED:
                world.name = name
            bound = self._entry(world, name)
            if name not in bound.schemas:
                bound.schemas.append(name)
                self._make_views(name, bound)
            self._set_search_path()
            names = {schema: bound for bound in self._bound for schema in bound.schemas}
            self._narrow_worlds.clear()
            self._narrow_worlds.update(names)

    def _unbind(self, name: str, world: World) -> None:
        """Take a name from another world; one without a name is not held any more."""
        for other in [bound for bound in self._bound if name in bound.schemas]:
            if other.world is world:
                continue
            other.schemas.remove(name)
            if not other.schemas:
                self._bound.remove(other)
                self._stop(other)
                for shown in other.versions:
                    self.unshow(shown)

    def _check_schema(self, name: str) -> None:
        ((database,),) = self._own_rows("SELECT current_database()")
        if name.casefold() in _TAKEN or name.casefold() == database.casefold():
            raise ArgumentError(
                f"a world cannot be called {name!r}: DuckDB has a schema or database of that name"
            )
        runs = "SELECT schema_name FROM duckdb_tables() WHERE table_name = ?"
        taken = self._own_rows(runs, [ABOUT])
        if name.casefold() in {schema.casefold() for (schema,) in taken}:
            raise ArgumentError(
                f"a world cannot be called {name!r}: a recorded run is called so in SQL"
            )
        for other in self._bound:
            for schema in other.schemas:
                if schema != name and schema.casefold() == name.casefold():
                    raise ArgumentError(
                        f"a world cannot be called {name!r}: there is {schema!r}, "
                        "and SQL does not tell upper from lower case"
                    )

    def _entry(self, world: World, name: str | None = None) -> _Bound:
        """What is known of a world; its ticks are recorded under the name that it gets first."""
        for bound in self._bound:
            if bound.world is world:
                return bound
        bound = _Bound(world, f"world {next(self._numbers)}")
        self._bound.append(bound)
        try:
            if isinstance(world, RecordedWorld):
                bound.kept = _Kept(world.archive, world.own_record)
            if self._recording is not None and not world.is_final:
                self._keep(bound, self._recording, name or world.name)
            self._show(bound)
        except BaseException:
            self._bound.remove(bound)
            raise
        return bound

    def _make_views(self, name: str, bound: _Bound) -> None:
        schema = exp.table_(name, quoted=True)
        self.run(exp.Create(this=schema, kind="SCHEMA", exists=True).sql("duckdb"))
        for table in TABLES:
            rows = exp.select("*").from_(exp.table_(_live(bound.key, table), quoted=True))
            if table in bound.world.snapshot.untold:
                _refuse(rows, bound.world.snapshot.untold[table])
            view = exp.table_(table, db=name, quoted=True)
            create = exp.Create(this=view, kind="VIEW", replace=True, expression=rows)
            self.run(create.sql("duckdb"))
        self._make_history_views(name, bound)
        self._forget_plans("entities")

    # -- what is kept -----------------------------------------------------------------------

    def record(self, world: World, recording: Recording | None) -> None:
        """Keep the ticks of a world from now on, in a history of their own; None keeps none.

        What was kept before is dropped, unless it is in a file.
        """
        with self._lock:
            bound = self._entry(world)
            _check_runs(world)
            if recording is not None:
                check_names(recording, world.snapshot.members)
            with world.held():
                self._stop(bound)
            if recording is not None:
                self._keep(bound, recording, bound.schemas[0])
            self._show(bound)
            for schema in bound.schemas:
                self._make_history_views(schema, bound)
            self._forget_plans("entities")

    def _keep(self, bound: _Bound, recording: Recording, name: str) -> None:
        world = bound.world
        check_names(recording, world.snapshot.members)
        in_memory = not self._is_file and not recording.changed
        make = Memory if in_memory else History
        history = make(self._free_schema(name), self.writer(), recording, name)
        if self._is_file:
            history.show()
        # Of a file, what waits is lost when the process is killed; of memory, all is.
        recorder = Recorder(recording, history, MEMORY_TICKS if in_memory else RING_TICKS)
        tables = tuple(recorder.rings)
        record = Record(
            world, recorder.ticks, recorder.members, tables, recorder.fetch, recorder.near
        )
        bound.kept = _Kept(history, record, recorder, (*history.shown, *recorder.shown))
        self._recorders.append(recorder)
        try:
            world.record(recorder)
        except BaseException:
            self._forget_recorder(bound, recorder)
            raise

    def _forget_recorder(self, bound: _Bound, recorder: Recorder) -> None:
        """Let a recorder keep no more ticks, without storing what waits."""
        bound.world.forget(recorder)
        self._recorders.remove(recorder)
        bound.kept = None

    def _stop(self, bound: _Bound) -> None:
        """Keep no more ticks of a world; what waits is stored."""
        if bound.kept is None:
            return
        kept = bound.kept
        kept.record.is_closed = True
        if kept.recorder is None:
            bound.kept = None
            kept.history.close(forget=False)
            return
        if self._is_file:
            kept.recorder.flush()
        kept.recorder.wait()
        self._forget_recorder(bound, kept.recorder)
        kept.history.close(forget=not self._is_file)
        for table in kept.recorder.rings:
            for name in _waiting(bound.key, len(kept.shown), table):
                if bound.versions.pop(name, None) is not None:
                    self.unshow(name)

    def _free_schema(self, world: str) -> str:
        taken = {
            name.casefold()
            for (name,) in self._own_rows("SELECT schema_name FROM duckdb_schemas()")
        }
        names = (f"{world}_record_{number}" for number in count())
        return next(name for name in names if name.casefold() not in taken)

    def _make_history_views(self, name: str, bound: _Bound) -> None:
        if self._told_of is not None:
            self._told_of.discard(name)
        for table in ("ticks", *RECORDABLE):
            rows = None
            if bound.kept is not None:
                waits = bound.kept.recorder is not None
                rings = partial(_waiting, bound.key, len(bound.kept.shown)) if waits else None
                rows = bound.kept.history.select(table, rings)
            if rows is None:
                refused = exp.select("*").from_(exp.table_(_live(bound.key, table), quoted=True))
                _refuse(refused, not_recorded(table, bound.world.name))
                rows = refused.sql("duckdb")
            self._make_view(name, history_name(table), rows)
        for table, rows in bound.kept.history.models().items() if bound.kept is not None else ():
            self._make_view(name, table, rows)

    def _make_view(self, schema: str, name: str, rows: str) -> None:
        view = exp.table_(name, db=schema, quoted=True).sql("duckdb")
        self.run(f"CREATE OR REPLACE VIEW {view} AS {rows}")

    def record_to(self, world: World, recording: Recording, path: Path) -> FolderRecording:
        """Write the ticks of a world to a folder from now on, too."""
        with self._lock:
            _check_runs(world)
            check_names(recording, world.snapshot.members)
            folder = Folder(path, self.schema_of(world), recording)
            recorder = Recorder(recording, folder, waits=PART_TICKS)
            self._recorders.append(recorder)
            try:
                world.record(recorder)
            except BaseException:
                world.forget(recorder)
                self._recorders.remove(recorder)
                folder.discard()
                raise
            return FolderRecording(world, recorder, folder, self._recorders)

    def writer(self) -> Writer:
        """A connection of its own, for what is kept of a world."""
        return Writer(self._connection, Path(self._path) if self._is_file else None)

    def record_of(self, world: World) -> Record:
        """What is kept of a world.

        Raises:
            EvaluationError: nothing is.
        """
        with self._lock:
            kept = self._entry(world).kept
            if kept is None:
                raise EvaluationError(
                    f"the ticks of {world.name!r} are not recorded; record(…) lets them be"
                )
            return kept.record

    def keeps(self, world: World) -> bool:
        """Whether the ticks of a world are recorded."""
        return self._entry(world).kept is not None

    def export(
        self,
        world: World,
        path: Path,
        names: tuple[str, ...] | None,
        between: tuple[float | None, float | None],
    ) -> Path:
        """Write what is kept of a world as a new episode in a folder; gives that of its ticks.

        Raises:
            RecordError: the folder has something else in it, or cannot be written.
            EvaluationError: nothing is kept of it, or nothing of that time.
        """
        record = self.record_of(world)
        with self._lock, world.held():
            kept = self._entry(world).kept
            assert kept is not None
            recording = kept.history.recording
            return exported(record, recording, self.schema_of(world), path, names, between)

    def flush(self) -> dict[str, int]:
        """Store what waits; tells up to which tick of each world, by its schema."""
        with self._lock:
            found = {}
            for bound in self._bound:
                if bound.kept is not None and bound.kept.recorder is not None and bound.schemas:
                    with bound.world.held():
                        bound.kept.recorder.flush()
                        numbers = bound.kept.recorder.ticks.numbers
                        found[bound.schemas[0]] = int(numbers[-1])
            return found

    def schema_of(self, world: World) -> str:
        """The schema of a world's tables; one is made for a world that has none here."""
        with self._lock:
            bound = self._entry(world)
            if not bound.schemas:
                taken = {schema.casefold() for other in self._bound for schema in other.schemas}
                names = (f"{world.name}_{number}" for number in count(2))
                name = world.name
                while name.casefold() in taken or name.casefold() in _TAKEN:
                    name = next(names)
                self.bind(name, world)
            return bound.schemas[0]

    def _set_search_path(self) -> None:
        """The first world's tables go without its name."""
        first = next((bound.schemas[0] for bound in self._bound if bound.schemas), None)
        if first is not None:
            name = exp.to_identifier(first, quoted=True).sql("duckdb")
            path = exp.Literal.string(f"main,{name}").sql("duckdb")
            self.run(f"SET search_path = {path}")

    def _tell_sql(self) -> None:
        """Make the relations functions of SQL, and let it say what the tables hold."""
        schemas = list(self._narrow_worlds)
        if self._told_of != set(schemas):
            only = schemas[0] if len(self.worlds) == 1 else None
            for statement in described(schemas, only, self._told_of, self.records):
                self.run(statement)
            self._told_of = set(schemas)

    def generation(self, tables: Iterable[str]) -> int:
        """Counts up when prepared statements that read one of these tables lose their validity."""
        return sum(self._generations.get(table, 0) for table in tables)

    def _show(self, bound: _Bound) -> None:
        """Let DuckDB see the buffers that were made anew; the others it sees already."""
        buffers: list[tuple[str, str, LiveTable | Shown]] = [
            (table, _live(bound.key, table), live)
            for table, live in bound.world.snapshot.tables.items()
        ]
        if bound.kept is not None:
            shown = bound.kept.shown
            for part, tables in enumerate(shown):
                for table, rows in tables.items():
                    name = _waiting(bound.key, len(shown), table)[part]
                    buffers.append((history_name(table), name, rows))
        new = [entry for entry in buffers if bound.versions.get(entry[1]) != entry[2].version]
        stale = {table for table, name, _ in new if name in bound.versions}
        if stale:
            self._forget_plans(*stale)
        for _, name, rows in new:
            self.show(name, rows.arrow)
            bound.versions[name] = rows.version

    def show(self, name: str, table: pa.Table) -> None:
        """Let DuckDB see a table under a name."""
        self._connection.register(name, table)

    def unshow(self, name: str) -> None:
        """Let DuckDB forget a table."""
        self._connection.unregister(name)

    def _forget_plans(self, *tables: str) -> None:
        """Drop prepared statements that would go on reading old buffers of one of these tables.

        Our own say by their names what they read. Of a user's it is not known, so that all are
        dropped if any statement that DuckDB keeps names such a table.
        """
        stale = set(tables)
        theirs = bool(stale & self._asked_for_good)
        for table in tables:
            self._generations[table] += 1
        for (name,) in self._own_rows("SELECT name FROM duckdb_prepared_statements()"):
            if stale & set(name.split()) if name.startswith(_OURS) else theirs:
                self.run(f"DEALLOCATE {exp.to_identifier(name, quoted=True).sql('duckdb')}")

    @property
    def worlds(self) -> dict[str, World]:
        """The worlds by the schema that ssduck's statements use, the first one first."""
        return {bound.schemas[0]: bound.world for bound in self._bound if bound.schemas}

    @property
    def records(self) -> dict[str, Record]:
        """What is kept of those that are recorded, by the same."""
        return {
            bound.schemas[0]: bound.kept.record
            for bound in self._bound
            if bound.schemas and bound.kept is not None
        }


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


def _end(listening: ctrl_c.Listening, timer: threading.Timer | None) -> None:
    listening.leave()
    if timer is not None:
        timer.cancel()
        if timer.is_alive():
            timer.join()  # so that it does not interrupt what comes next


def _refuse(rows: exp.Select, why: str) -> None:
    """Make a SELECT fail when it is read; a condition on no rows would not be looked at."""
    failing = exp.func("error", exp.Literal.string(why)).as_("why")
    rows.join(exp.select(failing).subquery("untold"), join_type="cross", copy=False)
    rows.set("expressions", [exp.Star(except_=[exp.column("why")])])
    rows.where(exp.column("why").is_(exp.null()), copy=False)


def _check_runs(world: World) -> None:
    """Complain of a world that has no ticks to come."""
    if isinstance(world, RecordedWorld):
        raise UnsupportedError(
            f"{world.name!r} is a record itself, with no ticks to come; export(…) copies it"
        )


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
    for recorder in recorders:
        try:
            recorder.flush()
        except SelectScriptError as error:
            failed = failed or error
    connection.close()
    if failed is not None:
        raise failed


def _waiting(key: str, parts: int, table: str) -> list[str]:
    """What the rows are called that are not stored, among DuckDB's temporary views."""
    return [f"{key}: {table} that wait, {part}" for part in range(parts)]


def _live(key: str, table: str) -> str:
    """What a table's buffers are called among DuckDB's temporary views."""
    return f"{key}: {table}"
