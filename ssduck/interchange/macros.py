"""Writes relations as macros of plain DuckDB, and the tables of a record as views.

A *formula* is an expression over the columns of two rows, and needs nothing else. A *lookup* reads a
table of the record at the tick of its rows. The other relations compare shapes or ask joints, which
only ssduck does.

The table of the pairs of a record whose shapes are near each other is for tools without shapes:

    pairs/world=kitchen/episode=0/part-000000.parquet

A row is two entities a < b at a tick whose clearance is at most `within`, which the footer says.
The table follows from the others; ssduck itself does not read it.
"""  # noqa: E501

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import sqlglot
from sqlglot import exp

from ssduck import validation
from ssduck.errors import NumberError, RecordError, check_known
from ssduck.language.intervals import INTERVALS, RELATIONS_OF_INTERVALS
from ssduck.recording.paths import FORMAT, part_name, part_number
from ssduck.recording.stores.files import verified_parquet, write_parquet
from ssduck.recording.stores.history_sql import file_list, quoted, rows_of_files
from ssduck.recording.stores.parquet_layout import PAIRS, FolderRun
from ssduck.recording.stores.stored_columns import part_columns
from ssduck.schema import LINK_FACTOR, MAX_LINKS, MODELS, RECORDED, TABLES, Column
from ssduck.sql.relations.motion import LINK_SPEED_UDFS, link_speed_lookup
from ssduck.sql.relations.registry import RELATIONS
from ssduck.sql.relations.relation import Relation, overloads_of_others

_WITHIN = b"ssduck pairs"
COLUMNS = pa.schema(
    [
        ("tick", pa.int64()),
        ("time", pa.float64()),
        ("a", pa.int64()),
        ("b", pa.int64()),
        ("clearance", pa.float64()),
        ("depth", pa.float64()),
    ]
)


def checked_distance(within: float) -> float:
    """Returns the largest clearance of pairs, m."""
    distance = validation.finite_number(within, "pairs", "metres")
    if distance < 0.0:
        raise NumberError(f"pairs: {distance:g} m is less than 0")
    return distance


def pair_query(schema: str) -> str:
    """Returns the SELECT of the pairs of a world at recorded ticks.

    Its parameters are the distance, and the first and the last tick.
    """
    history = f'"{validation.identifier(schema, "a world")}".entities_history'
    return (
        "SELECT a.tick, a.time, a.id AS a, b.id AS b, clearance(a, b) AS clearance, "  # noqa: S608
        f"penetration(a, b) AS depth FROM {history} AS a JOIN {history} AS b "
        "ON a.tick = b.tick AND a.id < b.id WHERE near(a, b, ?) AND a.tick BETWEEN ? AND ? "
        "ORDER BY a.tick, a.id, b.id"
    )


def write_pairs(run: FolderRun, rows: pa.Table, within: float) -> Path:
    """Writes the pairs of an episode; returns their file."""
    file = run.place(PAIRS) / part_name(0)
    label = run.label(PAIRS, 0)
    metadata = {_WITHIN: json.dumps({"within": within}).encode()}
    if label is not None:
        metadata[FORMAT.encode()] = label
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        labelled = rows.cast(COLUMNS).replace_schema_metadata(metadata)
        write_parquet(labelled, file, compression="zstd")
    except OSError as error:
        raise RecordError(f"{file} cannot be written: {error.strerror}") from error
    return file


def pairs_of(run: FolderRun) -> tuple[Path, float] | None:
    """Returns the file of an episode's pairs, and their largest clearance, m; None without one."""
    file = run.place(PAIRS) / part_name(0)
    if not file.is_file():
        return None
    stored: pq.ParquetFile = verified_parquet(file, has_checksums=True)
    metadata = stored.schema_arrow.metadata or {}
    label = run.label(PAIRS, 0)
    if label is not None and metadata.get(FORMAT.encode()) != label:
        raise RecordError(f"{file} is of another episode: it was copied there; remove it")
    try:
        within = json.loads(metadata[_WITHIN])["within"]
        return file, checked_distance(within)
    except (KeyError, TypeError, ValueError) as error:
        raise RecordError(f"{file} is damaged: it does not say how near its pairs are") from error


# -- the script -------------------------------------------------------------------------------


# The tables whose rows do not differ from tick to tick.
_OF_MODELS = frozenset(("shapes", "geometries"))
# Where a lookup has names of its own, so that no alias of a query is taken for one of them.
_PREFIX = "ssduck "
# The ticks, and what a view has of each.
_AT, _VALUE = '"ssduck at"', '"ssduck value"'
_MOMENTS = f'(SELECT "ssduck tick" AS {_AT} FROM "ssduck ticks") AS moments'  # noqa: S608
_WITHOUT_RECORD = "of the table of {}; ssduck macros --of RECORD writes those of a record"
_NOT_RECORDED = "of the table of {}, which is not recorded"
_SHAPES = "of shapes, which only ssduck compares"
_JOINTS = "of joints by their names and limits, which only ssduck reads"


@dataclass(frozen=True)
class MacroScript:
    """A script for plain DuckDB, the names of its macros, and why it lacks other relations."""

    text: str
    names: tuple[str, ...]
    missing: Mapping[str, str]


def macro_script(names: Sequence[str] = (), run: FolderRun | None = None) -> MacroScript:
    """Returns a script of some relations, or of all, and of views of the tables of an episode."""
    known = [*RELATIONS, *(name for name in RELATIONS_OF_INTERVALS if name not in RELATIONS)]
    for name in names:
        check_known(name, known, f"there is no relation {name!r}")
    files = {} if run is None else _files_of(run)
    pairs = None if run is None else pairs_of(run)
    is_wanted = set(names or known)
    source = _Source(frozenset(files), run is not None)
    statements: list[str] = []
    made: list[str] = []
    missing: dict[str, str] = {}
    for name, relation in RELATIONS.items():
        if name not in is_wanted:
            continue
        reason = source.obstacle(relation)
        if pairs is not None and (relation.alias_of or name) in _PAIR_MACROS:
            statements.append(_pair_macro(name, relation.alias_of or name, pairs[1]))
            made.append(name)
            continue
        if reason is None:
            statements += source.macros(relation)
            made.append(name)
        else:
            missing[name] = reason
            statements += _macros_of_lists(relation)
    for name, allen in RELATIONS_OF_INTERVALS.items():
        if name in is_wanted and name not in RELATIONS:
            statements.append(f"CREATE OR REPLACE MACRO {quoted(name)}(a, b) AS ({allen.formula})")
            made.append(name)
    if not names:
        statements.append(f"CREATE OR REPLACE MACRO intervals(source) AS TABLE {INTERVALS}")
    views = [*_views(files)]
    if pairs is not None:
        views += _pair_views(pairs[0])
    parts = [_heading(run, missing), *(f"{one};" for one in (*views, *statements))]
    return MacroScript("\n".join(parts) + "\n", tuple(made), missing)


def _heading(run: FolderRun | None, missing: Mapping[str, str]) -> str:
    """Returns the comment at the beginning: whose tables these are, and which relations lack."""
    lines = ["Relations of ssduck as macros of DuckDB; their parameters are rows of tables:"]
    lines.append("SELECT a.name, b.name FROM entities a JOIN entities b USING (tick)")
    lines.append("WHERE above(a, b)")
    lines.append("Metres, seconds, kilograms; world frame; quaternions w, x, y, z.")
    if run is not None:
        lines.append(f"The views are episode {run.number} of {run.world} in {run.path}.")
        if run.is_complete is False:
            lines.append("Its recording is not closed: parts that come later are not in the views.")
    for reason in dict.fromkeys(missing.values()):
        names = [name for name in missing if missing[name] == reason]
        lines.append(f"Not here: {', '.join(names)}: {reason}.")
    return "\n".join(f"-- {_one_line(line)}" for line in lines)


def _one_line(text: str) -> str:
    return re.sub(r"[\x00-\x1f\x7f\x85\u2028\u2029]", " ", text)


# -- relations --------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Source:
    tables: frozenset[str]
    has_record: bool

    def trees(self, relation: Relation) -> dict[int, exp.Expr]:
        """Returns the formulas of a relation; without the table of links, those of entities."""
        has_links = not self.has_record or "links" in self.tables
        trees = relation.link_expressions if has_links else relation.expressions
        return {count: tree.transform(_plain, has_links) for count, tree in trees.items()}

    def obstacle(self, relation: Relation) -> str | None:
        """Returns why plain DuckDB cannot have a relation; None if it can."""
        trees = self.trees(relation).values()
        if any(tree.find(exp.Placeholder) for tree in trees):
            return _JOINTS if relation.python_table == "joints" else _SHAPES
        needed = {table.name for tree in trees for table in tree.find_all(exp.Table)}
        if needed and not self.has_record:
            return _WITHOUT_RECORD.format(" and ".join(sorted(needed)))
        lacking = sorted(needed - _OF_MODELS - self.tables)
        return _NOT_RECORDED.format(" and ".join(lacking)) if lacking else None

    def macros(self, relation: Relation) -> Iterator[str]:
        """Yields the statements of a relation: its macro, and before it those that look up."""
        parameters = [parameter.name for parameter in relation.parameters]
        entity = next((p.name for p in relation.parameters if p.type in ("entity", "place")), "")
        overloads = []
        for count, tree in self.trees(relation).items():
            body, lookups = _without_lookups(tree, f"{_PREFIX}{relation.name} {count}", entity)
            yield from lookups
            names = parameters[:count]
            if lookups:
                body, names = _renamed(body, names)
            overloads.append(f"({', '.join(names)}) AS ({body.sql('duckdb')})")
        overloads = [*overloads_of_others(relation), *overloads]
        yield f"CREATE OR REPLACE MACRO {quoted(relation.name)}{', '.join(overloads)}"


def _plain(part: exp.Expr, has_links: bool) -> exp.Expr:
    """Returns a lookup in place of a function of an entity's links."""
    if not isinstance(part, exp.Anonymous) or part.name not in LINK_SPEED_UDFS:
        return part
    return _parsed(link_speed_lookup(part.name) if has_links else "0")


def _macros_of_lists(relation: Relation) -> Iterator[str]:
    """Yields the statement of a relation of intervals that has the name of one of entities."""
    if relation.list_formula:
        lists = overloads_of_others(relation)
        yield f"CREATE OR REPLACE MACRO {quoted(relation.name)}{', '.join(lists)}"


def _without_lookups(tree: exp.Expr, name: str, entity: str) -> tuple[exp.Expr, list[str]]:
    """Returns a formula that looks things up in views, and the statements of these.

    A view has what a subquery of the formula gives at each tick. It has names of its own: in a
    macro, an alias of the query takes the place of a parameter, and could be taken for a column.
    """
    statements: list[str] = []

    def looked_up(part: exp.Expr) -> exp.Expr:
        query = part.args.get("query") if isinstance(part, exp.In) else part
        if not isinstance(query, exp.Subquery) or part.find(exp.Table) is None:
            return part
        place = quoted(f"{name} {len(statements)}")
        tick, rows = exp.column("tick", table=entity), _own_names(query).sql("duckdb")
        has_ticks = any(table.name not in _OF_MODELS for table in query.find_all(exp.Table))
        if not isinstance(part, exp.In):
            statements.append(_view_of(place, f"SELECT {_AT}, {rows} AS {_VALUE} FROM {_MOMENTS}"))  # noqa: S608
            values = f"(SELECT map(list({_AT}), list({_VALUE})) FROM {place})"  # noqa: S608
            return exp.func("map_extract_value", _parsed(values), tick)
        keys = part.this.expressions if isinstance(part.this, exp.Tuple) else [part.this]
        names = ", ".join(quoted(f"{_PREFIX}key {number}") for number in range(len(keys)))
        if has_ticks:
            keys, found = [tick, *keys], f"{_MOMENTS} CROSS JOIN LATERAL {rows} AS found({names})"
            names = f"{_AT}, {names}"
        else:
            found = f"{rows} AS found({names})"
        statements.append(_view_of(place, f"SELECT {names} FROM {found}"))  # noqa: S608
        held = _parsed(f"0 IN (SELECT {names} FROM {place})")  # noqa: S608
        held.set("this", exp.Tuple(expressions=keys) if len(keys) > 1 else keys[0])
        return held

    return tree.copy().transform(looked_up), statements


def _renamed(body: exp.Expr, names: Sequence[str]) -> tuple[exp.Expr, list[str]]:
    """Returns a formula whose parameters have names that no column of a view has, and these."""
    renamed = body.copy()
    for column in renamed.find_all(exp.Column):
        if column.table in names:
            column.set("table", exp.to_identifier(_own_parameter(column.table)))
        elif not column.table and column.name in names:
            column.set("this", exp.to_identifier(_own_parameter(column.name)))
    return renamed, list(map(_own_parameter, names))


def _own_parameter(name: str) -> str:
    return f"ssduck_{name}"


def _parsed(text: str) -> exp.Expr:
    return sqlglot.parse_one(text, dialect="duckdb")


def _view_of(place: str, rows: str) -> str:
    return f"CREATE OR REPLACE VIEW {place} AS {rows}"


def _own_names(query: exp.Expr) -> exp.Expr:
    """Returns a subquery that reads tables at the tick of a moment, with names of its own."""
    result = query.copy()
    for name in list(result.find_all(exp.Identifier)):
        name.set("this", _PREFIX + name.this)
        name.set("quoted", True)
    for table in list(result.find_all(exp.Table)):
        of_model = table.name.removeprefix(_PREFIX) in _OF_MODELS
        condition = "" if of_model else f" WHERE {quoted(f'{_PREFIX}tick')} = {_AT}"
        rows = _parsed(f"SELECT * FROM {quoted(table.name)}{condition}")  # noqa: S608
        alias = exp.TableAlias(this=exp.to_identifier(table.alias_or_name, quoted=True))
        table.replace(exp.Subquery(this=rows, alias=alias))
    return result


# -- tables -----------------------------------------------------------------------------------


def _files_of(run: FolderRun) -> dict[str, Sequence[Path]]:
    """Returns the files of the complete parts of each table and model of an episode."""
    names = [table for table in run.tables if table in TABLES]
    names += [f"models/{table}" for table in MODELS]
    files = {name: run.listed_files(name) for name in names}
    for name, listed in files.items():
        run.check_data(name, map(part_number, listed))
    return {name: listed for name, listed in files.items() if listed}


def _views(files: Mapping[str, Sequence[Path]]) -> Iterator[str]:
    """Yields the statements of the views of a record's tables."""
    for name, listed in files.items():
        rows, table = rows_of_files(listed, _columns(name)), name.removeprefix("models/")
        source = MODELS[table].model_view if name != table else table
        yield _view(source, rows if name != table else _with_view_columns(table, rows))
        if table in (_OF_MODELS if name != table else RECORDED):
            columns = ", ".join(
                f"{quoted(column)} AS {quoted(_PREFIX + column)}" for column in part_columns(name)
            )
            yield _view(_PREFIX + table, f"SELECT {columns} FROM {quoted(source)}")  # noqa: S608


def _view(name: str, rows: str) -> str:
    return _view_of(quoted(name), rows)


def _columns(name: str) -> Sequence[Column]:
    model = name.removeprefix("models/")
    return MODELS[model].model if model != name else TABLES[name].columns


def _with_view_columns(table: str, rows: str) -> str:
    """Returns rows of links with the columns that make them rows like those of entities."""
    if table != "links":
        return rows
    owner = "SELECT tick, id, name, enabled, visible, run FROM entities"
    id = f"CASE WHEN link < {MAX_LINKS} THEN (link + 1) * {LINK_FACTOR} + entity END"
    return (
        f"SELECT links.*, {id} AS id, owners.name || '.' || links.name AS full_name, "  # noqa: S608
        "'link' AS kind, owners.enabled, owners.visible, owners.run "
        f"FROM ({rows}) AS links JOIN ({owner}) AS owners "
        "ON owners.tick = links.tick AND owners.id = links.entity WHERE region IS NULL"
    )


# -- pairs ------------------------------------------------------------------------------------

# The relations that the table of pairs answers, with the condition on its rows, by their number of
# arguments.
_PAIR_MACROS = {
    "collides": {2: "{depth} > 1e-6", 3: "{depth} > ssduck_depth"},
    "collision": {2: "{depth} > 1e-6"},
    "near": {3: "{clearance} <= ssduck_d"},
}
_ENTITIES_ONLY = "{}: the table of pairs has entities, and no links"
_FARTHER = "near: the table of pairs has those within {!r} m"


def _pair_macro(name: str, relation: str, within: float) -> str:
    """Returns the statement of a relation that looks up the table of pairs."""
    columns = {column: quoted(_PREFIX + column) for column in COLUMNS.names}
    overloads, ids = [], "ssduck_a.id, ssduck_b.id"
    for count, condition in _PAIR_MACROS[relation].items():
        rows = (
            f"SELECT {columns['tick']}, {columns['a']}, {columns['b']} "  # noqa: S608
            f"FROM {quoted(_PREFIX + PAIRS)} WHERE {condition.format(**columns)}"
        )
        cases = f"WHEN greatest({ids}) >= {LINK_FACTOR} THEN {_error(_ENTITIES_ONLY, name)} "
        if relation == "near":
            cases += f"WHEN ssduck_d > {within!r} THEN {_error(_FARTHER, within)} "
        held = f"(ssduck_a.tick, least({ids}), greatest({ids})) IN ({rows})"
        parameters = ", ".join(
            _own_parameter(p.name) for p in RELATIONS[relation].parameters[:count]
        )
        overloads.append(
            f"({parameters}) AS (ssduck_a.tick = ssduck_b.tick AND CASE {cases}ELSE {held} END)"
        )
    return f"CREATE OR REPLACE MACRO {quoted(name)}{', '.join(overloads)}"


def _error(message: str, value: object) -> str:
    return f"error({exp.Literal.string(message.format(value)).sql('duckdb')})::BOOLEAN"


def _pair_views(file: Path) -> Iterator[str]:
    names = COLUMNS.names
    rows = f"FROM read_parquet({file_list([file])}, hive_partitioning = false)"
    yield _view(PAIRS, f"SELECT {', '.join(map(quoted, names))} {rows}")
    own = ", ".join(f"{quoted(name)} AS {quoted(_PREFIX + name)}" for name in names)
    yield _view(_PREFIX + PAIRS, f"SELECT {own} FROM {quoted(PAIRS)}")  # noqa: S608
