"""The contract of records: `SqliteRecords` keeps it, in memory or in a folder."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path
from typing import Protocol

from rosld.server.storage.recent_writes import RecordWrite
from rosld.server.storage.record import Blob, Member, Record, RecordChange, Write
from rosld.server.storage.version_table import FormerVersion


class Records(Protocol):
    """All records of one server. Belongs to one loop; reading is quick (tens of microseconds) and never waits.

    Whatever reads or writes raises StorageError where the disk or the database fails, and can be asked again.
    """

    @property
    def identity(self) -> str:
        """A random name of these records, made once and kept with them: versions are only of one identity."""
        ...

    @property
    def failure(self) -> str | None:
        """Why not everything can be kept just now, in a sentence for people; None where it can."""
        ...

    @property
    def version(self) -> int:
        """The number of the last change; it rises with each, by more than one where a container lists anew."""
        ...

    def get(self, path: str) -> Record | None:
        """A record. The very same object comes back while nothing of it changes (and it is asked for now and then)."""
        ...

    def versions(self, path: str) -> Sequence[FormerVersion]:
        """The former versions of a document that are kept, the oldest first."""
        ...

    def version_at(self, path: str, time_ns: int) -> Record | None:
        """The former version of a document that was there at a time; None where there was none, or it is not kept."""
        ...

    def is_tombstone(self, path: str) -> bool:
        """Whether a record of this path was ever removed; one may be there again."""
        ...

    def members(self, path: str, *, after: int = 0, limit: int = 1000) -> Sequence[Member]:
        """The members of a container in the order of their numbers, those after one of them."""
        ...

    def last_member_numbers(self, path: str, *, up_to: int | None = None, limit: int = 1000) -> Sequence[int]:
        """The numbers of the last members of a container, the newest first: of all, or of those up to a number."""
        ...

    def changes_since(self, after: int, *, limit: int = 10_000) -> Sequence[RecordChange]:
        """What has changed after a version, each path with its latest version, in the order of versions.

        A path comes once, but twice where it was removed and made again. No two changes have one version: after as
        many as `limit`, ask again after the last.
        """
        ...

    def writes_since(self, record: Record, after: int) -> Sequence[RecordWrite] | None:
        """The writes that made a record what it is from what it was at a version; None where they are not known."""
        ...

    async def write(self, *writes: Write) -> Sequence[Record | None]:
        """Do these writes, all or none, and durably where a folder is kept: when it returns, a crash loses nothing.

        The records as they are then, None for what was removed. Raises Conflict; ValueError for a write that makes no
        sense whatever is there. They are done even if nobody waits for the end any more.
        """
        ...

    async def receive(self, chunks: AsyncIterator[bytes], media_type: str, *, limit: int) -> Blob:
        """Keep bytes as they come, until a write refers to them. Raises ValueError beyond `limit` bytes.

        What no write refers to within ten minutes is thrown away; what was refused in a write may be tried in another.
        """
        ...

    def discard(self, blob: Blob) -> None:
        """Throw away received bytes that no write refers to; of other blobs it leaves everything as it is."""
        ...

    def file(self, blob: Blob) -> Path:
        """The file that holds a blob. Raises FileNotFoundError for one that is no more."""
        ...

    def watch(self, wake: Callable[[Sequence[RecordChange]], None]) -> Callable[[], None]:
        """Call `wake` on the loop after each write with what it changed; the function that ends it.

        Changes by `rosld load` are told too, within a second.
        """
        ...

    async def close(self) -> None:
        """Finish what is under way. Idempotent."""
        ...
