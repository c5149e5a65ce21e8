"""Names of the aircraft, and its services as pure functions of the flight and the request."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

from rosld.adapters.aircraft.flight import Declined, Flight, set_heading, set_power, set_speed, start, stop

Values: TypeAlias = Mapping[str, object]
Answer: TypeAlias = "tuple[Flight, Values]"


class AircraftService(NamedTuple):
    """A service: its type, and its function of a flight, a request and a time."""

    type: str
    answer: Callable[[Flight, Any, int], Answer]


def _command(act: Callable[[Flight, Any, int], Flight], done: str) -> Callable[[Flight, Any, int], Answer]:
    def answer(flight: Flight, request: Any, now_ns: int) -> Answer:
        try:
            return act(flight, request, now_ns), {"success": True, "message": done}
        except Declined as words:
            return flight, {"success": False, "message": str(words)}

    return answer


def _question(query: Callable[[Flight], object]) -> Callable[[Flight, Any, int], Answer]:
    def answer(flight: Flight, _request: Any, _now_ns: int) -> Answer:
        return flight, {"data": query(flight)}

    return answer


SERVICES: Mapping[str, AircraftService] = MappingProxyType(
    {
        "/aircraft/start": AircraftService(
            "std_srvs/srv/Trigger", _command(lambda flight, _, now: start(flight, now), "started")
        ),
        "/aircraft/stop": AircraftService(
            "std_srvs/srv/Trigger", _command(lambda flight, _, now: stop(flight, now), "stopped")
        ),
        "/aircraft/set_power": AircraftService(
            "rosld_aircraft/srv/SetText",
            _command(lambda flight, request, now: set_power(flight, request.data, now), "power set"),
        ),
        "/aircraft/get_power": AircraftService("rosld_aircraft/srv/GetText", _question(lambda flight: flight.power)),
        "/aircraft/engine/set_speed": AircraftService(
            "rosld_aircraft/srv/SetNumber",
            _command(lambda flight, request, now: set_speed(flight, request.data, now), "speed set"),
        ),
        "/aircraft/engine/set_direction": AircraftService(
            "rosld_aircraft/srv/SetNumber",
            _command(lambda flight, request, now: set_heading(flight, request.data, now), "direction set"),
        ),
        "/aircraft/engine/get_direction": AircraftService(
            "rosld_aircraft/srv/GetNumber", _question(lambda flight: flight.direction)
        ),
    }
)


AIRCRAFT = "/aircraft"
COCKPIT = "/cockpit"
SPEED = "/aircraft/engine/speed"
DISPLAY = "/cockpit/display"
