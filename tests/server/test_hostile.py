"""Malicious input for every method: 4xx problem details, the robot unaffected, the server alive."""

from __future__ import annotations

import socket

import httpx
import pytest

STRING = "https://w3id.org/rosld/types/std_msgs/msg/String"
DISPLAY = "/topics/cockpit/display"
SPEED = "/services/aircraft/engine/set_speed"
PARAMETER = "/parameters/hostile"
TURTLE, JSON, JSONLD = "text/turtle", "application/json", "application/ld+json"

BODIES = {
    "empty": (TURTLE, b""),
    "not utf-8": (TURTLE, b"\xff\xfe"),
    "no turtle": (TURTLE, b"<a <b"),
    "no message": (TURTLE, b"<x:a> <x:b> <x:c> ."),
    "nul": (TURTLE, b"\x00" * 100),
    "deep turtle": (TURTLE, b"<> <x:p> " + b"[ <x:p> " * 20000 + b"]" * 20000 + b"."),
    "deep collection": (TURTLE, b"<> <x:p> " + b"(" * 20000 + b")" * 20000 + b"."),
    "empty json": (JSON, b""),
    "no json": (JSON, b"{data: 1}"),
    "json array": (JSON, b"[1]"),
    "json nan": (JSON, b'{"data": NaN}'),
    "json twice": (JSON, b'{"data": "a", "data": "b"}'),
    "deep json": (JSON, b'{"data":' + b"[" * 50000 + b"]" * 50000 + b"}"),
    "wrong type": (JSON, b'{"data": {"a": 1}}'),
    "unknown field": (JSON, b'{"data": "a", "rm": "-rf"}'),
    "lone surrogate": (JSON, b'{"data": "\\ud800"}'),
    "deep json-ld": (JSONLD, b'{"x:p":' * 20000 + b"1" + b"}" * 20000),
    "wrong class": (TURTLE, b"<#message> a <https://w3id.org/rosld/types/std_msgs/msg/Bool> ."),
    "two values": (TURTLE, f'<#message> a <{STRING}> ; <{STRING}#data> "a", "b" .'.encode()),
    "own predicate": (TURTLE, f'<#message> a <{STRING}> ; <{STRING}#data> "a" ; <{STRING}#more> "b" .'.encode()),
    "elided": (TURTLE, f"<#message> a <{STRING}> ; <{STRING}#data> [ a <https://w3id.org/rosld#Elided> ] .".encode()),
}
CALL_BODIES = {
    "infinite": (JSON, b'{"data": 1e999}'),
    "text": (JSON, b'{"data": "one"}'),
    "boolean": (JSON, b'{"data": true}'),
    "null": (JSON, b'{"data": null}'),
}


def refused(answer: httpx.Response) -> None:
    """Check that it is a refusal with meaningful problem details."""
    assert 400 <= answer.status_code < 500, (answer.status_code, answer.text[:300])
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert problem["status"] == answer.status_code
    assert len(problem["detail"]) > 10
    assert "Traceback" not in answer.text


def test_a_bad_body_publishes_nothing(http: httpx.Client) -> None:
    http.put(DISPLAY, json={"data": "untouched"})
    for media_type, body in BODIES.values():
        for method in ("PUT", "PATCH"):
            refused(http.request(method, DISPLAY, content=body, headers={"Content-Type": media_type, "If-Match": "*"}))
    assert http.get(DISPLAY, headers={"Accept": JSON}).json() == {"data": "untouched"}


def test_a_bad_body_calls_nothing_and_sets_nothing(http: httpx.Client) -> None:
    calls = http.get("/calls/").text
    for name, (media_type, body) in (BODIES | CALL_BODIES).items():
        if name != "empty":
            refused(http.post(SPEED, content=body, headers={"Content-Type": media_type}))
    assert http.get("/calls/").text == calls
    for name in ("not utf-8", "no turtle", "nul", "deep turtle", "deep json", "json twice"):
        media_type, body = BODIES[name]
        refused(http.put(PARAMETER, content=body, headers={"Content-Type": media_type}))
    assert http.get(PARAMETER).status_code == 404


def test_a_bad_header_or_option_publishes_nothing(http: httpx.Client) -> None:
    http.put(DISPLAY, json={"data": "untouched"})
    for headers, status in BAD_HEADERS:
        answer = http.put(DISPLAY, content=b'{"data": "evil"}', headers={"Content-Type": JSON, **headers})
        assert answer.status_code == status, (headers, answer.text)
        refused(answer)
    for query in ("latch=maybe", "latch=1", "defaults=yes"):
        assert http.put(f"{DISPLAY}?{query}", json={"data": "evil"}).status_code == 400, query
    for query in ("rate=1_0", "rate=inf", "rate=%C2%B2", "rate=1&lease=1_0"):
        assert http.post(f"{DISPLAY}?{query}", json={"data": "evil"}).status_code == 400, query
    assert http.get("/sparql", params={"query": "ASK {}", "timeout": "1_0"}).status_code == 400
    assert http.get(DISPLAY, headers={"Accept": JSON}).json() == {"data": "untouched"}


BAD_HEADERS = (
    ({"Content-Type": "text/plain"}, 415),
    ({"Content-Type": "nonsense"}, 415),
    ({"Content-Type": "text/turtle; charset=klingon"}, 415),
    ({"Content-Encoding": "gzip"}, 415),
    ({"If-Match": "not a tag"}, 400),
    ({"If-Match": '"other"'}, 412),
    ({"If-None-Match": "*"}, 412),
)


def raw(http: httpx.Client, head: bytes) -> bytes:
    """Return the response to bytes that no client library would send."""
    with socket.create_connection((http.base_url.host, http.base_url.port or 80), timeout=10) as sock:
        host = f"Host: {http.base_url.netloc.decode()}\r\n".encode()
        sock.sendall(head.replace(b"\r\n", b"\r\n" + host, 1))
        found = b""
        while piece := sock.recv(65536):
            found += piece
        return found


def test_an_asterisk_asks_for_the_options_of_the_server_and_for_nothing_else(http: httpx.Client) -> None:
    answer = raw(http, b"OPTIONS * HTTP/1.1\r\nConnection: close\r\n\r\n").lower()
    assert answer.startswith(b"http/1.1 204")
    assert b"\r\nallow: delete, get, head, options, patch, post, put\r\n" in answer
    assert raw(http, b"GET * HTTP/1.1\r\nConnection: close\r\n\r\n").startswith(b"HTTP/1.1 400")


LONG = f"http://x/{'a' * 20_000}/"
TRIPLES = f"x: x: x:{',x:' * 12_000}"
"""300 MB when expanded."""
SOLID = "http://www.w3.org/ns/solid/terms#"


@pytest.mark.slow
def test_a_body_whose_prefixes_expand_too_far_is_413(http: httpx.Client) -> None:
    patch = f"[ a <{SOLID}InsertDeletePatch> ; <{SOLID}inserts> {{ {TRIPLES} }} ] ."
    for method, path, media_type, body in (
        ("PUT", "/data/expanded", "text/turtle", f"@prefix x: <{LONG}> . {TRIPLES} ."),
        ("POST", "/sparql", "application/sparql-update", f"PREFIX x: <{LONG}> INSERT DATA {{ {TRIPLES} }}"),
        (
            "POST",
            "/sparql",
            "application/sparql-query",
            f"PREFIX x: <{LONG}> ASK {{ VALUES ?x {{ {'x: ' * 12_000} }} }}",
        ),
        ("PATCH", "/data/", "text/n3", f"@prefix x: <{LONG}> . {patch}"),
    ):
        answer = http.request(method, path, content=body, headers={"Content-Type": media_type})
        assert answer.status_code == 413, (method, path)
        assert "shorten the prefixes" in answer.json()["detail"]
