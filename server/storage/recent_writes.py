"""What the last writes changed of large records: so that a few triples of a million are told as a few triples."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from rosld.server.storage.record import Difference, Put, Record

MAX_BYTES = 16 * 1024
"""Bytes of N-Triples in the difference of one write; what changes more is told whole."""
_WRITES = 64
"""Writes of one record, and records, whose differences are kept: the oldest go first."""


class RecordWrite(NamedTuple):
    """One write of a record: what it was before and after, of what clients say only its times, and what changed."""

    before: Record
    after: Record
    difference: Difference


class RecentWrites:
    """The differences of the last writes, by record."""

    def __init__(self) -> None:
        self._steps: OrderedDict[str, list[RecordWrite]] = OrderedDict()

    def add(self, put: Put, record: Record) -> None:
        """This write has made this record."""
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
        """The writes that made a record what it is from what it was at a version; None where they are not known."""
        steps = [each for each in self._steps.get(record.path, ()) if each.after.version > after]
        if not steps or steps[0].before.version > after or steps[-1].after.version != record.version:
            return None
        return steps

    def clear(self) -> None:
        """Know of no writes."""
        self._steps.clear()
