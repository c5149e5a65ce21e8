"""Descriptors of parameters with any content."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from rosld.adapters.model import Descriptor, ParameterType, Range
from rosld.adapters.parameter_messages import descriptor_of

EMPTY = {
    "type": 0,
    "description": "",
    "additional_constraints": "",
    "read_only": False,
    "dynamic_typing": False,
    "integer_range": [],
    "floating_point_range": [],
}


def message(**fields: Any) -> Any:
    return SimpleNamespace(**EMPTY | fields)


def between(least: float, greatest: float, step: float = 0) -> list[Any]:
    return [SimpleNamespace(from_value=least, to_value=greatest, step=step)]


def test_of_two_ranges_the_one_of_the_type_holds() -> None:
    both = {"integer_range": between(1, 2), "floating_point_range": between(0.5, 1.5, 0.5)}
    assert descriptor_of(message(type=3, **both)) == Descriptor(ParameterType.DOUBLE, range=Range(0.5, 1.5, 0.5))
    assert descriptor_of(message(type=4, **both)) == Descriptor(ParameterType.STRING)
    assert descriptor_of(message(type=2, dynamic_typing=True, **both)) == Descriptor(dynamic_typing=True)


def test_a_range_is_in_order_whatever_was_declared() -> None:
    for given, range in (
        (between(1.0, 0.0, -0.5), Range(0.0, 1.0, 0.5)),
        (between(0.0, 1.0, float("nan")), Range(0.0, 1.0)),
        (between(0.0, 1.0, float("inf")), Range(0.0, 1.0)),
        (between(float("nan"), 1.0), None),
        (between(float("-inf"), 1.0), Range(float("-inf"), 1.0)),
    ):
        found = descriptor_of(message(type=3, floating_point_range=given))
        assert found is not None
        assert found.range == range


def test_endless_words_have_an_end_and_all_are_unicode() -> None:
    found = descriptor_of(message(description="x" * 10**6, additional_constraints="\udce9"))
    assert found is not None
    assert len(found.description) < 5000
    assert found.constraints == "?"
