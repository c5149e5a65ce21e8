"""Missing fields of messages in JSON have their defaults, as in ROS's own tools; in RDF they are errors."""

from __future__ import annotations

import json
from typing import Any

import httpx
import jsonschema
import pytest

from tests.crawl.description import Description
from tests.server.robots.made_up import TYPES, MadeUp, Serving
from tests.waiting import until

pytestmark = pytest.mark.slow

DRIVE, GOAL, TURN = "/drive", "/goal", "/turn"
TWIST = "https://w3id.org/rosld/types/geometry_msgs/msg/Twist"
VECTOR = "https://w3id.org/rosld/types/geometry_msgs/msg/Vector3"
ZERO = {"x": 0.0, "y": 0.0, "z": 0.0}
POSED = {"position": ZERO, "orientation": {**ZERO, "w": 1.0}}
NAMES = {
    "speed": 0.5,
    "times": 3,
    "name": "all of it",
    "far": "9223372036854775807",
    "least": "-INF",
    "octets": "AQI=",
    "three": [1.0, 2.0, 3.0],
    "words": ["a", "b"],
    "pose": POSED,
    "poses": [],
    "pair": [POSED, POSED],
    "plain": 0.0,
    "text": "",
    "on": False,
    "nothing": [],
    "four": [0, 0, 0, 0],
}
"""The request of `made_up/srv/Turn` with all defaults, as plain JSON."""
REQUEST = """float32 speed 0.5
uint8 times 3
string name "all of it"
int64 far 9223372036854775807
float64 least -inf
uint8[] octets [1, 2]
float64[3] three [1, 2, 3]
string[] words ["a", 'b']
geometry_msgs/Pose pose
geometry_msgs/Pose[] poses
geometry_msgs/Pose[2] pair
float64 plain
string text
bool on
int32[] nothing
int32[4] four
---
bool success true
"""


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> MadeUp:
    """A robot that drives, goes somewhere, and turns."""
    monkeypatch.setitem(TYPES, "made_up/srv/Turn", REQUEST)
    found = MadeUp()
    found.topic(DRIVE, "geometry_msgs/msg/Twist", published=False, heard=True)
    found.topic(GOAL, "geometry_msgs/msg/PoseStamped", published=False, heard=True)
    found.answer(TURN, "made_up/srv/Turn")
    return found


@pytest.fixture
def http(robot: MadeUp, serving: Serving) -> httpx.Client:
    return serving()


def missing(answer: httpx.Response) -> set[str]:
    """Return the paths of the missing fields in a response."""
    assert answer.status_code == 422, answer.text
    violations = answer.json()["violations"]
    assert all(one["message"].startswith("missing") for one in violations), violations
    return {one["path"] for one in violations}


def test_a_request_has_what_its_definition_gives_it(http: httpx.Client, robot: MadeUp) -> None:
    requests: list[dict[str, Any]] = []
    robot.offer(TURN, "made_up/srv/Turn", lambda request: requests.append(request) or {})
    assert http.post(f"/services{TURN}", json={}).status_code == 201
    assert http.post(f"/services{TURN}", json={"times": 0, "pair": [{}, {"position": {"x": 1}}]}).status_code == 201
    there = {"position": {**ZERO, "x": 1.0}, "orientation": POSED["orientation"]}
    assert requests == [NAMES, {**NAMES, "times": 0, "pair": [POSED, there]}]


def test_a_field_that_is_left_out_is_zero_and_a_quaternion_turns_nothing(http: httpx.Client, robot: MadeUp) -> None:
    assert http.put(f"/topics{DRIVE}", json={"linear": {"x": 0.2}}).status_code == 204
    for query in ("", "?defaults=true", "?strict=false", "?defaults", "?strict=false&defaults=true"):
        assert http.put(f"/topics{DRIVE}{query}", json={}).status_code == 204
    assert robot.sent[DRIVE] == [
        {"linear": {**ZERO, "x": 0.2}, "angular": ZERO},
        *[{"linear": ZERO, "angular": ZERO}] * 5,
    ]
    for body in ({"position": {"x": 1}}, {"orientation": {"z": 0.5}}, {"orientation": {"w": 0}}):
        assert http.put(f"/topics{GOAL}", json={"pose": body}).status_code == 204
    assert [sent["pose"]["orientation"] for sent in robot.sent[GOAL]] == [
        {**ZERO, "w": 1.0},
        {**ZERO, "z": 0.5, "w": 1.0},
        {**ZERO, "w": 0.0},
    ]


def test_who_asks_for_strictness_is_told_what_is_missing(http: httpx.Client, robot: MadeUp) -> None:
    for query in ("strict=true", "strict", "defaults=false", "strict=true&defaults=false"):
        answer = http.put(f"/topics{DRIVE}?{query}", json={"linear": {"x": 1}})
        assert missing(answer) == {"linear.y", "linear.z", "angular"}
        held = http.post(f"/topics{DRIVE}?rate=10&{query}", json={"linear": ZERO})
        assert missing(held) == {"angular"}
        assert "pose" in missing(http.post(f"/services{TURN}?{query}", json={"speed": 1}))
    for query in ("strict=true&defaults=true", "strict=false&defaults=false", "strict=perhaps"):
        assert http.put(f"/topics{DRIVE}?{query}", json={}).status_code == 400
    assert not robot.sent
    assert not robot.calls


def test_what_is_wrong_is_not_left_out_and_rdf_says_all_of_a_message(http: httpx.Client, robot: MadeUp) -> None:
    wrong: list[object] = [{"linaer": {"x": 1}}, {"linear": {"x": 1, "w": 1}}, {"linear": None}, [], None]
    for body in wrong:
        answer = http.put(f"/topics{DRIVE}", content=json.dumps(body), headers=JSON)
        assert answer.status_code == 422, answer.text
    part = f"<#message> a <{TWIST}> ; <{TWIST}#linear> [ a <{VECTOR}> ; <{VECTOR}#x> 1.0 ] ."
    for query in ("", "?defaults=true", "?strict=false"):
        answer = http.put(f"/topics{DRIVE}{query}", content=part, headers={"Content-Type": "text/turtle"})
        assert missing(answer) == {"linear.y", "linear.z", "angular"}
    for headers in ({}, JSON, {"Content-Type": "text/turtle"}):  # for a lost body
        assert "pose" in missing(http.post(f"/services{TURN}", headers=headers))
        assert "pose" in missing(http.post(f"/resources{TURN}", headers=headers))
    assert not robot.sent
    assert not robot.calls


JSON = {"Content-Type": "application/json"}


def test_a_patch_changes_what_it_names_and_removes_no_field(http: httpx.Client, robot: MadeUp) -> None:
    http.put(f"/topics{GOAL}", json={"header": {"frame_id": "map"}, "pose": {"orientation": {"z": 1, "w": 0}}})
    at = {"If-Match": http.get(f"/topics{GOAL}").headers["etag"], "Content-Type": "application/merge-patch+json"}
    removed = http.patch(f"/topics{GOAL}", content='{"pose": {"orientation": {"w": null}}}', headers=at)
    assert missing(removed) == {"pose.orientation.w"}
    assert http.patch(f"/topics{GOAL}", content='{"pose": {"position": {"x": 2}}}', headers=at).status_code == 204
    assert robot.sent[GOAL][-1]["header"]["frame_id"] == "map"
    assert robot.sent[GOAL][-1]["pose"] == {
        "position": {**ZERO, "x": 2.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0},
    }


def test_a_hold_says_what_was_left_out_too(http: httpx.Client, robot: MadeUp) -> None:
    begun = http.post(f"/topics{DRIVE}?rate=10&lease=5", json={"linear": {"x": 1}})
    assert begun.status_code == 201, begun.text
    changed = http.patch(begun.headers["location"], json={"angular": {"z": 1}})
    assert changed.status_code == 204, changed.text
    until(lambda: {"linear": ZERO, "angular": {**ZERO, "z": 1.0}} in robot.sent[DRIVE], "the command after the change")
    assert robot.sent[DRIVE][0] == {"linear": {**ZERO, "x": 1.0}, "angular": ZERO}
    assert http.delete(begun.headers["location"]).status_code == 204


def test_the_value_of_a_resource_is_filled_up_and_a_member_that_is_patched_is_not(
    http: httpx.Client, robot: MadeUp
) -> None:
    values = robot.variable("/arm/range", "Range", low=1.0, high=2.0)
    place = "/resources/arm/range"
    assert missing(http.put(f"{place}?strict=true", json={"high": 3})) == {"low"}
    assert http.put(place, json={"high": 3}).status_code == 204
    assert values == {"low": 0.0, "high": 3.0}
    merge = {"Content-Type": "application/merge-patch+json"}
    assert http.patch("/resources/arm/", content='{"range": {"low": 1}}', headers=merge).status_code == 204
    assert values == {"low": 1.0, "high": 3.0}


def test_a_goal_is_filled_up(own_aircraft: httpx.Client) -> None:
    plane = own_aircraft
    assert missing(plane.post("/actions/aircraft/fly?strict=true", json={})) == {"distance"}
    refused = plane.post("/actions/aircraft/fly", json={})
    assert refused.status_code == 409, "the aircraft is off: it is asked all the same"
    goal = plane.get(refused.headers["location"], headers={"Accept": "application/json"}).json()
    assert goal["goal"] == {"distance": 0.0}


def test_the_description_says_what_may_be_left_out_and_what_it_is_then(http: httpx.Client, robot: MadeUp) -> None:
    description = Description(http.get("/openapi.json").json())
    sent = description.document["components"]["schemas"]["made_up.srv.Turn_Request.sent"]
    assert "required" not in sent
    told = {name: one["default"] for name, one in sent["properties"].items() if "default" in one}
    assert told == {name: value for name, value in NAMES.items() if name not in ("pose", "pair", "four")}
    orientation = description.resolved(sent["properties"]["pose"])["properties"]["orientation"]
    assert description.resolved(orientation)["properties"]["w"]["default"] == 1.0
    jsonschema.Draft202012Validator(sent).validate({})
    for name, value in told.items():
        jsonschema.Draft202012Validator(sent["properties"][name]).validate(value)
    read = description.document["components"]["schemas"]["made_up.srv.Turn_Response"]
    assert read["required"] == ["success"]
    assert "default" not in read["properties"]["success"]


def test_a_thing_description_says_so_too(http: httpx.Client, robot: MadeUp) -> None:
    robot.variable("/arm/range", "Range", low=1.0, high=2.0)
    robot.variable("/arm/reach", "Range", set=None, low=1.0, high=2.0)
    thing = http.get("/resources/arm/", headers={"Accept": "application/td+json"}).json()
    written, read = (thing["properties"][name] for name in ("range", "reach"))
    assert "required" not in written
    assert written["properties"]["low"]["default"] == 0.0
    assert read["required"] == ["low", "high"]
    assert "default" not in read["properties"]["low"]
    root = http.get("/resources/", headers={"Accept": "application/td+json"}).json()
    assert root["actions"]["turn"]["input"]["properties"]["times"]["default"] == 3
    assert "required" not in root["actions"]["turn"]["input"]


def test_a_shape_states_defaults_and_asks_for_every_field(http: httpx.Client) -> None:
    lines = http.get("/shapes/geometry_msgs/msg/Quaternion", headers={"Accept": "application/n-triples"}).text
    about = [
        line
        for line in lines.splitlines()
        if line.startswith(f"<{http.base_url}shapes/geometry_msgs/msg/Quaternion#w>")
    ]
    double = '"1.0"^^<http://www.w3.org/2001/XMLSchema#double>'
    assert any("shacl#defaultValue" in line and double in line for line in about)
    assert any("shacl#minCount" in line for line in about)
