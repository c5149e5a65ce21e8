"""Service calls: any number at once, each with its own deadline, over clients that are cached for some time.

Everything here runs on the ROS thread, and blocks only its event loop.
"""

from __future__ import annotations

import asyncio
import math
from functools import partial

from msgspec import Struct, field

from rosld.adapters.model import Sent, TimedOut, UnknownType, Unreachable
from rosld.adapters.ros2.middleware import Client, Participant
from rosld.adapters.ros2.wait_set import Waiter

_IDLE = 30.0
_FIRST_PAUSE = 0.002
_LONGEST_PAUSE = 0.05
_SETTLING = 0.05
_LONGEST_SETTLING = 0.5
_SETTLING_STEPS = 10
"""Number of parts of this wait: on a busy machine each takes longer, like the server's discovery of our client."""


class _ServiceClient(Struct, eq=False):
    """A client, and its pending calls."""

    client: Client
    pending: dict[int, asyncio.Future[object]] = field(default_factory=dict)
    users: int = 0
    used: float = 0.0
    settled: bool = False


class Calls:
    """Services of a ROS 2 system, called with objects of their types' classes."""

    def __init__(self, participant: Participant, waiter: Waiter) -> None:
        self._participant = participant
        self.messages = participant.messages
        self._waiter = waiter
        self._loop = asyncio.get_running_loop()
        self._clients: dict[tuple[str, str], _ServiceClient] = {}

    async def call(self, service: str, type: str, request: object, until: float) -> object:
        """Return the response; `until` is a time of the thread's loop. Raises TimedOut, Unreachable, UnknownType."""
        if until <= self._loop.time():
            raise TimedOut(f"the deadline passed before {service} was called")
        entry = self._client_of(service, type)
        entry.users += 1
        try:
            await self._wait_for_server(service, entry, until)
            return await self._answer(service, entry, request, until)
        finally:
            entry.users -= 1
            entry.used = self._loop.time()

    def drop_missing_servers(self) -> None:
        """Fail calls to servers that have disappeared, and drop unused clients."""
        now = self._loop.time()
        for key, entry in list(self._clients.items()):
            if entry.pending and not entry.client.ready():
                for future in entry.pending.values():
                    if not future.done():
                        words = f"{key[0]} was called, but its node went away before it answered"
                        future.set_exception(Unreachable(words, sent=Sent.MAYBE))
            elif not entry.users and now - entry.used > _IDLE:
                del self._clients[key]
                self._close(entry)

    def forget(self, service: str) -> None:
        """Close the idle clients of a service that no longer exists."""
        for key, entry in list(self._clients.items()):
            if key[0] == service and not entry.users:
                del self._clients[key]
                self._close(entry)

    def close(self) -> None:
        """Fail pending calls and close all clients."""
        for entry in self._clients.values():
            for future in entry.pending.values():
                if not future.done():
                    future.set_exception(Unreachable("the adapter was closed meanwhile", sent=Sent.MAYBE))
            self._close(entry)
        self._clients.clear()

    def _client_of(self, service: str, type: str) -> _ServiceClient:
        entry = self._clients.get((service, type))
        if entry is None:
            try:
                client = self._participant.client(service, type)
            except UnknownType:
                raise
            except Exception as error:
                raise Unreachable(f"{service} cannot be called: {error}") from error
            entry = self._clients[service, type] = _ServiceClient(client, used=self._loop.time())
        return entry

    async def _wait_for_server(self, service: str, entry: _ServiceClient, until: float) -> None:
        """Wait for a server, and then as long again for the server to discover the client.

        A server that has not discovered the client cannot send its response, and the middleware drops it.
        """
        began = self._loop.time()
        pause = _FIRST_PAUSE
        while not entry.client.ready():
            if self._loop.time() + pause >= until:
                raise TimedOut(f"no server of {service} was connected in time: nothing was sent")
            await asyncio.sleep(pause)
            pause = min(2 * pause, _LONGEST_PAUSE)
            entry.settled = False
        if not entry.settled:
            now = self._loop.time()
            settling = min(max(_SETTLING, now - began), _LONGEST_SETTLING)
            for _ in range(_SETTLING_STEPS):
                if self._loop.time() - now < (until - now) / 2:
                    await asyncio.sleep(settling / _SETTLING_STEPS)
            entry.settled = True

    async def _answer(self, service: str, entry: _ServiceClient, request: object, until: float) -> object:
        try:
            number = entry.client.send(request)
        except Exception as error:
            raise Unreachable(f"{service} cannot be called: {error}") from error
        future: asyncio.Future[object] = self._loop.create_future()
        entry.pending[number] = future
        self._arm(entry)
        try:
            left = None if until == math.inf else max(until - self._loop.time(), 0.0)
            return await asyncio.wait_for(future, left)
        except asyncio.TimeoutError as error:
            raise TimedOut(f"{service} did not answer in time", sent=Sent.MAYBE) from error
        finally:
            entry.pending.pop(number, None)

    def _arm(self, entry: _ServiceClient) -> None:
        self._waiter.arm(entry.client.handle, "client", partial(self._take, entry))

    def _take(self, entry: _ServiceClient) -> None:
        while (reply := entry.client.take()) is not None:
            number, response = reply
            future = entry.pending.get(number)
            if future is not None and not future.done():
                future.set_result(response)
        if any(not future.done() for future in entry.pending.values()):
            self._arm(entry)

    def _close(self, entry: _ServiceClient) -> None:
        self._waiter.disarm(entry.client.handle)
        entry.client.close()
