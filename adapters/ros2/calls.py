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
_FIRST_LOOK = 0.002
_LONGEST_LOOK = 0.05
_SETTLING = 0.05
_LONGEST_SETTLING = 0.5
_SETTLING_STEPS = 10
"""Number of parts of this wait: on a busy machine each takes longer, like the server's discovery of our client."""


class _Line(Struct, eq=False):
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
        self._waiter = waiter
        self._loop = asyncio.get_running_loop()
        self._lines: dict[tuple[str, str], _Line] = {}

    async def call(self, service: str, type: str, request: object, until: float) -> object:
        """Return the response; `until` is a time of the thread's loop. Raises TimedOut, Unreachable, UnknownType."""
        if until <= self._loop.time():
            raise TimedOut(f"the time was up before {service} was called")
        line = self._line(service, type)
        line.users += 1
        try:
            await self._wait_for_server(service, line, until)
            return await self._answer(service, line, request, until)
        finally:
            line.users -= 1
            line.used = self._loop.time()

    def drop_missing_servers(self) -> None:
        """Fail calls to servers that have disappeared, and drop unused clients."""
        now = self._loop.time()
        for key, line in list(self._lines.items()):
            if line.pending and not line.client.ready():
                for future in line.pending.values():
                    if not future.done():
                        words = f"{key[0]} was called, but its node went away before it answered"
                        future.set_exception(Unreachable(words, sent=Sent.MAYBE))
            elif not line.users and now - line.used > _IDLE:
                del self._lines[key]
                self._close(line)

    def forget(self, service: str) -> None:
        """Close the idle clients of a service that no longer exists."""
        for key, line in list(self._lines.items()):
            if key[0] == service and not line.users:
                del self._lines[key]
                self._close(line)

    def close(self) -> None:
        """Fail pending calls and close all clients."""
        for line in self._lines.values():
            for future in line.pending.values():
                if not future.done():
                    future.set_exception(Unreachable("the adapter was closed meanwhile", sent=Sent.MAYBE))
            self._close(line)
        self._lines.clear()

    def _line(self, service: str, type: str) -> _Line:
        line = self._lines.get((service, type))
        if line is None:
            try:
                client = self._participant.client(service, type)
            except UnknownType:
                raise
            except Exception as error:
                raise Unreachable(f"{service} cannot be called: {error}") from error
            line = self._lines[service, type] = _Line(client, used=self._loop.time())
        return line

    async def _wait_for_server(self, service: str, line: _Line, until: float) -> None:
        """Wait for a server, and then as long again for the server to discover the client.

        A server that has not discovered the client cannot send its response, and the middleware drops it.
        """
        began = self._loop.time()
        pause = _FIRST_LOOK
        while not line.client.ready():
            if self._loop.time() + pause >= until:
                raise TimedOut(f"no server of {service} was connected in time: nothing was sent")
            await asyncio.sleep(pause)
            pause = min(2 * pause, _LONGEST_LOOK)
            line.settled = False
        if not line.settled:
            now = self._loop.time()
            settling = min(max(_SETTLING, now - began), _LONGEST_SETTLING)
            for _ in range(_SETTLING_STEPS):
                if self._loop.time() - now < (until - now) / 2:
                    await asyncio.sleep(settling / _SETTLING_STEPS)
            line.settled = True

    async def _answer(self, service: str, line: _Line, request: object, until: float) -> object:
        try:
            number = line.client.send(request)
        except Exception as error:
            raise Unreachable(f"{service} cannot be called: {error}") from error
        future: asyncio.Future[object] = self._loop.create_future()
        line.pending[number] = future
        self._arm(line)
        try:
            left = None if until == math.inf else max(until - self._loop.time(), 0.0)
            return await asyncio.wait_for(future, left)
        except asyncio.TimeoutError as error:
            raise TimedOut(f"{service} did not answer in time", sent=Sent.MAYBE) from error
        finally:
            line.pending.pop(number, None)

    def _arm(self, line: _Line) -> None:
        self._waiter.arm(line.client.handle, "client", partial(self._ready, line))

    def _ready(self, line: _Line) -> None:
        try:
            self._loop.call_soon_threadsafe(self._take, line)
        except RuntimeError:
            pass  # the thread's event loop has ended

    def _take(self, line: _Line) -> None:
        while (reply := line.client.take()) is not None:
            number, response = reply
            future = line.pending.get(number)
            if future is not None and not future.done():
                future.set_result(response)
        if any(not future.done() for future in line.pending.values()):
            self._arm(line)

    def _close(self, line: _Line) -> None:
        self._waiter.disarm(line.client.handle)
        line.client.close()
