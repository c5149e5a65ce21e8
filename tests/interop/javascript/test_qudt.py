"""QUDT's vocabulary, as published by qudtlib, has the units and quantity kinds that rosld names, and their factors."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from typing import Any

import pytest

from rosld.ontology.modules import module_triples
from rosld.ontology.units import _BY_SUFFIX, _BY_WORD, KIND, UNIT, Quantity, _factors
from rosld.ontology.vocab import qudt
from tests.interop.javascript.node import node

PATIENCE = 200.0
GAPS = {("FRACTION", "RelativeHumidity"), ("REV-PER-MIN", "AngularVelocity")}
"""A relative humidity from 0 to 1, for which QUDT has percent alone, and revolutions, which are frequencies there."""
OF_OTHER_KINDS = {"REV-PER-MIN", "REV-PER-SEC", "GAL_US", "KiloBIT", "MegaBIT", "BYTE-PER-SEC", "MegaBYTE-PER-SEC"}
"""Units that QUDT does not list for the quantity kind of their dimension."""


@pytest.fixture(scope="module")
def vocabulary() -> Mapping[str, Mapping[str, Any]]:
    command = node("qudt.mjs")
    return json.loads(subprocess.run(command, capture_output=True, timeout=PATIENCE, check=True).stdout)


def test_every_quantity_of_a_field_or_of_a_convention_is_one_of_qudt(
    vocabulary: Mapping[str, Mapping[str, Any]],
) -> None:
    stated: dict[object, dict[object, str]] = {}
    for subject, predicate, value in module_triples("units"):
        if predicate in (qudt.hasUnit, qudt.hasQuantityKind):
            stated.setdefault(subject, {})[predicate] = value.value
    quantities = {Quantity(each[qudt.hasUnit], each[qudt.hasQuantityKind]) for each in stated.values()}
    quantities |= {*_BY_SUFFIX.values(), *_BY_WORD.values()}
    assert len(quantities) > 50
    for quantity in quantities:
        unit, kind = (quantity.unit or "").removeprefix(UNIT), (quantity.kind or "").removeprefix(KIND)
        assert unit in vocabulary["units"]
        assert kind in vocabulary["kinds"]
        has_unit = unit in vocabulary["kinds"][kind] or kind in vocabulary["units"][unit]["kinds"]
        assert has_unit != ((unit, kind) in GAPS), quantity


def test_the_factors_are_those_of_qudt(vocabulary: Mapping[str, Mapping[str, Any]]) -> None:
    """Angles and bits have more digits here than there."""
    dimensions: dict[str, set[str]] = {}
    for iri, factor in _factors().items():
        name = iri.removeprefix(UNIT)
        unit = vocabulary["units"][name]
        assert float(factor.multiplier) == pytest.approx(float(unit["multiplier"]), rel=1e-7), name
        assert float(factor.offset) == pytest.approx(float(unit["offset"])), name
        has_unit = name in vocabulary["kinds"][factor.kind] or factor.kind in unit["kinds"]
        assert has_unit != (name in OF_OTHER_KINDS), name
        dimensions.setdefault(factor.kind, set()).add(unit["dimension"])
    assert {kind: found for kind, found in dimensions.items() if len(found) > 1} == {}
