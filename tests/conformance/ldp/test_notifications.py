"""Being told of changes of what is kept: waiting, event streams, and channels of the Solid Notifications Protocol."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import httpx
from websockets.sync.client import connect

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served

ONE, TWO = "<> <http://ex.org/p> 1 .", "<> <http://ex.org/p> 2 ."


def test_waiting_ends_with_the_next_change(place: Place) -> None:
    place.put("a", ONE)
    etag = place.get("a").headers["etag"]
    with ThreadPoolExecutor(1) as threads:
        waiting = threads.submit(httpx.get, place.at("a"), params={"after": etag, "timeout": "10"}, timeout=15)
        place.put("a", TWO)
        answer = waiting.result(15)
    assert answer.status_code == 200
    assert answer.headers["etag"] != etag
    assert "ex.org/p" in answer.text


def test_waiting_for_a_container_ends_with_a_new_member(place: Place) -> None:
    etag = place.get().headers["etag"]
    with ThreadPoolExecutor(1) as threads:
        waiting = threads.submit(httpx.get, place.url, params={"after": etag, "timeout": "10"}, timeout=15)
        made = place.post()
        answer = waiting.result(15)
    assert answer.status_code == 200
    assert made.removeprefix(place.url) in answer.text


def test_waiting_without_a_change_is_304(place: Place) -> None:
    place.put("a", ONE)
    answer = place.get("a?timeout=0.05&after=" + place.get("a").headers["etag"].strip('"'))
    assert answer.status_code == 304


def test_a_stream_tells_each_change(place: Place) -> None:
    place.put("a", ONE)
    with place.http.stream("GET", place.at("a"), headers={"Accept": "text/event-stream"}) as stream:
        assert stream.status_code == 200
        events = data_of(stream)
        assert '"1"' in next(events)
        place.put("a", TWO)
        assert '"2"' in next(events)


def data_of(stream: httpx.Response) -> Iterator[str]:
    """The data of each event."""
    held: list[str] = []
    for line in stream.iter_lines():
        if line.startswith("data:"):
            held.append(line[5:].removeprefix(" "))
        elif not line and held:
            yield "\n".join(held)
            held = []


def test_a_websocket_channel_tells_of_a_change(place: Place, served: Served) -> None:
    place.put("a", ONE)
    with connect(channel(served, place.at("a"), "WebSocketChannel2023"), open_timeout=10) as socket:
        changed = threading.Thread(target=place.put, args=("a", TWO))
        changed.start()
        told = json.loads(socket.recv(timeout=10))
        changed.join()
    assert told["object"] == place.at("a")
    assert told["type"] in ("Update", ["Update"])


def channel(served: Served, topic: str, kind: str) -> str:
    """Subscribe; the URL to receive from."""
    body = {"@context": ["https://www.w3.org/ns/solid/notifications-context/v1"], "type": kind, "topic": topic}
    answer = served.http.post(
        f"{served.url}channels/{kind}", content=json.dumps(body), headers={"Content-Type": "application/ld+json"}
    )
    assert answer.is_success, answer.text
    received = answer.json()["receiveFrom"]
    assert isinstance(received, str)
    return received
