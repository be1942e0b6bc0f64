"""Rows that SelectScript refuses are refused by SQL, and `ssduck check` finds them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
import pytest

import ssduck
from ssduck.errors import RecordError
from ssduck.recording.replay import checked_rows
from ssduck.recording.stores import parquet_archive
from tests.support.archive import Archive
from tests.support.cases import sampled
from tests.support.forged import make_records, part, rewrite, without_checksums

FIRST = "tick = (SELECT min(tick) FROM rows)"
# (table, what a stranger makes of its rows, words of the problem)
FORGERIES = {
    "rows twice": ("entities", f"FROM rows UNION ALL FROM rows WHERE {FIRST}", "a row is twice"),
    "links twice": ("links", f"FROM rows UNION ALL FROM rows WHERE {FIRST}", "a row is twice"),
    "joints twice": ("joints", f"FROM rows UNION ALL FROM rows WHERE {FIRST}", "a row is twice"),
    "a missing link": (
        "links",
        f"FROM rows WHERE NOT (link = 1 AND {FIRST})",
        "a body lacks some of them",
    ),
    "a body without links": (
        "links",
        "FROM rows WHERE NOT (entity = (SELECT entity FROM rows WHERE link = 1 LIMIT 1) AND "
        f"{FIRST})",
        "are missing at a tick",
    ),
    "no joints at a tick": ("joints", f"FROM rows WHERE NOT {FIRST}", "are missing at a tick"),
    "an unknown entity": (
        "entities",
        f"FROM rows UNION ALL SELECT * REPLACE (999 AS id) FROM rows WHERE {FIRST}",
        "the entity 999 is unknown",
    ),
    "an unknown link": (
        "links",
        f"FROM rows UNION ALL SELECT * REPLACE (77 AS link) FROM rows WHERE {FIRST}",
        "a link is unknown",
    ),
    "a contact of nobody": (
        "contacts",
        "SELECT * REPLACE (CASE WHEN tick = (SELECT max(tick) FROM rows) THEN 999 ELSE a END AS a) "
        "FROM rows",
        "the entity 999 is unknown",
    ),
    "a contact of no link": (
        "contacts",
        "SELECT * REPLACE (77 AS link_a) FROM rows",
        "a link is unknown",
    ),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, archive: Archive) -> Path:
    place = tmp_path_factory.mktemp("forged")
    archive.copy(make_records, place)
    return place


def forged_file(made: Path, to: Path, table: str, select: str) -> Path:
    file = Path(shutil.copy(made / "file.duckdb", to))
    place = f'lab_record_0."{table} 0"'
    with duckdb.connect(file) as plain:
        before = plain.sql(f"FROM {place}").fetchall()
        plain.execute(
            f'CREATE TABLE {place[:-1]}new" AS WITH rows AS (FROM {place}) {select}; '
            f'DELETE FROM {place}; INSERT INTO {place} FROM {place[:-1]}new"; '
            f'DROP TABLE {place[:-1]}new"'
        )
        assert sorted(plain.sql(f"FROM {place}").fetchall(), key=str) != sorted(before, key=str)
    return file


def forged_folder(made: Path, to: Path, table: str, select: str) -> Path:
    folder = Path(shutil.copytree(made / "folder", to / "folder"))

    def forge(rows: pa.Table) -> pa.Table:
        with duckdb.connect() as plain:
            plain.register("rows", rows)
            found = plain.sql(select).to_arrow_table()
        new = found.select(rows.column_names).cast(rows.schema)
        assert new != rows
        return new

    rewrite(part(folder, table), forge)
    without_checksums(folder)
    return folder


@pytest.mark.slow
@sampled("forge", [forged_folder, forged_file], every=2)
@pytest.mark.parametrize("name", FORGERIES)
def test_a_check_finds_them(
    made: Path, tmp_path: Path, name: str, forge: Callable[[Path, Path, str, str], Path]
) -> None:
    table, select, words = FORGERIES[name]
    record = forge(made, tmp_path, table, select)
    found = ssduck.check(record)
    assert [damage.loss for damage in found] == [f"{table} of episode 0 of 'lab'"]
    assert f"of the rows of {table}, " in found[0].problem
    assert words in found[0].problem


@pytest.mark.slow
@sampled("forge", [forged_folder, forged_file], every=2)
@pytest.mark.parametrize("name", FORGERIES)
def test_sql_refuses_them(
    made: Path, tmp_path: Path, name: str, forge: Callable[[Path, Path, str, str], Path]
) -> None:
    table, select, words = FORGERIES[name]
    with ssduck.open(forge(made, tmp_path, table, select)) as ss:
        for _ in range(2):
            with pytest.raises(RecordError, match=f"of the rows of {table}, .*{words}"):
                ss.sql(f"SELECT count(*) FROM {table}_history")


# Columns that a folder repeats for other tools: (table, column, another value)
REPEATED = [
    ("entities", "name", "'another'"),
    ("entities", "kind", "'robot'"),
    ("entities", "parent", "'another'"),
    ("entities", "mass", "mass + 1"),
    ("entities", "run", "run + 1"),
    ("links", "name", "'another'"),
    ("joints", "type", "'another'"),
    ("joints", "upper", "7.5"),
    ("entities", "mass", "'nan'::DOUBLE"),
    ("links", "region", "'sphere'"),
    ("links", "parent", "NULL"),
    ("links", "parent", "coalesce(parent, 0)"),
    ("shapes", "exact", "NOT exact"),
    ("shapes", "margin", "0.25"),
]


@pytest.mark.slow
@sampled(("table", "column", "value"), REPEATED, every=2)
def test_what_rows_repeat_is_that_of_their_model(
    made: Path, tmp_path: Path, table: str, column: str, value: str
) -> None:
    select = (
        f"SELECT * REPLACE (CASE WHEN tick = (SELECT max(tick) FROM rows) THEN {value} "
        f"ELSE {column} END AS {column}) FROM rows"
    )
    record = forged_folder(made, tmp_path, table, select)
    words = f"of the rows of {table}, the column '{column}' has another value than its model"
    assert words in ssduck.check(record)[0].problem
    with ssduck.open(record) as ss, pytest.raises(RecordError, match=words):
        ss.sql(f"SELECT count(*) FROM {table}_history")


@pytest.mark.parametrize(
    ("table", "read"),
    [
        ("contacts", ["contacts"]),
        ("entities", ["entities"]),
        ("joints", ["entities", "joints"]),
        ("links", ["entities", "links"]),
    ],
)
def test_each_part_is_read_once(
    made: Path, table: str, read: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """For the check of a first question, with the rows of bodies where they are compared."""
    files = []
    for name in ("_rows_of_part", "_rows_in"):
        real = getattr(parquet_archive, name)

        def reading(file: Path, *args: Any, real: Any = real) -> Any:
            files.append(file)
            return real(file, *args)

        monkeypatch.setattr(parquet_archive, name, reading)
    with ssduck.open(made / "folder") as ss:
        for _ in range(2):
            ss.sql(f"SELECT count(*) FROM {table}_history")
    assert sorted(files) == [part(made / "folder", name) for name in read]


@pytest.mark.slow
def test_links_that_no_replay_reads(made: Path, tmp_path: Path) -> None:
    """A folder has the links of bodies that have one: SQL reads them, SelectScript does not."""
    select = (
        "WITH one AS (SELECT entity FROM rows GROUP BY entity HAVING max(link) = 0) "
        "FROM rows UNION ALL FROM rows WHERE entity IN (FROM one)"
    )
    (damage,) = ssduck.check(forged_folder(made, tmp_path, "links", select))
    assert "of the rows of links, a row is twice there" in damage.problem


@pytest.mark.slow
@sampled("at_once", [1 << 19, 40, 1], every=3)
@pytest.mark.parametrize("record", ["folder", "file.duckdb", "unfinished"])
def test_the_valid_records_are_intact(
    made: Path, record: str, at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checked_rows, "_ROWS_AT_ONCE", at_once)
    assert ssduck.check(made / record) == []


@pytest.mark.long
def test_rows_are_read_some_ticks_at_a_time(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fault at the last of many steps is found."""
    monkeypatch.setattr(checked_rows, "_ROWS_AT_ONCE", 1)
    select = "FROM rows UNION ALL FROM rows WHERE tick = (SELECT max(tick) FROM rows)"
    (damage,) = ssduck.check(forged_file(made, tmp_path, "joints", select))
    assert "of the rows of joints, a row is twice there" in damage.problem
