"""The parts that a batch of episodes is read from: their bytes are read once, checked and decoded.

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
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from ssduck.errors import RecordError
from ssduck.recording.buffers import TickBuffer
from ssduck.recording.static_tables import join_model
from ssduck.recording.stores.base import RowBlock
from ssduck.recording.stores.checksums import footer_in, size_problem
from ssduck.recording.stores.object_store import ObjectPath, is_address
from ssduck.recording.stores.parquet_layout import OTHER_PART
from ssduck.recording.stores.row_checks import RowChecks, key_types, other_model, repeated_columns
from ssduck.recording.stores.stored_columns import checked_parquet, part_columns
from ssduck.schema import TABLES

# The largest number of bytes of the parts of a batch, as they are and decoded, and that of the
# columns that are kept for the next question.
MOST_READ = 1 << 27
MOST_KEPT = 1 << 26
_VALUE_BYTES = 8
# The column in which the parts have the number of the run.
RUN = "run"
# Columns by name.
Columns: TypeAlias = dict[str, pa.ChunkedArray]


def ticks_of_parts(starts: Sequence[int], last: int) -> list[tuple[int, int]]:
    """Returns the first and the last tick of each part."""
    return list(zip(starts, [*(start - 1 for start in starts[1:]), last], strict=True))


@dataclass(frozen=True)
class BatchedFile:
    """A file of a part.

    Attributes:
        path: where it is.
        checksum: the CRC-32 of its bytes.
        label: what its footer has to tell it from other parts.
        table: its table, or `models/<table>`.
    """

    path: str
    checksum: int
    label: bytes
    table: str

    def content(self) -> memoryview:
        """Returns the bytes of the file."""
        if is_address(self.path):
            content = memoryview(ObjectPath(self.path).read_bytes())
        else:
            content = _content(self.path)
        if zlib.crc32(content) != self.checksum:
            raise RecordError(f"{self.path} was changed or damaged since the manifest was made")
        if self.label not in bytes(footer_in(content)):
            raise RecordError(f"{self.path} {OTHER_PART}")
        return content


def _content(path: str) -> memoryview:
    """Returns the bytes of a file of this machine."""
    with open(path, "rb", buffering=0) as file:  # noqa: PTH123  # faster than a Path
        size = os.fstat(file.fileno()).st_size
        if (problem := size_problem(path, size)) is not None:
            raise RecordError(f"{path} {problem}")
        # Arrow uses its memory again: new pages take longer to clear than a part to read.
        content = memoryview(pa.allocate_buffer(size)).cast("B")
        end = 0
        while end < size and (count := file.readinto(content[end:])):
            end += count
    return content[:end]


@dataclass(frozen=True, eq=False)
class ReadPart:
    """A part whose bytes were read and checked.

    Attributes:
        file: the file.
        content: its bytes.
        columns: those that were decoded.
    """

    file: BatchedFile
    content: bytes | memoryview
    columns: Columns = field(default_factory=dict)

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

    def keys(self) -> pa.Table:
        """Returns the columns of the rows that are checked."""
        return self.rows(key_types(self.file.table).names)

    def check(self, checks: RowChecks, ticks: TickBuffer, between: tuple[int, int]) -> None:
        """Checks the rows, except that the bodies with parts are those that are there."""
        block = RowBlock(*between, self.keys())
        self.require(checks.problem_of_block(self.file.table, block, ticks))

    def require(self, problem: str | None) -> None:
        """Raises a RecordError if there is a problem with the rows."""
        if problem is not None:
            about = f"of the rows of {self.file.table}, {problem}"
            raise RecordError(f"{self.file.path} is damaged: {about}")


class RepeatedColumns:
    """Checks what the rows of parts repeat of the models of their group."""

    def __init__(self, models: Mapping[str, pa.Table]) -> None:
        self._models = models
        # The last rows that were right, by table and columns: most episodes have equal ones.
        self._right: dict[tuple[str, tuple[str, ...]], pa.Table] = {}

    def check(self, part: ReadPart, names: Sequence[str]) -> None:
        """Checks what the rows of a part repeat, but for the number of the run.

        Args:
            part: the part.
            names: the columns to check; others than those that repeat something are passed over.
        """
        table = part.file.table
        chosen = tuple(name for name in repeated_columns(table) if name in names and name != RUN)
        if not chosen:
            return
        model, rows = self._models[table], part.rows([*TABLES[table].key, *chosen])
        right = self._right.get((table, chosen))
        if right is not None and rows.equals(right):
            return
        expected = join_model(table, rows.select(TABLES[table].key), model, chosen)
        if not rows.select(chosen).equals(expected):  # or a number is NaN, which equals nothing
            part.require(other_model(table, rows, model))
        self._right[table, chosen] = rows


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
