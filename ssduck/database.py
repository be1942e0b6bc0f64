"""The one door to DuckDB: worlds as schemas, statements, and the tick that they run on."""

from __future__ import annotations

import inspect
import re
import threading
import weakref
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import count
from typing import Any, Literal, NoReturn, TypeAlias, TypeVar

import duckdb
import pyarrow as pa
from duckdb.func import FunctionNullHandling
from sqlglot import exp

from ssduck import ctrl_c
from ssduck.catalog import TABLE_MACROS, described, dropped, looking_up
from ssduck.errors import (
    ArgumentError,
    LimitError,
    SelectScriptError,
    Span,
    SqlError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.functions import Function
from ssduck.limits import Limits, Meter
from ssduck.shapes import ANSWERS
from ssduck.tables import TABLES, Column, LiveTable
from ssduck.types import Signature, Tag, converter, is_exactly
from ssduck.udfs import NARROW
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
    return f"{_OURS}{number} {' '.join(sorted(TABLES.keys() & set(reads)))}"


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
            select.join(row.copy(), join_type="cross", copy=False)
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
    """

    world: World
    key: str
    schemas: list[str] = field(default_factory=list)
    versions: dict[str, int] = field(default_factory=dict)


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
        self, path: str, tracer: Callable[[str], None] | None, limits: Limits | None = None
    ) -> None:
        try:
            self._connection = duckdb.connect(path)
        except duckdb.Error as error:
            raise SqlError(f"{path} cannot be opened: {str(error).strip()}") from error
        # Left open until Python ends, it would print complaints there.
        self._finalizer = weakref.finalize(self, self._connection.close)
        self._tracer = tracer
        self._lock = threading.RLock()
        self.meter = Meter(limits or Limits())
        self._functions: set[str] = set()
        # What a function raised while SQL called it: DuckDB keeps but its words.
        self._raised: list[BaseException] = []
        self._bound: list[_Bound] = []
        # The functions of the narrow phase know the worlds by their names, and not this object.
        self._narrow_worlds: dict[str, World] = {}
        self._numbers = count(1)
        # Counts up, by table, when prepared statements that read it lose their validity.
        self._generations = dict.fromkeys(TABLES, 0)
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
        for name in NARROW:
            self._add_narrow(name)
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
        """Close the connection; a file keeps no views or macros on worlds that are gone."""
        with self._lock:
            if not self._finalizer.alive:
                return
            for bound in self._bound:
                for schema in bound.schemas:
                    has_macros = schema in (self._told_of or ())
                    for statement in dropped(schema, described=has_macros):
                        self.run(statement)
            self._finalizer()

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
        if isinstance(cause, LimitError | UnknownNameError | UnsupportedError):
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
        converters = [converter(tag, self.worlds) for tag in signature.parameters]
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
                snapshot = worlds[world].snapshot
                if any(tick != snapshot.number for tick in arguments[:entities:2]):
                    raise UnsupportedError(
                        f"the shapes of {world!r} are known of its tick {snapshot.number} only: "
                        "rows that were kept of another tick cannot be compared"
                    )
                return answer(snapshot.shapes(), *arguments[1:entities:2], *arguments[entities:])
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
            bound = self._entry(world)
            if name not in bound.schemas:
                bound.schemas.append(name)
                self._make_views(name, bound)
            self._set_search_path()
            names = {schema: bound.world for bound in self._bound for schema in bound.schemas}
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
                for table in other.versions:
                    self.unshow(_live(other.key, table))

    def _check_schema(self, name: str) -> None:
        ((database,),) = self.rows("SELECT current_database()")
        if name.casefold() in _TAKEN or name.casefold() == database.casefold():
            raise ArgumentError(
                f"a world cannot be called {name!r}: DuckDB has a schema or database of that name"
            )
        for other in self._bound:
            for schema in other.schemas:
                if schema != name and schema.casefold() == name.casefold():
                    raise ArgumentError(
                        f"a world cannot be called {name!r}: there is {schema!r}, "
                        "and SQL does not tell upper from lower case"
                    )

    def _entry(self, world: World) -> _Bound:
        for bound in self._bound:
            if bound.world is world:
                return bound
        bound = _Bound(world, f"world {next(self._numbers)}")
        self._bound.append(bound)
        self._show(bound)
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
        if self._told_of is not None:
            self._told_of.discard(name)
        self._forget_plans()

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
            for statement in described(schemas, only, self._told_of):
                self.run(statement)
            self._told_of = set(schemas)

    def generation(self, tables: Iterable[str]) -> int:
        """Counts up when prepared statements that read one of these tables lose their validity."""
        return sum(self._generations.get(table, 0) for table in tables)

    def _show(self, bound: _Bound) -> None:
        """Let DuckDB see the buffers that were made anew; the others it sees already."""
        for table, live in bound.world.snapshot.tables.items():
            if bound.versions.get(table) != live.version:
                if table in bound.versions:
                    self._forget_plans(table)
                self.show(_live(bound.key, table), live.arrow)
                bound.versions[table] = live.version

    def show(self, name: str, table: pa.Table) -> None:
        """Let DuckDB see a table under a name."""
        self._connection.register(name, table)

    def unshow(self, name: str) -> None:
        """Let DuckDB forget a table."""
        self._connection.unregister(name)

    def _forget_plans(self, table: str = "entities") -> None:
        """Drop prepared statements that would go on reading a table's old buffers.

        Our own say by their names what they read. Of a user's it is not known, so that all are
        dropped if any statement that DuckDB keeps names the table.
        """
        theirs = table in self._asked_for_good
        self._generations[table] += 1
        for (name,) in self.rows("SELECT name FROM duckdb_prepared_statements()"):
            if table in name.split() if name.startswith(_OURS) else theirs:
                self.run(f"DEALLOCATE {exp.to_identifier(name, quoted=True).sql('duckdb')}")

    @property
    def worlds(self) -> dict[str, World]:
        """The worlds by the schema that ssduck's statements use, the first one first."""
        return {bound.schemas[0]: bound.world for bound in self._bound if bound.schemas}


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


def _live(key: str, table: str) -> str:
    """What a table's buffers are called among DuckDB's temporary views."""
    return f"{key}: {table}"
