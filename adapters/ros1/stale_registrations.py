"""Removal of registrations at the master that a rosld left when it ended uncleanly.

The master never forgets a publisher that was killed, so that its topics would be "published by /rosld_HOST_PID" for
ever. What is removed was registered under a name of rosld's, at an address of this machine where nobody answers any
more, or another process. A rosld that is only busy or suspended still has its port: connections to it are accepted.
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
_AGAIN = 10.0  # seconds until an address that answered is looked at again
_PATIENCE = 2.0


def host_label() -> str:
    """Return this machine's name as in the names of rosld's nodes."""
    return re.sub(r"\W", "_", socket.gethostname(), flags=re.ASCII)


def own_name(number: int) -> str:
    """A name for the adapter of this number in this process: `/rosld_HOST_PID`, from the second on with the number."""
    return f"/rosld_{host_label()}_{os.getpid()}" + (f"_{number}" if number else "")


def pids(node: str) -> frozenset[int]:
    """The process ids that a node's name may hold, two where it ends in two numbers; none for others' names."""
    found = _NAME.fullmatch(node) if node.startswith("/rosld_") else None
    if found is None:
        return frozenset()
    return frozenset(int(each) for each in (found["pid"], found["number"]) if each)


class StaleRegistrations:
    """Looks for dead registrations of rosld's. All methods run on the reading thread.

    `own_uri` gives the URI of our own Slave API while it runs.
    """

    def __init__(self, master: MasterApi, hosts: Hosts, own_node: str, own_uri: Callable[[], str | None]) -> None:
        self._master = master
        self._hosts = hosts
        self._own_node = own_node
        self._own_uri = own_uri
        self._looked_at: dict[str, float] = {}

    def nodes_to_check(self, publishers: Mapping[str, tuple[str, ...]]) -> Mapping[str, tuple[str, ...]]:
        """The topics of each node that is to be looked at now; `publishers` are the nodes by topic."""
        named = {node for nodes in publishers.values() for node in nodes if pids(node)}
        if self._own_uri() is not None:
            named.discard(self._own_node)
        self._looked_at = {node: at for node, at in self._looked_at.items() if node in named}
        now = time.monotonic()
        chosen = [node for node in named if now - self._looked_at.get(node, -_AGAIN) >= _AGAIN]
        self._looked_at.update(dict.fromkeys(chosen, now))
        return {node: tuple(topic for topic, nodes in publishers.items() if node in nodes) for node in chosen}

    async def remove(self, node: str, topics: tuple[str, ...]) -> bool:
        """Unregister a node from these topics if it is dead; whether it was."""
        try:
            uri = await self._master.lookup_node(node, _PATIENCE)
            if uri == self._own_uri() or not await self._is_dead(node, uri):
                return False
            for topic in topics:
                await self._master.unregister_publisher(topic, uri, _PATIENCE, node=node)
        except RosError:
            return False  # the master or the address cannot be asked: nothing is known
        return True

    async def _is_dead(self, node: str, uri: str) -> bool:
        """Whether a node's address is certainly unused, or used by another. Raises Unreachable."""
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
        """Whether who answers at an address is a process that the node's name does not name."""
        client = XmlRpcClient(uri, "/", lambda: self._hosts.streams(host, port), keep_alive=False)
        try:
            answer = await client.call("getPid", self._own_node, timeout=_PATIENCE)
        except (TimedOut, Refused):
            return False
        return isinstance(answer.value, int) and answer.value not in pids(node)


def _is_local(ip: str) -> bool:
    """Whether an address is this machine's own: only those can be bound."""
    try:
        with socket.socket(socket.AF_INET6 if ":" in ip else socket.AF_INET, socket.SOCK_STREAM) as probe:
            probe.bind((ip, 0))
    except OSError:
        return False
    return True
