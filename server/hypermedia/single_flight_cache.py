"""Single-flight cache: a value is cached for a while, and concurrent requests for it share one fetch."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Generic, TypeAlias, TypeVar

from msgspec import Struct

from rosld.server.runtime.tasks import end_tasks

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")

Fetch: TypeAlias = Callable[[Sequence[K]], Awaitable[Mapping[K, V]]]
"""Function that returns the values of all keys and never raises."""

Slot: TypeAlias = "AbstractAsyncContextManager[None]"
"""Context manager in which a fetch runs, such as a semaphore."""

_MAX_ENTRIES = 65536


class CacheEntry(Struct, Generic[V], frozen=True):
    """The result of a fetch that began at turn `started`; valid until the loop time `until`."""

    value: V
    started: int
    until: float


class PendingFetch(Generic[K, V]):
    """A fetch in progress, which continues if its callers stop waiting; `started` is its turn, or 0 if queued."""

    def __init__(self, keys: Sequence[K]) -> None:
        self.keys = keys
        self.started = 0
        self.task: asyncio.Task[Mapping[K, V]]

    async def wait(self, deadline: float) -> Mapping[K, V] | None:
        """Return the values, or None if the fetch does not finish by `deadline` (loop time)."""
        if not self.task.done():
            left = deadline - asyncio.get_running_loop().time()
            await asyncio.wait({self.task}, timeout=max(0.0, left))
        return self.task.result() if self.task.done() and not self.task.cancelled() else None


class SingleFlightCache(Generic[K, V]):
    """Values by key, each valid for `freshness` seconds.

    Every fetch takes a number from `turns` at its start, which orders fetches and callers.
    """

    def __init__(self, freshness: float, turns: Iterator[int]) -> None:
        self._freshness = freshness
        self._turns = turns
        self._kept: dict[K, CacheEntry[V]] = {}
        self._under_way: dict[K, PendingFetch[K, V]] = {}
        self._tasks: set[asyncio.Task[Mapping[K, V]]] = set()

    def find(self, key: K, since: int = 0) -> CacheEntry[V] | None:
        """Return the value if it is valid and its fetch began after the turn `since`."""
        answer = self._kept.get(key)
        if answer is None or answer.started <= since or answer.until <= asyncio.get_running_loop().time():
            return None
        return answer

    def fetch(self, keys: Iterable[K], start: Fetch[K, V], slot: Slot, since: int = 0) -> Sequence[PendingFetch[K, V]]:
        """Return the fetches for all keys: pending ones that begin after `since`, and a new one for the other keys.

        The new one begins once a `slot` is free.
        """
        shared: dict[PendingFetch[K, V], None] = {}
        others = []
        for key in keys:
            pending = self._under_way.get(key)
            if pending is not None and (pending.started == 0 or pending.started > since):
                shared[pending] = None
            else:
                others.append(key)
        if others:
            shared[self._begin(others, start, slot)] = None
        return tuple(shared)

    def invalidate(self, key: K) -> None:
        """Invalidate a value, even while it is being fetched, so that the next read fetches it again."""
        self._kept.pop(key, None)
        pending = self._under_way.get(key)
        if pending is not None and pending.started:
            del self._under_way[key]

    async def stop(self) -> None:
        """Cancel all fetches."""
        await end_tasks(self._tasks)

    def _begin(self, keys: Sequence[K], start: Fetch[K, V], slot: Slot) -> PendingFetch[K, V]:
        pending: PendingFetch[K, V] = PendingFetch(keys)
        pending.task = asyncio.get_running_loop().create_task(self._run(pending, start, slot))
        self._tasks.add(pending.task)
        pending.task.add_done_callback(self._tasks.discard)
        self._under_way.update(dict.fromkeys(keys, pending))
        return pending

    async def _run(self, pending: PendingFetch[K, V], start: Fetch[K, V], slot: Slot) -> Mapping[K, V]:
        answers: Mapping[K, V] = {}
        try:
            async with slot:
                pending.started = next(self._turns)
                answers = await start(pending.keys)
            return answers
        finally:
            self._settle(pending, answers)

    def _settle(self, pending: PendingFetch[K, V], answers: Mapping[K, V]) -> None:
        """Cache the values, except those invalidated meanwhile."""
        until = asyncio.get_running_loop().time() + self._freshness
        for key in pending.keys:
            if self._under_way.get(key) is pending:
                del self._under_way[key]
                if key in answers and self._freshness > 0:
                    self._kept.pop(key, None)
                    self._kept[key] = CacheEntry(answers[key], pending.started, until)
        while len(self._kept) > _MAX_ENTRIES:
            del self._kept[next(iter(self._kept))]
