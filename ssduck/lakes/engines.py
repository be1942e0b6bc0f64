"""The engines that answer the batches of a question: processes of this machine, Ray, Spark.

Each runs `ssduck.lakes.workers.answer_episodes` on batches of episodes. What is lost with a killed
process is Ray's or Spark's to compute again; the pool of this machine ends with an error, and the
answers that were kept are there when the question is asked again.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory, mkstemp
from typing import Any, Literal, TypeAlias

import pyarrow as pa

from ssduck import validation
from ssduck.errors import ArgumentError, EvaluationError, UnsupportedError
from ssduck.lakes.manifest import EpisodeEntry
from ssduck.lakes.pool import end_at_once, pools
from ssduck.lakes.questions import Question
from ssduck.lakes.workers import Answer, answer_episodes

EngineName: TypeAlias = Literal["local", "ray", "spark"]
Batch: TypeAlias = Sequence[EpisodeEntry]
# Yields the index of each batch with its answers, in any order.
Answers: TypeAlias = Iterator[tuple[int, list[Answer]]]
Answerer: TypeAlias = Callable[[Question, Sequence[Batch]], Answers]
# How often Ray, or Spark on this machine, starts a task again whose process was killed.
RETRIES = 3
_RAY_HINT = "engine='ray' needs Ray: pip install 'ssduck[ray]'"
_SPARK_HINT = "engine='spark' needs PySpark and Java 17 or newer: pip install 'ssduck[spark]'"
# The columns of the batches for Spark, and of its results, as pickles.
_PARTS, _RESULTS = "batch int, task binary", "batch int, answers binary"


@dataclass(frozen=True)
class How:
    """How episodes are asked; see `Lake.ask`."""

    engine: EngineName = "local"
    processes: int | None = None
    batch: int | None = None
    resume: str | Path | None = None
    progress: bool = True
    options: Mapping[str, Any] | None = None
    session: Any = None


def how_of(method: str, engine: EngineName, arguments: Mapping[str, Any]) -> How:
    """Returns how episodes are asked by a method that takes further arguments of `ask`."""
    known = [field.name for field in fields(How)]
    others = {name: value for name, value in arguments.items() if name not in known}
    validation.no_others(others, method, known, {})
    return How(engine, **arguments)


def answer_locally(question: Question, batches: Sequence[Batch], processes: int) -> Answers:
    """Answers batches in this process, or in several processes of this machine.

    The processes are kept for the next question. If one that was kept is killed, new processes
    answer the rest.
    """
    rest = dict(enumerate(batches))
    if processes == 1:
        for index, batch in rest.items():
            yield index, answer_episodes(question, batch)
        return
    is_first = True
    while rest:
        pool, is_kept = pools.take(processes)
        try:
            for index, answers in _answers_of_pool(pool, question, dict(rest), processes):
                del rest[index]
                yield index, answers
        except BrokenProcessPool as error:
            if not is_kept or not is_first:
                raise EvaluationError(
                    "a process was killed, by the system for lack of memory, say; what was "
                    "answered is kept if `resume` names a folder: ask again to go on, with fewer "
                    "processes or smaller batches. Each process imports the file that asks: there, "
                    'the call belongs below `if __name__ == "__main__":`'
                ) from error
            is_first = False


def _answers_of_pool(
    pool: ProcessPoolExecutor, question: Question, batches: Mapping[int, Batch], processes: int
) -> Answers:
    """Yields the answers of processes, which are kept unless some are still at work."""
    pending: deque[tuple[int, Future[Path]]] = deque()
    waiting = iter(batches.items())
    unanswered = len(batches)
    with TemporaryDirectory(prefix="ssduck") as folder:
        try:
            while unanswered:
                # The answers of a few batches wait, and not those of all.
                for index, batch in waiting:
                    task = pool.submit(_write_answers, question, batch, Path(folder))
                    pending.append((index, task))
                    if len(pending) > 2 * processes:
                        break
                index, future = pending.popleft()
                answers = _read_answers(future.result())
                unanswered -= 1
                yield index, answers
        finally:
            if unanswered:
                end_at_once(pool)
            else:
                pools.keep(pool, processes)


def _write_answers(question: Question, batch: Batch, folder: Path) -> Path:
    """Answers a batch; returns the file of the answers: a killed process leaves no half of one."""
    content = pickle.dumps(answer_episodes(question, batch))
    try:
        handle, name = mkstemp(dir=folder)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
    except OSError as error:
        raise EvaluationError(
            f"answers of {len(content):,} bytes cannot be kept in {folder}: {error.strerror}; "
            "TMPDIR names another place"
        ) from error
    return Path(name)


def _read_answers(file: Path) -> list[Answer]:
    """Returns the answers that a process of this machine wrote."""
    content = file.read_bytes()
    file.unlink()
    answers: list[Answer] = pickle.loads(content)  # noqa: S301  # of our own process
    return answers


def answer_on_ray(
    question: Question, batches: Sequence[Batch], options: Mapping[str, Any] | None
) -> Answers:
    """Answers batches as tasks of Ray, which starts those again whose process was killed."""
    try:
        import ray
    except ImportError as error:
        raise UnsupportedError(_RAY_HINT) from error
    if not ray.is_initialized():
        local = {
            "include_dashboard": False,
            "_node_ip_address": "127.0.0.1",
            "log_to_driver": False,
        }
        ray.init(**(local if options is None else options))
    task = ray.remote(max_retries=RETRIES)(answer_episodes)
    shared = ray.put(question)
    references = {task.remote(shared, batch): index for index, batch in enumerate(batches)}
    while references:
        (done,), _ = ray.wait(list(references), num_returns=1)
        yield references.pop(done), ray.get(done)


def answer_on_spark(question: Question, batches: Sequence[Batch], session: Any) -> Answers:
    """Answers batches as a job of Spark: `mapInArrow` over the batches, one a partition."""
    try:
        from pyspark.sql import SparkSession
    except ImportError as error:
        raise UnsupportedError(_SPARK_HINT) from error
    if session is None:
        # The workers of this machine have ssduck in the same Python.
        os.environ.setdefault("PYSPARK_PYTHON", sys.executable)
        # Without the second number, a task that fails once would end the job.
        builder = SparkSession.builder.master(f"local[*,{RETRIES + 1}]").appName("ssduck")
        settings = {
            "spark.ui.enabled": "false",
            "spark.driver.host": "127.0.0.1",
            "spark.driver.bindAddress": "127.0.0.1",
            "spark.ui.showConsoleProgress": "false",
        }
        for name, value in settings.items():
            builder = builder.config(name, value)
        session = builder.getOrCreate()
    rows = [(index, pickle.dumps((question, batch))) for index, batch in enumerate(batches)]
    parts = session.createDataFrame(rows, _PARTS).repartition(len(batches), "batch")
    for row in parts.mapInArrow(_answer_parts, _RESULTS).collect():
        yield row["batch"], pickle.loads(row["answers"])  # noqa: S301  # `_answer_parts` made it


def _answer_parts(parts: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
    """Answers the batches of a partition: the function that `mapInArrow` runs."""
    for part in parts:
        for row in part.to_pylist():
            question, entries = pickle.loads(row["task"])  # noqa: S301  # the driver made it
            answers = pickle.dumps(answer_episodes(question, entries))
            columns = pa.array([row["batch"]], pa.int32()), pa.array([answers], pa.binary())
            yield pa.RecordBatch.from_arrays(columns, names=["batch", "answers"])


def engine_of(
    name: str, processes: int | None, options: Mapping[str, Any] | None, session: Any
) -> Answerer:
    """Returns the function of an engine that answers batches."""
    match name:
        case "local":
            count = processes or 1
            return lambda question, batches: answer_locally(
                question, batches, max(1, min(count, len(batches)))
            )
        case "ray":
            return lambda question, batches: answer_on_ray(question, batches, options)
        case "spark":
            return lambda question, batches: answer_on_spark(question, batches, session)
    raise ArgumentError(f"there is no engine {name!r}; engines are 'local', 'ray' and 'spark'")
