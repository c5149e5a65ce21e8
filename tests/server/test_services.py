"""Services over HTTP: POST calls, the call is a resource."""

from __future__ import annotations

import httpx
import pytest

TYPES = "https://w3id.org/rosld/types/"
JSON = {"Accept": "application/json"}


@pytest.fixture
def plane(own_aircraft: httpx.Client) -> httpx.Client:
    """An aircraft for one test, at rest."""
    return own_aircraft


def test_a_call_is_201_with_its_location_and_the_answer_as_json(plane: httpx.Client) -> None:
    refused = plane.post("/services/aircraft/engine/set_speed", json={"data": 100.0}, headers=JSON)
    assert (refused.status_code, refused.json()["success"]) == (201, False), "a refusal is a failed call"
    assert refused.json()["message"]
    assert "Failed" in plane.get(refused.headers["location"]).text
    answer = plane.post("/services/aircraft/start", json={}, headers=JSON)
    assert (answer.status_code, answer.json()["success"]) == (201, True)
    location = answer.headers["location"]
    call = plane.get(location)
    assert (call.status_code, "Succeeded" in call.text) == (200, True)
    assert location.rpartition("/")[2] in plane.get("/calls/").text
    assert plane.delete(location).status_code == 204
    assert plane.get(location).status_code == 410
    assert plane.get("/calls/never-was").status_code == 404


def test_a_request_that_does_not_fit_is_422_naming_the_field_and_nothing_is_called(plane: httpx.Client) -> None:
    json_body = {"Content-Type": "application/json"}
    for body, path in (
        ('{"data": "fast"}', "data"),
        ("", "data"),
        ('{"data": 1, "extra": 2}', "extra"),
        ('{"data": null}', "data"),
    ):
        answer = plane.post("/services/aircraft/engine/set_speed", content=body, headers=json_body)
        assert answer.status_code == 422
        assert [violation["path"] for violation in answer.json()["violations"]] == [path]
        assert "constrainedBy" in answer.headers["link"]
    assert f"{TYPES}rosld_aircraft" not in plane.get("/calls/").text
    for method in ("GET", "POST"):
        assert plane.request(method, "/services/aircraft/eject").status_code == 404
