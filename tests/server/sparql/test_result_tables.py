"""Query results as tables: a column has a type if all of its values have one datatype, else it is text."""

from __future__ import annotations

import io
from datetime import date
from decimal import Decimal
from typing import Any

import pyarrow as pa
import pytest
from pyoxigraph import QueryResultsFormat, Store

from rosld.server.sparql.result_tables import table_of_results

NANOSECONDS = pa.timestamp("ns", "UTC")


def table(query: str) -> pa.Table:
    """Return the table of the results of a query of an empty store, written by it."""
    written = io.BytesIO()
    results: Any = Store().query("PREFIX xsd: <http://www.w3.org/2001/XMLSchema#> " + query)
    results.serialize(written, QueryResultsFormat.JSON)
    return table_of_results(written.getvalue())


@pytest.mark.parametrize(
    ("values", "type", "expected"),
    [
        ("1 2 UNDEF", pa.int64(), [1, 2, None]),
        ('1 "-7"^^xsd:byte', pa.int64(), [1, -7]),
        ("18446744073709551615 1", pa.string(), ["18446744073709551615", "1"]),
        ('1e0 "INF"^^xsd:double', pa.float64(), [1.0, float("inf")]),
        ('"0.5"^^xsd:float', pa.float32(), [0.5]),
        ("1.50 -20.25", pa.decimal128(4, 2), [Decimal("1.50"), Decimal("-20.25")]),
        ("true false", pa.bool_(), [True, False]),
        ("1 1.5", pa.string(), ["1", "1.5"]),
        ("<http://a/> 1", pa.string(), ["http://a/", "1"]),
        ("'a' 'b'@en", pa.string(), ["a", "b"]),
        ("'1x'^^xsd:integer", pa.string(), ["1x"]),
        ("'2026-01-02'^^xsd:date", pa.date32(), [date(2026, 1, 2)]),
        ("'2026-01-02T03:04:05'^^xsd:dateTime", pa.string(), ["2026-01-02T03:04:05"]),
        ("UNDEF", pa.string(), [None]),
    ],
)
def test_columns_have_the_type_of_their_values(values: str, type: pa.DataType, expected: list[Any]) -> None:
    column = table(f"SELECT ?v {{ VALUES ?v {{ {values} }} }}")["v"]
    assert (column.type, column.to_pylist()) == (type, expected)


def test_times_have_nanoseconds() -> None:
    found = table(
        "SELECT * { VALUES (?at ?long) {"
        "('2023-11-14T22:13:20.000000005Z'^^xsd:dateTime '-P1DT2H0.5S'^^xsd:dayTimeDuration)"
        "('2023-11-15T00:13:20+02:00'^^xsd:dateTime 'PT0S'^^xsd:dayTimeDuration) } }"
    )
    assert [found["at"].type, found["long"].type] == [NANOSECONDS, pa.duration("ns")]
    assert found["at"].cast(pa.int64()).to_pylist() == [1_700_000_000_000_000_005, 1_700_000_000_000_000_000]
    assert found["long"].cast(pa.int64()).to_pylist() == [-93_600_500_000_000, 0]
    assert found.schema.field("at").metadata == {b"datatype": b"http://www.w3.org/2001/XMLSchema#dateTime"}


def test_no_rows_and_a_boolean_are_tables_too() -> None:
    assert table("SELECT ?a ?b { FILTER(false) }").schema.names == ["a", "b"]
    assert table("ASK {}").to_pydict() == {"_askResult": [True]}
