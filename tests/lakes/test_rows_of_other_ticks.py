"""Rows that claim a tick of another episode, or of none, are one row with an error.

The episodes of a batch are asked together, their ticks moved behind one another: such a row must
change the answer of no episode.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck.lakes import workers
from ssduck.lakes.questions import ProgramQuestion
from ssduck.recording.stores.batched_parts import ReadPart
from ssduck.recording.stores.checksums import write_parquet
from tests.support.cases import sampled
from tests.support.forged import with_column
from tests.support.rising_cups import write_rising_cups

EPISODES, TICKS, FORGED = 4, 6, 1
# The tick and the time that the last row gets instead of its own.
FORGERIES = {
    "of the next episode": (2 * TICKS, 0.5),
    "of the episode before": (0, 0.5),
    "of none": (TICKS + 1000, 0.5),
    "of none before": (-1000, 0.5),
    "of another time": (TICKS, 50.5),
}
# Programs that are asked as SQL over all episodes at once, and one that reads rows in Python.
PROGRAMS = (
    "greatest(z(lab.cup));",
    "changes(z(lab.cup) > 2.25);",
    "[holds(z(lab.cup) < 50)];",
    "max(SELECT z FROM lab{} AS list);",
    "least(clearance(lab.cup, lab.pot));",
)


def forge(record: Path, tick: int, time: float) -> None:
    """Moves the cup's last row of an episode to another tick, far up, with right checksums."""

    def moved(rows: pa.Table) -> pa.Table:
        last = rows.num_rows - 2
        for name, value in (("tick", tick), ("time", time), ("z", 99.0)):
            values = rows[name].to_pylist()
            rows = with_column(name, [*values[:last], value, *values[last + 1 :]])(rows)
        return rows

    rewrite_rows(record, moved)


def rewrite_rows(record: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    """Changes the rows of an episode's entities, with right checksums."""
    file = record / f"entities/world=lab/episode={FORGED}/part-000000.parquet"
    rows = change(pq.ParquetFile(file).read())
    about = {k: v for k, v in rows.schema.metadata.items() if k != b"ssduck checksums"}
    write_parquet(rows.replace_schema_metadata(about), file)


def twice(rows: pa.Table) -> pa.Table:
    return pa.concat_tables([rows, rows.slice(rows.num_rows - 2)]).combine_chunks()


def of_unknown(rows: pa.Table) -> pa.Table:
    return with_column("id", lambda ids: [*ids[:-1], 999])(rows)


def without_value(rows: pa.Table) -> pa.Table:
    return with_column("visible", lambda values: [*values[:-1], None])(rows)


def answers_of(record: Path, program: str) -> list[workers.Answer]:
    workers.forget_readers()
    return workers.answer_episodes(ProgramQuestion(program, None), ssduck.lake(record).entries)


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Returns the numbers of the episodes that are asked by themselves, as they are."""
    asked: list[int] = []
    answer = workers.answer_by_itself

    def counted(question, entry):
        asked.append(entry.episode)
        return answer(question, entry)

    monkeypatch.setattr(workers, "answer_by_itself", counted)
    return asked


@pytest.mark.slow
@sampled("forgery", FORGERIES, every=3)
def test_a_row_of_another_tick_changes_no_answer(
    tmp_path: Path, forgery: str, alone: list[int]
) -> None:
    record = write_rising_cups(tmp_path / "r", EPISODES, TICKS)
    right = {program: answers_of(record, program) for program in PROGRAMS}
    assert alone == []
    assert all(one.error is None for answers in right.values() for one in answers)
    forge(record, *FORGERIES[forgery])
    for program in PROGRAMS:
        found = answers_of(record, program)
        assert [n for n, one in enumerate(found) if one.error is not None] == [FORGED]
        assert [a for n, a in enumerate(found) if n != FORGED] == [
            a for n, a in enumerate(right[program]) if n != FORGED
        ]
    assert set(alone) == {FORGED}  # the others are asked together


@pytest.mark.slow
@sampled(
    ("change", "words"),
    [
        (twice, "a row is twice there"),
        (of_unknown, "the entity 999 is unknown"),
        (without_value, "the column 'visible' lacks a value"),
    ],
    every=3,
)
def test_wrong_rows_are_an_error_of_their_episode(
    tmp_path: Path, change: Callable[[pa.Table], pa.Table], words: str
) -> None:
    record = write_rising_cups(tmp_path / "r", EPISODES, TICKS)
    rewrite_rows(record, change)
    for program in PROGRAMS:
        errors = [one.error for one in answers_of(record, program)]
        assert [n for n, error in enumerate(errors) if error is not None] == [FORGED]
        assert words in str(errors[FORGED])
    statement = ssduck.lake(record).sql("greatest(z(lab.cup));")
    found = duckdb.sql(f"SELECT episode, answer, error FROM ({statement}) ORDER BY episode")
    answers = found.fetchall()
    assert [answer is None for _, answer, _ in answers] == [n == FORGED for n in range(EPISODES)]
    assert words in answers[FORGED][2]


@pytest.mark.slow
def test_rows_are_checked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checked: list[str] = []

    require = ReadPart.require

    def counted(self, problem):
        checked.append(self.file.table)
        require(self, problem)

    monkeypatch.setattr(ReadPart, "require", counted)
    record = write_rising_cups(tmp_path / "r", EPISODES, TICKS)
    answers_of(record, PROGRAMS[0])
    assert checked.count("entities") == EPISODES
    for program in PROGRAMS:
        workers.answer_episodes(ProgramQuestion(program, None), ssduck.lake(record).entries)
    assert checked.count("entities") == EPISODES
    forge(record, *FORGERIES["of none"])  # the manifest is made anew
    workers.answer_episodes(ProgramQuestion(PROGRAMS[0], None), ssduck.lake(record).entries)
    assert checked.count("entities") == EPISODES + 1
