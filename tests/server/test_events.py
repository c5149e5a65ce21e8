"""Changes as they happen, over HTTP: event streams and waiting without one."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlencode, urlsplit

import httpx
import pytest

from tests.adapters.ros1.system import running

HERE = Path(__file__).parent
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
    """An event as a client reads it, and when."""

    name: str
    data: str
    id: str | None
    at: float

    @property
    def json(self) -> Any:
        """The data as JSON."""
        return json.loads(self.data)


def events(stream: httpx.Response) -> Iterator[Event]:
    """The events of a stream as they come."""
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
    """A stream, which must begin."""
    sent = {**STREAM, **{name.replace("_", "-"): value for name, value in headers.items()}}
    with served.http.stream("GET", path, headers=sent) as stream:
        assert stream.status_code == 200, stream.read()
        assert stream.headers["content-type"] == "text/event-stream; charset=utf-8"
        yield events(stream)


def first(found: Iterator[Event], true: Callable[[Event], bool]) -> Event:
    """The first event of which this is so."""
    return next(event for event in found if true(event))


def test_a_topic_tells_its_values_as_they_change(serve: Callable[..., Any]) -> None:
    served = serve("aircraft")
    with streaming(served, SPEED) as found:
        assert next(found).json == {"data": 0.0}
        served.http.post("/services/aircraft/start", json={}, headers=JSON).raise_for_status()
        served.http.post("/services/aircraft/engine/set_speed", json={"data": 20}, headers=JSON).raise_for_status()
        climbing = []
        while not climbing or climbing[-1] < 20:
            climbing.append(next(found).json["data"])
    assert climbing == sorted(climbing)


def test_what_is_put_arrives_at_once_and_in_order(aircraft: Any) -> None:
    with streaming(aircraft, f"{DISPLAY}?rate=100") as found:
        next(found)
        for number in range(20):
            aircraft.http.put(DISPLAY, json={"data": f"to {number}"}).raise_for_status()
            assert next(found).json == {"data": f"to {number}"}
            time.sleep(0.01)


def test_the_headers_keep_everybody_from_storing_or_buffering_it(aircraft: Any) -> None:
    with aircraft.http.stream("GET", SPEED, headers=STREAM) as stream:
        assert stream.headers["cache-control"] == "no-store"
        assert stream.headers["x-accel-buffering"] == "no"
        assert stream.headers["vary"] == "Accept"
        assert "content-length" not in stream.headers
        assert next(stream.iter_lines()) == "retry: 2000"


@pytest.mark.parametrize("accept", ["*/*", "text/*", "application/json, text/event-stream", "text/html, */*;q=0.5"])
def test_who_does_not_prefer_a_stream_gets_none(aircraft: Any, accept: str) -> None:
    answer = aircraft.http.get(SPEED, headers={"Accept": accept})
    assert not answer.headers["content-type"].startswith("text/event-stream")
    assert "content-length" in answer.headers


def test_head_tells_of_the_stream_and_has_none(aircraft: Any) -> None:
    answer = aircraft.http.head(SPEED, headers=STREAM)
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "text/event-stream; charset=utf-8"
    assert aircraft.http.head("/topics/none", headers=STREAM).status_code == 404


@pytest.mark.parametrize(
    ("query", "beginning"),
    [
        ("", '{"data":'),
        ("?format=json", '{"data":'),
        ("?format=jsonld", "{"),
        ("?format=ttl", "@"),
        ("?format=turtle", "@"),
        ("?format=nt", "<"),
        ("?format=html", "<!doctype html>"),
    ],
)
def test_the_data_has_the_format_asked_for(aircraft: Any, query: str, beginning: str) -> None:
    with streaming(aircraft, SPEED + query) as found:
        assert next(found).data.startswith(beginning)


def test_an_event_says_the_very_same_as_a_get(aircraft: Any) -> None:
    with streaming(aircraft, "/topics/?format=ttl") as found:
        for event in found:
            read = aircraft.http.get("/topics/", headers={"Accept": "text/turtle"})
            if read.headers["etag"] == f'"{event.id}.ttl"':  # nothing has changed in between
                break
        assert event.data == read.text.removesuffix("\n")


@pytest.mark.parametrize("name", ["yaml", ""])
def test_what_cannot_be_streamed_is_refused_before_it_begins(aircraft: Any, name: str) -> None:
    answer = aircraft.http.get(f"{SPEED}?format={name}", headers=STREAM)
    assert answer.status_code == 406
    assert "json" in answer.json()["detail"]


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf", "1_0", "", "x" * 1000, "%0a", "1%00", "٣"])
def test_a_hostile_rate_is_refused_before_it_begins(aircraft: Any, rate: str) -> None:
    answer = aircraft.http.get(f"{SPEED}?rate={rate}", headers=STREAM)
    assert answer.status_code == 400
    assert "?rate=" in answer.json()["detail"]


def test_what_is_not_there_is_an_ordinary_problem(aircraft: Any) -> None:
    answer = aircraft.http.get("/topics/none", headers=STREAM)
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


def test_the_rate_is_honoured(aircraft: Any) -> None:
    with streaming(aircraft, f"{SPEED}?rate=4") as found:
        came = [next(found).at for _ in range(9)]
    assert 8 / 4 * 0.8 <= came[-1] - came[0] <= 8 / 4 * 1.6


def test_a_reader_who_has_the_present_state_is_not_told_it_again(aircraft: Any) -> None:
    with streaming(aircraft, NIGHT) as found:
        present = next(found)
    with streaming(aircraft, NIGHT, Last_Event_ID=str(present.id)) as found:
        aircraft.http.put(NIGHT, json=not present.json).raise_for_status()
        assert next(found).json is not present.json
    with streaming(aircraft, NIGHT, Last_Event_ID="long-ago") as found:
        assert next(found).json is not present.json


def test_a_tree_of_parameters_tells_of_what_lies_in_it(aircraft: Any) -> None:
    with streaming(aircraft, "/parameters/cockpit/") as found:
        before = next(found).json["night"]
        seconds = []
        for night in (not before, before, not before, before, not before):
            began = time.monotonic()
            aircraft.http.put(NIGHT, json=night).raise_for_status()
            assert next(found).json["night"] is night
            seconds.append(time.monotonic() - began)
        assert min(seconds[1:]) < 0.9, "it is found out once a second, and not told"


def test_a_container_tells_of_its_members(aircraft: Any) -> None:
    with streaming(aircraft, "/topics/?format=ttl") as found:
        assert "</topics/passing>" not in next(found).data
        made = aircraft.http.put("/topics/passing", content=STRING % "by", headers=TURTLE)
        assert made.status_code in (201, 202, 204), made.text
        first(found, lambda event: "/topics/passing>" in event.data)
        aircraft.http.delete("/topics/passing").raise_for_status()
        first(found, lambda event: "/topics/passing>" not in event.data)


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


def test_what_is_gone_for_good_ends_the_stream(aircraft: Any) -> None:
    call = aircraft.http.post("/services/aircraft/get_power", json={}, headers=JSON).headers["location"]
    with streaming(aircraft, call) as found:
        assert next(found).json["response"] == {"data": "off"}
        aircraft.http.delete(call).raise_for_status()
        rest = list(found)
    assert [(event.name, event.json["status"]) for event in rest] == [("gone", 410)]


def test_calls_are_told_as_they_are_made(aircraft: Any) -> None:
    with streaming(aircraft, "/calls/?format=nt") as found:
        next(found)
        call = aircraft.http.post("/services/aircraft/get_power", json={}, headers=JSON).headers["location"]
        first(found, lambda event: call in event.data)


def test_a_foreign_page_is_shared_with_as_with_any_read(serve: Callable[..., Any]) -> None:
    served = serve("aircraft", "--cors-origin", "https://app.example")
    with served.http.stream("GET", SPEED, headers=STREAM | {"Origin": "https://app.example"}) as stream:
        assert stream.headers["access-control-allow-origin"] == "https://app.example"
        assert stream.headers["vary"] == "Accept, Origin"
        assert next(events(stream)).json == {"data": 0.0}
    with served.http.stream("GET", SPEED, headers=STREAM | {"Origin": "https://other.example"}) as stream:
        assert "access-control-allow-origin" not in stream.headers


def test_waiting_ends_with_the_change(aircraft: Any) -> None:
    read = aircraft.http.get(NIGHT, headers=JSON)
    etag, value = read.headers["etag"], read.json()

    def change() -> None:
        httpx.put(f"{aircraft.url}{NIGHT[1:]}", json=not value).raise_for_status()

    timer = threading.Timer(0.3, change)
    timer.start()
    began = time.monotonic()
    waited = aircraft.http.get(NIGHT, params={"after": etag, "timeout": "50"}, headers=JSON)
    assert time.monotonic() - began < 40
    timer.join()
    assert waited.status_code == 200
    assert waited.json() is not value
    assert waited.headers["etag"] != etag


@pytest.mark.parametrize("of", ["{}", '"{}"', "{}.ttl"])
def test_waiting_in_vain_ends_with_304(aircraft: Any, of: str) -> None:
    etag = aircraft.http.get(NIGHT, headers=JSON).headers["etag"]
    after = of.format(etag.strip('"').rpartition(".")[0])
    began = time.monotonic()
    waited = aircraft.http.get(NIGHT, params={"after": after, "timeout": "0.3"}, headers=JSON)
    assert waited.status_code == 304
    assert waited.headers["etag"] == etag
    assert waited.content == b""
    assert 0.25 < time.monotonic() - began < 20


def test_who_has_another_state_does_not_wait(aircraft: Any) -> None:
    began = time.monotonic()
    for after in ("", "long-ago", '"x.ttl"'):
        read = aircraft.http.get(NIGHT, params={"after": after, "timeout": "50", "format": "ttl"})
        assert read.status_code == 200
        assert read.headers["content-type"].startswith("text/turtle")
    assert time.monotonic() - began < 40


def test_waiting_for_what_is_not_there_or_for_no_time_is_refused(aircraft: Any) -> None:
    assert aircraft.http.get("/topics/none?after=x").status_code == 404
    assert aircraft.http.get(f"{NIGHT}?after=x&timeout=soon").status_code == 400


def test_a_reader_who_hangs_up_is_forgotten_and_others_go_on(aircraft: Any) -> None:
    for _ in range(30):
        with streaming(aircraft, f"{SPEED}?rate=100") as found:
            next(found)
    with streaming(aircraft, SPEED) as found:
        assert next(found).name == "message"
        assert next(found).name == "message"


def test_three_hundred_readers_get_every_value_in_time(serve: Callable[..., Any]) -> None:
    served = serve("aircraft", "--setting", "client_streams", "300")
    with ExitStack() as stack:
        limits = httpx.Limits(max_connections=None)
        http = stack.enter_context(httpx.Client(base_url=served.url, timeout=20, limits=limits))
        many = [
            events(stack.enter_context(http.stream("GET", f"{SPEED}?rate=100", headers=STREAM))) for _ in range(300)
        ]
        last = [[next(found) for _ in range(10)][-1] for found in many]
        assert {event.name for event in last} == {"message"}
        assert http.get(SPEED, headers=JSON).status_code == 200


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_server_ends_at_once_with_streams_and_waits_open(serve: Callable[..., Any], number: signal.Signals) -> None:
    served = serve("aircraft", process=True)
    etag = served.http.get(NIGHT, headers=JSON).headers["etag"]
    url = urlsplit(served.url)
    query = urlencode({"after": etag})
    waiting = socket.create_connection((url.hostname, url.port), timeout=20)
    waiting.sendall(f"GET {NIGHT}?{query} HTTP/1.1\r\nHost: {url.netloc}\r\nAccept: application/json\r\n\r\n".encode())
    with waiting, ExitStack() as stack:
        paths = [SPEED, DISPLAY, "/topics/", "/", NIGHT, "/ontology"] * 5
        many = [stack.enter_context(streaming(served, path)) for path in paths]
        for found in many:
            next(found)
        served.process.send_signal(number)
        assert served.process.wait(60) == 0
        for found in many:
            assert all(event.name == "message" for event in found)  # each ends as a stream ends, not in the middle
        assert waiting.recv(100).startswith(b"HTTP/1.1 304 ")


PAGE = """<!doctype html><title>events</title><script>
const source = new EventSource("URL");
const seen = [];
source.onmessage = (event) => {
  seen.push({data: event.data, id: event.lastEventId});
  if (seen.length === 3) {
    source.close();
    fetch("/seen", {method: "POST", body: JSON.stringify(seen)});
  }
};
</script>"""


def test_an_event_source_of_a_real_browser_reads_it(serve: Callable[..., Any], tmp_path: Path) -> None:
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("needs chromium: apt-get install $(cat tests/debian-browser.txt)")
    told: list[list[dict[str, str]]] = []
    came = threading.Event()
    page = b""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(page)

        def do_POST(self) -> None:
            told.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()
            came.set()

        def log_message(self, format: str, *args: object) -> None:
            pass

    site = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    origin = f"http://127.0.0.1:{site.server_port}"
    served = serve("aircraft", "--cors-origin", origin)
    page = PAGE.replace("URL", f"{served.url}{SPEED[1:]}").encode()
    threading.Thread(target=site.serve_forever, daemon=True).start()
    quiet = "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-sync"
    command = [program, *quiet.split(), f"--user-data-dir={tmp_path}", "--remote-debugging-port=0", origin]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as browser:
        try:
            assert came.wait(60), "the browser saw no three events"
        finally:
            browser.terminate()
            site.shutdown()
            site.server_close()
    assert [json.loads(event["data"]) for event in told[0]] == [{"data": 0.0}] * 3
    assert len({event["id"] for event in told[0]}) == 3


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A rosmaster, and whatever a test starts on it."""
    with running(tmp_path_factory.mktemp("ros")) as system:
        yield system


@pytest.fixture(scope="module")
def robot(ros: Any, start_server: Callable[..., Any]) -> Iterator[Any]:
    """rosld on that system."""
    served = start_server(ros.source)
    yield served
    assert served.stop() == 0


def until_there(robot: Any, path: str) -> None:
    """Wait until a resource is there."""
    deadline = time.monotonic() + 20
    while robot.http.get(path).status_code != 200:
        assert time.monotonic() < deadline, f"never came: {path}"
        time.sleep(0.05)


def test_what_a_ros_node_publishes_is_streamed_and_what_comes_after_it_too(ros: Any, robot: Any) -> None:
    node = ros.publish("/chatter", "std_msgs/String", "data: first", rate=50, name="talker")
    until_there(robot, "/topics/chatter")
    with streaming(robot, "/topics/chatter?rate=20") as found:
        several = [first(found, lambda event: event.data != "null") for _ in range(20)]
        assert all(event.json == {"data": "first"} for event in several)
        assert several[-1].at - several[0].at > 19 / 20 * 0.8
        node.kill()
        again = ros.publish("/chatter", "std_msgs/String", "data: second", name="talker_again")
        first(found, lambda event: event.json == {"data": "second"})
        again.stop()


def test_a_parameter_set_by_rosparam_is_streamed(ros: Any, robot: Any) -> None:
    ros.run("/usr/bin/rosparam", "set", "/told", "1")
    with streaming(robot, "/parameters/told") as found:
        assert next(found).json == 1
        ros.run("/usr/bin/rosparam", "set", "/told", "2.5")
        assert next(found).json == 2.5
        ros.run("/usr/bin/rosparam", "delete", "/told")
        assert first(found, lambda event: event.name == "gone").json["status"] == 404
