"""The SPARQL 1.1 Protocol: how a query arrives, and each wrong use told as what it is."""

from __future__ import annotations

from contextlib import suppress
from urllib.parse import quote

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.http.problem import Problem
from rosld.server.sparql.protocol import DIRECT, FORM, QueryRequest, query_request

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
    assert query_request("POST", b"", f"{DIRECT};charset=utf-8", Q.encode()) == expected


def test_a_plus_is_a_blank_in_urls_and_forms() -> None:
    assert query_request("GET", b"query=ASK+%7B%7D").text == "ASK {}"


def test_the_dataset_comes_beside_the_query_once_each() -> None:
    graphs = b"default-graph-uri=http://h/a&default-graph-uri=http://h/a&named-graph-uri=http://h/b%3Fc"
    expected = QueryRequest(Q, ("http://h/a",), ("http://h/b?c",))
    assert query_request("GET", b"query=" + ENCODED + b"&" + graphs) == expected
    assert query_request("POST", graphs, DIRECT, Q.encode()) == expected
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
        (("POST", b"query=a", DIRECT, b"b"), 400, "2 queries"),
        (("POST", b"query=a", FORM, b"query=a"), 400, "one of them"),
        (("POST", b"query=a", FORM, b""), 400, "one of them"),
        (("POST", b"", FORM, b""), 400, "no query"),
        (("POST", b"", FORM, b"update=x"), 400, "update"),
        (("POST", b"", DIRECT, b"\xff\xfe"), 400, "UTF-8"),
        (("POST", b"", f"{DIRECT}; charset=latin1", b"x"), 415, "UTF-8"),
        (("POST", b"", "text/plain", b"x"), 415, DIRECT),
        (("POST", b"", "application/sparql-update", b"x"), 415, "Updates"),
        (("POST", b"", None, b"x"), 415, "Content-Type"),
        (("POST", b"", "nonsense", b"x"), 415, "nonsense"),
    ],
)
def test_each_wrong_use_has_its_status_and_its_words(request_: tuple[str, bytes], status: int, words: str) -> None:
    found, detail = refusal(*request_)
    assert found == status
    assert words in detail


@given(st.text(), st.lists(st.sampled_from(["query", "default-graph-uri", "update", "ü"])), st.binary())
def test_nothing_that_arrives_makes_it_raise_anything_else(text: str, names: list[str], body: bytes) -> None:
    raw = "&".join(f"{quote(name)}={quote(text.encode('utf-8', 'replace'))}" for name in names).encode() + body
    for content_type in (None, FORM, DIRECT, text):
        for method in ("GET", "POST"):
            with suppress(Problem):
                query_request(method, raw, content_type, body)
