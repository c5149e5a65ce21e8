"""Texts of queries and updates over HTTP: valid ones, messages about invalid ones, and refusals of malicious ones.

W3C's syntax tests are in `tests/conformance/sparql`.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator

import httpx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

DIRECT = {"Content-Type": "application/sparql-query", "Accept": "text/csv, application/problem+json;q=0.9"}
UPDATE = {"Content-Type": "application/sparql-update"}


def ask(http: httpx.Client, text: str) -> httpx.Response:
    return http.post("/sparql", content=text.encode("utf-8", "surrogatepass"), headers=DIRECT)


def taken(http: httpx.Client, texts: list[str]) -> list[str]:
    """Return the texts that are accepted as queries: they may still exceed a limit."""
    return [text[:100] for text in texts if ask(http, text).status_code != 400]


@pytest.fixture(scope="module")
def trap() -> Iterator[socket.socket]:
    """A server to which no query must connect."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield listening
        listening.settimeout(0.01)
        with pytest.raises(TimeoutError):
            listening.accept()


def url(trap: socket.socket) -> str:
    return f"http://127.0.0.1:{trap.getsockname()[1]}/"


WRONG = [
    ("", "There is no query: it begins with SELECT, ASK, CONSTRUCT or DESCRIBE."),
    ("SELEC ?x {}", "SELEC at 1:1 is not a query form: SELECT, ASK, CONSTRUCT or DESCRIBE."),
    ("SELECT ?x {\n ?x foo:bar 1 }", "The prefix foo: is not declared, at 2:5."),
    ("ASK { ?s rdffs:label 1 }", "The prefix rdffs: is not declared (rdfs:?), at 1:10."),
    ("PREFIX ex: http://a/ ASK {}", "http: at 1:12 is unexpected; expected the IRI of ex: in <>."),
    (
        "SELECT * { OPTINAL { ?s ?p ?o } }",
        "OPTINAL at 1:12 is not a SPARQL keyword (OPTIONAL?); expected a triple",
    ),
    ("SELECT * { ?s ?p ?o", "The query ends where . or } is expected, and { at 1:10 is not closed."),
    ("SELECT * { ?s ?p ?o FILTER ?o > 3 }", "?o at 1:28 is unexpected; expected an expression in brackets, EXISTS"),
    ("SELECT ?x { ?x a foo }", "foo at 1:18 is not a term: put it in quotes, or write it as a variable"),
    (
        "SELECT * { ?s ?p <a b> }",
        "< at 1:18 does not begin an IRI: it is not closed, or contains a space, a quote or a bracket.",
    ),
    ("SELECT * { ?s ?p 'a }", "The string that begins at 1:18 is not closed."),
    (r"SELECT * { ?s ?p 'C:\data' }", "The string at 1:18 has an invalid escape: write a backslash as two."),
    ("SELECT (STRLEN() AS ?n) {}", "STRLEN at 1:9 has 0 arguments and takes 1."),
    ("SELECT (REGX('a', 'b') AS ?n) {}", "REGX at 1:9 is not a SPARQL function (REGEX?)."),
    ("SELECT ?s (COUNT(?o) AS ?n) { ?s ?p ?o }", "?s at 1:8 is not grouped: name it in GROUP BY, or use an"),
    ("SELECT * { ?s ?p ?o } GROUP BY ?s", "SELECT * at 1:1 cannot stand with GROUP BY or an aggregate: name what"),
    ("SELECT * { ?s ?p ?o BIND(1 AS ?o) }", "?o at 1:31 already has a value before this BIND: choose another"),
    ("SELECT (1) {}", ") at 1:10 is unexpected; expected AS and a variable."),
    ("ASK { ?s " + "x" * 100 + " ?o }", "x" * 37 + "... at 1:10 is not a SPARQL keyword; expected a predicate"),
]


def test_what_is_wrong_is_named_with_its_place_and_what_was_expected(http: httpx.Client) -> None:
    wrong = []
    for text, words in WRONG:
        answer = ask(http, text)
        detail = answer.json()["detail"]
        if answer.status_code != 400 or not detail.startswith(words) or len(detail) >= 200:
            wrong.append((text, detail))
    assert not wrong, wrong


AMBIGUOUS = [
    "SELECT * { \\u0053ERVICE <h:x> {} }",
    "SELECT * { ?a ?b <h:a\\u003E> }",
    "SELECT * { ?a ?b <h:a\\u0020b> }",
    "SELECT * { ?a ?b 'a\\uD800' }",
    "SELECT * { ?a ?b '\\U00110000' }",
    "SELECT * { ?a ?b <h:a\\b> }",
    'SELECT * { ?a ?b """open" }',
    "SELECT * { ?a ?b ?c\x00 }",
    "SELECT * { ?a ?b\u00a0?c }",
    "SELECT * { ?a ?b\x0c?c }",
    "SELECT * { <<?a ?b ?c>> ?p ?o }",
    "SELECT * { ?a ?b ?c {| ?d ?e |} }",
    "SELECT * { ?a ?b ?c ~ ?d }",
    "SELECT * { ?a ?b ?c FILTER(?a<?b&&?c>?a) }",
    "SELECT * { VALUES { 1 } }",
    "SELECT * {} VALUES { ?a ?b }",
    r"SELECT ?x { ?x ?y \u0022a\u0022 }",
]


def test_what_could_be_read_in_two_ways_or_not_at_all_is_refused(http: httpx.Client) -> None:
    assert not taken(http, AMBIGUOUS)
    assert "put a space after the <" in ask(http, AMBIGUOUS[13]).json()["detail"]
    assert ask(http, "SELECT * { ?a ?b ?c FILTER(?a < ?b && ?c > ?a) } LIMIT 1").status_code == 200


SERVICES = [
    "SELECT * { SERVICE <%s> { ?s ?p ?o } }",
    "SELECT * { service silent ?x { ?s ?p ?o } VALUES ?x { <%s> } }",
    "SELECT * { SerVice<%s>{} }",
    "SELECT * { SERVICESILENT<%s>{} }",
    "SELECT * { ?a ?b trueSERVICE <%s> {} }",
    "SELECT * { ?a ?b 1SERVICE <%s> {} }",
    "SELECT * { # c\rSERVICE <%s> {} }",
    "SELECT * { # '''\nSERVICE <%s> {} # '''\n }",
    "SELECT * { FILTER EXISTS { SERVICE <%s> {} } }",
    "SELECT * { OPTIONAL{}SERVICE <%s> {} }",
    'SELECT * { ?a ?b ?c FILTER(?a<?b#>"""\n) SERVICE <%s> {} #"""\n }',
    'SELECT * { ?a ?b ?c FILTER(?a <?b#>"""\n) SERVICE <%s> {} #"""\n }',
    "DELETE WHERE { ?s ?p ?o }",
    "LOAD <%s>",
]


def test_no_spelling_of_service_reaches_another_server(http: httpx.Client, trap: socket.socket) -> None:
    assert not taken(http, [text.replace("%s", url(trap)) for text in SERVICES])


@settings(max_examples=30)
@given(st.text(alphabet="SERVICEservice <>{}?x'\"\\u0053#\n.:", max_size=60))
def test_no_text_at_random_reaches_another_server(http: httpx.Client, trap: socket.socket, text: str) -> None:
    query = f"SELECT * {{ {text} SERVICE <{url(trap)}> {{ ?a ?b ?c }} {text} }}"
    assert ask(http, query).status_code in (200, 400)


STRINGS = {
    r"'x\u0027 . SERVICE <http://127.0.0.1:9/> {} . ?a ?b \u0027'": "x' . SERVICE <http://127.0.0.1:9/> {} . ?a ?b '",
    r"'\\u0027'": r"\u0027",
    r'"\u0022"': '"',
    r"'\U0000000A\u0001\u005C'": "\n\x01\\",
    r"'\t\b\n\r\f\"\'\\'": "\t\b\n\r\f\"'\\",
    "'SERVICE <x>' # SERVICE": "SERVICE <x>",
}


def test_a_string_may_have_every_escape_and_any_words(http: httpx.Client) -> None:
    for written, value in STRINGS.items():
        answer = http.post("/sparql", data={"query": f"SELECT ({written}\n AS ?x) {{}}"})
        [row] = answer.json()["results"]["bindings"]
        assert row["x"]["value"] == value
    assert ask(http, r"SELECT ?\u0061b { ?ab <h:caf\u00E9> ?SERVICE # \u000a" "\n}").status_code == 200


BOMBS = [
    "a." * 30_000,
    "<" * 60_000,
    '"' * 60_001,
    "'\\" * 30_000,
    '"""' + "a" * 60_000,
    '"""\'' * 16_000,
    "a" + "." * 60_000,
    "?" * 60_000,
    "ex:" + "\\-" * 30_000,
    "_:" + "a." * 30_000,
    "1." * 30_000,
    "@en" + "-a" * 30_000,
    "#\n" * 30_000,
    *(f"SELECT *\n{''.join(pair[0] * 200)}{''.join(pair[1] * 200)}" for pair in ("{}", "()", "[]")),
    f"SELECT * {{ ?s ?p ?o FILTER({'!' * 3000}?o) }}",
    f"SELECT * {{ ?s ?p ?o FILTER({'+'.join(['1'] * 3000)}) }}",
    f"SELECT * {{ ?s ?p ?o FILTER({'||'.join(['?s'] * 3000)}) }}",
    f"SELECT * {{ {'UNION'.join(['{}'] * 3000)} }}",
    f"SELECT * {{ {'FILTER(?s)' * 3000} }}",
    f"SELECT * {{ {''.join(f'BIND(1 AS ?b{n})' for n in range(3000))} }}",
    f"SELECT * {{ {'MINUS{}' * 3000} }}",
    f"SELECT {''.join(f'(1 AS ?a{n})' for n in range(3000))} {{ }}",
    f"SELECT * {{ ?s ?p ?o }} HAVING {'(1)' * 3000}",
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
]
"""Texts that might block a lexer, a parser or the optimizer, or overflow a stack."""
AT_THE_BOUNDS = [
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
    f"SELECT * {{ VALUES (?a ?b) {{ {'(1 2)' * 5000} }} }}",
    f"SELECT * {{ {' UNION '.join(['{ ' + ' . '.join(f'?v <h:p> ?v{n}' for n in range(30)) + ' }'] * 8)} }}",
    f"ASK {{ {'?s ?p ?o . ' * 50} }}",
]


@pytest.mark.slow
def test_bombs_are_refused_and_what_is_let_through_leaves_the_server_alive(http: httpx.Client) -> None:
    assert not taken(http, BOMBS)
    assert "the limit is 1000" in ask(http, BOMBS[16]).json()["detail"]
    assert ask(http, "ASK { }" + " " * 300_000).status_code == 413
    wrong = [
        (text[:60], answer.text) for text in AT_THE_BOUNDS if (answer := ask_at_once(http, text)).status_code == 400
    ]
    assert not wrong, wrong
    assert ask(http, "ASK {}").status_code == 200


def ask_at_once(http: httpx.Client, text: str) -> httpx.Response:
    """Return the result of a query over an empty dataset."""
    return http.post("/sparql", data={"query": text, "default-graph-uri": "http://nowhere/"}, headers={"Accept": "*/*"})


# Updates


WRONG_UPDATES = [
    ("INSERT", "The update ends where"),
    ("; INSERT DATA { }", "; at 1:1"),
    ("INSERT DATA { } INSERT DATA { }", "INSERT at 1:17"),
    ("INSERT DATA { } ; ; INSERT DATA { }", "; at 1:19"),
    ("SELECT * WHERE { ?s ?p ?o }", "SELECT at 1:1"),
    ("PREFIX e <urn:e:>", "e at 1:8"),
    ("PREFIX e: e:x", "e:x at 1:11"),
    ("CLEAR", "The update ends where"),
    ("CLEAR <g>", "<g> at 1:7"),
    ("COPY ALL TO <b>", "ALL at 1:6"),
    ("WITH <g> INSERT DATA { }", "DATA at 1:17"),
    ("INSERT { } DELETE { } WHERE { }", "DELETE at 1:12"),
    ("INSERT { } WHERE ?s", "?s at 1:18"),
    ("INSERT DATA { ?s <b> <c> }", "INSERT DATA at 1:13 cannot contain variables such as ?s"),
    ("DELETE { <a> <b> ( 1 ) } WHERE { }", "DELETE at 1:8 cannot contain a blank node"),
    ("DELETE WHERE { _:x <b> ?o }", "DELETE at 1:14 cannot contain a blank node"),
    ("INSERT DATA {\n <a> <b> <c>\n <d> <e> <f> }", "3:2"),
    ("INSERT DATA { <a> 'x' <c> }", "1:19"),
    ("INSERT DATA { 1 <b> <c> }", "1:15"),
    ("INSERT DATA { <a> <b> a }", "1:23"),
    ("INSERT DATA { <a> <b> <c> . . }", ". at 1:29"),
    ("INSERT DATA { <g> { <a> <b> <c> } }", "{ at 1:19"),
    ("INSERT DATA { GRAPH _:g { <a> <b> <c> } }", "_:g at 1:21"),
    ("INSERT DATA { GRAPH <g> { GRAPH <h> { <a> <b> <c> } } }", "GRAPH at 1:27"),
    ("INSERT DATA { <a> <b> ( GRAPH <g> { } ) }", "GRAPH at 1:25"),
    ("INSERT DATA { <a> <b>/<c> <d> }", "1:22"),
    ("INSERT DATA { <a> <b> <c> FILTER(true) }", "FILTER at 1:27"),
    ("INSERT DATA { @prefix ros: <urn:e:> . ros:a ros:b ros:c }", "@prefix at 1:15"),
    ("INSERT DATA { <a> <b> 'x'^^?t }", "1:28"),
    ("INSERT DATA { nope:a <b> <c> }", "The prefix nope: is not declared, at 1:15"),
    ("INSERT DATA { <a> <b> 'x }", "string that begins at 1:23 is not closed"),
    ("INSERT DATA { <a> <b> <c d> }", "< at 1:23 does not begin an IRI"),
    ("INSERT DATA { << <a> <b> <c> >> <b> <c> }", "<< at 1:15"),
    ("INSERT { } WHERE { SERVICE <s> { } }", "SERVICE at 1:20"),
    ("INSERT DATA { \\u003ca> <b> <c> }", "1:15"),
]


def test_a_wrong_update_is_refused_where_it_is_wrong(http: httpx.Client) -> None:
    wrong = []
    for text, words in WRONG_UPDATES:
        answer = http.post("/sparql", content=text.encode(), headers=UPDATE, params={"dry-run": "true"})
        if answer.status_code != 400 or words not in answer.json()["detail"]:
            wrong.append((text, words, answer.text))
    assert not wrong, wrong


# Updates of one graph, as in PATCH


@pytest.fixture(scope="module")
def one(http: httpx.Client) -> str:
    """A graph with a triple."""
    body = {"Content-Type": "text/turtle"}
    assert http.put("/data/one", content="<h:m> <h:p#x> 1 .", headers=body).status_code == 201
    return "/data/one"


OTHER_GRAPHS = [
    "INSERT DATA { GRAPH <h:g> { <h:a> <h:b> 1 } }",
    "WITH <h:g> DELETE { ?s ?p ?o } WHERE { ?s ?p ?o }",
    "DELETE { ?s ?p ?o } USING <h:g> WHERE { ?s ?p ?o }",
    "LOAD <%s>",
    "LOADSILENT<%s>",
    "INSERT DATA { };load <%s>",
    "CLEAR ALL",
    "DROP ALL",
    "CREATE GRAPH <h:g>",
    "COPY <h:a> TO <h:b>",
    "ADD <h:a> TO <h:b>",
    "MOVE <h:a> TO <h:b>",
    "PREFIX LOADx: <h:> PREFIX x: <h:> LOADx:y",
    "PREFIX ex: <h:> INSERT { ?s ?p 1 } WHERE { { SELECT * { GRAPHex:g { ?s ?p ?o } } } }",
    "PREFIX ex: <h:> INSERT { ?s ?p 1 } WHERE { { SELECT * { GRAPH:g { ?s ?p ?o } } } }",
    "PREFIX x: <%s> INSERT { ?s ?p 1 } WHERE { SERVICE:x { ?s ?p ?o } }",
]


def test_an_update_of_one_graph_reaches_no_other(http: httpx.Client, one: str, trap: socket.socket) -> None:
    before = http.get(one).content
    statuses = {
        text: http.patch(one, content=text.replace("%s", url(trap)), headers=UPDATE).status_code
        for text in OTHER_GRAPHS
    }
    assert set(statuses.values()) <= {400, 422}, statuses
    assert http.get(one).content == before


def test_a_prefix_may_have_the_name_of_any_keyword(http: httpx.Client, one: str) -> None:
    for prefix in ("graph", "GRAPH", "with", "add", "address", "service", "from", "loadx", "a.copy"):
        text = f"PREFIX {prefix}: <h:p#> INSERT {{ ?m {prefix}:y '{prefix}:y' }} WHERE {{ ?m {prefix}:x 1 }}"
        assert http.patch(one, content=text, headers=UPDATE).status_code == 204, prefix
        asked = f"PREFIX {prefix}: <h:p#> ASK {{ ?m {prefix}:x 1 {{}} ?m {prefix}:y '{prefix}:y' }}"
        assert http.get("/sparql", params={"query": asked}).json()["boolean"] is True
