"""The paper's Table 2: create, read, update and delete, of HTTP and of what ROS has. Its dashes are refusals."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from rosld.ontology.vocab import ldp, ros

HEADING = "/parameters/paper/heading"
ALTITUDE = "/parameters/paper/altitude"
DISPLAY, SPEED = "/topics/cockpit/display", "/topics/aircraft/engine/speed"
POWER, DIRECTION = "/resources/aircraft/power", "/resources/aircraft/engine/direction"
STRING = "https://w3id.org/rosld/types/std_msgs/msg/String"
SERVICES = (
    "/aircraft/start",
    "/aircraft/stop",
    "/aircraft/set_power",
    "/aircraft/get_power",
    "/aircraft/engine/set_speed",
    "/aircraft/engine/set_direction",
    "/aircraft/engine/get_direction",
)


@pytest.fixture(autouse=True)
def clean(flight: Any) -> Iterator[None]:
    """What a test has created is gone after it."""
    yield
    flight.http.delete("/parameters/paper/")
    for one in parameters(flight, "/parameters/paper/"):  # where a tree is not deleted whole
        flight.http.delete(one)


def parameters(flight: Any, tree: str) -> list[str]:
    """All parameters in a tree, if it is there."""
    if flight.get(tree).status_code != 200:
        return []
    found = flight.said(tree, ldp.contains)
    return [each for one in found for each in (parameters(flight, one) if one.endswith("/") else [one])]


# HTTP resource: POST/PUT, GET, PUT/PATCH, DELETE


def test_http_an_atomic_resource_is_created_read_updated_and_deleted_at_its_url(flight: Any) -> None:
    assert flight.get(ALTITUDE).status_code == 404
    assert flight.put(ALTITUDE, 3000).status_code == 201
    assert flight.json(ALTITUDE) == 3000
    assert flight.put(ALTITUDE, 3500).status_code == 204
    assert flight.json(ALTITUDE) == 3500
    assert flight.http.delete(ALTITUDE).status_code == 204
    assert flight.get(ALTITUDE).status_code == 404


def test_http_a_collection_creates_a_resource_on_post_lists_it_and_is_deleted(flight: Any) -> None:
    flight.put(ALTITUDE, 3000)
    made = flight.http.post("/parameters/paper/", json=270, headers={"Slug": "heading"})
    assert (made.status_code, flight.path(made.headers["location"])) == (201, HEADING)
    assert {ALTITUDE, HEADING} <= flight.said("/parameters/paper/", ldp.contains)
    assert flight.json("/parameters/paper/").items() >= {"altitude": 3000, "heading": 270}.items()
    if "DELETE" in flight.get("/parameters/paper/").headers["allow"]:
        assert flight.http.delete("/parameters/paper/").status_code == 204
        assert flight.get("/parameters/paper/").status_code == 404
    else:  # parameters of a node, which has others too
        assert [flight.http.delete(each).status_code for each in (ALTITUDE, HEADING)] == [204, 204]
        assert not {ALTITUDE, HEADING} & flight.said("/parameters/paper/", ldp.contains)


def test_http_patch_updates_a_part_and_leaves_the_rest(flight: Any) -> None:
    for name, value in {"plan/from": "FKB", "plan/to/airport": "TXL", "plan/to/gate": 4}.items():
        assert flight.put(f"/parameters/paper/{name}", value).status_code == 201
    answer = flight.patch("/parameters/paper/", {"plan": {"to": {"gate": 5}}})
    assert answer.status_code == 204, answer.text
    for name, value in {"plan/from": "FKB", "plan/to/airport": "TXL", "plan/to/gate": 5}.items():
        assert flight.robot.parameter(f"/paper/{name}") == value


# Service: -, get*, set*, -


def test_service_read_is_the_call_of_its_getter(flight: Any) -> None:
    flight.off()
    assert flight.said(POWER, ros.readsFrom) == {"/services/aircraft/get_power"}
    assert flight.json(POWER) == flight.robot.ask("/aircraft/get_power") == "off"


def test_service_update_is_the_call_of_its_setter(flight: Any) -> None:
    flight.standing()
    assert flight.said(DIRECTION, ros.writesTo) == {"/services/aircraft/engine/set_direction"}
    assert flight.put(DIRECTION, 90).status_code == 204
    assert flight.robot.ask("/aircraft/engine/get_direction") == 90


@pytest.mark.parametrize("verb", ["PUT", "PATCH"])
def test_service_cannot_be_created(flight: Any, verb: str) -> None:
    for path in ("/services/aircraft/land", "/resources/aircraft/land"):
        assert flight.http.request(verb, path, json={}).status_code in (404, 405)
        assert flight.get(path).status_code == 404
    assert flight.http.post("/services/aircraft/", json={}, headers={"Slug": "land"}).status_code == 405
    assert "/aircraft/land" not in flight.robot.names()["services"]


@pytest.mark.parametrize("service", SERVICES)
def test_service_cannot_be_deleted(flight: Any, service: str) -> None:
    refused = flight.http.delete(f"/services{service}")
    assert refused.status_code == 405
    assert "DELETE" not in refused.headers["allow"]
    assert "DELETE" not in flight.allowed(f"/services{service}")
    assert service in flight.robot.names()["services"]


@pytest.mark.parametrize("name", ["power", "engine/direction", "engine/speed", "start"])
def test_service_cannot_be_deleted_as_a_resource_either(flight: Any, name: str) -> None:
    flight.standing()
    refused = flight.http.delete(f"/resources/aircraft/{name}")
    assert refused.status_code == 405
    assert "DELETE" not in refused.headers["allow"]


# Topic subscriber: -, -, publish, -


@pytest.mark.parametrize(
    ("url", "body"), [(DISPLAY, {"data": "to the topic"}), ("/resources/cockpit/display", "to it")]
)
def test_topic_subscriber_update_is_to_publish(flight: Any, url: str, body: object) -> None:
    flight.publish(url, body)
    flight.robot.heard_in_the_cockpit(body["data"] if isinstance(body, dict) else body)


def test_topic_subscriber_cannot_be_created_or_deleted(flight: Any) -> None:
    assert flight.http.post("/topics/cockpit/", json={}, headers={"Slug": "radio"}).status_code == 405
    flight.http.delete(DISPLAY)  # takes back what rosld advertised, no more
    refused = flight.http.delete(DISPLAY)
    assert refused.status_code == 405
    assert "DELETE" not in refused.headers["allow"]
    assert flight.said(DISPLAY, ros.subscribedBy) >= {"/nodes/cockpit"}


def test_topic_subscriber_can_be_read_where_the_paper_has_a_dash_for_its_url_is_the_topic_s(flight: Any) -> None:
    flight.publish(DISPLAY, {"data": "read me"})
    flight.robot.heard_in_the_cockpit("read me")
    assert flight.json(DISPLAY) == {"data": "read me"}


def test_topic_that_the_robot_publishes_only_allows_get(flight: Any) -> None:
    assert flight.allowed(SPEED) == {"GET"}
    for verb in ("PUT", "PATCH", "POST", "DELETE"):
        refused = flight.http.request(verb, SPEED, json={"data": 900})
        assert (refused.status_code, refused.headers["allow"]) == (405, "GET, HEAD, OPTIONS")
    assert flight.robot.publishers("/aircraft/engine/speed") == {"/aircraft"}


def test_topic_of_rosld_s_own_is_created_by_put_and_deleted_where_the_paper_has_dashes(flight: Any) -> None:
    path, name = "/topics/paper/radio", "/paper/radio"
    body = f'<#message> a <{STRING}> ; <{STRING}#data> "mayday" .'
    made = flight.http.put(path, content=body, headers={"Content-Type": "text/turtle"})
    assert made.status_code == 201, made.text
    flight.until(lambda: flight.robot.publishers(name), f"a publisher of {name}")
    assert flight.json(path) == {"data": "mayday"}
    assert flight.http.delete(path).status_code == 204
    flight.until(lambda: not flight.robot.publishers(name), f"no publisher of {name}")


# Parameter: setParam, getParam, setParam, deleteParam


def test_parameter_create_is_set_param(flight: Any) -> None:
    assert flight.put(ALTITUDE, 3000).status_code == 201
    assert flight.robot.parameter("/paper/altitude") == 3000


def test_parameter_read_is_get_param(flight: Any) -> None:
    for name in ("/aircraft/registration", "/aircraft/engine/limits/temperature", "/cockpit/checklist"):
        assert flight.json(f"/parameters{name}") == flight.robot.parameter(name)


def test_parameter_update_is_set_param(flight: Any) -> None:
    flight.put(ALTITUDE, 3000)
    assert flight.put(ALTITUDE, 3500).status_code == 204
    assert flight.robot.parameter("/paper/altitude") == 3500
    assert flight.patch(ALTITUDE, 4000).status_code == 204
    assert flight.robot.parameter("/paper/altitude") == 4000


def test_parameter_delete_is_delete_param(flight: Any) -> None:
    flight.put(ALTITUDE, 3000)
    assert flight.http.delete(ALTITUDE).status_code == 204
    assert flight.robot.parameter("/paper/altitude") is None


def test_parameter_is_read_and_updated_as_a_resource_too(flight: Any) -> None:
    flight.put(ALTITUDE, 3000)
    resource = "/resources/paper/altitude"
    flight.until(lambda: flight.get(resource).status_code == 200, resource)
    assert flight.put(resource, 3500).status_code == 204
    assert flight.robot.parameter("/paper/altitude") == 3500
