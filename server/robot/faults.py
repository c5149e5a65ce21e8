"""Storage of faults, limited in number: the oldest healed ones are removed first."""

from __future__ import annotations

import re
import time
from collections import OrderedDict
from collections.abc import Sequence

from msgspec.structs import replace

from rosld.adapters.model import Ref
from rosld.ontology.describe_faults import Fault, FaultKey, FaultKind, FaultState, Severity, source_url
from rosld.ontology.urls import Space
from rosld.server.http.problem import one_line
from rosld.server.receipts.audit import record_step
from rosld.server.robot.calls import Gone
from rosld.server.runtime.dry_run import end_dry_run
from rosld.server.runtime.tasks import Signal, loop_time

MAX_FAULTS = 1000
"""Maximum number of faults under /faults/."""
_REMEMBERED_IDS = 10_000
_MAX_PATTERN = 120
_NUMBER = re.compile(r"0x[0-9a-fA-F]+|\d+(?:\.\d+)?")


def pattern_of(words: str) -> str:
    """Return text without its numbers, and truncated: the same for messages that differ only in these."""
    return " ".join(_NUMBER.sub("#", words).split())[:_MAX_PATTERN]


class Faults:
    """The faults of one robot. `changes` is emitted with the id of each changed one, `revision` counts the changes."""

    def __init__(self, limit: int = MAX_FAULTS) -> None:
        self._limit = limit
        self._faults: OrderedDict[str, Fault] = OrderedDict()
        self._removed: OrderedDict[str, None] = OrderedDict()
        self.revision = 0
        self.changes = Signal()

    def all(self) -> Sequence[Fault]:
        """Return the stored faults: those that last first, the latest first."""
        return sorted(self._faults.values(), key=lambda fault: (fault.is_healed, -fault.last_ns))

    def find(self, id: str) -> Fault:
        """Return a fault by its id. Raises Gone for a removed fault, KeyError for an unknown one."""
        if id in self._removed:
            raise Gone(id)
        return self._faults[id]

    def about(self, id: str, space: Space) -> Sequence[str] | None:
        """Return the URLs of the source and the topic of a fault, none of a removed one, None of an unknown one.

        Thread-safe.
        """
        fault = self._faults.get(id)
        if fault is None:
            return () if id in self._removed else None
        topics = () if fault.key.topic is None else (space.topic(fault.key.topic),)
        return (source_url(fault.key, space), *topics)

    def lasting(self, kind: FaultKind, source: Ref | None = None) -> Sequence[Fault]:
        """Return the faults of a kind that are not healed, of one source or of all."""
        return [
            fault
            for fault in self._faults.values()
            if fault.key.kind is kind and fault.key.source == (source or fault.key.source) and not fault.is_healed
        ]

    def report(
        self, key: FaultKey, severity: Severity, words: str, time_ns: int, activity: tuple[str, str] | None = None
    ) -> None:
        """Report an event or a state; a state whose words differ only in numbers is unchanged.

        `activity` is the path of the goal or the call that failed.
        """
        known, words = self._faults.get(key.id), one_line(words) or key.label
        if known is None:
            self._store(Fault(key, severity, words, time_ns, time_ns, loop_time(), activity=activity))
            return
        changed = replace(known, severity=severity, words=words)
        if known.is_healed or not key.kind.lasts:
            state, last_ns = FaultState.ACTIVE if known.is_healed else known.state, max(known.last_ns, time_ns)
            times = replace(changed, last_ns=last_ns, heard_at=loop_time(), healed_ns=None)
            self._store(replace(times, count=known.count + 1, activity=activity, state=state))
        elif known.severity is not severity or pattern_of(known.words) != pattern_of(words):
            self._store(changed)

    def heal(self, key: FaultKey, time_ns: int | None = None) -> None:
        """Report that the robot is as before, if there is such a fault; now, if no time is given."""
        known = self._faults.get(key.id)
        if known is not None and not known.is_healed:
            healed_ns = max(known.last_ns, time.time_ns() if time_ns is None else time_ns)
            self._store(replace(known, state=FaultState.HEALED, healed_ns=healed_ns))

    def acknowledge(self, id: str) -> None:
        """Acknowledge a fault; raises as `find`."""
        fault = self.find(id)
        record_step(f"acknowledge the fault {id}")
        end_dry_run(204)
        if fault.state is FaultState.ACTIVE:
            self._store(replace(fault, state=FaultState.ACKNOWLEDGED))

    def delete(self, id: str) -> None:
        """Remove a fault; raises as `find`."""
        record_step(f"forget the fault {self.find(id).id}")
        end_dry_run(204)
        self._drop(id)

    def _store(self, fault: Fault) -> None:
        self._faults[fault.id] = fault
        self._faults.move_to_end(fault.id)
        self._removed.pop(fault.id, None)
        self._revise(fault.id)
        while len(self._faults) > self._limit:
            healed = (each.id for each in self._faults.values() if each.is_healed)
            self._drop(next(healed, None) or next(iter(self._faults)))

    def _drop(self, id: str) -> None:
        self._faults.pop(id)
        self._removed[id] = None
        while len(self._removed) > _REMEMBERED_IDS:
            self._removed.popitem(last=False)
        self._revise(id)

    def _revise(self, id: str) -> None:
        self.revision += 1
        self.changes.emit(id)
