"""Stored queries over HTTP: parameters are terms with any content, and errors have their position."""

from __future__ import annotations

from urllib.parse import quote

import httpx
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

QUERY = {"Content-Type": "application/sparql-query"}
JSON = {"Accept": "application/sparql-results+json, application/problem+json;q=0.9"}
EVERYWHERE = """\
# Gives a parameter back from every place where it can stand.
# @param p string -- anything
SELECT ?bound ?nested ?most ?optional ?alternative WHERE {
  BIND(?p AS ?bound)
  { SELECT ?nested WHERE { { SELECT ?nested { VALUES ?x { 1 } BIND(STR($p) AS ?nested) FILTER(?p = ?p) } } } }
  { SELECT (MAX(?each) AS ?most) WHERE { VALUES ?x { 1 2 } BIND(?p AS ?each) } GROUP BY ?p0 HAVING(COUNT(?x)=2&&?p=?p) }
  OPTIONAL { VALUES ?x { 1 } FILTER(STRLEN(?p)>=0) BIND("?p" AS ?quoted) BIND(?p AS ?optional) } # ?p "
  { BIND(CONCAT('', ?p, "") AS ?alternative) } UNION { VALUES ?x { 1 } FILTER(?p!=?p) }
}
"""
ADD = """\
# Adds.
# In two lines.
#
# @param first integer -- the one
# @param second integer 2 -- the other -- by default 2
# @param word string "" -- nothing

SELECT ?sum WHERE { BIND(STRLEN(?word) + ?first + ?second AS ?sum) }
"""


@pytest.fixture(scope="module")
def stored(http: httpx.Client) -> httpx.Client:
    """A server with a query for each type of parameter."""
    texts = {
        kind: f"# Gives a parameter back.\n# @param p {kind} -- anything\nSELECT ?x WHERE {{ BIND(?p AS ?x) }}"
        for kind in ("iri", "string", "integer", "double")
    }
    texts |= {"everywhere": EVERYWHERE, "add": ADD, "none": "# All.\nSELECT * { ?s ?p ?o } LIMIT 1"}
    texts["minus"] = "# Subtracts.\n# @param p integer -- what\nSELECT ?x WHERE { BIND(1-?p AS ?x) }"
    for name, text in texts.items():
        assert http.put(f"/queries/{name}", content=text, headers=QUERY).status_code == 201, name
    return http


def run(http: httpx.Client, name: str, **values: str) -> httpx.Response:
    given = "&".join(f"{each}={quote(value, safe='', errors='surrogatepass')}" for each, value in values.items())
    return http.get(f"/queries/{name}?{given}", headers=JSON)


def row(answer: httpx.Response) -> list[tuple[str, str]]:
    """Return the values of the single row, with their datatypes or types."""
    assert answer.status_code == 200, answer.text
    found = answer.json()
    [bindings] = found["results"]["bindings"]
    terms = [bindings[name] for name in found["head"]["vars"]]
    return [(term["value"], term.get("datatype", term["type"]).rpartition("#")[2]) for term in terms]


STRINGS = st.text(st.characters(exclude_categories=["Cs"]))
PIECES = st.sampled_from(
    ["\"'\\", "\\u0022", "\\U00000022", "u0022", "\n", "\r", "\x00", "}", "#", "?p", " . ", '"""', "<x>"]
)


FEW = settings(max_examples=30)


@pytest.mark.slow
@FEW
@given((STRINGS | st.lists(PIECES | STRINGS).map("".join)).filter(bool))
@example('" AS ?x) } #')
@example("\\u0022 AS ?x) } #")
@example("\\\\u0022")
@example('"@en')
@example("\ufffe\uffff\U0010ffff\x7f\x85\u2028")
def test_any_string_comes_back_as_itself_from_wherever_it_stands(stored: httpx.Client, value: str) -> None:
    assert row(run(stored, "everywhere", p=value)) == [(value, "literal")] * 5


@FEW
@given(st.integers(-(2**63), 2**63 - 1), st.floats(allow_nan=False, allow_infinity=False))
def test_any_number_comes_back(stored: httpx.Client, whole: int, value: float) -> None:
    assert row(run(stored, "integer", p=f" {whole} ")) == [(str(whole), "integer")]
    [(found, datatype)] = row(run(stored, "double", p=repr(value)))
    assert (float(found), datatype) == (value, "double")


@FEW
@given(st.lists(PIECES | STRINGS | st.sampled_from(["http://a/", "urn:x", ">", "/topics/"])).map("".join))
def test_an_iri_comes_back_as_itself_or_is_refused(stored: httpx.Client, value: str) -> None:
    answer = run(stored, "iri", p=value)
    if answer.status_code == 400:
        return
    [(found, kind)] = row(answer)
    assert kind == "uri"
    assert found == value or (value.startswith("/") and found.startswith(str(stored.base_url)))


def test_an_iri_may_be_given_as_a_path_of_the_server(stored: httpx.Client) -> None:
    base = str(stored.base_url)
    for value, meant in {
        "http://elsewhere.example/ü?a#b": "http://elsewhere.example/ü?a#b",
        "urn:uuid:1": "urn:uuid:1",
        "/": base,
        "/topics/turtle1/pose#message": f"{base}topics/turtle1/pose#message",
        "/topics/käse brot": f"{base}topics/k%C3%A4se%20brot",
        "/topics/k%C3%A4se": f"{base}topics/k%C3%A4se",
        "/types/a/msg/B?hash=c": f"{base}types/a/msg/B?hash=c",
    }.items():
        assert row(run(stored, "iri", p=value)) == [(meant, "uri")]
    assert row(run(stored, "minus", p="-2")) == [("3", "integer")]


REFUSED = [
    ("iri", "topics/x", "neither an absolute IRI nor a path"),
    ("iri", "http://a> } #", "neither an absolute IRI nor a path"),
    ("iri", "/turtle1/pose", "'/turtle1/pose' is not a path of this server"),
    ("iri", "/topics/../x", "a path segment cannot be '..'"),
    ("iri", "/topics/%zz", "malformed percent-escape"),
    ("iri", "", "a value is required"),
    ("integer", "1.5", "'1.5' is not an integer"),
    ("integer", "٣", "is not an integer"),
    ("integer", str(2**63), "exceeds 64 bits"),
    ("double", "fast", "'fast' is not a number"),
]


def test_what_is_no_value_of_its_type_is_refused(stored: httpx.Client) -> None:
    wrong = []
    for kind, value, words in REFUSED:
        answer = run(stored, kind, p=value)
        detail = answer.json()["detail"]
        if answer.status_code != 400 or words not in detail or f"p ({kind})" not in detail:
            wrong.append((kind, value, answer.text))
    assert not wrong, wrong
    for kind in ("string", "iri"):
        assert run(stored, kind, p="urn:\ud800").status_code == 400


def test_what_is_not_given_is_as_by_default_and_all_that_is_wrong_is_told_at_once(stored: httpx.Client) -> None:
    assert row(run(stored, "add", first="1")) == row(run(stored, "add", first="1", second="", word=""))
    assert row(run(stored, "add", first="1", second="5", word="four")) == [("10", "integer")]
    problem = run(stored, "add", second="X", third="3")
    assert problem.status_code == 400
    for words in ("add", "'third'", "second: 'X'", "word (string)"):
        assert words in problem.json()["detail"]
    second = {"name": "second", "type": "integer", "default": "2", "about": "the other -- by default 2"}
    assert problem.json()["parameters"][1] == second
    assert "first: a value is required: the one" in run(stored, "add", word="x").json()["detail"]
    assert "This query has no parameters" in run(stored, "none", x="1").json()["detail"]


BAD = [
    ("# A.\n# @param p -- it\nASK { ?p ?a ?b }", "bad:2: '@param p -- it' must look like"),
    ("# A.\n# @param ?p iri -- it\nASK { ?p ?a ?b }", "bad:2: the parameter '?p' must be named"),
    ("# A.\n# @param format iri -- it\nASK { ?format ?a ?b }", "bad:2: a parameter cannot be named format"),
    ("# A.\n# @param p iri -- it\n# More.\nASK { ?p ?a ?b }", "bad:3: 'More.' must come before"),
    ("# A.\n# @param p iri -- it\n# @param p iri -- it\nASK { ?p ?a ?b }", "bad:3: the parameter p is declared twice"),
    ("# A.\n# @param p iri -- it\nASK { ?s ?a '?p' } # ?p", "bad:2: the parameter ?p is not used in the query"),
    ("# A.\nSELECT (1 AS ?nobodys0) { ?a ?b }", "bad:2: it is not a valid query with its parameters bound"),
]
"""Further refusals are in `test_kept_queries.py`."""


def test_what_is_wrong_in_a_stored_query_is_told_with_its_place(http: httpx.Client) -> None:
    wrong = []
    for text, words in BAD:
        answer = http.put("/queries/bad", content=text, headers=QUERY)
        if answer.status_code != 422 or words not in answer.json()["detail"]:
            wrong.append((text, answer.text))
    assert not wrong, wrong


@pytest.mark.slow
def test_a_value_that_stands_in_many_places_does_not_fill_the_memory(http: httpx.Client) -> None:
    text = "# A.\n# @param p string -- it\nASK { VALUES ?y { " + "?p " * 1000 + "} }"
    assert http.put("/queries/many", content=text, headers=QUERY).status_code == 201
    assert run(http, "many", p="x" * 8_000).status_code == 413
