"""Transactions: their effects, and the group commit of writes that wait."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from rosld.server.storage.record import Conflict, DatabaseBusy, Put, Record, RecordChange, StorageError, Write


class MemberList(NamedTuple):
    """The list of a container's members after a write: its version, when it was modified (ns), how many there are."""

    version: int
    modified: int
    members: int


class Effects:
    """The effects of the writes of a transaction so far."""

    __slots__ = ("freed", "lists", "records", "removed", "unused")

    def __init__(self, received: Sequence[str] = ()) -> None:
        self.records: dict[str, Record] = {}
        """The records that were written, as they are now."""
        self.removed: dict[str, int] = {}
        """The version at which a path was removed."""
        self.lists: dict[str, MemberList] = {}
        """The lists that changed, of containers that are there."""
        self.freed: list[str] = []
        """The blobs that nothing refers to any more."""
        self.unused = set(received)
        """The blobs that were received and wait for their record."""

    def changes(self) -> list[RecordChange]:
        """Return each path once, with its latest version, in the order of versions."""
        found = {path: listed.version for path, listed in self.lists.items()}
        for path, record in self.records.items():
            found[path] = max(record.version, found.get(path, 0))
        changed = [RecordChange(path, version, False) for path, version in found.items()]
        changed += [RecordChange(path, version, True) for path, version in self.removed.items()]
        return sorted(changed, key=version_of_change)


def with_list(record: Record, listed: MemberList) -> Record:
    """Return the record of a container after its list has changed."""
    return Record(
        record.path,
        record.model,
        record.version,
        record.created_ns,
        max(record.modified_ns, listed.modified),
        record.triples,
        record.blob,
        record.membership,
        record.member,
        listed.version,
        listed.members,
    )


def version_of_change(changed: RecordChange) -> int:
    """Return the version that changes are ordered by."""
    return changed.version


MAX_BATCHES = 128
"""Jobs in one transaction, which the loop does at a stretch."""
MAX_BYTES = 4 * 1024 * 1024
"""Bytes in one transaction, beyond its first job."""
_BUSY_SECONDS = 0.005


class WriteBatch:
    """Writes that belong together, and the ids of the received blobs they refer to."""

    __slots__ = ("done", "received", "size", "writes")

    def __init__(self, writes: Sequence[Write], received: Sequence[str]) -> None:
        self.writes = writes
        self.received = received
        self.size = sum(len(write.triples) for write in writes if isinstance(write, Put))
        self.done: asyncio.Future[Effects] | None = None


class BatchStorage(Protocol):
    """The storage that carries out batches of writes."""

    def transact(self, jobs: Sequence[WriteBatch]) -> Sequence[Effects | Conflict]:
        """Do jobs in one transaction: what came of each.

        Raises DatabaseBusy where another process writes, and anything else with nothing done.
        """
        ...

    async def wait_durable(self, applied: Sequence[Effects]) -> None:
        """Wait until what was done is durable. Raises StorageError where it is not, and was undone if possible."""
        ...

    async def recover(self) -> None:
        """See to it that writes can be made durable. Raises StorageError where they cannot."""
        ...

    async def free_space(self, job: WriteBatch) -> None:
        """Make what room there can be for a job that found the disk full."""
        ...


class GroupCommit:
    """Commits batches of writes, those that wait together in one transaction. Belongs to one loop."""

    def __init__(self, storage: BatchStorage) -> None:
        self._storage = storage
        self._jobs: deque[WriteBatch] = deque()
        self._idle = asyncio.Event()
        self._idle.set()
        self._work: asyncio.Task[None] | None = None

    async def commit(self, job: WriteBatch) -> Effects:
        """Do a job and wait until it is durable. Cancelling the wait does not cancel the job."""
        loop = asyncio.get_running_loop()
        job.done = loop.create_future()
        self._jobs.append(job)
        if self._idle.is_set():
            self._idle.clear()
            self._work = loop.create_task(self._do_all())  # begins together with others that come at once
        return await job.done

    def recover(self) -> None:
        """Recover from a failure, if there was one, without a write."""
        if self._idle.is_set():
            self._idle.clear()
            self._work = asyncio.get_running_loop().create_task(self._do_all())

    async def wait_idle(self) -> None:
        """Wait until every job is done."""
        await self._idle.wait()

    async def _do_all(self) -> None:
        """Do the jobs that wait, and those that come meanwhile."""
        try:
            while True:
                try:
                    await self._storage.recover()
                except Exception as error:
                    while self._jobs:
                        _settle(self._jobs.popleft(), error)
                if not self._jobs:
                    return
                await self._round(self._some())
        finally:
            self._idle.set()

    async def _round(self, jobs: Sequence[WriteBatch]) -> None:
        """Do jobs, then wait for the disk."""
        written, short, busy = list[tuple[WriteBatch, Effects]](), list[WriteBatch](), list[WriteBatch]()
        for job, outcome in zip(jobs, self._outcomes(jobs), strict=True):
            if isinstance(outcome, Effects):
                written.append((job, outcome))
            elif isinstance(outcome, DatabaseBusy):
                busy.append(job)
            elif isinstance(outcome, StorageError) and outcome.full:
                short.append(job)
            else:
                _settle(job, outcome)
        self._jobs.extend(busy)
        await self._reach(written)
        for job in short:
            await self._in_new_room(job)
        if busy and not written:
            await asyncio.sleep(_BUSY_SECONDS)

    async def _in_new_room(self, job: WriteBatch) -> None:
        """Try once more what found the disk full."""
        try:
            await self._storage.recover()
        except StorageError as error:
            _settle(job, error)
            return
        await self._storage.free_space(job)
        outcome = self._outcomes((job,))[0]
        if isinstance(outcome, Effects):
            await self._reach([(job, outcome)])
        elif isinstance(outcome, DatabaseBusy):
            self._jobs.append(job)
        else:
            _settle(job, outcome)

    async def _reach(self, written: Sequence[tuple[WriteBatch, Effects]]) -> None:
        if not written:
            return
        error: StorageError | None = None
        try:
            await self._storage.wait_durable([applied for _, applied in written])
        except StorageError as failed:
            error = failed
        for job, applied in written:
            _settle(job, applied if error is None else error)

    def _some(self) -> list[WriteBatch]:
        jobs, size = list[WriteBatch](), 0
        while self._jobs and len(jobs) < MAX_BATCHES and size < MAX_BYTES:
            jobs.append(self._jobs.popleft())
            size += jobs[-1].size
        return jobs

    def _outcomes(self, jobs: Sequence[WriteBatch]) -> Sequence[Effects | Exception]:
        """The outcome of each job. If the transaction fails, each is tried alone: one may be too large for the disk."""
        try:
            return self._storage.transact(jobs)
        except Exception as error:
            if len(jobs) == 1 or isinstance(error, DatabaseBusy):
                return [error] * len(jobs)
        return [self._outcomes((job,))[0] for job in jobs]


def _settle(job: WriteBatch, outcome: Effects | BaseException) -> None:
    """Set the result of a job unless its waiter has gone."""
    if job.done is None or job.done.done():
        return
    if isinstance(outcome, Effects):
        job.done.set_result(outcome)
    else:
        job.done.set_exception(outcome)
