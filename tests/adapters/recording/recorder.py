"""Recordings for tests: the same lines in every format, written by rosbags' own writers, and read by rosld."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, NamedTuple

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from rosld.adapters.base import AdapterOptions, NullSink, RecordedMessage
from rosld.adapters.recording import RecordingAdapter

START_NS = 1_700_000_000_000_000_000
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_JAZZY)


class Line(NamedTuple):
    """One message: the text of a `std_msgs/msg/String`, published `seconds` after the start by a node."""

    seconds: float
    topic: str
    text: str
    node: str = "/talker"
    latched: bool = False


def lines(topic: str = "/chatter", count: int = 10, every: float = 0.1, node: str = "/talker") -> list[Line]:
    """Return `count` lines at a regular interval: "0", "1", ..."""
    return [Line(each * every, topic, str(each), node) for each in range(count)]


def time_of(line: Line) -> int:
    """Return the time when a line was recorded, in ns."""
    return START_NS + round(line.seconds * 1e9)


def write_rosbag1(
    path: Path, said: Iterable[Line], *, compression: Literal["none", "bz2", "lz4"] = "none", chunk: int = 1 << 20
) -> Path:
    """Write a ROS 1 bag of these lines; `chunk` is the number of bytes of a chunk."""
    writer = Writer1(path)
    if compression != "none":
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    writer.chunk_threshold = chunk
    kind = ROS1.types["std_msgs/msg/String"]
    connections = {}
    with writer:
        for line in said:
            key = (line.topic, line.node)
            if key not in connections:
                connections[key] = writer.add_connection(
                    line.topic,
                    kind.__msgtype__,
                    typestore=ROS1,
                    callerid=line.node or None,
                    latching=int(line.latched),
                )
            data = ROS1.serialize_ros1(kind(line.text), kind.__msgtype__)
            writer.write(connections[key], time_of(line), data)
    return path


_TRANSIENT_LOCAL = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    QosTime(0, 0),
    QosTime(0, 0),
    QosLiveliness.AUTOMATIC,
    QosTime(0, 0),
    False,
)


def write_rosbag2(
    folder: Path,
    said: Iterable[Line],
    *,
    storage: Literal["mcap", "sqlite3"] = "mcap",
    compression: Literal["none", "file", "message", "storage"] = "none",
    version: Literal[8, 9] = 9,
) -> Path:
    """Write a ROS 2 bag of these lines, a folder; it does not record nodes."""
    writer = Writer2(folder, version=version, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    kind = ROS2.types["std_msgs/msg/String"]
    connections = {}
    with writer:
        for line in said:
            if line.topic not in connections:
                profiles = [_TRANSIENT_LOCAL] if line.latched else []
                connections[line.topic] = writer.add_connection(
                    line.topic, kind.__msgtype__, typestore=ROS2, offered_qos_profiles=profiles
                )
            data = ROS2.serialize_cdr(kind(line.text), kind.__msgtype__)
            writer.write(connections[line.topic], time_of(line), data)
    return folder


class Hidden(NamedTuple):
    """A message of a topic whose recorded definition is this text, or missing if it is empty."""

    topic: str
    type: str
    definition: str
    data: bytes
    hash: str = "RIHS01_" + "0" * 64


def write_hidden(folder: Path, recorded: Iterable[Hidden], storage: Literal["mcap", "sqlite3"] = "mcap") -> Path:
    """Write a ROS 2 bag of these messages, a folder, at intervals of a second."""
    writer = Writer2(folder, version=9, storage_plugin=StoragePlugin[storage.upper()])
    with writer:
        for number, one in enumerate(recorded):
            connection = writer.add_connection(one.topic, one.type, msgdef=one.definition, rihs01=one.hash)
            writer.write(connection, START_NS + number * 10**9, b"\0\1\0\0" + one.data)
    return folder


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open the recording at a path, even inside a running loop."""
    adapter = RecordingAdapter(path, AdapterOptions())

    def run(work: Coroutine[Any, Any, None]) -> None:
        with ThreadPoolExecutor(1) as thread:
            thread.submit(asyncio.run, work).result()

    run(adapter.open(NullSink(), deadline=float("inf")))
    (bag,) = adapter.recordings.values()
    try:
        yield bag
    finally:
        run(adapter.close())


def said(bag: Any, recorded: RecordedMessage) -> str:
    """Return the text of a recorded `std_msgs/msg/String`."""
    codec = bag.schema(recorded.sample.schema).codec
    return str(codec.decode(recorded.sample.data, recorded.sample.encoding).data)
