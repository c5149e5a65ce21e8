"""The SPARQL 1.1 Protocol: how queries and updates arrive, and each wrong use told as what it is."""

from __future__ import annotations

from contextlib import suppress
from urllib.parse import quote

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.http.charset import FORM
from rosld.server.http.problem import Problem
from rosld.server.sparql.protocol import (
    QUERY_MEDIA_TYPE,
    UPDATE_MEDIA_TYPE,
    QueryRequest,
    UpdateRequest,
    posted_request,
    query_request,
)

Q = "SELECT * { ?s ?p 'a+b & ü' }"
ENCODED = quote(Q, safe="").encode()


def refusal(
    method: str, query_string: bytes = b"", content_type: str | None = None, body: bytes = b""
) -> tuple[int, str]:
    with pytest.raises(Problem) as caught:
        query_request(method, query_string, content_type, body)
    return caught.value.status, caught.value.detail


@pytest.mark.parametrize("content_type", [FORM, FORM.upper(), f"{FORM}; charset=UTF-8"])
def test_a_query_comes_in_the_url_in_a_form_or_directly(content_type: str) -> None:
    expected = QueryRequest(Q)
    assert query_request("GET", b"query=" + ENCODED) == expected
    assert query_request("HEAD", b"x=1&query=" + ENCODED + b"&unknown=%41") == expected
    assert query_request("POST", b"", content_type, b"query=" + ENCODED) == expected
    assert query_request("POST", b"", f"{QUERY_MEDIA_TYPE};charset=utf-8", Q.encode()) == expected


def test_a_plus_is_a_blank_in_urls_and_forms() -> None:
    assert query_request("GET", b"query=ASK+%7B%7D").text == "ASK {}"


def test_the_dataset_comes_beside_the_query_once_each() -> None:
    graphs = b"default-graph-uri=http://h/a&default-graph-uri=http://h/a&named-graph-uri=http://h/b%3Fc"
    expected = QueryRequest(Q, ("http://h/a",), ("http://h/b?c",))
    assert query_request("GET", b"query=" + ENCODED + b"&" + graphs) == expected
    assert query_request("POST", graphs, QUERY_MEDIA_TYPE, Q.encode()) == expected
    assert query_request("POST", b"", FORM, b"query=" + ENCODED + b"&" + graphs) == expected


@pytest.mark.parametrize(
    ("request_", "status", "words"),
    [
        (("GET", b""), 400, "no query"),
        (("GET", b"update=CLEAR%20ALL"), 400, "update"),
        (("GET", b"query=a&query=b"), 400, "2 queries"),
        (("GET", b"query=%FF"), 400, "UTF-8"),
        (("GET", b"query=\xff"), 400, "percent-encoded"),
        (("GET", b"query=a&default-graph-uri=nowhere"), 400, "nowhere"),
        (("GET", b"query=a&named-graph-uri=http://h/%3E"), 400, "no absolute IRI"),
        (("GET", b"&".join([b"a=b"] * 2000)), 400, "1000 parameters"),
        (("POST", b"query=a", QUERY_MEDIA_TYPE, b"b"), 400, "2 queries"),
        (("POST", b"query=a", FORM, b"query=a"), 400, "one of them"),
        (("POST", b"query=a", FORM, b""), 400, "one of them"),
        (("POST", b"", FORM, b""), 400, "no query"),
        (("POST", b"", FORM, b"update=x"), 400, "update"),
        (("POST", b"update=x", FORM, b"query=a"), 400, "never in the URL"),
        (("POST", b"", FORM, b"query=a&update=x"), 400, "a query and an update"),
        (("GET", b"query=a&update=b"), 400, "never in the URL"),
        (("GET", b"query=a&using-graph-uri=http://h/"), 400, "using-graph-uri"),
        (("POST", b"", QUERY_MEDIA_TYPE, b"\xff\xfe"), 400, "UTF-8"),
        (("POST", b"", f"{QUERY_MEDIA_TYPE}; charset=klingon", b"x"), 415, "UTF-8"),
        (("POST", b"", "text/plain", b"x"), 415, QUERY_MEDIA_TYPE),
        (("POST", b"", UPDATE_MEDIA_TYPE, b"x"), 400, "only queries"),
        (("POST", b"", None, b"x"), 415, "Content-Type"),
        (("POST", b"", "nonsense", b"x"), 415, "nonsense"),
    ],
)
def test_each_wrong_use_has_its_status_and_its_words(request_: tuple[str, bytes], status: int, words: str) -> None:
    found, detail = refusal(*request_)
    assert found == status
    assert words in detail


U = "INSERT DATA { GRAPH <http://h/g> { <http://h/s> <http://h/p> 'a+b & ü' } }"


def update_refusal(query_string: bytes, content_type: str | None, body: bytes) -> tuple[int, str]:
    with pytest.raises(Problem) as caught:
        posted_request(query_string, content_type, body)
    return caught.value.status, caught.value.detail


def test_an_update_comes_in_a_form_or_directly_with_its_dataset_beside_it() -> None:
    graphs = b"using-graph-uri=http://h/a&using-graph-uri=http://h/a&using-named-graph-uri=http://h/b"
    form = b"update=" + quote(U, safe="").encode()
    assert posted_request(b"", UPDATE_MEDIA_TYPE, U.encode()) == posted_request(b"", FORM, form) == UpdateRequest(U)
    expected = UpdateRequest(U, ("http://h/a",), ("http://h/b",))
    assert posted_request(graphs, f"{UPDATE_MEDIA_TYPE}; charset=utf-8", U.encode()) == expected
    assert posted_request(b"", FORM, form + b"&" + graphs) == posted_request(graphs, FORM, form) == expected


@pytest.mark.parametrize(
    ("request_", "status", "words"),
    [
        ((b"", FORM, b"update=a&update=b"), 400, "2 updates"),
        ((b"", FORM, b"update=a&query=b"), 400, "a query and an update"),
        ((b"query=a", UPDATE_MEDIA_TYPE, b"b"), 400, "a query and an update"),
        ((b"update=a", UPDATE_MEDIA_TYPE, b"b"), 400, "never in the URL"),
        ((b"", UPDATE_MEDIA_TYPE, b"\xff\xfe"), 400, "UTF-8"),
        ((b"", f"{UPDATE_MEDIA_TYPE}; charset=utf-16", b"x"), 415, "UTF-8"),
        ((b"", "text/plain", b"x"), 415, UPDATE_MEDIA_TYPE),
        ((b"", None, b"x"), 415, "Content-Type"),
        ((b"using-graph-uri=nowhere", UPDATE_MEDIA_TYPE, b"x"), 400, "nowhere"),
        ((b"default-graph-uri=http://h/", UPDATE_MEDIA_TYPE, b"x"), 400, "using-graph-uri"),
    ],
)
def test_each_wrong_update_has_its_status_and_its_words(
    request_: tuple[bytes, str | None, bytes], status: int, words: str
) -> None:
    found, detail = update_refusal(*request_)
    assert found == status
    assert words in detail


@pytest.mark.parametrize("clause", ["USING <http://h/b>", "using named <http://h/b>", "USINGNAMED<http://h/b>"])
def test_graphs_are_named_in_an_update_or_beside_it(clause: str) -> None:
    text = f"DELETE {{ ?s ?p 1 }} {clause} WHERE {{ ?s ?p 1 }}"
    assert posted_request(b"", UPDATE_MEDIA_TYPE, text.encode()) == UpdateRequest(text)
    assert update_refusal(b"using-named-graph-uri=http://h/a", UPDATE_MEDIA_TYPE, text.encode())[0] == 400


def test_with_is_a_dataset_too() -> None:
    text = "CLEAR GRAPH <http://h/c> ; WITH <http://h/b> DELETE { ?s ?p 1 } WHERE { ?s ?p 1 }"
    status, detail = update_refusal(b"using-graph-uri=http://h/a", UPDATE_MEDIA_TYPE, text.encode())
    assert status == 400
    assert "WITH at 1:28" in detail


def test_words_in_strings_names_and_comments_are_no_dataset() -> None:
    text = "PREFIX with: <http://h/> # USING\nINSERT { ?using with:using 'WITH' } WHERE { ?s ?p ?using }"
    assert posted_request(b"using-graph-uri=http://h/a", UPDATE_MEDIA_TYPE, text.encode()) == UpdateRequest(
        text, ("http://h/a",)
    )


@given(st.text(), st.lists(st.sampled_from(["query", "default-graph-uri", "update", "ü"])), st.binary())
def test_nothing_that_arrives_makes_it_raise_anything_else(text: str, names: list[str], body: bytes) -> None:
    raw = "&".join(f"{quote(name)}={quote(text.encode('utf-8', 'replace'))}" for name in names).encode() + body
    for content_type in (None, FORM, QUERY_MEDIA_TYPE, UPDATE_MEDIA_TYPE, text):
        for method in ("GET", "POST"):
            with suppress(Problem):
                query_request(method, raw, content_type, body)
        with suppress(Problem):
            posted_request(raw, content_type, body)
