"""Limits on what may be written, over HTTP: a value beyond them is refused by every way that leads to it."""

from __future__ import annotations

import json
from pathlib import Path

import httpx
import pytest

from tests.server.robots import asking
from tests.server.robots.made_up import MadeUp, Serving

value, detail, mapped = asking.value, asking.detail, asking.mapped
TYPES, RDF, JSON, TURTLE, MERGE, UPDATE = (
    asking.TYPES, asking.RDF, asking.JSON, asking.TURTLE, asking.MERGE, asking.UPDATE
)  # fmt: skip
LIMITS = f"""
@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <{RDF}> . @prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
<#grip> a sh:NodeShape ; sh:targetNode <resources/arm/grip> ;
  sh:property [ sh:path rdf:value ; sh:minInclusive 0 ; sh:maxInclusive 100 ] .
<#mode> a sh:NodeShape ; sh:targetNode <resources/arm/mode> ;
  sh:property [ sh:path rdf:value ; sh:in ( "manual" "automatic" ) ] .
<#name> a sh:NodeShape ; sh:targetNode <resources/arm/name> ;
  sh:property [ sh:path rdf:value ; sh:maxLength 5 ; sh:pattern "^[A-Z]" ] .
<#level> a sh:NodeShape ; sh:targetNode <resources/arm/level> ;
  sh:property [ sh:path rdf:value ; sh:minInclusive 0 ; sh:maxExclusive 1.5 ] .
<#x> a sh:NodeShape ; sh:targetNode <resources/gripper/x> ; sh:property [ sh:path rdf:value ; sh:maxInclusive 10 ] .
<#point> a sh:NodeShape ; sh:targetClass <{TYPES}geometry_msgs/msg/Point> ;
  sh:property [ sh:path <{TYPES}geometry_msgs/msg/Point#z> ; sh:minInclusive 0 ; sh:message "not below the floor" ] .
<#aim> a sh:NodeShape ; sh:targetClass <{TYPES}made_up/srv/Aim_Request> ;
  sh:property [ sh:path <{TYPES}made_up/srv/Aim_Request#azimuth> ; sh:maxInclusive 360 ] .
"""


@pytest.fixture
def limits(tmp_path: Path) -> Path:
    """The file of limits."""
    path = tmp_path / "limits.ttl"
    path.write_text(LIMITS)
    return path


@pytest.fixture
def arm(robot: MadeUp) -> MadeUp:
    """An arm with something of each kind to write to."""
    robot.variable("/arm/grip", "Byte", value=1)
    robot.variable("/arm/mode", "Words", words="manual")
    robot.variable("/arm/pose", "Pose", pose={"position": {"x": 1, "y": 2, "z": 3}, "orientation": {"w": 1}})
    robot.parameter("/arm/name", "Bob")
    robot.topic("/arm/level", "std_msgs/msg/Float64", published=False, heard=True)
    robot.answer("/arm/aim", "made_up/srv/Aim", hit=True)
    return robot


@pytest.fixture
def http(arm: MadeUp, serving: Serving, limits: Path) -> httpx.Client:
    """The arm, served with limits."""
    client: httpx.Client = serving(shapes=(limits,), first_value_wait=0)
    return client


def moved(arm: MadeUp) -> list[str]:
    """What was done to the arm."""
    return [name for name in arm.calls if "/get_" not in name] + list(arm.sent)


POSE = {"position": {"x": 0, "y": 0, "z": -1}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("PUT", "/resources/arm/grip", 101),
        ("PUT", "/resources/arm/grip", -1),
        ("PUT", "/resources/arm/grip", {"value": 101}),
        ("PUT", "/resources/arm/mode", "Manual"),
        ("PUT", "/resources/arm/mode", ""),
        ("PUT", "/resources/arm/name", "Robert"),
        ("PUT", "/resources/arm/name", "bob"),
        ("PUT", "/resources/arm/level", 1.5),
        ("PUT", "/resources/arm/level", "NaN"),
        ("PUT", "/resources/arm/pose", {"pose": POSE}),
        ("POST", "/services/arm/set_grip", {"value": 101}),
        ("POST", "/services/arm/set_mode", {"words": "x"}),
        ("POST", "/services/arm/set_pose", {"pose": POSE}),
        ("PUT", "/parameters/arm/name", "Robert"),
        ("PUT", "/topics/arm/level", {"data": 2}),
        ("POST", "/resources/arm/aim", {"azimuth": 361, "elevation": 0}),
        ("POST", "/services/arm/aim", {"azimuth": 361, "elevation": 0}),
    ],
)
def test_a_value_beyond_its_limits_is_refused_by_every_way(
    arm: MadeUp, http: httpx.Client, method: str, path: str, body: object
) -> None:
    sent = {"content": json.dumps(body), "headers": {"Content-Type": "application/json"}}
    answer = http.request(method, path, **sent)
    assert answer.status_code == 422, answer.text
    assert answer.json()["violations"]
    report = http.request(method, path, content=sent["content"], headers={**sent["headers"], "Accept": "text/turtle"})
    assert report.status_code == 422
    assert "sh:ValidationReport" in report.text
    assert "sh:sourceConstraintComponent" in report.text
    assert moved(arm) == []
    assert value(http, "/parameters/arm/name") == "Bob"


@pytest.mark.parametrize(
    ("path", "body"),
    [("grip", 0), ("grip", 100), ("mode", "automatic"), ("name", "Eve"), ("level", 0), ("level", 1.25)],
)
def test_a_value_within_its_limits_is_written(http: httpx.Client, path: str, body: object) -> None:
    assert http.put(f"/resources/arm/{path}", json=body).status_code == 204
    assert value(http, f"/resources/arm/{path}") == body


def test_limits_hold_in_rdf_whatever_the_datatype(arm: MadeUp, http: httpx.Client) -> None:
    for term in ("101", '"101"^^<http://www.w3.org/2001/XMLSchema#byte>', "1.01e2", "-1.0"):
        assert http.put("/resources/arm/grip", content=f"<> <{RDF}value> {term} .", headers=TURTLE).status_code == 422
    update = f"DELETE {{ ?p <{RDF}value> ?v }} INSERT {{ ?p <{RDF}value> 101 }} WHERE {{ ?p <{RDF}value> ?v }}"
    assert http.patch("/resources/arm/grip", content=update, headers=UPDATE).status_code == 422
    assert http.patch("/resources/arm/grip", json=101, headers=MERGE).status_code == 422
    assert moved(arm) == []


def test_a_limit_of_one_member_keeps_all_of_a_patch_from_being_written(arm: MadeUp, http: httpx.Client) -> None:
    answer = http.patch("/resources/arm/", json={"mode": "automatic", "grip": 101, "name": "bob"}, headers=MERGE)
    assert answer.status_code == 422
    assert {one["path"] for one in answer.json()["violations"]} == {"grip", "name"}
    assert moved(arm) == []
    assert http.patch("/resources/arm/", json={"mode": "automatic", "grip": 99}, headers=MERGE).status_code == 204


def test_a_tree_of_parameters_is_held_against_the_limits_of_its_leaves(http: httpx.Client) -> None:
    answer = http.put("/parameters/arm", json={"name": "Robert"})
    assert answer.status_code in (409, 422), answer.text
    answer = http.patch("/parameters/arm/", json={"name": "Robert"}, headers=MERGE)
    assert answer.status_code in (405, 415, 422), answer.text
    assert value(http, "/parameters/arm/name") == "Bob"


def test_limits_of_a_field_hold_for_the_whole(arm: MadeUp, http: httpx.Client) -> None:
    mapped(
        http,
        """<#g> a map:ComplexResource ; map:path "/gripper/" ;
             map:property [ map:predicate ex:x ; map:member "/arm/pose" ; map:field "pose.position.x" ] .""",
    )
    assert http.put("/resources/gripper/x", json=11).status_code == 422
    assert http.patch("/resources/gripper/", json={"x": 11}, headers=MERGE).status_code == 422
    far = {"pose": {**POSE, "position": {"x": 11, "y": 0, "z": 0}}}
    assert http.put("/resources/arm/pose", json=far).status_code == 422
    assert http.post("/services/arm/set_pose", json=far).status_code == 422
    assert moved(arm) == []
    assert http.put("/resources/gripper/x", json=10).status_code == 204
    assert value(http, "/resources/gripper/") == {"x": 10.0}


def test_limits_are_told_before_anything_is_sent(http: httpx.Client) -> None:
    properties = http.get("/resources/arm/?format=td").json()["properties"]
    assert (properties["grip"]["minimum"], properties["grip"]["maximum"]) == (0, 100)
    assert properties["mode"]["enum"] == ["manual", "automatic"]
    assert properties["level"]["exclusiveMaximum"] == 1.5
    said = http.get("/resources/arm/grip").text
    assert "sh:maxInclusive 100" in said
    page = http.get("/resources/arm/grip", headers={"Accept": "text/html"}).text
    assert 'max="100"' in page
    assert "not below the floor" in http.put("/resources/arm/pose", json={"pose": POSE}).text


def test_a_limit_never_keeps_a_value_from_being_read(arm: MadeUp, http: httpx.Client) -> None:
    arm.answer("/arm/get_grip", "made_up/srv/GetByte", value=127)
    assert value(http, "/resources/arm/grip") == 127
    assert http.put("/resources/arm/grip", json=127).status_code == 422


@pytest.mark.parametrize("wrong", ["<#a> a", LIMITS.replace("sh:targetNode <resources/arm/grip> ;", "")])
def test_limits_that_cannot_be_held_end_the_start(serving: Serving, limits: Path, wrong: str) -> None:
    limits.write_text(wrong)
    with pytest.raises((AssertionError, ValueError), match=r"limits\.ttl"):
        serving(shapes=(limits,))


def test_a_write_within_limits_asks_for_nothing_else(arm: MadeUp, http: httpx.Client) -> None:
    assert http.put("/resources/arm/grip", json=2).status_code == 204
    assert arm.calls == {"/arm/set_grip": 1}


@pytest.mark.parametrize(
    ("method", "path", "body", "said"),
    [
        ("PUT", "/topics/cmd_vel", {"linear": {"x": "NaN"}}, "linear.x: must be a finite number, not NaN"),
        ("PUT", "/topics/cmd_vel", {"angular": {"z": 1e7}}, "angular.z: must be a number from -1e+06 to 1e+06"),
        ("PATCH", "/topics/cmd_vel", {"linear": {"x": "INF"}}, "linear.x: must be a finite number, not INF"),
        ("POST", "/topics/cmd_vel", {"linear": {"x": "-INF"}}, "linear.x: must be a finite number, not -INF"),
        ("PUT", "/topics/arm/efforts", {"data": [1, 1e300]}, "data.1: must be a number from -3.4e+38 to 3.4e+38"),
        ("POST", "/services/arm/aim", {"azimuth": "NaN"}, "azimuth: must be a finite number, not NaN"),
        ("POST", "/resources/arm/aim", {"azimuth": 1e300, "elevation": 0}, "azimuth: must be a number from"),
        ("PUT", "/resources/cmd_vel", {"linear": {"y": "NaN"}, "angular": {}}, "linear.y: must be a finite number"),
        ("PUT", "/parameters/arm/reach", {"@value": "NaN", "@type": "xsd:double"}, "must be a finite number, not NaN"),
        ("PATCH", "/parameters/arm/", {"reach": 1e300, "name": "Bob"}, "must be a number from"),
    ],
)
def test_a_command_takes_finite_numbers_only_by_every_way_unless_a_setting_names_it(
    robot: MadeUp, serving: Serving, method: str, path: str, body: object, said: str
) -> None:
    robot.topic("/cmd_vel", "geometry_msgs/msg/Twist", published=False, heard=True)
    robot.topic("/arm/efforts", "std_msgs/msg/Float64MultiArray", published=False, heard=True)
    robot.parameter("/arm/reach", 1.0)
    robot.parameter("/arm/name", "Eve")
    robot.answer("/arm/aim", "made_up/srv/Aim", hit=True)
    careful, bold = serving(), serving(allow_non_finite=("/cmd_vel", "/arm/*"))
    media_type = "application/merge-patch+json" if method == "PATCH" else "application/json"
    careful.put("/topics/cmd_vel", json={})
    answers = [
        http.request(
            method,
            path,
            content=json.dumps(body),
            headers={"Content-Type": media_type, "If-Match": "*", "Accept": "application/json"},
        )
        for http in (careful, bold)
    ]
    assert said in detail(answers[0], 422)
    assert "--allow-non-finite" in answers[0].text
    assert answers[1].status_code in (200, 201, 204), answers[1].text


def test_what_another_node_measures_and_whatever_is_read_may_be_no_finite_number(
    robot: MadeUp, serving: Serving
) -> None:
    robot.topic("/range", "std_msgs/msg/Float64", {"data": "NaN"}, heard=True)
    http = serving(allow_publish=("/range",))
    assert value(http, "/topics/range") == {"data": "NaN"}
    assert http.put("/topics/range", json={"data": "INF"}).status_code == 204
    assert robot.sent["/range"] == [{"data": "INF"}]


def test_schemas_and_shapes_of_commands_say_that_their_numbers_are_finite(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/cmd_vel", "geometry_msgs/msg/Twist", published=False, heard=True)
    http = serving()
    described = http.get("/openapi.json").json()["components"]["schemas"]
    speed = {"type": "number", "minimum": -1e6, "maximum": 1e6, "default": 0.0}
    assert described["geometry_msgs.msg.Twist.sent"]["properties"]["linear"]["properties"]["x"] == speed
    thing = value(http, "/.well-known/wot")
    assert thing["actions"]["cmd_vel/hold"]["input"]["properties"]["linear"]["properties"]["x"] == speed
    shape = http.get("/topics/cmd_vel?shape").text
    assert "1000000.0" in shape
    assert '"INF"' not in shape
