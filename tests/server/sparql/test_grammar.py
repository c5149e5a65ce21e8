"""Reading queries: what is given up on, what is refused, and that the store reads the same."""

from __future__ import annotations

import subprocess
import sys

import pytest

from rosld.server.dataset import MemoryStore
from rosld.server.http.problem import Problem
from rosld.server.sparql.analysis import Analyser, Analysis


def analyse(text: str) -> Analysis:
    return Analyser("http://robot/", "https://w3id.org/rosld/types/").analyse(text)


def refusal(text: str) -> str:
    with pytest.raises(Problem) as caught:
        analyse(text)
    assert caught.value.status == 400
    return caught.value.detail


@pytest.mark.parametrize(
    "text",
    [
        "SELECT DISTINCT ?a (COUNT(DISTINCT ?b) AS ?n) { ?a ?p ?b } GROUP BY ?a HAVING (COUNT(*) > 1) ORDER BY ?n",
        "SELECT (GROUP_CONCAT(?x ; separator=', ') AS ?all) { [] ?p ?x , 'a'@en , 1.5 ; ?q ( 1 [ ?r -2 ] ) . } LIMIT 3",
        "SELECT * { ?a ?b ?c FILTER(?c IN (1, 2) && !BOUND(?d) || ?a NOT IN (<h:x>)) } VALUES (?a ?b) { (UNDEF 1) }",
        "SELECT * { ?a ^<h:p>/(<h:q>|!(<h:r>|^a))+/a* ?b . FILTER NOT EXISTS { ?a a ?b } MINUS { ?b ?c ?a } }",
        "SELECT * FROM <h:g> FROM NAMED <h:n> WHERE { GRAPH ?g { { SELECT ?a { ?a ?b ?c } LIMIT 1 } UNION { } } }",
        "ASK { ?a ?b true ; . FILTER(REGEX(STR(?a), '^x', 'i')) BIND(IF(?a = ?b, 1, xsd:integer('2')) AS ?z) }",
        "CONSTRUCT { ?a <h:p> [ <h:q> ( ?b ) ] } WHERE { ?a ?p ?b } OFFSET 2",
        "CONSTRUCT WHERE { ?a ?p ?b . }",
        "DESCRIBE ?a <h:x> WHERE { ?a ?p ?b }",
        "DESCRIBE *  { ?a ?p ?b } ORDER BY <h:f>(?a)",
    ],
)
def test_the_whole_of_sparql_1_1_is_understood(text: str) -> None:
    assert analyse(text).prefixes != Analyser("http://r/", "h:").prefixes
    MemoryStore().query(text, prefixes=analyse(text).prefixes, functions={"h:f": lambda term: term})


@pytest.mark.parametrize(
    "text",
    [
        'SELECT * { ?a ?b ?c FILTER(?a<?b#>"""\n) SERVICE <http://127.0.0.1:9/> {} #"""\n }',
        'SELECT * { ?a ?b ?c FILTER(?a <?b#>"""\n) SERVICE <http://127.0.0.1:9/> {} #"""\n }',
        'SELECT * { ?a ?b ?c FILTER(1<?b#>"""\n) SERVICE <http://127.0.0.1:9/> {} #"""\n }',
        'SELECT * { ?a ?b ?c FILTER(true<?b#>"""\n) SERVICE <http://127.0.0.1:9/> {} #"""\n }',
        'SELECT * { ?a ?b ?c FILTER((1)<?b#>"""\n) SERVICE <http://127.0.0.1:9/> {} #"""\n }',
        'SELECT * { ?a ?b ?c FILTER(STR(?a)<?b#>"""\n) SERVICE <http://127.0.0.1:9/> {} #"""\n }',
        'SELECT (COUNT(DISTINCTtrue<?b#>"""\n) AS ?n) { SERVICE <http://127.0.0.1:9/> {} } #"""\n { }',
        'SELECT * { ?a ?b ?c BIND(xsd:x<?b#>"""\n AS ?x) SERVICE <http://127.0.0.1:9/> {} #"""\n }',
        'SELECT * { ?a ?b ?c FILTER(EXISTS { }<?b#>"""\n) SERVICE <http://127.0.0.1:9/> {} #"""\n }',
        'SELECT * { LATERAL {} FILTER(?a<?b#>"""\n) SERVICE <http://127.0.0.1:9/> {} #"""\n }',
        'SELECT * { ?a ?b ?c } ORDER BY (?a<?b#>"""\n) #"""\n',
    ],
)
def test_no_comment_hides_behind_a_less_than(text: str) -> None:
    """The store's parser would read `<` as less than and `#` as a comment where a lexer reads an IRI and a string."""
    refusal(text)


def test_a_comparison_without_blanks_is_refused_with_a_way_out() -> None:
    assert "put a blank after the <" in refusal("SELECT * { ?a ?b ?c FILTER(?a<?b&&?c>?a) }")
    analyse("SELECT * { ?a ?b ?c FILTER(?a < ?b && ?c > ?a) }")


def test_collections_and_inline_data_hold_iris_side_by_side() -> None:
    analyse("SELECT * { ?a ?b ( <h:a#b> <h:c#d> ) VALUES (?a ?b) { (<h:a#b> <h:c#d>) } }")


@pytest.mark.parametrize(
    "text",
    [
        f"SELECT * {{ {' . '.join(f'?v <h:p> ?v{n}' for n in range(200))} }}",
        f"SELECT * {{ ?s ?p {'[ ?p ' * 100}?o{']' * 100} }}",
        f"SELECT * {{ ?s ?p ({' ?o' * 100}) }}",
        f"SELECT * {{ ?s {'/'.join(['<h:p>'] * 100)} ?o }}",
        f"SELECT * {{ {'OPTIONAL { } ' * 100} }}",
        f"SELECT * {{ {'GRAPH ?g { } ' * 100} }}",
        f"SELECT * {{ {'VALUES ?s { 1 } ' * 100} }}",
        f"SELECT * {{ FILTER(EXISTS {{ {'?s ?p ?o . ' * 100} }}) }}",
        f"DESCRIBE {'<h:x> ' * 100}",
        f"SELECT * {{ LATERAL {{ {'?s ?p ?o . ' * 100} }} }}",
    ],
    ids=lambda text: text[:24],
)
def test_joins_that_would_keep_the_optimiser_busy_are_refused(text: str) -> None:
    refusal(text)


def test_alternatives_count_as_the_largest_of_them_and_templates_not_at_all() -> None:
    branch = " . ".join(f"?v <h:p> ?v{n}" for n in range(30))
    analyse(f"SELECT * {{ {' UNION '.join(['{ ' + branch + ' }'] * 8)} }}")
    analyse(f"CONSTRUCT {{ {'?s ?p ?o . ' * 200} }} WHERE {{ ?s ?p ?o }}")


@pytest.mark.parametrize("keyword", ["INSERT DATA { <h:a> <h:b> 1 }", "DROP ALL", "LOAD <http://127.0.0.1:9/>"])
def test_updates_are_refused_in_words(keyword: str) -> None:
    assert "update" in refusal(keyword)


def test_hostile_queries_that_are_let_through_leave_the_process_alive() -> None:
    """Right at the bounds, in another process, in a thread with the usual stack."""
    script = """
import sys, threading
from rosld.server.sparql.analysis import Analyser
from rosld.server.dataset import MemoryStore
texts = [
    "SELECT * " + "{" * 127 + "?s ?p ?o" + "}" * 127,
    "SELECT * { ?s ?p ?o FILTER(" + "(" * 126 + "1" + ")" * 126 + ") }",
    "SELECT * { ?s ?p ?o FILTER(" + "!" * 900 + "?o) }",
    "SELECT * { ?s ?p ?o FILTER(" + "+".join(["1"] * 900) + ") }",
    "SELECT * { " + "UNION".join(["{?s ?p 1}"] * 300) + " }",
    "SELECT * { ?s ?p ?o " + "".join(f"BIND(1 AS ?b{n})" for n in range(240)) + " }",
    "SELECT * { ?s ?p ?o " + "MINUS{}" * 60 + " }",
    "SELECT * { ?s ?p " + "[ ?p " * 62 + "?o" + "]" * 62 + " }",
    "SELECT * { ?s ?p ?o FILTER(" + "EXISTS { FILTER(" * 40 + "1" + ")}" * 40 + ") }",
    "SELECT * { " + "{ SELECT * { " * 60 + "?s ?p ?o" + "}}" * 60 + " }",
]
def run():
    for text in texts:
        analysis = Analyser("http://r/", "http://r/types/").analyse(text)
        MemoryStore().query(analysis.text)
    print("alive")
thread = threading.Thread(target=run); thread.start(); thread.join()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.strip() == "alive", done.stderr[-2000:]


@pytest.mark.parametrize(
    "query", ["SELECT * { VALUES { 1 } }", "SELECT * {} VALUES { ?a ?b }", "SELECT * { VALUES { VALUES ?a { 1 } } }"]
)
def test_values_of_no_variable_are_refused(query: str) -> None:
    assert "a variable, or several in brackets, is expected" in refusal(query)
