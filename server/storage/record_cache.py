"""Records that were looked at lately, up to a weight; the longest unused go first."""

from __future__ import annotations

from collections import OrderedDict

from rosld.server.storage.record import Record

MAX_WEIGHT = 64 * 1024 * 1024
_EACH = 1024
"""About what a record takes beside its triples, in bytes."""


class RecordCache:
    """Cache of records by path: the same objects come back, until they are dropped or evicted."""

    __slots__ = ("_kept", "_limit", "_weight")

    def __init__(self, limit: int = MAX_WEIGHT) -> None:
        self._kept: OrderedDict[str, Record] = OrderedDict()
        self._limit = limit
        self._weight = 0

    def get(self, path: str) -> Record | None:
        """A record that is kept, None for one that is not."""
        kept = self._kept
        found = kept.get(path)
        if found is not None:
            kept.move_to_end(path)
        return found

    def put(self, record: Record) -> None:
        """Keep this one from now on."""
        self.drop(record.path)
        self._kept[record.path] = record
        self._weight += _EACH + len(record.triples)
        while self._weight > self._limit:
            self._weight -= _EACH + len(self._kept.popitem(last=False)[1].triples)

    def drop(self, path: str) -> None:
        """Forget one."""
        old = self._kept.pop(path, None)
        if old is not None:
            self._weight -= _EACH + len(old.triples)

    def clear(self) -> None:
        """Forget all."""
        self._kept.clear()
        self._weight = 0
