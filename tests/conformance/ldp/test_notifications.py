"""Event streams and channels of the Solid Notifications Protocol on resources under `/data/`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from websockets.sync.client import connect

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served


def test_a_stream_sends_each_change(place: Place) -> None:
    place.put("a", "<> <http://ex.org/p> 1 .")
    with place.http.stream("GET", place.at("a"), headers={"Accept": "text/event-stream"}) as stream:
        lines = stream.iter_lines()
        assert any('"1"' in line for line in lines)
        place.put("a", "<> <http://ex.org/p> 2 .")
        assert any('"2"' in line for line in lines)


def test_a_websocket_channel_sends_each_change(place: Place, served: Served) -> None:
    place.put("a", "<> <http://ex.org/p> 1 .")
    kind = "WebSocketChannel2023"
    wish = {"@context": ["https://www.w3.org/ns/solid/notifications-context/v1"], "type": kind}
    body = json.dumps({**wish, "topic": place.at("a")})
    answer = served.at("channels/").send("POST", kind, body, "application/ld+json")
    channel = answer.headers["location"]
    assert place.graph(channel, Accept="application/ld+json") == place.graph(channel)
    with connect(answer.json()["receiveFrom"], open_timeout=10) as socket:
        place.put("a", "<> <http://ex.org/p> 2 .")
        notification = json.loads(socket.recv(timeout=10))
    assert notification["object"] == place.at("a")
    assert notification["type"] in ("Update", ["Update"])
