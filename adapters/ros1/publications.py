"""The topics that rosld publishes: registered at the master once their address is verified; and the slave API."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol
from weakref import WeakValueDictionary

from rosld.adapters.model import MessageSchema, NotFound, Refused, RosError, TypeRef, UnknownType
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.ros1.master import Hosts, MasterApi
from rosld.adapters.ros1.publication import Publication, SubscriberConnection
from rosld.adapters.ros1.types import Types
from rosld.adapters.ros1.xmlrpc import (
    Answer,
    Malformed,
    XmlRpcClient,
    content_length,
    decode_call,
    encode_answer,
    encode_fault,
    read_head,
)
from rosld.adapters.thread import Tasks

_MAX_REQUEST = 1024 * 1024
_MAX_CONNECTIONS = 200
_IDLE = 15.0


class PublishedTopics(Protocol):
    """Our publications, for the Slave API."""

    @property
    def port(self) -> int:
        """Port of the TCPROS server."""

    def topics(self) -> Sequence[tuple[str, str]]:
        """Return the published topics, with the ROS names of their types."""


class SlaveApi:
    """Responds to calls from the master and from other nodes."""

    def __init__(
        self, master_uri: str, host: str, published: PublishedTopics, shut_down: Callable[[str], None]
    ) -> None:
        self._master_uri = master_uri
        self._host = host
        self._published = published
        self._shut_down = shut_down

    def answer(self, method: str, arguments: Sequence[ParameterValue]) -> Answer:
        """Return the response to a call; code -1 for unknown methods."""
        match method, arguments:
            case "getPid", _:
                return Answer(1, "", os.getpid())
            case "getMasterUri", _:
                return Answer(1, "", self._master_uri)
            case "getPublications", _:
                return Answer(1, "", [[topic, name] for topic, name in self._published.topics()])
            case "getSubscriptions" | "getBusInfo", _:
                return Answer(1, "", [])
            case "getBusStats", _:
                return Answer(1, "", [[], [], []])
            case "publisherUpdate" | "paramUpdate", _:
                return Answer(1, "", 0)
            case "shutdown", _:
                self._shut_down(str(arguments[1]) if len(arguments) > 1 else "")
                return Answer(1, "", 0)
            case "requestTopic", [_, str(topic), list(protocols)]:
                return self._request_topic(topic, protocols)
            case _:
                return Answer(-1, f"there is no method {method[:80]!r} with these arguments", 0)

    def _request_topic(self, topic: str, protocols: list[ParameterValue]) -> Answer:
        if topic not in dict(self._published.topics()):
            return Answer(0, f"{topic[:200]} is not published here", [])
        if not any(isinstance(each, list) and each[:1] == ["TCPROS"] for each in protocols):
            return Answer(0, "only TCPROS is supported", [])
        return Answer(1, "ready", ["TCPROS", self._host, self._published.port])


class XmlRpcServer:
    """A minimal HTTP/1.1 server for ROS's XML-RPC."""

    def __init__(self, answer: Callable[[str, Sequence[ParameterValue]], Answer]) -> None:
        self._answer = answer
        self._server: asyncio.Server | None = None
        self._open = 0

    async def start(self, bind: str) -> int:
        """Listen on a free port at `bind`; return the port."""
        self._server = await asyncio.start_server(self._serve, bind, 0)
        return int(self._server.sockets[0].getsockname()[1])

    def close(self) -> None:
        """Stop listening."""
        if self._server is not None:
            self._server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._open += 1
        try:
            while self._open <= _MAX_CONNECTIONS and await asyncio.wait_for(self._turn(reader, writer), _IDLE):
                pass
        except (OSError, EOFError, Malformed, asyncio.TimeoutError):
            pass  # the peer disconnected, or does not speak HTTP
        finally:
            self._open -= 1
            writer.close()

    async def _turn(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
        """Respond to one request; return whether another may follow."""
        line, fields = await read_head(reader)
        length = content_length(fields, _MAX_REQUEST)
        if not line.startswith("POST ") or length is None:
            writer.write(
                b"HTTP/1.1 405 Method Not Allowed\r\nAllow: POST\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
            )
            await writer.drain()
            return False
        body = self._document(await reader.readexactly(length))
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nContent-Length: %d\r\n\r\n" % len(body) + body)
        await writer.drain()
        return "HTTP/1.1" in line and fields.get("connection", "").lower() != "close"

    def _document(self, request: bytes) -> bytes:
        try:
            method, arguments = decode_call(request)
            return encode_answer(self._answer(method, arguments))
        except (Malformed, Refused) as error:
            return encode_fault(str(error))


_PROOF = 2.0
_PATIENCE = 0.5  # seconds to wait for all subscribers that the master named, once one is connected
_GOODBYE = 1.0
_REMINDERS = (0.5, 1.0, 2.0, 4.0)
"""Seconds between registrations of a topic whose subscribers have not connected.

With each one the master notifies the subscribers again, in case they missed it or could not connect.
"""


class Servers(NamedTuple):
    """Our two servers, and the advertised URI of the Slave API."""

    slave: XmlRpcServer
    tcpros: asyncio.Server
    uri: str


def addresses(ros_ip: str | None, local: str | None, environment: Mapping[str, str] = os.environ) -> Sequence[str]:
    """Return candidate addresses to advertise, best first: the user's, ROS's variables, the route to the master."""
    if ros_ip:
        return [ros_ip]
    named = [environment.get("ROS_HOSTNAME"), environment.get("ROS_IP"), local]
    return list(dict.fromkeys(each for each in named if each))


class Publications:
    """The topics that we publish, by name. All methods run on the reading thread."""

    def __init__(
        self,
        master: MasterApi,
        node: str,
        types: Types,
        candidates: Callable[[], Sequence[str]],
        changed: Callable[[], None],
    ) -> None:
        self.by_topic: dict[str, Publication] = {}
        self._master = master
        self._node = node
        self._types = types
        self._candidates = candidates
        self._changed = changed
        self._servers: Servers | None = None
        self._starting = asyncio.Lock()
        self._changing: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        self._registering, self._reminding = Tasks(), Tasks()

    @property
    def uri(self) -> str | None:
        """URI of our Slave API while it runs."""
        return self._servers.uri if self._servers else None

    @property
    def port(self) -> int:
        """Port of our TCPROS server."""
        return int(self._servers.tcpros.sockets[0].getsockname()[1]) if self._servers else 0

    def topics(self) -> Sequence[tuple[str, str]]:
        """Return the topics that we publish, with the ROS names of their types."""
        return [(topic, publication.type_name) for topic, publication in self.by_topic.items()]

    async def advertise(self, topic: str, type: TypeRef, until: float) -> Publication:
        """Start publishing a topic, and wait for its subscribers as specified by `Adapter.publish`.

        Raises UnknownType, and Refused if our address does not respond or the topic has another type.
        """
        expected = 1
        async with self._changing.setdefault(topic, asyncio.Lock()):
            publication = self.by_topic.get(topic)
            if publication is None:
                publication, subscribers = await self._advertise(topic, type, until)
                expected = max(1, len(subscribers))
                if subscribers:
                    self._reminding.begin(self._remind(publication, len(subscribers)))
            elif not publication.carries(type):
                raise Refused(
                    f"rosld publishes {topic} as {publication.ref.name} ({publication.ref.hash}), not {type.name}"
                )
        # Outside of the lock, so that a topic whose subscribers never connect does not delay others.
        await publication.wait_matched(expected, until, _PATIENCE)
        return publication

    def suitable(self, topic: str, type: TypeRef, latch: bool) -> Publication | None:
        """Return the publication of a topic if it accepts messages of this type (thread-safe)."""
        publication = self.by_topic.get(topic)
        return publication if publication is not None and publication.carries(type) else None

    def is_latched(self, publication: Publication, latch: bool) -> bool:
        """Whether a message is latched: as requested."""
        return latch

    async def unadvertise(self, topic: str) -> None:
        """Stop publishing. Raises NotFound."""
        async with self._changing.setdefault(topic, asyncio.Lock()):
            publication = self.by_topic.pop(topic, None)
            if publication is None:
                raise NotFound(f"rosld does not publish {topic}")
            try:
                await self._master.unregister_publisher(topic, self.uri or "", _GOODBYE)
            finally:
                await publication.close(_GOODBYE)
                self._changed()

    def register_again(self, listed: Mapping[str, tuple[str, ...]], requested_at: float) -> None:
        """Register topics that the master does not list as ours in a response requested at `requested_at`.

        Later registrations are skipped: when notified twice, rospy connects twice and drops the first connection.
        """
        for topic, publication in self.by_topic.items():
            if publication.registered_at is None or publication.registered_at >= requested_at:
                continue
            if self._node not in listed.get(topic, ()) and not self._registering:
                self._registering.begin(self._register_again(publication))

    async def close(self) -> None:
        """Unregister everything, within a second and a half even if the master hangs."""
        self._reminding.cancel()
        publications = list(self.by_topic.values())
        self.by_topic.clear()
        goodbyes = [self._master.unregister_publisher(each.topic, self.uri or "", _GOODBYE) for each in publications]
        endings = [each.close(0.2) for each in publications]
        await asyncio.gather(*goodbyes, *endings, return_exceptions=True)
        if self._servers is not None:
            self._servers.slave.close()
            self._servers.tcpros.close()
            self._servers = None

    async def _advertise(self, topic: str, type: TypeRef, until: float) -> tuple[Publication, list[str]]:
        schema = await self._types.schema(type)
        if not isinstance(schema, MessageSchema):
            raise UnknownType(f"{type.name} is not a message type")
        servers = await self._serve()
        publication = Publication(topic, schema, self._node)
        self.by_topic[topic] = publication
        now = asyncio.get_running_loop().time
        left = max(until - now(), 0.1)
        try:
            subscribers = await self._master.register_publisher(topic, publication.type_name, servers.uri, left)
            publication.registered_at = now()
            return publication, subscribers
        except RosError:
            del self.by_topic[topic]
            raise
        finally:
            self._changed()

    async def _remind(self, publication: Publication, subscribers: int) -> None:
        """Register a topic again, with growing intervals, while fewer subscribers than expected are connected."""
        for pause in _REMINDERS:
            await asyncio.sleep(pause)
            if publication.matched >= subscribers:
                return
            await self._register_again(publication)

    async def _register_again(self, publication: Publication) -> None:
        if self._servers is None or self.by_topic.get(publication.topic) is not publication:
            return
        try:
            await self._master.register_publisher(publication.topic, publication.type_name, self._servers.uri, _PROOF)
            publication.registered_at = asyncio.get_running_loop().time()
        except RosError:
            pass  # the next poll retries
        self._changed()

    async def _serve(self) -> Servers:
        """Return our servers, started if necessary, at an address that responds. Raises Refused."""
        async with self._starting:
            if self._servers is not None:
                return self._servers
            tried: list[str] = []
            for address in self._candidates():
                if (servers := await self._try_address(address)) is not None:
                    self._servers = servers
                    return servers
                tried.append(address)
            raise Refused(
                f"nothing is published: rosld cannot be reached at {' or '.join(tried) or 'any address'}, where ROS "
                "would connect to it; set this machine's address with --ros-ip"
            )

    async def _try_address(self, address: str) -> Servers | None:
        """Return servers that were verified to answer at an address, or None."""
        slave = XmlRpcServer(SlaveApi(self._master.uri, address, self, self._leave_all).answer)
        try:
            bind, port = await _bind(slave, address)
            tcpros = await asyncio.get_running_loop().create_server(
                lambda: SubscriberConnection(self.by_topic), bind, 0
            )
        except OSError:
            slave.close()
            return None
        uri = f"http://{address}:{port}/"
        if await _is_reachable(address, port, uri):
            return Servers(slave, tcpros, uri)
        slave.close()
        tcpros.close()
        return None

    def _leave_all(self, words: str) -> None:
        """Stop publishing everything after `rosnode kill` or the takeover of our name; a later publish starts again."""
        for topic in list(self.by_topic):
            self._registering.begin(self._leave(topic))

    async def _leave(self, topic: str) -> None:
        try:
            await self.unadvertise(topic)
        except RosError:
            pass


async def _bind(slave: XmlRpcServer, address: str) -> tuple[str, int]:
    """Listen at an address, or at all addresses if it is not local (it may be forwarded here)."""
    try:
        return address, await slave.start(address)
    except OSError:
        return "0.0.0.0", await slave.start("0.0.0.0")


async def _is_reachable(address: str, port: int, uri: str) -> bool:
    """Whether this process responds at an address to ROS's XML-RPC."""
    hosts = Hosts({}, address)
    client = XmlRpcClient(uri, "/", lambda: hosts.streams(address, port), keep_alive=False)
    try:
        return (await client.call("getPid", "/rosld", timeout=_PROOF)).value == os.getpid()
    except RosError:
        return False
