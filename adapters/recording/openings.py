"""Messages that open a recording: what was latched before it begins. Files and parts of one recording tell it anew."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rosld.adapters.model import TypeRef
from rosld.adapters.model.sample import latched_depth
from rosld.adapters.recording.storage import MessageTable, RecordedConnection


def without_repeats(table: MessageTable, connections: Sequence[RecordedConnection]) -> MessageTable:
    """Leave out what opens a file where the same publisher's messages lie before: that file is not the first one."""
    is_opening = np.asarray([each.is_opening for each in connections], bool)
    if not is_opening.any():
        return table
    order = np.arange(len(table.times))[::-1]
    first = np.full(len(connections), -1)
    first[table.connections[order]] = order  # of several rows of a connection the last one that is set stays
    earliest: dict[tuple[str, str], int] = {}
    for one, row in zip(connections, first.tolist(), strict=True):
        if row >= 0:
            key, time = (one.topic, one.publisher), int(table.times[row])
            earliest[key] = min(earliest.get(key, time), time)
    known = np.asarray([earliest.get((one.topic, one.publisher), 0) for one in connections], np.int64)
    is_repeat = is_opening[table.connections] & (table.times > known[table.connections])
    return table.rows(~is_repeat)


def latched_rows(
    table: MessageTable, until: int, connections: Sequence[RecordedConnection], types: Sequence[TypeRef]
) -> NDArray[np.int64]:
    """The rows before row `until` that hold the latest latched messages of each publisher, ascending."""
    latched = [number for number, one in enumerate(connections) if one.latched]
    rows = np.flatnonzero(np.isin(table.connections[:until], latched))
    found: dict[tuple[str, str], deque[int]] = {}
    for row, number in zip(rows.tolist(), table.connections[rows].tolist(), strict=True):
        one = connections[number]
        found.setdefault((one.topic, one.publisher), deque(maxlen=latched_depth(types[number].name))).append(row)
    return np.sort(np.asarray([row for each in found.values() for row in each], np.int64))
