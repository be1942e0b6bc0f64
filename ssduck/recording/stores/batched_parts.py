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
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from ssduck.errors import RecordError
from ssduck.recording.stores.object_store import ObjectPath, is_address
from ssduck.recording.stores.stored_columns import checked_parquet, part_columns

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
    """A file of a part.

    Attributes:
        path: where it is.
        checksum: the CRC-32 of its bytes.
        table: its table, or `models/<table>`.
    """

    path: str
    checksum: int
    table: str

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
