"""Recordings: written by one library and read by others, bags of ROS 1 and 2, damaged files, missing topics."""

import bz2
import sqlite3
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory
from message_helpers import missing, naming
from recording_helpers import S, write_bag
from rosbags.rosbag2 import Writer as Writer2
from rosbags.rosbag2.reader import zstd
from rosbags.typesys import Stores, get_typestore

from tactile_loc.core.geometry.rigid import make_transform, rotation_about
from tactile_loc.core.runtime.errors import MissingLibraryError, OutputError, RecordingError
from tactile_loc.core.runtime.limits import TooLargeError
from tactile_loc.io.streams.recordings import (
    Message,
    Recording,
    RecordingWriter,
    choose_image_topic,
    limit_unpacking,
    write_recording,
)
from tactile_loc.io.streams.ros_messages import (
    IMAGE,
    POSE,
    TF,
    RosPose,
    decode_image,
    encode,
    make_image,
    make_pose,
    make_topic,
    make_transforms,
    read_pose,
    read_stamp_ns,
)

T = make_transform(rotation_about([1, 2, 3], 0.7), [0.1, -0.2, 0.3])
IMAGES = np.random.default_rng(0).integers(0, 256, (6, 30, 40, 3), np.uint8)


def fill(writer: RecordingWriter) -> None:
    """Six images, a transform before each, and a pose after."""
    writer.write("/tf_static", TF, make_transforms({("flange", "gel"): T}, 0), 0)
    for k, image in enumerate(IMAGES):
        writer.write("/tf", TF, make_transforms({("base", "flange"): T}, k * S), k * S)
        writer.write("/gel/image", IMAGE, make_image(image, "rgb8", k * S + 7, "gel"), k * S + 9)
        pose = RosPose.of(T, np.diag(np.arange(1.0, 7.0)))
        writer.write("/object/pose", POSE, make_pose(pose, k * S + 7, "gel"), k * S + 9)


@pytest.fixture
def recorded(tmp_path) -> Path:
    return write_recording(tmp_path / "drive.mcap", fill)


def in_chunks(path: Path, compression: CompressionType, chunk: int) -> Path:
    """The same images, in small chunks."""
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, chunk_size=chunk, use_chunking=chunk > 0)
        writer.start()
        topic = make_topic("/gel/image", IMAGE)
        schema = writer.register_schema(IMAGE, "ros2msg", topic.definition)
        channel = writer.register_channel(topic.name, "cdr", schema)
        store = get_typestore(Stores.ROS2_HUMBLE)
        for k, image in enumerate(IMAGES):
            data = store.serialize_cdr(make_image(image, "rgb8", k, "gel"), IMAGE)
            writer.add_message(channel, k, bytes(data), k)
        writer.finish()
    return path


def test_another_library_reads_a_written_recording(recorded):
    with recorded.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [(m.channel.topic, m.message.log_time, m.decoded_message) for m in reader.iter_decoded_messages()]
        assert reader.get_summary().statistics.message_count == 19
    images = [(time, message) for topic, time, message in found if topic == "/gel/image"]
    for k, (time, message) in enumerate(images):
        assert (time, read_stamp_ns(message.header), message.header.frame_id) == (k * S + 9, k * S + 7, "gel")
        np.testing.assert_array_equal(decode_image(message), IMAGES[k])
    pose = next(message for topic, _, message in found if topic == "/object/pose")
    np.testing.assert_allclose(read_pose(pose).T, T, atol=1e-12)
    assert list(pose.pose.covariance)[::7] == [1, 2, 3, 4, 5, 6]


def test_a_written_recording_is_read_back(recorded):
    recording = Recording(recorded)
    contents = recording.read_contents()
    counts = {topic.name: count for topic, count in contents.counts.items()}
    assert counts == {"/tf_static": 1, "/tf": 6, "/gel/image": 6, "/object/pose": 6}
    assert choose_image_topic(contents, recorded, None).name == "/gel/image"
    for k, message in enumerate(recording.read_messages("/gel/image")):
        assert message.log_time_ns == k * S + 9
        np.testing.assert_array_equal(decode_image(message.decode()), IMAGES[k])
    np.testing.assert_allclose(recording.read_frame_tree().look_up("base", "gel", S), T @ T, atol=1e-12)
    assert recording.damage == ""


def test_a_copy_has_the_same_messages_and_attachments(recorded, tmp_path):
    with recorded.open("rb") as file:
        before = [(m.topic, c.data) for _, m, c in make_reader(file).iter_messages()]
    noted = tmp_path / "noted.mcap"
    with noted.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_attachment(1, 2, "mount.toml", "text/plain", b"xyz")
        writer.add_metadata("robot", {"arm": "left"})
        writer.finish()

    def copy(writer: RecordingWriter) -> None:
        for message in Recording(recorded).read_messages():
            writer.copy(message)
        for extra in Recording(noted).read_extras():
            writer.copy_extra(extra)

    copied = write_recording(tmp_path / "copy.mcap", copy)
    with copied.open("rb") as file:
        reader = make_reader(file)
        assert [(m.topic, c.data) for _, m, c in reader.iter_messages()] == before
        assert [a.data for a in reader.iter_attachments()] == [b"xyz"]
        assert [m.metadata for m in reader.iter_metadata()] == [{"arm": "left"}]


@pytest.mark.parametrize("kind", ["ros1", "sqlite", "packed", "mcap"])
def test_bags_are_read(tmp_path, kind):
    path = write_bag(tmp_path / ("drive.bag" if kind == "ros1" else "drive"), IMAGES, kind)
    recording = Recording(path)
    ((topic, count),) = recording.read_contents().counts.items()
    assert (topic.name, topic.type, count) == ("/gel/image", IMAGE, 6)
    for k, found in enumerate(recording.read_messages()):
        message = found.decode()
        assert (found.log_time_ns, read_stamp_ns(message.header)) == (k * S + 9, k * S + 7)
        np.testing.assert_array_equal(decode_image(message), IMAGES[k])


def test_a_message_in_sqlite_above_the_limit_is_refused(tmp_path, monkeypatch):
    path = write_bag(tmp_path / "drive", IMAGES)
    monkeypatch.setattr("tactile_loc.io.streams.recordings.MOST_PART_BYTES", IMAGES[0].nbytes)
    with pytest.raises(RecordingError):
        list(Recording(path).read_messages())


def test_bags_without_definitions_are_read(tmp_path):
    """ROS 2 wrote such bags up to Humble."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer2(tmp_path / "drive", version=8) as writer:
        connection = writer.add_connection("/gel/image", IMAGE, typestore=store)
        writer.write(connection, 9, store.serialize_cdr(make_image(IMAGES[0], "rgb8", 7, "gel"), IMAGE))
    with closing(sqlite3.connect(tmp_path / "drive" / "drive.db3")) as database, database:
        database.execute("DROP TABLE message_definitions")
        database.execute("UPDATE schema SET schema_version = 3")
    (message,) = Recording(tmp_path / "drive").read_messages()
    assert message.topic == make_topic("/gel/image", IMAGE)
    np.testing.assert_array_equal(decode_image(message.decode()), IMAGES[0])


def test_two_channels_of_one_topic_count_as_one_topic(tmp_path):
    """Two publishers have different qualities of service."""
    path, topic = tmp_path / "drive.mcap", make_topic("/gel/image", IMAGE)

    def write(writer: RecordingWriter) -> None:
        for k, quality in enumerate(("reliable", "best effort")):
            data = encode(make_image(IMAGES[k], "rgb8", k, "gel"), IMAGE)
            writer.copy(Message(replace(topic, metadata=(("offered_qos_profiles", quality),)), k, k, data))

    contents = Recording(write_recording(path, write)).read_contents()
    assert contents.counts == {topic: 2}
    assert choose_image_topic(contents, path, None) == topic


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
@pytest.mark.parametrize("chunk", [0, 1000])
def test_the_beginning_of_a_truncated_recording_is_read(tmp_path, compression, chunk):
    whole = in_chunks(tmp_path / "whole.mcap", compression, chunk).read_bytes()
    counts = []
    for share in (0.3, 0.6, 0.9):
        (cut := tmp_path / "cut.mcap").write_bytes(whole[: int(share * len(whole))])
        recording = Recording(cut)
        contents = recording.read_contents()
        counts.append(sum(contents.counts.values()))
        assert not missing(contents.damage, counts[-1])
        for k, message in enumerate(recording.read_messages()):
            np.testing.assert_array_equal(decode_image(message.decode()), IMAGES[k])
    assert counts[0] >= 1
    assert counts[0] < counts[1] < counts[2] <= 6


def test_a_damaged_chunk_is_not_read(tmp_path):
    path = in_chunks(tmp_path / "drive.mcap", CompressionType.NONE, 1000)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    recording = Recording(path)
    assert 0 < len(list(recording.read_messages())) < 6
    assert "crc" in recording.damage.lower()


def test_a_file_that_is_not_a_recording_gives_a_one_sentence_error(tmp_path):
    for name in ("text.mcap", "text.bag", "empty.mcap", "touch.npz"):
        (tmp_path / name).write_text("no recording at all" if name.startswith("text") else "")
    (tmp_path / "folder").mkdir()
    with pytest.raises(RecordingError, match=naming(tmp_path / "none.mcap")):
        Recording(tmp_path / "none.mcap").read_contents()
    for name in ("text.mcap", "empty.mcap", "text.bag", "folder", "touch.npz"):
        with pytest.raises(RecordingError, match=naming(tmp_path / name, ".mcap", ".bag")):
            Recording(tmp_path / name).read_contents()


def test_a_recording_without_an_index_is_read_and_one_without_messages_is_called_damaged(recorded):
    whole = recorded.read_bytes()
    recorded.write_bytes(whole[:-20])
    assert Recording(recorded).read_contents().damage == ""
    recorded.write_bytes(whole[:100])
    with pytest.raises(RecordingError, match=naming(recorded, "damaged")) as caught:
        Recording(recorded).read_contents()
    assert ".bag" not in str(caught.value)


def test_a_data_set_of_lerobot_names_its_command(tmp_path):
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text("{}")
    with pytest.raises(RecordingError, match=naming(tmp_path.name, "replay-dataset")):
        Recording(tmp_path)


def test_a_missing_topic_is_refused_with_the_existing_topics(recorded, tmp_path):
    contents = Recording(recorded).read_contents()
    with pytest.raises(RecordingError, match=naming("drive.mcap", "'/gel/image'") + r".*/gel/imag\b"):
        choose_image_topic(contents, recorded, "/gel/imag")

    def two(writer: RecordingWriter) -> None:
        for name in ("/left", "/right"):
            writer.write(name, IMAGE, make_image(IMAGES[0], "rgb8", 0, "gel"), 0)

    several = write_recording(tmp_path / "two.mcap", two)
    with pytest.raises(RecordingError, match=naming("two.mcap", "`image_topic`", "/left", "/right")):
        choose_image_topic(Recording(several).read_contents(), several, None)
    moving = write_recording(tmp_path / "tf.mcap", lambda w: w.write("/tf", TF, make_transforms({}, 0), 0))
    expected = naming("tf.mcap", "sensor_msgs/msg/Image", "/tf (tf2_msgs/msg/TFMessage)")
    with pytest.raises(RecordingError, match=expected):
        choose_image_topic(Recording(moving).read_contents(), moving, None)


def test_messages_of_unknown_encodings_are_refused_when_decoded(tmp_path):
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("sensor_msgs/Image", "protobuf", b"")
        writer.add_message(writer.register_channel("/gel/image", "protobuf", schema), 0, b"1234", 0)
        schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", make_topic("/x", IMAGE).definition)
        writer.add_message(writer.register_channel("/bad", "cdr", schema), 0, b"\0\1\0\0stray bytes", 0)
        writer.finish()
    other, stray = Recording(path).read_messages()
    with pytest.raises(RecordingError, match=naming("/gel/image", "protobuf", "cdr", "ros1")):
        other.decode()
    with pytest.raises(RecordingError, match=naming("/bad", "sensor_msgs/msg/Image")):
        stray.decode()


@pytest.mark.parametrize("library", ["mcap", "rosbags"])
def test_a_missing_library_is_named(recorded, tmp_path, monkeypatch, library):
    monkeypatch.setitem(sys.modules, library, None)
    for use in (lambda: Recording(recorded), lambda: write_recording(tmp_path / "other.mcap", fill)):
        with pytest.raises(MissingLibraryError, match=naming(library, "pip install 'tactile-loc[recordings]'")):
            use()
    assert not (tmp_path / "other.mcap").exists()


def test_a_recording_is_written_whole_or_not_at_all(recorded):
    before = recorded.read_bytes()

    def fail(writer: RecordingWriter) -> None:
        fill(writer)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_recording(recorded, fail)
    assert recorded.read_bytes() == before
    assert [path.name for path in recorded.parent.iterdir()] == ["drive.mcap"]
    with pytest.raises(OutputError):
        write_recording(recorded / "below.mcap", fill)


DATA = np.random.default_rng(0).bytes(5000)


@pytest.mark.parametrize(
    ("pack", "unpack"),
    [(bz2.compress, bz2.decompress), (lz4.frame.compress, lz4.frame.decompress), (zstd.compress, zstd.decompress)],
)
def test_a_chunk_or_message_of_a_bag_is_unpacked_up_to_the_limit(pack, unpack):
    assert limit_unpacking(unpack)(pack(DATA)) == DATA
    assert limit_unpacking(unpack, len(DATA))(pack(DATA)) == DATA
    with pytest.raises(TooLargeError):
        limit_unpacking(unpack, len(DATA) - 1)(pack(DATA))
