"""Workers: a bounded number of threads that answer queries, off the loop, and a bounded queue for them.

They are daemons, because an evaluation cannot be stopped: the server must be able to end while one runs on.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from typing import TypeAlias

from rosld.server.sparql.limits import busy

Job: TypeAlias = Callable[[], None]


class Workers:
    """`count` threads, and a queue of at most `waiting` jobs for them."""

    def __init__(self, count: int = 4, waiting: int = 256) -> None:
        self._count = count
        self._waiting = waiting
        self._started = False
        self._busy = 0
        self._jobs: deque[Job] = deque()
        self._changed = threading.Condition()

    def submit(self, job: Job) -> None:
        """Run the job in a thread as soon as one is free; it must not raise.

        Raises Problem 503 where too many wait already.
        """
        with self._changed:
            if len(self._jobs) >= self._waiting + self._count - self._busy:
                raise busy()
            if not self._started:
                self._started = True
                for number in range(self._count):
                    threading.Thread(target=self._work, name=f"sparql-{number}", daemon=True).start()
            self._jobs.append(job)
            self._changed.notify()

    @property
    def occupied(self) -> bool:
        """Whether no thread is free."""
        return self._busy >= self._count

    def withdraw(self, job: Job) -> bool:
        """Give up the place of a job that still waits; whether it did."""
        with self._changed:
            try:
                self._jobs.remove(job)
            except ValueError:
                return False
            return True

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._jobs:
                    self._changed.wait()
                job = self._jobs.popleft()
                self._busy += 1
            job()
            del job
            with self._changed:
                self._busy -= 1


def call_soon(loop: asyncio.AbstractEventLoop, function: Callable[..., object], *arguments: object) -> None:
    """Call a function on the loop from a worker; nothing happens where the loop has ended meanwhile."""
    try:
        loop.call_soon_threadsafe(function, *arguments)
    except RuntimeError:
        if not loop.is_closed():
            raise
