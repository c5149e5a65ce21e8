"""Limits for reading the newest or oldest messages: the requested number is found, and hardly more are read."""

from __future__ import annotations

from pathlib import Path
from random import Random

from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.server.history.history import HistoryRecording
from rosld.server.history.history_writer import HistoryWriter
from rosld.server.history.segments import HistoryLimits, Segments
from rosld.server.resources.past_messages import PastRange, clip_ranges, count_past, read_past, time_of_end

TYPE = TypeRef("std_msgs/msg/Empty")
CHUNK = 20
TOPICS = ("/a", "/b", "/c")
BEGIN, END = 1_000_000_000_000, 1_001_000_000_000


def recorded(folder: Path, random: Random, late: int) -> tuple[HistoryRecording, list[tuple[str, int]]]:
    """Write messages at random times, some `late` by a number of ns, and leave the last ones outside of any chunk."""
    writer = HistoryWriter(Segments(folder, HistoryLimits(1e9, 1 << 30)), lambda ref: "")
    writer.open()
    times = sorted(random.randrange(BEGIN, END) for _ in range(600))
    messages: list[tuple[str, int]] = []
    for number, time_ns in enumerate(times):
        topic, at = random.choice(TOPICS), time_ns - random.choice([0, 0, 0, random.randrange(late + 1)])
        writer.add(topic, Sample(b"\0\1\0\0\0", Encoding.CDR, TYPE, "/talker", at, number))
        messages.append((topic, at))
        if number % (CHUNK * len(TOPICS)) == 0:
            writer.write_all()
    return HistoryRecording(writer, ()), messages


def test_as_many_as_asked_for_are_within_the_time_and_few_more(tmp_path: Path) -> None:
    for seed in range(4):
        bounds_few_more(tmp_path / str(seed), seed)


def bounds_few_more(tmp_path: Path, seed: int) -> None:
    random = Random(seed)
    late = 9_000_000_000 * (seed % 2)
    recording, messages = recorded(tmp_path, random, late)
    for _ in range(20):
        topics = random.sample(TOPICS, random.choice([1, 2, 3]))
        most, is_newest = random.choice([1, 5, 30, 150, 2000]), random.choice([True, False])
        ranges = [PastRange(topic, 0, 1 << 62) for topic in topics]
        times = [at for topic, at in messages if topic in topics]
        bound = time_of_end([(recording, ranges)], most, is_newest=is_newest)
        if bound is None:
            assert len(times) < most
            continue
        clipped = clip_ranges(ranges, bound, is_newest=is_newest)
        found = [each.sample.received_ns for block in read_past(recording, clipped) for each in block.messages()]
        assert sorted(found) == sorted(at for at in times if (at >= bound if is_newest else at <= bound))
        assert len(found) >= most
        assert late or count_past(recording, clipped) <= most + 4 * CHUNK * len(topics)
