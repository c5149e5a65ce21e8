"""Conditions on numbers in recordings, such as `battery_state.percentage < 0.2 and odom.pose.pose.position.x >= 1`."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial, reduce
from math import isfinite
from typing import NamedTuple

from rosld.adapters.base import FOR_EVER, Recording
from rosld.server.history.statistics import Statistics, Total, schema_in, statistics_of
from rosld.server.resources.past_messages import PastRange, read_past
from rosld.server.resources.series import FieldValues

_OPERATORS: Mapping[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "!=": operator.ne,
    "==": operator.eq,
    "=": operator.eq,
    "<": operator.lt,
    ">": operator.gt,
}
_AND = re.compile(r"\s+and\s+", re.IGNORECASE)
_COMPARISON = re.compile(r"/?([^\s.<>=!]+)\.([^\s<>=!]+)\s*(<=|>=|!=|==|=|<|>)\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)")


class Comparison(NamedTuple):
    """A comparison of a field of a topic with a number."""

    topic: str
    path: str
    operator: str
    number: float

    def holds(self, value: float) -> bool:
        """Whether a value satisfies it."""
        return _OPERATORS[self.operator](value, self.number)

    def holds_between(self, least: float, most: float) -> bool | None:
        """Whether one of some numbers, of which these are the least and the most, satisfies it; None if unknown."""
        if not (isfinite(least) and isfinite(most)):
            return None
        if self.holds(least) or self.holds(most):
            return True
        return None if self.operator in ("=", "==") and least < self.number < most else False


def parse_condition(text: str) -> Sequence[Comparison]:
    """Return the comparisons in `TOPIC.FIELD OP NUMBER and …`. Raises ValueError."""
    return [_parse_comparison(each) for each in _AND.split(text.strip())]


def _parse_comparison(text: str) -> Comparison:
    found = _COMPARISON.fullmatch(text)
    try:
        if found is None:
            raise ValueError(text)
        path = found[2].replace("[", ".").replace("]", "")
        return Comparison(f"/{found[1]}", path, found[3], float(found[4]))
    except ValueError as error:
        words = f"{text[:100]!r} is not TOPIC.FIELD OP NUMBER, such as battery_state.percentage < 0.2"
        raise ValueError(words) from error


class ConditionReader:
    """Reader of the numbers that a condition is about; `problem` says why a message had none.

    With `statistics`, those of a topic are made once and kept.
    """

    def __init__(self, statistics: Statistics | None = None) -> None:
        self._statistics = statistics
        self._known: dict[Comparison, dict[str, dict[str, dict[str, Total]]]] = {}
        self.problem: str | None = None
        self.has_numbers = False
        """Whether some message had a number."""

    def holds(self, recording: Recording, condition: Sequence[Comparison]) -> bool:
        """Whether each comparison is true for some message of a recording."""
        return all(self._holds(recording, each) for each in condition)

    def _holds(self, recording: Recording, comparison: Comparison) -> bool:
        known = self._total(recording, comparison)
        found = None if known is None else comparison.holds_between(known.minimum, known.maximum)
        if found is None:
            return any(comparison.holds(value) for _, value in self._numbers(recording, comparison))
        self.has_numbers = True
        return found

    def _total(self, recording: Recording, comparison: Comparison) -> Total | None:
        """Return the statistics of a field in a recording, None if there are none."""
        key, topic = recording.content, comparison.topic
        if self._statistics is None or key is None or topic not in recording.topics:
            return None
        if comparison not in self._known:
            self._known[comparison] = self._statistics.totals(topic, [comparison.path])
        types = self._known[comparison].get(key)
        if types is None:
            found = statistics_of(recording, topic, partial(schema_in, recording), lambda _: None)
            self._statistics.keep(key, topic, found)
            types = {type: each.totals() for type, each in found.items()}
        totals = [each[comparison.path] for each in types.values() if comparison.path in each]
        return reduce(Total.join, totals) if totals else None

    def times(self, recording: Recording, condition: Sequence[Comparison]) -> Sequence[int]:
        """Return the times in ns of the messages with which a condition becomes true.

        Raises ValueError if the comparisons are about several topics, or no message has such a number.
        """
        if len({each.topic for each in condition}) > 1:
            raise ValueError("a condition to cut around must be about the fields of one topic")
        found: dict[int, list[bool]] = {}
        for each in condition:
            for time, value in self._numbers(recording, each):
                found.setdefault(time, []).append(each.holds(value))
        if not found:
            raise ValueError(self.problem or f"{recording.name} has no messages of {condition[0].topic}")
        times, was_true = list[int](), False
        for time in sorted(found):
            is_true = len(found[time]) >= len(condition) and all(found[time])
            if is_true and not was_true:
                times.append(time)
            was_true = is_true
        return times

    def _numbers(self, recording: Recording, comparison: Comparison) -> Iterator[tuple[int, float]]:
        """Yield the time and the number of each message that has one, in any order."""
        if comparison.topic not in recording.topics:
            return
        values = FieldValues(recording.schema, comparison.path)
        for block in read_past(recording, [PastRange(comparison.topic, 0, FOR_EVER)]):
            for time, value in values.values_of(block):
                if value is not None:
                    self.has_numbers = True
                    yield time, value
        self.problem = self.problem or values.problem
