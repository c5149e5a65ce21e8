"""SPARQL functions of numbers and times, and aggregates for statistics. Pure.

The functions of numbers are those of XPath (https://www.w3.org/TR/xpath-functions-31/#trigonometry), under its IRIs:
results are xsd:double, and NaN or INF where a number has no result. Others raise ValueError for invalid arguments.
"""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from functools import lru_cache, partial

from pyoxigraph import Literal, NamedNode

from rosld.ontology.vocab import PREFIXES, ros, xsd
from rosld.server.dataset.base import AggregateFunction, Term
from rosld.server.dataset.encoding import is_numeric

SECOND_NS = 1_000_000_000
_DURATIONS = frozenset(NamedNode(xsd.iri + name) for name in ("dayTimeDuration", "duration"))
_TIME = re.compile(r"(-?[0-9]{4,6}-[0-9]{2}-[0-9]{2})T([0-9]{2}):([0-9]{2}):([0-9]{2})(?:\.([0-9]+))?(.*)")
_ZONE = re.compile(r"([+-])([0-9]{2}):([0-9]{2})")
_DURATION = re.compile(r"(-?)P(?:([0-9]+)D)?(?:T(?:([0-9]+)H)?(?:([0-9]+)M)?(?:([0-9]+)(?:\.([0-9]+))?S)?)?")


def number(term: Term) -> float:
    """Return the value of a numeric literal. Raises ValueError for any other term."""
    if not isinstance(term, Literal) or not is_numeric(term):
        raise ValueError("not a number")
    return float(term.value)


# --- times


def time_ns(term: Term) -> int:
    """Return an xsd:dateTime in ns since the epoch; without a time zone it counts as UTC. Raises ValueError."""
    if not isinstance(term, Literal) or term.datatype != xsd.dateTime:
        raise ValueError("not a time")
    found = _TIME.fullmatch(term.value)
    if found is None:
        raise ValueError("not a time")
    date, hour, minute, second, fraction, zone = found.groups()
    seconds = _day(date) + int(hour) * 3600 + int(minute) * 60 + int(second)
    if zone not in ("Z", ""):
        offset = _ZONE.fullmatch(zone)
        if offset is None:
            raise ValueError("not a time")
        seconds -= int(f"{offset[1]}{int(offset[2]) * 3600 + int(offset[3]) * 60}")
    return seconds * SECOND_NS + _fraction(fraction)


@lru_cache(maxsize=1024)
def _day(date: str) -> int:
    """Return the seconds from the epoch to a date. Raises ValueError for years that Python has not."""
    return int(datetime.fromisoformat(date).replace(tzinfo=timezone.utc).timestamp())


def _fraction(digits: str | None) -> int:
    return int(digits[:9].ljust(9, "0")) if digits else 0


def duration_ns(term: Term) -> int:
    """Return a duration of days to seconds in ns. Raises ValueError for months, whose length depends on the date."""
    found = _DURATION.fullmatch(term.value) if isinstance(term, Literal) and term.datatype in _DURATIONS else None
    if found is None:
        raise ValueError("not a duration of days, hours, minutes and seconds")
    sign, days, hours, minutes, seconds, fraction = found.groups()
    whole = int(days or 0) * 86400 + int(hours or 0) * 3600 + int(minutes or 0) * 60 + int(seconds or 0)
    total = whole * SECOND_NS + _fraction(fraction)
    return -total if sign else total


def _decimals(nanoseconds: int) -> str:
    """Return `.` and the decimals of a second, "" for none."""
    return f".{nanoseconds:09d}".rstrip("0").rstrip(".")


def seconds(term: Term) -> Term:
    """`ros:seconds(?duration)`: a duration in seconds; of a time those since 1970, as xsd:decimal."""
    is_time = isinstance(term, Literal) and term.datatype == xsd.dateTime
    total = time_ns(term) if is_time else duration_ns(term)
    whole, rest = divmod(abs(total), SECOND_NS)
    return Literal(f"{'-' if total < 0 else ''}{whole}{_decimals(rest)}", datatype=xsd.decimal)


def floor(time: Term, step: Term) -> Term:
    """`ros:floor(?time, ?duration)`: the begin of the window of this length, counted from 1970 in UTC."""
    length = duration_ns(step)
    if length <= 0:
        raise ValueError("not a length")
    whole, rest = divmod(time_ns(time) // length * length, SECOND_NS)
    text = datetime.fromtimestamp(whole, timezone.utc).strftime("%Y-%m-%dT%H:%M:%S").rjust(19, "0")
    return Literal(f"{text}{_decimals(rest)}Z", datatype=xsd.dateTime)


# --- numbers


def _of_numbers(function: Callable[..., float], *terms: Term) -> Term:
    numbers = [number(each) for each in terms]
    try:
        return Literal(function(*numbers))
    except ValueError:
        return Literal(math.nan)
    except OverflowError:
        return Literal(math.inf)


def _log(value: float, function: Callable[[float], float] = math.log) -> float:
    return function(value) if value else -math.inf


def _pow(base: float, exponent: float) -> float:
    if base == 0 and exponent < 0:
        return math.copysign(math.inf, base) if exponent % 2 == 1 else math.inf
    found: float = math.pow(base, exponent)
    return found


_MATH: Mapping[str, Callable[..., float]] = {
    **{name: getattr(math, name) for name in ("exp", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "atan2")},
    "pi": lambda: math.pi,
    "pow": _pow,
    "exp10": partial(_pow, 10.0),
    "log": _log,
    "log10": partial(_log, function=math.log10),
}

FUNCTIONS: Mapping[str, Callable[..., Term]] = {
    **{PREFIXES["math"] + name: partial(_of_numbers, function) for name, function in _MATH.items()},
    ros.seconds.value: seconds,
    ros.floor.value: floor,
}


# --- aggregates


class _Numbers:
    """Accumulator of numbers; NaN is left out. Without enough of them, or with another term, the result is an error."""

    def __init__(self, function: Callable[[list[float]], float], least: int = 1) -> None:
        self._function = function
        self._least = least
        self._numbers: list[float] = []
        self._is_wrong = False

    def accumulate(self, term: Term) -> None:
        try:
            value = number(term)
        except ValueError:
            self._is_wrong = True
            return
        if value == value:
            self._numbers.append(value)

    def finish(self) -> Term | None:
        if self._is_wrong or len(self._numbers) < self._least:
            return None
        try:
            return Literal(self._function(self._numbers))
        except (ArithmeticError, ValueError):  # of infinities
            return Literal(math.nan)


class _Percentile:
    """Accumulator of values, each with the percentage in front (`PAIR` of the private functions)."""

    def __init__(self) -> None:
        self._numbers: list[float] = []
        self._percent: str | None = None
        self._is_wrong = False

    def accumulate(self, term: Term) -> None:
        percent, _, value = term.value.partition(" ") if isinstance(term, Literal) else ("", "", "")
        if not value or self._percent not in (None, percent):
            self._is_wrong = True
            return
        self._percent = percent
        found = float(value)
        if found == found:
            self._numbers.append(found)

    def finish(self) -> Term | None:
        percent = float(self._percent or "nan")
        if self._is_wrong or not self._numbers or not 0 <= percent <= 100:
            return None
        return Literal(percentile(self._numbers, percent))


def percentile(numbers: list[float], percent: float) -> float:
    """Return a percentile of unsorted numbers, linear between the two nearest."""
    ordered = sorted(numbers)
    below, share = divmod((len(ordered) - 1) * percent / 100, 1)
    low = ordered[int(below)]
    return low + (ordered[int(below) + 1] - low) * share if share else low


def _variance(numbers: list[float]) -> float:
    mean = math.fsum(numbers) / len(numbers)
    return math.fsum((each - mean) ** 2 for each in numbers) / (len(numbers) - 1)


AGGREGATES: Mapping[str, AggregateFunction] = {
    ros.median.value: partial(_Numbers, statistics.median),
    ros.stdev.value: partial(_Numbers, lambda numbers: math.sqrt(_variance(numbers)), 2),
    ros.variance.value: partial(_Numbers, _variance, 2),
    ros.percentile.value: _Percentile,
}
"""Aggregates by IRI."""
AGGREGATE_ARGUMENTS: Mapping[str, tuple[int, int]] = {
    iri: (2, 2) if iri == ros.percentile.value else (1, 1) for iri in AGGREGATES
}
"""Least and greatest number of arguments of each aggregate."""
