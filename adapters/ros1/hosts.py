"""Connections to the hosts that a master names: by the user's map, by resolving, or at the master's own host."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar
from urllib.parse import urlsplit

from rosld.adapters.model import Unreachable

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
        address = await self.resolve(host)
        try:
            return await asyncio.wait_for(asyncio.open_connection(address.ip, port), CONNECT)
        except (OSError, asyncio.TimeoutError) as error:
            raise Unreachable(_failure_text(host, port, address, error)) from error

    async def connect(self, host: str, port: int, protocol: Callable[[], _P]) -> _P:
        """Return a protocol connected to `port` of `host`. Raises Unreachable with the addresses tried."""
        address = await self.resolve(host)
        loop = asyncio.get_running_loop()
        try:
            _, connection = await asyncio.wait_for(loop.create_connection(protocol, address.ip, port), CONNECT)
        except (OSError, asyncio.TimeoutError) as error:
            raise Unreachable(_failure_text(host, port, address, error)) from error
        return connection

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


def _failure_text(host: str, port: int, address: Address, error: BaseException) -> str:
    words = str(error) or "no answer"
    if address.guessed:
        return (
            f"{address.guessed}, and at the master's host {address.ip} port {port} does not answer either "
            f"({words}); name its address with --host-map {host}=IP"
        )
    return f"{host}:{port} does not answer ({words})"
