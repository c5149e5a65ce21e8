"""Reading topics: one connection to each publisher, requested from the publisher itself, without registering."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Sequence

from rosld.adapters.model import Refused, RosError, TypeRef, Unreachable
from rosld.adapters.ros1.master import Hosts, host_and_port
from rosld.adapters.ros1.subscription import Slot, TopicFeed
from rosld.adapters.ros1.tcpros import Deliver, Frame, FrameReceiver, Header, encode_header
from rosld.adapters.ros1.types import EndpointFacts, Facts, Types, type_name
from rosld.adapters.ros1.xmlrpc import XmlRpcClient

_TIMEOUT = 5.0
_FIRST_WAIT = 0.1
_LONGEST_WAIT = 10.0
_LONG_ENOUGH = 5.0  # seconds of a connection after which its end does not count as a failure


class Nodes:
    """Addresses of nodes, as last reported by the master, and their Slave APIs.

    `message_limit` is the maximum size of a received message in bytes.
    """

    def __init__(
        self, caller: str, hosts: Hosts, facts: Facts, look_up: Callable[[str], Awaitable[str]], message_limit: int
    ) -> None:
        self.caller = caller
        self.message_limit = message_limit
        self.hosts = hosts
        self.facts = facts
        self._look_up = look_up

    async def address(self, node: str) -> str:
        """Return a node's URI from the master, because a restarted node has a new one."""
        uri = await self._look_up(node)
        self.facts.set_node_uri(node, uri)
        return uri

    async def request_topic(self, uri: str, topic: str) -> tuple[str, int]:
        """Return the TCPROS address of a topic from its publisher. Raises Refused, Unreachable."""
        host, port = host_and_port(uri, "http")
        client = XmlRpcClient(uri, "/RPC2", lambda: self.hosts.streams(host, port), keep_alive=False)
        answer = await client.call("requestTopic", self.caller, topic, [["TCPROS"]], timeout=_TIMEOUT)
        match answer.code, answer.value:
            case 1, ["TCPROS", str(at), int(tcp_port), *_]:
                return at, tcp_port
            case _:
                raise Refused(f"{uri} does not offer {topic} over TCPROS", words=answer.words)


class PublisherReader:
    """Reader of one publisher of one topic, which reconnects when the connection is lost."""

    def __init__(self, feed: TopicFeed, slot: Slot, nodes: Nodes, types: Types, next_epoch: Callable[[], int]) -> None:
        self.slot = slot
        self._feed = feed
        self._nodes = nodes
        self._types = types
        self._next_epoch = next_epoch
        self.receiver: FrameReceiver | None = None
        self._guessed = False

    @property
    def is_connected(self) -> bool:
        """Whether messages can be received now."""
        return self.receiver is not None and self.receiver.ready.done()

    async def run(self) -> None:
        """Read until cancelled."""
        wait = _FIRST_WAIT
        now = asyncio.get_running_loop().time
        while True:
            began = now()
            words = await self._attempt()
            if now() - began > _LONG_ENOUGH or words is None:
                wait = _FIRST_WAIT
            if words is not None:
                endpoints, key = self._nodes.facts.endpoints, (self._feed.topic, self.slot.publisher)
                endpoints.put(key, endpoints.get(key, EndpointFacts())._replace(unreachable=words))
            await asyncio.sleep(wait)
            wait = min(2 * wait, _LONGEST_WAIT)

    async def _attempt(self) -> str | None:
        """Connect and read until the connection ends; return the error message, or None without an error."""
        try:
            uri = await self._nodes.address(self.slot.publisher)
            receiver = await self._connect(uri)
        except (RosError, OSError, ValueError, asyncio.TimeoutError) as error:
            if isinstance(error, Unreachable):
                self._nodes.facts.unreachable.put(self.slot.publisher, str(error))
            return str(error) or f"{self.slot.publisher} did not answer in time"
        self._nodes.facts.unreachable.put(self.slot.publisher, None)
        try:
            await receiver.closed
        finally:
            receiver.close()
            self.receiver = None
        return receiver.failure

    async def _connect(self, uri: str) -> FrameReceiver:
        host, port = await self._nodes.request_topic(uri, self._feed.topic)
        self._guessed = (await self._nodes.hosts.resolve(host)).guessed is not None
        if self.slot.uri not in (None, uri):
            self.slot.restart(self._next_epoch())
        self.slot.uri = uri
        limit = self._nodes.message_limit
        receiver = await self._nodes.hosts.connect(
            host, port, lambda: FrameReceiver(self._hello(), self._accept, limit)
        )
        receiver.depth = self._feed.depth
        self.receiver = receiver
        try:
            await asyncio.wait_for(receiver.ready, _TIMEOUT)
        except BaseException:
            receiver.close()
            raise
        return receiver

    def _hello(self) -> bytes:
        fields = {
            "callerid": self._nodes.caller + self._feed.caller_suffix,
            "topic": self._feed.topic,
            "type": "*",
            "md5sum": "*",
            "tcp_nodelay": "1",
        }
        return encode_header({**fields, "message_definition": ""})

    def _accept(self, header: Header) -> Deliver:
        """Store the facts in the publisher's header; return the receiver of its frames. Raises Refused."""
        if "error" in header:
            raise Refused(f"{self.slot.publisher} refuses", words=header["error"])
        if self._guessed and header.get("callerid", self.slot.publisher) != self.slot.publisher:
            raise Unreachable(f"another node responds for {self.slot.publisher} at the master's host: use --host-map")
        name = type_name(header.get("type", ""))
        if name is None:
            raise Refused(f"{self.slot.publisher} does not state a message type", words=header.get("type"))
        ref = TypeRef(name, header.get("md5sum"))
        self._types.learn(ref, header.get("message_definition", ""))
        latched = header.get("latching") == "1"
        self.slot.schema, self.slot.latched = ref, latched
        self._nodes.facts.endpoints.put((self._feed.topic, self.slot.publisher), EndpointFacts(ref, latched))
        return self._deliver

    def _deliver(self, frames: Sequence[Frame], count: int) -> None:
        feed = self._feed
        self.slot.take(frames, count, feed.depth)
        feed.arrived()


class TopicReader:
    """Reader of one topic for its feed, with a source for each publisher that the master lists."""

    def __init__(self, feed: TopicFeed, nodes: Nodes, types: Types, first_epoch: int) -> None:
        self.feed = feed
        self.next_epoch = first_epoch
        self._nodes = nodes
        self._types = types
        self._sources: dict[str, tuple[PublisherReader, asyncio.Task[None]]] = {}
        self._left: list[Slot] = []

    def follow(self, publishers: Iterable[str]) -> None:
        """Update the publishers that are read."""
        names = [each for each in publishers if each != self._nodes.caller]
        for former in self._sources.keys() - set(names):
            source, task = self._sources.pop(former)
            task.cancel()
            self._left.append(source.slot)
        for name in names:
            if name not in self._sources:
                self._begin(name)
        self._arrange()

    @property
    def is_connected(self) -> bool:
        """Whether any publisher is connected."""
        return any(source.is_connected for source, _ in self._sources.values())

    def deepen(self) -> None:
        """Apply the feed's new depth."""
        for source, _ in self._sources.values():
            if source.receiver is not None:
                source.receiver.depth = self.feed.depth

    def fit_buffers(self) -> None:
        """Adapt the kernel's buffers to the incoming rates; called about once a second."""
        for source, _ in self._sources.values():
            if source.receiver is not None:
                source.receiver.fit_buffer()

    def close(self) -> None:
        """Stop reading."""
        for _, task in self._sources.values():
            task.cancel()
        self._sources.clear()

    def _begin(self, publisher: str) -> None:
        previous = next((slot for slot in self._left if slot.publisher == publisher), None)
        slot = previous or Slot(publisher, self._epoch())
        source = PublisherReader(self.feed, slot, self._nodes, self._types, self._epoch)
        self._sources[publisher] = source, asyncio.get_running_loop().create_task(source.run())

    def _epoch(self) -> int:
        self.next_epoch += 1
        return self.next_epoch - 1

    def _arrange(self) -> None:
        """Publish the slots to readers. Of publishers that left, only the one with the latest message stays visible."""
        current = [source.slot for source, _ in self._sources.values()]
        former = [slot for slot in self._left if slot.values and slot not in current]
        self._left = sorted(former, key=lambda slot: slot.values[-1].received_ns)[-1:]
        if self._left and any(_newest(slot) >= _newest(self._left[0]) for slot in current):
            self._left = []
        self.feed.slots = (*current, *self._left)


def _newest(slot: Slot) -> int:
    return slot.values[-1].received_ns if slot.values else 0
