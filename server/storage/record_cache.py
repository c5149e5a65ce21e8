"""Caches of records: recently read records, and the differences of recent writes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

from msgspec.structs import replace

from rosld.server.storage.record import Difference, Put, Record

MAX_WEIGHT = 64 * 1024 * 1024
_EACH = 1024
"""Approximate bytes of a record without its triples."""


class RecordCache:
    """Cache of records by path, which returns the same object until it is dropped or evicted."""

    __slots__ = ("_limit", "_records", "_weight")

    def __init__(self, limit: int = MAX_WEIGHT) -> None:
        self._records: OrderedDict[str, Record] = OrderedDict()
        self._limit = limit
        self._weight = 0

    def get(self, path: str) -> Record | None:
        """Return a cached record, or None."""
        records = self._records
        found = records.get(path)
        if found is not None:
            records.move_to_end(path)
        return found

    def peek(self, path: str) -> Record | None:
        """Return a cached record, or None, from any thread; does not defer its eviction."""
        return self._records.get(path)

    def put(self, record: Record) -> None:
        """Add a record, and evict the least recently used ones above the limit."""
        self.drop(record.path)
        self._records[record.path] = record
        self._weight += _EACH + len(record.triples)
        while self._weight > self._limit:
            self._weight -= _EACH + len(self._records.popitem(last=False)[1].triples)

    def drop(self, path: str) -> None:
        """Remove a record."""
        old = self._records.pop(path, None)
        if old is not None:
            self._weight -= _EACH + len(old.triples)

    def clear(self) -> None:
        """Remove all records."""
        self._records.clear()
        self._weight = 0


MAX_BYTES = 16 * 1024
"""Maximum bytes of N-Triples in the difference of one write; larger differences are not stored."""
_WRITES = 64
"""Maximum number of writes per record, and of records, whose differences are stored."""


class RecordWrite(NamedTuple):
    """One write of a record: the record before and after (client statements reduced to times), and the difference."""

    before: Record
    after: Record
    difference: Difference


class RecentWrites:
    """Differences of the latest writes, by record."""

    def __init__(self) -> None:
        self._steps: OrderedDict[str, list[RecordWrite]] = OrderedDict()

    def add(self, put: Put, record: Record) -> None:
        """Add the difference of a write that produced this record."""
        difference = put.difference
        if difference is None or put.expected != difference.before.version:
            self._steps.pop(record.path, None)
            return
        before, after = (replace(each, triples=difference.times) for each in (difference.before, record))
        steps = self._steps.setdefault(record.path, [])
        if steps and steps[-1].after.version != before.version:
            steps.clear()
        steps.append(RecordWrite(before, after, difference))
        del steps[:-_WRITES]
        self._steps.move_to_end(record.path)
        if len(self._steps) > _WRITES:
            self._steps.popitem(last=False)

    def since(self, record: Record, after: int) -> Sequence[RecordWrite] | None:
        """Return the writes that led from a version to this record, or None if they are unknown."""
        steps = [each for each in self._steps.get(record.path, ()) if each.after.version > after]
        if not steps or steps[0].before.version > after or steps[-1].after.version != record.version:
            return None
        return steps

    def clear(self) -> None:
        """Remove all differences."""
        self._steps.clear()
