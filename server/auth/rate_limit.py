"""Clients: how much each of them may ask at a time, so that one at its limit leaves the others their speed.

A client is who it says it is, where that is known, else its address: in IPv6 its network of 64 bits, which is one
machine's as a rule.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_address

from rosld.server.auth.agent import ANYBODY, Agent
from rosld.server.http.problem import Problem

BURST_SECONDS = 2.0
"""A client that was quiet may send what it may send in so many seconds at once."""
REFUSAL_SECONDS = 0.5
"""How long a refusal waits: who asks again at once would keep the server as busy with refusing as with answering."""
_MOST_KNOWN = 10_000


class RateLimitExceeded(Problem):
    """The client is at its limit (429). It is told so after a moment (`REFUSAL_SECONDS`)."""


@dataclass(frozen=True, slots=True)
class ClientLimits:
    """What one client may do: requests a second, requests under way, connections, WebSockets among them."""

    rate: float
    requests: int
    connections: int
    websockets: int = 256


class Client:
    """One client as it is known: how many requests are under way, and when all it has sent was due.

    The second is the theoretical arrival time of the generic cell rate algorithm (ITU-T I.371).
    """

    __slots__ = ("connections", "due", "requests", "websockets")

    def __init__(self) -> None:
        self.requests = 0
        self.connections = 0
        self.websockets = 0
        self.due = 0.0

    def is_idle(self, now: float) -> bool:
        """Whether forgetting it makes no difference."""
        return not (self.requests or self.connections or self.websockets) and self.due <= now


class ClientLimiter:
    """All clients of one server. Those on this machine have no limits unless `loopback`. Belongs to one loop."""

    def __init__(self, allowance: ClientLimits, *, loopback: bool, clock: Callable[[], float] = time.monotonic) -> None:
        self._allowance = allowance
        self._loopback = loopback
        self._clock = clock
        self._known: dict[str, Client] = {}
        self._names: dict[str, str | None] = {}

    def admit(self, agent: Agent, address: str | None) -> Client | None:
        """Let a request pass: what `leave` is to be told when it is answered. Raises a 429 Problem."""
        name = self._address(address) if agent.name == ANYBODY.name else f"agent {agent.name}"
        if name is None:
            return None
        client, now, allowance = self._client(name), self._clock(), self._allowance
        if client.requests >= allowance.requests:
            words = f"{allowance.requests} requests of yours are being answered already, as many as may be at a time"
            raise _too_much(f"{words}: wait for one to end.", 1.0)
        wait = max(client.due, now) - now - BURST_SECONDS + 1.0 / allowance.rate
        if wait > 1e-9 and client.due > now:
            raise _too_much(f"You send more than {allowance.rate:g} requests a second: send fewer.", wait)
        client.due = max(client.due, now) + 1.0 / allowance.rate
        client.requests += 1
        return client

    def leave(self, client: Client | None) -> None:
        """A request was answered, or given up."""
        if client is not None:
            client.requests -= 1

    def connect(self, address: str | None) -> Callable[[], None]:
        """Let a connection be made: what is to be called when it ends. Raises a 429 Problem."""
        name = self._address(address)
        if name is None:
            return _nothing
        client = self._client(name)
        if client.connections >= self._allowance.connections:
            words = f"{client.connections} connections come from your address already, as many as may be at a time"
            raise _too_much(f"{words}: use those, or end some.", 5.0)
        client.connections += 1

        def ended() -> None:
            client.connections -= 1

        return ended

    def open_websocket(self, address: str | None) -> Callable[[], None]:
        """As `connect`, for WebSockets, which this machine's clients may not have without limit either."""
        client = self._client(f"WebSockets of {name_of(address, loopback=True)}")
        if client.websockets >= self._allowance.websockets:
            words = f"{client.websockets} WebSockets are open at your address already, as many as may be at a time"
            raise _too_much(f"{words} (client_websockets): use those, or end some.", 5.0)
        client.websockets += 1

        def ended() -> None:
            client.websockets -= 1

        return ended

    def _client(self, name: str) -> Client:
        client = self._known.get(name)
        if client is None:
            if len(self._known) >= _MOST_KNOWN:
                now = self._clock()
                self._known = {each: one for each, one in self._known.items() if not one.is_idle(now)}
            client = self._known[name] = Client()
        return client

    def _address(self, address: str | None) -> str | None:
        """What a client is known by that says nothing of itself; None where it has no limits."""
        if address not in self._names:
            if len(self._names) >= _MOST_KNOWN:
                self._names.clear()
            self._names[address or ""] = name_of(address, loopback=self._loopback)
        return self._names[address or ""]


def name_of(address: str | None, *, loopback: bool) -> str | None:
    """What the client at an address is known by; None for this machine, unless `loopback`."""
    try:
        found = ip_address((address or "").partition("%")[0])
    except ValueError:
        return f"address {address}"
    if isinstance(found, IPv6Address):
        found = found.ipv4_mapped or found
    if found.is_loopback and not loopback:
        return None
    if isinstance(found, IPv6Address):
        return f"address {IPv6Address(int(found) >> 64 << 64)}/64"
    return f"address {found}"


def _nothing() -> None:
    pass


def _too_much(words: str, seconds: float) -> RateLimitExceeded:
    return RateLimitExceeded(429, words, headers={"Retry-After": str(max(1, math.ceil(seconds)))})
