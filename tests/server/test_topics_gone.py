"""A topic without nodes is removed from every representation, until a node has it again."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from tests.server.robots.made_up import MadeUp, served
from tests.waiting import until

NAME, OTHER = "/chatter", "/other"
TOPIC = "/topics/chatter"
STRING = "std_msgs/msg/String"
ACCEPTED = ["text/turtle", "application/json", "application/ld+json", "text/html", "application/n-quads"]


@pytest.fixture
def robot() -> MadeUp:
    """A robot with two topics."""
    made = MadeUp()
    made.topic(NAME, STRING, {"data": "x"})
    made.topic(OTHER, STRING, {"data": "y"})
    return made


@pytest.fixture
def http(robot: MadeUp) -> Iterator[httpx.Client]:
    """A client that has read the topic before it was removed."""
    with served(robot) as client:
        for accept in ACCEPTED:
            assert client.get(TOPIC, headers={"Accept": accept}).status_code == 200
        assert client.get(TOPIC, params={"field": "data"}).text == "x"
        robot.forget(NAME)
        yield client


def asks(http: httpx.Client, pattern: str) -> bool:
    answer = http.get("/sparql", params={"query": f"ASK {{ {pattern} }}"}, headers={"Accept": "application/json"})
    assert answer.status_code == 200, answer.text
    return bool(answer.json()["boolean"])


def test_it_is_gone_in_every_representation_listing_and_graph(http: httpx.Client) -> None:
    for accept in (*ACCEPTED, "text/event-stream"):
        for method in ("GET", "HEAD"):
            assert http.request(method, TOPIC, headers={"Accept": accept}).status_code == 404, accept
    assert http.get(TOPIC, params={"field": "data"}).status_code == 404
    assert "chatter" not in http.get("/topics/", headers={"Accept": "text/turtle"}).text
    assert not asks(http, f"GRAPH <{http.base_url.join(TOPIC)}> {{ ?s ?p ?o }}")
    assert not asks(http, f"<{http.base_url.join(TOPIC)}> ?p ?o")
    assert asks(http, f"GRAPH <{http.base_url.join('/topics/other')}> {{ ?s ?p ?o }}")
    assert http.options(TOPIC).headers["allow"] == "OPTIONS"
    assert http.put(TOPIC, json={"data": "z"}).status_code == 405
    assert http.patch(TOPIC, json={"data": "z"}, headers={"If-Match": '"x"'}).status_code == 405


@pytest.mark.slow
def test_once_a_node_has_it_again_it_is_read_as_a_new_one(robot: MadeUp) -> None:
    slot = robot.slot(NAME)
    with served(robot, first_value_wait=0.1) as http:
        assert http.get(TOPIC, headers={"Accept": "application/json"}).json() == {"data": "x"}
        robot.forget(NAME)
        until(lambda: not slot.subscriptions, "it is not subscribed to any more")
        robot.topic(NAME, STRING)
        assert http.get(TOPIC, headers={"Accept": "application/json"}).json() is None
        robot.publishes(NAME, {"data": "anew"})
        assert http.get(TOPIC, headers={"Accept": "application/json"}).json() == {"data": "anew"}


@pytest.mark.slow
def test_the_first_read_of_a_field_waits_for_a_message(robot: MadeUp) -> None:
    robot.topic("/heard", STRING, published=False, heard=True)
    with served(robot, first_value_wait=5.0) as http:
        soon = threading.Timer(0.1, robot.publishes, ("/heard", {"data": "here"}))
        soon.start()
        assert http.get("/topics/heard", params={"field": "data"}).text == "here"
        soon.join()
    robot.topic("/silent", STRING, published=False, heard=True)
    with served(robot, first_value_wait=0.3) as http:
        took = []
        for _ in range(3):
            began = time.monotonic()
            assert http.get("/topics/silent", params={"field": "data"}).status_code == 404
            took.append(time.monotonic() - began)
        assert took[0] >= 0.3 > min(took[1:])


def test_reading_a_missing_topic_subscribes_to_nothing(robot: MadeUp) -> None:
    asked: list[str] = []
    subscribe = robot.subscribe

    async def counted(topic: str, *, depth: int = 1) -> Any:
        asked.append(topic)
        return await subscribe(topic, depth=depth)

    robot.subscribe = counted  # type: ignore[method-assign]
    with served(robot) as http:
        assert http.get("/topics/none", params={"field": "data"}).status_code == 404
        assert http.get("/topics/none").status_code == 404
        assert http.get(TOPIC).status_code == 200
    assert asked == [NAME]
