"""Sort keys: strings whose order by code point is the order of their terms (SPARQL 1.1, 15.1).

pyoxigraph's sort needs a total order, but its own order is not total for mixed numbers, times and strings: then it
aborts the process. Here each term has its place: blank nodes, IRIs, numbers by value (NaN last), text, dateTimes,
booleans, other times, durations, and all other literals by their lexical form.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Mapping
from decimal import Decimal, InvalidOperation
from functools import lru_cache

from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.ontology.vocab import xsd
from rosld.server.dataset.base import Term
from rosld.server.dataset.encoding import NAMESPACE, OTHER

_BLANK, _IRI, _NUMBER, _TEXT, _MOMENT, _BOOLEAN, _TIME, _DURATION, _ANY = "012345678"
_DATE_TIME = re.compile(
    r"(?:(-?[0-9]{4,18})(?:-([0-9]{2})(?:-([0-9]{2}))?)?)?"
    r"T?(?:([0-9]{2}):([0-9]{2}):([0-9]{2})(?:\.([0-9]+))?)?(?:Z|([+-])([0-9]{2}):([0-9]{2}))?"
)
_DURATION_PARTS = re.compile(
    r"(-)?P(?:([0-9]{1,18})Y)?(?:([0-9]{1,18})M)?(?:([0-9]{1,18})D)?"
    r"(?:T(?:([0-9]{1,18})H)?(?:([0-9]{1,18})M)?(?:([0-9]{1,18})(?:\.([0-9]{1,400}))?S)?)?"
)
_MONTH = 2_629_746
"""Seconds of a mean month."""
_OFFSET = 1 << 95
"""Offset that makes all seconds positive."""


def sort_key(term: Term) -> str:
    """Return the key of a term; terms of equal value have equal keys."""
    if isinstance(term, Literal):
        return _literal_key(term.value, _name(term), term.language or "")
    if isinstance(term, NamedNode):
        return _IRI + term.value
    return _BLANK + (term.value if isinstance(term, BlankNode) else str(term))


def _name(literal: Literal) -> str:
    """Return the datatype: its local name in XSD, else its IRI."""
    datatype = literal.datatype.value
    if datatype.startswith(NAMESPACE):
        return datatype[len(OTHER) :]
    return datatype.removeprefix(xsd.iri)


@lru_cache(maxsize=16 * 1024)
def _literal_key(lexical: str, name: str, language: str) -> str:
    if name == "string" or language:
        return f"{_TEXT}{lexical}\x00{language}"
    make = _KEYS.get(name)
    key = None if make is None else make(lexical)
    if key is None:
        return f"{_NUMBER}!{lexical}" if name in _NUMERIC else f"{_ANY}{lexical}\x00{name}"
    return key


def _number_key(lexical: str) -> str | None:
    """Return the key of a number: the nearest double, and the difference of the exact value from it."""
    if lexical == "NaN":
        return f"{_NUMBER}~"
    try:
        double = float(lexical)
        if not math.isfinite(double):
            return _NUMBER + _double_key(double) + _ZERO
        exact = Decimal(lexical)
    except (ValueError, InvalidOperation):
        return None
    return _NUMBER + _double_key(double) + _double_key(float(exact - Decimal(double)) if len(lexical) > 15 else 0.0)


def _floating_key(lexical: str) -> str | None:
    """Return the key of a double, whose exact value is the nearest one."""
    try:
        double = float(lexical)
    except ValueError:
        return None
    return f"{_NUMBER}~" if math.isnan(double) else _NUMBER + _double_key(double) + _ZERO


def _float_key(lexical: str) -> str | None:
    try:
        double: float = struct.unpack("f", struct.pack("f", float(lexical)))[0]
    except OverflowError:
        double = math.inf if lexical[0] != "-" else -math.inf
    except ValueError:
        return None
    return f"{_NUMBER}~" if math.isnan(double) else _NUMBER + _double_key(double) + _ZERO


def _double_key(double: float) -> str:
    [bits] = struct.unpack(">Q", struct.pack(">d", double + 0.0))  # no -0.0
    return f"{(bits ^ 0xFFFFFFFFFFFFFFFF) if bits >> 63 else bits | 1 << 63:016x}"


_ZERO = _double_key(0.0)


def _boolean_key(lexical: str) -> str | None:
    return {"false": f"{_BOOLEAN}0", "0": f"{_BOOLEAN}0", "true": f"{_BOOLEAN}1", "1": f"{_BOOLEAN}1"}.get(lexical)


def _moment_key(lexical: str) -> str | None:
    key = _time_key(lexical)
    return key and _MOMENT + key[1:]


def _time_key(lexical: str) -> str | None:
    """Return the key of a time: seconds since the year 0 (or since midnight), in UTC without a time zone."""
    match = _DATE_TIME.fullmatch(lexical)
    if match is None:
        return None
    year, month, day, hour, minute, second, fraction, sign, hours, minutes = match.groups()
    seconds = _days(int(year or 0), int(month or 1), int(day or 1)) * 86400
    seconds += int(hour or 0) * 3600 + int(minute or 0) * 60 + int(second or 0)
    if sign:
        seconds -= (int(hours) * 3600 + int(minutes) * 60) * (-1 if sign == "-" else 1)
    return _TIME + _seconds_key(seconds, fraction)


def _days(year: int, month: int, day: int) -> int:
    """Return the days since March of the year 0 in the proleptic Gregorian calendar."""
    year, month = (year, month - 3) if month > 2 else (year - 1, month + 9)
    return 365 * year + year // 4 - year // 100 + year // 400 + (153 * month + 2) // 5 + day


def _duration_key(lexical: str) -> str | None:
    match = _DURATION_PARTS.fullmatch(lexical)
    if match is None:
        return None
    sign, *parts, fraction = match.groups()
    years, months, days, hours, minutes, seconds = (int(part or 0) for part in parts)
    length = (years * 12 + months) * _MONTH + ((days * 24 + hours) * 60 + minutes) * 60 + seconds
    if not sign:
        return _DURATION + _seconds_key(length, fraction)
    digits = (fraction or "").rstrip("0")
    if digits:  # for example, -1.25 is -2 and 0.75
        return _DURATION + _seconds_key(-length - 1, str(10 ** len(digits) - int(digits)).zfill(len(digits)))
    return _DURATION + _seconds_key(-length, None)


def _seconds_key(seconds: int, fraction: str | None) -> str:
    return f"{seconds + _OFFSET:024x}.{(fraction or '').rstrip('0')}"


_KEYS: Mapping[str, Callable[[str], str | None]] = {
    **dict.fromkeys(("integer", "decimal", "nonNegativeInteger", "positiveInteger"), _number_key),
    **dict.fromkeys(("nonPositiveInteger", "negativeInteger", "byte", "short", "int", "long"), _number_key),
    **dict.fromkeys(("unsignedByte", "unsignedShort", "unsignedInt", "unsignedLong"), _number_key),
    "double": _floating_key,
    "float": _float_key,
    "boolean": _boolean_key,
    "dateTime": _moment_key,
    **dict.fromkeys(("dateTimeStamp", "date", "time", "gYear", "gYearMonth"), _time_key),
    **dict.fromkeys(("duration", "dayTimeDuration", "yearMonthDuration"), _duration_key),
}
_NUMERIC = frozenset(name for name, make in _KEYS.items() if make in (_number_key, _floating_key, _float_key))
