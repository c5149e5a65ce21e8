"""Functions of numbers and times, and aggregates, in queries over HTTP: numpy is the judge of statistics."""

from __future__ import annotations

import csv
import io
import math

import httpx
import numpy as np
import pytest

NUMBERS = (3.5, -1.0, 7.25, 7.25, 0.125, 1e6, 12.0)
EXPRESSIONS = {
    "math:sqrt(2)": math.sqrt(2),
    "math:sqrt(-1)": math.nan,
    "math:pow(2, 0.5)": 2**0.5,
    "math:pow(0, -1)": math.inf,
    "math:atan2(1, -1)": math.atan2(1, -1),
    "math:exp(1000)": math.inf,
    "math:exp10(3)": 1000,
    "math:log(0)": -math.inf,
    'math:log10("100"^^xsd:unsignedByte)': 2,
    "math:sin(math:pi())": math.sin(math.pi),
    'ros:seconds("-P1DT2H0.25S"^^xsd:dayTimeDuration)': -93600.25,
    'ros:seconds("1969-12-31T23:59:59.5Z"^^xsd:dateTime)': -0.5,
    'ros:seconds("1970-01-01T01:00:00+01:00"^^xsd:dateTime)': 0,
    'ros:seconds("2026-01-01T00:00:00.1Z"^^xsd:dateTime - "2026-01-01T00:00:00Z"^^xsd:dateTime)': 0.1,
}
ERRORS = ('math:sqrt("4")', "math:pow(2)", "ros:seconds(1)", 'ros:seconds("P1M"^^xsd:duration)', "ros:floor(1, 1)")


def answer(http: httpx.Client, query: str) -> list[str]:
    """Return the only row of an answer."""
    found = http.post("/sparql", data={"query": query}, headers={"Accept": "text/csv"})
    assert found.status_code == 200, found.text
    return list(csv.reader(io.StringIO(found.text)))[1]


def test_functions_have_the_values_of_xpath(http: httpx.Client) -> None:
    for expression, expected in EXPRESSIONS.items():
        [found] = answer(http, f"SELECT ({expression} AS ?x) {{}}")
        assert float(found) == pytest.approx(expected, nan_ok=True), expression
    for expression in ERRORS:
        assert answer(http, f"SELECT ({expression} AS ?x) (1 AS ?y) {{}}") == ["", "1"], expression


def test_a_time_has_a_window_counted_in_utc(http: httpx.Client) -> None:
    for time, length, begin in (
        ("2026-01-01T00:00:07.25+01:00", "PT0.5S", "2025-12-31T23:00:07Z"),
        ("2026-01-01T00:00:07.123456789Z", "PT0.001S", "2026-01-01T00:00:07.123Z"),
        ("1969-12-31T23:59:59Z", "PT1M", "1969-12-31T23:59:00Z"),
    ):
        window = f'ros:floor("{time}"^^xsd:dateTime, "{length}"^^xsd:dayTimeDuration)'
        assert answer(http, f"SELECT ({window} AS ?x) {{}}") == [begin]


def test_aggregates_are_those_of_numpy_and_leave_out_nan(http: httpx.Client) -> None:
    aggregates = "(ros:stdev(?x) AS ?a) (ros:variance(?x) AS ?b) (ros:median(?x) AS ?c) "
    aggregates += "(ros:percentile(?x, 95) AS ?e) (ros:percentile(?x, 0) AS ?f)"
    values = " ".join(map(str, (*NUMBERS, '"NaN"^^xsd:double', '"3"^^xsd:short')))
    numbers = np.array([*NUMBERS, 3.0])
    expected = [
        numbers.std(ddof=1), numbers.var(ddof=1), np.median(numbers),
        np.percentile(numbers, 95), numbers.min(),
    ]  # fmt: skip
    found = answer(http, f"SELECT {aggregates} {{ VALUES ?x {{ {values} }} }}")
    assert list(map(float, found)) == pytest.approx(expected)
    assert answer(http, f'SELECT (1 AS ?n) {aggregates} {{ VALUES ?x {{ 1 "two" }} }}') == ["1", *[""] * 5]
