"""Depth of the subscriptions of recorded topics: sufficient for bursts, and reduced afterwards."""

from __future__ import annotations

from collections.abc import Iterator

from rosld.adapters.base import Subscription
from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.adapters.slots import Slot
from rosld.server.history.topic_feed import TopicFeed

MEBIBYTE = 1024 * 1024


class Source:
    """A robot with one topic, `slot`."""

    def __init__(self) -> None:
        self.slot = Slot()
        self._numbers: Iterator[int] = iter(range(1, 1 << 30))

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        return self.slot.subscribe(depth)

    def speak(self, count: int) -> None:
        """Publish this number of messages of a kibibyte."""
        for _, number in zip(range(count), self._numbers, strict=False):
            self.slot.put(Sample(bytes(1024), Encoding.CDR, TypeRef("a/msg/B"), "/driver", number, number))


async def looked(source: Source, feed: TopicFeed, counts: list[int], max_bytes: int) -> int:
    """Return the depth of a subscription after reads, each preceded by this number of messages."""
    for count in counts:
        source.speak(count)
        depth = feed.next_depth(feed.take(), max_bytes)
        if depth != feed.depth:
            await feed.resubscribe(source, depth)  # type: ignore[arg-type]
    return feed.depth


async def test_what_a_busy_moment_deepened_is_made_shallower_once_it_is_over() -> None:
    source = Source()
    feed = TopicFeed("/imu", source.slot.subscribe(32), 32)
    stalled = await looked(source, feed, [32, 100, 400, 1500], 32 * MEBIBYTE)
    assert (stalled, feed.dropped) == (4096, 0)
    calm = await looked(source, feed, [5] * 1500, 32 * MEBIBYTE)
    assert (calm, feed.dropped, len(source.slot.latest(4096))) == (64, 0, 64)


async def test_a_subscription_keeps_no_more_than_its_share_of_memory() -> None:
    source = Source()
    feed = TopicFeed("/imu", source.slot.subscribe(32), 32)
    depth = await looked(source, feed, [400, 400, 400, 400], MEBIBYTE // 4)
    assert depth * 1024 <= MEBIBYTE // 4
