"""Diagnostics: states that the parts of a robot report about themselves. Pure except for `LevelTimes`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple, cast

from msgspec import Struct
from msgspec.structs import replace

from rosld.adapters.model import Graph, Message

DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"


def has_diagnostics(graph: Graph) -> bool:
    """Whether a node of the graph publishes or reads diagnostics."""
    return any(ref.name == DIAGNOSTIC_ARRAY for topic in graph.topics.values() for ref in topic.types)


STALE_SECONDS = 5.0
"""Seconds without a report after which a part is stale, as in the aggregator of ROS."""
_MAX_PARTS = 10_000


class Level(IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


SEVERITY: Mapping[Level, int] = {Level.ERROR: 3, Level.STALE: 2, Level.WARN: 1, Level.OK: 0}
"""Order of levels: a silent part may hide any fault, so stale ranks just below error."""


class KeyValue(NamedTuple):
    """A value that a part reports about itself."""

    key: str
    value: str


class DiagnosticState(Struct, frozen=True):
    """The latest state of a part: its topic, name, hardware, and the time since it has this level.

    `reported_level` is the reported level, `level` the effective one: a part that is silent becomes stale.
    """

    topic: str
    name: str
    hardware: str
    reported_level: Level
    message: str
    values: tuple[KeyValue, ...]
    received_ns: int
    level: Level = Level.OK
    since_ns: int = 0


class LevelChange(NamedTuple):
    """A moment at which a part changed its level or message."""

    time_ns: int
    level: Level
    message: str


def read_states(topic: str, message: Message, times: Mapping[str, int], received_ns: int) -> list[DiagnosticState]:
    """Return the states of a DiagnosticArray; `times` are the receipt times by name, where they differ."""
    found = []
    for each in cast("Iterable[Any]", getattr(message, "status", ())):
        name, level = str(each.name), _level(each.level)
        values = tuple(KeyValue(str(pair.key), str(pair.value)) for pair in each.values)
        newest_ns = times.get(each.name, received_ns)
        state = DiagnosticState(topic, name, str(each.hardware_id), level, str(each.message), values, newest_ns, level)
        found.append(state)
    return found


def _level(value: object) -> Level:
    """Return the level in a message; an unknown level counts as an error."""
    number = int(cast("int", value)) if not isinstance(value, bytes) else value[0]
    return Level(number) if number in Level.__members__.values() else Level.ERROR


def state_at(state: DiagnosticState, now_ns: int, period: float) -> DiagnosticState:
    """Return the state as of now: stale after `STALE_SECONDS` of silence, or three periods of a slow topic."""
    silent = (now_ns - state.received_ns) / 1e9
    return replace(state, level=Level.STALE) if silent > max(STALE_SECONDS, 3 * period) else state


def worst_first(states: Iterable[DiagnosticState]) -> Sequence[DiagnosticState]:
    """Return the states, worst level first and, within a level, the most recent change first."""
    return sorted(states, key=lambda each: (-SEVERITY[each.level], -each.since_ns, each.name))


def changes_of(reports: Iterable[tuple[int, DiagnosticState]]) -> Sequence[LevelChange]:
    """Return the changes in the reports of one part, newest first; `reported_level` is in order of time."""
    found: list[LevelChange] = []
    for time_ns, state in reports:
        if not found or (found[-1].level, found[-1].message) != (state.reported_level, state.message):
            found.append(LevelChange(time_ns, state.reported_level, state.message))
    return found[::-1]


class LevelTimes:
    """The times at which the parts reached their levels, as far as observed."""

    def __init__(self) -> None:
        self._since: dict[tuple[str, str], tuple[Level, int]] = {}

    def note(self, state: DiagnosticState, now_ns: int) -> DiagnosticState:
        """Return the state with the time at which this level was first observed."""
        key = state.topic, state.name
        known = self._since.pop(key, None)
        if known is None or known[0] is not state.level:
            known = state.level, now_ns if state.level is Level.STALE and known is not None else state.received_ns
        self._since[key] = known
        if len(self._since) > _MAX_PARTS:
            self._since.pop(next(iter(self._since)))
        return replace(state, since_ns=known[1])
