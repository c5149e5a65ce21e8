"""`?until=`: a response as soon as a condition on the value holds, over HTTP, on the aircraft and on the rover."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any

import httpx
import pytest

from rosld.adapters.base import Watch
from rosld.adapters.model import Action, GoalEvent, GoalId, GoalStatus, TypeRef
from tests.server.conftest import Served
from tests.server.robots.made_up import ROBOT, MadeUp, Serving, served
from tests.server.test_events import streaming
from tests.waiting import until

SPEED = "/topics/aircraft/engine/speed"
NIGHT = "/parameters/cockpit/night"
JSON = "application/json"
LONG = {"timeout": "60"}
EVENTS = {"Accept": "text/event-stream"}


@pytest.fixture
def aside() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(4) as pool:
        yield pool


def wait(http: httpx.Client, path: str, condition: str, **more: str) -> httpx.Response:
    """Return the response to a request that waits for a condition."""
    query = {"until": condition, **LONG, **more}
    return http.get(path, params=query, headers={"Accept": JSON}, timeout=120)


def answered(waiting: Future[httpx.Response]) -> Any:
    """Return the value of a successful wait."""
    answer = waiting.result(timeout=120)
    assert answer.status_code == 200, answer.text
    return answer.json()


@pytest.mark.slow
def test_the_speed_of_the_aircraft_is_waited_for(own_aircraft: httpx.Client, aside: ThreadPoolExecutor) -> None:
    http = own_aircraft
    http.post("/services/aircraft/start", json={}).raise_for_status()
    topic = aside.submit(wait, http, SPEED, "data >= 300")
    resource = aside.submit(wait, http, "/resources/aircraft/engine/speed", "value >= 300")
    whole = aside.submit(wait, http, "/resources/aircraft/engine/", "speed > 299.5 and speed < 1000")
    http.post("/services/aircraft/engine/set_speed", json={"data": 300}).raise_for_status()
    assert answered(topic) == {"data": 300.0}
    assert answered(resource) == 300.0
    assert answered(whole)["speed"] > 299.5


def test_a_condition_that_holds_already_is_answered_at_once_and_an_unmet_one_with_204(aircraft: Served) -> None:
    http = aircraft.http
    http.put(NIGHT, json=False).raise_for_status()
    met = wait(http, NIGHT, "value = false")
    etag = http.get(NIGHT, headers={"Accept": JSON}).headers["etag"]
    assert (met.status_code, met.headers["etag"]) == (200, etag)
    unmet = wait(http, NIGHT, "value = true", timeout="0")
    assert (unmet.status_code, unmet.content, unmet.headers["etag"]) == (204, b"", etag)
    assert unmet.headers["content-location"] == str(http.base_url.join(NIGHT))
    assert {"content-type", "content-length"}.isdisjoint(unmet.headers)
    with streaming(aircraft, f"{NIGHT}?until=value%20=%20true&timeout=0.2") as told:
        first, end = told
    assert first.json is False
    assert (end.name, end.json) == ("until", False)


def test_with_after_another_state_is_waited_for(aircraft: Served, aside: ThreadPoolExecutor) -> None:
    http, path = aircraft.http, "/topics/cockpit/display"
    http.put(path, json={"data": "go"}).raise_for_status()
    known = http.get(path, headers={"Accept": JSON}).headers["etag"]
    assert wait(http, path, "data = 'go'", after=known, timeout="0").status_code == 204
    waiting = aside.submit(wait, http, path, "data = 'go'", after=known)
    http.put(path, json={"data": "stay"}).raise_for_status()
    http.put(path, json={"data": "go"}).raise_for_status()
    assert answered(waiting) == {"data": "go"}
    assert waiting.result().headers["etag"] != known


def test_parameters_calls_and_trees_are_waited_for(aircraft: Served, aside: ThreadPoolExecutor) -> None:
    http = aircraft.http
    one = aside.submit(wait, http, NIGHT, "value = true")
    tree = aside.submit(wait, http, "/parameters/", "cockpit.night = true")
    http.put(NIGHT, json=True).raise_for_status()
    try:
        assert answered(one) is True
        assert answered(tree)["cockpit"]["night"] is True
    finally:
        http.put(NIGHT, json=False).raise_for_status()
    call = http.post("/services/aircraft/get_power", json={}).headers["location"]
    answer = wait(http, call, "response.data = 'on' or response.data = 'off'").json()
    assert (answer["url"], answer["sentBy"], answer["state"]) == (call, "anybody", "Succeeded")
    assert answer["ended"]
    too_late = wait(http, call, "response.data = 'broken'")
    assert (too_late.status_code, too_late.json()["state"]) == (409, answer)


def test_the_end_of_a_goal_is_waited_for(serve: Callable[..., Served]) -> None:
    http = serve("rover:?rate=10").http
    far = {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 90.0, "y": 90.0}}}}
    sent = http.post("/actions/navigate_to", json=far)
    goal = sent.headers["location"]
    assert sent.status_code == 201
    missed = wait(http, goal, "status = 'succeeded'")  # waits until it is clear that there is none
    assert (missed.status_code, missed.json()["title"]) == (409, "Has ended")
    assert missed.json()["state"]["status"] == "aborted"
    ended = wait(http, goal, "status != 'accepted' and status != 'executing'").json()
    assert (ended["status"], ended["url"], ended["sentBy"]) == ("aborted", goal, "anybody")
    assert ended["ended"] == missed.json()["state"]["ended"]
    assert wait(http, goal, "result != null").status_code == 200
    stream = {"Accept": "text/event-stream"}
    assert http.get(goal, params={"until": "status = 'succeeded'"}, headers=stream).status_code == 409
    turtle = http.get(goal, params={"until": "status = 'succeeded'"}, headers={"Accept": "text/turtle"})
    assert turtle.status_code == 409
    [receipt] = [link for link in sent.headers["link"].split("<") if "/activity/" in link]
    triple = f"<{goal}> <http://www.w3.org/ns/prov#wasInformedBy> <{receipt.partition('>')[0]}> ."
    assert triple in http.get(goal, headers={"Accept": "application/n-triples"}).text
    near = {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 2.0, "y": 1.0}}}}
    again = http.post("/actions/navigate_to", json=near).headers["location"]
    with http.stream("GET", again, params={"until": "status = 'succeeded'"}, headers=stream) as streamed:
        lines = streamed.iter_lines()
        next(lines)
        http.delete(again).raise_for_status()
        told = [line for line in lines if line]
    problem = told[told.index("event: problem") + 1 :]
    assert json.loads("".join(line.removeprefix("data: ") for line in problem))["status"] == 409


class Mover(MadeUp):
    """A robot with an action whose result has no fields."""

    def __init__(self) -> None:
        super().__init__()
        self.strange(Action("/move_base", self._library.find(TypeRef("move_base_msgs/action/MoveBase")).ref, (ROBOT,)))

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        self.tell(GoalEvent(time.time_ns(), GoalStatus.EXECUTING, goal=goal, own=True))
        return GoalId(action, "1")

    async def follow_goals(self, action: str, *, deadline: float) -> Watch:
        return ExitStack()

    def tell(self, event: GoalEvent) -> None:
        """Report an event of the goal."""
        assert self._sink is not None
        self._sink.goal_changed(GoalId("/move_base", "1"), event)


def test_a_result_without_fields_is_waited_for(aside: ThreadPoolExecutor) -> None:
    robot = Mover()
    with served(robot) as http:
        goal = http.post("/actions/move_base", json={}).headers["location"]
        waiting = aside.submit(wait, http, goal, "result != null")
        robot.tell(GoalEvent(time.time_ns(), GoalStatus.SUCCEEDED))
        ended = wait(http, goal, "status = 'succeeded'").json()
        assert ended["result"] is None
        robot.tell(GoalEvent(time.time_ns(), result=b""))
        assert answered(waiting) == ended | {"result": {}}
        assert wait(http, goal, "result = null").status_code == 409


def test_a_condition_that_can_never_hold_is_refused_at_once(aircraft: Served) -> None:
    http = aircraft.http
    wait(http, SPEED, "data >= 0")
    for path, condition, words in (
        (SPEED, "dta >= 300", "there is no dta: there are data"),
        (SPEED, "data >= ", "a number"),
        (SPEED, "data = 'fast'", "data is a number"),
        ("/resources/aircraft/", "engine > 3", "there is no engine: there are power"),
        (NIGHT, "night = true", "there are value"),
        ("/topics/", "data = 3", "?after="),
    ):
        for accept in (JSON, "text/event-stream"):
            answer = http.get(path, params={"until": condition, **LONG}, headers={"Accept": accept})
            assert (answer.status_code, words in answer.json()["detail"]) == (400, True), answer.text


def test_a_field_is_judged_once_there_is_a_message(robot: MadeUp, serving: Serving, aside: ThreadPoolExecutor) -> None:
    robot.topic("/late", "std_msgs/msg/Float64")
    http = serving()
    wrong, right = (
        aside.submit(wait, http, "/topics/late", "dta > 3"),
        aside.submit(wait, http, "/topics/late", "data > 3"),
    )
    robot.publishes("/late", {"data": 4.0})
    assert answered(right) == {"data": 4.0}
    assert wrong.result().status_code == 400


@pytest.mark.slow
def test_a_stream_ends_with_the_state_that_meets_its_condition(serve: Callable[..., Served]) -> None:
    served = serve("aircraft")
    with streaming(served, f"{SPEED}?until=data%20%3E=%20300&rate=1") as told:
        assert next(told).json == {"data": 0.0}
        served.http.post("/services/aircraft/start", json={}).raise_for_status()
        served.http.post("/services/aircraft/engine/set_speed", json={"data": 300}).raise_for_status()
        *_, last, end = told
    assert last.json == {"data": 300.0}
    assert (end.name, end.json) == ("until", True)


def streams(http: httpx.Client, stack: ExitStack, number: int) -> list[httpx.Response]:
    return [stack.enter_context(http.stream("GET", SPEED, headers=EVENTS)) for _ in range(number)]


def test_one_stream_more_than_an_address_may_have_is_429_until_another_ends(serve: Callable[..., Served]) -> None:
    http = serve("aircraft", "--setting", "client_streams", "3").http
    with ExitStack() as stack:
        assert {one.status_code for one in streams(http, stack, 3)} == {200}
        refused = http.get(SPEED, headers=EVENTS)
        assert refused.status_code == 429
        assert "client_streams" in refused.json()["detail"]
        assert int(refused.headers["retry-after"]) > 0

        def waiting() -> int:
            """Return the response to a wait for a changed state; the topic changes ten times per second."""
            etag = json.dumps(http.get(SPEED).headers["etag"].strip('"'))
            return http.get(SPEED, params={"after": etag, "timeout": "0.01"}).status_code

        until(lambda: waiting() == 429, "that one who waits is one too many")
        assert http.get(SPEED).status_code == 200
        assert http.post("/stop").status_code == 200
    until(lambda: waiting() != 429, "room")
