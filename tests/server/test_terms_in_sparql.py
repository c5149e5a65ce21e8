"""SPARQL returns the terms of GET: original datatypes and lexical forms; and every order is total."""

from __future__ import annotations

import random
from itertools import count
from typing import Any

import httpx
import pytest
import rdflib
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, RdfFormat, Triple, parse

pytestmark = pytest.mark.slow

XSD = "http://www.w3.org/2001/XMLSchema#"
PREFIXES = f"PREFIX xsd: <{XSD}> "
P = "<urn:p>"
N_TRIPLES = {"Accept": "application/n-triples"}
TURNS = count()


def put(client: httpx.Client, *literals: str) -> str:
    """Create a resource with these values of <urn:p>; return its URL."""
    url = str(client.base_url.join(f"/data/terms{next(TURNS)}"))
    body = "".join(f"<{url}> {P} {literal} .\n" for literal in literals)
    answer = client.put(url, content=body.encode(), headers={"Content-Type": "application/n-triples"})
    assert answer.status_code == 201, answer.text
    return url


def rows(client: httpx.Client, query: str) -> list[tuple[str, ...]]:
    """Return the rows of a SELECT as N-Triples, unbound ones empty."""
    answer = client.post(
        "/sparql", data={"query": PREFIXES + query}, headers={"Accept": "application/sparql-results+json"}
    )
    assert answer.status_code == 200, answer.text
    found = answer.json()
    return [tuple(term(row.get(name)) for name in found["head"]["vars"]) for row in found["results"]["bindings"]]


def term(told: Any) -> str:
    """Return a term of JSON results, abbreviated for XSD."""
    if told is None:
        return ""
    if told["type"] != "literal":
        return f"<{told['value']}>"
    if "xml:lang" in told:
        return str(Literal(told["value"], language=told["xml:lang"]))
    if "datatype" not in told:
        return str(Literal(told["value"]))
    return str(Literal(told["value"], datatype=NamedNode(told["datatype"])))


def typed(value: str, name: str) -> str:
    return f'"{value}"^^<{XSD}{name}>'


def objects(answer: httpx.Response) -> set[str]:
    """Return the values of <urn:p> in a response."""
    assert answer.status_code == 200, answer.text
    quads = parse(answer.content, RdfFormat.N_TRIPLES)
    return {str(quad.object) for quad in quads if quad.predicate == NamedNode("urn:p")}


def mixed() -> list[str]:
    """Return integers, dateTimes and strings that pyoxigraph's own order cannot sort."""
    made = random.Random(1)
    return [
        literal
        for _ in range(60)
        for literal in (
            typed(str(made.randint(0, 3000)), "integer"),
            typed(f"20{made.randint(10, 99)}-01-01T00:00:00Z", "dateTime"),
            f'"{made.randint(0, 3000)}x"',
        )
    ]


def test_integers_times_and_strings_are_ordered_in_queries_and_patches(plane: httpx.Client) -> None:
    url = put(plane, *mixed())
    found = [value for [value] in rows(plane, f"SELECT ?o {{ <{url}> {P} ?o }} ORDER BY ?o")]
    numbers = [int(value.split('"')[1]) for value in found if value.endswith("integer>")]
    texts = [value for value in found if "^^" not in value]
    times = [value for value in found if value.endswith("dateTime>")]
    assert (numbers, texts, times) == (sorted(numbers), sorted(texts), sorted(times))
    assert found == [*(typed(str(number), "integer") for number in numbers), *texts, *times]
    assert rows(plane, f"SELECT ?o {{ <{url}> {P} ?o }} ORDER BY DESC(?o) LIMIT 1") == [(found[-1],)]
    inner = f"SELECT ?o {{ {{ SELECT ?o {{ <{url}> {P} ?o }} ORDER BY ?o LIMIT 3 }} }} ORDER BY ?o"
    assert rows(plane, inner) == [(value,) for value in found[:3]]
    extremes = rows(plane, f"SELECT (MIN(?o) AS ?a) (MAX(?o) AS ?b) {{ <{url}> {P} ?o }}")
    assert extremes == [(found[0], found[-1])]
    body = f"INSERT {{ <{url}> <urn:least> ?o }} WHERE {{ {{ SELECT ?o {{ ?s {P} ?o }} ORDER BY ?o LIMIT 1 }} }}"
    answer = plane.patch(url, content=body, headers={"Content-Type": "application/sparql-update"})
    assert answer.status_code in (200, 204), answer.text
    assert rows(plane, f"SELECT ?o {{ <{url}> <urn:least> ?o }}") == [(found[0],)]


def test_queries_keep_terms_as_they_were_written(plane: httpx.Client) -> None:
    kept = {
        typed("7", "unsignedByte"), typed("7", "integer"), typed("07", "integer"), typed("005", "unsignedByte"),
        typed("1.50", "decimal"), typed("1.0E0", "double"), typed("1", "boolean"), typed("PT60S", "duration"),
        typed("2020-01-01T00:00:00.000Z", "dateTime"), '"07"', '"seven"@en', typed("300", "byte"), "<urn:seven>",
    }  # fmt: skip
    url = put(plane, *kept)
    assert objects(plane.get(url, headers=N_TRIPLES)) == kept
    assert {value for [value] in rows(plane, f"SELECT ?o {{ <{url}> {P} ?o }}")} == kept
    for accept in ("text/turtle", "application/ld+json", "application/rdf+xml"):
        answer = plane.get("/sparql", params={"query": f"DESCRIBE <{url}>"}, headers={"Accept": accept})
        syntax = RdfFormat.from_media_type(accept)
        assert syntax is not None
        told = {str(quad.object) for quad in parse(answer.content, syntax) if quad.predicate == NamedNode("urn:p")}
        assert told == kept, accept
    page = plane.get("/sparql", params={"query": f"SELECT ?o {{ <{url}> {P} ?o }}"}, headers={"Accept": "text/html"})
    assert "urn:x-" not in page.text
    assert "005" in page.text


PATTERNS = {
    f"<URL> {P} 7": True,
    f"<URL> {P} 07": True,
    f"<URL> {P} 007": False,
    f"<URL> {P} '7'^^xsd:unsignedByte": True,
    f"<URL> {P} '7'^^xsd:byte": False,
    f"<URL> {P} '''07'''^^<{XSD}integer>": True,
    f"VALUES ?o {{ 07 }} <URL> {P} ?o": True,
    f"VALUES (?x ?o) {{ (1 007) }} <URL> {P} ?o": False,
    f"<URL> {P} ?o FILTER(sameTerm(?o, 07))": True,
    f"<URL> {P} ?o FILTER(sameTerm(?o, 007))": False,
    f"<URL> {P} ?o FILTER(?o = 007)": True,
    f"<URL> {P} ?o FILTER(?o IN (007, 'x'))": True,
    f"<URL> {P} ?o FILTER(?o > 7)": False,
    f"<URL> {P} ?o FILTER(DATATYPE(?o) = xsd:unsignedByte)": True,
    f"BIND('07'^^xsd:integer AS ?o) <URL> {P} ?o": True,
    f"BIND(3 + 4 AS ?o) <URL> {P} ?o": True,
    f"BIND(STRDT('07', xsd:integer) AS ?o) <URL> {P} ?o": True,
    f"BIND(IF(true, 007, 7) AS ?o) <URL> {P} ?o": False,
    f"BIND(COALESCE(1 / 0, 07) AS ?o) <URL> {P} ?o": True,
    f"<URL> {P} ?o , ?x FILTER(?o = ?x && !sameTerm(?o, ?x))": True,
    f"<URL> {P} ?o FILTER NOT EXISTS {{ <URL> {P} 07 }}": False,
    f"{{ SELECT (COUNT(DISTINCT ?o) AS ?n) {{ <URL> {P} ?o }} }} FILTER(?n = 3)": True,
    f"{{ SELECT (SUM(?o) AS ?n) {{ <URL> {P} ?o }} HAVING(SUM(?o) > 20) }} FILTER(?n = 21)": True,
    f"{{ SELECT ?o (COUNT(*) AS ?n) {{ <URL> {P} ?o }} GROUP BY ?o }} FILTER(?n = 1 && ?o = 7.0)": True,
    f"{{ SELECT (SAMPLE(?x) AS ?o) {{ <URL> {P} ?x FILTER(STR(?x) = '07') }} }} <URL> {P} ?o": True,
}
"""Patterns, and whether they match a resource of 7 and 07 as integers, and 7 as an unsignedByte."""


def test_patterns_match_terms_and_filters_compare_values(plane: httpx.Client) -> None:
    url = put(plane, typed("7", "integer"), typed("07", "integer"), typed("7", "unsignedByte"))
    for pattern, found in PATTERNS.items():
        query = PREFIXES + f"ASK {{ {pattern.replace('<URL>', f'<{url}>')} }}"
        answer = plane.get("/sparql", params={"query": query}, headers={"Accept": "application/sparql-results+json"})
        assert answer.status_code == 200, answer.text
        assert answer.json()["boolean"] is found, pattern


def test_updates_insert_what_was_written_and_delete_nothing_else(plane: httpx.Client) -> None:
    url = put(plane, typed("01", "integer"), typed("1", "integer"), typed("1", "byte"))

    def update(text: str) -> None:
        answer = plane.post("/sparql", content=PREFIXES + text, headers={"Content-Type": "application/sparql-update"})
        assert answer.status_code in (200, 204), answer.text

    update(f"DELETE DATA {{ GRAPH <{url}> {{ <{url}> {P} 1 }} }}")
    assert objects(plane.get(url, headers=N_TRIPLES)) == {typed("01", "integer"), typed("1", "byte")}
    update(f"INSERT DATA {{ GRAPH <{url}> {{ <{url}> {P} 1.0 , '005'^^xsd:unsignedByte }} }}")
    update(f"DELETE {{ GRAPH ?g {{ ?s {P} ?o }} }} INSERT {{ GRAPH ?g {{ ?s {P} ?o ; <urn:q> ?o }} }} "
           f"WHERE {{ GRAPH ?g {{ ?s {P} ?o FILTER(?o = 1 && ?s = <{url}>) }} }}")  # fmt: skip
    left = {typed("01", "integer"), typed("1", "byte"), typed("1.0", "decimal"), typed("005", "unsignedByte")}
    assert objects(plane.get(url, headers=N_TRIPLES)) == left
    copies = rows(plane, f"SELECT ?o {{ <{url}> <urn:q> ?o }}")
    assert {value for [value] in copies} == left - {typed("005", "unsignedByte")}


LEXICAL = {
    "integer": ["0", "7", "007", "-0", "+5", "-12", "9223372036854775807", "9223372036854775808"],
    "byte": ["7", "-7", "07", "300"],
    "unsignedByte": ["0", "255", "005"],
    "short": ["-3"], "unsignedShort": ["3"], "int": ["-3", "+3"], "unsignedInt": ["3"], "long": ["-3"],
    "unsignedLong": ["3", "18446744073709551615"], "nonNegativeInteger": ["3"], "positiveInteger": ["3"],
    "nonPositiveInteger": ["-3"], "negativeInteger": ["-3"],
    "decimal": ["1", "1.0", "1.50", "-0.0", ".5", "0.1234567890123456789", "100000000000000000000000"],
    "double": ["1", "1.0", "1.5E0", "1e300", "-0.0", "-0", "INF", "+INF", "NaN", "0.30000000000000004", "5e-324"],
    "float": ["1", "1.0", "0.1", "16777217", "0.10000000149", "3.4028235E38", "INF", "-INF", "NaN"],
    "boolean": ["true", "false", "1", "0", "TRUE"],
    "dateTime": ["2020-01-01T00:00:00Z", "2020-01-01T00:00:00.000Z", "2020-01-01T00:00:00", "2020-01-01T24:00:00Z",
                 "2020-01-01T00:00:00+00:00", "2020-01-01T00:00:00.123456789+02:00", "2020-13-01T00:00:00Z"],
    "dateTimeStamp": ["2020-01-01T00:00:00.0Z"], "date": ["2020-01-01", "2020-01-01+00:00"],
    "time": ["24:00:00", "00:00:00.0", "12:00:00Z"], "duration": ["PT60S", "P12M", "P0D", "-P1D"],
    "dayTimeDuration": ["PT24H"], "yearMonthDuration": ["P12M"], "gYear": ["2020", "2020+00:00"],
    "gYearMonth": ["2020-01Z", "2020-01+00:00"], "gMonth": ["--01+00:00"], "gDay": ["---01+00:00"],
    "gMonthDay": ["--01-01+00:00"], "string": ["7", "07"], "normalizedString": ["7"], "token": ["07"],
    "anyURI": ["urn:x"], "hexBinary": ["0a", "0A"], "base64Binary": ["AAA="], "language": ["EN"],
}  # fmt: skip
"""Lexical forms of every datatype of XSD, canonical ones and others."""
SAMPLES = [typed(value, name) for name, values in LEXICAL.items() for value in values]
DIGITS = st.from_regex(r"[+-]?[0-9]{1,20}(\.[0-9]{1,20})?([eE][+-]?[0-9]{1,2})?", fullmatch=True)
LITERALS = (
    st.sampled_from(SAMPLES)
    | st.builds(typed, DIGITS, st.sampled_from(["integer", "int", "decimal", "double", "float"]))
    | st.builds(typed, st.floats().map(repr), st.sampled_from(["double", "float"]))
    | st.builds(typed, st.datetimes().map(lambda moment: moment.isoformat()), st.sampled_from(["dateTime", "date"]))
)


@given(st.lists(LITERALS, min_size=1, max_size=40))
@example(SAMPLES)
@settings(max_examples=25, deadline=None)
def test_literals_of_every_datatype_are_the_same_in_get_and_in_queries(
    plane: httpx.Client, literals: list[str]
) -> None:
    url = put(plane, *literals)
    kept = objects(plane.get(url, headers=N_TRIPLES))
    assert kept == {str(triple.object) for triple in triples("".join(f"<urn:s> {P} {each} .\n" for each in literals))}
    assert {value for [value] in rows(plane, f"SELECT ?o {{ <{url}> {P} ?o }} ORDER BY ?o")} == kept
    query = f"CONSTRUCT {{ ?s ?p ?o }} {{ GRAPH <{url}> {{ ?s ?p ?o }} }}"
    assert objects(plane.get("/sparql", params={"query": query}, headers=N_TRIPLES)) == kept
    constants = " ".join(f'"{each.split(chr(34))[1]}"^^{each.split("^^")[1]}' for each in sorted(kept) if "^^" in each)
    found = rows(plane, f"SELECT DISTINCT ?o {{ VALUES ?o {{ {constants} }} <{url}> {P} ?o }}")
    assert {value for [value] in found} == {each for each in kept if "^^" in each}
    told = rows(plane, f"SELECT (STR(?o) AS ?t) (DATATYPE(?o) AS ?d) {{ <{url}> {P} ?o }}")
    assert sorted(told) == sorted(by_rdflib(literals))


def triples(text: str) -> list[Triple]:
    return [quad.triple for quad in parse(text.encode(), RdfFormat.N_TRIPLES)]


def by_rdflib(literals: list[str]) -> list[tuple[str, str]]:
    """Return STR and DATATYPE according to rdflib, which preserves terms."""
    normalised, rdflib.NORMALIZE_LITERALS = rdflib.NORMALIZE_LITERALS, False
    try:
        graph = rdflib.Graph()
        graph.parse(data="".join(f"<urn:s> {P} {each} .\n" for each in literals), format="nt")
        kept = {each for each in graph.objects() if isinstance(each, rdflib.Literal)}
        found = {(str(each), str(each.datatype or f"{XSD}string")) for each in kept}
        return [(f'"{value}"', f"<{datatype}>") for value, datatype in found]
    finally:
        rdflib.NORMALIZE_LITERALS = normalised
