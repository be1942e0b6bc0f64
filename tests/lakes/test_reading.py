"""What a lake reads and decodes: each file once a question, and nothing that it still has."""

from collections import Counter
from pathlib import Path

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
from tests.support.forged import with_column
from tests.support.lake_questions import whole_answer_of
from tests.support.rising_cups import write_rising_cups

EPISODES, TICKS, CHANGED = 4, 6, 1
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
    file = record / f"entities/world=lab/episode={CHANGED}/part-000000.parquet"
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
