"""Changes over HTTP: event streams and long polling."""

from __future__ import annotations

import json
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple
from urllib.parse import urlencode, urlsplit

import httpx
import pytest

from tests.waiting import until

pytestmark = pytest.mark.slow

STREAM = {"Accept": "text/event-stream"}
JSON = {"Accept": "application/json"}
SPEED = "/topics/aircraft/engine/speed"
DISPLAY = "/topics/cockpit/display"
NIGHT = "/parameters/cockpit/night"
TURTLE = {"Content-Type": "text/turtle"}
STRING = (
    "<#message> a <https://w3id.org/rosld/types/std_msgs/msg/String> ; "
    '<https://w3id.org/rosld/types/std_msgs/msg/String#data> "%s" .'
)


class Event(NamedTuple):
    """An event as a client reads it, with its time."""

    name: str
    data: str
    id: str | None
    at: float

    @property
    def json(self) -> Any:
        """The data as JSON."""
        return json.loads(self.data)


def events(stream: httpx.Response) -> Iterator[Event]:
    """Yield the events of a stream."""
    fields: dict[str, list[str]] = {}
    for line in stream.iter_lines():
        if line.startswith(":"):
            continue
        if line:
            name, _, value = line.partition(":")
            fields.setdefault(name, []).append(value.removeprefix(" "))
        elif fields:
            if "data" in fields:
                name, found = fields.get("event", ["message"])[0], fields.get("id", [None])[0]
                yield Event(name, "\n".join(fields["data"]), found, time.monotonic())
            fields = {}


@contextmanager
def streaming(served: Any, path: str, **headers: str) -> Iterator[Iterator[Event]]:
    """Open a stream, which must succeed."""
    sent = {**STREAM, **{name.replace("_", "-"): value for name, value in headers.items()}}
    with served.http.stream("GET", path, headers=sent) as stream:
        assert stream.status_code == 200, stream.read()
        assert stream.headers["content-type"] == "text/event-stream; charset=utf-8"
        yield events(stream)


def first(found: Iterator[Event], true: Callable[[Event], bool]) -> Event:
    """Return the first event that meets a condition."""
    return next(event for event in found if true(event))


def test_a_topic_tells_its_values_as_they_come_and_in_order(serve: Callable[..., Any]) -> None:
    served = serve("aircraft")
    with streaming(served, SPEED) as found:
        assert next(found).json == {"data": 0.0}
        served.http.post("/services/aircraft/start", json={}, headers=JSON).raise_for_status()
        served.http.post("/services/aircraft/engine/set_speed", json={"data": 20}, headers=JSON).raise_for_status()
        climbing = []
        while not climbing or climbing[-1] < 20:
            climbing.append(next(found).json["data"])
    assert climbing == sorted(climbing)
    with streaming(served, f"{DISPLAY}?rate=100") as found:
        next(found)
        for number in range(10):
            served.http.put(DISPLAY, json={"data": f"to {number}"}).raise_for_status()
            assert next(found).json == {"data": f"to {number}"}
            time.sleep(0.01)


def test_a_stream_is_for_who_prefers_it_and_nobody_stores_or_buffers_it(aircraft: Any) -> None:
    with aircraft.http.stream("GET", SPEED, headers=STREAM) as stream:
        assert stream.headers["cache-control"] == "no-store"
        assert stream.headers["x-accel-buffering"] == "no"
        assert stream.headers["vary"] == "Accept"
        assert "content-length" not in stream.headers
        assert next(stream.iter_lines()) == "retry: 2000"
    for accept in ("*/*", "text/*", "application/json, text/event-stream", "text/html, */*;q=0.5"):
        answer = aircraft.http.get(SPEED, headers={"Accept": accept})
        assert not answer.headers["content-type"].startswith("text/event-stream")
        assert "content-length" in answer.headers
    answer = aircraft.http.head(SPEED, headers=STREAM)
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "text/event-stream; charset=utf-8"
    assert aircraft.http.head("/topics/none", headers=STREAM).status_code == 404


def test_an_event_says_the_very_same_as_a_get_in_the_format_asked_for(aircraft: Any) -> None:
    beginnings = {"": '{"data":', "json": '{"data":', "jsonld": "{", "ttl": "@", "turtle": "@", "nt": "<"}
    for name, beginning in (beginnings | {"html": "<!doctype html>"}).items():
        with streaming(aircraft, f"{SPEED}?format={name}" if name else SPEED) as found:
            assert next(found).data.startswith(beginning), name
    with streaming(aircraft, "/topics/?format=ttl") as found:
        for event in found:
            read = aircraft.http.get("/topics/", headers={"Accept": "text/turtle"})
            if read.headers["etag"] == f'"{event.id}.ttl"':  # nothing has changed in between
                break
        assert event.data == read.text.removesuffix("\n")


def test_what_cannot_be_streamed_is_an_ordinary_problem(aircraft: Any) -> None:
    refusals = [(f"{SPEED}?format={name}", 406, "json") for name in ("yaml", "")]
    rates = ("0", "-1", "nan", "inf", "1_0", "", "x" * 1000, "%0a", "1%00", "٣")
    refusals += [(f"{SPEED}?rate={rate}", 400, "?rate=") for rate in rates]
    for path, status, words in (*refusals, ("/topics/none", 404, "/none")):
        answer = aircraft.http.get(path, headers=STREAM)
        assert answer.status_code == status, path
        assert answer.headers["content-type"] == "application/problem+json"
        assert words in answer.json()["detail"]


def test_a_reader_who_has_the_present_state_is_not_told_it_again(aircraft: Any) -> None:
    with streaming(aircraft, NIGHT) as found:
        present = next(found)
    with streaming(aircraft, NIGHT, Last_Event_ID=str(present.id)) as found:
        aircraft.http.put(NIGHT, json=not present.json).raise_for_status()
        assert next(found).json is not present.json
    with streaming(aircraft, NIGHT, Last_Event_ID="long-ago") as found:
        assert next(found).json is not present.json


def test_a_tree_of_parameters_tells_at_once_of_what_lies_in_it(aircraft: Any) -> None:
    with streaming(aircraft, "/parameters/cockpit/") as found:
        before = next(found).json["night"]
        seconds = []
        for night in (not before, before, not before):
            began = time.monotonic()
            aircraft.http.put(NIGHT, json=night).raise_for_status()
            assert next(found).json["night"] is night
            seconds.append(time.monotonic() - began)
        assert min(seconds[1:]) < 0.9, "it is found out once a second, and not told"


def test_a_topic_that_goes_is_told_and_told_again_when_it_is_back(aircraft: Any) -> None:
    path = "/topics/coming_and_going"
    assert aircraft.http.put(path, content=STRING % "here", headers=TURTLE).status_code in (201, 202, 204)
    with streaming(aircraft, path) as found:
        assert first(found, lambda event: event.data != "null").json == {"data": "here"}
        aircraft.http.delete(path).raise_for_status()
        gone = first(found, lambda event: event.name == "gone")
        assert gone.json["status"] == 404
        assert gone.id is None
        aircraft.http.put(path, content=STRING % "back", headers=TURTLE)
        assert first(found, lambda event: event.name == "message" and event.data != "null").json == {"data": "back"}
    aircraft.http.delete(path)


def test_calls_are_told_as_they_are_made_and_the_stream_of_one_that_is_deleted_ends(aircraft: Any) -> None:
    with streaming(aircraft, "/calls/?format=nt") as found:
        next(found)
        call = aircraft.http.post("/services/aircraft/get_power", json={}, headers=JSON).headers["location"]
        first(found, lambda event: call in event.data)
    with streaming(aircraft, call) as found:
        assert next(found).json["response"] == {"data": "off"}
        aircraft.http.delete(call).raise_for_status()
        rest = list(found)
    assert [(event.name, event.json["status"]) for event in rest] == [("gone", 410)]


def test_waiting_ends_with_the_change_or_in_vain_with_304(aircraft: Any) -> None:
    read = aircraft.http.get(NIGHT, headers=JSON)
    etag, value = read.headers["etag"], read.json()
    state = etag.strip('"').rpartition(".")[0]
    for after in (state, f'"{state}"', f"{state}.ttl"):
        waited = aircraft.http.get(NIGHT, params={"after": after, "timeout": "0.2"}, headers=JSON)
        assert (waited.status_code, waited.headers["etag"], waited.content) == (304, etag, b"")
        assert 0.15 < waited.elapsed.total_seconds() < 20

    def change() -> None:
        httpx.put(f"{aircraft.url}{NIGHT[1:]}", json=not value).raise_for_status()

    timer = threading.Timer(0.2, change)
    timer.start()
    waited = aircraft.http.get(NIGHT, params={"after": etag, "timeout": "50"}, headers=JSON)
    timer.join()
    assert waited.elapsed.total_seconds() < 40
    assert waited.status_code == 200
    assert waited.json() is not value
    assert waited.headers["etag"] != etag
    for after in ("", "long-ago", '"x.ttl"'):  # a client with an outdated state does not wait
        read = aircraft.http.get(NIGHT, params={"after": after, "timeout": "50", "format": "ttl"})
        assert read.status_code == 200
        assert read.headers["content-type"].startswith("text/turtle")
        assert read.elapsed.total_seconds() < 40
    assert aircraft.http.get("/topics/none?after=x").status_code == 404
    assert aircraft.http.get(f"{NIGHT}?after=x&timeout=soon").status_code == 400


def test_a_hundred_readers_get_every_value_in_time_and_who_hangs_up_is_forgotten(serve: Callable[..., Any]) -> None:
    served = serve("aircraft", "--setting", "client_streams", "100")
    limits = httpx.Limits(max_connections=None)
    with httpx.Client(base_url=served.url, timeout=20, limits=limits) as http, ExitStack() as stack:
        opened = [http.stream("GET", f"{SPEED}?rate=100", headers=STREAM) for _ in range(100)]
        many = [events(stack.enter_context(each)) for each in opened]
        assert {next(found).name for found in many for _ in range(5)} == {"message"}
        assert http.get(SPEED, headers=JSON).status_code == 200

    def is_let_in() -> bool:
        with served.http.stream("GET", SPEED, headers=STREAM) as stream:
            return bool(stream.status_code == 200)

    for _ in range(3):
        until(is_let_in, "room for another reader")


def test_the_server_ends_at_once_with_streams_and_waits_open(serve: Callable[..., Any]) -> None:
    served = serve("aircraft", process=True)
    etag = served.http.get(NIGHT, headers=JSON).headers["etag"]
    url = urlsplit(served.url)
    query = urlencode({"after": etag})
    waiting = socket.create_connection((url.hostname, url.port), timeout=20)
    waiting.sendall(f"GET {NIGHT}?{query} HTTP/1.1\r\nHost: {url.netloc}\r\nAccept: application/json\r\n\r\n".encode())
    with waiting, ExitStack() as stack:
        paths = [SPEED, DISPLAY, "/topics/", "/", NIGHT, "/ontology"] * 2
        many = [stack.enter_context(streaming(served, path)) for path in paths]
        for found in many:
            next(found)
        served.process.send_signal(signal.SIGTERM)
        assert served.process.wait(60) == 0
        for found in many:
            assert all(event.name == "message" for event in found)  # each ends as a stream ends, not in the middle
        assert waiting.recv(100).startswith(b"HTTP/1.1 304 ")
