"""A ROS action among the resources, without a mapping and with one."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
import rdflib

from rosld.adapters.rover.graph import NAVIGATE_TO
from tests.rover.conftest import StartRover
from tests.rover.rovers import UNDER_WAY, Rover
from tests.stopping import release
from tests.waiting import until

pytestmark = pytest.mark.slow

TD = rdflib.Namespace("https://www.w3.org/2019/wot/td#")
HCTL = rdflib.Namespace("https://www.w3.org/2019/wot/hypermedia#")
HTV = rdflib.Namespace("http://www.w3.org/2011/http#")
LDP = rdflib.Namespace("http://www.w3.org/ns/ldp#")
ROS = rdflib.Namespace("https://w3id.org/rosld#")
ACTION = f"/resources{NAVIGATE_TO}"
JSON = {"Accept": "application/json"}
TURTLE = {"Accept": "text/turtle"}
STREAM = {"Accept": "text/event-stream"}
PARTS = {"status", "goal", "feedback", "result"}


def graph(http: httpx.Client, path: str) -> rdflib.Graph:
    answer = http.get(path, headers=TURTLE)
    assert answer.status_code == 200, answer.text
    return rdflib.Graph().parse(data=answer.text, format="turtle")


def forms(found: rdflib.Graph, affordance: rdflib.term.Node) -> set[tuple[str, str, str]]:
    """Return the operations of an affordance, each with its method and its target."""
    return {
        (
            str(found.value(form, HCTL.hasOperationType)).rpartition("#")[2],
            str(found.value(form, HTV.methodName)),
            str(found.value(form, HCTL.hasTarget)),
        )
        for form in found.objects(affordance, TD.hasForm)
    }


def sent(rover: Rover, x: float, y: float, to: str = ACTION, frame: str = "map") -> httpx.Response:
    pose = {"header": {"frame_id": frame}, "pose": {"position": {"x": x, "y": y}}}
    return rover.http.post(to, json={"pose": pose}, headers=JSON)


def status(rover: Rover) -> Any:
    return rover.http.get(f"{ACTION}/status", headers=JSON).json()


def end(rover: Rover) -> None:
    """Cancel the goals of the rover."""
    until(lambda: rover.http.delete(ACTION).status_code == 409 and status(rover) not in UNDER_WAY, "the end of goals")


def events(stream: httpx.Response) -> Iterator[Any]:
    for line in stream.iter_lines():
        if line.startswith("data: "):
            yield json.loads(line.removeprefix("data: "))


def test_an_action_tells_how_to_send_follow_and_cancel_a_goal(rover: Rover) -> None:
    base = str(rover.http.base_url).rstrip("/")
    found, action = graph(rover.http, ACTION), rdflib.URIRef(base + ACTION)
    assert found.value(action, ROS.invokes) == rdflib.URIRef(f"{base}/actions{NAVIGATE_TO}")
    (goal,) = found.objects(action, TD.hasActionAffordance)
    assert forms(found, goal) == {
        ("invokeAction", "POST", base + ACTION),
        ("queryAction", "GET", f"{base}{ACTION}/"),
        ("cancelAction", "DELETE", base + ACTION),
    }
    for predicate, ending in ((ROS.requestShape, "Goal"), (ROS.feedbackShape, "Feedback"), (ROS.resultShape, "Result")):
        assert str(found.value(goal, predicate)).endswith(f"NavigateTo_{ending}")
    parts = {str(found.value(one, TD.name)): one for one in found.objects(action, TD.hasPropertyAffordance)}
    assert parts.keys() == PARTS
    for name, one in parts.items():
        operations = {operation for operation, _, _ in forms(found, one)}
        assert operations == {"readProperty", "observeProperty"}
        assert {target for _, _, target in forms(found, one)} == {f"{base}{ACTION}/{name}"}
        sources = {str(each) for each in graph(rover.http, f"{ACTION}/{name}").objects(None, ROS.readsFrom)}
        assert sources == {f"{base}/actions{NAVIGATE_TO}"}, "and not the topics that the action is made of"
    assert rover.http.get(f"{ACTION}/cancel").status_code == 404
    assert set(rover.http.options(ACTION).headers["allow"].split(", ")) == {"GET", "HEAD", "OPTIONS", "POST", "DELETE"}


def test_it_is_in_the_resource_of_its_namespace_and_in_thing_descriptions(rover: Rover) -> None:
    base = str(rover.http.base_url).rstrip("/")
    found, root = graph(rover.http, "/resources/"), rdflib.URIRef(f"{base}/resources/")
    contained = {str(each) for each in found.objects(root, LDP.contains)}
    assert {base + ACTION, f"{base}{ACTION}/"} <= contained
    assert base + ACTION in {
        target for one in found.objects(root, TD.hasActionAffordance) for _, _, target in forms(found, one)
    }
    for path in ("/.well-known/wot", "/resources/?format=td"):
        action = rover.http.get(path).json()["actions"][NAVIGATE_TO[1:]]
        assert action["synchronous"] is False
        assert "pose" in action["input"]["properties"]
        assert {one["op"] for one in action["forms"]} == {"invokeaction", "queryaction", "cancelaction"}
    own = rover.http.get(f"{ACTION}/?format=td").json()["properties"]
    assert own.keys() == PARTS
    assert {"executing", "succeeded", "aborted"} < set(own["status"]["enum"])
    whole = rover.http.get("/.well-known/wot").json()["properties"]
    assert {f"{NAVIGATE_TO[1:]}/{part}" for part in PARTS} <= whole.keys()
    assert all(one["readOnly"] and one["observable"] for one in own.values())


def test_a_goal_is_followed_at_one_url_until_it_is_reached(rover: Rover) -> None:
    end(rover)
    x, y = rover.place()
    goal = (0.5, -1.0) if abs(x - 0.5) + abs(y + 1.0) > 0.5 else (-0.5, -1.0)
    with rover.http.stream("GET", f"{ACTION}/status", headers=STREAM) as stream:
        answer = sent(rover, *goal)
        assert answer.status_code == 201, answer.text
        assert "/goals/" in answer.headers["location"]
        for event in events(stream):
            if event == "succeeded":
                break
            assert event in (*UNDER_WAY, "idle", "aborted", "canceled", "rejected")
    told = rover.http.get(f"{ACTION}/", headers=JSON).json()
    assert told.keys() == PARTS
    assert told["status"] == "succeeded"
    assert rover.http.get(f"{ACTION}/goal", headers=JSON).json() == told["goal"]
    assert told["result"]["message"] == "arrived"
    assert "distance_remaining" in told["feedback"]


def test_a_goal_is_canceled_where_it_was_sent(rover: Rover) -> None:
    end(rover)
    goal = sent(rover, 4.4, -3.4).headers["location"]
    until(lambda: status(rover) == "executing", "the goal under way")
    answer = rover.http.delete(ACTION)
    assert (answer.status_code, answer.headers["location"]) == (202, goal)
    until(lambda: status(rover) == "canceled", "the end of the goal")
    nothing = rover.http.delete(ACTION)
    assert nothing.status_code == 409
    assert "has no active goal that was sent through rosld" in nothing.json()["detail"]


def test_the_last_goal_is_shown_unless_another_is_pursued(start_rover: StartRover) -> None:
    rover = start_rover("pose=-4.2,-3.2,0")
    assert status(rover) == "idle"
    assert sent(rover, 1.0, 0.0, frame="moon").status_code == 409
    assert status(rover) == "rejected"
    assert rover.http.get(f"{ACTION}/goal", headers=JSON).json()["pose"]["header"]["frame_id"] == "moon"
    assert sent(rover, 4.4, 3.0).status_code == 201
    until(lambda: status(rover) == "executing", "the goal under way")
    assert sent(rover, 1.0, 0.0, frame="moon").status_code == 409
    assert status(rover) == "executing"
    end(rover)


MAPPING = f"""
@prefix map: <https://w3id.org/rosld/mapping#> . @prefix ex: <http://example.org/> .
@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
<#rover> a map:ComplexResource ; map:path "/errand/" ;
  map:property [ map:predicate ex:errand ; map:name "errand" ; map:member "{NAVIGATE_TO}/status" ] ,
    [ map:predicate ex:left ; map:name "left" ; map:member "{NAVIGATE_TO}/feedback" ; map:field "distance_remaining" ] ;
  map:action [ map:relation ex:go ; map:name "go" ; map:service "{NAVIGATE_TO}" ; map:availableWhen <#idle> ] .
<#idle> a sh:NodeShape ; map:about "/errand/" ;
  sh:property [ sh:path ex:errand ; sh:in ( "idle" "succeeded" "canceled" "aborted" "rejected" "lost" ) ] .
"""


def test_a_mapping_offers_it_on_conditions_about_its_goal(start_rover: StartRover) -> None:
    rover = start_rover("pose=-4.2,-3.2,0")
    put = rover.http.put("/mappings/mine", content=MAPPING, headers={"Content-Type": "text/turtle"})
    assert put.status_code == 201, put.text
    assert "warnings" not in put.text
    go = "/resources/errand/go"
    moved = rover.http.get(ACTION)
    assert (moved.status_code, moved.headers["location"]) == (308, f"{rover.http.base_url}resources/errand/go")
    offered = graph(rover.http, "/resources/errand/")
    assert str(next(offered.objects(None, rdflib.URIRef("http://example.org/go")))).endswith(go)
    assert sent(rover, 4.4, 3.0, to=go).status_code == 201
    until(lambda: rover.http.get("/resources/errand/", headers=JSON).json()["errand"] == "executing", "the goal")
    refused = sent(rover, 0.0, 0.0, to=go)
    assert refused.status_code == 409
    assert "not on offer now" in refused.json()["detail"]
    assert rover.http.get(go).status_code == 404
    assert "DELETE" in rover.http.options(go).headers["allow"]
    until(lambda: rover.http.get("/resources/errand/", headers=JSON).json()["left"], "how far it is")
    assert rover.http.delete(go).status_code == 202, "what moves can be ended whatever conditions say"
    until(lambda: rover.http.get(go).status_code == 200, "the offer")


def test_while_the_robot_is_stopped_a_goal_can_only_be_canceled(start_rover: StartRover) -> None:
    rover = start_rover("pose=-4.2,-3.2,0")
    assert rover.http.post("/stop").status_code in (200, 201, 204)
    assert rover.http.options(ACTION).headers["allow"] == "DELETE, GET, HEAD, OPTIONS"
    found = graph(rover.http, ACTION)
    operations = {
        operation for one in found.objects(None, TD.hasActionAffordance) for operation, _, _ in forms(found, one)
    }
    assert operations == {"queryAction", "cancelAction"}
    assert sent(rover, 1.0, 0.0).status_code == 423
    assert release(rover.http).status_code in (200, 204)
