"""Measured numbers that a stranger stored as NaN are unknown, whichever way they are asked for."""

import math
import shutil
from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck.interchange.macros import macro_script
from ssduck.interpreter.archives import folder_run
from ssduck.recording.stores.files import write_parquet
from tests.support.cases import sampled
from tests.support.forged import part, rewrite_log, with_column, without_checksums
from tests.support.rising_cups import write_rising_cups

pytestmark = pytest.mark.slow
KINDS = ("folder", "unfinished", "file.duckdb")
# Columns of each table that a simulation measures.
NUMBERS = {
    "entities": ("z", "vx", "zmax"),
    "links": ("z", "wx"),
    "joints": ("position",),
    "contacts": ("force",),
}


def some_nan(rows, columns):
    """Returns rows with NaN in some columns of every other row."""
    for name in columns:
        values = rows[name].to_numpy().copy()
        values[::2] = np.nan
        rows = with_column(name, pa.array(values))(rows)
    return rows


def store_nan(record, table):
    columns = NUMBERS[table]
    if record.suffix:
        place = f'lab_record_0."{table} 0"'
        values = ", ".join(f"{name} = 'nan'" for name in columns)
        with duckdb.connect(record) as plain:
            plain.execute(f"UPDATE {place} SET {values} WHERE rowid % 2 = 0")
    elif record.name == "unfinished":
        rewrite_log(record, lambda t: t.update({table: some_nan(t[table], columns)}))
    else:
        without_checksums(record)
        file = part(record, table)
        rows = pq.ParquetFile(file).read()
        write_parquet(some_nan(rows, columns), file, write_statistics=False)


@pytest.fixture
def record(small_records, tmp_path, request):
    source = small_records / request.param
    copy = shutil.copytree if source.is_dir() else shutil.copy
    return Path(copy(source, tmp_path / source.name))


# The first file of the log has no contacts.
CASES = [(kind, table) for kind in KINDS for table in NUMBERS]
CASES.remove(("unfinished", "contacts"))


@sampled(("record", "table"), CASES, indirect=["record"], every=3)
def test_sql_reads_null_and_ssduck_writes_it(record, table, tmp_path):
    history = f"{table}_history"
    with ssduck.open(record) as ss:
        before = dict(ss.sql(f"SELECT column_name, null FROM (DESCRIBE {history})").fetchall())
        (counts,) = ss.sql(f"SELECT {_counts(table)} FROM {history}").fetchall()
    assert not any(counts)
    store_nan(record, table)
    with ssduck.open(record) as ss:
        (counts,) = ss.sql(f"SELECT {_counts(table)} FROM {history}").fetchall()
        assert all(counts)
        for name in NUMBERS[table]:
            assert ss.sql(f"SELECT * FROM {history} WHERE isnan({name})").fetchall() == []
            ((largest,),) = ss.sql(f"SELECT max({name}) FROM {history}").fetchall()
            assert math.isfinite(largest)
        assert before == dict(
            ss.sql(f"SELECT column_name, null FROM (DESCRIBE {history})").fetchall()
        )
        ss.export(tmp_path / "exported")
    rows = f"read_parquet('{tmp_path}/exported/{table}/**/part-*.parquet')"
    for name in NUMBERS[table]:
        kinds = f"count(*) FILTER (isnan({name})), count(*) FILTER ({name} IS NULL)"
        ((nans, nulls),) = duckdb.sql(f"SELECT {kinds} FROM {rows}").fetchall()
        assert nans == 0
        assert nulls > 0


def _counts(table):
    """Returns the numbers of unknown values of columns, in SQL."""
    return ", ".join(f"count(*) FILTER ({name} IS NULL)" for name in NUMBERS[table])


PROGRAMS = (
    "SELECT tick, id FROM lab{} WHERE z(this) > 0.05 AS list;",
    "SELECT tick, id FROM lab{} WHERE NOT z(this) > 0.05 AS list;",
    "SELECT tick, z(this) FROM lab{} ORDER BY z(this) DESC, tick, id AS list;",
    "holds(z(lab.ball) < 1000);",
    "greatest(z(lab.ball));",
    "SELECT tick, id FROM lab{} WHERE above(this, lab.arm) AS list;",
    "SELECT tick, id FROM lab{} WHERE near(this, lab.arm, 1) AS list;",
)


@sampled("record", KINDS, indirect=True, every=2)
def test_selectscript_answers_as_for_null(record, tmp_path):
    """The oracle is the same record with NULL in their place, as ssduck stores them."""
    store_nan(record, "entities")
    other = tmp_path / "null" / record.name
    other.parent.mkdir()
    (shutil.copytree if record.is_dir() else shutil.copy)(record, other)
    _with_null(other)
    with ssduck.open(record) as ss, ssduck.open(other) as expected:
        for program in PROGRAMS:
            assert ss.eval(program) == expected.eval(program), program


def _nan_in_entities(rows):
    return some_nan(rows, NUMBERS["entities"])


def _null_in_entities(rows):
    rows = _nan_in_entities(rows)
    for name in NUMBERS["entities"]:
        rows = with_column(name, pa.array(rows[name].to_numpy(), from_pandas=True))(rows)
    return rows


def _with_null(record):
    """Replaces NaN by NULL in the entities of a record."""
    if record.suffix:
        with duckdb.connect(record) as plain:
            for name in NUMBERS["entities"]:
                value = f"nullif({name}, 'nan')"
                plain.execute(f'UPDATE lab_record_0."entities 0" SET {name} = {value}')
    elif record.name == "unfinished":
        rewrite_log(record, lambda t: t.update(entities=_null_in_entities(t["entities"])))
    else:
        file = part(record, "entities")
        write_parquet(_null_in_entities(pq.ParquetFile(file).read()), file, write_statistics=False)


@sampled("program", PROGRAMS, every=2)
def test_lakes_answer_as_for_null(tmp_path, program):
    records = [write_rising_cups(tmp_path / name / "record", 2, 4) for name in ("nan", "null")]
    for record, change in zip(records, (_nan_in_entities, _null_in_entities), strict=True):
        file = part(record, "entities")
        rows = pq.ParquetFile(file).read()
        about = {k: v for k, v in rows.schema.metadata.items() if k != b"ssduck checksums"}
        write_parquet(change(rows).replace_schema_metadata(about), file, write_statistics=False)
    lake, expected = map(ssduck.lake, records)
    program = program.replace("ball", "pot").replace("arm", "cup")
    found, wanted = (one.ask(program, processes=1).to_pylist() for one in (lake, expected))
    assert [row["error"] for row in found] == [None, None]
    assert [row["answer"] for row in found] == [row["answer"] for row in wanted]
    if "near" not in program:  # no formula
        found, wanted = (
            duckdb.sql(one.sql(program.replace(" AS list", ""))).df().drop(columns="path")
            for one in (lake, expected)
        )
        assert found.equals(wanted)


# Questions about a number that is NaN in some rows, and their filters.
DOORS = ("z > 1e9", "z IS NULL", "z < 1e9", "NOT z > -1e9", "z = 0")


@pytest.mark.parametrize("statistics", [False, True])
def test_all_doors_answer_the_same(tmp_path, statistics):
    """NaN is NULL, whether a footer says of the column what other values it has, or nothing."""
    record = write_rising_cups(tmp_path / "record", 2, 4)
    for file in sorted(record.glob("entities/**/part-*.parquet")):
        rows = pq.ParquetFile(file).read()
        about = {k: v for k, v in rows.schema.metadata.items() if k != b"ssduck checksums"}
        numbers = pa.array(([math.nan, 0.0, 3.0] * len(rows))[: len(rows)])
        rows = with_column("z", numbers)(rows).replace_schema_metadata(about)
        write_parquet(rows, file, write_statistics=statistics)
    expected = [0.0, 3.0, None]
    lake = ssduck.lake(record)
    told = lake.ask("SELECT z(this) FROM lab{} AS list;", processes=1).to_pylist()
    plain = duckdb.sql(lake.sql("SELECT tick, z(this) AS z FROM lab{}")).fetchall()
    assert {value for row in told for value in row["answer"]} == set(expected)
    assert {row[-2] for row in plain} == set(expected)
    for episode in range(2):
        with ssduck.open(record, episode=episode) as ss:
            found = [row for (row,) in ss.sql("SELECT z FROM entities_history").fetchall()]
            assert set(found) == set(expected)
            assert sorted(map(str, found)) == sorted(map(str, told[episode]["answer"]))
            assert ss.sql("SELECT min(z), max(z) FROM entities_history").fetchall() == [(0, 3)]
            for condition in DOORS:
                with duckdb.connect() as oracle:
                    oracle.register("rows", pa.table({"z": pa.array(found, pa.float64())}))
                    count = f"SELECT count(*) FROM {{}} WHERE {condition}"
                    wanted = oracle.sql(count.format("rows")).fetchall()
                assert ss.sql(count.format("entities_history")).fetchall() == wanted, condition


@pytest.mark.parametrize("record", ["folder", "file.duckdb"], indirect=True)
def test_limits_that_are_nan_are_null(record):
    if record.suffix:
        with duckdb.connect(record) as plain:
            plain.execute("UPDATE lab_record_0.\"joints model\" SET upper = 'nan'")
    else:
        without_checksums(record)
        for table in ("joints", "models/joints"):
            file = part(record, table)
            rows = pq.ParquetFile(file).read()
            nan = pa.array(np.full(len(rows), math.nan))
            pq.write_table(with_column("upper", nan)(rows), file)
    with ssduck.open(record) as ss:
        for view in ("joints", "joints_history", "joints_model"):
            ((count, known),) = ss.sql(f"SELECT count(*), count(upper) FROM {view}").fetchall()
            assert count > 0, view
            assert known == 0, view
    assert ssduck.check(record) == []


def test_macros_over_the_files_have_null(small_records, tmp_path):
    record = shutil.copytree(small_records / "folder", tmp_path / "folder")
    store_nan(record, "entities")
    with duckdb.connect() as plain, ssduck.open(record) as ss:
        plain.execute(macro_script((), folder_run(record, None, None)).text)
        question = "SELECT count(*) FILTER (z > 1000), count(z), max(z) FROM {}"
        told = plain.sql(question.format("entities")).fetchall()
        assert told == ss.sql(question.format("entities_history")).fetchall()
