"""Results over HTTP: functions, values that look like rows, and large results."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable
from random import Random
from typing import Any

import httpx
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
        ("SELECT (<h:f>(1) AS ?x) {}", [[""]]),
        ("SELECT (COALESCE(<h:f>(1), 2) AS ?x) {}", [["2"]]),
        ("SELECT ?x { VALUES ?x { 1 2 } FILTER(<h:f>(?x) || ?x = 2) }", [["2"]]),
        ("SELECT ?x { VALUES ?x { 1 2 } FILTER(<h:f>(?x)) }", []),
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
    ("length({})", "[]"): "0",
    ("at({}, 1)", "[1,2.5,3]"): "2.5",
    ("at({}, 2)", "[1,2,3]"): "3",
    ("at({}, 1)", "[true,false]"): "false",
    ("at({}, 0)", '["NaN",1.5]'): math.nan,
    ("at({}, 0)", '["-INF",1.5]'): -math.inf,
    ("at({}, 0)", '["18446744073709551615"]'): "18446744073709551615",
    ("at({}, 1)", '["a","NaN"]'): "NaN",
    ("at({}, 0)", '[{"@type":"http://h/t","@value":"/w=="}]'): "/w==",
    ("min({})", "[3,1,2]"): "1",
    ("max({})", '[3,1.5,"INF","NaN"]'): math.inf,
    ("min({})", '[3.5,"NaN",2.5]'): 2.5,
    ("mean({})", '[1,2,"NaN",6]'): 3.0,
    ("mean({})", '["INF","-INF"]'): math.nan,
    ("max({})", '["NaN"]'): math.nan,
    ("mean({})", "[]"): math.nan,
    **dict.fromkeys([("at({}, 1)", "[1]"), ("at({}, -1)", "[1]"), ("at({}, 'x')", "[1]"), ("at({}, 0.5)", "[1]")], ""),
    **dict.fromkeys([("at({}, 0)", "[[1]]"), ("at({})", "[1]"), ("length({})", "{}"), ("length({})", "[1")], ""),
    **dict.fromkeys([("max({})", '["a"]'), ("mean({})", "[true]"), ("min({})", "[null]"), ("max({})", "\\ud800")], ""),
    ("convert(90, unit:KiloM-PER-HR, unit:M-PER-SEC)", ""): 25.0,
    ("convert('20.5'^^xsd:float, unit:DEG_C, unit:K)", ""): 293.65,
    ("convert('INF'^^xsd:double, unit:M, unit:FT)", ""): math.inf,
    **dict.fromkeys(
        [(f"convert({each})", "") for each in ("1", "1, unit:M", "'1', unit:M, unit:FT", "1, 'M', unit:FT")], ""
    ),
    **dict.fromkeys(
        [(f"convert(1, {each})", "") for each in ("unit:M, unit:SEC", "unit:N-M, unit:J", "<h:x>, unit:M")], ""
    ),
    ("length('[1]')", ""): "",
    ("max(<http://h/>)", ""): "",
    ("age('x')", ""): "",
    ("age()", ""): "",
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
    "?m <geometry_msgs/msg/Vector3#z> ?v": ("unit:DEG-PER-SEC", None),
    "?m <geometry_msgs/msg/Twist#linear>/<geometry_msgs/msg/Vector3#z> ?v "
    "OPTIONAL { ?p <control_msgs/msg/AdmittanceControllerState#admittance_acceleration> ?m }": (
        "unit:FT-PER-SEC",
        None,
    ),
    "?m <geometry_msgs/msg/Point#x>|<geometry_msgs/msg/Quaternion#x> ?v": ("unit:FT", None),
}
"""Patterns that bind a number to fields, a unit, and the factor from the unit of the fields (None: they have none)."""


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
