"""A lake: all records below a path, which answer one question together (`Lake`)."""

from __future__ import annotations

import glob
import math
import os
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa
from sqlglot import exp

from ssduck import validation
from ssduck.database.database import Database
from ssduck.errors import (
    ArgumentError,
    ProgramWarning,
    RecordError,
    SqlError,
    record_errors,
    warn,
)
from ssduck.gym.terms import Reward, Terms, WhereNaN
from ssduck.lakes.answers import AnsweredEpisode, KeptAnswers, answer_table, tables, whole_table
from ssduck.lakes.engines import Answerer, EngineName, How, engine_of, how_of
from ssduck.lakes.lint import told_of
from ssduck.lakes.manifest import (
    EpisodeEntry,
    named_errors,
    read_manifest,
    table_of,
    tag_column,
    write_manifest,
)
from ssduck.lakes.pool import pools
from ssduck.lakes.questions import ConditionQuestion, ProgramQuestion, Question, ScoreQuestion
from ssduck.lakes.sandboxed import SandboxedLake, check_in_process
from ssduck.lakes.scan import DUCKDB_SUFFIX, entries_of_records, missing, records_of
from ssduck.lakes.statements import SqlDialect, statement
from ssduck.lakes.where import condition, no_episode
from ssduck.limits import Limits
from ssduck.recording.episode import Tag, checked_tags, given_tags
from ssduck.recording.paths import expand_path
from ssduck.recording.replay.progress import Progress
from ssduck.recording.stores.descriptions import checked_description
from ssduck.recording.stores.object_store import ObjectPath
from ssduck.recording.stores.parquet import write_tags
from ssduck.recording.stores.parquet_layout import FolderRun
from ssduck.recording.stores.summaries import size_and_time

MANIFEST = "ssduck-manifest"
# The number of episodes that are asked together, at most.
BATCH = 100
# The number of different doubts in a question that become warnings, at most.
MAX_DOUBTS = 10
_FILE_SCHEME = "file://"
_INTERNAL = ("group", "tags", "files", "error")


def _program(text: str, limits: Limits | None, strict: bool) -> ProgramQuestion:
    return ProgramQuestion(text, limits, validation.boolean(strict, "ask: strict"))


class Lake:
    """All episodes of the records below a path.

    Args:
        path: as `open_lake` takes it.

    Attributes:
        path: the absolute path.

    Raises:
        RecordError: there is no such path.
    """

    def __init__(self, path: str | Path) -> None:
        text = str(validation.path(path, "lake: path"))
        if text.startswith(_FILE_SCHEME):
            text = text.removeprefix(_FILE_SCHEME)
        self.path = str(expand_path(text).absolute())
        self._place = expand_path(self.path)
        self._entries: list[EpisodeEntry] = []
        self.refresh()

    # -- the manifest -----------------------------------------------------------------------

    @property
    def manifest(self) -> Path:
        """The file of the manifest; it is there if its folder can be written."""
        place = self._place
        if isinstance(place, ObjectPath) or place.is_dir():
            return place / f"{MANIFEST}.parquet"
        if place.is_file():
            return place.with_name(f"{place.name}.{MANIFEST}.parquet")
        parts = place.parts
        fixed = next((i for i, part in enumerate(parts) if glob.has_magic(part)), len(parts) - 1)
        checksum = zlib.crc32(self.path.encode())
        return Path(*parts[:fixed]) / f"{MANIFEST}-{checksum:08x}.parquet"

    @record_errors()
    def refresh(self, *, forget_missing: bool = False) -> None:
        """Reads what is new, was changed or is missing since the manifest was made.

        Args:
            forget_missing: whether episodes whose files are gone are no longer listed, with an
                error.

        Raises:
            RecordError: there is no such path.
        """
        forget_missing = validation.boolean(forget_missing, "refresh: forget_missing")
        before = read_manifest(self.manifest)
        known = {entry.key: entry for entry in before}
        entries = []
        with closing(Progress("episodes", None, time.monotonic())) as progress:
            for entry in entries_of_records(records_of(self.path), known):
                entries.append(entry)
                progress.advance(1)
        found = {entry.key for entry in entries}
        if not forget_missing:
            gone = [entry for entry in before if entry.key not in found and entry.ticks is not None]
            entries += [missing(entry) for entry in gone if entry.path]
        self._replace(sorted(entries, key=lambda entry: entry.key), before)

    def _replace(self, entries: list[EpisodeEntry], before: Sequence[EpisodeEntry]) -> None:
        self._entries = entries
        self.__dict__.pop("episodes", None)
        if entries != list(before):
            write_manifest(entries, self.manifest)

    @property
    def entries(self) -> tuple[EpisodeEntry, ...]:
        """What the manifest has of each episode, in the order of `episodes`."""
        return tuple(self._entries)

    @cached_property
    def episodes(self) -> pa.Table:
        """The episodes, sorted by path, world and number.

        Each is a row with `path`, `world`, `episode`, `id`, `started`, `complete`, `version`,
        `ticks`, `first_tick`, `last_tick`, `start` and `end` (s), `every`, `tables`, `entities`,
        `size` (bytes) and `error`, and with a column for each tag that an episode has, such as
        `success`. DuckDB, polars and pandas take the table as it is.
        """
        table = table_of(self._entries)
        columns = {name: table[name] for name in table.column_names if name not in _INTERNAL}
        sizes = [sum(file.size for file in entry.files) for entry in self._entries]
        columns["size"] = pa.array(sizes, pa.int64())
        columns["error"] = table["error"]
        for name in sorted({name for entry in self._entries for name in entry.tags}):
            if name not in columns:
                columns[name] = tag_column([entry.tags.get(name) for entry in self._entries])
        return pa.table(columns)

    def select(self, where: str | None = None) -> pa.Table:
        """Returns the rows of `episodes` for which a condition holds.

        Args:
            where: the condition, an expression of DuckDB's SQL over the columns of `episodes`, tags
                among them: `"task = 'pick' AND NOT success"`. It has no queries. None for all
                episodes.

        Raises:
            ArgumentError: it is no such condition.
        """
        return self.episodes.take(pa.array(self._places(where), pa.int64()))

    def __len__(self) -> int:
        return len(self._entries)

    def __repr__(self) -> str:
        return f"<Lake {self.path!r}: {len(self)} episodes>"

    def _selected(self, where: str | None) -> list[EpisodeEntry]:
        """Returns the episodes for which a condition holds; all if there is none."""
        entries = [self._entries[place] for place in self._places(where)]
        if where is not None and not entries:
            warn(no_episode(where, self.episodes))
        return entries

    def _places(self, where: str | None) -> Sequence[int]:
        """Returns the rows of the episodes for which a condition holds; all if there is none."""
        if where is None:
            return range(len(self._entries))
        rows = self.episodes
        test = condition(where, rows.column_names)
        # DuckDB takes names that differ in case for one: the columns get numbers.
        names = {name: str(number) for number, name in enumerate(rows.column_names)}
        for column in test.find_all(exp.Column):
            column.set("this", exp.to_identifier(names[column.name], quoted=True))
        numbers = pa.array(range(rows.num_rows), pa.int64())
        numbered = rows.rename_columns(list(names.values())).append_column("row", numbers)
        select = exp.select(exp.column("row", quoted=True)).from_("episodes").where(test)
        database = Database(":memory:", None)
        try:
            database.connection.register("episodes", numbered)
            found = database.connection.rows(select.sql("duckdb"))
        except SqlError as error:
            message = error.message.splitlines()[0]  # below is a statement with other names
            raise ArgumentError(f"where: {where!r} is no condition: {message}") from error
        finally:
            database.close()
        return sorted(row for (row,) in found)

    # -- questions --------------------------------------------------------------------------

    def ask(
        self,
        program: str,
        where: str | None = None,
        engine: EngineName = "local",
        *,
        limits: Limits | None = None,
        strict: bool = False,
        processes: int | None = None,
        batch: int | None = None,
        resume: str | Path | None = None,
        progress: bool = True,
        options: Mapping[str, Any] | None = None,
        session: Any = None,
    ) -> pa.Table:
        """Returns the answer of each episode to a program, as `ssduck.open` would give it.

        Args:
            program: a program of SelectScript; each episode's world has the name that it was
                recorded under, and is at its last tick.
            where: a condition on the columns of `episodes`, in SQL; None for all episodes.
            engine: `"local"`: processes of this machine; `"ray"`; `"spark"`.
            limits: the limits of the program; with `Limits.strict()`, one process of a sandbox
                answers.
            strict: whether a probable mistake in the program, such as a name that no entity of an
                episode has, is the error of that episode.
            processes: the number of processes of this machine; by default one for each core, and
                fewer for few episodes. They are kept for some minutes, for further questions.
            batch: the number of episodes that are asked together, by default at most 100.
            resume: a folder that keeps the answers of finished batches, so that the same question
                goes on from there when it is asked again, of these episodes and of others; None
                to keep nothing.
            progress: whether to show the progress, if standard error is a terminal.
            options: the arguments of `ray.init`.
            session: the `SparkSession`; None for one on this machine.

        Returns:
            A table with the columns `world`, `episode`, `path`, `answer` and `error`, sorted by
            path, world and number. If all answers are records, it has their columns in place of
            `answer`, and a row for each record. An episode that is damaged, or at which the program
            fails, has the message in `error`.

        Raises:
            ParseError: the text is no program.
            ArgumentError: an argument is wrong, or the condition is none.
            UnsupportedError: the engine is not installed.

        Warns:
            ProgramWarning: a probable mistake in the program, once, with the first episode that
                has it.
        """
        how = How(engine, processes, batch, resume, progress, options, session)
        if limits is not None and limits.is_sandboxed:
            with SandboxedLake(self.path, limits) as lake:
                return lake.ask(program, where, strict=strict, **vars(how))
        return whole_table(self._answered(_program(program, limits, strict), where, how))

    def stream(
        self,
        program: str,
        where: str | None = None,
        engine: EngineName = "local",
        *,
        limits: Limits | None = None,
        strict: bool = False,
        **arguments: Any,
    ) -> Iterator[pa.Table]:
        """Returns an iterator of the same answers, batch by batch, as soon as they are there.

        The arguments and the errors are those of `ask`; wrong arguments are told at once, before
        the first table. Each table has the types of its own answers.
        """
        check_in_process(limits, "stream")
        how = how_of("stream", engine, arguments)
        answered = self._answered(_program(program, limits, strict), where, how)
        return tables(answered, how.batch or BATCH)

    def score(
        self,
        success: str | None = None,
        failure: str | None = None,
        reward: Reward | None = None,
        stop_when: str | None = None,
        *,
        where: str | None = None,
        nan: WhereNaN = "error",
        engine: EngineName = "local",
        limits: Limits | None = None,
        processes: int | None = None,
        batch: int | None = None,
        resume: str | Path | None = None,
        progress: bool = True,
        options: Mapping[str, Any] | None = None,
        session: Any = None,
    ) -> pa.Table:
        """Returns the return and the success of each episode of an environment of gymnasium.

        They are those of `ssduck.gym.score`; its arguments are the terms and `nan`.

        Returns:
            A table with the columns `world`, `episode`, `path`, `return`, `success`, `failure`,
            `steps`, `seed` and `error`.

        Raises:
            ArgumentError: a term is none, or another argument is wrong.
            UnsupportedError: the engine is not installed.
        """
        how = How(engine, processes, batch, resume, progress, options, session)
        if limits is not None and limits.is_sandboxed:
            terms = success, failure, reward, stop_when
            with SandboxedLake(self.path, limits) as lake:
                return lake.score(*terms, where=where, nan=nan, **vars(how))
        question = ScoreQuestion(Terms.of(success, failure, reward, stop_when, nan=nan), limits)
        return whole_table(self._answered(question, where, how))

    def lint(
        self,
        condition: str,
        where: str | None = None,
        *,
        limits: Limits | None = None,
        strict: bool = False,
        **options: Any,
    ) -> list[str]:
        """Tells of a condition that never holds, always, or at the first tick of each episode.

        Args:
            condition: an expression of SelectScript, as success is one; with a query inside, it is
                asked at each tick, which takes longer.
            where: a condition on the columns of `episodes`; None for all episodes.
            limits: as in `ask`.
            strict: likewise.
            options: further arguments of `ask`.

        Returns:
            What is told of it, a sentence each; nothing of a condition that may well be meant.

        Raises:
            ArgumentError: it is no condition, or an argument is wrong.
            SelectScriptError: it fails in all episodes; the message has the place.
        """
        validation.text(condition, "lint takes a condition")
        if limits is not None and limits.is_sandboxed:
            with SandboxedLake(self.path, limits) as lake:
                return lake.lint(condition, where, strict=strict, **options)
        question = ConditionQuestion(condition, limits, validation.boolean(strict, "lint: strict"))
        how = how_of("lint", options.pop("engine", "local"), options)
        return told_of(condition, list(self._answered(question, where, how)))

    def _answered(
        self, question: Question, where: str | None, how: How
    ) -> Iterator[AnsweredEpisode]:
        """Returns the answers of the selected episodes, in order, which are asked one by one."""
        progress = validation.boolean(how.progress, "ask: progress")
        batch, processes = how.batch, how.processes
        if batch is not None:
            batch = validation.integer(batch, "ask: batch", minimum=1)
        if processes is not None:
            processes = validation.integer(processes, "ask: processes", minimum=1)
        entries = self._selected(where)
        if how.engine == "local" and processes is None:
            processes = pools.default_count(len(entries))
        answer = engine_of(how.engine, processes, how.options, how.session)
        kept = KeptAnswers(None if how.resume is None else expand_path(how.resume), question)
        size = batch or _batch_size(len(entries), processes or os.cpu_count() or 1)
        return _in_order(question, entries, answer, kept, size, progress)

    def sql(
        self,
        program: str,
        where: str | None = None,
        dialect: SqlDialect = "duckdb",
        *,
        limits: Limits | None = None,
    ) -> str:
        """Returns one statement of SQL that answers a program of formulas without ssduck.

        It reads the Parquet files where they are. A program is one query of a world, or one
        expression of entities, perhaps in a function over time; relations of shapes, contacts and
        joints are not written as SQL.

        Args:
            program: the program.
            where: a condition on the columns of `episodes`; None for all episodes.
            dialect: `"duckdb"` or `"spark"`, for a session of Spark.
            limits: the limits of the program.

        Returns:
            A SELECT with the columns and rows of `ask`. Where an entity is missing, it gives NULL
            in place of an error; `changes`, `least` and `greatest` give structs of `time` and
            `value`. It does not check that files are as they were.

        Raises:
            ParseError: the text is no program.
            UnsupportedError: SQL alone cannot answer it, or an episode is in no Parquet files.
            UnknownNameError: there is no such dialect, or the program names nothing.
            ArgumentError: the condition is none, or no episode is without an error.
        """
        validation.text(program, "a program for a lake is a text of SelectScript")
        entries = [self._entries[place] for place in self._places(where)]
        check_in_process(limits, "sql")
        return statement(entries, program, dialect, limits)

    # -- tags -------------------------------------------------------------------------------

    def tag(
        self,
        name: str,
        program: str,
        where: str | None = None,
        engine: EngineName = "local",
        *,
        limits: Limits | None = None,
        strict: bool = False,
        **arguments: Any,
    ) -> pa.Table:
        """Tags each episode with its answer to a program.

        Args:
            name: the name of the tag.
            program: a program whose answer is a text, True, False or a finite number, or a list of
                one such value, or a record of one; of an episode without such an answer, the tag
                stays as it is.
            where: a condition on the columns of `episodes`.
            engine: the engine.
            limits: the limits of the program.
            strict: whether a probable mistake in it is an error.
            arguments: further arguments of `ask`.

        Returns:
            The answers, as `ask` gives them.

        Raises:
            ArgumentError: an argument is wrong, or an answer is no tag.
            RecordError: the description of an episode cannot be written, or it is in a DuckDB file.
        """
        checked_tags({name: True}, "tag")
        validation.text(program, "tag takes a program (set_tags takes tags)")
        check_in_process(limits, "tag")
        how = how_of("tag", engine, arguments)
        answered = list(self._answered(_program(program, limits, strict), where, how))
        values = {
            one.entry.key: _single_value(one.value)
            for one in answered
            if one.error is None and _single_value(one.value) is not None
        }
        for value in values.values():
            checked_tags({name: value}, "tag")
        self._write_tags({key: {name: value} for key, value in values.items()})
        return answer_table(answered)

    def set_tags(self, tags: Mapping[str, Tag], where: str | None = None) -> int:
        """Gives the selected episodes tags; returns the number of these episodes.

        A warning tells of episodes that have errors: they get none.

        Args:
            tags: texts, True, False or finite numbers by name.
            where: a condition on the columns of `episodes`; None for all.

        Raises:
            ArgumentError: a tag is another value, or the condition is none.
            RecordError: the description of an episode cannot be written, or it is in a DuckDB file.
        """
        added = given_tags(tags)
        entries = self._selected(where)
        whole = [entry for entry in entries if entry.error is None]
        self._write_tags({entry.key: added for entry in whole})
        if failed := [entry for entry in entries if entry.error is not None]:
            warn(f"episodes without tags: {named_errors(failed)}; mend that, and refresh the lake")
        return len(whole)

    def _write_tags(self, tags: Mapping[tuple[str, str, int], Mapping[str, Tag]]) -> None:
        """Writes tags of episodes, by their keys, and reads their descriptions again."""
        places = {path: expand_path(path) for path, _, _ in tags}
        for path, place in places.items():  # before anything is written
            if place.suffix == DUCKDB_SUFFIX and place.is_file():
                raise RecordError(f"{path} is a DuckDB file: tags are given while it is recorded")
        for path, world, number in tags:
            write_tags(FolderRun(places[path], world, number), tags[path, world, number])
        before = self._entries
        self._replace([_with_tags(entry, tags.get(entry.key)) for entry in before], before)


def open_lake(path: str | Path, *, limits: Limits | None = None) -> Lake:
    """Returns the episodes of all records below a path, to ask them one question.

    Args:
        path: a folder with records in it, at any depth; a record; a pattern such as
            `runs/*/night`, in which `**` stands for folders at any depth; or an address, `file://…`
            or `s3://bucket/runs`.
        limits: `Limits.strict()` for records from elsewhere: it is a `SandboxedLake` then.

    Raises:
        RecordError: there is no such path.

    >>> import ssduck, tempfile
    >>> with ssduck.load("kitchen") as ss, tempfile.TemporaryDirectory() as folder:
    ...     for _ in range(2):
    ...         ss.run(0.1)
    ...         _ = ss.export(folder)
    ...     ssduck.lake(folder).ask("heldFor(z(kitchen.can) > 0) > 0.15;")["answer"].to_pylist()
    [False, True]
    """
    if limits is not None and limits.is_sandboxed:
        sandboxed: Any = SandboxedLake(path, limits)
        return sandboxed  # type: ignore[no-any-return]
    return Lake(path)


def _with_tags(entry: EpisodeEntry, tags: Mapping[str, Tag] | None) -> EpisodeEntry:
    """Returns the entry of an episode whose description was written anew, with tags."""
    if tags is None:
        return entry
    name = f"episodes/{entry.world}-{entry.episode}.json"
    place = expand_path(entry.path) / name
    # In this order: if another process writes it meanwhile, it is read again next time.
    (_, modified), content = size_and_time(place), place.read_bytes()
    size, checksum = len(content), zlib.crc32(content)
    files = tuple(
        replace(file, size=size, modified=modified, checksum=checksum)
        if file.name == name
        else file
        for file in entry.files
    )
    # Others may have given it further tags.
    own = checked_description(content, str(place)).get("tags", {})
    return replace(entry, tags=checked_tags(own), files=files)


def _single_value(value: Any) -> Any:
    """Returns the value of an answer that is a value, or a list or a record of one."""
    while isinstance(value, list | dict) and len(value) == 1:
        value = value[0] if isinstance(value, list) else next(iter(value.values()))
    return value


def _in_order(
    question: Question,
    entries: Sequence[EpisodeEntry],
    answer: Answerer,
    kept: KeptAnswers,
    size: int,
    progress: bool,
) -> Iterator[AnsweredEpisode]:
    """Yields the answers of episodes in order; those that are kept are not asked again."""
    warned: set[str] = set()
    ready = {
        index: known
        for index, entry in enumerate(entries)
        if (known := kept.read(entry)) is not None
    }
    missing = [index for index in range(len(entries)) if index not in ready]
    batches = [missing[start : start + size] for start in range(0, len(missing), size)]
    with closing(Progress("episodes", len(entries), -math.inf, is_shown=progress)) as shown:
        shown.advance(len(ready))
        results = answer(question, [[entries[index] for index in batch] for batch in batches])
        for index, entry in enumerate(entries):
            while index not in ready:
                place, answers = next(results)
                kept.write([entries[one] for one in batches[place]], answers)
                ready.update(zip(batches[place], answers, strict=True))
                shown.advance(len(answers))
            answered = AnsweredEpisode(entry, *ready.pop(index))
            _warn_of(answered, warned)
            yield answered


def _warn_of(answered: AnsweredEpisode, warned: set[str]) -> None:
    """Warns of the probable mistakes in a question that no episode before had."""
    for doubt in answered.doubts:
        if doubt not in warned and len(warned) <= MAX_DOUBTS:
            warned.add(doubt)
            entry = answered.entry
            is_last = len(warned) > MAX_DOUBTS
            message = "there are more such warnings: they are left out" if is_last else doubt
            place = f"episode {entry.episode} of {entry.world} in {entry.path}"
            warn(f"{message}\n  first in {place}", ProgramWarning)


def _batch_size(count: int, processes: int) -> int:
    """Returns the number of episodes of a batch, so that each process has several batches."""
    return max(1, min(BATCH, -(-count // (2 * processes))))
