"""Checks that episodes are of one group, so that one of them may stand for the models of all.

A manifest says which are, and may come from a stranger. So the files of each episode are compared
with those of the first of its group: by their bytes, or by their rows where a file was written
otherwise, as checksums prove nothing against a forger.
"""

from __future__ import annotations

import base64
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ssduck.errors import RecordError
from ssduck.lakes.manifest import EpisodeEntry
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.model_checks import check_models
from ssduck.recording.paths import expand_path, label_of, part_name
from ssduck.recording.static_tables import members_of, run_of
from ssduck.recording.stores.batched_parts import (
    BatchedFile,
    ReadPart,
    ReadParts,
    RepeatedColumns,
    ticks_of_parts,
)
from ssduck.recording.stores.checksums import content_problem, footer_in, with_footer_sums
from ssduck.recording.stores.object_store import ObjectPath
from ssduck.recording.stores.parquet_layout import LOG, FolderRun
from ssduck.recording.stores.row_checks import RowChecks, repeated_columns
from ssduck.recording.stores.summaries import StoredFile, present_at_end
from ssduck.schema import MODELS


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
        self._members: dict[tuple[str, str, int], tuple[tuple[StoredFile, ...], str]] = {}

    def check(self, entry: EpisodeEntry, parts: ReadParts) -> EntryFiles:
        """Checks that an episode is of the group; returns its files.

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
            self._repeated.check(part, repeated_columns("entities"))

    def _check_model(self, run: FolderRun, listed: EntryFiles, model: str) -> None:
        """Checks that a model of an episode is that of the group."""
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
    """Returns what the description of an episode has in common with others of its group."""
    has_log = any(file.name.startswith(f"{LOG}/") for file in entry.files)
    if has_log or run.removed_parts or not run.has_checksums:
        raise RecordError(f"{run.about_file} is of an episode that is asked by itself")
    return run.world, run.tables, run.recording, run.description.get("camera")


def _model_parts(files: EntryFiles) -> Mapping[str, list[ModelPart]]:
    """Returns the parts of each model, checked."""
    parts: dict[str, list[ModelPart]] = {}
    for model in MODELS:
        listed = files.parts(f"models/{model}")
        parts[model] = _checked_parts(listed, [bytes(file.content()) for file in listed])
    return parts


def _checked_parts(files: Sequence[BatchedFile], contents: Sequence[bytes]) -> list[ModelPart]:
    """Returns the parts of a model."""
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


# -- the parts of models, compared by their bytes or their rows -------------------------------

# The Arrow schema in a footer, in base64: it begins with four bytes of ones.
_SCHEMA = re.compile(rb"ARROW:schema.{1,6}?(/////[A-Za-z0-9+/]+=*)", re.DOTALL)


@dataclass(frozen=True)
class ModelPart:
    """A part of a model.

    Attributes:
        file: the file.
        content: its bytes.
    """

    file: BatchedFile
    content: bytes

    def is_copied_in(self, content: bytes, label: bytes) -> bool:
        """Checks from the bytes of a part whether it is this one with another label.

        One of another run, or that was written otherwise, may have the same rows: see `is_like`.
        """
        if self._footer is None or len(content) != len(self.content):
            return False
        if len(label) != len(self.file.label):
            return False
        data, footer = self._footer.data, self._footer.with_label(label)
        return content == data + with_footer_sums(footer, self._footer.data_sum)

    def is_like(self, other: ModelPart) -> bool:
        """Checks whether another part has the same rows, but for the number of the run."""
        if self._has_columns_of(other):
            return True
        return bool(_without_run(self._part.rows()).equals(_without_run(other._part.rows())))

    def _has_columns_of(self, other: ModelPart) -> bool:
        """Checks whether all columns of another part are the same bytes, but the last, `run`."""
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
        """The numbers of the runs of the rows."""
        return self._part.rows(["run"])

    @cached_property
    def _footer(self) -> _Footer | None:
        """The footer, which has the label twice; None if there is no schema in it."""
        footer = footer_in(self.content)
        match = _SCHEMA.search(footer)
        if match is None:
            return None
        data, schema = self.content[: -len(footer)], base64.b64decode(match[1])
        return _Footer(data, footer, self.file.label, schema, match.start(1))

    @cached_property
    def _part(self) -> ReadPart:
        return ReadPart(self.file, self.content)


@dataclass(frozen=True)
class _Footer:
    """The bytes of a part before its footer, and the footer."""

    data: bytes  # before it
    content: bytes
    label: bytes
    schema: bytes  # that of Arrow in it, decoded, which has the label, too
    place: int  # where the schema begins

    @cached_property
    def data_sum(self) -> int:
        """The CRC-32 of the bytes before the footer."""
        return zlib.crc32(self.data)

    def with_label(self, label: bytes) -> bytes:
        """Returns the footer with another label of the same length, and wrong checksums."""
        changed = self.content.replace(self.label, label)
        columns = base64.b64encode(self.schema.replace(self.label, label))
        return changed[: self.place] + columns + changed[self.place + len(columns) :]


def _first_byte(column: pq.ColumnChunkMetaData) -> int:
    """Returns where the bytes of a column begin in its file."""
    places = (column.dictionary_page_offset, column.data_page_offset)
    first: int = min(place for place in places if place is not None)
    return first


def _without_run(rows: pa.Table) -> pa.Table:
    return rows.drop_columns(["run"]) if "run" in rows.column_names else rows


class EntryFiles:
    """The parts of an episode.

    Args:
        entry: the episode.
        key: the text that its labels have of it.
    """

    def __init__(self, entry: EpisodeEntry, key: str) -> None:
        self.key = key
        self._path = entry.path
        self._end = f"/world={entry.world}/episode={entry.episode}"
        self._sums: dict[str, dict[str, int]] = {}
        for file in entry.files:
            folder, _, name = file.name.rpartition("/")
            self._sums.setdefault(folder, {})[name] = file.checksum

    def parts(self, table: str) -> list[BatchedFile]:
        """Returns the files of a table, or of a model such as `models/links`, in their order."""
        folder = f"{table}{self._end}"
        sums: Mapping[str, int] = self._sums.get(folder, {})
        names = [part_name(number) for number in range(len(sums))]
        if not names or sorted(sums) != names:
            raise RecordError(f"{self._path}/{folder} has other files than complete parts")
        place = f"{_resolved(self._path)}/{folder}"
        return [
            BatchedFile(f"{place}/{name}", sums[name], label_of(self.key, table, number), table)
            for number, name in enumerate(names)
        ]


@lru_cache(maxsize=1024)
def _resolved(path: str) -> str:
    """Returns the path of a record without links."""
    place = expand_path(path).resolve()
    return str(place) if isinstance(place, ObjectPath) else place.as_posix()
