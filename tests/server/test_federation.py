"""SERVICE and LOAD: no request leaves the machine, except to the endpoints in the settings."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import httpx
import pytest

from tests.waiting import once_started

Served = Any
ANSWER = b'{"head":{"vars":["x"]},"results":{"bindings":[{"x":{"type":"literal","value":"from afar"}}]}}'
DOCUMENTS = {
    "/doc": (b"<#it> <urn:says> [ <urn:n> 1 ] .", "text/turtle"),
    "/latin": ("<#it> <urn:says> 'Zoë' .".encode("latin-1"), "text/turtle; charset=ISO-8859-1"),
    "/klingon": (b"<#it> <urn:says> 1 .", "text/turtle; charset=klingon"),
    "/page": (b"<html></html>", "text/html"),
    "/broken.ttl": (b"<#it> <urn:says>", "text/turtle"),
}
UPDATE = {"Content-Type": "application/sparql-update"}


class Endpoint(ThreadingHTTPServer):
    """A remote server: /sparql answers, /broken fails, /moved redirects to /sparql, /silent waits for its end."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.asked: list[str] = []
        self.ending = threading.Event()

    def url(self, path: str) -> str:
        return f"http://127.0.0.1:{self.server_port}/{path}"


class _Handler(BaseHTTPRequestHandler):
    server: Endpoint

    def do_POST(self) -> None:
        self.rfile.read(int(self.headers.get("Content-Length", 0)))
        self.server.asked.append(self.path)
        if self.path == "/silent":
            self.server.ending.wait(60)
        self.send_response({"/broken": 500, "/moved": 302}.get(self.path, 200))
        body, media_type = DOCUMENTS.get(self.path, (ANSWER, "application/sparql-results+json"))
        self.send_header("Content-Type", media_type)
        self.send_header("Location", self.server.url("sparql"))
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def do_GET(self) -> None:
        self.do_POST()

    def log_message(self, *arguments: object) -> None:
        pass


@pytest.fixture(scope="module")
def endpoint() -> Iterator[Endpoint]:
    running = Endpoint()
    thread = threading.Thread(target=running.serve_forever)
    thread.start()
    yield running
    running.ending.set()
    running.shutdown()
    thread.join()
    running.server_close()


@pytest.fixture(scope="module")
def federated(start_server: Callable[..., Served], endpoint: Endpoint) -> Served:
    listed = [
        each for path in ("sparql", "broken", "moved", "silent") for each in ("--allow-service", endpoint.url(path))
    ]
    return start_server("aircraft", *listed)


def ask(served: Served, query: str, **parameters: str) -> httpx.Response:
    answer: httpx.Response = served.http.get(
        "/sparql", params={"query": query, **parameters}, headers={"Accept": "text/csv, application/problem+json;q=0.9"}
    )
    return answer


def test_an_endpoint_that_is_listed_is_asked_each_time_anew(federated: Served, endpoint: Endpoint) -> None:
    before = len(endpoint.asked)
    query = f"SELECT ?x ?n {{ SERVICE <{endpoint.url('sparql')}> {{ ?s ?p ?x }} ?t a ros:Topic ; ros:name ?n }}"
    for _ in range(2):
        answer = ask(federated, query)
        assert answer.status_code == 200, answer.text
        assert "from afar,/cockpit/display" in answer.text
    assert endpoint.asked[before:] == ["/sparql", "/sparql"]


def test_an_endpoint_that_fails_is_502_and_silently_passed_over_where_asked_so(
    federated: Served, endpoint: Endpoint
) -> None:
    for path in ("broken", "moved"):
        query = f"SELECT ?x {{ SERVICE <{endpoint.url(path)}> {{ ?s ?p ?x }} }}"
        before = len(endpoint.asked)
        answer = ask(federated, query)
        assert answer.status_code == 502, answer.text
        assert endpoint.asked[before:] == [f"/{path}"]  # the target of a redirect is not queried
        assert ask(federated, query.replace("SERVICE", "SERVICE SILENT")).status_code == 200


def test_an_endpoint_that_does_not_answer_takes_no_longer_than_a_query_may(
    federated: Served, endpoint: Endpoint
) -> None:
    query = f"SELECT ?x {{ SERVICE <{endpoint.url('silent')}> {{ ?s ?p ?x }} }}"
    answer = once_started(lambda: ask(federated, query, timeout="0.5"))
    assert (answer.status_code, answer.json()["reason"]) == (503, "time")


REFUSED = [
    "SELECT * {{ SERVICE <{url}> {{ ?s ?p ?o }} }}",
    "SELECT * {{ SERVICE SILENT <{url}> {{ ?s ?p ?o }} }}",
    "SELECT * {{ SERVICE ?x {{ ?s ?p ?o }} }} VALUES ?x {{ <{url}> }}",
    "SELECT * {{ BIND(<{url}> AS ?x) SERVICE SILENT ?x {{ ?s ?p ?o }} }}",
    "PREFIX e: <{url}> SELECT * {{ SERVICE e: {{ ?s ?p ?o }} }}",
    "BASE <{url}> SELECT * {{ SERVICE <> {{ ?s ?p ?o }} }}",
    "SELECT * {{ ?s ?p ?o FILTER EXISTS {{ SERVICE <{url}> {{ ?a ?b ?c }} }} }}",
    "SELECT * {{ {{ SELECT * {{ SERVICE <{url}> {{ ?a ?b ?c }} }} }} }}",
]


def test_no_request_leaves_the_machine_however_it_is_written(
    aircraft: Served, federated: Served, endpoint: Endpoint
) -> None:
    before, url = len(endpoint.asked), endpoint.url("other")
    for query in REFUSED:
        for served in (aircraft, federated):
            answer = ask(served, query.format(url=url))
            assert answer.status_code == 400, (query, answer.text)
            assert "SERVICE" in answer.text
    for query in (
        f"SELECT * FROM <{url}> {{ ?s ?p ?o }}",
        f"SELECT * FROM NAMED <{url}> {{ GRAPH ?g {{ ?s ?p ?o }} }}",
        f"DESCRIBE <{url}>",
        f"SELECT (<{url}>(1) AS ?x) {{ }}",
    ):
        assert ask(aircraft, query).status_code < 500
        assert ask(aircraft, query, **{"default-graph-uri": url}).status_code < 500
    for update in (
        f"LOAD <{url}>",
        f"LOAD SILENT <{url}> INTO GRAPH <x:y>",
        f"INSERT {{ ?s ?p ?o }} WHERE {{ SERVICE <{url}> {{ ?s ?p ?o }} }}",
    ):
        for path in ("/sparql", "/topics/cockpit/display", "/data/"):
            method = "POST" if path == "/sparql" else "PATCH"
            answer = aircraft.http.request(method, path, content=update, headers=UPDATE)
            silent = "SILENT" in update and method == "POST"  # errors are ignored (Update, 3.1.4)
            assert answer.status_code == 204 if silent else 400 <= answer.status_code < 500, answer.text
    assert len(endpoint.asked) == before


def test_an_endpoint_is_listed_by_its_whole_url_letter_by_letter(federated: Served, endpoint: Endpoint) -> None:
    before, url = len(endpoint.asked), endpoint.url("sparql")
    near = [f"{url}/other", f"{url}ing", f"{url}?query=x", url[:-1], url.replace("http://", "http://x@")]
    for each in (*near, url.replace("sparql", "%73parql"), url.replace("sparql", "other/../sparql")):
        for keyword in ("SERVICE", "service silent"):
            answer = ask(federated, f"SELECT * {{ {keyword} <{each}> {{ ?s ?p ?o }} }}")
            assert answer.status_code == 400, answer.text
            assert "full URL" in answer.json()["detail"]
    assert len(endpoint.asked) == before


def test_settings_refuse_what_is_no_url_to_ask() -> None:
    from rosld.server.settings import Settings

    for url in ("a.example/sparql", "ftp://a.example/", "http://a.example/<x>", "http:///x"):
        with pytest.raises(ValueError, match="--allow-service"):
            Settings(allow_service=(url,))
        with pytest.raises(ValueError, match="--allow-load"):
            Settings(allow_load=(url,))


@pytest.mark.slow
def test_documents_that_are_listed_are_loaded_into_a_graph_and_no_others(
    serve: Callable[..., Served], endpoint: Endpoint
) -> None:
    urls = {name: endpoint.url(name) for name in ("doc", "latin", "klingon", "page", "broken.ttl", "moved")}
    http = serve("aircraft", *(word for url in urls.values() for word in ("--allow-load", url))).http
    urls["unlisted"] = endpoint.url("unlisted")

    def load(name: str, into: str = " INTO GRAPH </data/other>", how: str = "LOAD") -> int:
        found: int = http.post("/sparql", content=f"{how} <{urls[name]}>{into}", headers=UPDATE).status_code
        return found

    assert load("doc", " INTO GRAPH </data/loaded>") == 204
    found = http.get("/data/loaded", headers={"Accept": "application/n-triples"}).text
    assert f"<{urls['doc']}#it> <urn:says> _:" in found
    assert load("latin", " INTO GRAPH </data/latin>") == 204
    assert '"Zoë"' in http.get("/data/latin", headers={"Accept": "application/n-triples"}).text
    assert load("doc", "") == 204
    assert "urn:says" in http.get("/data/default").text
    refused = {"klingon": 422, "page": 422, "broken.ttl": 422, "moved": 502, "unlisted": 403}
    assert {name: load(name) for name in refused} == refused
    for name in ("moved", "unlisted", "page"):
        assert load(name, how="LOAD SILENT") == 204
    for into in (" INTO GRAPH </topics/>", ""):
        assert load("doc", into, "LOAD SILENT") == 204
    assert http.get("/data/other").status_code == 404
