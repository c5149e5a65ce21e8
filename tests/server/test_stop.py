"""The stop: after one request nothing moves the robot any more, however busy the server is."""

from __future__ import annotations

import asyncio
import json
import re
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest

from rosld.adapters import aircraft
from rosld.adapters.base import AdapterOptions, Published
from rosld.adapters.model import GoalEvent, GoalId, GoalStatus, Refused, TypeRef
from tests.server.robots.asking import mapped
from tests.server.robots.made_up import MadeUp, served
from tests.stopping import release, shown_id
from tests.waiting import until

JSON = {"Accept": "application/json"}
TWIST = "https://w3id.org/rosld/types/geometry_msgs/msg/Twist"
TURTLE = {"Content-Type": "text/turtle"}
ROS = "https://w3id.org/rosld#"
MAPPING = """@prefix map: <https://w3id.org/rosld/mapping#> .
<#arm> a map:ComplexResource ; map:path "/arm/" ;
  map:stop [ map:call "brake" ; map:content "{\\"azimuth\\": 1.5, \\"elevation\\": 0}" ] ,
           [ map:publish "/drive" ] , [ map:call "/nowhere" ] ."""


AHEAD = {"linear": {"x": 1, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}


STILL = {"linear": {"x": 0.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}


class Stoppable(MadeUp):
    """A robot with everything that moves it; publishing on `/slow` waits until it is released."""

    def __init__(self) -> None:
        super().__init__()
        self.let_go = asyncio.Event()
        self.waiting = threading.Event()
        self.braked: list[float] = []
        self.offer("/arm/brake", "made_up/srv/Aim", self._brake)
        self.offer("/arm/aim", "made_up/srv/Aim", lambda _: {"hit": True})
        self.variable("/arm/label", "Words", words="x")
        self.topic("/drive", "geometry_msgs/msg/Twist", published=False, heard=True)
        self.topic("/slow", "std_msgs/msg/String", published=False, heard=True)
        self.parameter("/gain", 1)

    def _brake(self, request: dict[str, Any]) -> dict[str, Any]:
        self.braked.append(time.monotonic())
        assert request == {"azimuth": 1.5, "elevation": 0.0}
        return {"hit": True}

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        if topic == "/slow":
            self.waiting.set()
            await self.let_go.wait()
        return await super().publish(topic, type, data, latch=latch, deadline=deadline)

    def moved(self) -> tuple[object, ...]:
        """Return all commands received, except those that stop it."""
        calls = {name: count for name, count in self.calls.items() if name not in ("/arm/brake", "/arm/get_label")}
        sent = {name: [each for each in messages if each != STILL] for name, messages in self.sent.items()}
        return json.dumps(sent), calls, len(self.sets)


@pytest.fixture
def robot() -> Stoppable:
    return Stoppable()


@pytest.fixture
def http(robot: Stoppable) -> Iterator[httpx.Client]:
    with served(robot) as client:
        assert client.put("/mappings/arm", content=MAPPING, headers=TURTLE).status_code == 201
        yield client


OLD = "{ GRAPH </parameters/gain> { ?p ros:value ?v } }"
UPDATE = f"DELETE {OLD} INSERT {{ GRAPH </parameters/gain> {{ ?p ros:value 3 }} }} WHERE {OLD}"
WRITES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("PUT", "/topics/drive", {"json": AHEAD}),
    ("POST", "/topics/drive", {"json": AHEAD, "params": {"rate": 10}}),
    ("POST", "/services/arm/aim", {"json": {"azimuth": 1, "elevation": 1}}),
    ("PUT", "/parameters/gain", {"json": 2}),
    ("POST", "/sparql", {"data": {"update": UPDATE}}),
    ("DELETE", "/parameters/gain", {}),
    ("PUT", "/resources/arm/label", {"json": "moved"}),
)


def stopped(http: httpx.Client, **body: str) -> dict[str, Any]:
    answer = http.post("/stop", json=body, headers=JSON)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


@pytest.mark.slow
def test_every_write_that_would_reach_the_robot_is_refused_until_it_is_released(
    robot: Stoppable, http: httpx.Client
) -> None:
    stopped(http, reason="a person on the track")
    before = robot.moved()
    for method, path, content in WRITES:
        answer = http.request(method, path, **content)
        assert answer.status_code == 423, (method, path, answer.text)
        told = answer.json()
        assert "The robot was stopped at 2" in told["detail"]
        assert "track" not in told["detail"] + told["title"], "words of others are no part of the server's"
        said = told["graphs"][0] if "graphs" in told else told
        assert (said["stoppedBy"], said["agentSaid"]) == ("anybody", "a person on the track")
    assert robot.moved() == before
    assert http.put("/data/x", content="<> <p> 1 .", headers=TURTLE).status_code == 201
    assert http.get("/resources/arm/label", headers=JSON).json() == "x", "reading goes on, by getters too"
    assert release(http).status_code == 204
    for method, path, content in WRITES:
        assert http.request(method, path, **content).status_code < 300, (method, path)


@pytest.mark.slow
def test_each_stop_does_what_mappings_say_and_reports_each_step(robot: Stoppable, http: httpx.Client) -> None:
    planned = {step["does"]: step["state"] for step in http.get("/stop", headers=JSON).json()["steps"]}
    assert len(planned) == 4
    assert set(planned.values()) == {"NotSent"}
    told = stopped(http)
    steps = {step["does"].split(" with ")[0]: step for step in told["steps"]}
    assert (told["stopped"], told["by"], told["reason"]) == (True, "anybody", None)
    assert steps["call /arm/brake"]["state"] == "Succeeded"
    assert (steps["publish on /drive"]["state"], steps["publish on /drive"]["subscribers"]) == ("Succeeded", 1)
    assert steps["call /nowhere"]["state"] == "Failed"
    assert "/nowhere" in steps["call /nowhere"]["words"]
    assert len(robot.braked) == 1
    assert robot.sent["/drive"][-1]["linear"] == {"x": 0.0, "y": 0.0, "z": 0.0}
    again = stopped(http, reason="second")
    assert (again["reason"], again["since"], len(robot.braked)) == (None, told["since"], 2)
    assert [release(http).status_code for _ in range(2)] == [204, 204], "releasing twice is fine"
    assert http.get("/stop", headers=JSON).json()["stopped"] is False


@pytest.mark.slow
def test_a_service_that_refuses_has_failed_unless_it_is_at_rest(robot: Stoppable, http: httpx.Client) -> None:
    robot.offer("/arm/fold", "std_srvs/srv/Trigger", lambda _: {"success": False, "message": "the arm is off"})
    mapping = """@prefix map: <https://w3id.org/rosld/mapping#> . @prefix sh: <http://www.w3.org/ns/shacl#> .
        <#arm> a map:ComplexResource ; map:path "/arm/" ; map:stop [ map:call "/arm/fold" ; map:atRestWhen <#off> ] .
        <#off> a sh:NodeShape ; map:about "/arm/label" ; sh:property [
          sh:path <http://www.w3.org/1999/02/22-rdf-syntax-ns#value> ; sh:hasValue "off" ] ."""
    assert http.put("/mappings/arm", content=mapping, headers=TURTLE).status_code == 204
    for label, state, words in (("on", "Failed", "the arm is off"), ("off", "Succeeded", "it is already at rest")):
        assert http.put("/resources/arm/label", json=label).status_code == 204
        told = stopped(http)
        step = told["steps"][-1]
        assert (step["does"], step["state"], step["words"][: len(words)]) == ("call /arm/fold", state, words)
        assert told["warning"] is None if state == "Succeeded" else "1 of 2 steps to stop it failed" in told["warning"]
        assert release(http).status_code == 204


@pytest.mark.slow
def test_a_stop_ends_holds_and_only_zero_follows(robot: Stoppable, http: httpx.Client) -> None:
    for then in ("zero", "none", "/data/creep"):
        creep = "".join(f"<#message> <{TWIST}#{part}> <#message.{part}> . " for part in ("linear", "angular"))
        creep += "".join(
            f"<#message.{part}> <https://w3id.org/rosld/types/geometry_msgs/msg/Vector3#{axis}> 0.5 . "
            for part in ("linear", "angular")
            for axis in "xyz"
        )
        http.put("/data/creep", content=f"<#message> a <{TWIST}> . {creep}", headers=TURTLE).raise_for_status()
        answer = http.post("/topics/drive", params={"rate": 50, "lease": 5, "then": then}, json=AHEAD)
        assert answer.status_code == 201, answer.text
        hold = answer.headers["location"]
        robot.sent["/drive"].clear()
        stopped(http)
        assert http.get(hold).status_code == 410
        assert "The robot was stopped at" in http.get(hold).text
        until(lambda: robot.sent["/drive"].count(STILL) >= 15, "zero, again and again")
        after = robot.sent["/drive"][robot.sent["/drive"].index(STILL) :]
        assert all(message == STILL for message in after), then
        assert release(http).status_code == 204


@pytest.mark.slow
def test_a_stop_cuts_off_writes_under_way(robot: Stoppable, http: httpx.Client) -> None:
    robot.hold("/arm/aim")
    with ThreadPoolExecutor(3) as pool:
        other = [httpx.Client(base_url=http.base_url, timeout=20) for _ in range(2)]
        slow = pool.submit(other[0].put, "/topics/slow", json={"data": "late"})
        call = pool.submit(other[1].post, "/services/arm/aim", json={"azimuth": 1, "elevation": 1})
        assert robot.waiting.wait(60)
        robot.until(lambda: robot.calls["/arm/aim"] == 1)
        stopped(http)
        assert slow.result(10).status_code == 423
        assert "may have been carried out" in slow.result().json()["detail"]
        assert call.result(10).status_code == 423
        assert call.result().json()["state"] == "OutcomeUnknown"
    robot.run(robot.let_go.set)
    robot.release("/arm/aim")
    time.sleep(0.05)
    assert "/slow" not in robot.sent


@pytest.mark.slow
def test_a_stop_action_that_hangs_delays_nobody(robot: Stoppable) -> None:
    with served(robot, call_deadline=0.5) as http:
        assert http.put("/mappings/arm", content=MAPPING, headers=TURTLE).status_code == 201
        robot.hold("/arm/brake")
        with ThreadPoolExecutor(1) as pool:
            other = httpx.Client(base_url=http.base_url, timeout=20)
            stopping = pool.submit(other.post, "/stop", headers=JSON)
            robot.until(lambda: robot.calls["/arm/brake"] == 1)
            assert http.put("/parameters/gain", json=2).status_code == 423
            assert release(http).status_code == 409, "it is still being stopped"
            [brake] = [one for one in stopping.result(20).json()["steps"] if "/arm/brake" in one["does"]]
        assert brake["state"] in ("Running", "Failed")


@pytest.mark.slow
def test_without_tokens_a_release_takes_what_a_person_sees_on_the_page(robot: Stoppable, http: httpx.Client) -> None:
    stopped(http, reason="a person on the track")
    refused = http.put("/parameters/gain", json=2)
    assert refused.status_code == 423
    assert "DELETE" not in refused.text
    assert "A person can release the stop at" in refused.json()["detail"]
    unconfirmed = http.delete("/stop")
    assert unconfirmed.status_code == 428
    assert f"{http.base_url}stop" in unconfirmed.json()["detail"]
    assert http.delete("/stop?confirm=guess").status_code == 409
    id = http.get("/stop", headers={"Accept": "text/html"}).text.split('name="?confirm" value="')[1].split('"')[0]
    for accept in ("application/json", "text/turtle", "application/ld+json"):
        assert id not in http.get("/stop", headers={"Accept": accept}).text
    assert id not in refused.text + unconfirmed.text
    assert http.get("/stop", headers=JSON).json()["stopped"] is True
    released = http.delete("/stop", params={"confirm": id})
    assert released.status_code == 204
    stopped(http)
    assert http.delete("/stop", params={"confirm": id}).status_code == 409, "it was the id of another stop"


@pytest.mark.slow
def test_a_body_that_is_no_reason_is_refused_and_an_empty_one_stops(http: httpx.Client) -> None:
    for body in (b"[]", b'{"reason": 1}', b'{"other": "x"}', b'{"reason": "%s"}' % (b"x" * 501)):
        refused = http.post("/stop", content=body, headers={"Content-Type": "application/json"})
        assert refused.status_code == 422, body
        assert http.get("/stop", headers=JSON).json()["stopped"] is False
    assert http.post("/stop").status_code == 200


@pytest.mark.slow
def test_every_page_has_a_button_that_stops_without_a_script_and_says_when_it_is_stopped(http: httpx.Client) -> None:
    html = {"Accept": "text/html"}
    pages = ("/", "/topics/drive", "/sparql", "/nothing", "/stop")
    for page in pages:
        text = http.get(page, headers=html).text
        assert '<form class="stop" method="post" action="/stop"' in text, page
        assert "Nothing is written to it until" not in text, page
    form = text.split('<form class="stop"')[1].split("</form>")[0]
    token = form.split('name="csrf" value="')[1].split('"')[0]
    fields = {"csrf": token, "method": "POST"}
    forged = http.post("/stop", data={**fields, "csrf": "forged"}, headers=html)
    assert forged.status_code == 403
    pressed = http.post("/stop", data=fields, headers=html)
    assert pressed.status_code == 303
    assert pressed.headers["location"].startswith(f"{http.base_url}stop?receipt=")
    for page in pages:
        assert "Nothing is written to it until" in http.get(page, headers=html).text, page
    shown = http.get("/stop", headers=html).text
    assert "Release" in shown
    id = shown.split('name="?confirm" value="')[1].split('"')[0]
    assert http.post("/stop", data={**fields, "method": "DELETE"}, headers=html).status_code == 428
    assert http.post("/stop", data={**fields, "method": "DELETE", "?confirm": id}, headers=html).status_code == 303
    assert "Nothing is written to it until" not in http.get("/topics/drive", headers=html).text


@pytest.mark.slow
def test_a_stop_is_streamed_on_open_pages_too_and_is_in_sparql(http: httpx.Client) -> None:
    stream = {"Accept": "text/event-stream"}
    with (
        http.stream("GET", "/stop", headers=stream) as stop,
        http.stream("GET", "/parameters/gain", params={"format": "html"}, headers=stream) as page,
        http.stream("GET", "/parameters/gain", params={"format": "json"}, headers=stream) as values,
        httpx.Client(base_url=http.base_url) as other,
    ):
        states, pages, told = events(stop), events(page), events(values)
        assert '"stopped":false' in next(states)
        assert "a person on the track" not in next(pages)
        assert next(told) == "1"
        stopped(other, reason="a person on the track")
        assert '"reason":"a person on the track"' in next(states)
        assert "a person on the track" in next(pages)
        query = f"SELECT ?who ?why {{ ?stop <{ROS}stoppedBy> ?who ; <{ROS}reason> ?why }}"
        found = other.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"}).text.splitlines()
        assert found[1:] == ["anybody,a person on the track"]
        assert release(other).status_code == 204
        assert any("a person on the track" not in page for page in pages)
        assert other.put("/parameters/gain", json=2).status_code == 204
        assert next(told) == "2", "values are not sent twice"


def events(stream: httpx.Response) -> Iterator[str]:
    """Yield the content of each event of a stream."""
    said: list[str] = []
    for line in stream.iter_lines():
        if line.startswith("data: "):
            said.append(line.removeprefix("data: "))
        elif not line and said:
            yield "\n".join(said)
            said.clear()


@pytest.mark.slow
def test_a_stop_is_released_by_the_form_of_a_thing_description_and_by_that_of_its_rdf(http: httpx.Client) -> None:
    action = http.get("/.well-known/wot").json()["actions"]["stopRobot"]
    [variable] = action["uriVariables"]
    invoke, _, cancel = action["forms"]
    assert http.request(invoke["htv:methodName"], invoke["href"]).status_code == 200
    told = http.get("/stop", headers={"Accept": "application/n-triples"}).text
    assert re.findall(r'/stop#stop/delete> <[^>]+#uriTemplate> "([^"]+)"', told) == [cancel["href"]]
    url = cancel["href"].split(f"{{?{variable}}}")[0]
    assert http.request(cancel["htv:methodName"], url).status_code == 428
    assert http.request(cancel["htv:methodName"], url, params={variable: shown_id(http)}).status_code == 204
    assert http.get("/stop", headers=JSON).json()["stopped"] is False


def test_a_server_that_is_read_only_tells_the_robot_nothing_not_even_to_stop(robot: Stoppable) -> None:
    with served(robot, read_only=True) as http:
        assert http.post("/stop").status_code == 405
        assert "read-only" in http.post("/stop").text
        assert http.get("/stop", headers=JSON).json()["stopped"] is False
        assert '<form class="stop"' not in http.get("/", headers={"Accept": "text/html"}).text
        assert "stopRobot" not in http.get("/.well-known/wot").json()["actions"]


def test_the_aircraft_is_stopped_while_it_is_off_and_while_it_flies(own_aircraft: httpx.Client) -> None:
    http = own_aircraft
    told = stopped(http)
    assert (told["warning"], {step["state"] for step in told["steps"]}) == (None, {"Succeeded"})
    page = http.get("/stop", headers={"Accept": "text/html"}).text
    assert 'class="notice error stopped"' in page
    assert "is already at rest: the aircraft is off" in page
    assert "may still be moving" not in page
    assert release(http).status_code == 204
    assert http.post("/services/aircraft/start", json={}).status_code == 201
    goal = http.post("/actions/aircraft/fly", json={"distance": 5000.0}).headers["location"]
    assert http.put("/resources/aircraft/engine/speed", json=300).status_code < 300
    told = stopped(http, reason="enough")
    assert {step["state"] for step in told["steps"]} == {"Succeeded"}, told
    assert any("cancel the goal" in step["does"] for step in told["steps"])
    with http.stream("GET", goal, headers={"Accept": "text/event-stream"}) as stream:
        assert any('"status":"canceled"' in line for line in stream.iter_lines() if line.startswith("data: "))
    assert http.get("/topics/cockpit/display", headers=JSON).json() == {"data": "stopped"}
    assert http.post("/actions/aircraft/fly", json={"distance": 1.0}).status_code == 423
    assert http.post("/resources/aircraft/start").status_code in (409, 423)


class EndsMeanwhile:
    """The aircraft, whose action server refuses to cancel; `ends` determines whether the goal has just ended."""

    def __init__(self, *, ends: bool) -> None:
        self._inner: Any = aircraft.adapter("aircraft", AdapterOptions())
        self._ends = ends
        self._goal = GoalId("/aircraft/fly", "")
        self._sink: Any = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    async def open(self, sink: Any, *, deadline: float) -> None:
        self._sink = sink
        await self._inner.open(sink, deadline=deadline)

    async def send_goal(self, *arguments: Any, **named: Any) -> GoalId:
        self._goal = await self._inner.send_goal(*arguments, **named)
        return self._goal

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        if self._ends:  # as a server does: its status follows its refusal
            aborted = GoalEvent(time.time_ns(), GoalStatus.ABORTED, own=True)
            asyncio.get_running_loop().call_later(0.05, self._sink.goal_changed, goal, aborted)
        raise Refused("the goal is not canceled: the server refuses to cancel it")

    async def cancel_goals(self, action: str, *, deadline: float) -> None:
        await self.cancel_goal(self._goal, deadline=deadline)


@pytest.mark.slow
def test_a_goal_that_ends_before_it_is_canceled_leaves_nothing_moving() -> None:
    for whose, ends in (("own", True), ("others", False)):
        with served(EndsMeanwhile(ends=ends), stop_cancels=whose) as http:  # type: ignore[arg-type]
            assert http.post("/services/aircraft/start", json={}).status_code == 201
            assert http.post("/actions/aircraft/fly", json={"distance": 5000.0}).status_code == 201
            told = stopped(http)
            [step] = [each for each in told["steps"] if each["does"].startswith("cancel")]
            assert (step["state"], told["warning"] is None) == (("Succeeded", True) if ends else ("Failed", False)), (
                told
            )


@pytest.mark.slow
def test_the_robot_is_stopped_while_queries_and_slow_calls_saturate_the_server(
    robot: Stoppable, http: httpx.Client
) -> None:
    robot.hold("/arm/aim")
    over = threading.Event()
    heavy = "SELECT (COUNT(*) AS ?n) { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i }"

    def run(method: str, path: str, **sent: Any) -> None:
        with httpx.Client(base_url=http.base_url, timeout=60) as client:
            client.request(method, path, **sent)
            while method == "GET" and not over.is_set():
                client.request(method, path, **sent)

    with ThreadPoolExecutor(40) as pool:
        for _ in range(8):
            pool.submit(run, "GET", "/sparql", params={"query": heavy, "timeout": 1})
            pool.submit(run, "GET", "/topics/drive")
        for _ in range(16):
            pool.submit(run, "POST", "/services/arm/aim", json={"azimuth": 1, "elevation": 1})
        robot.until(lambda: robot.calls["/arm/aim"] == 16)
        try:
            assert stopped(http)["stopped"]
            assert robot.braked, "while all others still wait"
        finally:
            over.set()
            robot.release("/arm/aim")


@pytest.mark.slow
def test_a_step_is_named_by_its_effect_so_that_no_number_reveals_hidden_ones() -> None:
    def steps(stops: str) -> set[str]:
        with served(Stoppable()) as http:
            mapped(http, f'<#arm> a map:ComplexResource ; map:path "/arm/" ; map:stop {stops} .')
            query = f"SELECT ?step {{ ?stop ros:stopStep ?step . ?step ros:touches <{http.base_url}topics/drive> }}"
            answer = http.get("/sparql", params={"query": query}, headers=JSON).json()
            return {row["step"]["value"].partition("#")[2] for row in answer["results"]["bindings"]}

    alone, last = steps('[ map:publish "/drive" ]'), steps('[ map:call "brake" ] , [ map:publish "/drive" ]')
    assert len(alone) == 2, "zero, and what the mapping says"
    assert alone == last
