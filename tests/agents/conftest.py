"""The aircraft that agents fly, embedded and as a rospy node under a real roscore, each behind a server of its own."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import tests.agents.node
import tests.agents.pilot
from tests.adapters.ros1.system import running
from tests.server.conftest import start_lasting_server

__all__ = ["start_lasting_server"]
"""The fixture that starts servers; it belongs to the server's tests."""

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
SERVICES = ("start", "stop", "get_power", "set_power", "engine/set_speed", "engine/set_direction")
PATIENCE = 30.0


def until(true: Callable[[], Any], what: str) -> Any:
    """Wait for something about the robot."""
    end = time.monotonic() + PATIENCE
    while not (found := true()):
        assert time.monotonic() < end, f"never came: {what}"
        time.sleep(0.05)
    return found


class Aircraft:
    """An aircraft behind a server. Its plain services, which no mapping guards, are the hand of somebody else."""

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
        """Whether it is on or off."""
        return str(self.call("get_power")["data"])

    @property
    def speed(self) -> float | None:
        """Its speed, None as long as nobody told."""
        read = self.http.get("/topics/aircraft/engine/speed", headers={"Accept": "application/json"}).json()
        return None if read is None else float(read["data"])

    def place(self, power: str, speed: float = 0.0) -> None:
        """Bring it into a state: off, or on and at a speed."""
        if self.power == "on":
            self.call("engine/set_speed", data=0.0)
            until(lambda: self.speed == 0.0, "rest")
            self.call("stop")
        if power == "on":
            self.call("start")
            self.call("engine/set_speed", data=speed)
        until(lambda: self.power == power and self.speed == speed, f"power {power}, speed {speed}")


@pytest.fixture(scope="session")
def embedded(start_lasting_server: Callable[..., Any]) -> Aircraft:
    """The aircraft that rosld brings along."""
    return Aircraft(start_lasting_server("aircraft"))


@pytest.fixture(scope="session")
def rospy(start_lasting_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Aircraft]:
    """The same as a rospy node, with the mapping and the limits that are shipped with the embedded one."""
    with running(tmp_path_factory.mktemp("ros")) as system:
        system.node("aircraft_node.py", str(tmp_path_factory.mktemp("classes")))
        files = ROOT / "adapters" / "aircraft"
        options = ("--mapping", str(files / "mapping.ttl"), "--shapes", str(files / "limits.ttl"))
        found = Aircraft(start_lasting_server(system.source, *options))
        for name in SERVICES:
            allowed = f"/services/aircraft/{name}"
            until(lambda url=allowed: "POST" in found.http.options(url).headers.get("allow", ""), allowed)
        yield found


@pytest.fixture(params=["embedded", "rospy"])
def aircraft(request: pytest.FixtureRequest) -> Aircraft:
    """Each of them in turn, off."""
    found: Aircraft = request.getfixturevalue(request.param)
    found.place("off")
    return found


@pytest.fixture(scope="session")
def pilot() -> ModuleType:
    """The agent in Python."""
    return tests.agents.pilot


@pytest.fixture(scope="session")
def node() -> ModuleType:
    """Node, where there is one."""
    tests.agents.node.require_node()
    return tests.agents.node


@pytest.fixture(scope="session")
def run_node(node: ModuleType) -> Callable[..., tuple[int, list[Any]]]:
    """Runs a script of this folder on Node: its exit code, and the lines of JSON that it printed."""

    def run(script: str, *arguments: str) -> tuple[int, list[Any]]:
        command = node.node(HERE / script, *arguments)
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        lines = [json.loads(line) for line in done.stdout.splitlines()]
        assert done.returncode == 0 or lines, done.stderr
        return done.returncode, lines

    return run
