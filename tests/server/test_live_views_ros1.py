"""Queries over a real ROS 1 system: what they name is subscribed to, waited for, and aged by the wall clock."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.adapters.ros1.system import running

HERE = Path(__file__).parent
STRING = "https://w3id.org/rosld/types/std_msgs/msg/String"


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A rosmaster with a node that speaks and one that listens to a topic on which nobody does."""
    with running(tmp_path_factory.mktemp("ros")) as system:
        system.publish("/chatter", "std_msgs/String", "data: one", name="speaker")
        system.node("listener.py", "/unspoken", "std_msgs/String")
        yield system


def rows(robot: Any, query: str) -> list[list[str]]:
    """The rows of a SELECT."""
    answer = robot.http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    return list(csv.reader(io.StringIO(answer.text)))[1:]


def test_the_first_query_already_sees_the_value_of_a_topic_that_nobody_was_subscribed_to(
    ros: Any, start_server: Callable[..., Any]
) -> None:
    robot = start_server(ros.source, "--setting", "first_value_wait", "20")
    chatter = robot.topic("/chatter")
    assert rows(robot, f"SELECT ?t ?x {{ ?t ros:latest ?m . ?m <{STRING}#data> ?x }}") == [[chatter, "one"]]
    [[topic, age]] = rows(
        robot,
        "SELECT ?t ?age { VALUES ?t { <topics/chatter> <topics/unspoken> } BIND(ros:age(?t) AS ?age) "
        "FILTER(BOUND(?age)) }",
    )
    assert topic == chatter
    assert 0 <= float(age) < 60
    assert robot.stop() == 0
