"""Lexical forms: the values of XSD's literals (XSD 1.1 part 2), exactly.

Each literal is read by the rules of its own datatype: "0.1"^^xsd:float is the float32 nearest to 0.1, in any field, and
"300"^^xsd:byte is invalid.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import date
from decimal import Decimal
from math import isfinite, isinf

from pyoxigraph import NamedNode

from rosld.ontology.coercion import (
    RANGES,
    SPECIALS,
    Misfit,
    Number,
    base64_octets,
    may_tie,
    to_float32,
)
from rosld.ontology.literals import DATATYPES
from rosld.ontology.vocab import xsd

_INTEGER = re.compile(r"[+-]?[0-9]{1,400}", re.ASCII)
_DECIMAL = re.compile(r"[+-]?(?:[0-9]{1,400}(?:\.[0-9]{0,400})?|\.[0-9]{1,400})", re.ASCII)
_DOUBLE = re.compile(r"[+-]?(?:[0-9]{1,400}(?:\.[0-9]{0,400})?|\.[0-9]{1,400})(?:[eE][+-]?[0-9]{1,9})?", re.ASCII)
_DATE_TIME = re.compile(
    r"([0-9]{4})-([0-9]{2})-([0-9]{2})T([01][0-9]|2[0-3]):([0-5][0-9]):([0-5][0-9])(?:\.([0-9]{1,30}))?"
    r"(Z|[+-](?:0[0-9]|1[0-3]):[0-5][0-9]|[+-]14:00)?",
    re.ASCII,
)
_HEX = re.compile(r"(?:[0-9A-Fa-f]{2})*", re.ASCII)
_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}
_EPOCH = date(1970, 1, 1).toordinal()


def _integer(name: str, least: int | None, greatest: int | None) -> Callable[[str], int]:
    def read(text: str) -> int:
        if _INTEGER.fullmatch(text := text.strip()):
            value = int(text)
            if (least is None or value >= least) and (greatest is None or value <= greatest):
                return value
        raise Misfit(f"this is not a valid xsd:{name}", text)

    return read


def _decimal(text: str) -> Decimal:
    if _DECIMAL.fullmatch(text := text.strip()):
        return Decimal(text)
    raise Misfit("this is not a valid xsd:decimal", text)


def _double(text: str) -> float:
    if _DOUBLE.fullmatch(text := text.strip()):
        value = float(text)
        if not isinf(value):
            return value
        raise Misfit("this number is beyond the range of xsd:double (infinity is written INF)", text)
    if text in SPECIALS:
        return SPECIALS[text]
    raise Misfit("this is not a number (infinity is written INF)", text)


def _float(text: str) -> float:
    double = _double(text)
    try:
        return to_float32(Decimal(text.strip()) if double and isfinite(double) and may_tie(double) else double)
    except OverflowError:
        raise Misfit("this number is beyond the range of xsd:float (infinity is written INF)", text) from None


NUMBERS: dict[NamedNode, Callable[[str], Number]] = {
    xsd.integer: _integer("integer", None, None),
    xsd.decimal: _decimal,
    xsd.double: _double,
    xsd.float: _float,
    NamedNode(xsd.iri + "nonNegativeInteger"): _integer("nonNegativeInteger", 0, None),
    NamedNode(xsd.iri + "positiveInteger"): _integer("positiveInteger", 1, None),
    NamedNode(xsd.iri + "nonPositiveInteger"): _integer("nonPositiveInteger", None, 0),
    NamedNode(xsd.iri + "negativeInteger"): _integer("negativeInteger", None, -1),
    **{NamedNode(xsd.iri + DATATYPES[name]): _integer(DATATYPES[name], *limits) for name, limits in RANGES.items()},
}
"""Readers by numeric datatype: each returns the value of a lexical form or raises Misfit."""


def parse_boolean(text: str) -> bool:
    """Return the value of an xsd:boolean. Raises Misfit."""
    value = _BOOLEANS.get(text)
    if value is None:
        raise Misfit("expected an xsd:boolean: true or false", text)
    return value


def parse_hex_binary(text: str) -> bytes:
    """Return the octets of an xsd:hexBinary. Raises Misfit."""
    if not _HEX.fullmatch(text):
        raise Misfit("expected an xsd:hexBinary", text)
    return bytes.fromhex(text)


BINARIES: dict[NamedNode, Callable[[str], bytes]] = {
    xsd.base64Binary: base64_octets,
    xsd.hexBinary: parse_hex_binary,
}
"""Readers of octets by datatype."""


def parse_date_time(text: str) -> int:
    """Return the nanoseconds from the epoch to an xsd:dateTime, which must have a time zone. Raises Misfit."""
    match = _DATE_TIME.fullmatch(text.strip())
    if match is None or match[8] is None:
        raise Misfit("expected an xsd:dateTime with a time zone, such as 2026-01-31T12:00:00.5Z", text)
    year, month, day, hour, minute, second = (int(match[group]) for group in range(1, 7))
    fraction, zone = (match[7] or "").ljust(9, "0"), match[8]
    try:
        days = date(year, month, day).toordinal() - _EPOCH
    except ValueError as error:
        raise Misfit(f"expected an xsd:dateTime ({error})", text) from error
    if fraction[9:].strip("0"):
        raise Misfit("expected an xsd:dateTime to the nanosecond", text)
    seconds = days * 86400 + hour * 3600 + minute * 60 + second - _offset(zone)
    return seconds * 1_000_000_000 + int(fraction[:9])


def _offset(zone: str) -> int:
    """Return the offset in seconds east of UTC."""
    if zone == "Z":
        return 0
    east = int(zone[1:3]) * 3600 + int(zone[4:6]) * 60
    return east if zone[0] == "+" else -east
