"""Feeds: the newest samples of one topic, taken from the middleware's history when they are read.

A feed belongs to the server's event loop, which takes the samples; only its reader and the facts about its publishers
are replaced by the ROS thread, each with one assignment.
"""

from __future__ import annotations

import asyncio
import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from msgspec import Struct, field

from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.adapters.ros2.middleware import Reader, ReceivedMessage
from rosld.adapters.ros2.wait_set import Waiter
from rosld.adapters.slots import LoopWatch, received_ns
from rosld.adapters.thread import LiveFeed

_ECHO_NS = 250_000_000
_ECHOES = 64
_REMEMBERED = 256


class Publishers(Struct, frozen=True):
    """Facts about a topic's publishers: the number for each node (except ours), and the nodes by gid.

    `types` are the nodes' types, `latched` are the nodes with latched publishers, `type` is the topic's type if known.
    """

    nodes: Counter[str] = field(default_factory=Counter)
    gids: Mapping[bytes, str] = field(default_factory=dict)
    types: Mapping[str, TypeRef] = field(default_factory=dict)
    latched: frozenset[str] = frozenset()
    type: TypeRef | None = None


class _Stream(Struct):
    """One publisher's newest samples, and the state of its count."""

    epoch: int
    samples: deque[Sample]
    sequence: int = 0
    number: int | None = None
    identities: deque[tuple[int, int | None]] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))

    def count(self, message: ReceivedMessage, *, alone: bool) -> int:
        """Return the next message's number: by the publisher's own count since the first message, else the next."""
        if message.number is not None and alone and self.number is not None:
            step = message.number - self.number
            if step <= 0:
                self.epoch += 1
                self.sequence = 0
                step = 1
            self.sequence += step
        else:
            self.sequence += 1
        self.number = message.number
        return self.sequence


class _Streams:
    """Newest samples of each other publisher of one topic."""

    def __init__(self, epoch: int) -> None:
        self.depth = 1
        self.epoch = epoch
        self._by_publisher: dict[str, _Stream] = {}
        self._views: dict[int, tuple[Sample, ...]] = {}
        self._own: tuple[Sample, ...] = ()

    def put(self, message: ReceivedMessage, name: str, publishers: Publishers, latched: bool) -> bool:
        """Add a message of the publisher with this name; return whether it is new."""
        stream = self._stream(name, self.epoch)
        if latched:
            identity = message.source_ns, message.number
            if identity in stream.identities:
                return False  # a new reader of a latched topic receives the previous reader's messages again
            stream.identities.append(identity)
        sequence = stream.count(message, alone=publishers.nodes[name] == 1)
        self.epoch = max(self.epoch, stream.epoch)
        schema = publishers.types.get(name) or publishers.type or TypeRef("")
        stream.samples.append(
            Sample(
                message.data,
                Encoding.CDR,
                schema,
                name,
                message.received_ns,
                sequence,
                stream.epoch,
                name in publishers.latched or (latched and not name),  # only latched topics are read with this profile
            )
        )
        self._views.clear()
        return True

    def latest(self, depth: int, publishers: Publishers, own: tuple[Sample, ...]) -> Sequence[Sample]:
        """Return the newest `depth` samples of each publisher and of ours; the same object if nothing is new."""
        if own is not self._own:
            self._own = own
            self._views.clear()
        view = self._views.get(depth)
        if view is None:
            newest = [sample for samples in self._current(publishers) for sample in samples[-depth:]]
            view = self._views[depth] = tuple(sorted(newest, key=received_ns))
        return view

    def resize(self, depth: int) -> None:
        """Store this number of the newest samples from now on."""
        self.depth = depth
        for stream in self._by_publisher.values():
            if stream.samples.maxlen != depth:
                stream.samples = deque(stream.samples, maxlen=depth)
        self._views.clear()

    def attribute(self, publishers: Publishers) -> None:
        """Attribute messages from before the discovery of their publisher to the only publisher, once it is known."""
        self._views.clear()
        nameless = self._by_publisher.get("")
        name = next(iter(publishers.nodes), "")
        if nameless is not None and name and len(publishers.nodes) == 1 and name not in self._by_publisher:
            is_latched = name in publishers.latched
            named = (each._replace(publisher=name, latched=is_latched) for each in nameless.samples)
            nameless.samples = deque(named, maxlen=self.depth)
            self._by_publisher[name] = self._by_publisher.pop("")

    def _stream(self, name: str, epoch: int) -> _Stream:
        stream = self._by_publisher.get(name)
        if stream is None:
            stream = self._by_publisher[name] = _Stream(epoch, deque(maxlen=self.depth))
        return stream

    def _current(self, publishers: Publishers) -> list[tuple[Sample, ...]]:
        """Return the samples of current publishers, and the latest ones of a former one, until a newer message."""
        present = [self._own] if self._own else []
        former: list[tuple[Sample, ...]] = []
        for name, stream in self._by_publisher.items():
            if stream.samples:
                (present if name in publishers.nodes else former).append(tuple(stream.samples))
        last = max(former, key=_newest, default=None)
        return present if last is None or any(_newest(each) >= _newest(last) for each in present) else [*present, last]


class _Echoes:
    """Recently published messages of rosld, to recognize their echoes from the middleware."""

    def __init__(self) -> None:
        self._published: deque[tuple[int, bytes]] = deque(maxlen=_ECHOES)

    def note(self, sample: Sample) -> None:
        """Expect the echo of a message."""
        self._published.append((sample.received_ns, sample.data))

    def take(self, message: ReceivedMessage) -> bool:
        """Whether this is the echo of our own message: the same bytes, written at about the same time."""
        for published in self._published:
            written, data = published
            if -_ECHO_NS < message.source_ns - written < _ECHO_NS and data == message.data:
                self._published.remove(published)
                return True
        return False


class TopicFeed(LiveFeed):
    """Incoming messages of one topic, for all its subscriptions."""

    def __init__(self, topic: str, own_node: str, epoch: int, waiter: Waiter, changed: Callable[[Any], None]) -> None:
        super().__init__(topic, changed)
        self.publishers = Publishers()
        self._waiter = waiter
        self._server = asyncio.get_running_loop()
        self._reader: Reader | None = None
        self._own_node = own_node
        self._streams = _Streams(epoch)
        self._echoes = _Echoes()
        self._taking = threading.Lock()
        self._last_publishers = self.publishers

    @property
    def epoch(self) -> int:
        """Newest epoch of the publishers."""
        return self._streams.epoch

    @property
    def reader(self) -> Reader | None:
        """Reader of the topic, or None while it is not read."""
        return self._reader

    def read_with(self, reader: Reader | None) -> Reader | None:
        """Replace the reader; return the previous one, to be closed. Called on the ROS thread."""
        before, self._reader = self._reader, reader
        if before is not None:
            self._waiter.disarm(before.handle)
        with suppress(RuntimeError):  # the server's event loop has ended
            self._server.call_soon_threadsafe(self._rearm)
        return before

    def put_own(self, own: tuple[Sample, ...]) -> None:
        """Replace the messages of rosld, and expect the echoes of new ones."""
        for sample in own:
            if all(sample is not each for each in self.own):
                self._echoes.note(sample)
        super().put_own(own)

    def latest(self, depth: int = 1) -> Sequence[Sample]:
        """Return the newest `depth` samples of each publisher by time of receipt; the same object if nothing is new."""
        self._drain()
        return self._streams.latest(depth, self._last_publishers, self.own)

    def resize(self) -> None:
        """Store as many of the newest samples as the subscriptions need from now on."""
        self._streams.resize(self.depth)

    def watch(self, wake: Callable[[], None]) -> LoopWatch:
        """Wake on the event loop after new messages."""
        watch = super().watch(wake)
        self._rearm()
        return watch

    def _drain(self) -> bool:
        """Take available messages; return whether there were new ones."""
        publishers, reader = self.publishers, self._reader
        if publishers is not self._last_publishers:
            self._last_publishers = publishers
            self._streams.attribute(publishers)
        if reader is None:
            return False
        new, latched = False, reader.qos.durability == "transient_local"
        with self._taking:
            for _ in range(max(reader.qos.depth, self.depth)):
                message = reader.take()
                if message is None:
                    break
                new = self._put(message, publishers, latched) or new
        return new

    def _put(self, message: ReceivedMessage, publishers: Publishers, latched: bool) -> bool:
        name = self._sender(message, publishers)
        if name == self._own_node or self._echoes.take(message):
            return False
        return self._streams.put(message, name, publishers, latched)

    def _sender(self, message: ReceivedMessage, publishers: Publishers) -> str:
        """Return the sending node: by its gid if the middleware reports it, else the only publishing node."""
        if message.gid is not None and (found := publishers.gids.get(message.gid)) is not None:
            return found
        return next(iter(publishers.nodes)) if len(publishers.nodes) == 1 else ""

    def _rearm(self) -> None:
        """Request notification of the next message, if there are watches."""
        reader = self._reader
        if reader is not None and self.watches:
            self._waiter.arm(reader.handle, "reader", self._on_message)

    def _on_message(self) -> None:
        if not self.watches:
            return
        if self._drain():
            self.notify()
        self._rearm()


def _newest(samples: tuple[Sample, ...]) -> int:
    return samples[-1].received_ns
