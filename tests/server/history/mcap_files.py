"""MCAP files as third parties read them: mcap's own readers, its ROS 1 decoder, and rosbags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mcap.reader import NonSeekingReader, make_reader
from mcap_ros1.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

MAGIC = b"\x89MCAP0\r\n"


class Read(NamedTuple):
    """A message as read: its topic, its sequence number, its log time, its bytes."""

    topic: str
    sequence: int
    time_ns: int
    data: bytes


def read(path: Path) -> list[Read]:
    """Return the messages of a finished file, by summary and sequentially: both must be equal, including checksums."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None, path
        assert summary.statistics is not None, path
        found = [
            Read(channel.topic, message.sequence, message.log_time, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
        assert summary.statistics.message_count == len(found)
        for chunk in summary.chunk_indexes:
            topics = {summary.channels[number].topic for number in chunk.message_index_offsets}
            assert len(topics) == 1, "a chunk has one topic"
    with path.open("rb") as file:
        walked = [
            Read(channel.topic, message.sequence, message.log_time, message.data)
            for _, channel, message in NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False)
        ]
    assert sorted(walked) == sorted(found)
    return found


def finished(folder: Path) -> list[Path]:
    """Return the complete files of a folder: all except the one being written."""
    return [path for path in sorted(folder.glob("*.mcap")) if path.read_bytes().endswith(MAGIC)]


def profile(path: Path) -> str:
    """Return the kind of ROS that a file states."""
    with path.open("rb") as file:
        return str(make_reader(file).get_header().profile)


def decode(path: Path) -> Sequence[tuple[str, object]]:
    """Return the messages of a file, decoded by its own definitions: ROS 1 by mcap's decoder, ROS 2 by rosbags."""
    if profile(path) == "ros1":
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            return [(channel.topic, decoded) for _, channel, _, decoded in reader.iter_decoded_messages()]
    with AnyReader([path]) as bag:
        return [(one.topic, bag.deserialize(data, one.msgtype)) for one, _, data in bag.messages()]
