"""The paper's Listing 1: the aircraft's topic and services, each line at its own URL (level one)."""

from __future__ import annotations

from typing import Any

import pytest

from rosld.ontology.vocab import ros

TYPES = "https://w3id.org/rosld/types/"
SPEED = "/topics/aircraft/engine/speed"
LINES = {
    "/aircraft/start": "std_srvs/srv/Trigger",
    "/aircraft/stop": "std_srvs/srv/Trigger",
    "/aircraft/set_power": "rosld_aircraft/srv/SetText",
    "/aircraft/get_power": "rosld_aircraft/srv/GetText",
    "/aircraft/engine/set_speed": "rosld_aircraft/srv/SetNumber",
    "/aircraft/engine/set_direction": "rosld_aircraft/srv/SetNumber",
    "/aircraft/engine/get_direction": "rosld_aircraft/srv/GetNumber",
}


def called(flight: Any, service: str, request: object | None = None) -> Any:
    """What a service answers; the call is a new resource."""
    answer = flight.post(f"/services{service}", request, "application/json")
    assert answer.status_code == 201, answer.text
    assert flight.path(answer.headers["location"]).startswith("/calls/")
    return answer.json()


def refused(flight: Any, service: str, value: object) -> None:
    """A value is outside of the line's range: it does not fit, and the service was not called."""
    before = flight.calls()
    answer = flight.post(f"/services{service}", {"data": value}, "application/json")
    assert (answer.status_code, answer.json()["title"]) == (422, "Does not fit"), answer.text
    assert answer.json()["violations"]
    assert flight.calls() == before


@pytest.mark.parametrize("service", LINES)
def test_every_service_is_a_resource_that_tells_its_type_and_is_called_with_post(flight: Any, service: str) -> None:
    assert flight.said(f"/services{service}", ros.hasServiceType) == {TYPES + LINES[service]}
    assert flight.allowed(f"/services{service}") == {"GET", "POST"}


def test_topic_speed_tells_a_number_from_0_to_1000(flight: Any) -> None:
    assert flight.said(SPEED, ros.hasMessageType) == {f"{TYPES}std_msgs/msg/Float64"}
    flight.off()
    assert flight.json(SPEED) == {"data": 0.0}
    flight.flying()
    assert flight.json(SPEED)["data"] == flight.robot.hear("/aircraft/engine/speed") == 20.0


def test_topic_speed_informs_of_the_changed_speed(flight: Any) -> None:
    flight.standing()
    called(flight, "/aircraft/engine/set_speed", {"data": 10.0})
    after = flight.get(SPEED).headers["etag"]

    def told() -> bool:
        nonlocal after
        answer = flight.http.get(SPEED, params={"after": after, "timeout": "5"}, headers={"Accept": "application/json"})
        assert answer.status_code == 200  # each answer waits for another message than the one before
        after = answer.headers["etag"]
        return bool(answer.json() == {"data": 10.0})

    flight.until(told, "the speed")


def test_service_start_starts_once(flight: Any) -> None:
    flight.off()
    assert called(flight, "/aircraft/start") == {"success": True, "message": "started"}
    assert flight.robot.ask("/aircraft/get_power") == "on"
    assert called(flight, "/aircraft/start")["success"] is False


def test_service_stop_stops_at_rest_only(flight: Any) -> None:
    flight.flying()
    assert called(flight, "/aircraft/stop")["success"] is False
    assert flight.robot.ask("/aircraft/get_power") == "on"
    flight.standing()
    assert called(flight, "/aircraft/stop")["success"] is True
    assert flight.robot.ask("/aircraft/get_power") == "off"


def test_service_set_power_takes_on_or_off(flight: Any) -> None:
    flight.off()
    assert called(flight, "/aircraft/set_power", {"data": "on"})["success"] is True
    assert flight.robot.ask("/aircraft/get_power") == "on"
    assert called(flight, "/aircraft/set_power", {"data": "off"})["success"] is True
    refused(flight, "/aircraft/set_power", "maybe")
    assert flight.robot.ask("/aircraft/get_power") == "off"


def test_service_get_power_gives_on_or_off(flight: Any) -> None:
    flight.off()
    assert called(flight, "/aircraft/get_power") == {"data": "off"}
    flight.standing()
    assert called(flight, "/aircraft/get_power") == {"data": "on"}


def test_service_set_speed_takes_0_to_1000(flight: Any) -> None:
    flight.standing()
    for value in (0.0, 1000.0, 20.0):
        assert called(flight, "/aircraft/engine/set_speed", {"data": value})["success"] is True
    for value in (-0.5, 1000.5):
        refused(flight, "/aircraft/engine/set_speed", value)
    flight.until(lambda: flight.robot_speed() == 20.0, "the speed that was taken")
    assert flight.robot.hear("/aircraft/engine/speed") == 20.0


def test_service_set_direction_takes_0_to_360(flight: Any) -> None:
    flight.standing()
    for value in (0.0, 360.0, 270.0):
        assert called(flight, "/aircraft/engine/set_direction", {"data": value})["success"] is True
    for value in (-0.5, 360.5):
        refused(flight, "/aircraft/engine/set_direction", value)
    assert flight.robot.ask("/aircraft/engine/get_direction") == 270.0


def test_service_get_direction_gives_0_to_360(flight: Any) -> None:
    flight.standing()
    called(flight, "/aircraft/engine/set_direction", {"data": 45.5})
    assert called(flight, "/aircraft/engine/get_direction") == {"data": 45.5}
    assert flight.robot.ask("/aircraft/engine/get_direction") == 45.5
