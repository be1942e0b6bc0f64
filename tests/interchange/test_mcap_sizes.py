"""An MCAP file of some kilobytes whose chunks are far larger is an error before it is read."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Mapping
from pathlib import Path
from typing import Any

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


@pytest.mark.slow
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


def forged(file: Path, transform: Any, kinds: Mapping[str, int], **metadata: str) -> Path:
    """Writes a message whose schema, which a file brings itself, has other types of fields."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from mcap.writer import Writer

    field = descriptor_pb2.FieldDescriptorProto
    own = descriptor_pb2.FileDescriptorProto(name="a.proto", package="foxglove", syntax="proto3")

    def add(name: str, **fields: Any) -> None:
        message = own.message_type.add(name=name)
        for number, (key, kind) in enumerate(fields.items(), 1):
            many = field.LABEL_REPEATED if key == "transforms" else field.LABEL_OPTIONAL
            one = message.field.add(name=key, number=number, label=many)
            if isinstance(kind, str):
                one.type, one.type_name = field.TYPE_MESSAGE, f".foxglove.{kind}"
            else:
                one.type = kinds.get(key, kind)

    add("Stamp", seconds=field.TYPE_INT64, nanos=field.TYPE_INT64)
    add("Vector", **dict.fromkeys("xyzw", field.TYPE_DOUBLE))
    names = dict.fromkeys(("parent_frame_id", "child_frame_id"), field.TYPE_STRING)
    add("FrameTransform", timestamp="Stamp", **names, translation="Vector", rotation="Vector")
    add("FrameTransforms", transforms="FrameTransform")
    files, pool = descriptor_pb2.FileDescriptorSet(file=[own]), descriptor_pool.DescriptorPool()
    pool.Add(own)
    kind = pool.FindMessageTypeByName("foxglove.FrameTransforms")
    message = message_factory.GetMessageClass(kind)(**transform)
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = "foxglove.FrameTransforms", "protobuf", files.SerializeToString()
        channel = writer.register_channel("/tf", "protobuf", writer.register_schema(*schema))
        if metadata:
            writer.add_metadata("ssduck", metadata)
        writer.add_message(channel, 0, message.SerializeToString(), 0)
        writer.finish()
    return file


PLAIN = {"parent_frame_id": "map", "child_frame_id": "cup", "rotation": {"w": 1.0}}
TEXT, BOOL = 9, 8  # of FieldDescriptorProto
FORGED = {
    "a text of seconds": ({"timestamp": {"seconds": "ab"}}, {"seconds": TEXT}, {}, "the time 'ab'"),
    "a text of nanoseconds": ({"timestamp": {"nanos": "7"}}, {"nanos": TEXT}, {}, "the time '7'"),
    "a text of a number": ({"translation": {"x": "9"}}, dict.fromkeys("xyzw", TEXT), {}, "has '9'"),
    "true for a number": ({"rotation": {"w": True}}, dict.fromkeys("xyzw", BOOL), {}, "has False"),
    "no orientation": ({"rotation": {}}, {}, {}, "the quaternion 0, 0, 0, 0"),
    "no name": ({"child_frame_id": ""}, {}, {}, "a frame without a name"),
    "a control character": ({"child_frame_id": "a\x07"}, {}, {}, "'a\\\\x07'"),
    "DuckDB's name": ({}, {}, {"world": '"Memory"'}, "a world cannot have the name 'Memory'"),
}


@pytest.mark.parametrize("name", FORGED)
def test_a_message_that_is_no_pose_is_an_error_of_the_file(tmp_path: Path, name: str) -> None:
    change, kinds, metadata, message = FORGED[name]
    if "rotation" not in change and kinds.get("w") == TEXT:
        change = change | {"rotation": {"w": "1"}}
    transform = {"transforms": [PLAIN | change]}
    file = forged(tmp_path / "a.mcap", transform, kinds, **metadata)
    with pytest.raises(RecordError, match=f"a.mcap.*{message}"):
        ssduck.import_poses(file, tmp_path / "r")
    assert not (tmp_path / "r").exists()


@pytest.mark.slow
def test_many_empty_messages_are_not_kept(tmp_path: Path) -> None:
    transforms: dict[str, Any] = {"transforms": [{}] * 300_000}
    file = forged(tmp_path / "a.mcap", transforms, {})
    tracemalloc.start()
    try:
        with pytest.raises(RecordError, match="a frame without a name"):
            ssduck.import_poses(file, tmp_path / "r")
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()
