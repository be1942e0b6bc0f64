"""Chunks of an MCAP file in each compression are read, and a message that is no pose is an error."""

import pytest

import ssduck
from ssduck.errors import RecordError

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra mcap is not installed")

PLAIN = {"parent_frame_id": "map", "child_frame_id": "cup", "rotation": {"w": 1.0}}


def write(file, *transforms, compression="ZSTD", **about):
    """Writes poses of frames, one a second."""
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from mcap.writer import CompressionType, Writer
    from mcap_protobuf.schema import register_schema

    with file.open("wb") as stream:
        writer = Writer(stream, compression=getattr(CompressionType, compression))
        writer.start()
        schema = register_schema(writer, FrameTransform)
        channel = writer.register_channel("/tf", "protobuf", schema)
        if about:
            writer.add_metadata("ssduck", about)
        for second, transform in enumerate(transforms):
            moved = FrameTransform(**transform)
            moved.timestamp.seconds = second
            writer.add_message(channel, second, moved.SerializeToString(), second)
        writer.finish()
    return file


@pytest.mark.filterwarnings("ignore:.*tells of poses")
@pytest.mark.parametrize("compression", ["ZSTD", "LZ4", "NONE"])
def test_poses_in_chunks_are_read(tmp_path, compression):
    file = write(tmp_path / "a.mcap", *[PLAIN] * 3, compression=compression)
    (episode,) = ssduck.import_poses(file, tmp_path / "r")
    assert episode.ticks == 3


@pytest.mark.parametrize(
    ("change", "about", "message"),
    [
        ({"rotation": {}}, {}, "the quaternion 0, 0, 0, 0"),
        ({"child_frame_id": ""}, {}, "a frame without a name"),
        ({"child_frame_id": "a\x07"}, {}, "'a\\\\x07'"),
        ({}, {"world": '"Memory"'}, "a world cannot have the name 'Memory'"),
    ],
)
def test_a_message_that_is_no_pose_is_an_error_of_the_file(tmp_path, change, about, message):
    file = write(tmp_path / "a.mcap", PLAIN | change, **about)
    with pytest.raises(RecordError, match=f"a.mcap.*{message}"):
        ssduck.import_poses(file, tmp_path / "r")
    assert not (tmp_path / "r").exists()
