"""Broadcasters, which observe a resource for all readers of its changes and read its state once per change."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import Counter
from collections.abc import Collection, Coroutine, Hashable, Iterator

from msgspec import Struct, field
from starlette.datastructures import Address
from starlette.types import Receive, Scope

from rosld.adapters.base import Watch
from rosld.adapters.model import RosError
from rosld.server.auth.rate_limit import client_name
from rosld.server.http.problem import Problem
from rosld.server.rest.resource import Resource
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import State
from rosld.server.runtime.tasks import Signal, call_every, end_tasks

MAX_READERS = 2000
"""Maximum number of streams and waiting requests; further ones are answered 503."""
MAX_OF_ADDRESS = 256
"""Default maximum per client address; further ones are answered 429."""
RETRY_SECONDS = 2
LOOK_AGAIN_SECONDS = 5.0
"""Seconds between checks of a resource that has no watch of its own."""

_log = logging.getLogger("rosld")


class Observation(Struct, frozen=True):
    """The state of a resource at one moment, or the problem of reading it.

    `name` identifies the content. `chunks` are its events, by variant and edition: each is rendered once for all
    readers.
    """

    name: str
    state: State | Problem
    chunks: dict[Hashable, bytes] = field(default_factory=dict)

    @property
    def is_final(self) -> bool:
        """Whether it is the last one: the resource was removed permanently (410)."""
        return isinstance(self.state, Problem) and self.state.status == 410


class Waiter:
    """A task that sleeps until it is woken."""

    __slots__ = ("_loop", "_woken")

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._woken: asyncio.Future[None] | None = None

    def wake(self) -> None:
        """Wake the task if it sleeps."""
        woken, self._woken = self._woken, None
        if woken is not None and not woken.done():
            woken.set_result(None)

    def sleep(self) -> asyncio.Future[None]:
        """Return an awaitable that ends with the next wake-up."""
        self._woken = self._loop.create_future()
        return self._woken


class Broadcaster:
    """Observer of one resource for all its readers.

    A reader remembers `version`, reads the state, and sleeps in `wait` until there may be a newer one. Changes without
    readers only increment a number. After any general change the resource is watched anew, because its parts may have
    changed.
    """

    def __init__(self, resource: Resource, changes: Signal) -> None:
        self.version = 1
        self.readers = 0
        self._resource = resource
        self._general = changes
        self._follows: Watch | None = None
        self._watch: Watch | None = None
        self._is_outdated = True
        self._waiters: dict[Waiter, None] = {}
        self._turn = asyncio.Lock()
        self._latest: Observation | None = None
        self._observed_version = 0

    def start(self) -> None:
        """Follow the resource; its own watch is created with the first read."""
        self._follows = self._general.watch(self._outdate)

    def stop(self) -> None:
        """Stop observing."""
        for watch in (self._follows, self._watch):
            if watch is not None:
                watch.close()

    async def wait(self, waiter: Waiter, version: int) -> None:
        """Wait until there may be a version newer than `version`, or the waiter is woken otherwise."""
        if self.version == version:
            self._waiters[waiter] = None
            try:
                await waiter.sleep()
            finally:
                self._waiters.pop(waiter, None)

    def current(self) -> Observation | None:
        """Return the result of `observe`, if that needs no read."""
        return self._latest if self._observed_version == self.version else None

    async def observe(self) -> Observation:
        """Return the current state: the same object until it changes."""
        async with self._turn:
            observation = self.current()
            if observation is None:
                version = self.version
                observation = await self._read()
                if self._latest is not None and self._latest.name == observation.name:
                    observation = self._latest
                self._latest, self._observed_version = observation, version
            return observation

    async def _read(self) -> Observation:
        try:
            if self._is_outdated:
                await self._renew()
            await self._resource.prepare()
            state = await self._resource.state()
            return Observation(state.tag, state)
        except RosError as error:
            problem = problem_of(error)
        except Problem as error:
            problem = error
        except Exception as error:
            _log.exception("cannot read %s to look for changes", self._resource.url, exc_info=error)
            problem = Problem(500, "The server failed to read this resource; see its log.")
        return Observation(f"{problem.status} {problem.with_quotes}", problem)

    async def _renew(self) -> None:
        """Watch the resource in its present form; if that fails, the next read tries again."""
        self._is_outdated = False
        watch: Watch | None = None
        try:
            watch = await self._resource.watch(self.wake_all)
        except BaseException:
            self._is_outdated = True
            raise
        finally:
            old, self._watch = self._watch, watch or call_every(LOOK_AGAIN_SECONDS, self.wake_all)
            if old is not None:
                old.close()

    def _outdate(self) -> None:
        self._is_outdated = True
        self.wake_all()

    def wake_all(self) -> None:
        """Wake all readers."""
        self.version += 1
        if self._waiters:
            sleepers, self._waiters = self._waiters, {}
            for waiter in sleepers:
                waiter.wake()


class Broadcasters:
    """Broadcasters of one server, one per resource with readers; `changes` wakes them after every change."""

    def __init__(
        self, changes: Signal, max_of_address: int = MAX_OF_ADDRESS, of_address: Counter[str | None] | None = None
    ) -> None:
        """Initialize; `of_address` are the numbers of readers by address, where several broadcasters share them."""
        self._general = changes
        self._max_of_address = max_of_address
        self._of_address: Counter[str | None] = Counter() if of_address is None else of_address
        self._broadcasters: dict[Resource, Broadcaster] = {}
        self._held: set[asyncio.Task[None]] = set()
        self._is_over = False

    @property
    def readers(self) -> int:
        """Current number of streams and waiting requests."""
        return len(self._held)

    @property
    def resources(self) -> Collection[Resource]:
        """Resources with readers."""
        return self._broadcasters.keys()

    def require_capacity(self, client: tuple[str, int] | Address | None = None) -> None:
        """Raise a 503 Problem if the number of readers is at its limit, or the server is ending.

        Raises a 429 Problem if the readers at this client's address are at their limit; loopback addresses count too.
        """
        if self._of_address[_address_of(client)] >= self._max_of_address:
            words = f"{self._max_of_address} streams and waiting requests from your address are open, the maximum"
            raise Problem(429, f"{words} (client_streams): end some.", headers={"Retry-After": "5"})
        if self._is_over or self.readers >= MAX_READERS:
            why = (
                "The server is shutting down."
                if self._is_over
                else f"{MAX_READERS} clients are already waiting for changes."
            )
            raise Problem(503, f"{why} Try again later, or read without a stream.", headers={"Retry-After": "10"})

    @contextlib.contextmanager
    def count_reader(self, scope: Scope) -> Iterator[None]:
        """Count a stream or a waiting request for its client's address."""
        address = _address_of(scope.get("client"))
        self._of_address[address] += 1
        try:
            yield
        finally:
            self._of_address[address] -= 1
            if not self._of_address[address]:
                del self._of_address[address]

    @contextlib.contextmanager
    def subscribe(self, resource: Resource) -> Iterator[Broadcaster]:
        """Return the broadcaster of a resource, which is watched as long as it has readers."""
        broadcaster = self._broadcasters.get(resource)
        if broadcaster is None:
            broadcaster = self._broadcasters[resource] = Broadcaster(resource, self._general)
            broadcaster.start()
        broadcaster.readers += 1
        try:
            yield broadcaster
        finally:
            broadcaster.readers -= 1
            if not broadcaster.readers:
                broadcaster.stop()
                del self._broadcasters[resource]

    async def run_for_client(
        self, work: Coroutine[None, None, None], receive: Receive, seconds: float | None = None
    ) -> bool:
        """Run work for a client until it is done, the client disconnects, the time is over or the server ends.

        Returns whether it was done; otherwise it is cancelled, and has ended on return.
        """
        working = asyncio.ensure_future(work)
        listening = asyncio.ensure_future(_wait_for_disconnect(receive))
        self._held.add(working)
        try:
            await asyncio.wait({working, listening}, timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._held.discard(working)
            done = working.done() and not working.cancelled()
            await end_tasks((working, listening))
        if done:
            working.result()
        return done

    def wake_all(self) -> None:
        """Wake all readers to read the state again, because their rights may have changed."""
        for broadcaster in tuple(self._broadcasters.values()):
            broadcaster.wake_all()

    def close(self) -> None:
        """End all streams and waits, and refuse new ones."""
        self._is_over = True
        for task in tuple(self._held):
            task.cancel()


def _address_of(client: tuple[str, int] | Address | None) -> str | None:
    return client_name(client[0], loopback=True) if client else None


async def _wait_for_disconnect(receive: Receive) -> None:
    """Wait until the client has disconnected (ASGI http.disconnect)."""
    while (await receive())["type"] != "http.disconnect":
        pass
