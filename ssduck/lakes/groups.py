"""Checks that episodes are of one group, so that one of them may stand for the models of all.

A manifest says which are, and may come from a stranger. So the files of each episode are compared
with those of the first of its group: by their bytes, or by their rows where a file was written
otherwise, as checksums prove nothing against a forger.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ssduck.errors import RecordError
from ssduck.lakes.entry_files import EntryFiles
from ssduck.lakes.manifest import EpisodeEntry, FileEntry
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.model_checks import check_models
from ssduck.recording.paths import expand_path
from ssduck.recording.static_tables import members_of, run_of
from ssduck.recording.stores.batched_parts import (
    BatchedFile,
    ReadPart,
    ReadParts,
    ticks_of_parts,
)
from ssduck.recording.stores.checksums import (
    content_problem,
    footer_in,
    with_footer_sum,
)
from ssduck.recording.stores.parquet_layout import LOG, FolderRun
from ssduck.recording.stores.row_checks import RowChecks, repeated_columns
from ssduck.recording.stores.summaries import present_at_end
from ssduck.schema import MODELS

# The Arrow schema in a footer, in base64: it begins with four bytes of ones.
_SCHEMA = re.compile(rb"ARROW:schema.{1,6}?(/////[A-Za-z0-9+/]+=*)", re.DOTALL)


@dataclass(frozen=True)
class _ModelPart:
    """A part of a model.

    Attributes:
        file: the file.
        content: its bytes.
    """

    file: BatchedFile
    content: bytes

    def is_like(self, other: _ModelPart) -> bool:
        """Checks whether another part has the same rows, but for the number of the run."""
        if self._has_columns_of(other):
            return True
        return bool(_without_run(self._part.rows()).equals(_without_run(other._part.rows())))

    def _has_columns_of(self, other: _ModelPart) -> bool:
        """Checks whether all columns of another part are the same bytes here, but the last, `run`.

        Both have the same columns then, of the same types, and the bytes are theirs.
        """
        own, others = self._part.parquet, other._part.parquet
        count = own.metadata.num_columns
        is_same = own.metadata.num_row_groups == others.metadata.num_row_groups == 1
        if not is_same or not own.schema_arrow.equals(others.schema_arrow):
            return False
        if own.schema_arrow.names[-1:] != ["run"] or not own.schema.equals(others.schema):
            return False
        columns, theirs = (part.metadata.row_group(0).column for part in (own, others))
        end = _first_byte(columns(count - 1))
        return self.content[:end] == other.content[:end] and all(
            (column := columns(place)).equals(theirs(place))
            and _first_byte(column) + column.total_compressed_size <= end
            for place in range(count - 1)
        )

    @property
    def run(self) -> pa.Table:
        """The numbers of the runs of the rows; no column if it has none."""
        return self._part.rows(["run"])

    def with_label(self, label: bytes) -> bytes | None:
        """Returns the bytes of this part if it had another label; None if the lengths differ.

        Besides the label itself, they differ in the copy of it within the columns' schema, and in
        the checksum of the footer.
        """
        if self._footer is None or len(label) != len(self.file.label):
            return None
        data, footer, schema, place = self._footer
        changed = footer.replace(self.file.label, label)
        columns = base64.b64encode(schema.replace(self.file.label, label))
        return data + with_footer_sum(changed[:place] + columns + changed[place + len(columns) :])

    @cached_property
    def _footer(self) -> tuple[bytes, bytes, bytes, int] | None:
        """The data, the footer, the schema in it and its place; None if there is no schema."""
        footer = footer_in(self.content)
        data = self.content[: -len(footer)]
        match = _SCHEMA.search(footer)
        if match is None:
            return None
        return data, footer, base64.b64decode(match[1]), match.start(1)

    @cached_property
    def _part(self) -> ReadPart:
        return ReadPart(self.file, self.content)


def _first_byte(column: pq.ColumnChunkMetaData) -> int:
    """Returns where the bytes of a column begin in its file."""
    places = (column.dictionary_page_offset, column.data_page_offset)
    first: int = min(place for place in places if place is not None)
    return first


def _without_run(rows: pa.Table) -> pa.Table:
    return rows.drop_columns(["run"]) if "run" in rows.column_names else rows


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
        number = run_of(self.models)
        if number is None:
            raise RecordError(f"{self.run.about_file} is of a record without the number of its run")
        self.number = number
        self._checks = RowChecks(members_of(self.models))
        assert self.run.key is not None  # its parts have labels
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
        known, key = self._members.get(entry.key, ((), ""))
        if known and known == entry.files:
            return EntryFiles(entry, key)
        run = FolderRun(expand_path(entry.path), entry.world, entry.episode)
        if _described(run, entry) != self._described:
            raise RecordError(f"{run.about_file} describes another recording than its group has")
        assert run.key is not None  # its parts have labels
        files = EntryFiles(entry, run.key)
        for model in MODELS:
            self._check_model(run, files, model)
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
            part.check_repeated(self.models["entities"], repeated_columns("entities"))

    def _check_model(self, run: FolderRun, listed: EntryFiles, model: str) -> None:
        """Checks that a model of an episode is that of the group.

        Most are: they differ in their labels only, as is seen from the bytes.
        """
        table, others = f"models/{model}", self._parts[model]
        files = listed.parts(table)
        contents = [file.content() for file in files]
        if len(files) == len(others) and all(
            content == other.with_label(file.label)
            for content, file, other in zip(contents, files, others, strict=True)
        ):
            return
        parts = _checked_parts(files, contents)
        if len(parts) != len(others) or not all(map(_ModelPart.is_like, parts, others)):
            raise RecordError(f"{run.place(table)} is another than its group has")
        if model == "entities":
            run_of({"entities": pa.concat_tables([part.run for part in parts])})


def _described(run: FolderRun, entry: EpisodeEntry) -> tuple[object, ...]:
    """Returns what the description of an episode has in common with others of its group.

    Raises:
        RecordError: the episode cannot be asked together with others.
    """
    has_log = any(file.name.startswith(f"{LOG}/") for file in entry.files)
    if has_log or run.removed_parts or not run.has_checksums or run.key is None:
        raise RecordError(f"{run.about_file} is of an episode that is asked by itself")
    return run.world, run.tables, run.recording, run.description.get("camera")


def _model_parts(files: EntryFiles) -> Mapping[str, list[_ModelPart]]:
    """Returns the parts of each model, checked.

    Raises:
        RecordError: a file is damaged, or of another part.
        OSError: a file cannot be read.
    """
    parts: dict[str, list[_ModelPart]] = {}
    for model in MODELS:
        listed = files.parts(f"models/{model}")
        parts[model] = _checked_parts(listed, [file.content() for file in listed])
    return parts


def _checked_parts(files: Sequence[BatchedFile], contents: Sequence[bytes]) -> list[_ModelPart]:
    """Returns the parts of a model.

    Raises:
        RecordError: a file is damaged.
    """
    parts = []
    for file, content in zip(files, contents, strict=True):
        problem = content_problem(content, has_checksums=True)
        if problem is not None:
            raise RecordError(f"{file.path} {problem}")
        parts.append(_ModelPart(file, content))
    return parts


def _last_rows(files: EntryFiles, parts: ReadParts) -> pa.Table:
    """Returns the rows of the last part of an episode's entities: the columns to be checked."""
    return parts.read(files.parts("entities")[-1]).keys()
