"""Everything rosld publishes: registered at the master only after the address it would advertise was proved."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Coroutine, Mapping, Sequence
from typing import NamedTuple
from weakref import WeakValueDictionary

from rosld.adapters.model import MessageSchema, NotFound, Refused, RosError, TypeRef, UnknownType
from rosld.adapters.ros1.hosts import Hosts
from rosld.adapters.ros1.master import MasterApi
from rosld.adapters.ros1.publication import Publication, SubscriberConnection
from rosld.adapters.ros1.slave import SlaveApi, XmlRpcServer
from rosld.adapters.ros1.types import Types
from rosld.adapters.ros1.xmlrpc import XmlRpcClient

_PROOF = 2.0
_PATIENCE = 0.5  # seconds that the first message waits for all subscribers the master named, once one is there
_GOODBYE = 1.0
_REMINDERS = (0.5, 1.0, 2.0, 4.0)
"""Seconds between registrations of a topic that a subscriber has not connected to.

Upon each the master tells the subscribers of us anew: one that missed it, or could not connect then, is reached.
"""


class Servers(NamedTuple):
    """Our two servers, and the URI under which ROS reaches the first."""

    slave: XmlRpcServer
    tcpros: asyncio.Server
    uri: str


def addresses(ros_ip: str | None, local: str | None, environment: Mapping[str, str] = os.environ) -> Sequence[str]:
    """Return candidates to advertise, best first: the user's, those of ROS's variables, the route to the master."""
    if ros_ip:
        return [ros_ip]
    named = [environment.get("ROS_HOSTNAME"), environment.get("ROS_IP"), local]
    return list(dict.fromkeys(each for each in named if each))


class Publications:
    """The topics we publish, by name. All methods run on the reading thread."""

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
        self._registering: set[asyncio.Task[None]] = set()
        self._reminding: set[asyncio.Task[None]] = set()

    @property
    def uri(self) -> str | None:
        """The URI of our Slave API while it runs."""
        return self._servers.uri if self._servers else None

    @property
    def port(self) -> int:
        """The port of our TCPROS server."""
        return int(self._servers.tcpros.sockets[0].getsockname()[1]) if self._servers else 0

    def topics(self) -> Sequence[tuple[str, str]]:
        """Return the topics we publish, with the ROS names of their types."""
        return [(topic, publication.type_name) for topic, publication in self.by_topic.items()]

    async def advertise(self, topic: str, type: TypeRef, until: float) -> Publication:
        """Publish a topic from now on, and wait for its subscribers as `Adapter.publish` promises.

        Raises Refused where our address does not answer or the topic is ours with another type, UnknownType.
        """
        wanted = 1
        async with self._changing.setdefault(topic, asyncio.Lock()):
            publication = self.by_topic.get(topic)
            if publication is None:
                publication, subscribers = await self._advertise(topic, type, until)
                wanted = max(1, len(subscribers))
                if subscribers:
                    self._begin(self._remind(publication, len(subscribers)), self._reminding)
            elif not publication.carries(type):
                raise Refused(
                    f"rosld publishes {topic} as {publication.ref.name} ({publication.ref.hash}), not {type.name}"
                )
        # Outside the lock: a topic whose subscribers never connect must not hold up the others.
        await publication.wait_matched(wanted, until, _PATIENCE)
        return publication

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

    def register_again(self, listed: Mapping[str, tuple[str, ...]], asked_at: float) -> None:
        """Register what the master, asked for its publishers then, did not list as ours: it has forgotten us.

        What was registered since is left alone: told of it twice, rospy connects twice and drops the first connection.
        """
        for topic, publication in self.by_topic.items():
            if publication.registered_at is None or publication.registered_at >= asked_at:
                continue
            if self._node not in listed.get(topic, ()) and not self._registering:
                self._begin(self._register_again(publication), self._registering)

    async def close(self) -> None:
        """Unregister everything, within a second and a half even if the master hangs."""
        for task in self._reminding:
            task.cancel()
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
            raise UnknownType(f"{type.name} is no message type")
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
            pass  # the next look tries again
        self._changed()

    async def _serve(self) -> Servers:
        """Our servers, started if they are not running, at an address that answers. Raises Refused."""
        async with self._starting:
            if self._servers is not None:
                return self._servers
            tried: list[str] = []
            for address in self._candidates():
                if (servers := await self._try(address)) is not None:
                    self._servers = servers
                    return servers
                tried.append(address)
            raise Refused(
                f"nothing is published: rosld does not answer at {' or '.join(tried) or 'any address'}, where ROS "
                "would look for it; give this machine's address with --ros-ip"
            )

    async def _try(self, address: str) -> Servers | None:
        """Return servers that were verified to answer at an address, or None."""
        slave = XmlRpcServer(SlaveApi(self._master.uri, address, self, self._asked_to_leave).answer)
        try:
            bind, port = await _bind(slave, address)
            tcpros = await asyncio.get_running_loop().create_server(
                lambda: SubscriberConnection(self.by_topic), bind, 0
            )
        except OSError:
            slave.close()
            return None
        uri = f"http://{address}:{port}/"
        if await _answers(address, port, uri):
            return Servers(slave, tcpros, uri)
        slave.close()
        tcpros.close()
        return None

    def _asked_to_leave(self, words: str) -> None:
        """`rosnode kill`, or another node took our name: give up what we publish; a later publish begins anew."""
        for topic in list(self.by_topic):
            self._begin(self._leave(topic), self._registering)

    def _begin(self, work: Coroutine[None, None, None], tasks: set[asyncio.Task[None]]) -> None:
        """Do this beside, as one of these tasks."""
        task = asyncio.get_running_loop().create_task(work)
        tasks.add(task)
        task.add_done_callback(tasks.discard)

    async def _leave(self, topic: str) -> None:
        try:
            await self.unadvertise(topic)
        except RosError:
            pass


async def _bind(slave: XmlRpcServer, address: str) -> tuple[str, int]:
    """Listen at an address, or, where it is not this machine's own (it may be forwarded here), at all."""
    try:
        return address, await slave.start(address)
    except OSError:
        return "0.0.0.0", await slave.start("0.0.0.0")


async def _answers(address: str, port: int, uri: str) -> bool:
    """Whether this process answers at an address, asked by XML-RPC as ROS would."""
    hosts = Hosts({}, address)
    client = XmlRpcClient(uri, "/", lambda: hosts.streams(address, port), keep_alive=False)
    try:
        return (await client.call("getPid", "/rosld", timeout=_PROOF)).value == os.getpid()
    except RosError:
        return False
