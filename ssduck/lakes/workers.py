"""Answers a question for some episodes: what each process of an engine does.

Episodes of the same group are one record (`ssduck.interpreter.episode_batches`): a manifest says
which are, from the rows of their models, and has the checksums of their files. Whatever fails
there, a changed file as well as a program that has no value, is asked again of the episode by
itself, as `ssduck.open` does: its answer or its error is the result.
"""

from __future__ import annotations

import json
import threading
from collections import OrderedDict
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa

from ssduck.errors import RecordError, SelectScriptError, record_errors
from ssduck.gym.scoring import EpisodeScore
from ssduck.gym.terms import Terms
from ssduck.interpreter.episode_batches import BatchInterpreter, collected_doubts
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.opening import open_record
from ssduck.lakes.manifest import EpisodeEntry
from ssduck.lakes.pool import pools
from ssduck.lakes.questions import Answering, Question, StepsQuestion
from ssduck.lakes.scan import entries_of_records
from ssduck.limits import Limits
from ssduck.recording.paths import expand_path, part_name
from ssduck.recording.spec import Recording
from ssduck.recording.static_tables import run_of
from ssduck.recording.stores.descriptions import camera_of
from ssduck.recording.stores.episode_batch import BatchedEpisode, BatchedFile, DamagedEpisodeError
from ssduck.recording.stores.files import checksum_of
from ssduck.recording.stores.object_store import ObjectPath, is_address
from ssduck.recording.stores.parquet_layout import FolderRun
from ssduck.recording.stores.summaries import StoredFile, size_and_time
from ssduck.schema import MODELS, RECORDABLE

# What reading a damaged file may raise.
UNREADABLE = (SelectScriptError, OSError, pa.ArrowException, KeyError, TypeError, ValueError)
# The number of groups whose models and plans a process keeps.
MAX_READERS = 4


class Answer(NamedTuple):
    """The answer of an episode."""

    text: str | None  # the answer as a text of JSON; None if there is an error
    error: str | None = None  # the error; None if there is an answer
    # the probable mistakes in the question, each once, of which to warn
    doubts: tuple[str, ...] = ()


def _run_of(entry: EpisodeEntry) -> FolderRun:
    return FolderRun(expand_path(entry.path), entry.world, entry.episode)


def _description(run: FolderRun) -> tuple[object, ...]:
    """Returns what the description of an episode has in common with others of its group."""
    return run.world, run.tables, run.recording, run.description.get("camera")


class _Reader:
    """Asks episodes with the models, tables and entities of one of them."""

    def __init__(self, entry: EpisodeEntry, limits: Limits | None) -> None:
        self._run = run = _run_of(entry)
        tables = [table for table in run.tables if table in RECORDABLE]
        models = {table: run.read(f"models/{table}") for table in MODELS}
        self._batch = BatchInterpreter(
            entry.world,
            Recording(**{**run.recording, "tables": tables}),
            run.tables,
            models,
            run_of(models) or 0,
            limits,
            entry.path,
            camera_of(run.description),
        )
        # The files of the episodes whose descriptions were read.
        self._described: dict[tuple[str, str, int], tuple[StoredFile, ...]] = {}
        self._next_tick = 0
        self._answering: tuple[str, Answering] | None = None

    def answers(self, question: Question, entries: Sequence[EpisodeEntry]) -> list[Answer | None]:
        """Returns the answers of episodes; None for those to be asked by themselves."""
        try:
            return self._answers(question, entries)
        finally:
            self._batch.forget()

    def _answers(self, question: Question, entries: Sequence[EpisodeEntry]) -> list[Answer | None]:
        reads_present, key = question.reads_present, question.key
        results: list[Answer | None] = [None] * len(entries)
        for place, index in enumerate(self._load(entries)):
            try:
                with self._batch.episode(place, is_present_read=reads_present) as interpreter:
                    interpreter.strict = question.is_strict
                    if self._answering is None or self._answering[0] != key:
                        self._answering = key, question.answering(interpreter)
                    results[index] = _answer(self._answering[1], interpreter, entries[index])
            except (SelectScriptError, OSError, pa.ArrowException):
                continue
        return results

    def _load(self, entries: Sequence[EpisodeEntry]) -> list[int]:
        """Loads episodes; returns the indices of those whose files are as the manifest says."""
        episodes: dict[int, BatchedEpisode] = {}
        for index, entry in enumerate(entries):
            with suppress(*UNREADABLE):
                episodes[index] = self._read(entry)
        while episodes:
            try:
                self._batch.load(list(episodes.values()))
                break
            except DamagedEpisodeError as error:
                del episodes[list(episodes)[error.index]]
        return list(episodes)

    def _read(self, entry: EpisodeEntry) -> BatchedEpisode:
        """Returns an episode of the group; its ticks come after those of all others."""
        if self._described.get(entry.key) != entry.files:
            run = _run_of(entry)
            if _description(run) != _description(self._run):
                raise RecordError(f"{run.about_file} describes another recording than its group's")
            self._described[entry.key] = entry.files
        files = _parts_of(entry, self._run.tables)
        ticks_of_parts = [
            self._batch.parts.read(file).rows(["tick", "time", "wall_time"])
            for file in files["ticks"]
        ]
        rows = pa.concat_tables(ticks_of_parts)
        ticks = rows["tick"].to_numpy()
        first, last = int(ticks[0]), int(ticks[-1])
        offset = self._next_tick - first
        self._next_tick += last - first + 1
        return BatchedEpisode(offset, rows, files)

    def close(self) -> None:
        self._batch.close()


def _parts_of(entry: EpisodeEntry, tables: Collection[str]) -> dict[str, list[BatchedFile]]:
    """Returns the files of the parts of an episode by table, in order, as its entry has them."""
    place, sums = _resolved(entry.path), dict[str, dict[str, int]]()
    for file in entry.files:
        folder, _, name = file.name.rpartition("/")
        sums.setdefault(folder, {})[name] = file.checksum
    parts = {}
    for table in tables:
        folder = f"{table}/world={entry.world}/episode={entry.episode}"
        own = sums.get(folder, {})
        names = [part_name(number) for number in range(len(own))]
        if not names or sorted(own) != names:
            raise RecordError(f"{entry.path}/{folder} has other files than complete parts")
        parts[table] = [BatchedFile(f"{place}/{folder}/{name}", own[name], table) for name in names]
    return parts


@lru_cache(maxsize=1024)
def _resolved(path: str) -> str:
    """Returns the path of a record without links."""
    place = expand_path(path).resolve()
    return str(place) if isinstance(place, ObjectPath) else place.as_posix()


# By the group, whether its files are objects of a store, and the limits. They answer one question
# at a time: a batch of episodes has one present episode.
_readers: OrderedDict[tuple[str, bool, Limits | None], _Reader] = OrderedDict()
_lock = threading.RLock()


def _reader_of(entry: EpisodeEntry, limits: Limits | None) -> _Reader:
    """Returns the reader of the group of an episode; a process keeps the last ones."""
    assert entry.group is not None
    key = entry.group, is_address(entry.path), limits
    if key not in _readers:
        reader = _Reader(entry, limits)
        while len(_readers) >= MAX_READERS:
            _readers.popitem(last=False)[1].close()
        _readers[key] = reader
    _readers.move_to_end(key)
    return _readers[key]


def answer_episodes(question: Question, entries: Sequence[EpisodeEntry]) -> list[Answer]:
    """Returns the answer or the error of each episode, in order."""
    answers: list[Answer | None] = [None] * len(entries)
    with _lock:
        groups: dict[str, list[int]] = {}
        if question.is_batchable:
            for index, entry in enumerate(entries):
                if entry.group is not None and entry.error is None:
                    groups.setdefault(entry.group, []).append(index)
        for indices in groups.values():
            chosen = [entries[index] for index in indices]
            for index, answer in zip(indices, _answers_of_group(question, chosen), strict=True):
                answers[index] = answer
        return [
            answer_by_itself(question, entry) if answer is None else answer
            for entry, answer in zip(entries, answers, strict=True)
        ]


def _answers_of_group(question: Question, entries: Sequence[EpisodeEntry]) -> list[Answer | None]:
    try:
        reader = _reader_of(entries[0], question.limits)
    except UNREADABLE:  # others of the group may be whole
        return [None] * len(entries)
    return reader.answers(question, entries)


def answer_by_itself(question: Question, entry: EpisodeEntry) -> Answer:
    """Returns the answer or the error of an episode, opened as `ssduck.open` does."""
    if entry.error is not None:
        return Answer(None, entry.error)
    try:
        with record_errors():
            _check_database_file(entry)
            interpreter = open_record(
                entry.path, entry.world, entry.episode, limits=question.limits
            )
        with interpreter:
            interpreter.strict = question.is_strict
            return _answer(question.answering(interpreter), interpreter, entry)
    except SelectScriptError as error:
        return Answer(None, str(error))
    except Exception as error:  # noqa: BLE001  # a damaged file must not end the others' answers
        return Answer(None, f"{type(error).__name__}: {error}")


def _answer(answering: Answering, interpreter: Interpreter, entry: EpisodeEntry) -> Answer:
    """Returns the answer of an episode, with what would be warnings of an interpreter."""
    with collected_doubts(interpreter) as doubts:
        text = json.dumps(answering(interpreter, entry))
    return Answer(text, doubts=tuple(doubts))


def _check_database_file(entry: EpisodeEntry) -> None:
    """Checks the bytes of a DuckDB file that was not written since the manifest was made."""
    record = expand_path(entry.path)
    if isinstance(record, ObjectPath) or not record.is_file():
        return
    status = size_and_time(record)
    for file in entry.files:
        is_same = file.name == record.name and (file.size, file.modified) == status
        if is_same and _checksum(record, *status) != file.checksum:
            raise RecordError(
                f"{record} is damaged: it was not written since the manifest was made, and has "
                "other bytes than then; put a copy of it back"
            )


@lru_cache(maxsize=1024)
def _checksum(file: Path, _size: int, _modified: int) -> int:
    """Returns the checksum of a file; a process reads it once as long as it is not written."""
    return checksum_of(file)


def forget_readers() -> None:
    """Closes what this process keeps of groups of episodes, and the processes that it keeps."""
    pools.close()
    with _lock:
        while _readers:
            _readers.popitem()[1].close()


# -- scores, step by step, for `ssduck.gym.score` ---------------------------------------------

# So many episodes are read at a time.
_PORTION = 64


def step_scores(
    folder: Path, world: str, numbers: Sequence[int], terms: Terms, limits: Limits | None
) -> Iterator[EpisodeScore | None]:
    """Yields the score of each episode; None of one that has to be opened by itself."""
    entries = {one.episode: one for one in entries_of_records([folder], {}) if one.world == world}
    question, left = StepsQuestion(terms, limits), iter(numbers)
    while portion := list(islice(left, _PORTION)):
        known = [entries[number] for number in portion if number in entries]
        answers = zip(known, answer_episodes(question, known), strict=True)
        scores = {entry.episode: answer.text for entry, answer in answers}
        for number in portion:
            text = scores.get(number)
            yield None if text is None else _score_of(json.loads(text))


def _score_of(told: dict[str, object]) -> EpisodeScore:
    """Returns the score that an answer has; series are tuples again."""
    parts = told.pop("parts")
    assert isinstance(parts, dict)
    series = {
        name: tuple(value) if isinstance(value, list) and name != "options" else value
        for name, value in told.items()
    }
    own = {name: tuple(values) for name, values in parts.items()}
    return EpisodeScore(parts=own, **series)  # type: ignore[arg-type]
