"""Adapters of live systems: the thread that speaks ROS, and the base class of those that have one.

The thread has its own event loop. Sockets are read there and nowhere else, so that a busy server never makes a robot's
publisher wait.
"""

from __future__ import annotations

import asyncio
import itertools
import threading
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Coroutine, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

from msgspec import Struct

from rosld.adapters.base import Adapter, Published, Sink, Watch
from rosld.adapters.model import (
    Encoding,
    GoalId,
    Graph,
    Kind,
    Operation,
    ParameterValue,
    Ref,
    Refused,
    RosError,
    Sample,
    Schema,
    TimedOut,
    TypeRef,
    Unreachable,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.slots import Feed, TopicSubscription

_T = TypeVar("_T")
_MAX_AT_ONCE = 1000
_CLOSE_SECONDS = 1.7


class Tasks:
    """Tasks in the background of the running loop, referenced until they end."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[None]] = set()

    def __bool__(self) -> bool:
        return bool(self._tasks)

    def begin(self, work: Coroutine[Any, Any, None]) -> None:
        """Run in the background."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def wait(self, seconds: float) -> None:
        """Wait until all have ended, for at most `seconds`."""
        if self._tasks:
            await asyncio.wait(tuple(self._tasks), timeout=seconds)

    def cancel(self) -> None:
        for task in self._tasks:
            task.cancel()


class IoThread:
    """An event loop on a daemon thread."""

    def __init__(self, name: str) -> None:
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._tasks: set[asyncio.Task[Any]] = set()
        self._actions: deque[Callable[[], None]] = deque()
        self._wake_scheduled = False
        self._stopped = False

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    async def run(self, coroutine: Coroutine[Any, Any, _T]) -> _T:
        """Return the result of a coroutine that runs on the thread. Cancelling the await leaves it running.

        Raises what it raises, or Unreachable once the thread has stopped.
        """
        server = asyncio.get_running_loop()
        answer: asyncio.Future[_T] = server.create_future()

        def done(task: asyncio.Task[_T]) -> None:
            self._tasks.discard(task)
            _call_soon(server, lambda: _settle(answer, task))

        def start() -> None:
            task = self.loop.create_task(coroutine)
            self._tasks.add(task)
            task.add_done_callback(done)

        if self._stopped or not _call_soon(self.loop, start):
            coroutine.close()
            raise Unreachable("the adapter is closed")
        return await answer

    def post(self, action: Callable[[], None]) -> None:
        """Run an action on the thread soon, in the order of posts; many posts cost one wake-up."""
        self._actions.append(action)
        if not self._wake_scheduled:
            self._wake_scheduled = True
            if not _call_soon(self.loop, self._drain):
                self._actions.clear()

    async def stop(self, timeout: float) -> None:
        """Cancel everything on the thread and end it; waits at most `timeout` seconds."""
        if self._stopped:
            return
        self._stopped = True
        if self._thread.is_alive():
            _call_soon(self.loop, self.loop.stop)
            server = asyncio.get_running_loop()
            await server.run_in_executor(None, self._thread.join, timeout)
        else:
            self.loop.close()

    def _run(self) -> None:
        asyncio.set_event_loop(self.loop)
        try:
            self.loop.run_forever()
            self.loop.run_until_complete(self._cancel_all())
        finally:
            self.loop.close()

    async def _cancel_all(self) -> None:
        tasks = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=0.5)
        await asyncio.sleep(0)  # let closed transports tell their protocols

    def _drain(self) -> None:
        self._wake_scheduled = False
        for _ in range(min(len(self._actions), _MAX_AT_ONCE)):
            self._actions.popleft()()
        if self._actions and not self._wake_scheduled:  # sockets get their turn in between
            self._wake_scheduled = True
            self.loop.call_soon(self._drain)


def _call_soon(loop: asyncio.AbstractEventLoop, action: Callable[[], object]) -> bool:
    """Schedule a call on another thread's loop; return False if it is closed."""
    try:
        loop.call_soon_threadsafe(action)
    except RuntimeError:
        return False
    return True


def _settle(answer: asyncio.Future[_T], task: asyncio.Task[_T]) -> None:
    if answer.done():
        if not task.cancelled():
            task.exception()  # nobody waits for it any more
    elif task.cancelled():
        answer.set_exception(Unreachable("the adapter was closed meanwhile"))
    elif error := task.exception():
        answer.set_exception(error)
    else:
        answer.set_result(task.result())


class LivePublication(Protocol):
    """A topic that rosld publishes."""

    topic: str
    ref: TypeRef

    @property
    def matched(self) -> int: ...

    async def wait_matched(self, count: int, until: float, patience: float) -> None: ...

    def send(self, data: bytes, latch: bool) -> None: ...


class LivePublications(Protocol):
    """The topics that rosld publishes."""

    def suitable(self, topic: str, type: TypeRef, latch: bool) -> LivePublication | None:
        """Return the publication of a topic if messages of this type can be sent with it as it is (thread-safe)."""

    def is_latched(self, publication: Any, latch: bool) -> bool:
        """Whether a message that is sent, to be latched or not, reaches later subscribers."""


class LiveFeed(Feed):
    """A feed of a topic of a live system, with the newest messages that rosld published on it."""

    def __init__(self, topic: str, changed: Callable[[Any], None] = lambda _: None) -> None:
        super().__init__(changed)
        self.topic = topic
        self.own: tuple[Sample, ...] = ()

    def put_own(self, own: tuple[Sample, ...]) -> None:
        """Replace the messages of rosld."""
        self.own = own
        self.notify()


class _OwnMessages(Struct):
    """Newest messages that rosld published on a topic, and their count."""

    ref: TypeRef
    epoch: int
    samples: tuple[Sample, ...] = ()
    sequence: int = 0


class LiveActions(Protocol):
    """Actions of a live system: what `Adapter` promises, with `until` as a time of the thread's loop."""

    async def send(self, action: str, type: TypeRef, goal: bytes, until: float) -> GoalId: ...

    async def cancel(self, goal: GoalId, until: float) -> None: ...

    async def cancel_all(self, action: str, until: float) -> None: ...

    async def follow(self, action: str, until: float) -> Callable[[], None]:
        """Report all goals of an action until the returned function is called."""


class LiveParameters(Protocol):
    """Parameters of a live system: what `Adapter` promises, with `until` as a time of the thread's loop."""

    async def get(self, names: Sequence[str], until: float) -> Mapping[str, ParameterValue]: ...

    async def set(self, values: Mapping[str, ParameterValue], until: float) -> None: ...

    async def delete(self, names: Sequence[str], until: float) -> None: ...


class LiveSystem(Protocol):
    """A system that lives on the thread of its adapter."""

    @property
    def actions(self) -> LiveActions: ...

    @property
    def parameters(self) -> LiveParameters: ...

    @property
    def publications(self) -> LivePublications: ...

    @property
    def graph(self) -> Graph:
        """The computation graph as last known; any thread may read it."""

    async def close(self) -> None:
        """Leave the system."""

    async def advertise(self, topic: str, type: TypeRef, latch: bool, until: float) -> LivePublication:
        """Publish a topic, wait for its subscribers, and update the graph."""

    async def unadvertise(self, topic: str) -> None:
        """Stop publishing a topic, and update the graph. Raises NotFound."""

    async def call(self, service: str, type: TypeRef, request: bytes, until: float) -> bytes: ...

    def read(self, feed: Any) -> None:
        """Start reading the topic of a feed."""

    def deepen(self, feed: Any) -> None:
        """Apply a new depth of a feed."""

    def stop_reading(self, feed: Any) -> None:
        """Stop reading the topic of a feed."""


_S = TypeVar("_S", bound=LiveSystem)
_F = TypeVar("_F", bound=LiveFeed)


class ThreadAdapter(Adapter, Generic[_S, _F]):
    """Base class of adapters of systems that are reached from a thread of their own."""

    def __init__(self, library: TypeLibrary, own_node: str) -> None:
        self._library = library
        self._graph = Graph(0, own_node=own_node)
        self._thread: IoThread | None = None
        self._system: _S | None = None
        self._feeds: dict[str, _F] = {}
        self._own: dict[str, _OwnMessages] = {}
        self._own_epochs = itertools.count()
        self._closing: asyncio.Future[None] | None = None

    @property
    def graph(self) -> Graph:
        return self._system.graph if self._system else self._graph

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Connect to the system. If it does not respond, the graph is Stale until it does."""
        if self._system is not None:
            return
        self._thread = IoThread(f"rosld-{type(self).__name__}")
        self._thread.start()
        try:
            self._system = await self._thread.run(self._begin(sink, thread_time(deadline)))
        except RosError:
            await self._thread.stop(1.0)
            self._thread = None
            raise

    @abstractmethod
    async def _begin(self, sink: Sink, until: float) -> _S:
        """Return the system, opened before a time of the thread's loop. Runs on the thread."""

    async def close(self) -> None:
        """Leave the system within two seconds, even if it hangs. Idempotent."""
        if self._closing is not None:
            await asyncio.shield(self._closing)
        elif self._thread is not None:
            self._closing = asyncio.ensure_future(self._close(self._thread))
            await asyncio.shield(self._closing)

    async def subscribe(self, topic: str, *, depth: int = 1) -> TopicSubscription:
        """Subscribe to a topic, whether or not it exists yet."""
        thread, system = self._running()
        feed = self._feeds.get(topic)
        if feed is not None:
            return feed.subscribe(depth)
        feed = self._new_feed(topic, system)
        subscription = feed.subscribe(depth)
        if (own := self._own.get(topic)) is not None:
            feed.put_own(own.samples)
        self._feeds[topic] = feed
        thread.post(partial(system.read, feed))
        return subscription

    @abstractmethod
    def _new_feed(self, topic: str, system: _S) -> _F:
        """Return a feed of a topic, which calls `_apply` when its subscriptions change."""

    def _apply(self, topic: str, feed: _F) -> None:
        """Read a topic as deep as its subscriptions need, or no longer."""
        if not feed.subscriptions:
            self._feeds.pop(topic, None)
        if self._thread is not None and self._system is not None:
            self._thread.post(partial(self._system.deepen if feed.subscriptions else self._system.stop_reading, feed))

    def known_types(self) -> Sequence[TypeRef]:
        """Return the types met so far, and those that the graph names."""
        graph = self.graph
        types = dict.fromkeys(self._library.known())
        named = {ref.name for ref in types}
        typed = [ref for topic in graph.topics.values() for ref in topic.types]
        typed += [service.type for service in graph.services.values() if service.type is not None]
        typed += [action.type for action in graph.actions.values() if action.type is not None]
        types.update(dict.fromkeys(ref for ref in typed if ref.hash or ref.name not in named))
        return list(types)

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        """Publish a message, advertising the topic first if necessary. Raises Refused, Unreachable, UnknownType.

        With a connected subscriber, this neither waits nor changes threads: messages are queued for the thread, with
        one wake-up for many.
        """
        thread, system = self._running()
        publication = system.publications.suitable(topic, type, latch)
        if publication is None:
            publication = await self._advertise(topic, type, latch, deadline)
        elif not publication.matched:
            await thread.run(publication.wait_matched(1, thread_time(deadline), 0.0))
        self._keep_own(publication, data, system.publications.is_latched(publication, latch))
        thread.post(partial(publication.send, data, latch))
        return Published(publication.matched)

    async def advertise(self, topic: str, type: TypeRef, *, deadline: float) -> None:
        """Publish a topic, and wait for a subscriber. Raises Refused, Unreachable, UnknownType."""
        _, system = self._running()
        if system.publications.suitable(topic, type, False) is None:
            await self._advertise(topic, type, False, deadline)

    async def unadvertise(self, topic: str) -> None:
        thread, system = self._running()
        self._own.pop(topic, None)
        if (feed := self._feeds.get(topic)) is not None:
            feed.put_own(())
        await thread.run(system.unadvertise(topic))

    async def _advertise(self, topic: str, type: TypeRef, latch: bool, deadline: float) -> LivePublication:
        thread, system = self._running()
        existing = self.graph.topics.get(topic)
        if existing is not None and existing.types and all(type.name != each.name for each in existing.types):
            names = " and ".join(each.name for each in existing.types)
            raise Refused(f"{topic} has the type {names}, not {type.name}")
        return await thread.run(system.advertise(topic, type, latch, thread_time(deadline)))

    def _keep_own(self, publication: LivePublication, data: bytes, is_latched: bool) -> None:
        """Store a published message as a sample of rosld before `publish` returns."""
        topic = publication.topic
        own = self._own.get(topic)
        if own is None or own.ref != publication.ref:
            own = self._own[topic] = _OwnMessages(publication.ref, next(self._own_epochs))
        own.sequence += 1
        encoding, node, now = self.capabilities.encoding, self.graph.own_node, time.time_ns()
        sample = Sample(data, encoding, own.ref, node, now, own.sequence, own.epoch, is_latched)
        feed = self._feeds.get(topic)
        own.samples = (*own.samples, sample)[-(feed.depth if feed else 1) :]
        if feed:
            feed.put_own(own.samples)

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """Return the operations on a thing: topics with conflicting or unreadable types are not writable.

        In ROS 2, variants of a type do not conflict.
        """
        graph, name = self.graph, ref.name
        match ref.kind:
            case Kind.TOPIC if (topic := graph.topics.get(name)) is not None:
                types = {each if self.capabilities.encoding is Encoding.ROS1 else each.name for each in topic.types}
                is_writable = len(types) <= 1 and topic.unreadable is None
                return frozenset({Operation.SUBSCRIBE, *([Operation.PUBLISH] if is_writable else [])})
            case Kind.TOPIC:
                return frozenset({Operation.PUBLISH})
            case Kind.SERVICE if (service := graph.services.get(name)) is not None and service.uncallable is None:
                return frozenset({Operation.CALL})
            case Kind.ACTION if (action := graph.actions.get(name)) is not None and action.servers:
                return frozenset({Operation.SEND_GOAL} if action.unusable is None else ())
            case Kind.NODE if (node := graph.nodes.get(name)) is not None and node.lifecycle is not None:
                return frozenset({Operation.CHANGE_STATE} if node.lifecycle.transitions else ())
            case Kind.PARAMETER:
                return self._parameter_operations(name)
        return frozenset()

    @abstractmethod
    def _parameter_operations(self, name: str) -> frozenset[Operation]:
        """Return the operations on a parameter."""

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        """Return the current values of existing parameters."""
        thread, system = self._running()
        return await thread.run(system.parameters.get(names, thread_time(deadline)))

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """Set parameters: in ROS 2 all or none of each node. Raises Refused naming the parameter, with the reason."""
        thread, system = self._running()
        await thread.run(system.parameters.set(values, thread_time(deadline)))

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        """Delete parameters. Raises NotFound, and Refused if a node keeps them."""
        thread, system = self._running()
        await thread.run(system.parameters.delete(names, thread_time(deadline)))

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        """Call a service. Raises Refused with the words of the node, if it has any, TimedOut, Unreachable, NotFound."""
        thread, system = self._running()
        return await thread.run(system.call(service, type, request, thread_time(deadline)))

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        thread, system = self._running()
        return await thread.run(system.actions.send(action, type, goal, thread_time(deadline)))

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        thread, system = self._running()
        await thread.run(system.actions.cancel(goal, thread_time(deadline)))

    async def cancel_goals(self, action: str, *, deadline: float) -> None:
        thread, system = self._running()
        await thread.run(system.actions.cancel_all(action, thread_time(deadline)))

    async def follow_goals(self, action: str, *, deadline: float) -> Watch:
        thread, system = self._running()
        watch = ExitStack()
        watch.callback(thread.post, await thread.run(system.actions.follow(action, thread_time(deadline))))
        return watch

    def _running(self) -> tuple[IoThread, _S]:
        if self._thread is None or self._system is None or self._closing is not None:
            raise Unreachable("the adapter is not open")
        return self._thread, self._system

    async def _schema_in_time(self, name: str, search: Coroutine[Any, Any, Schema], deadline: float) -> Schema:
        """Return the schema that `search` finds on the thread. Raises TimedOut, UnknownType."""
        thread, _ = self._running()
        try:
            return await asyncio.wait_for(thread.run(search), max(seconds_left(deadline), 0.0))
        except asyncio.TimeoutError as error:
            raise TimedOut(f"the definition of {name} was not found in time") from error

    async def _close(self, thread: IoThread) -> None:
        began = time.monotonic()
        if self._system is not None:
            try:
                await asyncio.wait_for(thread.run(self._system.close()), _CLOSE_SECONDS)
            except (asyncio.TimeoutError, RosError):
                pass
        await thread.stop(max(0.2, _CLOSE_SECONDS - (time.monotonic() - began)))


def thread_time(deadline: float) -> float:
    """Return a deadline of the running loop as a time of the thread's loop, whose clock is the monotonic one."""
    return time.monotonic() + seconds_left(deadline)


def seconds_left(deadline: float) -> float:
    """Return the seconds until a deadline of the running loop."""
    return deadline - asyncio.get_running_loop().time()


async def wait_event(event: asyncio.Event, seconds: float) -> bool:
    """Wait until an event is set, for at most `seconds`; return whether it is."""
    try:
        return await asyncio.wait_for(event.wait(), max(seconds, 0.0))
    except asyncio.TimeoutError:
        return False
