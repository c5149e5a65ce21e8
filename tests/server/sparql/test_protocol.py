"""The SPARQL 1.1 Protocol: errors for each wrong use. Valid requests are in `tests/conformance/sparql`."""

from __future__ import annotations

from contextlib import suppress
from urllib.parse import quote

import httpx
from hypothesis import given
from hypothesis import strategies as st

QUERY, UPDATE = "application/sparql-query", "application/sparql-update"
FORM = "application/x-www-form-urlencoded"
WITH = "CLEAR GRAPH <http://h/c> ; WITH <http://h/b> DELETE { ?s ?p 1 } WHERE { ?s ?p 1 }"
WRONG: list[tuple[str, str | None, bytes | None, int, str]] = [
    ("update=CLEAR%20ALL", None, None, 400, "update"),
    ("query=a&query=b", None, None, 400, "2 queries"),
    ("query=%FF", None, None, 400, "utf-8"),
    ("query=a&default-graph-uri=nowhere", None, None, 400, "nowhere"),
    ("query=a&named-graph-uri=http://h/%3E", None, None, 400, "not an absolute IRI"),
    ("&".join(["a=b"] * 2000), None, None, 400, "fields"),
    ("query=a&update=b", None, None, 400, "not in the URL"),
    ("query=a&using-graph-uri=http://h/", None, None, 400, "using-graph-uri"),
    ("query=a", QUERY, b"b", 400, "2 queries"),
    ("query=a", FORM, b"query=a", 400, "one of them"),
    ("", FORM, b"", 400, "no query"),
    ("update=x", FORM, b"query=a", 400, "?update"),
    ("", FORM, b"query=a&update=x", 400, "a query and an update"),
    ("", QUERY, b"\xff\xfe", 400, "UTF-8"),
    ("", f"{QUERY}; charset=klingon", b"x", 415, "UTF-8"),
    ("", "text/plain", b"x", 415, QUERY),
    ("", None, b"x", 415, "Content-Type"),
    ("", "nonsense", b"x", 415, "nonsense"),
    ("", FORM, b"update=a&update=b", 400, "2 updates"),
    ("query=a", UPDATE, b"b", 400, "a query and an update"),
    ("update=a", UPDATE, b"b", 400, "?update"),
    ("", UPDATE, b"\xff\xfe", 400, "UTF-8"),
    ("", f"{UPDATE}; charset=utf-16", b"x", 415, "UTF-8"),
    ("using-graph-uri=nowhere", UPDATE, b"x", 400, "nowhere"),
    ("default-graph-uri=http://h/", UPDATE, b"x", 400, "using-graph-uri"),
    ("using-named-graph-uri=http://h/a", UPDATE, b"INSERT {} USINGNAMED<http://h/b> WHERE {}", 400, ""),
    ("using-graph-uri=http://h/a", UPDATE, WITH.encode(), 400, "WITH at 1:28"),
]


def send(http: httpx.Client, query: str, content_type: str | None, body: bytes | None) -> httpx.Response:
    headers = {} if content_type is None else {"Content-Type": content_type}
    url = f"/sparql?{query}"
    return http.get(url) if body is None else http.post(url, content=body, headers=headers)


def test_each_wrong_use_has_its_status_and_its_words(http: httpx.Client) -> None:
    wrong = []
    for query, content_type, body, status, words in WRONG:
        answer = send(http, query, content_type, body)
        if answer.status_code != status or words not in answer.json()["detail"]:
            wrong.append((query[:80], content_type, body, answer.status_code, answer.text))
    assert not wrong, wrong


def test_words_in_strings_names_and_comments_are_no_dataset(http: httpx.Client) -> None:
    inserted = "GRAPH <data/w> { ?using with:using 'WITH' }"
    text = f"PREFIX with: <http://h/> # USING\nINSERT {{ {inserted} }} WHERE {{ ?using ?p ?o }}"
    query = f"using-graph-uri={quote(str(http.base_url.join('data/nothing')))}"
    assert send(http, query, UPDATE, text.encode()).status_code == 204


@given(st.text(), st.lists(st.sampled_from(["query", "default-graph-uri", "update", "ü"])), st.binary())
def test_nothing_that_arrives_is_an_error_of_the_server(
    http: httpx.Client, text: str, names: list[str], body: bytes
) -> None:
    raw = "&".join(f"{quote(name)}={quote(text.encode('utf-8', 'replace'))}" for name in names)
    for content_type in (FORM, QUERY, UPDATE):
        answer = send(http, raw, content_type, body)
        assert answer.status_code < 500, answer.text
    with suppress(httpx.InvalidURL):  # too long for the client
        assert send(http, raw, None, None).status_code < 500
