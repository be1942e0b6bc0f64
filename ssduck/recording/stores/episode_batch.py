"""Reads many episodes with the same entities as one: an archive of a batch of episodes.

The ticks of an episode are moved by an offset, so that those of no two episodes are equal. SQL
reads the rows of all episodes at once, or those of one, as `EpisodeBatch.show` says.

A part is read only if its bytes have the checksum that its episode has in a manifest. Those of the
batch being asked are kept, with the columns that were decoded: the proof that episodes belong
together, the check of their ticks, SQL and Python read the same ones. The columns of some parts
are kept for the next question, which reads and checks the bytes again.
"""

from __future__ import annotations

import os
import re
import zlib
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from ssduck.errors import RecordError
from ssduck.geometry.arrays import Array
from ssduck.recording.spec import Recording
from ssduck.recording.stores.base import BufferViews, PairRequest, StoreConnection, TickArchive
from ssduck.recording.stores.history_sql import near_pair_rows, quoted
from ssduck.recording.stores.object_store import ObjectPath, is_address
from ssduck.recording.stores.parquet_archive import multi_link_bodies
from ssduck.recording.stores.stored_columns import (
    arrow_types,
    checked_parquet,
    part_columns,
    with_nulls,
)
from ssduck.schema import MODELS, TABLES
from ssduck.world.live_tables import ARROW_TYPES

# The largest number of bytes of the parts of a batch, as they are and decoded, and that of the
# columns that are kept for the next question.
MOST_READ = 1 << 27
MOST_KEPT = 1 << 26
_VALUE_BYTES = 8
# The column in which the parts have the number of the run.
RUN = "run"
# Columns by name.
Columns: TypeAlias = dict[str, pa.ChunkedArray]


@dataclass(frozen=True)
class BatchedFile:
    """A file of a part."""

    path: str  # where it is
    checksum: int  # the CRC-32 of its bytes
    table: str  # its table, or `models/<table>`

    def content(self) -> memoryview:
        """Returns the bytes of the file."""
        if is_address(self.path):
            content = memoryview(ObjectPath(self.path).read_bytes())
        else:
            content = _content(self.path)
        if zlib.crc32(content) != self.checksum:
            raise RecordError(f"{self.path} was changed or damaged since the manifest was made")
        return content


def _content(path: str) -> memoryview:
    """Returns the bytes of a file of this machine."""
    with open(path, "rb", buffering=0) as file:  # noqa: PTH123  # faster than a Path
        size = os.fstat(file.fileno()).st_size
        # Arrow uses its memory again: new pages take longer to clear than a part to read.
        content = memoryview(pa.allocate_buffer(size)).cast("B")
        end = 0
        while end < size and (count := file.readinto(content[end:])):
            end += count
    return content[:end]


@dataclass(frozen=True, eq=False)
class ReadPart:
    """A part whose bytes were read and checked."""

    file: BatchedFile  # the file
    content: bytes | memoryview  # its bytes
    columns: Columns = field(default_factory=dict)  # those that were decoded

    @cached_property
    def parquet(self) -> pq.ParquetFile:
        """The part as Arrow reads it; its columns are those of its table."""
        return checked_parquet(self.file.path, self.content, self.file.table)

    @property
    def row_count(self) -> int:
        """The number of rows."""
        for column in self.columns.values():
            return len(column)
        count: int = self.parquet.metadata.num_rows
        return count

    @property
    def size(self) -> int:
        """The number of bytes, as they are and decoded, about; the errors are those of `rows`."""
        values = self.row_count * len(part_columns(self.file.table))
        return len(self.content) + values * _VALUE_BYTES

    def rows(self, names: Sequence[str] | None = None) -> pa.Table:
        """Returns the rows, of some columns or of all."""
        names = self.parquet.schema_arrow.names if names is None else names
        missing = [name for name in names if name not in self.columns]
        if missing:
            # The threads of the library take longer to wake up than most parts to read.
            read = self.parquet.read(missing, use_threads=False)
            self.columns.update(zip(read.column_names, read.columns, strict=True))
        return pa.table({name: self.columns[name] for name in names})

    def decoded_size(self) -> int:
        """Returns the number of bytes of the columns that were decoded."""
        return sum(column.nbytes for column in self.columns.values())


class ReadParts:
    """Reads the parts of a batch of episodes, each once, as far as they are not too large."""

    def __init__(self) -> None:
        self._parts: dict[BatchedFile, ReadPart] = {}
        self._size = 0
        # The columns of earlier batches, those that were read last at the end, and their sizes.
        self._kept: OrderedDict[BatchedFile, tuple[Columns, int]] = OrderedDict()
        self._kept_size = 0

    def read(self, file: BatchedFile) -> ReadPart:
        """Returns the part of a file."""
        part = self._parts.get(file)
        if part is None:
            content = file.content()
            columns, kept_size = self._kept.pop(file, ({}, 0))
            self._kept_size -= kept_size
            part = ReadPart(file, content, columns)
            size = self._size + part.size
            if size <= MOST_READ:
                self._parts[file], self._size = part, size
        return part

    def __contains__(self, file: BatchedFile) -> bool:
        """Checks whether the part of a file is of the batch, and was not too large."""
        return file in self._parts

    def clear(self) -> None:
        """Forgets the batch, and keeps the last columns that were decoded."""
        for file, part in self._parts.items():
            self._kept[file] = part.columns, part.decoded_size()
            self._kept_size += self._kept[file][1]
        while self._kept_size > MOST_KEPT:
            self._kept_size -= self._kept.popitem(last=False)[1][1]
        self._parts.clear()
        self._size = 0


class PartsDataset(ds.InMemoryDataset):  # type: ignore[misc]  # it has no types
    """Rows that DuckDB reads, which are decoded when it does, and only the columns that it asks."""

    def __init__(
        self, schema: pa.Schema, rows: Callable[[Sequence[str]], Iterable[pa.Table]]
    ) -> None:
        super().__init__(schema.empty_table())
        self._rows = rows

    def scanner(self, *, columns: Sequence[str], filter: Any = None, **options: Any) -> ds.Scanner:
        """Returns what reads some columns, as a dataset of Arrow does."""
        words = set(columns)
        if filter is not None:  # its columns are some of these words
            words.update(re.findall(r"\w+", str(filter)))
        chosen = [name for name in self.schema.names if name in words] or self.schema.names[:1]
        schema = pa.schema([self.schema.field(name) for name in chosen])
        batches = (batch for rows in self._rows(chosen) for batch in rows.cast(schema).to_batches())
        options |= {"columns": list(columns), "filter": filter, "use_threads": False}
        return ds.Scanner.from_batches(batches, schema=schema, **options)


@dataclass(frozen=True)
class BatchedEpisode:
    """An episode of a batch."""

    offset: int  # is added to the numbers of its ticks
    ticks: pa.Table  # the rows of its ticks: `tick`, without the offset, `time` and `wall_time`
    files: Mapping[str, Sequence[BatchedFile]]  # the files of its parts, by table

    @cached_property
    def numbers(self) -> npt.NDArray[np.int64]:
        """The numbers of its ticks in the batch, (n,)."""
        numbers: npt.NDArray[np.int64] = self.ticks["tick"].to_numpy() + self.offset
        return numbers

    @cached_property
    def times(self) -> Array:
        """Their simulated times, s, (n,)."""
        times: Array = self.ticks["time"].to_numpy()
        return times


class DamagedEpisodeError(RecordError):
    """A file of an episode of a batch is missing or damaged."""

    def __init__(self, message: str, index: int) -> None:
        super().__init__(message)
        self.index = index  # the index of the episode


class EpisodeBatch(TickArchive):
    """The ticks of episodes with the same entities and tables."""

    def __init__(
        self,
        recording: Recording,
        tables: Sequence[str],
        models: Mapping[str, pa.Table],
        run: int,
        connection: StoreConnection,
        register: Callable[[str, PartsDataset], None],
    ) -> None:
        self.parts = ReadParts()  # the parts of the batch being asked
        self.recording = recording
        self.tables = tuple(tables)
        self._run = run
        self._models = models
        self._linked = multi_link_bodies(models["entities"])
        self._connection, self._register = connection, register
        self._episodes: Sequence[BatchedEpisode] = ()
        self._starts = np.zeros(0, dtype=np.int64)
        # The tables that SQL or Python has read: their files are checked when a batch is loaded.
        self._read: set[str] = {"entities"}
        self._shown = range(0)
        # The columns that were read of all rows of the batch, by table.
        self._whole: dict[str, dict[str, pa.ChunkedArray]] = {}

    def load(self, episodes: Sequence[BatchedEpisode]) -> None:
        """Replaces the episodes."""
        self._episodes = episodes
        self._whole.clear()
        self._starts = np.array([episode.numbers[0] for episode in episodes], dtype=np.int64)
        for table in sorted(self._read):
            self._check(table)
        self.show(0, len(episodes))

    def show(self, first: int, end: int) -> None:
        """Lets SQL see the episodes from `first` to `end - 1` only."""
        self._shown = range(first, end)

    def _check(self, table: str) -> None:
        for index, episode in enumerate(self._episodes):
            for number in range(len(episode.files[table])):
                self._part(table, number, index)

    def _part(self, table: str, number: int, index: int) -> ReadPart:
        """Returns a part of an episode, whose bytes are right."""
        file = self._episodes[index].files[table][number]
        try:
            return self.parts.read(file)
        except RecordError as error:
            raise DamagedEpisodeError(error.message, index) from error
        except (OSError, pa.ArrowException) as error:
            raise DamagedEpisodeError(f"{file.path} cannot be read: {error}", index) from error

    def forget(self) -> None:
        """Forgets the rows of the batch, which is not asked any more."""
        self.parts.clear()
        self._whole.clear()

    # -- SQL --------------------------------------------------------------------------------

    def select(self, table: str, buffer_views: BufferViews | None) -> str | None:  # noqa: ARG002
        """Returns the SELECT of the view of a table's history; None if it is not recorded."""
        if table not in self.tables:
            return None
        if table not in self._read:
            self._read.add(table)
            self._check(table)
        self._register(_rows_name(table), self._dataset(table, lambda: self._shown))
        columns = ", ".join(quoted(column.name) for column in TABLES[table].columns)
        return f"SELECT {columns} FROM {quoted(_rows_name(table))}"  # noqa: S608

    def _dataset(self, table: str, indices: Callable[[], range]) -> PartsDataset:
        """Returns the rows of a table in episodes, whose indices are asked when they are read."""
        schema = pa.schema(
            {column.name: ARROW_TYPES[column.type] for column in TABLES[table].columns}
        )
        return PartsDataset(schema, lambda columns: self._rows_of(table, indices(), columns))

    def _rows_of(self, table: str, indices: range, columns: Sequence[str]) -> Iterator[pa.Table]:
        """Yields the rows of episodes: all at once if their parts are kept, or part by part."""
        files = [episode.files[table] for episode in self._episodes]
        if not all(file in self.parts for own in files for file in own):
            yield from map(with_nulls, self._pieces(table, indices, columns))
            return
        whole = self._whole.setdefault(table, {})
        missing = [name for name in columns if name not in whole]
        if missing:  # the same for all statements of a batch
            pieces = self._pieces(table, range(len(files)), missing)
            rows = with_nulls(pa.concat_tables(pieces).combine_chunks())
            whole.update(zip(missing, rows.columns, strict=True))
        counts = [sum(self.parts.read(file).row_count for file in own) for own in files]
        first, end = sum(counts[: indices.start]), sum(counts[: indices.stop])
        yield pa.table({name: whole[name] for name in columns}).slice(first, end - first)

    def _pieces(self, table: str, indices: range, columns: Sequence[str]) -> Iterator[pa.Table]:
        """Yields the rows of each part of episodes; the errors are those of `_rows_of`."""
        stored = [name for name in columns if name != RUN]
        for index in indices:
            for number in range(len(self._episodes[index].files[table])):
                rows = self._part(table, number, index).rows(stored)
                yield self._in_batch(rows, self._episodes[index].offset, columns)

    def _in_batch(self, rows: pa.Table, offset: int, columns: Sequence[str]) -> pa.Table:
        """Returns rows of an episode with the numbers that ticks and the run have in the batch."""
        own = {}
        if "tick" in columns:
            own["tick"] = pa.array(rows["tick"].to_numpy() + offset)
        if RUN in columns:
            own[RUN] = pa.array(np.full(len(rows), self._run, dtype=np.int64))
        return pa.table({name: own[name] if name in own else rows[name] for name in columns})

    def models(self) -> dict[str, str]:
        """Returns the SELECT of the view of each model, by the name of the view."""
        # They are registered with the connection, as tables in memory.
        return {
            table.model_view: f"SELECT * FROM {quoted(model_table(table.name))}"  # noqa: S608
            for table in MODELS.values()
        }

    def model_rows(self) -> Mapping[str, pa.Table]:
        """Returns the rows of each model, by the name of its table."""
        return self._models

    # -- rows -------------------------------------------------------------------------------

    def fetch(self, table: str, first: int, last: int) -> pa.Table:
        """Returns the rows of a table at the ticks from first to last."""
        types = arrow_types(table)
        if table == "links" and not len(self._linked):
            return types.empty_table()
        begin = max(int(np.searchsorted(self._starts, first, side="right")) - 1, 0)
        end = int(np.searchsorted(self._starts, last, side="right"))
        parts = (
            [
                _moved(e.ticks.select(types.names), types, e.offset, first, last)
                for e in self._episodes[begin:end]
            ]
            if table == "ticks"
            else [
                _moved(part.rows(types.names), types, episode.offset, first, last)
                for index, episode in enumerate(self._episodes[begin:end], begin)
                for number in range(len(episode.files[table]))
                for part in [self._part(table, number, index)]
            ]
        )
        rows = parts[0] if len(parts) == 1 else pa.concat_tables([types.empty_table(), *parts])
        if table == "links":  # the rows of bodies with one link repeat the pose of the body
            rows = rows.filter(pa.array(np.isin(rows["entity"].to_numpy(), self._linked)))
        return rows

    def near_pairs(self, request: PairRequest, buffered: pa.Table | None) -> pa.Table:  # noqa: ARG002
        """Returns the pairs of entities whose boxes are near at a tick, or unknown."""
        begin = max(int(np.searchsorted(self._starts, request.first, side="right")) - 1, 0)
        end = int(np.searchsorted(self._starts, request.last, side="right"))
        rows = self._dataset("entities", lambda: range(begin, end))
        return near_pair_rows(self._connection, None, request, rows)


def model_table(table: str) -> str:
    """Returns the name under which the rows of a model are registered with the connection."""
    return f"batch: {table} model"


def _rows_name(table: str) -> str:
    """Returns the name under which the rows of a table are registered with the connection."""
    return f"batch: {table}"


def _moved(rows: pa.Table, types: pa.Schema, offset: int, first: int, last: int) -> pa.Table:
    """Returns the rows of some ticks, their numbers moved by an offset."""
    ticks = rows["tick"].to_numpy() + offset
    if (np.diff(ticks) < 0).any():
        chosen = (ticks >= first) & (ticks <= last)
        rows, ticks = rows.filter(pa.array(chosen)), ticks[chosen]
    else:
        start, end = np.searchsorted(ticks, [first, last + 1]).tolist()
        rows, ticks = rows.slice(start, end - start), ticks[start:end]
    place = rows.column_names.index("tick")
    rows = rows.set_column(place, types.field("tick"), pa.array(ticks))
    return rows if rows.schema.equals(types) else rows.cast(types)
