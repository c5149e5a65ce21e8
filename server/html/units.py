"""Units as people write them: QUDT's `M-PER-SEC2` is m/s²."""

from __future__ import annotations

import re
from functools import lru_cache

from rosld.server.html.labels import local_name

QUDT = "http://qudt.org/vocab/unit/"

_SYMBOLS = {
    "A": "A", "ARCMIN": "′", "ARCSEC": "″", "BAR": "bar", "BIT": "bit", "BYTE": "B", "C": "C",
    "CD": "cd", "DAY": "d", "DEG": "°", "DEG_C": "°C", "DEG_F": "°F", "EV": "eV", "F": "F", "FT": "ft", "GAUSS": "G",
    "GM": "g", "H": "H", "HR": "h", "HZ": "Hz", "IN": "in", "J": "J", "K": "K", "KN": "kn", "L": "L",
    "LM": "lm", "LUX": "lx", "M": "m", "MI": "mi", "MIN": "min", "MOL": "mol", "N": "N", "OHM": "Ω", "PA": "Pa",
    "PERCENT": "%", "PSI": "psi", "RAD": "rad", "REV": "rev", "S": "S", "SEC": "s", "SR": "sr", "T": "T", "V": "V",
    "W": "W", "WB": "Wb",
}  # fmt: skip
_PREFIXES = {
    "Tera": "T", "Giga": "G", "Mega": "M", "Kilo": "k", "Hecto": "h", "Deca": "da", "Deci": "d", "Centi": "c",
    "Milli": "m", "Micro": "µ", "Nano": "n", "Pico": "p",
}  # fmt: skip
_WHOLE = {"REV-PER-MIN": "rpm", "UNITLESS": "", "NUM": "", "W-HR": "Wh", "KiloW-HR": "kWh"}
_PART = re.compile(rf"({'|'.join(_PREFIXES)})?([A-Z][A-Z_]*)([2-9])?")
_POWERS = dict(zip("23456789", "²³⁴⁵⁶⁷⁸⁹", strict=True))


@lru_cache(maxsize=1024)
def unit_symbol(iri: str) -> str:
    """The symbol of a unit of QUDT; the last part of the IRI for one that is not known here."""
    name = local_name(iri)
    if not iri.startswith(QUDT):
        return name
    if name in _WHOLE:
        return _WHOLE[name]
    above, _, below = name.partition("PER-")
    over, under = _product(above.strip("-")), _product(below)
    if over is None or under is None:
        return name
    return f"{over or '1'}/{f'({under})' if '·' in under else under}" if under else over


def _product(text: str) -> str | None:
    """The symbols of units multiplied; None where one is not known."""
    found = [_symbol(each) for each in text.split("-")] if text else []
    return "·".join(each for each in found if each) if None not in found else None


def _symbol(text: str) -> str | None:
    match = _PART.fullmatch(text)
    if match is None or match[2] not in _SYMBOLS:
        return None
    return f"{_PREFIXES.get(match[1] or '', '')}{_SYMBOLS[match[2]]}{_POWERS.get(match[3] or '', '')}"
