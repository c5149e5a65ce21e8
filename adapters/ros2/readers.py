"""Readers of topics: one for each feed, with a profile that matches the topic's current publishers."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Endpoint, Graph, Qos, TypeRef, UnknownType
from rosld.adapters.ros2.feeds import Feed, Publishers
from rosld.adapters.ros2.graph import nodes_using
from rosld.adapters.ros2.middleware import DiscoveredEndpoint, Participant, Reader
from rosld.adapters.ros2.profiles import override_for, reading_profile
from rosld.adapters.ros2.types import Types

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
        self._feeds: dict[str, Feed] = {}
        self._checked_types: set[TypeRef] = set()
        self._checks: set[asyncio.Task[None] | None] = set()

    def reader_of(self, topic: str) -> Reader | None:
        """Return the reader of a topic, or None."""
        feed = self._feeds.get(topic)
        return feed.reader if feed is not None else None

    def add(self, feed: Feed) -> None:
        """Read a topic, starting with the next `follow`."""
        self._feeds[feed.topic] = feed

    def remove(self, feed: Feed) -> None:
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

    def follow(self, feed: Feed, graph: Graph, discovered: Sequence[DiscoveredEndpoint]) -> None:
        """Read a feed's topic with a profile that matches its current publishers."""
        if self._feeds.get(feed.topic) is not feed:
            return
        feed.own = graph.own_node
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
            finally:
                self._checks.discard(asyncio.current_task())

        self._checks.add(loop.create_task(check()))

    def _read_with(self, feed: Feed, type: TypeRef, profile: Qos) -> None:
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
