"""RDF in every syntax, beyond single documents (`tests/crawl` compares those)."""

from __future__ import annotations

import httpx
from pyoxigraph import RdfFormat, parse

COMPACT = [".well-known/solid", "channels/WebSocketChannel2023", "channels/StreamingHTTPChannel2023"]
"""Resources with a special JSON-LD for clients without RDF, which is less complete."""


def test_the_whole_dataset_is_there_in_rdf_xml(http: httpx.Client) -> None:
    answer = http.get("graphs?default", headers={"Accept": "application/rdf+xml"})
    assert answer.status_code == 200, answer.text[:300]
    assert sum(1 for _ in parse(answer.content, RdfFormat.RDF_XML)) > 1000


def test_what_a_client_says_with_other_letters_than_ascii_is_there_in_rdf_xml(http: httpx.Client) -> None:
    turtle = "<> <http://h/vokabular#größe> 5 ; <http://h/vokabular#名前> 'x' ; <http://h/vokabular#é> 'y' ."
    assert http.put("data/letters", content=turtle, headers={"Content-Type": "text/turtle"}).status_code == 201
    answer = http.get("data/letters", headers={"Accept": "application/rdf+xml"})
    assert answer.status_code == 200, answer.text
    said = {quad.predicate.value.partition("#")[2] for quad in parse(answer.content, RdfFormat.RDF_XML)}
    assert {"größe", "名前", "é"} <= said
    assert http.delete("data/letters").status_code == 204


def test_compact_json_ld_of_notifications_needs_no_context_of_another_host(http: httpx.Client) -> None:
    for path in COMPACT:
        answer = http.get(path, headers={"Accept": "application/ld+json"})
        assert answer.headers["content-type"] == "application/ld+json"
        assert "id" in answer.json(), "clients without RDF read it by its names"
        found = {quad.triple for quad in parse(answer.content, RdfFormat.JSON_LD, base_iri=str(answer.url))}
        assert len(found) >= 6
        whole = http.get(path, headers={"Accept": "application/n-triples"}).content
        assert found <= {quad.triple for quad in parse(whole, RdfFormat.N_TRIPLES)}


def test_no_header_is_empty(http: httpx.Client) -> None:
    for path in (*COMPACT, "", "stop", "sparql", "openapi.json", "style.css", "topics/", "data/", "ontology"):
        for method in ("HEAD", "OPTIONS"):
            answer = http.request(method, path)
            assert answer.status_code < 300, answer.text
            assert [name for name, value in answer.headers.multi_items() if not value] == [], (method, path)
