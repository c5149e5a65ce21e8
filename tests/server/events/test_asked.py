"""Parameters of a request for changes."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.events import query_params
from rosld.server.http.problem import Problem

NO_RATES = ("", "0", "-1", "nan", "inf", "0x10", "10Hz", "١٠", "1_0", " 1", "1;2", "9" * 21, "0.0001", "%00")


def test_rates_and_timeouts_have_defaults_and_upper_bounds() -> None:
    rates = {"0.5": 0.5, "1000": 1000.0, "2e3": 1000.0, "9" * 20: 1000.0}
    assert {text: query_params.parse_rate({"rate": text}) for text in rates} == rates
    assert query_params.parse_rate({}) == 50.0
    timeouts = {"0": 0.0, "3600": 60.0}
    assert {text: query_params.parse_timeout({"timeout": text}) for text in timeouts} == timeouts
    assert query_params.parse_timeout({}) == 25.0


def test_a_rate_that_is_no_number_is_refused_with_the_range() -> None:
    for text in NO_RATES:
        with pytest.raises(Problem, match=r"from 0\.001 to 100") as refused:
            query_params.parse_rate({"rate": text})
        assert refused.value.status == 400


@given(st.text(max_size=30) | st.floats().map(str) | st.integers().map(str))
def test_any_text_is_refused_or_within_the_bounds(text: str) -> None:
    for read, name, least, most in (
        (query_params.parse_rate, "rate", 0.001, 1000.0),
        (query_params.parse_timeout, "timeout", 0.0, 60.0),
    ):
        with suppress(Problem):
            assert least <= read({name: text}) <= most
