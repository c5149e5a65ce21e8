"""Units and kinds of quantity (QUDT) of the numbers in messages, conversion, and symbols. Pure.

`units.ttl` states them for the fields of common message types. For other fields the convention of their names applies:
a suffix (`depth_mm`), or one of a few words for which ROS has a usual unit (REP 103). `units.csv` holds the factors.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from fractions import Fraction
from functools import cache, lru_cache
from importlib.resources import files
from typing import NamedTuple

from pyoxigraph import NamedNode

from rosld.adapters.model import OCTETS, STRINGS, Array, Field, FieldType, MessageSchema, Primitive
from rosld.ontology.modules import module_triples
from rosld.ontology.vocab import PREFIXES, qudt, ros

UNIT, KIND = PREFIXES["unit"], PREFIXES["quantitykind"]
_TYPES = "https://w3id.org/rosld/types/"
_VECTOR = "geometry_msgs/msg/Vector3"
_NO_NUMBERS = frozenset({"bool", *STRINGS})


class Quantity(NamedTuple):
    """Quantity that a number measures: the IRIs of its unit and kind of quantity (QUDT), None if unknown."""

    unit: str | None = None
    kind: str | None = None

    @property
    def statements(self) -> list[tuple[NamedNode, NamedNode | None]]:
        """Return the unit and the kind of quantity as statements."""
        pairs = ((qudt.hasUnit, self.unit), (qudt.hasQuantityKind, self.kind))
        return [(predicate, None if iri is None else NamedNode(iri)) for predicate, iri in pairs]

    @property
    def symbol(self) -> str:
        """The symbol of the unit; empty for unknown, and for numbers without dimension."""
        return "" if self.unit is None else symbol_of(self.unit)


UNKNOWN = Quantity()
"""A number that has no unit of its own: the definition leaves it to the use of the type, or mixes several."""


def quantity_of(type_name: str, field: str) -> Quantity | None:
    """Return what a field measures, such as `voltage` of `sensor_msgs/msg/BatteryState`; None if that is unknown.

    For a field that holds a message, it is what all numbers within measure: `linear` of a twist is in m/s.
    """
    found = _stated().get((type_name, field)) or _by_name(field)
    return None if found == UNKNOWN else found


def has_no_own_unit(type_name: str, field: str) -> bool:
    """Whether a field is stated to have no unit of its own."""
    return _stated().get((type_name, field)) == UNKNOWN


def field_quantity(type_name: str, field: Field) -> Quantity | None:
    """Return what is known of a field: its quantity, `UNKNOWN` if it has no unit of its own, None if nothing is.

    Convention applies to numbers, arrays of them, and vectors.
    """
    stated = _stated().get((type_name, field.name))
    if stated is not None or (field.nested != _VECTOR and not has_numbers(field.type)):
        return stated
    return _by_name(field.name)


def has_numbers(kind: FieldType) -> bool:
    """Whether a field holds a number or an array of numbers, which octets are not."""
    element = kind.element if isinstance(kind, Array) else kind
    is_number = isinstance(element, Primitive) and element.name not in _NO_NUMBERS
    return is_number and not (isinstance(kind, Array) and kind.element.name in OCTETS)


def quantity_within(enclosing: Quantity | None, type_name: str, field: Field) -> Quantity | None:
    """Return what a field measures within one that measures `enclosing`: the innermost quantity counts.

    A field that holds messages and is `UNKNOWN` cancels what is stated within: twists that hold accelerations.
    """
    stated = field_quantity(type_name, field)
    if enclosing == UNKNOWN or (stated == UNKNOWN and field.nested is not None):
        return UNKNOWN
    if stated in (None, UNKNOWN):
        return enclosing if field.nested is not None or has_numbers(field.type) else None
    return stated


def quantity_at(schema: MessageSchema, path: str) -> Quantity:
    """Return what the number at a dotted path measures (`transforms.0.translation.x`), or `UNKNOWN`."""
    name: str | None = schema.ref.name
    found: Quantity | None = None
    for step in path.split("."):
        fields = schema.types[name].fields if name is not None and name in schema.types else ()
        field = next((each for each in fields if each.name == step), None)
        if field is not None and name is not None:
            found, name = quantity_within(found, name, field), field.nested
        elif not step.isdecimal():
            return UNKNOWN
    return found or UNKNOWN


def unit_symbols(schema: MessageSchema, most: int) -> Mapping[str, str]:
    """Return the symbol of the unit of each field of a message by its path, up to a number of fields."""
    found: dict[str, str] = {}

    def walk(name: str, prefix: str, enclosing: Quantity | None, depth: int) -> None:
        for field in schema.types[name].fields if depth else ():
            quantity = quantity_within(enclosing, name, field)
            if len(found) == most:
                return
            if quantity is not None and quantity.symbol:
                found[prefix + field.name] = quantity.symbol
            elif field.nested in schema.types:
                walk(field.nested or "", f"{prefix}{field.name}.", quantity, depth - 1)

    walk(schema.ref.name, "", None, 8)
    return found


@cache
def _stated() -> Mapping[tuple[str, str], Quantity]:
    """Return what `units.ttl` states, by type and field."""
    found: dict[tuple[str, str], Quantity] = {}
    for subject, predicate, value in module_triples("units"):
        if not isinstance(subject, NamedNode) or predicate not in (qudt.hasUnit, qudt.hasQuantityKind, ros.unitUnknown):
            continue
        type_name, _, field = subject.value.removeprefix(_TYPES).partition("#")
        own = found.get((type_name, field), UNKNOWN)
        if predicate == qudt.hasUnit:
            own = own._replace(unit=value.value)
        elif predicate == qudt.hasQuantityKind:
            own = own._replace(kind=value.value)
        found[type_name, field] = own
    return found


# Conventions

_SUFFIXES = """
M Length: m meter meters metre metres | KiloM Length: km | CentiM Length: cm | MilliM Length: mm | FT Length: ft feet
RAD Angle: rad rads radian radians | DEG Angle: deg degs degree degrees
M-PER-SEC LinearVelocity: mps m_s m_per_s m_per_sec meters_per_second | KiloM-PER-HR LinearVelocity: kmh kph km_h
KN LinearVelocity: knots kts | MI-PER-HR LinearVelocity: mph
M-PER-SEC2 LinearAcceleration: mps2 m_s2 m_per_s2
RAD-PER-SEC AngularVelocity: rad_s radps rad_per_s rad_per_sec | DEG-PER-SEC AngularVelocity: deg_s degps deg_per_s dps
REV-PER-MIN AngularVelocity: rpm | RAD-PER-SEC2 AngularAcceleration: rad_s2
SEC Time: s sec secs second seconds | MilliSEC Time: ms msec millis milliseconds | MicroSEC Time: us usec microseconds
NanoSEC Time: ns nsec nanosec nanoseconds | MIN Time: minutes | HR Time: hours
HZ Frequency: hz hertz | KiloHZ Frequency: khz
DEG_C Temperature: celsius degc deg_c | DEG_F Temperature: fahrenheit degf deg_f | K Temperature: kelvin
V Voltage: volt volts | MilliV Voltage: mv millivolts | A ElectricCurrent: amp amps ampere amperes
MilliA ElectricCurrent: ma milliamps | A-HR ElectricCharge: ah | MilliA-HR ElectricCharge: mah
W Power: watt watts | KiloW Power: kw kilowatts | W-HR Energy: wh | J Energy: joule joules | OHM Resistance: ohm ohms
N Force: newton newtons | PA Pressure: pa pascal pascals | KiloPA Pressure: kpa | HectoPA Pressure: hpa
BAR Pressure: bar | PSI Pressure: psi | KiloGM Mass: kg kilograms
PERCENT DimensionlessRatio: percent pct | LUX Illuminance: lux | T MagneticFluxDensity: tesla
BYTE InformationEntropy: bytes
"""
_WORDS = """
V Voltage: voltage | DEG_C Temperature: temperature | PA Pressure: pressure | M Length: distance
DEG Angle: latitude longitude | M Altitude: altitude | RAD Angle: roll pitch yaw theta
M-PER-SEC LinearVelocity: linear_velocity | RAD-PER-SEC AngularVelocity: angular_velocity
M-PER-SEC2 LinearAcceleration: linear_acceleration | RAD-PER-SEC2 AngularAcceleration: angular_acceleration
"""


def _table(text: str) -> Mapping[str, Quantity]:
    found: dict[str, Quantity] = {}
    for entry in text.replace("\n", "|").split("|"):
        measured, _, names = entry.partition(":")
        for name in names.split():
            unit, kind = measured.split()
            found[name] = Quantity(UNIT + unit, KIND + kind)
    return found


_BY_SUFFIX, _BY_WORD = _table(_SUFFIXES), _table(_WORDS)


@lru_cache(maxsize=4096)
def _by_name(field: str) -> Quantity | None:
    """Return what a field measures by its name, which begins with a word and ends with the longest suffix."""
    name = field.lower()
    if name in _BY_WORD:
        return _BY_WORD[name]
    parts = name.split("_")
    endings = ("_".join(parts[at:]) for at in range(1, len(parts)))
    return next((_BY_SUFFIX[ending] for ending in endings if ending in _BY_SUFFIX), None) if parts[0] else None


# Conversion


class _Factor(NamedTuple):
    """A unit in terms of the SI: (value + offset) × multiplier. Only units of one kind are converted."""

    kind: str
    multiplier: Fraction
    offset: Fraction


@cache
def _factors() -> Mapping[str, _Factor]:
    lines = files("rosld.ontology").joinpath("units.csv").read_text("utf-8").splitlines()
    rows = (line.split(",") for line in lines[1:])
    return {UNIT + unit: _Factor(kind, Fraction(times), Fraction(plus)) for unit, kind, times, plus in rows}


def convert(value: float, source: str, target: str) -> float | None:
    """Return a value in another unit; None if one of the units is not in the table or they measure different things.

    Torque and energy have the same dimension, as have angles and plain numbers, but are not converted into each other.
    """
    if source == target:
        return float(value)
    one, other = _factors().get(source), _factors().get(target)
    if one is None or other is None or one.kind != other.kind:
        return None
    if not math.isfinite(value):
        return float(value)
    try:
        return float((Fraction(value) + one.offset) * one.multiplier / other.multiplier - other.offset)
    except OverflowError:
        return math.copysign(math.inf, value)


# Symbols

_SYMBOLS = {
    "A": "A", "ARCMIN": "′", "ARCSEC": "″", "BAR": "bar", "BIT": "bit", "BYTE": "B", "C": "C", "CD": "cd",
    "DAY": "d", "DEG": "°", "DEG_C": "°C", "DEG_F": "°F", "EV": "eV", "F": "F", "FARAD": "F", "FT": "ft", "G": "g",
    "GAUSS": "G", "GM": "g", "H": "H", "HR": "h", "HZ": "Hz", "IN": "in", "J": "J", "K": "K", "KN": "kn", "L": "L",
    "LB": "lb", "LM": "lm", "LUX": "lx", "M": "m", "MI": "mi", "MI_N": "nmi", "MIN": "min", "MOL": "mol", "N": "N",
    "OHM": "Ω", "PA": "Pa", "PERCENT": "%", "PPB": "ppb", "PPM": "ppm", "PSI": "psi", "RAD": "rad", "REV": "rev",
    "S": "S", "SEC": "s", "SR": "sr", "T": "T", "V": "V", "W": "W", "WB": "Wb",
}  # fmt: skip
_PREFIXES = {
    "Tera": "T", "Giga": "G", "Mega": "M", "Kilo": "k", "Hecto": "h", "Deca": "da", "Deci": "d", "Centi": "c",
    "Milli": "m", "Micro": "µ", "Nano": "n", "Pico": "p",
}  # fmt: skip
_WHOLE = {
    "REV-PER-MIN": "rpm", "UNITLESS": "", "NUM": "", "FRACTION": "", "PIXEL_COUNT": "px", "W-HR": "Wh",
    "KiloW-HR": "kWh", "A-HR": "Ah", "MilliA-HR": "mAh",
}  # fmt: skip
_PART = re.compile(rf"({'|'.join(_PREFIXES)})?([A-Z][A-Z_]*)([2-9])?")
_POWERS = dict(zip("23456789", "²³⁴⁵⁶⁷⁸⁹", strict=True))


@lru_cache(maxsize=4096)
def symbol_of(iri: str) -> str:
    """Return the symbol of a QUDT unit; the local name of the IRI if the unit is unknown."""
    if not iri.startswith(UNIT):
        return re.split(r"[#/:]", iri.rstrip("#/:"))[-1] or iri
    name = iri.removeprefix(UNIT)
    if name in _WHOLE:
        return _WHOLE[name]
    above, _, below = name.partition("PER-")
    over, under = _product(above.strip("-")), _product(below)
    if over is None or under is None:
        return name
    return f"{over or '1'}/{f'({under})' if '·' in under else under}" if under else over


def _product(text: str) -> str | None:
    """Return the symbol of a product of units; None if one is unknown."""
    found = [_symbol(each) for each in text.split("-")] if text else []
    return "·".join(each for each in found if each) if None not in found else None


def _symbol(text: str) -> str | None:
    match = _PART.fullmatch(text)
    if match is None or match[2] not in _SYMBOLS:
        return None
    return f"{_PREFIXES.get(match[1] or '', '')}{_SYMBOLS[match[2]]}{_POWERS.get(match[3] or '', '')}"
