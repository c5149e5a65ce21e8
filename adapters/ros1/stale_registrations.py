"""Removal of registrations at the master that a rosld left behind when it did not end cleanly.

The master never forgets a killed publisher, so its topics would remain "published by /rosld_HOST_PID". A registration
is removed if it has a name of rosld's and an address of this machine where nothing or another process listens. A busy
or suspended rosld still has its port, so connections to it are accepted.
"""

from __future__ import annotations

import asyncio
import os
import re
import socket
import time
from collections.abc import Callable, Mapping

from rosld.adapters.model import Refused, RosError, TimedOut
from rosld.adapters.ros1.hosts import Hosts, host_and_port
from rosld.adapters.ros1.master import MasterApi
from rosld.adapters.ros1.xmlrpc import XmlRpcClient

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
