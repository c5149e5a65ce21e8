"""The agent in Python: it knows the entry URL and vocabularies, and flies with the operations on offer."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from tests.agents import pilot
from tests.agents.conftest import Aircraft

pytestmark = pytest.mark.slow


class Log(list[str]):
    """The log of a pilot."""

    @property
    def writes(self) -> list[tuple[str, str, int]]:
        """Return its unsafe requests: the method, the last part of the target, the status."""
        told = [line.split() for line in self if line.startswith(("POST", "PUT"))]
        return [(method, target.rpartition("/")[2], int(status)) for method, target, status in told]


def fly(aircraft: Aircraft, http: httpx.Client | None = None, **options: Any) -> Log:
    """Fly, and return the log."""
    log = Log()
    with http or httpx.Client(timeout=15) as client:
        pilot.fly(client, aircraft.url, tell=log.append, **options)
    return log


def test_a_pilot_that_knows_only_the_entry_url_flies_the_aircraft(aircraft: Aircraft) -> None:
    log = fly(aircraft, cruise=40.0, pause=0.05)
    assert log.writes == [("POST", "start", 200), ("PUT", "speed", 204), ("PUT", "speed", 204), ("POST", "stop", 200)]
    assert log[-1] == "landed"
    assert (aircraft.power, aircraft.speed) == ("off", 0.0)


def test_an_aircraft_that_is_on_already_is_flown_on(aircraft: Aircraft) -> None:
    aircraft.place("on", 50.0)
    log = fly(aircraft, cruise=30.0, pause=0.05)
    assert log.writes == [("PUT", "speed", 204), ("PUT", "speed", 204), ("POST", "stop", 200)]
    assert aircraft.power == "off"


def test_what_the_shape_forbids_is_not_sent(aircraft: Aircraft) -> None:
    log = Log()
    with httpx.Client(timeout=15) as http, pytest.raises(pilot.Forbidden, match="1500 is not sent"):
        pilot.fly(http, aircraft.url, tell=log.append, cruise=1500.0)
    assert log.writes == [("POST", "start", 200)]
    assert aircraft.speed == 0.0


class Meddler:
    """Another client that intervenes once, just before a request of the pilot arrives."""

    def __init__(self, method: str, last: str, act: Any) -> None:
        self.method, self.last, self.act, self.done = method, last, act, False

    def __call__(self, request: httpx.Request) -> None:
        if not self.done and request.method == self.method and request.url.path.endswith(self.last):
            self.done = True
            self.act()

    def client(self) -> httpx.Client:
        """Return a client whose requests it observes."""
        return httpx.Client(timeout=15, event_hooks={"request": [self]})


def test_a_pilot_who_comes_second_looks_again(aircraft: Aircraft) -> None:
    meddler = Meddler("POST", "/start", lambda: aircraft.call("start"))
    log = fly(aircraft, meddler.client(), cruise=30.0, pause=0.05)
    assert meddler.done
    assert log.writes[0] == ("POST", "start", 409)
    assert log.writes[1:] == [("PUT", "speed", 204), ("PUT", "speed", 204), ("POST", "stop", 200)]
