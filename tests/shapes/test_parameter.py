"""Values that do not fit the declaration of a parameter; `tests/server/test_declared_parameters.py` has others."""

from __future__ import annotations

import pytest

from rosld.adapters.model import Descriptor, ParameterType, ParameterValue, Range
from rosld.ontology.urls import Space
from rosld.ontology.vocab import ros
from rosld.shapes.parameter import constraint_url, declared_triples, violations

SPACE = Space("http://127.0.0.1:8080/")
NAME = "/driver/frequency"
URL = SPACE.parameter(NAME)
GAIN = Descriptor(ParameterType.DOUBLE, range=Range(0.0, 1.0, 0.1))


@pytest.mark.parametrize("descriptor", [Descriptor(dynamic_typing=True), Descriptor(read_only=True)])
def test_a_parameter_whose_type_may_change_has_no_shape(descriptor: Descriptor) -> None:
    assert constraint_url(URL, descriptor) is None
    assert {each.predicate for each in declared_triples(descriptor, URL, SPACE)} == {ros.readOnly}
    assert violations(descriptor, NAME, URL, "anything") == ()


@pytest.mark.parametrize(
    ("descriptor", "value", "words"),
    [
        (GAIN, float("nan"), "must be at least 0.0, not NaN"),
        (GAIN, 0.25, "must be on a step (0.0 and steps of 0.1 from there, up to 1.0), which 0.25 is not"),
        (Descriptor(ParameterType.INTEGER), 2**63, f"must be at most {2**63 - 1}, not {2**63}"),
        (Descriptor(ParameterType.INTEGER_ARRAY), [1, 2.5], "is declared as integer array, which [1,2.5] is not"),
    ],
)
def test_what_does_not_fit_is_told_with_the_value_and_the_bound(
    descriptor: Descriptor, value: ParameterValue, words: str
) -> None:
    assert tuple(each.message for each in violations(descriptor, NAME, URL, value)) == (words,)
