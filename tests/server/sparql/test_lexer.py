"""Tokens, and what is refused before a parser sees it."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, Quad, Store

from rosld.server.http.problem import Problem
from rosld.server.sparql.syntax.lexer import (
    DEFAULT_BOUNDS,
    QueryBounds,
    check_text,
    check_update_of_one_graph,
    line_and_column,
    tokens,
    update_keyword,
)
from rosld.server.sparql.syntax.token import Kind

EVIL = "http://127.0.0.1:9/evil"


def kinds(text: str) -> list[str]:
    return [f"{token.kind.name} {token.text}" for token in tokens(text) if token.kind is not Kind.SPACE]


def refusal(text: str, bounds: QueryBounds = DEFAULT_BOUNDS) -> Problem:
    with pytest.raises(Problem) as caught:
        check_text(text, bounds)
    return caught.value


@given(st.text())
def test_no_character_is_ever_lost(text: str) -> None:
    assert "".join(token.text for token in tokens(text)) == text


_PIECES = [*"\"'\\<>#{}()[]?$@:^|&.,;~!*/+-=a.b1 \n\r_\u00b7\u0301", '"""', "'''", "\\u0041", "SERVICE", "<<", "_:"]


@given(st.lists(st.sampled_from(_PIECES)).map("".join))
def test_no_character_is_ever_lost_from_what_looks_like_sparql(text: str) -> None:
    assert "".join(token.text for token in tokens(text)) == text
    at = 0
    for token in tokens(text):
        assert token.start == at
        assert token.text
        at = token.end


def test_tokens_are_cut_as_the_grammar_says() -> None:
    assert kinds("SELECT?x{?x a<h:t>;:p\"a\\\"b\"@en-GB,'''it's'''^^x:t . _:b.c ex:a.b. ?y 1.5e3 .5 5. }#end") == [
        "WORD SELECT", "VARIABLE ?x", "MARK {", "VARIABLE ?x", "WORD a", "IRI <h:t>", "MARK ;", "NAME :p",
        'STRING "a\\"b"', "LANGUAGE @en-GB", "MARK ,", "STRING '''it's'''", "MARK ^^", "NAME x:t", "MARK .",
        "BLANK _:b.c", "NAME ex:a.b", "MARK .", "VARIABLE ?y", "NUMBER 1.5e3", "NUMBER .5", "NUMBER 5", "MARK .",
        "MARK }", "COMMENT #end",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [
        "a." * 40_000,
        "<" * 60_000,
        '"' * 60_001,
        "'\\" * 30_000,
        '"""' + "a" * 60_000,
        '"""\'' * 16_000,
        "a" * 60_000 + ".",
        "a" + "." * 60_000,
        "?" * 60_000,
        "ex:" + "\\-" * 30_000,
        "ex:" + "." * 60_000,
        "_:" + "a." * 30_000,
        "1." * 30_000,
        "@en" + "-a" * 30_000,
        "#\n" * 30_000,
    ],
    ids=lambda text: repr(text[:6]),
)
def test_time_is_linear_in_the_text(text: str) -> None:
    def seconds(size: int) -> float:
        begun = time.process_time()
        for _ in tokens(text[:size]):
            pass
        return time.process_time() - begun

    quarter, whole = min(seconds(len(text) // 4) for _ in range(3)), min(seconds(len(text)) for _ in range(3))
    assert whole < 9 * quarter + 0.02  # four times as long, not sixteen


@pytest.mark.parametrize(
    "text",
    [
        "SELECT * { SERVICE <%s> { ?s ?p ?o } }",
        "SELECT * { service silent ?x { ?s ?p ?o } }",
        "SELECT * { SerVice<%s>{} }",
        "SELECT * { SERVICESILENT<%s>{} }",
        "SELECT * { ?a ?b trueSERVICE <%s> {} }",
        "SELECT * { ?a ?b 1SERVICE <%s> {} }",
        "SELECT * { # c\rSERVICE <%s> {} }",
        "SELECT * { # '''\nSERVICE <%s> {} # '''\n }",
        "SELECT * { FILTER EXISTS { SERVICE <%s> {} } }",
        "SELECT * { OPTIONAL{}SERVICE <%s> {} }",
    ],
)
def test_service_is_refused_however_it_is_written(text: str) -> None:
    assert "SERVICE" in refusal(text.replace("%s", EVIL)).detail


@pytest.mark.parametrize(
    "text",
    [
        "SELECT * { \\u0053ERVICE <h:x> {} }",
        "SELECT * { ?a ?b <h:a\\u003E> }",
        "SELECT * { ?a ?b <h:a\\u0020b> }",
        "SELECT * { ?a ?b 'a\\uD800' }",
        "SELECT * { ?a ?b '\\U00110000' }",
        "SELECT * { ?a ?b <h:a\\b> }",
        "SELECT * { ?a ?b 'open }",
        'SELECT * { ?a ?b """open" }',
        "SELECT * { ?a ?b ?c\x00 }",
        "SELECT * { ?a ?b\u00a0?c }",
        "SELECT * { ?a ?b\x0c?c }",
        "SELECT * { <<?a ?b ?c>> ?p ?o }",
        "SELECT * { ?a ?b ?c {| ?d ?e |} }",
        "SELECT * { ?a ?b ?c ~ ?d }",
    ],
)
def test_what_could_be_read_in_two_ways_or_not_at_all_is_400(text: str) -> None:
    assert refusal(text).status == 400


def test_escapes_that_mean_letters_are_taken_in_strings_and_iris() -> None:
    check_text('SELECT * { <http://h/\\u0061> ?p "\\u00e4 \\\\ \\" \\n", \'\\U0001F600\' }')


def test_words_in_strings_iris_and_comments_are_no_keywords() -> None:
    check_text('SELECT * { <http://SERVICE/> ex:SERVICE "SERVICE" # SERVICE\n }')
    check_text("SELECT ?SERVICE { ?SERVICE ?p '''LOAD <x>''' }")


def test_comments_are_blanked_and_positions_stay() -> None:
    text = "SELECT * # one\n{ ?s ?p <h:a#b> } # two"
    checked = check_text(text)
    assert len(checked.text) == len(text)
    assert checked.text.split() == ["SELECT", "*", "{", "?s", "?p", "<h:a#b>", "}"]


@pytest.mark.parametrize("bracket", ["{}", "()", "[]"])
def test_nesting_is_bounded_and_the_place_told(bracket: str) -> None:
    nested = bracket[0] * 200 + bracket[1] * 200
    assert refusal(f"SELECT *\n{nested}").detail.endswith("2:129.")
    check_text("SELECT * " + bracket[0] * 128 + bracket[1] * 128)


CHAINS: list[Callable[[int], str]] = [
    lambda n: f"SELECT * {{ ?s ?p ?o FILTER({'!' * n}?o) }}",
    lambda n: f"SELECT * {{ ?s ?p ?o FILTER({'+'.join(['1'] * n)}) }}",
    lambda n: f"SELECT * {{ ?s ?p ?o FILTER({'||'.join(['?s'] * n)}) }}",
    lambda n: f"SELECT * {{ {'UNION'.join(['{}'] * n)} }}",
    lambda n: f"SELECT * {{ {'FILTER(?s)' * n} }}",
    lambda n: f"SELECT * {{ {''.join(f'BIND(1 AS ?b{i})' for i in range(n))} }}",
    lambda n: f"SELECT * {{ {'MINUS{}' * n} }}",
    lambda n: f"SELECT * {{ {'OPTIONAL{}' * n} }}",
    lambda n: f"SELECT {''.join(f'(1 AS ?a{i})' for i in range(n))} {{ }}",
    lambda n: f"SELECT * {{ ?s ?p ?o }} HAVING {'(1)' * n}",
]


@pytest.mark.parametrize("chain", CHAINS)
def test_long_chains_that_would_overflow_the_parsers_stack_are_refused(chain: Callable[[int], str]) -> None:
    check_text(chain(100))
    assert "at most 1000" in refusal(chain(3000)).detail


def test_inline_data_may_be_long() -> None:
    check_text(f"SELECT * {{ VALUES (?a ?b) {{ {'(1 2)' * 5000} }} }}")
    refusal(f"SELECT * {{ VALUES (?a ?b) {{ (1 2) }} FILTER({'!' * 3000}?a) }}")


@pytest.mark.parametrize(
    "triples", ["<urn:s> a <urn:C> .", "[] <urn:p> (1 -1 true) .", 'GRAPH <urn:g> { <s> <p> ""^^<t> }']
)
def test_data_of_an_update_may_be_long(triples: str) -> None:
    for operation in ("INSERT DATA", "DELETE DATA"):
        check_text(f"{operation} {{ {triples * 1200} }}", what="update")
        refusal(f"{operation} {{ {triples * 1200} }} ; DELETE WHERE {{ ?a {'!' * 3000}<p> ?b }}")


def test_datatypes_are_no_steps() -> None:
    check_text(f"""INSERT {{ <s> <p> {", ".join(['"1"^^<t>'] * 2000)} }} WHERE {{}}""", what="update")


def test_size_is_bounded() -> None:
    assert refusal("SELECT * { }" + " " * 100, QueryBounds(size=50)).status == 413


def test_an_update_is_known_by_its_first_keyword() -> None:
    def keyword(text: str) -> str | None:
        return update_keyword(check_text(text).tokens)

    assert keyword("PREFIX a: <h:> # x\nBASE <h:y> insert data { }") == "INSERT"
    assert keyword("LOAD <h:x>") == "LOAD"
    assert keyword("SELECT ?delete { ?s ?p 'DROP' }") is None


def test_places_are_lines_and_columns_from_one() -> None:
    assert line_and_column("ab\ncd", 4) == "2:2"
    assert line_and_column("", 0) == "1:1"


@pytest.mark.parametrize(
    "text",
    [
        "INSERT DATA { GRAPH <h:g> { <h:a> <h:b> 1 } }",
        "WITH <h:g> DELETE { ?s ?p ?o } WHERE { ?s ?p ?o }",
        "DELETE { ?s ?p ?o } USING <h:g> WHERE { ?s ?p ?o }",
        "LOAD <http://127.0.0.1:9/x>",
        "LOADSILENT<http://127.0.0.1:9/x>",
        "INSERT DATA { };load <http://127.0.0.1:9/x>",
        "CLEAR ALL",
        "DROP ALL",
        "CREATE GRAPH <h:g>",
        "COPY <h:a> TO <h:b>",
        "ADD <h:a> TO <h:b>",
        "MOVE <h:a> TO <h:b>",
    ],
)
def test_an_update_of_one_graph_reaches_no_other(text: str) -> None:
    with pytest.raises(Problem) as caught:
        check_update_of_one_graph(text)
    assert caught.value.status == 422


@pytest.mark.parametrize(
    "text",
    [
        "PREFIX LOADx: <h:> PREFIX x: <h:> LOADx:y",
        "PREFIX ex: <h:> INSERT { ?s ?p 1 } WHERE { { SELECT * { GRAPHex:g { ?s ?p ?o } } } }",
        "PREFIX ex: <h:> INSERT { ?s ?p 1 } WHERE { { SELECT * { GRAPH:g { ?s ?p ?o } } } }",
        "PREFIX x: <http://127.0.0.1:9/> INSERT { ?s ?p 1 } WHERE { SERVICE:x { ?s ?p ?o } }",
    ],
)
def test_no_keyword_can_be_cut_from_the_prefixes_of_an_update_of_one_graph(text: str) -> None:
    with pytest.raises(SyntaxError):
        Store().update(check_update_of_one_graph(text).text)


@pytest.mark.parametrize("prefix", ["graph", "GRAPH", "with", "add", "address", "service", "from", "loadx", "a.copy"])
def test_a_prefix_may_have_the_name_of_any_keyword(prefix: str) -> None:
    text = f"PREFIX {prefix}: <h:p#> INSERT {{ ?m {prefix}:x '{prefix}:y' }} WHERE {{ ?m {prefix}:x 1 }}"
    store = Store()
    store.add(Quad(NamedNode("h:m"), NamedNode("h:p#x"), Literal(1)))
    store.update(check_update_of_one_graph(text).text)
    assert Quad(NamedNode("h:m"), NamedNode("h:p#x"), Literal(f"{prefix}:y")) in store
    asked = check_text(f"PREFIX {prefix}: <h:p#> ASK {{ ?m {prefix}:x 1 {{}} ?m {prefix}:x ?b }}").text
    assert store.query(asked)
    assert asked.index("ASK") == len(f"PREFIX {prefix}: <h:p#> ")


@pytest.mark.parametrize(
    ("written", "value"),
    [
        (
            r"'x\u0027 . SERVICE <http://127.0.0.1:9/> {} . ?a ?b \u0027'",
            "x' . SERVICE <http://127.0.0.1:9/> {} . ?a ?b '",
        ),
        (r"'\\u0027'", r"\u0027"),
        (r'"\u0022"', '"'),
        (r"'\U0000000A\u0001\u005C'", "\n\x01\\"),
        (r"'\t\b\n\r\f\"\'\\'", "\t\b\n\r\f\"'\\"),
    ],
)
def test_a_string_may_have_every_escape(written: str, value: str) -> None:
    [row] = Store().query(check_text(f"SELECT ({written} AS ?x) {{}}").text)
    assert row[0].value == value


def test_escapes_of_names_are_taken() -> None:
    assert (
        check_text(r"SELECT ?\u0061b { ?ab ex:caf\u00E9 ?c # \u000a").text.rstrip()
        == "SELECT ?ab { ?ab ex:caf\u00e9 ?c"
    )
    assert (
        refusal(r"SELECT ?x { ?x ?y \u0022a\u0022 }").detail
        == "The backslash at 1:19 escapes nothing that can stand there."
    )


def test_an_update_of_one_graph_may_delete_and_insert() -> None:
    check_update_of_one_graph('PREFIX p: <h:p#> DELETE { ?m p:x ?x } INSERT { ?m p:x "GRAPH" } WHERE { ?m p:x ?x }')


@settings(max_examples=200)
@given(st.text(alphabet="SERVICEservice <>{}?x'\"\\u0053#\n.:", max_size=60))
def test_whatever_is_let_through_holds_no_service_outside_strings_iris_and_names(text: str) -> None:
    try:
        checked = check_text(text)
    except Problem:
        return
    assert not any("SERVICE" in token.text.upper() for token in checked.tokens if token.kind is Kind.WORD)
