"""An MCAP file of some kilobytes whose chunks are far larger is an error before it is read."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path

import pytest

import ssduck
from ssduck.errors import RecordError

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra mcap is not installed")

COMPRESSIONS = ["ZSTD", "LZ4", "NONE"]


def write(file: Path, compression: str, name: str, count: int = 3) -> int:
    """Writes poses of a frame; returns the size of the chunk that has them."""
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer
    from mcap_protobuf.schema import build_file_descriptor_set

    with file.open("wb") as stream:
        kind = getattr(CompressionType, compression)
        writer = Writer(stream, compression=kind, chunk_size=1 << 30)
        writer.start()
        schema = build_file_descriptor_set(FrameTransform).SerializeToString()
        number = writer.register_schema("foxglove.FrameTransform", "protobuf", schema)
        channel = writer.register_channel("/tf", "protobuf", number)
        for second in range(count):
            moved = FrameTransform(parent_frame_id="map", child_frame_id=name)
            moved.timestamp.seconds, moved.rotation.w = second, 1.0
            writer.add_message(channel, second, moved.SerializeToString(), second)
        writer.finish()
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        (chunk,) = summary.chunk_indexes
        return chunk.uncompressed_size


@pytest.mark.filterwarnings("ignore:.*tells of poses")
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_poses_in_chunks_are_read(tmp_path: Path, compression: str) -> None:
    write(tmp_path / "a.mcap", compression, "hand")
    (episode,) = ssduck.import_poses(tmp_path / "a.mcap", tmp_path / "r")
    assert episode.ticks == 3


@pytest.mark.parametrize("compression", COMPRESSIONS[:2])
def test_a_chunk_that_is_far_larger_than_its_file_is_not_read(
    tmp_path: Path, compression: str
) -> None:
    file = tmp_path / "a.mcap"
    size = write(file, compression, "a" * 30_000_000, count=2)
    assert size > 100 * file.stat().st_size
    tracemalloc.start()
    try:
        with pytest.raises(RecordError, match=f"has a chunk of {size:,} bytes"):
            ssduck.import_poses(file, tmp_path / "r")
        assert tracemalloc.get_traced_memory()[1] < size / 4
    finally:
        tracemalloc.stop()
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize("claim", [10, 10_000])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_chunk_of_another_size_than_it_says_is_an_error(
    tmp_path: Path, compression: str, claim: int
) -> None:
    file = tmp_path / "a.mcap"
    told = struct.pack("<Q", write(file, compression, "hand"))
    content = file.read_bytes()
    assert told in content
    file.write_bytes(content.replace(told, struct.pack("<Q", claim)))
    with pytest.raises(RecordError, match="cannot be read as an MCAP file"):
        ssduck.import_poses(file, tmp_path / "r")
