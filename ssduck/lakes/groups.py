"""Checks that episodes are of one group, so that one of them may stand for the models of all.

A manifest says which are, and may come from a stranger. So the files of each episode are compared
with those of the first of its group: by their bytes, or by their rows where a file was written
otherwise, as checksums prove nothing against a forger.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from typing import TypeAlias, TypeVar

import numpy as np
import pyarrow as pa

from ssduck.errors import RecordError
from ssduck.lakes.entry_files import EntryFiles
from ssduck.lakes.manifest import EpisodeEntry, FileEntry
from ssduck.lakes.model_parts import ModelPart
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.model_checks import check_models
from ssduck.recording.paths import expand_path
from ssduck.recording.static_tables import members_of, run_of
from ssduck.recording.stores.batched_parts import (
    BatchedFile,
    ReadParts,
    RepeatedColumns,
    ticks_of_parts,
)
from ssduck.recording.stores.checksums import content_problem
from ssduck.recording.stores.parquet_layout import LOG, FolderRun
from ssduck.recording.stores.row_checks import RowChecks, repeated_columns
from ssduck.recording.stores.summaries import present_at_end
from ssduck.schema import MODELS

T = TypeVar("T")
# Work that is done in steps, and returns a value in the end.
Steps: TypeAlias = Generator[None, None, T]


class EpisodeGroup:
    """The episodes with the models, tables and entities of one of them.

    Args:
        entry: the episode.

    Attributes:
        run: the episode.
        models: the rows of each model.
        number: the number of its run.

    Raises:
        RecordError: its models cannot be read, or it cannot be asked together with others.
    """

    def __init__(self, entry: EpisodeEntry) -> None:
        self.run = FolderRun(expand_path(entry.path), entry.world, entry.episode)
        self._described = _described(self.run, entry)
        self.models = {table: self.run.read(f"models/{table}") for table in MODELS}
        check_models(self.models, lambda table: str(self.run.place(f"models/{table}")))
        self.number = run_of(self.models) or 0
        self._checks = RowChecks(members_of(self.models))
        self._repeated = RepeatedColumns(self.models)
        files = EntryFiles(entry, self.run.key)
        self._parts = _model_parts(files)
        self._present = present_at_end(_last_rows(files, ReadParts()))
        # The files of the episodes that were found to be of the group, and what their labels have.
        self._members: dict[tuple[str, str, int], tuple[tuple[FileEntry, ...], str]] = {}

    def check(self, entry: EpisodeEntry, parts: ReadParts) -> EntryFiles:
        """Checks that an episode is of the group; returns its files.

        Args:
            entry: the episode.
            parts: reads its parts.

        Raises:
            RecordError: it is not, or a file of it is damaged.
            OSError: a file cannot be read.
        """
        steps = self.steps(entry, parts)
        while True:
            try:
                next(steps)
            except StopIteration as end:
                files: EntryFiles = end.value
                return files

    def steps(self, entry: EpisodeEntry, parts: ReadParts) -> Steps[EntryFiles]:
        """Does the same in steps, each of which reads another kind of file."""
        known, key = self._members.get(entry.key, ((), ""))
        if known and known == entry.files:
            return EntryFiles(entry, key)
        run = FolderRun(expand_path(entry.path), entry.world, entry.episode)
        if _described(run, entry) != self._described:
            raise RecordError(f"{run.about_file} describes another recording than its group has")
        files = EntryFiles(entry, run.key)
        for model in MODELS:
            yield
            self._check_model(run, files, model)
        yield
        if not np.array_equal(present_at_end(_last_rows(files, parts)), self._present):
            raise RecordError(f"{run.place('entities')} has other entities than its group has")
        self._members[entry.key] = entry.files, run.key
        return files

    def check_rows(
        self, files: EntryFiles, starts: Sequence[int], ticks: TickBuffer, parts: ReadParts
    ) -> None:
        """Checks all rows of the entities of an episode of the group.

        Args:
            files: the files of the episode.
            starts: the first tick of each part.
            ticks: its ticks.
            parts: reads its parts.

        Raises:
            RecordError: they are of unknown ticks or entities, or twice there, or repeat another
                name, kind or mass than their model has.
            OSError: a file cannot be read.
        """
        between = ticks_of_parts(starts, int(ticks.numbers[-1]))
        for file, first_and_last in zip(files.parts("entities"), between, strict=True):
            part = parts.read(file)
            part.check(self._checks, ticks, first_and_last)
            self._repeated.check(part, repeated_columns("entities"))

    def _check_model(self, run: FolderRun, listed: EntryFiles, model: str) -> None:
        """Checks that a model of an episode is that of the group.

        Most are: they differ in their labels and their runs only, as is seen from the bytes.
        """
        table, others = f"models/{model}", self._parts[model]
        files = listed.parts(table)
        contents = [bytes(file.content()) for file in files]
        if len(files) == len(others) and all(
            other.is_copied_in(content, file.label)
            for content, file, other in zip(contents, files, others, strict=True)
        ):
            return
        parts = _checked_parts(files, contents)
        if len(parts) != len(others) or not all(map(ModelPart.is_like, parts, others)):
            raise RecordError(f"{run.place(table)} is another than its group has")
        if model == "entities":
            run_of({"entities": pa.concat_tables([part.run for part in parts])})


def _described(run: FolderRun, entry: EpisodeEntry) -> tuple[object, ...]:
    """Returns what the description of an episode has in common with others of its group.

    Raises:
        RecordError: the episode cannot be asked together with others.
    """
    has_log = any(file.name.startswith(f"{LOG}/") for file in entry.files)
    if has_log or run.removed_parts or not run.has_checksums:
        raise RecordError(f"{run.about_file} is of an episode that is asked by itself")
    return run.world, run.tables, run.recording, run.description.get("camera")


def _model_parts(files: EntryFiles) -> Mapping[str, list[ModelPart]]:
    """Returns the parts of each model, checked.

    Raises:
        RecordError: a file is damaged, or of another part.
        OSError: a file cannot be read.
    """
    parts: dict[str, list[ModelPart]] = {}
    for model in MODELS:
        listed = files.parts(f"models/{model}")
        parts[model] = _checked_parts(listed, [bytes(file.content()) for file in listed])
    return parts


def _checked_parts(files: Sequence[BatchedFile], contents: Sequence[bytes]) -> list[ModelPart]:
    """Returns the parts of a model.

    Raises:
        RecordError: a file is damaged.
    """
    parts = []
    for file, content in zip(files, contents, strict=True):
        problem = content_problem(content, has_checksums=True)
        if problem is not None:
            raise RecordError(f"{file.path} {problem}")
        parts.append(ModelPart(file, content))
    return parts


def _last_rows(files: EntryFiles, parts: ReadParts) -> pa.Table:
    """Returns the rows of the last part of an episode's entities: the columns to be checked."""
    return parts.read(files.parts("entities")[-1]).keys()
