"""The effects of the writes of one transaction on records, which are announced once it is committed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from rosld.server.storage.record import Record, RecordChange


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
        """Each path once, with its latest version, in the order of versions."""
        found = {path: listed.version for path, listed in self.lists.items()}
        for path, record in self.records.items():
            found[path] = max(record.version, found.get(path, 0))
        changed = [RecordChange(path, version, False) for path, version in found.items()]
        changed += [RecordChange(path, version, True) for path, version in self.removed.items()]
        return sorted(changed, key=version_of_change)


def with_list(record: Record, listed: MemberList) -> Record:
    """The record of a container after its list has changed."""
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
    """The version that changes are ordered by."""
    return changed.version
