"""Constraints that FILTER, BIND and VALUES put on the variables of a group: time intervals and sets of terms. Pure.

A constraint holds in every solution that passes all filters; an expression that is not understood adds none. Times are
compared as linear sums of at most one variable on either side, constants, NOW() and durations.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import date
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from math import inf, isfinite, nan
from typing import NamedTuple

from msgspec import Struct, field
from msgspec.structs import replace
from pyoxigraph import Literal, NamedNode

from rosld.ontology.vocab import xsd
from rosld.server.sparql.syntax.tree import (
    Call,
    Choices,
    Constant,
    Expression,
    Group,
    Iri,
    Operand,
    Part,
    Reference,
    Value,
    strip_brackets,
)

FOR_EVER = 1 << 80
"""Bound in nanoseconds, beyond any representable time on either side of the epoch."""
_STAMP, _DAY_TIME, _DURATION_TYPE = (
    NamedNode(xsd.iri + name) for name in ("dateTimeStamp", "dayTimeDuration", "duration")
)
_NUMBERS = frozenset((xsd.integer, xsd.decimal, xsd.double, xsd.float))
_EPOCH = date(1970, 1, 1).toordinal()
_ROUNDING = 1e-6
"""Relative margin of bounds; a float has 24 binary digits."""
_LEAST_FLOAT, _MOST_FLOAT = 1e-44, 3.4e38
_ROUNDS = 3
"""Maximum number of passes over the filters; each pass may use results of the previous one."""
_TURNED = {"<": ">", ">": "<", "<=": ">=", ">=": "<=", "=": "="}


class Interval(NamedTuple):
    """Closed interval of times or durations, in nanoseconds."""

    low: int = -FOR_EVER
    high: int = FOR_EVER

    def meet(self, other: Interval) -> Interval:
        """Return the intersection of both intervals."""
        return Interval(max(self.low, other.low), min(self.high, other.high))

    def hull(self, other: Interval) -> Interval:
        """Return the smallest interval that contains both."""
        return Interval(min(self.low, other.low), max(self.high, other.high))

    def shift(self, other: Interval, sign: int = 1) -> Interval:
        """Return the interval of the sums (or differences, if `sign` is negative) of both."""
        low, high = (other.low, other.high) if sign > 0 else (-other.high, -other.low)
        return Interval(max(-FOR_EVER, self.low + low), min(FOR_EVER, self.high + high))


ANY_TIME = Interval()


class Bounds(NamedTuple):
    """Closed interval of numbers, slightly too wide: a float may equal a decimal that differs from it as a double."""

    low: float = -inf
    high: float = inf

    def meet(self, other: Bounds) -> Bounds:
        """Return the intersection of both."""
        return Bounds(max(self.low, other.low), min(self.high, other.high))


class Knowledge(Struct, frozen=True):
    """Constraints on variables: their intervals as far as they are times or numbers, and their possible terms."""

    times: Mapping[str, Interval] = field(default_factory=dict)
    terms: Mapping[str, frozenset[Iri | Value]] = field(default_factory=dict)
    numbers: Mapping[str, Bounds] = field(default_factory=dict)

    def of_time(self, variable: str) -> Interval:
        """Return the time interval of a variable."""
        return self.times.get(variable, ANY_TIME)

    def restrict(self, variables: frozenset[str]) -> Knowledge:
        """Return only the constraints on these variables."""
        return Knowledge(
            {name: each for name, each in self.times.items() if name in variables},
            {name: each for name, each in self.terms.items() if name in variables},
            {name: each for name, each in self.numbers.items() if name in variables},
        )

    def with_time(self, variable: str, time: Interval) -> Knowledge:
        """Return these constraints with a variable further limited to an interval."""
        return replace(self, times={**self.times, variable: self.of_time(variable).meet(time)})

    def with_terms(self, variable: str, terms: frozenset[Iri | Value]) -> Knowledge:
        """Return these constraints with a variable further limited to these terms."""
        known = self.terms.get(variable)
        return replace(self, terms={**self.terms, variable: terms if known is None else known & terms})

    def with_number(self, variable: str, bounds: Bounds) -> Knowledge:
        """Return these constraints with a variable further limited to these numbers."""
        return replace(self, numbers={**self.numbers, variable: self.numbers.get(variable, Bounds()).meet(bounds)})

    def join(self, other: Knowledge) -> Knowledge:
        """Return the constraints that hold if either set of constraints does."""
        return Knowledge(
            {name: each.hull(other.times[name]) for name, each in self.times.items() if name in other.times},
            {name: each | other.terms[name] for name, each in self.terms.items() if name in other.terms},
            {
                name: Bounds(min(each.low, other.numbers[name].low), max(each.high, other.numbers[name].high))
                for name, each in self.numbers.items()
                if name in other.numbers
            },
        )


class _Sum(NamedTuple):
    """A variable minus another plus a constant: a time (`is_time`) or a duration."""

    plus: str | None
    minus: str | None
    offset: Interval
    is_time: bool


def knowledge_of(group: Group, outer: Knowledge, now: Interval) -> Knowledge:
    """Return the constraints on the variables of a group, given those that `outer` puts on them; NOW() is in `now`."""
    known = outer
    for name, values in group.data:
        if values is not None:
            known = _with_values(known, name, values)
    for _ in range(_ROUNDS):
        before = known
        for name, operand in group.bindings:
            found = _sum([operand], now)
            if found is not None and found.is_time:
                known = known.with_time(name, _range_of(found, known))
        for test in group.tests:
            known = _narrow(test, known, now)
        if known == before:
            break
    return known


def time_of(operand: Operand, known: Knowledge, now: Interval) -> Interval:
    """Return the interval of an expression, as far as it is a time."""
    found = _sum([operand], now)
    return _range_of(found, known) if found is not None and found.is_time else ANY_TIME


def date_time_interval(value: Value) -> Interval | None:
    """Return the interval of an xsd:dateTime, None for any other literal; without a time zone it counts as UTC.

    A comparison with a time without a zone is only true if it is true in every zone, and so in UTC.
    """
    if value.literal.datatype not in (xsd.dateTime, _STAMP):
        return None
    found = _DATE_TIME.fullmatch(value.literal.value.strip())
    if found is None:
        return None
    year, month, day, hour, minute, second, sign, hours, minutes = found.groups()
    try:
        days = date(int(year), int(month), int(day)).toordinal() - _EPOCH
    except ValueError:  # before the year 1, after 9999, or no date at all
        return None
    seconds = Decimal(days * 86400 + int(hour) * 3600 + int(minute) * 60) + Decimal(second)
    if hours is not None:
        offset = int(hours) * 3600 + int(minutes) * 60
        seconds += offset if sign == "-" else -offset
    return _nanoseconds(seconds)


_DATE_TIME = re.compile(
    r"(-?[0-9]{4,6})-([0-9]{2})-([0-9]{2})T([0-9]{2}):([0-9]{2}):([0-9]{2}(?:\.[0-9]{1,30})?)"
    r"(?:Z|([+-])([0-9]{2}):([0-9]{2}))?"
)
_DURATION = re.compile(
    r"(-?)P(?:0+Y)?(?:0+M)?(?:([0-9]{1,9})D)?"
    r"(?:T(?:([0-9]{1,9})H)?(?:([0-9]{1,9})M)?(?:([0-9]{1,12}(?:\.[0-9]{1,30})?)S)?)?"
)
"""A duration without years and months, because their lengths depend on the date."""


def _nanoseconds(seconds: Decimal) -> Interval:
    exact = seconds * 1_000_000_000
    return Interval(int(exact.to_integral_value(ROUND_FLOOR)), int(exact.to_integral_value(ROUND_CEILING)))


def _duration(text: str) -> Interval | None:
    found = _DURATION.fullmatch(text.strip())
    if found is None:
        return None
    sign, days, hours, minutes, seconds = found.groups()
    total = Decimal(int(days or 0) * 86400 + int(hours or 0) * 3600 + int(minutes or 0) * 60) + Decimal(seconds or 0)
    return _nanoseconds(-total if sign else total)


def _with_values(known: Knowledge, name: str, values: frozenset[Iri | Value]) -> Knowledge:
    """Limit a variable to the terms of VALUES, IN or =."""
    times = [date_time_interval(each) if isinstance(each, Value) else None for each in values]
    moments = [each for each in times if each is not None]
    if moments and len(moments) == len(times):
        whole = moments[0]
        for each in moments[1:]:
            whole = whole.hull(each)
        return known.with_time(name, whole)
    if all(isinstance(each, Iri) or _is_text(each) for each in values):
        return known.with_terms(name, values)
    return known


def _is_text(value: Value) -> bool:
    """Whether a literal equals only itself."""
    return value.literal.datatype == xsd.string


# --- tests


def _narrow(test: Operand, known: Knowledge, now: Interval) -> Knowledge:
    """Return the constraints where a test holds."""
    test = strip_brackets(test)
    if not isinstance(test, Expression):
        return known
    alternatives = [*split_parts(test.parts, "||")]
    if len(alternatives) > 1:
        found = [_narrow_all(each, known, now) for each in alternatives]
        joined = found[0]
        for each in found[1:]:
            joined = joined.join(each)
        return joined
    return _narrow_all(test.parts, known, now)


def _narrow_all(parts: Sequence[Part], known: Knowledge, now: Interval) -> Knowledge:
    for each in split_parts(parts, "&&"):
        if len(each) == 1 and not isinstance(each[0], str):
            known = _narrow(each[0], known, now)
        else:
            known = _compare(each, known, now)
    return known


def split_parts(parts: Sequence[Part], operator: str) -> Iterator[Sequence[Part]]:
    """Yield the parts of an expression between occurrences of an operator."""
    begin = 0
    for at, part in enumerate(parts):
        if part == operator:
            yield parts[begin:at]
            begin = at + 1
    yield parts[begin:]


def _compare(parts: Sequence[Part], known: Knowledge, now: Interval) -> Knowledge:
    if "!" in parts:
        return known
    if len(parts) == 3 and parts[1] == "IN" and isinstance(parts[2], Choices):
        return _among(parts[0], parts[2], known)
    at = next((at for at, part in enumerate(parts) if isinstance(part, str) and part in _TURNED), None)
    if at is None:
        return known
    operator, before, after = str(parts[at]), parts[:at], parts[at + 1 :]
    if operator == "=" and len(before) == len(after) == 1:
        for side, other in ((before[0], after[0]), (after[0], before[0])):
            variable, constant = _operand(side), _operand(other)
            if isinstance(variable, Reference) and isinstance(constant, Constant):
                known = _with_values(known, variable.name[1:], frozenset({constant.term}))
    known = _bound_number(before, operator, after, known)
    known = _bound_number(after, _TURNED[operator], before, known)
    left, right = _sum(before, now), _sum(after, now)
    if left is None or right is None or left.is_time != right.is_time:
        return known
    if operator != ">" and operator != ">=":
        known = _at_most(left, right, known)
    if operator != "<" and operator != "<=":
        known = _at_most(right, left, known)
    return known


def _bound_number(one: Sequence[Part], operator: str, other: Sequence[Part], known: Knowledge) -> Knowledge:
    """Return the constraints where a variable compares to a number."""
    variable = _operand(one[0]) if len(one) == 1 else None
    number = _number(other)
    if not isinstance(variable, Reference) or number is None:
        return known
    margin = abs(number) * _ROUNDING + _LEAST_FLOAT
    low = -inf if operator in ("<", "<=") or number < -_MOST_FLOAT else number - margin
    high = inf if operator in (">", ">=") or number > _MOST_FLOAT else number + margin
    return known.with_number(variable.name[1:], Bounds(low, high))


def _number(parts: Sequence[Part]) -> float | None:
    sign = -1 if len(parts) == 2 and parts[0] == "-" else 1
    constant = _operand(parts[-1]) if len(parts) == 1 or sign < 0 else None
    if isinstance(constant, Expression):
        return _number(constant.parts)
    if not isinstance(constant, Constant) or not isinstance(constant.term, Value):
        return None
    literal = constant.term.literal
    try:
        number = sign * float(literal.value) if literal.datatype in _NUMBERS else nan
    except ValueError:
        return None
    return number if isfinite(number) else None


def _among(part: Part, choices: Choices, known: Knowledge) -> Knowledge:
    variable = _operand(part)
    items = [strip_brackets(each) for each in choices.items]
    terms = frozenset(each.term for each in items if isinstance(each, Constant))
    if not isinstance(variable, Reference) or not all(isinstance(each, Constant) for each in items):
        return known
    return _with_values(known, variable.name[1:], terms)


def _operand(part: Part) -> Operand | None:
    return None if isinstance(part, str) else strip_brackets(part)


def _at_most(left: _Sum, right: _Sum, known: Knowledge) -> Knowledge:
    """Return the constraints where one sum is at most another."""
    above = [name for name in (left.plus, right.minus) if name is not None]
    below = [name for name in (left.minus, right.plus) if name is not None]
    for name in [each for each in above if each in below]:
        above.remove(name)
        below.remove(name)
    if len(above) > 1 or len(below) > 1:
        return known
    least = left.offset.shift(right.offset, -1).low  # what is above minus what is below is at most the opposite
    if above and below:
        (upper,), (lower,) = above, below
        was_upper, was_lower = known.of_time(upper), known.of_time(lower)
        known = known.with_time(upper, Interval(high=was_lower.shift(Interval(-least, -least)).high))
        return known.with_time(lower, Interval(low=was_upper.shift(Interval(least, least)).low))
    if above:
        return known.with_time(above[0], Interval(high=-least))
    if below:
        return known.with_time(below[0], Interval(low=least))
    return known


def _range_of(found: _Sum, known: Knowledge) -> Interval:
    whole = found.offset
    if found.plus is not None:
        whole = whole.shift(known.of_time(found.plus))
    if found.minus is not None:
        whole = whole.shift(known.of_time(found.minus), -1)
    return whole


def _sum(parts: Sequence[Part], now: Interval) -> _Sum | None:
    """Return the sum of operands with + and - between them; None for anything not understood."""
    total: _Sum | None = None
    sign = 1
    is_operator_next = False
    for part in parts:
        if isinstance(part, str):
            if part not in ("+", "-"):
                return None
            sign = sign * (-1 if part == "-" else 1) if not is_operator_next else (-1 if part == "-" else 1)
            is_operator_next = False
            continue
        found = _single(part, now)
        if found is None:
            return None
        total = _apply_sign(found, sign) if total is None else _add(total, found, sign)
        if total is None:
            return None
        sign, is_operator_next = 1, True
    return total


def _single(operand: Operand, now: Interval) -> _Sum | None:
    operand = strip_brackets(operand)
    if isinstance(operand, Reference):
        return _Sum(operand.name[1:], None, Interval(0, 0), True)
    if isinstance(operand, Expression):
        return _sum(operand.parts, now)
    if isinstance(operand, Constant):
        return _constant(operand.term)
    if isinstance(operand, Call):
        if operand.name == "NOW":
            return _Sum(None, None, now, True)
        if operand.iri.startswith(xsd.iri) and len(operand.arguments) == 1:
            return _cast(operand, now)
    return None


def _constant(term: Iri | Value) -> _Sum | None:
    if not isinstance(term, Value):
        return None
    moment = date_time_interval(term)
    if moment is not None:
        return _Sum(None, None, moment, True)
    if term.literal.datatype in (_DURATION_TYPE, _DAY_TIME):
        duration = _duration(term.literal.value)
        return None if duration is None else _Sum(None, None, duration, False)
    return None


def _cast(call: Call, now: Interval) -> _Sum | None:
    """Return the sum of a cast such as xsd:dateTime(…) of a string or of a value that already has the type."""
    argument = strip_brackets(call.arguments[0])
    text = _text_of(argument)
    if text is not None:
        return _constant(Value(Literal(text, datatype=NamedNode(call.iri))))
    return _single(argument, now) if call.iri == xsd.dateTime.value else None


def _text_of(operand: Operand) -> str | None:
    """Return the string constant that an operand (with STR and CONCAT) evaluates to, None for anything else."""
    operand = strip_brackets(operand)
    if isinstance(operand, Constant):
        is_text = isinstance(operand.term, Value) and _is_text(operand.term)
        return operand.term.literal.value if is_text and isinstance(operand.term, Value) else None
    if not isinstance(operand, Call):
        return None
    if operand.name == "STR":
        argument = strip_brackets(operand.arguments[0])
        if isinstance(argument, Constant) and isinstance(argument.term, Value) and _is_whole(argument.term):
            return argument.term.literal.value
        return _text_of(argument)
    if operand.name == "CONCAT":
        parts = [_text_of(each) for each in operand.arguments]
        return None if None in parts else "".join(each for each in parts if each is not None)
    return None


def _is_whole(value: Value) -> bool:
    """Whether a literal is an integer in the form that STR writes."""
    return value.literal.datatype == xsd.integer and str(int(value.literal.value or 0)) == value.literal.value


def _apply_sign(found: _Sum, sign: int) -> _Sum | None:
    """Apply a sign: durations may be negative; a time with a sign is an error."""
    if sign > 0:
        return found
    return None if found.is_time else _Sum(found.minus, found.plus, Interval(0, 0).shift(found.offset, -1), False)


def _add(total: _Sum, found: _Sum, sign: int) -> _Sum | None:
    if sign < 0:
        found = _Sum(found.minus, found.plus, Interval(0, 0).shift(found.offset, -1), found.is_time)
    if total.is_time and found.is_time and sign < 0:
        is_time = False  # a time minus a time
    elif found.is_time:
        return None  # the sum of two times, or a duration minus a time
    else:
        is_time = total.is_time
    pluses = [name for name in (total.plus, found.plus) if name is not None]
    minuses = [name for name in (total.minus, found.minus) if name is not None]
    if len(pluses) > 1 or len(minuses) > 1:
        return None
    offset = total.offset.shift(found.offset)
    return _Sum(pluses[0] if pluses else None, minuses[0] if minuses else None, offset, is_time)
