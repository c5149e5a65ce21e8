"""Services over HTTP: POST calls, the call is a resource."""

from __future__ import annotations

import json

import httpx
import pytest

TYPES = "https://w3id.org/rosld/types/"
JSON = {"Accept": "application/json"}


@pytest.fixture
def plane(own_aircraft: httpx.Client) -> httpx.Client:
    """An aircraft of this test's own, standing."""
    return own_aircraft


def test_a_call_is_201_with_its_location_and_the_answer_as_json(plane: httpx.Client) -> None:
    answer = plane.post("/services/aircraft/start", headers=JSON)
    assert answer.status_code == 201, answer.text
    assert answer.json()["success"] is True
    call = plane.get(answer.headers["location"])
    assert call.status_code == 200
    assert "Succeeded" in call.text


def test_an_empty_object_is_an_empty_request(plane: httpx.Client) -> None:
    assert plane.post("/services/aircraft/start", json={}).status_code == 201


def test_a_refusal_by_the_service_is_a_failed_call_and_still_201(plane: httpx.Client) -> None:
    answer = plane.post("/services/aircraft/engine/set_speed", json={"data": 100.0}, headers=JSON)
    assert answer.status_code == 201
    assert answer.json()["success"] is False
    assert answer.json()["message"]
    assert "Failed" in plane.get(answer.headers["location"]).text


def test_the_request_may_be_rdf(plane: httpx.Client) -> None:
    plane.post("/services/aircraft/start")
    request = f"{TYPES}rosld_aircraft/srv/SetNumber_Request"
    body = json.dumps(
        {"@type": request, f"{request}#data": {"@value": "200", "@type": "http://www.w3.org/2001/XMLSchema#integer"}}
    )
    answer = plane.post(
        "/services/aircraft/engine/set_speed", content=body, headers={"Content-Type": "application/ld+json", **JSON}
    )
    assert answer.status_code == 201, answer.text
    assert answer.json()["success"] is True


@pytest.mark.parametrize(
    ("body", "path"),
    [('{"data": "fast"}', "data"), ("", "data"), ('{"data": 1, "extra": 2}', "extra"), ('{"data": null}', "data")],
)
def test_a_request_that_does_not_fit_is_422_naming_the_field_and_nothing_is_called(
    plane: httpx.Client, body: str, path: str
) -> None:
    answer = plane.post(
        "/services/aircraft/engine/set_speed", content=body, headers={"Content-Type": "application/json"}
    )
    assert answer.status_code == 422
    assert [violation["path"] for violation in answer.json()["violations"]] == [path]
    assert f"{TYPES}rosld_aircraft" not in plane.get("/calls/").text
    assert "constrainedBy" in answer.headers["link"]


def test_the_same_idempotency_key_calls_once(plane: httpx.Client) -> None:
    headers = {"Idempotency-Key": "take-off-1", **JSON}
    first = plane.post("/services/aircraft/start", headers=headers)
    second = plane.post("/services/aircraft/start", headers=headers)
    assert first.json() == second.json() == {"success": True, "message": first.json()["message"]}
    assert first.headers["location"] == second.headers["location"]
    other = plane.post("/services/aircraft/start", json={}, headers=headers)
    assert other.status_code == 422


def test_a_call_can_be_forgotten_and_is_then_gone(plane: httpx.Client) -> None:
    location = plane.post("/services/aircraft/start").headers["location"]
    assert location in plane.get("/calls/").text or location.rpartition("/")[2] in plane.get("/calls/").text
    assert plane.delete(location).status_code == 204
    assert plane.get(location).status_code == 410
    assert plane.get("/calls/never-was").status_code == 404


def test_a_service_that_is_not_there_is_404(plane: httpx.Client) -> None:
    assert plane.post("/services/aircraft/eject").status_code == 404
    assert plane.get("/services/aircraft/eject").status_code == 404


def test_the_paper_s_aircraft_flies(plane: httpx.Client) -> None:
    def call(name: str, **request: object) -> dict[str, object]:
        return plane.post(f"/services/aircraft/{name}", json=request, headers=JSON).json()

    assert call("get_power") == {"data": "off"}
    assert call("set_power", data="on")["success"] is True
    assert call("engine/set_direction", data=90)["success"] is True
    assert call("engine/get_direction") == {"data": 90.0}
    assert call("engine/set_speed", data=50)["success"] is True
    assert call("stop")["success"] is False
    assert call("engine/set_speed", data=0)["success"] is True
