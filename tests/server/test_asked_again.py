"""Repeated requests: caches never return an earlier state."""

from __future__ import annotations

import re
import time
from collections.abc import Callable

import httpx
import pytest

from tests.server.robots import asking
from tests.server.robots.made_up import MadeUp, Serving
from tests.waiting import until

pytestmark = pytest.mark.slow

PLACE = "geometry_msgs/msg/Vector3"
CLASS = f"{asking.TYPES}{PLACE}"
CSV = {"Accept": "text/csv"}


def query(http: httpx.Client, text: str, how: str = "GET") -> str:
    if how == "GET":
        answer = http.get("/sparql", params={"query": text}, headers=CSV)
    else:
        answer = http.post("/sparql", content=text, headers={"Content-Type": "application/sparql-query", **CSV})
    assert answer.status_code == 200, answer.text
    return answer.text


def place(number: float) -> dict[str, float]:
    return {"x": number, "y": 0, "z": 0}


VALUE = f"PREFIX v: <{CLASS}#> SELECT ?x {{ ?t ros:latest ?m . ?m v:x ?x }}"
WAYS: dict[str, Callable[[httpx.Client], str]] = {
    "topic": lambda http: http.get("/topics/place").text,
    "topic as JSON": lambda http: http.get("/topics/place", headers=asking.JSON).text,
    "graph of a topic": lambda http: http.get("/graphs", params={"graph": f"{http.base_url}topics/place"}).text,
    "query of a class": lambda http: query(http, VALUE),
    "posted query": lambda http: query(http, VALUE, "POST"),
    "query of a topic": lambda http: query(http, f"SELECT ?o {{ <topics/place#message> <{CLASS}#x> ?o }}"),
    "resource": lambda http: http.get("/resources/").text,
    "member": lambda http: http.get("/resources/place").text,
}


def test_what_a_topic_says_is_never_what_it_said_before(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/place", PLACE, place(0))
    http = serving()
    for number in range(77001, 77008):
        robot.publishes("/place", place(number))
        said = {way: [re.findall(r"\b77\d{3}\b", ask(http)) for _ in range(3)] for way, ask in WAYS.items()}
        assert said == dict.fromkeys(WAYS, [[str(number)]] * 3)


def test_getters_are_called_again_once_what_they_said_is_no_longer_fresh(robot: MadeUp, serving: Serving) -> None:
    grip = robot.variable("/arm/grip", "Byte", value=1)
    http = serving(freshness=0.05)
    for number in range(2, 6):
        grip["value"] = number
        time.sleep(0.06)  # nothing reports by itself that it has changed
        for path in ("/resources/arm/grip", "/resources/arm/"):
            assert [f"{number}" in http.get(path, headers=asking.JSON).text for _ in range(5)] == [True] * 5
    assert http.put("/resources/arm/grip", json=9).status_code == 204
    assert http.get("/resources/arm/grip", headers=asking.JSON).json() == 9


def test_a_mapping_counts_from_when_it_is_in_force(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    http = serving()
    text = f"SELECT ?x {{ ?arm <{asking.EX}force> ?x }}"
    assert [query(http, text) for _ in range(3)] == ["x\r\n"] * 3
    asking.mapped(
        http,
        '<#a> a map:ComplexResource ; map:path "/arm/" ; '
        'map:property [ map:predicate ex:force ; map:member "grip" ; map:name "force" ] .',
    )
    assert [query(http, text) for _ in range(3)] == ["x\r\n1\r\n"] * 3
    assert [http.get("/resources/arm/", headers=asking.JSON).json() for _ in range(3)] == [{"force": 1}] * 3
    assert http.delete("/mappings/mine").status_code == 204
    assert [query(http, text) for _ in range(3)] == ["x\r\n"] * 3


def test_a_state_that_has_not_changed_is_304_and_its_age_and_date_go_on(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/place", PLACE, place(1))
    http = serving()
    known = {"If-None-Match": http.get("/topics/place").headers["etag"]}
    ages, dates = set[str](), set[str]()

    def is_older() -> bool:
        assert http.get("/topics/place", headers=known).status_code == 304
        answer = http.get("/topics/place")
        ages.add(answer.headers["age"])
        dates.add(answer.headers["date"])
        return len(ages) >= 2 and len(dates) >= 2

    until(is_older, "another second")
    robot.publishes("/place", place(2))
    assert http.get("/topics/place", headers=known).status_code == 200


def test_a_subscription_lasts_while_somebody_asks_the_same_again(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/place", PLACE, place(1))
    http = serving(idle_time=0.2)
    end = time.monotonic() + 0.6
    while time.monotonic() < end:
        http.get("/topics/place")
        assert "/place" in robot.subscribed()
        time.sleep(0.02)


def test_queries_whose_answers_differ_each_time_are_asked_each_time(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/place", PLACE, place(1))
    http = serving()
    for expression in ("RAND()", "NOW()", "UUID()", "ros:age(<topics/place>)"):
        answers = {query(http, f"SELECT ({expression} AS ?x) {{ <topics/place> ros:latest ?m }}") for _ in range(4)}
        assert len(answers) == 4
