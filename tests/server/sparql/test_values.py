"""Values in queries over HTTP: filters find the values that pyoxigraph finds, and order is by value."""

from __future__ import annotations

import csv
import io
from itertools import count
from random import Random

import httpx
import pyoxigraph
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import QueryResultsFormat, QuerySolutions, parse_query_results

pytestmark = pytest.mark.slow

XSD = "http://www.w3.org/2001/XMLSchema#"
P = "<urn:p>"
TURNS = count()


def typed(value: str, name: str) -> str:
    return f'"{value}"^^<{XSD}{name}>'


WHOLE, NUMBERS = ("0", "1", "007", "-3", "100", "9007199254740993"), ("+2.50", "2.5", "1e0", "NaN", "INF")
MOMENTS = ("2020-01-01T00:00:00Z", "2020-01-01T01:00:00+01:00", "2020-01-01T01:00:00.0Z", "2020-01-01T01:00:00")
LITERALS = [
    *(typed(value, name) for value in WHOLE for name in ("integer", "byte", "unsignedInt")),
    *(typed(value, name) for value in (*WHOLE, *NUMBERS) for name in ("decimal", "double", "float")),
    *(typed(value, "boolean") for value in ("true", "false", "1", "0")),
    *(typed(value, "dateTime") for value in (*MOMENTS, "2020-99-01T00:00:00Z")),
    *(typed("2020-01-01", "date"), typed("2020-01-01+00:00", "date"), typed("PT60S", "duration")),
    *(typed("many", "integer"), '""', '"2"', '"x"', '"x"@en', "<urn:x>", '"x"^^<urn:own>', "_:blank"),
]
"""Terms with equal and different values, canonical and other lexical forms, and ill-typed ones."""
CONSTANTS = st.sampled_from(
    ["1", "2.5", "1e0", "007", "true", "'x'", "'x'@en", "<urn:x>", "'2020-01-01T01:00:00Z'^^xsd:dateTime", "?w", "?v"]
)
OPERATORS = st.sampled_from(["=", "!=", "<", ">", "<=", ">="])
FUNCTIONS = st.sampled_from(["ABS", "CEIL", "ROUND", "YEAR", "xsd:integer", "xsd:double", "-"])
VALUES = st.recursive(
    CONSTANTS,
    lambda inner: st.one_of(
        st.builds("({} {} {})".format, inner, st.sampled_from("+-*/"), inner),
        st.builds("IF({}, {}, {})".format, inner, inner, inner),
        st.builds("COALESCE({}, {})".format, inner, inner),
        st.builds("{}({})".format, FUNCTIONS, inner),
    ),
    max_leaves=4,
)
TESTS = st.recursive(
    st.one_of(
        st.builds("{} {} {}".format, VALUES, OPERATORS, VALUES),
        st.builds("{} {} ({}, {})".format, VALUES, st.sampled_from(["IN", "NOT IN"]), VALUES, VALUES),
        st.builds("{}(?v)".format, st.sampled_from(["isNumeric", "isLiteral", "isIRI", "BOUND"])),
        st.sampled_from(["?v", "?w", "EXISTS { ?v2 <urn:p> ?v3 FILTER(?v3 = ?v) }", "CONTAINS(?v, 'x')"]),
    ),
    lambda inner: st.one_of(
        st.builds("({}) && ({})".format, inner, inner),
        st.builds("({}) || ({})".format, inner, inner),
        st.builds("!({})".format, inner),
    ),
    max_leaves=4,
)


def put(http: httpx.Client, lines: list[str]) -> str:
    """Put a new graph; return its path."""
    path = f"data/values{next(TURNS)}"
    headers = {"Content-Type": "text/turtle"}
    assert http.put(path, content="\n".join(lines), headers=headers).status_code == 201
    return path


@pytest.fixture(scope="module")
def judged(http: httpx.Client) -> tuple[str, pyoxigraph.Store]:
    """Return a graph with one literal per subject, some of them twice, and a pyoxigraph store with the same."""
    lines = [f"<urn:s{at}> {P} {literal} ." for at, literal in enumerate(LITERALS)]
    lines += [f"<urn:s{at}> <urn:q> {literal} ." for at, literal in enumerate(LITERALS) if at % 5 == 0]
    plain = pyoxigraph.Store()
    plain.update(f"INSERT DATA {{ {' '.join(lines)} }}")
    return put(http, lines), plain


def rows(found: object) -> list[str]:
    assert isinstance(found, QuerySolutions)
    return sorted(",".join(map(str, row)) for row in found)


def select(http: httpx.Client, query: str, graph: str) -> QuerySolutions:
    answer = http.post("/sparql", data={"query": query, "default-graph-uri": str(http.base_url.join(graph))})
    assert answer.status_code == 200, (query, answer.text)
    found = parse_query_results(answer.content, QueryResultsFormat.JSON)
    assert isinstance(found, QuerySolutions)
    return found


@given(TESTS, VALUES)
@settings(max_examples=30)
def test_filters_and_expressions_come_to_what_they_do_by_value(
    http: httpx.Client, judged: tuple[str, pyoxigraph.Store], test: str, value: str
) -> None:
    graph, plain = judged
    for query in (
        f"SELECT ?s ?t {{ ?s {P} ?v . ?t <urn:q> ?w FILTER({test}) }}",
        f"SELECT ?s (({value}) = 1 AS ?a) (!({test}) AS ?b) {{ ?s {P} ?v BIND(?v AS ?w) }}",
    ):
        expected = rows(plain.query(query, prefixes={"xsd": XSD}))
        assert rows(select(http, query, graph)) == expected


ORDERED = [
    "_:a", "<urn:a>", "<urn:b>",
    typed("-INF", "double"), typed("-9007199254740993", "integer"), typed("-9007199254740992", "integer"),
    typed("-1.5", "decimal"), typed("0", "integer"), typed("5e-324", "double"), typed("0.1", "decimal"),
    typed("9007199254740992", "double"), typed("9007199254740993", "long"),
    typed("1e300", "double"), typed("INF", "float"), typed("NaN", "double"),
    '""', '"A"', '"a"', '"a"@de', '"a"@en', '"\U0001f600"',
    typed("-0044-03-15T12:00:00Z", "dateTime"), typed("1969-12-31T23:59:59.999", "dateTime"),
    typed("1970-01-01T01:00:00+01:00", "dateTime"), typed("1970-01-01T00:00:00.001Z", "dateTime"),
    typed("12000-01-01T00:00:00Z", "dateTime"), typed("false", "boolean"), typed("true", "boolean"),
    typed("2019", "gYear"), typed("2020-02-29", "date"), typed("2020-03-01", "date"),
    typed("-P1D", "duration"), typed("-PT1.5S", "duration"), typed("-PT1.25S", "duration"), typed("PT0S", "duration"),
    typed("P1M", "duration"), typed("P1Y", "yearMonthDuration"), typed("a", "hexBinary"), typed("b", "hexBinary"),
]  # fmt: skip
EQUAL = [
    (typed("7", "unsignedByte"), typed("007.0", "decimal")),
    (typed("0", "integer"), typed("-0.0", "double")),
    (typed("2020-01-01T00:00:00Z", "dateTime"), typed("2020-01-01T02:00:00.000+02:00", "dateTime")),
    (typed("PT60S", "duration"), typed("PT1M", "dayTimeDuration")),
    (typed("1", "boolean"), typed("true", "boolean")),
]


def test_solutions_are_in_the_order_of_values_whatever_their_kind(http: httpx.Client) -> None:
    """docs/reference/sparql.md: blank nodes, IRIs, numbers, text, times, booleans, all other literals."""
    mixed = Random(0).sample(list(enumerate(ORDERED)), len(ORDERED))
    graph = put(http, [f"<urn:s{at:03}> {P} {literal} ." for at, literal in mixed])
    expected = [f"<urn:s{at:03}>" for at in range(len(ORDERED))]
    for direction, order in (("?o", expected), ("DESC(?o)", expected[::-1])):
        found = select(http, f"SELECT ?s {{ ?s {P} ?o }} ORDER BY {direction}", graph)
        assert [str(row["s"]) for row in found] == order
    [row] = select(http, f"SELECT (MIN(?o) AS ?least) (MAX(?o) AS ?most) {{ ?s {P} ?o FILTER(isLiteral(?o)) }}", graph)
    assert (str(row["least"]), str(row["most"])) == (ORDERED[3], ORDERED[-1])


def test_terms_of_one_value_are_ordered_by_what_comes_next(http: httpx.Client) -> None:
    names = [f"<urn:s{at}{turn}>" for at in range(len(EQUAL)) for turn in range(4)]
    terms = [term for pair in EQUAL for term in (*pair, *pair)]
    lines = [f"{name} {P} {term} .\n{name} <urn:pair> '{name[6]}' ." for name, term in zip(names, terms, strict=True)]
    graph = put(http, lines)
    found = select(http, f"SELECT ?s {{ ?s {P} ?o ; <urn:pair> ?pair }} ORDER BY ?pair ?o ?s", graph)
    assert [str(row["s"]) for row in found] == names


def test_literals_without_a_value_can_be_ordered_too(http: httpx.Client) -> None:
    names = ("integer", "decimal", "double", "float", "dateTime", "duration", "boolean", "gYear")
    forms = ("", "-", "9" * 10_000, f"-PT1.{'9' * 10_000}S", "1e999999999", "1_0", "nan", "\ud7ff")
    lines = [f"<urn:s> {P} {typed(form, name)} ." for name in names for form in forms]
    answer = http.get(
        "/sparql",
        params={"query": f"SELECT ?o {{ GRAPH <{put(http, lines)}> {{ ?s {P} ?o }} }} ORDER BY ?o"},
        headers={"Accept": "text/csv"},
    )
    csv.field_size_limit(10**6)
    assert len(list(csv.reader(io.StringIO(answer.text)))) == len(lines) + 1
