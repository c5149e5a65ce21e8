"""Updates of a real ROS 1 robot: rospy gets what an update publishes, sets and calls, once."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from tests.adapters.ros1.system import running
from tests.server.robots import asking
from tests.waiting import until

TWIST, VECTOR = f"{asking.TYPES}geometry_msgs/msg/Twist", f"{asking.TYPES}geometry_msgs/msg/Vector3"
PREFIXES = f"PREFIX rdf: <{asking.RDF}> PREFIX ros: <{asking.ROS}> PREFIX t: <{TWIST}#> PREFIX v: <{VECTOR}#> "


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A rosmaster, and the paper's aircraft on it."""
    with running(tmp_path_factory.mktemp("ros")) as found:
        found.node("aircraft_node.py", str(tmp_path_factory.mktemp("classes")))
        yield found


@pytest.fixture(scope="module")
def http(ros: Any, start_server: Callable[..., Any]) -> Iterator[httpx.Client]:
    """rosld on that robot."""
    served = start_server(ros.source)
    yield served.http
    assert served.stop() == 0


def update(http: httpx.Client, text: str) -> None:
    """Have an update carried out."""
    answer = http.post("/sparql", content=PREFIXES + text, headers=asking.UPDATE)
    assert answer.status_code == 204, answer.text


def vector(x: float, z: float) -> str:
    """A vector in an update."""
    return f"[ a <{VECTOR}> ; v:x {x} ; v:y 0 ; v:z {z} ]"


def test_a_rospy_subscriber_gets_one_message_of_an_update_and_none_of_one_that_changes_nothing(
    ros: Any, http: httpx.Client
) -> None:
    listener = ros.node("listener.py", "/cmd_vel", "geometry_msgs/Twist")
    until(lambda: "PUT" in http.options("/topics/cmd_vel").headers.get("allow", ""), "/cmd_vel, writable")
    stated = f"</topics/cmd_vel#message> a <{TWIST}> ; t:linear {vector(0.5, 0)} ; t:angular {vector(0, 1)}"
    update(http, f"INSERT DATA {{ GRAPH </topics/cmd_vel> {{ {stated} }} }}")
    faster = (
        "WITH </topics/cmd_vel> DELETE { ?linear v:x ?old } INSERT { ?linear v:x ?new } "
        "WHERE { ?m t:linear ?linear . ?linear v:x ?old BIND(?old * 2 AS ?new) }"
    )
    update(http, faster)
    same = "WITH </topics/cmd_vel> DELETE { ?l v:x ?x } INSERT { ?l v:x ?x } WHERE { ?m t:linear ?l . ?l v:x ?x }"
    update(http, same)
    two_steps = f"{faster.replace('* 2', '* 3')} ; {faster.replace('* 2', '+ 1')}"
    update(http, two_steps)
    speeds = [json.loads(listener.line("heard").removeprefix("heard "))["linear"]["x"] for _ in range(3)]
    assert speeds == [0.5, 1.0, 4.0]
    assert len([line for line in listener.seen if line.startswith("heard")]) == 3
    listener.stop()


def test_a_parameter_of_a_real_master_is_set_and_deleted(ros: Any, http: httpx.Client) -> None:
    until(lambda: http.get("/parameters/aircraft/seats").status_code == 200, "the parameter")
    update(
        http,
        "DELETE { GRAPH ?g { ?p ros:value ?old } } INSERT { GRAPH ?g { ?p ros:value ?new } } "
        "WHERE { VALUES ?g { </parameters/aircraft/seats> } GRAPH ?g { ?p ros:value ?old } BIND(?old + 2 AS ?new) }",
    )
    assert ros.yaml(ros.run("/usr/bin/rosparam", "get", "/aircraft/seats")) == 4
    update(http, "DELETE WHERE { GRAPH </parameters/aircraft/registration> { ?s ?p ?o } }")
    assert "/aircraft/registration" not in ros.run("/usr/bin/rosparam", "list").split()


def test_the_setter_of_a_real_node_is_called(ros: Any, http: httpx.Client) -> None:
    power = "/resources/aircraft/power"
    until(lambda: http.get(power).status_code == 200, "the resource")
    before = asking.value(http, power)
    after = "on" if before == "off" else "off"
    update(
        http,
        f"INSERT DATA {{ GRAPH </data/log> {{ <urn:power> <urn:is> '{after}' }} }} ; WITH <{power}> "
        f"DELETE {{ ?p rdf:value ?old }} INSERT {{ ?p rdf:value '{after}' }} WHERE {{ ?p rdf:value ?old }}",
    )
    assert asking.value(http, power) == after
    assert http.get("/data/log").status_code == 200
