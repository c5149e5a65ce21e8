"""The container of a node's parameters (ROS 2), patched as one; and what a parameter server says of its own (ROS 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import httpx
import pytest

from rosld.adapters import parameters as trees
from rosld.adapters.model import ParameterValue
from tests.server.robots.made_up import MadeUp, Serving, served

PATCH = {"content-type": "application/merge-patch+json"}
JSON = {"accept": "application/json"}


@pytest.fixture
def turtle(robot: MadeUp) -> MadeUp:
    robot.capabilities = replace(robot.capabilities, parameter_trees=False)
    robot.owners = ("/turtle/arm", "/turtle")
    robot.parameter("/turtle/red", 69)
    robot.parameter("/turtle/green", 86)
    robot.parameter("/turtle/pen/width", 3)
    robot.parameter("/turtle/arm/reach", 1.5)
    return robot


def patched(client: httpx.Client, value: object, path: str = "/parameters/turtle/") -> httpx.Response:
    return client.patch(path, json=value, headers=PATCH)


def test_several_parameters_of_a_node_are_set_in_one_go(turtle: MadeUp, serving: Serving) -> None:
    client = serving()
    assert "PATCH" in client.get("/parameters/turtle/").headers["allow"]
    assert patched(client, {"red": 1, "green": 86, "pen": {"width": 5}, "new": "x"}).status_code == 204
    assert turtle.sets == [{"/turtle/red": 1, "/turtle/pen/width": 5, "/turtle/new": "x"}]
    assert client.get("/parameters/turtle/pen/width", headers=JSON).json() == 5


def test_where_one_is_refused_none_is_set(turtle: MadeUp, serving: Serving) -> None:
    client = serving()
    answer = patched(client, {"red": 1, "green": "refused"})
    assert 400 <= answer.status_code < 600
    assert "/turtle/green" in answer.text
    assert client.get("/parameters/turtle/red", headers=JSON).json() == 69


def test_null_deletes(turtle: MadeUp, serving: Serving) -> None:
    client = serving()
    assert patched(client, {"green": None}).status_code == 204
    assert turtle.sets == []
    assert client.get("/parameters/turtle/green").status_code == 404
    assert client.get("/parameters/turtle/red").status_code == 200


def test_the_parameters_of_another_node_below_are_not_touched(turtle: MadeUp, serving: Serving) -> None:
    client = serving()
    answer = patched(client, {"red": 1, "arm": {"reach": 2.0}})
    assert answer.status_code == 409
    assert "/turtle/arm" in answer.text
    assert turtle.sets == []
    assert patched(client, {"reach": 2.0}, "/parameters/turtle/arm/").status_code == 204


@pytest.mark.parametrize("path", ["/parameters/", "/parameters/turtle/pen/"])
def test_a_container_that_is_no_nodes_takes_no_patch(turtle: MadeUp, serving: Serving, path: str) -> None:
    client = serving()
    answer = patched(client, {"red": 1}, path)
    assert answer.status_code == 405
    assert "PATCH" not in answer.headers["allow"]


def test_a_server_that_only_reads_takes_no_patch(turtle: MadeUp, serving: Serving) -> None:
    assert patched(serving(read_only=True), {"red": 1}).status_code in (403, 405)
    assert turtle.sets == []


class LateGraph(MadeUp):
    """A robot with a parameter server, whose graph shows what was set there only when it is looked at."""

    capabilities = replace(MadeUp.capabilities, parameter_server=True)

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        for name, value in values.items():
            self._parameters = trees.with_value(self._parameters, name, value)

    def look(self) -> None:
        """The graph is as the parameters are."""
        self.run(lambda: self._parameters_are(self._parameters))


def test_what_was_just_set_on_a_parameter_server_reads_the_same_before_the_graph_has_it() -> None:
    robot = LateGraph()
    with served(robot) as http:
        http.put("/parameters/height", json=3).raise_for_status()
        before = http.get("/parameters/height")
        robot.look()
        after = http.get("/parameters/height")
    assert "nodes may read it only when they start" in before.text
    assert (before.headers["etag"], before.text) == (after.headers["etag"], after.text)
