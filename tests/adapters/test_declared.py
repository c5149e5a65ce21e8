"""Declarations of parameters by nodes: matching types of values, ranges and their steps."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.model import ParameterType, ParameterValue, Range, coerce

FITS: list[tuple[ParameterValue, ParameterType, ParameterValue]] = [
    (True, ParameterType.BOOLEAN, True),
    (1, ParameterType.DOUBLE, 1.0),
    (2.0, ParameterType.INTEGER, 2),
    (10**400, ParameterType.INTEGER, 10**400),
    (b"\x01", ParameterType.BYTE_ARRAY, b"\x01"),
    ([], ParameterType.BYTE_ARRAY, b""),
    ([], ParameterType.STRING_ARRAY, []),
    ([1, 2.5], ParameterType.DOUBLE_ARRAY, [1.0, 2.5]),
    ([1.0, 2], ParameterType.INTEGER_ARRAY, [1, 2]),
]
MISFITS: list[tuple[ParameterValue, ParameterType, ParameterValue]] = [
    (1, ParameterType.BOOLEAN),
    (True, ParameterType.INTEGER),
    (2.5, ParameterType.INTEGER),
    (math.inf, ParameterType.INTEGER),
    (10**400, ParameterType.DOUBLE),
    (1, ParameterType.STRING),
    ("AQ==", ParameterType.BYTE_ARRAY),
    ([1], ParameterType.BYTE_ARRAY),
    ([1, "two"], ParameterType.INTEGER_ARRAY),
    ({"a": 1}, ParameterType.INTEGER),
    ({}, ParameterType.STRING_ARRAY),
]


def test_a_value_fits_a_type_that_can_hold_it_and_none_that_would_change_it() -> None:
    for value, type, fit in FITS:
        found = coerce(value, type)
        assert (found, _types(found)) == (fit, _types(fit))
    for value, type in MISFITS:
        assert coerce(value, type) is None, value


def _types(value: object) -> object:
    return [type(each) for each in value] if isinstance(value, list) else type(value)


@given(st.integers(), st.integers(0, 10**6), st.integers(1, 2**64 - 1), st.integers(-(2**65), 2**65))
def test_whole_numbers_are_on_a_step_where_counting_from_the_least_comes_to_them(
    least: int, length: int, step: int, value: int
) -> None:
    bounds = Range(least, least + length, step)
    assert bounds.is_on_step(least)
    assert bounds.is_on_step(least + length)
    assert bounds.is_on_step(least + step)
    assert bounds.is_on_step(value) is (value in (least, least + length) or (value - least) % step == 0)


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e3), st.integers(0, 1000))
def test_doubles_are_on_a_step_however_they_were_reckoned(least: float, step: float, times: int) -> None:
    bounds = Range(least, least + 2000 * step, step)
    summed = least
    for _ in range(times):
        summed += step
    assert bounds.is_on_step(summed)
    assert bounds.is_on_step(least + times * step)
    assert not any(Range(0.0, 1.0, 0.1).is_on_step(value) for value in (0.05, 0.249, 0.95))


@given(st.floats(allow_nan=True), st.floats(allow_nan=False), st.floats(allow_nan=False), st.floats(min_value=5e-324))
def test_no_number_upsets_a_range(value: float, one: float, other: float, step: float) -> None:
    bounds = Range(min(one, other), max(one, other), step if math.isfinite(step) else None)
    if bounds.contains(value):
        assert bounds.is_on_step(value) in (True, False)
    assert not bounds.contains(math.nan)
