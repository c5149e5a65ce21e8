"""Parameters over HTTP: create, read, update, delete (paper, Table 2); those of a ROS 2 node are set together."""

from __future__ import annotations

from collections.abc import Mapping

import httpx
import pytest
from msgspec.structs import replace

from rosld.adapters import parameters as trees
from rosld.adapters.model import ParameterValue
from tests.server.robots.made_up import MadeUp, Serving, served

ROS = "https://w3id.org/rosld#"
JSON = {"Accept": "application/json"}
MERGE = {"Content-Type": "application/merge-patch+json"}


def test_a_parameter_has_no_past_and_says_so(plane: httpx.Client) -> None:
    assert plane.put("/parameters/present", json=4).status_code == 201
    for query in ("at=-5", "timemap", "series=value"):
        answer = plane.get(f"/parameters/present?{query}", headers=JSON)
        assert answer.status_code == 404, "the present value is no answer to what it was"
        assert "parameter values are not recorded" in answer.json()["detail"]


def test_rdf_sets_what_json_sets_and_a_value_that_was_read_can_be_put_back(plane: httpx.Client) -> None:
    turtle = {"Content-Type": "text/turtle"}
    assert plane.put("/parameters/p", content=f"<> <{ROS}value> 4.5 .", headers=turtle).status_code == 201
    assert plane.get("/parameters/p", headers=JSON).json() == 4.5
    for value in (3, 2.5, "x", [1, "a"], True):
        plane.put("/parameters/p", json=value)
        read = plane.get("/parameters/p", headers={"Accept": "text/turtle"}).content
        answer = plane.put("/parameters/p", content=read, headers=turtle)
        assert answer.status_code == 204, answer.text
        assert plane.get("/parameters/p", headers=JSON).json() == value


def test_a_tree_is_set_and_patched_as_an_object_and_a_value_replaces_none(plane: httpx.Client) -> None:
    plane.put("/parameters/tree", json={"a": 1, "b": 2, "deep": {"c": "three"}})
    assert plane.get("/parameters/tree/", headers=JSON).json() == {"a": 1, "b": 2, "deep": {"c": "three"}}
    made = [plane.post("/parameters/tree/", json=5, headers={"Slug": "fresh"}) for _ in range(2)]
    assert made[0].headers["location"] != made[1].headers["location"]
    patched = plane.patch("/parameters/tree/", content='{"a": 10, "b": null, "deep": null}', headers=MERGE)
    assert patched.status_code == 204
    assert plane.get("/parameters/tree/a", headers=JSON).json() == 10
    assert "deep" not in plane.get("/parameters/tree/", headers=JSON).json()
    assert plane.put("/parameters/tree", json=5).status_code == 409, "a value never wipes out others"
    assert plane.put("/parameters/tree/a/below", json=5).status_code == 409


def test_a_patch_removes_a_value_however_the_client_spells_it(plane: httpx.Client) -> None:
    spellings = {1: ("01", "integer"), 2.5: ("2.50e0", "double"), False: ("0", "boolean")}
    for value, (spelling, datatype) in spellings.items():
        plane.put("/parameters/p", json=value)
        old = f'<> <{ROS}value> "{spelling}"^^<http://www.w3.org/2001/XMLSchema#{datatype}>'
        update = f"DELETE DATA {{ {old} }} ; INSERT DATA {{ <> <{ROS}value> 'new' }}"
        patched = plane.patch("/parameters/p", content=update, headers={"Content-Type": "application/sparql-update"})
        assert patched.status_code == 204, patched.text
        assert plane.get("/parameters/p", headers=JSON).json() == "new"


def test_if_match_guards_a_parameter(plane: httpx.Client) -> None:
    plane.put("/parameters/guarded", json=1)
    etag = plane.get("/parameters/guarded").headers["etag"]
    guards = ({"If-Match": etag}, {"If-Match": etag}, {"If-None-Match": "*"})
    assert [plane.put("/parameters/guarded", json=2, headers=guard).status_code for guard in guards] == [204, 412, 412]


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
    return client.patch(path, json=value, headers=MERGE)


def test_several_parameters_of_a_node_are_set_at_once_or_not_at_all(turtle: MadeUp, serving: Serving) -> None:
    client = serving()
    assert "PATCH" in client.get("/parameters/turtle/").headers["allow"]
    assert patched(client, {"red": 1, "green": 86, "pen": {"width": 5}, "new": "x"}).status_code == 204
    assert turtle.sets == [{"/turtle/red": 1, "/turtle/pen/width": 5, "/turtle/new": "x"}]
    assert client.get("/parameters/turtle/pen/width", headers=JSON).json() == 5
    refused = patched(client, {"red": 2, "green": "refused"})
    assert 400 <= refused.status_code < 600
    assert "/turtle/green" in refused.text
    assert client.get("/parameters/turtle/red", headers=JSON).json() == 1
    turtle.sets.clear()
    assert patched(client, {"green": None}).status_code == 204
    assert turtle.sets == []
    assert client.get("/parameters/turtle/green").status_code == 404
    assert client.get("/parameters/turtle/red").status_code == 200


def test_a_patch_is_for_the_parameters_of_one_node(turtle: MadeUp, serving: Serving) -> None:
    client = serving()
    answer = patched(client, {"red": 1, "arm": {"reach": 2.0}})
    assert answer.status_code == 409
    assert "/turtle/arm" in answer.text
    for path in ("/parameters/", "/parameters/turtle/pen/"):
        refused = patched(client, {"red": 1}, path)
        assert refused.status_code == 405
        assert "PATCH" not in refused.headers["allow"]
    assert patched(serving(read_only=True), {"red": 1}).status_code in (403, 405)
    assert turtle.sets == []
    assert patched(client, {"reach": 2.0}, "/parameters/turtle/arm/").status_code == 204


class LateGraph(MadeUp):
    """A robot with a parameter server, whose graph shows new parameters only once it is refreshed."""

    capabilities = replace(MadeUp.capabilities, parameter_server=True)

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        for name, value in values.items():
            self._parameters = trees.with_value(self._parameters, name, value)

    def look(self) -> None:
        """Update the graph to match the parameters."""
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
