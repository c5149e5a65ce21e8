"""Limits of clients on the real server: a client at its limit is notified, and does not slow down others."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.stopping import release

pytestmark = pytest.mark.slow

GREEDY, MODEST = "127.0.0.2", "127.0.0.3"
"""Two addresses of this machine: two clients."""
SETTINGS = {"client_rate": "40", "client_requests": "8", "client_connections": "12"}


@pytest.fixture(scope="module")
def url(start_server: Callable[..., Any]) -> str:
    """An aircraft whose limits also apply to clients on this machine."""
    given = [word for name, value in SETTINGS.items() for word in ("--setting", name, value)]
    base: str = start_server("aircraft", "--limit-loopback", *given).url
    return base


@contextmanager
def client(url: str, address: str) -> Iterator[httpx.Client]:
    """Return a client at an address."""
    with httpx.Client(base_url=url, timeout=15, transport=httpx.HTTPTransport(local_address=address)) as found:
        yield found


def test_too_many_requests_are_429_and_others_are_answered_meanwhile(url: str) -> None:
    answers: list[httpx.Response] = []
    over, refused = threading.Event(), threading.Event()

    def flood() -> None:
        with client(url, GREEDY) as greedy:
            while not over.is_set():
                answer = greedy.get("/topics/aircraft/engine/speed", headers={"Accept": "application/json"})
                answers.append(answer)
                if answer.status_code == 429:
                    refused.set()

    threads = [threading.Thread(target=flood) for _ in range(4)]
    with client(url, MODEST) as modest:
        for each in threads:
            each.start()
        try:
            assert refused.wait(30)
            for _ in range(30):
                assert modest.get("/topics/aircraft/engine/speed").status_code == 200
        finally:
            over.set()
            for each in threads:
                each.join()
    assert {answer.status_code for answer in answers} == {200, 429}
    told = next(answer for answer in answers if answer.status_code == 429)
    assert int(told.headers["retry-after"]) >= 1
    assert "40 requests per second" in told.json()["detail"]


def test_streams_count_and_stopping_the_robot_is_never_too_much(url: str) -> None:
    address = "127.0.0.4"
    with client(url, address) as http:
        streams = [http.stream("GET", "/topics/aircraft/engine/speed", headers=STREAM) for _ in range(8)]
        for each in streams:
            assert each.__enter__().status_code == 200
        refused = http.get("/")
        assert (refused.status_code, refused.headers["retry-after"]) == (429, "1")
        assert "8 of your requests" in refused.json()["detail"]
        assert http.post("/stop/nothing").status_code == 429
        for path in ("/services/aircraft/stop", "/topics/stop", "/data/stop"):
            assert http.post(path).status_code == 429, path
        assert http.post("/stop").status_code != 429
        release(http)
        for each in streams:
            each.__exit__(None, None, None)


def test_preflights_are_requests_like_any_other(start_server: Callable[..., Any], tmp_path: Path) -> None:
    rules = tmp_path / "auth.toml"
    rules.write_text("[[rule]]\nagents = ['anybody']\nmodes = ['read']\npaths = ['/**']\n")
    base = start_server("aircraft", "--limit-loopback", "--setting", "client_rate", "5", "--auth", str(rules)).url
    asked = {"Origin": "https://app.example", "Access-Control-Request-Method": "PUT"}
    with client(base, "127.0.0.8") as http:
        statuses = {http.options("/topics/", headers=asked).status_code for _ in range(30)}
    assert statuses == {204, 429}


STREAM = {"Accept": "text/event-stream"}


def test_connections_are_counted_by_address_and_other_addresses_come_in(url: str) -> None:
    host, port = httpx.URL(url).host, httpx.URL(url).port
    assert port is not None
    held = [socket.create_connection((host, port), source_address=("127.0.0.5", 0)) for _ in range(12)]
    try:
        with socket.create_connection((host, port), source_address=("127.0.0.5", 0), timeout=10) as one_more:
            one_more.sendall(f"GET / HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
            assert one_more.recv(1000).startswith(b"HTTP/1.1 429")
        with client(url, "127.0.0.6") as other:
            assert other.get("/").status_code == 200
    finally:
        for each in held:
            each.close()
