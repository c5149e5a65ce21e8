"""Notifications over real connections: found, subscribed to, received by a WebSocket and by a response that goes on."""

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
    """A subscription request."""
    return {"@context": [CONTEXT], "type": NOTIFY + kind, "topic": served.url + topic, **features}


def post(served: Any, body: object, kind: str = WEBSOCKET, **headers: str) -> httpx.Response:
    """Send a subscription request."""
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    answer = served.http.post(f"/channels/{kind}", content=data, headers={**JSON_LD, **headers})
    assert isinstance(answer, httpx.Response)
    return answer


def subscribed(served: Any, topic: str, kind: str = WEBSOCKET, **features: object) -> dict[str, Any]:
    """The channel that the server made."""
    answer = post(served, wish(served, topic, kind, **features), kind)
    assert answer.status_code == 201, answer.text
    found: dict[str, Any] = answer.json()
    assert answer.headers["location"] == found["id"]
    return found


def received(ws: ClientConnection) -> dict[str, Any]:
    """The next notification."""
    found: dict[str, Any] = json.loads(ws.recv(10))
    return found


@contextmanager
def streaming(served: Any, channel: dict[str, Any]) -> Iterator[Iterator[dict[str, Any]]]:
    """The notifications of a response."""
    with served.http.stream("GET", channel["receiveFrom"]) as stream:
        assert stream.status_code == 200, stream.read()
        assert stream.headers["content-type"] == "application/x-ndjson"
        yield (json.loads(line) for line in stream.iter_lines() if line)


def turn(served: Any) -> None:
    """Change the parameter of the tests."""
    served.http.put(f"/{NIGHT}", json=not served.http.get(f"/{NIGHT}?format=json").json()).raise_for_status()


def fly(served: Any, speed: float) -> None:
    """Start the engine and ask for a speed: it climbs in steps."""
    served.http.post("/services/aircraft/start", json={}).raise_for_status()
    served.http.post("/services/aircraft/engine/set_speed", json={"data": speed}).raise_for_status()


def moment(seconds: float) -> str:
    """The xsd:dateTime so many seconds from now."""
    return (datetime.now(timezone.utc) + timedelta(seconds=seconds)).isoformat()


# Discovery


@pytest.mark.parametrize("path", ["/", "/topics/", f"/{SPEED}", f"/{AIRCRAFT}", f"/{NIGHT}", "/topics/none", "/sparql"])
@pytest.mark.parametrize("method", ["GET", "HEAD", "OPTIONS"])
def test_every_answer_links_to_the_description(aircraft: Any, path: str, method: str) -> None:
    links = aircraft.http.request(method, path).headers.get_list("link")
    wanted = f'<{aircraft.url}.well-known/solid>; rel="http://www.w3.org/ns/solid/terms#storageDescription"'
    assert wanted in ", ".join(links)


@pytest.mark.parametrize("accept", ["text/turtle", "application/ld+json;q=0.1, text/n3", "application/rdf+xml"])
def test_the_description_lists_the_services_and_their_features(
    aircraft: Any, triples_of: Callable[[httpx.Response], set[Triple]], accept: str
) -> None:
    found = triples_of(aircraft.http.get("/.well-known/solid", headers={"Accept": accept}))
    description = NamedNode(f"{aircraft.url}.well-known/solid")
    offers = (description, NamedNode(f"{NOTIFY}subscription"))
    services = {one.object for one in found if (one.subject, one.predicate) == offers}
    assert services == {NamedNode(f"{aircraft.url}channels/{kind}") for kind in (WEBSOCKET, STREAMING)}
    for kind in (WEBSOCKET, STREAMING):
        service = NamedNode(f"{aircraft.url}channels/{kind}")
        assert Triple(service, NamedNode(f"{NOTIFY}channelType"), NamedNode(NOTIFY + kind)) in found
        for feature in ("accept", "rate", "startAt", "endAt", "state"):
            assert Triple(service, NamedNode(f"{NOTIFY}feature"), NamedNode(NOTIFY + feature)) in found


def test_jsonld_is_compact_for_clients_without_rdf(aircraft: Any) -> None:
    answer = aircraft.http.get("/.well-known/solid", headers={"Accept": "application/ld+json"})
    assert answer.headers["content-type"] == "application/ld+json"
    said = answer.json()
    assert isinstance(said["@context"], dict), "nothing of another host has to be fetched to read it"
    assert said["id"] == f"{aircraft.url}.well-known/solid"
    assert [one["channelType"] for one in said["subscription"]] == [NOTIFY + WEBSOCKET, NOTIFY + STREAMING]
    again = {"If-None-Match": answer.headers["etag"], "Accept": "application/ld+json"}
    assert aircraft.http.get("/.well-known/solid", headers=again).status_code == 304


def test_a_service_describes_itself_and_says_what_it_takes(aircraft: Any) -> None:
    url = f"/channels/{WEBSOCKET}"
    assert aircraft.http.get(url, headers=JSON_LD).json()["channelType"] == NOTIFY + WEBSOCKET
    for method in ("GET", "HEAD", "OPTIONS"):
        headers = aircraft.http.request(method, url).headers
        assert headers["allow"] == "GET, HEAD, OPTIONS, POST"
        assert "application/ld+json" in headers["accept-post"]
    assert aircraft.http.get("/channels", follow_redirects=True).status_code == 200
    assert f"/channels/{STREAMING}" in aircraft.http.get("/channels/", headers={"Accept": "text/turtle"}).text


# Receiving


def test_what_is_well_known_is_a_container_to_which_what_is_below_it_leads_up(
    aircraft: Any, triples_of: Callable[..., Any]
) -> None:
    http, url = aircraft.http, f"{aircraft.url}.well-known/"
    assert http.get("/.well-known").headers["location"] == url
    answer = http.get("/.well-known/", headers={"Accept": "text/turtle"})
    contained = {each.object.value for each in triples_of(answer) if each.predicate.value.endswith("ldp#contains")}
    assert contained == {f"{url}solid", f"{url}wot"}
    assert all(http.get(each).status_code == 200 for each in contained)
    page = http.get("/.well-known/solid", headers={"Accept": "text/html"})
    assert f'href="{url}"' in page.text or 'href="/.well-known/"' in page.text
    assert http.get("/.well-known/", headers={"Accept": "text/html"}).status_code == 200
    assert http.get("/.well-known/other").status_code == 404


def test_a_live_topic_notifies_over_a_websocket_no_faster_than_its_rate(serve: Callable[..., Any]) -> None:
    served = serve("aircraft")
    channel = subscribed(served, SPEED, rate="PT0.3S")
    with connect(channel["receiveFrom"]) as ws:
        fly(served, 30)
        came = [received(ws) for _ in range(5)]
    for found in came:
        assert found["@context"] == ["https://www.w3.org/ns/activitystreams", CONTEXT]
        assert found["type"] == "Update"
        assert found["object"] == served.url + SPEED
        assert found["id"].startswith("urn:uuid:")
        assert found["published"].endswith("Z")
    assert len({found["state"] for found in came}) == 5
    assert told_at(came[-1]) - told_at(came[0]) > 3.5 * 0.3  # one may come a quarter early


def told_at(found: Any) -> float:
    """When a notification was published, in seconds, as the server told it."""
    whole, _, part = found["published"].rstrip("Z").partition(".")
    return datetime.fromisoformat(whole).timestamp() + float(f"0.{part or 0}")


def test_a_complex_resource_notifies_over_http(serve: Callable[..., Any]) -> None:
    served = serve("aircraft")
    with streaming(served, subscribed(served, AIRCRAFT, STREAMING)) as came:
        fly(served, 10)
        found = next(came)
    assert (found["type"], found["object"]) == ("Update", served.url + AIRCRAFT)


def test_the_state_told_is_the_one_in_the_entity_tag(aircraft: Any) -> None:
    with connect(subscribed(aircraft, NIGHT)["receiveFrom"]) as ws:
        turn(aircraft)
        state = received(ws)["state"]
    etag = aircraft.http.get(f"/{NIGHT}", headers={"Accept": "text/turtle"}).headers["etag"]
    assert etag == f'"{state}.ttl"'


def test_who_has_the_present_state_is_told_of_the_next(aircraft: Any) -> None:
    etag = aircraft.http.get(f"/{NIGHT}").headers["etag"]
    with connect(subscribed(aircraft, NIGHT, state=etag)["receiveFrom"]) as ws:
        turn(aircraft)
        assert received(ws)["state"] not in etag
    with connect(subscribed(aircraft, NIGHT, state=etag)["receiveFrom"]) as ws:
        assert received(ws)["state"] not in etag  # at once: nothing changed since


def test_a_container_tells_which_member_came_and_went(aircraft: Any) -> None:
    url = subscribed(aircraft, "topics/")["receiveFrom"]
    with connect(url) as ws, streaming(aircraft, subscribed(aircraft, "topics/", STREAMING)) as came:
        aircraft.http.put("/topics/notified", content=STRING, headers={"Content-Type": "text/turtle"})
        notified = iter(lambda: received(ws), None)
        added, same = of_members(notified), of_members(came)
        aircraft.http.delete("/topics/notified").raise_for_status()
        removed = of_members(notified)
    assert (added["type"], added["object"], added["target"]) == (
        "Add", f"{aircraft.url}topics/notified", f"{aircraft.url}topics/",
    )  # fmt: skip
    assert (removed["type"], removed["object"]) == ("Remove", f"{aircraft.url}topics/notified")
    assert same == added


def of_members(notified: Iterator[dict[str, Any]]) -> dict[str, Any]:
    """The next notification of a member: a container also tells that it was updated, by a rate that became known."""
    return next(each for each in notified if each["type"] != "Update")


def test_what_is_deleted_and_made_again_is_told(aircraft: Any) -> None:
    path, turtle = "/topics/notified_too", {"Content-Type": "text/turtle"}
    aircraft.http.put(path, content=STRING, headers=turtle)
    with connect(subscribed(aircraft, path[1:])["receiveFrom"]) as ws:
        aircraft.http.delete(path).raise_for_status()
        while (last := received(ws))["type"] != "Delete":
            pass
        assert "state" not in last
        aircraft.http.put(path, content=STRING, headers=turtle)
        assert received(ws)["type"] == "Create"
    aircraft.http.delete(path).raise_for_status()


def test_notifications_come_in_turtle_where_that_is_accepted(aircraft: Any) -> None:
    channel = subscribed(aircraft, NIGHT, accept="text/turtle")
    assert channel["accept"] == "text/turtle"
    with connect(channel["receiveFrom"]) as ws:
        turn(aircraft)
        assert "https://www.w3.org/ns/activitystreams#object" in str(ws.recv(10))
    streamed = subscribed(aircraft, NIGHT, STREAMING, accept="text/turtle")
    head = aircraft.http.head(streamed["receiveFrom"])
    assert head.headers["content-type"] == "text/turtle; charset=utf-8"


def test_a_receiver_that_comes_back_hears_what_it_missed(aircraft: Any) -> None:
    channel = subscribed(aircraft, NIGHT)
    with connect(channel["receiveFrom"]):
        pass
    turn(aircraft)
    with connect(channel["receiveFrom"]) as ws:
        assert received(ws)["type"] == "Update"


def test_a_second_connection_takes_the_place_of_the_first(aircraft: Any) -> None:
    channel = subscribed(aircraft, NIGHT)
    with connect(channel["receiveFrom"]) as old, connect(channel["receiveFrom"]) as new:
        with pytest.raises(ConnectionClosed) as caught:
            old.recv(10)
        assert caught.value.rcvd is not None
        assert caught.value.rcvd.code == 1000
        turn(aircraft)
        assert received(new)["type"] == "Update"


def test_a_channel_ends_at_its_end_and_when_it_is_deleted(aircraft: Any) -> None:
    for channel, end in (
        (subscribed(aircraft, NIGHT, endAt=moment(1)), lambda url: None),
        (subscribed(aircraft, NIGHT), lambda url: aircraft.http.delete(url).raise_for_status()),
    ):
        with connect(channel["receiveFrom"]) as ws:
            end(channel["id"])
            with pytest.raises(ConnectionClosed) as caught:
                ws.recv(10)
        assert caught.value.rcvd is not None
        assert caught.value.rcvd.code == 1000
        assert aircraft.http.get(channel["id"]).status_code == 404
    streamed = subscribed(aircraft, NIGHT, STREAMING, endAt=moment(1))
    with streaming(aircraft, streamed) as came:
        assert list(came) == []


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


def test_a_subscription_in_turtle_is_answered_in_turtle(aircraft: Any) -> None:
    turtle = {"Content-Type": "text/turtle", "Accept": "text/turtle"}
    answer = post(aircraft, f"[] a <{NOTIFY}{WEBSOCKET}> ; <{NOTIFY}topic> </{NIGHT}> .".encode(), **turtle)
    assert answer.status_code == 201
    assert answer.headers["content-type"].startswith("text/turtle")
    assert "receiveFrom" in answer.text


def test_a_browsers_choice_of_subprotocol_is_confirmed(aircraft: Any) -> None:
    with connect(subscribed(aircraft, NIGHT)["receiveFrom"], subprotocols=[WEBSOCKET]) as ws:  # type: ignore[list-item]
        assert ws.subprotocol == WEBSOCKET


def test_what_a_client_says_is_not_listened_to(aircraft: Any) -> None:
    with connect(subscribed(aircraft, NIGHT)["receiveFrom"]) as ws:
        for _ in range(100):
            ws.send("hello")
        turn(aircraft)
        assert received(ws)["type"] == "Update"
        ws.send("x" * 10_000)
        with pytest.raises(ConnectionClosed) as caught:
            ws.recv(10)
        assert caught.value.rcvd is not None
        assert caught.value.rcvd.code == 1009


def test_a_hundred_receivers_hear_of_one_change_at_once(aircraft: Any) -> None:
    channels = [subscribed(aircraft, NIGHT)["receiveFrom"] for _ in range(100)]
    with ThreadPoolExecutor(100) as pool, ExitStack() as open_ones:
        made = pool.map(connect, channels)
        sockets = [open_ones.enter_context(ws) for ws in made]
        turn(aircraft)
        came = list(pool.map(received, sockets))
        assert len({found["id"] for found in came}) == 1


# Refusals


@pytest.mark.parametrize(
    ("changed", "status", "said"),
    [
        ({"topic": "http://elsewhere.example/topics/x"}, 422, "elsewhere.example"),
        ({"topic": "/topics/none"}, 422, "/none"),
        ({"topic": "/nothing/here"}, 422, "nothing/here"),
        ({"topic": "/.well-known/wot"}, 422, "no state"),
        ({"topic": "/topics/%ff"}, 422, "%ff"),
        ({"topic": "/topics"}, 422, "/topics/"),
        ({"topic": 5}, 422, "topic"),
        ({"type": NOTIFY + STREAMING}, 422, STREAMING),
        ({"@context": "http://evil.example/"}, 422, "evil.example"),
        ({"rate": "fast"}, 422, "fast"),
        ({"state": "x" * 20_000}, 413, "16384"),
    ],
)
def test_a_hostile_subscription_is_a_clear_error(
    aircraft: Any, changed: dict[str, object], status: int, said: str
) -> None:
    body = wish(aircraft, NIGHT) | changed
    if str(body["topic"]).startswith("/"):
        body["topic"] = aircraft.url + str(body["topic"])[1:]
    answer = post(aircraft, body, Accept="application/json")
    assert answer.status_code == status, answer.text
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
        with pytest.raises(ConnectionClosed) as caught:
            ws.recv(10)
        assert list(came) == []
        assert served.process.wait(60) == 0
    assert caught.value.rcvd is not None
    assert caught.value.rcvd.code in (1001, 1012)
