"""Named attacks on a robot without --auth: refused, with the robot unchanged."""

from __future__ import annotations

import gzip
import json
import re
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle
from typing import Any
from urllib.parse import quote

import httpx
import pytest

pytestmark = pytest.mark.slow

JSON = {"Content-Type": "application/json"}
TURTLE = {"Content-Type": "text/turtle"}
HTML = {"Accept": "text/html"}
DISPLAY, START, SEATS = "/topics/cockpit/display", "/services/aircraft/start", "/parameters/aircraft/seats"
POWER = "/resources/aircraft/power"
EVIL = "https://evil.example"
IMPATIENT = ("--setting", "head_timeout", "1", "--setting", "body_timeout", "1")


@dataclass
class Target:
    """A robot under attack: its server, and its initial state."""

    url: str
    http: httpx.Client

    def state(self) -> tuple[bytes, ...]:
        """Return all state that an attack here would change."""
        plain = {"Accept": "application/json"}
        return tuple(self.http.get(path, headers=plain).content for path in (POWER, SEATS, "/parameters/", DISPLAY))

    @property
    def address(self) -> tuple[str, int]:
        host, port = self.url.removeprefix("http://").rstrip("/").split(":")
        return host, int(port)

    def raw(self, sent: bytes) -> bytes:
        """Return the complete response to bytes that no client library would send."""
        with socket.create_connection(self.address, timeout=10) as sock:
            sock.sendall(sent)
            return b"".join(iter(lambda: sock.recv(65536), b""))


@pytest.fixture(scope="module")
def robot(start_server: Callable[..., Any]) -> Target:
    """The robot under attack."""
    served = start_server("aircraft", *IMPATIENT)
    found = Target(served.url, served.http)
    assert found.http.put(DISPLAY, json={"data": "calm"}).status_code == 204
    return found


@pytest.fixture
def target(robot: Target) -> Iterator[Target]:
    """The robot, checked to be unchanged after the attack."""
    before = robot.state()
    yield robot
    assert robot.state() == before, "the robot was moved"


def writes() -> Iterator[tuple[str, str, Mapping[str, str], bytes]]:
    """Yield a write of each kind that would move the robot."""
    yield "PUT", DISPLAY, JSON, b'{"data": "owned"}'
    yield "POST", START, JSON, b"{}"
    yield "PUT", SEATS, JSON, b"666"
    yield "DELETE", SEATS, {}, b""
    yield "PUT", POWER, JSON, b'"on"'
    yield "POST", f"{DISPLAY}?rate=10", JSON, b'{"data": "owned"}'
    yield "POST", "/stop", {}, b""
    update = f"INSERT DATA {{ GRAPH <{SEATS}> {{ <{SEATS}> <https://w3id.org/rosld#value> 666 }} }}"
    yield "POST", "/sparql", {"Content-Type": "application/sparql-update"}, update.encode()
    yield "PUT", f"/graphs?graph={SEATS}", TURTLE, f"<{SEATS}> <https://w3id.org/rosld#value> 666 .".encode()
    yield "PUT", "/data/owned", TURTLE, b"<> a <#Owned> ."


WRITES = tuple(writes())


def test_cross_site_request(target: Target) -> None:
    pages = ({"Origin": EVIL}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"}, {"Sec-Fetch-Site": "same-site"})
    for method, path, headers, body in WRITES:
        for page in pages:
            answer = target.http.request(method, path, headers={**headers, **page}, content=body)
            assert answer.status_code == 403, (method, path, page, answer.text)
            assert "access-control-allow-origin" not in answer.headers


def test_cross_site_form_without_an_origin(target: Target) -> None:
    forms = ({"data": "x"}, {"data": "x", "method": "POST"}, {"data": "x", "method": "PUT", "csrf": "x" * 43})
    for form in forms:
        for path in (DISPLAY, START, SEATS, POWER, "/stop"):
            answer = target.http.post(path, data=dict(form), headers=HTML)
            assert answer.status_code in (403, 405, 415), (path, answer.text[:300])


def test_dns_rebinding(target: Target) -> None:
    for host in ("evil.example", "robot.evil.example:8080", "127.0.0.1.evil.example", "[::1]:1", ""):
        for method, path, headers, body in WRITES:
            answer = target.http.request(method, path, headers={**headers, "Host": host}, content=body)
            assert answer.status_code in (400, 421), (host, method, path, answer.text)


PATHS = (
    "/topics/cockpit%2Fdisplay", "/topics/cockpit%5Cdisplay", "/topics/aircraft/../cockpit/display",
    "/topics/aircraft/%2e%2e/cockpit/display", "/topics//cockpit/display", "//topics/cockpit/display",
    "/topics/cockpit/display/..", "/topics/cockpit/display%00", "/topics/cockpit/display;v=1",
    "/Topics/cockpit/display", "/topics/Cockpit/Display", "/topics/%D1%81ockpit/display",
    "/topics/%EF%BD%83ockpit/display", "/topics/cockpit%E2%80%8B/display", "/topics/cockpit%252Fdisplay",
    "/topics/%C0%AFcockpit/display", "/services/aircraft/../aircraft/start", "/services/aircraft%2Fstart",
    "/data/../parameters/aircraft/seats", "/data/%2e%2e/%2e%2e/etc/passwd",
    "/style.css/../../settings.py", "/queries/..%2f..%2fetc%2fpasswd",
)  # fmt: skip


def test_path_tricks(target: Target) -> None:
    host = target.url.removeprefix("http://").rstrip("/").encode()
    wrong = []
    for path in PATHS:
        for method in (b"GET", b"PUT", b"POST", b"DELETE"):
            body = b"" if method in (b"GET", b"DELETE") else b'{"data": "owned"}'
            head = b"%s %s HTTP/1.1\r\nHost: %s\r\nContent-Type: application/json\r\nContent-Length: %d\r\n" % (
                method, path.encode(), host, len(body),
            )  # fmt: skip
            answer = target.raw(head + b"Connection: close\r\n\r\n" + body)
            refused = int(answer.split()[1]) in (308, 400, 404, 405, 409, 415, 422)
            if not refused or b"root:" in answer or b"import " in answer:
                wrong.append((method, path, answer[:300]))
    assert not wrong, wrong


def test_header_injection_by_names(target: Target) -> None:
    for end in ("\r\n", "\n", "\r", "\u2028", "\x00"):
        quoted = f"{target.url}parameters/aircraft/" + quote(f"x{end}Set-Cookie: owned=1{end}{end}<script>")
        for method in ("GET", "PUT", "DELETE", "OPTIONS"):
            answer = target.http.request(method, quoted, headers={**JSON, "Accept": "application/json"}, content=b"1")
            assert answer.status_code < 500, answer.text
            assert "set-cookie" not in answer.headers
            assert not answer.is_success or method in ("PUT", "OPTIONS", "DELETE"), answer.text
            assert not any(re.search("[\r\n\x00]", value) for value in answer.headers.values())
            if answer.status_code == 201:
                assert target.http.delete(quoted).status_code == 204
    answer = target.http.post("/data/", content=b"<> a <#T> .", headers={**TURTLE, "Slug": "a%0d%0aSet-Cookie: b"})
    assert answer.status_code == 201
    assert "set-cookie" not in answer.headers
    assert target.http.delete(answer.headers["location"]).status_code == 204


def test_slow_loris(target: Target) -> None:
    host = target.url.removeprefix("http://").rstrip("/").encode()
    beginnings = (
        b"GET / HTTP/1.1\r\nHost: " + host + b"\r\nX-Slow: ",
        b"PUT " + DISPLAY.encode() + b" HTTP/1.1\r\nHost: " + host
        + b"\r\nContent-Type: application/json\r\nContent-Length: 17\r\n\r\n{",
        b"",
    )  # fmt: skip
    opened = [socket.create_connection(target.address, timeout=15) for _ in range(20) for _ in beginnings]
    try:
        for number, sock in enumerate(opened):
            sock.sendall(beginnings[number % len(beginnings)])
        assert target.http.get("/").status_code == 200  # other requests are answered meanwhile
        for number, sock in enumerate(opened):
            if beginnings[number % len(beginnings)]:
                answer = b"".join(iter(lambda sock=sock: sock.recv(65536), b""))  # the server ends it
                assert not answer or answer.split()[1] == b"408", answer[:200]
    finally:
        for sock in opened:
            sock.close()


def test_oversized_and_compressed_bodies(target: Target) -> None:
    large = b'{"data": "' + b"a" * 11 * 1024 * 1024 + b'"}'
    bomb = gzip.compress(large)
    deep = b'{"data": ' + b"[" * 100_000 + b"]" * 100_000 + b"}"
    codings = cycle(("gzip", "deflate", "br", "gzip, gzip"))
    for path in (DISPLAY, START, SEATS, POWER, "/sparql", "/data/file"):
        method = "POST" if path in (START, "/sparql") else "PUT"
        kind = {"Content-Type": "application/sparql-query"} if path == "/sparql" else JSON
        coding = next(codings)
        answer = target.http.request(method, path, headers={**kind, "Content-Encoding": coding}, content=bomb)
        assert answer.status_code == 415, answer.text
        if path != "/data/file":  # files may be this large, and have any bytes
            assert target.http.request(method, path, headers=kind, content=large).status_code == 413
            answer = target.http.request(method, path, headers=kind, content=deep)
            assert 400 <= answer.status_code < 500, answer.text


@contextmanager
def canary() -> Iterator[tuple[str, list[bytes]]]:
    """A server that must not be called: its URL, and the calls."""
    calls: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(0.2)
        ended = threading.Event()

        def listen() -> None:
            while not ended.is_set():
                try:
                    connection, _ = listening.accept()
                except TimeoutError:
                    continue
                with connection:
                    calls.append(connection.recv(1024))

        thread = threading.Thread(target=listen)
        thread.start()
        try:
            yield f"http://127.0.0.1:{listening.getsockname()[1]}/", calls
        finally:
            ended.set()
            thread.join()


def test_server_side_requests(target: Target) -> None:
    with canary() as (url, calls):
        context = json.dumps({"@context": f"{url}context", "@id": "", "@type": "T"}).encode()
        entity = (
            f'<?xml version="1.0"?><!DOCTYPE r [<!ENTITY x SYSTEM "{url}entity"><!ENTITY f SYSTEM "file:///etc/passwd">]>'
            '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="">'
            "<rdf:value>&x;&f;</rdf:value></rdf:Description></rdf:RDF>"
        ).encode()
        for path in (DISPLAY, SEATS, "/data/inside"):
            for kind, body in (("application/ld+json", context), ("application/rdf+xml", entity)):
                answer = target.http.put(path, content=body, headers={"Content-Type": kind})
                assert 400 <= answer.status_code < 500, (path, kind, answer.text)
        for query in (f"SELECT * {{ SERVICE <{url}> {{ ?s ?p ?o }} }}", f"SELECT * FROM <{url}> {{ ?s ?p ?o }}"):
            answer = target.http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"})
            assert answer.status_code == 400 or len(answer.text.splitlines()) == 1, answer.text
        for update in (f"LOAD <{url}>", f"LOAD <{url}> INTO GRAPH </data/x>", "LOAD <file:///etc/passwd>"):
            answer = target.http.post("/sparql", content=update, headers={"Content-Type": "application/sparql-update"})
            assert answer.status_code in (400, 403), answer.text
        answer = target.http.get("/graphs", params={"graph": url})
        assert answer.status_code == 404
        then = target.http.post(DISPLAY, params={"rate": 1, "then": f"{url}message"}, json={"data": "x"})
        assert then.status_code == 422, then.text
        assert not calls
    assert target.http.get("/data/inside").status_code in (404, 410)


TAGS = ("<script>alert(1)</script>", "\"'><img src=x onerror=alert(1)>", "</title><svg/onload=alert(1)>")


def test_html_injection_by_what_a_robot_says(robot: Target) -> None:
    """A value, the name of a parameter, form input, a query, the name of an agent: shown, and never run."""
    for tag in TAGS:
        name = f"{robot.url}parameters/attack" + quote(tag.replace("/", ""))
        assert robot.http.put(DISPLAY, json={"data": tag}).status_code == 204
        assert robot.http.put("/parameters/attack", json=[tag, {"a": tag}]).status_code == 201
        robot.http.put(name, json=1)
        paths = [DISPLAY, "/parameters/attack", "/parameters/", "/resources/cockpit/", "/activity/", name, "/stop"]
        paths += [f"/topics/{tag}", f"/sparql?query={tag}", f"/topics/?format={tag}", f"/graphs?graph={tag}"]
        for path in (*paths, f"/data/{tag}"):
            page = robot.http.get(path, headers=HTML)
            if page.headers.get("content-type", "").startswith("text/html"):
                assert not re.search(r"<script>alert|<img src=x|<svg/onload", page.text), path
                assert "default-src 'none'" in page.headers["content-security-policy"]
            assert page.status_code < 500, (path, page.text[:300])
        robot.http.delete("/parameters/attack")
        robot.http.delete(name)
    assert robot.http.put(DISPLAY, json={"data": "calm"}).status_code == 204
