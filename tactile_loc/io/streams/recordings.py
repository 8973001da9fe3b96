"""Recordings of ROS topics, without ROS: read from MCAP and from bags of ROS 1 and 2, written as MCAP."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from tactile_loc.core.errors import RecordingError, did_you_mean
from tactile_loc.core.geometry.frame_tree import FrameTree
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

FORMATS = "an MCAP file (.mcap), a bag of ROS 1 (.bag), or the folder of a bag of ROS 2"


@dataclass(frozen=True, eq=False)
class Message:
    """A message of a recording as its bytes; when it was logged and published, ns."""

    topic: Topic
    log_time_ns: int
    publish_time_ns: int
    data: bytes

    def decode(self) -> Any:
        """Return the message with its fields. Raises RecordingError when it is damaged or of an unknown encoding."""
        topic = self.topic
        types = load_types(topic.message_encoding)
        if types is None:
            raise RecordingError(
                f"the messages of {topic.name} are written as {topic.message_encoding or 'nothing that is named'}; "
                "only those of ROS 2 (cdr) and ROS 1 (ros1) can be read"
            )
        read = types.deserialize_cdr if topic.message_encoding == CDR else types.deserialize_ros1
        try:
            return read(self.data, topic.type)
        except Exception as error:  # whatever stray bytes make of generated code
            raise RecordingError(f"a message of {topic.name} is no {topic.type}: it is damaged") from error


@dataclass(frozen=True)
class Contents:
    """What a recording holds: how many messages of each topic, and what is wrong with it, if something is."""

    counts: dict[Topic, int]
    damage: str = ""

    @property
    def images(self) -> list[Topic]:
        """The topics of images."""
        return [topic for topic in self.counts if topic.type in IMAGE_TYPES]


class Recording:
    """A recording, read from its beginning to its end, or to where it is damaged: `damage` then says what is wrong.

    An MCAP file, a bag of ROS 1 (.bag) or the folder of a bag of ROS 2. Messages come in the order of an MCAP file, or
    of a bag's times. Raises RecordingError when there is no such file or it is no recording, and MissingLibraryError.
    """

    def __init__(self, path: str | Path) -> None:
        require_libraries()
        self.path = Path(path)
        self.damage = ""
        if not os.path.exists(self.path):
            raise RecordingError(f"there is no recording {self.path}; check the path")
        self._in_mcap = os.path.isfile(self.path) and self.path.suffix.lower() == ".mcap"
        if not (self._in_mcap or os.path.isdir(self.path) or self.path.suffix.lower() == ".bag"):
            raise RecordingError(f"{self.path} is no recording; give {FORMATS}")

    def read_messages(self, *names: str) -> Iterator[Message]:
        """Yield the messages of the topics of these names, or all. Raises RecordingError when there is none to read."""
        self.damage = ""
        found = 0
        for message in self._read_mcap() if self._in_mcap else self._read_bag():
            found += 1
            if not names or message.topic.name in names:
                yield message
        if self.damage and not found:
            raise RecordingError(f"{self.path} cannot be read as a recording ({self.damage}); give {FORMATS}")
        if self.damage:
            self.damage = f"{self.path} is damaged or ends early ({self.damage}); its first {found} messages are read"

    def read_contents(self) -> Contents:
        """Return what the recording holds. Raises RecordingError when there is nothing that can be read."""
        counts: dict[Topic, int] = {}
        for message in self.read_messages():
            counts[message.topic] = counts.get(message.topic, 0) + 1
        return Contents(counts, self.damage)

    def read_frame_tree(self) -> FrameTree:
        """Return the frames that topics of type TFMessage speak of. Raises FrameError when they are no tree."""
        tree = FrameTree()
        for message in self.read_messages():
            if message.topic.type == TF:
                add_transforms(tree, message.decode(), fixed=message.topic.name.endswith(STATIC))
        return tree

    def read_extras(self) -> Iterator[Any]:
        """Yield the attachments and metadata of an MCAP file, as the library mcap has them."""
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
        """The records of the data section, to its end or to where it is damaged."""
        from mcap.exceptions import EndOfFile
        from mcap.records import DataEnd
        from mcap.stream_reader import StreamReader

        with self.path.open("rb") as file:
            try:
                largest = self.path.stat().st_size
                for record in StreamReader(file, validate_crcs=True, record_size_limit=largest).records:
                    if isinstance(record, DataEnd):
                        return
                    yield record
            except _list_damages() as error:
                self.damage = "it breaks off" if isinstance(error, EndOfFile) else summarize(error)

    def _read_bag(self) -> Iterator[Message]:
        from rosbags.highlevel import AnyReader

        try:
            with AnyReader([self.path], default_typestore=load_types(CDR)) as reader:
                encoding = CDR if reader.is2 else ROS1
                topics = {c.id: _read_bag_topic(c, encoding) for c in reader.connections}
                for connection, time_ns, data in reader.messages():
                    yield Message(topics[connection.id], time_ns, time_ns, bytes(data))
        except _list_damages() as error:
            self.damage = summarize(error)


def choose_image_topic(contents: Contents, path: Path, name: str | None) -> Topic:
    """Return the topic of images called `name`, or the only one.

    Raises RecordingError, which names those there are, when there is none, another or several.
    """
    names = [topic.name for topic in contents.images]
    listed = ", ".join(names)
    if not names:
        held = ", ".join(f"{topic.name} ({topic.type})" for topic in contents.counts) or "nothing"
        raise RecordingError(f"{path} holds no images: no topic of type {' or '.join(IMAGE_TYPES)}; it holds {held}")
    if name is None and len(names) > 1:
        raise RecordingError(f"{path} holds images on several topics; choose one by --image-topic: {listed}")
    if name is not None and name not in names:
        raise RecordingError(
            f"{path} has no images on {name}; there are images on {listed}.{did_you_mean(name, names)}"
        )
    return contents.images[0 if name is None else names.index(name)]


class RecordingWriter:
    """Writes messages to a file as MCAP."""

    def __init__(self, file: IO[bytes]) -> None:
        require_libraries()
        from mcap.writer import Writer

        self._writer: Any = Writer(file)  # whose methods are untyped
        self._writer.start(profile="ros2", library="tactile-loc")
        self._channels: dict[Topic, int] = {}
        self._schemas: dict[tuple[str, bytes], int] = {}

    def copy(self, message: Message) -> None:
        """Write a message of another recording as it is."""
        self._add(message.topic, message.data, message.log_time_ns, message.publish_time_ns)

    def write(self, name: str, type_name: str, message: Any, log_time_ns: int) -> None:
        """Write a message of a type that ROS comes with to the topic of this name."""
        self._add(make_topic(name, type_name), encode(message, type_name), log_time_ns, log_time_ns)

    def copy_extra(self, record: Any) -> None:
        """Write an attachment or metadata of another recording as it is."""
        if hasattr(record, "metadata"):
            self._writer.add_metadata(record.name, record.metadata)
        else:
            self._writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )

    def finish(self) -> None:
        """Write what ends the file."""
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
    """Have `write` fill a recording, whole or not there, and return its path.

    Raises OutputError, and MissingLibraryError without mcap.
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
    definition = connection.msgdef.data.encode() or find_definition(connection.msgtype)  # older bags have none
    kind = "ros2idl" if connection.msgdef.format.name == "IDL" else "ros2msg" if encoding == CDR else "ros1msg"
    return Topic(connection.topic, connection.msgtype, definition, kind, encoding)


def _complete_type(name: str) -> str:
    """A type's name as ROS 2 has it: package/msg/Name."""
    package, _, kind = name.partition("/")
    return name if "/" in kind or not kind else f"{package}/msg/{kind}"


def _list_damages() -> tuple[type[Exception], ...]:
    """What reading damaged bytes raises."""
    import apsw
    from mcap.exceptions import McapError
    from rosbags.highlevel import AnyReaderError
    from rosbags.rosbag1 import ReaderError as Ros1Error
    from rosbags.rosbag2 import ReaderError as Ros2Error
    from zstandard import ZstdError

    of_libraries = (McapError, AnyReaderError, Ros1Error, Ros2Error, ZstdError, struct.error, apsw.Error)
    of_code = (LookupError, ArithmeticError, AssertionError, TypeError, AttributeError, RuntimeError)  # on stray bytes
    return (OSError, ValueError, EOFError, MemoryError, *of_code, *of_libraries)  # lengths are damaged, too
