"""Group commit: writes that come while the disk is at work wait, and are then done together in one transaction.

So a hundred writers wait for the disk once, not a hundred times, and nothing is written to the log while it is synced,
which would hold up the loop.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence

from rosld.server.records.durability import Durability
from rosld.server.records.ledger import Applied, Busy
from rosld.server.records.record import Conflict, Put, Write

MOST = 128
"""Jobs in one transaction, which the loop does at a stretch."""
BYTES = 4 * 1024 * 1024
"""Bytes in one transaction, beyond its first job."""
_BUSY_SECONDS = 0.005


class Job:
    """Writes that belong together, and the ids of the received blobs they refer to."""

    __slots__ = ("done", "received", "size", "writes")

    def __init__(self, writes: Sequence[Write], received: Sequence[str]) -> None:
        self.writes = writes
        self.received = received
        self.size = sum(len(write.triples) for write in writes if isinstance(write, Put))
        self.done: asyncio.Future[Applied] | None = None


class Group:
    """Belongs to one loop. `transact` does jobs in one transaction, and says what came of each.

    It raises Busy where another process writes, and anything else with nothing done.
    """

    def __init__(
        self, transact: Callable[[Sequence[Job]], Sequence[Applied | Conflict]], durability: Durability
    ) -> None:
        self._transact = transact
        self._durability = durability
        self._jobs: deque[Job] = deque()
        self._idle = asyncio.Event()
        self._idle.set()

    async def do(self, job: Job) -> Applied:
        """Do a job and wait until it is durable. It is done even if nobody waits any more."""
        loop = asyncio.get_running_loop()
        job.done = loop.create_future()
        self._jobs.append(job)
        if self._idle.is_set():
            self._idle.clear()
            loop.call_soon(self._go_on)  # together with others that come at once
        return await job.done

    async def idle(self) -> None:
        """Wait until every job is done."""
        await self._idle.wait()

    def _go_on(self) -> None:
        """Do the jobs that wait, then wait for the disk."""
        loop = asyncio.get_running_loop()
        jobs = self._some()
        if not jobs:
            self._idle.set()
            return
        freed, written = list[str](), list[tuple[Job, Applied]]()
        for job, outcome in zip(jobs, self._outcomes(jobs), strict=True):
            if isinstance(outcome, Applied):
                freed += outcome.freed
                written.append((job, outcome))
            elif isinstance(outcome, Busy):
                self._jobs.append(job)
            else:
                _settle(job, outcome)
        if not written:
            loop.call_later(_BUSY_SECONDS if self._jobs else 0, self._go_on)
            return

        def reached(future: asyncio.Future[None]) -> None:
            error = future.exception()
            for job, applied in written:
                _settle(job, applied if error is None else error)
            self._go_on()

        self._durability.reached(freed).add_done_callback(reached)

    def _some(self) -> list[Job]:
        jobs, size = list[Job](), 0
        while self._jobs and len(jobs) < MOST and size < BYTES:
            jobs.append(self._jobs.popleft())
            size += jobs[-1].size
        return jobs

    def _outcomes(self, jobs: Sequence[Job]) -> Sequence[Applied | Exception]:
        """What came of each job. Where the transaction fails each is tried alone: one is too large for the disk."""
        try:
            return self._transact(jobs)
        except Exception as error:
            if len(jobs) == 1 or isinstance(error, Busy):
                return [error] * len(jobs)
        return [self._outcomes((job,))[0] for job in jobs]


def _settle(job: Job, outcome: Applied | BaseException) -> None:
    """Tell whoever waits for the job, if somebody still does."""
    if job.done is None or job.done.done():
        return
    if isinstance(outcome, Applied):
        job.done.set_result(outcome)
    else:
        job.done.set_exception(outcome)
