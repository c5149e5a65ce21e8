"""Hostile input on every verb: 4xx problem details, the robot untouched, the server alive."""

from __future__ import annotations

import json
import socket
from urllib.parse import urlsplit

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
    "remote context": (JSONLD, b'{"@context": "http://127.0.0.1:1/context", "@id": "#message"}'),
    "wrong class": (TURTLE, b"<#message> a <https://w3id.org/rosld/types/std_msgs/msg/Bool> ."),
    "two values": (TURTLE, f'<#message> a <{STRING}> ; <{STRING}#data> "a", "b" .'.encode()),
    "own predicate": (TURTLE, f'<#message> a <{STRING}> ; <{STRING}#data> "a" ; <{STRING}#more> "b" .'.encode()),
    "elided": (TURTLE, f"<#message> a <{STRING}> ; <{STRING}#data> [ a <https://w3id.org/rosld#Elided> ] .".encode()),
    "entities": (
        "application/rdf+xml",
        b'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]><rdf:RDF '
        b'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">&b;</rdf:RDF>',
    ),
    "external entity": (
        "application/rdf+xml",
        b'<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><rdf:RDF '
        b'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">&a;</rdf:RDF>',
    ),
}
CALL_BODIES = {
    "infinite": (JSON, b'{"data": 1e999}'),
    "text": (JSON, b'{"data": "one"}'),
    "boolean": (JSON, b'{"data": true}'),
    "null": (JSON, b'{"data": null}'),
}


def refused(answer: httpx.Response) -> None:
    """It is a refusal with problem details that say something."""
    assert 400 <= answer.status_code < 500, (answer.status_code, answer.text[:300])
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert problem["status"] == answer.status_code
    assert len(problem["detail"]) > 10
    assert "Traceback" not in answer.text


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("method", ["PUT", "PATCH"])
def test_a_bad_body_publishes_nothing(http: httpx.Client, method: str, name: str) -> None:
    http.put(DISPLAY, json={"data": "untouched"})
    media_type, body = BODIES[name]
    headers = {"Content-Type": media_type, "If-Match": "*"}
    refused(http.request(method, DISPLAY, content=body, headers=headers))
    assert http.get(DISPLAY, headers={"Accept": JSON}).json() == {"data": "untouched"}


@pytest.mark.parametrize("name", [name for name in BODIES if name != "empty"] + list(CALL_BODIES))
def test_a_bad_body_calls_nothing(http: httpx.Client, name: str) -> None:
    calls = http.get("/calls/").text
    media_type, body = (BODIES | CALL_BODIES)[name]
    refused(http.post(SPEED, content=body, headers={"Content-Type": media_type}))
    assert http.get("/calls/").text == calls


@pytest.mark.parametrize(
    "name", ["not utf-8", "no turtle", "nul", "deep turtle", "deep json", "json twice", "entities"]
)
def test_a_bad_body_sets_nothing(http: httpx.Client, name: str) -> None:
    media_type, body = BODIES[name]
    refused(http.put(PARAMETER, content=body, headers={"Content-Type": media_type}))
    assert http.get(PARAMETER).status_code == 404


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Content-Type": "text/plain"}, 415),
        ({"Content-Type": "nonsense"}, 415),
        ({"Content-Type": "text/turtle; charset=klingon"}, 415),
        ({"Content-Type": "application/json", "Content-Encoding": "gzip"}, 415),
        ({"Content-Type": "application/json", "If-Match": "not a tag"}, 400),
        ({"Content-Type": "application/json", "If-Match": '"other"'}, 412),
        ({"Content-Type": "application/json", "If-None-Match": "*"}, 412),
        ({"Content-Type": "application/json", "Origin": "http://evil.example"}, 403),
        ({"Content-Type": "application/json", "Origin": "null"}, 403),
        ({"Content-Type": "application/json", "Sec-Fetch-Site": "cross-site"}, 403),
        ({"Content-Type": "application/json", "Host": "evil.example"}, 421),
    ],
)
def test_a_bad_header_publishes_nothing(http: httpx.Client, headers: dict[str, str], status: int) -> None:
    http.put(DISPLAY, json={"data": "untouched"})
    answer = http.put(DISPLAY, content=b'{"data": "evil"}', headers=headers)
    assert answer.status_code == status
    refused(answer)
    assert http.get(DISPLAY, headers={"Accept": JSON}).json() == {"data": "untouched"}


@pytest.mark.parametrize("method", ["GET", "PUT", "POST", "DELETE", "OPTIONS"])
def test_a_foreign_host_is_421_and_names_the_base(http: httpx.Client, method: str) -> None:
    answer = http.request(method, DISPLAY, headers={"Host": "rebound.example"})
    assert answer.status_code == 421
    assert str(http.base_url) in answer.json()["detail"]


def test_every_loopback_name_is_this_server_and_changes_no_iri(http: httpx.Client) -> None:
    port = http.base_url.port
    bodies = {
        http.get(SPEED.replace("set_speed", ""), headers={"Host": f"{name}:{port}"}).text
        for name in ("localhost", "127.0.0.1")
    }
    assert len(bodies) == 1
    assert f"http://127.0.0.1:{port}/" in bodies.pop()


@pytest.mark.parametrize("accept", ["image/png", "text/turtle;q=0", "application/nothing, */*;q=0"])
def test_what_is_not_offered_is_406_and_names_what_is(http: httpx.Client, accept: str) -> None:
    answer = http.get(DISPLAY, headers={"Accept": accept})
    assert answer.status_code == 406
    assert "text/turtle" in answer.json()["detail"]


@pytest.mark.parametrize(
    "path",
    [
        "/topics/%", "/topics/%zz", "/topics/%ff", "/topics/a%2Fb", "/topics//x", "/topics/a//b", "/%00", "/nothing",
        "/topics/..%2f..%2fetc/passwd", "/calls/a/b", "/types/x", "/bags/none", "/queries/none", "/ontology/x",
        "/topics/" + "a" * 5000, "/shapes/a/msg/B", "/types/std_msgs/msg/Nothing",
    ],
)  # fmt: skip
@pytest.mark.parametrize("method", ["GET", "HEAD", "PUT", "DELETE"])
def test_a_bad_path_is_a_4xx(http: httpx.Client, path: str, method: str) -> None:
    answer = http.request(method, path)
    assert 300 <= answer.status_code < 500, answer.text


def test_dots_in_a_raw_path_reach_nothing(http: httpx.Client) -> None:
    base = urlsplit(str(http.base_url))
    for path in ("/topics/../parameters/", "/topics/./x", "/topics/%2e%2e/x", "//topics/"):
        with socket.create_connection((base.hostname, base.port), timeout=5) as raw:
            raw.sendall(f"GET {path} HTTP/1.1\r\nHost: {base.netloc}\r\nConnection: close\r\n\r\n".encode())
            status = int(raw.recv(4096).split()[1])
        assert 300 <= status < 500, path


@pytest.mark.parametrize("method", ["TRACE", "CONNECT", "PROPFIND", "BREW"])
def test_an_unknown_method_is_405(http: httpx.Client, method: str) -> None:
    assert http.request(method, "/").status_code in (400, 405, 501)


def raw(http: httpx.Client, head: bytes) -> bytes:
    """What is answered to bytes that a client's library would not send."""
    with socket.create_connection((http.base_url.host, http.base_url.port or 80), timeout=10) as sock:
        host = f"Host: {http.base_url.netloc.decode()}\r\n".encode()
        sock.sendall(head.replace(b"\r\n", b"\r\n" + host, 1))
        found = b""
        while piece := sock.recv(65536):
            found += piece
        return found


def test_the_options_of_the_server_are_told(http: httpx.Client) -> None:
    answer = raw(http, b"OPTIONS * HTTP/1.1\r\nConnection: close\r\n\r\n").lower()
    assert answer.startswith(b"http/1.1 204")
    assert b"\r\nallow: delete, get, head, options, patch, post, put\r\n" in answer


def test_an_asterisk_is_no_url_of_anything(http: httpx.Client) -> None:
    assert raw(http, b"GET * HTTP/1.1\r\nConnection: close\r\n\r\n").startswith(b"HTTP/1.1 400")


@pytest.mark.parametrize(
    "head",
    [
        b"GET /topics/" + b"a" * 70_000 + b" HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nX: " + b"a" * 100_000 + b"\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + b"X: a\r\n" * 17_000 + b"\r\n",
        b"GET / HTTP/1.1\r\nConnection: upgrade\r\nUpgrade: h2c\r\nX: " + b"a" * 100_000 + b"\r\n\r\n",
    ],
)
def test_a_head_that_is_too_large_is_431_also_where_it_comes_at_once(http: httpx.Client, head: bytes) -> None:
    assert raw(http, head).startswith(b"HTTP/1.1 431")


@pytest.mark.parametrize("accept", ["application/xml", "text/xml"])
def test_who_accepts_xml_gets_rdf_xml(http: httpx.Client, accept: str) -> None:
    for path in ("/", "/nothing"):
        assert http.get(path, headers={"Accept": accept}).headers["content-type"] == "application/rdf+xml"


@pytest.mark.parametrize("accept", ["turtle", "text/html;q=2", ";;;", "\xff"])
def test_a_malformed_accept_is_ignored(http: httpx.Client, accept: str) -> None:
    answer = http.get("/", headers={"Accept": accept.encode("latin-1")})
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/turtle; charset=utf-8")


@pytest.mark.parametrize("query", ["rate=1_0", "rate=inf", "rate=%C2%B2", "rate=1&lease=1_0"])
def test_a_number_that_http_does_not_know_holds_nothing(http: httpx.Client, query: str) -> None:
    answer = http.post(f"{DISPLAY}?{query}", json={"data": "evil"})
    refused(answer)
    assert answer.status_code == 400
    assert http.get("/sparql", params={"query": "ASK {}", "timeout": "1_0"}).status_code == 400


def test_a_body_larger_than_the_limit_is_413_and_nothing_is_read_of_it(http: httpx.Client) -> None:
    answer = http.put(DISPLAY, content=json.dumps({"data": "x" * (11 << 20)}), headers={"Content-Type": JSON})
    assert answer.status_code == 413


def test_the_server_lives_after_all_that(http: httpx.Client) -> None:
    assert http.get("/").status_code == 200


def test_a_form_without_our_token_moves_nothing(http: httpx.Client) -> None:
    http.put(DISPLAY, json={"data": "untouched"})
    for fields in ({"data": "evil", "method": "PUT"}, {"data": "evil", "method": "PUT", "csrf": "guess"}):
        assert http.post(DISPLAY, data=fields).status_code == 403
    assert http.get(DISPLAY, headers={"Accept": JSON}).json() == {"data": "untouched"}


@pytest.mark.parametrize("key", ["latch=maybe", "latch=1", "defaults=yes"])
def test_a_flag_that_is_neither_true_nor_false_is_400(http: httpx.Client, key: str) -> None:
    assert http.put(f"{DISPLAY}?{key}", json={"data": "x"}).status_code == 400
