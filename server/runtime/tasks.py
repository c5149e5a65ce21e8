"""Background tasks on the event loop, the signals that wake them, and the clock of deadlines."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from contextlib import ExitStack, asynccontextmanager
from typing import Any
from weakref import WeakValueDictionary

from rosld.adapters.base import Watch
from rosld.server.http.problem import Problem

loop_time = time.monotonic
"""Clock of deadlines: the value of `loop.time()`, of asyncio and of uvloop.

Getting the running loop is a system call before Python 3.12, and each request would do it many times.
"""


class Signal:
    """A signal that wakes its watches when emitted; not thread-safe. Wake-ups may be spurious: read the state again."""

    def __init__(self) -> None:
        self._watches: dict[object, tuple[Callable[[], None], Callable[[str], bool] | None]] = {}

    def watch(self, wake: Callable[[], None], concerns: Callable[[str], bool] | None = None) -> Watch:
        """Call `wake` when the signal is emitted, if `concerns` (if given) accepts its subject."""
        key = object()
        self._watches[key] = (wake, concerns)
        return call_on_close(lambda: self._watches.pop(key, None))

    def emit(self, about: str = "") -> None:
        """Wake the watches that the subject concerns."""
        for key, (wake, concerns) in tuple(self._watches.items()):
            if key in self._watches and (concerns is None or concerns(about)):
                wake()


def call_every(seconds: float, wake: Callable[[], None]) -> Watch:
    """Call `wake` at this interval until the watch is closed."""
    loop = asyncio.get_running_loop()
    timer: asyncio.TimerHandle

    def ring() -> None:
        nonlocal timer
        timer = loop.call_later(seconds, ring)
        wake()

    timer = loop.call_later(seconds, ring)
    return call_on_close(lambda: timer.cancel())


def call_on_close(end: Callable[[], object]) -> Watch:
    """Return a watch that calls `end` once, when it is closed."""
    watch = ExitStack()
    watch.callback(end)
    return watch


def combine_watches(*watches: Watch) -> Watch:
    """Return one watch that closes several."""
    combined = ExitStack()
    for watch in watches:
        combined.callback(watch.close)
    return combined


_CANCEL_SECONDS = 0.5
"""Interval of repeated cancellations."""

_log = logging.getLogger("rosld")


class Background:
    """Base class of those that work in a task of the running loop from `start` until `stop`."""

    _task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Start; requires a running loop."""
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def stop(self) -> None:
        """Cancel the work, and wait for its end. Idempotent."""
        task, self._task = self._task, None
        if task is not None:
            await end_tasks([task])

    async def _run(self) -> None:
        raise NotImplementedError


class WokenTask(Background):
    """A task that runs `work` once started and after each `wake`; wakes during a run cause one more run.

    A failed run is logged. Not thread-safe.
    """

    def __init__(self, work: Callable[[], Awaitable[None]]) -> None:
        self._work = work
        self._woken = asyncio.Event()

    def wake(self) -> None:
        """Request another run."""
        self._woken.set()

    def start(self) -> None:
        """Start with the first run."""
        self._woken.set()
        super().start()

    async def _run(self) -> None:
        while True:
            await self._woken.wait()
            self._woken.clear()
            try:
                await self._work()
            except Exception:
                _log.exception("background work failed; it runs again at the next change")


async def end_tasks(tasks: Iterable[asyncio.Future[Any]]) -> None:
    """Cancel tasks until they have ended; their results and exceptions are ignored.

    One cancellation is not enough: before Python 3.12, `asyncio.wait_for` loses one that arrives as its wait ends
    (python/cpython#86296), so that a task that waits in a loop would never end.
    """
    pending = {*tasks}
    while pending:
        for each in pending:
            each.cancel()
        _, pending = await asyncio.wait(pending, timeout=_CANCEL_SECONDS)


class KeyedLock:
    """Locks that serialize conditional writes to each URL (RFC 9110 13.1.1: no lost updates)."""

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

    @asynccontextmanager
    async def acquire(self, *urls: str) -> AsyncIterator[None]:
        """Hold the locks of these URLs. Raises a 503 Problem if one is not free within the timeout, in seconds."""
        held: list[asyncio.Lock] = []
        try:
            for url in sorted(urls):  # sorted: two writes of the same URLs never wait for each other
                held.append(await self._acquire(url))
            yield
        finally:
            for lock in held:
                lock.release()

    async def _acquire(self, url: str) -> asyncio.Lock:
        lock = self._locks.get(url)
        if lock is None:
            lock = self._locks[url] = asyncio.Lock()
        try:
            if lock.locked():
                await asyncio.wait_for(lock.acquire(), self._timeout)
            else:
                await lock.acquire()  # at once
        except (asyncio.TimeoutError, TimeoutError):
            sentence = f"An earlier write to {url} is still in progress; nothing was done."
            raise Problem(503, sentence, headers={"Retry-After": "1"}) from None
        return lock
