"""Effects of transactions, and group commit of waiting writes."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from typing import NamedTuple, TypeAlias

from rosld.server.storage.record import Conflict, Put, Record, RecordChange, Write


class MemberList(NamedTuple):
    """The list of a container's members after a write: its version, its modification time (ns), and its length."""

    version: int
    modified: int
    members: int


class Effects:
    """The effects of the writes of a transaction so far."""

    __slots__ = ("freed", "lists", "records", "removed", "unused")

    def __init__(self, received: Sequence[str] = ()) -> None:
        self.records: dict[str, Record] = {}
        """Written records in their new state, by path."""
        self.removed: dict[str, int] = {}
        """Version of the removal, by path."""
        self.lists: dict[str, MemberList] = {}
        """Changed lists of existing containers, by path."""
        self.freed: list[str] = []
        """Ids of the blobs that are no longer referenced."""
        self.unused = set(received)
        """Ids of received blobs that no record refers to yet."""

    def changes(self) -> list[RecordChange]:
        """Return each path once, with its latest version, in the order of versions."""
        versions = {path: listed.version for path, listed in self.lists.items()}
        for path, record in self.records.items():
            versions[path] = max(record.version, versions.get(path, 0))
        changed = [RecordChange(path, version, False) for path, version in versions.items()]
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
    """Return the version of a change, as a sort key."""
    return changed.version


MAX_BATCHES = 128
"""Maximum number of batches in one transaction."""
MAX_BYTES = 4 * 1024 * 1024
"""Bytes in one transaction after which no further batch is added."""


class WriteBatch:
    """Writes that belong together, and the ids of the received blobs they refer to."""

    __slots__ = ("done", "received", "size", "writes")

    def __init__(self, writes: Sequence[Write], received: Sequence[str]) -> None:
        self.writes = writes
        self.received = received
        self.size = sum(len(write.triples) for write in writes if isinstance(write, Put))
        self.done: asyncio.Future[Effects] | None = None


Transact: TypeAlias = Callable[[Sequence[WriteBatch]], Awaitable[Sequence[Effects | Conflict]]]
"""Applies batches in one durable transaction and returns their outcomes. Raises StorageError if none is applied."""


class GroupCommit:
    """Commits batches of writes; all that wait share one transaction. Belongs to one event loop."""

    def __init__(self, transact: Transact) -> None:
        self._transact = transact
        self._batches: deque[WriteBatch] = deque()
        self._idle = asyncio.Event()
        self._idle.set()
        self._work: asyncio.Task[None] | None = None

    async def commit(self, batch: WriteBatch) -> Effects:
        """Apply a batch and wait until it is durable. Cancelling the wait does not cancel the batch."""
        loop = asyncio.get_running_loop()
        batch.done = loop.create_future()
        self._batches.append(batch)
        if self._idle.is_set():
            self._idle.clear()
            self._work = loop.create_task(self._do_all())  # starts in the next iteration, with this one's other batches
        return await batch.done

    async def wait_idle(self) -> None:
        """Wait until no batch is pending."""
        await self._idle.wait()

    async def _do_all(self) -> None:
        """Commit batches until none is waiting."""
        try:
            while self._batches:
                batches = self._next_batches()
                for batch, outcome in zip(batches, await self._outcomes(batches), strict=True):
                    _settle(batch, outcome)
        finally:
            self._idle.set()

    def _next_batches(self) -> list[WriteBatch]:
        batches, size = list[WriteBatch](), 0
        while self._batches and len(batches) < MAX_BATCHES and size < MAX_BYTES:
            batches.append(self._batches.popleft())
            size += batches[-1].size
        return batches

    async def _outcomes(self, batches: Sequence[WriteBatch]) -> Sequence[Effects | Exception]:
        """Return the outcomes. After a failure, try each batch alone: one may be too large for the disk."""
        try:
            return await self._transact(batches)
        except Exception as error:
            if len(batches) == 1:
                return [error]
        return [(await self._outcomes((batch,)))[0] for batch in batches]


def _settle(batch: WriteBatch, outcome: Effects | BaseException) -> None:
    """Set the result of a batch unless the wait for it was cancelled."""
    if batch.done is None or batch.done.done():
        return
    if isinstance(outcome, Effects):
        batch.done.set_result(outcome)
    else:
        batch.done.set_exception(outcome)
