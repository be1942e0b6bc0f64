"""Runs statements in DuckDB: in time, traced, and with ssduck's errors."""

from __future__ import annotations

import inspect
import os
import re
import threading
import weakref
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager, suppress
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

import duckdb
import pyarrow as pa
from sqlglot import exp

from ssduck.database.fetched_rows import (
    FetchedRows,
    Header,
    RowLimits,
    all_rows,
    arrow_table,
    fetched,
)
from ssduck.database.instances import (
    FILE_NAME,
    MEMORY,
    POOL,
    absolute_path,
    check_beside,
    open_error_text,
    open_file,
    reach_objects,
    set_up,
)
from ssduck.database.running import StatementRunner, translated
from ssduck.database.writer import WriterConnection
from ssduck.errors import (
    RecordError,
    RecordPermissionError,
    SelectScriptError,
    SqlError,
)
from ssduck.formatting import short_repr
from ssduck.limits import Limits
from ssduck.recording.background_writer import is_background_thread
from ssduck.recording.opened_record import OpenedRecord
from ssduck.recording.recorder import Recorder
from ssduck.recording.stores.history_sql import exact_path, quoted
from ssduck.recording.stores.object_store import ObjectPath

T = TypeVar("T")

Parameters: TypeAlias = Sequence[Any] | Mapping[str, Any] | None

_SCHEMAS = (
    "SELECT schema_name FROM duckdb_schemas() "
    "WHERE NOT internal AND database_name = current_database() AND schema_name <> 'main'"
)
# Begins a statement that executes a prepared one.
_EXECUTE = "EXECUTE "
# Has DuckDB plan nested loops in place of all range joins.
NO_RANGE_JOINS = "SET nested_loop_join_threshold = 1000000000"
# The name of an attached file with a record; no world can have it.
_ATTACHED = "ssduck record file"
_ATTACHED_NAME = exp.to_identifier(_ATTACHED, quoted=True).sql("duckdb")
# A forked process keeps its parent's connections: freeing them would wait for threads it lacks.
_LEFT_TO_PARENT: list[Sequence[duckdb.DuckDBPyConnection]] = []
# The settings of DuckDB that ssduck changes before some statements.
_CHANGED = "['nested_loop_join_threshold', 'merge_join_threshold', 'search_path', 'schema']"

_BETWEEN = r"(?:\s|/\*(?:(?!\*/).)*\*/|--[^\n]*(?:\n|\Z))*"
# A query of WITH that changes rows or writes a file.
_CHANGING = re.compile(
    rf"[()]{_BETWEEN}(?:INSERT|UPDATE|DELETE|MERGE|COPY|EXECUTE)\b", re.IGNORECASE | re.DOTALL
)

# A schema, or None for names without one; and the name of a view or a function.
Name: TypeAlias = tuple[str | None, str]
# The number of statements whose names are known to be there.
_MAX_STATEMENTS = 4096


class Connection(StatementRunner):
    """A connection to DuckDB, which is closed when nothing refers to it.

    Attributes:
        meter: the use of the running program's limits.
        on_demand: the views and functions that are made when a statement names them.
        has_records: whether recorded ticks may be in the database, or in an attached file.
    """

    def __init__(
        self,
        path: str,
        tracer: Callable[[str], None] | None,
        limits: Limits,
        recorders: list[Recorder],
    ) -> None:
        self._path = path if path == MEMORY else absolute_path(path, is_written=True)
        try:
            self._instance = open_file(self._path) if self.is_file else POOL.take()
            super().__init__(self._cursor(), tracer, limits)
        except duckdb.Error as error:
            raise SqlError(open_error_text(path, error)) from error
        # A connection that is open when Python ends prints errors.
        open_ones = self._connection, self._instance
        self._finalizer = weakref.finalize(self, _finish, open_ones, recorders, os.getpid())
        self._recorders = recorders
        self.on_demand = OnDemand()
        self.has_records = self.is_file
        # Whether something may be in the database that `_give_back` does not remove.
        self._is_altered = False
        # Where queries spilled to the disk before their memory was limited; None if it is not.
        self._spill: str | None = None
        self._functions: set[str] = set()
        # The schemas of worlds, which no other connection makes.
        self._schemas: set[str] = set()
        set_up(self._connection)
        if self.is_file:
            self.run("SET wal_autocheckpoint = '1TB'")  # see WriterConnection.checkpoint

    def apply_limits(self) -> None:
        """Applies the limit of memory to all later statements."""
        limits = self.meter.limits
        if limits.memory is not None:
            ((self._spill,),) = self.internal_rows("SELECT current_setting('temp_directory')")
            memory = exp.Literal.string(f"{limits.memory}B").sql("duckdb")
            self.run(f"SET memory_limit = {memory}")
            # A query that exceeds the limit fails instead of writing to the working directory.
            self.run("SET temp_directory = ''")

    def seal(self, readable: Sequence[Path], memory: int | None = None) -> None:
        """Switches files off for all later statements, and changes of settings."""
        self._is_altered = True
        if readable:
            # DuckDB checks the pattern that it is given, and each file that fits it.
            forms = {
                form
                for folder in readable
                for form in (str(folder), str(folder.resolve()), exact_path(folder))
            }
            names = [exp.Literal.string(f"{form}{os.sep}").sql("duckdb") for form in sorted(forms)]
            self.run(f"SET allowed_directories = [{', '.join(names)}]")
        self.run(NO_RANGE_JOINS)  # it cannot be set later
        if memory is not None:
            self.run(f"SET memory_limit = '{int(memory)}B'")
            self.run("SET temp_directory = ''")
            self.run(f"SET allowed_configs = {_CHANGED}")
        self.run("SET enable_external_access = false")
        self.run("SET lock_configuration = true")

    def _cursor(self) -> duckdb.DuckDBPyConnection:
        cursor = self._instance.cursor()
        if self.is_file:
            cursor.execute(f"USE {FILE_NAME}")
        return cursor

    @cached_property
    def name(self) -> str:
        """The name of the database in SQL."""
        ((name,),) = self.internal_rows("SELECT current_database()")
        return str(name)

    @property
    def is_file(self) -> bool:
        """Whether the database is a file."""
        return self._path != MEMORY

    @property
    def is_open(self) -> bool:
        """Whether the connection is open."""
        return self._finalizer.alive

    def close(self) -> None:
        """Stores the waiting ticks, and closes the connection."""
        self.on_demand.clear()
        if self.is_open and not (self.is_file or self._is_altered or self._recorders):
            with suppress(duckdb.Error):
                self._give_back()
        self._finalizer()

    def _give_back(self) -> None:
        """Empties the database, and gives it to the next interpreter."""
        if self._spill is not None:
            spill = exp.Literal.string(self._spill).sql("duckdb")
            self._connection.execute(f"RESET memory_limit; SET temp_directory = {spill}")
        for name in list(self._functions):
            self.remove_function(name)
        if self._attached is not None:
            self._connection.execute(f"DETACH {_ATTACHED_NAME}")
        schemas = self._schemas
        if self.has_records:  # another connection may have made some
            schemas = {name for (name,) in self._connection.execute(_SCHEMAS).fetchall()}
        for schema in schemas:
            self._connection.execute(f"DROP SCHEMA {quoted(schema)} CASCADE")
        self._connection.close()
        self._finalizer.detach()
        POOL.give_back(self._instance)

    def writer(self) -> WriterConnection:
        """Returns a second connection to the same database, to store recorded ticks.

        Their schema is all that it may change there: `_give_back` drops it.
        """
        self.has_records = True
        return self.reader()

    def reader(self, record: OpenedRecord | None = None) -> WriterConnection:
        """Returns a second connection to the same database, to read recorded ticks.

        Args:
            record: the record that it reads; None for the database itself.
        """
        file = Path(self._path) if self.is_file else None
        if record is not None:
            self._opened = record
        if record is not None and isinstance(record.path, ObjectPath):
            self._is_altered = reach_objects(self._connection)  # so no other one gets the instance
        return WriterConnection(self._cursor(), self._cursor(), file, record)

    def make_schema(self, name: str) -> None:
        """Creates the schema of a world unless it is there."""
        self.run(f"CREATE SCHEMA IF NOT EXISTS {quoted(name)}")
        self._schemas.add(name)

    def drop_schema(self, name: str) -> None:
        """Drops the schema of a world, and all that is in it."""
        self.run(f"DROP SCHEMA IF EXISTS {quoted(name)} CASCADE")
        self._schemas.discard(name)

    def attach(self, path: Path) -> str:
        """Attaches a DuckDB file to be read, and returns its name."""
        try:
            file = exp.Literal.string(absolute_path(str(path))).sql("duckdb")
            check_beside(str(path))
        except SqlError as error:
            raise RecordError(error.message) from error
        try:
            # DuckDB would download an extension to read a file of another type.
            self.run(f"ATTACH {file} AS {_ATTACHED_NAME} (READ_ONLY, TYPE duckdb)")
        except SqlError as error:
            text = open_error_text(str(path), error.__cause__ or error)
            kind = RecordPermissionError if "Permission denied" in text else RecordError
            raise kind(text) from error
        self._attached, self.has_records = path, True
        return _ATTACHED

    @property
    def has_attached(self) -> bool:
        """Whether the file of a record is attached."""
        return self._attached is not None

    def register(self, name: str, table: pa.Table) -> None:
        """Makes a table, or a dataset of Arrow, readable under a name."""
        with translated():
            self._connection.register(name, table)

    def unregister(self, name: str) -> None:
        """Removes a registered table."""
        with translated():
            self._connection.unregister(name)

    def offer_function(self, name: str, *function: Any, **options: Any) -> None:
        """Has a function registered, as by `register_function`, when a statement names it."""
        self.on_demand.offer(
            (None, name), lambda own: own.register_function(name, *function, **options)
        )

    def withdraw_function(self, name: str) -> None:
        """Takes a function back, whether it was offered only or is registered."""
        self.on_demand.withdraw((None, name))
        if name in self._functions:
            self.remove_function(name)

    def register_function(
        self,
        name: str,
        function: Callable[..., Any],
        parameter_types: Sequence[str],
        result_type: str,
        *,
        at_start: Callable[[], None] | None = None,
        **options: Any,
    ) -> None:
        """Registers a Python function with SQL; replaces one of that name.

        An exception of the function is raised by the statement that called it.

        Args:
            name: the name of the function.
            function: the function; it must not keep this object alive.
            parameter_types: the SQL types of its arguments.
            result_type: the SQL type of its result.
            at_start: a function that is called before each statement.
            options: other options of DuckDB.
        """
        if name in self._functions:
            self.remove_function(name)
        raised = self._raised

        def call(*arguments: Any) -> Any:
            try:
                return function(*arguments)
            except BaseException as error:
                raised[:] = [error]
                raise

        _give_arity(call, len(parameter_types))
        types, result = list[Any](parameter_types), cast(Any, result_type)
        self._functions.add(name)  # Ctrl-C may come when it is made
        self._connection.create_function(name, call, types, result, **options)
        if at_start is not None:
            self._at_start[name] = at_start

    def remove_function(self, name: str) -> None:
        """Removes a registered function from SQL."""
        with suppress(duckdb.InvalidInputException):  # Ctrl-C came before it was made
            self._connection.remove_function(name)
        self._functions.discard(name)

    # -- statements -----------------------------------------------------------------------

    def rows(self, sql: str, parameters: Parameters = None) -> list[tuple[Any, ...]]:
        """Returns all rows of a statement from the translator; the caller pins the worlds."""
        if not sql.startswith(_EXECUTE):  # what it names is there
            self.on_demand.provide(sql, self)
        limits = self._row_limits

        def fetch() -> list[tuple[Any, ...]]:
            result = self._connection.execute(sql, parameters)
            return all_rows(result) if limits is None else limits.rows(result)

        rows = self._execute(sql, fetch)
        self.meter.check_rows(len(rows))
        return rows

    def table(self, sql: str, parameters: Parameters) -> pa.Table:
        """Returns all rows of a user's statement; the caller pins the worlds."""
        self._is_altered = True
        self.on_demand.provide(sql, self)
        limits = self._row_limits

        def fetch() -> pa.Table:
            relation = self._connection.sql(sql, params=parameters)
            if relation is None:
                return pa.table({})
            return arrow_table(relation, limits)

        table = self._execute(sql, fetch)
        self.meter.check_rows(table.num_rows)
        return table

    def fetched(
        self, sql: str, parameters: Parameters, header: Header | None
    ) -> FetchedRows | None:
        """Returns all rows of a user's statement as tuples; the caller pins the worlds.

        Returns:
            The rows; None if the types of the columns require an Arrow table.
        """
        if not sql.startswith(_EXECUTE):
            self.on_demand.provide(sql, self)
        limits = self._row_limits
        rows = self._execute(
            sql, lambda: fetched(self._connection.execute(sql, parameters), limits, header)
        )
        if rows is not None:
            self.meter.check_rows(len(rows))
        return rows

    @property
    def _row_limits(self) -> RowLimits | None:
        """The limits of the rows of statements: one more than allowed; None for none."""
        rows, memory = self.meter.limits.rows, self.meter.limits.memory
        if rows is None and memory is None:
            return None
        return RowLimits(None if rows is None else rows + 1, self.meter.charge)

    def columns(self, sql: str, parameters: Parameters) -> list[tuple[str, str]]:
        """Returns the names and the types of a query's columns; the query does not run."""
        self.on_demand.provide(sql, self)
        described = self._execute(
            sql, lambda: self._connection.execute(f"DESCRIBE {sql}", parameters).fetchall()
        )
        return [(name, type) for name, type, *_ in described]

    def statements(self, sql: str) -> list[tuple[str, str]] | None:
        """Returns the type and the text of each statement in a text; None if it is no SQL.

        A type is the name of one of `duckdb.StatementType`. That of a SELECT is WITH if a query of
        WITH may change rows or write a file.
        """
        try:
            return [_type_and_text(one) for one in self._connection.extract_statements(sql)]
        except (duckdb.Error, TypeError):  # TypeError: it is no text in UTF-8
            return None
        except ValueError as error:  # UPDATE EXTENSIONS
            shown = short_repr(" ".join(sql.split()))
            raise SqlError(f"SQL has no such statement here: {shown}") from error

    def is_query(self, sql: str) -> bool:
        """Checks whether a text is one statement that only reads."""
        return [kind for kind, _ in self.statements(sql) or ()] == ["SELECT"]

    def run(self, sql: str) -> None:
        """Runs a statement of ssduck's own, which no limit cuts off."""
        self._execute(sql, lambda: self._connection.execute(sql).fetchall(), timed=False)

    def define(self, sql: str) -> None:
        """Runs a statement that makes a view or a macro; it is not traced: any may need it."""
        tracer, self._tracer = self._tracer, None
        try:
            self.run(sql)
        finally:
            self._tracer = tracer

    def prepare(self, name: str, select: str) -> None:
        """Prepares a statement from the translator; the caller pins the worlds."""
        self.on_demand.provide(select, self)
        sql = f"PREPARE {quoted(name)} AS {select}"
        self._execute(sql, lambda: self._connection.execute(sql).fetchall())

    def deallocate(self, name: str) -> None:
        """Drops a prepared statement."""
        self.run(f"DEALLOCATE {quoted(name)}")

    def internal_rows(self, sql: str, parameters: Parameters = None) -> list[tuple[Any, ...]]:
        """Returns all rows of a statement of ssduck's own, which no time limit ends."""
        work = partial(self._connection.execute, sql, parameters)
        return self._execute(sql, lambda: work().fetchall(), timed=False)


def _type_and_text(statement: duckdb.Statement) -> tuple[str, str]:
    name, text = statement.type.name, statement.query
    if name == "SELECT" and "with" in text.casefold() and _CHANGING.search(text) is not None:
        name = "WITH"
    return name, text


def execution_of(name: str) -> str:
    """Returns the statement that executes a prepared one."""
    return f"{_EXECUTE}{quoted(name)}"


def _finish(
    connections: Sequence[duckdb.DuckDBPyConnection], recorders: list[Recorder], process: int
) -> None:
    """Stores the waiting ticks and closes; in a forked process, leaves that to the parent."""
    if os.getpid() != process:
        _LEFT_TO_PARENT.append(connections)
        return
    if recorders and is_background_thread():  # by garbage collection there
        threading.Thread(target=_finish, args=(connections, recorders, process)).start()
        return
    failed = None
    try:
        for recorder in recorders:
            try:
                recorder.finish()
            except SelectScriptError as error:
                failed = failed or error
    finally:  # its functions may refer to it, and would keep it open until Python ends
        for connection in connections:
            connection.close()
    if failed is not None:
        raise failed


def _give_arity(call: Callable[..., Any], count: int) -> None:
    """Sets the number of arguments of a function, for DuckDB."""
    kinds = [inspect.Parameter(f"a{i}", inspect.Parameter.POSITIONAL_ONLY) for i in range(count)]
    call.__signature__ = inspect.Signature(kinds)  # type: ignore[attr-defined]


class OnDemand:
    """Views and functions that are made before the first statement that names them.

    A world has some thirty views, and relations have as many functions: making all of them takes
    longer than opening a small record and asking it a question. They are made by functions of the
    connection, which do not keep it alive.
    """

    def __init__(self) -> None:
        self._makers: dict[Name, Callable[[Connection], None]] = {}
        # Statements that name nothing that is still to be made.
        self._complete: set[str] = set()
        # What is not made now; see `without`.
        self._left_out: frozenset[Name] = frozenset()

    def offer(self, name: Name, make: Callable[[Connection], None]) -> None:
        """Has a view or a function made when a statement names it; replaces an earlier offer."""
        self._makers[name] = make
        self._complete.clear()

    def withdraw(self, name: Name) -> None:
        """Takes an offer back."""
        self._makers.pop(name, None)

    def withdraw_schema(self, schema: str) -> None:
        """Takes the offers of the views of a schema back."""
        for name in [name for name in self._makers if name[0] == schema]:
            del self._makers[name]

    def clear(self) -> None:
        """Takes all offers back, as the connection is closed."""
        self._makers.clear()

    def make(self, name: Name, connection: Connection) -> None:
        """Makes a view or a function if that has not been done."""
        maker = self._makers.get(name)
        if maker is not None:
            maker(connection)
            self._makers.pop(name, None)

    def make_all(self, connection: Connection) -> None:
        """Makes everything, for a statement that may read anything."""
        while self._makers:
            self.make(next(iter(self._makers)), connection)

    def make_named(self, words: AbstractSet[str], connection: Connection) -> None:
        """Makes what words in small letters name; names in a user's query may omit the schema."""
        for name in [name for name in self._makers if name[1].casefold() in words]:
            self.make(name, connection)

    def make_schema(self, schema: str, connection: Connection) -> None:
        """Makes the views of a schema."""
        for name in [name for name in self._makers if name[0] == schema]:
            self.make(name, connection)

    def is_offered(self, name: Name) -> bool:
        """Checks whether a view or a function is still to be made."""
        return name in self._makers

    @property
    def leaves_out(self) -> bool:
        """Whether a statement runs that has names left out; one that runs within it may not."""
        return bool(self._left_out)

    @contextmanager
    def without(self, names: Collection[Name]) -> Iterator[None]:
        """Has `provide` make none of some names in a context: they are there, in part."""
        before, self._left_out = self._left_out, frozenset(names)
        try:
            yield
        finally:
            self._left_out = before

    def provide(self, sql: str, connection: Connection) -> None:
        """Makes what one of ssduck's own statements may name."""
        if not self._makers or sql in self._complete:
            return
        text = sql.casefold()  # SQL ignores case
        for schema, name in list(self._makers):
            if (schema, name) in self._left_out:
                continue
            # A name may be quoted.
            is_named = schema is None or schema.casefold().replace('"', '""') in text
            if is_named and _word(name).search(text):
                self.make((schema, name), connection)
        if self._left_out:
            return
        if len(self._complete) >= _MAX_STATEMENTS:
            self._complete.clear()
        self._complete.add(sql)


@lru_cache(maxsize=1024)
def _word(name: str) -> re.Pattern[str]:
    return re.compile(rf"(?<!\w){re.escape(name.casefold())}(?!\w)")
