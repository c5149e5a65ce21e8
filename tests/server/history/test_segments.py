"""Segments: third parties read them, truncated ones are recovered, excess ones are removed."""

from __future__ import annotations

import asyncio
import shutil
import time
from pathlib import Path

import pytest

from rosld.adapters.base import AdapterOptions, NullSink, RecordedMessage
from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.adapters.registry import adapter_for
from rosld.server.history import mcap_writer
from rosld.server.history.history_writer import HistoryWriter
from rosld.server.history.mcap_writer import recover
from rosld.server.history.recorder import LatchedMessages
from rosld.server.history.segment_file import DiskFile
from rosld.server.history.segments import HistoryLimits, Segments
from tests.server.history.mcap_files import read

TEXT = TypeRef("std_msgs/msg/String", "RIHS01_" + "0" * 64)
START = 1_700_000_000_000_000_000
LIMITS = HistoryLimits(1e9, 1 << 30)


def sample(number: int, text: str = "", publisher: str = "/talker") -> Sample:
    """Return a string as CDR, published 10 ms after the previous one."""
    said = f"{text}{number}".encode() + b"\0"
    data = b"\0\1\0\0" + len(said).to_bytes(4, "little") + said
    return Sample(data, Encoding.CDR, TEXT, publisher, START + number * 10_000_000, number)


def open_writer(folder: Path | None, limits: HistoryLimits = LIMITS) -> HistoryWriter:
    writer = HistoryWriter(Segments(folder, limits), lambda ref: "string data\n")
    writer.open()
    return writer


def add(writer: HistoryWriter, count: int, topics: tuple[str, ...] = ("/a", "/b")) -> None:
    """Record this number of messages on each topic in turn."""
    for number in range(writer.next, writer.next + count * len(topics)):
        writer.add(topics[number % len(topics)], sample(number))


def files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.mcap"))


def test_a_segment_that_has_no_number_for_another_channel_ends_with_all_that_came(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_writer, "_MAX_CHANNELS", 3)
    writer = open_writer(tmp_path)
    topics = ("/a", "/b", "/c", "/d", "/e")
    add(writer, 4, topics)
    writer.close()
    found = sorted((one for path in files(tmp_path) for one in read(path)), key=lambda one: one.sequence)
    assert len(files(tmp_path)) > 1
    assert [(one.topic, one.data) for one in found] == [(topics[n % 5], sample(n).data) for n in range(20)]
    assert not writer.dropped


def test_an_index_that_is_lost_or_damaged_is_made_again_from_the_segments(tmp_path: Path) -> None:
    writer = open_writer(tmp_path)
    add(writer, 700)
    writer.close()
    writer.segments.close()
    for damage in (lambda path: path.unlink(), lambda path: path.write_bytes(b"no index" * 1000)):
        damage(tmp_path / "index.sqlite")
        again = open_writer(tmp_path)
        assert again.next == 1400
        assert again.counts == {"/a": 700, "/b": 700}
        found = again.message(1001)
        assert found is not None
        assert found[1].data == sample(1001).data
        assert again.segments.index.definition(TEXT) == "string data\n"
        again.segments.close()


def test_a_file_that_ends_anywhere_is_completed_and_loses_only_the_chunk_it_ends_in(tmp_path: Path) -> None:
    writer = open_writer(tmp_path / "whole")
    for _ in range(4):
        add(writer, 10)
        writer.write_due(time.monotonic() + 2)
    (path,) = files(tmp_path / "whole")
    whole = path.read_bytes()
    ends = [row.at for topic in ("/a", "/b") for row in writer.segments.index.of_topic(topic, 0, 1 << 62)][1:]
    for size in range(len(whole), min(ends), -97):
        copy = tmp_path / "copy.mcap"
        copy.write_bytes(whole[:size])
        found = recover(DiskFile(copy))
        messages = read(copy)
        assert len(messages) == sum(len(chunk.numbers) for chunk in found.chunks)
        assert all(one.data == sample(one.sequence).data for one in messages)
        assert len(messages) >= 10 * sum(end <= size for end in ends)


@pytest.mark.parametrize("on_disk", [True, False])
def test_what_does_not_fit_goes_oldest_first_and_whole_files_at_a_time(tmp_path: Path, on_disk: bool) -> None:
    limits = HistoryLimits(1e9, 20_000, segment_size=4_000)
    writer = open_writer(tmp_path if on_disk else None, limits)
    for _ in range(60):
        add(writer, 100)
        writer.write_due(time.monotonic() + 2)
    assert writer.segments.size <= 24_500
    assert 0 < writer.first < writer.next
    assert writer.message(writer.first) is not None
    assert writer.message(writer.first - 1) is None
    assert sum(writer.counts.values()) == writer.next - writer.first
    if on_disk:
        assert sum(len(read(path)) for path in files(tmp_path)[:-1]) < writer.next - writer.first


def test_what_is_too_old_goes(tmp_path: Path) -> None:
    writer = open_writer(tmp_path, HistoryLimits(3600.0, 1 << 30, segment_seconds=0.0))
    for _ in range(3):  # each spans years, and is a separate segment
        add(writer, 10)
        writer.write_due(time.monotonic() + 2)
    assert writer.first == 40
    writer.add("/a", sample(60)._replace(received_ns=time.time_ns()))
    writer.write_due(time.monotonic() + 2)
    assert len(files(tmp_path)) == 1
    assert writer.first == 60


def played(folder: Path, part: str = "") -> list[RecordedMessage]:
    """Return the messages of a folder of segments, or of a part of them, as `rosld serve` plays it."""

    async def read_all() -> list[RecordedMessage]:
        adapter = adapter_for(f"recording:{folder}{part}", AdapterOptions())
        await adapter.open(NullSink(), deadline=asyncio.get_running_loop().time() + 20)
        (recording,) = adapter.recordings.values()
        found = list(recording.messages())
        await adapter.close()
        return found

    return asyncio.run(read_all())


def test_every_segment_opens_with_what_was_latched_which_the_history_counts_once(tmp_path: Path) -> None:
    latched = LatchedMessages()
    whole = tmp_path / "whole"
    limits = HistoryLimits(1e9, 1 << 30, segment_seconds=10)
    segments = Segments(whole, limits, lambda: latched.messages(lambda topic: True))
    writer = HistoryWriter(segments, lambda ref: "string data\n")
    writer.open()
    maps = [sample(number, "map", publisher)._replace(latched=True) for number, publisher in enumerate(("/m", "/n"))]
    for one in maps:
        writer.add("/map", one)
        latched.take("/map", one)
    for last in (12, 22):
        for number in range(writer.next, last):
            writer.add("/odom", sample(number))
        writer.write_due(time.monotonic() + 11)
    writer.close()
    _, second = files(whole)
    opening = [one for one in read(second) if one.topic == "/map"]
    assert [(one.data, one.time_ns) for one in opening] == [(one.data, sample(12).received_ns) for one in maps]
    assert (writer.next, writer.counts) == (22, {"/map": 2, "/odom": 20})

    for path in whole.glob("index*"):
        path.unlink()
    again = open_writer(whole)
    assert (again.next, again.counts) == (22, {"/map": 2, "/odom": 20}), "also where the index is made anew"
    again.segments.close()
    assert [one.sample.data for one in played(whole) if one.topic == "/map"] == [one.data for one in maps]
    part = played(whole, "?from=0.05&to=0.08")
    assert [(one.topic, one.is_opening) for one in part] == [("/map", True)] * 2 + [("/odom", False)] * 4
    assert {one.sample.received_ns for one in part[:2]} == {sample(5).received_ns}, "when the part begins"

    cut = tmp_path / "cut"
    cut.mkdir()
    shutil.copy(second, cut)
    rest = open_writer(cut)
    assert rest.counts == {"/odom": 10}
    found = rest.latched_at(sample(15).received_ns, lambda topic: True)
    assert [(one.data, one.received_ns) for _, one in found] == [(one.data, one.received_ns) for one in maps]
    assert [(one.topic, one.is_opening) for one in played(cut)[:3]] == [("/map", True)] * 2 + [("/odom", False)]
