"""A recording as a playing system: the newest messages at each time."""

from __future__ import annotations

import asyncio
import hashlib
import struct
from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag1 import Writer

from rosld.adapters.base import AdapterOptions
from rosld.adapters.recording import RecordingAdapter
from tests.adapters.recording import recorder
from tests.adapters.recording.recorder import opened

Play = Callable[..., AbstractAsyncContextManager[Any]]


def texts(samples: Sequence[Any]) -> list[str]:
    """Return the texts of ROS 1 strings."""
    return [each.data[4 : 4 + struct.unpack("<I", each.data[:4])[0]].decode() for each in samples]


@pytest.fixture
def chatter(tmp_path: Path) -> Path:
    """Return the lines "0" to "9", ten per second."""
    return recorder.write_rosbag1(tmp_path / "run.bag", recorder.lines())  # type: ignore[no-any-return]


async def test_the_newest_is_the_one_at_or_before_the_play_position_whenever_first_looked_at(
    chatter: Path, play: Play, clock: Any
) -> None:
    async with play(chatter) as playing:
        assert texts((await playing.subscribe("/chatter")).latest()) == ["0"]
        clock.forward(0.35)
        early = await playing.subscribe("/chatter")
        assert texts(early.latest()) == ["3"]
        clock.forward(0.05)
        assert texts(early.latest()) == ["4"]
        clock.forward(0.5)
        assert texts(early.latest()) == texts((await playing.subscribe("/chatter")).latest()) == ["9"]


async def test_samples_tell_when_they_were_recorded_and_count_from_one(chatter: Path, play: Play, clock: Any) -> None:
    async with play(chatter) as playing:
        subscription = await playing.subscribe("/chatter")
        clock.forward(0.2)
        (sample,) = subscription.latest()
        assert (sample.sequence, sample.epoch, sample.publisher) == (3, 0, "/talker")
        assert sample.received_ns == recorder.START_NS + 200_000_000
        assert sample == next(iter(playing.recordings.values())).message(2).sample


async def test_a_loop_begins_anew_with_the_next_epoch(chatter: Path, play: Play, clock: Any) -> None:
    async with play(chatter) as playing:
        subscription = await playing.subscribe("/chatter")
        clock.forward(0.9999)
        assert texts(subscription.latest()) == ["9"]
        clock.forward(0.0001)
        (sample,) = subscription.latest()
        assert (texts([sample]), sample.sequence, sample.epoch) == (["0"], 1, 1)
        clock.forward(100.0)
        assert subscription.latest()[0].epoch == 101


async def test_the_age_of_a_message_is_counted_by_the_clock_of_the_playing(
    chatter: Path, play: Play, clock: Any
) -> None:
    async with play(chatter, rate=2.0) as playing:
        subscription = await playing.subscribe("/chatter")
        clock.forward(0.03)  # twice as fast as recorded
        (first,) = subscription.latest()
        assert playing.age_ns(first) == 60_000_000
        clock.forward(0.02)
        (second,) = subscription.latest()
        assert (playing.age_ns(second), playing.age_ns(first)) == (0, 100_000_000)
        clock.forward(0.5)
        (again,) = subscription.latest()
        assert again.epoch == 1
        assert playing.age_ns(second) == 1_000_000_000


async def test_latched_messages_survive_a_loop_and_others_do_not(tmp_path: Path, play: Play, clock: Any) -> None:
    lines = [
        *recorder.lines("/chatter"),
        recorder.Line(0.45, "/map", "the map", "/server", latched=True),
        recorder.Line(0.45, "/once", "gone", "/server"),
    ]
    path = recorder.write_rosbag1(tmp_path / "run.bag", sorted(lines))
    async with play(path) as playing:
        latched, plain = await playing.subscribe("/map"), await playing.subscribe("/once")
        assert (list(latched.latest()), list(plain.latest())) == ([], [])
        clock.forward(0.5)
        kept = latched.latest()
        assert (texts(kept), texts(plain.latest())) == (["the map"], ["gone"])
        assert kept[0].latched
        clock.forward(0.6)
        assert plain.latest() == ()
        assert latched.latest() is kept
        assert kept[0].epoch == 0
        clock.forward(0.4)
        assert texts(latched.latest()) == ["the map"]
        assert latched.latest()[0].epoch == 1
        assert texts((await playing.subscribe("/map")).latest()) == ["the map"]


async def test_a_latched_topic_of_ros2_is_known_by_its_durability(tmp_path: Path, play: Play, clock: Any) -> None:
    lines = [recorder.Line(0.5, "/map", "the map", latched=True), *recorder.lines("/chatter")]
    for storage, version in (("mcap", 9), ("sqlite3", 8)):
        folder = recorder.write_rosbag2(tmp_path / storage, sorted(lines), storage=storage, version=version)
        async with play(folder) as playing:
            clock.forward(1.2)
            assert [each.latched for each in (await playing.subscribe("/map")).latest()] == [True]
            assert [each.latched for each in (await playing.subscribe("/chatter")).latest()] == [False]


async def test_each_publisher_of_a_topic_has_its_newest_shown_in_order_of_play(
    tmp_path: Path, play: Play, clock: Any
) -> None:
    lines = [recorder.Line(each / 10, "/tf", f"{each}", "/left" if each % 3 else "/right") for each in range(9)]
    path = recorder.write_rosbag1(tmp_path / "run.bag", lines)
    async with play(path) as playing:
        subscription = await playing.subscribe("/tf")
        deep = await playing.subscribe("/tf", depth=2)
        clock.forward(0.65)
        assert [(each.publisher, each.sequence) for each in subscription.latest()] == [("/left", 4), ("/right", 3)]
        assert texts(subscription.latest()) == ["5", "6"]
        assert texts(deep.latest()) == ["3", "4", "5", "6"]


async def test_a_watch_wakes_for_each_message_and_into_the_next_loop(tmp_path: Path) -> None:
    path = recorder.write_rosbag1(tmp_path / "run.bag", recorder.lines(count=4, every=0.05))
    seen: list[tuple[int, str]] = []

    class Sink:
        def graph_changed(self, graph: Any) -> None: ...

        def parameter_changed(self, name: str) -> None: ...

    playing = RecordingAdapter(path, AdapterOptions())
    await playing.open(Sink(), deadline=asyncio.get_running_loop().time() + 5)
    subscription = await playing.subscribe("/chatter")
    enough = asyncio.Event()

    def wake() -> None:
        (sample,) = subscription.latest()
        seen.append((sample.epoch, *texts([sample])))
        if sample.epoch == 2:
            enough.set()

    subscription.watch(wake)
    await asyncio.wait_for(enough.wait(), 60)
    await playing.close()
    assert seen == sorted(seen)
    assert len(set(seen)) >= 6


def test_two_definitions_of_one_name_live_side_by_side(tmp_path: Path) -> None:
    old, new = "float32 x\n", "float64 x\n"
    path = tmp_path / "run.bag"
    with Writer(path) as writer:
        md5s = [hashlib.md5(text.strip().encode()).hexdigest() for text in (old, new)]
        for text, md5, node in zip((old, new), md5s, ("/old", "/new"), strict=True):
            connection = writer.add_connection("/x", "my_msgs/msg/X", msgdef=text, md5sum=md5, callerid=node)
            writer.write(connection, 10**9, struct.pack("<f" if text is old else "<d", 1.5))
    with opened(path) as bag:
        values = {}
        for each in bag.messages():
            schema = bag.schema(each.sample.schema)
            values[each.sample.publisher] = schema.codec.decode(each.sample.data, each.sample.encoding).x
        assert values == {"/old": 1.5, "/new": 1.5}
        assert [ref.hash for ref in bag.types()] == md5s
