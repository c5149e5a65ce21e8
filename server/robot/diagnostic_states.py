"""Diagnostics: what the parts of a robot say of themselves, as states with words. Pure but for `LevelTimes`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, NamedTuple, cast

from rosld.adapters.model import Message

DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
STALE_SECONDS = 5.0
"""How long a part may be silent before what it said is stale, as the aggregator of ROS has it."""
_MAX_KEPT = 10_000


class Level(IntEnum):
    """The levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


SEVERITY: Mapping[Level, int] = {Level.ERROR: 3, Level.STALE: 2, Level.WARN: 1, Level.OK: 0}
"""The worst first: what is silent may hide anything."""


class KeyValue(NamedTuple):
    """A value that a part reports about itself."""

    key: str
    value: str


@dataclass(frozen=True, slots=True)
class DiagnosticState:
    """The latest state of a part: its topic, name, hardware, and the time since it has this level.

    `said` is the reported level, `level` the effective one: a part that is silent becomes stale.
    """

    topic: str
    name: str
    hardware: str
    said: Level
    message: str
    values: tuple[KeyValue, ...]
    received_ns: int
    level: Level = Level.OK
    since_ns: int = 0


class LevelChange(NamedTuple):
    """A moment at which a part came to another level, or said something else, with what it said then."""

    time_ns: int
    level: Level
    message: str


def read_states(topic: str, message: Message, times: Mapping[str, int], received_ns: int) -> list[DiagnosticState]:
    """The states of a DiagnosticArray; `times` tells when each name was heard where they were not heard together."""
    found = []
    for each in cast("Iterable[Any]", getattr(message, "status", ())):
        name, level = str(each.name), _level(each.level)
        values = tuple(KeyValue(str(pair.key), str(pair.value)) for pair in each.values)
        heard = times.get(each.name, received_ns)
        state = DiagnosticState(topic, name, str(each.hardware_id), level, str(each.message), values, heard, level)
        found.append(state)
    return found


def _level(value: object) -> Level:
    """A level as a message has it; one that does not exist is taken for an error."""
    number = int(cast("int", value)) if not isinstance(value, bytes) else value[0]
    return Level(number) if number in Level.__members__.values() else Level.ERROR


def state_at(state: DiagnosticState, now_ns: int, period: float) -> DiagnosticState:
    """The state as of now: stale where nothing was heard for `STALE_SECONDS`, or for three periods of a slow topic."""
    silent = (now_ns - state.received_ns) / 1e9
    return replace(state, level=Level.STALE) if silent > max(STALE_SECONDS, 3 * period) else state


def worst_first(states: Iterable[DiagnosticState]) -> Sequence[DiagnosticState]:
    """Return the worst before all others, of one level what came to it last."""
    return sorted(states, key=lambda each: (-SEVERITY[each.level], -each.since_ns, each.name))


def changes_of(said: Iterable[tuple[int, DiagnosticState]]) -> Sequence[LevelChange]:
    """Return the changes in what one part said, the newest first; `said` is in order of time."""
    found: list[LevelChange] = []
    for time_ns, state in said:
        if not found or (found[-1].level, found[-1].message) != (state.said, state.message):
            found.append(LevelChange(time_ns, state.said, state.message))
    return found[::-1]


class LevelTimes:
    """Since when each part is at its level, as far as somebody looked."""

    def __init__(self) -> None:
        self._since: dict[tuple[str, str], tuple[Level, int]] = {}

    def note(self, state: DiagnosticState, now_ns: int) -> DiagnosticState:
        """Return the state with its time: that at which it was heard first at this level."""
        key = state.topic, state.name
        known = self._since.pop(key, None)
        if known is None or known[0] is not state.level:
            known = state.level, now_ns if state.level is Level.STALE and known is not None else state.received_ns
        self._since[key] = known
        if len(self._since) > _MAX_KEPT:
            self._since.pop(next(iter(self._since)))
        return replace(state, since_ns=known[1])
