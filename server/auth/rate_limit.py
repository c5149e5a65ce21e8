"""Rate limits: the token bucket for clients, publishes and events, and the limits of each client."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import lru_cache, partial
from ipaddress import IPv6Address, ip_address

from msgspec import Struct

from rosld.server.auth.rules import ANONYMOUS, Agent
from rosld.server.http.problem import Problem

_ROUNDING = 1e-9


class TokenBucket:
    """Token bucket with `rate` tokens per second and capacity `burst` (at least 1.0), initially full.

    The state is one number, the time at which it is full again: the theoretical arrival time of the generic cell rate
    algorithm (ITU-T I.371), which is equivalent. Times are seconds of a monotonic clock.
    """

    __slots__ = ("_burst", "_full_at", "_interval")

    def __init__(self, rate: float, burst: float) -> None:
        self._interval = 1.0 / rate
        self._burst = max(burst, 1.0)
        self._full_at = -math.inf

    def wait(self, now: float) -> float:
        """Return the seconds until a token is available, 0.0 if there is one."""
        seconds = self._full_at - now - (self._burst - 1.0) * self._interval
        return seconds if seconds > _ROUNDING else 0.0

    def take(self, now: float, *, debt: float = math.inf) -> None:
        """Take a token; an empty bucket lends at most `debt` tokens, which later takers wait for."""
        self._full_at = min(max(self._full_at, now), now + (self._burst + debt - 1.0) * self._interval) + self._interval

    def is_full(self, now: float) -> bool:
        """Whether the bucket is full."""
        return self._full_at <= now


BURST_SECONDS = 2.0
"""Burst of a client in seconds of its rate."""
RETRY_SECONDS = 0.5
"""Seconds by which a refusal is delayed, so that immediate retries do not keep the server busy."""
MAX_CLIENTS = 10_000


class RateLimitExceeded(Problem):
    """Problem 429: the client is at its limit. The response is sent after `RETRY_SECONDS`."""


class ClientLimits(Struct, frozen=True):
    """Limits of one client: requests per second, concurrent requests, connections, and WebSockets among them."""

    rate: float
    requests: int
    connections: int
    websockets: int = 256


class Client:
    """A client: its current requests, connections and WebSockets, and the bucket of its requests.

    A client is an authenticated agent, or else an address: in IPv6 a network of 64 bits, which usually belongs to one
    machine.
    """

    __slots__ = ("bucket", "connections", "requests", "websockets")

    def __init__(self, rate: float) -> None:
        self.requests = 0
        self.connections = 0
        self.websockets = 0
        self.bucket = TokenBucket(rate, BURST_SECONDS * rate)

    def is_idle(self, now: float) -> bool:
        """Whether the client can be removed without any effect."""
        return not (self.requests or self.connections or self.websockets) and self.bucket.is_full(now)


class ClientLimiter:
    """Limiter of one server's clients; those on this machine are unlimited unless `loopback`.

    Belongs to one loop.
    """

    def __init__(self, limits: ClientLimits, *, loopback: bool, clock: Callable[[], float] = time.monotonic) -> None:
        self._limits = limits
        self._clock = clock
        self._known: dict[str, Client] = {}
        self._address = lru_cache(maxsize=MAX_CLIENTS)(partial(client_name, loopback=loopback))

    def acquire(self, agent: Agent, address: str | None) -> Client | None:
        """Count a request; return the argument of `release` after the response. Raises RateLimitExceeded."""
        name = self._address(address) if agent.name == ANONYMOUS.name else f"agent {agent.name}"
        if name is None:
            return None
        client, now, limits = self._client(name), self._clock(), self._limits
        if client.requests >= limits.requests:
            words = f"{limits.requests} of your requests are in progress, the maximum"
            raise _exceeded(f"{words}: wait for one to finish.", 1.0)
        wait = client.bucket.wait(now)
        if wait > 0.0:
            raise _exceeded(f"You sent more than {limits.rate:g} requests per second: slow down.", wait)
        client.bucket.take(now)
        client.requests += 1
        return client

    @property
    def websockets(self) -> int:
        """Number of open WebSockets."""
        return sum(client.websockets for client in self._known.values())

    def release(self, client: Client | None) -> None:
        """Count a request as answered or cancelled."""
        if client is not None:
            client.requests -= 1

    def connect(self, address: str | None) -> Callable[[], None]:
        """Count a connection; return a function to call when it ends. Raises RateLimitExceeded."""
        name = self._address(address)
        if name is None:
            return _nothing
        client = self._client(name)
        if client.connections >= self._limits.connections:
            words = f"{client.connections} connections from your address are open, the maximum"
            raise _exceeded(f"{words}: reuse or close some.", 5.0)
        client.connections += 1

        def ended() -> None:
            client.connections -= 1

        return ended

    def open_websocket(self, address: str | None) -> Callable[[], None]:
        """Count a WebSocket, also on this machine, until the returned function is called.

        Raises a 429 Problem beyond the limit.
        """
        client = self._client(f"WebSockets of {client_name(address, loopback=True)}")
        if client.websockets >= self._limits.websockets:
            words = f"{client.websockets} WebSockets from your address are open, the maximum"
            raise _exceeded(f"{words} (client_websockets): reuse or close some.", 5.0)
        client.websockets += 1

        def ended() -> None:
            client.websockets -= 1

        return ended

    def _client(self, name: str) -> Client:
        client = self._known.get(name)
        if client is None:
            if len(self._known) >= MAX_CLIENTS:
                now = self._clock()
                self._known = {each: one for each, one in self._known.items() if not one.is_idle(now)}
            client = self._known[name] = Client(self._limits.rate)
        return client


def client_name(address: str | None, *, loopback: bool) -> str | None:
    """Return the name under which a client is counted by its address, None for this machine unless `loopback`."""
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


def _exceeded(words: str, seconds: float) -> RateLimitExceeded:
    return RateLimitExceeded(429, words, headers={"Retry-After": str(max(1, math.ceil(seconds)))})
