"""The paper's Listing 1: the aircraft's topic and services, each line as a resource (level one)."""

from __future__ import annotations

from typing import Any

import pytest

from rosld.ontology.vocab import ros
from tests.paper.conftest import JSON, SERVICES, Flight
from tests.waiting import until

pytestmark = pytest.mark.slow

TYPES = "https://w3id.org/rosld/types/"
SPEED = "/topics/aircraft/engine/speed"


def called(flight: Flight, service: str, request: object | None = None) -> Any:
    """Return the response of a service; the call is a new resource."""
    answer = flight.post(f"/services{service}", request, JSON)
    assert answer.status_code == 201, answer.text
    assert flight.path(answer.headers["location"]).startswith("/calls/")
    return answer.json()


def refused(flight: Flight, service: str, value: object) -> None:
    """Check that a value outside of the line's range does not fit, and that the service is not called."""
    before = flight.calls()
    answer = flight.post(f"/services{service}", {"data": value}, JSON)
    assert (answer.status_code, answer.json()["title"]) == (422, "Does not fit"), answer.text
    assert answer.json()["violations"]
    assert flight.calls() == before


def test_every_service_is_a_resource_that_tells_its_type_and_is_called_with_post(flight: Flight) -> None:
    for service, type in SERVICES.items():
        assert flight.said(f"/services{service}", ros.hasServiceType) == {TYPES + type}
        assert flight.allowed(f"/services{service}") == {"GET", "POST"}, service


def test_topic_speed_informs_of_a_number_from_0_to_1000(flight: Flight) -> None:
    assert flight.said(SPEED, ros.hasMessageType) == {f"{TYPES}std_msgs/msg/Float64"}
    flight.standing()
    assert flight.json(SPEED) == {"data": 0.0}
    called(flight, "/aircraft/engine/set_speed", {"data": 10.0})
    after = flight.get(SPEED).headers["etag"]

    def has_speed() -> bool:
        nonlocal after
        answer = flight.http.get(SPEED, params={"after": after, "timeout": "5"}, headers={"Accept": JSON})
        assert answer.status_code == 200  # each answer waits for a newer message than the one before
        after = answer.headers["etag"]
        return bool(answer.json() == {"data": 10.0})

    until(has_speed, "the speed")


def test_service_start_starts_once(flight: Flight) -> None:
    flight.off()
    assert called(flight, "/aircraft/start") == {"success": True, "message": "started"}
    assert flight.ask("/aircraft/get_power") == "on"
    assert called(flight, "/aircraft/start")["success"] is False


def test_service_stop_stops_at_rest_only(flight: Flight) -> None:
    flight.flying()
    assert called(flight, "/aircraft/stop")["success"] is False
    assert flight.ask("/aircraft/get_power") == "on"
    flight.standing()
    assert called(flight, "/aircraft/stop")["success"] is True
    assert flight.ask("/aircraft/get_power") == "off"


def test_service_set_power_takes_on_or_off_and_get_power_gives_it(flight: Flight) -> None:
    flight.off()
    for word in ("on", "off"):
        assert called(flight, "/aircraft/set_power", {"data": word})["success"] is True
        assert called(flight, "/aircraft/get_power") == {"data": word}
    refused(flight, "/aircraft/set_power", "maybe")
    assert called(flight, "/aircraft/get_power") == {"data": "off"}


def test_service_set_speed_takes_0_to_1000(flight: Flight) -> None:
    flight.standing()
    for value in (0.0, 1000.0, 20.0):
        assert called(flight, "/aircraft/engine/set_speed", {"data": value})["success"] is True
    for value in (-0.5, 1000.5):
        refused(flight, "/aircraft/engine/set_speed", value)
    until(lambda: flight.robot_speed() == 20.0, "the last speed within the range")


def test_service_set_direction_takes_0_to_360_and_get_direction_gives_it(flight: Flight) -> None:
    flight.standing()
    for value in (0.0, 360.0, 45.5):
        assert called(flight, "/aircraft/engine/set_direction", {"data": value})["success"] is True
        assert called(flight, "/aircraft/engine/get_direction") == {"data": value}
    for value in (-0.5, 360.5):
        refused(flight, "/aircraft/engine/set_direction", value)
    assert called(flight, "/aircraft/engine/get_direction") == {"data": 45.5}
