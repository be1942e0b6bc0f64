"""Makes tables of answers, and keeps the answers of finished batches to go on later."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import pyarrow as pa

from ssduck.errors import ProgramWarning, warn
from ssduck.formatting import count_of
from ssduck.lakes.manifest import EpisodeEntry
from ssduck.lakes.questions import Question
from ssduck.lakes.workers import Answer
from ssduck.recording.stores.files import verified_parquet, write_parquet

KEYS = ("world", "episode", "path")
ERROR = "error"
_DOUBTS = "doubts"


@dataclass(frozen=True)
class AnsweredEpisode:
    """The answer of an episode."""

    entry: EpisodeEntry  # the episode
    text: str | None  # the answer as a text of JSON; None if there is an error
    error: str | None  # the error; None if there is an answer
    doubts: tuple[str, ...] = ()  # the probable mistakes in the question

    @property
    def value(self) -> Any:
        """The answer."""
        return None if self.text is None else json.loads(self.text)


def answer_table(answered: Iterable[AnsweredEpisode]) -> pa.Table:
    """Returns the answers as a table, with a row for each episode, in their order.

    Its columns are `world`, `episode`, `path`, `answer` and `error`. If all answers are records, or
    lists of such, the columns of these are there in place of `answer`, and each record is a row.
    Answers that have no common type in Arrow are texts of JSON.
    """
    rows = list(answered)
    values = [row.value for row in rows]
    known = [value for row, value in zip(rows, values, strict=True) if row.error is None]
    if known and all(map(_are_records, known)) and any(known):
        return _table_of_records(rows, values)
    columns = _key_columns([row.entry for row in rows])
    columns["answer"] = _array(values)
    columns[ERROR] = pa.array([row.error for row in rows], pa.string())
    return pa.table(columns)


def whole_table(answered: Iterable[AnsweredEpisode]) -> pa.Table:
    """Returns the answers as `answer_table` does, and warns if no episode has one."""
    table = answer_table(answered)
    errors = table[ERROR]
    if table.num_rows and not errors.null_count:
        episodes = count_of(table.num_rows, "episode")
        told = f"no answer: {episodes} failed, as the column {ERROR!r} says: {errors[0]}"
        warn(told, ProgramWarning)
    return table


def tables(answered: Iterator[AnsweredEpisode], size: int) -> Iterator[pa.Table]:
    """Yields tables of so many answers each; of fewer at the end."""
    while pending := list(islice(answered, size)):
        yield answer_table(pending)


def _are_records(value: Any) -> bool:
    if isinstance(value, dict):
        return True
    return isinstance(value, list) and all(isinstance(one, dict) for one in value)


def _table_of_records(rows: Sequence[AnsweredEpisode], values: Sequence[Any]) -> pa.Table:
    records: list[tuple[AnsweredEpisode, dict[str, Any]]] = []
    for row, value in zip(rows, values, strict=True):
        listed = [{}] if row.error is not None else [value] if isinstance(value, dict) else value
        records += [(row, record) for record in listed]
    names = list(dict.fromkeys(name for _, record in records for name in record))
    columns = _key_columns([row.entry for row, _ in records])
    for name in names:
        column = name
        while column in columns or column == ERROR:
            column += "_"
        columns[column] = _array([record.get(name) for _, record in records])
    columns[ERROR] = pa.array([row.error for row, _ in records], pa.string())
    return pa.table(columns)


def _key_columns(entries: Sequence[EpisodeEntry]) -> dict[str, pa.Array]:
    return {
        "world": pa.array([entry.world for entry in entries], pa.string()),
        "episode": pa.array([entry.episode for entry in entries], pa.int64()),
        "path": pa.array([entry.path for entry in entries], pa.string()),
    }


def _array(values: Sequence[Any]) -> pa.Array:
    """Returns values of one type as an array, and other values as texts of JSON."""
    try:
        array = pa.array(values)
    except (pa.ArrowException, OverflowError):
        array = None
    if array is not None and _are_same(array.to_pylist(), list(values)):
        return array
    return pa.array([None if value is None else json.dumps(value) for value in values], pa.string())


def _are_same(found: Any, value: Any) -> bool:
    """Checks whether Arrow has a value as it is: 1 may be 1.0, but True is not, and NaN is NaN."""
    match value:
        case list():
            return len(found) == len(value) and all(map(_are_same, found, value))
        case dict():
            is_same = found.keys() == value.keys()
            return is_same and all(_are_same(found[key], value[key]) for key in value)
        case bool():
            return found is value
        case float() if math.isnan(value):
            return math.isnan(found)
    return bool(found == value)


class KeptAnswers:
    """The answers of episodes in finished batches, in a folder with a file for each batch."""

    def __init__(self, folder: Path | None, question: Question) -> None:
        self._folder = folder
        self._question = hashlib.sha256(question.key.encode()).hexdigest()[:16]
        # By what tells an episode from others: whatever batch it was in, it has its answer.
        self._answers: dict[str, Answer] = {}
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            for file in folder.iterdir():
                if file.name.startswith(f"answers-{self._question}-"):
                    self._answers |= _kept_in(file)

    def read(self, entry: EpisodeEntry) -> Answer | None:
        """Returns the kept answer of an episode; None if there is none."""
        return self._answers.get(_identity(entry)) if self._answers else None

    def write(self, entries: Sequence[EpisodeEntry], answers: Sequence[Answer]) -> None:
        """Keeps the answers of a batch."""
        if self._folder is None:
            return
        identities = [_identity(entry) for entry in entries]
        name = hashlib.sha256("".join(identities).encode()).hexdigest()[:32]
        texts, errors, doubts = zip(*answers, strict=True)
        columns = {"episode": identities, "answer": texts, ERROR: errors}
        rows = pa.table({name: pa.array(values, pa.string()) for name, values in columns.items()})
        rows = rows.append_column(_DOUBTS, pa.array(doubts, pa.list_(pa.string())))
        file = self._folder / f"answers-{self._question}-{name}.parquet"
        write_parquet(rows, file, compression="zstd")


def _identity(entry: EpisodeEntry) -> str:
    """Returns what tells an episode, as its files are, from others."""
    # A DuckDB file is known by the ids of its episodes. No answer depends on tags.
    return hashlib.sha256(repr(replace(entry, tags={})).encode()).hexdigest()


def _kept_in(file: Path) -> dict[str, Answer]:
    """Returns the answers in a file; none if it is damaged."""
    try:
        rows = verified_parquet(file, has_checksums=True).read()
        answers = (rows[name].to_pylist() for name in ("episode", "answer", ERROR, _DOUBTS))
        return {
            episode: Answer(text, error, tuple(doubts))
            for episode, text, error, doubts in zip(*answers, strict=True)
        }
    except (OSError, pa.ArrowException, KeyError):  # a RecordError is an OSError
        return {}
