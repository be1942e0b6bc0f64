"""What a lake reads and decodes: each file once a question; a file whose bytes change gives an error."""

import os
from collections import Counter
from pathlib import Path

import duckdb
import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck.lakes import workers
from ssduck.lakes.questions import ProgramQuestion
from ssduck.recording.stores import episode_batch
from ssduck.recording.stores.episode_batch import BatchedFile
from ssduck.recording.stores.files import write_parquet
from ssduck.recording.stores.parquet import _options as options
from tests.support.cases import sampled
from tests.support.forged import flip_bit, with_column
from tests.support.lake_questions import whole_answer_of
from tests.support.rising_cups import write_rising_cups

EPISODES, TICKS, CHANGED = 4, 6, 1  # the last is the number of an episode
# Programs that SQL answers for all episodes at once, for each by itself, and from rows in Python.
PROGRAMS = (
    "holds(z(lab.cup) > 2.25);",
    "greatest(z(lab.cup) + x(lab.pot));",
    "SELECT id, z FROM lab WHERE z(this) > 1;",
    "count(SELECT id FROM lab{} WHERE z(this) > 2.25 AS list);",
    "changes(near(lab.cup, lab.pot, 4.8));",
    "least(clearance(lab.cup, lab.pot));",
)


@pytest.fixture
def record(tmp_path, archive):
    place = archive.copy(write_rising_cups, tmp_path / "r", EPISODES, TICKS)
    workers.forget_readers()
    return place


def asked(record, program):
    return workers.answer_episodes(ProgramQuestion(program, None), ssduck.lake(record).entries)


def by_themselves(record, program):
    answers = []
    for episode in range(EPISODES):
        with ssduck.open(record, "lab", episode) as ss:
            answers.append(whole_answer_of(ss, program))
    return answers


@pytest.fixture
def together(monkeypatch):
    """Lets no episode be asked by itself."""
    monkeypatch.setattr(workers, "answer_by_itself", None)


@pytest.fixture
def read(monkeypatch):
    """Counts how often each file is read, by its table and its episode."""
    counts = Counter()
    content = BatchedFile.content

    def counted(file):
        counts[f"{file.table} {Path(file.path).parent.name[-1]}"] += 1
        return content(file)

    monkeypatch.setattr(BatchedFile, "content", counted)
    return counts


@pytest.mark.slow
@pytest.mark.usefixtures("together")
@sampled("program", PROGRAMS, every=2)
def test_episodes_that_are_known_are_asked_with_others(record, program):
    """Those that the process knows are checked less; each has its own answer."""
    entries = ssduck.lake(record).entries
    expected = by_themselves(record, program)
    workers.answer_episodes(ProgramQuestion(program, None), entries[2:])
    assert asked(record, program) == expected


def changed(record, name, value):
    """Changes a value of the last row of the cup in an episode, with right checksums."""
    file = file_of(record, "entities")
    rows = pq.ParquetFile(file).read()
    last = rows.num_rows - 2
    values = rows[name].to_pylist()
    rows = with_column(name, [*values[:last], value, *values[last + 1 :]])(rows)
    about = {k: v for k, v in rows.schema.metadata.items() if k != b"ssduck checksums"}
    rows = rows.replace_schema_metadata(about)
    write_parquet(rows, file, **options(rows))


@pytest.mark.slow
@pytest.mark.usefixtures("together")
@sampled("value", [99.0, float("nan")], every=2)
def test_a_file_that_changed_is_decoded_anew(record, value):
    programs = PROGRAMS[:4]
    before = [asked(record, program) for program in programs]
    changed(record, "z", value)
    for program, answers in zip(programs, before, strict=True):
        found = asked(record, program)
        assert found == by_themselves(record, program)
        assert [a for n, a in enumerate(found) if n != CHANGED] == [
            a for n, a in enumerate(answers) if n != CHANGED
        ]
    assert asked(record, PROGRAMS[1]) != before[1]


@pytest.mark.slow
@pytest.mark.usefixtures("together")
@sampled("program", PROGRAMS, every=3)
def test_parts_that_are_too_large_to_be_kept_give_the_same_answers(
    record, monkeypatch, read, program
):
    monkeypatch.setattr(episode_batch, "MOST_READ", 0)
    assert asked(record, program) == by_themselves(record, program)
    assert max(read.values()) > 1  # they are read again and again


# -- bits that flip: the size and the time of the file stay, and only its checksum tells ----------

DAMAGED_PROGRAMS = (
    "greatest(z(lab.cup));",
    "max(SELECT z FROM lab{} AS list);",
    "least(clearance(lab.cup, lab.pot));",
    "count(SELECT id FROM lab AS list);",
)
PARTS = ("ticks", "entities", "frames", "models/entities", "models/shapes", "models/geometries")
ALWAYS_READ = ("ticks", "entities")


def file_of(record, table, number=CHANGED):
    return record / f"{table}/world=lab/episode={number}/part-000000.parquet"


def flip(file, place):
    """Flips a bit at a part of the length of a file, which keeps its time."""
    status = file.stat()
    flip_bit(file, place)
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))


def answers(record, program):
    rows = ssduck.lake(record).ask(program, processes=1).to_pylist()
    return [
        ({k: v for k, v in row.items() if k not in ("error", "path")}, row["error"]) for row in rows
    ]


@pytest.mark.slow
@sampled("table", PARTS, every=3)
def test_a_flipped_bit_gives_the_right_answer_or_an_error(record, table):
    right = {program: answers(record, program) for program in DAMAGED_PROGRAMS}
    whole = file_of(record, table).read_bytes()
    for place in (0.1, 0.5, 0.95):
        file_of(record, table).write_bytes(whole)
        flip(file_of(record, table), place)
        workers.forget_readers()
        for program in DAMAGED_PROGRAMS:
            for number, (found, wanted) in enumerate(
                zip(answers(record, program), right[program], strict=True)
            ):
                if found[1] is None or number != CHANGED:
                    assert found == wanted
                else:
                    assert file_of(record, table).name in str(found[1])
            is_error = answers(record, program)[CHANGED][1] is not None
            assert is_error or table not in ALWAYS_READ


@pytest.mark.slow
@sampled("number", [0, CHANGED], every=2)
@sampled("table", PARTS[3:], every=3)
def test_a_statement_has_the_error_of_its_episode(record, table, number):
    """A model is damaged: of the first of its group, of which it is planned, or of another."""
    program = DAMAGED_PROGRAMS[0]
    right = duckdb.sql(f"SELECT answer FROM ({ssduck.lake(record).sql(program)})").fetchall()
    flip(file_of(record, table, number), 0.5)
    found = duckdb.sql(f"SELECT answer, error FROM ({ssduck.lake(record).sql(program)})").fetchall()
    assert [n for n, (_, error) in enumerate(found) if error is not None] == [number]
    assert "checksum is wrong" in found[number][1]
    assert [a for n, (a, _) in enumerate(found) if n != number] == [
        a for n, (a,) in enumerate(right) if n != number
    ]
