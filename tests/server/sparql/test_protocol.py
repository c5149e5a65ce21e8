"""The SPARQL 1.1 Protocol: wrong uses beyond the tests of W3C, which are in `tests/conformance/sparql`."""

from __future__ import annotations

from urllib.parse import quote

import httpx

QUERY, UPDATE = "application/sparql-query", "application/sparql-update"
FORM = "application/x-www-form-urlencoded"
WITH = "CLEAR GRAPH <http://h/c> ; WITH <http://h/b> DELETE { ?s ?p 1 } WHERE { ?s ?p 1 }"
WRONG: list[tuple[str, str | None, bytes | None, int, str]] = [
    ("query=%FF", None, None, 400, "utf-8"),
    ("query=a&default-graph-uri=nowhere", None, None, 400, "nowhere"),
    ("query=a&named-graph-uri=http://h/%3E", None, None, 400, "not an absolute IRI"),
    ("&".join(["a=b"] * 2000), None, None, 400, "fields"),
    ("query=a&update=b", None, None, 400, "not in the URL"),
    ("query=a", FORM, b"query=a", 400, "one of them"),
    ("", FORM, b"", 400, "no query"),
    ("update=x", FORM, b"query=a", 400, "?update"),
    ("", f"{QUERY}; charset=klingon", b"x", 415, "UTF-8"),
    ("", "nonsense", b"x", 415, "nonsense"),
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
