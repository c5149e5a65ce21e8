"""Limits on writes over HTTP: a value beyond them is refused on every route to it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.crawl.description import Description
from tests.server.robots import asking
from tests.server.robots.made_up import MadeUp, Serving, served

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
    """An arm with a writable resource of each kind."""
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
    """Return the writes that the arm received."""
    return [name for name in arm.calls if "/get_" not in name] + list(arm.sent)


POSE = {"position": {"x": 0, "y": 0, "z": -1}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}


def test_a_value_beyond_its_limits_is_refused_by_every_way(arm: MadeUp, http: httpx.Client) -> None:
    for method, path, body in (
        ("PUT", "/resources/arm/grip", 101),
        ("PUT", "/resources/arm/grip", {"value": -1}),
        ("PUT", "/resources/arm/mode", "Manual"),
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
    ):
        answer = http.request(method, path, json=body)
        assert answer.status_code == 422, (path, answer.text)
        assert answer.json()["violations"]
        report = http.request(method, path, json=body, headers={"Accept": "text/turtle"})
        assert report.status_code == 422
        assert "sh:ValidationReport" in report.text
        assert "sh:sourceConstraintComponent" in report.text
    assert "not below the floor" in http.put("/resources/arm/pose", json={"pose": POSE}).text
    for term in ("101", '"101"^^<http://www.w3.org/2001/XMLSchema#byte>', "1.01e2", "-1.0"):
        assert http.put("/resources/arm/grip", content=f"<> <{RDF}value> {term} .", headers=TURTLE).status_code == 422
    update = f"DELETE {{ ?p <{RDF}value> ?v }} INSERT {{ ?p <{RDF}value> 101 }} WHERE {{ ?p <{RDF}value> ?v }}"
    assert http.patch("/resources/arm/grip", content=update, headers=UPDATE).status_code == 422
    assert http.patch("/resources/arm/grip", json=101, headers=MERGE).status_code == 422
    patch = http.patch("/resources/arm/", json={"mode": "automatic", "grip": 101, "name": "bob"}, headers=MERGE)
    assert patch.status_code == 422
    assert {one["path"] for one in patch.json()["violations"]} == {"grip", "name"}
    assert http.put("/parameters/arm", json={"name": "Robert"}).status_code in (409, 422)
    assert http.patch("/parameters/arm/", json={"name": "Robert"}, headers=MERGE).status_code in (405, 415, 422)
    assert moved(arm) == []
    assert value(http, "/parameters/arm/name") == "Bob"


def test_a_value_within_its_limits_is_written_and_what_is_read_has_none(arm: MadeUp, http: httpx.Client) -> None:
    assert http.put("/resources/arm/grip", json=2).status_code == 204
    assert arm.calls == {"/arm/set_grip": 1}, "nothing else is asked for"
    for path, body in (
        ("grip", 0),
        ("grip", 100),
        ("mode", "automatic"),
        ("name", "Eve"),
        ("level", 0),
        ("level", 1.25),
    ):
        assert http.put(f"/resources/arm/{path}", json=body).status_code == 204
        assert value(http, f"/resources/arm/{path}") == body
    assert http.patch("/resources/arm/", json={"mode": "automatic", "grip": 99}, headers=MERGE).status_code == 204
    arm.answer("/arm/get_grip", "made_up/srv/GetByte", value=127)
    assert value(http, "/resources/arm/grip") == 127
    assert http.put("/resources/arm/grip", json=127).status_code == 422


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


def test_limits_that_cannot_be_used_end_the_start(serving: Serving, limits: Path) -> None:
    for wrong in ("<#a> a", LIMITS.replace("sh:targetNode <resources/arm/grip> ;", "")):
        limits.write_text(wrong)
        with pytest.raises((AssertionError, ValueError), match=r"limits\.ttl"):
            serving(shapes=(limits,))


NOT_FINITE: tuple[tuple[str, str, object, str], ...] = (
    ("PUT", "/topics/cmd_vel", {"linear": {"x": "NaN"}}, "linear.x: must be a finite number, not NaN"),
    ("PUT", "/topics/cmd_vel", {"angular": {"z": 1e7}}, "angular.z: must be a number from -1e+06 to 1e+06"),
    ("PATCH", "/topics/cmd_vel", {"linear": {"x": "INF"}}, "linear.x: must be a finite number, not INF"),
    ("PUT", "/topics/arm/efforts", {"data": [1, 1e300]}, "data.1: must be a number from -3.4e+38 to 3.4e+38"),
    ("POST", "/services/arm/aim", {"azimuth": "NaN"}, "azimuth: must be a finite number, not NaN"),
    ("POST", "/resources/arm/aim", {"azimuth": 1e300, "elevation": 0}, "azimuth: must be a number from"),
    ("PUT", "/resources/cmd_vel", {"linear": {"y": "NaN"}, "angular": {}}, "linear.y: must be a finite number"),
    ("PUT", "/parameters/arm/reach", {"@value": "NaN", "@type": "xsd:double"}, "must be a finite number, not NaN"),
    ("PATCH", "/parameters/arm/", {"reach": 1e300, "name": "Bob"}, "must be a number from"),
    ("POST", "/topics/cmd_vel", {"linear": {"x": "-INF"}}, "linear.x: must be a finite number, not -INF"),
)
"""The last one holds its topic."""


def test_a_command_takes_only_finite_numbers_by_every_way_unless_a_setting_names_it() -> None:
    def command(http: httpx.Client, method: str, path: str, body: object) -> httpx.Response:
        kind = "application/merge-patch+json" if method == "PATCH" else "application/json"
        headers = {"Content-Type": kind, "If-Match": "*", "Accept": "application/json"}
        return http.request(method, path, content=json.dumps(body), headers=headers)

    for settings in (dict[str, Any](), {"allow_non_finite": ("/cmd_vel", "/arm/*")}):
        robot = MadeUp()
        robot.topic("/cmd_vel", "geometry_msgs/msg/Twist", published=False, heard=True)
        robot.topic("/arm/efforts", "std_msgs/msg/Float64MultiArray", published=False, heard=True)
        robot.parameter("/arm/reach", 1.0)
        robot.parameter("/arm/name", "Eve")
        robot.answer("/arm/aim", "made_up/srv/Aim", hit=True)
        with served(robot, **settings) as http:
            http.put("/topics/cmd_vel", json={})
            for method, path, body, said in NOT_FINITE:
                answer = command(http, method, path, body)
                if settings:
                    assert answer.status_code in (200, 201, 204), (path, answer.text)
                else:
                    assert said in detail(answer, 422)
                    assert "--allow-non-finite" in answer.text


def test_a_measurement_may_be_no_finite_number(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/range", "std_msgs/msg/Float64", {"data": "NaN"}, heard=True)
    http = serving(allow_publish=("/range",))
    assert value(http, "/topics/range") == {"data": "NaN"}
    assert http.put("/topics/range", json={"data": "INF"}).status_code == 204
    assert robot.sent["/range"] == [{"data": "INF"}]


def test_schemas_and_shapes_of_commands_say_that_their_numbers_are_finite(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/cmd_vel", "geometry_msgs/msg/Twist", published=False, heard=True)
    http = serving()
    description = Description(http.get("/openapi.json").json())
    speed = {"type": "number", "minimum": -1e6, "maximum": 1e6, "default": 0.0}
    unit = "http://qudt.org/vocab/unit/M-PER-SEC"
    twist = description.document["components"]["schemas"]["geometry_msgs.msg.Twist.sent"]["properties"]
    assert description.resolved(twist["linear"])["properties"]["x"] == {**speed, "x-unit": unit}
    held = value(http, "/.well-known/wot")["actions"]["cmd_vel/hold"]["input"]["properties"]
    assert held["linear"]["properties"]["x"] == {**speed, "unit": unit}
    shape = http.get("/topics/cmd_vel?shape").text
    assert "1000000.0" in shape
    assert '"INF"' not in shape
