"""Storage of faults, limited in number: the oldest healed ones are removed first."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence

from msgspec.structs import replace

from rosld.adapters.model import Ref
from rosld.ontology.describe_faults import Fault, FaultKey, FaultKind, FaultState, Severity, source_url
from rosld.ontology.urls import Space
from rosld.server.http.problem import one_line
from rosld.server.receipts.audit import record_step
from rosld.server.robot.limited_store import LimitedStore
from rosld.server.runtime.dry_run import end_dry_run
from rosld.server.runtime.tasks import loop_time

MAX_FAULTS = 1000
"""Maximum number of faults under /faults/."""
_MAX_PATTERN = 120
_NUMBER = re.compile(r"0x[0-9a-fA-F]+|\d+(?:\.\d+)?")


def pattern_of(words: str) -> str:
    """Return text without its numbers, and truncated: the same for messages that differ only in these."""
    return " ".join(_NUMBER.sub("#", words).split())[:_MAX_PATTERN]


class Faults(LimitedStore[Fault]):
    """The faults of one robot."""

    word = "fault"

    def __init__(self, limit: int = MAX_FAULTS) -> None:
        super().__init__(limit)

    def may_go(self, one: Fault) -> bool:
        return one.is_healed

    def all(self) -> Sequence[Fault]:
        """Return the stored faults: those that last first, the latest first."""
        return sorted(self._stored.values(), key=lambda fault: (fault.is_healed, -fault.last_ns))

    def about(self, id: str, space: Space) -> Sequence[str] | None:
        """Return the URLs of the source and the topic of a fault, none of a removed one, None of an unknown one.

        Thread-safe.
        """
        fault = self._stored.get(id)
        if fault is None:
            return () if id in self._removed else None
        topics = () if fault.key.topic is None else (space.topic(fault.key.topic),)
        return (source_url(fault.key, space), *topics)

    def lasting(self, kind: FaultKind, source: Ref | None = None) -> Sequence[Fault]:
        """Return the faults of a kind that are not healed, of one source or of all."""
        return [
            fault
            for fault in self._stored.values()
            if fault.key.kind is kind and fault.key.source == (source or fault.key.source) and not fault.is_healed
        ]

    def report(
        self, key: FaultKey, severity: Severity, words: str, time_ns: int, activity: tuple[str, str] | None = None
    ) -> None:
        """Report an event or a state; a state whose words differ only in numbers is unchanged.

        `activity` is the path of the goal or the call that failed.
        """
        known, words = self._stored.get(key.id), one_line(words) or key.label
        if known is None:
            self.keep(Fault(key, severity, words, time_ns, time_ns, loop_time(), activity=activity))
            return
        changed = replace(known, severity=severity, words=words)
        if known.is_healed or not key.kind.lasts:
            state, last_ns = FaultState.ACTIVE if known.is_healed else known.state, max(known.last_ns, time_ns)
            times = replace(changed, last_ns=last_ns, heard_at=loop_time(), healed_ns=None)
            self.keep(replace(times, count=known.count + 1, activity=activity, state=state))
        elif known.severity is not severity or pattern_of(known.words) != pattern_of(words):
            self.keep(changed)

    def heal(self, key: FaultKey, time_ns: int | None = None) -> None:
        """Report that the robot is as before, if there is such a fault; now, if no time is given."""
        known = self._stored.get(key.id)
        if known is not None and not known.is_healed:
            healed_ns = max(known.last_ns, time.time_ns() if time_ns is None else time_ns)
            self.keep(replace(known, state=FaultState.HEALED, healed_ns=healed_ns))

    def acknowledge(self, id: str) -> None:
        """Acknowledge a fault; raises as `find`."""
        fault = self.find(id)
        record_step(f"acknowledge the fault {id}")
        end_dry_run(204)
        if fault.state is FaultState.ACTIVE:
            self.keep(replace(fault, state=FaultState.ACKNOWLEDGED))

    def keep(self, one: Fault) -> None:
        self._removed.pop(one.id, None)
        super().keep(one)
        self._stored.move_to_end(one.id)
