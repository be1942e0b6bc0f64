"""Rows that claim a tick or a time that their record does not have are an error at every door."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import duckdb
import pyarrow as pa
import pytest

import ssduck
from ssduck.errors import RecordError
from tests.support.archive import Archive
from tests.support.cases import sampled
from tests.support.forged import make_records, part, rewrite, without_checksums

# What a stranger replaces in a row: the SQL of the new tick and of the new time.
FORGERIES = {
    "a later tick": ("tick + 1000", "time"),
    "a tick before the first": ("-5", "time"),
    "another time": ("tick", "time + 50"),
    "no time": ("tick", "NULL"),
}
TABLES = ("entities", "links", "joints", "contacts")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, archive: Archive) -> Path:
    place = tmp_path_factory.mktemp("forged")
    archive.copy(make_records, place)
    return place


def forged_file(made: Path, to: Path, table: str, tick: str, time: str) -> Path:
    file = Path(shutil.copy(made / "file.duckdb", to))
    with duckdb.connect(file) as plain:
        plain.execute(
            f'UPDATE lab_record_0."{table} 0" SET tick = {tick}, time = {time} '
            f'WHERE tick = (SELECT max(tick) FROM lab_record_0."{table} 0")'
        )
    return file


def forged_folder(made: Path, to: Path, table: str, tick: str, time: str) -> Path:
    folder = shutil.copytree(made / "folder", to / "folder")

    def forge(rows: pa.Table) -> pa.Table:
        with duckdb.connect() as plain:
            plain.register("valid", rows)
            changed = plain.sql(
                "SELECT * REPLACE (CASE WHEN tick = last THEN new_tick ELSE tick END AS tick, "
                "CASE WHEN tick = last THEN new_time ELSE time END AS time) FROM (SELECT *, "
                f"{tick} AS new_tick, {time} AS new_time, max(tick) OVER () AS last FROM valid)"
            ).to_arrow_table()
        return changed.select(rows.column_names).cast(rows.schema)

    rewrite(part(folder, table), forge)
    without_checksums(folder)
    return folder


@pytest.mark.slow
@sampled("forge", [forged_folder, forged_file], every=2)
@pytest.mark.parametrize("name", FORGERIES)
@sampled("table", TABLES, every=2)
def test_a_forged_row_is_an_error(
    made: Path,
    tmp_path: Path,
    table: str,
    name: str,
    forge: Callable[[Path, Path, str, str, str], Path],
) -> None:
    record = forge(made, tmp_path, table, *FORGERIES[name])
    assert [damage.loss for damage in ssduck.check(record)] == [f"{table} of episode 0 of 'lab'"]
    with (
        ssduck.open(record) as ss,
        pytest.raises(RecordError, match=f"of the rows of {table}, one is at the tick"),
    ):
        ss.sql(f"SELECT max(tick) FROM {table}_history").fetchall()
    if table == "entities":
        with ssduck.open(record) as ss, pytest.raises(RecordError):
            ss.eval("max(SELECT z(this) FROM lab{} AS list);")


@pytest.mark.slow
@pytest.mark.parametrize("forge", [forged_file, forged_folder])
@pytest.mark.parametrize("name", FORGERIES)
def test_no_export_drops_it(
    made: Path,
    tmp_path: Path,
    name: str,
    forge: Callable[[Path, Path, str, str, str], Path],
) -> None:
    record = forge(made, tmp_path, "contacts", *FORGERIES[name])
    with (
        ssduck.open(record) as ss,
        pytest.raises(RecordError, match="of the rows of contacts, one is at the tick"),
    ):
        ss.export(tmp_path / "new")
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_the_valid_records_are_none(made: Path) -> None:
    for record in (made / "folder", made / "file.duckdb"):
        assert ssduck.check(record) == []
        with ssduck.open(record) as ss:
            for table in TABLES:
                count, last = ss.sql(f"SELECT count(*), max(tick) FROM {table}_history").fetchone()
                assert count
                assert last <= ss.sql("SELECT max(tick) FROM ticks_history").fetchone()[0]
