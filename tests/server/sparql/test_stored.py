"""Stored queries: how their comments are read, and how their parameters are bound."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, QuerySolutions, Store

from rosld.ontology.vocab import xsd
from rosld.server.http.problem import Problem
from rosld.server.sparql.stored_query import (
    ParameterType,
    QueryParameterDeclaration,
    bind_parameters,
    read_stored_query,
    shipped_queries,
)
from rosld.server.sparql.syntax.lexer import check_text

BASE = "http://robot.example/below/"

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


def query_of(kind: str) -> str:
    return f"# Gives a parameter back.\n# @param p {kind} -- anything\nSELECT ?x WHERE {{ BIND(?p AS ?x) }}"


def answered(text: str, **values: str) -> list[object]:
    """The one row that a stored query answers; what is asked is fit for the store by the server's own rules."""
    bound = bind_parameters(read_stored_query("q", text), values, BASE)
    answer = Store().query(check_text(bound).text)
    assert isinstance(answer, QuerySolutions)
    [row] = answer
    return list(row)


STRINGS = st.text(st.characters(exclude_categories=["Cs"]))
PIECES = st.sampled_from(
    [
        '"',
        "'",
        "\\",
        "\\u0022",
        "\\U00000022",
        "u",
        "U",
        "0022",
        "\n",
        "\r",
        "\x00",
        "}",
        "#",
        "?p",
        " . ",
        '"""',
        "<x>",
    ]
)


@given(STRINGS | st.lists(PIECES | STRINGS).map("".join))
@example('" AS ?x) } #')
@example("\\u0022 AS ?x) } #")
@example("\\\\u0022")
@example('"@en')
@example("\ufffe\uffff\U0010ffff\x7f\x85\u2028")
def test_any_string_comes_back_as_itself_from_wherever_it_stands(value: str) -> None:
    assert answered(EVERYWHERE, p=value) == [Literal(value)] * 5


@given(st.integers(-(2**63), 2**63 - 1))
def test_any_integer_of_the_store_comes_back(value: int) -> None:
    assert answered(query_of("integer"), p=f" {value} ") == [Literal(str(value), datatype=xsd.integer)]


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_any_double_comes_back(value: float) -> None:
    [found] = answered(query_of("double"), p=repr(value))
    assert isinstance(found, Literal)
    assert found.datatype == xsd.double
    assert float(found.value) == value


def test_a_negative_number_can_follow_a_minus() -> None:
    text = "# Subtracts.\n# @param p integer -- what\nSELECT ?x WHERE { BIND(1-?p AS ?x) }"
    assert answered(text, p="-2") == [Literal("3", datatype=xsd.integer)]


@given(STRINGS | st.lists(PIECES | st.sampled_from(["http://a/", "urn:x", ">", "/topics/"])).map("".join))
def test_an_iri_comes_back_as_itself_or_is_refused(value: str) -> None:
    try:
        [found] = answered(query_of("iri"), p=value)
    except Problem as problem:
        assert problem.status == 400  # noqa: PT017
    else:
        assert isinstance(found, NamedNode)
        assert found.value == value or (value.startswith("/") and found.value.startswith(BASE))


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("http://elsewhere.example/ü?a#b", "http://elsewhere.example/ü?a#b"),
        ("urn:uuid:1", "urn:uuid:1"),
        ("/", BASE),
        ("/topics/", f"{BASE}topics/"),
        ("/topics/turtle1/pose#message", f"{BASE}topics/turtle1/pose#message"),
        ("/topics/käse brot", f"{BASE}topics/k%C3%A4se%20brot"),
        ("/topics/k%C3%A4se", f"{BASE}topics/k%C3%A4se"),
        ("/types/a/msg/B?hash=c", f"{BASE}types/a/msg/B?hash=c"),
    ],
)
def test_an_iri_may_be_given_as_a_path_of_the_server(given: str, meant: str) -> None:
    assert answered(query_of("iri"), p=given) == [NamedNode(meant)]


@pytest.mark.parametrize(
    ("kind", "value", "words"),
    [
        ("iri", "topics/x", "neither an absolute IRI nor a path"),
        ("iri", "http://a> } #", "neither an absolute IRI nor a path"),
        ("iri", "http://a\\u003e", "neither an absolute IRI nor a path"),
        ("iri", "/turtle1/pose", "'/turtle1/pose' is no path of this server"),
        ("iri", "//elsewhere.example/x", "a path segment cannot be"),
        ("iri", "/topics/../x", "a path segment cannot be '..'"),
        ("iri", "/topics/%zz", "malformed percent-escape"),
        ("iri", "/topics/x#>", "neither an absolute IRI nor a path"),
        ("iri", "/topics/\ud800", "lone surrogate"),
        ("iri", "urn:\ud800", "lone surrogate"),
        ("iri", "", "must be given"),
        ("string", "\ud800", "lone surrogate"),
        ("integer", "1.5", "'1.5' is no whole number"),
        ("integer", "1) }", "is no whole number"),
        ("integer", "٣", "is no whole number"),
        ("integer", str(2**63), "beyond the 64 bits"),
        ("integer", "9" * 500, "is no whole number"),
        ("double", "fast", "'fast' is no number"),
        ("double", "1e999", "is no number"),
        ("double", "", "must be given"),
    ],
)
def test_what_is_no_value_of_its_type_is_refused(kind: str, value: str, words: str) -> None:
    with pytest.raises(Problem) as refused:
        bind_parameters(read_stored_query("q", query_of(kind)), {"p": value}, BASE)
    assert refused.value.status == 400
    assert words in refused.value.detail
    assert f"p ({kind})" in refused.value.detail


TWO = """\
# Adds.
# In two lines.
#
# @param first integer -- the one
# @param second integer 2 -- the other -- by default 2
# @param word string "" -- nothing

SELECT ?sum WHERE { BIND(STRLEN(?word) + ?first + ?second AS ?sum) }
"""


def test_a_comment_block_tells_purpose_and_parameters() -> None:
    query = read_stored_query("add", TWO)
    assert (query.name, query.purpose, query.text) == ("add", "Adds. In two lines.", TWO)
    assert query.parameters == (
        QueryParameterDeclaration("first", ParameterType.INTEGER, None, "the one"),
        QueryParameterDeclaration("second", ParameterType.INTEGER, "2", "the other -- by default 2"),
        QueryParameterDeclaration("word", ParameterType.STRING, "", "nothing"),
    )


def test_what_is_not_given_is_as_by_default_and_an_empty_field_is_not_given() -> None:
    assert answered(TWO, first="1") == answered(TWO, first="1", second="", word="") == [Literal(3)]
    assert answered(TWO, first="1", second="5", word="four") == [Literal(10)]


def test_all_that_is_wrong_is_told_at_once_with_what_there_is() -> None:
    with pytest.raises(Problem) as refused:
        bind_parameters(read_stored_query("add", TWO), {"second": "X", "third": "3"}, BASE)
    problem = refused.value
    assert problem.status == 400
    for words in ("add", "'third'", "first: must be given; it is the one", "second: 'X'", "word (string)"):
        assert words in problem.detail
    assert problem.extra["parameters"][1] == {  # type: ignore[index]
        "name": "second",
        "type": "integer",
        "default": "2",
        "about": "the other -- by default 2",
    }


def test_a_query_without_parameters_says_so() -> None:
    with pytest.raises(Problem, match="This query has no parameters"):
        bind_parameters(read_stored_query("q", "# All.\nSELECT * { ?s ?p ?o }"), {"x": "1"}, BASE)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("SELECT * { ?s ?p ?o }", "q:1: must begin with a comment"),
        ("# @param p iri -- it\nSELECT * { ?p ?a ?b }", "q:1: must begin with a comment"),
        ("# A.\n# @param p -- it\nASK { ?p ?a ?b }", "q:2: '@param p -- it' should look like"),
        ("# A.\n# @param p iri it\nASK { ?p ?a ?b }", "q:2: .* should look like"),
        ("# A.\n# @parameter p iri -- it\nASK { ?p ?a ?b }", "q:2: .* should look like"),
        ("# A.\n# @param p date -- it\nASK { ?p ?a ?b }", "q:2: 'date' is no type of parameter: take iri, string"),
        ("# A.\n# @param ?p iri -- it\nASK { ?p ?a ?b }", r"q:2: the parameter '\?p' must be named"),
        ("# A.\n# @param format iri -- it\nASK { ?format ?a ?b }", "q:2: no parameter can be called format"),
        ("# A.\n# @param p iri -- it\n# More.\nASK { ?p ?a ?b }", "q:3: 'More.' must stand before"),
        ("# A.\n# @param p iri -- it\n# @param p iri -- it\nASK { ?p ?a ?b }", "q:3: the parameter p is told of twice"),
        ("# A.\n# @param p iri -- it\nASK { ?s ?a '?p' } # ?p", r"q:2: no \?p is in the query"),
        ("# A.\n# @param p integer ten -- it\nASK { ?s ?a ?p }", "q:2: the default of p: 'ten' is no whole number"),
        ("# A.\n# @param p integer -- it\nASK { ?a ?p ?b }", "with its parameters bound it is no query"),
        ("# A.\n# @param p iri -- it\nSELECT ?p { ?p ?a ?b }", "with its parameters bound it is no query"),
        ("# A.\nSELECT WHERE", "with its parameters bound it is no query"),
        ("# A.\n\nCLEAR ALL", "q:3: CLEAR is an update"),
        ("# A.\n\n\nSELECT * { ?a ?b }", "q:4: with its parameters bound it is no query"),
        ("# A.\nSELECT (1 AS ?nobodys0) { ?a ?b }", "q:2: with its parameters bound it is no query"),
        ("# A.\nASK { ?a nobody:knows ?b }", "q:2: with its parameters bound it is no query"),
        ("# A.\n" + "".join(f"# @param p{n} iri -- it\n" for n in range(60)) + "ASK {}", "at most 50 parameters"),
        ("# A.\nASK { SERVICE <http://a/> { ?a ?b ?c } }", "SERVICE at .* is refused"),
        ("# A.\nASK {" + "{" * 500 + "}" * 500 + "}", "nests deeper than"),
    ],
)
def test_what_is_wrong_in_a_stored_query_is_told_with_its_place(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        read_stored_query("q", text)


def test_a_query_that_would_take_for_ever_is_read_and_not_evaluated() -> None:
    tables = " ".join(f"VALUES ?v{n} {{ {' '.join(map(str, range(100)))} }}" for n in range(9))
    for form in ("ASK", "SELECT (COUNT(*) AS ?c)", "SELECT *"):
        order = "ORDER BY ?v0" if form.endswith("*") else ""
        assert read_stored_query("q", f"# A.\n{form} {{ {tables} FILTER(?v0 < 0) }} {order}").purpose == "A."


def test_the_prefixes_of_the_server_hold_where_a_query_declares_none() -> None:
    read_stored_query("q", "# A.\nSELECT ?x { ?x a ros:Topic }")


def test_a_value_that_stands_in_many_places_does_not_fill_the_memory() -> None:
    query = read_stored_query(
        "q", "# A.\n# @param p string -- it\nASK { VALUES ?x { " + "?p " * 1000 + "} }".replace("?x", "?y")
    )
    with pytest.raises(Problem) as refused:
        bind_parameters(query, {"p": "x" * 100_000}, BASE)
    assert refused.value.status == 413


def test_functions_of_the_server_are_no_hindrance() -> None:
    read_stored_query("q", "# A.\nSELECT ?x { BIND(<https://w3id.org/rosld#age>(<http://a/>) AS ?x) }")


def test_the_shipped_queries_are_in_order_and_say_what_they_are_for() -> None:
    queries = shipped_queries()
    assert len(queries) >= 10
    assert list(queries) == sorted(queries)
    for name, query in queries.items():
        assert query.name == name
        assert query == read_stored_query(name, query.text), "judged as those of strangers are"
        assert query.purpose.endswith(".")
        assert all(parameter.about for parameter in query.parameters)
