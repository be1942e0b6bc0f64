"""Reads the records of an MCAP file, whose chunks may claim to be far larger than the file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from ssduck.errors import RecordError

# The largest size of a chunk, bytes: writers make them of some megabytes.
MAX_CHUNK = 1 << 26
# All chunks of a file have at most so many bytes, and so many for each byte of the file.
MAX_SMALL, MAX_RATIO = 1 << 24, 100


def records_of(file: Path) -> Iterator[Any]:
    """Yields the records of a file, those in its chunks, too, in their order.

    Raises:
        RecordError: chunks are larger than `MAX_CHUNK`, or than the file can have.
        Exception: the file is damaged, as the library says it.
    """
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    size = file.stat().st_size
    left = MAX_SMALL + MAX_RATIO * size
    with file.open("rb") as stream:
        reader = StreamReader(stream, emit_chunks=True, validate_crcs=True, record_size_limit=size)
        for record in reader.records:
            if not isinstance(record, Chunk):
                yield record
                continue
            largest = min(left, MAX_CHUNK)
            if record.uncompressed_size > largest:
                raise RecordError(
                    f"{file} has a chunk of {record.uncompressed_size:,} bytes: ssduck reads "
                    f"chunks of {MAX_CHUNK:,} bytes, and {MAX_RATIO} times the size of the file in "
                    "all"
                )
            left -= record.uncompressed_size
            data = _decompressed(record)
            yield from breakup_chunk(replace(record, compression="", data=data), validate_crc=True)


def _decompressed(chunk: Any) -> bytes:
    """Returns the bytes of a chunk, which are no more than it says.

    Raises:
        ValueError: they are not as many, or of an unknown compression.
    """
    match chunk.compression:
        case "":
            data: bytes = chunk.data
        case "zstd":
            data = _from_zstd(chunk.data, chunk.uncompressed_size)
        case "lz4":
            from lz4.frame import LZ4FrameDecompressor

            data = LZ4FrameDecompressor().decompress(chunk.data, chunk.uncompressed_size + 1)
        case other:
            raise ValueError(f"a chunk has the unknown compression {other!r}")
    if len(data) != chunk.uncompressed_size:
        raise ValueError(f"a chunk has not the {chunk.uncompressed_size} bytes that it says")
    return data


def _from_zstd(data: bytes, size: int) -> bytes:
    import zstandard

    told = zstandard.get_frame_parameters(data).content_size
    if told not in (size, 0, zstandard.CONTENTSIZE_UNKNOWN):
        raise ValueError(f"a chunk has not the {size} bytes that it says")
    result: bytes = zstandard.decompress(data, max_output_size=size)
    return result
