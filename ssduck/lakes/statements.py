"""Writes a question of formulas as one statement of SQL over the Parquet files of a lake.

The statement has the files' addresses, the episodes and the formulas, so that DuckDB and Spark
answer it without ssduck. Its parts, from the inside out:

    ssduck_episodes    the episodes, numbered in the order of the lake
    ssduck_entities    the rows of their entities, at the ticks in question
    ssduck_rows        the program's SQL, with the number of the episode beside each tick
    ssduck_series      for an expression: its value at each time
    ssduck_answers     for a function over time: the answer of each episode
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias, TypeVar, get_args

import sqlglot
from sqlglot import exp

from ssduck.errors import ArgumentError, RecordError, UnknownNameError, UnsupportedError, nearest
from ssduck.formatting import short_repr
from ssduck.interpreter.opening import open_record
from ssduck.interpreter.plans_over_ticks import SelectedSql, TickPlan, plan_over_ticks
from ssduck.lakes.answers import ERROR, KEYS
from ssduck.lakes.manifest import EpisodeEntry, named_errors
from ssduck.lakes.questions import add_hint_of_episode
from ssduck.language.parser import parse
from ssduck.limits import Limits
from ssduck.recording.paths import expand_path, part_number
from ssduck.recording.stores.parquet_layout import FolderRun
from ssduck.recording.stores.stored_columns import part_columns
from ssduck.schema import MODELS, RECORDED
from ssduck.simulators.clock import TIME_TOLERANCE
from ssduck.sql.sql_values import literal

_Part = TypeVar("_Part", bound=exp.Expr)
SqlDialect: TypeAlias = Literal["duckdb", "spark"]
DIALECTS: tuple[str, ...] = get_args(SqlDialect)
# The number of an episode, and that of a row of its answer.
_NUMBER, _ROW = "ssduck_number", "ssduck_row"
_PREFIX = "ssduck_"
_EPISODES, _ENTITIES, _TICKS, _ROWS, _ANSWERS = (
    f"{_PREFIX}{name}" for name in ("episodes", "entities", "ticks", "rows", "answers")
)
# The columns of the episodes: where they are, and their ticks in question.
_COLUMNS = (_NUMBER, "record", "path", "world", "episode", "first_tick", "last_tick", "since")
_WRITTEN = "written as SQL: ask the episodes (Lake.ask)"
# What stands for other characters in a path: DuckDB's and Hadoop's ways to write one as itself.
_DUCKDB_PATTERN = re.compile(r"([*?\[])")
_HADOOP_PATTERN = re.compile(r"([\\*?\[\]{}])")


def statement(
    entries: Sequence[EpisodeEntry], program: str, dialect: str, limits: Limits | None = None
) -> str:
    """Returns the statement that answers a program for some episodes."""
    if dialect not in DIALECTS:
        raise UnknownNameError(
            f"there is no SQL dialect {short_repr(dialect)} for lakes",
            suggestions=nearest(str(dialect), DIALECTS),
        )
    whole, failed = _read_episodes(entries)
    plans = _plans_of(whole, program, limits)
    if not plans:
        reason = named_errors(list(failed.values())) if failed else "none was selected"
        raise ArgumentError(f"there is no episode to ask: {reason}")
    parts: dict[str, exp.Expr] = {}
    answers: list[exp.Select] = []
    for place, (plan, chosen) in enumerate(plans):
        own, select = _answers(plan, _Files(chosen, dialect, plan.age))
        names = {name: f"{name}_{place + 1}" for name in own} if place else {}
        parts |= {names.get(name, name): _renamed(part, names) for name, part in own.items()}
        answers.append(_renamed(select, names))
    whole_select = _united(answers, failed)
    for name, part in parts.items():
        whole_select = whole_select.with_(name, as_=part)
    return _text(whole_select, dialect)


_Entries: TypeAlias = dict[int, EpisodeEntry]


def _read_episodes(entries: Sequence[EpisodeEntry]) -> tuple[list[_Entries], _Entries]:
    """Returns the episodes by number, in groups with the same entities, and those with errors."""
    groups: dict[str, _Entries] = {}
    failed: _Entries = {}
    for number, entry in enumerate(entries):
        if entry.error is not None:
            failed[number] = entry
            continue
        if entry.group is None:
            raise UnsupportedError(
                f"{entry.path}, episode {entry.episode} of {entry.world!r}, is no complete episode "
                "in Parquet files: leave it out (where), or ask the episodes (Lake.ask)"
            )
        try:
            _check_files(entry)
        except RecordError as error:
            failed[number] = replace(entry, error=str(error))
        else:
            groups.setdefault(entry.group, {})[number] = entry
    return list(groups.values()), failed


def _check_files(entry: EpisodeEntry) -> None:
    """Checks the bytes of the files of an episode that its plan and its statement read."""
    run = FolderRun(expand_path(entry.path), entry.world, entry.episode)
    for table in ("ticks", "entities", *(f"models/{model}" for model in MODELS)):
        run.check_data(table, map(part_number, run.listed_files(table)))


def _plans_of(
    groups: Sequence[_Entries], program: str, limits: Limits | None
) -> list[tuple[TickPlan, _Entries]]:
    """Returns the plans of episodes, each with those whose statement is the same."""
    plans: dict[tuple[str, str], tuple[TickPlan, _Entries]] = {}
    for members in groups:
        first = next(iter(members.values()))
        with open_record(first.path, first.world, first.episode, limits=limits) as interpreter:
            try:
                plan = plan_over_ticks(interpreter, program)
            except UnknownNameError as error:
                add_hint_of_episode(error, parse(program), first)
                raise
        bare = _without_ticks(plan.select)
        key = first.world, bare.sql("duckdb")
        plans.setdefault(key, (replace(plan, select=bare), {}))[1].update(members)
    return list(plans.values())


def _without_ticks(select: exp.Select) -> exp.Select:
    """Returns a statement without the numbers of the ticks of the episode that it was made of."""
    result = select.copy()
    for query in [s.this for s in result.find_all(exp.Subquery) if isinstance(s.this, exp.Select)]:
        where = query.args.get("where")
        whole = None if where is None else where.this
        parts = list(whole.flatten()) if isinstance(whole, exp.And) else [whole]
        kept = [part for part in parts if part is not None and not _is_range_of_ticks(part)]
        query.set("where", exp.Where(this=exp.and_(*kept)) if kept else None)
    return result


def _is_range_of_ticks(part: exp.Expr | None) -> bool:
    return isinstance(part, exp.Between) and part.this == exp.column("tick")


# -- the statement of episodes with the same entities -----------------------------------------


@dataclass(frozen=True)
class _Files:
    """The files of the episodes with one plan."""

    entries: Mapping[int, EpisodeEntry]
    dialect: str
    age: float | None

    @property
    def records(self) -> list[tuple[str, str]]:
        """The paths of the records, each with the world."""
        return list(dict.fromkeys((e.path, e.world) for e in self.entries.values()))

    def episodes(self) -> exp.Select:
        places = {record: place for place, record in enumerate(self.records)}
        rows = []
        for number, entry in self.entries.items():
            assert entry.last_tick is not None
            assert entry.end is not None
            first = entry.last_tick if self.age == 0.0 else entry.first_tick
            since = entry.end + (self.age or 0.0) - TIME_TOLERANCE
            place = places[entry.path, entry.world]
            own = (number, place, entry.path, entry.world, entry.episode, first, entry.last_tick)
            rows.append((*own, float(since)))
        return exp.select(*_COLUMNS).from_(_values(rows, _COLUMNS))

    def rows(self, table: str, columns: Sequence[str]) -> exp.Expr:
        """Returns the rows of a table at the ticks in question, with the numbers of episodes."""
        parts = []
        for place, (path, world) in enumerate(self.records):
            conditions = f"e.record = {place} AND f.episode = e.episode"
            conditions += " AND f.tick BETWEEN e.first_tick AND e.last_tick"
            if self.age:
                conditions += " AND f.time >= e.since"
            select = exp.select(
                exp.column(_NUMBER, table="e"),
                *(self._stored(table, name) for name in columns),
            )
            select = select.from_(self._scan(f"{path}/{table}/world={world}"))
            parts.append(select.join(exp.table_(_EPISODES, alias="e"), on=_parsed(conditions)))
        return _union(parts)

    def _scan(self, folder: str) -> exp.Expr:
        """Returns the rows of the files in a folder, in which each episode has a folder."""
        alias = _alias("f")
        if self.dialect == "spark":
            exact = _HADOOP_PATTERN.sub(r"\\\1", folder)
            place = exp.to_identifier(exact, quoted=True)
            return exp.Table(this=place, db=exp.to_identifier("parquet"), alias=alias)
        exact = _DUCKDB_PATTERN.sub(r"[\1]", folder)
        files = exp.Literal.string(f"{exact}/episode=*/part-*.parquet")
        is_hive = exp.EQ(this=exp.column("hive_partitioning"), expression=exp.true())
        read = exp.Anonymous(this="read_parquet", expressions=[files, is_hive])
        return exp.Table(this=read, alias=alias)

    def _stored(self, table: str, name: str) -> exp.Expr:
        """Returns a column of a file; NULL for NaN, which other writers may have stored."""
        column = exp.column(name, table="f", quoted=True)
        types = {one.name: one.type for one in RECORDED[table].columns}
        if types.get(name) != "double" or name == "time":
            return column
        if self.dialect == "spark":
            known = exp.case().when(exp.not_(exp.IsNan(this=column)), column.copy())
        else:  # see `history_sql.known`
            is_finite = exp.Anonymous(this="isfinite", expressions=[column])
            known = exp.case().when(is_finite, column.copy())
            known = known.when(exp.IsInf(this=column.copy()), column.copy())
        return exp.alias_(known, name, quoted=True)


# -- the rows of the program ------------------------------------------------------------------


def _answers(plan: TickPlan, files: _Files) -> tuple[dict[str, exp.Expr], exp.Select]:
    """Returns the parts of a statement by name, and the SELECT of the answers of episodes."""
    rows, columns = _of_all_episodes(plan)
    parts: dict[str, exp.Expr] = {
        _EPISODES: files.episodes(),
        _ENTITIES: files.rows("entities", columns),
    }
    if plan.is_query:
        parts[_ROWS] = _numbered(rows)
        names = _column_names(plan)
        keys = [exp.column(name, table="e") for name in (_NUMBER, *KEYS)]
        columns_of_rows = (exp.column(name, table="a", quoted=True) for name in (_ROW, *names))
        select = exp.select(*keys, *columns_of_rows).from_(exp.table_(_ROWS, alias="a"))
        return parts, select.join(exp.table_(_EPISODES, alias="e"), using=[_NUMBER])
    parts[_TICKS] = files.rows("ticks", ("tick", "time"))
    parts[_ROWS] = rows
    own, answer = _over_time(plan)
    parts |= own
    keys = [exp.column(name, table="e") for name in (_NUMBER, *KEYS)]
    number = exp.alias_(exp.Literal.number(0), _ROW)
    select = exp.select(*keys, number, exp.alias_(answer, "answer"))
    select = select.from_(exp.table_(_EPISODES, alias="e"))
    return parts, select.join(exp.table_(_ANSWERS, alias="a"), using=[_NUMBER], join_type="left")


def _of_all_episodes(plan: TickPlan) -> tuple[exp.Select, list[str]]:
    """Returns a program's SQL over the ticks of all episodes, and the columns that it reads."""
    select = plan.select.copy()
    from_, joins = select.find(exp.From), select.args.get("joins") or []
    assert from_ is not None
    sources = [from_.this, *(join.this for join in joins)]
    inner = [source.this for source in sources if isinstance(source, exp.Subquery)]
    tables = list(select.find_all(exp.Table))
    if len(list(select.find_all(exp.Select))) != 1 + len(inner):
        raise UnsupportedError(f"a query inside of another expression is not {_WRITTEN}")
    for table in tables:
        if table.name != "entities_history":
            raise UnsupportedError(f"what reads {table.name} is not {_WRITTEN}")
        alias = table.args.get("alias")
        table.replace(exp.Table(this=exp.to_identifier(_ENTITIES), alias=alias))
    first, *others = (
        exp.column(_NUMBER, table=exp.to_identifier(source.alias, quoted=True))
        for source in sources
    )
    for join, own in zip(joins, others, strict=True):
        is_same = exp.EQ(this=first.copy(), expression=own)
        join.set("on", exp.and_(join.args.get("on"), is_same))
        join.set("kind", None)
    columns = [exp.alias_(column.value.copy(), name, quoted=True) for column, name in _named(plan)]
    select.set("expressions", [first.copy(), *columns])
    read = {column.name for column in select.find_all(exp.Column)} | {"id", "tick", "time"}
    return select, [name for name in part_columns("entities") if name in read]


def _named(plan: TickPlan) -> Iterator[tuple[SelectedSql, str]]:
    names = _column_names(plan) if plan.is_query else ("tick", "time", "value")
    return zip(plan.columns, names, strict=True)


def _column_names(plan: TickPlan) -> list[str]:
    """Returns the names of the columns of an answer, none of which is there twice."""
    names: list[str] = []
    taken = {ERROR, *KEYS}
    for column in plan.columns:
        name = column.name
        while name.lower() in taken:
            name += "_"
        taken.add(name.lower())
        names.append(name)
    return names


def _numbered(rows: exp.Select) -> exp.Select:
    """Returns the rows of a query with their places in its order, in each episode."""
    order, limit, offset = (rows.args.get(name) for name in ("order", "limit", "offset"))
    for name in ("order", "limit", "offset"):
        rows.set(name, None)
    assert order is not None  # rows of the past have an order
    number = rows.expressions[0]
    window = exp.Window(this=exp.RowNumber(), partition_by=[number.copy()], order=order)
    rows = rows.select(exp.alias_(window, _ROW))
    if limit is None and offset is None:
        return rows
    first = offset.expression if offset is not None else exp.Literal.number(0)
    conditions: list[exp.Expr] = [exp.GT(this=exp.column(_ROW), expression=first.copy())]
    if limit is not None:
        last = exp.Add(this=first.copy(), expression=limit.expression.copy())
        conditions.append(exp.LTE(this=exp.column(_ROW), expression=last))
    return exp.select("*").from_(rows.subquery("numbered")).where(*conditions)


# -- functions over time ----------------------------------------------------------------------

# Of several ticks of the same time, the last one counts.
_SERIES = """
    SELECT m.ssduck_number, m.time, r.value
    FROM (
        SELECT ssduck_number, time, max(tick) AS tick FROM ssduck_ticks
        GROUP BY ssduck_number, time) AS m
    LEFT JOIN ssduck_rows AS r ON r.ssduck_number = m.ssduck_number AND r.tick = m.tick
"""
_SPANS = """
    SELECT *, lead(time) OVER (PARTITION BY ssduck_number ORDER BY time) AS following,
        sum(CASE WHEN value THEN 0 ELSE 1 END) OVER (PARTITION BY ssduck_number ORDER BY time)
            AS island,
        max(CASE WHEN value THEN NULL ELSE time END) OVER (PARTITION BY ssduck_number) AS broken
    FROM ssduck_series
"""
_INTERVALS = """
    SELECT ssduck_number, min(time) AS began, max(coalesce(following, time)) AS ended
    FROM ssduck_spans WHERE value GROUP BY ssduck_number, island
"""
_HOLDS = """
    SELECT ssduck_number, list_sort(list([began, ended])) AS answer
    FROM ssduck_intervals GROUP BY ssduck_number
"""
_SINCE = """
    SELECT ssduck_number, max(time) AS latest,
        min(CASE WHEN broken IS NULL OR time > broken THEN time END) AS answer
    FROM ssduck_spans GROUP BY ssduck_number
"""
_STEPS = """
    SELECT *, row_number() OVER (PARTITION BY ssduck_number ORDER BY time) AS place,
        lag(value) OVER (PARTITION BY ssduck_number ORDER BY time) AS preceding
    FROM ssduck_series
"""
_CHANGES = """
    SELECT ssduck_number, list_sort(list({'time': time, 'value': value})) AS answer
    FROM ssduck_steps WHERE place = 1 OR value IS DISTINCT FROM preceding GROUP BY ssduck_number
"""
_FIRST = "SELECT ssduck_number, value AS answer FROM ssduck_steps WHERE place = 1"
_RANKED = """
    SELECT *, row_number() OVER (PARTITION BY ssduck_number ORDER BY value {}, time) AS place
    FROM ssduck_series WHERE value IS NOT NULL AND NOT isnan(CAST(value AS DOUBLE))
"""
_EXTREME = """
    SELECT ssduck_number, {'time': time, 'value': value} AS answer
    FROM ssduck_ranked WHERE place = 1
"""
_INTERVALS_ANSWER = "coalesce(a.answer, CAST([] AS DOUBLE[][]))"
_TRUTH, _NUMBERS = frozenset(("boolean",)), frozenset(("double", "integer"))
_VALUES = _TRUTH | _NUMBERS | {"string"}


@dataclass(frozen=True)
class _Function:
    """A function over time in SQL."""

    types: frozenset[str]
    parts: Mapping[str, str]
    answer: str = "a.answer"


_OF_SPANS = {"spans": _SPANS}
_SINCE_PARTS = _OF_SPANS | {"answers": _SINCE}
_FIRST_PARTS = {"steps": _STEPS, "answers": _FIRST}
_FUNCTIONS: dict[str | None, _Function] = {
    None: _Function(_VALUES, _FIRST_PARTS),
    "initially": _Function(_VALUES, _FIRST_PARTS),
    "holds": _Function(
        _TRUTH, _OF_SPANS | {"intervals": _INTERVALS, "answers": _HOLDS}, _INTERVALS_ANSWER
    ),
    "since": _Function(_TRUTH, _SINCE_PARTS),
    "heldFor": _Function(_TRUTH, _SINCE_PARTS, "coalesce(a.latest - a.answer, 0e0)"),
    "changes": _Function(_VALUES, {"steps": _STEPS, "answers": _CHANGES}),
    "least": _Function(_NUMBERS, {"ranked": _RANKED.format("ASC"), "answers": _EXTREME}),
    "greatest": _Function(_NUMBERS, {"ranked": _RANKED.format("DESC"), "answers": _EXTREME}),
}


def _over_time(plan: TickPlan) -> tuple[dict[str, exp.Expr], exp.Expr]:
    """Returns the parts of a function over time, the series first, and the answer."""
    function, type = _FUNCTIONS[plan.function], plan.columns[-1].sql_type.type
    if type not in function.types:
        raise UnsupportedError(f"{plan.function or 'a value'} of the type {type} is not {_WRITTEN}")
    texts = {"series": _SERIES, **function.parts}
    return {f"{_PREFIX}{name}": _parsed(text) for name, text in texts.items()}, _parsed(
        function.answer
    )


# -- the whole --------------------------------------------------------------------------------


def _united(answers: Sequence[exp.Select], failed: Mapping[int, EpisodeEntry]) -> exp.Select:
    """Returns the answers and the episodes with errors, in the order of the lake."""
    names = [one.alias_or_name for one in answers[0].expressions]
    no_error = exp.alias_(exp.cast(exp.null(), "TEXT"), ERROR)
    parts: list[exp.Expr] = [select.select(no_error.copy()) for select in answers]
    if failed:
        rows = [(n, e.world, e.episode, e.path, 0, e.error) for n, e in failed.items()]
        known = (_NUMBER, *KEYS, _ROW, ERROR)
        values = [exp.column(name) if name in known else exp.null() for name in names]
        parts.append(exp.select(*values, exp.column(ERROR)).from_(_values(rows, known)))
    shown = [name for name in (*names, ERROR) if name not in (_NUMBER, _ROW)]
    select = exp.select(*(exp.column(name, quoted=True) for name in shown))
    select = select.from_(exp.Subquery(this=_union(parts), alias=_alias("answered")))
    return select.order_by(exp.column(_NUMBER), exp.column(_ROW))


def _values(rows: Sequence[Sequence[Any]], columns: Sequence[str]) -> exp.Values:
    tuples = [exp.Tuple(expressions=[literal(value) for value in row]) for row in rows]
    alias = _alias("listed")
    alias.set("columns", [exp.to_identifier(name) for name in columns])
    return exp.Values(expressions=tuples, alias=alias)


def _alias(name: str) -> exp.TableAlias:
    return exp.TableAlias(this=exp.to_identifier(name))


def _union(parts: Sequence[exp.Expr]) -> exp.Expr:
    result = parts[0]
    for part in parts[1:]:
        result = exp.union(result, part, distinct=False, copy=False)
    return result


def _renamed(part: _Part, names: Mapping[str, str]) -> _Part:
    for table in part.find_all(exp.Table):
        if table.name in names:
            table.set("this", exp.to_identifier(names[table.name]))
    return part


def _parsed(text: str) -> exp.Expr:
    return sqlglot.parse_one(text, dialect="duckdb")


def _text(select: exp.Select, dialect: str) -> str:
    tree = select if dialect == "duckdb" else select.transform(_as_double)
    return tree.sql(dialect=dialect, unsupported_level=sqlglot.ErrorLevel.RAISE, pretty=True)


def _as_double(part: exp.Expr) -> exp.Expr:
    """Writes a number with a fraction as a double: Spark takes it for a decimal one."""
    is_fraction = isinstance(part, exp.Literal) and not part.is_string and "." in part.name
    if is_fraction and "e" not in part.name.lower():
        return exp.Literal.number(f"{part.name}e0")
    return part
