"""What is wrong with a query, in words. W3C's negative syntax tests judge the same in `tests/interop/w3c`."""

from __future__ import annotations

import pytest

from rosld.server.http.problem import Problem
from rosld.server.sparql.analysis import Analyser, Analysis


def analyse(text: str) -> Analysis:
    return Analyser("http://robot/", "https://w3id.org/rosld/types/").analyse(text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "There is no query: it begins with SELECT, ASK, CONSTRUCT or DESCRIBE."),
        ("SELEC ?x {}", "SELEC at 1:1 is no query form: SELECT, ASK, CONSTRUCT or DESCRIBE."),
        ("SELECT ?x {\n ?x foo:bar 1 }", "The prefix foo: is not declared, at 2:5."),
        ("ASK { ?s rdffs:label 1 }", "The prefix rdffs: is not declared (rdfs:?), at 1:10."),
        (
            "PREFIX ex <http://a/> ASK {}",
            "ex at 1:8 is no name of a prefix: it ends in a colon, such as ex:, and has no other.",
        ),
        ("PREFIX ex: http://a/ ASK {}", "http: at 1:12 stands where the IRI of ex: in <> is expected."),
        ("SELECT * { OPTINAL { ?s ?p ?o } }", "OPTINAL at 1:12 is no keyword of SPARQL (OPTIONAL?), where a triple"),
        ("SELECT * { ?s ?p ?o", "The query ends where . or } is expected, and { at 1:10 is not closed."),
        ("SELECT * { ?s ?p ?o } }", "} at 1:23 stands where the end of the query is expected."),
        ("SELECT * { ?s ?p ?o FILTER ?o > 3 }", "?o at 1:28 stands where an expression in brackets, EXISTS"),
        ("SELECT * { ?s ?p ?o ?t ?q ?r }", "?t at 1:21 stands where . or } is expected."),
        ("SELECT ?x { ?x a foo }", "foo at 1:18 is no term: put it in quotes, or write it as a variable"),
        ("SELECT * { ?s ?p <a b> }", "< at 1:18 begins no IRI: it has no end, or a blank, a quote or a bracket in it."),
        ("SELECT * { ?s ?p 'a }", "The string that begins at 1:18 has no end."),
        (r"SELECT * { ?s ?p 'C:\data' }", "A backslash in the string at 1:18 escapes nothing: write it as two."),
        ("SELECT % {}", "'%' at 1:8 is no part of SPARQL."),
        ("SELECT (STRLEN() AS ?n) {}", "STRLEN at 1:9 has 0 arguments and takes 1."),
        ("SELECT (REGX('a', 'b') AS ?n) {}", "REGX at 1:9 is no function of SPARQL (REGEX?)."),
        (
            "SELECT * { ?s ?p ?o } LIMIT ten",
            "ten at 1:29 is no keyword of SPARQL, where the number of LIMIT is expected.",
        ),
        ("SELECT ?s (COUNT(?o) AS ?n) { ?s ?p ?o }", "?s at 1:8 is not grouped by: name it in GROUP BY, or use an"),
        ("SELECT * { ?s ?p ?o } GROUP BY ?s", "SELECT * at 1:1 cannot stand with GROUP BY or an aggregate: name what"),
        ("SELECT * { ?s ?p ?o BIND(1 AS ?o) }", "?o at 1:31 has a value already, before this BIND: choose another"),
        ("SELECT * { VALUES (?a ?b) { (1) } }", "( at 1:29 begins a row of 1 values for 2 variables."),
        (
            "SELECT * { _:a ?p 1 { _:a ?q 2 } }",
            "_:a at 1:23 stands in another group of triples already: use a variable",
        ),
        (
            "SELECT * { FILTER(1 = 2 = 3) }",
            "= at 1:25 compares what a comparison says: put brackets around one of them.",
        ),
        ("CONSTRUCT WHERE { ?s ?p ?o FILTER(true) }", "FILTER at 1:28 stands where . or } is expected."),
        ("SELECT (1) {}", ") at 1:10 stands where AS and a variable is expected."),
        ("ASK { ?s " + "x" * 100 + " ?o }", "x" * 37 + "... at 1:10 is no keyword of SPARQL, where a predicate"),
    ],
)
def test_what_is_wrong_is_named_with_its_place_and_what_was_expected(text: str, words: str) -> None:
    with pytest.raises(Problem) as caught:
        analyse(text)
    assert caught.value.status == 400
    assert caught.value.detail.startswith(words)
    assert len(caught.value.detail) < 200


@pytest.mark.parametrize(
    "text",
    [
        "BASE <http://h/> PREFIX : <#> SELECT DISTINCT ?a (COUNT(DISTINCT *) AS ?n) FROM <g> FROM NAMED :g "
        "{ ?a :p ?b } GROUP BY ?a (?b + 1 AS ?c) STR(?d) "
        "HAVING (COUNT(?b) > 1) :f(?a) ORDER BY DESC(?n) ?a LIMIT 3 OFFSET 4",
        "SELECT * { ?s ^rdf:type/(rdfs:label|!(a|^rdfs:comment))* ?o ; a ?c , [ ?p ( 1 -2.5 'a'@en ) ] "
        ". FILTER NOT EXISTS { ?s ?p true } OPTIONAL { ?s ?q () } MINUS { } { } UNION { SELECT (1 AS ?x) {} } "
        "VALUES ?v { UNDEF <a> } BIND(IF(BOUND(?s), -?o, !?o) AS ?w) GRAPH ?g { } } VALUES (?y ?z) { (1 2) }",
        "CONSTRUCT { ?s ?p _:b . _:b ?q [] } WHERE { ?s ?p ?o }",
        "CONSTRUCT WHERE { ?s ?p ?o . ?o a ?c }",
        "DESCRIBE ?x <a> rdf:type WHERE { ?x ?y ?z }",
        "DESCRIBE *  { ?x ?y ?z }",
        "SELECT ?o { _:a ?p ?o FILTER(?o IN (1, 2) && ?o NOT IN () || ?o = 2) _:a ?q 2 }",
        "SELECT (SAMPLE(?o) AS ?x) (GROUP_CONCAT(?o ; separator=',') AS ?y) { ?s ?p ?o }",
    ],
)
def test_nothing_is_wrong_with_what_is_a_query(text: str) -> None:
    assert analyse(text).form in text
