"""The aircraft that agents fly, embedded, behind a server."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.agents.node import node, require_node
from tests.server.conftest import start_server
from tests.waiting import until

__all__ = ["start_server"]
"""Fixture that starts servers, from the tests of the server."""

HERE = Path(__file__).parent


class Aircraft:
    """An aircraft behind a server. Its plain services, which no mapping guards, simulate another client."""

    def __init__(self, served: Any) -> None:
        self.url: str = served.url
        self.http = served.http

    def call(self, service: str, **request: object) -> Any:
        """Call a service of the aircraft."""
        answer = self.http.post(f"/services/aircraft/{service}", json=request, headers={"Accept": "application/json"})
        assert answer.status_code == 201, answer.text
        return answer.json()

    @property
    def power(self) -> str:
        return str(self.call("get_power")["data"])

    @property
    def speed(self) -> float:
        read = self.http.get("/topics/aircraft/engine/speed", headers={"Accept": "application/json"}).json()
        return float(read["data"])

    def place(self, power: str, speed: float = 0.0) -> None:
        """Set its state: off, or on and at a speed."""
        if self.power == "on":
            self.call("engine/set_speed", data=0.0)
            until(lambda: self.speed == 0.0, "rest")
            self.call("stop")
        if power == "on":
            self.call("start")
            self.call("engine/set_speed", data=speed)
        until(lambda: self.power == power and self.speed == speed, f"power {power}, speed {speed}")


@pytest.fixture(scope="module")
def served_aircraft(start_server: Callable[..., Any]) -> Aircraft:
    """The aircraft, shared by the tests of a file."""
    return Aircraft(start_server("aircraft"))


@pytest.fixture
def aircraft(served_aircraft: Aircraft) -> Aircraft:
    """The aircraft, off."""
    served_aircraft.place("off")
    return served_aircraft


@pytest.fixture(scope="session")
def run_node() -> Callable[..., tuple[int, list[Any]]]:
    """Return a function that runs a script of this folder on Node: its exit code and the JSON lines that it printed."""
    require_node()

    def run(script: str, *arguments: str) -> tuple[int, list[Any]]:
        command = node(HERE / script, *arguments)
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        lines = [json.loads(line) for line in done.stdout.splitlines()]
        assert done.returncode == 0 or lines, done.stderr
        return done.returncode, lines

    return run
