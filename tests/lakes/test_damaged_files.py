"""A file whose bytes change under a lake gives the right answer or the error of its episode.

The size and the time of the file stay, as when a disk loses a bit: only its checksum tells.
"""

import os
import shutil
from pathlib import Path

import duckdb
import pytest

import ssduck
from ssduck.lakes.workers import forget_readers
from tests.support.cases import sampled
from tests.support.rising_cups import write_rising_cups

EPISODES, TICKS, DAMAGED = 4, 6, 1
PROGRAMS = (
    "greatest(z(lab.cup));",
    "max(SELECT z FROM lab{} AS list);",
    "least(clearance(lab.cup, lab.pot));",
    "count(SELECT id FROM lab AS list);",
)
PARTS = ("ticks", "entities", "frames", "models/entities", "models/shapes", "models/geometries")
ALWAYS_READ = ("ticks", "entities")


def file_of(record, table, number=DAMAGED):
    return record / f"{table}/world=lab/episode={number}/part-000000.parquet"


def change(file, place):
    """Flips a bit at a part of the length of a file, which keeps its time."""
    status, content = file.stat(), bytearray(file.read_bytes())
    content[int(place * len(content))] ^= 4
    file.write_bytes(content)
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return write_rising_cups(tmp_path_factory.mktemp("lake") / "r", EPISODES, TICKS)


@pytest.fixture
def record(made, tmp_path):
    """A record that its lake knows."""
    place = Path(shutil.copytree(made, tmp_path / "r"))
    assert not any(ssduck.lake(place).episodes["error"].to_pylist())
    forget_readers()
    return place


def answers(record, program):
    rows = ssduck.lake(record).ask(program, processes=1).to_pylist()
    return [
        ({k: v for k, v in row.items() if k not in ("error", "path")}, row["error"]) for row in rows
    ]


@pytest.mark.slow
@sampled("table", PARTS, every=3)
def test_a_flipped_bit_gives_the_right_answer_or_an_error(record, table):
    right = {program: answers(record, program) for program in PROGRAMS}
    whole = file_of(record, table).read_bytes()
    for place in (0.1, 0.5, 0.95):
        file_of(record, table).write_bytes(whole)
        change(file_of(record, table), place)
        forget_readers()
        for program in PROGRAMS:
            for number, (found, wanted) in enumerate(
                zip(answers(record, program), right[program], strict=True)
            ):
                if found[1] is None or number != DAMAGED:
                    assert found == wanted
                else:
                    assert file_of(record, table).name in str(found[1])
            is_error = answers(record, program)[DAMAGED][1] is not None
            assert is_error or table not in ALWAYS_READ


@pytest.mark.slow
@sampled("number", [0, DAMAGED], every=2)
@sampled("table", PARTS[3:], every=3)
def test_a_statement_has_the_error_of_its_episode(record, table, number):
    """A model is damaged: of the first of its group, of which it is planned, or of another."""
    program = PROGRAMS[0]
    right = duckdb.sql(f"SELECT answer FROM ({ssduck.lake(record).sql(program)})").fetchall()
    change(file_of(record, table, number), 0.5)
    found = duckdb.sql(f"SELECT answer, error FROM ({ssduck.lake(record).sql(program)})").fetchall()
    assert [n for n, (_, error) in enumerate(found) if error is not None] == [number]
    assert "checksum is wrong" in found[number][1]
    assert [a for n, (a, _) in enumerate(found) if n != number] == [
        a for n, (a,) in enumerate(right) if n != number
    ]
