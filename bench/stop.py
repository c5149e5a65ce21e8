"""How soon a stop reaches the robot at full load: from the request to the call of the robot's service, in ms.

    python bench/stop.py [--rounds 20]

The load: 8 clients with queries that take the longest they may, 16 calls of a service that does not answer, and 16
clients that read as fast as they are answered. The robot's own clock says when it was told. Beside it the same without
load. Aim: under 50 ms.
"""

from __future__ import annotations

import argparse
import http.client
import json
import logging
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.server.robots.made_up import MadeUp, served

MAPPING = '@prefix map: <https://w3id.org/rosld/mapping#> . <#a> a map:ComplexResource ; map:path "/arm/" ; map:stop [ map:call "brake" ] .'  # noqa: E501
HEAVY = "/sparql?" + urlencode({"query": "SELECT (COUNT(*) AS ?n) { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i }", "timeout": 2})
JSON = {"Content-Type": "application/json", "Accept": "application/json"}


class Client:
    """One connection, kept alive."""

    def __init__(self, address: str) -> None:
        self._connection = http.client.HTTPConnection(address, timeout=60)

    def ask(self, method: str, path: str, body: str | None = None, headers: dict[str, str] = JSON) -> int:
        """The status of an answer."""
        self._connection.request(method, path, body, headers)
        answer = self._connection.getresponse()
        answer.read()
        return answer.status


def load(address: str) -> None:
    """Everything at once, for ever."""

    def again(path: str) -> None:
        client = Client(address)
        while True:
            client.ask("GET", path)

    def call() -> None:
        client = Client(address)
        while True:
            client.ask("POST", "/services/arm/slow", "{}")
            time.sleep(0.01)

    works: list[Callable[[], None]] = [lambda: again(HEAVY)] * 8 + [call] * 16 + [lambda: again("/topics/state")] * 16
    for work in works:
        threading.Thread(target=work, daemon=True).start()
    time.sleep(3)
    print("ready", flush=True)
    time.sleep(3600)


def press(address: str, rounds: int) -> None:
    """Stop so many times, and print when each request was sent."""
    client, times = Client(address), []
    for _ in range(rounds):
        times.append(time.monotonic())
        assert client.ask("POST", "/stop") == 200
        while client.ask("DELETE", "/stop") == 409:
            time.sleep(0.01)
        time.sleep(0.2)
    print(json.dumps(times))


def measured(address: str, told: list[float], rounds: int) -> list[float]:
    """Milliseconds from each request to the robot's being told."""
    told.clear()
    command = [sys.executable, __file__, "--press", address, "--rounds", str(rounds)]
    times = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return sorted((heard - sent) * 1e3 for sent, heard in zip(times, told, strict=True))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--load")
    parser.add_argument("--press")
    asked = parser.parse_args()
    if asked.load:
        load(asked.load)
    elif asked.press:
        press(asked.press, asked.rounds)
    else:
        bench(asked.rounds)


def bench(rounds: int) -> None:
    """Serve the robot here; load and stop it from other processes."""
    logging.disable(logging.WARNING)
    robot, told = MadeUp(), list[float]()

    def brake(_: dict[str, Any]) -> dict[str, Any]:
        told.append(time.monotonic())
        return {"success": True, "message": ""}

    robot.offer("/arm/brake", "std_srvs/srv/Trigger", brake)
    robot.offer("/arm/slow", "std_srvs/srv/Trigger", lambda _: {"success": True, "message": ""})
    robot.topic("/state", "std_msgs/msg/String", {"data": "standing"})
    with served(robot, call_deadline=30.0) as http:
        address = http.base_url.netloc.decode()
        assert Client(address).ask("PUT", "/mappings/arm", MAPPING, {"Content-Type": "text/turtle"}) == 201
        rows = {"alone": measured(address, told, rounds)}
        robot.hold("/arm/slow")
        with subprocess.Popen([sys.executable, __file__, "--load", address], stdout=subprocess.PIPE) as loading:
            assert loading.stdout is not None
            loading.stdout.readline()
            rows["at full load"] = measured(address, told, rounds)
            loading.kill()
        robot.release("/arm/slow")
    print(f"{'request to robot, ms':22}{'median':>9}{'90 %':>9}{'most':>9}")
    for name, found in rows.items():
        print(f"{name:22}{statistics.median(found):9.1f}{found[int(0.9 * (len(found) - 1))]:9.1f}{found[-1]:9.1f}")


if __name__ == "__main__":
    main()
