"""Notifications over real connections: discovery, subscription, delivery by WebSocket and by a streaming response."""

from __future__ import annotations

import json
import signal
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from datetime import datetime, timedelta, timezone
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from pyoxigraph import NamedNode, Triple
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

NOTIFY = "http://www.w3.org/ns/solid/notifications#"
CONTEXT = "https://www.w3.org/ns/solid/notifications-context/v1"
WEBSOCKET, STREAMING = "WebSocketChannel2023", "StreamingHTTPChannel2023"
JSON_LD = {"Content-Type": "application/ld+json", "Accept": "application/ld+json"}
SPEED = "topics/aircraft/engine/speed"
AIRCRAFT = "resources/aircraft/"
NIGHT = "parameters/cockpit/night"
STRING = (
    "<#message> a <https://w3id.org/rosld/types/std_msgs/msg/String> ; "
    '<https://w3id.org/rosld/types/std_msgs/msg/String#data> "here" .'
)


def wish(served: Any, topic: str, kind: str = WEBSOCKET, **features: object) -> dict[str, object]:
    """Return a subscription request."""
    return {"@context": [CONTEXT], "type": NOTIFY + kind, "topic": served.url + topic, **features}


def post(served: Any, body: object, kind: str = WEBSOCKET, **headers: str) -> httpx.Response:
    """Send a subscription request."""
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    answer = served.http.post(f"/channels/{kind}", content=data, headers={**JSON_LD, **headers})
    assert isinstance(answer, httpx.Response)
    return answer


def subscribed(served: Any, topic: str, kind: str = WEBSOCKET, **features: object) -> dict[str, Any]:
    """Return the new channel of the server."""
    answer = post(served, wish(served, topic, kind, **features), kind)
    assert answer.status_code == 201, answer.text
    found: dict[str, Any] = answer.json()
    assert answer.headers["location"] == found["id"]
    return found


def received(ws: ClientConnection) -> dict[str, Any]:
    """Return the next notification."""
    found: dict[str, Any] = json.loads(ws.recv(10))
    return found


@contextmanager
def streaming(served: Any, channel: dict[str, Any]) -> Iterator[Iterator[dict[str, Any]]]:
    """Yield the notifications of a response."""
    with served.http.stream("GET", channel["receiveFrom"]) as stream:
        assert stream.status_code == 200, stream.read()
        assert stream.headers["content-type"] == "application/x-ndjson"
        yield (json.loads(line) for line in stream.iter_lines() if line)


def turn(served: Any) -> None:
    """Change the parameter of the tests."""
    served.http.put(f"/{NIGHT}", json=not served.http.get(f"/{NIGHT}?format=json").json()).raise_for_status()


def fly(served: Any, speed: float) -> None:
    """Start the engine and command a speed: it climbs in steps."""
    served.http.post("/services/aircraft/start", json={}).raise_for_status()
    served.http.post("/services/aircraft/engine/set_speed", json={"data": speed}).raise_for_status()


def moment(seconds: float) -> str:
    """Return the xsd:dateTime this many seconds from now."""
    return (datetime.now(timezone.utc) + timedelta(seconds=seconds)).isoformat()


# Discovery


def test_every_answer_links_to_the_description(aircraft: Any) -> None:
    wanted = f'<{aircraft.url}.well-known/solid>; rel="http://www.w3.org/ns/solid/terms#storageDescription"'
    for path in ("/", "/topics/", f"/{SPEED}", f"/{AIRCRAFT}", f"/{NIGHT}", "/topics/none", "/sparql"):
        for method in ("GET", "HEAD", "OPTIONS"):
            links = aircraft.http.request(method, path).headers.get_list("link")
            assert wanted in ", ".join(links), (method, path)


def test_the_description_lists_the_services_and_their_features(
    aircraft: Any, triples_of: Callable[[httpx.Response], set[Triple]]
) -> None:
    found = triples_of(aircraft.http.get("/.well-known/solid", headers={"Accept": "text/turtle"}))
    description = NamedNode(f"{aircraft.url}.well-known/solid")
    offers = (description, NamedNode(f"{NOTIFY}subscription"))
    services = {one.object for one in found if (one.subject, one.predicate) == offers}
    assert services == {NamedNode(f"{aircraft.url}channels/{kind}") for kind in (WEBSOCKET, STREAMING)}
    for kind in (WEBSOCKET, STREAMING):
        service = NamedNode(f"{aircraft.url}channels/{kind}")
        assert Triple(service, NamedNode(f"{NOTIFY}channelType"), NamedNode(NOTIFY + kind)) in found
        for feature in ("accept", "rate", "startAt", "endAt", "state"):
            assert Triple(service, NamedNode(f"{NOTIFY}feature"), NamedNode(NOTIFY + feature)) in found
    answer = aircraft.http.get("/.well-known/solid", headers={"Accept": "application/ld+json"})
    said = answer.json()
    assert isinstance(said["@context"], dict), "nothing of another host has to be fetched to read it"
    compact = triples_of(answer)
    assert len(compact) >= 6
    assert compact <= found, "the JSON-LD for clients without RDF is less complete"
    for path, names in (("channels/", {WEBSOCKET, STREAMING}), (".well-known/", {"solid", "wot", "void"})):
        told = triples_of(aircraft.http.get(f"/{path}", headers={"Accept": "text/turtle"}))
        contained = {each.object for each in told if each.predicate.value.endswith("ldp#contains")}
        assert contained == {NamedNode(f"{aircraft.url}{path}{name}") for name in names}
    assert said["id"] == f"{aircraft.url}.well-known/solid"
    assert [one["channelType"] for one in said["subscription"]] == [NOTIFY + WEBSOCKET, NOTIFY + STREAMING]
    again = {"If-None-Match": answer.headers["etag"], "Accept": "application/ld+json"}
    assert aircraft.http.get("/.well-known/solid", headers=again).status_code == 304


# Receiving


@pytest.mark.slow
def test_a_topic_notifies_over_a_websocket_no_faster_than_its_rate_and_a_resource_over_http(
    serve: Callable[..., Any],
) -> None:
    served = serve("aircraft")
    channel = subscribed(served, SPEED, rate="PT0.3S")
    with connect(channel["receiveFrom"]) as ws, streaming(served, subscribed(served, AIRCRAFT, STREAMING)) as stream:
        fly(served, 30)
        came = [received(ws) for _ in range(4)]
        found = next(stream)
    assert (found["type"], found["object"]) == ("Update", served.url + AIRCRAFT)
    for found in came:
        assert found["@context"] == ["https://www.w3.org/ns/activitystreams", CONTEXT]
        assert found["type"] == "Update"
        assert found["object"] == served.url + SPEED
        assert found["id"].startswith("urn:uuid:")
        assert found["published"].endswith("Z")
    assert len({found["state"] for found in came}) == 4
    assert published_at(came[-1]) - published_at(came[0]) > 2.5 * 0.3  # one may be sent a quarter early


def published_at(found: Any) -> float:
    """Return when a notification was published, in seconds."""
    whole, _, part = found["published"].rstrip("Z").partition(".")
    return datetime.fromisoformat(whole).timestamp() + float(f"0.{part or 0}")


def test_the_state_told_is_that_of_the_entity_tag_and_is_told_to_who_has_another(aircraft: Any) -> None:
    etag = aircraft.http.get(f"/{NIGHT}", headers={"Accept": "text/turtle"}).headers["etag"]
    with connect(subscribed(aircraft, NIGHT, state=etag)["receiveFrom"]) as ws:
        turn(aircraft)
        state = received(ws)["state"]
        assert state not in etag
    with connect(subscribed(aircraft, NIGHT, state=etag)["receiveFrom"]) as ws:
        assert received(ws)["state"] == state  # immediately: nothing changed since
    etag = aircraft.http.get(f"/{NIGHT}", headers={"Accept": "text/turtle"}).headers["etag"]
    assert etag == f'"{state}.ttl"'


def test_a_container_tells_which_member_came_and_went_and_the_member_too(aircraft: Any) -> None:
    path, turtle = "/topics/notified", {"Content-Type": "text/turtle"}
    members = {"target": f"{aircraft.url}topics/", "object": f"{aircraft.url}topics/notified"}
    with connect(subscribed(aircraft, "topics/")["receiveFrom"]) as ws:
        aircraft.http.put(path, content=STRING, headers=turtle)
        assert next_of(ws, "Add").items() >= members.items()
        with connect(subscribed(aircraft, path[1:])["receiveFrom"]) as own:
            aircraft.http.delete(path).raise_for_status()
            assert next_of(ws, "Remove")["object"] == members["object"]
            assert "state" not in next_of(own, "Delete")
            aircraft.http.put(path, content=STRING, headers=turtle)
            assert received(own)["type"] == "Create"
    aircraft.http.delete(path).raise_for_status()


def next_of(ws: ClientConnection, type: str) -> dict[str, Any]:
    """Return the next notification of a type: others are about rates and values that became known."""
    return next(each for each in iter(lambda: received(ws), None) if each["type"] == type)


def test_turtle_is_taken_answered_and_sent_where_it_is_accepted(aircraft: Any) -> None:
    turtle = {"Content-Type": "text/turtle", "Accept": "text/turtle"}
    answer = post(aircraft, f"[] a <{NOTIFY}{WEBSOCKET}> ; <{NOTIFY}topic> </{NIGHT}> .".encode(), **turtle)
    assert answer.status_code == 201
    assert answer.headers["content-type"].startswith("text/turtle")
    assert "receiveFrom" in answer.text
    channel = subscribed(aircraft, NIGHT, accept="text/turtle")
    assert channel["accept"] == "text/turtle"
    with connect(channel["receiveFrom"]) as ws:
        turn(aircraft)
        assert "as:object" in str(ws.recv(10))
    streamed = subscribed(aircraft, NIGHT, STREAMING, accept="text/turtle")
    head = aircraft.http.head(streamed["receiveFrom"])
    assert head.headers["content-type"] == "text/turtle; charset=utf-8"


def test_a_receiver_that_comes_back_hears_what_it_missed(aircraft: Any) -> None:
    channel = subscribed(aircraft, NIGHT)
    with connect(channel["receiveFrom"], subprotocols=[WEBSOCKET]) as ws:  # type: ignore[list-item]
        assert ws.subprotocol == WEBSOCKET
    turn(aircraft)
    with connect(channel["receiveFrom"]) as ws:
        assert received(ws)["type"] == "Update"


def test_a_second_connection_takes_the_place_of_the_first(aircraft: Any) -> None:
    channel = subscribed(aircraft, NIGHT)
    with connect(channel["receiveFrom"]) as old, connect(channel["receiveFrom"]) as new:
        assert closed_with(old) == 1000
        turn(aircraft)
        assert received(new)["type"] == "Update"


@pytest.mark.slow
def test_a_channel_ends_at_its_end_and_when_it_is_deleted(aircraft: Any) -> None:
    streamed = subscribed(aircraft, NIGHT, STREAMING, endAt=moment(0.5))
    with streaming(aircraft, streamed) as came:
        assert list(came) == []
    for channel, end in (
        (subscribed(aircraft, NIGHT, endAt=moment(0.5)), lambda url: None),
        (subscribed(aircraft, NIGHT), lambda url: aircraft.http.delete(url).raise_for_status()),
    ):
        with connect(channel["receiveFrom"]) as ws:
            end(channel["id"])
            assert closed_with(ws) == 1000
        assert aircraft.http.get(channel["id"]).status_code == 404


def closed_with(ws: ClientConnection) -> int:
    """Wait until the server closes the connection; return its code."""
    with pytest.raises(ConnectionClosed) as caught:
        ws.recv(10)
    assert caught.value.rcvd is not None
    return caught.value.rcvd.code


def test_a_channel_says_what_it_was_made_for(
    aircraft: Any, triples_of: Callable[[httpx.Response], set[Triple]]
) -> None:
    channel = subscribed(aircraft, NIGHT, rate="PT1M", startAt="2026-01-01T00:00:00Z", endAt="2099-01-01T00:00:00Z")
    assert channel["type"] == NOTIFY + WEBSOCKET
    assert channel["topic"] == aircraft.url + NIGHT
    assert (channel["rate"], channel["endAt"]) == ("PT60S", "2099-01-01T00:00:00Z")
    assert urlsplit(channel["receiveFrom"]).scheme == "ws"
    found = triples_of(aircraft.http.get(channel["id"], headers={"Accept": "text/turtle"}))
    source = NamedNode(channel["receiveFrom"])
    assert Triple(NamedNode(channel["id"]), NamedNode(f"{NOTIFY}receiveFrom"), source) in found
    plain = aircraft.http.get(channel["receiveFrom"].replace("ws", "http", 1))
    assert plain.status_code == 426
    assert plain.headers["upgrade"] == "websocket"


def test_what_a_client_says_is_not_listened_to(aircraft: Any) -> None:
    with connect(subscribed(aircraft, NIGHT)["receiveFrom"]) as ws:
        for _ in range(100):
            ws.send("hello")
        turn(aircraft)
        assert received(ws)["type"] == "Update"
        ws.send("x" * 10_000)
        assert closed_with(ws) == 1009


def test_all_receivers_hear_of_one_change_at_once(aircraft: Any) -> None:
    channels = [subscribed(aircraft, NIGHT)["receiveFrom"] for _ in range(20)]
    with ThreadPoolExecutor(20) as pool, ExitStack() as open_ones:
        made = pool.map(connect, channels)
        sockets = [open_ones.enter_context(ws) for ws in made]
        turn(aircraft)
        came = list(pool.map(received, sockets))
        assert len({found["id"] for found in came}) == 1


# Refusals


def test_a_hostile_subscription_is_a_clear_error(aircraft: Any) -> None:
    for changed, status, said in (
        ({"topic": "http://elsewhere.example/topics/x"}, 422, "elsewhere.example"),
        ({"topic": f"{aircraft.url}topics/none"}, 422, "/none"),
        ({"topic": f"{aircraft.url}nothing/here"}, 422, "nothing/here"),
        ({"topic": f"{aircraft.url}.well-known/wot"}, 422, "no state"),
        ({"topic": f"{aircraft.url}topics/%ff"}, 422, "%ff"),
        ({"topic": f"{aircraft.url}topics"}, 422, "/topics/"),
        ({"topic": 5}, 422, "topic"),
        ({"type": NOTIFY + STREAMING}, 422, STREAMING),
        ({"@context": "http://evil.example/"}, 422, "evil.example"),
        ({"rate": "fast"}, 422, "fast"),
        ({"state": "x" * 20_000}, 413, "16384"),
    ):
        answer = post(aircraft, wish(aircraft, NIGHT) | changed, Accept="application/json")
        assert answer.status_code == status, (changed, answer.text)
        assert answer.headers["content-type"] == "application/problem+json"
        assert said in answer.json()["detail"]


def test_what_is_no_subscription_at_all_is_refused(aircraft: Any) -> None:
    assert post(aircraft, b"{").status_code == 400
    assert post(aircraft, b"[" * 10_000).status_code == 400
    assert post(aircraft, b"x", **{"Content-Type": "text/plain"}).status_code == 415
    assert post(aircraft, b"a=b", **{"Content-Type": "application/x-www-form-urlencoded"}).status_code == 415
    profile = {"Content-Type": 'application/ld+json; profile="http://example.org/other"'}
    assert post(aircraft, wish(aircraft, NIGHT), **profile).status_code == 415
    assert aircraft.http.put(f"/channels/{WEBSOCKET}", json={}).status_code == 405
    assert aircraft.http.post("/channels/Pigeon", json={}).status_code == 404


def test_foreign_pages_may_neither_subscribe_nor_listen(aircraft: Any) -> None:
    foreign = "http://evil.example"
    assert post(aircraft, wish(aircraft, NIGHT), Origin=foreign).status_code == 403
    url = subscribed(aircraft, NIGHT)["receiveFrom"]
    with pytest.raises(InvalidStatus) as caught, connect(url, additional_headers={"Origin": foreign}):
        pass
    assert caught.value.response.status_code == 403
    assert json.loads(caught.value.response.body)["status"] == 403
    with connect(url, additional_headers={"Origin": aircraft.url.rstrip("/")}):
        pass


def test_another_name_of_the_server_and_no_channel_are_refused(aircraft: Any) -> None:
    base = aircraft.url.replace("http", "ws", 1)
    for path in ("", SPEED, f"channels/{WEBSOCKET}/guessed/messages", f"channels/{WEBSOCKET}", "channels/%ff/x"):
        with pytest.raises(InvalidStatus) as caught, connect(base + path):
            pass
        assert caught.value.response.status_code in (400, 404)
    streamed = subscribed(aircraft, NIGHT, STREAMING)["receiveFrom"].replace("http", "ws", 1)
    with pytest.raises(InvalidStatus), connect(streamed):
        pass
    address = urlsplit(aircraft.url)
    with socket.create_connection((address.hostname, address.port), 5) as raw:
        raw.sendall(
            b"GET / HTTP/1.1\r\nHost: rebound.example\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
            b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
        )
        assert raw.recv(4096).startswith(b"HTTP/1.1 421")


def test_a_topic_may_be_called_by_any_name_of_this_machine(aircraft: Any) -> None:
    other = wish(aircraft, NIGHT) | {"topic": aircraft.url.replace("127.0.0.1", "localhost") + NIGHT}
    answer = post(aircraft, other)
    assert answer.status_code == 201
    assert answer.json()["topic"] == aircraft.url + NIGHT


# The end


def test_a_server_told_to_end_closes_its_channels_and_is_gone(serve: Callable[..., Any]) -> None:
    served = serve("aircraft")
    streamed = subscribed(served, NIGHT, STREAMING)
    with connect(subscribed(served, NIGHT)["receiveFrom"]) as ws, streaming(served, streamed) as came:
        served.process.send_signal(signal.SIGTERM)
        assert closed_with(ws) in (1001, 1012)
        assert list(came) == []
        assert served.process.wait(60) == 0
