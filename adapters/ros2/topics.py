"""Topics that rosld publishes, and those that it reads, with profiles that match all other endpoints.

Created on the ROS thread; the number of matched subscribers is available on any thread.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Endpoint, Graph, NotFound, Qos, Refused, TypeRef, UnknownType
from rosld.adapters.ros2.feeds import Publishers, TopicFeed
from rosld.adapters.ros2.graph import nodes_using
from rosld.adapters.ros2.middleware import DiscoveredEndpoint, Participant, Reader, Writer
from rosld.adapters.ros2.profiles import is_compatible, override_for, publishing_profile, reading_profile
from rosld.adapters.ros2.types import Types
from rosld.adapters.thread import Tasks

_PAUSE = 0.005
_PATIENCE = 0.5
"""Maximum seconds that a new publication waits for further subscribers after the first."""
_SETTLING = 0.1
"""Seconds for a matched best-effort subscriber, to which nothing is sent twice, to discover us as well."""


class Publication:
    """A topic that rosld publishes; `ours` returns rosld's own reader of it, which is not counted."""

    def __init__(self, topic: str, ref: TypeRef, writer: Writer, ours: Callable[[], Reader | None]) -> None:
        self.topic = topic
        self.ref = ref
        self.writer = writer
        self._ours = ours

    @property
    def qos(self) -> Qos:
        """Profile of the publication."""
        return self.writer.qos

    @property
    def latched(self) -> bool:
        """Whether later subscribers receive the last message."""
        return self.qos.durability == "transient_local"

    @property
    def matched(self) -> int:
        """Number of connected subscribers."""
        reader = self._ours()
        has_own_reader = reader is not None and is_compatible(reader.qos, self.qos)
        return max(0, self.writer.subscribers() - has_own_reader)

    def carries(self, type: TypeRef) -> bool:
        """Whether the topic accepts messages of this type."""
        return type.name == self.ref.name and type.hash in (None, self.ref.hash)

    async def wait_matched(self, count: int, until: float, patience: float) -> None:
        """Wait for one subscriber until a time, then at most `patience` seconds for `count` subscribers."""
        loop = asyncio.get_running_loop()
        while self.matched == 0 and loop.time() < until:  # noqa: ASYNC110 - no event reports a match
            await asyncio.sleep(_PAUSE)
        enough = min(until, loop.time() + patience)
        while self.matched < count and loop.time() < enough:  # noqa: ASYNC110
            await asyncio.sleep(_PAUSE)

    async def wait_settled(self, until: float) -> None:
        """Wait until matched subscribers have discovered us, too."""
        left = until - asyncio.get_running_loop().time()
        if left > 0 and self.matched:
            await asyncio.sleep(min(left, _SETTLING))

    def send(self, data: bytes, latch: bool) -> None:
        """Publish a message; one that the middleware refuses is lost, as on a broken connection."""
        try:
            self.writer.publish(data)
        except ValueError:
            pass


class Publications:
    """The topics that rosld publishes. Belongs to the ROS thread, except for `suitable` and `is_latched`.

    `graph` returns the current graph, `reader_of` rosld's own reader of a topic, and `poll` updates a topic's endpoints
    in the graph.
    """

    def __init__(
        self,
        participant: Participant,
        types: Types,
        options: AdapterOptions,
        graph: Callable[[], Graph],
        reader_of: Callable[[str], Reader | None],
        poll: Callable[[tuple[str, ...]], Awaitable[None]],
    ) -> None:
        self._participant = participant
        self._types = types
        self._options = options
        self._graph = graph
        self._reader_of = reader_of
        self._poll = poll
        self._by_topic: dict[str, Publication] = {}
        self._advertising = asyncio.Lock()

    @property
    def by_topic(self) -> Mapping[str, Publication]:
        """Current publications by topic."""
        return self._by_topic

    async def advertise(self, topic: str, type: TypeRef, latch: bool, until: float) -> Publication:
        """Start publishing a topic, and wait for its subscribers as specified by `Adapter.publish`.

        Raises Refused if we publish the topic with another type, UnknownType, Unreachable.
        """
        expected = 1
        async with self._advertising:
            publication = self._by_topic.get(topic)
            if publication is not None and not publication.carries(type):
                raise Refused(f"rosld publishes {topic} as {publication.ref.name}, not {type.name}")
            if publication is None or not self._suits(publication, latch):
                publication = await self._advertise(topic, type, latch, until)
                existing = self._graph().topics.get(topic)
                expected = max(1, len(existing.subscribers) if existing else 0)
        # Outside of the lock, so that a topic whose subscribers never match does not delay others.
        await publication.wait_matched(expected, until, _PATIENCE)
        await publication.wait_settled(until)
        return publication

    def suitable(self, topic: str, type: TypeRef, latch: bool) -> Publication | None:
        """Return the publication of a topic if it accepts messages of this type, and all subscribers its profile."""
        publication = self.by_topic.get(topic)
        if publication is None or not publication.carries(type) or not self._suits(publication, latch):
            return None
        return publication

    def is_latched(self, publication: Publication, latch: bool) -> bool:
        """Whether a message is latched: as its publication is."""
        return publication.latched

    def _suits(self, publication: Publication, latch: bool) -> bool:
        required = self._profile(publication.topic, latch or publication.latched)
        return replace(required, depth=publication.qos.depth) == publication.qos

    async def unadvertise(self, topic: str) -> None:
        """Stop publishing. Raises NotFound."""
        async with self._advertising:
            publication = self._by_topic.pop(topic, None)
            if publication is None:
                raise NotFound(f"rosld does not publish {topic}")
            publication.writer.close()
            if not self._by_topic:
                self._participant.hide()
            await self._poll((topic,))

    def close(self) -> None:
        """Stop publishing everything."""
        for publication in self._by_topic.values():
            publication.writer.close()

    def _profile(self, name: str, latch: bool) -> Qos:
        topic = self._graph().topics.get(name)
        subscribers = topic.subscribers if topic is not None else ()
        return publishing_profile(subscribers, latch=latch, override=override_for(name, self._options.qos))

    async def _advertise(self, topic: str, type: TypeRef, latch: bool, until: float) -> Publication:
        if (words := self._types.problem(type.name)) is not None:
            raise UnknownType(words)
        schema = await self._types.schema(type, nodes_using(self._graph(), type), until)
        before = self._by_topic.pop(topic, None)
        if before is not None:
            latch = latch or before.latched
            before.writer.close()
        profile = self._profile(topic, latch)
        try:
            self._participant.show(self._graph().own_node.rpartition("/")[2])
            writer = self._participant.writer(topic, schema.ref.name, profile)
        except Exception as error:
            if not self._by_topic:
                self._participant.hide()
            raise Refused(f"{topic} cannot be published: {error}") from error
        publication = Publication(topic, schema.ref, writer, partial(self._reader_of, topic))
        self._by_topic[topic] = publication
        await self._poll((topic,))
        return publication


_CHECK_SECONDS = 5.0
"""Maximum seconds for checking whether messages of a type can be decoded."""


class Readers:
    """Readers of feeds. `refresh_soon` is called when a topic is found to be unreadable. Belongs to the ROS thread."""

    def __init__(
        self, participant: Participant, types: Types, options: AdapterOptions, refresh_soon: Callable[[], None]
    ) -> None:
        self._participant = participant
        self._types = types
        self._options = options
        self._refresh_soon = refresh_soon
        self._feeds: dict[str, TopicFeed] = {}
        self._checked_types: set[TypeRef] = set()
        self._checks = Tasks()

    def reader_of(self, topic: str) -> Reader | None:
        """Return the reader of a topic, or None."""
        feed = self._feeds.get(topic)
        return feed.reader if feed is not None else None

    def add(self, feed: TopicFeed) -> None:
        """Read a topic, starting with the next `follow`."""
        self._feeds[feed.topic] = feed

    def remove(self, feed: TopicFeed) -> None:
        """Stop reading a topic."""
        if self._feeds.get(feed.topic) is feed:
            del self._feeds[feed.topic]
        if (reader := feed.read_with(None)) is not None:
            reader.close()

    def close(self) -> None:
        """Stop reading all topics."""
        for feed in self._feeds.values():
            if (reader := feed.read_with(None)) is not None:
                reader.close()

    def follow_all(self, graph: Graph, endpoints_of: Callable[[str], Sequence[DiscoveredEndpoint]]) -> None:
        """Read all topics with profiles that match their current publishers, returned by `endpoints_of`."""
        for feed in list(self._feeds.values()):
            self.follow(feed, graph, endpoints_of(feed.topic))

    def follow(self, feed: TopicFeed, graph: Graph, discovered: Sequence[DiscoveredEndpoint]) -> None:
        """Read a feed's topic with a profile that matches its current publishers."""
        if self._feeds.get(feed.topic) is not feed:
            return
        others = [each for each in discovered if each.node != graph.own_node]
        publishers = self._publishers(feed.topic, graph, [each for each in others if each.node])
        if publishers != feed.publishers:
            feed.publishers = publishers
        type = publishers.type
        if feed.topic not in graph.topics or type is None or self._types.problem(type.name) is not None:
            return
        self._check_type(type, graph)
        endpoints = [Endpoint(each.node, qos=each.qos) for each in others]
        profile = reading_profile(endpoints, feed.depth, override_for(feed.topic, self._options.qos))
        reader = feed.reader
        if reader is not None and reader.qos.depth >= profile.depth:
            profile = replace(profile, depth=reader.qos.depth)
        if reader is None or reader.qos != profile:
            self._read_with(feed, type, profile)

    def _check_type(self, type: TypeRef, graph: Graph) -> None:
        """Check once whether messages of a type can be decoded; if not, its topics are marked as unreadable."""
        if type in self._checked_types:
            return
        self._checked_types.add(type)
        loop = asyncio.get_running_loop()

        async def check() -> None:
            try:
                await self._types.schema(type, nodes_using(graph, type), loop.time() + _CHECK_SECONDS)
            except UnknownType as error:
                self._types.note_problem(type.name, error.sentence)
                self._refresh_soon()

        self._checks.begin(check())

    def _read_with(self, feed: TopicFeed, type: TypeRef, profile: Qos) -> None:
        try:
            reader: Reader | None = self._participant.reader(feed.topic, type.name, profile)
        except Exception:  # a name that ROS 2 does not allow, or a profile that the middleware refuses
            return
        if (before := feed.read_with(reader)) is not None:
            before.close()

    def _publishers(self, name: str, graph: Graph, discovered: Sequence[DiscoveredEndpoint]) -> Publishers:
        topic = graph.topics.get(name)
        types = {each.node: self._types.with_hash(each.type) for each in discovered}
        first = next(iter(types.values()), None)
        if first is None and topic is not None and topic.types:
            first = self._types.with_hash(topic.types[0])
        return Publishers(
            Counter(each.node for each in discovered),
            {each.gid: each.node for each in discovered if each.gid},
            types,
            frozenset(each.node for each in discovered if each.qos.durability == "transient_local"),
            first,
        )
