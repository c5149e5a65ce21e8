"""Streams, waits and channels: redacted alike, and ended when the permission is revoked."""

from __future__ import annotations

import itertools
import json
import threading
import time
from collections.abc import Callable

import httpx
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.server.auth.conftest import RULES, TURTLE, Guarded, tokens

pytestmark = pytest.mark.slow

STREAM = {"Accept": "text/event-stream"}
AGENTS = ("reader", "admin")


@pytest.fixture
def changing(guard: Callable[..., Guarded]) -> Guarded:
    """A server whose rules this test may change."""
    return guard(RULES, *AGENTS)


def test_a_stream_shows_what_its_reader_may_see_and_ends_when_the_right_is_withdrawn(changing: Guarded) -> None:
    with changing["reader"].stream("GET", "/resources/", headers=STREAM, params={"format": "nt"}, timeout=20) as stream:
        assert stream.status_code == 200
        lines = stream.iter_lines()
        event = itertools.dropwhile(lambda line: not line.startswith("id:"), lines)
        first = "\n".join(itertools.takewhile(bool, event))
        assert "resources/" in first
        assert "nodes/aircraft" not in first
        changing.file.write_text(tokens("admin") + RULES)
        for _ in lines:
            pass
    assert changing["reader"].get("/topics/").status_code == 401


def test_a_wait_ends_without_an_answer_when_the_right_is_withdrawn(changing: Guarded) -> None:
    tag = changing["reader"].get("/data/", headers={"Accept": "text/turtle"}).headers["etag"]
    answers: list[httpx.Response] = []
    asking = threading.Thread(
        target=lambda: answers.append(changing["reader"].get("/data/", params={"after": tag, "timeout": "15"}))
    )
    asking.start()
    time.sleep(0.5)
    changing.file.write_text(tokens("admin") + RULES)
    while changing["reader"].get("/topics/").status_code == 200:
        time.sleep(0.1)
    changing["admin"].put("/data/new", content="", headers=TURTLE)
    asking.join(60)
    assert answers[0].status_code == 401


def subscribed(guarded: Guarded, agent: str, topic: str) -> httpx.Response:
    wish = {
        "@context": ["https://www.w3.org/ns/solid/notification/v1"],
        "type": "http://www.w3.org/ns/solid/notifications#WebSocketChannel2023",
        "topic": f"{guarded.url.rstrip('/')}{topic}",
    }
    media_type = {"Content-Type": "application/ld+json", "Accept": "application/ld+json"}
    return guarded[agent].post("/channels/WebSocketChannel2023", content=json.dumps(wish), headers=media_type)


def test_a_channel_is_made_for_what_may_be_read_and_others_are_refused_alike(changing: Guarded) -> None:
    assert subscribed(changing, "reader", "/data/").status_code == 201
    refusals = {
        subscribed(changing, "reader", path).text.replace(path, "") for path in ("/nodes/aircraft", "/nodes/none")
    }
    assert len(refusals) == 1
    assert subscribed(changing, "reader", "/nodes/aircraft").status_code == 422


def test_a_channel_tells_of_no_member_that_may_not_be_known_and_ends_with_the_right(changing: Guarded) -> None:
    made = subscribed(changing, "reader", "/data/").json()
    with connect(made["receiveFrom"]) as socket:
        changing["admin"].put("/data/secret/x", content="", headers=TURTLE)
        told = json.loads(socket.recv(10))
        assert "secret" not in json.dumps(told)
        changing.file.write_text(tokens("admin") + RULES)
        with pytest.raises(ConnectionClosed):
            socket.recv(10)
