"""What the footers of parts say of their values hides no row: it is compared with the values."""

from __future__ import annotations

import math
import re
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import duckdb
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck.errors import RecordError
from ssduck.recording.stores import part_statistics
from ssduck.schema import MODELS
from tests.support.archive import Archive
from tests.support.forged import make_records, part, rewrite, with_column, without_checksums

# A connection that reads footers.
PLAIN = SimpleNamespace(fetchall=lambda sql: duckdb.sql(sql).fetchall())


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, archive: Archive) -> Path:
    """Records as other programs write them: with statistics of all columns."""
    place = tmp_path_factory.mktemp("forged")
    archive.copy(make_records, place)
    shutil.copytree(place / "folder", place / "own")
    without_checksums(place / "folder")
    return place


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made / "folder", tmp_path / "folder"))


def _bytes(value: Any) -> bytes:
    """Returns a value as statistics have it."""
    if isinstance(value, str):
        return bytes([len(value)]) + value.encode()
    return struct.pack("<d" if isinstance(value, float) else "<q", value)


def forge(file: Path, old: bytes, new: bytes) -> None:
    """Replaces bytes in the footer of a part."""
    content = file.read_bytes()
    start = len(content) - int.from_bytes(content[-8:-4], "little") - 8
    assert old in content[start:]
    file.write_bytes(content[:start] + content[start:].replace(old, new))


def written_by_duckdb(file: Path, option: str) -> None:
    """Writes a part anew, as DuckDB writes it."""
    label = pq.read_schema(file).metadata[b"ssduck record"].decode()
    with duckdb.connect() as plain:
        plain.register("rows", pq.ParquetFile(file).read())
        plain.execute(
            f"COPY rows TO '{file}' (FORMAT parquet, {option}, "
            f"KV_METADATA {{'ssduck record': '{label}'}})"
        )


def hidden(file: Path, condition: str) -> int:
    """Returns how many rows DuckDB leaves out by the footer."""
    rows = pq.ParquetFile(file).read()
    with duckdb.connect() as plain:
        plain.register("rows", rows)
        selects = (
            f"SELECT count(*) FROM {place} WHERE {condition}" for place in ("rows", f"'{file}'")
        )
        wanted, found = (plain.sql(select).fetchall()[0][0] for select in selects)
    return int(wanted - found)


def least(values: pa.ChunkedArray) -> Any:
    return pc.min_max(values)["min"].as_py()


def greatest(values: pa.ChunkedArray) -> Any:
    return pc.min_max(values)["max"].as_py()


# (table, column, the bound that is forged): it gets the value of the other bound.
FORGERIES: list[tuple[str, str, Callable[[pa.ChunkedArray], Any]]] = [
    *((table, "tick", greatest) for table in ("entities", "links", "contacts", "ticks")),
    *(("entities", column, greatest) for column in ("z", "time", "id", "name")),
    *(("entities", column, least) for column in ("z", "tick", "kind")),
    ("links", "x", greatest),
    ("ticks", "time", least),
    ("models/entities", "name", greatest),
    ("models/shapes", "entity", least),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "column", "bound"),
    FORGERIES,
    ids=[f"{bound.__name__} {table}.{column}" for table, column, bound in FORGERIES],
)
def test_forged_bounds_are_an_error(
    folder: Path, table: str, column: str, bound: Callable[[pa.ChunkedArray], Any]
) -> None:
    file = part(folder, table)
    values = pq.ParquetFile(file).read()[column]
    old, other = (greatest(values), least(values))[:: 1 if bound is greatest else -1]
    if isinstance(old, str):
        other = other[: len(old)].ljust(len(old), "a")
    forge(file, _bytes(old), _bytes(other))
    assert hidden(file, f"{column} = {old!r}") > 0
    refused(folder, table, column)


def refused(folder: Path, table: str, column: str) -> None:
    """Checks that SQL and a check refuse a column, and that SelectScript answers no less."""
    view = f"{table.removeprefix('models/')}_{'model' if '/' in table else 'history'}"
    # The same bytes may be a bound of another column before it, too.
    words = rf"{part(folder, table)} is damaged: the column '\w+' has other values than"
    with ssduck.open(folder) as ss:
        for _ in range(2):
            with pytest.raises(RecordError, match=words):
                ss.sql(f"SELECT count(*) FROM {view} WHERE {column} IS NOT NULL")
    if "/" not in table:
        assert re.search(words, " ".join(one.problem for one in ssduck.check(folder)))


@pytest.mark.slow
def test_a_forged_number_of_nulls_is_an_error(folder: Path) -> None:
    file = part(folder, "entities")
    rows = pq.ParquetFile(file).read()
    bound, count = _bytes(least(rows["z"])) + b"\x16", bytes([2 * len(rows)])
    forge(file, bound + b"\x00", bound + count)
    assert hidden(file, "z IS NOT NULL") == len(rows)
    refused(folder, "entities", "z")


def test_values_of_lists_are_compared(folder: Path) -> None:
    file = part(folder, "models/geometries")
    forge(file, _bytes(0.1), _bytes(-7.0))
    refused(folder, "models/geometries", "vertices")


def test_pairs_are_found_in_compared_parts(folder: Path) -> None:
    forge(part(folder, "entities"), _bytes(greatest(_ticks(folder))), _bytes(1))
    program = "SELECT tick FROM lab{} WHERE touching(this, lab.arm) AS list;"
    with ssduck.open(folder) as ss, pytest.raises(RecordError, match="has other values than"):
        ss.eval(program)


def _ticks(folder: Path) -> pa.ChunkedArray:
    return pq.ParquetFile(part(folder, "entities")).read()["tick"]


@pytest.mark.slow
def test_nan_beside_statistics_is_unknown(folder: Path) -> None:
    """Statistics leave it out; to plain SQL it is the greatest number, in ssduck's views NULL."""
    file = part(folder, "entities")
    rewrite(file, with_column("vx", lambda v: [float("nan"), *v[1:]]))
    assert hidden(file, "vx > 1e9") == 1
    with ssduck.open(folder) as ss:
        for condition, count in (("vx > 1e9", 0), ("vx IS NULL", 1), ("isnan(vx)", 0)):
            found = ss.sql(f"SELECT count(*) FROM entities_history WHERE {condition}")
            assert found.fetchall() == [(count,)]
    assert ssduck.check(folder) == []


def test_times_that_are_nan_are_an_error_beside_statistics(folder: Path) -> None:
    rewrite(part(folder, "entities"), with_column("time", lambda v: [float("nan"), *v[1:]]))
    with ssduck.open(folder) as ss, pytest.raises(RecordError, match="entities"):
        ss.sql("SELECT count(*) FROM entities_history")


@pytest.mark.slow
def test_bloom_filters_are_refused(folder: Path) -> None:
    file = part(folder, "entities")
    written_by_duckdb(file, "WRITE_BLOOM_FILTER true")
    with duckdb.connect() as plain:
        ((offset, length),) = plain.sql(
            "SELECT bloom_filter_offset, bloom_filter_length "
            f"FROM parquet_metadata('{file}') WHERE path_in_schema = 'id'"
        ).fetchall()
    content = bytearray(file.read_bytes())
    end = offset + length
    content[end - 32 : end] = bytes(32)
    file.write_bytes(content)
    assert hidden(file, "id = 1") > 0
    with (
        ssduck.open(folder) as ss,
        pytest.raises(RecordError, match="has a Bloom filter or a page"),
    ):
        ss.sql("FROM entities_history")


def test_page_indexes_are_refused(folder: Path) -> None:
    file = part(folder, "entities")
    rows = pq.ParquetFile(file).read()
    pq.write_table(rows, file, write_page_index=True)
    with duckdb.connect() as plain:
        ((offset, length),) = plain.sql(
            "SELECT column_index_offset, column_index_length "
            f"FROM parquet_metadata('{file}') WHERE path_in_schema = 'z'"
        ).fetchall()
    content = bytearray(file.read_bytes())
    index = content[offset : offset + length]
    old = _bytes(greatest(rows["z"]))
    assert old in index
    content[offset : offset + length] = index.replace(old, _bytes(-1.0))
    file.write_bytes(content)
    with (
        ssduck.open(folder) as ss,
        pytest.raises(RecordError, match="has a Bloom filter or a page"),
    ):
        ss.sql("FROM entities_history")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["own", "folder"])
def test_true_statistics_are_none(made: Path, kind: str) -> None:
    assert ssduck.check(made / kind) == []
    with ssduck.open(made / kind) as ss:
        for table in MODELS:
            assert ss.sql(f"SELECT count(*) FROM {table}_model").fetchone()[0]


@pytest.mark.slow
@pytest.mark.parametrize("table", ["entities", "models/entities"])
def test_a_folder_may_be_a_link_inside_of_the_record(folder: Path, table: str) -> None:
    episode, place = part(folder, table).parent, folder / "elsewhere" / "episode=1"
    place.parent.mkdir()
    shutil.move(episode, place)
    episode.symlink_to(place)
    with ssduck.open(folder) as ss:
        assert len(ss.sql("SELECT * FROM entities_history"))


def test_a_link_named_as_another_episode_is_compared_with_its_own_values(
    folder: Path, tmp_path: Path
) -> None:
    """Two folders of the same name: one is a link to the other's place."""
    true, forged = (tmp_path / name / "episode=1" / "part-000000.parquet" for name in "ab")
    for place in (true, forged):
        place.parent.mkdir(parents=True)
        shutil.copy(part(folder, "entities"), place)
    values = pq.ParquetFile(true).read()["tick"]
    forge(forged, _bytes(greatest(values)), _bytes(least(values)))
    (tmp_path / "link").symlink_to(forged.parent)
    files = [tmp_path / "link" / forged.name, true]
    for some in (files, files[::-1]):
        with pytest.raises(RecordError, match="'tick' has other values"):
            part_statistics.check_statistics(PLAIN, some, "entities")


@pytest.mark.parametrize("table", ["joints", "models/joints"])
def test_nan_of_a_model_may_be_beside_statistics(folder: Path, table: str) -> None:
    """A joint's greatest effort may be NaN in its URDF."""
    file = part(folder, table)
    rewrite(file, lambda rows: pa.concat_tables([rows, rows]))
    rewrite(
        file, with_column("max_effort", lambda values: [5.0] * (len(values) - 1) + [float("nan")])
    )
    statistics = pq.read_metadata(file).row_group(0).column(_place(file, "max_effort")).statistics
    assert statistics.has_min_max
    part_statistics.check_statistics(PLAIN, [file], table)


def _place(file: Path, column: str) -> int:
    return pq.read_schema(file).names.index(column)


@pytest.mark.slow
def test_other_writers_and_row_groups(folder: Path) -> None:
    """DuckDB writes other statistics, and a part may have any number of row groups."""
    pq.write_table(
        pq.ParquetFile(part(folder, "links")).read(), part(folder, "links"), row_group_size=3
    )
    file = part(folder, "entities")
    written_by_duckdb(file, "WRITE_BLOOM_FILTER false")
    assert ssduck.check(folder) == []
    with ssduck.open(folder) as ss:
        ss.sql("FROM entities_history"), ss.sql("FROM links_history")


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, list[str]]]:
    """The tables and columns that are read to compare them."""
    read: list[tuple[str, list[str]]] = []
    before = part_statistics._read

    def counted(file: Path, group: int, names: list[str]) -> pa.Table:
        read.append((file.parts[-4], sorted(names)))
        return before(file, group, names)

    monkeypatch.setattr(part_statistics, "_read", counted)
    return read


@pytest.mark.slow
def test_own_parts_are_not_read_again(made: Path, read: list[tuple[str, list[str]]]) -> None:
    """They have statistics of ticks and times only, which the check of their rows has read."""
    with ssduck.open(made / "own") as ss:
        for table in ("entities", "links", "contacts"):
            ss.sql(f"FROM {table}_history").fetchall()
        for table in MODELS:
            ss.sql(f"FROM {table}_model").fetchall()
    assert read == []


@pytest.mark.slow
def test_several_row_groups_are_read_each_by_itself(
    folder: Path, read: list[tuple[str, list[str]]]
) -> None:
    """The values of the whole part are not those of one of them."""
    file = part(folder, "contacts")
    rows = pq.ParquetFile(file).read()
    assert len(rows) > 2
    pq.write_table(rows, file, row_group_size=-(-len(rows) // 2), write_statistics=["tick"])
    with ssduck.open(folder) as ss:
        ss.sql("FROM contacts_history")
    assert read == 2 * [("contacts", ["tick"])]
    last, first = greatest(rows["tick"]), least(rows["tick"])
    assert first != last
    forge(file, _bytes(last), _bytes(first))
    refused(folder, "contacts", "tick")


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)


@pytest.mark.parametrize(
    "values",
    [
        [3, 1, 2],
        [0.5, -0.0, 2.5],
        [None, 4.0, None],
        [None, None],
        [float("nan"), 1.0],
        [float("nan"), None],
        [],
        ["b", "a"],
        [True, False],
        [[1.0, 2.0], [-7.0], []],
    ],
    ids=str,
)
def test_found_values(values: list[Any]) -> None:
    """Those of two halves are those of the whole, and as a plain loop finds them."""
    column = pa.chunked_array([pa.array(values, pa.float64() if not values else None)])
    if column.type == pa.null():
        column = column.cast(pa.float64())
    flat = [v for value in values for v in (value if isinstance(value, list) else [value])]
    known = [value for value in flat if value is not None]
    ordered = [value for value in known if not _is_nan(value)]
    bounds = (min(ordered), max(ordered)) if ordered else (None, None)
    found = part_statistics.Values.of(column)
    assert (found.known, found.has_nan) == (len(known), len(ordered) < len(known))
    if not found.has_nan or ordered:
        assert (found.least, found.greatest) == bounds
    halves = [part_statistics.Values.of(half) for half in (column[:1], column[1:])]
    if not found.has_nan:
        assert halves[0] | halves[1] == found
