"""The paper's Table 2: create, read, update and delete, in HTTP and in ROS. Its dashes are refusals."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from rosld.ontology.vocab import ldp, ros
from tests.paper.conftest import SERVICES, Flight

HEADING = "/parameters/paper/heading"
ALTITUDE = "/parameters/paper/altitude"
DISPLAY, SPEED = "/topics/cockpit/display", "/topics/aircraft/engine/speed"
POWER, DIRECTION = "/resources/aircraft/power", "/resources/aircraft/engine/direction"
STRING = "https://w3id.org/rosld/types/std_msgs/msg/String"


@pytest.fixture(autouse=True)
def clean(flight: Flight) -> Iterator[None]:
    """Delete the parameters that a test has created."""
    yield
    flight.http.delete("/parameters/paper/")


# Parameter: setParam, getParam, setParam, deleteParam


def test_parameter_is_created_read_updated_and_deleted_at_its_url(flight: Flight) -> None:
    assert flight.get(ALTITUDE).status_code == 404
    assert flight.put(ALTITUDE, 3000).status_code == 201
    assert flight.json(ALTITUDE) == 3000
    assert flight.put(ALTITUDE, 3500).status_code == 204
    assert flight.json(ALTITUDE) == 3500
    assert flight.patch(ALTITUDE, 4000).status_code == 204
    resource = "/resources/paper/altitude"
    assert flight.json(resource) == 4000
    assert flight.put(resource, 4500).status_code == 204
    assert flight.json(ALTITUDE) == 4500
    assert flight.http.delete(ALTITUDE).status_code == 204
    assert flight.get(ALTITUDE).status_code == 404


# HTTP resource: POST/PUT, GET, PUT/PATCH, DELETE


def test_http_a_collection_creates_a_resource_on_post_lists_it_and_is_deleted(flight: Flight) -> None:
    flight.put(ALTITUDE, 3000)
    made = flight.http.post("/parameters/paper/", json=270, headers={"Slug": "heading"})
    assert (made.status_code, flight.path(made.headers["location"])) == (201, HEADING)
    assert flight.said("/parameters/paper/", ldp.contains) == {ALTITUDE, HEADING}
    assert flight.json("/parameters/paper/") == {"altitude": 3000, "heading": 270}
    assert flight.http.delete("/parameters/paper/").status_code == 204
    assert flight.get("/parameters/paper/").status_code == 404


def test_http_patch_updates_a_part_and_leaves_the_rest(flight: Flight) -> None:
    for name, value in {"plan/from": "FKB", "plan/to/airport": "TXL", "plan/to/gate": 4}.items():
        assert flight.put(f"/parameters/paper/{name}", value).status_code == 201
    answer = flight.patch("/parameters/paper/", {"plan": {"to": {"gate": 5}}})
    assert answer.status_code == 204, answer.text
    assert flight.json("/parameters/paper/plan/") == {"from": "FKB", "to": {"airport": "TXL", "gate": 5}}


# Service: -, get*, set*, -


def test_service_cannot_be_created(flight: Flight) -> None:
    for path in ("/services/aircraft/land", "/resources/aircraft/land"):
        for method in ("PUT", "PATCH"):
            assert flight.http.request(method, path, json={}).status_code in (404, 405)
        assert flight.get(path).status_code == 404
    assert flight.http.post("/services/aircraft/", json={}, headers={"Slug": "land"}).status_code == 405


def test_service_cannot_be_deleted(flight: Flight) -> None:
    flight.standing()
    names = ("power", "engine/direction", "engine/speed", "start")
    for path in (*(f"/services{name}" for name in SERVICES), *(f"/resources/aircraft/{name}" for name in names)):
        refused = flight.http.delete(path)
        assert refused.status_code == 405, path
        assert "DELETE" not in refused.headers["allow"]
    assert flight.ask("/aircraft/get_power") == "on"


# Topic subscriber: -, -, publish, -


def test_topic_subscriber_update_is_to_publish(flight: Flight) -> None:
    for url, body in ((DISPLAY, {"data": "to the topic"}), ("/resources/cockpit/display", "to it")):
        assert flight.put(url, body).status_code == 204, "somebody heard it"
        assert flight.json(url) == body  # a dash in the paper, as the URL is the topic's


def test_topic_subscriber_cannot_be_created_or_deleted(flight: Flight) -> None:
    assert flight.http.post("/topics/cockpit/", json={}, headers={"Slug": "radio"}).status_code == 405
    flight.http.delete(DISPLAY)  # only takes back what rosld advertised
    refused = flight.http.delete(DISPLAY)
    assert refused.status_code == 405
    assert "DELETE" not in refused.headers["allow"]
    assert flight.said(DISPLAY, ros.subscribedBy) >= {"/nodes/cockpit"}


def test_topic_that_the_robot_publishes_only_allows_get(flight: Flight) -> None:
    for method in ("PUT", "PATCH", "POST", "DELETE"):
        refused = flight.http.request(method, SPEED, json={"data": 900})
        assert (refused.status_code, refused.headers["allow"]) == (405, "GET, HEAD, OPTIONS")
    assert flight.said(SPEED, ros.publishedBy) == {"/nodes/aircraft"}


def test_topic_of_rosld_s_own_is_created_by_put_and_deleted_where_the_paper_has_dashes(flight: Flight) -> None:
    path = "/topics/paper/radio"
    body = f'<#message> a <{STRING}> ; <{STRING}#data> "mayday" .'
    made = flight.http.put(path, content=body, headers={"Content-Type": "text/turtle"})
    assert made.status_code == 201, made.text
    assert flight.said(path, ros.publishedBy) == {"/nodes/rosld"}
    assert flight.json(path) == {"data": "mayday"}
    assert flight.http.delete(path).status_code == 204
    assert flight.get(path).status_code == 404
