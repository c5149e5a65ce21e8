"""Locks by URL that serialise conditional writes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from weakref import WeakValueDictionary

from rosld.server.http.problem import Problem


class KeyedLock:
    """Serialises the conditional writes at each URL (RFC 9110 13.1.1: no update is lost)."""

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

    @asynccontextmanager
    async def acquire(self, *urls: str) -> AsyncIterator[None]:
        """Hold the locks of these URLs. Raises a 503 Problem if one is not free within the timeout, in seconds."""
        held: list[asyncio.Lock] = []
        try:
            for url in sorted(urls):  # in one order: two writes of the same URLs never wait for each other
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
            sentence = f"An earlier write to {url} is not finished yet; nothing was done."
            raise Problem(503, sentence, headers={"Retry-After": "1"}) from None
        return lock
