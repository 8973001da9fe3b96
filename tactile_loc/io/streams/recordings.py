"""Reads recordings of ROS topics (MCAP files, and bags of ROS 1 and 2), and writes MCAP files, without ROS."""

import bz2
import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import IO, Any

from tactile_loc.core.geometry.frame_tree import FrameTree
from tactile_loc.core.runtime.errors import RecordingError, did_you_mean
from tactile_loc.core.runtime.limits import MOST_PART_BYTES, read_unpacked, require_size
from tactile_loc.io.images import summarize
from tactile_loc.io.streams.ros_messages import (
    CDR,
    IMAGE_TYPES,
    ROS1,
    STATIC,
    TF,
    Topic,
    add_transforms,
    encode,
    find_definition,
    load_types,
    make_topic,
    require_libraries,
)
from tactile_loc.store.files import write_atomically

MCAP_MAGIC, BAG_MAGIC = b"\x89MCAP", b"#ROSBAG"  # first bytes of the formats
DATASETS = "read it with replay-dataset, a command of ./plugins_contrib/tactile-loc-datasets"
FORMATS = "an MCAP file (.mcap), a ROS 1 bag (.bag), or the folder of a ROS 2 bag"


@dataclass(frozen=True, eq=False)
class Message:
    """A message of a recording as bytes, with the times when it was logged and published, ns."""

    topic: Topic
    log_time_ns: int
    publish_time_ns: int
    data: bytes

    def decode(self) -> Any:
        """Return the message as an object. Raises RecordingError when it is damaged or has an unknown encoding."""
        topic = self.topic
        types = load_types(topic.message_encoding)
        if types is None:
            raise RecordingError(
                f"the messages of {topic.name} have the unknown encoding {topic.message_encoding!r}; record them by "
                "ROS 2 (cdr) or ROS 1 (ros1)"
            )
        read = types.deserialize_cdr if topic.message_encoding == CDR else types.deserialize_ros1
        try:
            return read(self.data, topic.type)
        except Exception as error:  # generated code raises errors of any type for damaged bytes
            raise RecordingError(f"a message of {topic.name} is not a {topic.type}; record it again") from error


@dataclass(frozen=True)
class Contents:
    """The number of messages of each topic in a recording, and its damage in words, if any."""

    counts: dict[Topic, int]
    damage: str = ""

    @property
    def images(self) -> list[Topic]:
        """The topics that carry images."""
        return [topic for topic in self.counts if topic.type in IMAGE_TYPES]


class Recording:
    """A recording: an MCAP file, a ROS 1 bag (.bag) or the folder of a ROS 2 bag.

    It is read to its end, or to the first damage, which `damage` then describes. Messages of an MCAP file are in the
    file's order, and messages of a bag in the order of their times. Raises RecordingError when the file is missing or
    not a recording, and MissingLibraryError when mcap or rosbags is not installed.
    """

    def __init__(self, path: str | Path) -> None:
        require_libraries()
        self.path = Path(path)
        self.damage = ""
        if not os.path.exists(self.path):
            raise RecordingError(f"there is no recording {self.path}; check the path")
        self._in_mcap = os.path.isfile(self.path) and self.path.suffix.lower() == ".mcap"
        if not (self._in_mcap or os.path.isdir(self.path) or self.path.suffix.lower() == ".bag"):
            raise RecordingError(f"{self.path} is not a recording; give {FORMATS}")
        if os.path.isdir(self.path) and not os.path.isfile(self.path / "metadata.yaml"):
            if os.path.isfile(self.path / "meta" / "info.json"):
                raise RecordingError(f"{self.path} is a data set of LeRobot; {DATASETS}")
            raise RecordingError(
                f"{self.path} is not a ROS 2 bag: it has no metadata.yaml; give {FORMATS}; a folder of images also "
                "needs the sensor's `poses`"
            )

    def read_messages(self, *names: str) -> Iterator[Message]:
        """Yield the messages of the topics with these names, or of all topics if no name is given.

        Raises RecordingError when no message of the recording can be read.
        """
        self.damage = ""
        found = 0
        for message in self._read_mcap() if self._in_mcap else self._read_bag():
            found += 1
            if not names or message.topic.name in names:
                yield message
        if self.damage and not found:
            if self._begins_as_recording():
                raise RecordingError(
                    f"{self.path} is damaged or cut off: no message can be read ({self.damage}); copy or record it "
                    "again"
                )
            raise RecordingError(f"{self.path} cannot be read as a recording ({self.damage}); give {FORMATS}")
        if self.damage:
            self.damage = f"{self.path} is damaged or ends early ({self.damage}); its first {found} messages are used"

    def _begins_as_recording(self) -> bool:
        """Return whether the file begins like a recording; True for a folder and no access."""
        magic = MCAP_MAGIC if self._in_mcap else BAG_MAGIC
        try:
            if os.path.isdir(self.path):
                return True
            with self.path.open("rb") as file:
                head = file.read(len(magic))
                return bool(head) and magic.startswith(head)
        except OSError:
            return True

    def read_contents(self) -> Contents:
        """Return the recording's contents. Raises RecordingError when no message can be read."""
        counts = Counter(message.topic for message in self.read_messages())
        return Contents(counts, self.damage)

    def read_frame_tree(self) -> FrameTree:
        """Return the tree of the frames in topics of type TFMessage.

        Raises FrameError when the transforms do not form a tree.
        """
        tree = FrameTree()
        for message in self.read_messages():
            if message.topic.type == TF:
                add_transforms(tree, message.decode(), fixed=message.topic.name.endswith(STATIC))
        return tree

    def read_extras(self) -> Iterator[Any]:
        """Yield the attachments and metadata of an MCAP file, as records of the library mcap."""
        from mcap.records import Attachment, Metadata

        if self._in_mcap:
            yield from (record for record in self._read_records() if isinstance(record, Attachment | Metadata))

    def _read_mcap(self) -> Iterator[Message]:
        from mcap.records import Channel, Schema
        from mcap.records import Message as Record

        schemas: dict[int, Schema] = {}
        topics: dict[int, Topic] = {}
        for record in self._read_records():
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                topics[record.id] = _read_topic(record, schemas.get(record.schema_id))
            elif isinstance(record, Record) and record.channel_id in topics:
                yield Message(topics[record.channel_id], record.log_time, record.publish_time, record.data)

    def _read_records(self) -> Iterator[Any]:
        """Yield the records of the data section until it ends or is damaged."""
        from mcap.exceptions import EndOfFile
        from mcap.records import DataEnd

        with self.path.open("rb") as file:
            try:
                for record in _read_mcap_records(file, self.path.stat().st_size):
                    if isinstance(record, DataEnd):
                        return
                    yield record
            except Exception as error:  # noqa: BLE001 - damaged bytes raise errors of any type
                self.damage = "it is truncated" if isinstance(error, EndOfFile) else summarize(error)

    def _read_bag(self) -> Iterator[Message]:
        from rosbags.highlevel import AnyReader

        try:
            for path in self.path.glob("*.mcap") if self.path.is_dir() else ():
                _require_chunks(path)
            with AnyReader([self.path], default_typestore=load_types(CDR)) as reader:
                unpack = _limit_reading(reader)
                encoding = CDR if reader.is2 else ROS1
                topics = {c.id: _read_bag_topic(c, encoding) for c in reader.connections}
                for connection, time_ns, data in reader.messages():
                    yield Message(topics[connection.id], time_ns, time_ns, unpack(data))
        except Exception as error:  # noqa: BLE001 - damaged bytes raise errors of any type
            self.damage = summarize(error)


def _limit_reading(reader: Any) -> Callable[[bytes], bytes]:
    """Limit the memory for chunks and messages in a reader of rosbags, and return what unpacks a message."""
    from apsw import SQLITE_LIMIT_LENGTH
    from rosbags.rosbag2.reader import zstd

    unpack: Callable[[bytes], bytes] = bytes
    for bag in reader.readers:
        if not reader.is2:
            for at, one in bag.chunks.items():
                bag.chunks[at] = one._replace(decompressor=limit_unpacking(one.decompressor))
            continue
        for file in bag.storage.storages:
            if hasattr(file, "dbconn"):  # in SQLite
                file.dbconn.limit(SQLITE_LIMIT_LENGTH, MOST_PART_BYTES)
        if bag.compression_mode == "message":
            bag.storage.metadata = bag.storage.metadata._replace(compression_mode=None)
            unpack = limit_unpacking(zstd.decompress)
    return unpack


def choose_image_topic(contents: Contents, path: Path, name: str | None) -> Topic:
    """Return the topic of images called `name`, or the only topic of images if `name` is None.

    Raises RecordingError, which lists the topics, when there is no such topic, or when `name` is None and there are
    several topics of images.
    """
    topics = {topic.name: topic for topic in contents.images}
    if not topics:
        held = ", ".join(f"{topic.name} ({topic.type})" for topic in contents.counts) or "nothing"
        raise RecordingError(f"{path} has no topic of images ({' or '.join(IMAGE_TYPES)}); its topics: {held}")
    listed = f"choose one by `image_topic`: {', '.join(topics)}"
    if name is None and len(topics) > 1:
        raise RecordingError(f"{path} has images on several topics; {listed}")
    if name is not None and name not in topics:
        near = did_you_mean(name, topics)
        raise RecordingError(f"{path} has no images on {name}; {listed}{'.' + near if near else ''}")
    return topics[name or next(iter(topics))]


class RecordingWriter:
    """Writes messages to an MCAP file."""

    def __init__(self, file: IO[bytes]) -> None:
        require_libraries()
        from mcap.writer import Writer

        self._writer: Any = Writer(file)  # its methods are untyped
        self._writer.start(profile="ros2", library="tactile-loc")
        self._channels: dict[Topic, int] = {}
        self._schemas: dict[tuple[str, bytes], int] = {}

    def copy(self, message: Message) -> None:
        """Copy a message of another recording."""
        self._add(message.topic, message.data, message.log_time_ns, message.publish_time_ns)

    def write(self, name: str, type_name: str, message: Any, log_time_ns: int) -> None:
        """Write a message of a standard ROS type to the topic of this name."""
        self._add(make_topic(name, type_name), encode(message, type_name), log_time_ns, log_time_ns)

    def copy_extra(self, record: Any) -> None:
        """Copy an attachment or metadata of another recording."""
        if hasattr(record, "metadata"):
            self._writer.add_metadata(record.name, record.metadata)
        else:
            self._writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )

    def finish(self) -> None:
        """Write the end of the file."""
        self._writer.finish()

    def _add(self, topic: Topic, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        if topic not in self._channels:
            self._channels[topic] = self._find_channel(topic)
        self._writer.add_message(self._channels[topic], log_time_ns, data, publish_time_ns)

    def _find_channel(self, topic: Topic) -> int:
        schema = (topic.type, topic.definition)
        if schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(
                topic.type, topic.definition_encoding, topic.definition
            )
        return self._writer.register_channel(
            topic.name, topic.message_encoding, self._schemas[schema], dict(topic.metadata)
        )


def write_recording(path: Path, write: Callable[[RecordingWriter], object]) -> Path:
    """Write a recording atomically by calling `write` with a writer, and return the recording's path.

    Raises OutputError when the file cannot be written, and MissingLibraryError when mcap is not installed.
    """

    def write_file(temporary: Path) -> None:
        with temporary.open("wb") as file:
            writer = RecordingWriter(file)
            write(writer)
            writer.finish()

    return write_atomically(path, write_file)


def _read_topic(channel: Any, schema: Any) -> Topic:
    name, data, encoding = ("", b"", "") if schema is None else (schema.name, schema.data, schema.encoding)
    return Topic(
        channel.topic, _complete_type(name), data, encoding, channel.message_encoding, tuple(channel.metadata.items())
    )


def _read_bag_topic(connection: Any, encoding: str) -> Topic:
    definition = connection.msgdef.data.encode() or find_definition(connection.msgtype)  # missing in older bags
    kind = "ros2idl" if connection.msgdef.format.name == "IDL" else "ros2msg" if encoding == CDR else "ros1msg"
    return Topic(connection.topic, connection.msgtype, definition, kind, encoding)


def _complete_type(name: str) -> str:
    """Return the name of a message type in the form of ROS 2: package/msg/Name."""
    package, _, kind = name.partition("/")
    return name if "/" in kind or not kind else f"{package}/msg/{kind}"


def _read_mcap_records(file: IO[bytes], size: int) -> Iterator[Any]:
    """Yield the records of an MCAP file of `size` bytes, also those in chunks. Raises the errors of damaged bytes."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    for record in StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=size).records:
        if isinstance(record, Chunk):
            yield from breakup_chunk(_unpack_chunk(record), validate_crc=True)
        else:
            yield record


def _unpack_chunk(chunk: Any) -> Any:
    """Return a chunk of MCAP without compression. Raises ValueError if it is too large or of another size."""
    from lz4.frame import LZ4FrameFile
    from zstandard import ZstdDecompressor

    open_stream: Any = {"zstd": ZstdDecompressor().stream_reader, "lz4": LZ4FrameFile}.get(chunk.compression)
    if open_stream is None:
        return chunk
    with open_stream(BytesIO(chunk.data)) as stream:
        return replace(chunk, compression="", data=read_unpacked(stream, chunk.uncompressed_size))


def _require_chunks(path: Path) -> None:
    """Raise TooLargeError if a chunk of an MCAP file states a size above the limit, without unpacking it."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader
    from zstandard import frame_content_size

    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True, record_size_limit=path.stat().st_size).records:
            if isinstance(record, Chunk):
                stated = frame_content_size(record.data) if record.compression == "zstd" else record.uncompressed_size
                require_size(max(stated, record.uncompressed_size))


def limit_unpacking(unpack: Callable[[bytes], bytes], most: int = MOST_PART_BYTES) -> Callable[[bytes], bytes]:
    """Return a function that unpacks like `unpack`, which is that of bz2, lz4 or zstd in rosbags, up to `most` bytes.

    It raises TooLargeError for more.
    """
    from lz4.frame import LZ4FrameFile, decompress
    from rosbags.rosbag2.reader import zstd

    streams = {bz2.decompress: bz2.BZ2File, decompress: LZ4FrameFile, zstd.decompress: zstd.ZstdFile}
    open_stream: Any = streams.get(unpack)
    if open_stream is None:
        return unpack

    def unpack_within(data: bytes) -> bytes:
        with open_stream(BytesIO(data)) as stream:
            content: bytes = stream.read(most + 1)
        require_size(len(content), most)
        return content

    return unpack_within
