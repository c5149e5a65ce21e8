"""Storage of faults, limited in number: the oldest healed ones are removed first."""

from __future__ import annotations

import re
import time
from collections import OrderedDict
from collections.abc import Sequence

from msgspec.structs import replace

from rosld.ontology.describe_faults import Fault, FaultKey, FaultState, Severity
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
        return sorted(self._faults.values(), key=lambda fault: (fault.state is FaultState.HEALED, -fault.last_ns))

    def find(self, id: str) -> Fault:
        """Return a fault by its id. Raises Gone for a removed fault, KeyError for an unknown one."""
        if id in self._removed:
            raise Gone(id)
        return self._faults[id]

    def key_of(self, id: str) -> FaultKey | None:
        """Return the key of a stored fault, or None (thread-safe)."""
        fault = self._faults.get(id)
        return None if fault is None else fault.key

    def is_removed(self, id: str) -> bool:
        """Whether a fault was removed (thread-safe)."""
        return id in self._removed

    def lasting(self) -> Sequence[Fault]:
        """Return the faults that are not healed, in the order of their last change."""
        return [fault for fault in self._faults.values() if fault.state is not FaultState.HEALED]

    def reached(self, key: FaultKey, severity: Severity, words: str, time_ns: int) -> None:
        """Report a state that lasts: it counts again only after it was healed. Numbers in its words may change."""
        words = one_line(words) or key.label
        known = self._faults.get(key.id)
        if known is None or known.state is FaultState.HEALED:
            self._occurred(known, key, severity, words, time_ns, None)
        elif known.severity is not severity or pattern_of(known.words) != pattern_of(words):
            self._store(replace(known, severity=severity, words=words))

    def occurred(
        self, key: FaultKey, severity: Severity, words: str, time_ns: int, activity: tuple[str, str] | None = None
    ) -> None:
        """Report an event, which counts each time; `activity` is the path of the goal or the call that failed."""
        self._occurred(self._faults.get(key.id), key, severity, one_line(words) or key.label, time_ns, activity)

    def heal(self, key: FaultKey, time_ns: int | None = None) -> None:
        """Report that the robot is as before, if there is such a fault; now, if no time is given."""
        known = self._faults.get(key.id)
        if known is not None and known.state is not FaultState.HEALED:
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

    def _occurred(
        self,
        known: Fault | None,
        key: FaultKey,
        severity: Severity,
        words: str,
        time_ns: int,
        activity: tuple[str, str] | None,
    ) -> None:
        if known is None:
            self._store(Fault(key, severity, words, time_ns, time_ns, loop_time(), activity=activity))
            return
        is_healed = known.state is FaultState.HEALED
        changed = replace(
            known,
            severity=severity,
            words=words,
            last_ns=max(known.last_ns, time_ns),
            heard_at=loop_time(),
            count=known.count + 1,
            activity=activity,
            state=FaultState.ACTIVE if is_healed else known.state,
            healed_ns=None,
        )
        self._store(changed)

    def _store(self, fault: Fault) -> None:
        self._faults[fault.id] = fault
        self._faults.move_to_end(fault.id)
        self._removed.pop(fault.id, None)
        self._revise(fault.id)
        while len(self._faults) > self._limit:
            healed = (each.id for each in self._faults.values() if each.state is FaultState.HEALED)
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
