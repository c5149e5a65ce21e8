"""MCAP files as those read them who did not write them: mcap's own readers, its ROS 1 decoder, and rosbags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mcap.reader import NonSeekingReader, make_reader
from mcap_ros1.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

MAGIC = b"\x89MCAP0\r\n"


class Read(NamedTuple):
    """A message as it was read: its topic, its sequence, when it was logged, its bytes."""

    topic: str
    sequence: int
    time_ns: int
    data: bytes


def read(path: Path) -> list[Read]:
    """The messages of a finished file, by its summary and through it: both must be the same, checksums included."""
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
    """The files of a folder that are complete: all but the one that is being written."""
    return [path for path in sorted(folder.glob("*.mcap")) if path.read_bytes().endswith(MAGIC)]


def profile(path: Path) -> str:
    """Which ROS a file says that it is of."""
    with path.open("rb") as file:
        return str(make_reader(file).get_header().profile)


def decode(path: Path) -> Sequence[tuple[str, object]]:
    """The messages of a file, decoded by its own definitions: ROS 1 by mcap's decoder, ROS 2 by rosbags."""
    if profile(path) == "ros1":
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            return [(channel.topic, decoded) for _, channel, _, decoded in reader.iter_decoded_messages()]
    with AnyReader([path]) as bag:
        return [(one.topic, bag.deserialize(data, one.msgtype)) for one, _, data in bag.messages()]
