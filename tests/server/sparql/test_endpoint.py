"""The endpoint over HTTP: functions, values that look like rows, large results, and wrong uses of the protocol.

numpy is the judge of statistics. W3C's tests of the protocol are in `tests/conformance/sparql`.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable
from random import Random
from typing import Any
from urllib.parse import quote

import httpx
import numpy as np
import pytest

ROS, MAP = "https://w3id.org/rosld#", "https://w3id.org/rosld/mapping#"
FORMATS = {
    "json": "application/sparql-results+json",
    "xml": "application/sparql-results+xml",
    "csv": "text/csv",
    "tsv": "text/tab-separated-values",
}


def rows(http: httpx.Client, query: str) -> list[list[str]]:
    """Return the rows of a SELECT, without the heading."""
    answer = http.post("/sparql", data={"query": query}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, (query, answer.text)
    return list(csv.reader(io.StringIO(answer.text)))[1:]


@pytest.mark.parametrize(
    ("query", "found"),
    [
        ("SELECT (COALESCE(<h:f>(1), 2) AS ?x) {}", [["2"]]),
        ("SELECT ?x { VALUES ?x { 1 2 } FILTER(<h:f>(?x) || ?x = 2) }", [["2"]]),
        ("SELECT (xsd:byte('1') AS ?x) {}", [[""]]),
        ("SELECT (xsd:date('2026-11-23') AS ?x) {}", [["2026-11-23"]]),
    ],
)
def test_calling_an_unknown_function_is_an_error_of_its_expression(
    http: httpx.Client, query: str, found: list[list[str]]
) -> None:
    """SPARQL 1.1 Query, 17.2."""
    assert [row or [""] for row in rows(http, query)] == found


ARRAYS: dict[tuple[str, str], object] = {
    ("length({})", "[1,2.5,3]"): "3",
    ("at({}, 1)", "[1,2.5,3]"): "2.5",
    ("at({}, 1)", "[true,false]"): "false",
    ("at({}, 0)", '["NaN",1.5]'): math.nan,
    ("at({}, 0)", '["18446744073709551615"]'): "18446744073709551615",
    ("at({}, 1)", '["a","NaN"]'): "NaN",
    ("at({}, 0)", '[{"@type":"http://h/t","@value":"/w=="}]'): "/w==",
    ("max({})", '[3,1.5,"INF","NaN"]'): math.inf,
    ("min({})", '[3.5,"NaN",2.5]'): 2.5,
    ("mean({})", '[1,2,"NaN",6]'): 3.0,
    ("mean({})", '["INF","-INF"]'): math.nan,
    ("mean({})", "[]"): math.nan,
    **dict.fromkeys([("at({}, 1)", "[1]"), ("at({}, -1)", "[1]"), ("at({}, 'x')", "[1]"), ("at({}, 0.5)", "[1]")], ""),
    **dict.fromkeys([("at({}, 0)", "[[1]]"), ("at({})", "[1]"), ("length({})", "{}"), ("length({})", "[1")], ""),
    **dict.fromkeys([("max({})", '["a"]'), ("mean({})", "[true]"), ("min({})", "[null]"), ("max({})", "\\ud800")], ""),
    ("convert(90, unit:KiloM-PER-HR, unit:M-PER-SEC)", ""): 25.0,
    ("convert('20.5'^^xsd:float, unit:DEG_C, unit:K)", ""): 293.65,
    **dict.fromkeys(
        [(f"convert({each})", "") for each in ("1", "1, unit:M", "'1', unit:M, unit:FT", "1, 'M', unit:FT")], ""
    ),
    **dict.fromkeys(
        [(f"convert(1, {each})", "") for each in ("unit:M, unit:SEC", "unit:N-M, unit:J", "<h:x>, unit:M")], ""
    ),
    ("length('[1]')", ""): "",
    ("age('x')", ""): "",
    ("age(<http://elsewhere/topics/b>)", ""): "",
}
"""Calls of functions of ros: with an array, and their results: "" is an error."""


def test_arrays_are_read_and_what_is_none_is_an_error(http: httpx.Client) -> None:
    wrong = []
    for (call, array), expected in ARRAYS.items():
        written = array.replace("'", "\\'")
        [found] = rows(http, f"SELECT (ros:{call.format(f'{written!r}^^rdf:JSON')} AS ?x) {{}}") or [[""]]
        text = found[0] if found else ""
        same = text == expected if isinstance(expected, str) else text and str(float(text)) == str(expected)
        if not same:
            wrong.append((call, array, text))
    assert not wrong, wrong


def test_a_topic_has_one_age_within_a_query_and_another_in_the_next(http: httpx.Client) -> None:
    assert http.put("/topics/cockpit/display", json={"data": "now"}).is_success
    topic = "<topics/cockpit/display>"
    query = f"SELECT (ros:age({topic}) AS ?a) (ros:age({topic}) AS ?b) {{ VALUES ?x {{ 1 2 3 }} }}"
    ages = [{value for row in rows(http, query) for value in row} for _ in range(2)]
    (first,), (second,) = ages
    assert 0 <= float(first) < float(second)


FIELD = "https://w3id.org/rosld/types/"
CONVERTED = {
    "?m <sensor_msgs/msg/LaserScan#range_max> ?v": ("unit:CentiM", 100),
    "?m <geometry_msgs/msg/Twist#linear> ?t . ?t <geometry_msgs/msg/Vector3#x> ?v": ("unit:KiloM-PER-HR", 3.6),
    "?m <geometry_msgs/msg/Twist#angular>/<geometry_msgs/msg/Vector3#z> ?v": ("unit:DEG-PER-SEC", 180 / math.pi),
    "?m <geometry_msgs/msg/Twist#linear>/<geometry_msgs/msg/Vector3#z> ?v "
    "OPTIONAL { ?p <control_msgs/msg/AdmittanceControllerState#admittance_acceleration> ?m }": (
        "unit:FT-PER-SEC",
        None,
    ),
    "?m <geometry_msgs/msg/Point#x>|<geometry_msgs/msg/Quaternion#x> ?v": ("unit:FT", None),
}
"""Patterns that bind a number to fields, a unit, and the factor from the unit of the fields (None: they have none)."""


@pytest.mark.slow
@pytest.mark.parametrize("pattern", CONVERTED)
def test_a_number_is_converted_from_the_unit_of_the_field_that_binds_it(rover: httpx.Client, pattern: str) -> None:
    unit, factor = CONVERTED[pattern]
    where = pattern.replace("<", f"<{FIELD}")
    found = rows(rover, f"SELECT ?v (ros:convert(?v, {unit}) AS ?x) {{ {where} FILTER(isNumeric(?v)) }}")
    assert found
    for value, converted in found:
        assert converted == "" if factor is None else float(converted) == pytest.approx(float(value) * factor)


def test_a_number_is_converted_from_the_unit_that_the_dataset_states(rover: httpx.Client) -> None:
    field = f"<{FIELD}sensor_msgs/msg/BatteryState#voltage>"
    where = f"?s {field} ?v . {field} qudt:hasUnit ?u"
    [[volts, millivolts], *_] = rows(rover, f"SELECT ?v (ros:convert(?v, ?u, unit:MilliV) AS ?x) {{ {where} }}")
    assert float(millivolts) == pytest.approx(1000 * float(volts))


PIECES = ["{", "}", ",", '"', "\\", "\n", "\r", "{}", ",{", "},{", ",{}", "a", "<result>", '"bindings":[{', "\u00e9"]


@pytest.mark.slow
def test_rows_are_counted_in_every_format_whatever_values_hold(start_server: Callable[..., Any]) -> None:
    http: httpx.Client = start_server("aircraft", "--query-row-limit", "3000").http
    random = Random(0)
    texts = {"".join(random.choices(PIECES, k=random.randint(0, 8))) + str(number) for number in range(3000)}
    lines = []
    for text in texts:
        escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\r", "\\r")
        lines.append(f'<urn:s> <urn:p> "{escaped}" .\n')
    body = {"Content-Type": "application/n-triples"}
    for number, text in ((len(lines), "".join(lines)), (len(lines) + 1, "".join(lines) + "<urn:s> <urn:p> <urn:o> .")):
        assert http.put("/data/many", content=text, headers=body).is_success
        for name, media_type in FORMATS.items():
            query = {"query": "SELECT ?none ?o { <urn:s> <urn:p> ?o }", "format": name}
            if number > 3000:
                with pytest.raises((httpx.RemoteProtocolError, AssertionError)):
                    assert http.get("/sparql", params=query).status_code == 200
                continue
            answer = http.get("/sparql", params=query)
            assert (answer.status_code, answer.headers["content-type"].partition(";")[0]) == (200, media_type)
            if name == "json":
                found = {row["o"]["value"] for row in answer.json()["results"]["bindings"]}
                assert found == texts


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


def test_functions_have_the_values_of_xpath(http: httpx.Client) -> None:
    for expression, expected in EXPRESSIONS.items():
        [[found]] = rows(http, f"SELECT ({expression} AS ?x) {{}}")
        assert float(found) == pytest.approx(expected, nan_ok=True), expression
    for expression in ERRORS:
        assert rows(http, f"SELECT ({expression} AS ?x) (1 AS ?y) {{}}") == [["", "1"]], expression


def test_a_time_has_a_window_counted_in_utc(http: httpx.Client) -> None:
    for time, length, begin in (
        ("2026-01-01T00:00:07.25+01:00", "PT0.5S", "2025-12-31T23:00:07Z"),
        ("2026-01-01T00:00:07.123456789Z", "PT0.001S", "2026-01-01T00:00:07.123Z"),
        ("1969-12-31T23:59:59Z", "PT1M", "1969-12-31T23:59:00Z"),
    ):
        window = f'ros:floor("{time}"^^xsd:dateTime, "{length}"^^xsd:dayTimeDuration)'
        assert rows(http, f"SELECT ({window} AS ?x) {{}}") == [[begin]]


def test_aggregates_are_those_of_numpy_and_leave_out_nan(http: httpx.Client) -> None:
    aggregates = "(ros:stdev(?x) AS ?a) (ros:variance(?x) AS ?b) (ros:median(?x) AS ?c) "
    aggregates += "(ros:percentile(?x, 95) AS ?e) (ros:percentile(?x, 0) AS ?f)"
    values = " ".join(map(str, (*NUMBERS, '"NaN"^^xsd:double', '"3"^^xsd:short')))
    numbers = np.array([*NUMBERS, 3.0])
    expected = [
        numbers.std(ddof=1), numbers.var(ddof=1), np.median(numbers),
        np.percentile(numbers, 95), numbers.min(),
    ]  # fmt: skip
    [found] = rows(http, f"SELECT {aggregates} {{ VALUES ?x {{ {values} }} }}")
    assert list(map(float, found)) == pytest.approx(expected)
    assert rows(http, f'SELECT (1 AS ?n) {aggregates} {{ VALUES ?x {{ 1 "two" }} }}') == [["1", *[""] * 5]]


QUERY, UPDATE = "application/sparql-query", "application/sparql-update"
FORM = "application/x-www-form-urlencoded"
WITH = "CLEAR GRAPH <http://h/c> ; WITH <http://h/b> DELETE { ?s ?p 1 } WHERE { ?s ?p 1 }"
WRONG: list[tuple[str, str | None, bytes | None, int, str]] = [
    ("query=%FF", None, None, 400, "utf-8"),
    ("query=a&default-graph-uri=nowhere", None, None, 400, "nowhere"),
    ("query=a&named-graph-uri=http://h/%3E", None, None, 400, "not an absolute IRI"),
    ("&".join(["a=b"] * 2000), None, None, 400, "fields"),
    ("query=a&update=b", None, None, 400, "not in the URL"),
    ("query=a", FORM, b"query=a", 400, "one of them"),
    ("", FORM, b"", 400, "no query"),
    ("update=x", FORM, b"query=a", 400, "?update"),
    ("", f"{QUERY}; charset=klingon", b"x", 415, "UTF-8"),
    ("", "nonsense", b"x", 415, "nonsense"),
    ("using-graph-uri=nowhere", UPDATE, b"x", 400, "nowhere"),
    ("default-graph-uri=http://h/", UPDATE, b"x", 400, "using-graph-uri"),
    ("using-named-graph-uri=http://h/a", UPDATE, b"INSERT {} USINGNAMED<http://h/b> WHERE {}", 400, ""),
    ("using-graph-uri=http://h/a", UPDATE, WITH.encode(), 400, "WITH at 1:28"),
]


def send(http: httpx.Client, query: str, content_type: str | None, body: bytes | None) -> httpx.Response:
    headers = {} if content_type is None else {"Content-Type": content_type}
    url = f"/sparql?{query}"
    return http.get(url) if body is None else http.post(url, content=body, headers=headers)


def test_each_wrong_use_has_its_status_and_its_words(http: httpx.Client) -> None:
    wrong = []
    for query, content_type, body, status, words in WRONG:
        answer = send(http, query, content_type, body)
        if answer.status_code != status or words not in answer.json()["detail"]:
            wrong.append((query[:80], content_type, body, answer.status_code, answer.text))
    assert not wrong, wrong


def test_words_in_strings_names_and_comments_are_no_dataset(http: httpx.Client) -> None:
    inserted = "GRAPH <data/w> { ?using with:using 'WITH' }"
    text = f"PREFIX with: <http://h/> # USING\nINSERT {{ {inserted} }} WHERE {{ ?using ?p ?o }}"
    query = f"using-graph-uri={quote(str(http.base_url.join('data/nothing')))}"
    assert send(http, query, UPDATE, text.encode()).status_code == 204
