"""Holds: a message is published while its holder is connected, and a final message afterwards."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import httpx
import pytest
import rdflib

from rosld.adapters.base import Published
from rosld.adapters.model import TypeRef, Unreachable
from tests.crawl.description import inlined
from tests.server.robots.made_up import MadeUp, served
from tests.waiting import until

pytestmark = pytest.mark.slow

DRIVE, STAMPED, NAMED, SENSOR = "/drive", "/stamped", "/named", "/sensor"
JSON = {"Accept": "application/json"}
ROS = "https://w3id.org/rosld#"
TD, HCTL = (rdflib.Namespace(f"https://www.w3.org/2019/wot/{name}#") for name in ("td", "hypermedia"))
STILL = {"linear": {"x": 0.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}


def ahead(x: float) -> dict[str, Any]:
    return {**STILL, "linear": {"x": x, "y": 0.0, "z": 0.0}}


class Driven(MadeUp):
    """A robot that records received messages with their times; it may be slow, or gone."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[tuple[float, str, Any]] = []
        self.is_gone = False
        self.seconds = 0.0
        self.at_once = self.max_at_once = 0
        self.topic(DRIVE, "geometry_msgs/msg/Twist", published=False, heard=True)
        self.topic(STAMPED, "geometry_msgs/msg/TwistStamped", published=False, heard=True)
        self.topic(NAMED, "std_msgs/msg/String", published=False, heard=True)
        self.topic(SENSOR, "std_msgs/msg/String", published=True, heard=True)

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        if self.is_gone:
            raise Unreachable("the robot is gone")
        self.at_once += 1
        self.max_at_once = max(self.max_at_once, self.at_once)
        try:
            await asyncio.sleep(self.seconds)
            published = await super().publish(topic, type, data, latch=latch, deadline=deadline)
        finally:
            self.at_once -= 1
        with self._happened:
            self.told.append((time.monotonic(), topic, self.sent[topic][-1]))
            self._happened.notify_all()
        return published

    def on(self, topic: str) -> list[Any]:
        """Return the messages received on a topic."""
        return [message for _, name, message in list(self.told) if name == topic]

    def is_told(self, message: Any) -> bool:
        """Whether this message was received last."""
        return self.told[-1][2] == message


@pytest.fixture(scope="module")
def driven() -> Driven:
    return Driven()


@pytest.fixture(scope="module")
def server(driven: Driven) -> Iterator[httpx.Client]:
    with served(driven) as client:
        yield client


@pytest.fixture
def http(driven: Driven, server: httpx.Client) -> Iterator[httpx.Client]:
    """The robot, without holds and received messages."""
    driven.told.clear()
    driven.is_gone, driven.seconds, driven.max_at_once = False, 0.0, 0
    yield server
    for hold in holds(server):
        server.delete(hold)


def held(http: httpx.Client, topic: str = DRIVE, message: Any = None, **query: Any) -> httpx.Response:
    return http.post(f"/topics{topic}", params={"rate": 50, **query}, json=ahead(1.0) if message is None else message)


def begun(http: httpx.Client, topic: str = DRIVE, message: Any = None, **query: Any) -> str:
    answer = held(http, topic, message, **query)
    assert answer.status_code == 201, answer.text
    return str(answer.headers["location"])


def holds(http: httpx.Client) -> list[str]:
    graph = http.get("/holds/", headers={"Accept": "application/ld+json"}).text
    return [f"/holds/{part}" for part in {one.partition('"')[0] for one in graph.split("/holds/")[1:]} if part]


def says(http: httpx.Client, url: str, predicate: str) -> list[str]:
    lines = http.get(url, headers={"Accept": "application/n-triples"}).text.splitlines()
    return [line.split(" ", 2)[2].removesuffix(" .") for line in lines if line.split(" ")[1] == f"<{predicate}>"]


# Holding


def test_a_hold_publishes_until_its_lease_lapses_and_then_stands_still(driven: Driven, http: httpx.Client) -> None:
    began = time.monotonic()
    answer = held(http, lease=0.3)
    assert answer.status_code == 201
    hold = answer.headers["location"]
    driven.until(lambda: driven.on(DRIVE)[-1:] == [STILL], "standing still")
    assert time.monotonic() - began > 0.28
    assert driven.on(DRIVE) == [ahead(1.0)] * (len(driven.on(DRIVE)) - 1) + [STILL]
    assert 2 <= len(driven.on(DRIVE)) <= 17
    gone = http.get(hold)
    assert gone.status_code == 410
    assert "its lease expired" in gone.text


def test_a_hold_for_a_time_needs_no_renewal_and_can_be_prolonged_and_ended(driven: Driven, http: httpx.Client) -> None:
    hold = begun(http, **{"for": 1.2})  # longer than the default lease
    state = http.get(hold, headers=JSON).json()
    assert (state["for"], state["lease"], state["url"]) == (1.2, 1.2, hold)
    assert says(http, hold, f"{ROS}holdTime") == ['"1.2"^^<http://www.w3.org/2001/XMLSchema#double>']
    driven.until(lambda: driven.is_told(STILL), "standing still")
    (began, *_), (ended, *_) = driven.told[0], driven.told[-1]
    assert 1.15 < ended - began < 5
    assert "its 1.2 s elapsed" in http.get(hold).text
    prolonged = begun(http, **{"for": 0.3})
    assert http.patch(prolonged, params={"for": 60}).status_code == 204
    assert http.get(prolonged, headers=JSON).json()["for"] == 60.0
    assert http.patch(prolonged, params={"lease": 5}).status_code == 204
    assert http.get(prolonged, headers=JSON).json()["for"] is None
    assert http.delete(prolonged).status_code == 204
    assert driven.is_told(STILL)


def test_a_velocity_that_is_published_once_is_answered_with_how_to_hold_it(driven: Driven, http: httpx.Client) -> None:
    for path in ("/topics/drive", "/resources/drive"):
        driven.told.clear()
        silent = http.put(path, json=ahead(1.0))
        assert silent.status_code == 204
        assert f'<{http.base_url}topics/drive#hold>; rel="help"; title="It stays in effect' in silent.headers["link"]
        told = http.put(path, json=ahead(1.0), headers=JSON)
        assert (told.status_code, told.json()["title"]) == (200, "Stays in effect until something stops it")
        assert f"POST to {http.base_url}topics/drive?for=3" in told.json()["detail"]
        shown = http.put(path, json=ahead(1.0), headers={**JSON, "Prefer": "return=representation"})
        assert shown.json() == ahead(1.0)
        assert "#hold" in shown.headers["link"]
        receipt = next(link for link in shown.headers["link"].split("<") if "/activity/" in link).partition(">")[0]
        assert "the command on /drive stays in effect until something stops it" in http.get(receipt).text
        assert http.put(path, json=STILL, headers=JSON).status_code == 204
        assert len(driven.on(DRIVE)) == 4
    assert "#hold" not in http.put(f"/topics{NAMED}", json={"data": "x"}, headers=JSON).headers["link"]


def test_who_renews_goes_on_and_never_faster_than_the_rate(driven: Driven, http: httpx.Client) -> None:
    hold = begun(http, lease=2)
    began = driven.told[0][0]
    while driven.told[-1][0] - began < 2.2:
        time.sleep(0.1)
        assert http.patch(hold).status_code == 204
    assert http.delete(hold).status_code == 204
    times = [at for at, _, message in driven.told if message != STILL]
    for number, at in enumerate(times):
        assert at >= began + (number - 1) / 50, "there are more than one a beat"


def test_another_message_comes_without_a_gap_and_without_a_double(driven: Driven, http: httpx.Client) -> None:
    hold = begun(http, lease=5)
    for x in (2.0, 3.0, 4.0):
        assert http.patch(hold, json=ahead(x)).status_code == 204
        driven.until(partial(driven.is_told, ahead(x)), "the other message")
    merge = {"Content-Type": "application/merge-patch+json"}
    assert http.patch(hold, content='{"linear": {"x": 5.0}}', headers=merge).status_code == 204
    driven.until(lambda: driven.on(DRIVE)[-1] == ahead(5.0), "the last")
    types = "https://w3id.org/rosld/types/geometry_msgs/msg"
    forward, straight = (f"[ v:x {x} ; v:y 0.0 ; v:z 0.0 ]" for x in (6.0, 0.0))
    given = f"@prefix t: <{types}/Twist#> . @prefix v: <{types}/Vector3#> . <#message> a <{types}/Twist> ; "
    given += f"t:linear {forward} ; t:angular {straight} ."
    changed = http.patch(hold, content=given, headers={"Content-Type": "text/turtle"})
    assert changed.status_code == 204, changed.text
    driven.until(lambda: driven.on(DRIVE)[-1] == ahead(6.0), "that of the Turtle")
    http.delete(hold)
    xs = [message["linear"]["x"] for message in driven.on(DRIVE)]
    assert xs[:-1] == sorted(xs[:-1])
    assert set(xs) == {1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 0.0}
    times = [at for at, *_ in driven.told[:-1]]
    assert all(at >= times[0] + (number - 1) / 50 for number, at in enumerate(times)), "one was published twice"


def test_deleting_a_hold_publishes_its_last_message_before_it_is_answered(driven: Driven, http: httpx.Client) -> None:
    hold = begun(http, lease=5)
    assert http.delete(hold).status_code == 204
    assert driven.on(DRIVE)[-1] == STILL
    count = len(driven.told)
    time.sleep(0.1)
    assert len(driven.told) == count
    assert http.delete(hold).status_code == 410
    assert http.patch(hold).status_code == 410
    http.delete(begun(http, NAMED, {"data": "go"}))  # which takes no velocity commands, so there is no final message
    assert {one["data"] for one in driven.on(NAMED)} == {"go"}


def test_the_rate_and_the_lease_can_be_changed_and_only_a_new_command_leaves_a_receipt(
    driven: Driven, http: httpx.Client
) -> None:
    hold = begun(http, rate=1, lease=0.5)
    assert http.patch(hold, params={"rate": 50, "lease": 2}).status_code == 204
    driven.until(lambda: len(driven.told) > 10, "the other rate")
    told = http.get(hold, headers=JSON).json()
    assert (told["rate"], told["lease"], told["topic"], told["holder"]) == (50.0, 2.0, DRIVE, "anybody")
    assert told["message"] == ahead(1.0)
    renewed, changed = http.patch(hold), http.patch(hold, json=ahead(2.0))
    assert (renewed.status_code, changed.status_code) == (204, 204)
    assert "has_provenance" not in renewed.headers.get("link", "")
    assert "has_provenance" in changed.headers["link"]


# The final message


def test_a_message_anywhere_on_the_server_can_be_the_last(driven: Driven, http: httpx.Client) -> None:
    text = (
        "<#message> a <https://w3id.org/rosld/types/std_msgs/msg/String> ; "
        '<https://w3id.org/rosld/types/std_msgs/msg/String#data> "park" .'
    )
    kept = http.put("/data/park", content=text, headers={"Content-Type": "text/turtle"})
    assert kept.status_code in (201, 204)
    for then in ("/data/park", f"{http.base_url}data/park", "/data/park#message"):
        hold = begun(http, NAMED, {"data": "go"}, then=then)
        http.put("/data/park", content=text.replace("park", "other"), headers={"Content-Type": "text/turtle"})
        http.delete(hold)
        assert driven.on(NAMED)[-1] == {"data": "park"}, "it is read when the hold begins"
        http.put("/data/park", content=text, headers={"Content-Type": "text/turtle"})


def test_what_cannot_be_held_is_refused_before_anything_moves(driven: Driven, http: httpx.Client) -> None:
    for then in ("/data/nothing", "http://elsewhere.example/x", "/topics/drive", "nonsense", "/a%ZZ"):
        answer = held(http, NAMED, {"data": "go"}, then=then)
        assert answer.status_code == 422
        assert then in answer.json()["detail"]
    assert not driven.told
    hold = begun(http, NAMED, {"data": "go"}, lease=5)
    queries: list[dict[str, Any]] = [{"rate": rate} for rate in (0, -1, 50.1, "NaN", "inf", "fast", "1e-300")]
    queries += [{"rate": 10, "lease": lease} for lease in (0, 5.1, "NaN")]
    queries += [{"rate": 10, "for": time} for time in ("NaN", 0, -3, 60.1, "1e300")]
    for query in (*queries, {"rate": 10, "for": 3, "lease": 1}):
        assert http.post(f"/topics{DRIVE}", params=query, json=ahead(1.0)).status_code == 400, query
        assert http.patch(hold, params=query).status_code == 400, query
    assert not driven.on(DRIVE)


def test_a_stamp_that_was_left_open_is_that_of_the_moment(driven: Driven, http: httpx.Client) -> None:
    header = {"seq": 0, "stamp": {"sec": 0, "nanosec": 0}, "frame_id": "base"}
    begin = time.time()
    http.delete(begun(http, STAMPED, {"header": header, "twist": ahead(1.0)}))
    first, *_, last = driven.on(STAMPED)
    for one in (first, last):
        assert begin - 1 <= one["header"]["stamp"]["sec"] <= time.time()
        assert one["header"]["frame_id"] == "base"
    assert (first["twist"], last["twist"]) == (ahead(1.0), STILL)
    fixed = {**header, "stamp": {"sec": 7, "nanosec": 0}}
    http.delete(begun(http, STAMPED, {"header": fixed, "twist": ahead(1.0)}))
    assert driven.on(STAMPED)[-2]["header"]["stamp"]["sec"] == 7


# Ownership


def test_while_a_topic_is_held_nothing_else_is_published_on_it(driven: Driven, http: httpx.Client) -> None:
    hold = begun(http, lease=5)
    for refused in (held(http), http.put(f"/topics{DRIVE}", json=ahead(9.0))):
        assert refused.status_code == 409
        assert (refused.json()["hold"], refused.json()["holder"]) == (hold, "anybody")
    assert begun(http, NAMED, {"data": "other"}) != hold
    x = "<https://w3id.org/rosld/types/geometry_msgs/msg/Vector3#x>"
    graph = f"GRAPH <{http.base_url}topics/drive>"
    old, new = f"{{ {graph} {{ ?v {x} ?old }} }}", f"{{ {graph} {{ ?v {x} 9e0 }} }}"
    update = f"DELETE {old} INSERT {new} WHERE {old}"
    assert http.post("/sparql", data={"update": update}).status_code == 409
    assert {json.dumps(one) for one in driven.on(DRIVE)} == {json.dumps(ahead(1.0))}


def test_holds_are_in_sparql_on_their_topic_and_in_its_stream(driven: Driven, http: httpx.Client) -> None:
    hold = begun(http, lease=5)
    query = (
        f"SELECT ?topic ?holder ?rate {{ ?topic <{ROS}heldBy> ?hold . ?hold <{ROS}holder> ?holder ; "
        f"<{ROS}publishRate> ?rate }}"
    )
    found = http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"}).text.splitlines()[1:]
    assert found == [f"{http.base_url}topics/drive,anybody,50.0"]
    assert says(http, f"/topics{DRIVE}", f"{ROS}heldBy") == [f"<{hold}>"]
    assert f"<{http.base_url}holds/>" in says(http, "/", "http://www.w3.org/ns/ldp#contains")
    with http.stream("GET", hold, headers={"Accept": "text/event-stream"}) as stream:
        lines = stream.iter_lines()
        assert next(line for line in lines if line.startswith("data: "))
        http.patch(hold, json=ahead(2.0))
        assert '"x":2.0' in next(line for line in lines if line.startswith("data: "))
        http.delete(hold)
        assert "event: gone" in list(lines)


def test_a_writable_topic_says_how_it_is_held_and_a_sensor_does_not(http: httpx.Client) -> None:
    assert "POST" in http.options(f"/topics{DRIVE}").headers["allow"]
    assert "POST" not in http.options(f"/topics{SENSOR}").headers["allow"]
    assert held(http, SENSOR, {"data": "x"}).status_code == 405
    affordance = "https://www.w3.org/2019/wot/td#hasActionAffordance"
    assert says(http, f"/topics{DRIVE}", affordance) == [f"<{http.base_url}topics/drive#hold>"]
    assert says(http, f"/resources{DRIVE}", affordance) == [f"<{http.base_url}resources/drive#hold>"]
    assert says(http, f"/topics{SENSOR}", affordance) == says(http, f"/resources{SENSOR}", affordance) == []
    assert set(says(http, f"/topics{DRIVE}", "https://w3id.org/rosld#uriTemplate")) == {
        f'"{http.base_url}topics/drive{{?rate,lease,for,then}}"'
    }
    described = http.get("/.well-known/wot").json()["actions"]["drive/hold"]
    assert [form["href"] for form in described["forms"]] == [f"{http.base_url}topics/drive{{?rate,lease,for,then}}"]
    assert set(described["uriVariables"]) == {"rate", "lease", "for", "then"}
    assert set(described["input"]["properties"]) == {"linear", "angular"}
    [shape] = says(http, f"/topics{DRIVE}", f"{ROS}requestShape")
    assert shape == f"<{http.base_url}shapes/geometry_msgs/msg/Twist>"
    assert any("DELETE ends it" in one for one in says(http, f"/topics{DRIVE}", "http://purl.org/dc/terms/description"))
    paths = inlined(http.get("/openapi.json").json())
    rate = next(one for one in paths["/topics/drive"]["post"]["parameters"] if one.get("name") == "rate")
    assert (rate.get("required", False), rate["schema"]["maximum"]) == (False, 50.0)
    rate = next(one for one in paths[f"/topics{NAMED}"]["post"]["parameters"] if one.get("name") == "rate")
    assert (rate["required"], rate["schema"]["maximum"]) == (True, 50.0)
    assert {"get", "patch", "delete"} <= paths["/holds/{id}"].keys()


# Refusals


def test_a_velocity_is_held_ten_times_a_second_unless_asked_otherwise_and_all_else_has_to_say(
    driven: Driven, http: httpx.Client
) -> None:
    refused = http.post(f"/topics{NAMED}", json={"data": "go"})
    assert refused.status_code == 400
    assert "?rate=10" in refused.json()["detail"]
    assert held(http, message={"linear": "fast"}).status_code == 422
    assert not driven.told
    answer = http.post(f"/topics{DRIVE}", json=ahead(1.0), headers=JSON)
    assert answer.status_code == 201, answer.text
    assert (answer.json()["rate"], answer.json()["lease"], answer.json()["then"]) == (10.0, 1.0, "zero")
    hold = answer.headers["location"]
    assert http.patch(hold, params={"lease": 5}).status_code == 204
    assert http.patch(hold, json={"linear": "fast"}).status_code == 422
    assert http.patch(hold, json=ahead(2.0), params={"then": "/data/nothing"}).status_code == 422
    assert http.patch(hold, content=b"x", headers={"Content-Type": "image/png"}).status_code == 415
    assert http.get(hold, headers=JSON).json()["message"] == ahead(1.0)


def test_limits_hold_for_what_is_held_what_it_is_changed_to_and_what_comes_last(
    driven: Driven, http: httpx.Client
) -> None:
    vector = "https://w3id.org/rosld/types/geometry_msgs/msg"
    limit = f"""@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix ros: <{ROS}> .
        <#slow> a sh:NodeShape ; sh:targetClass <{vector}/Twist> ; sh:property [
            sh:path <{vector}/Twist#linear> ; sh:property [
                sh:path <{vector}/Vector3#x> ; sh:minInclusive 0.5 ; sh:maxInclusive 1.5 ] ] ."""
    kept = http.put("/shapes/slow", content=limit, headers={"Content-Type": "text/turtle"})
    assert kept.status_code in (201, 204), kept.text
    try:
        assert http.put(f"/topics{DRIVE}", json=ahead(9.0)).status_code == 422
        assert held(http, message=ahead(9.0), then="none").status_code == 422
        assert held(http).status_code == 422, "to stand still is outside these limits"
        hold = begun(http, then="none", lease=5)
        assert http.patch(hold, json=ahead(9.0)).status_code == 422
        assert set(map(json.dumps, driven.on(DRIVE))) == {json.dumps(ahead(1.0))}
    finally:
        http.delete("/shapes/slow")


def test_a_robot_that_is_gone_is_told_of_and_the_hold_goes_on_when_it_is_back(
    driven: Driven, http: httpx.Client
) -> None:
    driven.is_gone = True
    assert held(http).status_code == 503
    driven.is_gone = False
    hold = begun(http, lease=5)
    driven.is_gone = True
    assert "gone" in until(lambda: http.get(hold, headers=JSON).json()["trouble"], "the trouble")
    count, driven.is_gone = len(driven.told), False
    driven.until(lambda: len(driven.told) > count, "it goes on")


def test_a_hold_ends_with_its_last_message_when_another_node_publishes_on_its_topic(
    driven: Driven, http: httpx.Client
) -> None:
    hold = begun(http, lease=5)
    other = begun(http, NAMED, {"data": "on"}, lease=5)
    driven.until(lambda: len(driven.on(DRIVE)) > 2, "messages")
    try:
        driven.topic(DRIVE, "geometry_msgs/msg/Twist", published=True, heard=True)
        driven.until(lambda: driven.on(DRIVE)[-1] == STILL, "the last message")
        until(lambda: http.get(hold).status_code == 410, "the hold is gone")
        assert "/drive is published by /robot" in http.get(hold).json()["detail"]
        assert held(http).status_code == 405
        assert http.get(other).status_code == 200
        assert driven.on(DRIVE).count(STILL) == 1
    finally:
        driven.topic(DRIVE, "geometry_msgs/msg/Twist", published=False, heard=True)
    assert held(http, lease=0.2).status_code == 201


def test_a_hold_goes_on_beside_a_permitted_publisher_and_while_its_only_subscriber_restarts() -> None:
    driven = Driven()
    with served(driven, allow_publish=(DRIVE,)) as http:
        hold = begun(http, lease=5)
        for published, heard in ((True, True), (False, False)):
            driven.topic(DRIVE, "geometry_msgs/msg/Twist", published=published, heard=heard)
            told = len(driven.told)
            driven.until(lambda told=told: len(driven.told) > told + 3, "further messages")
            assert http.get(hold).status_code == 200


def test_holds_that_begin_and_end_in_turn_publish_no_more_often_than_anything_else() -> None:
    driven, limit = Driven(), 20
    with served(driven, max_publish_rate=float(limit)) as http:
        started, answers = time.monotonic(), []
        while time.monotonic() - started < 0.5 or answers[-1].status_code == 201:
            answers.append(held(http, rate=1, lease=5))
            if answers[-1].status_code == 201:
                http.delete(answers[-1].headers["location"])
        seconds = time.monotonic() - started
        assert {answer.status_code for answer in answers} == {201, 429}
        assert "--max-publish-rate" in answers[-1].text
        assert len(driven.on(DRIVE)) <= limit + limit * seconds + 2
        assert int(answers[-1].headers["retry-after"]) >= 1
        assert driven.is_told(STILL), "the message that ends a hold is never refused"
    with served(driven, read_only=True) as http:
        assert held(http).status_code == 405
        assert http.get("/holds/").status_code == 200


def test_nothing_queues_up_while_the_robot_is_slow(driven: Driven, http: httpx.Client) -> None:
    hold = begun(http, lease=5)
    driven.seconds = 0.08
    count = len(driven.told)
    driven.until(lambda: len(driven.told) > count + 2, "slow messages")
    driven.max_at_once = 0
    http.patch(hold)
    driven.until(lambda: len(driven.told) > count + 5, "more of them")
    assert driven.max_at_once == 1
    driven.seconds = 0.0
    http.delete(hold)
    assert driven.on(DRIVE)[-1] == STILL


# End of a hold


KEEPER = """
import sys, httpx
with httpx.stream("GET", sys.argv[1], headers={"Accept": "text/event-stream"}, timeout=None) as stream:
    for line in stream.iter_lines():
        print(line, flush=True)
"""


def test_a_stream_keeps_a_hold_and_the_hold_ends_when_its_reader_is_killed(driven: Driven, http: httpx.Client) -> None:
    hold = begun(http, lease=5)
    keeper = subprocess.Popen([sys.executable, "-c", KEEPER, f"{hold}?keep=true"], stdout=subprocess.PIPE, text=True)
    try:
        assert keeper.stdout is not None
        assert any("data: " in line for line in keeper.stdout)
        assert http.patch(hold, params={"lease": 0.2}).status_code == 204
        time.sleep(0.5)
        assert http.get(hold, headers=JSON).json()["kept"]
        assert STILL not in driven.on(DRIVE)
    finally:
        keeper.kill()
        keeper.wait()
    driven.until(lambda: driven.on(DRIVE)[-1] == STILL, "standing still")
    assert "stream ended" in http.get(hold).text


def test_only_a_stream_that_asks_to_keep_a_hold_does_so_and_says_that_it_is_alive(
    driven: Driven, http: httpx.Client
) -> None:
    hold = begun(http, lease=0.4)
    with http.stream("GET", hold, headers={"Accept": "text/event-stream"}) as stream:
        assert "event: gone" in list(stream.iter_lines())
    assert driven.on(DRIVE)[-1] == STILL
    hold = begun(http, lease=0.8)
    with http.stream("GET", f"{hold}?keep=true", headers={"Accept": "text/event-stream"}) as stream:
        lines, began = stream.iter_lines(), time.monotonic()
        for _ in range(3):
            assert next(line for line in lines if line.startswith(":"))
        assert time.monotonic() - began < 5
    until(lambda: http.get(hold).status_code == 410, "the end of the hold")


def test_the_server_ends_its_holds_before_it_ends_also_with_a_request_under_way(driven: Driven) -> None:
    driven.told.clear()
    with httpx.Client() as other, served(driven) as http:
        request = other.build_request("GET", begun(http, lease=5), headers={"Accept": "text/event-stream"})
        lines = other.send(request, stream=True).iter_lines()
        next(line for line in lines if line.startswith("data: "))
        driven.until(lambda: len(driven.told) > 2, "messages")
    assert driven.on(DRIVE)[-1] == STILL
    assert driven.on(DRIVE).count(STILL) == 1
