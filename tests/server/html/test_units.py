"""Units as people write them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rosld.server.html.labels import QUDT, unit_symbol

SYMBOLS = {
    "M-PER-SEC": "m/s", "M-PER-SEC2": "m/s²", "KiloM-PER-HR": "km/h", "RAD-PER-SEC": "rad/s", "REV-PER-MIN": "rpm",
    "N-M": "N·m", "KiloGM-M2": "kg·m²", "J-PER-KiloGM-K": "J/(kg·K)", "PER-SEC": "1/s", "DEG": "°", "DEG_C": "°C",
    "PERCENT": "%", "UNITLESS": "",
}  # fmt: skip
UNKNOWN = ("FURLONG-PER-FORTNIGHT", "M-PER-SEC-PER-SEC", "Kilo", "m-per-sec")


def test_a_unit_of_qudt_has_its_symbol_and_any_other_its_name() -> None:
    expected = SYMBOLS | {name: name for name in UNKNOWN}
    assert {name: unit_symbol(QUDT + name) for name in expected} == expected
    assert unit_symbol("http://www.ontology-of-units-of-measure.org/resource/om-2/metre") == "metre"


@given(st.text())
def test_no_name_is_too_strange(name: str) -> None:
    assert isinstance(unit_symbol(QUDT + name), str)
