"""Queries on a changing robot: values as of the start of the query, at one moment, as far as it names them."""

from __future__ import annotations

import asyncio
import csv
import io
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import httpx
import pytest

from rosld.adapters.model import Sample
from rosld.adapters.model.parameter import ParameterValue
from rosld.ontology.document import Document
from rosld.server.resources import topics as topic_resources
from rosld.server.robot.live_topics import LiveTopics
from tests.server.robots.made_up import MadeUp, Serving
from tests.waiting import once_started

pytestmark = pytest.mark.slow

TYPES = "https://w3id.org/rosld/types/"
VECTOR = f"{TYPES}geometry_msgs/msg/Vector3"
PREFIX = f"PREFIX v: <{VECTOR}#> "


def rows(http: httpx.Client, query: str) -> list[list[str]]:
    """Return the rows of a SELECT."""
    answer = once_started(lambda: http.get("/sparql", params={"query": PREFIX + query}, headers={"Accept": "text/csv"}))
    assert answer.status_code == 200, answer.text
    return list(csv.reader(io.StringIO(answer.text)))[1:]


@contextmanager
def meanwhile(act: Callable[[int], None]) -> Iterator[None]:
    """Run a function repeatedly, counting, until the block ends."""
    ended, failed = threading.Event(), []

    def run() -> None:
        count = 0
        try:
            while not ended.is_set():
                count += 1
                act(count)
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
    assert not failed, failed


def all_equal(number: int) -> dict[str, int]:
    return {"x": number, "y": number, "z": number}


def test_a_message_is_never_seen_torn(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/place", "geometry_msgs/msg/Vector3", all_equal(0))
    http = serving()
    by_name = "SELECT ?x ?y ?z { <topics/place#message> v:x ?x ; v:y ?y ; v:z ?z }"
    by_type = "SELECT ?x ?y ?z { ?t ros:latest ?m . ?m v:x ?x . OPTIONAL { ?m v:y ?y } OPTIONAL { ?m v:z ?z } }"
    in_sum = (
        "SELECT (MIN(?a) AS ?x) (MAX(?a) AS ?y) (AVG(?a) AS ?z) "
        "{ ?t ros:latest ?m { ?m v:x ?a } UNION { ?m v:y ?a } UNION { ?m v:z ?a } }"
    )
    seen = set()
    with meanwhile(lambda count: robot.publishes("/place", all_equal(count))):
        for query in (*[by_name] * 30, *[by_type] * 8, *[in_sum] * 8):
            [values] = rows(http, query)
            assert len(set(map(float, values))) == 1, values
            seen.add(values[0])
    assert len(seen) > 3


def test_topics_that_change_together_are_seen_together(robot: MadeUp, serving: Serving) -> None:
    names = [f"/part{number}" for number in range(5)]
    robot.topics(names, "geometry_msgs/msg/Vector3")

    def publish_all(count: int) -> None:
        robot.run(lambda: [robot.publishes(name, all_equal(count)) for name in names])

    publish_all(0)
    http = serving()
    query = "SELECT ?t ?x { ?t ros:latest ?m . ?m v:x ?x }"
    assert len(rows(http, query)) == len(names)
    seen = set()
    with meanwhile(publish_all):
        for _ in range(20):
            found = rows(http, query)
            assert len(found) == len(names)
            assert len({x for _, x in found}) == 1, found
            seen.add(found[0][1])
    assert len(seen) > 3


def test_a_query_pays_for_the_topics_it_names_and_not_for_the_size_of_the_robot(
    robot: MadeUp, serving: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    every, size = 30, 300
    robot.topics((f"/t{number}" for number in range(size)), "geometry_msgs/msg/Vector3")
    for number in range(0, size, every):
        robot.publishes(f"/t{number}", all_equal(number))
    lifted: list[str] = []
    whole = topic_resources.topic_document  # type: ignore[attr-defined] # of another module

    def counted(topic: Any, *arguments: Any, **options: Any) -> Document:
        lifted.append(topic.name)
        return whole(topic, *arguments, **options)

    monkeypatch.setattr(topic_resources, "topic_document", counted)
    http = serving()
    assert len(rows(http, "SELECT ?t { ?t a ros:Topic ; ros:hasMessageType <" + VECTOR + "> }")) == size
    assert robot.subscribed() == set()
    assert lifted == []  # statements of the graph need no value
    wanted = {f"/t{number}" for number in range(0, size, every)}
    each = (f"{{ GRAPH <topics{topic}> {{ ?m v:x ?x }} }}" for topic in sorted(wanted))
    query = f"SELECT ?m ?x {{ {' UNION '.join(each)} }}"
    assert {float(x) for _, x in rows(http, query)} == set(map(float, range(0, size, every)))
    assert robot.subscribed() == wanted
    assert sorted(lifted) == sorted(wanted)
    lifted.clear()
    rows(http, query)
    assert lifted == []  # nothing has changed
    robot.publishes("/t60", all_equal(-1))
    robot.publishes("/t61", all_equal(-1))
    assert "-1.0" in [x for _, x in rows(http, query)]
    assert lifted == ["/t60"]
    assert robot.subscribed() == wanted


def test_silent_topics_are_waited_for_together_and_once(
    robot: MadeUp, serving: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    silent = 65  # concurrent requests share one read
    robot.topics((f"/silent{number}" for number in range(silent)), "geometry_msgs/msg/Vector3")
    waiting = 0
    together = asyncio.Event()

    async def wait(self: LiveTopics, look: object, seconds: float) -> None:
        nonlocal waiting
        assert seconds == 0.25
        waiting += 1
        if waiting == silent:
            together.set()
        await asyncio.wait_for(together.wait(), 60)  # the reads run concurrently

    monkeypatch.setattr(LiveTopics, "_wait", wait)
    http = serving(first_value_wait=0.25)
    query = "SELECT ?t ?x { ?t ros:latest ?m . ?m v:x ?x }"
    for _ in range(2):
        assert rows(http, query) == []
        assert waiting == silent
    assert http.get("/topics/silent7").status_code == 200
    assert waiting == silent
    robot.publishes("/silent7", all_equal(7))
    assert rows(http, query) == [[str(http.base_url.join("/topics/silent7")), "7.0"]]


def test_the_parameters_a_query_needs_are_asked_for_together(
    robot: MadeUp, serving: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(50):
        robot.parameter(f"/p{number}", number)
    http = serving()
    asked: list[Sequence[str]] = []
    get = robot.get_parameters

    async def counted(names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        asked.append(names)
        return await get(names, deadline=deadline)

    monkeypatch.setattr(robot, "get_parameters", counted)
    found = rows(http, "SELECT ?v { ?p a ros:Parameter ; ros:value ?v }")
    assert {int(value) for [value] in found} == set(range(50))
    assert [len(names) for names in asked] == [51]  # and their tree
    assert rows(http, "SELECT ?v { <parameters/p7> ros:value ?v }") == [["7"]]
    assert [list(names) for names in asked[1:]] == [["/p7"]]


def test_a_value_says_when_it_was_received_and_age_counts_from_there(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/place", "geometry_msgs/msg/Vector3", all_equal(1))
    http = serving()
    aged: list[Sample] = []
    robot.age_ns = lambda sample: aged.append(sample) or 2_500_000_000  # type: ignore[method-assign,func-returns-value]
    query = (
        "SELECT ?r ?age ?again { <topics/place> ros:latest/ros:received ?r "
        "BIND(ros:age(<topics/place>) AS ?age) BIND(ros:age(<topics/place>) AS ?again) }"
    )
    [[received, age, again]] = rows(http, query)
    [sample] = aged
    assert received.startswith("20")
    assert (age, again) == ("2.5", "2.5")
    assert sample.received_ns > 0
    assert rows(http, "SELECT ?age { BIND(ros:age(<topics/nowhere>) AS ?age) FILTER(BOUND(?age)) }") == []
