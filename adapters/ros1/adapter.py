"""The adapter: the contract's methods, on the server's loop, over a client that lives on a thread of its own."""

from __future__ import annotations

import asyncio
import itertools
import os
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from urllib.parse import urlsplit

from rosld.adapters.base import AdapterOptions, Capabilities, Published, Recording, Sink, Watch
from rosld.adapters.model import (
    Encoding,
    GoalId,
    Graph,
    Kind,
    Operation,
    Ref,
    Refused,
    RosError,
    Sample,
    Schema,
    TimedOut,
    TypeRef,
    Unreachable,
    without_lifecycle,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.ros1.client import Client
from rosld.adapters.ros1.publication import Publication
from rosld.adapters.ros1.stale_registrations import own_name
from rosld.adapters.ros1.subscription import Feed, Slot, TopicSubscription
from rosld.adapters.ros1.types import definition_folders
from rosld.adapters.thread import IoThread

DEFAULT_MASTER = "http://localhost:11311"
_CLOSE = 1.7
_CAPABILITIES = Capabilities(
    "ROS 1", Encoding.ROS1, writes=True, creates_topics=True, parameter_trees=True, parameter_server=True
)
_instances = itertools.count()


def master_address(source: str, environment: Mapping[str, str] = os.environ) -> tuple[str, int]:
    """Host and port of the master that a source names: `ros1://host:port`, or ROS_MASTER_URI for `ros1` or `ros1:`.

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
        raise ValueError(f"{source!r} names no master: give ros1://HOST:PORT, or set ROS_MASTER_URI=http://HOST:PORT")
    return host, port or 11311


def node_name() -> str:
    """Our name in ROS: `/rosld_HOST_PID`, with a number for further adapters in one process."""
    return own_name(next(_instances))


def adapter(source: str, options: AdapterOptions) -> Ros1Adapter:
    """Return the adapter for a source `ros1://host:port` or `ros1:`. Raises ValueError for what is neither."""
    return Ros1Adapter(master_address(source), options)


class Ros1Adapter:
    """A ROS 1 system, reached through its master. Implements the contract's `Adapter`."""

    def __init__(self, master: tuple[str, int], options: AdapterOptions) -> None:
        self._master = master
        self._options = options
        self._library = TypeLibrary(ros_version=1, folders=definition_folders(options.types))
        self._graph = Graph(0, own_node=node_name())
        self._thread: IoThread | None = None
        self._client: Client | None = None
        self._feeds: dict[str, Feed] = {}
        self._own: dict[str, Slot] = {}
        self._own_epochs = itertools.count()
        self._closing: asyncio.Future[None] | None = None

    @property
    def capabilities(self) -> Capabilities:
        """Everything ROS 1 has can be read and written."""
        return _CAPABILITIES

    @property
    def graph(self) -> Graph:
        """The computation graph as last known."""
        return self._client.graph if self._client else self._graph

    @property
    def recordings(self) -> Mapping[str, Recording]:
        """None: this is a live system."""
        return {}

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Look for the master. One that does not answer is waited for, with a graph that is Stale until it does."""
        thread = IoThread("rosld-ros1")
        thread.start()
        self._thread = thread

        left = _seconds_left(deadline)

        async def begin() -> Client:
            client = Client(self._master, self._graph.own_node, self._options, self._library, sink)
            await client.open(left)
            return client

        self._client = await thread.run(begin())

    async def close(self) -> None:
        """Unregister everything; idempotent, and over within two seconds even if the master hangs."""
        if self._closing is not None:
            await asyncio.shield(self._closing)
        elif self._thread is not None:
            self._closing = asyncio.ensure_future(self._close(self._thread))
            await asyncio.shield(self._closing)

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """What ROS 1 can do with a thing: a topic whose types conflict or cannot be read is not published to."""
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
        """What can be done with a parameter: one that a node declares cannot be deleted, for the node keeps it."""
        operations = self._client.parameters.operations(name) if self._client else frozenset()
        parameter = self.graph.parameters.get(name)
        is_declared = parameter is not None and parameter.descriptor is not None
        return operations - {Operation.DELETE_PARAMETER} if is_declared else operations

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        """Return the schema of a type. Raises UnknownType."""
        thread, client = self._running()
        try:
            return await asyncio.wait_for(thread.run(client.types.schema(ref)), max(_seconds_left(deadline), 0.0))
        except asyncio.TimeoutError as error:
            raise TimedOut(f"the definition of {ref.name} was not found in time") from error

    def known_types(self) -> Sequence[TypeRef]:
        """Return the types met so far, and those that the graph names."""
        graph = self.graph
        met = dict.fromkeys(self._library.known())
        named = {ref.name for ref in met}
        for topic in graph.topics.values():
            met.update(dict.fromkeys(ref for ref in topic.types if ref.hash or ref.name not in named))
        met.update(dict.fromkeys(service.type for service in graph.services.values() if service.type is not None))
        met.update(dict.fromkeys(one.type for one in graph.actions.values() if one.type and one.type.name not in named))
        return list(met)

    async def subscribe(self, topic: str, *, depth: int = 1) -> TopicSubscription:
        """Begin to read a topic, without a trace at the master."""
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

    def age_ns(self, sample: Sample) -> int:
        """How long ago a sample was received, simulated time or not."""
        return max(0, time.time_ns() - sample.received_ns)

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        """Publish, advertising first if need be. Raises Refused, Unreachable, UnknownType.

        With a subscriber connected it neither waits nor changes thread: the message is put where the thread
        takes it, one wake-up for many.
        """
        thread, client = self._running()
        publication = client.publications.by_topic.get(topic)
        if publication is None or not publication.carries(type):
            publication = await self._advertise(topic, type, deadline)
        elif not publication.matched:
            await thread.run(publication.wait_matched(1, _until(deadline), 0.0))
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
        """Stop advertising. Raises NotFound where rosld advertises nothing."""
        thread, client = self._running()
        self._own.pop(topic, None)

        async def leave() -> None:
            await client.publications.unadvertise(topic)
            await client.look()

        await thread.run(leave())

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        """Call a service. Raises Refused with the node's words, TimedOut, Unreachable, NotFound."""
        thread, client = self._running()
        return await thread.run(client.services.call(service, type, request, _until(deadline)))

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        """Send a goal by actionlib's topics. Raises Refused with the server's words, TimedOut, Unreachable."""
        thread, client = self._running()
        return await thread.run(client.actions.send(action, type, goal, _until(deadline)))

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        """Ask for a goal to be canceled. Raises NotFound, Unreachable."""
        thread, client = self._running()
        await thread.run(client.actions.cancel(goal, _until(deadline)))

    async def cancel_goals(self, action: str, *, deadline: float) -> None:
        """Ask for all goals of an action to be canceled. Raises NotFound, Unreachable."""
        thread, client = self._running()
        await thread.run(client.actions.cancel_all(action, _until(deadline)))

    async def follow_goals(self, action: str, *, deadline: float) -> Watch:
        """Follow an action's goals by its topics, without a registration at the master, until the watch is closed."""
        thread, client = self._running()
        await thread.run(client.actions.start_following(action, _until(deadline)))
        return _Following(lambda: thread.post(partial(client.actions.stop_following, action)))

    async def change_state(self, node: str, transition: str, *, deadline: float) -> None:
        """Raise Refused: ROS 1 has no managed nodes; NotFound for a node that is not there."""
        raise without_lifecycle(self.graph.nodes, node)

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        """Return the values of those names that exist, asked of the master now."""
        thread, client = self._running()
        return await thread.run(client.parameters.get(names, _until(deadline)))

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """Set them, all of them checked before the first is sent. Raises Refused naming the parameter.

        What a node declares by dynamic_reconfigure is set by the node, so that it takes effect; all else at the master.
        """
        thread, client = self._running()
        await thread.run(client.set_parameters(values, _until(deadline)))

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        """Delete them, trees whole. Raises NotFound."""
        thread, client = self._running()

        async def change() -> None:
            try:
                await client.parameters.delete(names, _until(deadline))
            finally:
                client.refresh()

        await thread.run(change())

    def _running(self) -> tuple[IoThread, Client]:
        if self._thread is None or self._client is None or self._closing is not None:
            raise Unreachable("the adapter is not open")
        return self._thread, self._client

    async def _advertise(self, topic: str, type: TypeRef, deadline: float) -> Publication:
        """Advertise a topic; when it returns the graph has it."""
        thread, client = self._running()
        known = self.graph.topics.get(topic)
        if known is not None and known.types and all(type.name != each.name for each in known.types):
            names = " and ".join(each.name for each in known.types)
            raise Refused(f"{topic} has the type {names}, not {type.name}")
        until = _until(deadline)

        async def advertise() -> Publication:
            publication = await client.publications.advertise(topic, type, until)
            await client.look()
            return publication

        return await thread.run(advertise())

    def _keep_own(self, publication: Publication, data: bytes, latch: bool) -> None:
        """What we publish is a sample of ours, there before `publish` returns."""
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
        if self._thread is not None and self._client is not None:
            self._thread.post(partial(self._client.stop_reading, feed))

    def _set_depth(self, feed: Feed) -> None:
        depth = max(each.depth for each in feed.subscriptions)
        if depth != feed.depth and self._thread is not None and self._client is not None:
            feed.depth = depth
            self._thread.post(partial(self._client.deepen, feed.topic))

    async def _close(self, thread: IoThread) -> None:
        began = time.monotonic()
        if self._client is not None:
            try:
                await asyncio.wait_for(thread.run(self._client.close()), _CLOSE)
            except (asyncio.TimeoutError, RosError):
                pass  # it was promised to be quick
        await thread.stop(max(0.2, _CLOSE - (time.monotonic() - began)))


class _Following:
    """A watch of the goals of an action."""

    def __init__(self, leave: Callable[[], None]) -> None:
        self._leave: Callable[[], None] | None = leave

    def close(self) -> None:
        """Follow them no longer. Idempotent."""
        leave, self._leave = self._leave, None
        if leave is not None:
            leave()


def _until(deadline: float) -> float:
    """Return a deadline of the running loop as a time of the thread's loop, whose clock is the monotonic one."""
    return time.monotonic() + _seconds_left(deadline)


def _seconds_left(deadline: float) -> float:
    return deadline - asyncio.get_running_loop().time()
