"""A failing endpoint is reported in a sentence, in time, and affects nothing else; `--store` and related settings."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import pytest

from rosld.server.dataset.endpoint_client import Endpoint, StoreError, StoreRefused, StoreUnreachable
from rosld.server.dataset.remote_store import RemoteStore
from rosld.server.resources.mirror import authorization
from rosld.server.settings import Settings

if TYPE_CHECKING:
    from tests.server.dataset.conftest import Behaviour, Failing

EMPTY = b'{"head":{"vars":["g"]},"results":{"bindings":[]}}'
JSON = "application/sparql-results+json"
SECONDS = 0.2
ASK = b"query=ASK{}"
Start: TypeAlias = "Callable[[Behaviour], Failing]"


def garbage(server: Failing, connection: socket.socket, body: bytes) -> bool:
    connection.sendall(b"\x00\xff\r\n\r\nnothing of HTTP \x1b[2J" * 100)
    return False


def closed(server: Failing, connection: socket.socket, body: bytes) -> bool:
    return False


def closed_midway(server: Failing, connection: socket.socket, body: bytes) -> bool:
    connection.sendall(f"HTTP/1.1 200 OK\r\nContent-Type: {JSON}\r\nContent-Length: 1000\r\n\r\n".encode() + EMPTY)
    return False


def chunk_broken_off(server: Failing, connection: socket.socket, body: bytes) -> bool:
    connection.sendall(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nffff\r\n{")
    return False


def bad_length(server: Failing, connection: socket.socket, body: bytes) -> bool:
    connection.sendall(b"HTTP/1.1 two hundred\r\nContent-Length: many\r\n\r\n")
    return False


def headers_without_end(server: Failing, connection: socket.socket, body: bytes) -> bool:
    connection.sendall(b"HTTP/1.1 200 OK\r\n" + b"X-Header: x\r\n" * 1000)
    return False


def silent(server: Failing, connection: socket.socket, body: bytes) -> bool:
    server.ended.wait(60)
    return False


def dripping(server: Failing, connection: socket.socket, body: bytes) -> bool:
    for byte in b"HTTP/1.1 200 OK\r\n" + b"X: " + b"x" * 10_000:
        connection.sendall(bytes((byte,)))
        if server.ended.wait(0.01):
            break
    return False


def slow(server: Failing, connection: socket.socket, body: bytes) -> bool:
    connection.sendall(f"HTTP/1.1 200 OK\r\nContent-Type: {JSON}\r\n\r\n".encode())
    while not server.ended.wait(0.01):
        connection.sendall(b" ")
    return False


def endless(server: Failing, connection: socket.socket, body: bytes) -> bool:
    connection.sendall(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n")
    while not server.ended.is_set():
        connection.sendall(b"10000\r\n" + b"x" * 0x10000 + b"\r\n")
    return False


def post(url: str, **options: float) -> bytes:
    endpoint = Endpoint(url, seconds=options.pop("seconds", SECONDS), limit=int(options.pop("limit", 1_000_000)))
    return endpoint.post(ASK, "application/x-www-form-urlencoded", JSON).body


@pytest.mark.parametrize(
    "behave",
    [
        garbage,
        closed,
        closed_midway,
        chunk_broken_off,
        bad_length,
        headers_without_end,
        silent,
        dripping,
        slow,
        endless,
    ],
    ids=lambda behave: behave.__name__,
)
def test_an_endpoint_that_speaks_no_http_to_the_end_is_unreachable_in_time(behave: Behaviour, failing: Start) -> None:
    server = failing(behave)
    with pytest.raises(StoreUnreachable) as error:
        post(server.url)
    assert server.url in str(error.value)
    assert str(error.value).isprintable()


def test_where_nobody_listens_the_endpoint_is_unreachable(failing: Start) -> None:
    server = failing(closed)
    server.close()
    url = server.url
    with pytest.raises(StoreUnreachable, match=url):
        post(url)


def test_a_refusal_is_told_with_its_status_and_one_line_of_its_words(failing: Start) -> None:
    def refusing(server: Failing, connection: socket.socket, body: bytes) -> bool:
        return server.answer(connection, "503 Busy", b"come\r\nback \x1b[31mlater" + b"x" * 100_000)

    server = failing(refusing)
    with pytest.raises(StoreRefused, match="answers 503") as error:
        post(server.url)
    assert error.value.status == 503
    assert error.value.sentence == f"{server.url} answers 503."
    assert str(error.value.words).startswith("come back")
    assert len(str(error.value)) < 500
    assert str(error.value).isprintable()


def test_redirects_are_not_followed(failing: Start) -> None:
    def answering(server: Failing, connection: socket.socket, body: bytes) -> bool:
        return server.answer(connection, "200 OK", EMPTY, JSON)

    def redirecting(server: Failing, connection: socket.socket, body: bytes) -> bool:
        return server.answer(connection, "307 Elsewhere", b"", "text/plain", f"Location: {other.url}")

    other = failing(answering)
    with pytest.raises(StoreRefused, match="redirects, which is not followed"):
        post(failing(redirecting).url)
    assert other.bodies == []


def test_a_connection_is_kept_and_one_that_was_closed_meanwhile_is_made_anew(failing: Start) -> None:
    def twice(server: Failing, connection: socket.socket, body: bytes) -> bool:
        server.answer(connection, "200 OK", EMPTY, JSON)
        return len(server.bodies) % 2 != 0  # closed after the second, the fourth, ...

    endpoint = Endpoint(failing(twice).url, seconds=5)
    for _ in range(6):
        assert endpoint.post(ASK, "text/plain", JSON).body == EMPTY
    assert endpoint.connections == 3


def test_credentials_are_sent_and_not_told(failing: Start) -> None:
    def refusing(server: Failing, connection: socket.socket, body: bytes) -> bool:
        return server.answer(connection, "401 Unauthorized", b"who are you?")

    server = failing(refusing)
    with pytest.raises(StoreRefused, match="401") as error:
        Endpoint(server.url, "Bearer secret", seconds=5).post(ASK, "text/plain", JSON)
    assert b"Authorization: Bearer secret" in server.heads[0]
    assert "secret" not in str(error.value)


def test_a_request_under_way_can_be_ended(failing: Start) -> None:
    arrived = threading.Event()

    def waiting(server: Failing, connection: socket.socket, body: bytes) -> bool:
        arrived.set()
        return silent(server, connection, body)

    endpoint = Endpoint(failing(waiting).url, seconds=30)
    found: list[Exception] = []

    def ask() -> None:
        try:
            endpoint.post(ASK, "text/plain", JSON)
        except StoreError as error:
            found.append(error)

    asking = threading.Thread(target=ask)
    asking.start()
    assert arrived.wait(60)
    endpoint.interrupt()
    asking.join(60)
    assert not asking.is_alive()
    assert len(found) == 1


NO_RESULTS = [
    ("text/html", b"<html>Hello</html>"),
    (JSON, b"{"),
    (JSON, b"[" * 100_000),
    (JSON, b'{"head":{"vars":["g"]},"results":{"bindings":[{"g":{"type":"uri","value":"no iri"}}]}}'),
    (JSON, b'{"head":{"vars":["g"]},"results":{"bindings":[{"g":7}]}}'),
    ("application/n-triples", b"<a> <b>"),
]


def test_results_that_are_none_are_told_of_before_anybody_reads_them(failing: Start) -> None:
    answers = iter(NO_RESULTS)

    def answering(server: Failing, connection: socket.socket, asked: bytes) -> bool:
        media_type, body = next(answers)
        return server.answer(connection, "200 OK", body, media_type)

    url = failing(answering).url
    store = RemoteStore(Endpoint(url, seconds=5), Endpoint(url, seconds=5))
    for _ in NO_RESULTS:
        with pytest.raises(StoreUnreachable, match="results"):
            store.graphs_with_prefix("")


# Settings


def test_endpoints_are_those_of_oxigraph_unless_named() -> None:
    for given, endpoints in (
        ({}, None),
        ({"store": "http://h:7878"}, ("http://h:7878/query", "http://h:7878/update")),
        ({"store": "https://h/ds/"}, ("https://h/ds/query", "https://h/ds/update")),
        ({"store": "http://h", "store_update": "http://h/statements"}, ("http://h/query", "http://h/statements")),
        ({"store_query": "http://h/q", "store_update": "http://h/u"}, ("http://h/q", "http://h/u")),
    ):
        assert Settings(**given).store_endpoints == endpoints  # type: ignore[arg-type]


WRONG: list[dict[str, object]] = [
    *({"store": store} for store in ("h:7878", "ftp://h/", "http://user:secret@h/", "http://h:99999/", "")),
    *({"store": store} for store in ("http://h/?key=1", "http://h/#x", "http://h/a b", "http://h/\r\nX: y")),
    {"store_query": "http://h/q"},
    {"store_update": "http://h/u"},
    {"store_credentials": Path("x")},
    {"store": "http://h", "store_rate": 0},
]


def test_what_is_no_store_is_refused_with_the_option_and_no_secret() -> None:
    for given in WRONG:
        with pytest.raises(ValueError, match="--store") as error:
            Settings(**given)  # type: ignore[arg-type]
        assert "secret" not in str(error.value), given


def test_credentials_become_a_header_or_are_refused_and_not_shown(tmp_path: Path) -> None:
    file = tmp_path / "credentials"
    for text, header in {
        "Aladdin:open sesame\n": "Basic QWxhZGRpbjpvcGVuIHNlc2FtZQ==",
        "user:a:b": "Basic dXNlcjphOmI=",
        "Bearer abc.def\n": "Bearer abc.def",
    }.items():
        file.write_text(text)
        assert authorization(file) == header
    for text in ("", "nothing", "user:pass\r\nX-Header: y", "Bearer a\nb", "Bearer é", "\x00:"):
        file.write_text(text)
        with pytest.raises(ValueError, match="--store-credentials") as error:
            authorization(file)
        assert not text or text not in str(error.value)
