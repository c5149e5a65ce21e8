"""A lock per URL that serialises conditional writes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from weakref import WeakValueDictionary

from rosld.server.http.problem import Problem


class KeyedLock:
    """Serialises the conditional writes at each URL (RFC 9110 13.1.1: no update is lost)."""

    def __init__(self, timeout: float) -> None:
        self._patience = timeout
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

    @asynccontextmanager
    async def acquire(self, url: str) -> AsyncIterator[None]:
        """Within it no other is; a 503 Problem where the one before takes longer than the patience, in seconds."""
        lock = self._locks.get(url)
        if lock is None:
            lock = self._locks[url] = asyncio.Lock()
        try:
            if lock.locked():
                await asyncio.wait_for(lock.acquire(), self._patience)
            else:
                await lock.acquire()  # at once
        except (asyncio.TimeoutError, TimeoutError):
            sentence = f"An earlier write to {url} is not finished yet; nothing was done."
            raise Problem(503, sentence, headers={"Retry-After": "1"}) from None
        try:
            yield
        finally:
            lock.release()
