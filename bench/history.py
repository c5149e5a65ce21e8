"""The history: the cost of recording in addition to subscribing, compared to the mcap library's writer.

Run: python bench/history.py [seconds]. Targets: 200 topics at 50 Hz use 0.25 of a core; files are at most 1.2 times the
size of zstd MCAP in order of time; reading one topic of a hundred is at least ten times faster than from that.
"""

from __future__ import annotations

import asyncio
import os
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagWriter
from rosbags.typesys import Stores, get_typestore

from rosld.adapters.base import Subscription
from rosld.adapters.model import Encoding, Graph, Sample, Topic, TypeRef, freeze
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.slots import Slot
from rosld.server.history.history_writer import HistoryWriter
from rosld.server.history.mcap_writer import MAX_SECONDS
from rosld.server.history.segments import HistoryLimits, Segments
from rosld.server.history.topic_feed import LiveRecorder

TOPICS, RATE = 200, 50
TICK = 0.02
LIBRARY = TypeLibrary(ros_version=2)
IMU = LIBRARY.find(TypeRef("sensor_msgs/msg/Imu"))


class Source:
    """A robot in this process: the part of an adapter that a recorder needs."""

    def __init__(self, topics: int, seconds: float) -> None:
        self.slots = {f"/sensor_{number}/imu": Slot() for number in range(topics)}
        self.graph = Graph(1, topics=freeze({name: Topic(name, (IMU.ref,)) for name in self.slots}))
        self._sequence = 0
        self._messages = Messages(int(topics * RATE * (seconds + 2)))

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        """Start receiving a topic."""
        return self.slots[topic].subscribe(depth)

    async def speak(self, seconds: float) -> int:
        """Publish on every topic at `RATE`; return the number of messages."""
        end, due, count = time.monotonic() + seconds, time.monotonic(), 0
        while due < end:
            self._sequence += 1
            for slot in self.slots.values():
                now = time.time_ns()
                data = self._messages.next(now)
                slot.put(Sample(data, Encoding.CDR, IMU.ref, "/driver", now, self._sequence))
                count += 1
            due += TICK
            await asyncio.sleep(max(0.0, due - time.monotonic()))
        return count


class Messages:
    """Imu messages as CDR, each with its own noise: six decimals of ten numbers, as in drivers."""

    def __init__(self, count: int) -> None:
        self._noise = np.random.default_rng(7).normal(size=(count, 10)).round(6)
        self._covariance = struct.pack("<9d", 0.01, 0, 0, 0, 0.01, 0, 0, 0, 0.01)
        self._at = 0

    def next(self, now: int) -> bytes:
        """Return the next message."""
        numbers = self._noise[self._at].tobytes()
        self._at += 1
        head = struct.pack("<4sIII9s3x", b"\0\1\0\0", now // 10**9, now % 10**9, 9, b"imu_link\0")
        of = self._covariance
        return b"".join((head, numbers[:32], of, numbers[32:56], of, numbers[56:], of))


async def learn(ref: TypeRef) -> None:
    """Make the type known."""


def open_history(folder: Path) -> HistoryWriter:
    """Open a history in a folder."""
    writer = HistoryWriter(Segments(folder, HistoryLimits(1e9, 1 << 34)), lambda ref: IMU.definition)
    writer.open()
    return writer


class Cost(NamedTuple):
    """The share of a core, numbers of messages, and memory in megabytes after a third of the time and at the end."""

    share: float
    sent: int
    recorded: int
    dropped: int
    memory: tuple[float, float]


async def cost(seconds: float, folder: Path | None) -> Cost:
    """Return the cost while all topics are subscribed to, and recorded if there is a folder."""
    source = Source(TOPICS, seconds)
    live = LiveRecorder(source, learn)  # type: ignore[arg-type]
    kept = [await source.subscribe(topic) for topic in source.slots]
    writer = None if folder is None else open_history(folder)
    if writer is not None:
        live.add(writer, lambda topic: True)
    await source.speak(1.0)
    before, began = time.process_time(), time.monotonic()
    count = await source.speak(seconds / 3)
    early = resident()
    count += await source.speak(seconds * 2 / 3)
    share = (time.process_time() - before) / (time.monotonic() - began)
    memory = early, resident()
    await live.stop()
    for each in kept:
        each.close()
    return Cost(share, count, 0 if writer is None else writer.next, live.dropped().total(), memory)


def resident(process: int | str = "self") -> float:
    """Return the resident memory in megabytes of a process, by default this one."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def by_time(folder: Path, messages: list[tuple[str, int, bytes]]) -> Path:
    """Write the messages with the mcap library: chunks in order of time, zstd."""
    path = folder / "by_time.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", IMU.definition.encode())
        channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in {each[0] for each in messages}}
        for sequence, (topic, at, data) in enumerate(messages):
            writer.add_message(channels[topic], at, data, at, sequence)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def by_rosbag2(folder: Path, messages: list[tuple[str, int, bytes]]) -> Path:
    """Write the messages as a ROS 2 bag with zstd in its MCAP, with rosbags."""
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = RosbagWriter(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        name = "sensor_msgs/msg/Imu"
        found = {topic: writer.add_connection(topic, name, typestore=store) for topic in {each[0] for each in messages}}
        for topic, at, data in messages:
            writer.write(found[topic], at, data)
    (path,) = (folder / "bag").glob("*.mcap")
    return path


def by_topic(folder: Path, messages: list[tuple[str, int, bytes]]) -> HistoryWriter:
    """Write the messages as the history does, one second at a time."""
    writer = open_history(folder / "history")
    second = messages[0][1]
    for number, (topic, at, data) in enumerate(messages):
        writer.add(topic, Sample(data, Encoding.CDR, IMU.ref, "/driver", at, number))
        if at - second > int(MAX_SECONDS * 1e9):
            second = at
            writer.write_all()
    writer.close()
    return writer


def best(work: Callable[[], Any], rounds: int = 3) -> tuple[float, Any]:
    """Return the CPU time of the best round, and its result."""
    times: list[float] = []
    found: Any = None
    for _ in range(rounds):
        began = time.process_time()
        found = work()
        times.append(time.process_time() - began)
    return min(times), found


def read_by_time(path: Path, topic: str) -> int:
    """Read one topic with mcap's reader, by the index of the file."""
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file).iter_messages(topics=[topic]))


def read_history(writer: HistoryWriter, topic: str) -> int:
    """Read one topic from the history, by its index."""
    segments = writer.segments
    rows = segments.index.of_topic(topic, 0, 1 << 62)
    return sum(1 for row in rows for _ in segments.messages_of(row))


def produced(topics: int, seconds: int) -> Iterator[tuple[str, int, bytes]]:
    """Yield messages of this number of topics at `RATE`, in order of time."""
    messages, start = Messages(topics * seconds * RATE), 1_700_000_000_000_000_000
    for tick in range(seconds * RATE):
        for number in range(topics):
            now = start + tick * 20_000_000 + number * 1000
            yield f"/sensor_{number}/imu", now, messages.next(now)


def main() -> int:
    """Print the cost; return 1 if a target is missed that does not depend on the machine."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subscribed = asyncio.run(cost(seconds, None)).share
        share, sent, recorded, dropped, memory = asyncio.run(cost(seconds, folder / "live"))
        print(
            f"{TOPICS} topics of {RATE} Hz, {seconds:g} s: {subscribed:.2f} of a core subscribed, {share:.2f} recorded"
        )
        print(f"above being subscribed: {share - subscribed:.2f} of a core; {recorded} recorded, {dropped} dropped")
        print(f"memory after a third of it {memory[0]:.1f} MB, at its end {memory[1]:.1f} MB")
        messages = [*produced(100, 60)]
        wrote_by_time, path = best(lambda: by_time(folder, messages), 1)
        wrote, writer = best(lambda: by_topic(folder, messages), 1)
        print(f"writing {len(messages)} messages: {wrote:.2f} s, mcap's writer {wrote_by_time:.2f} s")
        size = writer.segments.size / path.stat().st_size
        print(f"disk: {size:.2f} of what mcap's writer takes in the order of time ({path.stat().st_size / 1e6:.1f} MB)")
        bag = writer.segments.size / by_rosbag2(folder, messages).stat().st_size
        print(f"disk: {bag:.2f} of what a bag of ROS 2 by rosbags takes, with zstd in its MCAP")
        topic = "/sensor_42/imu"
        slow, found = best(lambda: read_by_time(path, topic))
        fast, same = best(lambda: read_history(writer, topic))
        print(f"one topic of a hundred, {found} messages: {fast * 1e3:.1f} ms, by time {slow * 1e3:.1f} ms")
        print(f"{slow / fast:.0f} times faster")
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    return int(found != same or recorded < sent or dropped > 0 or size > 1.2 or slow < 10 * fast)


if __name__ == "__main__":
    sys.exit(main())
