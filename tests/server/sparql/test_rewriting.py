"""A rewritten query has the solutions that pyoxigraph finds by values, and keeps the terms."""

from __future__ import annotations

import pyoxigraph
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import QuerySolutions

from rosld.server.dataset import MemoryStore
from rosld.server.dataset.base import Term
from rosld.server.dataset.encoding import NAMESPACE, decode_term
from rosld.server.dataset.sort_keys import sort_key
from rosld.server.sparql.rewriting import rewrite
from rosld.server.sparql.ros_functions import AGE
from rosld.server.sparql.syntax.lexer import DEFAULT_BOUNDS, ServiceAllowlist, check_text
from rosld.server.sparql.syntax.query import parse_query
from rosld.server.sparql.update.parser import rewrite_update

XSD = "http://www.w3.org/2001/XMLSchema#"
PREFIXES = {"xsd": XSD}


def rewritten(text: str) -> str:
    query = check_text(text, reach=ServiceAllowlist(frozenset({"http://elsewhere/"})))
    parsed = parse_query(query, PREFIXES, "http://robot/", AGE, DEFAULT_BOUNDS)
    return rewrite(query.text, parsed.literals, parsed.expressions)


@pytest.mark.parametrize(
    "text",
    [
        "SELECT * { ?s ?p ?o }",
        "ASK { ?s ?p 7 , 1.5 , 'x' , true , -3 }",
        "SELECT ?s { ?s ?p ?o } LIMIT 07 OFFSET 01",
        "SELECT ?s { ?s ?p ?o FILTER(CONTAINS(STR(?o), 'x') && isIRI(?s)) }",
        "SELECT ?s { ?s ?p ?o FILTER(?p = <urn:p> || ?s IN (<urn:a>, <urn:b>)) }",
        "SELECT ?s { ?s ?p ?o FILTER(?o = 'on') }",
        "SELECT (COUNT(DISTINCT ?o) AS ?n) (SAMPLE(?o) AS ?one) { ?s ?p ?o } GROUP BY ?s",
        "SELECT * { SERVICE <http://elsewhere/> { ?s ?p 07 FILTER(?s > 07) } }",
        "SELECT * { ?s <urn:p>+ 5 ; <urn:q> -5 }",
    ],
)
def test_what_needs_no_change_stays_as_it_is(text: str) -> None:
    assert "".join(rewritten(text).split()) == "".join(text.split())


@pytest.mark.parametrize(
    "text",
    [
        "SELECT * { ?s ?p 07 }",
        "SELECT * { ?s ?p +5 }",
        "SELECT * { ?s ?p '7'^^xsd:byte }",
        "SELECT * { ?s ?p ?o } ORDER BY ?o",
        "SELECT * { ?s ?p ?o FILTER(?o != 'on') }",
        "SELECT * { ?s ?p ?o FILTER(!(?o = 'on')) }",
        "CONSTRUCT { ?s ?p 1.0 } { ?s ?p ?o }",
        "SELECT (MAX(?o) AS ?x) { ?s ?p ?o }",
        "ASK { FILTER EXISTS { ?s ?p 07 } }",
        "ASK { { SELECT ?s { ?s ?p ?o } ORDER BY DESC(?o) } }",
    ],
)
def test_what_would_come_to_another_answer_is_changed(text: str) -> None:
    assert NAMESPACE in rewritten(text)


def test_updates_of_one_graph_are_rewritten_too() -> None:
    text = "DELETE DATA { <a> <b> 01 } ; DELETE { ?s ?p ?o } INSERT { ?s ?p 02 } WHERE { ?s ?p ?o FILTER(?o > 1) }"
    assert rewrite_update(check_text(text), "http://robot/").count(NAMESPACE) >= 3


NAMES = ["integer", "byte", "unsignedInt", "decimal", "double", "float"]
NUMBERS = ["0", "1", "007", "-3", "+2.50", "2.5", "1e0", "100", "9007199254740993", "NaN", "INF"]
LITERALS = st.one_of(
    st.builds(lambda value, name: f'"{value}"^^<{XSD}{name}>', st.sampled_from(NUMBERS), st.sampled_from(NAMES)),
    st.sampled_from(
        [
            *(f'"{value}"^^<{XSD}boolean>' for value in ("true", "false", "1", "0")),
            *(f'"2020-01-01T00:00:00{zone}"^^<{XSD}dateTime>' for zone in ("Z", ".0Z", "", "+01:00")),
            *(f'"2020-01-01T01:00:00{zone}"^^<{XSD}dateTime>' for zone in ("Z", ".0Z", "", "+01:00")),
            f'"2020-01-01"^^<{XSD}date>', f'"2020-01-01+00:00"^^<{XSD}date>', f'"PT60S"^^<{XSD}duration>',
            f'"2020-99-01T00:00:00Z"^^<{XSD}dateTime>', f'"many"^^<{XSD}integer>',
            '""', '"2"', '"x"', '"x"@en', "<urn:x>", '"x"^^<urn:own>', "_:blank",
        ]
    ),
)  # fmt: skip
CONSTANTS = st.sampled_from(
    ["1", "2.5", "1e0", "007", "true", "'x'", "'x'@en", "<urn:x>", "'2020-01-01T01:00:00Z'^^xsd:dateTime", "?w", "?v"]
)
OPERATORS = st.sampled_from(["=", "!=", "<", ">", "<=", ">="])
VALUES = st.recursive(
    CONSTANTS,
    lambda inner: st.one_of(
        st.builds("({} {} {})".format, inner, st.sampled_from(["+", "-", "*", "/"]), inner),
        st.builds("IF({}, {}, {})".format, inner, inner, inner),
        st.builds("COALESCE({}, {})".format, inner, inner),
        st.builds(
            "{}({})".format, st.sampled_from(["ABS", "CEIL", "ROUND", "YEAR", "xsd:integer", "xsd:double"]), inner
        ),
        st.builds("-({})".format, inner),
    ),
    max_leaves=4,
)
TESTS = st.recursive(
    st.one_of(
        st.builds("{} {} {}".format, VALUES, OPERATORS, VALUES),
        st.builds("{} {} ({}, {})".format, VALUES, st.sampled_from(["IN", "NOT IN"]), VALUES, VALUES),
        st.builds("{}({})".format, st.sampled_from(["isNumeric", "isLiteral", "isIRI", "BOUND"]), st.just("?v")),
        st.sampled_from(["?v", "?w", "EXISTS { ?v2 <urn:p> ?v3 FILTER(?v3 = ?v) }", "CONTAINS(?v, 'x')"]),
    ),
    lambda inner: st.one_of(
        st.builds("({}) && ({})".format, inner, inner),
        st.builds("({}) || ({})".format, inner, inner),
        st.builds("!({})".format, inner),
    ),
    max_leaves=4,
)


def both(literals: list[str]) -> tuple[pyoxigraph.Store, MemoryStore]:
    """A store of its own making, and ours, with one literal a subject."""
    text = "".join(f"<urn:s{at}> <urn:p> {literal} .\n" for at, literal in enumerate(literals))
    plain, kept = pyoxigraph.Store(), MemoryStore()
    plain.update(f"INSERT DATA {{ {text} }}")
    kept.replace({"urn:g": text})
    return plain, kept


def subjects(results: object) -> list[str]:
    assert isinstance(results, QuerySolutions)
    return sorted(",".join(str(term) for term in row) for row in results)


@given(st.lists(LITERALS, min_size=2, max_size=6), TESTS)
@settings(max_examples=1500, deadline=None)
def test_filters_find_what_they_find_by_value(literals: list[str], test: str) -> None:
    plain, kept = both(literals)
    query = f"SELECT ?s ?t {{ ?s <urn:p> ?v . ?t <urn:p> ?w FILTER({test}) }}"
    assert subjects(kept.query(rewritten(query), prefixes=PREFIXES)) == subjects(plain.query(query, prefixes=PREFIXES))


@given(st.lists(LITERALS, min_size=1, max_size=6), VALUES, TESTS)
@settings(max_examples=500, deadline=None)
def test_expressions_come_to_the_same_values(literals: list[str], value: str, test: str) -> None:
    plain, kept = both(literals)
    query = f"SELECT ?s (({value}) = 1 AS ?a) (!({test}) AS ?b) {{ ?s <urn:p> ?v BIND(?v AS ?w) }}"
    assert subjects(kept.query(rewritten(query), prefixes=PREFIXES)) == subjects(plain.query(query, prefixes=PREFIXES))


@given(st.lists(LITERALS, min_size=1, max_size=80), st.booleans())
@settings(max_examples=500, deadline=None)
def test_an_order_is_that_of_the_sort_keys(literals: list[str], descending: bool) -> None:
    _, kept = both(literals)
    query = rewritten(f"SELECT ?v {{ ?s <urn:p> ?v }} ORDER BY {'DESC(?v)' if descending else '?v'}")
    found = kept.query(query)
    assert isinstance(found, QuerySolutions)
    keys = [key(row["v"]) for row in found]
    assert keys == sorted(keys, reverse=descending)


def key(term: Term | None) -> str:
    """The key; what is no number is as good as any other, and so are the kinds that nobody else orders."""
    assert term is not None
    found = sort_key(term)
    return "2!" if found[:2] == "2!" else min(found, "5")


@given(st.lists(LITERALS.filter(lambda literal: literal[0] == '"'), min_size=1, max_size=12))
@settings(max_examples=300, deadline=None)
def test_the_least_and_the_greatest_are_terms_that_are_there(literals: list[str]) -> None:
    _, kept = both(literals)
    found = kept.query(
        rewritten("SELECT (MIN(?v) AS ?least) (MAX(?v) AS ?greatest) (MAX(?v) = MAX(?v) AS ?same) { ?s ?p ?v }")
    )
    assert isinstance(found, QuerySolutions)
    [row] = found
    there = kept.query("SELECT ?v { ?s ?p ?v }")
    assert isinstance(there, QuerySolutions)
    terms = {decode_term(value) for [value] in there if value is not None}
    least, greatest = decode_term(row["least"]), decode_term(row["greatest"])
    assert {least, greatest} <= terms
    assert sort_key(least) == min(map(sort_key, terms))
    assert sort_key(greatest) == max(map(sort_key, terms))
