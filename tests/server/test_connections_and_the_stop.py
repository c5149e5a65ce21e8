"""With any number of connections, the robot can be stopped, and requests are served while connections are idle."""

from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from tests.stopping import release
from tests.waiting import until

pytestmark = pytest.mark.slow

MOST = 40
WEBSOCKETS = 15
STREAM = {"Accept": "text/event-stream"}
WISH = {
    "@context": ["https://www.w3.org/ns/solid/notification/v1"],
    "type": "http://www.w3.org/ns/solid/notifications#WebSocketChannel2023",
}
JSON_LD = {"Content-Type": "application/ld+json", "Accept": "application/ld+json"}


@pytest.fixture(scope="module")
def url(start_server: Callable[..., Any]) -> str:
    """An aircraft with few connections."""
    few = ("--setting", "connections", str(MOST), "--setting", "client_websockets", str(WEBSOCKETS))
    base: str = start_server("aircraft", *few).url
    return base


@pytest.fixture
def http(url: str) -> Iterator[httpx.Client]:
    """A new client, which leaves the robot unchanged."""
    with httpx.Client(base_url=url, timeout=15) as client:
        yield client


def stopped(url: str) -> None:
    """Stop the robot on a new connection, and release it."""
    with httpx.Client(base_url=url, timeout=15) as http:
        assert http.post("/stop").status_code == 200
        release(http)


@contextlib.contextmanager
def streams(url: str, number: int) -> Iterator[None]:
    """Open connections with unfinished responses."""
    with contextlib.ExitStack() as open_, httpx.Client(base_url=url, timeout=15) as http:
        for _ in range(number):
            answer = open_.enter_context(http.stream("GET", "/topics/aircraft/engine/speed", headers=STREAM))
            assert answer.status_code == 200
        yield


def silent(url: str) -> socket.socket:
    """Open a connection without sending anything."""
    base = httpx.URL(url)
    assert base.port is not None
    return socket.create_connection((base.host, base.port), timeout=10)


def test_idle_connections_give_way_to_new_ones(url: str, http: httpx.Client) -> None:
    with contextlib.ExitStack() as idle:
        held = [idle.enter_context(silent(url)) for _ in range(3 * MOST)]
        assert http.get("/").status_code == 200
        stopped(url)
        assert held[0].recv(1) == b"", "the one that was idle longest was ended"
    with streams(url, 3):
        pass


def test_where_all_connections_are_busy_the_robot_can_be_stopped_and_others_are_told(url: str) -> None:
    with streams(url, MOST), contextlib.ExitStack() as idle:
        for number in range(4):
            refused = httpx.get(url)
            assert (refused.status_code, refused.headers["retry-after"]) == (503, "5")
            assert "POST /stop" in refused.json()["detail"]
            assert httpx.post(f"{url}services/aircraft/stop").status_code == 503
            assert httpx.post(f"{url}stop/more").status_code == 503
            stopped(url)
            for _ in range(70 * number):  # more than the reserve
                idle.enter_context(silent(url))
    until(lambda: httpx.get(url).status_code == 200, "room again")


def subscribed(http: httpx.Client, topic: str = "data/") -> str:
    """Return the URL of a new channel for a topic."""
    wish = json.dumps({**WISH, "topic": f"{http.base_url}{topic}"})
    answer = http.post("/channels/WebSocketChannel2023", content=wish, headers=JSON_LD)
    return str(answer.json()["receiveFrom"])


def test_one_address_has_so_many_websockets_and_no_more_on_this_machine_too(url: str, http: httpx.Client) -> None:
    with contextlib.ExitStack() as open_:

        def opened() -> ClientConnection:
            return open_.enter_context(connect(subscribed(http), open_timeout=20))

        held = [opened() for _ in range(WEBSOCKETS)]
        with pytest.raises(InvalidStatus) as refused:
            opened()
        assert refused.value.response.status_code == 429
        assert b"client_websockets" in refused.value.response.body
        stopped(url)
        held[0].close()
        until(lambda: _is_open(http), "room for another")


def _is_open(http: httpx.Client) -> bool:
    try:
        with connect(subscribed(http), open_timeout=20):
            return True
    except InvalidStatus:
        return False
