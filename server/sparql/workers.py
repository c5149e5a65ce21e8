"""Workers: a bounded number of threads that answer queries, off the loop.

They are daemons, because an evaluation cannot be stopped: the server must be able to end while one runs on.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from queue import SimpleQueue

from rosld.server.http.problem import Problem

_RETRY_AFTER = {"Retry-After": "1"}


class Workers:
    """`count` threads, and a queue of at most `waiting` jobs for them. Belongs to one loop."""

    def __init__(self, count: int = 4, waiting: int = 256) -> None:
        self._count = count
        self._waiting = waiting
        self._started = False
        self._jobs: SimpleQueue[Callable[[], None]] = SimpleQueue()

    def submit(self, job: Callable[[], None]) -> None:
        """Run the job in a thread as soon as one is free; it must not raise.

        Raises Problem 503 where too many wait already.
        """
        if self._jobs.qsize() >= self._waiting:
            raise busy()
        if not self._started:
            self._started = True
            for number in range(self._count):
                threading.Thread(target=self._work, name=f"sparql-{number}", daemon=True).start()
        self._jobs.put(job)

    def _work(self) -> None:
        while True:
            job = self._jobs.get()
            job()
            del job


def busy() -> Problem:
    """All workers are at work and enough requests wait: come again."""
    return Problem(503, "All threads for queries are busy; try again in a moment.", headers=_RETRY_AFTER)


def call_soon(loop: asyncio.AbstractEventLoop, function: Callable[..., object], *arguments: object) -> None:
    """Call a function on the loop from a worker; nothing happens where the loop has ended meanwhile."""
    try:
        loop.call_soon_threadsafe(function, *arguments)
    except RuntimeError:
        if not loop.is_closed():
            raise
