"""The `Adapter` of ROS 1: its methods run on the server's event loop and use a client in a separate thread."""

from __future__ import annotations

import asyncio
import itertools
import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from urllib.parse import urlsplit

from rosld.adapters.base import AdapterOptions, Capabilities, Published, Sink, Watch
from rosld.adapters.model import (
    Encoding,
    GoalId,
    Kind,
    Operation,
    Ref,
    Schema,
    TypeRef,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.ros1.client import Client
from rosld.adapters.ros1.master import own_name
from rosld.adapters.ros1.publication import Publication
from rosld.adapters.ros1.subscription import Feed, Slot, TopicSubscription
from rosld.adapters.ros1.types import definition_folders
from rosld.adapters.thread import IoThread, ThreadAdapter, seconds_left, thread_time

DEFAULT_MASTER = "http://localhost:11311"
_instances = itertools.count()


def master_address(source: str, environment: Mapping[str, str] = os.environ) -> tuple[str, int]:
    """Return host and port of the master in a source: `ros1://host:port`, or ROS_MASTER_URI for `ros1` or `ros1:`.

    Raises ValueError with a sentence for the user.
    """
    rest = source.removeprefix("ros1").removeprefix(":").removeprefix("//")
    uri = f"http://{rest}" if rest else environment.get("ROS_MASTER_URI") or DEFAULT_MASTER
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ValueError(f"{uri!r} does not name a master: {error}") from error
    if parts.scheme != "http" or not host or parts.path.strip("/"):
        raise ValueError(
            f"{source!r} does not name a master: use ros1://HOST:PORT, or set ROS_MASTER_URI=http://HOST:PORT"
        )
    return host, port or 11311


def node_name() -> str:
    """Return our name in ROS: `/rosld_HOST_PID`, with a number for further adapters in one process."""
    return own_name(next(_instances))


def adapter(source: str, options: AdapterOptions) -> Ros1Adapter:
    """Return the adapter for a source `ros1://host:port` or `ros1:`. Raises ValueError for other sources."""
    return Ros1Adapter(master_address(source), options)


class Ros1Adapter(ThreadAdapter[Client]):
    """A ROS 1 system, reached through its master."""

    capabilities = Capabilities(
        "ROS 1", Encoding.ROS1, writes=True, creates_topics=True, parameter_trees=True, parameter_server=True
    )

    def __init__(self, master: tuple[str, int], options: AdapterOptions) -> None:
        super().__init__(TypeLibrary(ros_version=1, folders=definition_folders(options.types)), node_name())
        self._master = master
        self._options = options
        self._feeds: dict[str, Feed] = {}
        self._own: dict[str, Slot] = {}
        self._own_epochs = itertools.count()

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Connect to the master. If it does not respond, the graph is Stale until it does."""
        thread = IoThread("rosld-ros1")
        thread.start()
        self._thread = thread

        left = seconds_left(deadline)

        async def begin() -> Client:
            client = Client(self._master, self._graph.own_node, self._options, self._library, sink)
            await client.open(left)
            return client

        self._system = await thread.run(begin())

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """Return the operations of ROS 1 on a thing: topics with conflicting or unreadable types are not writable."""
        graph = self.graph
        if ref.kind is Kind.TOPIC:
            topic = graph.topics.get(ref.name)
            if topic is None:
                return frozenset({Operation.PUBLISH})
            writable = len(topic.types) <= 1 and topic.unreadable is None
            return frozenset({Operation.SUBSCRIBE, *([Operation.PUBLISH] if writable else [])})
        if ref.kind is Kind.SERVICE:
            service = graph.services.get(ref.name)
            return frozenset({Operation.CALL} if service is not None and service.uncallable is None else ())
        if ref.kind is Kind.ACTION:
            action = graph.actions.get(ref.name)
            return frozenset({Operation.SEND_GOAL} if action is not None and action.unusable is None else ())
        if ref.kind is Kind.PARAMETER:
            return self._parameter_operations(ref.name)
        return frozenset()

    def _parameter_operations(self, name: str) -> frozenset[Operation]:
        """Return the operations on a parameter: one that a node declares cannot be deleted."""
        operations = self._system.parameters.operations(name) if self._system else frozenset()
        parameter = self.graph.parameters.get(name)
        is_declared = parameter is not None and parameter.descriptor is not None
        return operations - {Operation.DELETE_PARAMETER} if is_declared else operations

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        """Return the schema of a type. Raises UnknownType."""
        _, client = self._running()
        return await self._schema_in_time(ref.name, client.types.schema(ref), deadline)

    async def subscribe(self, topic: str, *, depth: int = 1) -> TopicSubscription:
        """Subscribe to a topic, without registering at the master."""
        thread, client = self._running()
        feed = self._feeds.get(topic)
        if feed is None:
            feed = self._feeds[topic] = Feed(topic, asyncio.get_running_loop(), self._own)
            feed.depth = max(1, depth)
            thread.post(partial(client.read, feed))
        subscription = TopicSubscription(feed, max(1, depth), self._release)
        feed.subscriptions.append(subscription)
        self._set_depth(feed)
        return subscription

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        """Publish a message, advertising the topic first if necessary. Raises Refused, Unreachable, UnknownType.

        With a connected subscriber, this neither waits nor changes threads: messages are queued for the thread, with
        one wake-up for many.
        """
        thread, client = self._running()
        publication = client.publications.by_topic.get(topic)
        if publication is None or not publication.carries(type):
            publication = await self._advertise(topic, type, deadline)
        elif not publication.matched:
            await thread.run(publication.wait_matched(1, thread_time(deadline), 0.0))
        self._keep_own(publication, data, latch)
        thread.post(partial(publication.send, data, latch))
        return Published(publication.matched)

    async def advertise(self, topic: str, type: TypeRef, *, deadline: float) -> None:
        """Register as a publisher, and wait for a subscriber. Raises Refused, Unreachable, UnknownType."""
        _, client = self._running()
        publication = client.publications.by_topic.get(topic)
        if publication is None or not publication.carries(type):
            await self._advertise(topic, type, deadline)

    async def unadvertise(self, topic: str) -> None:
        """Stop advertising. Raises NotFound if rosld does not advertise the topic."""
        thread, client = self._running()
        self._own.pop(topic, None)

        async def leave() -> None:
            await client.publications.unadvertise(topic)
            await client.poll()

        await thread.run(leave())

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        """Call a service. Raises Refused with the node's message, TimedOut, Unreachable, NotFound."""
        thread, client = self._running()
        return await thread.run(client.services.call(service, type, request, thread_time(deadline)))

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        """Send a goal by actionlib's topics. Raises Refused with the server's message, TimedOut, Unreachable."""
        thread, client = self._running()
        return await thread.run(client.actions.send(action, type, goal, thread_time(deadline)))

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        """Request the cancellation of a goal. Raises NotFound, Unreachable."""
        thread, client = self._running()
        await thread.run(client.actions.cancel(goal, thread_time(deadline)))

    async def cancel_goals(self, action: str, *, deadline: float) -> None:
        """Request the cancellation of all goals of an action. Raises NotFound, Unreachable."""
        thread, client = self._running()
        await thread.run(client.actions.cancel_all(action, thread_time(deadline)))

    async def follow_goals(self, action: str, *, deadline: float) -> Watch:
        """Follow an action's goals until the watch is closed, without registering at the master."""
        thread, client = self._running()
        await thread.run(client.actions.start_following(action, thread_time(deadline)))
        watch = ExitStack()
        watch.callback(thread.post, partial(client.actions.stop_following, action))
        return watch

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        """Return the current values of existing parameters, from the master."""
        thread, client = self._running()
        return await thread.run(client.parameters.get(names, thread_time(deadline)))

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """Set parameters; all are checked before the first is sent. Raises Refused naming the parameter.

        Parameters of dynamic_reconfigure are set by their nodes, so that they take effect; all others at the master.
        """
        thread, client = self._running()
        await thread.run(client.set_parameters(values, thread_time(deadline)))

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        """Delete parameters and trees of parameters. Raises NotFound."""
        thread, client = self._running()

        async def change() -> None:
            try:
                await client.parameters.delete(names, thread_time(deadline))
            finally:
                client.refresh()

        await thread.run(change())

    async def _advertise(self, topic: str, type: TypeRef, deadline: float) -> Publication:
        """Advertise a topic, and update the graph."""
        thread, client = self._running()
        self._require_type(topic, type)
        until = thread_time(deadline)

        async def advertise() -> Publication:
            publication = await client.publications.advertise(topic, type, until)
            await client.poll()
            return publication

        return await thread.run(advertise())

    def _keep_own(self, publication: Publication, data: bytes, latch: bool) -> None:
        """Store a published message as a sample of rosld before `publish` returns."""
        topic = publication.topic
        slot = self._own.get(topic)
        if slot is None or slot.schema != publication.ref:
            slot = self._own[topic] = Slot(self.graph.own_node, next(self._own_epochs))
            slot.schema = publication.ref
        slot.latched = latch
        feed = self._feeds.get(topic)
        slot.take((data,), 1, feed.depth if feed else 1)
        if feed:
            feed.arrived_here()

    def _release(self, subscription: TopicSubscription) -> None:
        feed = subscription.feed
        feed.subscriptions.remove(subscription)
        if feed.subscriptions:
            self._set_depth(feed)
            return
        del self._feeds[feed.topic]
        if self._thread is not None and self._system is not None:
            self._thread.post(partial(self._system.stop_reading, feed))

    def _set_depth(self, feed: Feed) -> None:
        depth = max(each.depth for each in feed.subscriptions)
        if depth != feed.depth and self._thread is not None and self._system is not None:
            feed.depth = depth
            self._thread.post(partial(self._system.deepen, feed.topic))
