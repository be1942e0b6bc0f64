"""The parts of models, which are compared by their bytes, or by their rows."""

from __future__ import annotations

import base64
import re
import zlib
from dataclasses import dataclass
from functools import cached_property

import pyarrow as pa
import pyarrow.parquet as pq

from ssduck.recording.stores.batched_parts import BatchedFile, ReadPart
from ssduck.recording.stores.checksums import footer_in, with_footer_sums

# The Arrow schema in a footer, in base64: it begins with four bytes of ones.
_SCHEMA = re.compile(rb"ARROW:schema.{1,6}?(/////[A-Za-z0-9+/]+=*)", re.DOTALL)
# The number of a run from which on its bytes are hardly those of anything else.
_LEAST_RUN = 1 << 40


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
        """Checks from the bytes of a part whether it is this one with another label and run.

        One that was written otherwise may have the same rows, too: see `is_like`.

        Args:
            content: the bytes.
            label: the label of the part.
        """
        if self._footer is None or len(content) != len(self.content):
            return False
        if len(label) != len(self.file.label):
            return False
        data, footer = self._footer.data, self._footer.with_label(label)
        if content == data + with_footer_sums(footer, self._footer.data_sum):
            return True
        if self._run is None:
            return False
        other = self._run.number_in(content)
        changed = self._run.with_number(data, other)
        return content == changed + with_footer_sums(footer, zlib.crc32(changed))

    def is_like(self, other: ModelPart) -> bool:
        """Checks whether another part has the same rows, but for the number of the run."""
        if self._has_columns_of(other):
            return True
        return bool(_without_run(self._part.rows()).equals(_without_run(other._part.rows())))

    def _has_columns_of(self, other: ModelPart) -> bool:
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
    def _run(self) -> _RunBytes | None:
        """Where the number of the run is in the bytes; None if that is not known."""
        return None if self._footer is None else _run_bytes(self._part, self._footer)

    @cached_property
    def _part(self) -> ReadPart:
        return ReadPart(self.file, self.content)


@dataclass(frozen=True)
class _Footer:
    """The bytes of a part before its footer, and the footer.

    Attributes:
        data: the bytes before it.
        content: its bytes.
        label: the label in it.
        schema: the schema of Arrow in it, decoded, which has the label, too.
        place: where the schema begins.
    """

    data: bytes
    content: bytes
    label: bytes
    schema: bytes
    place: int

    @cached_property
    def data_sum(self) -> int:
        """The CRC-32 of the bytes before the footer."""
        return zlib.crc32(self.data)

    def with_label(self, label: bytes) -> bytes:
        """Returns the footer with another label of the same length, and wrong checksums."""
        changed = self.content.replace(self.label, label)
        columns = base64.b64encode(self.schema.replace(self.label, label))
        return changed[: self.place] + columns + changed[self.place + len(columns) :]


@dataclass(frozen=True)
class _RunBytes:
    """The column of the run, the last one, whose dictionary has one number.

    Attributes:
        number: the number, 8 bytes.
        start: where the column begins in the part.
        place: where the number stands first in the part.
        page: where what the dictionary's page has after its header begins and ends.
        checksum: the checksum of that in the header.
    """

    number: bytes
    start: int
    place: int
    page: slice
    checksum: bytes

    def number_in(self, content: bytes) -> bytes:
        """Returns the number that another part has in its place."""
        return content[self.place : self.place + len(self.number)]

    def with_number(self, data: bytes, number: bytes) -> bytes:
        """Returns the bytes before the footer with another number."""
        page = data[self.page].replace(self.number, number)
        header = data[self.start : self.page.start]
        header = header.replace(self.checksum, _page_checksum(page))
        rest = data[self.page.stop :].replace(self.number, number)
        return data[: self.start] + header + page + rest


def _run_bytes(part: ReadPart, footer: _Footer) -> _RunBytes | None:
    """Returns where a part has the number of its run; None unless it is written as ssduck does."""
    metadata, value = part.parquet.metadata, _only_run(part)
    if value is None or metadata.num_row_groups != 1 or part.parquet.schema.names[-1] != "run":
        return None
    number = value.to_bytes(8, "little")
    column = metadata.row_group(0).column(metadata.num_columns - 1)
    start, end = column.dictionary_page_offset, column.data_page_offset
    data, content = footer.data, footer.content
    place = -1 if start is None else data.find(number, start, end)
    if place < 0 or number in content:  # in the footer, it may stand for something else
        return None
    for begin in range(start, place + 1):  # the header is a few bytes, of unknown length
        checksum = _page_checksum(data[begin:end])
        if data.count(checksum, start, begin) == 1:
            return _RunBytes(number, start, place, slice(begin, end), checksum)
    return None


def _only_run(part: ReadPart) -> int | None:
    """Returns the number of the run of all rows; None if it may be the bytes of anything else."""
    numbers = part.rows(["run"])["run"].unique().to_pylist()
    is_one = len(numbers) == 1 and isinstance(numbers[0], int) and numbers[0] >= _LEAST_RUN
    return numbers[0] if is_one else None


def _page_checksum(page: bytes) -> bytes:
    """Returns the CRC-32 of a page as its header has it: a signed number, zigzag, in sevens."""
    checksum = zlib.crc32(page)
    rest = (checksum << 1 if checksum < 1 << 31 else ~(checksum << 1)) & 0xFFFFFFFF
    digits = bytearray()
    while rest > 0x7F:
        digits.append(rest & 0x7F | 0x80)
        rest >>= 7
    return bytes((*digits, rest))


def _first_byte(column: pq.ColumnChunkMetaData) -> int:
    """Returns where the bytes of a column begin in its file."""
    places = (column.dictionary_page_offset, column.data_page_offset)
    first: int = min(place for place in places if place is not None)
    return first


def _without_run(rows: pa.Table) -> pa.Table:
    return rows.drop_columns(["run"]) if "run" in rows.column_names else rows
