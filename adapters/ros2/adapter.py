"""The `Adapter` of ROS 2: its methods run on the server's event loop and use a system in a separate thread."""

from __future__ import annotations

import itertools
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial

from msgspec import Struct, field

from rosld.adapters.base import AdapterOptions, Capabilities, Published, Sink, Watch
from rosld.adapters.model import (
    Encoding,
    GoalId,
    Kind,
    Operation,
    Ref,
    RosError,
    Sample,
    Schema,
    TypeRef,
    Unreachable,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.ros2.feeds import Feed, TopicSubscription
from rosld.adapters.ros2.graph import nodes_using, type_in_use
from rosld.adapters.ros2.publications import Publication
from rosld.adapters.ros2.source import Source, read_source, require_rclpy
from rosld.adapters.ros2.system import System, unique_name
from rosld.adapters.ros2.types import definition_folders
from rosld.adapters.ros2.values import operations_on
from rosld.adapters.thread import IoThread, ThreadAdapter, thread_time


def adapter(source: str, options: AdapterOptions) -> Ros2Adapter:
    """Return the adapter for a source such as `ros2:?domain=42&namespace=/robot1`.

    Raises ValueError for other sources, and if rclpy is not available.
    """
    read = read_source(source)
    require_rclpy()
    return Ros2Adapter(read, options)


class _OwnMessages(Struct):
    """Newest messages that rosld published on a topic, and their count."""

    ref: TypeRef
    epoch: int
    samples: deque[Sample] = field(default_factory=lambda: deque(maxlen=1))
    sequence: int = 0


class Ros2Adapter(ThreadAdapter[System]):
    """A ROS 2 system, reached through rclpy."""

    capabilities = Capabilities(
        "ROS 2", Encoding.CDR, writes=True, creates_topics=True, parameter_trees=False, qos=True, hidden_names=True
    )

    def __init__(self, source: Source, options: AdapterOptions) -> None:
        library = TypeLibrary(ros_version=2, folders=definition_folders(options.types))
        super().__init__(library, f"{source.namespace.rstrip('/')}/{unique_name()}")
        self._source = source
        self._options = options
        self._feeds: dict[str, Feed] = {}
        self._epochs: dict[str, int] = {}
        self._own: dict[str, _OwnMessages] = {}
        self._own_epochs = itertools.count()

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Join the domain and discover the system. Raises Unreachable if the middleware cannot be started."""
        if self._system is not None:
            return
        thread = IoThread("rosld-ros2")
        thread.start()
        self._thread = thread
        until = thread_time(deadline)

        async def begin() -> System:
            try:
                system = System(self._source, self._graph, self._options, self._library, sink)
            except Exception as error:
                raise Unreachable(f"ROS 2's middleware cannot be started: {_one_line(error)}") from error
            await system.open(until)
            return system

        try:
            self._system = await thread.run(begin())
        except RosError:
            await thread.stop(1.0)
            self._thread = None
            raise

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """Return the operations of ROS 2 on a thing: topics with conflicting or unknown types are not writable."""
        graph = self.graph
        if ref.kind is Kind.TOPIC:
            topic = graph.topics.get(ref.name)
            if topic is None:
                return frozenset({Operation.PUBLISH})
            writable = len({each.name for each in topic.types}) <= 1 and topic.unreadable is None
            return frozenset({Operation.SUBSCRIBE, *([Operation.PUBLISH] if writable else [])})
        if ref.kind is Kind.SERVICE:
            service = graph.services.get(ref.name)
            return frozenset({Operation.CALL} if service is not None and service.uncallable is None else ())
        if ref.kind is Kind.ACTION:
            action = graph.actions.get(ref.name)
            usable = action is not None and action.servers and action.unusable is None
            return frozenset({Operation.SEND_GOAL} if usable else ())
        if ref.kind is Kind.NODE:
            node = graph.nodes.get(ref.name)
            movable = node is not None and node.lifecycle is not None and node.lifecycle.transitions
            return frozenset({Operation.CHANGE_STATE} if movable else ())
        if ref.kind is Kind.PARAMETER:
            if (parameter := graph.parameters.get(ref.name)) is not None:
                return operations_on(parameter.descriptor)
            owned = self._system is not None and self._system.parameters.owner_of(ref.name) is not None
            return frozenset({Operation.SET_PARAMETER} if owned else ())
        return frozenset()

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        """Return the schema of a type. Raises UnknownType."""
        _, system = self._running()
        graph = self.graph
        search = system.types.schema(type_in_use(graph, ref), nodes_using(graph, ref), thread_time(deadline))
        return await self._schema_in_time(ref.name, search, deadline)

    async def subscribe(self, topic: str, *, depth: int = 1) -> TopicSubscription:
        """Subscribe to a topic; messages are taken only when they are read."""
        thread, system = self._running()
        depth = max(1, depth)
        feed = self._feeds.get(topic)
        if feed is None:
            epoch = self._epochs.get(topic, -1) + 1
            feed = self._feeds[topic] = Feed(topic, self.graph.own_node, epoch, system.waiter)
            feed.deepen(depth)
            for sample in self._own[topic].samples if topic in self._own else ():
                feed.add_own_sample(sample)
            thread.post(partial(system.read, feed))
        subscription = TopicSubscription(feed, depth, self._release)
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
        thread, system = self._running()
        publication = system.publications.by_topic.get(topic)
        if publication is None or not publication.carries(type) or not system.publications.suits(publication, latch):
            publication = await self._advertise(topic, type, latch, deadline)
        elif not publication.matched:
            await thread.run(publication.wait_matched(1, thread_time(deadline), 0.0))
        self._keep_own(publication, data)
        thread.post(partial(publication.send, data))
        return Published(publication.matched)

    async def advertise(self, topic: str, type: TypeRef, *, deadline: float) -> None:
        """Create a writer that suits the readers, and wait for one. Raises Refused, Unreachable, UnknownType."""
        _, system = self._running()
        publication = system.publications.by_topic.get(topic)
        latch = publication is not None and publication.latched
        if publication is None or not publication.carries(type) or not system.publications.suits(publication, latch):
            await self._advertise(topic, type, latch, deadline)

    async def unadvertise(self, topic: str) -> None:
        """Stop advertising. Raises NotFound if rosld does not advertise the topic."""
        thread, system = self._running()
        self._own.pop(topic, None)
        if (feed := self._feeds.get(topic)) is not None:
            feed.forget_own()
        await thread.run(system.publications.unadvertise(topic))

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        """Call a service. Raises Refused, TimedOut, Unreachable, NotFound; ROS 2's nodes give no error messages."""
        thread, system = self._running()
        return await thread.run(system.call(service, type, request, thread_time(deadline)))

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        """Send a goal. Raises Refused if it is rejected, TimedOut, Unreachable, NotFound."""
        thread, system = self._running()
        return await thread.run(system.send_goal(action, type, goal, thread_time(deadline)))

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        """Request the cancellation of a goal. Raises Refused, TimedOut, Unreachable, NotFound."""
        thread, system = self._running()
        await thread.run(system.cancel_goal(goal, thread_time(deadline)))

    async def cancel_goals(self, action: str, *, deadline: float) -> None:
        """Request the cancellation of all goals of an action. Raises Refused, TimedOut, Unreachable, NotFound."""
        thread, system = self._running()
        await thread.run(system.cancel_goals(action, thread_time(deadline)))

    async def follow_goals(self, action: str, *, deadline: float) -> Watch:
        """Report all goals of an action to the sink. Raises NotFound."""
        thread, system = self._running()
        watch = ExitStack()
        watch.callback(thread.post, await thread.run(system.follow_goals(action, thread_time(deadline))))
        return watch

    async def change_state(self, node: str, transition: str, *, deadline: float) -> None:
        """Request a transition of a managed node. Raises Refused, TimedOut, Unreachable, NotFound."""
        thread, system = self._running()
        await thread.run(system.change_state(node, transition, thread_time(deadline)))

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        """Return the current values of existing parameters, from their nodes."""
        thread, system = self._running()
        return await thread.run(system.parameters.get(names, thread_time(deadline)))

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """Set parameters, all or none of each node. Raises Refused naming the parameter, with the node's reason."""
        thread, system = self._running()
        await thread.run(system.parameters.set(values, thread_time(deadline)))

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        """Delete parameters. Raises NotFound, and Refused if a node does not delete declared ones."""
        thread, system = self._running()
        await thread.run(system.parameters.delete(names, thread_time(deadline)))

    async def _advertise(self, topic: str, type: TypeRef, latch: bool, deadline: float) -> Publication:
        """Advertise a topic, and update the graph."""
        thread, system = self._running()
        self._require_type(topic, type)
        return await thread.run(system.publications.advertise(topic, type, latch, thread_time(deadline)))

    def _keep_own(self, publication: Publication, data: bytes) -> None:
        """Store a published message as a sample of rosld before `publish` returns."""
        topic = publication.topic
        own = self._own.get(topic)
        if own is None or own.ref != publication.ref:
            own = self._own[topic] = _OwnMessages(publication.ref, next(self._own_epochs))
        feed = self._feeds.get(topic)
        depth = feed.depth if feed else 1
        if own.samples.maxlen != depth:
            own.samples = deque(own.samples, maxlen=depth)
        own.sequence += 1
        node = self.graph.own_node
        now = time.time_ns()
        sample = Sample(data, Encoding.CDR, own.ref, node, now, own.sequence, own.epoch, publication.latched)
        own.samples.append(sample)
        if feed:
            feed.own = node
            feed.add_own_sample(sample)

    def _release(self, subscription: TopicSubscription) -> None:
        feed = subscription.feed
        feed.subscriptions.remove(subscription)
        if feed.subscriptions:
            return
        self._feeds.pop(feed.topic, None)
        self._epochs[feed.topic] = feed.epoch
        if self._thread is not None and self._system is not None:
            self._thread.post(partial(self._system.stop_reading, feed))

    def _set_depth(self, feed: Feed) -> None:
        depth = max(each.depth for each in feed.subscriptions)
        if depth > feed.depth and self._thread is not None and self._system is not None:
            feed.deepen(depth)
            self._thread.post(partial(self._system.deepen, feed))


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
