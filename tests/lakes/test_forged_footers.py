"""Footers of parts that say what is not so: `lake.sql` tells, and `lake.ask` reads the rows."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import duckdb
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck.recording.stores import checksums, part_statistics
from tests.support.rising_cups import write_rising_cups

EPISODES, TICKS, FORGED = 4, 6, 1
PROGRAM = "greatest(z(lab.cup));"
_SUMS = re.compile(rb"(crc32 of data [0-9a-f]{8}, of footer )[0-9a-f]{8}")


def forge(record: Path, table: str) -> None:
    """Says in an episode's footer that its last tick is its first, with right checksums."""
    file = record / f"{table}/world=lab/episode={FORGED}/part-000000.parquet"
    bounds = pc.min_max(pq.ParquetFile(file).read()["tick"])
    first, last = (struct.pack("<q", bounds[name].as_py()) for name in ("min", "max"))
    content = file.read_bytes()
    footer = checksums.footer_in(content)
    assert last in footer
    changed = _SUMS.sub(rb"\g<1>00000000", footer.replace(last, first))
    data = content[: -len(footer)]
    file.write_bytes(data + checksums.with_footer_sums(changed, zlib.crc32(data)))


@pytest.mark.slow
@pytest.mark.parametrize("table", ["entities", "ticks"])
def test_a_statement_tells_of_a_forged_footer(tmp_path: Path, table: str) -> None:
    record = write_rising_cups(tmp_path / "r", EPISODES, TICKS)
    right = ssduck.lake(record).ask(PROGRAM, processes=1)
    forge(record, table)
    lake = ssduck.lake(record)
    assert lake.ask(PROGRAM, processes=1) == right
    found = duckdb.sql(f"SELECT answer, error FROM ({lake.sql(PROGRAM)}) ORDER BY episode")
    rows = found.fetchall()
    errors = [error for _, error in rows]
    assert [n for n, error in enumerate(errors) if error is not None] == [FORGED]
    assert "the column 'tick' has other values than the statistics" in str(errors[FORGED])
    wanted = right["answer"].to_pylist()
    answers = [list(answer.values()) for answer, _ in rows if answer is not None]
    assert answers == [one for n, one in enumerate(wanted) if n != FORGED]


@pytest.mark.slow
def test_the_footers_of_a_record_are_read_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[int] = []
    before = part_statistics._select

    def counted(files: list[Path]) -> str:
        read.append(len(files))
        return before(files)

    monkeypatch.setattr(part_statistics, "_select", counted)
    lake = ssduck.lake(write_rising_cups(tmp_path / "r", EPISODES, TICKS))
    read.clear()
    lake.sql(PROGRAM)
    assert [count for count in read if count > 1] == [EPISODES] * 2
