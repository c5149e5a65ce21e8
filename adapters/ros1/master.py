"""The master: its API, the hosts that it names, and registrations there that a former rosld left behind."""

from __future__ import annotations

import asyncio
import os
import re
import socket
import time
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, NamedTuple, TypeVar
from urllib.parse import urlsplit

from msgspec import Struct

from rosld.adapters.model import NotFound, Refused, RosError, Sent, TimedOut, Unreachable
from rosld.adapters.model.names import global_name
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.ros1.graph import SystemState
from rosld.adapters.ros1.xmlrpc import XmlRpcClient, encode_call

_T = TypeVar("_T")
_P = TypeVar("_P", bound=asyncio.BaseProtocol)
_REMEMBER = 30.0
_RESOLVE = 3.0
CONNECT = 3.0


class Address(NamedTuple):
    """Address to connect to for a host name; `guessed` is a sentence if the name did not resolve."""

    ip: str
    guessed: str | None = None


def host_and_port(uri: str, *schemes: str) -> tuple[str, int]:
    """Return host and port of a URI (`http://host:port/`, `rosrpc://host:port`). Raises Unreachable naming it."""
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
        parts = urlsplit("")
    if parts.scheme not in schemes or not host or not port:
        raise Unreachable(f"{uri[:200]!r} is not an address of the form {schemes[0]}://HOST:PORT/")
    return host, port


class Hosts:
    """Opens connections to hosts by their names in ROS."""

    def __init__(self, host_map: Mapping[str, str], master_host: str) -> None:
        self._map = host_map
        self._master_host = master_host
        self._addresses: dict[str, tuple[float, Address]] = {}

    async def streams(self, host: str, port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Return streams connected to `port` of `host`. Raises Unreachable with the addresses tried."""
        return await self._open(host, port, asyncio.open_connection)

    async def connect(self, host: str, port: int, protocol: Callable[[], _P]) -> _P:
        """Return a protocol connected to `port` of `host`. Raises Unreachable with the addresses tried."""
        loop = asyncio.get_running_loop()
        _, connection = await self._open(host, port, lambda ip, port: loop.create_connection(protocol, ip, port))
        return connection

    async def _open(self, host: str, port: int, open: Callable[[str, int], Coroutine[Any, Any, _T]]) -> _T:
        address = await self.resolve(host)
        try:
            return await asyncio.wait_for(open(address.ip, port), CONNECT)
        except (OSError, asyncio.TimeoutError) as error:
            words = str(error) or "no answer"
            if not address.guessed:
                raise Unreachable(f"{host}:{port} does not answer ({words})") from error
            raise Unreachable(
                f"{address.guessed}, and at the master's host {address.ip} port {port} does not answer either "
                f"({words}); name its address with --host-map {host}=IP"
            ) from error

    async def resolve(self, host: str) -> Address:
        """Return the address of a host name, cached for half a minute."""
        now = time.monotonic()
        entry = self._addresses.get(host)
        if entry is None or entry[0] < now:
            entry = (now + _REMEMBER, await self._look_up(host))
            self._addresses[host] = entry
        return entry[1]

    async def _look_up(self, host: str) -> Address:
        name = self._map.get(host, host)
        try:
            return Address(await _first_ip(name))
        except (OSError, UnicodeError, asyncio.TimeoutError):
            if host == self._master_host:
                raise Unreachable(f"the master's host name {host!r} does not resolve") from None
            guess = await self.resolve(self._master_host)
            return Address(guess.ip, f"the host name {name!r} does not resolve")


async def _first_ip(host: str) -> str:
    """Return the first address of a host, IPv4 (ROS 1's own) before IPv6."""
    loop = asyncio.get_running_loop()
    addresses = await asyncio.wait_for(loop.getaddrinfo(host, None, type=socket.SOCK_STREAM), _RESOLVE)
    family_first = sorted(addresses, key=lambda each: each[0] != socket.AF_INET)
    return str(family_first[0][4][0])


LOOK = 5.0  # seconds without a response to a poll after which the master counts as lost


class MasterSnapshot(Struct, frozen=True):
    """State of the master: its process id, and the raw responses, which are compared to detect changes."""

    pid: int
    state: bytes
    types: bytes


class MasterApi:
    """Client of ROS 1's Master API at one URI, with `caller` as our name."""

    def __init__(self, client: XmlRpcClient, caller: str) -> None:
        self._client = client
        self._caller = caller

    @property
    def uri(self) -> str:
        """URI of the master as in ROS_MASTER_URI."""
        return self._client.uri

    def close(self) -> None:
        """Close idle connections."""
        self._client.close()

    async def snapshot(self) -> MasterSnapshot:
        """Return the master's process id and state. Raises Unreachable, TimedOut."""
        pid = await self._client.call("getPid", self._caller, timeout=LOOK)
        state = await self._client.request(encode_call("getSystemState", self._caller), timeout=LOOK)
        types = await self._client.request(encode_call("getTopicTypes", self._caller), timeout=LOOK)
        return MasterSnapshot(pid.value if isinstance(pid.value, int) else 0, state, types)

    def system_state(self, snapshot: MasterSnapshot) -> SystemState:
        """Return the decoded system state. Raises Unreachable if it is not from a ROS master."""
        state = self._client.decode(snapshot.state)
        types = self._client.decode(snapshot.types)
        if state.code != 1 or types.code != 1:
            words = f"{state.words}, {types.words}"
            raise Unreachable(f"the master at {self.uri} does not report its state", words=words)
        try:
            publishers, subscribers, services = (_nodes_by_name(part) for part in _list(state.value))
            return SystemState(
                publishers, subscribers, services, {name: str(each) for name, each in _pairs(types.value).items()}
            )
        except ValueError as error:
            raise Unreachable(f"{self.uri} does not respond like a ROS 1 master: {error}") from error

    async def parameters_document(self) -> bytes:
        """Return the document of the whole parameter tree."""
        return await self._client.request(encode_call("getParam", self._caller, "/"), timeout=4 * LOOK)

    def parameter_tree(self, document: bytes) -> dict[str, ParameterValue]:
        """Return the decoded tree of such a document."""
        answer = self._client.decode(document)
        return answer.value if answer.code == 1 and isinstance(answer.value, dict) else {}

    async def lookup_node(self, node: str, timeout: float = LOOK) -> str:
        """Return a node's own URI. Raises NotFound."""
        return str(await self.call("lookupNode", node, timeout=timeout))

    async def lookup_service(self, service: str) -> str:
        """Return a service's URI (`rosrpc://host:port`). Raises NotFound."""
        return str(await self.call("lookupService", service, timeout=LOOK))

    async def register_publisher(self, topic: str, type_name: str, uri: str, timeout: float) -> list[str]:
        """Register as a publisher; return the URIs of the topic's subscribers."""
        value = await self.call("registerPublisher", topic, type_name, uri, timeout=timeout)
        return [str(each) for each in value] if isinstance(value, list) else []

    async def unregister_publisher(self, topic: str, uri: str, timeout: float, *, node: str | None = None) -> None:
        """Unregister a publisher of ours, or of another `node`, at this URI. Does nothing if it is not registered."""
        await self.call("unregisterPublisher", topic, uri, timeout=timeout, caller=node)

    async def call(
        self, method: str, *arguments: ParameterValue, timeout: float, caller: str | None = None
    ) -> ParameterValue:
        """Return the value of a method of the Master or Parameter Server API. Raises NotFound, Refused."""
        answer = await self._client.call(method, caller or self._caller, *arguments, timeout=timeout)
        if answer.code == -1:
            raise NotFound(f"the master knows no {arguments[0]!r}", words=answer.words)
        if answer.code != 1:
            raise Refused(f"the master refused {method} of {arguments[0]!r}", words=answer.words, sent=Sent.YES)
        return answer.value


def _list(value: ParameterValue) -> list[ParameterValue]:
    if not isinstance(value, list):
        raise ValueError(f"expected a list, not {str(value)[:40]!r}")
    return value


def _pairs(value: ParameterValue) -> dict[str, ParameterValue]:
    """Return the values of a list of pairs by global name. Raises ValueError."""
    return {global_name(str(name)): each for name, each in map(_list, _list(value))}


def _nodes_by_name(value: ParameterValue) -> Mapping[str, tuple[str, ...]]:
    nodes = {name: (global_name(str(node)) for node in _list(each)) for name, each in _pairs(value).items()}
    return {name: tuple(dict.fromkeys(each)) for name, each in nodes.items()}


_NAME = re.compile(r"/rosld_\w*?_(?P<pid>\d+)(?:_(?P<number>\d+))?", re.ASCII)
_AGAIN = 10.0  # seconds until an address that responded is checked again
_PATIENCE = 2.0


def host_label() -> str:
    """Return this machine's name as used in the names of rosld's nodes."""
    return re.sub(r"\W", "_", socket.gethostname(), flags=re.ASCII)


def own_name(number: int) -> str:
    """Return the name of an adapter in this process: `/rosld_HOST_PID`, with the number from the second one on."""
    return f"/rosld_{host_label()}_{os.getpid()}" + (f"_{number}" if number else "")


def pids(node: str) -> frozenset[int]:
    """Return the possible process ids in a node's name, two if it ends with two numbers; none for other names."""
    match = _NAME.fullmatch(node) if node.startswith("/rosld_") else None
    if match is None:
        return frozenset()
    return frozenset(int(each) for each in (match["pid"], match["number"]) if each)


class StaleRegistrations:
    """Finder of dead registrations of rosld. All methods run on the reading thread.

    `own_uri` returns the URI of our own Slave API while it runs.
    """

    def __init__(self, master: MasterApi, hosts: Hosts, own_node: str, own_uri: Callable[[], str | None]) -> None:
        self._master = master
        self._hosts = hosts
        self._own_node = own_node
        self._own_uri = own_uri
        self._checked_at: dict[str, float] = {}

    def nodes_to_check(self, publishers: Mapping[str, tuple[str, ...]]) -> Mapping[str, tuple[str, ...]]:
        """Return the topics of each node that must be checked now; `publishers` are the nodes by topic."""
        named = {node for nodes in publishers.values() for node in nodes if pids(node)}
        if self._own_uri() is not None:
            named.discard(self._own_node)
        self._checked_at = {node: at for node, at in self._checked_at.items() if node in named}
        now = time.monotonic()
        chosen = [node for node in named if now - self._checked_at.get(node, -_AGAIN) >= _AGAIN]
        self._checked_at.update(dict.fromkeys(chosen, now))
        return {node: tuple(topic for topic, nodes in publishers.items() if node in nodes) for node in chosen}

    async def remove(self, node: str, topics: tuple[str, ...]) -> bool:
        """Unregister a node from these topics if it is dead; return whether it was."""
        try:
            uri = await self._master.lookup_node(node, _PATIENCE)
            if uri == self._own_uri() or not await self._is_dead(node, uri):
                return False
            for topic in topics:
                await self._master.unregister_publisher(topic, uri, _PATIENCE, node=node)
        except RosError:
            return False  # unknown, because the master or the address is unreachable
        return True

    async def _is_dead(self, node: str, uri: str) -> bool:
        """Whether a node's address is certainly unused, or used by another process. Raises Unreachable."""
        host, port = host_and_port(uri, "http")
        address = await self._hosts.resolve(host)
        is_ours = _is_local(address.ip) or node.startswith(f"/rosld_{host_label()}_")
        if address.guessed is not None or not is_ours:
            return False
        try:
            _, writer = await asyncio.wait_for(asyncio.open_connection(address.ip, port), _PATIENCE)
        except ConnectionRefusedError:
            return True
        except (OSError, asyncio.TimeoutError):
            return False
        writer.close()
        return await self._is_another(node, uri, host, port)

    async def _is_another(self, node: str, uri: str, host: str, port: int) -> bool:
        """Whether the process at an address is not one of those in the node's name."""
        client = XmlRpcClient(uri, "/", lambda: self._hosts.streams(host, port), keep_alive=False)
        try:
            answer = await client.call("getPid", self._own_node, timeout=_PATIENCE)
        except (TimedOut, Refused):
            return False
        return isinstance(answer.value, int) and answer.value not in pids(node)


def _is_local(ip: str) -> bool:
    """Whether an address is local: only those can be bound."""
    try:
        with socket.socket(socket.AF_INET6 if ":" in ip else socket.AF_INET, socket.SOCK_STREAM) as probe:
            probe.bind((ip, 0))
    except OSError:
        return False
    return True
